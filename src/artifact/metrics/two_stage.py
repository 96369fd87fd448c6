"""Two-stage methods: candidates of the augmented database by a first stage, ranked again by a second.

The database of a query is C with its allowed distractors N_i (paper, section III-B). A two-stage method takes the
first N images of that database by its first stage (SelaVPR: cosine of descriptors; SelaVPR++: Hamming distance of
hash codes) and ranks them again (SelaVPR: mutual nearest local features; SelaVPR++: cosine of descriptors). So
distractors act twice: they push database images out of the candidates, and they compete with those that stay. A
distractor may even help, by pushing out a wrong database image that the second stage would have preferred: DAR can
exceed R, and is reported as it is.

Counts per query do not suffice here, as they do for one-stage methods (:mod:`artifact.ranking.one_pass`). Each query needs the
scores of all images that are candidates under some choice of distractors; what those are is decided from the first
stage alone, so that nothing is scored in vain. A pair's score depends on the pair alone and is computed once.

Ties, as everywhere in this project, favour the query: images level in the first stage stand with the positives first,
then database images and distractors, each by index; images level in the second stage keep their first-stage order.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from artifact.metrics.evaluation import QUERY_POOL, Evaluation, Ties
from artifact.metrics.two_stage_sweeps import Sweep, check_numbers, rank_of_best, sweep
from artifact.ranking.candidates import DISTRACTOR, POSITIVE, Entries, Images, Problem, Scores, scored_entries
from artifact.ranking.one_pass import ORIGINAL, Ranking

REVISION = 1  # raise when any rank changes: it is part of the key of stored rankings


# -- results ------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class TwoStageEvaluation(Evaluation):
    """The outcome of evaluating a two-stage method: as :class:`~artifact.metrics.evaluation.Evaluation`, for K up to N.

    DAR@K may exceed R@K. There are no counts: ``ranking`` holds the numbers of images only. The sweeps need scores of
    more pairs than R and DAR and are computed when first asked for.

    Attributes
    ----------
    candidates
        N, the number of first-stage candidates that are ranked again.
    database_ranks
        ``(2, n)`` ranks of the best positive in the database; the second row has all ties against the query.
        N + 1 stands for every query without a positive among the candidates.
    augmented_ranks
        The same with each pool's distractors.
    lists
        By ``""`` for the database and by pool: indices ``(n, k)`` and scores ``(n, k)`` of the first k images.
    sweep_of
        Gives the sweep of a pool by its name; computed on the first call and kept.
    """

    candidates: int = field(kw_only=True)
    database_ranks: np.ndarray = field(kw_only=True)
    augmented_ranks: dict[str, np.ndarray] = field(kw_only=True)
    lists: dict[str, tuple[np.ndarray, np.ndarray]] = field(kw_only=True)
    sweep_of: Callable[[str], Sweep] = field(kw_only=True, compare=False)

    @property
    def views(self) -> list[str]:
        """The one view: suppression does not apply to codes and local features (paper, section IV)."""
        return [ORIGINAL]

    def __getitem__(self, view: str) -> Evaluation:
        if view != ORIGINAL:
            raise KeyError(f"no view {view!r}; a two-stage evaluation has the view {ORIGINAL!r} alone")
        return self

    def ranks(self, *, distractors: bool, ties: Ties = "for") -> np.ndarray:
        """Return ``(n,)`` int64 ranks of the best positive; N + 1 if no candidate is a positive.

        Parameters
        ----------
        distractors
            Whether allowed distractors are in the database.
        ties
            ``"for"`` is the protocol. ``"against"``: the positives come after all images level with them, in both
            stages.
        """
        found = self.augmented_ranks[self.pool_name] if distractors else self.database_ranks
        return found[int(ties == "against")]

    def hits(self, k: int = 1, *, distractors: bool, ties: Ties = "for") -> np.ndarray:
        """Return ``(n,)`` bool: whether a positive is among the top K after re-ranking."""
        return self.ranks(distractors=distractors, ties=ties) <= self._within(k)

    def dar_by_ratio(self, ratios: Sequence[float], k: int = 1) -> np.ndarray:
        """Return DAR@K when only a share of the distractor pool is used: the mean over nested random draws.

        There is no closed form as for one-stage methods, since distractors do not act on a query independently.
        """
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
        return ranks <= self._within(k)

    def dar_by_distance(self, distances: Sequence[float], k: int = 1) -> np.ndarray:
        """Return DAR@K when only distractors farther than a distance are used, ``(len(distances),)`` float64."""
        return self.hits_by_distance(distances, k).mean(axis=0)

    def hits_by_distance(self, distances: Sequence[float], k: int = 1) -> np.ndarray:
        """Return ``(n, len(distances))`` bool: each query's hits behind :meth:`dar_by_distance`."""
        return self.sweep_of(self.pool_name).distance.below(-self._limits(distances)) <= self._within(k)

    def retrieved(self, k: int = 1, *, distractors: bool) -> tuple[np.ndarray, np.ndarray]:
        """Return indices and second-stage scores of each query's top K images, as ``Evaluation.retrieved``."""
        indices, scores = self.lists[self.pool_name if distractors else ""]
        if not 1 <= k <= indices.shape[1]:
            raise ValueError(
                f"k is {k}; this evaluation keeps retrieval lists up to {indices.shape[1]}: raise the option retrieve"
            )
        return indices[:, :k], scores[:, :k]

    def arrays(self) -> dict[str, np.ndarray]:
        """Flatten into named arrays, for storage; sweeps are not among them."""
        named = {
            "numbers": np.array([self.ranking.n_listed, self.ranking.n_database, self.candidates]),
            "evaluated": self.ranking.evaluated,
            "threshold": np.array(self.threshold),
            "pools": np.array(self.pools),
            "query_positions": self.query_positions,
            "database_positions": self.database_positions,
            "database_ranks": self.database_ranks,
        }
        for number, name in enumerate(["", *self.pools]):
            named[f"indices_{number}"], named[f"scores_{number}"] = self.lists[name]
            if name:
                named[f"positions_{number}"] = self.pool_positions[name]
                named[f"ranks_{number}"] = self.augmented_ranks[name]
        return named

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, np.ndarray], sweep_of: Callable[[str], Sweep]) -> TwoStageEvaluation:
        """Rebuild from :meth:`arrays`."""
        n_listed, n_database, candidates = arrays["numbers"].tolist()
        names = dict(enumerate(arrays["pools"].tolist(), start=1))
        positions = {name: arrays[f"positions_{number}"] for number, name in names.items()}
        sizes = {name: len(where) for name, where in positions.items()}
        return cls(
            ranking=Ranking(arrays["evaluated"], n_listed, n_database, sizes, {}, {}),
            query_positions=arrays["query_positions"],
            database_positions=arrays["database_positions"],
            pool_positions=positions,
            threshold=float(arrays["threshold"]),
            pool_name=names[1],
            candidates=candidates,
            database_ranks=arrays["database_ranks"],
            augmented_ranks={name: arrays[f"ranks_{number}"] for number, name in names.items()},
            lists={
                name: (arrays[f"indices_{number}"], arrays[f"scores_{number}"])
                for number, name in {0: "", **names}.items()
            },
            sweep_of=sweep_of,
        )

    def _within(self, k: int) -> int:
        if not isinstance(k, int | np.integer) or isinstance(k, bool) or not 1 <= k <= self.candidates:
            raise ValueError(f"k is {k!r}; allowed: whole numbers from 1 to the {self.candidates} candidates")
        return int(k)


# -- evaluation ---------------------------------------------------------------------------------------------


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
) -> TwoStageEvaluation:
    """Evaluate a two-stage method with and without distractors.

    Parameters
    ----------
    queries, database
        The images with what both stages know of them.
    threshold
        As in :func:`artifact.evaluate`.
    scores
        The second stage, for example :func:`artifact.ranking.matching.cosines` or a
        :class:`artifact.ranking.matching.LocalMatcher`.
    pools
        Distractor pools by name; ``None`` takes the evaluated queries themselves, as does a pool that is ``None``.
    candidates
        N, how many images of the augmented database are ranked again.
    retrieve
        Length of the stored retrieval lists, at most N.
    draws, seed
        Number of nested random draws of the sweep over the number of distractors, and their seed: the draws are those
        of one-stage methods with the same pool size and seed.

    Raises
    ------
    ValueError
        If ``candidates`` or ``retrieve`` are not allowed, or no query has a positive.
    """
    check_numbers(candidates, draws)
    if not 0 <= retrieve <= candidates:
        raise ValueError(f"retrieve is {retrieve}; allowed: whole numbers from 0 to the {candidates} candidates")
    problem = Problem.of(queries, database, threshold, candidates)
    named = {name: problem.queries if p is None else p for name, p in (pools or {QUERY_POOL: None}).items()}
    n = len(problem.queries)
    ranks = {name: np.empty((2, n), np.int64) for name in ("", *named)}
    lists = {
        name: (np.full((n, retrieve), -1, np.int64), np.full((n, retrieve), -np.inf, np.float32)) for name in ranks
    }
    for query, found in scored_entries(problem, {"": None, **named}, scores):
        for name, entries in found.items():
            ranks[name][:, query] = [_rank(entries, candidates, ties) for ties in ("for", "against")]
            _fill_list(lists[name], query, entries, candidates, len(database))

    @functools.cache
    def sweep_of(name: str) -> Sweep:
        return sweep(queries, database, threshold, scores, named[name], candidates=candidates, draws=draws, seed=seed)

    sizes = {name: len(pool) for name, pool in named.items()}
    return TwoStageEvaluation(
        ranking=Ranking(problem.evaluated, len(queries), len(database), sizes, {}, {}),
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


def _rank(entries: Entries, n: int, ties: Ties) -> int:
    """Rank of the first positive after re-ranking the first n entries."""
    if ties == "against":
        last = np.where(entries.kind == POSITIVE, DISTRACTOR + 1, entries.kind)
        order = np.lexsort((entries.index, last, -entries.first))[:n]
        return rank_of_best(entries.kind[order], entries.second[order], True) or n + 1
    return rank_of_best(entries.kind[:n], entries.second[:n], False) or n + 1


def _fill_list(target: tuple[np.ndarray, np.ndarray], query: int, entries: Entries, n: int, n_database: int) -> None:
    order = np.argsort(-entries.second[:n], kind="stable")[: target[0].shape[1]]
    shift = np.where(entries.kind[order] == DISTRACTOR, n_database, 0)
    target[0][query, : len(order)] = entries.index[order] + shift
    target[1][query, : len(order)] = entries.second[order]
