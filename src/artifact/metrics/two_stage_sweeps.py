"""Two-stage methods with some of the distractors: every number in nested random draws, every minimum distance.

A sweep adds a query's distractors one by one in the order of a key: their place in a random order, or their distance,
farthest first. The rank of the best positive changes a few times on the way; those steps are kept, so that any ratio,
distance and K can be asked for afterwards. Unlike for one-stage methods the rank may fall as well as rise.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numba import njit

from artifact.ranking.candidates import DISTRACTOR, POSITIVE, Images, Problem, Scores, scored_entries
from artifact.ranking.one_pass import Options, draw_orders


@dataclass(frozen=True)
class Steps:
    """Ranks that change while distractors are added in order of a key: a step function for each row.

    Attributes
    ----------
    starts
        ``(rows + 1,)``; row ``i`` has the steps ``starts[i]`` to ``starts[i + 1]``, the first of which is the rank
        without distractors.
    keys, ranks
        From a distractor's key on (inclusive), the rank.
    """

    starts: np.ndarray
    keys: np.ndarray
    ranks: np.ndarray

    def below(self, limits: np.ndarray) -> np.ndarray:
        """Return ``(rows, len(limits))`` ranks with the distractors whose key is below each limit."""
        return _ranks_below(self.starts, self.keys, self.ranks, np.asarray(limits, np.float64))


@dataclass(frozen=True)
class Sweep:
    """Ranks of every query for every number of distractors, in nested random draws, and every minimum distance.

    Attributes
    ----------
    number
        Rows are queries × draws; the key is a distractor's place in the draw's random order.
    distance
        Rows are queries; the key is the negative distance of a distractor from the query.
    draws
        Number of draws.
    """

    number: Steps
    distance: Steps
    draws: int

    def arrays(self) -> dict[str, np.ndarray]:
        """Flatten into named arrays, for storage."""
        parts = {"number": self.number, "distance": self.distance}
        named = {f"{p}_{n}": getattr(s, n) for p, s in parts.items() for n in ("starts", "keys", "ranks")}
        return {**named, "draws": np.array(self.draws)}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, np.ndarray]) -> Sweep:
        """Rebuild from :meth:`arrays`."""
        parts = [Steps(*(arrays[f"{p}_{n}"] for n in ("starts", "keys", "ranks"))) for p in ("number", "distance")]
        return cls(*parts, int(arrays["draws"]))


def sweep(
    queries: Images,
    database: Images,
    threshold: float,
    scores: Scores,
    pool: Images | None = None,
    *,
    candidates: int = 100,
    draws: int = 10,
    seed: int = 0,
) -> Sweep:
    """Rank every query for every number and every minimum distance of the distractors of one pool.

    Parameters are those of :func:`artifact.metrics.two_stage.evaluate_two_stage`; ``pool`` is ``None`` for the evaluated queries.
    """
    check_numbers(candidates, draws)
    problem = Problem.of(queries, database, threshold, candidates)
    pool = problem.queries if pool is None else pool
    orders = draw_orders(len(pool), Options(draws=draws, seed=seed)).astype(np.float64)
    number, distance = _StepsBuilder(), _StepsBuilder()
    for _, found in scored_entries(problem, {"": pool}, scores, orders):
        kind, second, keys = found[""].kind, found[""].second, found[""].keys
        for draw in range(draws):
            number.add(*_steps(kind, second, keys[:, draw], problem.candidates))
        distance.add(*_steps(kind, second, keys[:, draws], problem.candidates))
    return Sweep(number.steps(), distance.steps(), draws)


def check_numbers(candidates: int, draws: int) -> None:
    """Raise ``ValueError`` if the number of candidates or of draws is below 1."""
    for name, value in (("candidates", candidates), ("draws", draws)):
        if value < 1:
            raise ValueError(f"{name} is {value}; allowed: whole numbers from 1")


class _StepsBuilder:
    def __init__(self) -> None:
        self._keys: list[np.ndarray] = []
        self._ranks: list[np.ndarray] = []

    def add(self, keys: np.ndarray, ranks: np.ndarray) -> None:
        self._keys.append(keys)
        self._ranks.append(ranks)

    def steps(self) -> Steps:
        starts = np.concatenate([[0], np.cumsum([len(keys) for keys in self._keys])])
        return Steps(starts, np.concatenate(self._keys), np.concatenate(self._ranks))


@njit(nogil=True, cache=True)
def rank_of_best(kind, second, against):
    """Rank of the best positive among candidates in first-stage order; 0 if there is none.

    Equal ones count when they stand before it, or all if ties go against the query.
    """
    best = -1
    for place in range(kind.size):
        if kind[place] == POSITIVE and (best < 0 or second[place] > second[best]):
            best = place
    if best < 0:
        return 0
    rank = 1
    for place in range(kind.size):
        if kind[place] != POSITIVE:
            equal = second[place] == second[best] and (against or place < best)
            rank += second[place] > second[best] or equal
    return rank


@njit(nogil=True, cache=True)
def _steps(kind, second, keys, n):
    """Add a query's distractors in order of their keys, and note the rank wherever it changes.

    The entries are in first-stage order. ``chosen`` holds the candidates of the moment, in that order: those that
    a new one pushes out never come back.
    """
    chosen, size = np.empty(n + 1, np.int64), 0
    for entry in range(kind.size):
        if kind[entry] != DISTRACTOR and size < n:
            chosen[size] = entry
            size += 1
    distractors = np.flatnonzero(kind == DISTRACTOR)
    distractors = distractors[np.argsort(keys[distractors], kind="mergesort")]
    at = np.empty(distractors.size + 1)
    ranks = np.empty(distractors.size + 1, np.int32)
    at[0], ranks[0], steps = -np.inf, rank_of_best(kind[chosen[:size]], second[chosen[:size]], False) or n + 1, 1
    for number in range(distractors.size):
        entry = distractors[number]
        slot = size
        while slot > 0 and chosen[slot - 1] > entry:
            chosen[slot] = chosen[slot - 1]
            slot -= 1
        chosen[slot] = entry
        size = min(size + 1, n)
        rank = rank_of_best(kind[chosen[:size]], second[chosen[:size]], False) or n + 1
        if rank != ranks[steps - 1]:
            at[steps], ranks[steps] = keys[entry], rank
            steps += 1
    return at[:steps], ranks[:steps]


@njit(nogil=True, cache=True)
def _ranks_below(starts, keys, ranks, limits):
    out = np.empty((starts.size - 1, limits.size), np.int32)
    for row in range(starts.size - 1):
        first = starts[row]
        for place in range(limits.size):
            out[row, place] = ranks[first + np.searchsorted(keys[first + 1 : starts[row + 1]], limits[place])]
    return out
