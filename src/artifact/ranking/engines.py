"""Where the arithmetic of a ranking pass runs: NumPy and Numba on the CPU, or :mod:`artifact.ranking.engine_torch`.

Both engines offer the same six operations on blocks of rows and columns; the schedule of the pass is in
:mod:`artifact.ranking.one_pass` and does not know which engine it drives.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Protocol

import numpy as np

from artifact.ranking import counting
from artifact.ranking.counting import Counts, Groups, Places, Tile

_CONVERTED = 32 * 2**20  # bytes of half-precision descriptors that are widened at a time
_NOTHING = np.empty((0, 0), np.float32)


class Engine(Protocol):
    """What a ranking pass asks of a device."""

    def __enter__(self) -> Engine: ...
    def __exit__(self, *_: object) -> None: ...
    def product(self, left: np.ndarray, rows: slice, right: np.ndarray, columns: slice) -> Any: ...  # noqa: D102
    def correction(self, left: np.ndarray, right: np.ndarray) -> Any: ...  # noqa: D102
    def transposed(self, tile: Any) -> Any: ...  # noqa: D102
    def count_database(self, tile: Tile, positives: Groups, counts: Counts) -> None: ...  # noqa: D102
    def count_pool(self, tile: Tile, places: Places, orders: np.ndarray, counts: Counts) -> None: ...  # noqa: D102
    def count_pool_only(self, tile: Tile, places: Places, near: Groups, counts: Counts) -> None: ...  # noqa: D102


class CpuEngine:
    """Matrix products by NumPy's BLAS, counting by Numba in one thread per core."""

    def __init__(self) -> None:
        self._workers = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        self._pool = ThreadPoolExecutor(self._workers)
        self._buffers: dict[str, np.ndarray] = {}

    def __enter__(self) -> CpuEngine:
        return self

    def __exit__(self, *_: object) -> None:
        self._pool.shutdown()

    def product(self, left: np.ndarray, rows: slice, right: np.ndarray, columns: slice) -> np.ndarray:
        """Return ``left[rows] @ right[columns].T`` as float32; the memory is reused by the next call."""
        block, others = left[rows].astype(np.float32, copy=False), right[columns]
        out = self._buffer("product", (len(block), len(others)))
        step = len(others) if others.dtype == np.float32 else max(1, _CONVERTED // (4 * others.shape[1]))
        for start in range(0, len(others), step):
            part = others[start : start + step].astype(np.float32, copy=False)
            np.matmul(block, part.T, out=out[:, start : start + step])
        return out

    def correction(self, left: np.ndarray, right: np.ndarray) -> np.ndarray:
        """Return what a view subtracts from a tile, ``left @ right.T``; empty if the view changes nothing."""
        if left.shape[1] == 0:
            return _NOTHING
        return np.matmul(left, right.T, out=self._buffer("correction", (len(left), len(right))))

    def transposed(self, tile: np.ndarray) -> np.ndarray:
        """Return the transposed tile in row order."""
        return np.ascontiguousarray(tile.T)

    def count_database(self, tile: Tile, positives: Groups, counts: Counts) -> None:
        """See :func:`artifact.ranking.counting.database_rows`."""
        self._by_rows(tile, lambda part: counting.database_rows(part, positives, counts))

    def count_pool(self, tile: Tile, places: Places, orders: np.ndarray, counts: Counts) -> None:
        """See :func:`artifact.ranking.counting.pool_rows`."""
        earliest = orders.min(axis=1) if orders.shape[1] else np.zeros(len(orders), np.int32)
        self._by_rows(tile, lambda part: counting.pool_rows(part, places, orders, earliest, counts))

    def count_pool_only(self, tile: Tile, places: Places, near: Groups, counts: Counts) -> None:
        """See :func:`artifact.ranking.counting.pool_counts`."""
        self._by_rows(tile, lambda part: counting.pool_counts(part, near, counts))

    def _by_rows(self, tile: Tile, count: Callable[[Tile], None]) -> None:
        edges = np.linspace(0, len(tile.values), self._workers + 1).astype(int).tolist()
        jobs = [
            self._pool.submit(
                count,
                tile._replace(
                    values=tile.values[start:stop],
                    correction=tile.correction[start:stop],
                    first_row=tile.first_row + start,
                ),
            )
            for start, stop in itertools.pairwise(edges)
            if stop > start
        ]
        for job in jobs:
            job.result()

    def _buffer(self, name: str, shape: tuple[int, int]) -> np.ndarray:
        size = shape[0] * shape[1]
        if name not in self._buffers or self._buffers[name].size < size:
            self._buffers[name] = np.empty(size, np.float32)
        return self._buffers[name][:size].reshape(shape)


def engine_for(device: Any) -> Engine:
    """Return the engine of a device; ``None`` takes CUDA if there is any, else the CPU."""
    if str(device) == "cpu":
        return CpuEngine()
    import torch  # takes longer to import than many a ranking takes

    if device is None and not torch.cuda.is_available():
        return CpuEngine()
    from artifact.ranking.engine_torch import TorchEngine

    return TorchEngine(torch.device("cuda" if device is None else device))
