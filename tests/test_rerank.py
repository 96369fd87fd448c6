"""Two-stage methods against the definition: build the augmented database, sort, cut, score, sort again, look."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from oracle import distance, share, similarity

from artifact import candidates, matching, ranking
from artifact.matching import LocalMatcher
from artifact.metrics import evaluate
from artifact.rerank import Sweep, TwoStageEvaluation, evaluate_two_stage
from artifact.statistics import intervals


@dataclass(frozen=True)
class Case:
    """Images with first-stage vectors or codes; the second stage is a table of scores, (query, image)."""

    queries: np.ndarray
    database: np.ndarray
    query_positions: np.ndarray
    database_positions: np.ndarray
    threshold: float
    database_scores: np.ndarray
    pool: np.ndarray | None
    pool_positions: np.ndarray | None
    pool_scores: np.ndarray


def random_case(seed, largest=14):
    """A small case full of ties at both stages."""
    rng = np.random.default_rng(seed)
    n_queries, n_database, n_pool = rng.integers(1, largest, 3)
    codes = rng.random() < 0.4

    def images(n):
        if codes:
            return rng.integers(0, 256, (n, 1)).astype(np.uint8) & np.uint8(0b10110001)
        out = np.zeros((n, 4), np.float32)
        for row in out:
            row[rng.choice(4, rng.choice([1, 4]), replace=False)] = 1.0
            row *= rng.choice([-1.0, 1.0], 4)
        return out

    place = lambda n: rng.integers(0, 5, (n, 2)) * 5.0  # noqa: E731
    own = rng.random() < 0.5
    values = rng.choice([2, 4, 1000])
    n_pool = n_queries if own else n_pool
    return Case(
        images(n_queries), images(n_database), place(n_queries), place(n_database), float(rng.choice([0.0, 5.0, 10.0])),
        rng.integers(0, values, (n_queries, n_database)), None if own else images(n_pool),
        None if own else place(n_pool), rng.integers(0, values, (n_queries, n_pool)),
    )  # fmt: skip


def first_stage(query, images):
    if images.dtype == np.uint8:
        return -np.array([sum(int(byte).bit_count() for byte in query ^ image) for image in images], float)
    return np.round(similarity("cosine", query, images), 12)


def evaluated_queries(case):
    near = lambda where: any(distance(where, y) <= case.threshold for y in case.database_positions)  # noqa: E731
    return [i for i, where in enumerate(case.query_positions) if near(where)]


POSITIVE, OTHER, DISTRACTOR = 0, 1, 2


class Definition:
    """The definition, word for word: `entries` of each evaluated query are (first, kind, index, second, distance)."""

    def __init__(self, case):
        self.kept = evaluated_queries(case)
        own = case.pool is None
        pool = case.queries[self.kept] if own else case.pool
        where = case.query_positions[self.kept] if own else case.pool_positions
        table = case.pool_scores[:, self.kept] if own else case.pool_scores
        self.entries = []
        for i in self.kept:
            here, entries = case.query_positions[i], []
            for index, first in enumerate(first_stage(case.queries[i], case.database)):
                apart = distance(here, case.database_positions[index])
                kind = POSITIVE if apart <= case.threshold else OTHER
                entries.append((first, kind, index, case.database_scores[i, index], apart))
            for index, first in enumerate(first_stage(case.queries[i], pool)):
                apart = distance(here, where[index])
                if apart > case.threshold:
                    entries.append((first, DISTRACTOR, index, table[i, index], apart))
            self.entries.append(entries)

    def candidates(self, row, n, *, beyond=-1, members=None, ties="for", with_distractors=True):
        order = {"for": [0, 1, 2], "against": [3, 1, 2]}[ties]
        chosen = [
            (first, kind, index, second, apart)
            for first, kind, index, second, apart in self.entries[row]
            if kind != DISTRACTOR or (with_distractors and apart > beyond and (members is None or index in members))
        ]
        return sorted(chosen, key=lambda e: (-e[0], order[e[1]], e[2]))[:n]

    def reranked(self, row, n, *, ties="for", **how):
        best = self.candidates(row, n, ties=ties, **how)
        if ties == "for":
            return sorted(best, key=lambda e: -e[3])  # stable: first-stage order stays
        return sorted(best, key=lambda e: (-e[3], e[1] == POSITIVE))

    def ranks(self, n, **how):
        result = []
        for row in range(len(self.kept)):
            places = [place for place, e in enumerate(self.reranked(row, n, **how)) if e[1] == POSITIVE]
            result.append(1 + places[0] if places else n + 1)
        return np.array(result)


class Table:
    """A second stage that looks scores up: what it is asked is part of the test."""

    def __init__(self, case):
        self.tables = {"database": case.database_scores, "pool": case.pool_scores, "queries": case.pool_scores}
        self.asked = []

    def __call__(self, queries, query_rows, images, image_rows):
        assert queries.name == "queries"
        self.asked += [(images.name, *pair) for pair in zip(query_rows.tolist(), image_rows.tolist(), strict=True)]
        return self.tables[images.name][query_rows, image_rows].astype(np.float32)


@dataclass
class Named:
    name: str
    n: int

    def __len__(self):
        return self.n


def run(case, scores=None, **options):
    def images(name, first, positions):
        return candidates.Images.of(first, Named(name, len(first)), positions)

    pools = None if case.pool is None else {"other": images("pool", case.pool, case.pool_positions)}
    return evaluate_two_stage(
        images("queries", case.queries, case.query_positions), images("database", case.database, case.database_positions),
        case.threshold, scores or Table(case), pools, **options,
    )  # fmt: skip


def check_against_definition(case, n):
    if not evaluated_queries(case):
        with pytest.raises(ValueError, match="has a database image within the threshold"):
            run(case)
        return
    result, definition = run(case, candidates=n, draws=2, retrieve=min(n, 3)), Definition(case)
    assert result.n_queries == len(definition.kept)
    assert result.excluded_queries == len(case.queries) - len(definition.kept)
    for distractors in (False, True):
        for ties in ("for", "against"):
            expected = definition.ranks(n, ties=ties, with_distractors=distractors)
            np.testing.assert_array_equal(result.ranks(distractors=distractors, ties=ties), expected)
            for k in {1, n}:
                metric = result.dar if distractors else result.recall
                assert metric(k, ties=ties) == share(expected, k)
        indices, scores = result.retrieved(min(n, 3), distractors=distractors)
        for row in range(len(definition.kept)):
            wanted = definition.reranked(row, n, with_distractors=distractors)[: min(n, 3)]
            shown = [index + len(case.database) * (kind == DISTRACTOR) for _, kind, index, _, _ in wanted]
            assert indices[row].tolist() == shown + [-1] * (min(n, 3) - len(wanted))
            assert scores[row, : len(wanted)].tolist() == [e[3] for e in wanted]
    limits = [case.threshold, case.threshold + 3, case.threshold + 5, case.threshold + 12, np.inf]
    by_limit = [definition.ranks(n, beyond=limit) for limit in limits]
    sizes = range(result.n_distractors + 1)
    orders = ranking._draw_orders(result.n_distractors, ranking.Options(draws=2))
    by_size = [[definition.ranks(n, members=set(np.flatnonzero(order < size))) for size in sizes] for order in orders.T]
    for k in {1, min(2, n), n}:
        np.testing.assert_array_equal(result.dar_by_distance(limits, k), [share(ranks, k) for ranks in by_limit])
        expected = [[share(ranks, k) for ranks in draw] for draw in by_size]
        ratios = np.array(sizes) / result.n_distractors
        np.testing.assert_array_equal(result.dar_by_ratio_draws(ratios, k), expected)
        np.testing.assert_allclose(result.dar_by_ratio(ratios, k), np.mean(expected, axis=0))


@pytest.mark.parametrize("n", [1, 2, 3, 5, 40])
def test_ranks_and_sweeps_equal_the_definition(n, monkeypatch):
    monkeypatch.setattr(candidates, "_BLOCK", 3)
    for seed in range(60):
        check_against_definition(random_case([n, seed]), n)


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10**9), st.integers(1, 12))
def test_ranks_and_sweeps_equal_the_definition_property(seed, n):
    check_against_definition(random_case(seed, largest=18), n)


def continuous_case(seed, n_queries=12, n_database=30, n_pool=60):
    """A case without ties at either stage, with more distractors than candidates."""
    rng = np.random.default_rng(seed)
    unit = lambda n: (lambda x: x / np.linalg.norm(x, axis=1, keepdims=True))(rng.standard_normal((n, 8)))  # noqa: E731
    shared = rng.standard_normal(8)
    lean = lambda n: (unit(n) + 0.5 * shared).astype(np.float32)  # noqa: E731
    return Case(
        lean(n_queries), unit(n_database).astype(np.float32), rng.uniform(0, 30, (n_queries, 2)),
        rng.uniform(0, 30, (n_database, 2)), 8.0, rng.permutation(n_queries * n_database).reshape(n_queries, -1),
        lean(n_pool), rng.uniform(0, 30, (n_pool, 2)), rng.permutation(n_queries * n_pool).reshape(n_queries, -1),
    )  # fmt: skip


def test_only_pairs_that_can_be_candidates_are_scored_and_each_once():
    """For R and DAR the candidates of both; for the sweeps those of every number in every draw and every distance."""
    for seed in range(4):
        case, n = continuous_case(seed), 4
        definition, table = Definition(case), Table(case)
        result = run(case, table, candidates=n, draws=2)
        wanted = set()

        def add(row, wanted=wanted, definition=definition, **how):
            for _, kind, index, _, _ in definition.candidates(row, n, **how):
                wanted.add(("pool" if kind == DISTRACTOR else "database", definition.kept[row], index))

        rows = range(len(definition.kept))
        for row in rows:
            add(row)
            add(row, with_distractors=False)
        assert len(table.asked) == len(set(table.asked))
        assert set(table.asked) == wanted
        table.asked.clear()
        result.dar_by_distance([case.threshold])
        result.dar_by_ratio([0.5])
        assert len(table.asked) == len(set(table.asked)), "sweeps are computed once and kept"
        for row in rows:
            for order in ranking._draw_orders(len(case.pool), ranking.Options(draws=2)).T:
                for size in range(len(case.pool) + 1):
                    add(row, members=set(np.flatnonzero(order < size)))
            for entry in definition.entries[row]:
                add(row, beyond=entry[4] - 1e-9)
        assert set(table.asked) == wanted


def test_a_few_candidates_per_query_suffice_for_every_number_of_distractors():
    """About n (1 + ln(pool / n)) distractors of a random order are ever candidates, not the whole pool."""
    case, n, table = continuous_case(9, n_queries=20, n_database=15, n_pool=2000), 10, None
    table = Table(case)
    result = run(case, table, candidates=n, draws=1)
    table.asked.clear()
    result.sweep_of("other")
    per_query = sum(name == "pool" for name, *_ in table.asked) / result.n_queries
    assert per_query < 2 * n * (1 + np.log(len(case.pool) / n)) < len(case.pool) / 10


@pytest.mark.parametrize("n", [1, 5, 200])
def test_a_second_stage_equal_to_the_first_changes_nothing_within_the_candidates(n):
    case = continuous_case(3)

    def cosine(queries, query_rows, images, image_rows):
        values = {"database": case.database, "pool": case.pool}[images.name]
        rows = [
            similarity("cosine", case.queries[q], values[i : i + 1])[0]
            for q, i in zip(query_rows, image_rows, strict=True)
        ]
        return np.array(rows, np.float32)

    one = evaluate(
        case.queries, case.database, case.query_positions, case.database_positions, case.threshold, {"other": case.pool},
        {"other": case.pool_positions}, draws=3,
    )  # fmt: skip
    two = run(case, cosine, candidates=n, draws=3)
    for distractors in (False, True):
        expected = np.minimum(one.ranks(distractors=distractors), n + 1)
        np.testing.assert_array_equal(two.ranks(distractors=distractors), expected)
    ratios, limits = np.linspace(0, 1, 31), [case.threshold, 12.0, 20.0, np.inf]
    np.testing.assert_allclose(two.dar_by_ratio_draws(ratios), one.dar_by_ratio_draws(ratios))
    np.testing.assert_allclose(two.dar_by_distance(limits), one.dar_by_distance(limits))
    assert intervals(two)["DAR"] == intervals(one)["DAR"]


def tiny(first, second, *, pool_first=(), pool_second=(), positives=1):
    """One query whose images have the given cosines to it; the first ``positives`` database images are positives."""
    vectors = lambda values: np.array([[v, np.sqrt(1 - v * v)] for v in values], np.float32)  # noqa: E731
    where = np.where(np.arange(len(first)) < positives, 0.0, 100.0)[:, None]
    return Case(
        vectors([1.0]), vectors(first), np.zeros((1, 1)), where, 1.0, np.array([second]),
        vectors(pool_first), np.full((len(pool_first), 1), 50.0), np.array([pool_second]),
    )  # fmt: skip


def test_a_distractor_that_pushes_out_a_wrong_candidate_can_help_and_is_reported_so():
    case = tiny([0.9, 0.5], [3, 7], pool_first=[0.7], pool_second=[1])
    result = run(case, candidates=2)
    assert (result.recall(1), result.dar(1)) == (0.0, 1.0)
    assert np.isnan(result.rsr(1))
    assert result.dar_by_ratio([0, 1]).tolist() == [0.0, 1.0]


def test_with_fewer_distractors_images_beyond_the_first_candidates_move_up():
    """Distractors 0 and 1 hide distractor 2, which beats the positive, until both are left out."""
    case = tiny([0.5], [5], pool_first=[0.9, 0.8, 0.7], pool_second=[1, 1, 9])
    case.pool_positions[:, 0] = [10, 20, 30]
    result = run(case, candidates=2)
    assert result.ranks(distractors=True).tolist() == [3], "the positive itself is no candidate"
    assert result.dar_by_distance([1, 10, 20, 30]).tolist() == [0, 0, 0, 1]
    alone = tiny([0.5], [5], pool_first=[0.7], pool_second=[9])
    assert run(alone, candidates=2).ranks(distractors=True).tolist() == [2]


def test_several_pools_share_the_database_and_stand_alone():
    case, other = continuous_case(1), continuous_case(2)
    images = lambda name, first, where: candidates.Images.of(first, Named(name, len(first)), where)  # noqa: E731
    table = Table(case)
    table.tables["far"] = other.pool_scores
    pools = {
        "other": images("pool", case.pool, case.pool_positions),
        "far": images("far", other.pool, other.pool_positions),
    }
    both = evaluate_two_stage(
        images("queries", case.queries, case.query_positions), images("database", case.database, case.database_positions),
        case.threshold, table, pools, candidates=4, draws=1, retrieve=2,
    )  # fmt: skip
    assert both.pools == ["other", "far"]
    alone = replace(case, pool=other.pool, pool_positions=other.pool_positions, pool_scores=other.pool_scores)
    for name, single in (("other", run(case, candidates=4, draws=1)), ("far", run(alone, candidates=4, draws=1))):
        np.testing.assert_array_equal(both.pool(name).ranks(distractors=True), single.ranks(distractors=True))
        ratios = [0, 0.3, 1]
        np.testing.assert_array_equal(both.pool(name).dar_by_ratio(ratios), single.dar_by_ratio(ratios))
    rebuilt = TwoStageEvaluation.from_arrays(both.arrays(), both.sweep_of)
    for name in both.pools:
        for distractors in (False, True):
            for got, expected in (
                (rebuilt.pool(name).ranks(distractors=distractors), both.pool(name).ranks(distractors=distractors)),
                (rebuilt.pool(name).retrieved(2, distractors=distractors)[0], both.pool(name).retrieved(2, distractors=distractors)[0]),
            ):  # fmt: skip
                np.testing.assert_array_equal(got, expected)
    assert (rebuilt.n_distractors, rebuilt.threshold, rebuilt["original"]) == (
        both.n_distractors,
        both.threshold,
        rebuilt,
    )
    again = Sweep.from_arrays(both.sweep_of("far").arrays())
    np.testing.assert_array_equal(again.number.below([3.0]), both.sweep_of("far").number.below([3.0]))


def test_bad_questions_and_scores_are_named():
    case = continuous_case(1)
    result = run(case, candidates=4)
    for k in (0, 5, True):
        with pytest.raises(ValueError, match="whole numbers from 1 to the 4 candidates"):
            result.recall(k)
    with pytest.raises(ValueError, match="raise the option retrieve"):
        result.retrieved(1, distractors=True)
    with pytest.raises(ValueError, match="from the threshold 8 up"):
        result.dar_by_distance([1.0])
    with pytest.raises(KeyError, match="no view 'leace'"):
        result["leace"]
    for options, message in (
        ({"candidates": 0}, "candidates is 0"), ({"draws": 0}, "draws is 0"), ({"retrieve": 9, "candidates": 4}, "retrieve is 9"),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=message):
            run(case, **options)
    with pytest.raises(ValueError, match=r"scores query 0 and image \d+ as nan; scores must be finite"):
        run(case, lambda q, rows, images, columns: np.full(len(rows), np.nan, np.float32))
    with pytest.raises(ValueError, match="of 3, 2 and 3 images"):
        candidates.Images.of(np.eye(3, dtype=np.float32), np.eye(2), np.arange(3.0))
    with pytest.raises(ValueError, match="found int64"):
        candidates.Images.of(np.eye(3, dtype=np.int64), np.eye(3), np.arange(3.0))


# -- matching -------------------------------------------------------------------------------------------------------


def unit_features(rng, *shape):
    values = rng.standard_normal(shape).astype(np.float32)
    return values / np.linalg.norm(values, axis=-1, keepdims=True)


def mutual_pairs(query, image):
    """The definition: pairs of features that are each other's nearest; one is none."""
    products = query.reshape(-1, query.shape[-1]).astype(np.float64) @ image.reshape(-1, image.shape[-1]).T
    count = sum(products[:, products[i].argmax()].argmax() == i for i in range(len(products)))
    return 0 if count == 1 else count


@pytest.mark.parametrize("device", ["cpu", "torch"])
@pytest.mark.parametrize("memory", [1, 20_000, 2**30])
def test_mutual_nearest_features_within_any_memory(device, memory, monkeypatch):
    monkeypatch.setattr(matching, "_TILE_ROWS", 7)
    rng = np.random.default_rng(0)
    queries, images = unit_features(rng, 6, 4, 5, 8), unit_features(rng, 9, 3, 6, 8)
    images[2, 0] = queries[1, :1, :3].repeat(2, axis=1)  # some that surely match, some of them twice
    query_rows, image_rows = rng.integers(0, 6, 40), rng.integers(0, 9, 40)
    matcher = LocalMatcher(memory, "cpu" if device == "cpu" else torch.device("cpu", 0))
    expected = [mutual_pairs(queries[q], images[i]) for q, i in zip(query_rows, image_rows, strict=True)]
    assert matcher(queries, query_rows, images, image_rows).tolist() == expected
    half = matcher(queries.astype(np.float16), query_rows, images.astype(np.float16), image_rows)
    assert np.abs(half - expected).max() <= 3, "rounding moves a few matches"


def test_a_single_match_counts_as_none_as_in_the_authors_code():
    query = np.array([[[1.0, 0.0]]], np.float32)
    for device in ("cpu", torch.device("cpu", 0)):
        assert LocalMatcher(device=device)(query, np.array([0]), query, np.array([0])).tolist() == [0.0]


def test_features_are_loaded_a_few_images_at_a_time():
    """The memory budget bounds what is loaded, and each image is loaded once for each group of queries."""
    rng, loads = np.random.default_rng(0), []

    class Loading:
        def __init__(self, values):
            self.values, self.shape = values, values.shape

        def __getitem__(self, rows):
            loads.append(len(rows))
            return self.values[rows]

    values = unit_features(rng, 30, 4, 4, 8)
    size = values[0].nbytes
    images = Loading(values)
    rows = np.arange(30)
    LocalMatcher(4 * 8 * size, "cpu")(values[:8], np.repeat(np.arange(8), 30), images, np.tile(rows, 8))
    assert loads == [8, 8, 8, 6]


def test_the_cosine_of_equal_images_is_equal():
    rng = np.random.default_rng(0)
    images = unit_features(rng, 50, 4096)
    images[[3, 17, 40]] = images[11]
    scores = matching.cosines(images[:5], np.repeat(np.arange(5), 50), images, np.tile(np.arange(50), 5)).reshape(5, 50)
    np.testing.assert_allclose(scores, images[:5] @ images.T, atol=1e-6)
    assert (scores[:, [3, 17, 40]] == scores[:, [11]]).all()
