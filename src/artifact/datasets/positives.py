"""Which database images are positives of a query."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree


def as_columns(positions: npt.ArrayLike) -> np.ndarray:
    """Return positions ``(n, p)`` as float64; those of one axis, ``(n,)``, become a column."""
    columns = np.asarray(positions, np.float64)
    return columns[:, None] if columns.ndim == 1 else columns


def positives_of(
    query_positions: np.ndarray, database_positions: np.ndarray, threshold: float
) -> tuple[np.ndarray, np.ndarray]:
    """List the database images within a threshold (inclusive) of each query, as ``starts`` and ``positives``, int64.

    Those of query ``i`` are ``positives[starts[i]:starts[i + 1]]``, ascending database indices.

    Examples
    --------
    >>> starts, positives = positives_of(np.array([[0.0], [9.0]]), np.array([[1.0], [2.0], [3.0]]), 2.0)
    >>> starts.tolist(), positives.tolist()
    ([0, 2, 2], [0, 1])
    """
    trees = cKDTree(query_positions), cKDTree(database_positions)
    near = trees[0].sparse_distance_matrix(trees[1], threshold * (1 + 1e-9), output_type="ndarray")
    # The tree's distances are good to far less than this slack; close to the threshold the definition decides.
    close = np.flatnonzero(near["v"] > threshold * (1 - 1e-9))
    i, j, squared = near["i"][close], near["j"][close], np.zeros(len(close))
    for here, there in zip(query_positions.T, database_positions.T, strict=True):
        squared += (here[i] - there[j]) ** 2
    pairs = np.delete(near["i"] * len(database_positions) + near["j"], close[np.sqrt(squared) > threshold])
    pairs.sort()
    owners, indices = np.divmod(pairs, len(database_positions))
    counts = np.bincount(owners, minlength=len(query_positions))
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64), indices.astype(np.int64, copy=False)


def nearest_distance(query_positions: np.ndarray, database_positions: np.ndarray) -> float:
    """Return the least distance between a query and a database image, in the unit of the positions."""
    return float(cKDTree(database_positions).query(query_positions)[0].min())
