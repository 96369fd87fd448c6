"""Counts are those of the exact similarities, whatever multiplies, on inputs made to mislead."""

import time
from concurrent.futures import ThreadPoolExecutor
from fractions import Fraction
from math import isqrt

import numpy as np
import pytest
import torch
from oracle import Case, evaluated_queries

from artifact import INLP, LEACE, evaluate
from artifact.ranking import arithmetic, lenses, one_pass, products, similarity
from artifact.ranking.engine_torch import TorchEngine
from artifact.ranking.engines import CpuEngine
from artifact.studies.how_fast import synthetic
from artifact.suppression.compiled import threads
from artifact.suppression.lowrank import LowRankMap

PRODUCTS = products.every()
FLOAT32, TORCH, BFLOAT16 = PRODUCTS[:3]
ENGINES = [lambda _, p=p: CpuEngine(p) for p in PRODUCTS]
ENGINES += [lambda _, p=p: TorchEngine(torch.device("cpu"), p) for p in (TORCH, BFLOAT16)]
NAMES = [*(p.name for p in PRODUCTS), "other device, float32", "other device, bfloat16"]


def fractions(row):
    return [Fraction(value) for value in np.asarray(row, np.float64).tolist()]


def mapped(row, transform):
    """A row under a low-rank map, in rational numbers."""
    if transform is None:
        return fractions(row)
    x = fractions(row)
    left, right = ([fractions(column) for column in part.T] for part in (transform.left, transform.right))
    changes = [
        sum(r * v for r, v in zip(column, x, strict=True)) - o
        for column, o in zip(right, fractions(transform.offset), strict=True)
    ]
    return [v - sum(column[i] * change for column, change in zip(left, changes, strict=True)) for i, v in enumerate(x)]


def key(kind, q, c):
    """What orders images for a query as the similarity does, a rational number."""
    product = sum(a * b for a, b in zip(q, c, strict=True))
    squared = sum(b * b for b in c)
    if kind == "cosine":
        return product * abs(product) / squared if squared else Fraction(0)
    return 2 * product - squared if kind == "l2" else product


def counted(case, kind="cosine", transform=None):
    """Images that outrank the best positive, and ties, over database and distractors, by definition in rationals."""
    kept = evaluated_queries(case)
    queries, database = ([mapped(row, transform) for row in rows] for rows in (case.queries[kept], case.database))
    where = case.query_positions[kept]
    rows = []
    for i, query in enumerate(queries):
        keys = [key(kind, query, image) for image in database]
        positive = np.linalg.norm(case.database_positions - where[i], axis=1) <= case.threshold
        best = max(k for k, p in zip(keys, positive, strict=True) if p)
        first = next(j for j, k in enumerate(keys) if positive[j] and k == best)
        far = np.linalg.norm(where - where[i], axis=1) > case.threshold
        pool = [key(kind, query, image) for image, allowed in zip(queries, far, strict=True) if allowed]
        others = [k for k, p in zip(keys, positive, strict=True) if not p]
        order = sorted(range(len(keys)), key=lambda j: (-keys[j], j))[:3]
        rows.append([first, *(sum(k > best for k in ks) for ks in (others, pool))])
        rows[-1] += [*(sum(k == best for k in ks) for ks in (others, pool)), *order]
    return np.array(rows)


def found(case, kind="cosine", transform=None):
    views = {} if transform is None else {"view": transform}
    result = evaluate(
        case.queries,
        case.database,
        case.query_positions,
        case.database_positions,
        case.threshold,
        views=views,
        similarity=kind,
        retrieve=3,
        view_sweeps=True,
    )
    seen = result if transform is None else result["view"]
    counts = [seen.database_counts, seen.distractor_counts]
    columns = [seen.per_query()["best_positive"], *(c.outranking for c in counts), *(c.ties for c in counts)]
    assert result.ranking.work.second_looks >= result.ranking.work.third_looks >= 0
    beyond = seen.hits_by_distance([case.threshold, np.inf])
    np.testing.assert_array_equal(beyond[:, 0], seen.hits(distractors=True))
    return np.column_stack([*columns, seen.retrieved(3, distractors=False)[0]])


def unit(rows):
    return (rows / np.linalg.norm(rows, axis=1, keepdims=True)).astype(np.float32)


def base(seed, n=24, d=32):
    rng = np.random.default_rng(seed)
    return rng, rng.standard_normal((n, d)).astype(np.float32), rng.standard_normal((n, d)).astype(np.float32)


def near_duplicates(seed):
    """Images that differ from one of four in one place by one unit in the last one."""
    rng, _, _ = base(seed)
    originals = rng.standard_normal((4, 32)).astype(np.float32)
    sets = []
    for _ in range(2):
        rows = originals[rng.integers(0, 4, 24)].copy()
        for row in rows[8:]:
            column = rng.integers(0, 32)
            row[column] = np.nextafter(row[column], np.float32(rng.choice([-9, 9])))
        sets.append(rows)
    return sets


def cancelling(seed):
    """A large common part that leaves differences in the last digits."""
    rng, queries, database = base(seed)
    common = 1e4 * rng.standard_normal(32).astype(np.float32)
    return common + queries, common + database


def codes(seed):
    _, queries, database = base(seed)
    return [np.where(rows > 0, 1, -1).astype(np.float32) for rows in (queries, database)]


def sparse(seed):
    _, queries, database = base(seed)
    return [np.round(rows).astype(np.float32) + np.eye(24, 32, dtype=np.float32) * 4 for rows in (queries, database)]


def scaled(seed):
    """The same directions at other lengths, all exact ties of cosines."""
    rng, queries, _ = base(seed)
    database = queries[rng.integers(0, 6, 24)] * np.float32(2) ** rng.integers(-4, 5, (24, 1)).astype(np.float32)
    return queries, database


def equal(seed):
    row = base(seed)[1][:1]
    return np.repeat(row, 24, axis=0), np.repeat(row, 24, axis=0)


INPUTS = {
    "random": lambda seed: base(seed)[1:],
    "near duplicates": near_duplicates,
    "cancelling": cancelling,
    "codes": codes,
    "sparse": sparse,
    "scaled": scaled,
    "equal": equal,
    "half precision": lambda seed: [rows.astype(np.float16) for rows in base(seed)[1:]],
    "denormals": lambda seed: [rows * np.float32(1e-42) for rows in base(seed)[1:]],
    "very small": lambda seed: [rows * np.float32(1e-22) for rows in base(seed)[1:]],
    "very large": lambda seed: [rows * np.float32(1e30) for rows in base(seed)[1:]],
    "two columns": lambda seed: [np.ascontiguousarray(rows[:, :2]) for rows in base(seed)[1:]],
}


def case_of(name, seed=0):
    queries, database = INPUTS[name](seed)
    rng = np.random.default_rng(seed)
    where = [rng.integers(0, 12, (len(rows), 1)).astype(float) for rows in (queries, database)]
    return Case(queries, database, *where, 1.0)


@pytest.mark.parametrize("engine", ENGINES, ids=NAMES)
@pytest.mark.parametrize("name", INPUTS)
def test_counts_and_lists_are_those_of_rational_arithmetic(name, engine, monkeypatch):
    monkeypatch.setattr(one_pass, "engine_for", engine)
    monkeypatch.setattr(one_pass, "_TILE_SIDE", 9)
    case = case_of(name)
    np.testing.assert_array_equal(found(case), counted(case))


@pytest.mark.parametrize("kind", ["dot", "l2"])
@pytest.mark.parametrize("engine", ENGINES, ids=NAMES)
def test_dot_and_l2_too(kind, engine, monkeypatch):
    monkeypatch.setattr(one_pass, "engine_for", engine)
    for name in ("random", "near duplicates", "sparse"):
        case = case_of(name, 1)
        case = Case(unit(case.queries), unit(case.database), case.query_positions, case.database_positions, 1.0)
        np.testing.assert_array_equal(found(case, kind), counted(case, kind))


def transforms(case, seed):
    """Maps as they are fitted, one that leaves next to nothing, and one that erases a coordinate exactly."""
    rng = np.random.default_rng(seed)
    X = np.concatenate([case.queries, case.database]).astype(np.float32)
    condition = np.repeat([0, 1], [len(case.queries), len(case.database)])
    d = X.shape[1]
    yield LowRankMap(*INLP(3).fit(X, condition).low_rank())
    yield LowRankMap(*LEACE().fit(X, condition).low_rank())
    basis = np.linalg.qr(rng.standard_normal((d, d - 1)))[0]
    yield LowRankMap(basis, basis, np.zeros(d - 1))
    yield LowRankMap(np.eye(d)[:, :1], np.eye(d)[:, :1], np.zeros(1))
    yield LowRankMap(np.eye(d), np.eye(d), np.zeros(d))


@pytest.mark.parametrize("engine", [ENGINES[i] for i in (0, 2, 4)], ids=[NAMES[i] for i in (0, 2, 4)])
def test_views_are_the_real_maps_even_where_little_is_left(engine, monkeypatch):
    monkeypatch.setattr(one_pass, "engine_for", engine)
    for name in ("cancelling", "near duplicates"):
        case = case_of(name, 2)
        narrow = Case(
            *(np.ascontiguousarray(rows[:14, :8]) for rows in (case.queries, case.database)),
            *(where[:14] for where in (case.query_positions, case.database_positions)),
            2.0,
        )
        for transform in transforms(narrow, 2):
            np.testing.assert_array_equal(found(narrow, "cosine", transform), counted(narrow, "cosine", transform))


def exact_in_float64(queries, database):
    """Cosines up to the query's length, of small whole numbers: sums and squares are exact in float64."""
    q, c = (rows.astype(np.float64) for rows in (queries, database))
    return q @ c.T, (c * c).sum(axis=1)


@pytest.mark.parametrize("d", [2, 300, 4096, 49152])
def test_many_columns_and_thousands_of_duplicates(d, monkeypatch):
    """Whole numbers, so that float64 is exact: each product finds the same counts as squares of cosines compared."""
    rng = np.random.default_rng(d)
    n = 600 if d <= 300 else 40
    originals = rng.integers(-3, 4, (max(2, n // 30), d)).astype(np.float32)
    originals[:, 0] += 4
    queries, database = (originals[rng.integers(0, len(originals), n)] for _ in range(2))
    where = [np.sort(rng.uniform(0, n / 4, n))[:, None] for _ in range(2)]
    product, squared = exact_in_float64(queries, database)
    keys = np.sign(product) * product**2 / squared
    near = np.abs(where[0] - where[1].T) <= 2.0
    kept = near.any(axis=1)
    best = np.where(near, keys, -np.inf).max(axis=1)[kept, None]
    others = np.where(near, -np.inf, keys)[kept]
    expected = (others > best * (1 + 1e-12 * np.sign(best))).sum(axis=1)
    for engine in ENGINES:
        monkeypatch.setattr(one_pass, "engine_for", engine)
        result = evaluate(queries, database, *where, 2.0, {})
        np.testing.assert_array_equal(result.ranks(distractors=False) - 1, expected)
        assert (result.database_counts.ties == (np.abs(others - best) <= 1e-12 * np.abs(best)).sum(axis=1)).all()


def real_like(n, d, seed):
    rng = np.random.default_rng(seed)
    queries, database = (rng.standard_normal((n, d), dtype=np.float32) for _ in range(2))
    common = 3 * rng.standard_normal(d, dtype=np.float32)
    where = np.arange(n) * 1.0
    return unit(queries + common), unit(0.2 * queries + database + common), where, where


def test_all_that_is_kept_is_equal_to_the_byte_for_every_product_block_and_order_of_rows(monkeypatch):
    queries, database, *where = real_like(120, 700, 3)
    X, condition = np.concatenate([queries, database]), np.repeat([0, 1], 120)
    views = {"INLP": INLP(4).fit(X, condition), "LEACE": LEACE().fit(X, condition)}
    kept = []
    for engine, side in [*((engine, 1024) for engine in ENGINES), (ENGINES[0], 37), (ENGINES[-1], 37)]:
        monkeypatch.setattr(one_pass, "engine_for", engine)
        monkeypatch.setattr(one_pass, "_TILE_SIDE", side)
        monkeypatch.setattr(one_pass, "_LARGEST_ROWS", side)
        kept.append(evaluate(queries, database, *where, 3.0, views=views, retrieve=5, view_sweeps=True).arrays())
    for other in kept[1:]:
        assert {name: a.tobytes() for name, a in other.items()} == {name: a.tobytes() for name, a in kept[0].items()}


@pytest.mark.parametrize("product", PRODUCTS, ids=NAMES[: len(PRODUCTS)])
@pytest.mark.parametrize("d", [7, 1100, 9000])
def test_every_product_keeps_its_bound(product, d):
    rng = np.random.default_rng(d)
    left, right = (rng.standard_normal((60, d)).astype(np.float32) ** 3 for _ in range(2))
    right[:20] = left[:20]  # all terms of one sign: the hardest for a bound of sums
    left[30:] *= np.float32(1e-3) * (1 + np.arange(d, dtype=np.float32) % 7)
    found = product.multiply(*map(product.prepared, (left, right)))
    error = np.abs(np.asarray(found, np.float64) - left.astype(np.float64) @ right.T.astype(np.float64))
    terms = [product.terms(rows, np.linalg.norm(rows.astype(np.float64), axis=1)) for rows in (left, right)]
    bound = terms[0][0] @ terms[1][1].T
    assert (error <= bound).all()
    assert bound.max() < 0.02 * np.outer(*(np.linalg.norm(rows, axis=1) for rows in (left, right))).max()


def test_bounds_grow_with_the_steps_of_a_product_and_not_with_all_columns():
    bound = {
        d: np.prod([side.sum() for side in FLOAT32.terms(np.ones((1, d), np.float32), np.ones(1))])
        for d in (4096, 8448)
    }
    assert bound[8448] < 0.75 * bound[4096]  # three steps of 2816 columns
    closer, plain = (products.TorchProduct(step=step) for step in (128, 512))
    rows = np.random.default_rng(0).standard_normal((40, 2000)).astype(np.float32)
    found = [np.asarray(one.multiply(one.prepared(rows), one.prepared(rows))) for one in (closer, plain)]
    np.testing.assert_allclose(*found, rtol=1e-4, atol=1e-3)
    assert closer.terms(rows, np.ones(40))[0].sum() < plain.terms(rows, np.ones(40))[0].sum()


@pytest.mark.parametrize("product", PRODUCTS, ids=NAMES[: len(PRODUCTS)])
def test_bounds_hold_for_rows_of_any_size_and_shape(product):
    rng = np.random.default_rng(0)
    rows = rng.standard_normal((12, 300)).astype(np.float32)
    rows[0], rows[1, 1:], rows[2] = 1.0, 0.0, -1.0  # no difference, a single value
    rows[3, 0], rows[4, :2] = 1e6, (1e4, -1e4)  # others are next to nothing beside an outlier
    rows[5:8] *= np.array([[1e-20], [1e-38], [1e-44]], np.float32)  # squares, and values, that float32 cannot hold
    rows[8:10] *= np.array([[1e12], [1e17]], np.float32)
    rows[10] = rows[11] + np.float32(2.0**-20)
    found = np.asarray(product.multiply(*[product.prepared(rows)] * 2), np.float64)
    as_query, as_image = product.terms(rows, np.linalg.norm(rows.astype(np.float64), axis=1))
    error = np.abs(found - rows.astype(np.float64) @ rows.astype(np.float64).T)
    assert (error <= as_query @ as_image.T).all()


def test_whole_numbers_are_multiplied_exactly_or_not_at_all(monkeypatch):
    integers = products.IntegerProduct()
    if not integers.available():
        pytest.skip("this processor does not add products of int8 exactly")
    d = 49_152
    rows = np.full((3, d), 127, np.float32)  # the largest sums: each value has the high part 127
    rows[1] *= -1
    rows[:, 1::2] -= np.float32(0.498)  # and the largest low part
    parts, scale = integers.prepared(rows)
    assert parts[0, [0, 1, d + 1, 2 * d]].tolist() == [127, 127, -127, 127]
    exact = rows.astype(np.float64) @ rows.astype(np.float64).T
    np.testing.assert_allclose(integers.multiply((parts, scale), (parts, scale)), exact, rtol=1e-5)
    length = np.linalg.norm(rows.astype(np.float64), axis=1)
    assert np.isfinite(integers.terms(rows, length)[0]).all()
    too_long = np.ones((2, 2**16 + 1), np.float32)
    assert not np.isfinite(integers.terms(too_long, np.full(2, 256.0))[0]).all()  # nothing is claimed
    with monkeypatch.context() as patch:

        def saturated(left, right):
            """As before there was an instruction for it: without signs on the left, and pairs added in 16 bits."""
            products = (left.int() + 128)[:, :, None] * right.int()[None]
            pairs = products.view(len(left), -1, 2, right.shape[1]).sum(2).clamp(-(2**15), 2**15 - 1)
            return pairs.sum(1) - 128 * right.int().sum(0)

        patch.setattr(torch, "_int_mm", saturated)
        assert not integers.available()
    monkeypatch.delattr(torch, "_int_mm")
    assert not integers.available()
    assert integers not in products.every()


def test_rows_are_prepared_once_while_there_is_room(monkeypatch):
    from artifact.ranking import engines

    queries, database, *where = real_like(160, 40, 9)
    expected = evaluate(queries, database, *where, 3.0, device="cpu").ranks(distractors=True)
    monkeypatch.setattr(engines, "_COLUMNS", 32)
    monkeypatch.setattr(one_pass, "_TILE_SIDE", 16)
    calls = []

    class Counted(products.NumpyProduct):
        def prepared(self, rows):
            calls.append(len(rows))
            return rows

    asked = {}
    for kept in (2**26, 0):
        monkeypatch.setattr(engines, "_KEPT", kept)
        monkeypatch.setattr(one_pass, "engine_for", lambda _: CpuEngine(Counted()))
        calls.clear()
        ranks = evaluate(queries, database, *where, 3.0).ranks(distractors=True)
        np.testing.assert_array_equal(ranks, expected)
        asked[kept] = sum(calls)
    assert asked[2**26] < 0.6 * asked[0], asked


def test_rows_are_multiplied_with_themselves_where_half_of_that_is_enough(monkeypatch):
    queries, database, *where = real_like(160, 40, 9)
    monkeypatch.setattr(one_pass, "_TILE_SIDE", 32)
    own = []

    class Seen(products.NumpyProduct):
        def multiply(self, left, right, out=None):
            own.append(np.shares_memory(left, right) and left.shape == right.shape)
            return super().multiply(left, right, out)

    monkeypatch.setattr(one_pass, "engine_for", lambda _: CpuEngine(Seen()))
    evaluate(queries, database, *where, 3.0)
    assert sum(own) == 160 // 32


def test_a_product_that_is_far_behind_is_not_timed_for_long(monkeypatch):
    calls = []

    class Slow(products.NumpyProduct):
        def multiply(self, left, right, out=None):
            calls.append(left.shape)
            time.sleep(0.02)
            return super().multiply(left, right, out)

    some = [products.NumpyProduct(), Slow("slow")]
    monkeypatch.setattr(products, "every", lambda: some)
    assert list(products.seconds.__wrapped__()) == some[:1]
    assert {n for n, _ in calls} == {128}


def test_the_bound_of_a_view_holds_and_a_lens_is_no_wider_than_needed():
    queries, database, *_ = real_like(80, 200, 5)
    X, condition = np.concatenate([queries, database]), np.repeat([0, 1], 80)
    for fitted in (INLP(5).fit(X, condition), LEACE().fit(X, condition)):
        transform = similarity.Transform(*fitted.low_rank())
        with threads() as executor:
            rows = similarity.described([queries, database], executor)
        q, c = (similarity.views_of(one, {"view": transform})["view"] for one in rows)
        product = FLOAT32
        terms = (
            product.terms(queries, np.sqrt(rows[0].squared))[0],
            product.terms(database, np.sqrt(rows[1].squared))[1],
        )
        lens = lenses.lens(q, c, "cosine", terms, lenses.limits(q, c, "cosine"), None)
        seen = product.multiply(queries, database) - lens.left @ lens.right
        true = [fitted.transform(one.astype(np.float64)) for one in (queries, database)]
        error = np.abs(seen - true[0] @ true[1].T)
        reach = np.outer(lens.query_reach, lens.image_reach)
        assert (error <= reach).all()
        assert reach.max() < 1e-3


def test_a_small_part_of_the_pairs_is_looked_at_again_and_the_best_product_is_taken(monkeypatch):
    queries, database, *where = real_like(400, 256, 6)
    result = evaluate(queries, database, *where, 3.0, device="cpu")
    work = result.ranking.work
    assert work.product == "NumPy float32"  # so little is not worth a trial
    assert work.pairs == 2 * 400 * 400
    assert work.second_looks < 0.01 * work.pairs
    assert work.third_looks == 0
    from artifact.ranking import engines

    rates = dict.fromkeys(PRODUCTS, 1e-3) | {PRODUCTS[-1]: 1e-4}
    monkeypatch.setattr(products, "measured", lambda: True)
    assert (
        evaluate(queries, database, *where, 3.0, device="cpu").ranking.work.product == "NumPy float32"
    )  # nor a choice
    monkeypatch.setattr(engines, "_WORTH_A_CHOICE", 0)
    monkeypatch.setattr(products, "seconds", lambda: rates)
    tried = evaluate(queries, database, *where, 3.0, device="cpu")
    assert tried.ranking.work.product == PRODUCTS[-1].name
    np.testing.assert_array_equal(tried.ranks(distractors=True), result.ranks(distractors=True))
    made = synthetic(300, 300, 4096)
    monkeypatch.setattr(products, "seconds", lambda: dict.fromkeys(PRODUCTS[:1], 1e-12))
    before = evaluate(*made, 25.0, device="cpu").ranking.work
    monkeypatch.setattr(products, "seconds", lambda: dict.fromkeys(PRODUCTS[:2], 1e-12))
    closest = evaluate(*made, 25.0, device="cpu").ranking.work
    assert closest.product == "PyTorch float32"  # as fast, with the closer bound
    assert closest.second_looks < before.second_looks


def test_second_looks_are_foretold_for_the_database_and_for_the_pool(monkeypatch):
    foretold = []

    class Foretelling(CpuEngine):
        def choose(self, multiplications, look_seconds):
            assert multiplications == 512 * 1200 * (700 + 1200 // 2)
            foretold.append(look_seconds(self.product_kind))

    monkeypatch.setattr(lenses.Sample, "pair_seconds", 1.0)
    monkeypatch.setattr(one_pass, "engine_for", lambda _: Foretelling(products.HalfProduct()))
    found = evaluate(*synthetic(1200, 700, 512), 25.0).ranking.work.second_looks
    assert 0.8 * found < foretold[0] < 1.25 * found


def test_a_similarity_between_two_float32_is_rounded_as_its_exact_value():
    row = np.array([[1.0, 2.0**-12, 2.0**-30]], np.float32)  # 1 + 2⁻²⁴ + 2⁻⁶⁰: float64 takes it for the middle
    for other, expected in (
        (row, 1 + 2.0**-23),
        (row * np.float32([1, 1, -1]), 1.0),
        (row * np.float32([1, 1, 0]), 1.0),
    ):
        result = evaluate(row, other, [[0.0]], [[0.0]], 1.0, similarity="dot", retrieve=1)
        assert result.retrieved(1, distractors=False)[1].tolist() == [[expected]]
        assert result.per_query()["similarity"].tolist() == [expected]


def test_inner_products_are_computed_once_and_are_those_of_float64():
    rng = np.random.default_rng(0)
    X, Y = (rng.standard_normal((n, 40)).astype(np.float32) for n in (5, 7))
    with ThreadPoolExecutor(2) as executor:
        known = arithmetic.Dots(X, Y, executor)
        for _ in range(4):
            i, j = rng.integers(0, 5, 12), rng.integers(0, 7, 12)
            expected = [X[a].astype(np.float64) @ Y[b].astype(np.float64) for a, b in zip(i, j, strict=True)]
            np.testing.assert_allclose(known(i, j), expected, rtol=0, atol=1e-13)
    i, j = np.divmod(known._pairs, 7)
    with ThreadPoolExecutor(2) as executor:
        np.testing.assert_array_equal(known._values, arithmetic.dots(X, i, Y, j, executor))
    assert (known(i, j) == known._values).all(), "nothing is left to compute: the threads have ended"


def test_products_restore_the_precision_that_they_found():
    for precision in ("highest", "medium"):
        torch.set_float32_matmul_precision(precision)
        try:
            for product in PRODUCTS[1:]:
                ones = product.prepared(np.ones((4, 4), np.float32))
                product.multiply(ones, ones)
                assert torch.get_float32_matmul_precision() == precision
        finally:
            torch.set_float32_matmul_precision("highest")


def test_exact_products_are_those_of_fractions():
    rng = np.random.default_rng(0)
    X = rng.standard_normal((3, 20)) * 10.0 ** rng.integers(-30, 30, (3, 20))
    Y = rng.standard_normal((2, 20)).astype(np.float32) * np.float32(1e-44)
    expected = [[sum(a * b for a, b in zip(fractions(x), fractions(y), strict=True)) for y in Y] for x in X]
    assert arithmetic.exact_products(X, Y).tolist() == expected
    assert arithmetic.exact_products(X, np.zeros((1, 20))).tolist() == [[0], [0], [0]]


def test_similarities_are_the_float32_next_to_the_real_ones():
    queries, database, *where = real_like(40, 50, 8)
    X, condition = np.concatenate([queries, database]), np.repeat([0, 1], 40)
    view = LowRankMap(*INLP(2).fit(X, condition).low_rank())
    result = evaluate(queries, database, *where, 1.0, views={"view": view})
    for name, transform in (("original", None), ("view", view)):
        table = result[name].per_query()
        for row in table.itertuples():
            q, c = (mapped(x, transform) for x in (queries[row.query], database[row.best_positive]))
            numbers = [sum(a * b for a, b in zip(*pair, strict=True)) for pair in ((q, c), (q, q), (c, c))]
            scaled = numbers[0] ** 2 / (numbers[1] * numbers[2])
            root = Fraction(isqrt((scaled.numerator << 400) // scaled.denominator), 1 << 200)
            near = np.float32(row.similarity)
            below, above = (Fraction(float(np.nextafter(near, np.float32(end)))) for end in (-2, 2))
            assert abs(root - Fraction(float(near))) <= min(root - below, above - root)


def test_rounding_to_float32_is_to_the_nearest_and_to_even():
    one, unit_last = Fraction(1), Fraction(1, 2**23)
    assert arithmetic.nearest_float32(one + unit_last / 2) == np.float32(1)
    assert arithmetic.nearest_float32(one + 3 * unit_last / 2) == np.float32(1 + 2 * 2.0**-23)
    assert arithmetic.nearest_float32(one + unit_last / 2 + Fraction(1, 2**200)) == np.float32(1 + 2.0**-23)
    assert arithmetic.nearest_float32(one + unit_last / 2 - Fraction(1, 2**200)) == np.float32(1)
