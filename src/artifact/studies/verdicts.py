"""Every number that the paper prints beside the number measured on the same dataset with the same method."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import numpy as np
import pandas as pd

from artifact.manifest import Manifest
from artifact.studies import composition, distractors, mixed_database, recall, reported, suppression
from artifact.studies.common import METRICS, single_stage
from artifact.studies.judging import VERDICTS, Judged, Verdict, judge, printed_digits
from artifact.studies.reported import EVALUATED_QUERIES

DISTANCES = (25.0, 50.0, 75.0, 100.0, 150.0, 200.0)
"""Minimum distractor distances of Fig. 6b, in metres."""

RATIOS = (0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1)
"""Distractor-to-query ratios of Fig. 6a."""

FRACTIONS = (0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5)
"""Query fitting fractions of Fig. 10."""

PAIRS = 54
"""Method–dataset pairs of the paper under suppression: nine single-stage methods on six datasets."""

COLUMNS = ("where", "dataset", "method", "quantity", "reported", "measured", "low", "high", "verdict", "why")

_Names = tuple[str, str, str, str]  # place in the paper, dataset, method and quantity


def _row(
    names: _Names, expected: float, digits: int, measured: float, low: float, high: float, **facts: Any
) -> dict[str, Any]:
    judged = judge(measured, expected, digits=digits, low=low, high=high, **facts)
    return dict(zip(COLUMNS, (*names, f"{expected:.{digits}f}", measured, low, high, *judged), strict=True))


def _frame(rows: Iterable[dict[str, Any]]) -> pd.DataFrame:
    return pd.DataFrame(list(rows), columns=list(COLUMNS))


# -- shares of queries: Table III, Figs. 2, 5, 6, 7, 9 ------------------------------------------------------


def of_recall(table: pd.DataFrame) -> pd.DataFrame:
    """Compare Table III and Fig. 5, cell by cell, and their means where everything that enters them was measured.

    The table is :func:`artifact.studies.recall.recall_table` for K = 1.
    """
    known = table[table["reported_R"].notna()]
    cells = [cell for row in known.to_dict("records") for cell in _recall_cells(row)]
    for row in known.drop_duplicates("reported_as").to_dict("records"):
        judged = of_evaluated(row["listed"], row["queries"], row["reported_as"])
        expected = str(EVALUATED_QUERIES[row["reported_as"]])
        facts = ("Table I", row["title"], "all", "evaluated queries", expected, row["queries"], math.nan, math.nan)
        cells.append(dict(zip(COLUMNS, (*facts, *judged), strict=True)))
    return _frame([*cells, *_recall_means(known)])


def _recall_cells(row: dict[str, Any]) -> list[dict[str, Any]]:
    cells = []
    for metric in METRICS:
        expected, facts = row[f"reported_{metric}"], {}
        where, digits = "Table III", printed_digits(expected)
        if metric != "RSR":
            where, digits = "Table III, Fig. 5", 2
            facts["hits"] = row[f"hits_{metric}"], row["queries"]
            facts["expected_queries"] = EVALUATED_QUERIES[row["reported_as"]]
        names = where, row["title"], row["method"], f"{metric}@1 %"
        bounds = row[f"{metric}_low"], row[f"{metric}_high"]
        cells.append(_row(names, expected, digits, row[metric], *bounds, **facts))
    if all(cell["why"].endswith("queries in both") for cell in cells[:2]):
        # The paper's quotient of printed values may round to another last digit than that of the counts.
        cells[2] |= {"verdict": "equal", "why": "the quotient of the same numbers of queries"}
    return cells


def of_evaluated(listed: int, evaluated: int, dataset: str) -> Judged:
    """Compare the number of evaluated queries of one of the paper's datasets, given the number of its queries.

    The same images have the same positives: with the paper's list of queries, another number of evaluated ones is a
    difference of the protocol. With another list nothing follows.
    """
    counts = reported.table("tab01").set_index("dataset").loc[dataset]
    expected = EVALUATED_QUERIES[dataset]
    if evaluated == expected:
        return Judged("equal", f"{expected} evaluated queries in both")
    if listed == counts["queries"]:
        return Judged("differs", f"{evaluated} of {listed} queries have a positive, in the paper {expected}")
    return Judged("cannot tell", f"{listed} queries are listed, in the paper {counts['queries']}")


def _recall_means(known: pd.DataFrame) -> Iterator[dict[str, Any]]:
    """Column *Mean* of Table III, for methods on all datasets; lines of Fig. 5, for datasets with all methods."""
    cells = reported.table("tab03").query("dataset == 'mean'").set_index(["method", "metric"])["percent"]
    for method, part in known.groupby("method", sort=False):
        if set(part["reported_as"]) == set(EVALUATED_QUERIES):
            for metric in METRICS:
                expected = cells[method, f"{metric}@1"]
                names = "Table III", "Mean", str(method), f"{metric}@1 %"
                yield _row(names, expected, printed_digits(expected), *_mean(part, metric))
    lines = reported.table("fig05_means").set_index("dataset")
    for dataset, part in known.groupby("reported_as", sort=False):
        if set(part["method"]) == set(reported.method_titles()):
            for metric, column in (("R", "recall_percent"), ("DAR", "dar_percent")):
                names = "Fig. 5", part["title"].iloc[0], "Mean", f"{metric}@1 %"
                yield _row(names, lines.loc[dataset, column], 2, *_mean(part, metric))


def _mean(part: pd.DataFrame, metric: str) -> tuple[float, float, float]:
    """A mean of independent values, and its interval, which follows from theirs."""
    values, low, high = part[metric], part[f"{metric}_low"], part[f"{metric}_high"]
    below, above = (np.sqrt((gap**2).sum()) / len(part) for gap in (values - low, high - values))
    return values.mean(), values.mean() - below, values.mean() + above


def of_curve(table: pd.DataFrame, where: str, dataset: str, x: str, unit: str = "") -> pd.DataFrame:
    """Compare curves of :mod:`artifact.studies.distractors` over the column ``x`` in a unit: Figs. 6 and 7.

    ``where`` and ``dataset`` are the printed names of the figure and the dataset.
    """
    rows = []
    for row in table[table["reported"].notna()].to_dict("records"):
        at = row[x] if isinstance(row[x], str) else f"{row[x]:g}".replace("inf", "∞")
        facts: dict[str, Any] = {}
        if not math.isnan(row.get("hits", math.nan)):
            facts = {"hits": (int(row["hits"]), row["queries"]), "expected_queries": EVALUATED_QUERIES["robotcar"]}
        names = where, dataset, row["method"], f"DAR@1 % at {x} {at}{unit}"
        rows.append(_row(names, row["reported"], 2, row["DAR"], row["low"], row["high"], **facts))
    return _frame(rows)


def of_mixed_database(table: pd.DataFrame, where: str, dataset: str) -> pd.DataFrame:
    """Compare R@1 in the corners of the maps, :func:`artifact.studies.mixed_database.mixed_recall`: Figs. 2 and 9."""
    rows = []
    for row in table[table["reported"].notna()].to_dict("records"):
        names = where, dataset, row["method"], f"R@1 %, {row['evaluation']}"
        rows.append(_row(names, row["reported"], 1, row["R"], row["low"], row["high"]))
    return _frame(rows)


# -- over method–dataset pairs: Figs. 8 and 10, Tables IV and V ---------------------------------------------


# What the paper prints of pairs: the name of a number, how it is computed, its column there, and its decimals.
_Statistic = tuple[str, Callable[..., Any], str, int]
_COUNTS: list[_Statistic] = [
    ("pairs whose {metric} {direction}", lambda changes, axis: (changes > 1e-9).sum(axis), "improved", 0)
]
_DIFFERENCES: list[_Statistic] = [
    ("Δ{metric}, mean", np.mean, "mean_pp", 2),
    ("Δ{metric}, standard deviation", functools.partial(np.std, ddof=1), "std_pp", 2),
    ("Δ{metric}, pairs within 1 pp", lambda gaps, axis: (np.abs(gaps) <= 1 + 1e-9).sum(axis), "within_1pp", 0),
]
_MEAN_CHANGE: list[_Statistic] = [("Δ{metric} at {fitting_fraction:g}", np.mean, "change_pp", 3)]


def of_counts(table: pd.DataFrame) -> pd.DataFrame:
    """Compare how many of the 54 pairs of :func:`artifact.studies.suppression.suppression_table` improve (Fig. 8)."""
    printed = reported.table("fig08").rename(columns={"quantity": "metric"})
    # The probe improves where it falls.
    printed["direction"] = np.where(printed["metric"] == "probe accuracy", "falls", "rises")
    return _of_pairs(table.assign(change_probe=-table["change_probe"]), printed, "Fig. 8", "change", _COUNTS)


def of_equivalence(table: pd.DataFrame) -> pd.DataFrame:
    """Compare Table IV, if its 54 pairs are in :func:`artifact.studies.composition.single_against_multi`."""
    return _of_pairs(table, reported.table("tab04"), "Table IV", "difference", _DIFFERENCES)


def of_irrelevant(table: pd.DataFrame) -> pd.DataFrame:
    """Compare Table V with :func:`artifact.studies.composition.irrelevant_conditions`, where all nine methods are."""
    nine = PAIRS // len(EVALUATED_QUERIES)
    return _of_pairs(table, reported.table("tab05"), "Table V", "difference", _DIFFERENCES, nine)


def of_fractions(table: pd.DataFrame) -> pd.DataFrame:
    """Compare the curves of Fig. 10, if its 54 pairs are in :func:`artifact.studies.suppression.fitting_fraction`."""
    return _of_pairs(table, reported.table("fig10"), "Fig. 10", "change", _MEAN_CHANGE)


def _of_pairs(
    table: pd.DataFrame, printed: pd.DataFrame, where: str, value: str, statistics: list[_Statistic], size: int = PAIRS
) -> pd.DataFrame:
    """Compare each printed row with the statistics of the paper's pairs, if as many as it has were measured."""
    table = table[table["reported_as"].isin(list(EVALUATED_QUERIES)) & table["method"].isin(reported.method_titles())]
    rows = []
    for row in printed.to_dict("records"):
        chosen = table["suppression"] == row["suppression"]
        if "pair" in row:
            chosen &= table["pair"].str.replace("–", "-") == row["pair"]
        if "fitting_fraction" in row:
            chosen &= np.isclose(table["fraction"], row["fitting_fraction"])
        if chosen.sum() != size:
            continue
        metric = row["metric"].removesuffix("@1").removesuffix(" accuracy")
        values = table.loc[chosen, f"{value}_{metric}"].to_numpy()
        label = f"{row['suppression']} {row.get('pair', '')}".strip()
        for quantity, compute, column, digits in statistics:
            names, measured = (where, "all", label, quantity.format(**row)), float(compute(values, axis=0))
            facts = {} if digits else {"margin": 1.0, "unit": "pair"}
            rows.append(_row(names, row[column], digits, measured, *over_pairs(compute, values), **facts))
    return _frame(rows)


def over_pairs(statistic: Callable[..., Any], values: np.ndarray) -> tuple[float, float]:
    """Return the 95 % bootstrap interval of a statistic, a function of an array and an ``axis``, of values ``(n,)``."""
    rows = np.random.default_rng(0).integers(0, len(values), (2000, len(values)))
    low, high = np.quantile(statistic(values[rows], axis=1), [0.025, 0.975])
    return float(low), float(high)


# -- all of them --------------------------------------------------------------------------------------------


def tally(tables: Sequence[pd.DataFrame]) -> dict[Verdict, int]:
    """Count the verdicts of several comparisons."""
    found = [verdict for table in tables for verdict in table["verdict"]]
    return {verdict: found.count(verdict) for verdict in VERDICTS}


def of_profile(manifest: Manifest, names: Sequence[str], methods: Sequence[str], *, seed: int = 0) -> pd.DataFrame:
    """Compare every number of the paper that datasets at hand, all of the paper, and methods of the paper allow."""
    if not names:
        return _frame([])
    found = [of_recall(recall.recall_table(manifest, names, methods, seed=seed).table)]
    robotcar = next((name for name in names if manifest.dataset(name).reported_as == "robotcar"), None)
    if robotcar is not None:
        found += _of_robotcar(manifest, robotcar, methods, seed)
    if len(single_stage(manifest, methods)) * len(names) >= PAIRS:
        order = composition.order_of_fitting(manifest, names)
        found += [
            of_counts(suppression.suppression_table(manifest, names, methods, seed=seed).table),
            of_equivalence(composition.single_against_multi(manifest, order, methods, seed=seed).table),
            of_irrelevant(composition.irrelevant_conditions(manifest, order, methods, seed=seed).table),
            of_fractions(suppression.fitting_fraction(manifest, names, methods, FRACTIONS, seed=seed).table),
        ]
    return pd.concat([table for table in found if len(table)] or found[:1], ignore_index=True)


def _of_robotcar(manifest: Manifest, name: str, methods: Sequence[str], seed: int) -> list[pd.DataFrame]:
    """Figs. 2, 6, 7 and 9: the paper shows them for RobotCar."""
    title, threshold = manifest.dataset(name).title, manifest.dataset(name).threshold.value
    what = manifest, name, methods
    number = distractors.distractor_number(*what, RATIOS, seed=seed).table
    distances = distractors.distances_beyond(threshold, DISTANCES)
    distance = distractors.distractor_distance(*what, distances, seed=seed).table
    condition = distractors.distractor_condition(*what, seed=seed).table
    found = [
        of_curve(number, "Fig. 6a", title, "ratio"),
        of_curve(distance, "Fig. 6b", title, "distance", " m"),
        of_curve(condition, "Fig. 7", title, "condition"),
    ]
    shown = [method for method in ("anyloc", "eigenplaces") if method in methods]
    for figure, study in ((2, mixed_database.mixed_database), (9, mixed_database.mixed_database_suppressed)):
        maps = {method: study(manifest, name, method, seed=seed) for method in shown}
        table = mixed_database.mixed_recall(manifest, name, maps, f"fig{figure:02}", seed=seed)
        found.append(of_mixed_database(table, f"Fig. {figure}", title))
    return found
