"""Any folder of images as a traversal.

Positions come from a CSV file (``image,x,y[,z]`` in metres, ``image,latitude,longitude`` or ``image,index``), from file names
(``@utm_east@utm_north@...``, the convention of VPR-datasets-downloader), or from the frame order.
"""

from __future__ import annotations

import csv
import re
from pathlib import Path

import numpy as np

from artifact.datasets.traversal import DatasetError
from artifact.manifest.layout import IMAGE_SUFFIXES, POSITIONS_FILE, UTM_NAME, text_of


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
    return contents(folder)[0]


def contents(folder: Path) -> tuple[list[str], list[str]]:
    """Return the names of the images below a folder in natural order, and of the other files.

    Hidden files and the folders ``__MACOSX`` that some archives hold are passed over.
    """
    names, others = [], []
    for path in folder.rglob("*"):
        name = path.relative_to(folder)
        if not any(part.startswith((".", "__MACOSX")) for part in name.parts) and path.is_file():
            (names if path.suffix.lower() in IMAGE_SUFFIXES else others).append(name.as_posix())
    if not names:
        raise DatasetError(f"{folder}: no images in it; files with these endings count: {', '.join(IMAGE_SUFFIXES)}")
    return sorted(names, key=natural_order), sorted(set(others) - {POSITIONS_FILE})


def natural_order(name: str) -> list[tuple[int, int, str]]:
    """Return a sort key that compares runs of digits as numbers.

    Examples
    --------
    >>> sorted(["f10.jpg", "f9.jpg", "F1.jpg"], key=natural_order)
    ['F1.jpg', 'f9.jpg', 'f10.jpg']
    """
    parts = re.split(r"(\d+)", name)
    return [(1, int(part), "") if part.isdecimal() else (0, 0, part) for part in parts]


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

    Only the file's own name is read, so an ``@`` in a parent folder does no harm; text may stand before the first ``@``.

    Raises
    ------
    DatasetError
        If a name has no such numbers, or the zones that follow them differ: positions of two zones are not in one plane.
    """
    positions, zones = np.empty((len(names), 2)), set()
    for row, name in enumerate(names):
        fields = UTM_NAME.search(Path(name).name)
        if fields is None:
            raise DatasetError(
                f"{folder / name}: the name does not begin with @utm_east@utm_north@ in metres; "
                f"write the positions to {POSITIONS_FILE} instead, or use the frame order"
            )
        positions[row] = float(fields["east"]), float(fields["north"])
        zones |= {fields["zone"]} - {None, ""}
    if len(zones) > 1:
        raise DatasetError(
            f"{folder}: the names are in the UTM zones {', '.join(sorted(zones))}; write image,latitude,longitude to "
            f"{POSITIONS_FILE} instead"
        )
    return _finite(positions, folder, names)


def names_in_csv(path: Path) -> list[str]:
    """Return the image names of a positions file in its order, for traversals without images."""
    return list(_positions_table(path)[0])


def positions_from_csv(path: Path, names: list[str], part: str = "") -> tuple[np.ndarray, str]:
    """Return positions in the order of ``names`` and their unit from a CSV file.

    Columns are found by their names in any order, further ones are passed over. The separator is a comma, semicolon or tab;
    with the latter two, numbers may have decimal commas. The text is UTF-8, UTF-16 or Latin-1.

    Parameters
    ----------
    path
        CSV file with a column ``image`` and ``x``, ``y`` and perhaps ``z`` (metres, in any plane coordinate system), or
        ``latitude`` and ``longitude`` (degrees, WGS 84), or ``index`` (frames).
    names
        Image names; each must have exactly one row.
    part
        Folder of the images, which may stand before the names in a file for several folders.

    Returns
    -------
    positions
        ``(n, 2)`` or ``(n, 3)`` float64 metres (degrees become earth-centred coordinates, whose distances are true in every
        zone), or ``(n, 1)`` frames.
    unit
        ``"metres"`` or ``"frames"``.

    Raises
    ------
    DatasetError
        If the file is missing, has another header, a row that does not fit, no row for an image, or degrees as ``x`` and ``y``.
    """
    table, kind = _positions_table(path)
    keys = [name if name in table or f"{part}/{name}" not in table else f"{part}/{name}" for name in names]
    missing = [key for key in keys if key not in table]
    if missing:
        alike = {key.lower(): key for key in table}.get(missing[0].lower())
        hint = f"; it has {alike!r}, in other case" if alike else ""
        raise DatasetError(f"{path}: no row for {len(missing)} of {len(names)} images, first {missing[0]!r}{hint}")
    positions = _finite(np.array([table[key] for key in keys], dtype=np.float64), path, names)
    if kind == "degrees":
        outside = np.flatnonzero((np.abs(positions) > [90, 180]).any(axis=1))
        if outside.size:
            raise DatasetError(
                f"{path}: latitude and longitude of {names[outside[0]]!r} are {positions[outside[0]].tolist()}"
            )
        return earth_centred(*positions.T), "metres"
    if kind == "metres" and _look_like_degrees(positions):
        raise DatasetError(
            f"{path}: x and y all lie within one unit around {positions[0, :2].tolist()}, as degrees do; name the columns latitude "
            f"and longitude if they are"
        )
    return positions, "frames" if kind == "index" else "metres"


def earth_centred(latitude: np.ndarray, longitude: np.ndarray) -> np.ndarray:
    """Return earth-centred coordinates ``(n, 3)`` in metres of points on the WGS 84 ellipsoid, given in degrees.

    Straight distances between them are those on the ground to 1 mm in a kilometre, in every zone.

    Examples
    --------
    >>> a, b = earth_centred(np.array([51.0, 51.0]), np.array([0.0, 0.001]))
    >>> round(float(np.linalg.norm(a - b)), 2)
    70.2
    """
    phi, theta = np.radians(latitude), np.radians(longitude)
    squared_eccentricity = 6.69437999014e-3
    normal = 6_378_137.0 / np.sqrt(1 - squared_eccentricity * np.sin(phi) ** 2)
    around = normal * np.cos(phi)
    north = normal * (1 - squared_eccentricity) * np.sin(phi)
    return np.column_stack([around * np.cos(theta), around * np.sin(theta), north])


def _look_like_degrees(positions: np.ndarray) -> bool:
    """Whether coordinates are of the size of degrees, away from the origin, and hardly differ."""
    plane = positions[:, :2]
    apart = np.ptp(plane, axis=0).max()
    return bool(len(plane) > 1 and 0 < apart < 1 and np.abs(plane).max() <= 180 and np.abs(plane).max() > 1)


_COLUMNS = {
    "image": ("image", "name", "file", "filename"),
    "x": ("x", "east", "easting", "utm_east"),
    "y": ("y", "north", "northing", "utm_north"),
    "z": ("z",),
    "latitude": ("latitude", "lat"),
    "longitude": ("longitude", "lon", "lng"),
    "index": ("index", "frame"),
}
_KINDS = {"metres": ("x", "y"), "degrees": ("latitude", "longitude"), "index": ("index",)}


def _positions_table(path: Path) -> tuple[dict[str, list[float]], str]:
    """Coordinates by image name, and their kind: metres, degrees or index."""
    if not path.is_file():
        raise DatasetError(
            f"{path}: no such file; it should have the header image,x,y (metres) or image,index (frames)"
        )
    lines = text_of(path).splitlines()
    separator = max(",;\t", key=lines[0].count) if lines else ","
    header = [column.strip().strip('"').lower() for column in lines[0].split(separator)] if lines else []
    at = {name: header.index(alias) for name, known in _COLUMNS.items() for alias in known[::-1] if alias in header}
    kind = next((kind for kind, needed in _KINDS.items() if all(name in at for name in needed)), None)
    if kind is None or "image" not in at:
        raise DatasetError(
            f"{path}:1: the header is {','.join(header)!r}; allowed: 'image,x,y' or 'image,x,y,z' in metres, "
            f"'image,latitude,longitude', or 'image,index'"
        )
    columns = [at[name] for name in (*_KINDS[kind], *(["z"] if kind == "metres" and "z" in at else []))]
    table: dict[str, list[float]] = {}
    for line, row in enumerate(csv.reader(lines[1:], delimiter=separator), start=2):
        if not row:
            continue
        if len(row) != len(header):
            raise DatasetError(f"{path}:{line}: {len(row)} fields where the header has {len(header)}")
        name = row[at["image"]].strip().replace("\\", "/").removeprefix("./")
        if name in table:
            raise DatasetError(f"{path}:{line}: a second row for the image {name!r}")
        values = [row[column].strip() for column in columns]
        try:
            table[name] = [float(value.replace(",", ".") if separator != "," else value) for value in values]
        except ValueError:
            raise DatasetError(f"{path}:{line}: found {','.join(values)!r}; positions must be numbers") from None
    return table, kind


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
