"""The guardedness probe: can a linear classifier still tell the condition (paper §V-A and Fig. 8a)?"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from scipy import linalg
from sklearn.exceptions import ConvergenceWarning
from sklearn.svm import LinearSVC

from artifact.datasets.positives import as_columns
from artifact.suppression.regions import longest_direction

_BLOCK = 2**23  # values that are transformed and widened at a time

_Blocks = Iterator[tuple[slice, np.ndarray]]  # rows in order, in float64


class Half(NamedTuple):
    """Rows of one half of the evaluation region: equally many ``queries`` and ``database`` images."""

    queries: np.ndarray
    database: np.ndarray


class Guardedness(NamedTuple):
    """Test accuracy of a probe as a fraction (0.5 is chance), and whether it converged in its default iterations."""

    accuracy: float
    converged: bool


def probe(
    queries: np.ndarray,
    database: np.ndarray,
    query_positions: np.ndarray,
    database_positions: np.ndarray,
    threshold: float,
    *,
    transform: Any = None,
    seed: int = 0,
) -> Guardedness:
    """Train a ``LinearSVC`` with its defaults to tell queries from database images, and test it on other places.

    It trains on one spatial half of the images and tests on the other, with a gap between them. With fewer rows than
    columns it runs on the triangular factor L of their inner products, ``L L' = X X'``: the solver (dual coordinate
    descent) sees inner products only, so this is the same algorithm in exact arithmetic, at a cost of n instead of d
    per sample. Half of L is zero and takes no memory in the solver, which turns each value into 16 bytes: n² float64
    and as much again, instead of six times the float32 descriptors. Descriptors are transformed some rows at a time.

    Parameters
    ----------
    queries, database
        Descriptors ``(n, d)`` of the evaluation region, float32 or float16.
    query_positions, database_positions, threshold
        Positions ``(n, p)`` or ``(n,)`` in metres or frames, and the positive threshold in the same unit.
    transform
        A fitted :class:`~artifact.INLP`, :class:`~artifact.LEACE` or :class:`~artifact.LowRankMap` to apply first, or
        an :class:`~artifact.STD` that was fitted with the conditions 0 (queries) and 1 (database).
    seed
        Seed of the balancing and of the solver.

    Raises
    ------
    ValueError
        If a half has fewer than two images of a condition.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> day, night = rng.standard_normal((2, 80, 6)) + np.array([[[2.0]], [[-2.0]]])
    >>> probe(day, night, np.arange(80.0), np.arange(80.0), threshold=3).accuracy
    1.0
    """
    train, test = probe_split(query_positions, database_positions, threshold, seed)

    def blocks(half: Half) -> _Blocks:
        step, start = max(1, _BLOCK // queries.shape[1]), 0
        for condition, (images, rows) in enumerate(zip((queries, database), half, strict=True)):
            for first in range(0, len(rows), step):
                block = images[rows[first : first + step]]
                if hasattr(transform, "low_rank"):
                    block = transform.transform(block)
                elif transform is not None:
                    block = transform.transform(block, condition)
                block = block.astype(np.float64)
                yield slice(start, start := start + len(block)), block

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", ConvergenceWarning)
        weights, intercept = _classifier(lambda: blocks(train), 2 * len(train.queries), queries.shape[1], seed)
    told = np.concatenate([block @ weights + intercept > 0 for _, block in blocks(test)])
    right = told == np.repeat([False, True], len(test.queries))
    converged = not any(issubclass(warning.category, ConvergenceWarning) for warning in caught)
    return Guardedness(float(right.mean()), converged)


def probe_split(
    query_positions: np.ndarray, database_positions: np.ndarray, threshold: float, seed: int = 0
) -> tuple[Half, Half]:
    """Return the halves of the evaluation region to train and to test on, balanced, with a gap between them.

    The border is at the median of the query positions along their longest direction. Images within half the threshold
    of it leave, so that no image of one half is within the threshold of one of the other; the larger group of each half
    is thinned at random.
    """
    places = [as_columns(positions) for positions in (query_positions, database_positions)]
    direction = longest_direction(places[0])
    along = [where @ direction for where in places]
    border = np.median(along[0])
    generator = np.random.default_rng(seed)
    halves = []
    for sign in (-1, 1):
        groups = [np.flatnonzero(sign * (values - border) > threshold / 2) for values in along]
        size = min(map(len, groups))
        if size < 2:
            found = (
                f"a half of the evaluation region, beyond a gap of {threshold:g}, has {size} images of one condition"
            )
            raise ValueError(f"{found}; a probe needs two of each")
        halves.append(Half(*(np.sort(generator.choice(group, size, replace=False)) for group in groups)))
    return halves[0], halves[1]


def _classifier(blocks: Callable[[], _Blocks], n: int, d: int, seed: int) -> tuple[np.ndarray, float]:
    """Fit the classifier to rows of which the second half is one class; return its weights and intercept."""
    labels = np.repeat([0, 1], n // 2)
    if n >= d:
        X = np.empty((n, d))
        for rows, block in blocks():
            X[rows] = block
        fitted = LinearSVC(random_state=seed).fit(X, labels)
        return fitted.coef_[0], float(fitted.intercept_[0])
    factor = _factor(blocks, n)
    fitted = LinearSVC(random_state=seed, dual=True).fit(factor, labels)
    shares = linalg.solve_triangular(factor.T, fitted.coef_[0], check_finite=False)
    weights = np.zeros(d)
    for rows, block in blocks():
        weights += shares[rows] @ block
    return weights, float(fitted.intercept_[0])


def _factor(blocks: Callable[[], _Blocks], n: int) -> np.ndarray:
    """Lower triangular ``L`` with ``L L'`` the inner products of the rows."""
    products = np.zeros((n, n))
    for rows, block in blocks():
        for columns, other in blocks():
            if columns.start > rows.start:
                break
            products[rows, columns] = block @ other.T
    # What rounding needs to factor equal rows; beside the 1/2 that the squared hinge adds to each it is nothing.
    products[np.diag_indices(n)] += n * np.finfo(np.float64).eps * np.trace(products)
    upper, _ = linalg.lapack.dpotrf(products.T, lower=0, clean=1, overwrite_a=1)
    return upper.T
