"""Tables IV and V: transforms of several datasets in one."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import astuple
from typing import Any

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from artifact import datasets
from artifact.extraction.described import Described, describe
from artifact.manifest import Manifest
from artifact.metrics.evaluate import evaluate
from artifact.metrics.evaluation import Evaluation
from artifact.metrics.stored import stored
from artifact.studies import fitted, reported
from artifact.studies.common import PERCENT, Study, by_metric, cell_of, replicated_hits, single_stage
from artifact.studies.fitted import LOW_RANK, Fitting

WITHIN_PP = 1.0
"""Difference that Tables IV and V count as equal, in percentage points."""

FITTING_ORDER = ("nordland", "amstertime", "gardens_point", "svox", "robotcar", "st_lucia")
"""Order in which the paper fits and composes the transforms of its datasets."""


def order_of_fitting(manifest: Manifest, names: Iterable[str]) -> list[str]:
    """Put datasets into the paper's order of fitting, by the dataset that each is or mirrors; others come last."""
    by_title = {title.replace("StLuciaMToD", "St Lucia"): name for name, title in reported.dataset_titles().items()}

    def place(name: str) -> int:
        entry = manifest.dataset(name)
        standing_for = entry.reported_as or by_title.get(entry.mirrors or "")
        return FITTING_ORDER.index(standing_for) if standing_for in FITTING_ORDER else len(FITTING_ORDER)

    return sorted(names, key=place)


def single_against_multi(
    manifest: Manifest,
    names: Sequence[str],
    methods: Iterable[str],
    *,
    k: int = 1,
    suppressors: Sequence[str] = LOW_RANK,
    **fitting: Any,
) -> Study:
    """Table IV: one transform per dataset, fitted as :class:`Fitting` says, against the composition of all of them.

    ``suppressors`` are INLP and LEACE, or one of them.

    Columns: ``suppression``, ``dataset``, ``reported_as``, ``title``, ``method``, ``single_R``, ``single_DAR``,
    ``multi_R``, ``multi_DAR`` in percent, ``queries``, and ``difference_R``, ``difference_DAR`` (single minus multi) in
    percentage points.
    """
    how = Fitting(**fitting)
    rows, inputs, sample = [], [], []
    for method in single_stage(manifest, methods):
        described = {name: describe(manifest, name, method) for name in names}
        for suppressor in suppressors:
            for name, found in _evaluate_both(manifest, described, method, suppressor, how).items():
                row = {"suppression": suppressor} | cell_of(manifest, name, method)
                views = "single", "multi"
                rows.append(row | _differences({view: found[view] for view in views}, k))
                single, multi = (replicated_hits(found[view], k, name, how.seed) for view in views)
                sample.append(single - multi)
                inputs += described[name].inputs
    return Study(pd.DataFrame(rows), tuple(inputs), by_metric(sample, "difference_"))


def _evaluate_both(
    manifest: Manifest, described: Mapping[str, Described], method: str, suppressor: str, how: Fitting
) -> dict[str, Evaluation]:
    """Evaluate each dataset under its own transform, ``single``, and under the composition of all, ``multi``."""

    def compute() -> dict[str, Any]:
        erasure = fitted.sequential(manifest, described, method, suppressor, how)
        found = {}
        for name, one in described.items():
            views = {"single": erasure.single[name], "multi": erasure.composed}
            where = fitted.split_of(one.dataset, how.fraction)
            options = {"views": views, "seed": how.seed, "draws": 0, "depth": 1}
            found[name] = evaluate(*fitted.evaluation_region(one, where), **options)
        return found

    key = fitted.key_of("single and multi", list(described.values()), [suppressor, list(described), *astuple(how)])
    return stored(manifest, key, compute, {"datasets": list(described), "method": method, "stage": "composition"})


def irrelevant_conditions(
    manifest: Manifest, names: Sequence[str], methods: Iterable[str], *, k: int = 1, **fitting: Any
) -> Study:
    """Table V: the composed transform of :class:`Fitting` on condition pairs that it was not fitted on.

    The pairs are the ``irrelevant_pairs`` of the datasets in the manifest. A dataset that is fitted on the pair itself
    leaves the composition, and the places of every region that an applied transform was fitted on stay out. Columns:
    ``suppression``, ``pair`` (conditions), ``dataset``, ``reported_as``, ``title``, ``method``, ``queries``,
    ``original_R``, ``original_DAR``, ``erased_R``, ``erased_DAR`` in percent, ``difference_R`` and ``difference_DAR``
    (original minus erased) in percentage points.
    """
    how = Fitting(**fitting)
    rows, inputs, sample = [], [], []
    for method in single_stage(manifest, methods):
        for name in names:
            entry = manifest.dataset(name)
            for pair in entry.irrelevant_pairs:
                chosen = [other for other in names if not _is_pair(manifest, other, name, pair)]
                described = describe(manifest, name, method, pair)
                result = _evaluate_pair(manifest, described, pair, chosen, how)
                reference = replicated_hits(result, k, name, how.seed)
                conditions = [entry.traversals[traversal].condition for traversal in pair]
                title = "–".join(conditions if len(set(conditions)) > 1 else pair)
                for suppressor in LOW_RANK:
                    row = {"suppression": suppressor, "pair": title} | cell_of(manifest, name, method)
                    views = {"original": result, "erased": result[suppressor]}
                    rows.append(row | {"queries": result.n_queries} | _differences(views, k))
                    sample.append(reference - replicated_hits(result[suppressor], k, name, how.seed))
                inputs += described.inputs
    return Study(pd.DataFrame(rows), tuple(inputs), by_metric(sample, "difference_"))


def _differences(views: Mapping[str, Evaluation], k: int) -> dict[str, float]:
    """R and DAR of two evaluations of the same queries in percent, and the first minus the second."""
    (first, one), (second, other) = views.items()
    row = {f"{first}_R": PERCENT * one.recall(k), f"{first}_DAR": PERCENT * one.dar(k)}
    row |= {f"{second}_R": PERCENT * other.recall(k), f"{second}_DAR": PERCENT * other.dar(k)}
    row["queries"] = one.n_queries
    return row | {
        f"difference_{metric}": row[f"{first}_{metric}"] - row[f"{second}_{metric}"] for metric in ("R", "DAR")
    }


def _is_pair(manifest: Manifest, other: str, name: str, pair: Sequence[str]) -> bool:
    entry = manifest.dataset(other)
    same = (entry.root or other) == (manifest.dataset(name).root or name)
    return same and {entry.query, entry.database} == set(pair)


def fitted_places(
    manifest: Manifest, names: Iterable[str], name: str, fraction: float
) -> list[tuple[np.ndarray, float]]:
    """Return where transforms of several datasets were fitted, for those that share the coordinates of ``name``.

    For each: positions ``(n, p)`` of the fitting queries, and the threshold.
    """

    def frame(of: str) -> str:
        entry = manifest.dataset(of)
        return entry.coordinates or entry.root or of

    found = []
    for other in names:
        if frame(other) == frame(name):
            dataset = datasets.load(manifest, other)
            rows = fitted.split_of(dataset, fraction).fit_queries
            found.append((dataset.query.positions[rows], dataset.threshold))
    return found


def _evaluate_pair(
    manifest: Manifest, described: Described, pair: Sequence[str], names: Sequence[str], how: Fitting
) -> Evaluation:
    """Evaluate a pair of traversals under the composed transforms of datasets, at the places that none was fitted on."""
    dataset, method = described.dataset, described.method
    others = {other: describe(manifest, other, method) for other in names}
    places = fitted_places(manifest, names, dataset.name, how.fraction)

    def compute() -> dict[str, Any]:
        views = {name: fitted.sequential(manifest, others, method, name, how).composed for name in LOW_RANK}
        values, positions = [], []
        for name in pair:
            where = dataset.traversals[name].positions
            kept = np.ones(len(where), bool)
            for fitting_places, threshold in places:
                kept &= cKDTree(fitting_places).query(where)[0] > threshold
            values.append(described.descriptors[name].values[kept])
            positions.append(where[kept])
        return {"views": evaluate(*values, *positions, dataset.threshold, views=views, seed=how.seed, draws=0, depth=1)}

    key = fitted.key_of("irrelevant pair", [described, *others.values()], [list(pair), names, places, *astuple(how)])
    record = {"dataset": dataset.name, "datasets": list(names), "method": method, "stage": "irrelevant pair"}
    return stored(manifest, key, compute, record)["views"]


FEW_ITERATIONS = (1, 5)
"""Numbers of iterations of INLP that Table IV shows beside the one asked for."""


def by_iterations(
    manifest: Manifest, names: Sequence[str], methods: Sequence[str], *, k: int = 1, **fitting: Any
) -> pd.DataFrame:
    """Summarise Table IV for INLP of :data:`FEW_ITERATIONS` and as many as :class:`Fitting` says, a row each.

    On small regions 35 iterations remove as many directions as there are images to fit on: all that the images span.
    """
    how, tables = Fitting(**fitting), []
    for number in sorted({*FEW_ITERATIONS, how.iterations}):
        options = {**fitting, "iterations": number}
        study = single_against_multi(manifest, names, methods, k=k, suppressors=["INLP"], **options)
        tables.append(study.table.assign(iterations=number))
    return summary(pd.concat(tables, ignore_index=True), ["suppression", "iterations"])


def summary(table: pd.DataFrame, by: Sequence[str], *, ddof: int = 1) -> pd.DataFrame:
    """Summarise differences as Tables IV and V do: mean ± standard deviation, and the number within 1 pp.

    Parameters
    ----------
    table
        As from :func:`single_against_multi` or :func:`irrelevant_conditions`.
    by
        Columns to group by: a row each, with ``pairs``, and for DAR and R ``mean``, ``std`` and ``within`` columns.
    ddof
        Of the standard deviation; the paper does not say which, 1 is that of a sample.
    """
    rows = []
    for keys, part in table.groupby(list(by), sort=False):
        row = dict(zip(by, keys, strict=True)) | {"pairs": len(part)}
        for metric in ("DAR", "R"):
            values = part[f"difference_{metric}"]
            row |= {f"mean_{metric}": values.mean(), f"std_{metric}": values.std(ddof=ddof)}
            row[f"within_{metric}"] = int((np.abs(values) <= WITHIN_PP + 1e-9).sum())
        rows.append(row)
    return pd.DataFrame(rows)
