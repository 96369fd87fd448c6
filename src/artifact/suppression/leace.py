"""LEACE: the least change of descriptors after which no linear classifier can tell the conditions apart."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import linalg

from artifact.suppression.lowrank import LowRankEstimator, LowRankMap
from artifact.suppression.samples import checked_fit, gram_matrix, precision, scatter_matrix, spectrum, weighted_sum


class LEACE(LowRankEstimator):
    """Least-squares concept erasure (Belrose et al. 2023), exact and without ``d × d`` matrices.

    The paper's formula (§IV-C) with whitening ``W = (Σ_XX^(1/2))^+`` equals
    ``r(x) = x - A (A'B)^+ B' (x - μ)`` with ``A = X_c' Z_c`` and ``B`` the minimum-norm least-squares solution of
    ``X_c B = Z_c``: memory O(n d).

    Nothing is removed where the conditions are already guarded. With orthonormal columns ``Q`` that span those of
    ``Z_c``, a condition direction counts only if its singular value in ``X_c' Q`` is above ``(2 ε + n ε₆₄) ‖X‖``, what
    rounding of the stored values and of the sums can leave of an erased condition: ``ε`` is the epsilon of the coarsest
    of float16, float32 and float64 that holds all of ``X``. So a fit on the stored output of a fit is the identity.
    (The regression cannot tell: with more columns than rows it fits labels to the rounding. Rows scaled to unit length
    after erasure are other data, whose means may differ again.)

    Parameters
    ----------
    shrinkage
        Whether to shrink the covariance linearly towards a multiple of the identity (Bodnar et al. 2014), as the
        reference implementation does by default; the paper's formula does not.
    tolerance
        Eigenvalues of the covariance at or below this share of the largest count as zero; ``None`` is the larger of n
        and d times the float64 epsilon.
    device
        Where the large matrix products run; ``None`` is the CPU.

    Attributes
    ----------
    map_
        The fitted :class:`~artifact.suppression.lowrank.LowRankMap`, of lower rank than there are conditions.
    mean_
        ``(d,)`` mean of the fitting data, which the map keeps.
    """

    def __init__(self, shrinkage: bool = False, tolerance: float | None = None, device: Any = None) -> None:
        self.shrinkage = shrinkage
        self.tolerance = tolerance
        self.device = device

    def fit(self, X: np.ndarray, condition: np.ndarray) -> LEACE:
        """Fit on descriptors ``(n, d)`` and their conditions ``(n,)``; raises as :meth:`artifact.STD.fit`."""
        X, condition = checked_fit(X, condition)
        self.mean_ = X.mean(axis=0, dtype=np.float64)
        labels = (condition[:, None] == np.unique(condition)[:-1]).astype(np.float64)
        labels = linalg.qr(labels - labels.mean(axis=0), mode="economic")[0]
        cross, sizes, mixing = linalg.svd(weighted_sum(X, self.mean_, labels), full_matrices=False)
        rounding = 2 * precision(X) + len(X) * np.finfo(np.float64).eps
        found = sizes > rounding * np.sqrt(np.einsum("nd,nd->", X, X, dtype=np.float64))
        # From here on both sides of the regression are of unit size, however weak a condition is.
        cross, labels = cross[:, found], labels @ (mixing[found].T / sizes[found])
        if not found.any():
            self.map_ = LowRankMap(cross, cross, np.zeros(0))
            return self
        solution = self._regression(X, cross, labels)
        # Not made symmetric: its own inverse guards exactly, however well the regression is conditioned.
        outer, values, inner = linalg.svd(solution.T @ cross)
        kept = values > 1e-10 * values[0]
        right = solution @ outer[:, kept]
        self.map_ = LowRankMap(cross @ (inner[kept].T / values[kept]), right, right.T @ self.mean_)
        return self

    def _regression(self, X: np.ndarray, cross: np.ndarray, labels: np.ndarray) -> np.ndarray:
        """Minimum-norm solution of ``X_c B = labels``, or its shrunk form ``(α S + γ I)^-1 cross``, up to a factor."""
        n, d = X.shape
        dual = n <= d
        gram = (gram_matrix if dual else scatter_matrix)(X, self.mean_, self.device)
        if self.shrinkage:
            alpha, gamma = _shrinkage(gram / n, n, d)
            gram = alpha * gram / n
            gram[np.diag_indices_from(gram)] += gamma
            solved = linalg.solve(gram, labels if dual else cross, assume_a="pos")
        else:
            tolerance = max(n, d) * np.finfo(np.float64).eps if self.tolerance is None else self.tolerance
            values, vectors = spectrum(gram, tolerance)
            solved = vectors @ ((vectors.T @ (labels if dual else cross)) / values[:, None])
        return weighted_sum(X, self.mean_, solved) if dual else solved


def _shrinkage(covariance: np.ndarray, n: int, d: int) -> tuple[float, float]:
    """Weights of covariance and identity (Bodnar et al. 2014) from trace and norm, which the ``n × n`` form shares."""
    trace = float(np.trace(covariance))
    spread = float((covariance**2).sum()) - trace**2 / d
    alpha = 1 - min(1.0, trace**2 / n / spread) if spread > 0 else 0.0
    return alpha, (1 - alpha) * trace / d
