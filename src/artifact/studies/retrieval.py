"""Tables I to III and Figs. 5 to 7: datasets, methods, recall with and without distractors."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import pandas as pd

from artifact import datasets as data
from artifact import paper, pipeline
from artifact.datasets.positives import positives_of
from artifact.extraction import extract
from artifact.manifest import Manifest
from artifact.manifest.entries import Preprocessing
from artifact.metrics.statistics import Interval, intervals
from artifact.studies.common import METRICS, PERCENT, Study, is_reported, origin


def datasets_table(manifest: Manifest, names: Iterable[str]) -> Study:
    """Table I: query and database traversals, their sizes, the threshold and the condition shift.

    Returns
    -------
    Study
        One row per dataset: ``dataset``, ``title``, ``query``, ``database``, ``queries``, ``evaluated`` (queries
        with a positive), ``database_images``, ``threshold``, ``shift``, ``positives`` (median number per
        evaluated query), ``images`` (real or rendered), ``mirrors``, ``licence``.
    """
    rows = []
    for name in names:
        entry, loaded = data.entry_of(manifest, name), data.load(manifest, name)
        starts, _ = positives_of(loaded.query.positions, loaded.database.positions, loaded.threshold)
        counts = np.diff(starts)
        rows.append(
            {
                "dataset": name,
                "title": entry.title,
                "query": loaded.query_name,
                "database": loaded.database_name,
                "queries": len(loaded.query),
                "evaluated": int((counts > 0).sum()),
                "database_images": len(loaded.database),
                "threshold": str(entry.threshold),
                "shift": entry.shift,
                "positives": float(np.median(counts[counts > 0])) if counts.any() else 0.0,
                "images": "real" if loaded.real else "rendered",
                "mirrors": entry.mirrors or "",
                "licence": entry.licence,
            }
        )
    return Study(pd.DataFrame(rows), ())


def methods_table(manifest: Manifest, names: Iterable[str], methods: Iterable[str]) -> Study:
    """Table II: what each method is and how fast it ran on the images at hand.

    Returns
    -------
    Study
        One row per method: ``method``, ``title``, ``kind``, ``backbone``, ``aggregation``, ``dimension``,
        ``train_data``, ``rerank``, ``input`` (preprocessing in words), ``batch_size``, ``licence``, ``images_per_second``
        (the model's own rate during extraction), ``busy`` (its share of the wall time, in percent), ``device``.
    """
    rows = []
    loaded = [data.load(manifest, name) for name in names]
    for method in methods:
        entry = manifest.method(method)
        found = [
            extract.descriptors(manifest, traversal, method)
            for dataset in loaded
            for traversal in dataset.traversals.values()
        ]
        timed = [one.sidecar for one in {one.key: one for one in found}.values() if one.sidecar.get("forward_seconds")]
        forward = sum(sidecar["forward_seconds"] for sidecar in timed)
        wall = sum(sidecar["seconds"] for sidecar in timed)
        rows.append(
            {
                "method": method,
                "title": entry.title,
                "kind": entry.kind,
                "backbone": entry.backbone,
                "aggregation": entry.aggregation,
                "dimension": entry.dimension,
                "train_data": entry.train_data,
                "rerank": f"top {entry.rerank}" if entry.rerank else "–",
                "input": input_in_words(entry.preprocessing),
                "batch_size": entry.batch_size,
                "licence": entry.licence,
                "images_per_second": sum(s["shape"][0] for s in timed) / forward if timed else np.nan,
                "busy": PERCENT * forward / wall if timed else np.nan,
                "device": ", ".join(sorted({sidecar["device"] for sidecar in timed})) or "–",
            }
        )
    return Study(pd.DataFrame(rows), ())


def input_in_words(preprocessing: Preprocessing) -> str:
    """Say how images are prepared, for example ``322×322 bicubic``."""
    p = preprocessing
    size = f"{p.size[0]}×{p.size[1]}" if p.size else "native size"
    if p.longest_side:
        size += f", at most {p.longest_side}"
    crop = f", cropped to ×{p.crop_to_multiple_of}" if p.crop_to_multiple_of > 1 else ""
    how = f" {p.interpolation}" if p.size or p.longest_side else ""
    return f"{size}{how}{crop}{', grey' if p.colour == 'grey' else ''}{'' if p.antialias else ', not antialiased'}"


def recall_table(
    manifest: Manifest, names: Iterable[str], methods: Iterable[str], *, k: int = 1, seed: int = 0
) -> Study:
    """Table III and Fig. 5: R@K, DAR@K and RSR@K of every method on every dataset.

    Returns
    -------
    Study
        One row per dataset and method: ``dataset``, ``title``, ``method``, ``R``, ``DAR``, ``RSR`` in percent, each
        with ``_low`` and ``_high`` (95 % block-bootstrap interval), ``queries`` (evaluated), ``hits_R`` and
        ``hits_DAR`` (numbers of queries), ``ties`` (percentage points between the two tie rules), ``origin``, and
        ``reported_R``, ``reported_DAR``, ``reported_RSR`` where the paper has them.
    """
    rows, inputs = [], []
    expected = _reported_recall() if k == 1 else {}
    for name in names:
        entry = data.entry_of(manifest, name)
        for method in methods:
            measured = pipeline.evaluation(manifest, name, method, seed=seed)
            result = measured.evaluation
            row: dict[str, Any] = {"dataset": name, "title": entry.title, "method": method}
            for metric, interval in intervals(result, k, seed=seed).items():
                row |= _percentages(metric, interval)
            row["queries"] = result.n_queries
            row["hits_R"] = int(result.hits(k, distractors=False).sum())
            row["hits_DAR"] = int(result.hits(k, distractors=True).sum())
            row["ties"] = PERCENT * (result.dar(k) - result.dar(k, ties="against"))
            row["origin"] = origin(measured)
            for metric in METRICS:
                row[f"reported_{metric}"] = expected.get((entry.reported_as, method, metric), np.nan)
            rows.append(row)
            inputs += measured.inputs
    return Study(pd.DataFrame(rows), tuple(inputs))


def _percentages(metric: str, interval: Interval) -> dict[str, float]:
    return {
        metric: PERCENT * interval.value,
        f"{metric}_low": PERCENT * interval.low,
        f"{metric}_high": PERCENT * interval.high,
    }


def _reported_recall() -> dict[tuple[str | None, str, str], float]:
    table = paper.recall_table()
    return {
        (row["dataset"], row["method"], metric): row[f"{metric}@1"]
        for row in table.to_dict("records")
        for metric in METRICS
    }


def with_means(table: pd.DataFrame) -> pd.DataFrame:
    """Append the unweighted mean over datasets and each method's rank on it, as Table III does.

    Parameters
    ----------
    table
        As from :func:`recall_table`.

    Returns
    -------
    pandas.DataFrame
        One row per method: the means ``R``, ``DAR``, ``RSR`` and the ranks ``rank_R``, ``rank_DAR``, ``rank_RSR``
        (1 is best; equal means share the better rank).
    """
    means = table.groupby("method", sort=False)[list(METRICS)].mean()
    ranks = means.rank(ascending=False, method="min").astype("Int64").add_prefix("rank_")
    return pd.concat([means, ranks], axis=1).reset_index()


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
        measured = pipeline.evaluation(manifest, dataset, method, seed=seed)
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
        measured = pipeline.evaluation(manifest, dataset, method, seed=seed)
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
    entry = data.entry_of(manifest, dataset)
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
        measured = pipeline.evaluation(manifest, dataset, method, distractors=names, pool_size=size, seed=seed)
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
    frame = paper.reported(table)
    keys = frame[x] if frame[x].dtype == object or str(frame[x].dtype) == "str" else frame[x].round(6)
    return {
        (method, key): value for method, key, value in zip(frame["method"], keys, frame["dar_percent"], strict=True)
    }
