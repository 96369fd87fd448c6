"""The ranking pass on other devices than the CPU: the same operations and the same counting, in PyTorch."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
import torch

from artifact.ranking import products
from artifact.ranking.counting import Counts, Groups, Lens, Orders, Places, Target, Tile
from artifact.ranking.products import Product, TorchProduct
from artifact.suppression.compiled import threads

_CONVERTED = 32 * 2**20  # bytes of descriptors that are sent to the device at a time if they do not stay there
_STEP = 128  # columns of a product: here the second looks, on the processor, weigh more than the product
_PIECE = 2**24  # values of a tile that are counted at a time

T = TypeVar("T")


class TorchEngine:
    """Everything in PyTorch on one device; descriptors that fit stay there for the whole pass.

    Products are float32 unless one of :mod:`artifact.ranking.products` is given.
    """

    def __init__(self, device: torch.device, product: Product | None = None) -> None:
        self._device = device
        self._resident: dict[int, torch.Tensor] = {}
        self.executor = threads()
        self.product_kind = product or TorchProduct(step=_STEP)

    def __enter__(self) -> TorchEngine:
        return self

    def __exit__(self, *_: object) -> None:
        self._resident.clear()
        self.executor.shutdown()

    def choose(self, multiplications: int, look_seconds: Callable[[Product], float]) -> None:
        """Keep the product: on a device, second looks on the processor cost more than a faster product saves."""

    def product(self, left: np.ndarray, rows: slice, right: np.ndarray, columns: slice) -> torch.Tensor:
        """Return ``left[rows] @ right[columns].T`` as float32."""
        kind, (first, end, _) = self.product_kind, columns.indices(len(right))
        block = kind.prepared(self._load(left, rows))
        step = max(1, _CONVERTED // (4 * right.shape[1])) if id(right) not in self._resident else end - first
        starts = range(first, end, step)
        others = (self._load(right, slice(start, min(start + step, end))) for start in starts)
        parts = [kind.multiply(block, kind.prepared(other)) for other in others]
        return parts[0] if len(parts) == 1 else torch.cat(parts, dim=1)

    def gather(self, tile: torch.Tensor, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Return single values of a tile."""
        return tile[self._send(rows), self._send(columns)].cpu().numpy()

    def transposed(self, tile: torch.Tensor) -> torch.Tensor:
        """Return the transposed tile."""
        return tile.T

    def in_pieces(self, tile: Tile, work: Callable[[Tile], T], largest: int) -> list[T]:
        """Do some work with pieces of a tile that the device divides further by itself; sweeps hold several of one."""
        step = max(1, _PIECE // tile.values.shape[1])

        def one(start: int) -> T:
            return work(tile._replace(values=tile.values[start : start + step], first_row=tile.first_row + start))

        return [one(start) for start in range(0, len(tile.values), step)]

    def shown(self, piece: Tile, lens: Lens) -> Tile:
        """Do as :func:`artifact.ranking.counting.show_rows`."""
        if not lens.left.shape[1]:
            return piece
        rows, columns = self._ranges(piece)
        left, right = lens.left[rows, lens.shared :], lens.right[lens.shared :, columns]
        with products.precision("highest"):
            return piece._replace(values=piece.values - self._send(left) @ self._send(right))

    def count(self, piece: Tile, lens: Lens, target: Target, groups: Groups, counts: Counts) -> np.ndarray:
        """Do as :func:`artifact.ranking.counting.count_rows`."""
        rows, columns = self._ranges(piece)
        line, (middle, width) = piece.values, self._against(piece, lens, target)
        left_out = self._members(piece, groups)
        above, below = line > middle + width, line < middle - width
        equal = self._send(target.identity[rows])[:, None] == self._send(lens.identity[columns])
        unsure = ~(above | below | left_out)
        counts.outranking[rows] += (above & ~left_out).sum(1).cpu().numpy()
        counts.ties[rows] += (unsure & equal).sum(1).cpu().numpy()
        return (unsure & ~equal).nonzero().cpu().numpy() + np.array([piece.first_row, piece.first_column])

    def sweep(self, piece: Tile, lens: Lens, target: Target, places: Places, orders: Orders, counts: Counts) -> None:
        """Do as :func:`artifact.ranking.counting.sweep_rows`."""
        rows, columns = self._ranges(piece)
        line, (middle, width) = piece.values, self._against(piece, lens, target)
        here, there, placed = map(self._send, (places.queries[rows], places.pool[columns], orders.place[columns]))
        squared = torch.zeros(line.shape, dtype=torch.float64, device=self._device)
        for axis in range(here.shape[1]):
            difference = here[:, axis, None] - there[None, :, axis]
            squared += difference * difference
        distance = squared.sqrt_()
        outranks = (distance > places.threshold) & (line > middle + width)
        depth = min(counts.farthest.shape[1], line.shape[1])
        found = distance.masked_fill_(~outranks, -torch.inf).topk(depth, dim=1).values.cpu().numpy()
        merged = np.concatenate([counts.farthest[rows], found], axis=1)
        counts.farthest[rows] = -np.sort(-merged, axis=1)[:, : counts.farthest.shape[1]]
        for draw in range(counts.first.shape[2]):
            drawn = placed[:, draw].expand_as(line).masked_fill(~outranks, np.iinfo(np.int32).max)
            found = drawn.topk(depth, dim=1, largest=False).values.cpu().numpy()
            merged = np.concatenate([counts.first[rows, :, draw], found], axis=1)
            counts.first[rows, :, draw] = np.sort(merged, axis=1)[:, : counts.first.shape[1]]

    def top(self, piece: Tile, lens: Lens, groups: Groups, similarity: np.ndarray, index: np.ndarray) -> None:
        """Do as :func:`artifact.ranking.counting.top_rows`."""
        rows, columns = self._ranges(piece)
        values = (piece.values - self._send(lens.bias[columns])) / self._send(lens.scale[columns])
        values = values.nan_to_num(-torch.inf).masked_fill_(self._members(piece, groups), -torch.inf)
        found, places = values.topk(min(similarity.shape[1], values.shape[1]), dim=1)
        merged = np.concatenate([similarity[rows], found.cpu().numpy()], axis=1)
        labels = np.concatenate([index[rows], places.cpu().numpy() + piece.first_column], axis=1)
        order = np.argsort(-merged, axis=1, kind="stable")[:, : similarity.shape[1]]
        similarity[rows] = np.take_along_axis(merged, order, axis=1)
        index[rows] = np.where(np.isneginf(similarity[rows]), -1, np.take_along_axis(labels, order, axis=1))

    def _ranges(self, tile: Tile) -> tuple[slice, slice]:
        rows, columns = tile.values.shape
        return (
            slice(tile.first_row, tile.first_row + rows),
            slice(tile.first_column, tile.first_column + columns),
        )

    def _against(self, tile: Tile, lens: Lens, target: Target) -> tuple[torch.Tensor, torch.Tensor]:
        """Return what inner products are compared with, and how near to it they tell nothing."""
        rows, columns = self._ranges(tile)
        level, reach = (self._send(part[rows])[:, None] for part in (target.level, lens.query_reach))
        scale, bias, reaches = (self._send(part[columns]) for part in (lens.scale, lens.bias, lens.image_reach))
        return level * scale + bias, reach * reaches

    def _members(self, tile: Tile, groups: Groups) -> torch.Tensor:
        """Return which images of a tile belong to its queries."""
        rows, columns = self._ranges(tile)
        starts = groups.starts[rows.start : rows.stop + 1]
        owner = np.repeat(np.arange(rows.stop - rows.start), np.diff(starts))
        members = groups.members[starts[0] : starts[-1]] - columns.start
        inside = (members >= 0) & (members < columns.stop - columns.start)
        mask = torch.zeros(tile.values.shape, dtype=torch.bool, device=self._device)
        mask[self._send(owner[inside]), self._send(members[inside])] = True
        return mask

    def _send(self, array: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(np.ascontiguousarray(array)).to(self._device)

    def _load(self, array: np.ndarray, rows: slice) -> Any:
        if id(array) not in self._resident and self._fits(array):
            self._resident[id(array)] = self._send(array).float()
        if id(array) in self._resident:
            return self._resident[id(array)][rows]
        return self._send(array[rows]).float()

    def _fits(self, array: np.ndarray) -> bool:
        if self._device.type != "cuda":
            return False
        free, _ = torch.cuda.mem_get_info(self._device)
        return array.size * 4 < free // 3
