"""Any folder of images as a traversal.

Positions come from a CSV file (``image,x,y[,z]`` in metres or ``image,index``), from file names
(``@utm_east@utm_north@...``, the convention of VPR-datasets-downloader), or from the frame order.
"""

from __future__ import annotations

import csv
import re
from pathlib import Path

import numpy as np

from artifact.datasets.traversal import DatasetError
from artifact.manifest.layout import IMAGE_SUFFIXES, POSITIONS_FILE


def list_images(folder: Path, image_list: Path | None = None) -> list[str]:
    """Return the image names below ``folder``, relative to it and in natural order.

    Natural order compares runs of digits as numbers, so ``frame2`` comes before ``frame10``.

    Parameters
    ----------
    folder
        Searched with its sub-folders; hidden files are passed over.
    image_list
        Text file with one image name a line, which selects and orders the images instead.

    Raises
    ------
    DatasetError
        If the folder or list is missing, names a file that is not there, or holds no image.
    """
    if not folder.is_dir():
        raise DatasetError(f"{folder}: no such folder; it should hold the images of this traversal")
    if image_list is not None:
        return _listed(folder, image_list)
    names = [
        path.relative_to(folder).as_posix()
        for path in folder.rglob("*")
        if path.suffix.lower() in IMAGE_SUFFIXES and not any(p.startswith(".") for p in path.relative_to(folder).parts)
    ]
    if not names:
        raise DatasetError(f"{folder}: no images in it; files with these endings count: {', '.join(IMAGE_SUFFIXES)}")
    return sorted(names, key=natural_order)


def natural_order(name: str) -> list[tuple[int, int, str]]:
    """Return a sort key that compares runs of digits as numbers.

    Examples
    --------
    >>> sorted(["f10.jpg", "f9.jpg", "F1.jpg"], key=natural_order)
    ['F1.jpg', 'f9.jpg', 'f10.jpg']
    """
    parts = re.split(r"(\d+)", name)
    return [(1, int(part), "") if part.isdigit() else (0, 0, part) for part in parts]


def _listed(folder: Path, image_list: Path) -> list[str]:
    if not image_list.is_file():
        raise DatasetError(f"{image_list}: no such file; it should list one image name of {folder} a line")
    names = [line.strip() for line in image_list.read_text(encoding="utf-8").splitlines() if line.strip()]
    missing = [name for name in names if not (folder / name).is_file()]
    if missing or not names:
        what = (
            f"{len(missing)} of its {len(names)} images are not in {folder}, first {missing[0]!r}"
            if names
            else "it is empty"
        )
        raise DatasetError(f"{image_list}: {what}")
    return names


def positions_from_names(folder: Path, names: list[str]) -> np.ndarray:
    """Return ``(n, 2)`` metres (east, north) from ``@utm_east@utm_north@...`` file names.

    Only the file's own name is read, so an ``@`` in a parent folder does no harm.
    """
    positions = np.empty((len(names), 2))
    for row, name in enumerate(names):
        fields = Path(name).name.split("@")
        try:
            positions[row] = float(fields[1]), float(fields[2])
        except (IndexError, ValueError):
            raise DatasetError(
                f"{folder / name}: the name does not begin with @utm_east@utm_north@ in metres; "
                f"write the positions to {POSITIONS_FILE} instead, or use the frame order"
            ) from None
    return _finite(positions, folder, names)


def names_in_csv(path: Path) -> list[str]:
    """Return the image names of a positions file in its order, for traversals without images."""
    return [row[0].strip() for row in _rows(path)[1:]]


def _rows(path: Path) -> list[list[str]]:
    if not path.is_file():
        raise DatasetError(
            f"{path}: no such file; it should have the header image,x,y (metres) or image,index (frames)"
        )
    with path.open(newline="", encoding="utf-8-sig") as stream:
        return [row for row in csv.reader(stream) if row]


def positions_from_csv(path: Path, names: list[str]) -> tuple[np.ndarray, str]:
    """Return positions in the order of ``names`` and their unit from a CSV file.

    Parameters
    ----------
    path
        CSV file with the header ``image,x,y`` or ``image,x,y,z`` (metres) or ``image,index`` (frames).
    names
        Image names; each must have exactly one row.

    Returns
    -------
    positions
        ``(n, 2)``, ``(n, 3)`` or ``(n, 1)`` float64.
    unit
        ``"metres"`` or ``"frames"``.
    """
    rows = _rows(path)
    header = [column.strip().lower() for column in rows[0]] if rows else []
    if header not in (["image", "x", "y"], ["image", "x", "y", "z"], ["image", "index"]):
        raise DatasetError(
            f"{path}:1: the header is {','.join(header)!r}; allowed: 'image,x,y' or 'image,x,y,z' in metres, or 'image,index'"
        )
    table: dict[str, list[float]] = {}
    for line, row in enumerate(rows[1:], start=2):
        if len(row) != len(header):
            raise DatasetError(f"{path}:{line}: {len(row)} fields where the header has {len(header)}")
        name = row[0].strip()
        if name in table:
            raise DatasetError(f"{path}:{line}: a second row for the image {name!r}")
        try:
            table[name] = [float(value) for value in row[1:]]
        except ValueError:
            raise DatasetError(f"{path}:{line}: found {','.join(row[1:])!r}; positions must be numbers") from None
    missing = [name for name in names if name not in table]
    if missing:
        raise DatasetError(f"{path}: no row for {len(missing)} of {len(names)} images, first {missing[0]!r}")
    positions = np.array([table[name] for name in names], dtype=np.float64)
    return _finite(positions, path, names), "frames" if header[1] == "index" else "metres"


def _finite(positions: np.ndarray, where: Path, names: list[str]) -> np.ndarray:
    bad = np.flatnonzero(~np.isfinite(positions).all(axis=1))
    if bad.size:
        raise DatasetError(f"{where}: the position of {names[bad[0]]!r} is not a finite number")
    return positions


def keep_spacing(positions: np.ndarray, spacing: float) -> np.ndarray:
    """Return the indices of a traversal thinned to a spacing in metres.

    The first frame is kept, then every frame at least ``spacing`` from the last frame kept (paper §V-A:
    traversals are subsampled to 1 m).

    Examples
    --------
    >>> keep_spacing(np.array([[0.0], [0.4], [1.0], [1.9], [2.1]]), 1.0)
    array([0, 2, 4])
    """
    kept = [0]
    for index in range(1, len(positions)):
        if np.linalg.norm(positions[index] - positions[kept[-1]]) >= spacing:
            kept.append(index)
    return np.array(kept)
