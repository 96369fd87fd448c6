"""Raw files to :class:`Traversal`: images, positions, condition.

:func:`load` is the one way in. A dataset is named by its manifest entry, or is a path to a folder of images.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from artifact import store
from artifact.datasets import folder, shipped
from artifact.datasets.positives import positives_of
from artifact.datasets.rendered import is_rendered, rendered
from artifact.datasets.traversal import Dataset, DatasetError, Given, Traversal
from artifact.manifest import Manifest
from artifact.manifest.entries import DatasetEntry, ManifestError
from artifact.manifest.layout import POSITIONS_FILE, positions_source

__all__ = ["Dataset", "DatasetError", "Traversal", "load", "load_traversal"]


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
        differences=tuple(_differences(entry, loaded[entry.query], loaded[entry.database])),
    )


def load_traversal(manifest: Manifest, dataset: str, name: str) -> Traversal:
    """Load one traversal of a dataset; see :func:`load`."""
    entry = manifest.dataset(dataset)
    if name not in entry.traversals:
        raise ManifestError(f"{dataset}: no traversal {name!r}; the traversals are {', '.join(entry.traversals)}")
    if entry.traversals[name].descriptors:
        return _load_described(manifest, dataset, entry, name)
    load_images = _load_rendered if entry.kind == "city" else _load_folder
    return load_images(manifest, dataset, entry, name)


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
        {method: root / path for method, path in files.items()}
        for files in (traversal.descriptors, traversal.second_stage)
    ]
    missing = [path for files in given for path in files.values() if not path.is_file()]
    if missing:
        raise DatasetError(f"{dataset}/{name}: no file {missing[0]}, which the manifest names")
    with_digests = [
        {
            method: Given(path, digest)
            for (method, path), digest in zip(
                files.items(), store.digest_of_files(list(files.values()), manifest.cache), strict=True
            )
        }
        for files in given
    ]
    digest = store.key(names=names, given=[{m: g.sha256 for m, g in files.items()} for files in with_digests])
    return Traversal(dataset, name, traversal.condition, tuple(names), positions, digest, None, *with_digests)


def _load_folder(manifest: Manifest, dataset: str, entry: DatasetEntry, name: str) -> Traversal:
    traversal = entry.traversals[name]
    root = manifest.data_root / (entry.root or dataset)
    images = root / (traversal.images or name)
    if not images.is_dir():
        found = _load_shipped(dataset, entry, name)
        if found is None:
            raise DatasetError(_missing(dataset, entry, images, manifest))
        return found
    listed = root / traversal.image_list if traversal.image_list else None
    names = folder.list_images(images, listed)
    source = traversal.positions or positions_source(images)
    unit = entry.threshold.unit
    if source == "names":
        positions, found = folder.positions_from_names(images, names), "metres"
    elif source == "csv":
        file = root / traversal.positions_file if traversal.positions_file else images / POSITIONS_FILE
        positions, found = folder.positions_from_csv(file, names)
    else:
        positions, found = np.arange(len(names), dtype=np.float64)[:, None], unit
    if (found == "metres") != (unit == "metres"):
        raise DatasetError(f"{dataset}/{name}: the threshold is in {unit} but the positions are in {found}")
    if traversal.spacing is not None:
        kept = folder.keep_spacing(positions, traversal.spacing)
        names, positions = [names[index] for index in kept], positions[kept]
    return _traversal(manifest, dataset, name, traversal.condition, images, names, positions)


def _load_shipped(dataset: str, entry: DatasetEntry, name: str) -> Traversal | None:
    """Return a traversal of which descriptors ship with the package, without its images."""
    folder_name = entry.root or dataset
    stored = None if Path(folder_name).is_absolute() else shipped.traversal(folder_name, name)
    if stored is None:
        return None
    names, digest = stored
    positions = np.arange(len(names), dtype=np.float64)[:, None]
    return Traversal(dataset, name, entry.traversals[name].condition, tuple(names), positions, digest)


def _load_rendered(manifest: Manifest, dataset: str, entry: DatasetEntry, name: str) -> Traversal:
    traversal = entry.traversals[name]
    images = rendered(traversal.render or {}, manifest.cache, f"{dataset}/{name}")
    names = folder.list_images(images)
    positions, found = folder.positions_from_csv(images / POSITIONS_FILE, names)
    if (found == "metres") != (entry.threshold.unit == "metres"):
        raise DatasetError(
            f"{dataset}/{name}: the threshold is in {entry.threshold.unit} but the positions are in {found}"
        )
    return _traversal(manifest, dataset, name, traversal.condition, images, names, positions)


def _traversal(
    manifest: Manifest,
    dataset: str,
    name: str,
    condition: str,
    images: Path,
    names: list[str],
    positions: np.ndarray,
) -> Traversal:
    cache = manifest.cache
    digests = store.digest_of_files([images / image for image in names], cache)
    digest = store.key(images=list(zip(names, digests, strict=True)))
    return Traversal(dataset, name, condition, tuple(names), positions, digest, images)


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
    if query.positions.shape[1] != database.positions.shape[1]:
        raise DatasetError(
            f"{name}: query positions have {query.positions.shape[1]} columns, database positions {database.positions.shape[1]}"
        )
    if entry.threshold.unit == "pairs":
        stems = [[Path(image).stem for image in traversal.image_names] for traversal in (query, database)]
        if stems[0] != stems[1]:
            odd = sorted(set(stems[0]) ^ set(stems[1]))
            what = f"{len(odd)} names have no partner, first {odd[0]!r}" if odd else "the order differs"
            raise DatasetError(f"{name}: images are matched in pairs by file name, but {what}")


def _differences(entry: DatasetEntry, query: Traversal, database: Traversal) -> Iterator[str]:
    """Compare numbers of images with those that the paper lists."""
    if entry.paper is None:
        return
    starts, _ = positives_of(query.positions, database.positions, entry.threshold.value)
    counts = {
        "query images": (len(query), entry.paper.queries),
        "database images": (len(database), entry.paper.database),
        "evaluated queries": (int((np.diff(starts) > 0).sum()), entry.paper.evaluated),
    }
    for what, (found, listed) in counts.items():
        if listed is not None and found != listed:
            yield f"{entry.title}: {found:,} {what}, the paper lists {listed:,}"


def describe_missing(manifest: Manifest, name: str) -> str | None:
    """Return why a dataset is not ready here, or ``None`` if it is. Renders nothing."""
    entry = manifest.dataset(name)
    try:
        if entry.kind == "city":
            cache = manifest.cache
            for traversal, described in entry.traversals.items():
                if not is_rendered(described.render or {}, cache, f"{name}/{traversal}"):
                    return f"{name}: not rendered yet (make data)"
        load(manifest, name)
    except (DatasetError, ManifestError) as error:
        return str(error)
    return None
