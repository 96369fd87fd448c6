"""Beyond the paper: conditions within one traversal."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from IPython.display import HTML
from matplotlib.figure import Figure

from artifact.pages.common import change, number, table
from artifact.pages.style import SUPPRESSION_COLOURS, embed


def within_summary(rows: pd.DataFrame, titles: Mapping[str, str]) -> str:
    """Say in words for how many pairs a statistic takes queries beyond the control, before and after suppression."""
    parts = []
    for view in rows["view"].unique():
        part = rows[rows["view"] == view]
        beyond = part[(part["gap_low"] > 0) & (part["gap"] > part["control_high"])]
        names = [f"{titles[m]} on {t}" for m, t in zip(beyond["method"], beyond["title"], strict=True)]
        listed = (
            f" ({', '.join(names[:4])}{' and others' if len(names) > 4 else ''})"
            if names and view == "original"
            else ""
        )
        parts.append(f"{len(beyond)} of {len(part)} pairs {'on the' if view == 'original' else 'after'} {view}{listed}")
    means = rows.groupby("view", sort=False)["gap"].mean()
    mean = ", ".join(f"{view} {value:+.1f}" for view, value in means.items())
    return (
        f"The gap is beyond every control, with an interval above zero, for {'; '.join(parts)}. "
        f"Mean gap over all pairs: {mean} pp."
    )


def within_table(frame: pd.DataFrame, titles: Mapping[str, str]) -> HTML:
    """Show every gap with its interval and control."""
    shown = pd.DataFrame({"Statistic": frame["statistic"], "Dataset": frame["title"]})
    shown["Method"] = frame["method"].map(titles)
    shown["Descriptors"] = frame["view"]
    shown["R@1 %"] = frame["R"].map(number)
    shown["own side %"] = frame["own"].map(number)
    shown["other side %"] = frame["other"].map(number)
    shown["gap (pp)"] = frame["gap"].map(change)
    shown["95 % interval"] = [
        f"[{change(a)}, {change(b)}]" for a, b in zip(frame["gap_low"], frame["gap_high"], strict=True)
    ]
    shown["control, mean"] = frame["control"].map(change)
    shown["control, largest"] = frame["control_high"].map(change)
    return table(shown, numeric=list(shown.columns[4:]))


def sided_gaps(table: pd.DataFrame, titles: Mapping[str, str]) -> HTML:
    """Gap between distractors of the other and of the query's own side, per dataset, with its interval and control.

    Parameters
    ----------
    table
        Rows of one statistic, as from :func:`artifact.studies.within_session.within_session`.
    titles
        Method name to printed title.
    """
    datasets = dict(zip(table["dataset"], table["title"], strict=True))
    figure = Figure(figsize=(2.75 * len(titles) + 1.7, 0.42 * len(datasets) + 1.5))
    panels = figure.subplots(1, len(titles), sharey=True, sharex=True, squeeze=False)[0]
    shifts = {"original": -0.22, "LEACE": 0.0, "INLP": 0.22}
    for axes, (method, title) in zip(panels, titles.items(), strict=True):
        axes.axvline(0, linestyle="--", color="gray", linewidth=0.9)
        for view, shift in shifts.items():
            rows = table[(table["method"] == method) & (table["view"] == view)].set_index("dataset").loc[list(datasets)]
            y = np.arange(len(datasets)) + shift
            colour = {"original": "black", **SUPPRESSION_COLOURS}[view]
            axes.hlines(y, rows["gap_low"], rows["gap_high"], color=colour, linewidth=1.2)
            axes.plot(rows["gap"], y, "o", color=colour, markersize=4, label=view)
            if view == "original":
                axes.plot(
                    rows["control"], y, "|", color="0.45", markersize=9, markeredgewidth=2, label="control (original)"
                )
        axes.set_title(title)
        axes.grid(visible=True, axis="x")
    panels[0].set_yticks(range(len(datasets)), list(datasets.values()))
    panels[0].invert_yaxis()
    figure.supxlabel("gap: R@1 with distractors of the other side − of the own side (pp)", fontsize=9)
    figure.tight_layout()
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="upper center", bbox_to_anchor=(0.5, 0.0), ncols=4)
    return embed(
        figure, "Gap between distractors of the other side and of the query's own side, per dataset and method"
    )
