"""How sure the order of the methods is."""

from __future__ import annotations

import pandas as pd
from IPython.display import HTML

from artifact.pages.common import Titles, interval, number, shown, table


def rank_table(frame: pd.DataFrame, titles: Titles, *, heading: str) -> HTML:
    """Show the chance of each rank of each method, from :func:`artifact.studies.how_sure.rank_chances`."""
    frame = _with_interval(frame.sort_values("mean", ascending=False))
    columns = {"Method": ("method", titles.get), f"Mean {heading} %": ("mean", number), "95 %": "interval"}
    columns |= {f"Rank {rank}": (rank, "{:.0f} %".format) for rank in frame if rank.isdigit()}
    caption = f"How often each method has each rank by mean {heading}, in percent of resampled runs."
    return table(shown(frame, columns), text=1, caption=caption)


def separable_table(frame: pd.DataFrame, titles: Titles, *, heading: str) -> HTML:
    """Show which methods can be told apart, from :func:`artifact.studies.how_sure.separable`."""
    columns = {
        "Better": ("better", titles.get),
        "Worse": ("worse", titles.get),
        f"Difference in mean {heading} (pp)": ("difference", "{:.1f}".format),
        "95 %": "interval",
        "p (Holm)": ("p", lambda p: "< 0.001" if p < 0.001 else f"{p:.3f}"),
        "Told apart": ("certain", lambda certain: "yes" if certain else "cannot tell"),
    }
    caption = f"{frame['certain'].sum()} of {len(frame)} pairs of methods are told apart by mean {heading}."
    return table(shown(_with_interval(frame), columns), text=2, caption=caption)


def _with_interval(frame: pd.DataFrame) -> pd.DataFrame:
    return frame.assign(interval=list(map(interval, frame["low"], frame["high"])))
