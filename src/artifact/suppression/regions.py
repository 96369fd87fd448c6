"""Fitting and evaluation regions that share no place (paper §V-A).

Neighbouring images show the same place, so a random split would let a transform be fitted on the places that it is
evaluated on. Regions are contiguous in space (or along the frames).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from artifact.datasets.positives import as_columns, positives_of

Where = Literal["centre", "edge"]


@dataclass(frozen=True)
class Split:
    """Indices of the fitting region, queries and the database images near any of them, and of the rest of both."""

    fit_queries: np.ndarray
    fit_database: np.ndarray
    evaluation_queries: np.ndarray
    evaluation_database: np.ndarray


def fit_region(positions: np.ndarray, fraction: float, where: Where = "centre") -> np.ndarray:
    """Return the queries of a spatially contiguous fitting region.

    Parameters
    ----------
    positions
        ``(n, p)`` or ``(n,)`` in metres or frames.
    fraction
        Share of the queries, in [0, 1]; ``ceil(fraction * n)`` are taken.
    where
        ``"centre"``: the queries nearest to the mean position; for one axis, contiguous places around the middle.
        ``"edge"``: a slice from the edge of the map, along its longest direction (paper Fig. 9).

    Returns ascending indices, or raises ``ValueError`` if the fraction is not in [0, 1] or ``where`` is unknown.

    Examples
    --------
    >>> fit_region(np.arange(10.0), 0.3)
    array([3, 4, 5])
    >>> fit_region(np.array([[0.0, 0], [10, 0], [4, 1], [20, 0]]), 0.25)
    array([1])
    >>> fit_region(np.arange(10.0), 0.2, "edge")
    array([0, 1])
    """
    positions = as_columns(positions)
    if not 0 <= fraction <= 1:
        raise ValueError(f"fraction is {fraction!r}; allowed: numbers from 0 to 1")
    n = len(positions)
    if n == 0:
        return np.zeros(0, np.int64)
    count = math.ceil(round(fraction * n, 9))  # 0.1 * 30 must take 3 and not 4
    if where == "edge":
        order = np.argsort(positions @ longest_direction(positions), kind="stable")
    elif where != "centre":
        raise ValueError(f"where is {where!r}; allowed: 'centre', 'edge'")
    elif positions.shape[1] == 1:
        order = np.argsort(positions[:, 0], kind="stable")[(n - count) // 2 :]
    else:
        order = np.argsort(np.linalg.norm(positions - positions.mean(axis=0), axis=1), kind="stable")
    return np.sort(order[:count])


def longest_direction(positions: np.ndarray) -> np.ndarray:
    """First principal axis, turned so that its largest component is positive."""
    centred = positions - positions.mean(axis=0)
    axis = np.linalg.svd(centred, full_matrices=False)[2][0]
    return axis * np.sign(axis[np.abs(axis).argmax()])


def split(
    query_positions: np.ndarray,
    database_positions: np.ndarray,
    threshold: float,
    fraction: float,
    *,
    evaluation_fraction: float | None = None,
    where: Where = "centre",
) -> Split:
    """Split queries and database by their ``(n, p)`` positions into a fitting and an evaluation region.

    Parameters
    ----------
    query_positions, database_positions, threshold
        In metres or frames.
    fraction
        Share of the evaluated queries, those with a positive, in the fitting region.
    evaluation_fraction
        Keep the evaluation region fixed: the share of the queries that lies outermost (paper Fig. 10 uses 0.5, and
        varies ``fraction`` up to it). Default: all outside the fitting region. Their sum may not exceed 1.
    where
        As in :func:`fit_region`.
    """
    reserved = fraction if evaluation_fraction is None else 1 - evaluation_fraction
    if fraction > reserved + 1e-12:
        raise ValueError(f"fraction {fraction:g} and evaluation_fraction {evaluation_fraction:g} exceed 1 together")
    evaluated = np.flatnonzero(np.diff(positives_of(query_positions, database_positions, threshold)[0]))
    fit_queries = evaluated[fit_region(query_positions[evaluated], fraction, where)]
    excluded = evaluated[fit_region(query_positions[evaluated], reserved, where)]
    near, away = (_colocated(query_positions[q], database_positions, threshold) for q in (fit_queries, excluded))
    rest = np.setdiff1d(np.arange(len(query_positions)), excluded)
    return Split(fit_queries, near, rest, np.setdiff1d(np.arange(len(database_positions)), away))


def _colocated(query_positions: np.ndarray, database_positions: np.ndarray, threshold: float) -> np.ndarray:
    """Database images within the threshold of any of the queries."""
    if len(query_positions) == 0:
        return np.zeros(0, np.int64)
    return np.unique(positives_of(query_positions, database_positions, threshold)[1])
