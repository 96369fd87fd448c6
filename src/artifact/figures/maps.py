"""Figs. 1, 2, 3 and 9: retrievals on the map, embeddings, and one distractor in pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from IPython.display import HTML
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from artifact.figures.embed import embed
from artifact.metrics.evaluation import Evaluation
from artifact.plotting import (
    DATABASE_COLOUR,
    DISTRACTOR_COLOUR,
    FITTING_COLOUR,
    QUERY_COLOUR,
    RIGHT_COLOUR,
    WRONG_COLOUR,
)
from artifact.studies.embedding import Embedding
from artifact.studies.mixed_database import MixedDatabase

_MATCHES = 500
"""Most matches drawn, as in the paper's Fig. 9."""


def mixed_database(
    found: Mapping[str, MixedDatabase], panels: Mapping[str, str], conditions: Sequence[str], titles: Mapping[str, str]
) -> HTML:  # fmt: skip
    """Figs. 2 and 9: each query joined with its top-1 retrieval, green within the threshold, red otherwise.

    Parameters
    ----------
    found
        By method: one row of panels each.
    panels
        Evaluation name to column title.
    conditions
        Names of the query condition, the database condition and the added images' condition, for the legend.
    titles
        Method name to printed title.
    """
    figure = Figure(figsize=(3.9 * len(panels) + 0.3, 3.7 * len(found)))
    axes = figure.subplots(len(found), len(panels), squeeze=False)
    for row, (method, one) in zip(axes, found.items(), strict=True):
        for panel, (name, title) in zip(row, panels.items(), strict=True):
            _draw_map(panel, one, one.evaluations[name], with_added=name != "single")
            panel.set_title(
                f"{titles[method]}, {title}\nR@1 {100 * one.evaluations[name].recall(1):.1f} %", fontsize=9.5
            )
    figure.tight_layout()
    with_fit = any(len(one.fitted_queries) for one in found.values())
    _map_legend(figure, conditions, with_fit=with_fit)
    shares = ", ".join(
        f"{titles[m]} {title} {100 * one.evaluations[name].recall(1):.1f} %"
        for m, one in found.items()
        for name, title in panels.items()
    )
    return embed(figure, f"Maps of top-1 retrievals; R@1: {shares}")


def _draw_map(axes: Axes, one: MixedDatabase, result: Evaluation, *, with_added: bool) -> None:
    data = one.described.dataset
    extra = next(n for n in data.traversals if n not in (data.query_name, data.database_name))
    added = data.traversals[extra].positions[one.added]
    places = data.database.positions[one.database]
    targets = np.concatenate([places, added]) if with_added else places
    top = result.retrieved(1, distractors=False)[0][:, 0]
    ends = targets[top]
    starts = result.query_positions
    right = np.linalg.norm(ends - starts, axis=1) <= data.threshold
    shown = np.linspace(0, len(starts) - 1, min(_MATCHES, len(starts))).round().astype(int)
    planes = [values[:, :2] if values.shape[1] > 1 else _on_two_lines(values) for values in (starts, places, ends)]
    begin, where, end = planes
    for colour, chosen, width, order in (
        (WRONG_COLOUR, shown[~right[shown]], 0.7, 2), (RIGHT_COLOUR, shown[right[shown]], 2.6, 6),
    ):  # fmt: skip
        lines = np.stack([begin[chosen], end[chosen]], axis=1)
        axes.add_collection(LineCollection(lines, colors=colour, linewidths=width, alpha=0.75, zorder=order))
    axes.scatter(*where.T, s=14, color=DATABASE_COLOUR, zorder=4, linewidths=0)
    axes.scatter(*begin.T, s=5, color=QUERY_COLOUR, zorder=5, linewidths=0)
    if len(one.fitted_queries):
        fitted = data.query.positions[one.fitted_queries][:, :2]
        axes.scatter(*fitted.T, s=14, color=FITTING_COLOUR, zorder=7, linewidths=0)
    if with_added and len(added):
        axes.scatter(*added[:, :2].T, s=16, color=DISTRACTOR_COLOUR, zorder=8, linewidths=0.4, edgecolors="white")
    axes.autoscale()
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_visible(True)
        spine.set_edgecolor("0.7")


def _on_two_lines(values: np.ndarray) -> np.ndarray:
    """Positions along one axis as points of a line."""
    return np.column_stack([values[:, 0], np.zeros(len(values))])


def _map_legend(figure: Figure, conditions: Sequence[str], *, with_fit: bool) -> None:
    query, database, added = conditions
    entries = [(FITTING_COLOUR, "fitting region")] if with_fit else []
    entries += [
        (QUERY_COLOUR, f"query ({query})"), (DATABASE_COLOUR, f"database ({database})"),
        (DISTRACTOR_COLOUR, f"added to the database ({added})"),
    ]  # fmt: skip
    handles = [Line2D([], [], linestyle="none", marker="s", color=colour, label=label) for colour, label in entries]
    handles += [Line2D([], [], color=c, label=label) for c, label in ((RIGHT_COLOUR, "right"), (WRONG_COLOUR, "wrong"))]
    figure.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, 0.0), ncols=3)


def embeddings(found: Mapping[str, Embedding], conditions: Sequence[str], titles: Mapping[str, str]) -> HTML:
    """Fig. 3: UMAP before and after suppression; gray lines join geometrical mutual nearest neighbours.

    Parameters
    ----------
    found
        By method: one row of panels each.
    conditions
        Names of the query and the database condition, for the legend.
    titles
        Method name to printed title.
    """
    figure = Figure(figsize=(7.6, 3.6 * len(found)))
    axes = figure.subplots(len(found), 2, squeeze=False)
    for row, (method, one) in zip(axes, found.items(), strict=True):
        for panel, points, name in zip(row, (one.before, one.after), ("original", "suppressed with INLP"), strict=True):
            joined = np.stack([points[one.partners[:, 0]], points[one.partners[:, 1]]], axis=1)
            panel.add_collection(LineCollection(joined, colors="0.6", linewidths=0.5, alpha=0.6, zorder=1))
            panel.scatter(*points[: one.n_queries].T, s=9, color="#1f77b4", linewidths=0, zorder=2)
            panel.scatter(*points[one.n_queries :].T, s=9, color="#ff7f0e", linewidths=0, zorder=2)
            panel.set_title(f"{titles[method]}, {name}", fontsize=9.5)
            panel.set_xticks([])
            panel.set_yticks([])
            for spine in panel.spines.values():
                spine.set_visible(True)
    figure.tight_layout()
    handles = [
        Line2D([], [], linestyle="none", marker="s", color=colour, label=label)
        for colour, label in (("#1f77b4", f"query ({conditions[0]})"), ("#ff7f0e", f"database ({conditions[1]})"))
    ]
    figure.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, 0.0), ncols=2)
    return embed(figure, "UMAP of query and database descriptors before and after condition suppression")
