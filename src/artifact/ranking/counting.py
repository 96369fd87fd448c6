"""Counting in one tile of the first look: which images outrank the best positive, and which must be looked at again.

Counting replaces sorting: a query is a hit at K exactly when fewer than K images outrank its best positive. The kernels
are compiled by Numba for the CPU and written again in PyTorch for other devices. With the level ``t`` of a query's best
positive, an image outranks it when its inner product is above ``t * scale + bias``, with one scale and bias per image:
``(|c|, 0)`` for cosine, ``(1, 0)`` for dot, ``(1, |c|² / 2)`` for l2. Within ``reach_q * reach_c`` of that the tile
cannot tell: such pairs are returned for :mod:`artifact.ranking.similarity` to decide.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from artifact.suppression.compiled import compiled

_TOGETHER = 32  # columns whose largest level is known
_CHUNK, _FEW = 128, 16  # columns that are tested together before any of them is looked at alone
_ALMOST = 1 - 2.0**-50
_NONE: Any = np.int32(0)  # what narrow sums begin with


class Tile(NamedTuple):
    """Inner products of descriptors: row ``r`` is query ``first_row + r``, column ``c`` image ``first_column + c``."""

    values: Any
    first_row: int
    first_column: int


class Lens(NamedTuple):
    """How a view reads inner products of queries and one set of images, in float32.

    It subtracts ``left @ right``, of ``(queries, m)`` and ``(m, images)``, whose first ``shared`` parts are all that the
    lens before subtracts. ``scale``, ``bias``, ``image_reach`` and ``identity`` are per image, ``query_reach`` per query.
    """

    left: np.ndarray
    right: np.ndarray
    shared: int
    scale: np.ndarray
    bias: np.ndarray
    image_reach: np.ndarray
    query_reach: np.ndarray
    identity: np.ndarray


class Target(NamedTuple):
    """The best positives: their float32 levels, and their classes of equal rows."""

    level: np.ndarray
    identity: np.ndarray


class Groups(NamedTuple):
    """Images that belong to each query: those of query ``i`` are ``members[starts[i]:starts[i + 1]]``, ascending."""

    starts: np.ndarray
    members: np.ndarray


class Places(NamedTuple):
    """Positions of the queries and of a pool, whose images are allowed when farther apart than ``threshold``."""

    queries: np.ndarray
    pool: np.ndarray
    threshold: float


class Orders(NamedTuple):
    """Random orders of a pool: ``(pool, draws)`` int32 places of each image, and ``(pool,)`` the smallest of each."""

    place: np.ndarray
    earliest: np.ndarray


class Counts(NamedTuple):
    """Per-query counts of one view over the database or one distractor pool; the arrays grow tile by tile.

    Attributes
    ----------
    outranking, ties
        ``(n,)`` int64, images more similar than the best positive and, among those that are not positives, as similar.
    farthest
        ``(n, depth)`` float64, distances of the farthest outranking images, descending; ``-inf`` where there are fewer.
    first
        ``(n, depth, draws)`` int32, smallest places of the outranking images in each random order, ascending; the
        largest int32 where there are fewer.
    top_similarity, top_index
        ``(n, k)`` float32 and int64, the most similar images, descending, and first of equal ones the first; ``-inf`` and
        -1 where there are fewer. Of a pool: the most similar of database and pool, whose indices follow the database's.
    """

    outranking: np.ndarray
    ties: np.ndarray
    farthest: np.ndarray
    first: np.ndarray
    top_similarity: np.ndarray
    top_index: np.ndarray

    @classmethod
    def empty(cls, n: int, depth: int, draws: int) -> Counts:
        """Return counts of nothing for ``n`` queries, without lists."""
        return cls(
            outranking=np.zeros(n, np.int64),
            ties=np.zeros(n, np.int64),
            farthest=np.full((n, depth), -np.inf),
            first=np.full((n, depth, draws), np.iinfo(np.int32).max, np.int32),
            top_similarity=np.empty((n, 0), np.float32),
            top_index=np.empty((n, 0), np.int64),
        )


@compiled()
def near_best(
    values: np.ndarray, lens: Lens, positives: Groups, first_row: int, rows: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the pairs of queries and positives that may be the best, given the inner products of all positives."""
    starts, members = positives
    base = starts[first_row]
    level, error = np.empty(values.size), np.empty(values.size)
    queries, images, found = np.empty(values.size, np.int64), np.empty(values.size, np.int64), 0
    for query in range(first_row, first_row + rows):
        sure = -np.inf
        for entry in range(starts[query] - base, starts[query + 1] - base):
            image = members[base + entry]
            value = np.float64(values[entry])
            for part in range(lens.left.shape[1]):
                value -= np.float64(lens.left[query, part]) * np.float64(lens.right[part, image])
            reach = np.float64(lens.query_reach[query]) * np.float64(lens.image_reach[image])
            scale = np.float64(lens.scale[image])
            if scale > 0.0 and reach < np.inf and np.isfinite(value):
                level[entry], error[entry] = (value - lens.bias[image]) / scale, reach / scale
                sure = max(sure, level[entry] - error[entry])
            else:
                level[entry], error[entry] = 0.0, np.inf
        for entry in range(starts[query] - base, starts[query + 1] - base):
            if level[entry] + error[entry] >= sure:
                queries[found], images[found] = query, members[base + entry]
                found += 1
    return queries[:found], images[:found]


@compiled()
def show_rows(tile: Tile, lens: Lens, out: np.ndarray) -> None:
    """Write the inner products of a tile in a view, in place of those of the view before where they share parts."""
    right, first, end = lens.right, tile.first_column, tile.first_column + out.shape[1]
    for row in range(out.shape[0]):
        line, parts = out[row], lens.left[tile.first_row + row]
        if not lens.shared:  # else it is written over
            line[:] = tile.values[row]
        whole = lens.shared + (parts.size - lens.shared) // 4 * 4
        for part in range(lens.shared, whole, 4):
            a, b, c, d = parts[part], parts[part + 1], parts[part + 2], parts[part + 3]
            # One by one: only so is the compiler sure that neighbours lie side by side.
            p, q = right[part, first:end], right[part + 1, first:end]
            r, s = right[part + 2, first:end], right[part + 3, first:end]
            for column in range(line.size):
                line[column] -= (a * p[column] + b * q[column]) + (c * r[column] + d * s[column])
        for part in range(whole, parts.size):
            a, p = parts[part], right[part, first:end]
            for column in range(line.size):
                line[column] -= a * p[column]


@compiled()
def _surely(
    values: np.ndarray, scale: np.ndarray, bias: np.ndarray, reaches: np.ndarray, level: float, reach: float
) -> tuple[int, int]:
    """Count the images of a part of a row that are surely above and surely below a best positive."""
    above, below = _NONE, _NONE  # sums of slices, kept narrow: only so does the compiler use whole vectors
    for place in range(values.size):
        middle, width = level * scale[place] + bias[place], reach * reaches[place]
        above = np.int32(above + np.int32(values[place] > middle + width))
        below = np.int32(below + np.int32(values[place] < middle - width))
    return above, below


@compiled()
def count_rows(tile: Tile, lens: Lens, target: Target, groups: Groups, counts: Counts) -> np.ndarray:
    """Count the images of a tile that surely outrank the best positives; returns the ``(m, 2)`` pairs in doubt.

    ``groups`` are the images that do not count: positives, or what a query may not use of a pool. Everything is counted
    and those few are taken back, so that no distance is computed.
    """
    starts, members = groups
    rows, columns = tile.values.shape
    pairs, found = np.empty((64, 2), np.int64), 0
    scale, bias = lens.scale[tile.first_column :][:columns], lens.bias[tile.first_column :][:columns]
    reaches, identity = lens.image_reach[tile.first_column :][:columns], lens.identity[tile.first_column :][:columns]
    for row in range(rows):
        query = tile.first_row + row
        line = tile.values[row]
        level, reach, own = target.level[query], lens.query_reach[query], members[starts[query] : starts[query + 1]]
        total = 0
        for begin in range(0, columns, _CHUNK):
            some = slice(begin, min(begin + _CHUNK, columns))
            above, below = _surely(line[some], scale[some], bias[some], reaches[some], level, reach)
            total += above
            if above + below == some.stop - begin:
                continue
            for first in range(begin, some.stop, _FEW):
                few = slice(first, min(first + _FEW, some.stop))
                above, below = _surely(line[few], scale[few], bias[few], reaches[few], level, reach)
                if above + below == few.stop - first:
                    continue
                for column in range(first, few.stop):
                    middle, width = level * scale[column] + bias[column], reach * reaches[column]
                    if line[column] > middle + width or line[column] < middle - width:
                        continue
                    image = tile.first_column + column
                    place = np.searchsorted(own, image)
                    if place < own.size and own[place] == image:
                        continue
                    if identity[column] == target.identity[query]:
                        counts.ties[query] += 1
                        continue
                    if found == pairs.shape[0]:
                        larger = np.empty((2 * found, 2), np.int64)
                        larger[:found] = pairs
                        pairs = larger
                    pairs[found, 0], pairs[found, 1] = query, image
                    found += 1
        for entry in range(own.size):
            column = own[entry] - tile.first_column
            if 0 <= column < columns:
                width = reach * reaches[column]
                total -= line[column] > level * scale[column] + bias[column] + width
        counts.outranking[query] += total
    return pairs[:found]


@compiled()
def _squared_distances(here: np.ndarray, there: np.ndarray, out: np.ndarray) -> None:
    """Write the squared distances from one position to those of ``there``, ``(axes, n)``."""
    for place in range(out.size):
        out[place] = 0.0
    for axis in range(here.size):
        along = there[axis]
        for place in range(out.size):
            difference = here[axis] - along[place]
            out[place] += difference * difference


@compiled()
def _insert(apart: float, image: int, farthest: np.ndarray, first: np.ndarray, orders: np.ndarray) -> None:
    """Put an outranking image into the lists of its query: its distance, and its place in each random order."""
    # Every slot is written: a branch that cannot be foretold costs more.
    last = farthest.size - 1
    if apart > farthest[last]:
        for slot in range(farthest.size):
            there = farthest[slot]
            farthest[slot] = max(there, apart)
            apart = min(there, apart)
    for draw in range(orders.shape[1]):
        place = orders[image, draw]
        if place < first[last, draw]:
            for slot in range(farthest.size):
                before = first[slot, draw]
                first[slot, draw] = min(before, place)
                place = max(before, place)


@compiled()
def sweep_rows(tile: Tile, lens: Lens, target: Target, places: Places, orders: Orders, counts: Counts) -> None:
    """Put the allowed distractors of a tile that surely outrank the best positives into the lists behind both sweeps.

    The loops over a chunk have no branches; only a chunk that changes a list is looked at image by image.
    """
    positions, threshold = places.queries, places.threshold
    rows, columns = tile.values.shape
    squares, outranks = np.empty(_CHUNK), np.empty(_CHUNK, np.int32)
    there = np.ascontiguousarray(places.pool[tile.first_column :][:columns].T)
    last, draws = counts.farthest.shape[1] - 1, orders.place.shape[1]
    scale, bias = lens.scale[tile.first_column :][:columns], lens.bias[tile.first_column :][:columns]
    reaches, earliest = lens.image_reach[tile.first_column :][:columns], orders.earliest[tile.first_column :][:columns]
    for row in range(rows):
        query = tile.first_row + row
        line = tile.values[row]
        level, reach = target.level[query], lens.query_reach[query]
        farthest, first = counts.farthest[query], counts.first[query]
        for begin in range(0, columns, _CHUNK):
            end = min(begin + _CHUNK, columns)
            part, factor, shift, near = line[begin:end], scale[begin:end], bias[begin:end], reaches[begin:end]
            reached = _NONE
            for place in range(part.size):
                outranking = np.int32(part[place] > level * factor[place] + shift[place] + reach * near[place])
                outranks[place] = outranking
                reached = np.int32(reached + outranking)
            if reached == 0:
                continue
            squared, early = squares[: part.size], earliest[begin:end]
            _squared_distances(positions[query], there[:, begin:end], squared)
            latest = _NONE
            for draw in range(draws):
                latest = max(latest, first[last, draw])
            # A root rounds by less than these squares: whatever changes a list is among what they let pass.
            allowed, farther = _ALMOST * threshold**2, _ALMOST * max(threshold, farthest[last]) ** 2
            changing = _NONE
            for place in range(part.size):
                soon = np.int32(squared[place] >= allowed) & np.int32(early[place] < latest)
                outranks[place] &= np.int32(squared[place] >= farther) | soon
                changing = np.int32(changing + outranks[place])
            if changing:
                for place in range(part.size):
                    if outranks[place]:
                        apart = np.sqrt(squared[place])
                        if apart > threshold and (apart > farthest[last] or early[place] < latest):
                            _insert(apart, tile.first_column + begin + place, farthest, first, orders.place)


@compiled()
def sweep_pairs(pairs: np.ndarray, places: Places, orders: Orders, counts: Counts) -> None:
    """Put pairs that turned out to outrank the best positives into the lists behind both sweeps."""
    apart = np.empty(1)
    for pair in range(pairs.shape[0]):
        query, image = pairs[pair, 0], pairs[pair, 1]
        _squared_distances(places.queries[query], places.pool[image : image + 1].T, apart)
        _insert(np.sqrt(apart[0]), image, counts.farthest[query], counts.first[query], orders.place)


@compiled(error_model="numpy")
def _levels(line: np.ndarray, scale: np.ndarray, bias: np.ndarray, out: np.ndarray) -> None:
    """Write the levels of a row; of what is not a number as of nothing."""
    nothing = np.float32(-np.inf)
    for place in range(out.size):
        level = (line[place] - bias[place]) / scale[place]
        out[place] = level if level > nothing else nothing


@compiled(fastmath={"nnan", "nsz", "reassoc"})
def _largest(levels: np.ndarray, out: np.ndarray) -> None:
    """Write the largest of every few levels."""
    for number in range(out.size):
        largest = np.float32(-np.inf)
        some = levels[number * _TOGETHER : (number + 1) * _TOGETHER]
        for place in range(some.size):
            largest = max(largest, some[place])
        out[number] = largest


@compiled()
def top_rows(tile: Tile, lens: Lens, groups: Groups, similarity: np.ndarray, index: np.ndarray) -> None:
    """Merge the images of a tile that seem most similar into running lists ``(n, m)``; ``groups`` are left out."""
    starts, members = groups
    rows, columns = tile.values.shape
    m, nothing = similarity.shape[1], np.float32(-np.inf)
    scale, bias = lens.scale[tile.first_column :][:columns], lens.bias[tile.first_column :][:columns]
    levels, largest = np.empty(columns, np.float32), np.empty(-(-columns // _TOGETHER), np.float32)
    for row in range(rows):
        query = tile.first_row + row
        values, labels = similarity[query], index[query]
        _levels(tile.values[row], scale, bias, levels)
        for image in members[starts[query] : starts[query + 1]]:
            if 0 <= image - tile.first_column < columns:
                levels[image - tile.first_column] = nothing
        _largest(levels, largest)
        # As many images as the list is long are at least as similar as the last of as many largest ones.
        least = np.partition(largest, largest.size - m)[largest.size - m] if largest.size > m else nothing
        for number in range(largest.size):
            if largest[number] < least or largest[number] <= values[m - 1]:
                continue
            for column in range(number * _TOGETHER, min((number + 1) * _TOGETHER, columns)):
                value, slot = levels[column], m - 1
                if value < least or value <= values[slot]:
                    continue
                while slot > 0 and values[slot - 1] < value:
                    values[slot] = values[slot - 1]
                    labels[slot] = labels[slot - 1]
                    slot -= 1
                values[slot] = value
                labels[slot] = tile.first_column + column
