"""Where the arithmetic of a ranking pass runs: the CPU, with Numba, or :mod:`artifact.ranking.engine_torch`.

Both engines offer the same operations on blocks of rows and columns; the schedule of the pass is in
:mod:`artifact.ranking.one_pass` and does not know which engine it drives.
"""

from __future__ import annotations

import contextlib
import ctypes
import itertools
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Protocol, TypeVar

import numpy as np

from artifact.ranking import counting, products
from artifact.ranking.counting import Counts, Groups, Lens, Orders, Places, Target, Tile
from artifact.ranking.products import NumpyProduct, Product
from artifact.suppression.compiled import threads

_COLUMNS = 2048  # columns of a product at a time: as much is copied or widened
_KEPT = 2**26  # values of rows that are kept as the product takes them
_DRIVERS = ("libcuda.so.1", "libamdhip64.so", "nvcuda.dll")  # CUDA's, or ROCm's, which PyTorch also calls CUDA
_WORTH = 2**35  # multiplications of a pass from which on products are tried
_WORTH_A_CHOICE = 2**33  # the same once they are measured

T = TypeVar("T")


class Engine(Protocol):
    """What a ranking pass asks of a device."""

    product_kind: Product
    executor: ThreadPoolExecutor

    def __enter__(self) -> Engine: ...
    def __exit__(self, *_: object) -> None: ...
    def choose(self, multiplications: int, look_seconds: Callable[[Product], float]) -> None: ...  # noqa: D102
    def product(self, left: np.ndarray, rows: slice, right: np.ndarray, columns: slice) -> Any: ...  # noqa: D102
    def gather(self, tile: Any, rows: np.ndarray, columns: np.ndarray) -> np.ndarray: ...  # noqa: D102
    def transposed(self, tile: Any) -> Any: ...  # noqa: D102
    def in_pieces(self, tile: Tile, work: Callable[[Tile], T], largest: int) -> list[T]: ...  # noqa: D102
    def shown(self, piece: Tile, lens: Lens) -> Tile: ...  # noqa: D102
    def count(self, piece: Tile, lens: Lens, target: Target, groups: Groups, counts: Counts) -> np.ndarray: ...  # noqa: D102
    def sweep(  # noqa: D102
        self, piece: Tile, lens: Lens, target: Target, places: Places, orders: Orders, counts: Counts
    ) -> None: ...
    def top(self, piece: Tile, lens: Lens, groups: Groups, similarity: np.ndarray, index: np.ndarray) -> None: ...  # noqa: D102


class CpuEngine:
    """Matrix products by the library that is fastest here, counting by Numba in one thread per core."""

    def __init__(self, product: Product | None = None) -> None:
        self.executor = threads()
        self.product_kind = product or NumpyProduct()
        self._fixed = product is not None
        self._buffers: dict[str, np.ndarray] = {}
        self._blocks: dict[tuple[int, int, int], Any] = {}

    def __enter__(self) -> CpuEngine:
        return self

    def __exit__(self, *_: object) -> None:
        self.executor.shutdown()

    def choose(self, multiplications: int, look_seconds: Callable[[Product], float]) -> None:
        """Take the product that is fastest, second looks included, where there is much to multiply."""
        if multiplications < (_WORTH_A_CHOICE if products.measured() else _WORTH) or self._fixed:
            return
        rates, least = products.seconds(), np.inf
        for product in sorted(rates, key=rates.__getitem__):
            alone = rates[product] * multiplications
            if alone < least and alone + (looks := look_seconds(product)) < least:
                self.product_kind, least = product, alone + looks

    def product(self, left: np.ndarray, rows: slice, right: np.ndarray, columns: slice) -> np.ndarray:
        """Return ``left[rows] @ right[columns].T`` as float32; the memory is reused by the next call."""
        (top, bottom, _), (first, end, _) = rows.indices(len(left)), columns.indices(len(right))
        block = self._prepared(left, top, bottom)
        out = self._buffer("product", (bottom - top, end - first))
        bounds = {first, *range(first - first % _COLUMNS + _COLUMNS, end, _COLUMNS), end}
        if left is right and first == top:
            bounds.add(min(bottom, end))  # NumPy multiplies rows with themselves at half the price
        for start, stop in itertools.pairwise(sorted(bounds)):
            self.product_kind.multiply(block, self._prepared(right, start, stop), out[:, start - first : stop - first])
        return out

    def _prepared(self, descriptors: np.ndarray, start: int, stop: int) -> Any:
        """Return rows as the product takes them; those asked for last are kept."""
        key = id(descriptors), start, stop
        found = self._blocks.pop(key, None)
        if found is None:
            found = self.product_kind.prepared(np.ascontiguousarray(descriptors[start:stop], np.float32))
            most = max(2, _KEPT // ((stop - start) * descriptors.shape[1]))
            while len(self._blocks) >= most:
                del self._blocks[next(iter(self._blocks))]
        self._blocks[key] = found
        return found

    def gather(self, tile: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Return single values of a tile."""
        return tile[rows, columns]

    def transposed(self, tile: np.ndarray) -> np.ndarray:
        """Return the transposed tile in row order."""
        out = Tile(self._buffer("transposed", (tile.shape[1], tile.shape[0])), 0, 0)
        self.in_pieces(out, lambda piece: np.copyto(piece.values, tile[:, piece.first_row :][:, : len(piece.values)].T))
        return out.values

    def in_pieces(self, tile: Tile, work: Callable[[Tile], T], largest: int | None = None) -> list[T]:
        """Do some work with pieces of at most ``largest`` rows of a tile, side by side."""
        rows = len(tile.values)
        step = min(largest or rows, -(-rows // self.executor._max_workers))

        def one(start: int) -> T:
            return work(Tile(tile.values[start : start + step], tile.first_row + start, tile.first_column))

        return list(self.executor.map(one, range(0, rows, step)))

    def shown(self, piece: Tile, lens: Lens) -> Tile:
        """See :func:`artifact.ranking.counting.show_rows`; a piece in the view before is written over."""
        if not lens.left.shape[1]:
            return piece
        out = piece.values if lens.shared else np.empty(piece.values.shape, np.float32)
        counting.show_rows(piece, lens, out)
        return piece._replace(values=out)

    def count(self, piece: Tile, lens: Lens, target: Target, groups: Groups, counts: Counts) -> np.ndarray:
        """See :func:`artifact.ranking.counting.count_rows`."""
        return counting.count_rows(piece, lens, target, groups, counts)

    def sweep(self, piece: Tile, lens: Lens, target: Target, places: Places, orders: Orders, counts: Counts) -> None:
        """See :func:`artifact.ranking.counting.sweep_rows`."""
        counting.sweep_rows(piece, lens, target, places, orders, counts)

    def top(self, piece: Tile, lens: Lens, groups: Groups, similarity: np.ndarray, index: np.ndarray) -> None:
        """See :func:`artifact.ranking.counting.top_rows`."""
        counting.top_rows(piece, lens, groups, similarity, index)

    def _buffer(self, name: str, shape: tuple[int, int]) -> np.ndarray:
        size = shape[0] * shape[1]
        if name not in self._buffers or self._buffers[name].size < size:
            self._buffers[name] = np.empty(size, np.float32)
        return self._buffers[name][:size].reshape(shape)


def engine_for(device: Any) -> Engine:
    """Return the engine of a device; ``None`` takes CUDA if there is any, else the CPU."""
    if str(device) == "cpu" or (device is None and not _has_driver()):
        return CpuEngine()
    import torch  # takes longer to import than many a ranking takes

    if device is None and not torch.cuda.is_available():
        return CpuEngine()
    from artifact.ranking.engine_torch import TorchEngine

    return TorchEngine(torch.device("cuda" if device is None else device))


def _has_driver() -> bool:
    """Whether the driver of a GPU is on this machine: without one PyTorch, slow to import, need not be asked."""
    for name in _DRIVERS:
        with contextlib.suppress(OSError):
            ctypes.CDLL(name)
            return True
    return False
