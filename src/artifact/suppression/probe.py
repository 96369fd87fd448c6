"""The guardedness probe: can a linear classifier still tell the condition (paper §V-A and Fig. 8a)?"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
from sklearn.exceptions import ConvergenceWarning
from sklearn.svm import LinearSVC


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


def probe_split(query_positions: np.ndarray, database_positions: np.ndarray, seed: int = 0) -> ProbeSplit:
    """Cut the evaluation region into two spatial halves, and balance each.

    The cut is at the median of the query positions along their longest direction; the larger group of each half is
    thinned at random.

    Parameters
    ----------
    query_positions, database_positions
        ``(n, p)`` positions of the evaluation region.
    seed
        Seed of the thinning.

    Raises
    ------
    ValueError
        If a half has fewer than two images of a condition.
    """
    centre = query_positions.mean(axis=0)
    axis = np.linalg.svd(query_positions - centre, full_matrices=False)[2][0]
    along = [(positions - centre) @ axis for positions in (query_positions, database_positions)]
    cut = np.median(along[0])
    generator = np.random.default_rng(seed)
    chosen = []
    for side in (np.less_equal, np.greater):
        groups = [np.flatnonzero(side(values, cut)) for values in along]
        size = min(map(len, groups))
        if size < 2:
            raise ValueError(
                f"a half of the evaluation region has {size} images of one condition; a probe needs two of each"
            )
        chosen += [np.sort(generator.choice(group, size, replace=False)) for group in groups]
    return ProbeSplit(*chosen)


def probe_accuracy(
    queries: np.ndarray, database: np.ndarray, rows: ProbeSplit, seed: int = 0
) -> float:  # fmt: skip
    """Return the test accuracy of a ``LinearSVC`` with default hyperparameters, as a fraction; 0.5 is chance.

    Parameters
    ----------
    queries, database
        Descriptors ``(n, d)`` of the evaluation region.
    rows
        As from :func:`probe_split`.
    seed
        Seed of the solver.
    """

    def stacked(of_queries: np.ndarray, of_database: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        labels = np.repeat([0, 1], [len(of_queries), len(of_database)])
        return np.concatenate([queries[of_queries], database[of_database]]).astype(np.float64), labels

    train, train_labels = stacked(rows.train_queries, rows.train_database)
    test, test_labels = stacked(rows.test_queries, rows.test_database)
    with warnings.catch_warnings():
        # A condition that is well hidden leaves the solver without a margin to converge to.
        warnings.simplefilter("ignore", ConvergenceWarning)
        classifier = LinearSVC(random_state=seed).fit(train, train_labels)
    return float(classifier.score(test, test_labels))
