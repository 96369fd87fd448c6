"""The streaming pass against the paper's definition, sorted literally."""

import inspect
import os
import subprocess
import sys
from math import comb

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracle import Case, distance, evaluated_queries, ranks, share, similarity

from artifact.metrics.evaluate import evaluate
from artifact.metrics.evaluation import Evaluation
from artifact.metrics.result import QUERY_POOL, Result
from artifact.metrics.two_stage import TwoStageEvaluation
from artifact.ranking import one_pass
from artifact.ranking.engines import CpuEngine
from artifact.suppression.lowrank import LowRankMap


def random_case(seed):
    """A small case full of ties: descriptors of -1, 0 and 1 with 1, 4 or 16 entries, so that cosines are exact."""
    rng = np.random.default_rng(seed)
    n_queries, n_database, n_pool = rng.integers(1, 12, 3)
    width = int(rng.choice([4, 16]))

    def descriptors(n):
        out = np.zeros((n, width), np.float32)
        for row in out:
            size = int(rng.choice([s for s in (1, 4, 16) if s <= width]))
            row[rng.choice(width, size, replace=False)] = rng.choice([-1.0, 1.0], size)
        return out

    kind = rng.choice(["exact", "frames", "plane", "space"])
    if kind == "exact":
        place = lambda n: rng.integers(0, 6, (n, 1)).astype(float)  # noqa: E731
        threshold = 0.0
    elif kind == "frames":
        place = lambda n: np.arange(n, dtype=float)[:, None] + rng.integers(0, 3)  # noqa: E731
        threshold = float(rng.integers(1, 3))
    else:
        axes = 2 if kind == "plane" else 3
        place = lambda n: rng.integers(0, 5, (n, axes)) * 5.0  # noqa: E731
        threshold = float(rng.choice([5.0, 5 * np.sqrt(2), 10.0]))
    own_pool = rng.random() < 0.5
    return Case(
        descriptors(n_queries),
        descriptors(n_database),
        place(n_queries),
        place(n_database),
        threshold,
        None if own_pool else descriptors(n_pool),
        None if own_pool else place(n_pool),
    )


def run(case, **options):
    return evaluate(
        case.queries,
        case.database,
        case.query_positions,
        case.database_positions,
        case.threshold,
        case.pool,
        case.pool_positions,
        **options,
    )


def with_tiles_of(monkeypatch, side):
    """Make the pass cut small cases into many tiles, so that block borders and mirrored tiles are met."""
    monkeypatch.setattr(one_pass, "_TILE_SIDE", side)
    monkeypatch.setattr(one_pass, "_LARGEST_ROWS", side)


def check_against_oracle(case, device):
    if not evaluated_queries(case):
        with pytest.raises(ValueError, match="has a database image within the threshold"):
            run(case, device=device)
        return
    result = run(case, device=device, depth=4, draws=2, retrieve=5)
    assert result.n_queries == len(evaluated_queries(case))
    assert result.excluded_queries == len(case.queries) - result.n_queries
    for ties in ("for", "against"):
        for with_distractors in (False, True):
            expected = ranks(case, ties=ties, with_distractors=with_distractors)
            np.testing.assert_array_equal(result.ranks(distractors=with_distractors, ties=ties), expected)
    check_per_query(result.per_query(), case)
    for k in (1, 2, 5):
        recall, dar = share(ranks(case, with_distractors=False), k), share(ranks(case), k)
        assert result.recall(k) == recall
        assert result.dar(k) == dar <= recall
        assert result.rsr(k) == pytest.approx(dar / recall) if recall else np.isnan(result.rsr(k))
    for k in (1, 3):
        limits = [case.threshold, case.threshold + 3, case.threshold + 9, np.inf]
        expected = [share(ranks(case, beyond=limit), k) for limit in limits]
        np.testing.assert_allclose(result.dar_by_distance(limits, k), expected)
        ratios = [0.0, 0.3, 0.5, 1.0]
        orders = one_pass.draw_orders(result.n_distractors, one_pass.Options(draws=2))
        for draw, row in zip(orders.T, result.dar_by_ratio_draws(ratios, k), strict=True):
            for ratio, value in zip(ratios, row, strict=True):
                members = set(np.flatnonzero(draw < round(ratio * result.n_distractors)).tolist())
                assert value == pytest.approx(share(ranks(case, members=members), k))


def check_per_query(table, case, kind="cosine"):
    assert table["query"].tolist() == evaluated_queries(case)
    for column, how in {
        "rank": {"with_distractors": False},
        "rank_with_distractors": {},
        "rank_against": {"ties": "against", "with_distractors": False},
        "rank_with_distractors_against": {"ties": "against"},
    }.items():
        np.testing.assert_array_equal(table[column], ranks(case, kind, **how))
    for row in table.itertuples():
        scores = similarity(kind, case.queries[row.query], case.database)
        away = [distance(case.query_positions[row.query], where) for where in case.database_positions]
        allowed = [
            (round(s, 9), -i) for i, (s, far) in enumerate(zip(scores, away, strict=True)) if far <= case.threshold
        ]
        assert row.best_positive == -max(allowed)[1], "the first of equal ones"
        assert row.similarity == pytest.approx(scores[row.best_positive], abs=1e-6)
        assert row.distance == pytest.approx(away[row.best_positive])


@pytest.mark.parametrize("side", [3, 1024])
@pytest.mark.parametrize("block", range(4))
def test_counts_equal_a_literal_sort_of_the_augmented_database(block, side, monkeypatch):
    with_tiles_of(monkeypatch, side)
    for seed in range(200 * block, 200 * block + 200):
        check_against_oracle(random_case(1000 * side + seed), "cpu")


@pytest.mark.parametrize("side", [2, 1024])
def test_the_engine_of_other_devices_equals_the_literal_sort(side, monkeypatch):
    from artifact.ranking.engine_torch import TorchEngine

    monkeypatch.setattr(one_pass, "engine_for", TorchEngine)
    with_tiles_of(monkeypatch, side)
    import torch

    for seed in range(150):
        check_against_oracle(random_case(seed), torch.device("cpu"))


@settings(max_examples=150, deadline=None)
@given(st.integers(10**6, 10**9))
def test_counts_equal_a_literal_sort_property(seed):
    check_against_oracle(random_case(seed), "cpu")


@pytest.mark.parametrize("kind", ["cosine", "l2", "dot"])
def test_similarities_rank_as_defined(kind):
    rng = np.random.default_rng(5)
    unit = lambda n: (lambda x: x / np.linalg.norm(x, axis=1, keepdims=True))(  # noqa: E731
        rng.standard_normal((n, 24))
    ).astype(np.float32)
    case = Case(unit(40), unit(50), rng.uniform(0, 30, (40, 2)), rng.uniform(0, 30, (50, 2)), 4.0)
    check_per_query(run(case, similarity=kind).per_query(), case, kind)


def test_cosine_ignores_length_and_half_precision_is_read_exactly():
    queries, database = (np.random.default_rng(n).standard_normal((n, 8)).astype(np.float16) for n in (30, 40))
    case = Case(queries, database, np.arange(30.0)[:, None], np.arange(40.0)[:, None], 2.0)
    wide = Case(case.queries.astype(np.float32), 4 * case.database.astype(np.float32), *_positions(case))
    np.testing.assert_array_equal(run(case).ranks(distractors=True), run(wide).ranks(distractors=True))


def _positions(case):
    return case.query_positions, case.database_positions, case.threshold


def test_expected_number_sweep_is_the_mean_over_all_subsets():
    """Enumerate every subset of a small pool: the hypergeometric expectation is exact, for several K."""
    from itertools import combinations

    rng = np.random.default_rng(11)
    case = Case(
        rng.standard_normal((6, 3)).astype(np.float32),
        rng.standard_normal((6, 3)).astype(np.float32),
        np.arange(6.0)[:, None],
        np.arange(6.0)[:, None],
        0.0,
    )
    result = run(case)
    for size in range(7):
        for k in (1, 2, 3):
            subsets = [share(ranks(case, members=set(chosen)), k) for chosen in combinations(range(6), size)]
            assert len(subsets) == comb(6, size)
            assert result.dar_by_ratio([size / 6], k)[0] == pytest.approx(np.mean(subsets), abs=1e-12)


def test_nested_draws_average_to_the_expectation():
    rng = np.random.default_rng(3)
    case = Case(
        rng.standard_normal((80, 6)).astype(np.float32),
        rng.standard_normal((80, 6)).astype(np.float32),
        np.arange(80.0)[:, None],
        np.arange(80.0)[:, None],
        1.0,
    )
    result = run(case, draws=400)
    ratios = np.linspace(0, 1, 11)
    draws = result.dar_by_ratio_draws(ratios)
    assert (np.diff(draws, axis=1) <= 0).all(), "more distractors can only lower DAR"
    error = draws.std(axis=0) / np.sqrt(len(draws))
    np.testing.assert_array_less(np.abs(draws.mean(axis=0) - result.dar_by_ratio(ratios)), 4 * error + 1e-12)


def test_sweeps_end_at_recall_and_dar():
    case = random_case(17)
    result = run(case, retrieve=3)
    assert result.dar_by_ratio([0, 1]).tolist() == [result.recall(), result.dar()]
    assert result.dar_by_ratio([]).shape == result.dar_by_distance([]).shape == (0,)
    assert result.chances_by_ratio([]).shape == (result.n_queries, 0)
    assert result.dar_by_distance([case.threshold, np.inf]).tolist() == [result.dar(), result.recall()]


@pytest.mark.parametrize("positions", [None, {}])
def test_no_distractors_at_all_is_the_recall(positions):
    case = random_case(0)
    result = evaluate(case.queries, case.database, *_positions(case), {}, positions, retrieve=2)
    assert (result.pools, result.n_distractors) == (["none"], 0)
    np.testing.assert_array_equal(result.ranks(distractors=True), ranks(case, with_distractors=False))
    assert run(case).dar() < result.dar() == result.recall()
    assert result.dar_by_ratio([0, 1]).tolist() == [result.recall()] * 2
    assert result.dar_by_ratio_draws([1]).tolist() == [[result.recall()]] * 10
    assert result.dar_by_distance([case.threshold]).tolist() == [result.recall()]
    alone, with_none = (result.retrieved(2, distractors=distractors)[0] for distractors in (False, True))
    np.testing.assert_array_equal(alone, with_none)


def test_several_pools_share_one_pass():
    rng = np.random.default_rng(2)
    case = random_case(23)
    near = case.queries[::-1].copy()
    where = rng.uniform(0, 10, (len(near), case.query_positions.shape[1]))
    result = evaluate(
        case.queries,
        case.database,
        case.query_positions,
        case.database_positions,
        case.threshold,
        {"own": case.queries, "other": near},
        {"own": case.query_positions, "other": where},
    )
    assert result.pools == ["own", "other"]
    for name, images, positions in (("own", case.queries, case.query_positions), ("other", near, where)):
        alone = Case(case.queries, case.database, *_positions(case), images, positions)
        np.testing.assert_array_equal(result.pool(name).ranks(distractors=True), ranks(alone))


@pytest.mark.parametrize("device", ["cpu", "torch"])
def test_retrieval_lists_hold_the_most_similar_allowed_images(device, monkeypatch):
    if device == "torch":
        import torch

        from artifact.ranking.engine_torch import TorchEngine

        monkeypatch.setattr(one_pass, "engine_for", lambda _: TorchEngine(torch.device("cpu")))
    with_tiles_of(monkeypatch, 7)
    rng = np.random.default_rng(8)
    case = Case(
        rng.standard_normal((40, 9)).astype(np.float32),
        rng.standard_normal((50, 9)).astype(np.float32),
        rng.uniform(0, 30, (40, 2)),
        rng.uniform(0, 30, (50, 2)),
        6.0,
    )
    result = run(case, retrieve=6)
    kept = evaluated_queries(case)
    for distractors in (False, True):
        indices, similarities = result.retrieved(6, distractors=distractors)
        for row, i in enumerate(kept):
            images = case.database / np.linalg.norm(case.database, axis=1, keepdims=True)
            if distractors:
                pool = case.queries[kept] / np.linalg.norm(case.queries[kept], axis=1, keepdims=True)
                images = np.concatenate([images, pool])
            scores = images @ case.queries[i]
            for j, other in enumerate(kept if distractors else []):
                if distance(case.query_positions[i], case.query_positions[other]) <= case.threshold:
                    scores[len(case.database) + j] = -np.inf
            np.testing.assert_array_equal(indices[row], np.argsort(-scores, kind="stable")[:6])
            length = np.linalg.norm(case.queries[i])
            np.testing.assert_allclose(similarities[row], np.sort(scores)[::-1][:6] / length, rtol=1e-5)


def test_memory_budget_and_tile_size_do_not_change_the_counts(monkeypatch):
    rng = np.random.default_rng(4)
    case = Case(
        rng.standard_normal((300, 32)).astype(np.float32),
        rng.standard_normal((200, 32)).astype(np.float32),
        rng.uniform(0, 100, (300, 2)),
        rng.uniform(0, 100, (200, 2)),
        12.0,
    )
    reference = run(case)
    with_tiles_of(monkeypatch, 37)
    other = run(case)
    np.testing.assert_array_equal(reference.ranks(distractors=True), other.ranks(distractors=True))


@pytest.mark.parametrize("side", [3, 1024])
def test_views_without_sweeps_count_equal_similarities_as_the_definition(side, monkeypatch):
    """Images that a query may not use are many and often as similar as its best positive."""
    with_tiles_of(monkeypatch, side)
    for seed in range(150):
        case = random_case(seed)
        if not evaluated_queries(case):
            continue
        width = case.queries.shape[1]
        nothing = LowRankMap(np.zeros((width, 0)), np.zeros((width, 0)), np.zeros(0))
        view = run(case, views={"as it is": nothing})["as it is"]
        for ties in ("for", "against"):
            np.testing.assert_array_equal(view.ranks(distractors=True, ties=ties), ranks(case, ties=ties))


@pytest.mark.parametrize("side", [3, 1024])
def test_equal_images_stand_in_retrieval_lists_in_their_order(side, monkeypatch):
    """Database before distractors, and each in the order given."""
    with_tiles_of(monkeypatch, side)
    for seed in range(60):
        case = random_case(seed)
        kept = evaluated_queries(case)
        if not kept:
            continue
        result = run(case, retrieve=4)
        pool = case.queries[kept] if case.pool is None else case.pool
        where = case.query_positions[kept] if case.pool is None else case.pool_positions
        for row, query in enumerate(kept):
            scores = [similarity("cosine", case.queries[query], images) for images in (case.database, pool)]
            far = [distance(case.query_positions[query], place) > case.threshold for place in where]
            scores[1] = np.where(far, scores[1], -np.inf)
            for distractors in (False, True):
                both = np.round(np.concatenate(scores if distractors else scores[:1]), 9)
                order = np.argsort(-both, kind="stable")[:4]
                expected = np.full(4, -1)
                expected[: len(order)] = np.where(np.isneginf(both[order]), -1, order)
                length = min(4, len(case.database))
                found = result.retrieved(length, distractors=distractors)[0][row]
                np.testing.assert_array_equal(found, expected[:length])


GOOD = {
    "queries": np.eye(3, dtype=np.float32),
    "database": np.eye(3, dtype=np.float32),
    "query_positions": np.arange(3.0),
    "database_positions": np.arange(3.0),
    "threshold": 0.0,
}


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"queries": np.eye(3)}, TypeError, "array of float64; allowed: NumPy arrays of float32 or float16"),
        ({"queries": [[1.0]]}, TypeError, "descriptors are list"),
        ({"queries": np.ones(3, np.float32)}, ValueError, r"shape \(3,\); allowed: \(n, d\)"),
        ({"database": np.eye(4, dtype=np.float32)[:3]}, ValueError, "3 columns in queries and 4 in database"),
        ({"query_positions": np.arange(4.0)}, ValueError, "positions have the shape"),
        ({"database_positions": np.zeros((3, 2))}, ValueError, "positions have 1 columns in queries and 2"),
        ({"query_positions": np.array([0, np.nan, 1])}, ValueError, "position of row 1 is not finite"),
        ({"database": np.diag([1, np.nan, 1]).astype(np.float32)}, ValueError, "database: row 1 .* NaN"),
        ({"queries": np.diag([1, 1, 0]).astype(np.float32)}, ValueError, "queries: row 2 .* all zeros"),
        ({"similarity": "dot", "queries": 2 * np.eye(3, dtype=np.float32)}, ValueError, "row 0 has length 2"),
        ({"similarity": "angle"}, ValueError, "allowed: 'cosine', 'l2', 'dot'"),
        ({"threshold": -1.0}, ValueError, "threshold is -1.0; allowed: finite numbers from 0"),
        ({"threshold": np.inf}, ValueError, "allowed: finite numbers from 0"),
        ({"database_positions": np.arange(3.0) + 50}, ValueError, "none of the 3 queries has a database image"),
        ({"distractors": np.eye(3, dtype=np.float32)}, ValueError, "without distractor_positions"),
        ({"distractor_positions": np.arange(3.0)}, ValueError, "without distractors"),
        ({"distractors": {}, "distractor_positions": {"a": np.arange(3.0)}}, ValueError, "both need the same names"),
        ({"retrieve": -1}, ValueError, "retrieve is -1; allowed: whole numbers from 0"),
        ({"colour": 1}, TypeError, "unexpected keyword argument 'colour'"),
    ],
)
def test_bad_input_is_named(change, error, message):
    with pytest.raises(error, match=message):
        evaluate(**{**GOOD, **change})


def test_bad_questions_are_named():
    result = evaluate(**GOOD, depth=2)
    for k in (0, 1.5, True):
        with pytest.raises(ValueError, match="allowed: whole numbers from 1"):
            result.recall(k)
    with pytest.raises(ValueError, match="raise the option depth"):
        result.dar_by_distance([0.0], k=3)
    with pytest.raises(ValueError, match="raise the option retrieve"):
        result.retrieved(1, distractors=False)
    with pytest.raises(ValueError, match="from the threshold 0 up"):
        result.dar_by_distance([-1.0])
    with pytest.raises(ValueError, match="numbers from 0 to 1"):
        result.dar_by_ratio([1.5])
    with pytest.raises(KeyError, match="no view 'leace'; the views are original"):
        result["leace"]
    with pytest.raises(KeyError, match="no distractor pool 'rain'; the pools are queries"):
        result.pool("rain")
    assert QUERY_POOL in result.pools


def test_compiling_at_set_up_compiles_all_that_a_ranking_calls(tmp_path):
    code = """if True:
        import numpy as np
        from artifact import LEACE, evaluate
        rng = np.random.default_rng(0)
        places = np.column_stack([np.arange(50.0), np.zeros(50)])
        for dtype in (np.float32, np.float16):
            X, Y, Z = (rng.standard_normal((50, 24)).astype(dtype) for _ in range(3))
            views = {"view": LEACE().fit(np.concatenate([X, Y]), np.repeat([0, 1], 50))}
            evaluate(X, Y, places, places, 2.0, views=views, retrieve=5, device="cpu")
            evaluate(X, Y, places, places, 2.0, Z, places, device="cpu")
    """
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    compiled = []
    for command in (["-m", "artifact.ranking"], ["-c", code]):
        subprocess.run([sys.executable, *command], env=environment, check=True, stdout=subprocess.DEVNULL)
        compiled.append({path.name for path in tmp_path.rglob("*.nbc")})
    assert compiled[0] == compiled[1] != set()


@pytest.mark.parametrize("kind", [Result, Evaluation, TwoStageEvaluation])
def test_k_is_1_if_nothing_else_is_said(kind):
    methods = [function for _, function in inspect.getmembers(kind, inspect.isfunction)]
    given = [inspect.signature(function).parameters.get("k") for function in methods]
    defaults = {k.default for k in given if k is not None and k.default is not inspect.Parameter.empty}
    assert defaults == {1}


def test_tiles_keep_to_the_memory_that_they_may_take(monkeypatch):
    product, taken, memory = CpuEngine.product, [], 4 * 40 * 7

    def recorded(*arguments):
        found = product(*arguments)
        taken.append(found.nbytes)
        return found

    monkeypatch.setattr(CpuEngine, "product", recorded)
    rng = np.random.default_rng(0)
    queries, database = (
        one_pass.ImageSet(rng.standard_normal((n, 8), dtype=np.float32), np.arange(n)[:, None] / 1.0) for n in (50, 40)
    )
    options = one_pass.Options(memory=memory, device="cpu")
    found = one_pass.rank(queries, database, 2.0, {"queries": None}, None, options)
    assert memory / 4 < max(taken) <= memory
    whole = one_pass.rank(queries, database, 2.0, {"queries": None}, None, one_pass.Options(device="cpu"))
    np.testing.assert_array_equal(
        found.pools[one_pass.ORIGINAL, "queries"].outranking, whole.pools[one_pass.ORIGINAL, "queries"].outranking
    )
