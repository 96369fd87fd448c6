"""Verdicts as a reader sees them: every number of the paper beside the measured one."""

from __future__ import annotations

from collections.abc import Mapping

import pandas as pd
from IPython.display import HTML

from artifact.pages.common import interval, markup, table, verdict
from artifact.studies import verdicts

NOTHING = "No number on this page can be compared with the paper's: that takes its datasets and its methods."


def verdicts_table(*found: pd.DataFrame, titles: Mapping[str, str]) -> HTML:
    """Show comparisons with the paper, or say that there are none.

    Parameters
    ----------
    *found
        As from :mod:`artifact.studies.verdicts`.
    titles
        Method name to printed title.
    """
    rows = [row for frame in found for row in frame.to_dict("records")]
    if not rows:
        return markup('<p class="origin">{}</p>', NOTHING)
    counts = verdicts.tally(found)
    shown = [
        {
            "Where": row["where"],
            "Dataset": row["dataset"],
            "Method": titles.get(row["method"], row["method"]),
            "Quantity": row["quantity"],
            "Paper": row["reported"],
            "Measured": f"{row['measured']:.2f}",
            "95 %": "–" if pd.isna(row["low"]) else interval(row["low"], row["high"]),
            "Verdict": verdict(row["verdict"], row["why"]),
            "Why": row["why"],
        }
        for row in rows
    ]
    caption = "Beside the paper: " + ", ".join(f"{count} {value}" for value, count in counts.items() if count) + "."
    return table(shown, numeric=["Paper", "Measured"], caption=caption)
