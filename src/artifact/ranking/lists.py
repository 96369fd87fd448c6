"""Retrieval lists: the most similar images of each query, in the order of the exact similarities."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from artifact.ranking.counting import Lens
from artifact.ranking.similarity import Looks

SPARE = 16  # images that are kept beyond twice the length of a list


@dataclass(frozen=True)
class Listed:
    """The images of one set that seem most similar at the first look: ``(n, m)`` levels, descending, and indices.

    ``allowed`` returns all images that a query may use; ``shift`` is added to their indices.
    """

    level: np.ndarray
    index: np.ndarray
    lens: Lens
    looks: Looks
    allowed: Callable[[int], np.ndarray]
    shift: int

    def margin(self) -> np.ndarray:
        """Return how far the level of an image of each query can be from the true one, ``(n,)``."""
        scale, reach = self.lens.scale.astype(np.float64), self.lens.image_reach.astype(np.float64)
        relative = np.divide(reach, scale, out=np.full(len(scale), np.inf), where=scale > 0)
        return self.lens.query_reach.astype(np.float64) * relative.max(initial=0.0)

    def candidates(self, floor: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return pairs of queries and images among which all are whose level reaches a floor."""
        incomplete = ~(self.level[:, -1] < floor) & (self.index[:, -1] >= 0) | ~np.isfinite(self.margin())
        kept = ~(self.level < floor[:, None]) & (self.index >= 0) & ~incomplete[:, None]
        queries, images = [np.nonzero(kept)[0]], [self.index[kept]]
        for query in np.flatnonzero(incomplete):
            images.append(self.allowed(int(query)))
            queries.append(np.full(len(images[-1]), query))
        return np.concatenate(queries), np.concatenate(images)


def top_lists(n: int, k: int, sets: list[Listed]) -> tuple[np.ndarray, np.ndarray]:
    """Return ``(n, k)`` float32 similarities and int64 indices; equal ones by index, ``-inf`` and -1 where none is left."""
    parts = []
    levels = np.concatenate([one.level for one in sets], axis=1)
    seen = np.sort(levels, axis=1)[:, -k].astype(np.float64)
    seen[~np.isfinite(seen)] = -np.inf
    floor = seen - 2 * np.max([one.margin() for one in sets], axis=0)
    for which, one in enumerate(sets):
        i, j = one.candidates(floor)
        identity = one.looks.identities(j)
        pair = i * (identity.max(initial=0) + 1) + identity
        _, first, inverse = np.unique(pair, return_index=True, return_inverse=True)
        level, doubt = one.looks.levels(i[first], j[first])
        parts.append((i, level[inverse], doubt[inverse], identity, j + one.shift, np.full(len(i), which)))
    query, level, doubt, identity, index, number = (np.concatenate(column) for column in zip(*parts, strict=True))
    order = np.lexsort((index, -level, query))
    _resorted(order, query, level, doubt, identity, index, number, sets)
    starts = np.searchsorted(query[order], np.arange(n))
    place = np.arange(len(order)) - starts[query[order]]
    order, place = order[place < k], place[place < k]
    similarities, indices = np.full((n, k), -np.inf, np.float32), np.full((n, k), -1, np.int64)
    indices[query[order], place] = index[order]
    for which, one in enumerate(sets):
        some = number[order] == which
        pairs = order[some]
        value = one.looks.rounded(query[pairs], index[pairs] - one.shift, level[pairs], doubt[pairs])
        similarities[query[pairs], place[some]] = value
    return similarities, indices


def _resorted(
    order: np.ndarray,
    query: np.ndarray,
    level: np.ndarray,
    doubt: np.ndarray,
    identity: np.ndarray,
    index: np.ndarray,
    number: np.ndarray,
    sets: list[Listed],
) -> None:
    """Sort the lists of those queries exactly whose images float64 cannot tell apart."""
    if not len(order):
        return
    starts = np.flatnonzero(np.r_[True, query[order][1:] != query[order][:-1]])
    ends = np.r_[starts[1:], len(order)]
    worst = np.repeat(np.maximum.reduceat(doubt[order], starts), ends - starts)
    before, after = order[:-1], order[1:]
    near = (query[before] == query[after]) & (identity[before] != identity[after])
    near &= ~(level[before] - level[after] > 2 * worst[:-1])
    for list_number in np.unique(np.searchsorted(starts, np.flatnonzero(near), side="right") - 1):
        mine = order[starts[list_number] : ends[list_number]]
        exact: dict[Any, Fraction] = {}
        for entry in mine.tolist():
            if identity[entry] not in exact:
                one = sets[number[entry]]
                exact[identity[entry]] = one.looks.exact(int(query[entry]), int(index[entry]) - one.shift)
        order[starts[list_number] : ends[list_number]] = sorted(mine, key=lambda e: (-exact[identity[e]], index[e]))
