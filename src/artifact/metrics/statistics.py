"""How sure a number is: intervals along a traversal, agreement of rankings.

Neighbouring images of a traversal succeed and fail together, so queries are resampled in blocks of consecutive
ones (circular block bootstrap, Politis and Romano 1992); treating them as independent would give intervals that
are far too narrow. The same seed gives the same interval.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import kendalltau

from artifact.metrics.result import Result


@dataclass(frozen=True)
class Interval:
    """A value with the ends of its confidence interval, all in the same unit."""

    value: float
    low: float
    high: float


def block_length(positions: np.ndarray, threshold: float) -> int:
    """Return how many consecutive queries at ``(n, p)`` share a place: those within twice the threshold along the path.

    Examples
    --------
    >>> block_length(np.arange(100.0)[:, None] * 5, 25.0)
    10
    """
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    typical = float(np.median(steps)) if len(steps) else 0.0
    if typical == 0 or threshold == 0:
        return 1
    return int(np.clip(np.ceil(2 * threshold / typical), 1, max(1, len(positions) // 4)))


def resamples(n: int, block: int, count: int, seed: int) -> np.ndarray:
    """Return ``(count, n)`` indices: circular blocks of consecutive queries, drawn with replacement."""
    starts = np.random.default_rng(seed).integers(0, n, (count, -(-n // block)))
    return ((starts[:, :, None] + np.arange(block)) % n).reshape(count, -1)[:, :n]


def intervals(
    result: Result, k: int = 1, *, confidence: float = 0.95, count: int = 1000, seed: int = 0
) -> dict[str, Interval]:
    """Return bootstrap intervals of R@K, DAR@K and RSR@K, as fractions; of RSR numerator and denominator together.

    ``confidence`` is the share of resamples inside an interval, ``count`` and ``seed`` their number and seed.
    """
    draws = resamples(result.n_queries, block_length(result.query_positions, result.threshold), count, seed)
    recall = result.hits(k, distractors=False)[draws].mean(axis=1)
    dar = result.hits(k, distractors=True)[draws].mean(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        survival = np.where(recall > 0, dar / recall, np.nan)
    tails = [(1 - confidence) / 2, (1 + confidence) / 2]
    values = {"R": result.recall(k), "DAR": result.dar(k), "RSR": result.rsr(k)}
    found = {}
    for (name, value), sample in zip(values.items(), (recall, dar, survival), strict=True):
        sample = sample[~np.isnan(sample)]
        low, high = np.quantile(sample, tails) if len(sample) else (np.nan, np.nan)
        found[name] = Interval(value, float(low), float(high))
    return found


def interval_of_means(
    values: np.ndarray,
    positions: np.ndarray,
    threshold: float,
    *,
    confidence: float = 0.95,
    count: int = 1000,
    seed: int = 0,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the ends, ``(m,)`` each, of bootstrap intervals of the means of ``(n, m)`` hits or chances of a hit.

    Positions and threshold of the queries give the length of the blocks; the rest is as in :func:`intervals`.
    """
    draws = resamples(len(values), block_length(positions, threshold), count, seed)
    # How often each query is drawn says all about a mean, and needs no array of draws × queries × m.
    weights = np.stack([np.bincount(draw, minlength=len(values)) for draw in draws]) / len(values)
    means = weights @ np.asarray(values, np.float64)
    low, high = np.quantile(means, [(1 - confidence) / 2, (1 + confidence) / 2], axis=0)
    return low, high


def rank_agreement(values: np.ndarray, other_values: np.ndarray) -> float:
    """Return Kendall's tau-b between two scores of the same methods: 1 is the same order, -1 the reverse; NaN if undefined.

    Examples
    --------
    >>> round(rank_agreement(np.array([1.0, 2.0, 3.0]), np.array([1.0, 3.0, 2.0])), 9)
    0.333333333
    """
    return float(kendalltau(values, other_values).statistic) if len(values) > 1 else float("nan")
