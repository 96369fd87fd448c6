"""First-stage candidates of every query, and with them all images that distractors could make candidates.

A two-stage method ranks again the first N images of a query's augmented database by its first stage. Which those are
depends on the distractors in use: fewer of them let images further down move up. A sweep adds distractors in the order
of a key (their place in a random order, or their distance), so an image can be a candidate at some point of the sweep
exactly when fewer than N images stand before it that are in the database or are added no later. That is decided
here from first-stage similarities and keys alone: for a random order about N (1 + ln(pool / N)) images of a query.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from artifact.datasets.positives import as_columns
from artifact.ranking.arithmetic import Dots
from artifact.ranking.one_pass import evaluated_queries
from artifact.ranking.similarity import Looks, described, views_of
from artifact.suppression.compiled import compiled, threads

Scores = Callable[[Any, np.ndarray, Any, np.ndarray], np.ndarray]
"""Second stage: ``(queries, query rows, images, image rows)`` to ``(p,)`` scores, larger is better."""

POSITIVE, DATABASE, DISTRACTOR = 0, 1, 2

_DATABASE = None  # its key among the pools, which have names
_BLOCK = 64  # queries whose pairs are scored together


@dataclass(frozen=True)
class Images:
    """What both stages know of a set of images, in one order.

    Attributes
    ----------
    first
        Descriptors ``(n, d)`` float32 or float16, compared by cosine; or hash codes packed eight bits to a byte
        ``(n, bytes)`` uint8, compared by Hamming distance.
    second
        What the second stage reads of an image when indexed by an array of ``rows``: descriptors, or local features.
    positions
        ``(n, p)`` float64 in metres or frames.
    rows
        ``(n,)`` where each image is in ``second``.
    """

    first: np.ndarray
    second: Any
    positions: np.ndarray
    rows: np.ndarray

    @classmethod
    def of(cls, first: np.ndarray, second: Any, positions: np.ndarray) -> Images:
        """Check and combine what is known of the images, or raise ``ValueError``."""
        where = as_columns(positions)
        if not len(first) == len(second) == len(where) > 0:
            found = (
                f"first stage, second stage and positions are of {len(first)}, {len(second)} and {len(where)} images"
            )
            raise ValueError(f"{found}; all three must be of the same images, at least one")
        if first.ndim != 2 or first.dtype not in (np.float32, np.float16, np.uint8):
            allowed = "descriptors (n, d) of float32 or float16 or packed codes (n, bytes) of uint8"
            raise ValueError(f"the first stage takes {allowed}; found {first.dtype} {first.shape}")
        return cls(first, second, np.ascontiguousarray(where), np.arange(len(where)))

    def __len__(self) -> int:
        return len(self.positions)

    def take(self, chosen: np.ndarray | slice) -> Images:
        """Return some of the images."""
        return Images(self.first[chosen], self.second, self.positions[chosen], self.rows[chosen])


class Entries(NamedTuple):
    """Possible candidates of one query in first-stage order: by similarity, then kind, then index.

    ``kind`` is int8: positive, other database image, or distractor; ``image`` its int64 index in the database or pool;
    ``first`` and ``second`` the float32 scores of the stages; ``keys`` ``(e, k)`` float64 keys of the distractors, 0
    for database images.
    """

    kind: np.ndarray
    image: np.ndarray
    first: np.ndarray
    second: np.ndarray
    keys: np.ndarray


class Problem(NamedTuple):
    """The evaluated queries and the database, N, and the ``positives`` of query i: from ``starts[i]`` on."""

    queries: Images
    evaluated: np.ndarray
    database: Images
    starts: np.ndarray
    positives: np.ndarray
    threshold: float
    candidates: int

    @classmethod
    def of(cls, queries: Images, database: Images, threshold: float, candidates: int) -> Problem:
        """Keep the queries that have a positive."""
        evaluated, starts, positives = evaluated_queries(queries.positions, database.positions, threshold)
        return cls(queries.take(evaluated), evaluated, database, starts, positives, threshold, candidates)

    def part(self, rows: slice) -> Problem:
        """Return the problem of some of the evaluated queries, from a row up to another."""
        starts = self.starts[rows.start : rows.stop + 1]
        return self._replace(
            queries=self.queries.take(rows),
            evaluated=self.evaluated[rows],
            starts=starts - starts[0],
            positives=self.positives[starts[0] : starts[-1]],
        )


def scored_entries(
    problem: Problem, pools: Mapping[str, Images | None], scores: Scores, orders: np.ndarray | None = None
) -> Iterator[tuple[int, dict[str, Entries]]]:
    """Yield each query with its possible candidates, by pool: from database and pool, scored by the second stage.

    ``None`` as a pool is no distractors. ``orders`` is ``None`` for all distractors at once, else ``(pool, draws)``
    places of the images of the only pool in random orders: entries then suffice for any first part of each order and
    for any minimum distance, and their keys are the places, then the negative distance. Pairs are scored once.
    """
    others = {name: pool.first for name, pool in pools.items() if pool is not None}
    similarities = _similarities(problem.queries.first, {_DATABASE: problem.database.first} | others)
    for start in range(0, len(problem.queries), _BLOCK):
        block = range(start, min(start + _BLOCK, len(problem.queries)))
        rows = slice(block.start, block.stop)
        near = [
            _from_database(problem, query, row) for query, row in zip(block, similarities[_DATABASE](rows), strict=True)
        ]
        _score(problem, block, near, problem.database, scores)
        found = dict.fromkeys(pools, near)
        for name, pool in pools.items():
            if pool is not None:
                far = [
                    _from_pool(problem, query, row, pool, orders, entries)
                    for query, row, entries in zip(block, similarities[name](rows), near, strict=True)
                ]
                _score(problem, block, far, pool, scores)
                found[name] = [_merged(*both) for both in zip(near, far, strict=True)]
        for place, query in enumerate(block):
            yield query, {name: entries[place] for name, entries in found.items()}


def _similarities(
    queries: np.ndarray, sets: Mapping[str | None, np.ndarray]
) -> dict[str | None, Callable[[slice], np.ndarray]]:
    """Return what gives the first-stage similarities of some queries to each set, the same on every machine."""
    if queries.dtype == np.uint8:
        return {name: partial(_of_codes, _signs(queries), _signs(codes)) for name, codes in sets.items()}
    with threads() as executor:
        ours, *theirs = (views_of(rows, {"": None})[""] for rows in described([queries, *sets.values()], executor))
        dots = [Dots(queries, rows, executor) for rows in sets.values()]
    looks = [Looks(ours, images, "cosine", one) for images, one in zip(theirs, dots, strict=True)]
    return {name: one.table for name, one in zip(sets, looks, strict=True)}


def _of_codes(queries: np.ndarray, images: np.ndarray, rows: slice) -> np.ndarray:
    return queries[rows] @ images.T


def _signs(codes: np.ndarray) -> np.ndarray:
    """Return +1 and -1: their product, exact, is the number of bits less twice the Hamming distance."""
    return 2.0 * np.unpackbits(codes, axis=1).astype(np.float32) - 1.0


def _from_database(problem: Problem, query: int, similarity: np.ndarray) -> Entries:
    """Entries of the database images that are candidates without distractors, under either rule for ties."""
    n = problem.candidates
    positives = problem.positives[problem.starts[query] : problem.starts[query + 1]]
    others = np.ones(len(similarity), bool)
    others[positives] = False
    positives, others = _leading(similarity, positives, n), _leading(similarity, np.flatnonzero(others), n)
    similarities, of_others = similarity[positives], similarity[others]
    # Positives lead their equals if ties favour the query, and come last if not.
    positives = positives[np.arange(len(positives)) + _above(of_others, similarities) < n]
    others = others[np.arange(len(others)) + _above(similarities, of_others) < n]
    kind = np.repeat(np.array([POSITIVE, DATABASE], np.int8), [len(positives), len(others)])
    index = np.concatenate([positives, others])
    return _sorted(_not_scored(kind, index, similarity, np.zeros((len(index), 0))))


def _from_pool(
    problem: Problem, query: int, similarity: np.ndarray, pool: Images, orders: np.ndarray | None, near: Entries
) -> Entries:
    """Entries of the allowed distractors that could be candidates beside the entries of the database."""
    n = problem.candidates
    apart = np.linalg.norm(pool.positions - problem.queries.positions[query], axis=1)
    others = near.first[near.kind == DATABASE]
    floor = others[n - 1] if len(others) >= n else np.float32(-np.inf)
    members = np.flatnonzero((apart > problem.threshold) & (similarity > floor))
    members = _leading(similarity, members, n if orders is None else len(members))
    similarities = similarity[members]
    before = len(others) - np.searchsorted(others[::-1], similarities)
    before += _above(near.first[near.kind == POSITIVE], similarities)
    if orders is None:
        keys, kept = np.zeros((len(members), 0)), np.arange(len(members)) + before < n
    else:
        keys = np.column_stack([orders[members], -apart[members]])
        kept = _reachable(before, keys, n)
    members = members[kept]
    return _not_scored(np.full(len(members), DISTRACTOR, np.int8), members, similarity, keys[kept])


def _not_scored(kind: np.ndarray, index: np.ndarray, similarity: np.ndarray, keys: np.ndarray) -> Entries:
    return Entries(kind, index, similarity[index], np.empty(len(index), np.float32), keys)


def _leading(similarity: np.ndarray, members: np.ndarray, n: int) -> np.ndarray:
    """Return the ``n`` most similar of some images, most similar first, equal ones by index."""
    if len(members) > n:
        values = similarity[members]
        members = members[values >= np.partition(values, len(values) - n)[len(values) - n]]
    return members[np.argsort(-similarity[members], kind="stable")[:n]]


def _above(descending: np.ndarray, similarities: np.ndarray) -> np.ndarray:
    """Return how many of some descending values are strictly above each."""
    return len(descending) - np.searchsorted(descending[::-1], similarities, side="right")


@compiled()
def _reachable(before: np.ndarray, keys: np.ndarray, n: int) -> np.ndarray:
    """Tell which distractors, in first-stage order and each behind some images, are ever candidates in a sweep."""
    # A distractor that is added comes with all of smaller or equal keys; it is a candidate then or never.
    sweeps = keys.shape[1]
    smallest, filled = np.empty((sweeps, n)), np.zeros(sweeps, np.int64)
    reachable = np.zeros(before.size, np.bool_)
    for image in range(before.size):
        slots = n - before[image]
        if slots <= 0:
            break
        for sweep in range(sweeps):
            key, values = keys[image, sweep], smallest[sweep]
            if filled[sweep] < slots or values[slots - 1] > key:
                reachable[image] = True
            if filled[sweep] < n:
                filled[sweep] += 1
            elif values[n - 1] <= key:
                continue
            slot = filled[sweep] - 1
            while slot > 0 and values[slot - 1] > key:
                values[slot] = values[slot - 1]
                slot -= 1
            values[slot] = key
    return reachable


def _score(problem: Problem, block: range, parts: list[Entries], images: Images, scores: Scores) -> None:
    """Write the second-stage scores of a block of queries into their entries."""
    lengths = [len(entries.image) for entries in parts]
    if not sum(lengths):
        return
    owners = problem.queries.rows[np.repeat(np.arange(block.start, block.stop), lengths)]
    index = np.concatenate([entries.image for entries in parts])
    values = scores(problem.queries.second, owners, images.second, images.rows[index])
    if not np.isfinite(values).all():
        pair = int(np.flatnonzero(~np.isfinite(values))[0])
        scored = f"query {owners[pair]} and image {images.rows[index[pair]]} as {values[pair]}"
        raise ValueError(f"the second stage scores {scored}; scores must be finite")
    for entries, found in zip(parts, np.split(values, np.cumsum(lengths)[:-1]), strict=True):
        entries.second[:] = found


def _merged(near: Entries, far: Entries) -> Entries:
    near = near._replace(keys=np.zeros((len(near.image), far.keys.shape[1])))
    return _sorted(Entries(*(np.concatenate(parts) for parts in zip(near, far, strict=True))))


def _sorted(entries: Entries) -> Entries:
    order = np.lexsort((entries.image, entries.kind, -entries.first))
    return Entries(*(part[order] for part in entries))
