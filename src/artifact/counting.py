"""Counting in one tile of similarities: how many database images and distractors beat the best positive.

Counting replaces sorting: a query is a hit at K exactly when fewer than K images beat its best positive. The
kernels below read each similarity once. They are compiled by Numba for the CPU and written again in PyTorch for
other devices; the tests hold both against a literal sort.

A similarity is ``(tile - correction) * scale + bias``, with one scale and bias per column, so that cosine, dot
product and Euclidean distance, and low-rank transformed descriptors, all come from one plain matrix product.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numba import njit

_CHUNK = 64  # columns that are tested together before any of them is looked at alone


@dataclass
class Counts:
    """Running per-query counts of one view and one distractor pool; the arrays grow tile by tile.

    Attributes
    ----------
    best
        ``(n,)`` float32, similarity of the best positive.
    beaters, ties
        ``(n,)`` int64, images strictly above ``best`` and, among the others that are not positives, equal to it.
    farthest
        ``(n, depth)`` float64, distances of the farthest beaters, descending; ``-inf`` where there are fewer.
    first
        ``(n, depth, draws)`` int32, smallest places of the beaters in each random order, ascending; the largest
        int32 where there are fewer.
    top_similarity, top_index
        ``(n, k)`` the most similar images, descending; ``-inf`` and -1 where there are fewer.
    """

    best: np.ndarray
    beaters: np.ndarray
    ties: np.ndarray
    farthest: np.ndarray
    first: np.ndarray
    top_similarity: np.ndarray
    top_index: np.ndarray

    @classmethod
    def empty(cls, n: int, depth: int, draws: int, top: int) -> Counts:
        """Return counts of nothing for ``n`` queries."""
        return cls(
            best=np.full(n, -np.inf, np.float32),
            beaters=np.zeros(n, np.int64),
            ties=np.zeros(n, np.int64),
            farthest=np.full((n, depth), -np.inf),
            first=np.full((n, depth, draws), np.iinfo(np.int32).max, np.int32),
            top_similarity=np.full((n, top), -np.inf, np.float32),
            top_index=np.full((n, top), -1, np.int64),
        )


# -- CPU ----------------------------------------------------------------------------------------------------


@njit(nogil=True, cache=True)
def _insert_descending(values, labels, value, label):
    """Put a value into a descending list that is full; the last falls out, equal values keep their order."""
    slot = values.size - 1
    while slot > 0 and values[slot - 1] < value:
        values[slot] = values[slot - 1]
        labels[slot] = labels[slot - 1]
        slot -= 1
    values[slot] = value
    labels[slot] = label


@njit(nogil=True, cache=True)
def _insert_distance(values, value):
    slot = values.size - 1
    while slot > 0 and values[slot - 1] < value:
        values[slot] = values[slot - 1]
        slot -= 1
    values[slot] = value


@njit(nogil=True, cache=True)
def _insert_places(first, places):
    """Put an image's place in each random order into that order's ascending list, where it is small enough."""
    last = first.shape[0] - 1
    early = 0
    for draw in range(places.size):
        early += places[draw] < first[last, draw]
    if early == 0:
        return
    for draw in range(places.size):
        if places[draw] < first[last, draw]:
            slot = last
            while slot > 0 and first[slot - 1, draw] > places[draw]:
                first[slot, draw] = first[slot - 1, draw]
                slot -= 1
            first[slot, draw] = places[draw]


@njit(nogil=True, cache=True)
def database_rows(
    tile, correction, scale, bias, starts, positives, offset, best, beaters, ties, top_similarity, top_index
):  # fmt: skip
    """Find the best positive of each row and count the columns above it and level with it.

    ``tile`` holds every database image of its rows. ``positives[starts[i]:starts[i + 1]]`` are the positives of
    query ``i``; row ``r`` is query ``offset + r``.
    """
    columns = tile.shape[1]
    similarity = np.empty(columns, np.float32)
    corrected = correction.shape[0] > 0
    top = top_similarity.shape[1]
    for row in range(tile.shape[0]):
        if corrected:
            for column in range(columns):
                similarity[column] = (tile[row, column] - correction[row, column]) * scale[column] + bias[
                    column
                ]
        else:
            for column in range(columns):
                similarity[column] = tile[row, column] * scale[column] + bias[column]
        query = offset + row
        level = np.float32(-np.inf)
        for entry in range(starts[query], starts[query + 1]):
            level = max(level, similarity[positives[entry]])
        above, equal = 0, 0
        for column in range(columns):
            above += similarity[column] > level
            equal += similarity[column] == level
        for entry in range(starts[query], starts[query + 1]):
            equal -= similarity[positives[entry]] == level
        best[query], beaters[query], ties[query] = level, above, equal
        if top:
            for column in range(columns):
                if similarity[column] > top_similarity[query, top - 1]:
                    _insert_descending(top_similarity[query], top_index[query], similarity[column], column)


@njit(nogil=True, cache=True)
def pool_rows(
    tile, correction, scale, bias, offset, first_column, positions, pool_positions, threshold, orders,
    best, beaters, ties, farthest, first, top_similarity, top_index,
):  # fmt: skip
    """Count the allowed distractors of a tile that beat, or are level with, each row's best positive.

    Row ``r`` is query ``offset + r``, column ``c`` is pool image ``first_column + c``. An image is allowed when
    it is farther than ``threshold`` from the query. ``orders`` is ``(pool, draws)``: the place of each pool image
    in each random order.
    """
    columns = tile.shape[1]
    similarity = np.empty(columns, np.float32)
    corrected = correction.shape[0] > 0
    top = top_similarity.shape[1]
    depth = farthest.shape[1]
    for row in range(tile.shape[0]):
        query = offset + row
        level = best[query]
        floor = min(level, top_similarity[query, top - 1]) if top else level
        if corrected:
            for column in range(columns):
                similarity[column] = (tile[row, column] - correction[row, column]) * scale[column] + bias[
                    column
                ]
        else:
            for column in range(columns):
                similarity[column] = tile[row, column] * scale[column] + bias[column]
        for begin in range(0, columns, _CHUNK):
            end = min(begin + _CHUNK, columns)
            reached = 0
            for column in range(begin, end):
                reached += similarity[column] >= floor
            if reached == 0:
                continue
            for column in range(begin, end):
                value = similarity[column]
                if value < floor:
                    continue
                image = first_column + column
                squared = 0.0
                for axis in range(positions.shape[1]):
                    difference = positions[query, axis] - pool_positions[image, axis]
                    squared += difference * difference
                distance = np.sqrt(squared)
                if distance <= threshold:
                    continue
                if value == level:
                    ties[query] += 1
                elif value > level:
                    beaters[query] += 1
                    if distance > farthest[query, depth - 1]:
                        _insert_distance(farthest[query], distance)
                    _insert_places(first[query], orders[image])
                if top and value > top_similarity[query, top - 1]:
                    _insert_descending(top_similarity[query], top_index[query], value, image)
                    floor = min(level, top_similarity[query, top - 1])


# -- other devices ------------------------------------------------------------------------------------------


def database_rows_torch(tile, scale, bias, starts, positives, offset, counts: Counts) -> None:
    """Do as :func:`database_rows`, with tensors on any device. ``tile`` is already corrected."""
    rows = slice(offset, offset + tile.shape[0])
    similarity = tile * scale + bias
    entries = positives[starts[offset] : starts[offset + tile.shape[0]]]
    lengths = np.diff(starts[offset : offset + tile.shape[0] + 1])
    owner = torch.from_numpy(np.repeat(np.arange(tile.shape[0]), lengths)).to(tile.device)
    values = similarity[owner, torch.from_numpy(entries).to(tile.device)]
    level = torch.full((tile.shape[0],), -torch.inf, device=tile.device).scatter_reduce_(
        0, owner, values, "amax"
    )
    equal = (similarity == level[:, None]).sum(1)
    equal -= torch.zeros_like(equal).scatter_add_(0, owner, (values == level[owner]).to(equal.dtype))
    counts.best[rows] = level.cpu().numpy()
    counts.beaters[rows] = (similarity > level[:, None]).sum(1).cpu().numpy()
    counts.ties[rows] = equal.cpu().numpy()
    _merge_top(counts, rows, similarity, 0)


def pool_rows_torch(
    tile, scale, bias, offset, first_column, positions, pool_positions, threshold, orders, counts: Counts
) -> None:  # fmt: skip
    """Do as :func:`pool_rows`, with tensors on any device. ``tile`` is already corrected."""
    rows = slice(offset, offset + tile.shape[0])
    columns = slice(first_column, first_column + tile.shape[1])
    similarity = tile * scale + bias
    level = torch.from_numpy(counts.best[rows]).to(tile.device)[:, None]
    squared = torch.zeros(tile.shape, dtype=torch.float64, device=tile.device)
    for axis in range(positions.shape[1]):
        difference = positions[rows, axis, None] - pool_positions[None, columns, axis]
        squared += difference * difference
    distance = squared.sqrt_()
    allowed = distance > threshold
    beats = allowed & (similarity > level)
    counts.beaters[rows] += beats.sum(1).cpu().numpy()
    counts.ties[rows] += (allowed & (similarity == level)).sum(1).cpu().numpy()
    depth = min(counts.farthest.shape[1], tile.shape[1])
    found = distance.masked_fill_(~beats, -torch.inf).topk(depth, dim=1).values.cpu().numpy()
    merged = np.concatenate([counts.farthest[rows], found], axis=1)
    counts.farthest[rows] = -np.sort(-merged, axis=1)[:, : counts.farthest.shape[1]]
    for draw in range(counts.first.shape[2]):
        places = orders[columns, draw].expand_as(tile).masked_fill(~beats, np.iinfo(np.int32).max)
        found = places.topk(depth, dim=1, largest=False).values.cpu().numpy()
        merged = np.concatenate([counts.first[rows, :, draw], found], axis=1)
        counts.first[rows, :, draw] = np.sort(merged, axis=1)[:, : counts.first.shape[1]]
    _merge_top(counts, rows, similarity.masked_fill(~allowed, -torch.inf), first_column)


def _merge_top(counts: Counts, rows: slice, similarity: torch.Tensor, first_column: int) -> None:
    """Merge the most similar columns of a tile into the running list; earlier columns win ties."""
    top = counts.top_similarity.shape[1]
    if not top:
        return
    values, columns = torch.sort(similarity, dim=1, descending=True, stable=True)
    values, columns = values[:, :top].cpu().numpy(), columns[:, :top].cpu().numpy() + first_column
    values = np.concatenate([counts.top_similarity[rows], values], axis=1)
    columns = np.concatenate([counts.top_index[rows], columns], axis=1)
    order = np.argsort(-values, axis=1, kind="stable")[:, :top]
    counts.top_similarity[rows] = np.take_along_axis(values, order, axis=1)
    counts.top_index[rows] = np.where(
        np.isneginf(counts.top_similarity[rows]), -1, np.take_along_axis(columns, order, axis=1)
    )
