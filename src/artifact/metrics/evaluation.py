"""R@K, DAR@K and RSR@K, their sweeps, and :func:`evaluate`, which computes them from descriptors.

The definitions are those of the paper, section III-B. With ``b`` database images and ``n`` allowed distractors
above a query's best positive, the query is a hit at K without distractors when ``b < K`` and with distractors
when ``b + n < K``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import pandas as pd
from scipy.special import gammaln

from artifact.ranking.counting import Counts
from artifact.ranking.one_pass import ORIGINAL, Ranking

QUERY_POOL = "queries"
NO_POOL = "none"
Ties = Literal["for", "against"]


@dataclass(frozen=True)
class Evaluation:
    """The outcome of one evaluation; all shares are fractions in [0, 1].

    ``result["name"]`` is the same evaluation seen through a view; ``result.pool("name")`` the same with another
    distractor pool.

    Attributes
    ----------
    ranking
        The per-query counts.
    query_positions, database_positions
        Positions of the evaluated queries ``(n, p)`` and of the database, in the unit of ``threshold``.
    pool_positions
        Positions of each distractor pool.
    threshold
        Positive threshold in metres or frames.
    view, pool_name
        Which view and pool this evaluation shows.
    """

    ranking: Ranking
    query_positions: np.ndarray
    database_positions: np.ndarray
    pool_positions: dict[str, np.ndarray]
    threshold: float
    view: str = ORIGINAL
    pool_name: str = QUERY_POOL

    # -- what was evaluated ---------------------------------------------------------------------------------

    @property
    def n_queries(self) -> int:
        """Number of evaluated queries: those with a positive in the database."""
        return len(self.ranking.evaluated)

    @property
    def excluded_queries(self) -> int:
        """Number of queries without a positive, which leave numerator, denominator and query pool."""
        return self.ranking.n_listed - self.n_queries

    @property
    def evaluated(self) -> np.ndarray:
        """Indices of the evaluated queries among those given; per-query arrays follow this order."""
        return self.ranking.evaluated

    @property
    def n_distractors(self) -> int:
        """Number of images in the distractor pool, N_D; each query may use those beyond the threshold."""
        return self.ranking.pool_sizes.get(self.pool_name, 0)

    @property
    def views(self) -> list[str]:
        """Names of the views, ``"original"`` first."""
        return list(self.ranking.database)

    @property
    def pools(self) -> list[str]:
        """Names of the distractor pools."""
        return list(self.ranking.pool_sizes)

    def __getitem__(self, view: str) -> Evaluation:
        if view not in self.ranking.database:
            raise KeyError(f"no view {view!r}; the views are {', '.join(self.views)}")
        return replace(self, view=view)

    def pool(self, name: str) -> Evaluation:
        """Return the same evaluation with the distractor pool ``name``."""
        if name not in self.ranking.pool_sizes:
            raise KeyError(f"no distractor pool {name!r}; the pools are {', '.join(self.pools)}")
        return replace(self, pool_name=name)

    # -- per query ------------------------------------------------------------------------------------------

    @property
    def database_counts(self) -> Counts:
        """Counts over the cross-condition database."""
        return self.ranking.database[self.view]

    @property
    def distractor_counts(self) -> Counts:
        """Counts over the allowed distractors."""
        if self.pool_name == NO_POOL:
            depth, draws = self.database_counts.farthest.shape[1], self.database_counts.first.shape[2]
            return Counts.empty(self.n_queries, depth, draws, self.database_counts.top_index.shape[1])
        return self.ranking.pools[self.view, self.pool_name]

    def ranks(self, *, distractors: bool, ties: Ties = "for") -> np.ndarray:
        """Return ``(n,)`` int64 ranks of the best positive; 1 is the top match.

        Parameters
        ----------
        distractors
            Whether allowed distractors are in the database.
        ties
            ``"for"`` the query: only images strictly above the best positive count. ``"against"`` it: images
            level with it count too.
        """
        ranks = 1 + self.database_counts.outranking
        if ties == "against":
            ranks = ranks + self.database_counts.ties
        if distractors:
            ranks = ranks + self.distractor_counts.outranking
            if ties == "against":
                ranks = ranks + self.distractor_counts.ties
        return ranks

    def hits(self, k: int = 1, *, distractors: bool, ties: Ties = "for") -> np.ndarray:
        """Return ``(n,)`` bool: whether a positive is among the top K."""
        return self.ranks(distractors=distractors, ties=ties) <= _checked_k(k)

    def per_query(self) -> pd.DataFrame:
        """Return one row for each evaluated query.

        Returns
        -------
        pandas.DataFrame
            ``query``: its index among those given; ``rank`` and ``rank_with_distractors`` of its best positive (1 is the top
            match; ties favour the query); ``ties`` and ``ties_with_distractors``: images exactly level with it;
            ``best_positive``: its database index, the first of several; ``distance`` from the query to it, in the unit of the
            positions.
        """
        ranks = {
            added: [self.ranks(distractors=added, ties=ties) for ties in ("for", "against")] for added in (False, True)
        }
        best = self.database_counts.positive
        return pd.DataFrame(
            {
                "query": self.evaluated,
                "rank": ranks[False][0],
                "rank_with_distractors": ranks[True][0],
                "ties": ranks[False][1] - ranks[False][0],
                "ties_with_distractors": ranks[True][1] - ranks[True][0],
                "best_positive": best,
                "distance": np.linalg.norm(self.query_positions - self.database_positions[best], axis=1),
            }
        )

    # -- metrics --------------------------------------------------------------------------------------------

    def recall(self, k: int = 1, *, ties: Ties = "for") -> float:
        """Return R@K: the share of queries with a positive among the top K of the database."""
        return float(self.hits(k, distractors=False, ties=ties).mean())

    def dar(self, k: int = 1, *, ties: Ties = "for") -> float:
        """Return DAR@K: the same share with each query's allowed distractors added to the database."""
        return float(self.hits(k, distractors=True, ties=ties).mean())

    def rsr(self, k: int = 1) -> float:
        """Return RSR@K = DAR@K / R@K: the share of successes that survive; NaN if R@K is 0."""
        successes = self.hits(k, distractors=False).sum()
        return float(self.hits(k, distractors=True).sum() / successes) if successes else float("nan")

    # -- sweeps ---------------------------------------------------------------------------------------------

    def dar_by_ratio(self, ratios: Sequence[float], k: int = 1) -> np.ndarray:
        """Return the expected DAR@K when only a share of the distractor pool is used (paper Fig. 6a).

        For ratio r, m = round(r N_D) pool images are drawn without replacement. Of the m drawn, the number that
        outranks query i's best positive is hypergeometric, so the expectation over all draws is exact.

        Parameters
        ----------
        ratios
            Shares of the pool in [0, 1]; 0 gives R@K and 1 gives DAR@K.
        k
            K.

        Returns
        -------
        numpy.ndarray
            ``(len(ratios),)`` float64.
        """
        return self.chances_by_ratio(ratios, k).mean(axis=0)

    def chances_by_ratio(self, ratios: Sequence[float], k: int = 1) -> np.ndarray:
        """Return each query's chance of a hit at the ratios of :meth:`dar_by_ratio`, ``(n, len(ratios))``."""
        spare = _checked_k(k) - 1 - self.database_counts.outranking
        outranking = self.distractor_counts.outranking
        chances = [_at_most(spare, self.n_distractors, outranking, int(size)) for size in self._sizes(ratios)]
        return np.stack(chances, axis=1) if chances else np.empty((self.n_queries, 0))

    def dar_by_ratio_draws(self, ratios: Sequence[float], k: int = 1) -> np.ndarray:
        """Return DAR@K for nested random subsets of the pool, one row for each stored draw.

        Within a row a larger ratio adds images to the smaller one's, as the paper samples. The spread between
        rows is the spread of :meth:`dar_by_ratio` over draws.

        Returns
        -------
        numpy.ndarray
            ``(draws, len(ratios))`` float64.
        """
        sizes = self._sizes(ratios)
        needed = self._needed(k)
        first = self.distractor_counts.first
        order = np.take_along_axis(first, np.maximum(needed - 1, 0)[:, None, None], axis=1)[:, 0]
        hits = (order[:, :, None] >= sizes) & (needed > 0)[:, None, None]
        return hits.mean(axis=0)

    def dar_by_distance(self, distances: Sequence[float], k: int = 1) -> np.ndarray:
        """Return DAR@K when only distractors farther than a distance are used (paper Fig. 6b).

        Parameters
        ----------
        distances
            Minimum distances in the unit of the threshold, from the threshold (all distractors: DAR@K) to
            infinity (none: R@K).
        k
            K.

        Returns
        -------
        numpy.ndarray
            ``(len(distances),)`` float64.
        """
        return self.hits_by_distance(distances, k).mean(axis=0)

    def hits_by_distance(self, distances: Sequence[float], k: int = 1) -> np.ndarray:
        """Return ``(n, len(distances))`` bool: each query's hits behind :meth:`dar_by_distance`."""
        limits = self._limits(distances)
        needed = self._needed(k)
        distance = np.take_along_axis(self.distractor_counts.farthest, np.maximum(needed - 1, 0)[:, None], axis=1)[:, 0]
        return ~(distance[:, None] > limits) & (needed > 0)[:, None]

    def _sizes(self, ratios: Sequence[float]) -> np.ndarray:
        values = np.asarray(ratios, np.float64)
        if values.ndim != 1 or not ((values >= 0) & (values <= 1)).all():
            raise ValueError(f"ratios are {ratios!r}; allowed: a list of numbers from 0 to 1")
        return np.rint(values * self.n_distractors).astype(np.int64)

    def _limits(self, distances: Sequence[float]) -> np.ndarray:
        limits = np.asarray(distances, np.float64)
        if limits.ndim != 1 or not (limits >= self.threshold).all():
            raise ValueError(
                f"distances are {distances!r}; allowed: a list of numbers from the threshold {self.threshold:g} up"
            )
        return limits

    def _needed(self, k: int) -> np.ndarray:
        """How many distractors must beat the best positive to push it out of the top K; 0 if it is out already."""
        depth = self.distractor_counts.farthest.shape[1]
        if depth == 0:
            raise ValueError(f"view {self.view!r} was evaluated without its sweeps: pass view_sweeps=True to evaluate")
        if _checked_k(k) > depth:
            raise ValueError(f"k is {k}; this evaluation keeps sweeps for K up to {depth}: raise the option depth")
        return np.clip(k - self.database_counts.outranking, 0, k)

    # -- retrieval lists ------------------------------------------------------------------------------------

    def retrieved(self, k: int = 1, *, distractors: bool) -> tuple[np.ndarray, np.ndarray]:
        """Return each query's top K images.

        Parameters
        ----------
        k
            Length of the list, at most the option ``retrieve``.
        distractors
            Whether allowed distractors are in the database.

        Returns
        -------
        indices
            ``(n, k)`` int64: database indices; a distractor with pool index ``j`` is ``n_database + j``; -1 where
            there are fewer than K images.
        similarities
            ``(n, k)`` float32, in the order of the list. They are comparable within a query; for cosine divide
            by the query's length to get the cosine itself.
        """
        stored = self.database_counts.top_index.shape[1]
        if not 1 <= _checked_k(k) <= stored:
            raise ValueError(
                f"k is {k}; this evaluation keeps retrieval lists up to {stored}: raise the option retrieve"
            )
        indices, similarities = self.database_counts.top_index, self.database_counts.top_similarity
        if distractors:
            pool = self.distractor_counts
            shifted = np.where(pool.top_index < 0, -1, pool.top_index + self.ranking.n_database)
            indices = np.concatenate([indices, shifted], axis=1)
            similarities = np.concatenate([similarities, pool.top_similarity], axis=1)
            order = np.argsort(-similarities, axis=1, kind="stable")
            indices = np.take_along_axis(indices, order, axis=1)
            similarities = np.take_along_axis(similarities, order, axis=1)
        return indices[:, :k], similarities[:, :k]


def _at_most(spare: np.ndarray, pool: int, outranking: np.ndarray, size: int) -> np.ndarray:
    """Probability that at most ``spare`` of the outranking are among ``size`` images drawn from a pool of ``pool``."""

    def log_choose(n: Any, k: Any) -> Any:
        return gammaln(n + 1) - gammaln(k + 1) - gammaln(n - k + 1)

    total = np.zeros(len(outranking))
    for drawn in range(int(spare.max(initial=-1)) + 1):
        possible = (drawn <= spare) & (drawn <= outranking) & (drawn <= size) & (size - drawn <= pool - outranking)
        n = outranking[possible]
        log_probability = (
            log_choose(n, drawn) + log_choose(pool - n, size - drawn) - log_choose(np.float64(pool), np.float64(size))
        )
        total[possible] += np.exp(log_probability)
    return np.minimum(total, 1.0)


# -- the boundary: everything past here is trusted ----------------------------------------------------------


def _is_integer(value: Any) -> bool:
    return isinstance(value, (int, np.integer)) and not isinstance(value, bool)


def _checked_k(k: int) -> int:
    if not _is_integer(k) or k < 1:
        raise ValueError(f"k is {k!r}; allowed: whole numbers from 1")
    return int(k)
