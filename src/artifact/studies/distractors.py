"""Figs. 6 and 7: number, distance and condition of distractors."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from artifact import datasets as data
from artifact.manifest import Manifest
from artifact.metrics.result import Result
from artifact.studies import evaluated, reported
from artifact.studies.common import PERCENT, Study, is_reported, joined, replicated, shares


def distractor_number(
    manifest: Manifest,
    dataset: str,
    methods: Iterable[str],
    ratios: Sequence[float],
    *,
    k: int = 1,
    draws: int = 20,
    seed: int = 0,
) -> Study:
    """Fig. 6a: DAR@K against the ratio of distractors to queries.

    Columns: ``method``, ``ratio``, ``DAR`` (exact expectation over random subsets, in percent; for two-stage methods
    the mean of draws), ``draws`` (their number; 0 where the expectation is exact), ``draw_low`` and ``draw_high``
    (lowest and highest of the nested random draws), ``low`` and ``high`` (the 95 % interval, widened to the draws: the
    paper shows one), ``reported``.
    """
    expected = _reported_curves(manifest, dataset, k, "fig06_number", "ratio")
    rows, inputs, found = [], [], []
    for method in methods:
        measured = evaluated.evaluation(manifest, dataset, method, draws=draws, seed=seed)
        result = measured.evaluation
        drawn = PERCENT * result.dar_by_ratio_draws(ratios, k)
        chances = result.chances_by_ratio(ratios, k)
        curve = pd.DataFrame({"method": method, "ratio": [float(ratio) for ratio in ratios]})
        curve["DAR"] = [PERCENT * chance.mean() for chance in chances.T]
        curve["draws"] = 0 if manifest.method(method).rerank is None else len(drawn)
        curve["draw_low"], curve["draw_high"] = drawn.min(axis=0), drawn.max(axis=0)
        found.append(replicated(chances, result, dataset, seed))
        low, high = shares(found[-1])
        curve["low"], curve["high"] = np.minimum(low, curve["draw_low"]), np.maximum(high, curve["draw_high"])
        curve["reported"] = [expected.get((method, round(ratio, 6)), np.nan) for ratio in curve["ratio"]]
        rows += curve.to_dict("records")
        inputs += measured.inputs
    return Study(pd.DataFrame(rows), tuple(inputs), {"DAR": np.concatenate(found)})


def distractor_distance(
    manifest: Manifest, dataset: str, methods: Iterable[str], distances: Sequence[float], *, k: int = 1, seed: int = 0
) -> Study:
    """Fig. 6b: DAR@K against the minimum distance between a query and its distractors.

    Columns: ``dataset``, ``title``, ``method``, ``distance`` (metres or frames; infinity is no distractor), ``DAR`` in percent
    with its 95 % interval ``low`` and ``high``, ``hits`` of ``queries``, ``distractors`` (mean number that a query has left),
    ``reported``.
    """
    expected = _reported_curves(manifest, dataset, k, "fig06_distance", "minimum_distance_metres")
    rows, inputs, found, title = [], [], [], manifest.dataset(dataset).title
    for method in methods:
        measured = evaluated.evaluation(manifest, dataset, method, seed=seed)
        result = measured.evaluation
        hits = result.hits_by_distance(distances, k)
        found.append(replicated(hits, result, dataset, seed))
        left = _distractors_left(result, distances)
        for distance, share, number in zip(map(float, distances), _shares(hits, found[-1]), left, strict=True):
            row = {"dataset": dataset, "title": title, "method": method, "distance": distance, **share}
            printed = expected.get((method, round(distance, 6)), np.nan)
            rows.append(row | {"distractors": number, "reported": printed})
        inputs += measured.inputs
    return Study(pd.DataFrame(rows), tuple(inputs), {"DAR": np.concatenate(found)})


def by_distance_everywhere(
    manifest: Manifest,
    names: Iterable[str],
    methods: Iterable[str],
    distances: Sequence[float],
    *,
    k: int = 1,
    seed: int = 0,
) -> Study:
    """Fig. 6b for every dataset with a threshold in metres: its threshold, the ``distances`` beyond it, and infinity."""
    found, methods = [], list(methods)
    for name in names:
        threshold = manifest.dataset(name).threshold
        if threshold.unit == "metres":
            limits = distances_beyond(threshold.value, distances)
            found.append(distractor_distance(manifest, name, methods, limits, k=k, seed=seed))
    return joined(found)


def distances_beyond(threshold: float, distances: Iterable[float]) -> list[float]:
    """Return a threshold, the finite ones of some distances beyond it, and infinity."""
    return [threshold, *(distance for distance in distances if threshold < distance < np.inf), np.inf]


def _distractors_left(result: Result, distances: Sequence[float]) -> np.ndarray:
    """Mean number of distractors of a query beyond each distance."""
    pool, queries = cKDTree(result.pool_positions[result.pool_name]), cKDTree(result.query_positions)
    return result.n_distractors - pool.count_neighbors(queries, distances) / result.n_queries


def distractor_condition(
    manifest: Manifest, dataset: str, methods: Iterable[str], *, k: int = 1, seed: int = 0
) -> Study:
    """Fig. 7: DAR@K with distractors from traversals of different conditions, the same number from each.

    The pools are the query set itself and the dataset's ``distractor_traversals``, as many images of each as the smallest
    has: the exact expectation over all draws of so many, or for two-stage methods one draw from the seed. ``none`` is R@K.
    Columns: ``method``, ``traversal``, ``condition``, ``pool_size``, ``DAR`` in percent with its 95 % interval ``low`` and
    ``high``, ``draw_low`` and ``draw_high`` (lowest and highest of 20 random draws), ``hits`` of ``queries`` (NaN where
    images were drawn), ``reported``.
    """
    names, size = pools_of_conditions(manifest, dataset)
    traversals = manifest.dataset(dataset).traversals
    pools = [(name, traversals[name].condition, size) for name in names] + [("none", "none", 0)]
    expected = _reported_curves(manifest, dataset, k, "fig07", "distractor_condition")
    rows, inputs, found = [], [], []
    for method in methods:
        # Draws of a two-stage method ask for local features of more pairs: one of them has to do.
        cut = None if manifest.method(method).rerank is None else size
        measured = evaluated.evaluation(manifest, dataset, method, distractors=names, pool_size=cut, seed=seed)
        result = measured.evaluation
        chances, spread = zip(*(_of_size(result.pool(name), size, k) for name in names), strict=True)
        columns = np.stack([*chances, result.hits(k, distractors=False)], axis=1).astype(np.float64)
        found.append(replicated(columns, result, dataset, seed))
        found_shares = _shares(columns, found[-1])
        for (name, condition, number), share, drawn in zip(pools, found_shares, (*spread, {}), strict=True):
            row = {"method": method, "traversal": name, "condition": condition, "pool_size": number, **share}
            row |= {"draw_low": share["DAR"], "draw_high": share["DAR"]} | drawn
            rows.append(row | {"reported": expected.get((method, condition), np.nan)})
        inputs += measured.inputs
    return Study(pd.DataFrame(rows), tuple(inputs), {"DAR": np.concatenate(found)})


def pools_of_conditions(manifest: Manifest, dataset: str) -> tuple[list[str], int]:
    """Return the traversals that are the pools of Fig. 7, the query traversal first, and the size that each is cut to."""
    entry = manifest.dataset(dataset)
    if not entry.distractor_traversals:
        able = ", ".join(name for name, other in manifest.datasets.items() if other.distractor_traversals)
        found = f"dataset {dataset!r} names no distractor_traversals in the manifest"
        raise ValueError(f"{found}; those that do: {able or 'none'}")
    names = [entry.query, *entry.distractor_traversals]
    loaded = data.load(manifest, dataset, names)
    evaluated_queries = evaluated.with_positives(loaded)
    return names, min(len(evaluated_queries), *(len(loaded.traversals[name]) for name in names[1:]))


def _of_size(result: Result, size: int, k: int) -> tuple[np.ndarray, dict[str, float]]:
    """Each query's chance of a hit with so many images drawn from the pool, and the spread of DAR over random draws."""
    if size >= result.n_distractors:
        return result.hits(k, distractors=True), {}
    ratio = [size / result.n_distractors]
    draws = PERCENT * result.dar_by_ratio_draws(ratio, k)
    return result.chances_by_ratio(ratio, k)[:, 0], {"draw_low": draws.min(), "draw_high": draws.max()}


def _shares(chances: np.ndarray, sample: np.ndarray) -> list[dict[str, float]]:
    """DAR of each column of hits, or chances of a hit, ``(n, m)``, with its interval."""
    rows = []
    for one, low, high in zip(chances.T, *shares(sample), strict=True):
        hits = np.nan if ((one > 0) & (one < 1)).any() else int(one.sum())
        rows.append({"DAR": PERCENT * one.mean(), "low": low, "high": high, "hits": hits, "queries": len(one)})
    return rows


def _reported_curves(manifest: Manifest, dataset: str, k: int, table: str, x: str) -> dict[tuple[str, Any], float]:
    """What the paper plots for RobotCar, by method and abscissa."""
    if not is_reported(manifest, dataset, "robotcar", k):
        return {}
    rows = reported.table(table)[["method", x, "dar_percent"]].round({x: 6})
    return {(method, at): percent for method, at, percent in rows.itertuples(index=False)}
