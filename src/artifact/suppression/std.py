"""STD: descriptors standardised per condition."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from sklearn.base import BaseEstimator
from sklearn.utils.validation import check_is_fitted

from artifact import store
from artifact.suppression.samples import checked_fit

_BLOCK = 1024  # rows whose means and deviations are spread out at a time


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

    def save(self, path: Path) -> None:
        """Write the fitted values to an ``.npz`` file; :func:`artifact.load_transform` reads it."""
        check_is_fitted(self)
        arrays = {"conditions": self.conditions_, "mean": self.mean_, "scale": self.scale_}
        store.write_arrays(Path(path), {"kind": np.array("STD"), **arrays})

    @classmethod
    def from_arrays(cls, conditions: np.ndarray, mean: np.ndarray, scale: np.ndarray) -> STD:
        """Rebuild a fitted transform from its attributes."""
        fitted = cls()
        fitted.conditions_, fitted.mean_, fitted.scale_ = conditions, mean, scale
        return fitted

    def transform(self, X: np.ndarray, condition: np.ndarray | int | str, *, copy: bool = True) -> np.ndarray:
        """Standardise descriptors ``(n, d)`` by their conditions, ``(n,)`` or one for all; the dtype is kept.

        With ``copy=False`` floats of 32 or 64 bits are changed in place.

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
        mean, scale = self.mean_.astype(kind), self.scale_.astype(kind)
        out = np.empty(X.shape, kind) if copy or X.dtype != kind else X
        for start in range(0, len(X), _BLOCK):
            block = slice(start, start + _BLOCK)
            np.subtract(X[block], mean[index[block]], out=out[block], casting="same_kind")
            out[block] /= scale[index[block]]
        return out
