"""Beyond the paper: conditions within one traversal."""

from __future__ import annotations

import numpy as np
import pandas as pd
from IPython.display import HTML
from matplotlib.axes import Axes

from artifact.pages.common import Titles, change, listed, number, shown, table
from artifact.pages.style import SUPPRESSION_COLOURS, SUPPRESSION_MARKERS, drawing, embed, legend_below, tell_values

_SHIFTS = {"original": -0.22, "LEACE": 0.0, "INLP": 0.22}
_COLOURS = {"original": "black", **SUPPRESSION_COLOURS}
_MARKERS = {"original": "D", **SUPPRESSION_MARKERS}


def within_summary(rows: pd.DataFrame, titles: Titles) -> str:
    """Say in words for how many pairs a statistic takes queries beyond the control, before and after suppression."""
    parts, means = [], []
    for view, part in rows.groupby("view", sort=False):
        beyond = part[(part["gap_low"] > 0) & (part["gap"] > part["control_high"])]
        names = [f"{titles[m]} on {t}" for m, t in zip(beyond["method"], beyond["title"], strict=True)]
        shortened = names if len(names) <= 4 else [*names[:3], f"{names[3]} and others"]
        where = f"on the original{listed(shortened)}" if view == "original" else f"after {view}"
        parts.append(f"{len(beyond)} of {len(part)} pairs {where}")
        means.append(f"{view} {part['gap'].mean():+.1f}")
    return (
        f"The gap is beyond every control, with an interval above zero, for {'; '.join(parts)}. "
        f"Mean gap over all pairs: {', '.join(means)} pp."
    )


def within_table(frame: pd.DataFrame, titles: Titles) -> HTML:
    """Show every gap with its interval and control."""
    frame = frame.assign(interval="[" + frame["gap_low"].map(change) + ", " + frame["gap_high"].map(change) + "]")
    columns = {
        "Statistic": "statistic",
        "Dataset": "title",
        "Method": ("method", titles.get),
        "Descriptors": "view",
        "R@1 %": ("R", number),
        "own side %": ("own", number),
        "other side %": ("other", number),
        "gap (pp)": ("gap", change),
        "95 % interval": "interval",
        "control, mean": ("control", change),
        "control, largest": ("control_high", change),
    }
    return table(shown(frame, columns), text=4)


def sided_gaps(table: pd.DataFrame, titles: Titles) -> HTML:
    """Gap between distractors of the other and of the query's own side by one statistic, with interval and control."""
    datasets = dict(zip(table["dataset"], table["title"], strict=True))
    size = 2.75 * len(titles) + 1.7, 0.42 * len(datasets) + 1.5
    figure, (panels,) = drawing(size, columns=len(titles), squeeze=False)
    lowest, highest = table[["gap_low", "control"]].min().min(), table[["gap_high", "control"]].max().max()
    room = 0.05 * (highest - lowest) + 0.1
    for axes, (method, title) in zip(panels, titles.items(), strict=True):
        axes.axvline(0, linestyle="--", color="gray", linewidth=0.9)
        of_method = table[table["method"] == method]
        for view in _SHIFTS:
            _draw_gaps(axes, of_method[of_method["view"] == view].set_index("dataset").loc[list(datasets)], view)
        axes.set(title=title, xlim=(lowest - room, highest + room), xlabel="gap (pp)")
        axes.set_yticks(range(len(datasets)), list(datasets.values()))
        axes.invert_yaxis()
        axes.grid(visible=True, axis="x")
    legend_below(figure, columns=4)
    text = "Gap: R@1 with distractors of the other side minus R@1 with those of the query's own side, per dataset and method"
    return embed(figure, text)


def _draw_gaps(axes: Axes, rows: pd.DataFrame, view: str) -> None:
    """Gaps of one method and view, a line per dataset; those of the original with their control."""
    y, colour = np.arange(len(rows)) + _SHIFTS[view], _COLOURS[view]
    axes.hlines(y, rows["gap_low"], rows["gap_high"], color=colour, linewidth=1.2)
    axes.plot(rows["gap"], y, _MARKERS[view], color=colour, markersize=4, label=view)
    tell_values(axes, np.column_stack([rows["gap"], y]), (f"{view}: gap {change(gap)} pp" for gap in rows["gap"]))
    if view == "original":
        axes.plot(rows["control"], y, "|", label="control (original)", color="0.45", markersize=9, markeredgewidth=2)
