"""Figs. 6 and 7: number, distance and condition of distractors."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from operator import itemgetter
from typing import Any

import numpy as np
import pandas as pd
from IPython.display import HTML
from matplotlib.axes import Axes

from artifact.pages.common import CLEARLY_PP, NOTHING_TO_COMPARE, Answer, Titles, claimed, listed, table
from artifact.pages.style import REPORTED_LINE, drawing, embed, marker_options, method_legend, percent_axis, tell_values
from artifact.studies import reported
from artifact.studies.common import Study
from artifact.studies.judging import Judged, above, all_above, some_above

_RENAMED = {"dar_percent": "DAR", "minimum_distance_metres": "distance", "distractor_condition": "condition"}


def number_and_distance(
    number: pd.DataFrame, distance: pd.DataFrame, titles: Titles, *, k: int = 1, source: str = "measured in this run"
) -> HTML:
    """Fig. 6: DAR@K against the number of distractors (a) and their minimum distance in metres (b)."""
    figure, (left, right) = drawing((8.2, 3.3), columns=2)
    for method, rows in number.groupby("method", sort=False):
        _draw_curve(left, rows["ratio"], rows, method, titles)
        if "draw_low" in rows:
            colour = marker_options(method, titles)["color"]
            left.fill_between(rows["ratio"], rows["draw_low"], rows["draw_high"], color=colour, alpha=0.18, linewidth=0)
    left.set(xlabel="Distractor-to-query ratio", title="(a) Distractor number")
    _draw_distance(right, distance, titles)
    for axes in (left, right):
        percent_axis(axes, f"DAR@{k} (%)")
    method_legend(figure, titles, reported=_has_reported(number) or _has_reported(distance), gap=1.2)
    return embed(figure, f"DAR@{k} against distractor number and distance, {source}")


def reported_number_and_distance() -> HTML:
    """Draw Fig. 6 from the values that the paper plots for RobotCar."""
    tables = [reported.table(name).rename(columns=_RENAMED) for name in ("fig06_number", "fig06_distance")]
    return number_and_distance(*tables, reported.method_titles(), source="reported by the paper for RobotCar")


def about_draws(number: pd.DataFrame, titles: Titles) -> str:
    """Say what the lines and bands of Fig. 6a are: exact expectations or means of draws, and of how many."""
    drawn = number.groupby("method", sort=False)["draws"].max()
    exact = [titles[method] for method in drawn.index[drawn == 0]]
    whose = "the line" if len(exact) == len(drawn) else f"the line of {', '.join(exact)}"
    parts = [f"{whose} is the exact expectation over all random subsets of the pool"] if exact else []
    for method, count in drawn[drawn > 0].items():
        parts.append(f"that of {titles[method]} is the mean of {count} nested random draws")
    lines = "; ".join(parts)
    return f"In (a) {lines}. The band spans nested random draws. The paper says only that it samples at random."


def _has_reported(table: pd.DataFrame) -> bool:
    return "reported" in table and table["reported"].notna().any()


def _draw_curve(axes: Axes, x: Sequence[float] | pd.Series, rows: pd.DataFrame, method: str, titles: Titles) -> None:
    """One method's curve, and what the paper reports for it below."""
    options = marker_options(method, titles)
    axes.plot(x, rows["DAR"], **options)
    tell_values(axes, np.column_stack([x, rows["DAR"]]), (f"{titles[method]}: {value:.2f} %" for value in rows["DAR"]))
    if _has_reported(rows):
        axes.plot(x, rows["reported"], color=options["color"], zorder=1, **REPORTED_LINE)


def _draw_distance(axes: Axes, distance: pd.DataFrame, titles: Titles) -> None:
    """Curves over distance with infinity at an equal step beyond the last finite one, right of a dashed line."""
    finite = sorted(x for x in distance["distance"].unique() if np.isfinite(x))
    gap = 0.2 * (finite[-1] - finite[0]) if len(finite) > 1 else 1.0
    end = finite[-1] + gap
    for method, rows in distance.sort_values("distance", kind="stable").groupby("method", sort=False):
        _draw_curve(axes, rows["distance"].replace(np.inf, end), rows, method, titles)
    axes.axvline(finite[-1] + gap / 2, linestyle="--", color="0.6", linewidth=0.9)
    axes.set_xticks([*finite, end], [*(f"{x:g}" for x in finite), "∞"])
    axes.set(xlabel="Minimum distractor distance (m)", title="(b) Distractor distance")


def condition(
    table: pd.DataFrame, titles: Titles, *, query_condition: str, k: int = 1, source: str = "measured in this run"
) -> HTML:
    """Fig. 7: DAR@K by the condition of the distractors, ordered by the mean over methods.

    Where two traversals have one condition, their names tell them apart.
    """
    table = table.assign(pool=_pools(table))
    means = table.groupby("pool", sort=False)["DAR"].mean().sort_values()
    order = [*(name for name in means.index if name != "none"), "none"]
    figure, axes = drawing((6.4, 3.4))
    for method, rows in table.groupby("method", sort=False):
        _draw_curve(axes, range(len(order)), rows.set_index("pool").loc[order], method, titles)
    query = table["pool"].iloc[0] if "traversal" in table else query_condition
    labels = [f"{name}\n(query)" if name == query else name for name in order]
    axes.set_xticks(range(len(order)), labels)
    axes.set_xlabel("Distractor set")
    percent_axis(axes, f"DAR@{k} (%)")
    method_legend(figure, titles, reported=_has_reported(table))
    return embed(figure, f"DAR@{k} by the condition of the distractors, {source}")


def _pools(table: pd.DataFrame) -> pd.Series:
    """Printed name of each pool: its condition, with the traversal where several have that condition."""
    if "traversal" not in table:
        return table["condition"]
    alone = table.groupby("condition")["traversal"].transform("nunique") == 1
    return table["condition"].where(alone, table["condition"] + "\n" + table["traversal"])


def reported_condition() -> HTML:
    """Draw Fig. 7 from the values that the paper plots for RobotCar."""
    table, titles = reported.table("fig07").rename(columns=_RENAMED), reported.method_titles()
    return condition(table, titles, query_condition="sun,clouds", source="reported by the paper for RobotCar")


def _wide(study: Study, column: str) -> tuple[pd.DataFrame, dict[Any, np.ndarray]]:
    """DAR by method (rows) and a column, and the replicates ``(methods, count)`` of each of its values."""
    table, sample = study.table, study.replicates["DAR"]
    wide = table.pivot(index="method", columns=column, values="DAR").reindex(table["method"].unique())
    return wide, {value: sample[(table[column] == value).to_numpy()] for value in wide.columns}


_TOO_FEW_RATIOS = "the sweep needs the ratio 0 and two more", Judged("cannot tell", "the parameters leave it out")


@claimed
def few_distractors_suffice(study: Study, titles: Titles, k: int = 1) -> Answer:
    """A small share of the distractors does much of the harm (Fig. 6a)."""
    wide, sample = _wide(study, "ratio")
    ratios = sorted(wide.columns)
    if len(ratios) < 3 or ratios[0] != 0:
        return _TOO_FEW_RATIOS
    small = ratios[1]
    judged, certain = some_above((wide[0.0] - wide[small]).to_numpy(), sample[0.0] - sample[small], CLEARLY_PP)
    hit = [titles[m] for m in wide.index[certain]]
    found = f"at a ratio of {small:g}, {len(hit)} of {len(wide)} methods are more than {CLEARLY_PP:g} pp below R@{k} beyond chance"
    return f"{found}{listed(hit)}", judged


@claimed
def more_distractors_hurt_more(study: Study, titles: Titles, k: int = 1) -> Answer:
    """More distractors take more queries (Fig. 6a)."""
    wide, sample = _wide(study, "ratio")
    ratios = sorted(wide.columns)
    if len(ratios) < 3 or ratios[0] != 0:
        return _TOO_FEW_RATIOS
    small, most = ratios[1], ratios[-1]
    steps = wide[small] - wide[most]
    falls = ", ".join(f"{titles[m]} {step:.1f}" for m, step in steps.items())
    judged = all_above(steps.to_numpy(), sample[small] - sample[most], 0)
    return f"from a ratio of {small:g} to {most:g} DAR@{k} falls by {falls} pp", judged


def _by_dataset(study: Study) -> Iterator[tuple[str, Study]]:
    """Title and rows of each dataset."""
    for _, rows in study.table.reset_index(drop=True).groupby("dataset", sort=False):
        yield rows["title"].iloc[0], Study(rows, (), {"DAR": study.replicates["DAR"][rows.index]})


def _gains(part: Study) -> tuple[pd.DataFrame, np.ndarray]:
    """Gain of mean DAR over methods when the distractors of each interval of distances leave, on one dataset.

    Returns a row per interval, ``from``, ``to``, ``gain`` (pp), ``removed`` (distractors of a query) and ``per_distractor``,
    and the replicates of the last, ``(intervals, count)``.
    """
    wide, sample = _wide(part, "distance")
    left = part.table.groupby("distance")["distractors"].first()
    rows, drawn = [], []
    for near, far in pairwise(sorted(distance for distance in wide.columns if np.isfinite(distance))):
        removed, gain = left[near] - left[far], (wide[far] - wide[near]).mean()
        if removed > 0:
            rows.append({"from": near, "to": far, "gain": gain, "removed": removed, "per_distractor": gain / removed})
            drawn.append((sample[far] - sample[near]).mean(axis=0) / removed)
    return pd.DataFrame(rows), np.array(drawn)


def gains_table(study: Study, titles: Titles, *, k: int = 1) -> HTML:
    """Show what mean DAR@K gains when the distractors of each interval of distances leave, on every dataset."""
    rows = []
    for title, part in _by_dataset(study):
        for row in _gains(part)[0].to_dict("records"):
            cells = {"Dataset": title, "Distractors leave between": f"{row['from']:g} and {row['to']:g} m"}
            cells |= {f"Gain of DAR@{k} (pp)": f"{row['gain']:.1f}", "Distractors of a query": f"{row['removed']:.1f}"}
            rows.append(cells | {"Gain per distractor (pp)": f"{row['per_distractor']:.2f}"})
    return table(rows, text=2, caption=f"Means over {len(titles)} methods, measured in this run.")


@claimed
def near_distractors_hurt_most(study: Study, titles: Titles, k: int = 1) -> Answer:
    """Near distractors do more harm than as many distant ones (Fig. 6b)."""
    found = [(title, *_gains(part)) for title, part in _by_dataset(study)]
    found = [one for one in found if len(one[1]) > 1]
    if not found:
        return "no dataset has distractors at two distances", NOTHING_TO_COMPARE
    titled = [(title, table["per_distractor"].tolist()) for title, table, _ in found]
    gains, samples = [one for _, one in titled], [drawn for *_, drawn in found]
    shortest = min(map(len, gains))
    means, drawn = (np.mean([one[:shortest] for one in of], axis=0) for of in (gains, samples))
    first = [title for title, one in titled if one[0] == max(one)]
    listing = "; ".join(f"{title} {one[0]:.2f}, then {max(one[1:]):.2f} at most" for title, one in titled)
    text = (
        f"the first interval has the largest gain per removed distractor on {len(first)} of {len(found)} datasets"
        f"{listed(first)}; pp per distractor: {listing}"
    )
    return text, above(means[0] - means[1:].max(), drawn[0] - drawn[1:].max(axis=0), 0, "pp per distractor")


@claimed
def far_distractors_still_hurt(study: Study, titles: Titles, k: int = 1) -> Answer:
    """Distant distractors still take queries (Fig. 6b)."""
    values, samples, names = [], [], []
    for title, part in _by_dataset(study):
        wide, sample = _wide(part, "distance")
        last = max(distance for distance in wide.columns if np.isfinite(distance))
        values += (wide[np.inf] - wide[last]).tolist()
        samples.append(sample[np.inf] - sample[last])
        names += [f"{titles[m]} on {title} at {last:g} m" for m in wide.index]
    judged, certain = some_above(np.array(values), np.concatenate(samples), CLEARLY_PP)
    most, where = max(zip(values, names, strict=True), key=itemgetter(0))
    return f"{certain.sum()} of {len(values)} pairs beyond chance; most: {where}, {most:.1f} pp below R@{k}", judged


def _by_condition(study: Study) -> tuple[pd.DataFrame, dict[str, np.ndarray]]:
    """DAR by method and condition, and replicates; traversals of one condition are averaged."""
    table, sample = study.table, study.replicates["DAR"]
    wide = table.pivot_table(index="method", columns="condition", values="DAR", sort=False)
    groups = table.groupby(["method", "condition"], sort=False).indices
    return wide, {c: np.stack([sample[groups[m, c]].mean(axis=0) for m in wide.index]) for c in wide.columns}


def _mean_by_condition(study: Study) -> tuple[pd.Series, dict[str, np.ndarray]]:
    """Mean DAR over methods by condition, and its replicates."""
    wide, sample = _by_condition(study)
    return wide.mean(), {name: one.mean(axis=0) for name, one in sample.items()}


@claimed
def own_condition_hurts_most(study: Study, titles: Titles, conditions: tuple[str, str], k: int = 1) -> Answer:
    """Distractors under the query's own condition do the most harm (Fig. 7)."""
    own, (wide, sample) = conditions[0], _by_condition(study)
    others = [name for name in wide.columns if name not in (own, "none")]
    if not others:
        return "all pools are under the query's condition", NOTHING_TO_COMPARE
    lowest = wide.drop(columns="none").idxmin(axis=1)
    odd = [titles[method] for method, name in lowest.items() if name != own]
    found = f"the query's own condition ({own}) gives the lowest DAR@{k} for {len(wide) - len(odd)} of {len(wide)}"
    values = np.concatenate([wide[name] - wide[own] for name in others])
    judged = all_above(values, np.concatenate([sample[name] - sample[own] for name in others]), 0)
    return f"{found} methods{listed(odd, 'not ')}", judged


@claimed
def conditions_between_hurt_less(study: Study, conditions: tuple[str, str], k: int = 1) -> Answer:
    """Other conditions take fewer queries than the query's own and more than the database's (Fig. 7)."""
    means, drawn = _mean_by_condition(study)
    between = [name for name in means.index if name not in (*conditions, "none")]
    if conditions[1] not in means or not between:
        return "no pools of three conditions", NOTHING_TO_COMPARE
    own, other = conditions
    steps = [(own, name) for name in between] + [(name, other) for name in between]
    values, samples = (np.array([of[b] - of[a] for a, b in steps]) for of in (means, drawn))
    return _means_in_words(means, k), all_above(values, samples, 0)


@claimed
def database_condition_hurts_little(study: Study, conditions: tuple[str, str], k: int = 1) -> Answer:
    """Distractors under the database's condition take far fewer queries than those under the query's (Fig. 7)."""
    means, drawn = _mean_by_condition(study)
    if conditions[1] not in means:
        return f"no pool of distractors is under {conditions[1]}", NOTHING_TO_COMPARE
    (own, across), (own_drawn, across_drawn) = ([of["none"] - of[name] for name in conditions] for of in (means, drawn))
    return _means_in_words(means, k), above(own / 2 - across, own_drawn / 2 - across_drawn, 0)


def _means_in_words(means: pd.Series, k: int) -> str:
    shares = ", ".join(f"{name} {value:.1f} %" for name, value in means.items())
    return f"mean DAR@{k} by pool: {shares} (none is R@{k})"
