"""A folder of images as a dataset entry: described by its ``dataset.yaml``, or read off its layout."""

from __future__ import annotations

from pathlib import Path

from artifact.manifest.entries import DatasetEntry, ManifestError, Positions, Threshold, TraversalEntry
from artifact.manifest.faults import read

IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png", ".webp", ".bmp", ".tif", ".tiff")
POSITIONS_FILE = "positions.csv"
DESCRIPTION = "dataset.yaml"
_QUERY_FOLDERS = ("queries", "query")
_DATABASE_FOLDERS = ("database", "gallery")


def entry_of_folder(folder: Path) -> DatasetEntry:
    """Return the entry of a dataset that is a folder.

    The folder describes itself in ``dataset.yaml`` (the same keys as a manifest entry), or has the sub-folders
    ``queries`` and ``database`` (or ``gallery``): then positions come from ``positions.csv`` in each, else from
    ``@utm_east@utm_north@`` file names, else from the frame order, and the threshold is 25 m, or 1 frame.

    Raises
    ------
    ManifestError
        If the description has a fault, or the layout is another one.
    """
    folder = folder.resolve()
    if (folder / DESCRIPTION).is_file():
        entry = read(folder / DESCRIPTION, DatasetEntry)
        return entry if entry.root else entry.model_copy(update={"root": str(folder)})
    query, database = _one_of(folder, _QUERY_FOLDERS), _one_of(folder, _DATABASE_FOLDERS)
    sources = {part: positions_source(folder / part) for part in (query, database)}
    if len(set(sources.values())) != 1:
        raise ManifestError(
            f"{folder}: {query} and {database} have different kinds of positions: {', '.join(sorted(sources.values()))}"
        )
    source = sources[query]
    in_frames = source == "order" or (source == "csv" and has_index(folder / query / POSITIONS_FILE))
    return DatasetEntry(
        title=folder.name,
        kind="folder",
        root=str(folder),
        threshold=Threshold(value=1.0, unit="frames") if in_frames else Threshold(value=25.0, unit="metres"),
        query=query,
        database=database,
        shift=f"{query}→{database}",
        traversals={part: TraversalEntry(condition=part, positions=source) for part in (query, database)},
    )


def _one_of(folder: Path, candidates: tuple[str, ...]) -> str:
    found = [candidate for candidate in candidates if (folder / candidate).is_dir()]
    if len(found) != 1:
        raise ManifestError(
            f"{folder}: expected one folder named {' or '.join(candidates)}, found {len(found)}; "
            f"or describe the dataset in {folder / DESCRIPTION}"
        )
    return found[0]


def positions_source(images: Path) -> Positions:
    """Say where the positions of a folder of images come from if nobody says it."""
    if (images / POSITIONS_FILE).is_file():
        return "csv"
    names = sorted(path.name for path in images.rglob("[!.]*") if path.suffix.lower() in IMAGE_SUFFIXES)
    return "names" if names and names[0].startswith("@") else "order"


def has_index(path: Path) -> bool:
    """Say whether a positions file holds frame indices."""
    with path.open(encoding="utf-8-sig") as stream:
        return "index" in stream.readline().lower()
