"""Table III and Fig. 5: recall with and without distractors."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import product
from typing import Any

import numpy as np
import pandas as pd

from artifact.manifest import Manifest
from artifact.metrics.statistics import intervals
from artifact.studies import evaluated, reported
from artifact.studies.common import METRICS, PERCENT, Study, by_metric, origin, replicated_hits


def recall_table(
    manifest: Manifest, names: Iterable[str], methods: Iterable[str], *, k: int = 1, seed: int = 0
) -> Study:
    """Table III and Fig. 5: R@K, DAR@K and RSR@K of every method on every dataset.

    Columns: ``dataset``, ``title``, ``method``, ``reported_as`` (the paper's name of the dataset), ``R``, ``DAR``,
    ``RSR`` in percent, each with ``_low`` and ``_high`` (95 % block-bootstrap interval), ``queries`` (evaluated),
    ``listed`` (all queries), ``hits_R`` and ``hits_DAR`` (numbers of queries), ``ties`` (percentage points between the
    two tie rules), ``origin``, and ``reported_R``, ``reported_DAR``, ``reported_RSR`` where the paper has them.
    """
    rows, inputs, sample = [], [], []
    expected = reported.recall_table().set_index(["dataset", "method"]).to_dict("index") if k == 1 else {}
    for name, method in product(names, methods):
        entry, measured = manifest.dataset(name), evaluated.evaluation(manifest, name, method, seed=seed)
        result = measured.evaluation
        row: dict[str, Any] = {"dataset": name, "title": entry.title, "method": method}
        row["reported_as"] = entry.reported_as
        sample.append(replicated_hits(result, k, name, seed))
        for metric, found in intervals(result, k, seed=seed, stream=name).items():
            bounds = {"": found.value, "_low": found.low, "_high": found.high}
            row |= {f"{metric}{bound}": PERCENT * value for bound, value in bounds.items()}
        row |= {"queries": result.n_queries, "listed": result.n_queries + result.excluded_queries}
        row |= {f"hits_{m}": int(result.hits(k, distractors=m == "DAR").sum()) for m in ("R", "DAR")}
        row["ties"] = PERCENT * (result.dar(k) - result.dar(k, ties="against"))
        row["origin"] = origin(measured)
        printed = expected.get((entry.reported_as, method), {})
        rows.append(row | {f"reported_{metric}": printed.get(f"{metric}@1", np.nan) for metric in METRICS})
        inputs += measured.inputs
    return Study(pd.DataFrame(rows), tuple(inputs), by_metric(sample))


def with_means(table: pd.DataFrame) -> pd.DataFrame:
    """Average a :func:`recall_table` over datasets and rank each method on it, as Table III does.

    One row per method: the unweighted means ``R``, ``DAR``, ``RSR`` and the ranks ``rank_R``, ``rank_DAR``,
    ``rank_RSR`` (1 is best; equal means share the better rank).
    """
    means = table.groupby("method", sort=False)[list(METRICS)].mean()
    ranks = means.rank(ascending=False, method="min").astype("Int64").add_prefix("rank_")
    return pd.concat([means, ranks], axis=1).reset_index()


def mean_replicates(study: Study) -> dict[str, np.ndarray]:
    """Return replicates ``(methods, count)`` of the means ``R`` and ``DAR`` of :func:`with_means`."""
    rows = study.table.groupby("method", sort=False).indices.values()
    return {metric: np.stack([sample[of].mean(axis=0) for of in rows]) for metric, sample in study.replicates.items()}
