"""A dataset at a glance: what to know of it before any result, and beside every result of an own one."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from artifact import datasets as data
from artifact import store
from artifact.datasets import Traversal
from artifact.datasets.appearance import measure
from artifact.datasets.folder import contents
from artifact.datasets.images import modes_and_sizes
from artifact.datasets.positives import positives_of
from artifact.manifest import Manifest

_JUMP_M = 50_000  # metres between neighbours that no traversal makes
_SYSTEM = ("Thumbs.db", "desktop.ini")
_SAMPLE = 25  # images of a traversal that are opened


def traversals_table(manifest: Manifest, name: str) -> pd.DataFrame:
    """Describe every traversal of a dataset.

    Returns
    -------
    pandas.DataFrame
        One row per traversal: ``traversal``, ``condition``, ``use`` (query, database or further), ``images``, ``spacing``
        (median distance between neighbours, in metres or frames), and of at most 25 evenly spaced images ``size`` (the most
        common, width × height), ``other_sizes`` (how many differ), ``modes`` and ``brightness`` (mean, 0 to 1); these are
        missing where only descriptors are at hand.
    """
    entry = manifest.dataset(name)
    dataset = data.load(manifest, name, entry.traversals)
    uses = {entry.database: "database", entry.query: "query"}
    rows = []
    for traversal in dataset.traversals.values():
        steps = np.linalg.norm(np.diff(traversal.positions, axis=0), axis=1)
        rows.append(
            {
                "traversal": traversal.name,
                "condition": traversal.condition,
                "use": uses.get(traversal.name, "further"),
                "images": len(traversal),
                "spacing": float(np.median(steps)) if len(steps) else np.nan,
                **_of_images(traversal),
            }
        )
    return pd.DataFrame(rows)


def _of_images(traversal: Traversal) -> dict[str, Any]:
    if not traversal.has_images:
        return {"size": None, "other_sizes": None, "modes": None, "brightness": np.nan}
    paths = traversal.image_paths()
    sample = [paths[i] for i in np.unique(np.linspace(0, len(paths) - 1, min(_SAMPLE, len(paths))).astype(int))]
    modes, sizes = modes_and_sizes(sample)
    (width, height), most = Counter(sizes).most_common(1)[0]
    return {
        "size": f"{width} × {height}",
        "other_sizes": len(sizes) - most,
        "modes": ", ".join(sorted(set(modes))),
        "brightness": float(np.mean([measure(path)[0] for path in sample])),
    }


def pair_facts(manifest: Manifest, name: str) -> dict[str, Any]:
    """Say what the query–database pair of a dataset offers to evaluate.

    Returns
    -------
    dict
        ``threshold``, ``queries``, ``database``, ``evaluated`` (queries with a positive), ``excluded``, and of the evaluated
        ones ``fewest``, ``median`` and ``most`` positives; ``nearest``: the least distance from a query to the database.
    """
    dataset = data.load(manifest, name)
    query, database = dataset.query.positions, dataset.database.positions
    return {"threshold": str(manifest.dataset(name).threshold), **counts(query, database, dataset.threshold)}


def remarks(manifest: Manifest, name: str) -> list[str]:
    """Say what of a dataset may make its numbers mean something else, one sentence each.

    Among them: query images that are database images too, images or positions that are all the same, frames that are paired
    by their order though their names differ, files that are no readable images, coordinates that jump.
    """
    entry, dataset = manifest.dataset(name), data.load(manifest, name)
    pair = (dataset.query, dataset.database)
    found = [text for traversal in pair for text in _remarks_on(manifest, traversal)]
    if all(traversal.has_images for traversal in pair):
        digests = [store.digest_of_files(traversal.image_paths(), manifest.cache) for traversal in pair]
        both = set(digests[0]) & set(digests[1])
        if both:
            found.append(f"{len(both)} images are both query and database: their places are found by themselves")
        for traversal, ours in zip(pair, digests, strict=True):
            if len(ours) > 1 and len(set(ours)) == 1:
                found.append(f"all images of {traversal.name} are the same")
    if dataset.unit == "frames" and not entry.by_name and all(t.has_images for t in pair):
        found += _remarks_on_order(*pair)
    for traversal in pair:
        if len(traversal) > 1 and (traversal.positions == traversal.positions[0]).all():
            found.append(f"all positions of {traversal.name} are the same: every image is a positive of every query")
    return found


def _remarks_on(manifest: Manifest, traversal: Traversal) -> list[str]:
    found = []
    if traversal.folder is not None and manifest.dataset(traversal.dataset).kind == "folder":
        others = [file for file in contents(traversal.folder)[1] if Path(file).name not in _SYSTEM]
        if others:
            heic = (
                "; HEIC must be converted first"
                if any(file.lower().endswith((".heic", ".heif")) for file in others)
                else ""
            )
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


def _remarks_on_order(query: Traversal, database: Traversal) -> list[str]:
    """Differences of names between frames that their order pairs."""
    names = [[data.stem(image) for image in traversal.image_names] for traversal in (query, database)]
    found = []
    if len(names[0]) != len(names[1]):
        found.append(
            f"frames are paired by their order, but {query.name} has {len(names[0])} images and {database.name} {len(names[1])}"
        )
    shared = set(names[0]) & set(names[1])
    differ = [pair for pair in zip(*names, strict=False) if pair[0] != pair[1]]
    if differ and len(shared) > len(names[0]) / 2:
        first = ", ".join(f"{a} with {b}" for a, b in differ[:5])
        found.append(
            f"frames are paired by their order though names differ: {first}; 'by_name: true' pairs equal names"
        )
    return found


def counts(query_positions: np.ndarray, database_positions: np.ndarray, threshold: float) -> dict[str, Any]:
    """Count queries, evaluated queries and positives; see :func:`pair_facts`."""
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
    """Return the facts of a pair as one sentence.

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
