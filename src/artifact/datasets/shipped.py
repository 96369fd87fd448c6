"""Real descriptors that ship with the package, for machines without the images.

``shipped_descriptors/<dataset>/traversals.json`` records the image names and content digest of each traversal; each
``<traversal>-<method>.npy`` (float16) has a sidecar with the key that it was made under. They are used only when
that key equals the key that the code at hand would use, so an outdated file is never passed off as current.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from artifact import store


def folder() -> Path:
    """Return the package folder of shipped descriptors."""
    return Path(str(files("artifact.datasets"))) / "shipped_descriptors"


def traversal(dataset: str, name: str) -> tuple[list[str], str] | None:
    """Return the image names and content digest of a shipped traversal, or ``None`` if there is none."""
    # A folder of the user's is no name of a shipped dataset; joined to ours it would replace it.
    path = folder() / dataset / "traversals.json"
    if Path(dataset).is_absolute() or not path.is_file():
        return None
    listed = _whole(store.read_json, path).get(name)
    return (listed["image_names"], listed["digest"]) if listed else None


def path_of(key: str) -> Path | None:
    """Return the shipped ``.npy`` file of descriptors or image statistics made under ``key``, if there is one."""
    for path in sorted(folder().glob("*/[!.]*.npy")):  # a hidden file is one being written
        if _whole(store.read_json, path.with_suffix(".json"))["key"] == key:
            return path
    return None


def record(path: Path) -> dict[str, Any]:
    """Return the record of a shipped file, or raise ``StoreError`` if the file is damaged."""
    return _whole(store.check, path)


def _whole(read: Callable[[Path], Any], path: Path) -> Any:
    try:
        return read(path)
    except store.DamagedError as error:
        raise store.StoreError(f"{error}; it came with the package: install it again, or `git checkout` it") from None


def appearance(key: str) -> np.ndarray | None:
    """Return the shipped image statistics that were made under ``key``, or ``None`` if there are none."""
    path = path_of(key)
    return None if path is None or not record(path) else np.load(path, allow_pickle=False)
