"""Two-stage methods with some of the distractors: every number in nested random draws, every minimum distance.

A sweep adds a query's distractors one by one in the order of a key: their place in a random order, or their distance,
farthest first. The rank of the best positive changes a few times on the way; those steps are kept, so that any ratio,
distance and K can be asked for afterwards. Unlike for one-stage methods the rank may fall as well as rise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from artifact.ranking.candidates import DISTRACTOR, POSITIVE, Images, Problem, Scores, scored_entries
from artifact.ranking.compiled import compiled
from artifact.ranking.one_pass import Options, draw_orders


class Steps(NamedTuple):
    """Ranks that change while distractors are added in order of a key: a step function for each row.

    Row ``i`` has the steps from ``starts[i]`` up to ``starts[i + 1]``: from a distractor's key on (inclusive), the
    rank; the first is the rank without distractors.
    """

    starts: np.ndarray
    keys: np.ndarray
    ranks: np.ndarray

    @classmethod
    def joined(cls, rows: Sequence[tuple[np.ndarray, np.ndarray]]) -> Steps:
        """Join the keys and ranks of all rows."""
        keys, ranks = zip(*rows, strict=True)
        return cls(np.concatenate([[0], np.cumsum([len(one) for one in keys])]), *map(np.concatenate, (keys, ranks)))

    def below(self, limits: np.ndarray) -> np.ndarray:
        """Return ``(rows, len(limits))`` ranks with the distractors whose key is below each limit."""
        ranks: np.ndarray = _ranks_below(self.starts, self.keys, self.ranks, np.asarray(limits, np.float64))
        return ranks


class Sweep(NamedTuple):
    """Ranks of every query for every number of distractors, in nested random draws, and every minimum distance.

    Rows of ``number`` are queries × draws; the key is a distractor's place in the draw's random order. Rows of
    ``distance`` are queries; the key is the negative distance of a distractor from the query.
    """

    number: Steps
    distance: Steps
    draws: int

    def arrays(self) -> dict[str, np.ndarray]:
        """Flatten into named arrays, for storage."""
        named = {f"number_{name}": array for name, array in self.number._asdict().items()}
        named |= {f"distance_{name}": array for name, array in self.distance._asdict().items()}
        return named | {"draws": np.array(self.draws)}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, np.ndarray]) -> Sweep:
        """Rebuild from :meth:`arrays`."""
        number, distance = (Steps(*(arrays[f"{by}_{n}"] for n in Steps._fields)) for by in ("number", "distance"))
        return cls(number, distance, int(arrays["draws"]))


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
    rows: slice | None = None,
) -> Sweep:
    """Rank every query for every number and every minimum distance of the distractors of one pool.

    Parameters are those of :func:`artifact.metrics.two_stage.evaluate_two_stage`; without a pool, the queries.
    """
    check_numbers(candidates, draws)
    problem = Problem.of(queries, database, threshold, candidates)
    pool = problem.queries if pool is None else pool
    orders = draw_orders(len(pool), Options(draws=draws, seed=seed)).astype(np.float64)
    problem = problem if rows is None else problem.part(rows)
    number, distance = [], []
    for _, found in scored_entries(problem, {"": pool}, scores, orders):
        kind, second, keys = found[""].kind, found[""].second, found[""].keys
        number += [_steps(kind, second, keys[:, draw], candidates) for draw in range(draws)]
        distance.append(_steps(kind, second, keys[:, draws], candidates))
    return Sweep(Steps.joined(number), Steps.joined(distance), draws)


def joined(parts: Sequence[Mapping[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Return the arrays of a whole sweep from those of its parts, in order of their queries."""
    names = [name for name in parts[0] if name.endswith(("_keys", "_ranks"))]
    whole = {name: np.concatenate([part[name] for part in parts]) for name in names}
    for name in ("number_starts", "distance_starts"):
        steps = np.concatenate([np.diff(part[name]) for part in parts])
        whole[name] = np.concatenate([[0], np.cumsum(steps)])
    return whole | {"draws": parts[0]["draws"]}


def check_numbers(candidates: int, draws: int) -> None:
    """Raise ``ValueError`` if the number of candidates or of draws is below 1."""
    for name, value in (("candidates", candidates), ("draws", draws)):
        if value < 1:
            raise ValueError(f"{name} is {value}; allowed: whole numbers from 1")


@compiled()
def rank_of_best(kind: np.ndarray, second: np.ndarray, against: bool) -> int:
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


@compiled()
def _steps(kind: np.ndarray, second: np.ndarray, keys: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Add a query's distractors in order of their keys, and note the rank wherever it changes."""
    # The candidates of the moment, in first-stage order as the entries: those pushed out never come back.
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


@compiled()
def _ranks_below(starts: np.ndarray, keys: np.ndarray, ranks: np.ndarray, limits: np.ndarray) -> np.ndarray:
    out = np.empty((starts.size - 1, limits.size), np.int32)
    for row in range(starts.size - 1):
        first = starts[row]
        for place in range(limits.size):
            out[row, place] = ranks[first + np.searchsorted(keys[first + 1 : starts[row + 1]], limits[place])]
    return out
