"""A dataset at a glance: what to know of it before any result, and beside every result of an own one."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from artifact import datasets as data
from artifact import store
from artifact.datasets import Dataset, Traversal
from artifact.datasets.appearance import measure
from artifact.datasets.folder import contents
from artifact.datasets.images import evenly_spaced, modes_and_sizes, read_image
from artifact.datasets.positives import positives_of
from artifact.manifest import Manifest
from artifact.manifest.entries import DatasetEntry

_JUMP_M = 50_000  # metres between neighbours that no traversal makes
_SYSTEM = ("Thumbs.db", "desktop.ini")
_SAMPLE = 25  # images of a traversal that are opened
_NEAREST = 3  # database images that a query is compared with
_SAME_PICTURE = 1.5  # mean difference of 16 × 16 grey values of 255: a copy saved again, and no second photograph


@dataclass(frozen=True)
class Preview:
    """What is known of a dataset, with all of its traversals loaded, before any result."""

    dataset: Dataset
    traversals: pd.DataFrame
    facts: dict[str, Any]
    remarks: list[str]

    def lines(self) -> Iterator[str]:
        """Yield it all for a terminal: the table, the facts, and each remark as a warning."""
        yield self.traversals.to_string(index=False, na_rep="–", float_format=lambda value: f"{value:.2f}")
        yield in_words(self.facts)
        yield from (f"warning: {remark}" for remark in self.remarks)


def look_at(manifest: Manifest, name: str) -> Preview:
    """Load a dataset once and describe it."""
    entry = manifest.dataset(name)
    dataset = data.load(manifest, name, entry.traversals)
    places = dataset.query.positions, dataset.database.positions, dataset.threshold
    facts = {"threshold": str(entry.threshold), **counts(*places)}
    remarks = [*remarks_on(manifest, dataset), *_remarks_on_copies(dataset)]
    return Preview(dataset, traversals_table(dataset), facts, remarks)


def traversals_table(dataset: Dataset) -> pd.DataFrame:
    """Describe every loaded traversal of a dataset.

    Columns: ``traversal``, ``condition``, ``use`` (query, database or further), ``images``, ``spacing`` (median
    distance between neighbours, in metres or frames), and of at most 25 evenly spaced images ``size`` (the most common,
    width × height), ``other_sizes`` (how many differ), ``modes`` and ``brightness`` (mean, 0 to 1); these are missing
    where only descriptors are at hand.
    """
    uses = {dataset.database_name: "database", dataset.query_name: "query"}
    rows = []
    for name, traversal in dataset.traversals.items():
        steps = np.linalg.norm(np.diff(traversal.positions, axis=0), axis=1)
        row = {"traversal": name, "condition": traversal.condition, "use": uses.get(name, "further")}
        row |= {"images": len(traversal), "spacing": float(np.median(steps)) if len(steps) else np.nan}
        rows.append(row | _of_images(traversal))
    return pd.DataFrame(rows)


def _of_images(traversal: Traversal) -> dict[str, Any]:
    if not traversal.has_images:
        return {"size": None, "other_sizes": None, "modes": None, "brightness": np.nan}
    paths = traversal.image_paths()
    sample = [paths[i] for i in evenly_spaced(len(paths), _SAMPLE)]
    modes, sizes = modes_and_sizes(sample)
    (width, height), most = Counter(sizes).most_common(1)[0]
    return {
        "size": f"{width} × {height}",
        "other_sizes": len(sizes) - most,
        "modes": ", ".join(sorted(set(modes))),
        "brightness": float(np.mean([measure(path)[0] for path in sample])),
    }


def remarks_on(manifest: Manifest, dataset: Dataset) -> list[str]:
    """Say what of a dataset may make its numbers mean something else, one sentence each.

    Among them: query images that are database images too, images or positions that are all the same, frames that are
    paired by their order though their names differ, files that are no readable images, coordinates that jump.
    """
    entry, pair = manifest.dataset(dataset.name), (dataset.query, dataset.database)
    found = [text for traversal in pair for text in _remarks_on_files(entry, traversal)]
    if all(traversal.has_images for traversal in pair):
        digests = [store.digest_of_files(traversal.image_paths(), manifest.cache) for traversal in pair]
        if both := set(digests[0]) & set(digests[1]):
            found.append(f"{len(both)} images are both query and database: their places are found by themselves")
        for traversal, ours in zip(pair, digests, strict=True):
            if len(ours) > 1 and len(set(ours)) == 1:
                found.append(f"all images of {traversal.name} are the same")
        if dataset.unit == "frames" and not entry.by_name:
            found += _remarks_on_order(*pair)
    facts = counts(dataset.query.positions, dataset.database.positions, dataset.threshold)
    if facts["median"] == len(dataset.database) > 1:
        found.append(
            "every database image is a positive of most queries: is the threshold in the unit of the positions?"
        )
    for traversal in pair:
        if len(traversal) > 1 and (traversal.positions == traversal.positions[0]).all():
            found.append(f"all positions of {traversal.name} are the same: every image is a positive of every query")
    return found


def _remarks_on_files(entry: DatasetEntry, traversal: Traversal) -> list[str]:
    found = []
    if traversal.folder is not None and entry.kind == "folder":
        others = [file for file in contents(traversal.folder)[1] if Path(file).name not in _SYSTEM]
        if others:
            unread = any(file.lower().endswith((".heic", ".heif")) for file in others)
            heic = "; HEIC must be converted first" if unread else ""
            what = "file is no image" if len(others) == 1 else "files are no images"
            found.append(f"{traversal.name}: {len(others)} {what} that can be read here, first {others[0]!r}{heic}")
    if traversal.positions.shape[1] > 1 and len(traversal) > 2:
        steps = np.linalg.norm(np.diff(traversal.positions, axis=0), axis=1)
        if steps.max() > _JUMP_M:
            found.append(
                f"{traversal.name}: neighbouring images are up to {steps.max() / 1000:.0f} km apart; do the coordinates cross the "
                f"border of a zone?"
            )
    return found


def _remarks_on_copies(dataset: Dataset) -> list[str]:
    """Query images of a sample that are the same picture as one of their nearest database images, saved once more."""
    if not (dataset.query.has_images and dataset.database.has_images):
        return []
    queries, database = dataset.query.image_paths(), dataset.database.image_paths()
    sample, copies = evenly_spaced(len(queries), _SAMPLE), 0
    for i in sample:
        distances = np.linalg.norm(dataset.database.positions - dataset.query.positions[i], axis=1)
        near = np.argsort(distances, kind="stable")[:_NEAREST]
        ours = _small(queries[i])
        copies += any(np.abs(ours - _small(database[j])).mean() < _SAME_PICTURE for j in near)
    found = f"{copies} of {len(sample)} query images look like copies of a database image: their places are found by themselves"
    return [found] if copies else []


def _small(path: Path) -> np.ndarray:
    return np.asarray(read_image(path, "grey").resize((16, 16)), np.float64)


def _remarks_on_order(query: Traversal, database: Traversal) -> list[str]:
    """Differences of names between frames that their order pairs."""
    names = [[data.stem(image) for image in traversal.image_names] for traversal in (query, database)]
    found = []
    if len(query) != len(database):
        sizes = f"{query.name} has {len(query)} images and {database.name} {len(database)}"
        found.append(f"frames are paired by their order, but {sizes}")
    shared = set(names[0]) & set(names[1])
    differ = [pair for pair in zip(*names, strict=False) if _number(pair[0]) != _number(pair[1])]
    if differ:
        first = ", ".join(f"{a} with {b}" for a, b in differ[:5])
        way_out = "'by_name: true' pairs equal names" if shared else "rename the images if these are other places"
        found.append(f"frames are paired by their order though names differ: {first}; {way_out}")
    return found


def _number(stem: str) -> str:
    """The last number of a name, or all of a name without any: what tells frames of one traversal apart."""
    return (re.findall(r"\d+", stem) or [stem])[-1].lstrip("0")


def counts(query_positions: np.ndarray, database_positions: np.ndarray, threshold: float) -> dict[str, Any]:
    """Say what a pair offers to evaluate, given its positions ``(n, p)`` and the threshold in their unit.

    ``queries``, ``database``, ``evaluated`` (queries with a positive), ``excluded``, and of the evaluated ones
    ``fewest``, ``median`` and ``most`` positives; ``nearest``: the least distance from a query to the database.
    """
    number = np.diff(positives_of(query_positions, database_positions, threshold)[0])
    found = number[number > 0]
    fewest, median, most = np.percentile(found, [0, 50, 100]) if len(found) else (0, 0, 0)
    return {
        "queries": len(number),
        "database": len(database_positions),
        "evaluated": len(found),
        "excluded": len(number) - len(found),
        "fewest": int(fewest),
        "median": float(median),
        "most": int(most),
        "nearest": data.positives.nearest_distance(query_positions, database_positions),
    }


def in_words(facts: dict[str, Any]) -> str:
    """Return :func:`counts`, and the ``threshold`` in words, as one sentence.

    Examples
    --------
    >>> in_words({"threshold": "25 m", **counts(np.arange(4.0)[:, None] * 20, np.arange(3.0)[:, None] * 20, 25.0)})
    '4 queries (all evaluated), 3 database images; positives within 25 m: 1 to 3 for a query, median 2'
    """
    some = f"{facts['evaluated']} evaluated, {facts['excluded']} without a positive"
    evaluated = some if facts["excluded"] else "all evaluated"
    exact = facts["threshold"] == "exact match"
    how = "by exact match" if exact else f"within {facts['threshold']}"
    start = f"{facts['queries']} queries ({evaluated}), {facts['database']} database images; positives {how}"
    if not facts["evaluated"]:
        return f"{start}: none, the nearest database image is at {facts['nearest']:g}"
    if facts["fewest"] == facts["most"]:
        return f"{start}: {facts['most']} for every query"
    return f"{start}: {facts['fewest']} to {facts['most']} for a query, median {facts['median']:g}"
