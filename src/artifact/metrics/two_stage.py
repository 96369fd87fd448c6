"""Two-stage methods: candidates of the augmented database by a first stage, ranked again by a second.

A two-stage method takes the first N images of a query's database by its first stage (SelaVPR: cosine of descriptors;
SelaVPR++: Hamming distance of hash codes) and ranks them again (SelaVPR: mutual nearest local features; SelaVPR++:
cosine of descriptors). So distractors act twice: they push database images out of the candidates, and they compete with
those that stay. A distractor may even help, by pushing out a wrong database image that the second stage would have
preferred: DAR can exceed R, and is reported as it is.

Ties favour the query: images equal in the first stage stand with the positives first, then database images and
distractors, each by index; images equal in the second stage keep their first-stage order.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from artifact.metrics.result import QUERY_POOL, Result, Ties, is_integer
from artifact.metrics.two_stage_sweeps import Sweep, check_numbers, rank_of_best, sweep
from artifact.ranking.candidates import DISTRACTOR, POSITIVE, Entries, Images, Problem, Scores, scored_entries

REVISION = 3  # raise when any rank changes: it is part of the key of stored rankings


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
    check_numbers(candidates, draws)
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


def joined(parts: Sequence[Mapping[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Return the arrays of a whole evaluation from those of its parts, in order of their queries."""

    def of(name: str) -> np.ndarray:
        if name in ("evaluated", "query_positions") or name.startswith(("indices_", "scores_")):
            return np.concatenate([part[name] for part in parts])
        if name == "database_ranks" or name.startswith("ranks_"):
            return np.concatenate([part[name] for part in parts], axis=1)
        return parts[0][name]

    return {name: of(name) for name in parts[0]}


def _rank(entries: Entries, n: int, ties: Ties) -> int:
    """Rank of the first positive after re-ranking the first n entries."""
    if ties == "against":
        last = np.where(entries.kind == POSITIVE, DISTRACTOR + 1, entries.kind)
        order = np.lexsort((entries.image, last, -entries.first))[:n]
        return rank_of_best(entries.kind[order], entries.second[order], True) or n + 1
    return rank_of_best(entries.kind[:n], entries.second[:n], False) or n + 1


def _fill_list(target: tuple[np.ndarray, np.ndarray], query: int, entries: Entries, n: int, n_database: int) -> None:
    order = np.argsort(-entries.second[:n], kind="stable")[: target[0].shape[1]]
    shift = np.where(entries.kind[order] == DISTRACTOR, n_database, 0)
    target[0][query, : len(order)] = entries.image[order] + shift
    target[1][query, : len(order)] = entries.second[order]
