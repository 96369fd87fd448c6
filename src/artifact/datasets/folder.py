"""The images of any folder, in their order."""

from __future__ import annotations

import re
from pathlib import Path

from artifact.datasets.prepared import INDEX_FILE, SIDECAR_FILE
from artifact.datasets.traversal import DatasetError
from artifact.manifest.layout import IMAGE_SUFFIXES, POSITIONS_FILE, files_below


def list_images(folder: Path, image_list: Path | None = None) -> list[str]:
    """Return the image names below ``folder``, relative to it: those of a list, one a line, or all in natural order.

    Raises ``DatasetError`` if the folder or list is missing, names a file that is not there, or holds no image.
    """
    if not folder.is_dir():
        raise DatasetError(f"{folder}: no such folder; it should hold the images of this traversal")
    if image_list is None:
        return contents(folder)[0]
    if not image_list.is_file():
        raise DatasetError(f"{image_list}: no such file; it should list one image name of {folder} a line")
    names = [line.strip() for line in image_list.read_text(encoding="utf-8").splitlines() if line.strip()]
    if not names:
        raise DatasetError(f"{image_list}: it is empty")
    if missing := [name for name in names if not (folder / name).is_file()]:
        what = f"{len(missing)} of its {len(names)} images are not in {folder}, first {missing[0]!r}"
        raise DatasetError(f"{image_list}: {what}")
    return names


def contents(folder: Path) -> tuple[list[str], list[str]]:
    """Return the names of the images below a folder in natural order, and of the other files.

    Hidden files and the folders ``__MACOSX`` that some archives hold are passed over.
    """
    names, others = files_below(folder)
    if not names:
        raise DatasetError(f"{folder}: no images in it; files with these endings count: {', '.join(IMAGE_SUFFIXES)}")
    return sorted(names, key=natural_order), sorted(set(others) - {POSITIONS_FILE, INDEX_FILE, SIDECAR_FILE})


def natural_order(name: str) -> list[tuple[int, int, str]]:
    """Return a sort key that compares runs of digits as numbers.

    Examples
    --------
    >>> sorted(["f10.jpg", "f9.jpg", "F1.jpg"], key=natural_order)
    ['F1.jpg', 'f9.jpg', 'f10.jpg']
    """
    parts = re.split(r"(\d+)", name)
    return [(1, int(part), "") if part.isdecimal() else (0, 0, part) for part in parts]
