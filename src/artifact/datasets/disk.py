"""Room on disk, and numbers of bytes in words."""

from __future__ import annotations

import shutil
from pathlib import Path


def free_bytes(folder: Path) -> int:
    """Return the free bytes of the disk that holds, or would hold, a folder."""
    return shutil.disk_usage(next(place for place in (folder, *folder.resolve().parents) if place.exists())).free


def in_words(n_bytes: float | None) -> str:
    """Write a number of bytes for people.

    Examples
    --------
    >>> in_words(105_123_000_000), in_words(2_000_152), in_words(64), in_words(None)
    ('105.1 GB', '2 MB', '64 bytes', 'size unknown')
    """
    if n_bytes is None:
        return "size unknown"
    for unit, size in (("TB", 1e12), ("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if n_bytes >= size:
            return f"{f'{n_bytes / size:.1f}'.removesuffix('.0')} {unit}"
    return f"{n_bytes:.0f} bytes"
