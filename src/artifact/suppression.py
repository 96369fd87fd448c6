"""Condition suppression: INLP, LEACE and per-condition standardisation (paper §IV), in the form of scikit-learn.

``fit(X, condition)`` takes descriptors ``(n, d)`` and an integer condition per row. Fitting never forms a ``d × d``
matrix when there are fewer rows than columns, and fitted INLP and LEACE hold O(d k) numbers.
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from scipy import linalg
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.exceptions import ConvergenceWarning
from sklearn.linear_model import SGDClassifier
from sklearn.metrics import balanced_accuracy_score
from sklearn.utils.validation import check_is_fitted

from artifact.lowrank import LowRankMap

REVISION = 1  # raise when a fit changes: it is part of the key of everything fitted

_CHUNK = 4096  # columns that are widened to float64 at a time


class INLP(TransformerMixin, BaseEstimator):
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
        """Fit on descriptors ``(n, d)`` and their conditions ``(n,)``.

        Raises
        ------
        ValueError
            If there are fewer than two conditions or two rows in one, or the descriptors are constant or not finite.

        Warns
        -----
        ConvergenceWarning
            Once, with the number of classifiers that did not converge.
        """
        X, condition = _checked_fit(X, condition)
        coordinates, lift = _coordinates(X, self.device)
        basis, self.accuracies_, self.ends_ = _erased_directions(coordinates, condition, self.n_iterations, self.seed)
        # One last orthonormalisation takes out the rounding of the lift; it keeps every leading subspace.
        directions, triangle = np.linalg.qr(lift(basis))
        self.directions_ = directions * np.where(np.diag(triangle) < 0, -1.0, 1.0)
        return self

    def at(self, iteration: int) -> LowRankMap:
        """Return the projection after a number of iterations; 0 changes nothing."""
        check_is_fitted(self)
        if not 0 <= iteration <= self.n_iterations:
            raise ValueError(f"iteration is {iteration}; allowed: 0 to {self.n_iterations}")
        done = min(iteration, len(self.ends_))
        directions = self.directions_[:, : self.ends_[done - 1] if done else 0]
        return LowRankMap(directions, directions, np.zeros(directions.shape[1]))

    def low_rank(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the fitted projection as ``left``, ``right``, ``offset``."""
        return self.at(self.n_iterations).low_rank()

    def transform(self, X: np.ndarray) -> np.ndarray:
        """Project descriptors ``(n, d)``; the dtype is kept."""
        return self.at(self.n_iterations).transform(X)


def _erased_directions(
    coordinates: np.ndarray, condition: np.ndarray, iterations: int, seed: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Fit classifiers and remove their directions, in turn.

    Returns
    -------
    basis
        ``(width, k)`` orthonormal directions.
    accuracies, ends
        Per iteration: balanced training accuracy, number of directions after it.
    """
    basis = np.zeros((coordinates.shape[1], 0))
    accuracies, ends, unconverged = [], [], 0
    start = np.linalg.norm(coordinates)
    for _ in range(iterations):
        if np.linalg.norm(coordinates) <= 1e-9 * start:
            break  # every dimension of the fitting data is gone
        classifier = SGDClassifier(max_iter=2500, class_weight="balanced", random_state=seed)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            classifier.fit(coordinates, condition)
        unconverged += any(issubclass(warning.category, ConvergenceWarning) for warning in caught)
        accuracies.append(balanced_accuracy_score(condition, classifier.predict(coordinates)))
        for weights in classifier.coef_:
            direction = weights - basis @ (basis.T @ weights)
            direction -= basis @ (basis.T @ direction)
            length = np.linalg.norm(direction)
            if length > 1e-9 * np.linalg.norm(weights):
                direction /= length
                basis = np.column_stack([basis, direction])
                coordinates = coordinates - np.outer(coordinates @ direction, direction)
        ends.append(basis.shape[1])
    if unconverged:
        warnings.warn(
            f"{unconverged} of {len(ends)} INLP classifiers did not converge in 2500 epochs",
            ConvergenceWarning,
            stacklevel=3,
        )
    return basis, np.array(accuracies), np.array(ends, int)


def _coordinates(X: np.ndarray, device: Any) -> tuple[np.ndarray, Any]:
    """Return coordinates of the rows in an orthonormal basis of their span, and the way back to descriptors."""
    n, d = X.shape
    if n >= d:
        return X.astype(np.float64), lambda basis: basis
    values, vectors = _spectrum(_gram(X, np.zeros(d), device))
    roots = np.sqrt(values)
    return np.ascontiguousarray(vectors * roots), lambda basis: _combine(X, np.zeros(d), (vectors / roots) @ basis)


class LEACE(TransformerMixin, BaseEstimator):
    """Least-squares concept erasure (Belrose et al. 2023), exact and without ``d × d`` matrices.

    The paper's formula (§IV-C) with whitening ``W = (Σ_XX^(1/2))^+`` equals
    ``r(x) = x - A (A'B)^+ B' (x - μ)`` with ``A = X_c' Z_c`` and ``B`` the minimum-norm least-squares solution of
    ``X_c B = Z_c``: memory O(n d).

    Parameters
    ----------
    shrinkage
        Whether to shrink the covariance linearly towards a multiple of the identity (Bodnar et al. 2014), as the
        reference implementation does by default; the paper's formula does not.
    tolerance
        Eigenvalues at or below this share of the largest count as zero; ``None`` is the larger of n and d times the
        float64 epsilon.
    device
        Where the large matrix products run; ``None`` is the CPU.

    Attributes
    ----------
    map_
        The fitted :class:`~artifact.lowrank.LowRankMap`; its rank is at most the number of conditions minus 1.
    mean_
        ``(d,)`` mean of the fitting data, which the map keeps.
    """

    def __init__(self, shrinkage: bool = False, tolerance: float | None = None, device: Any = None) -> None:
        self.shrinkage = shrinkage
        self.tolerance = tolerance
        self.device = device

    def fit(self, X: np.ndarray, condition: np.ndarray) -> LEACE:
        """Fit on descriptors ``(n, d)`` and their conditions ``(n,)``.

        Raises
        ------
        ValueError
            If there are fewer than two conditions or two rows in one, or the descriptors are constant or not finite.
        """
        X, condition = _checked_fit(X, condition)
        self.mean_ = X.mean(axis=0, dtype=np.float64)
        labels = (condition[:, None] == np.unique(condition)).astype(np.float64)
        labels -= labels.mean(axis=0)
        cross = _combine(X, self.mean_, labels)
        solution = self._regression(X, cross, labels)
        inner = cross.T @ solution
        values, vectors = _spectrum((inner + inner.T) / 2, 1e-10)
        left = cross @ (vectors / values)
        right = solution @ vectors
        self.map_ = LowRankMap(left, right, right.T @ self.mean_)
        return self

    def _regression(self, X: np.ndarray, cross: np.ndarray, labels: np.ndarray) -> np.ndarray:
        """Minimum-norm solution of ``X_c B = Z_c``, or its shrunk form ``(α S + γ I)^-1 A``, up to a factor."""
        n, d = X.shape
        dual = n <= d
        gram = (_gram if dual else _scatter)(X, self.mean_, self.device)
        if self.shrinkage:
            alpha, gamma = _shrinkage(gram / n, n, d)
            gram = alpha * gram / n
            gram[np.diag_indices_from(gram)] += gamma
            solved = linalg.solve(gram, labels if dual else cross, assume_a="pos")
            return _combine(X, self.mean_, solved) if dual else solved
        tolerance = max(n, d) * np.finfo(np.float64).eps if self.tolerance is None else self.tolerance
        values, vectors = _spectrum(gram, tolerance)
        solved = vectors @ ((vectors.T @ (labels if dual else cross)) / values[:, None])
        return _combine(X, self.mean_, solved) if dual else solved

    def low_rank(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the fitted map as ``left``, ``right``, ``offset``."""
        check_is_fitted(self)
        return self.map_.low_rank()

    def transform(self, X: np.ndarray) -> np.ndarray:
        """Erase the conditions from descriptors ``(n, d)``; the dtype is kept."""
        check_is_fitted(self)
        return self.map_.transform(X)


def _shrinkage(covariance: np.ndarray, n: int, d: int) -> tuple[float, float]:
    """Weights of the covariance and of the identity in the optimal linear shrinkage (Bodnar et al. 2014).

    Needs only trace and Frobenius norm, which the ``n × n`` form of the covariance shares.
    """
    trace = float(np.trace(covariance))
    spread = float((covariance**2).sum()) - trace**2 / d
    alpha = 1 - min(1.0, trace**2 / n / spread) if spread > 0 else 0.0
    return alpha, (1 - alpha) * trace / d


class STD(BaseEstimator):
    """Per-condition standardisation (Schubert et al. 2020): ``r(x_c) = (x_c - μ_c) / σ_c`` (paper §IV-C).

    It needs the condition of every descriptor at inference too, so it has no low-rank form and cannot be composed.

    Parameters
    ----------
    epsilon
        A standard deviation at or below this share of its condition's largest is taken as 1: that column is
        constant under the condition and says nothing.

    Attributes
    ----------
    conditions_
        ``(c,)`` the conditions seen.
    mean_, scale_
        ``(c, d)`` float64.
    """

    def __init__(self, epsilon: float = 1e-6) -> None:
        self.epsilon = epsilon

    def fit(self, X: np.ndarray, condition: np.ndarray) -> STD:
        """Fit on descriptors ``(n, d)`` and their conditions ``(n,)``.

        Raises
        ------
        ValueError
            If there are fewer than two conditions or two rows in one, or the descriptors are constant or not finite.
        """
        X, condition = _checked_fit(X, condition)
        self.conditions_ = np.unique(condition)
        groups = [X[condition == c] for c in self.conditions_]
        self.mean_ = np.stack([group.mean(axis=0, dtype=np.float64) for group in groups])
        deviation = np.stack([group.std(axis=0, dtype=np.float64) for group in groups])
        flat = deviation <= self.epsilon * deviation.max(axis=1, keepdims=True)
        self.scale_ = np.where(flat, 1.0, deviation)
        return self

    def transform(self, X: np.ndarray, condition: np.ndarray | int) -> np.ndarray:
        """Standardise descriptors ``(n, d)`` by their conditions, ``(n,)`` or one for all; the dtype is kept.

        Raises
        ------
        ValueError
            If the width differs, or a condition was not seen at fit.
        """
        check_is_fitted(self)
        X = np.asarray(X)
        if X.ndim != 2 or X.shape[1] != self.mean_.shape[1]:
            raise ValueError(
                f"descriptors have the shape {X.shape}; this transform was fitted on (n, {self.mean_.shape[1]})"
            )
        rows = np.broadcast_to(np.asarray(condition), len(X))
        unseen = np.setdiff1d(rows, self.conditions_)
        if unseen.size:
            raise ValueError(
                f"condition {unseen[0]} was not seen at fit; the conditions are {self.conditions_.tolist()}"
            )
        index = np.searchsorted(self.conditions_, rows)
        kind = X.dtype if X.dtype in (np.float32, np.float64) else np.float32
        return (X.astype(kind, copy=False) - self.mean_.astype(kind)[index]) / self.scale_.astype(kind)[index]


# -- checks and linear algebra --------------------------------------------------------------------------------


def _checked_fit(X: np.ndarray, condition: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    X, condition = np.asarray(X), np.asarray(condition)
    if X.ndim != 2 or 0 in X.shape or X.dtype.kind != "f":
        raise ValueError(f"descriptors have the shape {X.shape} and type {X.dtype}; allowed: (n, d) of a float type")
    if condition.shape != (len(X),):
        raise ValueError(f"condition has the shape {condition.shape}; allowed: ({len(X)},), one per descriptor")
    bad = np.flatnonzero(~np.isfinite(X.sum(axis=1, dtype=np.float64)))
    if bad.size:
        raise ValueError(f"row {bad[0]} of the descriptors has NaN or infinite values")
    names, counts = np.unique(condition, return_counts=True)
    if len(names) < 2:
        raise ValueError(f"all {len(X)} descriptors have the condition {names[0]}; at least two conditions are needed")
    if counts.min() < 2:
        raise ValueError(f"condition {names[counts.argmin()]} has one descriptor; at least two are needed")
    if (X[:1] == X).all():
        raise ValueError(f"all {len(X)} descriptors are the same; nothing can be fitted")
    return X, condition


def _chunks(width: int) -> range:
    return range(0, width, _CHUNK)


def _gram(X: np.ndarray, mean: np.ndarray, device: Any) -> np.ndarray:
    """Return ``(X - mean)(X - mean)'`` in float64, a slice of columns at a time."""
    import torch

    target = torch.device(device or "cpu")
    total = torch.zeros((len(X), len(X)), dtype=torch.float64, device=target)
    for start in _chunks(X.shape[1]):
        part = X[:, start : start + _CHUNK].astype(np.float64) - mean[start : start + _CHUNK]
        block = torch.from_numpy(part).to(target)
        total.addmm_(block, block.T)
    return total.cpu().numpy()


def _scatter(X: np.ndarray, mean: np.ndarray, device: Any) -> np.ndarray:
    """Return ``(X - mean)'(X - mean)`` in float64; for more rows than columns."""
    import torch

    block = torch.from_numpy(X.astype(np.float64) - mean).to(torch.device(device or "cpu"))
    return (block.T @ block).cpu().numpy()


def _combine(X: np.ndarray, mean: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return ``(X - mean)' weights`` in float64, a slice of columns at a time."""
    out = np.empty((X.shape[1], weights.shape[1]))
    for start in _chunks(X.shape[1]):
        part = X[:, start : start + _CHUNK].astype(np.float64) - mean[start : start + _CHUNK]
        out[start : start + _CHUNK] = part.T @ weights
    return out


def _spectrum(matrix: np.ndarray, tolerance: float = 1e-12) -> tuple[np.ndarray, np.ndarray]:
    """Return the eigenvalues above a share of the largest, and their eigenvectors."""
    values, vectors = linalg.eigh(matrix, overwrite_a=True, check_finite=False)
    kept = values > tolerance * values[-1]
    return values[kept], vectors[:, kept]
