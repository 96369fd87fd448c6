"""One streaming pass of similarity tiles gives the per-query counts behind every metric.

Nothing is sorted, no similarity matrix is kept and no per-query database is built. A block of queries is multiplied with
the whole database, which gives each query's best positive and the number of database images that outrank it; then tiles
of distractors add theirs. When the distractors are the queries themselves, half of the tiles suffice. Views (low-rank
transforms of the descriptors) correct each tile instead of multiplying again.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np

from artifact.datasets.positives import positives_of
from artifact.ranking.counting import Counts, Groups, Places, Tile
from artifact.ranking.engines import Engine, engine_for

Similarity = Literal["cosine", "dot", "l2"]

ORIGINAL = "original"
REVISION = 3  # raise when any count changes: it is part of the key of stored rankings

_TILE_SIDE = 1024
_LARGEST_ROWS = 2048
_NEGLIGIBLE = 1e-5  # of a projection, in float32


class LowRank(Protocol):
    """A transform ``r(x) = x - left @ (right.T @ x - offset)`` that can be evaluated as a view."""

    def low_rank(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]: ...  # noqa: D102


@dataclass(frozen=True)
class Options:
    """What the pass keeps besides the counts, and how it runs.

    Attributes
    ----------
    similarity
        ``cosine`` scales every descriptor to unit length; ``dot`` and ``l2`` take them as they are.
    depth
        Sweeps over number and distance are available for K up to this.
    draws
        Random orders of each pool, for the spread of the sweep over the number of distractors.
    retrieve
        Length of the stored retrieval lists; 0 stores none.
    view_sweeps
        Whether views offer both sweeps too, which cost a view several times what its counts cost.
    seed
        Seed of the random orders.
    memory
        Bytes that similarity tiles may take together.
    device
        ``None`` takes CUDA if there is any, else the CPU.
    """

    similarity: Similarity = "cosine"
    depth: int = 10
    draws: int = 10
    retrieve: int = 0
    view_sweeps: bool = False
    seed: int = 0
    memory: int = 256 * 2**20
    device: Any = None


@dataclass(frozen=True)
class ImageSet:
    """Descriptors ``(n, d)`` float32 or float16 with positions ``(n, p)`` float64, in the same order."""

    descriptors: np.ndarray
    positions: np.ndarray

    def __len__(self) -> int:
        return len(self.positions)


@dataclass(frozen=True)
class Ranking:
    """Per-query counts of one evaluation: all that the metrics need.

    Attributes
    ----------
    evaluated
        ``(n,)`` indices of the queries that have a positive; all per-query arrays follow this order.
    database
        Counts over the database, by view.
    pools
        Counts over the allowed distractors, by view and pool.
    similarity
        ``(n,)`` float32 similarity of each query and its best positive, by view.
    """

    evaluated: np.ndarray
    database: dict[str, Counts]
    pools: dict[tuple[str, str], Counts]
    similarity: dict[str, np.ndarray]


def rank(
    queries: ImageSet,
    database: ImageSet,
    threshold: float,
    pools: Mapping[str, ImageSet | None],
    views: Mapping[str, LowRank] | None = None,
    options: Options | None = None,
) -> Ranking:
    """Rank every query's best positive against the database and against each distractor pool.

    The sets are checked; pools go by name, and ``None`` stands for the evaluated queries themselves. Raises ``ValueError`` if no
    query has a positive.
    """
    options = options or Options()
    evaluated, starts, positives = evaluated_queries(queries.positions, database.positions, threshold)
    if evaluated.size < len(queries):
        queries = ImageSet(queries.descriptors[evaluated], queries.positions[evaluated])
    transforms: dict[str, LowRank | None] = {ORIGINAL: None, **(views or {})}
    factors = _factors(queries, transforms, options.similarity)
    with engine_for(options.device) as engine:
        run = _Pass(engine, queries, factors, threshold, transforms, options)
        in_database = run.over_database(database, starts, positives)
        best = {view: counts.best for view, counts in in_database.items()}
        in_pools = {name: run.over_pool(queries if pool is None else pool, best) for name, pool in pools.items()}
    return Ranking(
        evaluated=evaluated,
        database=in_database,
        pools={(view, name): counts[view] for name, counts in in_pools.items() for view in transforms},
        similarity={view: factors[view].similarity(best[view], options.similarity) for view in transforms},
    )


def evaluated_queries(
    queries: np.ndarray, database: np.ndarray, threshold: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return which queries have a positive, and their positives: those of the i-th are ``[starts[i]:starts[i + 1]]``.

    Raises ``ValueError`` if there is none.
    """
    starts, positives = positives_of(queries, database, threshold)
    evaluated = np.flatnonzero(np.diff(starts))
    if evaluated.size == 0:
        raise ValueError(
            f"none of the {len(queries)} queries has a database image within the threshold {threshold:g}; "
            f"check that both positions use the same coordinates and that the threshold is in their unit"
        )
    return evaluated, np.concatenate([[0], np.cumsum(np.diff(starts)[evaluated])]), positives


@dataclass(frozen=True)
class _Factors:
    """An image set in one view: as rows, and as columns ``(tile - left @ right.T) * scale + bias``."""

    left: np.ndarray
    right: np.ndarray
    scale: np.ndarray
    bias: np.ndarray

    def similarity(self, best: np.ndarray, kind: Similarity) -> np.ndarray:
        """Complete similarities with these rows, which lack what is the same for all columns."""
        return best * self.scale if kind == "cosine" else best + self.bias


@dataclass(frozen=True)
class _Pass:
    engine: Engine
    queries: ImageSet
    rows: Mapping[str, _Factors]
    threshold: float
    transforms: Mapping[str, LowRank | None]
    options: Options

    def over_database(self, database: ImageSet, starts: np.ndarray, positives: np.ndarray) -> dict[str, Counts]:
        """Multiply blocks of queries with the whole database: best positives, and the images that outrank them."""
        options, n = self.options, len(self.queries)
        columns = _factors(database, self.transforms, options.similarity)
        counts = {view: Counts.empty(n, options.depth, 0, options.retrieve) for view in self.transforms}
        copies = 2 if len(self.transforms) > 1 else 1
        # Every view reads the tile again: a smaller one stays nearer to the processor.
        largest = _LARGEST_ROWS if copies == 1 else _LARGEST_ROWS // 4
        step = max(1, min(largest, options.memory // (4 * copies * len(database))))
        for rows in _blocks(n, step):
            values = self.engine.product(self.queries.descriptors, rows, database.descriptors, slice(0, len(database)))
            for view in self.transforms:
                tile = self._tile(view, values, rows, columns[view], slice(0, len(database)))
                self.engine.count_database(tile, Groups(starts, positives), counts[view])
        return counts

    def over_pool(self, pool: ImageSet, best: Mapping[str, np.ndarray]) -> dict[str, Counts]:
        """Count the allowed distractors of one pool that outrank each query's best positive."""
        options, n = self.options, len(self.queries)
        own = pool is self.queries
        columns = self.rows if own else _factors(pool, self.transforms, options.similarity)
        bare = {view for view in self.transforms if view != ORIGINAL and not (options.view_sweeps or options.retrieve)}
        kept = options.depth, options.draws, options.retrieve
        counts = {view: Counts.empty(n, *((0, 0, 0) if view in bare else kept)) for view in self.transforms}
        for view in self.transforms:
            counts[view].best[:] = best[view]
        orders = draw_orders(len(pool), options)
        places = Places(self.queries.positions, pool.positions, self.threshold)
        near = Groups(*positives_of(*places)) if bare else None
        copies = 4 if len(self.transforms) > 1 else 2
        step = max(1, min(_TILE_SIDE, math.isqrt(options.memory // (4 * copies))))
        for rows, cols, mirrored in _tiles(n, len(pool), step, symmetric=own):
            values = self.engine.product(self.queries.descriptors, rows, pool.descriptors, cols)
            halves = [(values, rows, cols)]
            if mirrored:
                halves.append((self.engine.transposed(values), cols, rows))
            for view in self.transforms:
                for half, above, across in halves:
                    tile = self._tile(view, half, above, columns[view], across)
                    if near is not None and view in bare:
                        self.engine.count_pool_only(tile, places, near, counts[view])
                    else:
                        self.engine.count_pool(tile, places, orders, counts[view])
        return counts

    def _tile(self, view: str, values: Any, rows: slice, columns: _Factors, across: slice) -> Tile:
        correction = self.engine.correction(self.rows[view].left[rows], columns.right[across])
        return Tile(values, correction, columns.scale[across], columns.bias[across], rows.start, across.start)


def _factors(images: ImageSet, transforms: Mapping[str, LowRank | None], similarity: Similarity) -> dict[str, _Factors]:
    """Project an image set once for all views; norms turn dot products into the chosen similarity.

    With ``a = right.T x - offset``, ``u = left.T x`` and ``G = left.T left``, the transformed dot product is
    ``q'c' = qc - a_q u_c - (u_q - G a_q) a_c``. For an orthogonal projection the last term vanishes.
    """
    squared = squared_norms(images.descriptors)
    factors = {}
    bases = {view: [np.asarray(part, np.float32) for part in t.low_rank()] for view, t in transforms.items() if t}
    projected = _project(images.descriptors, [part for left, right, _ in bases.values() for part in (left, right)])
    for view in transforms:
        left_factor = right_factor = np.zeros((len(images), 0), np.float32)
        change = 0.0
        if view in bases:
            left, _, offset = bases[view]
            u, a = next(projected), next(projected) - offset
            remainder = u - a @ (left.T @ left)
            change = -sum(np.einsum("nk,nk->n", *both, dtype=np.float64) for both in ((a, u), (remainder, a)))
            left_factor, right_factor = np.concatenate([a, remainder], axis=1), np.concatenate([u, a], axis=1)
            if a.size and np.abs(remainder).max() <= _NEGLIGIBLE * max(np.abs(a).max(), np.abs(u).max()):
                left_factor, right_factor = np.ascontiguousarray(a), np.ascontiguousarray(u)
        norms = np.maximum(squared + change, 0.0)
        factors[view] = _Factors(_padded(left_factor), _padded(right_factor), *_scale_and_bias(norms, similarity))
    return factors


def _padded(factor: np.ndarray) -> np.ndarray:
    """Add empty columns up to a multiple of 4: products of thin matrices of other widths take nearly twice the time."""
    return np.pad(factor, ((0, 0), (0, -factor.shape[1] % 4)))


def _scale_and_bias(squared: np.ndarray, similarity: Similarity) -> tuple[np.ndarray, np.ndarray]:
    ones, zeros = np.ones(len(squared), np.float32), np.zeros(len(squared), np.float32)
    if similarity == "cosine":
        inverse = np.divide(1.0, np.sqrt(squared), out=np.zeros_like(squared), where=squared > 0)
        return inverse.astype(np.float32), zeros
    return (2 * ones, -squared.astype(np.float32)) if similarity == "l2" else (ones, zeros)


def squared_norms(descriptors: np.ndarray) -> np.ndarray:
    """Return ``(n,)`` float64 squared lengths, a block of rows at a time."""
    squared = np.empty(len(descriptors))
    for rows in _blocks(len(descriptors), max(1, 2**22 // max(1, descriptors.shape[1]))):
        block = descriptors[rows].astype(np.float64)
        squared[rows] = np.einsum("nd,nd->n", block, block)
    return squared


def _project(descriptors: np.ndarray, bases: list[np.ndarray]) -> Iterator[np.ndarray]:
    """Yield the projection on each basis, from one product with the directions that differ: INLP's views share theirs."""
    if not bases:
        return
    places: dict[bytes, int] = {}
    transposed = [np.ascontiguousarray(basis.T) for basis in bases]
    chosen = [[places.setdefault(column.tobytes(), len(places)) for column in basis] for basis in transposed]
    directions = np.frombuffer(b"".join(places), np.float32).reshape(len(places), descriptors.shape[1])
    out = np.empty((len(descriptors), len(places)), np.float32)
    for rows in _blocks(len(descriptors), max(1, 2**23 // max(1, descriptors.shape[1]))):
        np.matmul(descriptors[rows].astype(np.float32, copy=False), directions.T, out=out[rows])
    for columns in chosen:
        yield np.ascontiguousarray(out[:, columns])


def draw_orders(n: int, options: Options) -> np.ndarray:
    """Return ``(n, draws)`` int32: the place of each pool image in each random order."""
    generator = np.random.default_rng(options.seed)
    drawn = [generator.permutation(n).astype(np.int32) for _ in range(options.draws)]
    return np.stack(drawn, axis=1) if drawn else np.empty((n, 0), np.int32)


def _blocks(n: int, step: int) -> Iterator[slice]:
    for start in range(0, n, step):
        yield slice(start, min(start + step, n))


def _tiles(n_rows: int, n_columns: int, step: int, *, symmetric: bool) -> Iterator[tuple[slice, slice, bool]]:
    """Yield row and column slices; ``True`` marks a tile whose mirror image is not computed on its own."""
    for rows in _blocks(n_rows, step):
        for cols in _blocks(n_columns, step):
            if not symmetric:
                yield rows, cols, False
            elif cols.start >= rows.start:
                yield rows, cols, cols.start > rows.start
