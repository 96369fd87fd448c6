"""Verdicts as a reader sees them: every number of the paper beside the measured one."""

from __future__ import annotations

import pandas as pd
from IPython.display import HTML

from artifact.pages.common import Titles, interval, label, table, verdict
from artifact.studies import verdicts


def verdicts_table(*found: pd.DataFrame, titles: Titles) -> HTML:
    """Show comparisons with the paper, as from :mod:`artifact.studies.verdicts`, or say that there are none."""
    rows = []
    for row in (row for frame in found for row in frame.to_dict("records")):
        cells = {"Where": row["where"], "Dataset": row["dataset"], "Method": titles.get(row["method"], row["method"])}
        cells |= {"Quantity": row["quantity"], "Paper": row["reported"], "Measured": f"{row['measured']:.2f}"}
        cells["95 %"] = "–" if pd.isna(row["low"]) else interval(row["low"], row["high"])
        rows.append(cells | {"Verdict": verdict(row["verdict"], row["why"]), "Why": row["why"]})
    if not rows:
        return label(
            "No number on this page can be compared with the paper's: that takes its datasets and its methods."
        )
    counts = ", ".join(f"{count} {value}" for value, count in verdicts.tally(found).items() if count)
    return table(rows, numeric=["Paper", "Measured"], caption=f"Beside the paper: {counts}.")
