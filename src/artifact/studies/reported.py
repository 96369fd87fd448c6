"""What the paper reports: every number of its tables and plotted curves, and the verdict against a measurement.

The numbers were transcribed once, as printed, into tidy CSV files in ``reported/``; the tests hold them against
each other (RSR = DAR / R, means, ranks, curve ends equal to table cells, percentages that are whole numbers of
queries). Nothing here is ever mixed with a measurement without a label.
"""

from __future__ import annotations

from importlib.resources import files
from typing import Literal

import pandas as pd

TABLES = {
    "tab01": "tab01_datasets.csv",
    "tab02": "tab02_methods.csv",
    "tab03": "tab03_recall.csv",
    "fig02": "fig02_mixed_database.csv",
    "fig05": "fig05_scatter.csv",
    "fig05_means": "fig05_means.csv",
    "fig06_number": "fig06_number.csv",
    "fig06_distance": "fig06_distance.csv",
    "fig07": "fig07_condition.csv",
    "fig08": "fig08_counts.csv",
    "fig09": "fig09_mixed_database.csv",
    "tab04": "tab04_multi_condition.csv",
    "tab05": "tab05_irrelevant_conditions.csv",
    "fig10": "fig10_fitting_fraction.csv",
}

# Queries that enter each percentage. RobotCar lists 6,021 queries, but every printed percentage is a whole number
# of 5,987: the others have no positive and are excluded.
EVALUATED_QUERIES = {
    "amstertime": 1231,
    "gardens_point": 200,
    "nordland": 27592,
    "robotcar": 5987,
    "st_lucia": 1619,
    "svox": 872,
}

Verdict = Literal["equal", "close", "different", "not comparable"]

CLOSE_PP = 1.0
"""Largest difference in percentage points that still counts as close: the paper's own margin in Tables IV and V."""


def table(name: str) -> pd.DataFrame:
    """Return one table or curve of the paper as a tidy frame.

    Parameters
    ----------
    name
        A key of :data:`TABLES`, for example ``"tab03"`` or ``"fig06_number"``.

    Raises
    ------
    KeyError
        If the paper reports nothing under that name.

    Examples
    --------
    >>> table("fig02").query("method == 'anyloc'")["recall_percent"].tolist()
    [95.9, 80.5]
    """
    if name not in TABLES:
        raise KeyError(f"the paper reports nothing under {name!r}; allowed: {', '.join(TABLES)}")
    with (files("artifact.studies") / "paper" / TABLES[name]).open(encoding="utf-8") as stream:
        return pd.read_csv(stream, keep_default_na=False, na_values=[""])


def method_titles() -> dict[str, str]:
    """Return the printed title of each of the paper's methods, in the order of its tables."""
    return dict(zip(*(table("tab02")[column] for column in ("method", "title")), strict=True))


def dataset_titles() -> dict[str, str]:
    """Return the printed title of each of the paper's datasets, in the order of its tables."""
    return dict(zip(*(table("tab01")[column] for column in ("dataset", "title")), strict=True))


def recall_table() -> pd.DataFrame:
    """Return Table III as one row per dataset and method with ``R@1``, ``DAR@1``, ``RSR@1`` in percent."""
    wide = table("tab03").pivot(index=["dataset", "method"], columns="metric", values="percent")
    return wide[["R@1", "DAR@1", "RSR@1"]].reset_index().rename_axis(columns=None)


def verdict(measured_percent: float, reported_percent: float | None, n_queries: int | None = None) -> Verdict:
    """Compare a measured percentage with the reported one.

    Parameters
    ----------
    measured_percent, reported_percent
        In percent; ``None`` or NaN where the paper has no number for this dataset and method.
    n_queries
        Number of evaluated queries: two percentages are equal when they round to the same number of queries.

    Returns
    -------
    str
        ``"equal"`` (the same number of queries, or the same to two decimals), ``"close"`` (within 1 percentage
        point), ``"different"`` or ``"not comparable"``.

    Examples
    --------
    >>> verdict(95.924, 95.92, n_queries=5987), verdict(95.1, 95.92), verdict(80.0, 95.92), verdict(80.0, None)
    ('equal', 'close', 'different', 'not comparable')
    """
    if reported_percent is None or pd.isna(reported_percent) or pd.isna(measured_percent):
        return "not comparable"
    # Half a unit of the paper's last decimal, or of one query, whichever is coarser.
    resolution = max(0.005, 50 / n_queries if n_queries else 0.0)
    difference = abs(measured_percent - reported_percent)
    if difference <= resolution:
        return "equal"
    return "close" if difference <= CLOSE_PP else "different"
