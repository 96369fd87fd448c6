"""One streaming pass of similarity tiles gives the per-query counts behind every metric.

Nothing is sorted, no similarity matrix is kept and no per-query database is built. A block of queries is multiplied
with the whole database, which gives each query's best positive and the number of database images that outrank it; then
tiles of distractors add theirs. When the distractors are the queries themselves, half of the tiles suffice. Views
(low-rank transforms of the descriptors) correct each tile instead of multiplying again.

The tiles are a first look. What they cannot tell apart is decided by :mod:`artifact.ranking.similarity`, so that counts,
ties and lists are those of the exact similarities, and the same on every machine.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache, cached_property, partial
from typing import Any

import numpy as np

from artifact.datasets.positives import positives_of
from artifact.ranking import counting, lenses
from artifact.ranking.arithmetic import Dots
from artifact.ranking.counting import Counts, Groups, Lens, Orders, Places, Target, Tile
from artifact.ranking.engines import Engine, engine_for
from artifact.ranking.lists import SPARE, Listed, top_lists
from artifact.ranking.products import Product
from artifact.ranking.similarity import Best, Looks, LowRank, Rows, Similarity, Transform, View, described, views_of

ORIGINAL = "original"
REVISION = 4  # raise when any count changes: it is part of the key of stored rankings

_TILE_SIDE = 1024
_LARGEST_ROWS = 2048
_PIECE = 2**17  # values of a tile that several views are counted in together
_PENDING = 2**20  # pairs that wait for their second look
_OF_A_VIEW = 0.1  # what second looks in a further view cost, in those of the first: most inner products are the same


@dataclass(frozen=True)
class Options:
    """What the pass keeps besides the counts, and how it runs.

    Attributes
    ----------
    similarity
        ``cosine`` scales every descriptor to unit length; ``dot`` and ``l2`` take them as they are.
    depth
        Sweeps over number and distance are available for K up to this.
    draws, seed
        Random orders of each pool, for the spread of the sweep over the number of distractors, and their seed.
    retrieve
        Length of the stored retrieval lists; 0 stores none.
    view_sweeps
        Whether views offer both sweeps too, which cost a view several times what its counts cost.
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
class Work:
    """How a pass went: the pairs of images and queries in all views, those looked at again, and exactly."""

    product: str
    pairs: int
    second_looks: int
    third_looks: int


@dataclass(frozen=True)
class Ranking:
    """Per-query counts of one evaluation: over the database by view, over the allowed distractors by view and pool.

    ``evaluated`` are the ``(n,)`` indices of the queries that have a positive, in the order of all per-query arrays;
    ``best_positive`` and ``similarity`` are the database index of each one's best positive, ``(n,)`` int64, and its
    similarity, ``(n,)`` float32, by view. ``work`` depends on the machine and is not stored.
    """

    evaluated: np.ndarray
    database: dict[str, Counts]
    pools: dict[tuple[str, str], Counts]
    best_positive: dict[str, np.ndarray]
    similarity: dict[str, np.ndarray]
    work: Work | None = None


def rank(
    queries: ImageSet,
    database: ImageSet,
    threshold: float,
    pools: Mapping[str, ImageSet | None],
    views: Mapping[str, LowRank] | None,
    options: Options,
) -> Ranking:
    """Rank every query's best positive against the database and against each distractor pool.

    The sets are checked; pools go by name, and ``None`` stands for the evaluated queries themselves. Raises
    ``ValueError`` if no query has a positive.
    """
    evaluated, starts, members = evaluated_queries(queries.positions, database.positions, threshold)
    if evaluated.size < len(queries):
        queries = ImageSet(queries.descriptors[evaluated], queries.positions[evaluated])
    transforms: dict[str, Transform | None] = {ORIGINAL: None}
    transforms |= {name: Transform(*view.low_rank()) for name, view in (views or {}).items()}
    images = [database, *(pool for pool in pools.values() if pool is not None)]
    with engine_for(options.device) as engine:
        rows, *others = described([s.descriptors for s in (queries, *images)], engine.executor)
        run = _Pass(engine, queries, rows, transforms, Groups(starts, members), threshold, options)
        run.choose_product(others[0], [*others[1:], *(rows for pool in pools.values() if pool is None)])
        in_database = run.over_database(database, others[0])
        left, in_pools = iter(others[1:]), {}
        for name, pool in pools.items():
            chosen = (queries, rows) if pool is None else (pool, next(left))
            in_pools[name] = run.over_pool(*chosen, len(database))
        similarity = {view: run.similarity(view) for view in transforms}
    return Ranking(
        evaluated=evaluated,
        database=in_database,
        pools={(view, name): counts[view] for name, counts in in_pools.items() for view in transforms},
        best_positive={view: run.best[view].index for view in transforms},
        similarity=similarity,
        work=run.work(),
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
        found = f"none of the {len(queries)} queries has a database image within the threshold {threshold:g}"
        remedy = "check that both positions use the same coordinates and that the threshold is in their unit"
        raise ValueError(f"{found}; {remedy}")
    return evaluated, np.concatenate([[0], np.cumsum(np.diff(starts)[evaluated])]), positives


class _Pass:
    """The state of a pass: what each view knows of the queries and of their best positives."""

    def __init__(
        self,
        engine: Engine,
        queries: ImageSet,
        rows: Rows,
        transforms: Mapping[str, Transform | None],
        positives: Groups,
        threshold: float,
        options: Options,
    ) -> None:
        self.engine, self.queries, self.rows, self.positives = engine, queries, rows, positives
        self.transforms, self.threshold, self.options = transforms, threshold, options
        self.views = views_of(rows, transforms)
        self.best = {view: Best.empty(len(queries)) for view in transforms}
        self.looks: dict[str, Looks] = {}
        self._listed: dict[str, Listed] = {}
        self._limits: dict[str, np.ndarray] = {}
        self._pairs = self._second = self._third = 0

    def work(self) -> Work:
        """Say how the pass went."""
        return Work(self.engine.product_kind.name, self._pairs, self._second, self._third)

    def similarity(self, view: str) -> np.ndarray:
        """Return the similarities of the queries and their best positives."""
        best = self.best[view]
        return self.looks[view].rounded(np.arange(len(self.queries)), best.index, best.level, best.doubt)

    def choose_product(self, database: Rows, pools: list[Rows]) -> None:
        """Let the engine choose its product, knowing what the second looks of each would cost."""
        n, d = self.rows.descriptors.shape
        columns = len(database) + sum(len(pool) // (2 if pool is self.rows else 1) for pool in pools)

        @cache
        def sample() -> lenses.Sample:
            plain = [views_of(rows, {ORIGINAL: None})[ORIGINAL] for rows in (database, *pools) if len(rows)]
            looks = self._looks(plain[0], self._dots(database), ORIGINAL)
            return lenses.Sample(self.rows, self.positives, looks, plain)

        def look_seconds(product: Product) -> float:
            views = 1 + (len(self.transforms) - 1) * _OF_A_VIEW
            return sample().unsure(product) * sample().pair_seconds * views

        self.engine.choose(n * columns * d, look_seconds)

    def over_database(self, database: ImageSet, rows: Rows) -> dict[str, Counts]:
        """Multiply blocks of queries with the whole database: best positives, and the images that outrank them."""
        options, n, everything = self.options, len(self.queries), slice(0, len(database))
        columns = views_of(rows, self.transforms)
        dots = self._dots(rows)
        self.looks = {view: self._looks(columns[view], dots, view) for view in self.transforms}
        for view in self.transforms:
            self._limits[view] = lenses.limits(self.views[view], columns[view], options.similarity)
        seen = self._lenses(columns)
        none = Groups(np.zeros(n + 1, np.int64), np.zeros(0, np.int64))
        kept = {view: _Kept(Counts.empty(n, options.depth, 0), n, options.retrieve) for view in self.transforms}
        step = max(1, min(_LARGEST_ROWS, options.memory // (4 * len(database))))
        for block in _blocks(n, step):
            values = self.engine.product(self.queries.descriptors, block, database.descriptors, everything)
            tile = Tile(values, block.start, 0)
            starts = self.positives.starts[block.start : block.stop + 1]
            members = self.positives.members[starts[0] : starts[-1]]
            owners = np.repeat(np.arange(block.stop - block.start), np.diff(starts))
            found = self.engine.gather(values, owners, members)
            rows, targets = block.stop - block.start, {}
            near_best = partial(counting.near_best, found, positives=self.positives, first_row=block.start, rows=rows)
            for view, near in zip(seen, self.engine.executor.map(near_best, seen.values()), strict=True):
                self.best[view].find(near[0], near[1], self.looks[view])
                targets[view] = lenses.target(self.best[view], self._limits[view])

            def count(view: str, lens: Lens, shown: Tile, targets: dict[str, Target] = targets) -> np.ndarray:
                if options.retrieve:
                    self.engine.top(shown, lens, none, *kept[view].top)
                return self.engine.count(shown, lens, targets[view], self.positives, kept[view].counts)

            for view, pairs in self._in_views(tile, seen, count):
                self._wait(kept[view], pairs, view, self.looks[view], None)
        for view, lens in seen.items():
            self._decide(kept[view], view, self.looks[view], None)
            self._listed[view] = Listed(*kept[view].top, lens, self.looks[view], lambda _: np.arange(len(database)), 0)
        self._pairs += n * len(database) * len(self.transforms)
        return {view: self._finished(kept[view], [self._listed[view]]) for view in self.transforms}

    def over_pool(self, pool: ImageSet, rows: Rows, n_database: int) -> dict[str, Counts]:
        """Count the allowed distractors of one pool that outrank each query's best positive."""
        options, n, own = self.options, len(self.queries), pool is self.queries
        columns = self.views if own else views_of(rows, self.transforms)
        dots = self._dots(rows)
        looks = {view: self._looks(columns[view], dots, view) for view in self.transforms}
        seen, targets = self._lenses(columns), {}
        for view in self.transforms:
            targets[view] = lenses.target(self.best[view], self._limits[view])
        placed = draw_orders(len(pool), options)
        orders = Orders(placed, placed.min(axis=1, initial=len(pool)))
        places = Places(self.queries.positions, pool.positions, self.threshold)
        near = Groups(*positives_of(*places)) if len(pool) else Groups(np.zeros(n + 1, np.int64), np.zeros(0, np.int64))
        swept = {view for view in self.transforms if view == ORIGINAL or options.view_sweeps or options.retrieve}
        lists = options.depth, options.draws
        kept = {
            view: _Kept(Counts.empty(n, *(lists if view in swept else (0, 0))), n, options.retrieve)
            for view in self.transforms
        }

        def count(view: str, lens: Lens, shown: Tile) -> np.ndarray:
            if view in swept:
                self.engine.sweep(shown, lens, targets[view], places, orders, kept[view].counts)
            if options.retrieve:
                self.engine.top(shown, lens, near, *kept[view].top)
            return self.engine.count(shown, lens, targets[view], near, kept[view].counts)

        values_at_once = options.memory // (4 * 2)  # each may be there twice
        step = max(1, min(_TILE_SIDE, math.isqrt(values_at_once)))
        for block, cols in _tiles(n, len(pool), step, values_at_once // step, symmetric=own):
            values = self.engine.product(self.queries.descriptors, block, pool.descriptors, cols)
            halves = [Tile(values, block.start, cols.start)]
            if own and cols.stop > block.stop:  # what is right of the diagonal stands for what is below it
                first = max(block.stop, cols.start)
                halves.append(Tile(self.engine.transposed(values[:, first - cols.start :]), first, block.start))
            for view, pairs in itertools.chain.from_iterable(self._in_views(half, seen, count) for half in halves):
                self._wait(kept[view], pairs, view, looks[view], (places, orders) if view in swept else None)
        self._pairs += n * len(pool) * len(self.transforms)
        found = {}
        for view, lens in seen.items():
            self._decide(kept[view], view, looks[view], (places, orders) if view in swept else None)
            listed = Listed(*kept[view].top, lens, looks[view], _others(near, len(pool)), n_database)
            found[view] = self._finished(kept[view], [self._listed[view], listed])
        return found

    def _dots(self, images: Rows) -> Dots:
        return Dots(self.rows.descriptors, images.descriptors, self.engine.executor)

    def _looks(self, images: View, dots: Dots, view: str) -> Looks:
        return Looks(self.views[view], images, self.options.similarity, dots)

    def _lenses(self, columns: Mapping[str, View]) -> dict[str, Lens]:
        kind, theirs = self.options.similarity, columns[ORIGINAL].rows
        left = self._terms[0]
        right = self._terms[1] if theirs is self.rows else self._terms_of(theirs)[1]
        found: dict[str, Lens] = {}
        for view in self.transforms:
            before = next(reversed(found.values()), None)
            limit = self._limits[view]
            found[view] = lenses.lens(self.views[view], columns[view], kind, (left, right), limit, before)
        return found

    @cached_property
    def _terms(self) -> tuple[np.ndarray, np.ndarray]:
        return self._terms_of(self.rows)

    def _terms_of(self, rows: Rows) -> tuple[np.ndarray, np.ndarray]:
        return self.engine.product_kind.terms(rows.descriptors, np.sqrt(rows.squared))

    def _in_views(
        self, tile: Tile, seen: Mapping[str, Lens], count: Callable[[str, Lens, Tile], np.ndarray]
    ) -> Iterator[tuple[str, np.ndarray]]:
        """Count in a tile as each view shows it, and yield the pairs in doubt."""

        def work(piece: Tile) -> list[np.ndarray]:
            found, shown = [], piece
            for view, lens in seen.items():
                shown = self.engine.shown(shown if lens.shared else piece, lens)
                found.append(count(view, lens, shown))
            return found

        # What several views show of a piece is to stay in the cache of a core.
        largest = len(tile.values) if len(seen) == 1 else max(1, _PIECE // tile.values.shape[1])
        yield from zip(
            seen, map(np.concatenate, zip(*self.engine.in_pieces(tile, work, largest), strict=True)), strict=True
        )

    def _wait(
        self, kept: _Kept, pairs: np.ndarray, view: str, looks: Looks, sweeps: tuple[Places, Orders] | None
    ) -> None:
        """Keep pairs for their second look, which many take together."""
        kept.pending.append(pairs)
        if sum(map(len, kept.pending)) > _PENDING:
            self._decide(kept, view, looks, sweeps)

    def _decide(self, kept: _Kept, view: str, looks: Looks, sweeps: tuple[Places, Orders] | None) -> None:
        """Decide the pairs that wait, and count them."""
        pairs = np.concatenate([np.zeros((0, 2), np.int64), *kept.pending])
        kept.pending.clear()
        signs, undecided = looks.signs(pairs[:, 0], pairs[:, 1], self.best[view], self.looks[view])
        self._second += len(pairs)
        self._third += undecided
        np.add.at(kept.counts.outranking, pairs[signs > 0, 0], 1)
        np.add.at(kept.counts.ties, pairs[signs == 0, 0], 1)
        if sweeps is not None:
            counting.sweep_pairs(pairs[signs > 0], *sweeps, kept.counts)

    def _finished(self, kept: _Kept, sets: list[Listed]) -> Counts:
        k = self.options.retrieve
        if not k:
            return kept.counts
        similarity, index = top_lists(len(self.queries), k, sets)
        return kept.counts._replace(top_similarity=similarity, top_index=index)


class _Kept:
    """What is kept of a view while tiles go by."""

    def __init__(self, counts: Counts, n: int, retrieve: int) -> None:
        self.counts, self.pending = counts, list[np.ndarray]()
        shape = n, 2 * retrieve + SPARE
        self.top = (np.full(shape, -np.inf, np.float32), np.full(shape, -1, np.int64))


def _others(near: Groups, n: int) -> Callable[[int], np.ndarray]:
    """Return what lists the images that a query may use."""
    return lambda query: np.setdiff1d(np.arange(n), near.members[near.starts[query] : near.starts[query + 1]])


def draw_orders(n: int, options: Options) -> np.ndarray:
    """Return ``(n, draws)`` int32: the place of each pool image in each random order."""
    generator = np.random.default_rng(options.seed)
    drawn = [generator.permutation(n).astype(np.int32) for _ in range(options.draws)]
    return np.stack(drawn, axis=1) if drawn else np.empty((n, 0), np.int32)


def _blocks(n: int, step: int) -> Iterator[slice]:
    for start in range(0, n, step):
        yield slice(start, min(start + step, n))


def _tiles(n_rows: int, n_columns: int, step: int, width: int, *, symmetric: bool) -> Iterator[tuple[slice, slice]]:
    """Yield row and column slices; if symmetric, nothing that lies left of the squares on the diagonal."""
    for rows in _blocks(n_rows, step):
        for start in range(rows.start if symmetric else 0, n_columns, width):
            yield rows, slice(start, min(start + width, n_columns))
