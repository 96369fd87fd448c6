"""Evaluations of one-stage methods, from per-query counts.

With ``b`` database images and ``n`` allowed distractors that outrank a query's best positive, the query is a hit at K
without distractors when ``b < K`` and with distractors when ``b + n < K``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.special import gammaln

from artifact.metrics.result import Result, Ties
from artifact.ranking.counting import Counts
from artifact.ranking.one_pass import ORIGINAL, Ranking


@dataclass(frozen=True, kw_only=True)
class Evaluation(Result):
    """The outcome of evaluating a one-stage method, from the counts of a ranking and as one of its views shows it.

    See :class:`~artifact.metrics.result.Result` for what it answers.
    """

    ranking: Ranking
    view: str = ORIGINAL

    @property
    def views(self) -> list[str]:
        """Names of the views, ``"original"`` first."""
        return list(self.ranking.database)

    def __getitem__(self, view: str) -> Evaluation:
        return replace(super().__getitem__(view), view=view)

    @property
    def database_counts(self) -> Counts:
        """Counts over the cross-condition database."""
        return self.ranking.database[self.view]

    @property
    def distractor_counts(self) -> Counts:
        """Counts over the allowed distractors."""
        return self.ranking.pools[self.view, self.pool_name]

    def ranks(self, *, distractors: bool, ties: Ties = "for") -> np.ndarray:
        """Return ``(n,)`` int64 ranks of the best positive; see :class:`~artifact.metrics.result.Result`."""
        ranks = np.ones(self.n_queries, np.int64)
        for counts in [self.database_counts, *([self.distractor_counts] if distractors else [])]:
            ranks += counts.outranking + (counts.ties if ties == "against" else 0)
        return ranks

    def chances_by_ratio(self, ratios: Sequence[float], k: int = 1) -> np.ndarray:
        """Return each query's chance of a hit, ``(n, len(ratios))``, exact: what outranks it is hypergeometric."""
        spare = self._checked_k(k) - 1 - self.database_counts.outranking
        outranking = self.distractor_counts.outranking
        chances = [_at_most(spare, self.n_distractors, outranking, int(size)) for size in self._sizes(ratios)]
        return np.stack(chances, axis=1) if chances else np.empty((self.n_queries, 0))

    def dar_by_ratio_draws(self, ratios: Sequence[float], k: int = 1) -> np.ndarray:
        """Return DAR@K for the stored nested random subsets of the pool, ``(draws, len(ratios))`` float64."""
        sizes, needed = self._sizes(ratios), self._needed(k)
        first = self.distractor_counts.first
        order = np.take_along_axis(first, np.maximum(needed - 1, 0)[:, None, None], axis=1)[:, 0]
        hits = (order[:, :, None] >= sizes) & (needed > 0)[:, None, None]
        return hits.mean(axis=0)

    def hits_by_distance(self, distances: Sequence[float], k: int = 1) -> np.ndarray:
        """Return ``(n, len(distances))`` bool: each query's hits with the distractors beyond each distance."""
        limits, needed = self._limits(distances), self._needed(k)
        farthest = self.distractor_counts.farthest
        distance = np.take_along_axis(farthest, np.maximum(needed - 1, 0)[:, None], axis=1)[:, 0]
        return ~(distance[:, None] > limits) & (needed > 0)[:, None]

    def _needed(self, k: int) -> np.ndarray:
        """How many distractors must outrank the best positive to push it out of the top K; 0 if it is out already."""
        depth = self.distractor_counts.farthest.shape[1]
        if depth == 0:
            raise ValueError(f"view {self.view!r} was evaluated without its sweeps: pass view_sweeps=True to evaluate")
        if self._checked_k(k) > depth:
            raise ValueError(f"k is {k}; this evaluation keeps sweeps for K up to {depth}: raise the option depth")
        return np.clip(k - self.database_counts.outranking, 0, k)

    def _lists(self, *, distractors: bool) -> tuple[np.ndarray, np.ndarray]:
        counts = self.distractor_counts if distractors else self.database_counts
        return counts.top_index, counts.top_similarity

    def per_query(self) -> pd.DataFrame:
        """Return one row per evaluated query; see :class:`~artifact.metrics.result.Result`."""
        best, similarity = self.ranking.best_positive[self.view], self.ranking.similarity[self.view]
        distance = np.linalg.norm(self.query_positions - self.database_positions[best], axis=1)
        return super().per_query().assign(best_positive=best, similarity=similarity, distance=distance)

    def arrays(self) -> dict[str, np.ndarray]:
        """Flatten into named arrays, for storage."""
        named = super().arrays() | {"views": np.array(self.views)}
        for view_number, view in enumerate(self.views):
            named[f"best_positive/{view_number}"] = self.ranking.best_positive[view]
            named[f"similarity/{view_number}"] = self.ranking.similarity[view]
            counts = {f"database/{view_number}": self.ranking.database[view]}
            counts |= {f"pool/{view_number}/{n}": self.ranking.pools[view, pool] for n, pool in enumerate(self.pools)}
            named |= {f"{prefix}/{name}": a for prefix, c in counts.items() for name, a in c._asdict().items()}
        return named

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, np.ndarray]) -> Evaluation:
        """Rebuild from :meth:`arrays`."""

        def counts(prefix: str) -> Counts:
            return Counts(**{name: arrays[f"{prefix}/{name}"] for name in Counts._fields})

        fields, views = cls.fields_of(arrays), [str(view) for view in arrays["views"]]
        pools = list(enumerate(fields["pool_positions"]))
        ranking = Ranking(
            evaluated=arrays["evaluated"],
            database={view: counts(f"database/{v}") for v, view in enumerate(views)},
            pools={(view, pool): counts(f"pool/{v}/{p}") for v, view in enumerate(views) for p, pool in pools},
            best_positive={view: arrays[f"best_positive/{v}"] for v, view in enumerate(views)},
            similarity={view: arrays[f"similarity/{v}"] for v, view in enumerate(views)},
        )
        return cls(ranking=ranking, **fields)


def _at_most(spare: np.ndarray, pool: int, outranking: np.ndarray, size: int) -> np.ndarray:
    """Probability that at most ``spare`` of the outranking images are among ``size`` drawn from a pool of ``pool``."""

    def log_choose(n: npt.ArrayLike, k: npt.ArrayLike) -> np.ndarray:
        n, k = np.asarray(n, np.float64), np.asarray(k, np.float64)
        return gammaln(n + 1) - gammaln(k + 1) - gammaln(n - k + 1)

    total = np.zeros(len(outranking))
    for drawn in range(int(spare.max(initial=-1)) + 1):
        possible = (drawn <= spare) & (drawn <= outranking) & (drawn <= size) & (size - drawn <= pool - outranking)
        n = outranking[possible]
        log_probability = log_choose(n, drawn) + log_choose(pool - n, size - drawn) - log_choose(pool, size)
        total[possible] += np.exp(log_probability)
    return np.minimum(total, 1.0)
