"""The ranking pass on other devices than the CPU: the same five operations and the same counting, in PyTorch."""

from __future__ import annotations

import numpy as np
import torch

from artifact.ranking.counting import Counts, Groups, Places, Tile

_CONVERTED = 32 * 2**20  # bytes of descriptors that are sent to the device at a time if they do not stay there


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

    def count_database(self, tile: Tile, positives: Groups, counts: Counts) -> None:
        """See :func:`database_rows`."""
        database_rows(self._similarity(tile), tile.first_row, positives, counts)

    def count_pool(self, tile: Tile, places: Places, orders: np.ndarray, counts: Counts) -> None:
        """See :func:`pool_rows`."""
        pool_rows(self._similarity(tile), tile.first_row, tile.first_column, places, orders, counts)

    def count_pool_only(self, tile: Tile, places: Places, near: Groups, counts: Counts) -> None:
        """Count without lists: ``counts`` has none."""
        self.count_pool(tile, places, np.zeros((len(places.pool), 0), np.int32), counts)

    def _similarity(self, tile: Tile) -> torch.Tensor:
        return (tile.values - tile.correction) * self._send(tile.scale) + self._send(tile.bias)

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


def database_rows(similarity: torch.Tensor, offset: int, groups: Groups, counts: Counts) -> None:
    """Do as :func:`artifact.ranking.counting.database_rows`, with tensors on any device."""
    starts, positives = groups
    rows = slice(offset, offset + len(similarity))
    entries = positives[starts[offset] : starts[offset + similarity.shape[0]]]
    lengths = np.diff(starts[offset : offset + similarity.shape[0] + 1])
    owner = torch.from_numpy(np.repeat(np.arange(similarity.shape[0]), lengths)).to(similarity.device)
    values = similarity[owner, torch.from_numpy(entries).to(similarity.device)]
    best = torch.full((similarity.shape[0],), -torch.inf, device=similarity.device).scatter_reduce_(
        0, owner, values, "amax"
    )
    equal = (similarity == best[:, None]).sum(1)
    equal -= torch.zeros_like(equal).scatter_add_(0, owner, (values == best[owner]).to(equal.dtype))
    counts.best[rows] = best.cpu().numpy()
    found = np.flatnonzero((values == best[owner]).cpu().numpy())
    first = found[np.unique(owner.cpu().numpy()[found], return_index=True)[1]]
    counts.best_index[rows] = entries[first]
    counts.outranking[rows] = (similarity > best[:, None]).sum(1).cpu().numpy()
    counts.ties[rows] = equal.cpu().numpy()
    _merge_top(counts, rows, similarity, 0)


def pool_rows(
    similarity: torch.Tensor, offset: int, first_column: int, places: Places, orders: np.ndarray, counts: Counts
) -> None:
    """Do as :func:`artifact.ranking.counting.pool_rows`, with tensors on any device."""
    rows = slice(offset, offset + similarity.shape[0])
    columns = slice(first_column, first_column + similarity.shape[1])
    here, there = (torch.from_numpy(p).to(similarity.device) for p in (places.queries[rows], places.pool[columns]))
    placed = torch.from_numpy(orders[columns]).to(similarity.device)
    best = torch.from_numpy(counts.best[rows]).to(similarity.device)[:, None]
    squared = torch.zeros(similarity.shape, dtype=torch.float64, device=similarity.device)
    for axis in range(here.shape[1]):
        difference = here[:, axis, None] - there[None, :, axis]
        squared += difference * difference
    distance = squared.sqrt_()
    allowed = distance > places.threshold
    outranks = allowed & (similarity > best)
    counts.outranking[rows] += outranks.sum(1).cpu().numpy()
    counts.ties[rows] += (allowed & (similarity == best)).sum(1).cpu().numpy()
    depth = min(counts.farthest.shape[1], similarity.shape[1])
    found = distance.masked_fill_(~outranks, -torch.inf).topk(depth, dim=1).values.cpu().numpy()
    merged = np.concatenate([counts.farthest[rows], found], axis=1)
    counts.farthest[rows] = -np.sort(-merged, axis=1)[:, : counts.farthest.shape[1]]
    for draw in range(counts.first.shape[2]):
        drawn = placed[:, draw].expand_as(similarity).masked_fill(~outranks, np.iinfo(np.int32).max)
        found = drawn.topk(depth, dim=1, largest=False).values.cpu().numpy()
        merged = np.concatenate([counts.first[rows, :, draw], found], axis=1)
        counts.first[rows, :, draw] = np.sort(merged, axis=1)[:, : counts.first.shape[1]]
    _merge_top(counts, rows, similarity.masked_fill(~allowed, -torch.inf), first_column)


def _merge_top(counts: Counts, rows: slice, similarity: torch.Tensor, first_column: int) -> None:
    """Merge the most similar columns of a tile into the running list; earlier columns win ties."""
    top = counts.top_similarity.shape[1]
    if not top:
        return
    found, places = torch.sort(similarity, dim=1, descending=True, stable=True)
    values = np.concatenate([counts.top_similarity[rows], found[:, :top].cpu().numpy()], axis=1)
    columns = np.concatenate([counts.top_index[rows], places[:, :top].cpu().numpy() + first_column], axis=1)
    order = np.argsort(-values, axis=1, kind="stable")[:, :top]
    counts.top_similarity[rows] = np.take_along_axis(values, order, axis=1)
    counts.top_index[rows] = np.where(
        np.isneginf(counts.top_similarity[rows]), -1, np.take_along_axis(columns, order, axis=1)
    )
