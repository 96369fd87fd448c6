"""How sure a number is: intervals along a traversal, differences that are beyond chance, agreement of rankings.

Neighbouring images of a traversal succeed and fail together, so queries are resampled in blocks of consecutive
ones (circular block bootstrap, Politis and Romano 1992); treating them as independent would give intervals that
are far too narrow. All that is measured on the same queries is resampled by the same draws: replicates of differences are
differences of replicates (paired). The same seed gives the same interval.
"""

from __future__ import annotations

import zlib
from typing import NamedTuple

import numpy as np
from scipy.stats import norm, t

from artifact.metrics.result import Result

COUNT = 1000  # resamples
_TAILS = ((1 - 0.95) / 2, (1 + 0.95) / 2)


class Interval(NamedTuple):
    """A value with the ends of its confidence interval, all in the same unit."""

    value: float
    low: float
    high: float


def block_length(positions: np.ndarray, threshold: float) -> int:
    """Return how many consecutive queries at ``(n, p)`` are resampled together.

    Those within twice the threshold along the path share a place. Neighbours look alike beyond a tolerance of a few frames:
    a block has at least the cube root of n queries, the usual rate. Queries without an order (threshold 0) go one by one.

    Examples
    --------
    >>> block_length(np.arange(100.0)[:, None] * 5, 25.0)
    10
    """
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    typical = float(np.median(steps)) if len(steps) else 0.0
    if typical == 0 or threshold == 0:
        return 1
    wanted = max(np.ceil(2 * threshold / typical), np.ceil(np.cbrt(len(positions))))
    return int(np.clip(wanted, 1, max(1, len(positions) // 4)))


def replicates(
    values: np.ndarray, positions: np.ndarray, threshold: float, *, seed: int = 0, stream: str = "", count: int = COUNT
) -> np.ndarray:
    """Return block-bootstrap replicates ``(m, count)`` of the means of per-query values ``(n, m)``, or of ``(n,)``.

    Values of the same queries, seed and ``stream`` (a name: that of the dataset) meet the same draws. Their deviations from the
    mean are widened as Student's t is wider than the normal distribution, for as many blocks as there are: few blocks know
    little of their own spread.
    """
    values = np.asarray(values, np.float64).reshape(len(values), -1)
    n, block = len(values), block_length(positions, threshold)
    blocks = -(-n // block)
    starts = np.random.default_rng([seed, zlib.crc32(stream.encode())]).integers(0, n, (count, blocks))
    # Sums of blocks from cumulative sums; the last block of a draw is what is missing to n.
    rest = starts[:, -1] + n - block * (blocks - 1)
    means = np.empty((values.shape[1], count))
    for mean, column in zip(means, values.T, strict=True):
        sums = np.concatenate([[0.0], np.cumsum(np.concatenate([column, column[:block]]))])
        whole = (sums[block:] - sums[:-block])[starts[:, :-1]].sum(axis=1)
        mean[:] = (whole + sums[rest] - sums[starts[:, -1]]) / n
    return widened(means, values.mean(axis=0)[:, None], n / block)


def widened(means: np.ndarray, value: np.ndarray | float, pieces: float) -> np.ndarray:
    """Widen replicates around their value for the number of independent pieces that they were drawn from."""
    if pieces <= 2:
        return means
    factor = t.ppf(_TAILS[1], pieces - 1) / norm.ppf(_TAILS[1]) * np.sqrt(pieces / (pieces - 1))
    return value + (means - value) * factor


def ends(sample: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the ends of the 95 % intervals of replicates ``(..., count)``; NaN where none is defined."""
    rows = sample.reshape(-1, sample.shape[-1])
    found = np.full((2, len(rows)), np.nan)
    whole, some = ~np.isnan(rows).any(axis=1), ~np.isnan(rows).all(axis=1)
    found[:, whole] = np.quantile(rows[whole], _TAILS, axis=1)
    for row in np.flatnonzero(some & ~whole):
        found[:, row] = np.nanquantile(rows[row], _TAILS)
    low, high = found.reshape(2, *sample.shape[:-1])
    return low, high


def p_values(values: np.ndarray, sample: np.ndarray) -> np.ndarray:
    """Return two-sided p-values ``(m,)`` of values being 0, from replicates ``(m, count)``.

    By the normal distribution with the replicates' spread: counting replicates beyond 0 cannot give the small values that
    correction for many pairs needs. A value of exactly 0 has p = 1.
    """
    spread = sample.std(axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        found = 2 * norm.sf(np.abs(values) / spread)
    return np.where(np.asarray(values) == 0, 1.0, np.nan_to_num(found, nan=1.0))


def holm(p: np.ndarray) -> np.ndarray:
    """Return p-values ``(m,)`` adjusted for as many tests (Holm 1979): below 0.05, none at all is wrong in 95 % of runs.

    Examples
    --------
    >>> holm(np.array([0.01, 0.04, 0.03])).round(3).tolist()
    [0.03, 0.06, 0.06]
    """
    p = np.asarray(p, np.float64)
    order = np.argsort(p)
    scaled = np.maximum.accumulate(p[order] * np.arange(len(p), 0, -1))
    adjusted = np.empty_like(p)
    adjusted[order] = np.minimum(scaled, 1)
    return adjusted


def intervals(result: Result, k: int = 1, *, seed: int = 0, stream: str = "") -> dict[str, Interval]:
    """Return 95 % bootstrap intervals of R@K, DAR@K and RSR@K, fractions; RSR's resample both its terms together."""
    hits = np.stack([result.hits(k, distractors=added) for added in (False, True)], axis=1)
    sample = replicates(hits, result.query_positions, result.threshold, seed=seed, stream=stream).clip(0, 1)
    with np.errstate(invalid="ignore", divide="ignore"):
        survival = np.where(sample[0] > 0, sample[1] / sample[0], np.nan)
    low, high = ends(np.stack([*sample, survival]))
    values = result.recall(k), result.dar(k), result.rsr(k)
    bounds = zip(("R", "DAR", "RSR"), values, low.tolist(), high.tolist(), strict=True)
    return {name: Interval(*numbers) for name, *numbers in bounds}


def rank_agreement(values: np.ndarray, other_values: np.ndarray) -> np.ndarray:
    """Return Kendall's tau-b of two scores ``(m, ...)`` of the same methods: 1 is the same order, -1 the reverse.

    NaN where it is undefined: one method, or all methods equal.

    Examples
    --------
    >>> float(rank_agreement(np.array([1.0, 2.0, 3.0]), np.array([1.0, 3.0, 2.0])).round(9))
    0.333333333
    """
    first, second = np.triu_indices(len(values), 1)
    order, other = (np.sign(one[first] - one[second]) for one in (values, other_values))
    with np.errstate(invalid="ignore"):
        return (order * other).sum(axis=0) / np.sqrt((order**2).sum(axis=0) * (other**2).sum(axis=0))
