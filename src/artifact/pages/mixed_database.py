"""Figs. 1, 2, 3 and 9: retrievals on the map, embeddings, and one distractor in pictures."""

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
from artifact.pages.common import Finding, change, number, table
from artifact.pages.style import (
    DATABASE_COLOUR,
    DISTRACTOR_COLOUR,
    FITTING_COLOUR,
    QUERY_COLOUR,
    RIGHT_COLOUR,
    WRONG_COLOUR,
    embed,
)
from artifact.pages.suppression import NO_LOSS_PP
from artifact.studies import reported
from artifact.studies.common import PERCENT
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
    first, second = panels
    rows = []
    for method, one in found.items():
        before, after = (PERCENT * one.evaluations[name].recall(1) for name in (first, second))
        rows.append(
            {
                "Method": titles[method],
                f"R@1 %, {panels[first]}": number(before),
                f"R@1 %, {panels[second]}": number(after),
                "Change (pp)": change(after - before),
                "Queries": one.evaluations[first].n_queries,
                "Database": len(one.database),
                "Added": len(one.added),
            }
        )
    frame = pd.DataFrame(rows)
    return table(frame, numeric=list(frame.columns[1:]), caption="Measured in this run.")


def reported_mixed_table(name: str) -> HTML:
    """Show the values that the paper prints in Fig. 2 (``"fig02"``) or Fig. 9 (``"fig09"``)."""
    frame = reported.table(name)
    column = next(c for c in frame.columns if c not in ("method", "recall_percent"))
    wide = frame.pivot_table(index="method", columns=column, values="recall_percent", sort=False)
    titles = reported.method_titles()
    first, second = wide.columns
    rows = [
        {
            "Method": titles[method],
            f"R@1 %, {first}": number(row[first]),
            f"R@1 %, {second}": number(row[second]),
            "Change (pp)": change(row[second] - row[first]),
        }
        for method, row in wide.iterrows()
    ]
    shown = pd.DataFrame(rows)
    return table(
        shown, numeric=list(shown.columns[1:]), caption="Reported by the paper for RobotCar; not measured here."
    )


def few_images_lower_recall(found: Mapping[str, MixedDatabase], titles: Mapping[str, str]) -> Finding:
    """A few images of the query's condition in the database lower R@1 (Fig. 2)."""
    changes = {
        m: (100 * one.evaluations["single"].recall(1), 100 * one.evaluations["mixed"].recall(1))
        for m, one in found.items()
    }
    falls = [m for m, (alone, mixed) in changes.items() if mixed < alone]
    worst = min(changes, key=lambda m: changes[m][1] - changes[m][0])
    before, after = changes[worst]
    added = len(next(iter(found.values())).added)
    return Finding(
        "fig02",
        "A few images of the query's kind of condition in the database can lower R@1, though some of them show the place.",
        "5 % of a day traversal lower R@1 on RobotCar from 95.9 % to 80.5 % (AnyLoc), from 91.5 % to 86.8 % (EigenPlaces)",
        f"some method loses more than {NO_LOSS_PP:g} pp",
        f"{added} added images lower R@1 for {len(falls)} of {len(changes)} methods; {titles[worst]} goes from "
        f"{before:.1f} % to {after:.1f} %",
        before - after > NO_LOSS_PP,
    )


def suppression_helps_mixed_database(found: Mapping[str, MixedDatabase], titles: Mapping[str, str]) -> Finding:
    """INLP raises R@1 on a mixed database, with a fit on another part of the map (Fig. 9)."""
    changes = {
        m: (100 * one.evaluations["original"].recall(1), 100 * one.evaluations["INLP"].recall(1))
        for m, one in found.items()
    }
    rises = [m for m, (before, after) in changes.items() if after > before]
    listed = ", ".join(f"{titles[m]} {before:.1f} % to {after:.1f} %" for m, (before, after) in changes.items())
    return Finding(
        "fig09",
        "INLP, fitted on one end of the map, raises R@1 on a mixed database elsewhere.",
        "on RobotCar from 80.4 % to 96.8 % (AnyLoc) and from 88.7 % to 93.8 % (EigenPlaces)",
        "R@1 rises for every method",
        f"R@1 rises for {len(rises)} of {len(changes)} methods: {listed}",
        len(rises) == len(changes),
    )
