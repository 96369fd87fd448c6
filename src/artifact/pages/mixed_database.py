"""Figs. 2 and 9: retrievals from a mixed database on the map."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from IPython.display import HTML
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from artifact.metrics.evaluation import Evaluation
from artifact.pages.common import change, claim, number, table
from artifact.pages.style import (
    DATABASE_COLOUR,
    DISTRACTOR_COLOUR,
    FITTING_COLOUR,
    QUERY_COLOUR,
    RIGHT_COLOUR,
    WRONG_COLOUR,
    bare,
    colour_handle,
    embed,
    in_the_plane,
    legend_below,
)
from artifact.pages.suppression import NO_LOSS_PP
from artifact.studies import reported
from artifact.studies.common import PERCENT
from artifact.studies.mixed_database import MixedDatabase

_MATCHES = 500
"""Most matches drawn, as in the paper's Fig. 9."""


def mixed_database(
    found: Mapping[str, MixedDatabase], panels: Mapping[str, str], conditions: Sequence[str], titles: Mapping[str, str]
) -> HTML:
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
    shares = []
    for row, (method, one) in zip(axes, found.items(), strict=True):
        for panel, (name, title) in zip(row, panels.items(), strict=True):
            share = f"{_recall(one, name):.1f} %"
            _draw_map(panel, one, one.evaluations[name], with_added=name != "single")
            panel.set_title(f"{titles[method]}, {title}\nR@1 {share}", fontsize=9.5)
            shares.append(f"{titles[method]} {title} {share}")
    figure.tight_layout()
    _map_legend(figure, conditions, with_fit=any(len(one.fitted_queries) for one in found.values()))
    return embed(figure, f"Maps of top-1 retrievals; R@1: {', '.join(shares)}")


def _recall(one: MixedDatabase, name: str) -> float:
    return PERCENT * one.evaluations[name].recall(1)


def _draw_map(axes: Axes, one: MixedDatabase, result: Evaluation, *, with_added: bool) -> None:
    data = one.described.dataset
    extra = next(n for n in data.traversals if n not in (data.query_name, data.database_name))
    added = data.traversals[extra].positions[one.added]
    places, starts = data.database.positions[one.database], result.query_positions
    ends = (np.concatenate([places, added]) if with_added else places)[result.retrieved(1, distractors=False)[0][:, 0]]
    right = np.linalg.norm(ends - starts, axis=1) <= data.threshold
    origin = places.mean(axis=0)
    shown = np.linspace(0, len(starts) - 1, min(_MATCHES, len(starts))).round().astype(int)
    begin, end = in_the_plane(starts, origin), in_the_plane(ends, origin)
    for colour, chosen, width, order in (
        (WRONG_COLOUR, shown[~right[shown]], 0.7, 2),
        (RIGHT_COLOUR, shown[right[shown]], 2.6, 6),
    ):
        lines = np.stack([begin[chosen], end[chosen]], axis=1)
        axes.add_collection(LineCollection(lines, colors=colour, linewidths=width, alpha=0.75, zorder=order))
    axes.scatter(*in_the_plane(places, origin).T, s=14, color=DATABASE_COLOUR, zorder=4, linewidths=0)
    axes.scatter(*begin.T, s=5, color=QUERY_COLOUR, zorder=5, linewidths=0)
    if len(one.fitted_queries):
        fitted = in_the_plane(data.query.positions[one.fitted_queries], origin)
        axes.scatter(*fitted.T, s=14, color=FITTING_COLOUR, zorder=7, linewidths=0)
    if with_added and len(added):
        dots = {"color": DISTRACTOR_COLOUR, "edgecolors": "white", "linewidths": 0.4}
        axes.scatter(*in_the_plane(added, origin).T, s=16, zorder=8, **dots)
    axes.autoscale()
    axes.set_aspect("equal", adjustable="datalim")
    bare(axes, "0.7")


def _map_legend(figure: Figure, conditions: Sequence[str], *, with_fit: bool) -> None:
    query, database, added = conditions
    handles = [colour_handle(FITTING_COLOUR, "fitting region")] if with_fit else []
    handles += [
        colour_handle(QUERY_COLOUR, f"query ({query})"),
        colour_handle(DATABASE_COLOUR, f"database ({database})"),
        colour_handle(DISTRACTOR_COLOUR, f"added to the database ({added})"),
        Line2D([], [], color=RIGHT_COLOUR, label="right"),
        Line2D([], [], color=WRONG_COLOUR, label="wrong"),
    ]
    legend_below(figure, handles)


def mixed_table(found: Mapping[str, MixedDatabase], panels: Mapping[str, str], titles: Mapping[str, str]) -> HTML:
    """Show R@1 of each panel and the change between them.

    Parameters
    ----------
    found
        By method.
    panels
        Evaluation name to heading, two of them, before and after.
    titles
        Method name to printed title.
    """
    rows = []
    for method, one in found.items():
        counts = {
            "Queries": next(iter(one.evaluations.values())).n_queries,
            "Database": len(one.database),
            "Added": len(one.added),
        }
        recalls = {heading: _recall(one, name) for name, heading in panels.items()}
        rows.append(_before_and_after(titles[method], recalls) | counts)
    return table(rows, text=1, caption="Measured in this run.")


def reported_mixed_table(name: str) -> HTML:
    """Show the values that the paper prints in Fig. 2 (``"fig02"``) or Fig. 9 (``"fig09"``)."""
    frame = reported.table(name)
    column = next(c for c in frame.columns if c not in ("method", "recall_percent"))
    wide = frame.pivot_table(index="method", columns=column, values="recall_percent", sort=False)
    titles = reported.method_titles()
    rows = [_before_and_after(titles[method], row.to_dict()) for method, row in wide.iterrows()]
    return table(rows, text=1, caption="Reported by the paper for RobotCar, not from this run.")


def _before_and_after(title: str, recalls: Mapping[str, float]) -> dict[str, object]:
    """One row: the method, R@1 under two headings, and the change."""
    before, after = recalls.values()
    shown = {f"R@1 %, {heading}": number(value) for heading, value in recalls.items()}
    return {"Method": title, **shown, "Change (pp)": change(after - before)}


@claim(
    "fig02",
    "A few images of the query's kind of condition in the database can lower R@1, though some of them show the place.",
    paper="5 % of a day traversal lower R@1 on RobotCar from 95.9 % to 80.5 % (AnyLoc), from 91.5 % to 86.8 % (EigenPlaces)",
    rule=f"some method loses more than {NO_LOSS_PP:g} pp",
)
def few_images_lower_recall(found: Mapping[str, MixedDatabase], titles: Mapping[str, str]) -> tuple[str, bool | None]:
    """A few images of the query's condition in the database lower R@1 (Fig. 2)."""
    recalls = pd.DataFrame(
        {method: [_recall(one, name) for name in ("single", "mixed")] for method, one in found.items()}
    )
    loss = recalls.loc[0] - recalls.loc[1]
    before, after = recalls[loss.idxmax()]
    added = len(next(iter(found.values())).added)
    text = (
        f"{added} added images lower R@1 for {(loss > 0).sum()} of {len(loss)} methods; {titles[loss.idxmax()]} goes from "
        f"{before:.1f} % to {after:.1f} %"
    )
    return text, bool(loss.max() > NO_LOSS_PP)


@claim(
    "fig09",
    "INLP, fitted on one end of the map, raises R@1 on a mixed database elsewhere.",
    paper="on RobotCar from 80.4 % to 96.8 % (AnyLoc) and from 88.7 % to 93.8 % (EigenPlaces)",
    rule="R@1 rises for every method",
)
def suppression_helps_mixed_database(
    found: Mapping[str, MixedDatabase], titles: Mapping[str, str]
) -> tuple[str, bool | None]:
    """INLP raises R@1 on a mixed database, with a fit on another part of the map (Fig. 9)."""
    changes = {titles[m]: (_recall(one, "original"), _recall(one, "INLP")) for m, one in found.items()}
    rises = sum(after > before for before, after in changes.values())
    pairs = ", ".join(f"{title} {before:.1f} % to {after:.1f} %" for title, (before, after) in changes.items())
    return f"R@1 rises for {rises} of {len(changes)} methods: {pairs}", rises == len(changes)
