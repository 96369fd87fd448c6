"""Counting in one tile of similarities: how many database images and distractors outrank the best positive.

Counting replaces sorting: a query is a hit at K exactly when fewer than K images outrank its best positive. The kernels
are compiled by Numba for the CPU and written again in PyTorch for other devices. A similarity is
``(value - correction) * scale + bias`` with one scale and bias per column, so that all three kinds, also of low-rank
transformed descriptors, come from one plain matrix product.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

_CHUNK = 128  # columns that are tested together before any of them is looked at alone


class Tile(NamedTuple):
    """Rows and columns of a matrix of similarities ``(values - correction) * scale + bias``.

    Row ``r`` is query ``first_row + r``, column ``c`` is image ``first_column + c``. ``values`` and ``correction`` are
    arrays of the engine, and an empty correction changes nothing; ``scale`` and ``bias`` have one value per column.
    """

    values: Any
    correction: Any
    scale: np.ndarray
    bias: np.ndarray
    first_row: int
    first_column: int


class Groups(NamedTuple):
    """Images that belong to each query: those of query ``i`` are ``members[starts[i]:starts[i + 1]]``, ascending."""

    starts: np.ndarray
    members: np.ndarray


class Places(NamedTuple):
    """Positions of the queries and of a pool, whose images are allowed when farther apart than ``threshold``."""

    queries: np.ndarray
    pool: np.ndarray
    threshold: float


class Counts(NamedTuple):
    """Running per-query counts of one view and one distractor pool; the arrays grow tile by tile.

    Attributes
    ----------
    best, best_index
        ``(n,)`` float32 similarity, up to a factor of the query, and int64 database index of the best positive.
    outranking, ties
        ``(n,)`` int64, images strictly above ``best`` and, among the others that are not positives, equal to it.
    farthest
        ``(n, depth)`` float64, distances of the farthest outranking images, descending; ``-inf`` where there are fewer.
    first
        ``(n, depth, draws)`` int32, smallest places of the outranking images in each random order, ascending; the largest
        int32 where there are fewer.
    top_similarity, top_index
        ``(n, k)`` the most similar images, descending; ``-inf`` and -1 where there are fewer.
    """

    best: np.ndarray
    best_index: np.ndarray
    outranking: np.ndarray
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
            best_index=np.full(n, -1, np.int64),
            outranking=np.zeros(n, np.int64),
            ties=np.zeros(n, np.int64),
            farthest=np.full((n, depth), -np.inf),
            first=np.full((n, depth, draws), np.iinfo(np.int32).max, np.int32),
            top_similarity=np.full((n, top), -np.inf, np.float32),
            top_index=np.full((n, top), -1, np.int64),
        )


@njit(nogil=True, cache=True)
def _insert_descending(values: np.ndarray, labels: np.ndarray, value: float, label: int) -> None:
    """Put a value into a descending list that is full; the last falls out, equal values keep their order."""
    slot = values.size - 1
    while slot > 0 and values[slot - 1] < value:
        values[slot] = values[slot - 1]
        labels[slot] = labels[slot - 1]
        slot -= 1
    values[slot] = value
    labels[slot] = label


@njit(nogil=True, cache=True)
def _insert_distance(values: np.ndarray, value: float) -> None:
    slot = values.size - 1
    while slot > 0 and values[slot - 1] < value:
        values[slot] = values[slot - 1]
        slot -= 1
    values[slot] = value


@njit(nogil=True, cache=True)
def _insert_places(first: np.ndarray, places: np.ndarray) -> None:
    """Put an image's place in each random order into that order's ascending list, where it is small enough."""
    last = first.shape[0] - 1
    for draw in range(places.size):
        if places[draw] < first[last, draw]:
            slot = last
            while slot > 0 and first[slot - 1, draw] > places[draw]:
                first[slot, draw] = first[slot - 1, draw]
                slot -= 1
            first[slot, draw] = places[draw]


@njit(nogil=True, cache=True)
def _similarities(tile: Tile, row: int, out: np.ndarray) -> None:
    """Write the similarities of one tile row; an empty correction changes nothing."""
    values, scale, bias = tile.values[row], tile.scale, tile.bias
    if tile.correction.shape[0]:
        correction = tile.correction[row]
        for column in range(out.size):
            out[column] = (values[column] - correction[column]) * scale[column] + bias[column]
    else:
        for column in range(out.size):
            out[column] = values[column] * scale[column] + bias[column]


@njit(nogil=True, cache=True)
def _above_and_equal(similarity: np.ndarray, positive: np.floating) -> tuple[int, int]:
    above, equal = 0, 0
    for column in range(similarity.size):
        above += similarity[column] > positive
        equal += similarity[column] == positive
    return above, equal


@njit(nogil=True, cache=True)
def database_rows(tile: Tile, groups: Groups, counts: Counts) -> None:
    """Find the best positive of each row and count the columns above it and equal to it.

    The tile holds every database image of its rows; ``groups`` are the positives.
    """
    starts, positives = groups
    best, best_index, outranking, ties, _, _, top_similarity, top_index = counts
    rows, columns = tile.values.shape
    similarity = np.empty(columns, np.float32)
    top = top_similarity.shape[1]
    for row in range(rows):
        _similarities(tile, row, similarity)
        query = tile.first_row + row
        positive = np.float32(-np.inf)
        for entry in range(starts[query], starts[query + 1]):
            if similarity[positives[entry]] > positive:
                positive = similarity[positives[entry]]
                best_index[query] = positives[entry]
        above, equal = _above_and_equal(similarity, positive)
        for entry in range(starts[query], starts[query + 1]):
            equal -= similarity[positives[entry]] == positive
        best[query], outranking[query], ties[query] = positive, above, equal
        if top:
            for column in range(columns):
                if similarity[column] > top_similarity[query, top - 1]:
                    _insert_descending(top_similarity[query], top_index[query], similarity[column], column)


@njit(nogil=True, cache=True)
def pool_counts(tile: Tile, groups: Groups, counts: Counts) -> None:
    """Count as :func:`pool_rows`, without lists: for views whose sweeps nobody asked for.

    ``groups`` are the pool images that each query may not use: everything is counted and those few are taken back, so
    that no distance is computed.
    """
    starts, near = groups
    rows, columns = tile.values.shape
    similarity = np.empty(columns, np.float32)
    for row in range(rows):
        _similarities(tile, row, similarity)
        query = tile.first_row + row
        positive = counts.best[query]
        above, equal = _above_and_equal(similarity, positive)
        for entry in range(starts[query], starts[query + 1]):
            column = near[entry] - tile.first_column
            if 0 <= column < columns:
                above -= similarity[column] > positive
                equal -= similarity[column] == positive
        counts.outranking[query] += above
        counts.ties[query] += equal


@njit(nogil=True, cache=True)
def _distances(here: np.ndarray, pool_positions: np.ndarray, begin: int, out: np.ndarray) -> None:
    """Write the distances from one position to ``out.size`` pool images from ``begin`` on."""
    for place in range(out.size):
        out[place] = 0.0
    for axis in range(here.size):
        for place in range(out.size):
            difference = here[axis] - pool_positions[begin + place, axis]
            out[place] += difference * difference
    for place in range(out.size):
        out[place] = np.sqrt(out[place])


@njit(nogil=True, cache=True)
def pool_rows(tile: Tile, places: Places, orders: np.ndarray, earliest: np.ndarray, counts: Counts) -> None:
    """Count the allowed distractors of a tile that outrank, or are as similar as, each row's best positive.

    ``orders`` is ``(pool, draws)``: the place of each pool image in each random order, and ``earliest`` its smallest
    place. Columns go by in chunks: the loops over a chunk have no branches, and only a chunk that changes a list is
    looked at image by image.
    """
    positions, pool_positions, threshold = places
    best, _, outranking, ties, farthest, first, top_similarity, top_index = counts
    rows, columns = tile.values.shape
    similarity = np.empty(columns, np.float32)
    distance = np.empty(_CHUNK)
    top, depth, draws = top_similarity.shape[1], farthest.shape[1], first.shape[2]
    for row in range(rows):
        _similarities(tile, row, similarity)
        query = tile.first_row + row
        positive = best[query]
        floor = min(positive, top_similarity[query, top - 1]) if top else positive
        reached = 0
        for column in range(columns):
            reached += similarity[column] >= floor
        if reached == 0:
            continue
        for begin in range(0, columns, _CHUNK):
            values = similarity[begin : begin + _CHUNK]
            reached = 0
            for place in range(values.size):
                reached += values[place] >= floor
            if reached == 0:
                continue
            apart = distance[: values.size]
            image = tile.first_column + begin
            _distances(positions[query], pool_positions, image, apart)
            above, equal, farther, earlier, higher = 0, 0, 0, 0, 0
            limit = farthest[query, depth - 1]
            latest = first[query, depth - 1].max() if draws else 0
            shown = top_similarity[query, top - 1] if top else np.float32(np.inf)
            for place in range(values.size):
                allowed = apart[place] > threshold
                outranks = allowed & (values[place] > positive)
                above += outranks
                equal += allowed & (values[place] == positive)
                farther += outranks & (apart[place] > limit)
                earlier += outranks & (earliest[image + place] < latest)
                higher += allowed & (values[place] > shown)
            outranking[query] += above
            ties[query] += equal
            if farther:
                for place in range(values.size):
                    if values[place] > positive and apart[place] > max(threshold, farthest[query, depth - 1]):
                        _insert_distance(farthest[query], apart[place])
            if earlier:
                for place in range(values.size):
                    if values[place] > positive and apart[place] > threshold and earliest[image + place] < latest:
                        _insert_places(first[query], orders[image + place])
            if higher:
                for place in range(values.size):
                    if apart[place] > threshold and values[place] > top_similarity[query, top - 1]:
                        _insert_descending(top_similarity[query], top_index[query], values[place], image + place)
                floor = min(positive, top_similarity[query, top - 1])
