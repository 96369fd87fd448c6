"""A folder of images as a dataset entry: described by its ``dataset.yaml``, or read off its layout."""

from __future__ import annotations

import contextlib
import os
import re
from pathlib import Path

from artifact.manifest.entries import DatasetEntry, ManifestError, Positions, Threshold, TraversalEntry
from artifact.manifest.faults import read

IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png", ".webp", ".bmp", ".tif", ".tiff")
POSITIONS_FILE = "positions.csv"
UTM_NAME = re.compile(r"@(?P<east>-?\d+\.?\d*)@(?P<north>-?\d+\.?\d*)@(?:(?P<zone>\d{1,2})@[A-Za-z]@)?")
"""``@utm_east@utm_north@`` in a file name, perhaps with the zone behind it."""

DESCRIPTION = "dataset.yaml"
_COLUMNS = {
    "image": ("image", "name", "file", "filename"),
    "x": ("x", "east", "easting", "utm_east"),
    "y": ("y", "north", "northing", "utm_north"),
    "z": ("z",),
    "latitude": ("latitude", "lat"),
    "longitude": ("longitude", "lon", "lng"),
    "index": ("index", "frame"),
}
KINDS = {"metres": ("x", "y"), "degrees": ("latitude", "longitude"), "index": ("index",)}
"""Columns that positions of each kind need."""


def entry_of_folder(folder: Path) -> DatasetEntry:
    """Return the entry of a dataset that is a folder.

    The folder describes itself in ``dataset.yaml`` (the same keys as a manifest entry), or has the sub-folders
    ``queries`` and ``database`` (or ``gallery``): then positions come from ``positions.csv`` in each or one beside
    them, else from ``@utm_east@utm_north@`` file names, else from the frame order, and the threshold is 25 m, or 1
    frame. Raises :class:`ManifestError` if the description has a fault, or the layout is another one.
    """
    folder = folder.resolve()
    if (folder / DESCRIPTION).is_file():
        entry = read(folder / DESCRIPTION, DatasetEntry)
        return entry if entry.root else entry.model_copy(update={"root": str(folder)})
    query, database = _one_of(folder, "queries", "query"), _one_of(folder, "database", "gallery")
    sources = {part: positions_source(folder / part) for part in (query, database)}
    beside = POSITIONS_FILE if (folder / POSITIONS_FILE).is_file() and "csv" not in sources.values() else None
    if beside:
        sources = dict.fromkeys(sources, "csv")
    if len(set(sources.values())) != 1:
        kinds = ", ".join(sorted(sources.values()))
        raise ManifestError(f"{folder}: {query} and {database} have different kinds of positions: {kinds}")
    source = sources[query]
    file = folder / (beside or f"{query}/{POSITIONS_FILE}")
    in_frames = source == "order" or (source == "csv" and has_index(file))
    return DatasetEntry(
        title=folder.name,
        kind="folder",
        root=str(folder),
        threshold=Threshold(value=1.0, unit="frames") if in_frames else Threshold(value=25.0, unit="metres"),
        query=query,
        database=database,
        shift=f"{query}→{database}",
        traversals={p: TraversalEntry(condition=p, positions=source, positions_file=beside) for p in (query, database)},
    )


def _one_of(folder: Path, *candidates: str) -> str:
    found = [candidate for candidate in candidates if (folder / candidate).is_dir()]
    if len(found) != 1:
        raise ManifestError(
            f"{folder}: expected one folder named {' or '.join(candidates)}, found {len(found)}; "
            f"or describe the dataset in {folder / DESCRIPTION}"
        )
    return found[0]


def positions_source(images: Path) -> Positions:
    """Say where the positions of a folder of images come from if nobody says it.

    Raises :class:`ManifestError` if some of the names hold positions and others do not.
    """
    if (images / POSITIONS_FILE).is_file():
        return "csv"
    names = sorted(Path(name).name for name in files_below(images)[0])
    without = [name for name in names if not UTM_NAME.search(name)]
    if without and len(without) < len(names):
        raise ManifestError(
            f"{images}: {len(names) - len(without)} of {len(names)} names hold @utm_east@utm_north@, "
            f"{without[0]!r} does not; rename it, write {POSITIONS_FILE}, or say 'positions: order' in {DESCRIPTION}"
        )
    return "order" if without or not names else "names"


def files_below(folder: Path) -> tuple[list[str], list[str]]:
    """Return the names, relative to a folder, of the images below it and of the other files, in no order.

    Hidden files and the folders ``__MACOSX`` that some archives hold are passed over.
    """
    images: list[str] = []
    others: list[str] = []
    for name in names_below(folder):
        if "/__MACOSX" not in f"/{name}":
            (images if os.path.splitext(name)[1].lower() in IMAGE_SUFFIXES else others).append(name)
    return images, others


def names_below(folder: Path | str, before: str = "") -> list[str]:
    """Return the names of the files below a folder, each with ``before`` in front, in no order.

    What is hidden is passed over, and links to folders. Raises ``PermissionError`` if one may not be read.
    """
    found = []
    with contextlib.suppress(FileNotFoundError, NotADirectoryError), os.scandir(folder) as entries:
        for entry in entries:  # a Path for each of 50,000 images takes seconds, and so does asking the disk of each
            if entry.name.startswith("."):
                continue
            if entry.is_dir(follow_symlinks=False):
                found += names_below(entry.path, f"{before}{entry.name}/")
            elif entry.is_file():
                found.append(before + entry.name)
    return found


def header_of(line: str) -> tuple[str, list[str], dict[str, int], str | None]:
    """Read the first line of a positions file; columns are known by several names.

    Returns the separator, all columns, the place of each known one, and the one of :data:`KINDS` that they make, or ``None``.

    Examples
    --------
    >>> header_of("Name;North;East")
    (';', ['name', 'north', 'east'], {'image': 0, 'x': 2, 'y': 1}, 'metres')
    """
    separator = max(",;\t", key=line.count)
    columns = [column.strip().strip('"').lower() for column in line.split(separator)]
    at = {name: columns.index(alias) for name, known in _COLUMNS.items() for alias in known[::-1] if alias in columns}
    kind = next((kind for kind, needed in KINDS.items() if all(name in at for name in needed)), None)
    return separator, columns, at, kind


def has_index(path: Path) -> bool:
    """Say whether a positions file holds frame indices and no metres."""
    *_, kind = header_of((text_of(path).splitlines() or [""])[0])
    return kind == "index"


def text_of(path: Path) -> str:
    """Return the text of a file in UTF-8, UTF-16 or else Latin-1."""
    content = path.read_bytes()
    if content[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return content.decode("utf-16", errors="replace")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("latin-1")
