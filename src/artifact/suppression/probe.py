"""The guardedness probe: can a linear classifier still tell the condition (paper §V-A and Fig. 8a)?"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import linalg
from sklearn.exceptions import ConvergenceWarning
from sklearn.svm import LinearSVC

from artifact.suppression.samples import gram_matrix, weighted_sum

Transform = Callable[[np.ndarray, str], np.ndarray]
"""From descriptors ``(n, d)`` and their condition, ``"query"`` or ``"database"``, to what the probe sees."""

_ROWS = 2048  # test images that are transformed at a time


class Probe(NamedTuple):
    """What a probe found.

    Attributes
    ----------
    accuracy
        Share of test images whose condition the classifier tells; 0.5 is chance.
    converged
        Whether the classifier converged within the default number of iterations.
    """

    accuracy: float
    converged: bool


@dataclass(frozen=True)
class ProbeSplit:
    """Rows of query and database images to train and to test a probe on, balanced to 50 % each.

    Attributes
    ----------
    train_queries, train_database, test_queries, test_database
        Indices; within each pair both have the same number.
    """

    train_queries: np.ndarray
    train_database: np.ndarray
    test_queries: np.ndarray
    test_database: np.ndarray


def probe(
    queries: np.ndarray,
    database: np.ndarray,
    query_positions: np.ndarray,
    database_positions: np.ndarray,
    threshold: float,
    *,
    transform: Transform | None = None,
    seed: int = 0,
) -> Probe:
    """Train a linear classifier to tell queries from database images, and test it at other places.

    Parameters
    ----------
    queries, database
        Descriptors ``(n, d)``, of an evaluation region that no transform was fitted on.
    query_positions, database_positions
        Positions ``(n, p)`` or ``(n,)``, in metres or frames.
    threshold
        Images of the two halves are farther apart than this.
    transform
        Applied to blocks of descriptors before they are classified, so that no transformed copy of all is kept.
    seed
        Seed of the balancing and of the solver.

    Raises
    ------
    ValueError
        If a half has fewer than two images of a condition.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> where, places = np.arange(80.0), rng.normal(size=(80, 8)).astype(np.float32)
    >>> probe(places + 4, places - 4, where, where, threshold=2).accuracy
    1.0
    """
    rows = probe_split(query_positions, database_positions, threshold, seed)
    return probe_on(queries, database, rows, transform=transform, seed=seed)


def probe_split(
    query_positions: np.ndarray, database_positions: np.ndarray, threshold: float, seed: int = 0
) -> ProbeSplit:
    """Cut an evaluation region into two spatial halves with a gap between them, and balance each.

    The cut is at the median of the query positions along their longest direction. Images within half the threshold of it
    leave, so that no image of one half is within the threshold of one of the other; the larger group of each half is thinned
    at random. Parameters and errors are those of :func:`probe`.
    """
    places = [np.asarray(p, np.float64).reshape(len(p), -1) for p in (query_positions, database_positions)]
    centre = places[0].mean(axis=0)
    axis = np.linalg.svd(places[0] - centre, full_matrices=False)[2][0]
    along = [(positions - centre) @ axis for positions in places]
    cut, half = np.median(along[0]), threshold / 2
    generator = np.random.default_rng(seed)
    chosen = []
    for name in ("train", "test"):
        groups = [np.flatnonzero(x <= cut - half if name == "train" else x > cut + half) for x in along]
        size = min(map(len, groups))
        if size < 2:
            raise ValueError(
                f"the {name} half of the evaluation region has {size} images of one condition beyond the gap of {threshold:g}; "
                f"a probe needs two of each"
            )
        chosen += [np.sort(generator.choice(group, size, replace=False)) for group in groups]
    return ProbeSplit(*chosen)


def probe_on(
    queries: np.ndarray, database: np.ndarray, rows: ProbeSplit, *, transform: Transform | None = None, seed: int = 0
) -> Probe:
    """Train and test a ``LinearSVC`` with default hyperparameters on the rows of :func:`probe_split`; see :func:`probe`.

    With fewer training images than columns the classifier is trained on the rows of the triangular factor ``L`` of their
    Gram matrix: they have the same inner products, and the solver only ever sees those, so it is the same classifier in exact
    arithmetic. It then needs ``n²`` numbers and not the solver's 24 bytes for each of ``n d``.
    """
    change = transform or (lambda block, _: block)
    train = np.concatenate(
        [change(queries[rows.train_queries], "query"), change(database[rows.train_database], "database")]
    )
    labels = np.repeat([0, 1], [len(rows.train_queries), len(rows.train_database)])
    n, d = train.shape
    factor = _triangular_factor(train) if n < d else None
    # What the default, "auto", decides from the shape of the descriptors; the factor has another shape.
    classifier = LinearSVC(dual=n < d, random_state=seed)
    with warnings.catch_warnings():
        # A condition that is well hidden leaves the solver without a margin to converge to: counted, not warned of.
        warnings.simplefilter("ignore", ConvergenceWarning)
        classifier.fit(train.astype(np.float64) if factor is None else factor, labels)
    direction = classifier.coef_[0]
    if factor is not None:
        weights = linalg.solve_triangular(factor, direction, lower=True, trans="T")
        direction = weighted_sum(train, np.zeros(d), weights[:, None])[:, 0]
    right = 0
    for images, chosen, name, label in (
        (queries, rows.test_queries, "query", 0),
        (database, rows.test_database, "database", 1),
    ):
        for start in range(0, len(chosen), _ROWS):
            scores = change(images[chosen[start : start + _ROWS]], name) @ direction + classifier.intercept_[0]
            right += int(((scores > 0) == label).sum())
    return Probe(right / (2 * len(rows.test_queries)), bool(classifier.n_iter_ < classifier.max_iter))


def _triangular_factor(rows: np.ndarray) -> np.ndarray:
    """``L`` with ``L L' = rows rows'``; rows that depend on one another are told apart by rounding alone."""
    gram = gram_matrix(rows, np.zeros(rows.shape[1]), None)
    gram[np.diag_indices_from(gram)] += 1e-12 * np.trace(gram) / len(gram)
    return linalg.cholesky(gram, lower=True, overwrite_a=True, check_finite=False)
