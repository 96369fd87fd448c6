"""How sure the order of the methods is."""

from __future__ import annotations

import pandas as pd
from IPython.display import HTML

from artifact.pages.common import Titles, interval, number, table


def rank_table(frame: pd.DataFrame, titles: Titles, *, heading: str) -> HTML:
    """Show the chance of each rank of each method, from :func:`artifact.studies.how_sure.rank_chances`."""
    ranks = [column for column in frame if column.isdigit()]
    rows = []
    for row in frame.sort_values("mean", ascending=False).to_dict("records"):
        cells = {"Method": titles[row["method"]], f"Mean {heading} %": number(row["mean"])}
        cells["95 %"] = interval(row["low"], row["high"])
        rows.append(cells | {f"Rank {rank}": f"{row[rank]:.0f} %" for rank in ranks})
    caption = f"How often each method has each rank by mean {heading}, in percent of resampled runs."
    return table(rows, text=1, caption=caption)


def separable_table(frame: pd.DataFrame, titles: Titles, *, heading: str) -> HTML:
    """Show which methods can be told apart, from :func:`artifact.studies.how_sure.separable`."""
    rows = [
        {
            "Better": titles[row["better"]],
            "Worse": titles[row["worse"]],
            f"Difference in mean {heading} (pp)": f"{row['difference']:.1f}",
            "95 %": interval(row["low"], row["high"]),
            "p (Holm)": "< 0.001" if row["p"] < 0.001 else f"{row['p']:.3f}",
            "Told apart": "yes" if row["certain"] else "cannot tell",
        }
        for row in frame.to_dict("records")
    ]
    apart = int(frame["certain"].sum())
    return table(rows, text=2, caption=f"{apart} of {len(frame)} pairs of methods are told apart by mean {heading}.")
