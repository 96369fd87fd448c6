"""Beyond the paper: do incidental conditions inside one session take queries, and can they be suppressed?

The paper leaves this open (its conclusion). Here a *statistic* of the images, for example brightness, splits the query
traversal at its median into two conditions. Each query meets two pools of distractors of equal size, both from its own
traversal: images on its own side of the median and images on the other side. If descriptors encode the statistic, the
own side takes more queries. Nearby images share brightness and also look alike, so the same is measured with the split
moved along the traversal (the sequence of labels turned by several offsets): that control keeps how labels cluster in
space but not what they say about the image.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from artifact import store, suppression
from artifact.datasets.appearance import STATISTICS, appearance
from artifact.extraction.described import Described, describe
from artifact.manifest import Manifest
from artifact.metrics.evaluate import evaluate
from artifact.metrics.evaluation import Evaluation
from artifact.metrics.statistics import block_length, resamples
from artifact.metrics.stored import stored
from artifact.ranking import one_pass
from artifact.ranking.one_pass import ORIGINAL
from artifact.studies import fitted
from artifact.studies.common import PERCENT, Study, origin, single_stage
from artifact.studies.evaluated import Measured
from artifact.suppression.inlp import INLP
from artifact.suppression.leace import LEACE
from artifact.suppression.regions import Split

VIEWS = (ORIGINAL, "LEACE", "INLP")

CONTROLS = 8
"""Offsets, evenly spaced along the traversal, by which the labels are turned for the control."""


def within_session(
    manifest: Manifest,
    names: Iterable[str],
    methods: Iterable[str],
    statistics: Sequence[str] = ("brightness",),
    *,
    fraction: float = 0.25,
    iterations: int = 35,
    seed: int = 0,
) -> Study:
    """Measure how many queries distractors with the query's own side of a statistic take, before and after suppression.

    Parameters
    ----------
    names, methods
        Datasets and methods.
    statistics
        Some of :data:`artifact.datasets.appearance.STATISTICS`.
    fraction
        Share of the queries that LEACE and INLP are fitted on; the rest is evaluated.
    iterations
        INLP iterations.
    seed
        Seed of INLP and of the intervals.

    Returns
    -------
    Study
        One row per dataset, method, statistic and view (``original``, ``LEACE``, ``INLP``): ``R`` without distractors, ``own`` and
        ``other`` (R@1 with distractors of the query's own and of the other side) in percent; ``gap`` = other − own
        with its interval ``gap_low``, ``gap_high``; ``control``, the mean gap of the turned labels, and
        ``control_high``, the largest of them, in percentage points.
    """
    rows, inputs = [], []
    for name in names:
        for method in single_stage(manifest, methods):
            described = describe(manifest, name, method)
            region = fitted.split_of(described.dataset, fraction)
            measures = appearance(described.dataset.query, manifest.cache)
            for statistic in statistics:
                values = measures[:, STATISTICS.index(statistic)]
                found = _evaluations(manifest, described, region, values, statistic, iterations, seed)
                rows += [
                    {
                        "dataset": name,
                        "title": manifest.dataset(name).title,
                        "method": method,
                        "statistic": statistic,
                        "view": view,
                        **_row(found[view], values[region.evaluation_queries], seed),
                        "origin": origin(Measured(found[ORIGINAL], described.dataset, method, described.inputs)),
                    }
                    for view in VIEWS
                ]
            inputs += described.inputs
    return Study(pd.DataFrame(rows), tuple(inputs))


def sides(values: np.ndarray) -> np.ndarray:
    """Split at the median: 1 for the larger half, 0 for the smaller; equal values keep the order of the images.

    Examples
    --------
    >>> sides(np.array([0.3, 0.1, 0.2, 0.3])).tolist()
    [1, 0, 0, 1]
    """
    order = np.argsort(values, kind="stable")
    labels = np.zeros(len(values), int)
    labels[order[len(values) // 2 :]] = 1
    return labels


def turned(labels: np.ndarray) -> list[np.ndarray]:
    """Return the labels themselves, then turned by :data:`CONTROLS` offsets evenly spaced along the traversal."""
    offsets = [round(i * len(labels) / (CONTROLS + 1)) for i in range(CONTROLS + 1)]
    return [np.roll(labels, offset) for offset in offsets]


@dataclass(frozen=True)
class _Sided:
    """Evaluations with the pools of each side, real labels first."""

    evaluation: Evaluation

    def hits(self, turn: int, labels: np.ndarray, *, own: bool) -> np.ndarray:
        """Whether each evaluated query keeps its place among distractors of its own, or of the other, side."""
        by_side = np.stack([self.evaluation.pool(_pool(turn, side)).hits(1, distractors=True) for side in (0, 1)])
        wanted = labels if own else 1 - labels
        return by_side[wanted, np.arange(len(labels))]


def _pool(turn: int, side: int) -> str:
    return f"turn {turn} side {side}"


def _row(evaluation: Evaluation, values: np.ndarray, seed: int) -> dict[str, float]:
    """Own and other side with the gap between them, and the gaps of the control."""
    sided, evaluated = _Sided(evaluation), evaluation.evaluated
    gaps = []
    for turn, labels in enumerate(turned(sides(values))):
        own, other = (sided.hits(turn, labels[evaluated], own=side) for side in (True, False))
        gaps.append(other.astype(float) - own)
        if turn == 0:
            shares = PERCENT * own.mean(), PERCENT * other.mean()
    block = block_length(evaluation.query_positions, evaluation.threshold)
    draws = gaps[0][resamples(len(gaps[0]), block, 1000, seed)].mean(axis=1)
    low, high = np.quantile(draws, [0.025, 0.975])
    control = [gap.mean() for gap in gaps[1:]]
    return {
        "R": PERCENT * evaluation.recall(1),
        "own": shares[0],
        "other": shares[1],
        "gap": shares[1] - shares[0],
        "gap_low": PERCENT * low,
        "gap_high": PERCENT * high,
        "control": PERCENT * np.mean(control),
        "control_high": PERCENT * np.max(control),
        "queries": evaluation.n_queries,
    }


def _evaluations(
    manifest: Manifest,
    described: Described,
    region: Split,
    values: np.ndarray,
    statistic: str,
    iterations: int,
    seed: int,
) -> dict[str, Evaluation]:
    """Evaluate the original and the suppressed descriptors against the pools of both sides of all turns."""
    key = store.key(
        stage="within",
        revisions=[one_pass.REVISION, suppression.REVISION],
        inputs=described.key_inputs(),
        settings=[statistic, values, region.fit_queries, CONTROLS, iterations, seed],
    )

    def compute() -> dict[str, Any]:
        # The fitting region has its own median: all of it may lie on one side of the traversal's.
        fitting = described.query.values[region.fit_queries], sides(values[region.fit_queries])
        views = {"LEACE": LEACE().fit(*fitting), "INLP": INLP(iterations, seed=seed).fit(*fitting)}
        rows, columns = region.evaluation_queries, region.evaluation_database
        queries, places = described.query.values[rows], described.dataset.query.positions[rows]
        pools, where = {}, {}
        for turn, labels in enumerate(turned(sides(values[rows]))):
            for side in (0, 1):
                chosen = labels == side
                pools[_pool(turn, side)], where[_pool(turn, side)] = queries[chosen], places[chosen]
        result = evaluate(
            queries,
            described.database.values[columns],
            places,
            described.dataset.database.positions[columns],
            described.dataset.threshold,
            pools,
            where,
            views=views,
            draws=1,
            depth=1,
        )
        return {"views": result}

    record = {"dataset": described.dataset.name, "method": described.method, "stage": f"within: {statistic}"}
    result = stored(manifest, key, compute, record)["views"]
    return {view: result[view] for view in VIEWS}
