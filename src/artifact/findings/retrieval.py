"""Claims on recall, distractors and rankings (paper §V-B and V-C)."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations

import numpy as np
import pandas as pd

from artifact.findings.finding import CLEARLY_PP, SIMILAR_PP, Finding
from artifact.metrics.statistics import rank_agreement
from artifact.studies.recall import with_means


def ranking_changes(table: pd.DataFrame, titles: Mapping[str, str], k: int = 1) -> Finding:
    """Methods rank differently by mean DAR@K than by mean R@K (Table III)."""
    means = with_means(table).set_index("method")
    agrees = None
    if len(means) < 2:
        found = "one method has no ranking"
    else:
        moved = means.index[means.rank_R != means.rank_DAR]
        tau = rank_agreement(means.R.to_numpy(), means.DAR.to_numpy())
        agrees = len(moved) > 0
        moves = "; ".join(f"{titles[m]} from {means.rank_R[m]} to {means.rank_DAR[m]}" for m in moved)
        found = (
            f"{len(moved)} of {len(means)} methods change rank{f' ({moves})' if moves else ''}; Kendall's τ = {tau:.2f}"
        )
    return Finding(
        "tab03",
        f"Ranking methods by mean DAR@{k} gives another order than ranking them by mean R@{k}.",
        "SALAD-CM rises from 4th to 1st, CricaVPR falls from 5th to 7th",
        "at least one method changes its rank",
        found,
        agrees,
    )


def similar_recall_hides_differences(table: pd.DataFrame, titles: Mapping[str, str], k: int = 1) -> Finding:
    """Two methods with similar R@K can differ widely in DAR@K (Table III, Fig. 5)."""
    pairs = [
        (abs(a["DAR"] - b["DAR"]), a, b)
        for _, rows in table.groupby("dataset", sort=False)
        for a, b in combinations(rows.to_dict("records"), 2)
        if abs(a["R"] - b["R"]) <= SIMILAR_PP
    ]
    found, agrees = f"no two methods are within {SIMILAR_PP:g} pp in R@{k} on any dataset", None
    if pairs:
        gap, a, b = max(pairs, key=lambda pair: pair[0])
        agrees = gap > CLEARLY_PP
        found = (
            f"on {a['title']}, {titles[a['method']]} and {titles[b['method']]} have R@{k} {a['R']:.1f} % and {b['R']:.1f} % "
            f"but DAR@{k} {a['DAR']:.1f} % and {b['DAR']:.1f} %"
        )
    return Finding(
        "fig05",
        f"Similar R@{k} can hide large differences in DAR@{k}.",
        "RobotCar: AnyLoc and SelaVPR have R@1 95.9 % and 98.2 %, DAR@1 4.21 % and 71.2 %",
        f"two methods within {SIMILAR_PP:g} pp in R@{k} differ by more than {CLEARLY_PP:g} pp in DAR@{k} on some dataset",
        found,
        agrees,
    )


def distractors_lower_recall(table: pd.DataFrame, titles: Mapping[str, str], k: int = 1) -> Finding:
    """Distractors take successes from nearly every method on nearly every dataset (Table III)."""
    loss = table["R"] - table["DAR"]
    worst = table.loc[loss.idxmax()]
    clear = int((loss > CLEARLY_PP).sum())
    return Finding(
        "tab03",
        f"DAR@{k} is at most R@{k}, and can be far below it.",
        "AnyLoc on RobotCar falls from 95.9 % to 4.21 %",
        f"DAR@{k} never exceeds R@{k}, and some pair loses more than {CLEARLY_PP:g} pp",
        f"{clear} of {len(table)} method–dataset pairs lose more than {CLEARLY_PP:g} pp; most: {titles[worst['method']]} on "
        f"{worst['title']}, {worst['R']:.1f} % to {worst['DAR']:.1f} %",
        bool((loss >= 0).all() and clear > 0),
    )


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
