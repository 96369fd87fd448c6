"""Figs. 8 and 10, and the curves of the pages beyond the paper: what suppression changes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from IPython.display import HTML
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from artifact.figures.embed import embed
from artifact.plotting import SUPPRESSION_COLOURS, percent_axis
from artifact.studies import reported
from artifact.studies.erased import KINDS

_QUANTITIES = {
    "change_probe": ("(a) Guardedness probe accuracy", "lower is better", "RdBu_r"),
    "change_DAR": ("(b) ΔDAR@{k}", "higher is better", "RdBu"),
    "change_R": ("(c) ΔR@{k}", "higher is better", "RdBu"),
}


# -- Fig. 8 -------------------------------------------------------------------------------------------------


def heat_maps(table: pd.DataFrame, titles: Mapping[str, str], *, k: int = 1) -> HTML:
    """Fig. 8: change of probe accuracy, DAR@K and R@K per suppression method, dataset and method.

    Parameters
    ----------
    table
        As from :func:`artifact.studies.suppression.suppression_table`.
    titles
        Method name to printed title.
    k
        K, for the headings.
    """
    datasets = dict(zip(table["dataset"], table["title"], strict=True))
    suppressors = [name for name in table["suppression"].unique() if name != "original"]
    # The shorter axis runs across, so that the numbers stay legible.
    across, down = (titles, datasets) if len(titles) < len(datasets) else (datasets, titles)
    names = ("method", "dataset") if across is titles else ("dataset", "method")
    size = (2.0 + 0.68 * len(across) * len(suppressors), 3 * (0.55 + 0.27 * len(down)) + 1.2)
    figure = Figure(figsize=size)
    axes = figure.subplots(3, len(suppressors), sharex=True, sharey=True, squeeze=False)
    for row, (column, (name, better, colours)) in zip(axes, _QUANTITIES.items(), strict=True):
        limit = max(10.0, float(np.nanmax(np.abs(table[column]))))
        for panel, suppressor in zip(row, suppressors, strict=True):
            part = table[table["suppression"] == suppressor].pivot_table(
                index=names[1], columns=names[0], values=column
            )
            _heat_map(panel, part.reindex(index=list(down), columns=list(across)).to_numpy(), limit, colours)
            panel.set_title(suppressor, fontsize=9, pad=3, loc="left")
        row[0].set_yticks(range(len(down)), list(down.values()))
        row[0].set_title(
            f"{name.format(k=k)}, change in pp ({better})\n\n{suppressors[0]}", fontsize=9, pad=3, loc="left"
        )
    for panel in axes[-1]:
        panel.set_xticks(range(len(across)), list(across.values()), rotation=40, ha="right")
    figure.tight_layout(h_pad=0.8, w_pad=0.6)
    text = f"Changes by suppression of {len(titles)} methods on {len(datasets)} datasets; the numbers are in the table"
    return embed(figure, text)


def _heat_map(axes: Axes, values: np.ndarray, limit: float, colours: str) -> None:
    """One panel with its numbers; the scale is linear up to ``limit`` and symmetric around zero."""
    # A root makes changes of a few points visible beside one of tens of points.
    shown = np.sign(values) * np.sqrt(np.abs(values) / limit)
    axes.imshow(shown, cmap=colours, vmin=-1.25, vmax=1.25, aspect="auto")
    for (row, column), value in np.ndenumerate(values):
        if np.isfinite(value):
            strong = abs(shown[row, column]) > 0.95
            axes.text(
                column, row, f"{value:+.1f}", ha="center", va="center", fontsize=7, color="white" if strong else "black"
            )
    axes.tick_params(length=0)
    for spine in axes.spines.values():
        spine.set_visible(False)


# -- Fig. 10 ------------------------------------------------------------------------------------------------


def fraction_curves(means: pd.DataFrame, *, k: int = 1) -> HTML:
    """Fig. 10: mean change of DAR@K (a) and R@K (b) against the query fitting fraction.

    Parameters
    ----------
    means
        ``suppression``, ``fraction``, ``change_DAR``, ``change_R`` in percentage points.
    k
        K, for the headings.
    """
    return embed(_fraction_curves(means, k), f"Mean change of DAR@{k} and R@{k} against the query fitting fraction")


def reported_fraction_curves() -> HTML:
    """Draw Fig. 10 from the values that the paper plots."""
    wide = reported.table("fig10").pivot_table(
        index=["suppression", "fitting_fraction"], columns="metric", values="change_pp", sort=False
    )
    means = wide.reset_index().rename(
        columns={"fitting_fraction": "fraction", "DAR@1": "change_DAR", "R@1": "change_R"}
    )
    return embed(
        _fraction_curves(means, 1), "The paper's mean change of DAR@1 and R@1 against the query fitting fraction"
    )


def _fraction_curves(means: pd.DataFrame, k: int) -> Figure:
    figure = Figure(figsize=(8.0, 3.2))
    for axes, column, title in zip(
        figure.subplots(1, 2), ("change_DAR", "change_R"), (f"(a) ΔDAR@{k} (pp)", f"(b) ΔR@{k} (pp)"), strict=True
    ):
        axes.axhline(0, linestyle="--", color="gray", linewidth=0.9)
        for suppressor, rows in means.groupby("suppression", sort=False):
            ordered = rows.sort_values("fraction")
            axes.plot(
                ordered["fraction"], ordered[column], color=SUPPRESSION_COLOURS[suppressor], marker="o", markersize=3.5,
                label=suppressor,
            )  # fmt: skip
        axes.set(title=title, xlim=(-0.01, 0.51), xticks=np.arange(0, 0.51, 0.1))
        axes.grid(visible=True)
        axes.set_xlabel("Query fitting fraction")
    figure.tight_layout(w_pad=1.4)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="upper center", bbox_to_anchor=(0.5, 0.0), ncols=3)
    return figure


# -- beyond the paper ---------------------------------------------------------------------------------------


def iterations(table: pd.DataFrame) -> HTML:
    """R@1 and DAR@1 after each INLP iteration, and how well the next classifier still tells the conditions.

    Parameters
    ----------
    table
        ``iteration``, ``R``, ``DAR``, ``accuracy`` in percent.
    """
    figure = Figure(figsize=(7.2, 3.1))
    axes = figure.subplots()
    for column, label, colour in (
        ("R", "R@1", "#2e8b57"), ("DAR", "DAR@1", "#1f77b4"), ("accuracy", "classifier, training accuracy", "0.55"),
    ):  # fmt: skip
        axes.plot(table["iteration"], table[column], color=colour, marker="o", markersize=3, label=label)
    axes.axhline(50, linestyle=":", color="0.55", linewidth=0.9)
    axes.set_xlabel("INLP iterations")
    percent_axis(axes, "percent")
    figure.tight_layout()
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="upper center", bbox_to_anchor=(0.5, 0.0), ncols=3)
    return embed(figure, "R@1, DAR@1 and training accuracy after each INLP iteration")


_KIND_COLOURS = dict(zip(KINDS, ("#2e8b57", "#0000ff", "#ffa500"), strict=True))


def similarities(found: Mapping[str, Mapping[str, np.ndarray]], views: Sequence[str]) -> HTML:
    """Distributions of the cosine for the three kinds of pairs, one panel per view."""
    figure = Figure(figsize=(3.1 * len(views) + 0.4, 2.9))
    panels = figure.subplots(1, len(views), sharey=True, squeeze=False)[0]
    for axes, view in zip(panels, views, strict=True):
        pooled = np.concatenate(list(found[view].values()))
        edges = np.linspace(*np.quantile(pooled, [0.001, 0.999]), 60)
        centres = (edges[1:] + edges[:-1]) / 2
        for kind, values in found[view].items():
            height = np.histogram(values, edges)[0] / max(1, len(values))
            axes.fill_between(centres, height, color=_KIND_COLOURS[kind], alpha=0.25, linewidth=0)
            axes.plot(centres, height, color=_KIND_COLOURS[kind], linewidth=1.2, label=kind)
            axes.axvline(np.median(values), color=_KIND_COLOURS[kind], linewidth=0.9, linestyle=":")
        axes.set(title=view, yticks=[], ylim=(0, None))
        axes.set_xlabel("cosine similarity")
    panels[0].set_ylabel("share of pairs")
    figure.tight_layout()
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="upper center", bbox_to_anchor=(0.5, 0.0), ncols=3)
    return embed(figure, f"Distributions of the cosine for {len(KINDS)} kinds of pairs: {', '.join(views)}")


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
