"""Verdicts: every number that the paper prints beside the number that was measured on the same dataset with the same method.

``equal``
    The same number of queries, or equal after rounding to the digits that the paper prints.
``agrees``
    Not equal, but the reported value lies in the 95 % interval of the measured one and within 1 percentage point of it
    (counts of pairs: within 1 pair).
``differs``
    Outside both.
``cannot tell``
    Anything else; the reason is given in words.

Numbers are compared at the precision that was printed. The paper's scatter plot (Fig. 5) prints R@1 and DAR@1 with two
decimals, from which the number of queries follows; its Table III prints RSR@1 with three significant digits.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
import pandas as pd

from artifact.manifest import Manifest
from artifact.studies import composition, distractors, mixed_database, recall, reported, suppression
from artifact.studies.common import single_stage
from artifact.studies.reported import EVALUATED_QUERIES

Verdict = Literal["equal", "agrees", "differs", "cannot tell"]
VERDICTS: tuple[Verdict, ...] = ("equal", "agrees", "differs", "cannot tell")
CLOSE_PP = 1.0
"""Largest difference in percentage points of a value that agrees: the paper's own margin in Tables IV and V."""

DISTANCES = (25.0, 50.0, 75.0, 100.0, 150.0, 200.0)
"""Minimum distractor distances of Fig. 6b, in metres."""

RATIOS = (0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1)
"""Distractor-to-query ratios of Fig. 6a."""

FRACTIONS = (0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5)
"""Query fitting fractions of Fig. 10."""

COLUMNS = ("where", "dataset", "method", "quantity", "reported", "measured", "low", "high", "verdict", "why")


class Judged(NamedTuple):
    """A verdict and the reason for it, in words."""

    verdict: Verdict
    why: str


def judge(
    measured: float,
    expected: float,
    *,
    digits: int,
    low: float = math.nan,
    high: float = math.nan,
    hits: tuple[int, int] | None = None,
    expected_queries: int | None = None,
    margin: float = CLOSE_PP,
    unit: str = "pp",
) -> Judged:
    """Compare a measured number with the reported one.

    Parameters
    ----------
    measured, expected
        In the same unit: percent, percentage points or a count.
    digits
        Decimals that the paper prints.
    low, high
        The 95 % interval of the measured number.
    hits
        Measured number of successes and of queries, where the number is a share of queries.
    expected_queries
        Number of queries that the paper evaluates.
    margin, unit
        Largest difference of a value that agrees.

    Raises
    ------
    ValueError
        If the paper's number is missing.

    Examples
    --------
    >>> judge(95.924, 95.92, digits=2, hits=(5743, 5987), expected_queries=5987)
    Judged(verdict='equal', why='5743 of 5987 queries in both')
    >>> judge(95.1, 95.92, digits=2, low=94.5, high=96.0).verdict
    'agrees'
    >>> judge(80.0, 95.92, digits=2, low=78.0, high=82.0).verdict
    'differs'
    """
    if math.isnan(expected):
        raise ValueError("the paper's number is missing: only numbers that it prints can be compared")
    if math.isnan(measured):
        return Judged("cannot tell", "nothing was measured")
    half = 0.5 * 10.0**-digits
    if hits is not None and hits[1] == expected_queries and abs(hits[0] - round(expected * hits[1] / 100)) < 1:
        return Judged("equal", f"{hits[0]} of {hits[1]} queries in both")
    if abs(measured - expected) <= half * (1 + 1e-9) + 1e-9:
        return Judged("equal", f"the same to {digits} decimals" if digits else "the same number")
    inside, close = low <= expected <= high, abs(measured - expected) <= margin + 1e-9
    shown = f"{margin:g} {unit}"
    if inside and close:
        return Judged("agrees", f"in the 95 % interval and within {shown}")
    if not inside and not close and not math.isnan(low):
        return Judged("differs", f"outside the 95 % interval, and more than {shown} away")
    if math.isnan(low):
        return Judged("cannot tell", "no interval could be measured")
    if inside:
        return Judged("cannot tell", f"in the 95 % interval, which is wider than {shown}")
    return Judged("cannot tell", f"within {shown}, but outside the 95 % interval")


def printed_digits(percent: float) -> int:
    """Return the decimals with which the paper prints a percentage: three significant digits, two decimals at most."""
    return 2 if abs(percent) < 9.995 else 1 if abs(percent) < 99.95 else 0


def _row(where: str, dataset: str, method: str, quantity: str, expected: float, measured: float, **facts: Any) -> dict:
    judged = judge(measured, expected, **facts)
    text = f"{expected:.{facts['digits']}f}"
    return dict(
        zip(
            COLUMNS,
            (where, dataset, method, quantity, text, measured, facts.get("low"), facts.get("high"), *judged),
            strict=True,
        )
    )


def _frame(rows: Iterator[dict]) -> pd.DataFrame:
    return pd.DataFrame(list(rows), columns=list(COLUMNS))


# -- shares of queries: Tables III, Figs. 2, 5, 6, 7, 9 -----------------------------------------------------


def of_recall(table: pd.DataFrame) -> pd.DataFrame:
    """Compare Table III and Fig. 5, cell by cell, and their means where everything that enters them was measured.

    Parameters
    ----------
    table
        As from :func:`artifact.studies.recall.recall_table` for K = 1.
    """
    return _frame(_recall_rows(table))


def _recall_rows(table: pd.DataFrame) -> Iterator[dict]:
    for row in table.to_dict("records"):
        name, same = row["reported_as"], []
        for metric in ("R", "DAR", "RSR"):
            expected = row[f"reported_{metric}"]
            if pd.isna(expected):
                continue
            facts: dict[str, Any] = {"low": row[f"{metric}_low"], "high": row[f"{metric}_high"]}
            if metric == "RSR":
                facts["digits"] = printed_digits(expected)
            else:
                facts |= {"digits": 2, "hits": (row[f"hits_{metric}"], row["queries"])}
                facts["expected_queries"] = EVALUATED_QUERIES[name]
            where = "Table III" if metric == "RSR" else "Table III, Fig. 5"
            cell = _row(where, row["title"], row["method"], f"{metric}@1 %", expected, row[metric], **facts)
            same.append(cell["why"].endswith("queries in both"))
            if metric == "RSR" and same[:2] == [True, True]:
                # The paper's quotient of printed values may round to another last digit than that of the counts.
                cell |= {"verdict": "equal", "why": "the quotient of the same numbers of queries"}
            yield cell
    known = table[table["reported_R"].notna()]
    for name, part in known.groupby("reported_as", sort=False):
        row = part.iloc[0]
        judged = of_evaluated(int(row["listed"]), int(row["queries"]), str(name))
        expected = str(EVALUATED_QUERIES[str(name)])
        values = ("Table I", row["title"], "all", "evaluated queries", expected, row["queries"], math.nan, math.nan)
        yield dict(zip(COLUMNS, (*values, *judged), strict=True))
    yield from _mean_over_datasets(known)
    yield from _mean_over_methods(known)


def _mean_over_datasets(known: pd.DataFrame) -> Iterator[dict]:
    """Compare the column *Mean* of Table III for methods that were measured on all six datasets."""
    cells = reported.table("tab03").query("dataset == 'mean'").set_index(["method", "metric"])
    for method, part in known.groupby("method", sort=False):
        if set(part["reported_as"]) != set(EVALUATED_QUERIES):
            continue
        for metric in ("R", "DAR", "RSR"):
            expected = cells.loc[(method, f"{metric}@1"), "percent"]
            low, high = _interval_of_mean(part, metric)
            facts = {"digits": printed_digits(expected), "low": low, "high": high}
            yield _row("Table III", "Mean", str(method), f"{metric}@1 %", expected, part[metric].mean(), **facts)


def _mean_over_methods(known: pd.DataFrame) -> Iterator[dict]:
    """Compare the dotted lines of Fig. 5 for datasets on which all eleven methods were measured."""
    lines = reported.table("fig05_means").set_index("dataset")
    for dataset, part in known.groupby("reported_as", sort=False):
        if set(part["method"]) != set(reported.method_titles()):
            continue
        for metric, column in (("R", "recall_percent"), ("DAR", "dar_percent")):
            low, high = _interval_of_mean(part, metric)
            facts = {"digits": 2, "low": low, "high": high}
            title = part["title"].iloc[0]
            expected = lines.loc[dataset, column]
            yield _row("Fig. 5", title, "Mean", f"{metric}@1 %", expected, part[metric].mean(), **facts)


def _interval_of_mean(part: pd.DataFrame, metric: str) -> tuple[float, float]:
    """Interval of a mean of independent values, from theirs."""
    value = part[metric].mean()
    below = np.sqrt(((part[metric] - part[f"{metric}_low"]) ** 2).sum()) / len(part)
    above = np.sqrt(((part[f"{metric}_high"] - part[metric]) ** 2).sum()) / len(part)
    return value - below, value + above


def of_curve(table: pd.DataFrame, where: str, dataset: str, x: str, unit: str = "") -> pd.DataFrame:
    """Compare curves of DAR@1: Figs. 6 and 7.

    Parameters
    ----------
    table
        Columns ``method``, ``x``, ``DAR``, ``low``, ``high`` and ``reported``, in percent.
    where, dataset
        Printed names of the figure and dataset.
    x, unit
        Column of the abscissa, and its unit.
    """

    def rows() -> Iterator[dict]:
        for row in table[table["reported"].notna()].to_dict("records"):
            at = row[x] if isinstance(row[x], str) else f"{row[x]:g}".replace("inf", "∞")
            quantity = f"DAR@1 % at {x} {at}{unit}"
            facts: dict[str, Any] = {"digits": 2, "low": row["low"], "high": row["high"]}
            if "hits" in row:
                facts |= {"hits": (row["hits"], row["queries"]), "expected_queries": EVALUATED_QUERIES["robotcar"]}
            yield _row(where, dataset, row["method"], quantity, row["reported"], row["DAR"], **facts)

    return _frame(rows())


def of_mixed_database(table: pd.DataFrame, where: str, dataset: str) -> pd.DataFrame:
    """Compare R@1 in the corners of the maps: Figs. 2 and 9.

    Parameters
    ----------
    table
        Columns ``method``, ``evaluation``, ``R``, ``low``, ``high`` and ``reported``, in percent.
    where, dataset
        Printed names of the figure and dataset.
    """
    return _frame(
        _row(
            where,
            dataset,
            row["method"],
            f"R@1 %, {row['evaluation']}",
            row["reported"],
            row["R"],
            digits=1,
            low=row["low"],
            high=row["high"],
        )
        for row in table[table["reported"].notna()].to_dict("records")
    )


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


# -- over method–dataset pairs: Figs. 8 and 10, Tables IV and V ---------------------------------------------

PAIRS = 54
"""Method–dataset pairs of the paper under suppression: nine single-stage methods on six datasets."""


def of_counts(table: pd.DataFrame) -> pd.DataFrame:
    """Compare how many of the 54 pairs improve (Fig. 8), if those pairs were measured.

    Parameters
    ----------
    table
        As from :func:`artifact.studies.suppression.suppression_table`, with the column ``reported_as``.
    """
    expected = reported.table("fig08")
    names = {"probe accuracy": ("change_probe", -1), "DAR@1": ("change_DAR", 1), "R@1": ("change_R", 1)}

    def rows() -> Iterator[dict]:
        for row in expected.to_dict("records"):
            part = _paper_pairs(table[table["suppression"] == row["suppression"]])
            if len(part) == PAIRS:
                column, sign = names[row["quantity"]]
                better = (sign * part[column].to_numpy() > 1e-9).astype(float)
                quantity = f"pairs whose {row['quantity']} {'falls' if sign < 0 else 'rises'}"
                low, high = over_pairs(np.sum, better)
                facts = {"digits": 0, "low": low, "high": high, "margin": 1.0, "unit": "pair"}
                yield _row("Fig. 8", "all", str(row["suppression"]), quantity, row["improved"], better.sum(), **facts)

    return _frame(rows())


def of_equivalence(table: pd.DataFrame, *, ddof: int = 1) -> pd.DataFrame:
    """Compare Table IV, if its 54 pairs were measured.

    Parameters
    ----------
    table
        As from :func:`artifact.studies.composition.single_against_multi`, with the column ``reported_as``.
    ddof
        Of the standard deviation; the paper does not say which.
    """
    return _frame(_differences(table, reported.table("tab04"), "Table IV", PAIRS, ddof))


def of_irrelevant(table: pd.DataFrame, *, ddof: int = 1) -> pd.DataFrame:
    """Compare Table V, for pairs of conditions on which the nine methods were measured; see :func:`of_equivalence`."""
    return _frame(_differences(table, reported.table("tab05"), "Table V", PAIRS // len(EVALUATED_QUERIES), ddof))


def _differences(table: pd.DataFrame, expected: pd.DataFrame, where: str, size: int, ddof: int) -> Iterator[dict]:
    for row in expected.to_dict("records"):
        part = _paper_pairs(table[table["suppression"] == row["suppression"]])
        if "pair" in row:
            part = part[part["pair"].str.replace("–", "-") == row["pair"]]
        if len(part) != size:
            continue
        values = part[f"difference_{row['metric'].removesuffix('@1')}"].to_numpy()
        named: dict[str, tuple[Callable[..., Any], float, int, float, str]] = {
            "mean": (np.mean, row["mean_pp"], 2, CLOSE_PP, "pp"),
            "standard deviation": (lambda x, axis: np.std(x, axis=axis, ddof=ddof), row["std_pp"], 2, CLOSE_PP, "pp"),
            "pairs within 1 pp": (lambda x, axis: (np.abs(x) <= 1 + 1e-9).sum(axis), row["within_1pp"], 0, 1.0, "pair"),
        }
        for what, (statistic, printed, digits, margin, unit) in named.items():
            low, high = over_pairs(statistic, values)
            measured = float(statistic(values, axis=0))
            label = f"{row['suppression']} {row.get('pair', '')}".strip()
            facts = {"digits": digits, "low": low, "high": high, "margin": margin, "unit": unit}
            yield _row(where, "all", label, f"Δ{row['metric']}, {what}", printed, measured, **facts)


def of_fractions(table: pd.DataFrame) -> pd.DataFrame:
    """Compare the curves of Fig. 10, if their 54 pairs were measured.

    Parameters
    ----------
    table
        As from :func:`artifact.studies.suppression.fitting_fraction`, with the column ``reported_as``.
    """

    def rows() -> Iterator[dict]:
        for row in reported.table("fig10").to_dict("records"):
            chosen = (table["suppression"] == row["suppression"]) & np.isclose(
                table["fraction"], row["fitting_fraction"]
            )
            part = _paper_pairs(table[chosen])
            if len(part) != PAIRS:
                continue
            values = part[f"change_{row['metric'].removesuffix('@1')}"].to_numpy()
            low, high = over_pairs(np.mean, values)
            quantity = f"Δ{row['metric']} at {row['fitting_fraction']:g}"
            facts = {"digits": 3, "low": low, "high": high}
            yield _row("Fig. 10", "all", str(row["suppression"]), quantity, row["change_pp"], values.mean(), **facts)

    return _frame(rows())


def _paper_pairs(table: pd.DataFrame) -> pd.DataFrame:
    """Rows of the paper's datasets and methods."""
    return table[table["reported_as"].isin(list(EVALUATED_QUERIES)) & table["method"].isin(reported.method_titles())]


def over_pairs(
    statistic: Callable[..., Any], values: np.ndarray, *, count: int = 2000, seed: int = 0
) -> tuple[float, float]:
    """Return the 95 % bootstrap interval of a statistic over method–dataset pairs.

    Parameters
    ----------
    statistic
        Function of an array and an ``axis``.
    values
        ``(n,)``, one value for each pair.
    count, seed
        Number of resamples and their seed.
    """
    rows = np.random.default_rng(seed).integers(0, len(values), (count, len(values)))
    low, high = np.quantile(statistic(values[rows], axis=1), [0.025, 0.975])
    return float(low), float(high)


def tally(tables: Sequence[pd.DataFrame]) -> dict[Verdict, int]:
    """Count the verdicts of several comparisons."""
    found = [verdict for table in tables for verdict in table["verdict"]]
    return {verdict: found.count(verdict) for verdict in VERDICTS}


def of_profile(manifest: Manifest, names: Sequence[str], methods: Sequence[str], *, seed: int = 0) -> pd.DataFrame:
    """Compare every number of the paper that datasets and methods of a run can be compared with.

    Parameters
    ----------
    names, methods
        Datasets that are at hand and are the paper's, and methods of the paper.
    """
    if not names:
        return _frame(iter(()))
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
    title = manifest.dataset(name).title
    threshold = manifest.dataset(name).threshold.value
    distances = [threshold, *(d for d in DISTANCES if d > threshold), math.inf]
    number = distractors.distractor_number(manifest, name, methods, RATIOS, seed=seed).table
    distance = distractors.distractor_distance(manifest, name, methods, distances, seed=seed).table
    found = [
        of_curve(number, "Fig. 6a", title, "ratio"),
        of_curve(distance, "Fig. 6b", title, "distance", " m"),
        of_curve(
            distractors.distractor_condition(manifest, name, methods, seed=seed).table, "Fig. 7", title, "condition"
        ),
    ]
    shown = [method for method in ("anyloc", "eigenplaces") if method in methods]
    for figure, study in (
        ("fig02", mixed_database.mixed_database),
        ("fig09", mixed_database.mixed_database_suppressed),
    ):
        maps = {method: study(manifest, name, method, seed=seed) for method in shown}
        table = mixed_database.mixed_recall(manifest, name, maps, figure, seed=seed)
        found.append(of_mixed_database(table, f"Fig. {int(figure[3:])}", title))
    return found
