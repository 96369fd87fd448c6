"""Tables I to III and Figs. 5 to 7: datasets, methods, recall with and without distractors."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import pandas as pd

from artifact.manifest import Manifest
from artifact.metrics.statistics import Interval, intervals
from artifact.studies import evaluated, reported
from artifact.studies.common import METRICS, PERCENT, Study, origin


def recall_table(
    manifest: Manifest, names: Iterable[str], methods: Iterable[str], *, k: int = 1, seed: int = 0
) -> Study:
    """Table III and Fig. 5: R@K, DAR@K and RSR@K of every method on every dataset.

    Returns
    -------
    Study
        One row per dataset and method: ``dataset``, ``title``, ``method``, ``reported_as`` (the paper's name of the dataset), ``R``, ``DAR``, ``RSR`` in percent, each
        with ``_low`` and ``_high`` (95 % block-bootstrap interval), ``queries`` (evaluated), ``listed`` (all queries), ``hits_R`` and
        ``hits_DAR`` (numbers of queries), ``ties`` (percentage points between the two tie rules), ``origin``, and
        ``reported_R``, ``reported_DAR``, ``reported_RSR`` where the paper has them.
    """
    rows, inputs = [], []
    expected = _reported_recall() if k == 1 else {}
    for name in names:
        entry = manifest.dataset(name)
        for method in methods:
            measured = evaluated.evaluation(manifest, name, method, seed=seed)
            result = measured.evaluation
            row: dict[str, Any] = {"dataset": name, "title": entry.title, "method": method}
            row["reported_as"] = entry.reported_as
            for metric, interval in intervals(result, k, seed=seed).items():
                row |= _percentages(metric, interval)
            row["queries"] = result.n_queries
            row["listed"] = result.n_queries + result.excluded_queries
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
    table = reported.recall_table()
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
