"""Fig. 8, Fig. 10 and Tables IV and V: what condition suppression changes, how much data it needs, whether it composes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import pandas as pd

from artifact import datasets as data
from artifact import paper, suppressed
from artifact.extraction.described import Described, describe
from artifact.manifest import Manifest
from artifact.metrics.evaluate import evaluate
from artifact.metrics.evaluation import Evaluation
from artifact.pipeline import Measured
from artifact.ranking.one_pass import ORIGINAL
from artifact.studies.common import PERCENT, Study, origin
from artifact.suppressed import LOW_RANK, METHODS

WITHIN_PP = 1.0
"""Difference that Tables IV and V count as equal, in percentage points."""


def suppression_table(
    manifest: Manifest,
    names: Iterable[str],
    methods: Iterable[str],
    *,
    fraction: float = 0.1,
    iterations: int = 35,
    k: int = 1,
    seed: int = 0,
) -> Study:
    """Fig. 8: change of the probe's accuracy, of DAR@K and of R@K under INLP, LEACE and STD.

    Returns
    -------
    Study
        One row per dataset, method and suppression method: ``dataset``, ``title``, ``method``, ``suppression``
        (``original`` among them), ``R``, ``DAR``, ``probe`` in percent, their changes ``change_R``, ``change_DAR``,
        ``change_probe`` in percentage points, ``queries``, ``fitted_queries``, ``fitted_database``, ``origin``.
    """
    rows, inputs = [], []
    for name in names:
        title = data.entry_of(manifest, name).title
        for method in methods:
            result = suppressed.compare(manifest, name, method, fraction=fraction, iterations=iterations, seed=seed)
            before = result.evaluations[ORIGINAL]
            for suppressor, after in result.evaluations.items():
                rows.append(
                    {
                        "dataset": name,
                        "title": title,
                        "method": method,
                        "suppression": suppressor,
                        "R": PERCENT * after.recall(k),
                        "DAR": PERCENT * after.dar(k),
                        "probe": PERCENT * result.accuracies[suppressor],
                        "change_R": PERCENT * (after.recall(k) - before.recall(k)),
                        "change_DAR": PERCENT * (after.dar(k) - before.dar(k)),
                        "change_probe": PERCENT * (result.accuracies[suppressor] - result.accuracies[ORIGINAL]),
                        "queries": after.n_queries,
                        "fitted_queries": len(result.split.fit_queries),
                        "fitted_database": len(result.split.fit_database),
                        "origin": origin(_measured(result.described, before)),
                    }
                )
            inputs += result.described.inputs
    return Study(pd.DataFrame(rows), tuple(inputs))


def improved(table: pd.DataFrame) -> pd.DataFrame:
    """Count the method–dataset pairs that each suppression method improves, as the paper's text does.

    Parameters
    ----------
    table
        As from :func:`suppression_table`.

    Returns
    -------
    pandas.DataFrame
        One row per suppression method: ``suppression``, ``pairs`` and the numbers of pairs whose probe accuracy falls
        (``probe``) and whose DAR and R rise (``DAR``, ``R``); ``DAR_falls``, ``R_falls`` the other way.
    """
    changed = table[table["suppression"] != ORIGINAL]
    rows = []
    for suppressor, part in changed.groupby("suppression", sort=False):
        rows.append(
            {
                "suppression": suppressor,
                "pairs": len(part),
                "probe": int((part["change_probe"] < -1e-9).sum()),
                "DAR": int((part["change_DAR"] > 1e-9).sum()),
                "R": int((part["change_R"] > 1e-9).sum()),
                "DAR_falls": int((part["change_DAR"] < -1e-9).sum()),
                "R_falls": int((part["change_R"] < -1e-9).sum()),
            }
        )
    return pd.DataFrame(rows)


def fitting_fraction(
    manifest: Manifest,
    names: Iterable[str],
    methods: Iterable[str],
    fractions: Sequence[float],
    *,
    iterations: int = 35,
    k: int = 1,
    seed: int = 0,
) -> Study:
    """Fig. 10: change of DAR@K and R@K against the query fitting fraction, on the fixed outer half.

    Returns
    -------
    Study
        One row per dataset, method, suppression method and fraction: ``dataset``, ``title``, ``method``,
        ``suppression``, ``fraction``, ``change_R``, ``change_DAR`` in percentage points. Fraction 0 is without
        suppression. Fractions with fewer than two images of a condition are left out.
    """
    positive = sorted(fraction for fraction in fractions if fraction > 0)
    rows, inputs = [], []
    for name in names:
        title = data.entry_of(manifest, name).title
        for method in methods:
            found, described = suppressed.by_fraction(
                manifest, name, method, positive, iterations=iterations, seed=seed
            )
            before = found[ORIGINAL, 0.0]
            for suppressor in METHODS:
                for fraction in (0.0, *positive):
                    after = before if fraction == 0 else found.get((suppressor, fraction))
                    if after is None:
                        continue
                    rows.append(
                        {
                            "dataset": name,
                            "title": title,
                            "method": method,
                            "suppression": suppressor,
                            "fraction": fraction,
                            "change_R": PERCENT * (after.recall(k) - before.recall(k)),
                            "change_DAR": PERCENT * (after.dar(k) - before.dar(k)),
                        }
                    )
            inputs += described.inputs
    return Study(pd.DataFrame(rows), tuple(inputs))


def mean_by_fraction(table: pd.DataFrame) -> pd.DataFrame:
    """Average the changes over the method–dataset pairs that have every fraction.

    A pair that is too small for the smallest fraction would otherwise bend the curve where it enters.
    """
    wanted = table["fraction"].nunique()
    pairs = table.groupby(["dataset", "method", "suppression"])["fraction"].transform("nunique")
    whole = table[pairs == wanted]
    means = whole.groupby(["suppression", "fraction"], sort=False)[["change_DAR", "change_R"]]
    return means.mean().assign(pairs=means.size()).reset_index()


FITTING_ORDER = ("nordland", "amstertime", "gardens_point", "svox", "robotcar", "st_lucia")
"""Order in which the paper fits and composes the transforms of its datasets."""


def order_of_fitting(manifest: Manifest, names: Iterable[str]) -> list[str]:
    """Put datasets into the paper's order of fitting, by the dataset that each is or mirrors; others come last."""
    reported = {title.replace("StLuciaMToD", "St Lucia"): name for name, title in paper.dataset_titles().items()}

    def place(name: str) -> int:
        entry = data.entry_of(manifest, name)
        standing_for = entry.reported_as or reported.get(entry.mirrors or "")
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
    for method in methods:
        for suppressor in LOW_RANK:
            erasure, described = suppressed.sequential(
                manifest, names, method, suppressor, fraction=fraction, iterations=iterations, seed=seed
            )
            for name, one in described.items():
                region = suppressed.split_of(one, fraction)
                views = {"single": erasure.single[name], "multi": erasure.composed}
                found = suppressed.evaluate_region(one, region, views, seed=seed)
                row: dict[str, Any] = {
                    "suppression": suppressor,
                    "dataset": name,
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

    The pairs are the ``irrelevant_pairs`` of the datasets in the manifest. Queries and database images of the fitting
    region stay out.

    Returns
    -------
    Study
        One row per suppression method, pair and method: ``suppression``, ``pair`` (conditions), ``dataset``,
        ``method``, ``original_R``, ``original_DAR``, ``erased_R``, ``erased_DAR`` in percent, ``difference_R`` and
        ``difference_DAR`` (original minus erased) in percentage points.
    """
    rows, inputs = [], []
    for method in methods:
        erasures = {
            suppressor: suppressed.sequential(
                manifest, names, method, suppressor, fraction=fraction, iterations=iterations, seed=seed
            )[0].composed
            for suppressor in LOW_RANK
        }
        for name in names:
            entry = data.entry_of(manifest, name)
            for query, database in entry.irrelevant_pairs:
                described = describe(manifest, name, method, [query, database])
                result = _evaluate_pair(described, query, database, fraction, erasures, seed)
                conditions = [entry.traversals[traversal].condition for traversal in (query, database)]
                pair = "–".join(conditions) if len(set(conditions)) > 1 else f"{query}–{database}"
                for suppressor in LOW_RANK:
                    before, after = result, result[suppressor]
                    row: dict[str, Any] = {
                        "suppression": suppressor,
                        "pair": pair,
                        "dataset": name,
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


def _evaluate_pair(
    described: Described, query: str, database: str, fraction: float, views: dict[str, Any], seed: int
) -> Evaluation:  # fmt: skip
    """Evaluate another pair of traversals of a dataset outside the dataset's own fitting region."""
    from artifact.suppression.regions import split

    traversals = described.dataset.traversals
    places = traversals[query].positions, traversals[database].positions
    region = split(*places, described.dataset.threshold, fraction)
    return evaluate(
        described.descriptors[query].values[region.evaluation_queries],
        described.descriptors[database].values[region.evaluation_database],
        places[0][region.evaluation_queries], places[1][region.evaluation_database], described.dataset.threshold,
        views=views, seed=seed,
    )  # fmt: skip


def summary(table: pd.DataFrame, by: Sequence[str]) -> pd.DataFrame:
    """Summarise differences as Tables IV and V do: mean ± standard deviation, and the number within 1 pp.

    Parameters
    ----------
    table
        As from :func:`single_against_multi` or :func:`irrelevant_conditions`.
    by
        Columns to group by.

    Returns
    -------
    pandas.DataFrame
        One row per group: ``by``, ``pairs``, and for DAR and R ``mean``, ``std`` (population) and ``within`` columns.
    """
    rows = []
    for keys, part in table.groupby(list(by), sort=False):
        row = dict(zip(by, keys, strict=True)) | {"pairs": len(part)}
        for metric in ("DAR", "R"):
            values = part[f"difference_{metric}"]
            row |= {
                f"mean_{metric}": values.mean(),
                f"std_{metric}": values.std(ddof=0),
                f"within_{metric}": int((np.abs(values) <= WITHIN_PP + 1e-9).sum()),
            }
        rows.append(row)
    return pd.DataFrame(rows)


def _measured(described: Described, evaluation: Evaluation) -> Measured:
    return Measured(evaluation, described.dataset, described.method, described.inputs)
