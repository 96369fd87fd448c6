"""Affine maps that differ from the identity by a low rank, and their composition.

Every suppression transform that needs no condition at inference (INLP, LEACE, any sequence of them) has the form
``r(x) = x - left (right' x - offset)`` with ``left`` and ``right`` of ``k`` columns: O(d k) memory, and a similarity
between two transformed descriptors is the original one plus a correction of rank 2 k.
"""

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.utils.validation import check_is_fitted

from artifact.suppression import saved
from artifact.suppression.samples import checked_rows


@dataclass(frozen=True)
class LowRankMap:
    """The map ``x - left @ (right.T @ x - offset)``: ``left``, ``right`` ``(d, k)``, ``offset`` ``(k,)``, float64."""

    left: np.ndarray
    right: np.ndarray
    offset: np.ndarray

    @property
    def rank(self) -> int:
        """Number of columns k."""
        return len(self.offset)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the map to a file for :func:`artifact.load_transform`, whole or not at all.

        Examples
        --------
        >>> import tempfile
        >>> from artifact import load_transform
        >>> path = f"{tempfile.mkdtemp()}/map.npz"
        >>> LowRankMap(np.eye(2)[:, :1], np.eye(2)[:, :1], np.zeros(1)).save(path)
        >>> load_transform(path).transform(np.array([[1.0, 2.0]])).tolist()
        [[0.0, 2.0]]
        """
        saved.write(path, "low-rank map", left=self.left, right=self.right, offset=self.offset)

    def low_rank(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return ``left``, ``right`` and ``offset``, for evaluation as a view."""
        return self.left, self.right, self.offset

    def transform(self, X: np.ndarray) -> np.ndarray:
        """Apply the map to rows ``(n, d)``, or raise ``ValueError`` if they have another width; the dtype is kept."""
        X = checked_rows(X, len(self.left))
        left, right, offset = (part.astype(X.dtype) for part in (self.left, self.right, self.offset))
        change = (X @ right - offset) @ left.T
        return np.subtract(X, change, out=change)


class LowRankEstimator(TransformerMixin, BaseEstimator):
    """A transform whose fit gives a low-rank map, ``map_``."""

    map_: LowRankMap

    def low_rank(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the fitted map as ``left``, ``right``, ``offset``."""
        check_is_fitted(self)
        return self.map_.low_rank()

    def transform(self, X: np.ndarray) -> np.ndarray:
        """Transform descriptors ``(n, d)``; the dtype is kept."""
        check_is_fitted(self)
        return self.map_.transform(X)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the fitted map to a file for :func:`artifact.load_transform`; see :meth:`LowRankMap.save`."""
        LowRankMap(*self.low_rank()).save(path)


def compose(*steps: LowRankMap | LowRankEstimator) -> LowRankMap:
    """Return one map that applies fitted INLP or LEACE estimators, or low-rank maps, in order, normalising nothing.

    Raises ``TypeError`` if a step has no low-rank form, as STD; ``ValueError`` if there is no step, or widths differ.

    Examples
    --------
    >>> drop_first = LowRankMap(np.eye(3)[:, :1], np.eye(3)[:, :1], np.zeros(1))
    >>> drop_last = LowRankMap(np.eye(3)[:, 2:], np.eye(3)[:, 2:], np.zeros(1))
    >>> compose(drop_first, drop_last).transform(np.array([[1.0, 2.0, 3.0]])).tolist()
    [[0.0, 2.0, 0.0]]
    """
    if not steps:
        raise ValueError("compose needs at least one transform")
    for step in steps:
        if not hasattr(step, "low_rank"):
            raise TypeError(f"{type(step).__name__} has no low-rank form; INLP, LEACE and their compositions have")
    parts = [step.low_rank() for step in steps]
    widths = {part[0].shape[0] for part in parts}
    if len(widths) > 1:
        raise ValueError(f"the transforms were fitted on different widths: {', '.join(map(str, sorted(widths)))}")
    left, right, offset = parts[0]
    for next_left, next_right, next_offset in parts[1:]:
        overlap = left.T @ next_right
        right = np.concatenate([right, next_right - right @ overlap], axis=1)
        offset = np.concatenate([offset, next_offset - overlap.T @ offset])
        left = np.concatenate([left, next_left], axis=1)
    return LowRankMap(left, right, offset)
