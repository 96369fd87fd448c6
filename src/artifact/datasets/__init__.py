"""Raw files to :class:`Traversal`: images, positions, condition.

:func:`load` is the one way in. A dataset is named by its manifest entry, or is a path to a folder of images.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from artifact import store
from artifact.datasets import folder, imported, lookalikes, prepared, shipped
from artifact.datasets.positions import keep_spacing, names_in_csv, positions_from_csv, positions_from_names, zone_of
from artifact.datasets.rendered import render, rendered_folder
from artifact.datasets.traversal import Dataset, DatasetError, Given, Traversal
from artifact.manifest import Manifest
from artifact.manifest.entries import DatasetEntry, ManifestError, Positions, TraversalEntry
from artifact.manifest.layout import POSITIONS_FILE, positions_source

__all__ = ["Dataset", "DatasetError", "Traversal", "image_folder", "listed", "load", "load_traversal"]


def load(manifest: Manifest, name: str, traversals: Iterable[str] = ()) -> Dataset:
    """Load a dataset: query, database and any further traversals.

    Parameters
    ----------
    name
        A dataset of the manifest, or the path of a folder (see :meth:`artifact.manifest.Manifest.dataset`).
    traversals
        Names of further traversals to load.

    Raises
    ------
    DatasetError
        If files are missing or do not fit together; the message says how to obtain the dataset.
    """
    entry = manifest.dataset(name)
    wanted = dict.fromkeys([entry.query, entry.database, *traversals])
    loaded = {traversal: load_traversal(manifest, name, traversal) for traversal in wanted}
    _check_pair(name, entry, loaded[entry.query], loaded[entry.database])
    root = manifest.data_root / (entry.root or name)
    located = [t for t in loaded.values() if t.folder and _source(entry.traversals[t.name], t.folder, root) == "names"]
    zone_of(name, [image for traversal in located for image in traversal.image_names])
    return Dataset(
        name=name,
        title=entry.title,
        shift=entry.shift,
        threshold=entry.threshold.value,
        unit=entry.threshold.unit,
        traversals=loaded,
        query_name=entry.query,
        database_name=entry.database,
        real=entry.kind == "folder",
        paper=entry.paper,
    )


def load_traversal(manifest: Manifest, dataset: str, name: str) -> Traversal:
    """Load one traversal of a dataset, rendering it if need be; see :func:`load`.

    Where neither images nor descriptors are at hand, an imported results bundle may have its record; where the images are,
    that of its descriptors.
    """
    entry = manifest.dataset(dataset)
    if name not in entry.traversals:
        raise ManifestError(f"{dataset}: no traversal {name!r}; the traversals are {', '.join(entry.traversals)}")
    traversal, recorded = entry.traversals[name], imported.traversal(manifest, dataset, name)
    if traversal.descriptors:
        table = manifest.data_root / (entry.root or dataset) / (traversal.positions_file or f"{name}.csv")
        if recorded is not None and not table.exists():
            return recorded
        return _load_described(manifest, dataset, entry, name, table)
    rendered: dict[str, str] = {}
    if entry.kind == "city" and recorded is None:
        rendered = render(traversal.render or {}, manifest.cache, f"{dataset}/{name}")
    images = _images(manifest, dataset, entry, name)
    if not images.is_dir():
        if recorded is not None:
            return recorded
        found = shipped.traversal(entry.root or dataset, name)
        if found is None:
            raise DatasetError(_missing(manifest, dataset, entry, images))
        names, digest = found
        positions = np.arange(len(names), dtype=np.float64)[:, None]
        return Traversal(dataset, name, traversal.condition, tuple(names), positions, digest)
    names, positions = listed(manifest, dataset, name)
    digests = [rendered[n] for n in names] if rendered else prepared.digests_of_images(images, names, manifest.cache)
    digest = store.key(images=list(zip(names, digests, strict=True)))
    preparation = prepared.unchanged(images, digest) if prepared.is_prepared(images) else {}
    of_images = {"folder": images, "image_digests": tuple(digests), "preparation": preparation}
    if recorded is not None and recorded.digest == digest and np.array_equal(recorded.positions, positions):
        return replace(recorded, **of_images)
    return Traversal(dataset, name, traversal.condition, tuple(names), positions, digest, **of_images)


def _load_described(manifest: Manifest, dataset: str, entry: DatasetEntry, name: str, table: Path) -> Traversal:
    """Load a traversal that is given by its descriptors and a table of positions."""
    traversal, root, label = entry.traversals[name], manifest.data_root / (entry.root or dataset), f"{dataset}/{name}"
    names = names_in_csv(table)
    positions, found = positions_from_csv(table, names)
    _check_unit(label, entry, found, f"in {table} are in {found}")
    given: list[dict[str, Given]] = []
    for files in (traversal.descriptors, traversal.second_stage):
        paths = [root / path for path in files.values()]
        if missing := [path for path in paths if not path.is_file()]:
            raise DatasetError(f"{label}: no file {missing[0]}, which the manifest names")
        digests = store.digest_of_files(paths, manifest.cache)
        given.append(dict(zip(files, map(Given, paths, digests), strict=True)))
    digest = store.key(names=names, given=[{method: one.sha256 for method, one in files.items()} for files in given])
    return Traversal(dataset, name, traversal.condition, tuple(names), positions, digest, None, *given)


def image_folder(manifest: Manifest, dataset: str, name: str) -> Path:
    """Return the folder that holds, or would hold, the images of a traversal."""
    return _images(manifest, dataset, manifest.dataset(dataset), name)


def _images(manifest: Manifest, dataset: str, entry: DatasetEntry, name: str) -> Path:
    traversal = entry.traversals[name]
    if entry.kind == "city":
        return rendered_folder(traversal.render or {}, manifest.cache, f"{dataset}/{name}")
    return _below(manifest.data_root / (entry.root or dataset), traversal.images or name)


def listed(manifest: Manifest, dataset: str, name: str) -> tuple[list[str], np.ndarray]:
    """Return the image names and positions of a traversal whose folder is there, reading no image."""
    entry = manifest.dataset(dataset)
    traversal, root = entry.traversals[name], manifest.data_root / (entry.root or dataset)
    images = _images(manifest, dataset, entry, name)
    if is_prepared := prepared.is_prepared(images):
        source = "csv"
        names, positions, found = prepared.listed(images)
    else:
        if entry.preparation is not None:  # filled by hand, which may be right or not
            lookalikes.refuse(entry.preparation.recipe, images, folder.list_images(images))
            if not entry.preparation.used_as_unpacked:
                raise DatasetError(
                    f"{images}: holds images that were not prepared from the published files: which to use, and where they are, is "
                    f"not known; move the folder away and run `make data DATASET={dataset}`"
                )
        names, source = _image_names(manifest, dataset, entry, name), _source(traversal, images, root)
        if source == "names":
            positions, found = positions_from_names(images, names), "metres"
        elif source == "csv":
            positions, found = positions_from_csv(_positions_file(traversal, images, root), names, images.name)
        else:
            positions, found = _frame_indices(manifest, dataset, entry, names)[:, None], "frames"
    _check_unit(f"{dataset}/{name}", entry, found, "are the frame order" if source == "order" else f"are in {found}")
    if traversal.spacing is not None and not is_prepared:
        kept = keep_spacing(positions, traversal.spacing)
        names, positions = [names[index] for index in kept], positions[kept]
    return names, positions


def _check_unit(label: str, entry: DatasetEntry, found: str, where: str) -> None:
    unit = entry.threshold.unit
    if (found == "metres") != (unit == "metres"):
        raise DatasetError(f"{label}: the threshold is in {unit} but the positions {where}")


def _image_names(manifest: Manifest, dataset: str, entry: DatasetEntry, name: str) -> list[str]:
    chosen = entry.traversals[name].image_list
    image_list = _below(manifest.data_root / (entry.root or dataset), chosen) if chosen else None
    return folder.list_images(_images(manifest, dataset, entry, name), image_list)


def _source(traversal: TraversalEntry, images: Path, root: Path) -> Positions:
    """Where positions come from: as the entry says, else what is in the folder, else one file beside all folders."""
    if prepared.is_prepared(images):
        return "csv"
    if traversal.positions:
        return traversal.positions
    found = "csv" if traversal.positions_file else positions_source(images)
    return "csv" if found == "order" and (root / POSITIONS_FILE).is_file() else found


def _positions_file(traversal: TraversalEntry, images: Path, root: Path) -> Path:
    if traversal.positions_file:
        return _below(root, traversal.positions_file)
    inside = images / POSITIONS_FILE
    return inside if inside.is_file() or not (root / POSITIONS_FILE).is_file() else root / POSITIONS_FILE


def _below(root: Path, path: str) -> Path:
    """A path that may be absolute or begin with ``~``; ``..`` leads out of folders that are not there."""
    return Path(os.path.normpath(root / Path(path).expanduser()))


def _frame_indices(manifest: Manifest, dataset: str, entry: DatasetEntry, names: list[str]) -> np.ndarray:
    """Index of each frame: its place in its traversal, or with ``by_name`` that of its name among all traversals'."""
    if not entry.by_name:
        return np.arange(len(names), dtype=np.float64)
    every = {stem(image) for name in entry.traversals for image in _image_names(manifest, dataset, entry, name)}
    index = {one: place for place, one in enumerate(sorted(every, key=folder.natural_order))}
    return np.array([index[stem(name)] for name in names], dtype=np.float64)


def stem(name: str) -> str:
    """Return an image's name without its ending, by which frames of two traversals are paired."""
    return str(Path(name).with_suffix(""))


def _missing(manifest: Manifest, dataset: str, entry: DatasetEntry, images: Path) -> str:
    root = f"  the data root is {manifest.data_root} (set ARTIFACT_DATA_ROOT to change it)"
    origins = [f"  from {source.url} {source.note}".rstrip() for source in entry.sources]
    obtain = [f"  {entry.obtain.strip()}"] if entry.obtain else []
    if entry.preparation:
        obtain = [f"  make data DATASET={dataset} obtains and prepares it, or says which files to put where"]
    return os.linesep.join([f"{dataset}: no folder {images}", root, *origins, *obtain])


def _check_pair(name: str, entry: DatasetEntry, query: Traversal, database: Traversal) -> None:
    widths = [traversal.positions.shape[1] for traversal in (query, database)]
    if widths[0] != widths[1]:
        raise DatasetError(f"{name}: query positions have {widths[0]} columns, database positions {widths[1]}")
    if entry.threshold.unit == "pairs":
        stems = [[Path(image).stem for image in traversal.image_names] for traversal in (query, database)]
        if stems[0] != stems[1]:
            odd = sorted(set(stems[0]) ^ set(stems[1]))
            what = f"{len(odd)} names have no partner, first {odd[0]!r}" if odd else "the order differs"
            raise DatasetError(f"{name}: images are matched in pairs by file name, but {what}")


def describe_missing(manifest: Manifest, name: str) -> str | None:
    """Return why a dataset is not ready here, or ``None`` if it is. Renders nothing."""
    entry = manifest.dataset(name)
    try:
        if entry.kind == "city" and not all(image_folder(manifest, name, part).is_dir() for part in entry.traversals):
            return f"{name}: not rendered yet (make data)"
        load(manifest, name)
    except (DatasetError, ManifestError) as error:
        return str(error)
    return None
