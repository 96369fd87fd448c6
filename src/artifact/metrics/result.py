"""What every evaluation answers, of one stage or of two.

The definitions are those of the paper, section III-B: a query is a hit at K when its best positive is among the top K
of the database, without or with its allowed distractors.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, Protocol, Self

import numpy as np
import pandas as pd

from artifact.ranking.one_pass import ORIGINAL

QUERY_POOL = "queries"
Ties = Literal["for", "against"]


@dataclass(frozen=True, kw_only=True)
class Result(Protocol):
    """The outcome of one evaluation; all shares are fractions in [0, 1].

    ``result["name"]`` is the same evaluation seen through a view; ``result.pool("name")`` the same with another
    distractor pool.

    Attributes
    ----------
    evaluated
        ``(n,)`` indices of the queries with a positive among the ``n_listed`` given; the order of per-query arrays.
    query_positions, database_positions, pool_positions
        Of the evaluated queries ``(n, p)``, the database and each distractor pool, in the unit of ``threshold``.
    pool_name
        The pool that this evaluation shows.
    """

    evaluated: np.ndarray
    n_listed: int
    query_positions: np.ndarray
    database_positions: np.ndarray
    pool_positions: dict[str, np.ndarray]
    threshold: float
    pool_name: str

    @property
    def n_queries(self) -> int:
        """Number of evaluated queries: those with a positive in the database."""
        return len(self.evaluated)

    @property
    def excluded_queries(self) -> int:
        """Number of queries without a positive, which leave numerator, denominator and query pool."""
        return self.n_listed - self.n_queries

    @property
    def n_database(self) -> int:
        """Number of database images."""
        return len(self.database_positions)

    @property
    def n_distractors(self) -> int:
        """Number of images in the distractor pool, N_D; each query may use those beyond the threshold."""
        return len(self.pool_positions[self.pool_name])

    @property
    def views(self) -> list[str]:
        """Names of the views, ``"original"`` first."""
        return [ORIGINAL]

    @property
    def pools(self) -> list[str]:
        """Names of the distractor pools."""
        return list(self.pool_positions)

    def __getitem__(self, view: str) -> Self:
        if view not in self.views:
            raise KeyError(f"no view {view!r}; the views are {', '.join(self.views)}")
        return self

    def pool(self, name: str) -> Self:
        """Return the same evaluation with the distractor pool ``name``."""
        if name not in self.pool_positions:
            raise KeyError(f"no distractor pool {name!r}; the pools are {', '.join(self.pools)}")
        return replace(self, pool_name=name)

    @abstractmethod
    def ranks(self, *, distractors: bool, ties: Ties = "for") -> np.ndarray:
        """Return ``(n,)`` int64 ranks of the best positive, 1 on top, without or with the allowed distractors.

        With ties ``"for"`` the query only images above the best positive count, with ``"against"`` equal ones too.
        """

    def hits(self, k: int = 1, *, distractors: bool, ties: Ties = "for") -> np.ndarray:
        """Return ``(n,)`` bool: whether a positive is among the top K."""
        return self.ranks(distractors=distractors, ties=ties) <= self._checked_k(k)

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

    def dar_by_ratio(self, ratios: Sequence[float], k: int = 1) -> np.ndarray:
        """Return the expected DAR@K, ``(len(ratios),)`` float64, when only a share of the pool is used (paper Fig. 6a).

        For a ratio r in [0, 1], m = round(r N_D) pool images are drawn without replacement: 0 gives R@K, 1 gives DAR@K.
        """
        return self.chances_by_ratio(ratios, k).mean(axis=0)

    @abstractmethod
    def chances_by_ratio(self, ratios: Sequence[float], k: int = 1) -> np.ndarray:
        """Return each query's chance of a hit at the ratios of :meth:`dar_by_ratio`, ``(n, len(ratios))``."""

    @abstractmethod
    def dar_by_ratio_draws(self, ratios: Sequence[float], k: int = 1) -> np.ndarray:
        """Return DAR@K for nested random subsets of the pool: ``(draws, len(ratios))`` float64."""

    def dar_by_distance(self, distances: Sequence[float], k: int = 1) -> np.ndarray:
        """Return DAR@K, ``(len(distances),)`` float64, with only the distractors beyond a distance (paper Fig. 6b).

        Distances are in the unit of the threshold, from the threshold (all: DAR@K) to infinity (none: R@K).
        """
        return self.hits_by_distance(distances, k).mean(axis=0)

    @abstractmethod
    def hits_by_distance(self, distances: Sequence[float], k: int = 1) -> np.ndarray:
        """Return ``(n, len(distances))`` bool: each query's hits behind :meth:`dar_by_distance`."""

    def retrieved(self, k: int = 1, *, distractors: bool) -> tuple[np.ndarray, np.ndarray]:
        """Return each query's top K images, K up to the option ``retrieve``, without or with its allowed distractors.

        Indices are ``(n, k)`` int64: database indices, ``n_database + j`` for image ``j`` of the pool, -1 where there
        are fewer than K images. Similarities ``(n, k)`` float32 are the cosine, the dot product or the negative squared
        distance; scores of a second stage.
        """
        indices, similarities = self._lists(distractors=distractors)
        if not is_integer(k) or not 1 <= k <= indices.shape[1]:
            kept = f"this evaluation keeps retrieval lists up to {indices.shape[1]}"
            raise ValueError(f"k is {k!r}; {kept}: raise the option retrieve")
        return indices[:, :k], similarities[:, :k]

    @abstractmethod
    def _lists(self, *, distractors: bool) -> tuple[np.ndarray, np.ndarray]:
        """Return the whole lists of :meth:`retrieved`."""

    def per_query(self) -> pd.DataFrame:
        """Return one row per evaluated query.

        Columns are ``query``: its index among those given; ``rank`` and ``rank_with_distractors`` of its best positive;
        ``rank_against`` and ``rank_with_distractors_against``: the same with all ties against the query. One-stage
        methods add ``best_positive``: its database index, ``similarity`` of the two (cosine, dot product or negative
        squared distance) and ``distance`` between them in the unit of the threshold.
        """
        return pd.DataFrame(
            {
                "query": self.evaluated,
                "rank": self.ranks(distractors=False),
                "rank_with_distractors": self.ranks(distractors=True),
                "rank_against": self.ranks(distractors=False, ties="against"),
                "rank_with_distractors_against": self.ranks(distractors=True, ties="against"),
            }
        )

    def arrays(self) -> dict[str, np.ndarray]:
        """Flatten into named arrays, for storage."""
        named = {
            "numbers": np.array([self.n_listed, self.n_database]),
            "evaluated": self.evaluated,
            "threshold": np.array(self.threshold),
            "pools": np.array(self.pools),
            "query_positions": self.query_positions,
            "database_positions": self.database_positions,
        }
        return named | {f"positions_{number}": p for number, p in enumerate(self.pool_positions.values(), start=1)}

    @staticmethod
    def fields_of(arrays: Mapping[str, np.ndarray]) -> dict[str, Any]:
        """Return the fields of this class from :meth:`arrays`; the first pool is shown."""
        names = [str(name) for name in arrays["pools"]]
        return {
            "evaluated": arrays["evaluated"],
            "n_listed": int(arrays["numbers"][0]),
            "query_positions": arrays["query_positions"],
            "database_positions": arrays["database_positions"],
            "pool_positions": {name: arrays[f"positions_{number}"] for number, name in enumerate(names, start=1)},
            "threshold": float(arrays["threshold"]),
            "pool_name": names[0],
        }

    def _checked_k(self, k: int) -> int:
        if not is_integer(k) or k < 1:
            raise ValueError(f"k is {k!r}; allowed: whole numbers from 1")
        return int(k)

    def _sizes(self, ratios: Sequence[float]) -> np.ndarray:
        values = np.asarray(ratios, np.float64)
        if values.ndim != 1 or not ((values >= 0) & (values <= 1)).all():
            raise ValueError(f"ratios are {ratios!r}; allowed: a list of numbers from 0 to 1")
        return np.rint(values * self.n_distractors).astype(np.int64)

    def _limits(self, distances: Sequence[float]) -> np.ndarray:
        limits = np.asarray(distances, np.float64)
        if limits.ndim != 1 or not (limits >= self.threshold).all():
            allowed = f"a list of numbers from the threshold {self.threshold:g} up"
            raise ValueError(f"distances are {distances!r}; allowed: {allowed}")
        return limits


def is_integer(value: Any) -> bool:
    """Tell whole numbers from everything else, truth values among it."""
    return isinstance(value, (int, np.integer)) and not isinstance(value, bool)
