"""STD: descriptors standardised per condition."""

from __future__ import annotations

import os

import numpy as np
from sklearn.base import BaseEstimator
from sklearn.utils.validation import check_is_fitted

from artifact.suppression import saved
from artifact.suppression.samples import checked_fit, checked_rows

_BLOCK = 2**22  # values that are standardised at a time


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

        Raises ``ValueError`` for less than two conditions or rows in one, and for constant or infinite descriptors.
        """
        X, condition = checked_fit(X, condition)
        self.conditions_ = np.unique(condition)
        groups = [X[condition == c] for c in self.conditions_]
        self.mean_ = np.stack([group.mean(axis=0, dtype=np.float64) for group in groups])
        deviation = np.stack([group.std(axis=0, dtype=np.float64) for group in groups])
        flat = deviation <= self.epsilon * deviation.max(axis=1, keepdims=True)
        self.scale_ = np.where(flat, 1.0, deviation)
        return self

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the fitted transform to a file for :func:`artifact.load_transform`, whole or not at all."""
        check_is_fitted(self)
        saved.write(path, "std", conditions=self.conditions_, mean=self.mean_, scale=self.scale_)

    def transform(self, X: np.ndarray, condition: np.ndarray | int, *, copy: bool = True) -> np.ndarray:
        """Standardise descriptors ``(n, d)`` by their conditions, ``(n,)`` or one for all; the dtype is kept.

        ``copy=False`` writes the result into ``X`` itself if that is float32 or float64. Raises ``ValueError`` if the
        width differs, or a condition was not seen at fit.
        """
        check_is_fitted(self)
        X = checked_rows(given := np.asarray(X), self.mean_.shape[1])
        rows = np.broadcast_to(np.asarray(condition), len(X))
        unseen = np.setdiff1d(rows, self.conditions_)
        if unseen.size:
            seen = self.conditions_.tolist()
            raise ValueError(f"condition {unseen[0]} was not seen at fit; the conditions are {seen}")
        mean, scale = self.mean_.astype(X.dtype), self.scale_.astype(X.dtype)
        index = np.searchsorted(self.conditions_, rows)
        out = np.empty_like(X) if copy and X is given else X
        step = max(1, _BLOCK // X.shape[1])
        for start in range(0, len(X), step):
            part = slice(start, start + step)
            np.subtract(X[part], mean[index[part]], out=out[part])
            out[part] /= scale[index[part]]
        return out
