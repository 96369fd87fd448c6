"""The rules by which a measured number is held against the one that the paper prints, and a claim against a run.

A number is *equal* to the paper's if it is the same number of queries (the scatter plot prints two decimals, from which it
follows), or equal after rounding to the printed digits. It *agrees* if the reported value lies in the 95 % interval of the
measured one and within 1 percentage point of it (counts of pairs: 1 pair), *differs* if it is outside both, and for anything
else one *cannot tell*; the reason is given in words.

Claims in words get *agrees* where the interval of what they are about lies on their side, *differs* where it lies on the
other, and *cannot tell* between.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from scipy.stats import binomtest

from artifact.metrics import statistics

Verdict = Literal["equal", "agrees", "differs", "cannot tell"]
VERDICTS: tuple[Verdict, ...] = ("equal", "agrees", "differs", "cannot tell")
CLOSE_PP = 1.0
"""Largest difference in percentage points of a value that agrees: the paper's own margin in Tables IV and V."""


class Judged(NamedTuple):
    """A verdict and the reason for it, in words."""

    verdict: Verdict
    why: str


def judge(
    measured: float,
    expected: float,
    *,
    digits: int,
    low: float = math.nan,
    high: float = math.nan,
    hits: tuple[int, int] | None = None,
    expected_queries: int | None = None,
    margin: float = CLOSE_PP,
    unit: str = "pp",
) -> Judged:
    """Compare a measured number with the reported one, both in percent, percentage points or as a count.

    Parameters
    ----------
    digits
        Decimals that the paper prints.
    low, high
        The 95 % interval of the measured number.
    hits, expected_queries
        Where the number is a share of queries: measured successes and queries, and the queries of the paper.
    margin, unit
        Largest difference of a value that agrees.

    Raises
    ------
    ValueError
        If the paper's number is missing.

    Examples
    --------
    >>> judge(95.924, 95.92, digits=2, hits=(5743, 5987), expected_queries=5987)
    Judged(verdict='equal', why='5743 of 5987 queries in both')
    >>> judge(95.1, 95.92, digits=2, low=94.5, high=96.0).verdict
    'agrees'
    >>> judge(80.0, 95.92, digits=2, low=78.0, high=82.0).verdict
    'differs'
    """
    if math.isnan(expected):
        raise ValueError("the paper's number is missing: only numbers that it prints can be compared")
    if math.isnan(measured):
        return Judged("cannot tell", "nothing was measured")
    half = 0.5 * 10.0**-digits
    if hits is not None and hits[1] == expected_queries and abs(hits[0] - round(expected * hits[1] / 100)) < 1:
        return Judged("equal", f"{hits[0]} of {hits[1]} queries in both")
    if abs(measured - expected) <= half * (1 + 1e-9) + 1e-9:
        return Judged("equal", f"the same to {digits} decimals" if digits else "the same number")
    if math.isnan(low):
        return Judged("cannot tell", "no interval could be measured")
    inside, close = low <= expected <= high, abs(measured - expected) <= margin + 1e-9
    shown = f"{margin:g} {unit}"
    if inside and close:
        return Judged("agrees", f"in the 95 % interval and within {shown}")
    if inside:
        return Judged("cannot tell", f"in the 95 % interval, which is wider than {shown}")
    if close:
        return Judged("cannot tell", f"within {shown}, but outside the 95 % interval")
    return Judged("differs", f"outside the 95 % interval, and more than {shown} away")


def printed_digits(percent: float) -> int:
    """Return the decimals with which the paper prints a percentage: three significant digits, two decimals at most."""
    return 2 if abs(percent) < 9.995 else 1 if abs(percent) < 99.95 else 0


# -- claims in words ------------------------------------------------------------------------------------------------

CERTAIN = 0.05
"""Largest p-value, adjusted for the number of tests, of a difference beyond chance."""


def above(value: float, sample: np.ndarray, bound: float, unit: str = "pp") -> Judged:
    """Judge the claim that a number is above a bound by its 95 % interval, from replicates ``(count,)``.

    Examples
    --------
    >>> above(5.0, np.linspace(4, 6, 100), 0).verdict, above(5.0, np.linspace(-1, 11, 100), 0).verdict
    ('agrees', 'cannot tell')
    """
    return _above(value, *statistics.ends(sample), bound, unit)


def mostly(found: np.ndarray) -> Judged:
    """Judge the claim that something holds of more than half of some pairs ``(n,)`` by the share's interval (Wilson 1927).

    Examples
    --------
    >>> mostly(np.repeat([True, False], [40, 14])).verdict, mostly(np.array([True, True])).verdict
    ('agrees', 'cannot tell')
    """
    interval = binomtest(int(found.sum()), len(found)).proportion_ci(method="wilson")
    return _above(100 * found.mean(), 100 * interval.low, 100 * interval.high, 50, "% of pairs")


def more_often(first: np.ndarray, second: np.ndarray) -> Judged:
    """Judge the claim that something holds of more pairs ``(n,)`` with one method than with another.

    By the pairs of which it holds with one of them alone (exact McNemar test, 5 % on both sides).
    """
    more, fewer = int((first & ~second).sum()), int((second & ~first).sum())
    p = binomtest(more, more + fewer).pvalue if more + fewer else 1.0
    why = f"{more} pairs with it alone, {fewer} with the other alone, p = {p:.2g} (McNemar)"
    if p >= CERTAIN:
        return Judged("cannot tell", why)
    return Judged("agrees" if more > fewer else "differs", why)


def _above(value: float, low: float, high: float, bound: float, unit: str) -> Judged:
    interval = f"{value:.1f} {unit}, 95 % interval [{low:.1f}, {high:.1f}]"
    if math.isnan(low) or math.isnan(value):
        return Judged("cannot tell", "nothing could be measured")
    if low > bound:
        return Judged("agrees", f"{interval}, above {bound:g}")
    if high < bound:
        return Judged("differs", f"{interval}, below {bound:g}")
    return Judged("cannot tell", f"{interval}, holds {bound:g}")


def within(value: float, sample: np.ndarray, margin: float, resolution: float) -> Judged:
    """Judge the claim that a number is between ``-margin`` and ``margin``; ``resolution`` is the worth of a query in pp."""
    low, high = statistics.ends(sample)
    interval = f"{value:+.2f} pp, 95 % interval [{low:.2f}, {high:.2f}]"
    if math.isnan(low) or math.isnan(value):
        return Judged("cannot tell", "nothing could be measured")
    if -margin <= low and high <= margin:
        return Judged("agrees", f"{interval}, within {margin:g} pp")
    if low > margin or high < -margin:
        return Judged("differs", f"{interval}, beyond {margin:g} pp")
    why = f"{interval}, reaches beyond {margin:g} pp; a query is worth up to {resolution:.2g} pp of it"
    return Judged("cannot tell", why)


def some_above(values: np.ndarray, samples: np.ndarray, bound: float) -> tuple[Judged, np.ndarray]:
    """Judge the claim that some of several numbers is above a bound, and say which are beyond chance.

    Numbers ``(m,)`` have replicates ``(m, count)``; p-values are adjusted for all of them (Holm). It *differs* if every
    95 % interval is below the bound.
    """
    values = np.asarray(values, np.float64)
    p = statistics.holm(statistics.p_values(values - bound, samples - bound))
    certain = (values > bound) & (p < CERTAIN)
    if certain.any():
        return Judged("agrees", f"{certain.sum()} of {len(values)} beyond chance (Holm over {len(values)})"), certain
    if (statistics.ends(samples)[1] < bound).all():
        return Judged("differs", f"all {len(values)} intervals are below {bound:g} pp"), certain
    return Judged("cannot tell", f"none of {len(values)} beyond chance (Holm over {len(values)})"), certain


def all_above(values: np.ndarray, samples: np.ndarray, bound: float) -> Judged:
    """Judge the claim that each of several numbers ``(m,)`` is above a bound, from replicates ``(m, count)``.

    It *agrees* if every 95 % interval is above the bound, and *differs* if one number is below it beyond chance (Holm).
    """
    values = np.asarray(values, np.float64)
    low, _ = statistics.ends(samples)
    if (low > bound).all():
        return Judged("agrees", f"all {len(values)} intervals are above {bound:g} pp")
    below = (values < bound) & (statistics.holm(statistics.p_values(values - bound, samples - bound)) < CERTAIN)
    if below.any():
        why = f"{below.sum()} of {len(values)} below {bound:g} pp beyond chance (Holm over {len(values)})"
        return Judged("differs", why)
    return Judged("cannot tell", f"{(low <= bound).sum()} of {len(values)} intervals reach down to {bound:g} pp")


def first_of(*judged: Judged) -> Judged:
    """Judge a claim that holds if each of its parts does: the first part that differs, else that cannot be told, decides."""
    for verdict in ("differs", "cannot tell"):
        for one in judged:
            if one.verdict == verdict:
                return one
    return judged[0] if len(judged) == 1 else Judged("agrees", "; ".join(dict.fromkeys(one.why for one in judged)))


def changes_places(
    first: np.ndarray, second: np.ndarray, samples: tuple[np.ndarray, np.ndarray], groups: Sequence[Any]
) -> tuple[Judged, list[tuple[int, int]]]:
    """Judge the claim that two scores order methods differently, and return the pairs of rows that do beyond chance.

    Scores are ``(m,)`` with replicates ``(m, count)``; pairs are made within equal ``groups``. A pair counts where both scores
    differ, in opposite directions, beyond chance: the larger of both p-values, adjusted for all pairs (Holm).
    """
    pairs = [(i, j) for i, j in itertools.combinations(range(len(groups)), 2) if groups[i] == groups[j]]
    if not pairs:
        return Judged("cannot tell", "one method has no order"), []
    i, j = np.array(pairs).T
    steps = [score[i] - score[j] for score in (first, second)]
    p = np.stack([statistics.p_values(step, of[i] - of[j]) for step, of in zip(steps, samples, strict=True)])
    opposite = steps[0] * steps[1] < 0
    found = opposite & (statistics.holm(np.where(opposite, p.max(axis=0), 1.0)) < CERTAIN)
    certain = [pair for pair, one in zip(pairs, found, strict=True) if one]
    why = f"{opposite.sum()} of {len(pairs)} pairs of methods change places, {len(certain)} beyond chance"
    if certain:
        return Judged("agrees", why), certain
    if not opposite.any() and (p < CERTAIN).all():
        return Judged("differs", f"all {len(pairs)} pairs of methods keep their places beyond chance"), certain
    return Judged("cannot tell", why), certain
