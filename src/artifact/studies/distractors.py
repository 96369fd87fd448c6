"""Figs. 6 and 7: number, distance and condition of distractors."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import pandas as pd

from artifact import datasets as data
from artifact.datasets.positives import positives_of
from artifact.manifest import Manifest
from artifact.studies import evaluated, reported
from artifact.studies.common import PERCENT, Study, is_reported


def distractor_number(
    manifest: Manifest,
    dataset: str,
    methods: Iterable[str],
    ratios: Sequence[float],
    *,
    k: int = 1,
    seed: int = 0,
) -> Study:
    """Fig. 6a: DAR@K against the ratio of distractors to queries.

    Returns
    -------
    Study
        One row per method and ratio: ``method``, ``ratio``, ``DAR`` (exact expectation over random subsets, in
        percent), ``draw_low`` and ``draw_high`` (lowest and highest of the nested random draws), ``reported``.
    """
    curves = _reported_curves("fig06_number", "ratio") if is_reported(manifest, dataset, "robotcar", k) else {}
    rows, inputs = [], []
    for method in methods:
        measured = evaluated.evaluation(manifest, dataset, method, seed=seed)
        draws = measured.evaluation.dar_by_ratio_draws(ratios, k)
        for index, (ratio, value) in enumerate(zip(ratios, measured.evaluation.dar_by_ratio(ratios, k), strict=True)):
            rows.append(
                {
                    "method": method,
                    "ratio": float(ratio),
                    "DAR": PERCENT * value,
                    "draw_low": PERCENT * draws[:, index].min(),
                    "draw_high": PERCENT * draws[:, index].max(),
                    "reported": curves.get((method, round(float(ratio), 6)), np.nan),
                }
            )
        inputs += measured.inputs
    return Study(pd.DataFrame(rows), tuple(inputs))


def distractor_distance(
    manifest: Manifest,
    dataset: str,
    methods: Iterable[str],
    distances: Sequence[float],
    *,
    k: int = 1,
    seed: int = 0,
) -> Study:
    """Fig. 6b: DAR@K against the minimum distance between a query and its distractors.

    Returns
    -------
    Study
        One row per method and distance (metres or frames; infinity is no distractor): ``method``, ``distance``,
        ``DAR`` in percent, ``reported``.
    """
    curves = {}
    if is_reported(manifest, dataset, "robotcar", k):
        curves = _reported_curves("fig06_distance", "minimum_distance_metres")
    rows, inputs = [], []
    for method in methods:
        measured = evaluated.evaluation(manifest, dataset, method, seed=seed)
        for distance, value in zip(distances, measured.evaluation.dar_by_distance(distances, k), strict=True):
            reported = curves.get((method, round(float(distance), 6)), np.nan)
            rows.append({"method": method, "distance": float(distance), "DAR": PERCENT * value, "reported": reported})
        inputs += measured.inputs
    return Study(pd.DataFrame(rows), tuple(inputs))


def distractor_condition(
    manifest: Manifest, dataset: str, methods: Iterable[str], *, k: int = 1, seed: int = 0
) -> Study:
    """Fig. 7: DAR@K with distractors from traversals of different conditions, the same number from each.

    The pools are the query set itself and the dataset's ``distractor_traversals``, each cut to the smallest of
    them; ``none`` is R@K.

    Returns
    -------
    Study
        One row per method and pool: ``method``, ``traversal``, ``condition``, ``pool_size``, ``DAR`` in percent,
        ``reported``.
    """
    entry = manifest.dataset(dataset)
    if not entry.distractor_traversals:
        able = [n for n, e in manifest.datasets.items() if e.distractor_traversals]
        raise ValueError(
            f"dataset {dataset!r} names no distractor_traversals in the manifest; those that do: {', '.join(able) or 'none'}"
        )
    names = [entry.query, *entry.distractor_traversals]
    loaded = data.load(manifest, dataset, names)
    starts, _ = positives_of(loaded.query.positions, loaded.database.positions, loaded.threshold)
    size = min(
        [
            int((np.diff(starts) > 0).sum()),
            *(len(loaded.traversals[name]) for name in entry.distractor_traversals),
        ]
    )
    curves = {}
    if is_reported(manifest, dataset, "robotcar", k):
        curves = _reported_curves("fig07", "distractor_condition")
    rows, inputs = [], []
    for method in methods:
        measured = evaluated.evaluation(manifest, dataset, method, distractors=names, pool_size=size, seed=seed)
        shares = {name: (entry.traversals[name].condition, measured.evaluation.pool(name).dar(k)) for name in names}
        shares["none"] = ("none", measured.evaluation.recall(k))
        for name, (condition, value) in shares.items():
            rows.append(
                {
                    "method": method,
                    "traversal": name,
                    "condition": condition,
                    "pool_size": 0 if name == "none" else size,
                    "DAR": PERCENT * value,
                    "reported": curves.get((method, condition), np.nan),
                }
            )
        inputs += measured.inputs
    return Study(pd.DataFrame(rows), tuple(inputs))


def _reported_curves(table: str, x: str) -> dict[tuple[str, Any], float]:
    frame = reported.table(table)
    keys = frame[x] if frame[x].dtype == object or str(frame[x].dtype) == "str" else frame[x].round(6)
    return {
        (method, key): value for method, key, value in zip(frame["method"], keys, frame["dar_percent"], strict=True)
    }
