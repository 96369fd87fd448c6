"""Where the arithmetic of a ranking pass runs: NumPy and Numba on the CPU, PyTorch on other devices.

Both engines offer the same five operations on blocks of rows and columns; the schedule of the pass is in
:mod:`artifact.ranking` and does not know which engine it drives.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import torch

from artifact import counting
from artifact.counting import Counts

_CONVERTED = 32 * 2**20  # bytes of half-precision descriptors that are widened at a time
_NOTHING = np.empty((0, 0), np.float32)


class CpuEngine:
    """Matrix products by NumPy's BLAS, counting by Numba in one thread per core."""

    def __init__(self) -> None:
        self._workers = (
            len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        )
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

    def count_database(
        self, tile, correction, scale, bias, starts, positives, offset, counts: Counts
    ) -> None:
        """See :func:`artifact.counting.database_rows`."""
        self._by_rows(
            lambda rows, fix, first: counting.database_rows(
                tile[rows], fix, scale, bias, starts, positives, offset + first, counts.best, counts.beaters,
                counts.ties, counts.top_similarity, counts.top_index,
            ),
            len(tile), correction,
        )  # fmt: skip

    def count_pool(
        self, tile, correction, scale, bias, offset, first_column, positions, pool_positions, threshold, orders,
        counts: Counts,
    ) -> None:  # fmt: skip
        """See :func:`artifact.counting.pool_rows`."""
        self._by_rows(
            lambda rows, fix, first: counting.pool_rows(
                tile[rows], fix, scale, bias, offset + first, first_column, positions, pool_positions, threshold,
                orders, counts.best, counts.beaters, counts.ties, counts.farthest, counts.first,
                counts.top_similarity, counts.top_index,
            ),
            len(tile), correction,
        )  # fmt: skip

    def _by_rows(self, count, n_rows: int, correction: np.ndarray) -> None:
        edges = np.linspace(0, n_rows, self._workers + 1).astype(int)
        jobs = [
            self._pool.submit(count, slice(start, stop), correction[start:stop], start)
            for start, stop in zip(edges[:-1], edges[1:], strict=True)
            if stop > start
        ]
        for job in jobs:
            job.result()

    def _buffer(self, name: str, shape: tuple[int, int]) -> np.ndarray:
        size = shape[0] * shape[1]
        if name not in self._buffers or self._buffers[name].size < size:
            self._buffers[name] = np.empty(size, np.float32)
        return self._buffers[name][:size].reshape(shape)


class TorchEngine:
    """Everything in PyTorch on one device; descriptors that fit stay there for the whole pass."""

    def __init__(self, device: torch.device) -> None:
        self._device = device
        self._resident: dict[int, torch.Tensor] = {}
        self._precision = torch.get_float32_matmul_precision()

    def __enter__(self) -> TorchEngine:
        # TF32 keeps ten bits of the mantissa and would decide near-ties at random.
        torch.set_float32_matmul_precision("highest")
        return self

    def __exit__(self, *_: object) -> None:
        torch.set_float32_matmul_precision(self._precision)
        self._resident.clear()

    def product(self, left: np.ndarray, rows: slice, right: np.ndarray, columns: slice) -> torch.Tensor:
        """Return ``left[rows] @ right[columns].T`` as float32."""
        block, n = self._load(left, rows), len(range(*columns.indices(len(right))))
        step = max(1, _CONVERTED // (4 * right.shape[1])) if id(right) not in self._resident else n
        first = columns.indices(len(right))[0]
        parts = [
            block @ self._load(right, slice(first + start, first + min(start + step, n))).T
            for start in range(0, n, step)
        ]
        return parts[0] if len(parts) == 1 else torch.cat(parts, dim=1)

    def correction(self, left: np.ndarray, right: np.ndarray) -> torch.Tensor:
        """Return what a view subtracts from a tile, ``left @ right.T``; zero if the view changes nothing."""
        if left.shape[1] == 0:
            return torch.zeros((), device=self._device)
        return torch.from_numpy(left).to(self._device) @ torch.from_numpy(right).to(self._device).T

    def transposed(self, tile: torch.Tensor) -> torch.Tensor:
        """Return the transposed tile."""
        return tile.T if tile.ndim else tile

    def count_database(
        self, tile, correction, scale, bias, starts, positives, offset, counts: Counts
    ) -> None:
        """See :func:`artifact.counting.database_rows_torch`."""
        scale, bias = self._send(scale), self._send(bias)
        counting.database_rows_torch(tile - correction, scale, bias, starts, positives, offset, counts)

    def count_pool(
        self, tile, correction, scale, bias, offset, first_column, positions, pool_positions, threshold, orders,
        counts: Counts,
    ) -> None:  # fmt: skip
        """See :func:`artifact.counting.pool_rows_torch`."""
        counting.pool_rows_torch(
            tile - correction, self._send(scale), self._send(bias), offset, first_column, self._send(positions),
            self._send(pool_positions), threshold, self._send(orders), counts,
        )  # fmt: skip

    def _send(self, array: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(array).to(self._device)

    def _load(self, array: np.ndarray, rows: slice) -> torch.Tensor:
        if id(array) not in self._resident and self._fits(array):
            self._resident[id(array)] = self._send(np.ascontiguousarray(array)).float()
        if id(array) in self._resident:
            return self._resident[id(array)][rows]
        return self._send(np.ascontiguousarray(array[rows])).float()

    def _fits(self, array: np.ndarray) -> bool:
        if self._device.type != "cuda":
            return False
        free, _ = torch.cuda.mem_get_info(self._device)
        return array.size * 4 < free // 3


def engine_for(device: str | torch.device | None) -> CpuEngine | TorchEngine:
    """Return the engine of a device; ``None`` takes CUDA if there is any, else the CPU."""
    if device is None:
        device = "cuda" if torch.cuda.is_available() else "cpu"
    return CpuEngine() if str(device) == "cpu" else TorchEngine(torch.device(device))
