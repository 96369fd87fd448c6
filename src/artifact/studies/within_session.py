"""Beyond the paper: do incidental conditions inside one session take queries, and can they be suppressed?

The paper leaves this open (its conclusion). Here a *statistic* of the images, for example brightness, splits the query
traversal at its median. Each query meets two pools of distractors of equal size from its own traversal: its own side of
the median and the other. If descriptors encode the statistic, the own side takes more queries. Nearby images share
brightness and also look alike, so a control turns the sequence of labels along the traversal by several offsets: that
keeps how labels cluster in space but not what they say about the image.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import product
from typing import Any

import numpy as np
import pandas as pd

from artifact.datasets.appearance import STATISTICS, appearance
from artifact.extraction.described import Described, describe
from artifact.manifest import Manifest
from artifact.metrics.evaluate import evaluate
from artifact.metrics.evaluation import Evaluation
from artifact.metrics.statistics import ends, replicates
from artifact.metrics.stored import stored
from artifact.ranking.one_pass import ORIGINAL
from artifact.studies import fitted
from artifact.studies.common import PERCENT, NothingToShowError, Study, origin, single_stage
from artifact.studies.fitted import Fitting
from artifact.suppression.regions import Split

VIEWS = (ORIGINAL, "LEACE", "INLP")

CONTROLS = 8
"""Offsets, evenly spaced along the traversal, by which the labels are turned for the control."""

_FITTED = 4  # queries at least to fit on: two of either side


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

    One row per dataset, method, statistic and ``view``: ``R`` without distractors, ``own`` and ``other`` (R@1 with
    distractors of the query's own and of the other side) in percent; ``gap`` = other − own with its interval
    ``gap_low``, ``gap_high``; ``control``, the mean gap of the turned labels, and ``control_high``, the largest of
    them, in percentage points.

    ``statistics`` are some of :data:`artifact.datasets.appearance.STATISTICS`, ``fraction`` is the share of the queries
    that LEACE and INLP are fitted on (the rest is evaluated), ``iterations`` are INLP's, the seed is INLP's and the
    intervals'. Datasets with fewer than four queries to fit on, two of either side, are left out.

    Raises
    ------
    NothingToShowError
        If no dataset is left.
    """
    how, rows, inputs = Fitting(fraction, iterations, seed), [], []
    for name, method in product(names, single_stage(manifest, methods)):
        described = describe(manifest, name, method)
        region = fitted.split_of(described.dataset, fraction)
        if len(region.fit_queries) < _FITTED:
            continue
        measures = appearance(described.dataset.query, manifest.cache)
        for statistic in statistics:
            values = measures[:, STATISTICS.index(statistic)]
            found = _evaluations(manifest, described, region, values, statistic, how)
            for view in VIEWS:
                row = {"dataset": name, "title": manifest.dataset(name).title, "method": method}
                row |= {"statistic": statistic, "view": view}
                row |= _gaps(found[view], values[region.evaluation_queries], seed)
                rows.append(row | {"origin": origin(described)})
        inputs += described.inputs
    if not rows:
        raise NothingToShowError(
            f"this page needs a dataset with {_FITTED} queries in {PERCENT * fraction:g} % of them"
        )
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


def _pool(turn: int, side: int) -> str:
    return f"turn {turn} side {side}"


def _gaps(evaluation: Evaluation, values: np.ndarray, seed: int) -> dict[str, float]:
    queries, gaps, shares = np.arange(evaluation.n_queries), [], []
    for turn, labels in enumerate(turned(sides(values))):
        hits = np.stack([evaluation.pool(_pool(turn, side)).hits(1, distractors=True) for side in (0, 1)])
        label = labels[evaluation.evaluated]
        own, other = hits[label, queries], hits[1 - label, queries]
        gaps.append(other.astype(float) - own)
        shares.append((PERCENT * own.mean(), PERCENT * other.mean()))
    sample = replicates(gaps[0], evaluation.query_positions, evaluation.threshold, seed=seed)
    (low,), (high,) = ends(sample)
    control = [gap.mean() for gap in gaps[1:]]
    own, other = shares[0]
    return {
        "R": PERCENT * evaluation.recall(1),
        "own": own,
        "other": other,
        "gap": other - own,
        "gap_low": PERCENT * low,
        "gap_high": PERCENT * high,
        "control": PERCENT * np.mean(control),
        "control_high": PERCENT * np.max(control),
        "queries": evaluation.n_queries,
    }


def _evaluations(
    manifest: Manifest, described: Described, region: Split, values: np.ndarray, statistic: str, how: Fitting
) -> dict[str, Evaluation]:
    settings = [statistic, values, region.fit_queries, CONTROLS, how.iterations, how.seed]
    key = fitted.key_of("within", [described], settings)

    def compute() -> dict[str, Any]:
        # The fitting region has its own median: all of it may lie on one side of the traversal's.
        fitting = described.query.values[region.fit_queries], sides(values[region.fit_queries])
        views = fitted.fit(*fitting, ("LEACE", "INLP"), iterations=how.iterations, seed=how.seed)
        queries, database, places, *other = fitted.evaluation_region(described, region)
        pools, where = {}, {}
        for turn, labels in enumerate(turned(sides(values[region.evaluation_queries]))):
            for side in (0, 1):
                chosen = labels == side
                pools[_pool(turn, side)], where[_pool(turn, side)] = queries[chosen], places[chosen]
        return {"views": evaluate(queries, database, places, *other, pools, where, views=views, draws=1, depth=1)}

    record = {"dataset": described.dataset.name, "method": described.method, "stage": f"within: {statistic}"}
    result = stored(manifest, key, compute, record)["views"]
    return {view: result[view] for view in VIEWS}
