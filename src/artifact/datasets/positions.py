"""Positions of the images of any folder.

They come from a CSV file (``image,x,y[,z]`` in metres, ``image,latitude,longitude`` or ``image,index``), from file
names (``@utm_east@utm_north@...``, the convention of VPR-datasets-downloader), or from the frame order.
"""

from __future__ import annotations

import csv
import unicodedata
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from artifact.datasets.traversal import DatasetError
from artifact.manifest.layout import KINDS, POSITIONS_FILE, UTM_NAME, header_of, text_of

_SHORTEST_STEP = 0.01  # metres; images of a traversal are not closer to each other


def positions_from_names(folder: Path, names: list[str]) -> np.ndarray:
    """Return ``(n, 2)`` metres (east, north) from ``@utm_east@utm_north@...`` file names.

    Only the file's own name is read, so an ``@`` in a parent folder does no harm; text may stand before the first
    ``@``. Raises ``DatasetError`` if a name has no such numbers, or the zones that follow them differ.
    """
    positions = np.empty((len(names), 2))
    for row, name in enumerate(names):
        fields = UTM_NAME.search(Path(name).name)
        if fields is None:
            raise DatasetError(
                f"{folder / name}: the name does not begin with @utm_east@utm_north@ in metres; "
                f"write the positions to {POSITIONS_FILE} instead, or use the frame order"
            )
        positions[row] = float(fields["east"]), float(fields["north"])
    zone_of(folder, names)
    return in_metres(positions, folder, names)


def zone_of(where: Path | str, names: Iterable[str]) -> str | None:
    """Return the UTM zone that names of images hold, if any, or raise ``DatasetError`` if they hold several."""
    found = (UTM_NAME.search(Path(name).name) for name in names)
    zones = sorted({fields["zone"] for fields in found if fields and fields["zone"]})
    if len(zones) > 1:
        raise DatasetError(
            f"{where}: the names are in the UTM zones {', '.join(zones)}; write image,latitude,longitude to "
            f"{POSITIONS_FILE} instead"
        )
    return zones[0] if zones else None


def names_in_csv(path: Path) -> list[str]:
    """Return the image names of a positions file in its order, for traversals without images."""
    return list(_positions_table(path)[0])


def positions_from_csv(path: Path, names: list[str], part: str = "") -> tuple[np.ndarray, str]:
    """Return positions in the order of ``names`` and their unit from a CSV file.

    Columns are found by their names in any order, further ones are passed over. The separator is a comma, semicolon or
    tab; with the latter two, numbers may have decimal commas. The text is UTF-8, UTF-16 or Latin-1.

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
    positions, unit
        ``(n, 2)`` or ``(n, 3)`` float64 ``"metres"`` (degrees become earth-centred coordinates, whose distances are
        true in every zone), or ``(n, 1)`` ``"frames"``.

    Raises
    ------
    DatasetError
        If the file is missing, has another header, a row that does not fit, no row for an image, or degrees as x, y.
    """
    table, kind = _positions_table(path)
    keys = [name if name in table or f"{part}/{name}" not in table else f"{part}/{name}" for name in names]
    missing = [key for key in keys if key not in table]
    if missing:
        alike = {_plain(key): key for key in table}.get(_plain(missing[0]))
        hint = f"; it has {alike!r}, in other case or another form of Unicode" if alike else ""
        raise DatasetError(f"{path}: no row for {len(missing)} of {len(names)} images, first {missing[0]!r}{hint}")
    positions = np.array([table[key] for key in keys], dtype=np.float64)
    if kind == "metres":
        return in_metres(positions, path, names), "metres"
    _require_finite(positions, path, names)
    if kind == "index":
        return positions, "frames"
    outside = np.flatnonzero((np.abs(positions) > [90, 180]).any(axis=1))
    if outside.size:
        name, values = names[outside[0]], positions[outside[0]].tolist()
        raise DatasetError(f"{path}: latitude and longitude of {name!r} are {values}")
    return earth_centred(*positions.T), "metres"


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


def in_metres(positions: np.ndarray, where: Path, names: Sequence[object]) -> np.ndarray:
    """Return positions that were given in metres as they are.

    Raises ``DatasetError`` if a value is not finite, or all look like degrees: of their size, away from the origin, and
    closer to each other than images of a traversal in metres are.
    """
    _require_finite(positions, where, names)
    plane = positions[:, :2]
    largest, apart = np.abs(plane).max(), np.ptp(plane, axis=0).max()
    steps = np.linalg.norm(np.diff(plane, axis=0), axis=1)
    moved = steps[steps > 0]
    close = apart < 1 or (len(moved) > 0 and float(np.median(moved)) < _SHORTEST_STEP)
    if plane.shape[1] == 2 and apart > 0 and 1 < largest <= 180 and close:
        raise DatasetError(
            f"{where}: x and y are of the size of degrees and hardly differ, the first are {plane[0].tolist()}; "
            f"give them as latitude and longitude in a {POSITIONS_FILE} if they are"
        )
    return positions


def _positions_table(path: Path) -> tuple[dict[str, list[float]], str]:
    """Coordinates by image name, and their kind: metres, degrees or index."""
    if not path.is_file():
        needed = "it should have the header image,x,y (metres) or image,index (frames)"
        raise DatasetError(f"{path}: no such file; {needed}")
    first, *lines = text_of(path).splitlines() or [""]
    separator, header, at, kind = header_of(first)
    if kind is None or "image" not in at:
        raise DatasetError(
            f"{path}:1: the header is {','.join(header)!r}; allowed: 'image,x,y' or 'image,x,y,z' in metres, "
            f"'image,latitude,longitude', or 'image,index'"
        )
    columns = [at[name] for name in (*KINDS[kind], *(["z"] if kind == "metres" and "z" in at else []))]
    table: dict[str, list[float]] = {}
    for line, row in enumerate(csv.reader(lines, delimiter=separator), start=2):
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


def _require_finite(positions: np.ndarray, where: Path, names: Sequence[object]) -> None:
    bad = np.flatnonzero(~np.isfinite(positions).all(axis=1))
    if bad.size:
        raise DatasetError(f"{where}: the position of {names[bad[0]]!r} is not a finite number")


def _plain(name: str) -> str:
    return unicodedata.normalize("NFC", name).casefold()


def keep_spacing(positions: np.ndarray, spacing: float) -> np.ndarray:
    """Return the indices of a traversal thinned to a spacing in metres (paper §V-A: 1 m).

    The first frame is kept, then every frame at least ``spacing`` from the last frame kept.

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
