"""Raw files to :class:`Traversal`: images, positions, condition.

:func:`load` is the one way in. A dataset is named by its manifest entry, or is a path to a folder of images.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from artifact import store
from artifact.datasets import folder, shipped
from artifact.datasets.rendered import render, rendered_folder
from artifact.datasets.traversal import Dataset, DatasetError, Given, Traversal
from artifact.manifest import Manifest
from artifact.manifest.entries import DatasetEntry, ManifestError
from artifact.manifest.layout import POSITIONS_FILE, positions_source

__all__ = ["Dataset", "DatasetError", "Traversal", "image_folder", "listed", "load", "load_traversal"]


def load(manifest: Manifest, name: str, traversals: Iterable[str] | None = None) -> Dataset:
    """Load a dataset: query, database and any further traversals.

    Parameters
    ----------
    manifest
        The manifest.
    name
        A dataset of the manifest, or the path of a folder (see :meth:`artifact.manifest.Manifest.dataset`).
    traversals
        Names of further traversals to load; default none.

    Raises
    ------
    DatasetError
        If files are missing or do not fit together; the message says how to obtain the dataset.
    """
    entry = manifest.dataset(name)
    wanted = dict.fromkeys([entry.query, entry.database, *(traversals or [])])
    loaded = {traversal: load_traversal(manifest, name, traversal) for traversal in wanted}
    _check_pair(name, entry, loaded[entry.query], loaded[entry.database])
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
    """Load one traversal of a dataset, rendering it if need be; see :func:`load`."""
    entry = manifest.dataset(dataset)
    if name not in entry.traversals:
        raise ManifestError(f"{dataset}: no traversal {name!r}; the traversals are {', '.join(entry.traversals)}")
    if entry.traversals[name].descriptors:
        return _load_described(manifest, dataset, entry, name)
    condition = entry.traversals[name].condition
    if entry.kind == "city":
        render(entry.traversals[name].render or {}, manifest.cache, f"{dataset}/{name}")
    images = image_folder(manifest, dataset, name)
    if images.is_dir():
        names, positions = listed(manifest, dataset, name)
        digests = store.digest_of_files([images / image for image in names], manifest.cache)
        digest = store.key(images=list(zip(names, digests, strict=True)))
        return Traversal(dataset, name, condition, tuple(names), positions, digest, images)
    without_images = shipped.traversal(entry.root or dataset, name)
    if without_images is None:
        raise DatasetError(_missing(dataset, entry, images, manifest))
    names, digest = without_images
    positions = np.arange(len(names), dtype=np.float64)[:, None]
    return Traversal(dataset, name, condition, tuple(names), positions, digest)


def _load_described(manifest: Manifest, dataset: str, entry: DatasetEntry, name: str) -> Traversal:
    """Load a traversal that is given by its descriptors."""
    traversal, root = entry.traversals[name], manifest.data_root / (entry.root or dataset)
    file = root / (traversal.positions_file or f"{name}.csv")
    names = folder.names_in_csv(file)
    positions, found = folder.positions_from_csv(file, names)
    if (found == "metres") != (entry.threshold.unit == "metres"):
        raise DatasetError(
            f"{dataset}/{name}: the threshold is in {entry.threshold.unit} but the positions in {file} are in {found}"
        )
    given = [
        _with_digests(f"{dataset}/{name}", {method: root / path for method, path in files.items()}, manifest.cache)
        for files in (traversal.descriptors, traversal.second_stage)
    ]
    digest = store.key(names=names, given=[{method: one.sha256 for method, one in files.items()} for files in given])
    return Traversal(dataset, name, traversal.condition, tuple(names), positions, digest, None, *given)


def _with_digests(label: str, files: Mapping[str, Path], cache: Path) -> dict[str, Given]:
    missing = [path for path in files.values() if not path.is_file()]
    if missing:
        raise DatasetError(f"{label}: no file {missing[0]}, which the manifest names")
    digests = store.digest_of_files(list(files.values()), cache)
    return {method: Given(*pair) for method, pair in zip(files, zip(files.values(), digests, strict=True), strict=True)}


def image_folder(manifest: Manifest, dataset: str, name: str) -> Path:
    """Return the folder that holds, or would hold, the images of a traversal."""
    entry = manifest.dataset(dataset)
    traversal = entry.traversals[name]
    if entry.kind == "city":
        return rendered_folder(traversal.render or {}, manifest.cache, f"{dataset}/{name}")
    return _below(manifest.data_root / (entry.root or dataset), traversal.images or name)


def listed(manifest: Manifest, dataset: str, name: str) -> tuple[list[str], np.ndarray]:
    """Return the image names and positions of a traversal whose folder is there, reading no image."""
    entry, images = manifest.dataset(dataset), image_folder(manifest, dataset, name)
    traversal, root = entry.traversals[name], manifest.data_root / (entry.root or dataset)
    names = folder.list_images(images, _below(root, traversal.image_list) if traversal.image_list else None)
    source, unit = traversal.positions or positions_source(images), entry.threshold.unit
    if source == "names":
        positions, found = folder.positions_from_names(images, names), "metres"
    elif source == "csv":
        file = _below(root, traversal.positions_file) if traversal.positions_file else images / POSITIONS_FILE
        positions, found = folder.positions_from_csv(file, names, images.name)
    else:
        positions, found = _frame_indices(manifest, dataset, names)[:, None], "frames"
    if (found == "metres") != (unit == "metres"):
        where = "are the frame order" if source == "order" else f"are in {found}"
        raise DatasetError(f"{dataset}/{name}: the threshold is in {unit} but the positions {where}")
    if traversal.spacing is not None:
        kept = folder.keep_spacing(positions, traversal.spacing)
        names, positions = [names[index] for index in kept], positions[kept]
    return names, positions


def _below(root: Path, path: str) -> Path:
    """A path of a description, which may be absolute or begin with ``~``; ``..`` leads out of folders that are not there."""
    return Path(os.path.normpath(root / Path(path).expanduser()))


def _frame_indices(manifest: Manifest, dataset: str, names: list[str]) -> np.ndarray:
    """Index of each frame: its place in its traversal, or with ``by_name`` that of its name among those of all traversals."""
    entry = manifest.dataset(dataset)
    if not entry.by_name:
        return np.arange(len(names), dtype=np.float64)
    root = manifest.data_root / (entry.root or dataset)
    every: set[str] = set()
    for name, traversal in entry.traversals.items():
        chosen = _below(root, traversal.image_list) if traversal.image_list else None
        every |= {stem(image) for image in folder.list_images(image_folder(manifest, dataset, name), chosen)}
    index = {one: place for place, one in enumerate(sorted(every, key=folder.natural_order))}
    return np.array([index[stem(name)] for name in names], dtype=np.float64)


def stem(name: str) -> str:
    """Return an image's name without its ending, by which frames of two traversals are paired."""
    return str(Path(name).with_suffix(""))


def _missing(dataset: str, entry: DatasetEntry, images: Path, manifest: Manifest) -> str:
    lines = [
        f"{dataset}: no folder {images}",
        f"  the data root is {manifest.data_root} (set ARTIFACT_DATA_ROOT to change it)",
    ]
    lines += [f"  from {source.url} {source.note}".rstrip() for source in entry.sources]
    if entry.obtain:
        lines.append(f"  {entry.obtain.strip()}")
    return os.linesep.join(lines)


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
