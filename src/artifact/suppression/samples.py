"""Checked fitting data, and sums over many samples in little memory."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import linalg

_CHUNK = 4096  # columns that are widened to float64 at a time


def checked_fit(X: np.ndarray, condition: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return descriptors and conditions as arrays, or raise ``ValueError`` if nothing can be fitted on them."""
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


def checked_rows(X: np.ndarray, width: int) -> np.ndarray:
    """Return descriptors to transform, in float32 unless float64, or raise ``ValueError`` if they do not fit."""
    X = np.asarray(X)
    if X.ndim != 2 or X.shape[1] != width:
        raise ValueError(f"descriptors have the shape {X.shape}; this transform was fitted on (n, {width})")
    return X if X.dtype == np.float64 else X.astype(np.float32, copy=False)


def precision(X: np.ndarray) -> float:
    """Return the epsilon of the coarsest of float16, float32 and float64 that holds every value."""
    for kind in (np.float16, np.float32):
        with np.errstate(over="ignore"):
            if all((rows.astype(kind) == rows).all() for rows in X):
                return float(np.finfo(kind).eps)
    return float(np.finfo(np.float64).eps)


def _chunks(width: int) -> list[slice]:
    return [slice(start, start + _CHUNK) for start in range(0, width, _CHUNK)]


def gram_matrix(X: np.ndarray, mean: np.ndarray, device: Any) -> np.ndarray:
    """Return ``(X - mean)(X - mean)'`` in float64, a slice of columns and of rows at a time; half of it is multiplied."""
    total = np.zeros((len(X), len(X)))
    rows = [slice(start, min(start + _CHUNK, len(X))) for start in range(0, len(X), _CHUNK)]
    for columns in _chunks(X.shape[1]):
        part = X[:, columns].astype(np.float64) - mean[columns]
        for some in rows:
            total[some, : some.stop] += _product(part[some], part[: some.stop], device)
    for some in rows:
        total[: some.start, some] = total[some, : some.start].T
    return total


def scatter_matrix(X: np.ndarray, mean: np.ndarray, device: Any) -> np.ndarray:
    """Return ``(X - mean)'(X - mean)`` in float64; for more rows than columns."""
    block = (X.astype(np.float64) - mean).T
    return _product(block, block, device)


def _product(left: np.ndarray, right: np.ndarray, device: Any) -> np.ndarray:
    """Return ``left @ right.T``."""
    if device is None or str(device) == "cpu":
        return left @ right.T
    import torch

    there = (torch.from_numpy(np.ascontiguousarray(side)).to(device) for side in (left, right))
    return (next(there) @ next(there).T).cpu().numpy()


def weighted_sum(X: np.ndarray, mean: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return ``(X - mean)' weights`` in float64, a slice of columns at a time."""
    out = np.empty((X.shape[1], weights.shape[1]))
    for columns in _chunks(X.shape[1]):
        out[columns] = (X[:, columns].astype(np.float64) - mean[columns]).T @ weights
    return out


def spectrum(matrix: np.ndarray, tolerance: float = 1e-12) -> tuple[np.ndarray, np.ndarray]:
    """Return the eigenvalues above a share of the largest, and their eigenvectors."""
    # LAPACK works in columns: it copies a symmetric matrix in rows, and takes its transpose as it is.
    values, vectors = linalg.eigh(matrix.T, overwrite_a=True, check_finite=False)
    first = np.searchsorted(values, tolerance * values[-1], side="right")
    return values[first:], vectors[:, first:]  # a view: a copy of n × n eigenvectors may not fit
