"""Figs. 6 and 7: number, distance and condition of distractors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from IPython.display import HTML
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from artifact.pages.common import CLEARLY_PP, claim, listed
from artifact.pages.style import curve, embed, method_legend, method_style, percent_axis
from artifact.studies import reported

_RENAMED = {"dar_percent": "DAR", "minimum_distance_metres": "distance", "distractor_condition": "condition"}


def number_and_distance(
    number: pd.DataFrame,
    distance: pd.DataFrame,
    titles: Mapping[str, str],
    *,
    k: int = 1,
    source: str = "measured in this run",
) -> HTML:
    """Fig. 6: DAR@K against the number of distractors (a) and their minimum distance in metres (b)."""
    figure = Figure(figsize=(8.2, 3.3))
    left, right = figure.subplots(1, 2, sharey=True)
    for method, rows in number.groupby("method", sort=False):
        curve(left, rows["ratio"], rows["DAR"], method, list(titles))
        _draw_reported(left, rows["ratio"], rows, method, titles)
        if "draw_low" in rows:
            colour = method_style(method, list(titles)).colour
            left.fill_between(rows["ratio"], rows["draw_low"], rows["draw_high"], color=colour, alpha=0.18, linewidth=0)
    left.set(xlabel="Distractor-to-query ratio", title="(a) Distractor number")
    _draw_distance(right, distance, titles)
    percent_axis(left, f"DAR@{k} (%)")
    percent_axis(right)
    figure.tight_layout(w_pad=1.2)
    method_legend(figure, titles, reported=_has_reported(number) or _has_reported(distance))
    return embed(figure, f"DAR@{k} against distractor number and distance, {source}")


def reported_number_and_distance() -> HTML:
    """Draw Fig. 6 from the values that the paper plots for RobotCar."""
    tables = [reported.table(name).rename(columns=_RENAMED) for name in ("fig06_number", "fig06_distance")]
    return number_and_distance(*tables, reported.method_titles(), source="reported by the paper for RobotCar")


def about_draws(number: pd.DataFrame, titles: Mapping[str, str]) -> str:
    """Say what the lines and bands of Fig. 6a are: exact expectations or means of draws, and of how many.

    Parameters
    ----------
    number
        As from :func:`artifact.studies.distractors.distractor_number`.
    titles
        Method name to printed title.
    """
    drawn = number.groupby("method", sort=False)["draws"].max()
    exact = [titles[method] for method in drawn.index if drawn[method] == 0]
    parts = []
    if exact:
        whose = "the line" if len(exact) == len(drawn) else f"the line of {', '.join(exact)}"
        parts.append(f"{whose} is the exact expectation over all random subsets of the pool")
    parts += [
        f"that of {titles[method]} is the mean of {count} nested random draws"
        for method, count in drawn.items()
        if count
    ]
    return (
        f"In (a) {'; '.join(parts)}. The band spans nested random draws. The paper says only that it samples at random."
    )


def _has_reported(table: pd.DataFrame) -> bool:
    return "reported" in table and table["reported"].notna().any()


def _draw_reported(
    axes: Axes, x: Sequence[float] | pd.Series, rows: pd.DataFrame, method: str, titles: Mapping[str, str]
) -> None:
    """Draw what the paper reports for a measured curve, dashed and without markers, below it."""
    if _has_reported(rows):
        colour = method_style(method, list(titles)).colour
        axes.plot(x, rows["reported"], linestyle=(0, (4, 2)), color=colour, alpha=0.55, linewidth=2.6, zorder=1)


def _draw_distance(axes: Axes, distance: pd.DataFrame, titles: Mapping[str, str]) -> None:
    """Curves over distance with infinity at an equal step beyond the last finite one, right of a dashed line."""
    finite = sorted(x for x in distance["distance"].unique() if np.isfinite(x))
    gap = 0.2 * (finite[-1] - finite[0]) if len(finite) > 1 else 1.0
    end = finite[-1] + gap
    for method, rows in distance.groupby("method", sort=False):
        ordered = rows.sort_values("distance")
        places = ordered["distance"].replace(np.inf, end)
        curve(axes, places, ordered["DAR"], method, list(titles))
        _draw_reported(axes, places, ordered, method, titles)
    axes.axvline(finite[-1] + gap / 2, linestyle="--", color="0.6", linewidth=0.9)
    axes.set_xticks([*finite, end], [*(f"{x:g}" for x in finite), "∞"])
    axes.set(xlabel="Minimum distractor distance (m)", title="(b) Distractor distance")


def condition(
    table: pd.DataFrame,
    titles: Mapping[str, str],
    *,
    query_condition: str,
    k: int = 1,
    source: str = "measured in this run",
) -> HTML:
    """Fig. 7: DAR@K by the condition of the distractors, ordered by the mean over methods.

    Where two traversals have one condition, their names tell them apart.
    """
    table = table.assign(pool=_pools(table))
    means = table.groupby("pool", sort=False)["DAR"].mean().sort_values()
    order = [*(name for name in means.index if name != "none"), "none"]
    figure = Figure(figsize=(6.4, 3.4))
    axes = figure.subplots()
    for method, rows in table.groupby("method", sort=False):
        rows = rows.set_index("pool").loc[order]
        curve(axes, range(len(order)), rows["DAR"].to_list(), method, list(titles))
        _draw_reported(axes, range(len(order)), rows, method, titles)
    query = table["pool"].iloc[0] if "traversal" in table else query_condition
    labels = [f"{name}\n(query)" if name == query else name for name in order]
    axes.set_xticks(range(len(order)), labels)
    axes.set_xlabel("Distractor set")
    percent_axis(axes, f"DAR@{k} (%)")
    figure.tight_layout()
    method_legend(figure, titles, reported=_has_reported(table))
    return embed(figure, f"DAR@{k} by the condition of the distractors, {source}")


def _pools(table: pd.DataFrame) -> pd.Series:
    """Printed name of each pool: its condition, with the traversal where several have that condition."""
    if "traversal" not in table:
        return table["condition"]
    several = table.groupby("condition")["traversal"].nunique()
    both = table["condition"] + "\n" + table["traversal"]
    return table["condition"].where(table["condition"].map(several) == 1, both)


def reported_condition() -> HTML:
    """Draw Fig. 7 from the values that the paper plots for RobotCar."""
    table, titles = reported.table("fig07").rename(columns=_RENAMED), reported.method_titles()
    return condition(table, titles, query_condition="sun,clouds", source="reported by the paper for RobotCar")


@claim(
    "fig06",
    "Few distractors already do much of the harm; more of them lower DAR@K further for every method.",
    paper="at a ratio of 0.1 several methods stay well below R@1 (AnyLoc 95.9 % to 8.50 %)",
    rule=f"at the smallest ratio some method is more than {CLEARLY_PP:g} pp below R@K, and no curve rises",
)
def few_distractors_suffice(table: pd.DataFrame, titles: Mapping[str, str], k: int = 1) -> tuple[str, bool | None]:
    """A small share of the distractors does much of the harm, and more do more (Fig. 6a)."""
    wide = table.pivot(index="method", columns="ratio", values="DAR")
    ratios = sorted(wide.columns)
    if len(ratios) < 3 or ratios[0] != 0:
        return "the sweep needs the ratio 0 and two more", None
    small = ratios[1]
    hit = [titles[m] for m in wide.index[wide[0.0] - wide[small] > CLEARLY_PP]]
    falls = bool((np.diff(wide[ratios].to_numpy(), axis=1) <= 1e-9).all())
    found = (
        f"at a ratio of {small:g}, {len(hit)} of {len(wide)} methods are more than {CLEARLY_PP:g} pp below R@{k}"
        f"{listed(hit)}; the curves {'fall' if falls else 'do not all fall'} throughout"
    )
    return found, bool(falls and hit)


@claim(
    "fig06",
    "Distractors near the query do the most harm, and distant ones still do some.",
    paper="largest gains between 25 m and 50 m; some methods stay well below R@1 at 200 m",
    rule=f"the mean gain is largest in the first interval, and some method stays more than {CLEARLY_PP:g} pp below R@K at "
    "the end",
)
def near_distractors_hurt_most(table: pd.DataFrame, titles: Mapping[str, str], k: int = 1) -> tuple[str, bool | None]:
    """Distractors near the query do the most harm; distant ones still do some (Fig. 6b)."""
    wide = table.pivot(index="method", columns="distance", values="DAR").sort_index(axis=1)
    finite = [distance for distance in wide.columns if np.isfinite(distance)]
    steps = np.diff(wide[finite].mean().to_numpy())
    largest = int(np.argmax(steps))
    below = [titles[m] for m in wide.index[wide[np.inf] - wide[finite[-1]] > CLEARLY_PP]]
    rises = bool((np.diff(wide.to_numpy(), axis=1) >= -1e-9).all())
    found = (
        f"the largest mean gain is between {finite[largest]:g} and {finite[largest + 1]:g} m (+{steps[largest]:.1f} pp); "
        f"at {finite[-1]:g} m, {len(below)} of {len(wide)} methods are still more than {CLEARLY_PP:g} pp below R@{k}"
        f"{listed(below)}"
    )
    return found, bool(rises and largest == 0 and below)


@claim(
    "fig07",
    "Distractors under the query's own condition are the most effective.",
    paper="sun,clouds distractors give the lowest DAR@1 for all eleven methods",
    rule="the query's own condition gives the lowest DAR@K for every method",
)
def own_condition_hurts_most(
    table: pd.DataFrame, titles: Mapping[str, str], conditions: tuple[str, str], k: int = 1
) -> tuple[str, bool | None]:
    """Distractors under the query's own condition do the most harm (Fig. 7)."""
    own, wide = conditions[0], _by_condition(table)
    lowest = wide.drop(columns="none").idxmin(axis=1)
    odd = [titles[method] for method in wide.index if lowest[method] != own]
    found = (
        f"the query's own condition ({own}) gives the lowest DAR@{k} for {len(wide) - len(odd)} of {len(wide)} methods"
    )
    return f"{found}{listed(odd, 'not ')}", not odd


@claim(
    "fig07",
    "Distractors under the database's condition are far less effective.",
    paper="night distractors leave DAR@1 near R@1 for all eleven methods",
    rule="on average they take less than half of the queries that the query's own condition takes",
)
def database_condition_hurts_little(
    table: pd.DataFrame, conditions: tuple[str, str], k: int = 1
) -> tuple[str, bool | None]:
    """Distractors under the database's condition take far fewer queries than those under the query's (Fig. 7)."""
    means = _by_condition(table).mean()
    if conditions[1] not in means:
        return f"no pool of distractors is under {conditions[1]}", None
    own, across = (means["none"] - means[name] for name in conditions)
    shares = ", ".join(f"{name} {value:.1f} %" for name, value in means.items())
    return f"mean DAR@{k} by pool: {shares} (none is R@{k})", bool(across < own / 2)


def _by_condition(table: pd.DataFrame) -> pd.DataFrame:
    return table.pivot_table(index="method", columns="condition", values="DAR", sort=False)
