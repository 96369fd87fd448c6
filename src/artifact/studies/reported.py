"""What the paper reports: every number of its tables and plotted curves.

The numbers were transcribed once, as printed, into tidy CSV files in ``paper/``; the tests hold them against
each other (RSR = DAR / R, means, ranks, curve ends equal to table cells, percentages that are whole numbers of
queries). Nothing here is ever mixed with a measurement without a label.
"""

from __future__ import annotations

from importlib.resources import files

import pandas as pd

from artifact.manifest import Manifest
from artifact.manifest.entries import ManifestError, quoted

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


def table(name: str) -> pd.DataFrame:
    """Return one table or curve of the paper, a key of :data:`TABLES`, as a tidy frame; another name is a ``KeyError``.

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
    return table("tab02").set_index("method")["title"].to_dict()


def dataset_titles() -> dict[str, str]:
    """Return the printed title of each of the paper's datasets, in the order of its tables."""
    return table("tab01").set_index("dataset")["title"].to_dict()


def recall_table() -> pd.DataFrame:
    """Return Table III as one row per dataset and method with ``R@1``, ``DAR@1``, ``RSR@1`` in percent.

    R@1 and DAR@1 have the two decimals of the scatter plot (Fig. 5); the means have those of the table.
    """
    wide = table("tab03").pivot(index=["dataset", "method"], columns="metric", values="percent")
    exact = table("fig05").set_index(["dataset", "method"])
    wide.loc[exact.index, ["R@1", "DAR@1"]] = exact[["recall_percent", "dar_percent"]].to_numpy()
    return wide[["R@1", "DAR@1", "RSR@1"]].reset_index().rename_axis(columns=None)


def require(manifest: Manifest, profile: str) -> None:
    """Check that every number exists that a profile's results will be compared with.

    Raises
    ------
    ManifestError
        If a dataset names one that the paper does not have, or the paper has no number for a method of the profile.
    """
    entry, known = manifest.profile(profile), set(table("fig05").set_index(["dataset", "method"]).index)
    for name in entry.datasets:
        standing_for = manifest.dataset(name).reported_as
        if standing_for is None:
            continue
        if standing_for not in EVALUATED_QUERIES:
            raise ManifestError(
                f"{manifest.path}: datasets.{name}.reported_as is {standing_for!r}; allowed: {quoted(EVALUATED_QUERIES)}"
            )
        for method in entry.methods:
            if manifest.method(method).kind == "paper" and (standing_for, method) not in known:
                found = f"the paper reports nothing for the method {method!r} on {standing_for}"
                allowed = f"a method of kind 'paper' is one of {quoted(method_titles())}"
                raise ManifestError(f"{manifest.path}: {found}; {allowed}")
