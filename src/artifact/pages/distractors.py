"""Figs. 6 and 7: number, distance and condition of distractors."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from IPython.display import HTML
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from artifact.pages.common import CLEARLY_PP, Finding
from artifact.pages.style import (
    curve,
    embed,
    method_legend,
    method_style,
    percent_axis,
)
from artifact.studies import reported


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


def few_distractors_suffice(table: pd.DataFrame, titles: Mapping[str, str], k: int = 1) -> Finding:
    """A small share of the distractors does much of the harm, and more do more (Fig. 6a)."""
    wide = table.pivot(index="method", columns="ratio", values="DAR")
    ratios = sorted(wide.columns)
    small = next((ratio for ratio in ratios if ratio > 0), None)
    if small is None or 0.0 not in ratios or len(ratios) < 3:
        return Finding("fig06", "", "", "", "the sweep needs the ratio 0 and two more", None)
    loss = wide[0.0] - wide[small]
    hit = [titles[m] for m in wide.index[loss > CLEARLY_PP]]
    falls = bool((np.diff(wide[ratios].to_numpy(), axis=1) <= 1e-9).all())
    return Finding(
        "fig06",
        f"Few distractors already do much of the harm; more of them lower DAR@{k} further for every method.",
        "at a ratio of 0.1 several methods stay well below R@1 (AnyLoc 95.9 % to 8.50 %)",
        f"at the smallest ratio some method is more than {CLEARLY_PP:g} pp below R@{k}, and no curve rises",
        f"at a ratio of {small:g}, {len(hit)} of {len(wide)} methods are more than {CLEARLY_PP:g} pp below R@{k}"
        f"{' (' + ', '.join(hit) + ')' if hit else ''}; the curves {'fall' if falls else 'do not all fall'} throughout",
        bool(falls and hit),
    )


def near_distractors_hurt_most(table: pd.DataFrame, titles: Mapping[str, str], unit: str, k: int = 1) -> Finding:
    """Distractors near the query do the most harm; distant ones still do some (Fig. 6b)."""
    wide = table.pivot(index="method", columns="distance", values="DAR")
    finite = [distance for distance in sorted(wide.columns) if np.isfinite(distance)]
    steps = np.diff(wide[finite].mean().to_numpy())
    largest = int(np.argmax(steps))
    left = wide[np.inf] - wide[finite[-1]]
    below = [titles[m] for m in wide.index[left > CLEARLY_PP]]
    rises = bool((np.diff(wide[sorted(wide.columns)].to_numpy(), axis=1) >= -1e-9).all())
    short = {"metres": "m", "frames": "frames"}.get(unit, unit)
    return Finding(
        "fig06",
        "Distractors near the query do the most harm, and distant ones still do some.",
        "largest gains between 25 m and 50 m; some methods stay well below R@1 at 200 m",
        f"the mean gain is largest in the first interval, and some method stays more than {CLEARLY_PP:g} pp below R@{k} at the end",
        f"the largest mean gain is between {finite[largest]:g} and {finite[largest + 1]:g} {short} (+{steps[largest]:.1f} pp); "
        f"at {finite[-1]:g} {short}, {len(below)} of {len(wide)} methods are still more than {CLEARLY_PP:g} pp below R@{k}"
        f"{' (' + ', '.join(below) + ')' if below else ''}",
        bool(rises and largest == 0 and below),
    )


def own_condition_hurts_most(
    table: pd.DataFrame, titles: Mapping[str, str], query_condition: str, database_condition: str, k: int = 1
) -> Finding:
    """Distractors under the query's own condition do the most harm (Fig. 7)."""
    wide = table.pivot_table(index="method", columns="condition", values="DAR", sort=False)
    pools = [column for column in wide.columns if column != "none"]
    lowest = wide[pools].idxmin(axis=1)
    agree = [m for m in wide.index if lowest[m] == query_condition]
    odd = [titles[m] for m in wide.index if m not in agree]
    return Finding(
        "fig07",
        "Distractors under the query's own condition are the most effective.",
        "sun,clouds distractors give the lowest DAR@1 for all eleven methods",
        f"the query's own condition gives the lowest DAR@{k} for every method",
        f"the query's own condition ({query_condition}) gives the lowest DAR@{k} for {len(agree)} of {len(wide)} methods"
        f"{' (not ' + ', '.join(odd) + ')' if odd else ''}",
        len(agree) == len(wide),
    )


def database_condition_hurts_little(
    table: pd.DataFrame, titles: Mapping[str, str], query_condition: str, database_condition: str, k: int = 1
) -> Finding:
    """Distractors under the database's condition take far fewer queries than those under the query's (Fig. 7)."""
    wide = table.pivot_table(index="method", columns="condition", values="DAR", sort=False)
    claim = "Distractors under the database's condition are far less effective."
    reported = "night distractors leave DAR@1 near R@1 for all eleven methods"
    rule = "on average they take less than half of the queries that the query's own condition takes"
    if database_condition not in wide:
        return Finding("fig07", claim, reported, rule, f"no pool of distractors is under {database_condition}", None)
    means = wide.mean()
    own, across = (means["none"] - means[name] for name in (query_condition, database_condition))
    shares = ", ".join(f"{name} {value:.1f} %" for name, value in means.items())
    found = f"mean DAR@{k} by pool: {shares} (none is R@{k})"
    return Finding("fig07", claim, reported, rule, found, bool(across < own / 2))
