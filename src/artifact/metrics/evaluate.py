""":func:`evaluate`: from descriptors and positions to R@K, DAR@K, RSR@K and both sweeps."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from artifact import store
from artifact.datasets.positives import as_columns
from artifact.metrics.evaluation import Evaluation
from artifact.metrics.result import QUERY_POOL, is_integer
from artifact.ranking.one_pass import ImageSet, Options, rank
from artifact.ranking.similarity import LowRank, Similarity, squared_norms

_UNIT_TOLERANCE = 1e-3


def evaluate(
    queries: np.ndarray,
    database: np.ndarray,
    query_positions: np.ndarray,
    database_positions: np.ndarray,
    threshold: float,
    distractors: np.ndarray | Mapping[str, np.ndarray] | None = None,
    distractor_positions: np.ndarray | Mapping[str, np.ndarray] | None = None,
    *,
    views: Mapping[str, LowRank] | None = None,
    similarity: Similarity = "cosine",
    device: Any = None,
    depth: int = 10,
    draws: int = 10,
    retrieve: int = 0,
    view_sweeps: bool = False,
    seed: int = 0,
    memory: int = 256 * 2**20,
) -> Evaluation:
    """Evaluate descriptors: R@K, DAR@K and RSR@K for every K, and both sweeps, from one pass.

    Parameters
    ----------
    queries, database
        Descriptors ``(n, d)``, float32 or float16.
    query_positions, database_positions
        Positions ``(n, p)`` or ``(n,)`` in metres, or frame or pair indices.
    threshold
        A database image at most this far from a query is a positive; a pool image farther than it is an allowed
        distractor. Same unit as the positions.
    distractors, distractor_positions
        Distractor pool, or several by name. ``None`` takes the evaluated queries themselves, the paper's main
        setting; ``{}`` takes none, so that DAR@K equals R@K.
    views
        Suppression transforms to evaluate in the same pass, by name.
    similarity
        ``"cosine"`` (descriptors are scaled to unit length, again after a view), ``"l2"`` or ``"dot"`` (they are
        taken as they are, and must come with unit length).
    device, depth, draws, retrieve, view_sweeps, seed, memory
        As in :class:`artifact.ranking.one_pass.Options`.

    Raises
    ------
    TypeError
        If descriptors are not float32 or float16 arrays.
    ValueError
        If shapes do not fit, values are not finite, a length is zero (or not one, for ``l2`` and ``dot``), the
        threshold is negative, or no query has a positive.

    Examples
    --------
    Two places, seen by day (queries) and by night (database). The descriptor's first value tells day from night
    strongly and the others tell the places apart weakly, so each query prefers the other day image.

    >>> import numpy as np
    >>> day = np.array([[3, 1, 0], [3, 0, 1]], dtype=np.float32)
    >>> night = np.array([[-3, 1, 0], [-3, 0, 1]], dtype=np.float32)
    >>> where = np.array([[0.0], [100.0]])
    >>> result = evaluate(day, night, where, where, threshold=25)
    >>> result.recall(1), result.dar(1), result.rsr(1), result.dar(2)
    (1.0, 0.0, 0.0, 1.0)
    >>> evaluate(day, night, where, where, threshold=25, distractors={}).dar(1)
    1.0
    >>> result.per_query()[["query", "rank", "rank_with_distractors", "best_positive"]]
       query  rank  rank_with_distractors  best_positive
    0      0     1                      2              0
    1      1     1                      2              1
    """
    options = _checked(Options(similarity, depth, draws, retrieve, view_sweeps, seed, memory, device))
    threshold = float(threshold)
    if not np.isfinite(threshold) or threshold < 0:
        raise ValueError(f"threshold is {threshold!r}; allowed: finite numbers from 0, in metres or frames")
    query_set = _image_set("queries", queries, query_positions, similarity)
    database_set = _image_set("database", database, database_positions, similarity, query_set)
    pools = _pools(distractors, distractor_positions, query_set, similarity)
    with store.stage("rank"):
        ranking = rank(query_set, database_set, threshold, pools, views, options)
    evaluated = query_set.positions[ranking.evaluated]
    return Evaluation(
        evaluated=ranking.evaluated,
        n_listed=len(query_set),
        ranking=ranking,
        query_positions=evaluated,
        database_positions=database_set.positions,
        pool_positions={name: evaluated if pool is None else pool.positions for name, pool in pools.items()},
        threshold=threshold,
        pool_name=next(iter(pools)),
    )


def _checked(options: Options) -> Options:
    if options.similarity not in ("cosine", "l2", "dot"):
        raise ValueError(f"similarity is {options.similarity!r}; allowed: 'cosine', 'l2', 'dot'")
    for name, lowest in {"depth": 1, "draws": 0, "retrieve": 0, "seed": 0, "memory": 2**20}.items():
        value = getattr(options, name)
        if not is_integer(value) or value < lowest:
            raise ValueError(f"{name} is {value!r}; allowed: whole numbers from {lowest}")
    if not isinstance(options.view_sweeps, bool):
        raise TypeError(f"view_sweeps is {options.view_sweeps!r}; allowed: True, False")
    return options


def _pools(distractors: Any, positions: Any, queries: ImageSet, similarity: Similarity) -> dict[str, ImageSet | None]:
    if distractors is None:
        if positions is not None:
            raise ValueError("distractor_positions are given without distractors")
        return {QUERY_POOL: None}
    named = isinstance(distractors, Mapping)
    if named and not distractors and (positions is None or positions == {}):
        return {"none": ImageSet(queries.descriptors[:0], queries.positions[:0])}
    if positions is None:
        raise ValueError("distractors are given without distractor_positions")
    if named != isinstance(positions, Mapping):
        raise TypeError("distractors and distractor_positions must both be arrays or both be mappings by name")
    if not named:
        distractors, positions = {"distractors": distractors}, {"distractors": positions}
    if set(distractors) != set(positions):
        found = f"distractors are named {sorted(distractors)}, distractor_positions {sorted(positions)}"
        raise ValueError(f"{found}; both need the same names")
    return {
        name: _image_set(f"distractors {name!r}", images, positions[name], similarity, queries)
        for name, images in distractors.items()
    }


def _image_set(
    name: str, descriptors: Any, positions: Any, similarity: str, queries: ImageSet | None = None
) -> ImageSet:
    """Check images, also against the queries that they are compared with."""
    if not isinstance(descriptors, np.ndarray) or descriptors.dtype not in (np.float32, np.float16):
        kind = f"an array of {descriptors.dtype}" if isinstance(descriptors, np.ndarray) else type(descriptors).__name__
        raise TypeError(f"{name}: descriptors are {kind}; allowed: NumPy arrays of float32 or float16")
    if descriptors.ndim != 2 or 0 in descriptors.shape:
        raise ValueError(f"{name}: descriptors have the shape {descriptors.shape}; allowed: (n, d), neither zero")
    where = as_columns(positions)
    if where.ndim != 2 or where.shape[0] != len(descriptors) or where.shape[1] == 0:
        found = f"the shape {np.shape(positions)} for {len(descriptors)} descriptors"
        raise ValueError(f"{name}: positions have {found}; allowed: ({len(descriptors)}, p)")
    lengths = np.sqrt(squared_norms(descriptors))
    for wrong, message in (
        (~np.isfinite(where).all(axis=1), "the position of row {row} is not finite"),
        (~np.isfinite(lengths), "row {row} of the descriptors has NaN or infinite values"),
        (lengths == 0, "row {row} of the descriptors is all zeros and has no direction"),
        (
            (similarity != "cosine") & (np.abs(lengths - 1) > _UNIT_TOLERANCE),
            "row {row} has length {length:.4g}; similarity {similarity!r} needs unit-length descriptors: "
            "divide each row by its length, or use 'cosine'",
        ),
    ):
        if wrong.any():
            row = int(wrong.argmax())
            raise ValueError(f"{name}: " + message.format(row=row, length=lengths[row], similarity=similarity))
    images = ImageSet(descriptors, np.ascontiguousarray(where))
    for kind in ("descriptors", "positions"):
        ours, theirs = getattr(images, kind).shape[1], getattr(queries or images, kind).shape[1]
        if ours != theirs:
            raise ValueError(f"{kind} have {theirs} columns in queries and {ours} in {name}")
    return images
