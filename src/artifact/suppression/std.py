"""STD: descriptors standardised per condition."""

from __future__ import annotations

import numpy as np
from sklearn.base import BaseEstimator
from sklearn.utils.validation import check_is_fitted

from artifact.suppression.samples import checked_fit


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
        X, condition = checked_fit(X, condition)
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
