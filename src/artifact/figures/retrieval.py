"""Figs. 4 to 7: recall with and without distractors."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from IPython.display import HTML
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyBboxPatch, Rectangle

from artifact.figures.embed import embed
from artifact.plotting import (
    DATABASE_COLOUR,
    DISTRACTOR_COLOUR,
    curve,
    marker_options,
    method_legend,
    method_style,
    percent_axis,
)
from artifact.studies import reported

# -- Fig. 5 -------------------------------------------------------------------------------------------------


def scatter(table: pd.DataFrame, titles: Mapping[str, str], *, k: int = 1) -> HTML:
    """Fig. 5: DAR@K against R@K, one panel per dataset, with the diagonal and the means over methods."""
    panels = {
        rows["title"].iloc[0]: rows.rename(columns={"R": "recall", "DAR": "dar"})
        for _, rows in table.groupby("dataset", sort=False)
    }
    return embed(
        _scatter(panels, titles, k),
        f"DAR@{k} against R@{k} of {len(titles)} methods on {len(panels)} datasets",
    )


def reported_scatter() -> HTML:
    """Draw Fig. 5 from the values that the paper plots."""
    points = reported.table("fig05").rename(columns={"recall_percent": "recall", "dar_percent": "dar"})
    named = reported.dataset_titles()
    panels = {named[dataset]: rows for dataset, rows in points.groupby("dataset", sort=False)}
    titles = reported.method_titles()
    return embed(_scatter(panels, titles, 1), "The paper's DAR@1 against R@1 of eleven methods on six datasets")


def _scatter(panels: Mapping[str, pd.DataFrame], titles: Mapping[str, str], k: int) -> Figure:
    columns = min(4 if len(panels) in (4, 7, 8) else 3, len(panels))
    rows = -(-len(panels) // columns)
    figure = Figure(figsize=(2.35 * columns + 0.5, 2.3 * rows + 0.5))
    axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for panel, (title, points) in zip(axes.flat, panels.items(), strict=False):
        panel.axline((0, 0), slope=1, linestyle="--", color="gray", linewidth=0.9, zorder=1)
        panel.axvline(points["recall"].mean(), linestyle=":", color="gray", linewidth=1, zorder=1)
        panel.axhline(points["dar"].mean(), linestyle=":", color="gray", linewidth=1, zorder=1)
        for point in points.to_dict("records"):
            options = marker_options(point["method"], list(titles))
            panel.plot(point["recall"], point["dar"], linestyle="none", clip_on=False, zorder=3, **options)
        percent_axis(panel)
        percent_axis(panel, axis="x")
        panel.set_title(title)
        panel.set_box_aspect(1)
    for panel in axes.flat[len(panels) :]:
        panel.set_axis_off()
    figure.supxlabel(f"R@{k} (%)", fontsize=9.5)
    figure.supylabel(f"DAR@{k} (%)", fontsize=9.5)
    figure.tight_layout(h_pad=1.4, w_pad=0.4)
    method_legend(figure, dict(titles))
    return figure


# -- Fig. 6 -------------------------------------------------------------------------------------------------


def number_and_distance(
    number: pd.DataFrame, distance: pd.DataFrame, titles: Mapping[str, str], *, k: int = 1, unit: str = "m"
) -> HTML:  # fmt: skip
    """Fig. 6: DAR@K against the number of distractors (a) and their minimum distance (b)."""
    return embed(
        _number_and_distance(number, distance, titles, k, unit),
        f"DAR@{k} against distractor number and distance",
    )


def reported_number_and_distance() -> HTML:
    """Draw Fig. 6 from the values that the paper plots for RobotCar."""
    number = reported.table("fig06_number").rename(columns={"dar_percent": "DAR"})
    distance = reported.table("fig06_distance").rename(
        columns={"dar_percent": "DAR", "minimum_distance_metres": "distance"}
    )
    titles = reported.method_titles()
    figure = _number_and_distance(number, distance, titles, 1, "m")
    return embed(figure, "The paper's DAR@1 on RobotCar against distractor number and distance")


def _number_and_distance(
    number: pd.DataFrame, distance: pd.DataFrame, titles: Mapping[str, str], k: int, unit: str
) -> Figure:  # fmt: skip
    figure = Figure(figsize=(8.2, 3.3))
    left, right = figure.subplots(1, 2, sharey=True)
    for method, rows in number.groupby("method", sort=False):
        curve(left, rows["ratio"], rows["DAR"], method, list(titles))
        if "draw_low" in rows:
            colour = method_style(method, list(titles)).colour
            left.fill_between(rows["ratio"], rows["draw_low"], rows["draw_high"], color=colour, alpha=0.18, linewidth=0)
    left.set_xlabel("Distractor-to-query ratio")
    left.set_title("(a) Distractor number")
    _draw_distance(right, distance, titles, unit)
    percent_axis(left, f"DAR@{k} (%)")
    percent_axis(right)
    figure.tight_layout(w_pad=1.2)
    method_legend(figure, dict(titles))
    return figure


def _draw_distance(axes: Axes, distance: pd.DataFrame, titles: Mapping[str, str], unit: str) -> None:
    """Curves over distance with infinity at an equal step beyond the last finite one, right of a dashed line."""
    finite = sorted(x for x in distance["distance"].unique() if np.isfinite(x))
    gap = 0.2 * (finite[-1] - finite[0]) if len(finite) > 1 else 1.0
    end = finite[-1] + gap
    for method, rows in distance.groupby("method", sort=False):
        ordered = rows.sort_values("distance")
        curve(axes, ordered["distance"].replace(np.inf, end), ordered["DAR"], method, list(titles))
    axes.axvline(finite[-1] + gap / 2, linestyle="--", color="0.6", linewidth=0.9)
    axes.set_xticks([*finite, end], [*(f"{x:g}" for x in finite), "∞"])
    axes.set_xlabel(f"Minimum distractor distance ({unit})")
    axes.set_title("(b) Distractor distance")


# -- Fig. 7 -------------------------------------------------------------------------------------------------


def condition(table: pd.DataFrame, titles: Mapping[str, str], *, query_condition: str, k: int = 1) -> HTML:
    """Fig. 7: DAR@K by the condition of the distractors, ordered by the mean over methods."""
    return embed(_condition(table, titles, query_condition, k), f"DAR@{k} by the condition of the distractors")


def reported_condition() -> HTML:
    """Draw Fig. 7 from the values that the paper plots for RobotCar."""
    table = reported.table("fig07").rename(columns={"dar_percent": "DAR", "distractor_condition": "condition"})
    titles = reported.method_titles()
    return embed(_condition(table, titles, "sun,clouds", 1), "The paper's DAR@1 on RobotCar by distractor condition")


def _condition(table: pd.DataFrame, titles: Mapping[str, str], query_condition: str, k: int) -> Figure:
    means = table.groupby("condition", sort=False)["DAR"].mean().sort_values()
    order = [*(name for name in means.index if name != "none"), "none"]
    figure = Figure(figsize=(6.4, 3.4))
    axes = figure.subplots()
    for method, rows in table.groupby("method", sort=False):
        values = rows.set_index("condition")["DAR"]
        curve(axes, range(len(order)), [values[name] for name in order], method, list(titles))
    labels = [f"{name}\n(query)" if name == query_condition else name for name in order]
    axes.set_xticks(range(len(order)), labels)
    axes.set_xlabel("Distractor set")
    percent_axis(axes, f"DAR@{k} (%)")
    figure.tight_layout()
    method_legend(figure, dict(titles))
    return figure


# -- Fig. 4 -------------------------------------------------------------------------------------------------

_CROSS = [(-3.9, 2.3), (1.5, -3.7), (4.4, 0.3), (-4.2, -1.1)]
_DISTRACTORS = [(4.0, 1.8), (3.6, -2.4), (-2.7, -3.3)]
_POSITIVES = [(1.5, 1.6), (-1.7, 1.3), (-0.9, -1.9)]


def retrieval_diagram() -> HTML:
    """Fig. 4: what is in the database for recall (a) and for DAR (b); drawn, not measured."""
    figure = Figure(figsize=(7.2, 3.9))
    for axes, title, extra in zip(figure.subplots(1, 2), ("(a) Recall", "(b) DAR"), ([], _DISTRACTORS), strict=True):
        axes.add_patch(Circle((0, 0), 2.8, facecolor="#e7f5e9", edgecolor="#2e7d32", linestyle="--", linewidth=1.4))
        for places, size, colour in (
            (_CROSS, 0.6, DATABASE_COLOUR),
            (_POSITIVES, 0.66, DATABASE_COLOUR),
            (extra, 0.6, DISTRACTOR_COLOUR),
        ):
            for x, y in places:
                axes.add_patch(
                    Rectangle(
                        (x - size / 2, y - 0.36 * size),
                        size,
                        0.74 * size,
                        facecolor=colour,
                        edgecolor="black",
                        linewidth=0.7,
                    )
                )
        _robot(axes)
        axes.text(0, -2.45, "threshold", ha="center", va="center", fontsize=7.5, color="#2e7d32")
        axes.set(xlim=(-5.1, 5.3), ylim=(-4.4, 3.6), aspect="equal", title=title)
        axes.set_axis_off()
        axes.add_patch(
            FancyBboxPatch((-5.0, -4.3), 10.2, 7.8, boxstyle="round,pad=0,rounding_size=0.2", fill=False, linewidth=0.8)
        )
    handles = [
        Rectangle((0, 0), 1, 1, facecolor=DATABASE_COLOUR, edgecolor="black", linewidth=0.7),
        Rectangle((0, 0), 1, 1, facecolor=DISTRACTOR_COLOUR, edgecolor="black", linewidth=0.7),
    ]
    figure.legend(handles, ["Cross-condition database", "Distractors (query's condition)"], loc="lower center", ncols=2)
    figure.tight_layout(rect=(0, 0.07, 1, 1))
    return embed(
        figure,
        "A robot at the query pose. Left, recall: all database images are of the other condition. Right, DAR: images of the "
        "query's own condition are added outside the threshold circle.",
        width=720,
    )


def _robot(axes: Axes) -> None:
    """A small robot at the query pose."""
    blue, dark = "#bfc8ff", "#28349b"
    axes.add_patch(Rectangle((-0.56, -0.44), 1.12, 0.8, facecolor=blue, edgecolor=dark, linewidth=1.2))
    axes.add_patch(Rectangle((-0.36, 0.36), 0.72, 0.36, facecolor="#9daaf5", edgecolor=dark, linewidth=1.2))
    for x in (-0.16, 0.16):
        axes.add_patch(Circle((x, 0.54), 0.06, color=dark))
    axes.plot([0, 0], [0.72, 0.98], color=dark, linewidth=1.2)
    axes.add_patch(Circle((0, 1.0), 0.09, color=dark))
    for x in (-0.4, 0.4):
        axes.add_patch(Circle((x, -0.56), 0.12, color="black"))
