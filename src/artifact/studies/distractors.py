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
from artifact.studies.common import PERCENT, Study, is_reported, percent_interval


def distractor_number(
    manifest: Manifest,
    dataset: str,
    methods: Iterable[str],
    ratios: Sequence[float],
    *,
    k: int = 1,
    draws: int = 10,
    seed: int = 0,
) -> Study:
    """Fig. 6a: DAR@K against the ratio of distractors to queries.

    Returns
    -------
    Study
        One row per method and ratio: ``method``, ``ratio``, ``DAR`` (exact expectation over random subsets, in
        percent; for two-stage methods the mean of draws), ``draws`` (their number; 0 where the expectation is exact),
        ``draw_low`` and ``draw_high`` (lowest and highest of the nested random draws), ``low`` and ``high`` (the 95 %
        interval, widened to the draws: the paper shows one), ``reported``.
    """
    curves = _reported_curves("fig06_number", "ratio") if is_reported(manifest, dataset, "robotcar", k) else {}
    rows, inputs = [], []
    for method in methods:
        measured = evaluated.evaluation(manifest, dataset, method, draws=draws, seed=seed)
        result = measured.evaluation
        drawn = PERCENT * result.dar_by_ratio_draws(ratios, k)
        chances = result.chances_by_ratio(ratios, k)
        low, high = percent_interval(chances, result, seed=seed)
        for index, ratio in enumerate(map(float, ratios)):
            of_draws = drawn[:, index].min(), drawn[:, index].max()
            rows.append(
                {
                    "method": method,
                    "ratio": ratio,
                    "DAR": PERCENT * chances[:, index].mean(),
                    "draws": 0 if manifest.method(method).rerank is None else len(drawn),
                    "draw_low": of_draws[0],
                    "draw_high": of_draws[1],
                    "low": min(low[index], of_draws[0]),
                    "high": max(high[index], of_draws[1]),
                    "reported": curves.get((method, round(ratio, 6)), np.nan),
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
        ``DAR`` in percent with its 95 % interval ``low`` and ``high``, ``hits`` of ``queries``, ``reported``.
    """
    curves = {}
    if is_reported(manifest, dataset, "robotcar", k):
        curves = _reported_curves("fig06_distance", "minimum_distance_metres")
    rows, inputs = [], []
    for method in methods:
        measured = evaluated.evaluation(manifest, dataset, method, seed=seed)
        hits = measured.evaluation.hits_by_distance(distances, k)
        low, high = percent_interval(hits, measured.evaluation, seed=seed)
        for index, distance in enumerate(map(float, distances)):
            row = {"method": method, "distance": distance} | _share(hits[:, index], low[index], high[index])
            rows.append(row | {"reported": curves.get((method, round(distance, 6)), np.nan)})
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
        One row per method and pool: ``method``, ``traversal``, ``condition``, ``pool_size``, ``DAR`` in percent with its
        95 % interval ``low`` and ``high``, ``hits`` of ``queries``, ``reported``.
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
        result = measured.evaluation
        hits = {name: result.pool(name).hits(k, distractors=True) for name in names}
        hits["none"] = result.hits(k, distractors=False)
        low, high = percent_interval(np.stack(list(hits.values()), axis=1), result, seed=seed)
        for index, (name, found) in enumerate(hits.items()):
            condition = "none" if name == "none" else entry.traversals[name].condition
            row = {"method": method, "traversal": name, "condition": condition}
            row |= {"pool_size": 0 if name == "none" else size} | _share(found, low[index], high[index])
            rows.append(row | {"reported": curves.get((method, condition), np.nan)})
        inputs += measured.inputs
    return Study(pd.DataFrame(rows), tuple(inputs))


def _share(hits: np.ndarray, low: float, high: float) -> dict[str, float]:
    return {"DAR": PERCENT * hits.mean(), "low": low, "high": high, "hits": int(hits.sum()), "queries": len(hits)}


def _reported_curves(table: str, x: str) -> dict[tuple[str, Any], float]:
    frame = reported.table(table)
    keys = frame[x] if frame[x].dtype == object or str(frame[x].dtype) == "str" else frame[x].round(6)
    return {
        (method, key): value for method, key, value in zip(frame["method"], keys, frame["dar_percent"], strict=True)
    }
