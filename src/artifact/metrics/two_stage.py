"""Two-stage methods: candidates of the augmented database by a first stage, ranked again by a second.

The first N images of a query's database by the first stage (SelaVPR: cosine of descriptors; SelaVPR++: Hamming distance of
hash codes) are ranked again (SelaVPR: mutual nearest local features; SelaVPR++: cosine of descriptors). So distractors push
database images out of the candidates, and compete with those that stay. One may even help, by pushing out a wrong image that
the second stage would have preferred: DAR can exceed R, and is reported as it is.

Ties favour the query: images equal in the first stage stand with the positives first, then database images and
distractors, each by index; images equal in the second stage keep their first-stage order.

A sweep adds a query's distractors one by one in the order of a key: their place in a random order, or their distance,
farthest first. The rank of the best positive changes a few times on the way, down as well as up; those steps are kept, so
that any ratio, distance and K can be asked for afterwards.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from artifact.metrics.result import QUERY_POOL, Result, Ties, is_integer
from artifact.ranking.candidates import DISTRACTOR, POSITIVE, Entries, Images, Problem, Scores, scored_entries
from artifact.ranking.one_pass import Options, draw_orders
from artifact.suppression.compiled import compiled

REVISION = 3  # raise when any rank changes: it is part of the key of stored rankings


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


@dataclass(frozen=True, kw_only=True)
class TwoStageEvaluation(Result):
    """The outcome of evaluating a two-stage method, for K up to N; see :class:`~artifact.metrics.result.Result`.

    There is the original view alone: suppression does not apply to codes and local features (paper, section IV).

    Attributes
    ----------
    candidates
        N, the number of first-stage candidates that are ranked again.
    database_ranks, augmented_ranks
        ``(2, n)`` ranks of the best positive in the database, and with each pool's distractors; the second row has all
        ties against the query, in both stages. N + 1 stands for every query without a positive among the candidates.
    lists
        By ``""`` for the database and by pool: indices ``(n, k)`` and scores ``(n, k)`` of the first k images.
    sweep_of
        Gives the sweep of a pool by its name; it needs scores of more pairs, and is computed on the first call.
    """

    candidates: int
    database_ranks: np.ndarray
    augmented_ranks: dict[str, np.ndarray]
    lists: dict[str, tuple[np.ndarray, np.ndarray]]
    sweep_of: Callable[[str], Sweep] = field(compare=False)

    def ranks(self, *, distractors: bool, ties: Ties = "for") -> np.ndarray:
        """Return ``(n,)`` int64 ranks of the best positive; N + 1 if no candidate is a positive."""
        found = self.augmented_ranks[self.pool_name] if distractors else self.database_ranks
        return found[int(ties == "against")]

    def dar_by_ratio(self, ratios: Sequence[float], k: int = 1) -> np.ndarray:
        """Return the mean of DAR@K over nested random draws: distractors act together, so there is no closed form."""
        return self.dar_by_ratio_draws(ratios, k).mean(axis=0)

    def dar_by_ratio_draws(self, ratios: Sequence[float], k: int = 1) -> np.ndarray:
        """Return DAR@K for nested random subsets of the pool, ``(draws, len(ratios))`` float64."""
        return self._hits_by_draw(ratios, k).mean(axis=0)

    def chances_by_ratio(self, ratios: Sequence[float], k: int = 1) -> np.ndarray:
        """Return the share of draws in which each query is a hit, ``(n, len(ratios))``."""
        return self._hits_by_draw(ratios, k).mean(axis=1)

    def _hits_by_draw(self, ratios: Sequence[float], k: int) -> np.ndarray:
        sizes, sweep = self._sizes(ratios), self.sweep_of(self.pool_name)
        ranks = sweep.number.below(sizes).reshape(self.n_queries, sweep.draws, len(sizes))
        return ranks <= self._checked_k(k)

    def hits_by_distance(self, distances: Sequence[float], k: int = 1) -> np.ndarray:
        """Return ``(n, len(distances))`` bool: each query's hits with the distractors beyond each distance."""
        return self.sweep_of(self.pool_name).distance.below(-self._limits(distances)) <= self._checked_k(k)

    def _lists(self, *, distractors: bool) -> tuple[np.ndarray, np.ndarray]:
        return self.lists[self.pool_name if distractors else ""]

    def arrays(self) -> dict[str, np.ndarray]:
        """Flatten into named arrays, for storage; sweeps are not among them."""
        numbers = np.array([self.n_listed, self.n_database, self.candidates])
        named = super().arrays() | {"numbers": numbers, "database_ranks": self.database_ranks}
        for number, name in enumerate(["", *self.pools]):
            named[f"indices_{number}"], named[f"scores_{number}"] = self.lists[name]
            if name:
                named[f"ranks_{number}"] = self.augmented_ranks[name]
        return named

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, np.ndarray], sweep_of: Callable[[str], Sweep]) -> TwoStageEvaluation:
        """Rebuild from :meth:`arrays`."""
        fields = cls.fields_of(arrays)
        names = ["", *fields["pool_positions"]]
        return cls(
            candidates=int(arrays["numbers"][2]),
            database_ranks=arrays["database_ranks"],
            augmented_ranks={name: arrays[f"ranks_{number}"] for number, name in enumerate(names) if name},
            lists={name: (arrays[f"indices_{n}"], arrays[f"scores_{n}"]) for n, name in enumerate(names)},
            sweep_of=sweep_of,
            **fields,
        )

    def _checked_k(self, k: int) -> int:
        if not is_integer(k) or not 1 <= k <= self.candidates:
            raise ValueError(f"k is {k!r}; allowed: whole numbers from 1 to the {self.candidates} candidates")
        return int(k)


def evaluate_two_stage(
    queries: Images,
    database: Images,
    threshold: float,
    scores: Scores,
    pools: Mapping[str, Images | None] | None = None,
    *,
    candidates: int = 100,
    retrieve: int = 0,
    draws: int = 10,
    seed: int = 0,
    rows: slice | None = None,
) -> TwoStageEvaluation:
    """Evaluate a two-stage method with and without distractors.

    Parameters
    ----------
    queries, database, threshold
        The images with what both stages know of them; the threshold as in :func:`artifact.evaluate`.
    scores
        The second stage: :func:`artifact.ranking.matching.cosines` or a
        :class:`artifact.ranking.matching.LocalMatcher`.
    pools
        Distractor pools by name; ``None`` takes the evaluated queries themselves, as does a pool that is ``None``.
    candidates, retrieve
        N, how many images of the augmented database are ranked again; length of the stored lists, at most N.
    draws, seed
        Number of nested random draws of the number sweep, and their seed: the same draws as of one-stage methods.
    rows
        Rank only these of the evaluated queries, from a row up to another; :func:`joined` puts parts together. Distractors
        are the same.

    Raises
    ------
    ValueError
        If ``candidates``, ``draws`` or ``retrieve`` are not allowed, or no query has a positive.
    """
    _check_numbers(candidates, draws)
    if not 0 <= retrieve <= candidates:
        raise ValueError(f"retrieve is {retrieve}; allowed: whole numbers from 0 to the {candidates} candidates")
    problem = Problem.of(queries, database, threshold, candidates)
    named = {name: problem.queries if p is None else p for name, p in (pools or {QUERY_POOL: None}).items()}
    problem = problem if rows is None else problem.part(rows)
    n = len(problem.queries)
    ranks = {name: np.empty((2, n), np.int64) for name in ("", *named)}
    shape = n, retrieve
    lists = {name: (np.full(shape, -1, np.int64), np.full(shape, -np.inf, np.float32)) for name in ranks}
    for query, found in scored_entries(problem, {"": None, **named}, scores):
        for name, entries in found.items():
            ranks[name][:, query] = [_rank(entries, candidates, ties) for ties in ("for", "against")]
            _fill_list(lists[name], query, entries, candidates, len(database))

    @functools.cache
    def sweep_of(name: str) -> Sweep:
        what = queries, database, threshold, scores, named[name]
        return sweep(*what, candidates=candidates, draws=draws, seed=seed, rows=rows)

    return TwoStageEvaluation(
        evaluated=problem.evaluated,
        n_listed=len(queries),
        query_positions=problem.queries.positions,
        database_positions=database.positions,
        pool_positions={name: pool.positions for name, pool in named.items()},
        threshold=threshold,
        pool_name=next(iter(named)),
        candidates=candidates,
        database_ranks=ranks.pop(""),
        augmented_ranks=ranks,
        lists=lists,
        sweep_of=sweep_of,
    )


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

    Parameters are those of :func:`evaluate_two_stage`; without a pool, the queries.
    """
    _check_numbers(candidates, draws)
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
    """Return the arrays of a whole evaluation or sweep from those of its parts, in order of their queries."""

    def of(name: str) -> np.ndarray:
        arrays = [part[name] for part in parts]
        if name.endswith("_starts"):
            return np.concatenate([[0], np.cumsum(np.concatenate([np.diff(starts) for starts in arrays]))])
        if name == "database_ranks" or name.startswith("ranks_"):
            return np.concatenate(arrays, axis=1)
        per_query = "evaluated", "query_positions"
        if name in per_query or name.startswith(("indices_", "scores_")) or name.endswith(("_keys", "_ranks")):
            return np.concatenate(arrays)
        return arrays[0]

    return {name: of(name) for name in parts[0]}


def _check_numbers(candidates: int, draws: int) -> None:
    for name, value in (("candidates", candidates), ("draws", draws)):
        if value < 1:
            raise ValueError(f"{name} is {value}; allowed: whole numbers from 1")


def _rank(entries: Entries, n: int, ties: Ties) -> int:
    if ties == "against":
        last = np.where(entries.kind == POSITIVE, DISTRACTOR + 1, entries.kind)
        order = np.lexsort((entries.image, last, -entries.first))[:n]
        return _rank_of_best(entries.kind[order], entries.second[order], True) or n + 1
    return _rank_of_best(entries.kind[:n], entries.second[:n], False) or n + 1


def _fill_list(target: tuple[np.ndarray, np.ndarray], query: int, entries: Entries, n: int, n_database: int) -> None:
    order = np.argsort(-entries.second[:n], kind="stable")[: target[0].shape[1]]
    shift = np.where(entries.kind[order] == DISTRACTOR, n_database, 0)
    target[0][query, : len(order)] = entries.image[order] + shift
    target[1][query, : len(order)] = entries.second[order]


@compiled()
def _rank_of_best(kind: np.ndarray, second: np.ndarray, against: bool) -> int:
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
    at[0], ranks[0], steps = -np.inf, _rank_of_best(kind[chosen[:size]], second[chosen[:size]], False) or n + 1, 1
    for number in range(distractors.size):
        entry = distractors[number]
        slot = size
        while slot > 0 and chosen[slot - 1] > entry:
            chosen[slot] = chosen[slot - 1]
            slot -= 1
        chosen[slot] = entry
        size = min(size + 1, n)
        rank = _rank_of_best(kind[chosen[:size]], second[chosen[:size]], False) or n + 1
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
