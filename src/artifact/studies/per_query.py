"""Every query by itself: where its place ranks, and what stands before it."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import product

import numpy as np
import pandas as pd

from artifact.datasets import Dataset
from artifact.manifest import Manifest
from artifact.metrics.result import Result
from artifact.studies import evaluated, fitted
from artifact.studies.common import Study, single_stage
from artifact.studies.evaluated import Measured

COLUMNS = {
    "dataset": "name in the manifest",
    "method": "name in the manifest",
    "view": "original, or the suppression method",
    "query": "file of the query image",
    "rank": "rank of its best positive in the database, 1 on top",
    "rank_with_distractors": "the same with the query's distractors added",
    "best_positive": "file of the most similar database image within the threshold",
    "similarity": "of the two (cosine)",
    "distance": "between the two, in the unit of the threshold",
    "outranking": "images that are more similar than the best positive, distractors included",
    "outranking_distractors": "distractors among them",
}
"""Columns of :func:`per_query`, and what they hold; methods of two stages have no best positive, similarity and distance."""


def per_query(manifest: Manifest, names: Iterable[str], methods: Iterable[str], *, seed: int = 0) -> Study:
    """Return a row per dataset, method and evaluated query, with :data:`COLUMNS`: the evaluations of Table III."""
    frames, inputs = [], []
    for name, method in product(names, methods):
        measured = evaluated.evaluation(manifest, name, method, seed=seed)
        data = measured.dataset
        everything = np.arange(len(data.query)), np.arange(len(data.database))
        frames.append(_rows(measured.evaluation, data, method, "original", *everything))
        inputs += measured.inputs
    return Study(pd.concat(frames, ignore_index=True), tuple(inputs))


def per_query_suppressed(
    manifest: Manifest, names: Iterable[str], methods: Iterable[str], **fitting: int | float
) -> Study:
    """Return the same of the evaluation region for the original and each suppression method: the evaluations of Fig. 8."""
    frames, inputs = [], []
    for name, method in product(names, single_stage(manifest, methods)):
        found = fitted.compare(manifest, name, method, **fitting)
        region = found.split.evaluation_queries, found.split.evaluation_database
        frames += [_rows(one, found.described.dataset, method, v, *region) for v, one in found.evaluations.items()]
        inputs += found.described.inputs
    return Study(pd.concat(frames, ignore_index=True), tuple(inputs))


def _rows(
    result: Result, data: Dataset, method: str, view: str, queries: np.ndarray, database: np.ndarray
) -> pd.DataFrame:
    """One evaluation; ``queries`` and ``database`` are the images of each traversal that took part."""
    found = (
        result.per_query().round({"similarity": 5, "distance": 2}).assign(dataset=data.name, method=method, view=view)
    )
    found["query"] = np.array(data.query.image_names)[queries[found["query"]]]
    if "best_positive" in found:
        found["best_positive"] = np.array(data.database.image_names)[database[found["best_positive"]]]
    found["outranking"] = found["rank_with_distractors"] - 1
    found["outranking_distractors"] = found["rank_with_distractors"] - found["rank"]
    return found.reindex(columns=list(COLUMNS))


def taken(manifest: Manifest, name: str, method: str, most: int, *, seed: int = 0) -> tuple[Measured, pd.DataFrame]:
    """Return queries that distractors take, at most so many and evenly spread over all, as indices into the traversals.

    Columns: ``query``, ``positive`` (the best positive, in the database), ``distractor`` (what is retrieved instead, in the query
    traversal), ``away`` (its distance from the query), ``rank_with_distractors``, and ``of`` (how many queries are taken in all).
    """
    measured = evaluated.evaluation(manifest, name, method, retrieve=1, seed=seed)
    result = measured.evaluation
    lost = np.flatnonzero(result.hits(1, distractors=False) & ~result.hits(1, distractors=True))
    alone, augmented = (result.retrieved(1, distractors=added)[0][:, 0] for added in (False, True))
    shown = lost[np.linspace(0, len(lost) - 1, min(most, len(lost))).round().astype(int)]
    distractors = augmented[shown] - result.n_database
    away = result.query_positions[shown] - result.pool_positions[result.pool_name][distractors]
    table = pd.DataFrame(
        {
            "query": result.evaluated[shown],
            "positive": alone[shown],
            "distractor": result.evaluated[distractors],
            "away": np.linalg.norm(away, axis=1),
            "rank_with_distractors": result.ranks(distractors=True)[shown],
        }
    )
    return measured, table.assign(of=len(lost))
