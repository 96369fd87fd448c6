"""Tables IV and V: transforms of several datasets in one."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from artifact import datasets
from artifact.extraction.described import Described, describe
from artifact.manifest import Manifest
from artifact.metrics.evaluate import evaluate
from artifact.metrics.evaluation import Evaluation
from artifact.studies import fitted, reported
from artifact.studies.common import PERCENT, Study, single_stage
from artifact.studies.fitted import LOW_RANK

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
    fraction: float = 0.1,
    iterations: int = 35,
    k: int = 1,
    seed: int = 0,
) -> Study:
    """Table IV: one transform per dataset against the composition of all of them.

    Returns
    -------
    Study
        One row per suppression method, dataset and method: ``suppression``, ``dataset``, ``title``, ``method``,
        ``single_R``, ``single_DAR``, ``multi_R``, ``multi_DAR`` in percent, and ``difference_R``, ``difference_DAR``
        (single minus multi) in percentage points.
    """
    rows, inputs = [], []
    for method in single_stage(manifest, methods):
        for suppressor in LOW_RANK:
            erasure, described = fitted.sequential(
                manifest, names, method, suppressor, fraction=fraction, iterations=iterations, seed=seed
            )
            for name, one in described.items():
                region = fitted.split_of(one.dataset, fraction)
                views = {"single": erasure.single[name], "multi": erasure.composed}
                found = fitted.evaluate_region(one, region, views, seed=seed)
                row: dict[str, Any] = {
                    "suppression": suppressor,
                    "dataset": name,
                    "reported_as": manifest.dataset(name).reported_as,
                    "title": one.dataset.title,
                    "method": method,
                }
                for view in views:
                    row |= {f"{view}_R": PERCENT * found[view].recall(k), f"{view}_DAR": PERCENT * found[view].dar(k)}
                row["queries"] = found["single"].n_queries
                row |= {
                    f"difference_{metric}": row[f"single_{metric}"] - row[f"multi_{metric}"] for metric in ("R", "DAR")
                }
                rows.append(row)
                inputs += one.inputs
    return Study(pd.DataFrame(rows), tuple(inputs))


def irrelevant_conditions(
    manifest: Manifest,
    names: Sequence[str],
    methods: Iterable[str],
    *,
    fraction: float = 0.1,
    iterations: int = 35,
    k: int = 1,
    seed: int = 0,
) -> Study:
    """Table V: the composed transform on condition pairs that it was not fitted on.

    The pairs are the ``irrelevant_pairs`` of the datasets in the manifest. A dataset that is fitted on the pair itself
    leaves the composition, and the places of every region that an applied transform was fitted on stay out.

    Returns
    -------
    Study
        One row per suppression method, pair and method: ``suppression``, ``pair`` (conditions), ``dataset``,
        ``method``, ``original_R``, ``original_DAR``, ``erased_R``, ``erased_DAR`` in percent, ``difference_R`` and
        ``difference_DAR`` (original minus erased) in percentage points.
    """
    rows, inputs = [], []
    for method in single_stage(manifest, methods):
        for name in names:
            entry = manifest.dataset(name)
            for query, database in entry.irrelevant_pairs:
                chosen = [other for other in names if not _is_pair(manifest, other, name, query, database)]
                erasures = {
                    suppressor: fitted.sequential(
                        manifest, chosen, method, suppressor, fraction=fraction, iterations=iterations, seed=seed
                    )[0].composed
                    for suppressor in LOW_RANK
                }
                described = describe(manifest, name, method, [query, database])
                places = fitted_places(manifest, chosen, name, fraction)
                result = _evaluate_pair(described, query, database, places, erasures, seed)
                conditions = [entry.traversals[traversal].condition for traversal in (query, database)]
                pair = "–".join(conditions) if len(set(conditions)) > 1 else f"{query}–{database}"
                for suppressor in LOW_RANK:
                    before, after = result, result[suppressor]
                    row: dict[str, Any] = {
                        "suppression": suppressor,
                        "pair": pair,
                        "dataset": name,
                        "reported_as": entry.reported_as,
                        "title": entry.title,
                        "method": method,
                        "queries": before.n_queries,
                    }
                    row |= {"original_R": PERCENT * before.recall(k), "original_DAR": PERCENT * before.dar(k)}
                    row |= {"erased_R": PERCENT * after.recall(k), "erased_DAR": PERCENT * after.dar(k)}
                    row |= {f"difference_{m}": row[f"original_{m}"] - row[f"erased_{m}"] for m in ("R", "DAR")}
                    rows.append(row)
                inputs += described.inputs
    return Study(pd.DataFrame(rows), tuple(inputs))


def _is_pair(manifest: Manifest, other: str, name: str, query: str, database: str) -> bool:
    """Whether a dataset is fitted on just this pair of traversals."""
    entry = manifest.dataset(other)
    same = (entry.root or other) == (manifest.dataset(name).root or name)
    return same and {entry.query, entry.database} == {query, database}


def fitted_places(
    manifest: Manifest, names: Iterable[str], name: str, fraction: float
) -> list[tuple[np.ndarray, float]]:
    """Return the places that transforms of several datasets were fitted on, in the coordinates of one dataset.

    Returns
    -------
    list
        Positions ``(n, p)`` of the fitting queries of each dataset that shares these coordinates, with its threshold.
    """

    def frame(of: str) -> str:
        entry = manifest.dataset(of)
        return entry.coordinates or entry.root or of

    shared = [other for other in names if frame(other) == frame(name)]
    found = []
    for other in shared:
        dataset = datasets.load(manifest, other)
        rows = fitted.split_of(dataset, fraction).fit_queries
        found.append((dataset.query.positions[rows], dataset.threshold))
    return found


def _evaluate_pair(
    described: Described,
    query: str,
    database: str,
    places: Sequence[tuple[np.ndarray, float]],
    views: dict[str, Any],
    seed: int,
) -> Evaluation:
    """Evaluate a pair of traversals at the places that no transform was fitted on."""
    values, positions = [], []
    for name in (query, database):
        where = described.dataset.traversals[name].positions
        kept = np.ones(len(where), bool)
        for fitting_places, threshold in places:
            kept &= cKDTree(fitting_places).query(where)[0] > threshold
        values.append(described.descriptors[name].values[kept])
        positions.append(where[kept])
    return evaluate(*values, *positions, described.dataset.threshold, views=views, seed=seed)


def summary(table: pd.DataFrame, by: Sequence[str], *, ddof: int = 1) -> pd.DataFrame:
    """Summarise differences as Tables IV and V do: mean ± standard deviation, and the number within 1 pp.

    Parameters
    ----------
    table
        As from :func:`single_against_multi` or :func:`irrelevant_conditions`.
    by
        Columns to group by.
    ddof
        Of the standard deviation; the paper does not say which, 1 is that of a sample.

    Returns
    -------
    pandas.DataFrame
        One row per group: ``by``, ``pairs``, and for DAR and R ``mean``, ``std`` and ``within`` columns.
    """
    rows = []
    for keys, part in table.groupby(list(by), sort=False):
        row = dict(zip(by, keys, strict=True)) | {"pairs": len(part)}
        for metric in ("DAR", "R"):
            values = part[f"difference_{metric}"]
            row |= {
                f"mean_{metric}": values.mean(),
                f"std_{metric}": values.std(ddof=ddof),
                f"within_{metric}": int((np.abs(values) <= WITHIN_PP + 1e-9).sum()),
            }
        rows.append(row)
    return pd.DataFrame(rows)
