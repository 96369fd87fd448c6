"""INLP: the directions of one linear classifier of the conditions after another are projected out."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from sklearn.exceptions import ConvergenceWarning
from sklearn.utils.validation import check_is_fitted

from artifact.suppression.classifier import EPOCHS, LinearClassifier
from artifact.suppression.lowrank import LowRankEstimator, LowRankMap
from artifact.suppression.samples import checked_fit, gram_matrix, spectrum, weighted_sum


class INLP(LowRankEstimator):
    """Iterative null-space projection (Ravfogel et al. 2020).

    Each iteration fits a linear classifier to the conditions and projects its directions out:
    ``r(x) = P_m ... P_1 x`` (paper §IV-C). Directions are orthogonalised against the earlier ones, twice, so that
    the product is an orthogonal projection.

    With fewer rows than columns the classifiers run on the coordinates of the rows in their own span. Stochastic
    gradient descent with an L2 penalty, started at zero, only ever moves in that span and does not depend on the
    choice of its axes, so this is the same algorithm at a cost of n instead of d per sample.

    Parameters
    ----------
    n_iterations
        Classifiers to fit; the paper uses 35.
    seed
        Seed of every classifier.
    device
        Where the large matrix products run; ``None`` is the CPU.

    Attributes
    ----------
    directions_
        ``(d, k)`` float64, orthonormal; k is ``n_iterations`` for two conditions, fewer once nothing is left.
    accuracies_
        ``(iterations,)`` balanced training accuracy of each classifier, before its direction is removed.
    ends_
        ``(iterations,)`` number of directions after each iteration.
    """

    def __init__(self, n_iterations: int = 35, seed: int = 0, device: Any = None) -> None:
        self.n_iterations = n_iterations
        self.seed = seed
        self.device = device

    def fit(self, X: np.ndarray, condition: np.ndarray) -> INLP:
        """Fit on descriptors ``(n, d)`` and their conditions ``(n,)``; raises as :meth:`artifact.STD.fit`.

        Warns once (``ConvergenceWarning``) with the number of classifiers that did not converge.
        """
        X, condition = checked_fit(X, condition)
        coordinates, lift = _coordinates(X, self.device)
        basis, self.accuracies_, self.ends_ = _erased_directions(coordinates, condition, self.n_iterations, self.seed)
        # One last orthonormalisation takes out the rounding of the lift; it keeps every leading subspace.
        directions, triangle = np.linalg.qr(lift(basis))
        self.directions_ = directions * np.where(np.diag(triangle) < 0, -1.0, 1.0)
        self.map_ = self.at(self.n_iterations)
        return self

    def at(self, iteration: int) -> LowRankMap:
        """Return the projection after a number of iterations; 0 changes nothing."""
        check_is_fitted(self)
        if not 0 <= iteration <= self.n_iterations:
            raise ValueError(f"iteration is {iteration}; allowed: 0 to {self.n_iterations}")
        done = min(iteration, len(self.ends_))
        directions = self.directions_[:, : self.ends_[done - 1] if done else 0]
        return LowRankMap(directions, directions, np.zeros(directions.shape[1]))


def _erased_directions(
    coordinates: np.ndarray, condition: np.ndarray, iterations: int, seed: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Remove directions in turn, in place; return them and, per iteration, balanced accuracy and their number."""
    basis = np.zeros((coordinates.shape[1], 0))
    accuracies, ends, unconverged = [], [], 0
    start, members = np.linalg.norm(coordinates), [condition == name for name in np.unique(condition)]
    for _ in range(iterations):
        if np.linalg.norm(coordinates) <= 1e-9 * start:
            break  # every dimension of the fitting data is gone
        classifier = LinearClassifier(seed).fit(coordinates, condition)
        unconverged += classifier.n_iter_ == EPOCHS
        right = classifier.predict(coordinates) == condition
        accuracies.append(np.mean([right[rows].mean() for rows in members]))
        for weights in classifier.coef_:
            direction = weights - basis @ (basis.T @ weights)
            direction -= basis @ (basis.T @ direction)
            length = np.linalg.norm(direction)
            if length > 1e-9 * np.linalg.norm(weights):
                direction /= length
                basis = np.column_stack([basis, direction])
                _project_out(coordinates, direction)
        ends.append(basis.shape[1])
    if unconverged:
        text = f"{unconverged} of {len(ends)} INLP classifiers did not converge in {EPOCHS} epochs"
        warnings.warn(text, ConvergenceWarning, stacklevel=3)
    return basis, np.array(accuracies), np.array(ends, int)


def _project_out(coordinates: np.ndarray, direction: np.ndarray) -> None:
    """Take a direction out of rows in place, some rows at a time: a second array of their size may not fit."""
    step = max(1, 2**22 // coordinates.shape[1])
    for start in range(0, len(coordinates), step):
        rows = coordinates[start : start + step]
        rows -= np.outer(rows @ direction, direction)


def _coordinates(X: np.ndarray, device: Any) -> tuple[np.ndarray, Any]:
    """Return coordinates of the rows in an orthonormal basis of their span, and the way back to descriptors."""
    n, d = X.shape
    if n >= d:
        return X.astype(np.float64), lambda basis: basis
    values, vectors = spectrum(gram_matrix(X, np.zeros(d), device))
    roots = np.sqrt(values)

    def lift(basis: np.ndarray) -> np.ndarray:
        return weighted_sum(X, np.zeros(d), vectors @ (basis / roots[:, None]))

    return np.multiply(vectors, roots, order="C"), lift
