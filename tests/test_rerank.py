"""Two-stage methods against the definition: build the augmented database, sort, cut, score, sort again, look."""

import functools
import inspect
import itertools
import shutil
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import torch
from conftest import tiny_manifest, write_images, write_manifest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracle import distance, share, similarity
from torch import nn
from torch.nn import functional

from artifact import INLP, LEACE, datasets, manifest, methods, store, studies
from artifact.book.notebooks import Task
from artifact.commands import jobs, verify
from artifact.datasets.images import read_image
from artifact.extraction import extract, parts
from artifact.extraction.stored import descriptor_key, second_stage_key
from artifact.manifest.entries import ManifestError
from artifact.methods.preprocessing import prepare
from artifact.metrics import two_stage
from artifact.metrics.evaluate import evaluate
from artifact.metrics.statistics import intervals
from artifact.metrics.two_stage import Sweep, TwoStageEvaluation, evaluate_two_stage
from artifact.ranking import candidates, matching, one_pass
from artifact.ranking.matching import LocalMatcher
from artifact.studies import evaluated


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
        return out * rng.choice([-1.0, 1.0], (n, 4)).astype(np.float32)

    place = lambda n: rng.integers(0, 5, (n, 2)) * 5.0  # noqa: E731
    own = rng.random() < 0.5
    values = rng.choice([2, 4, 1000])
    n_pool = n_queries if own else n_pool
    return Case(
        images(n_queries),
        images(n_database),
        place(n_queries),
        place(n_database),
        float(rng.choice([0.0, 5.0, 10.0])),
        rng.integers(0, values, (n_queries, n_database)),
        None if own else images(n_pool),
        None if own else place(n_pool),
        rng.integers(0, values, (n_queries, n_pool)),
    )


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
        images("queries", case.queries, case.query_positions),
        images("database", case.database, case.database_positions),
        case.threshold,
        scores or Table(case),
        pools,
        **options,
    )


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
            column = f"rank{'_with_distractors' * distractors}{'_against' * (ties == 'against')}"
            np.testing.assert_array_equal(result.per_query()[column], expected)
        indices, scores = result.retrieved(min(n, 3), distractors=distractors)
        for row in range(len(definition.kept)):
            wanted = definition.reranked(row, n, with_distractors=distractors)[: min(n, 3)]
            shown = [index + len(case.database) * (kind == DISTRACTOR) for _, kind, index, _, _ in wanted]
            assert indices[row].tolist() == shown + [-1] * (min(n, 3) - len(wanted))
            assert scores[row, : len(wanted)].tolist() == [e[3] for e in wanted]
    limits = [case.threshold, case.threshold + 3, case.threshold + 5, case.threshold + 12, np.inf]
    by_limit = [definition.ranks(n, beyond=limit) for limit in limits]
    sizes = range(result.n_distractors + 1)
    orders = one_pass.draw_orders(result.n_distractors, one_pass.Options(draws=2))
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
    for seed in range(150):
        check_against_definition(random_case([n, seed]), n)


@settings(max_examples=150, deadline=None)
@given(st.integers(0, 10**9), st.integers(1, 12))
def test_ranks_and_sweeps_equal_the_definition_property(seed, n):
    check_against_definition(random_case(seed, largest=18), n)


def unit_features(rng, *shape):
    values = rng.standard_normal(shape).astype(np.float32)
    return values / np.linalg.norm(values, axis=-1, keepdims=True)


def continuous_case(seed, n_queries=12, n_database=30, n_pool=60):
    """A case without ties at either stage, with more distractors than candidates."""
    rng = np.random.default_rng(seed)
    unit = lambda n: unit_features(rng, n, 8)  # noqa: E731
    lean = lambda n: unit(n) + np.float32(0.5)  # noqa: E731
    return Case(
        lean(n_queries),
        unit(n_database),
        rng.uniform(0, 30, (n_queries, 2)),
        rng.uniform(0, 30, (n_database, 2)),
        8.0,
        rng.permutation(n_queries * n_database).reshape(n_queries, -1),
        lean(n_pool),
        rng.uniform(0, 30, (n_pool, 2)),
        rng.permutation(n_queries * n_pool).reshape(n_queries, -1),
    )


def test_only_pairs_that_can_be_candidates_are_scored_and_each_once():
    """For R and DAR the candidates of both; for the sweeps those of every number in every draw and every distance."""
    n = 4
    for seed in range(4):
        case = continuous_case(seed)
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
            for order in one_pass.draw_orders(len(case.pool), one_pass.Options(draws=2)).T:
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
        case.queries,
        case.database,
        case.query_positions,
        case.database_positions,
        case.threshold,
        {"other": case.pool},
        {"other": case.pool_positions},
        draws=3,
    )
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
        vectors([1.0]),
        vectors(first),
        np.zeros((1, 1)),
        where,
        1.0,
        np.array([second]),
        vectors(pool_first),
        np.full((len(pool_first), 1), 50.0),
        np.array([pool_second]),
    )


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


@pytest.mark.parametrize("seed", range(6))
def test_parts_of_the_queries_put_together_are_the_whole(seed):
    case = continuous_case(seed)
    whole = run(case, candidates=3, draws=2, retrieve=2)
    ends = [*sorted({0, whole.n_queries // 3, whole.n_queries // 2}), whole.n_queries]
    parts = [
        run(case, candidates=3, draws=2, retrieve=2, rows=slice(start, end))
        for start, end in itertools.pairwise(ends)
        if end > start
    ]
    assert sum(part.n_queries for part in parts) == whole.n_queries
    for found, expected in (
        (two_stage.joined([part.arrays() for part in parts]), whole.arrays()),
        (
            two_stage.joined([part.sweep_of(part.pool_name).arrays() for part in parts]),
            whole.sweep_of(whole.pool_name).arrays(),
        ),
    ):
        assert found.keys() == expected.keys()
        for name, array in expected.items():
            np.testing.assert_array_equal(found[name], array, err_msg=name)


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
        images("queries", case.queries, case.query_positions),
        images("database", case.database, case.database_positions),
        case.threshold,
        table,
        pools,
        candidates=4,
        draws=1,
        retrieve=2,
    )
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
                (
                    rebuilt.pool(name).retrieved(2, distractors=distractors)[0],
                    both.pool(name).retrieved(2, distractors=distractors)[0],
                ),
            ):
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
        ({"candidates": 0}, "candidates is 0"),
        ({"draws": 0}, "draws is 0"),
        ({"retrieve": 9, "candidates": 4}, "retrieve is 9"),
    ):
        with pytest.raises(ValueError, match=message):
            run(case, **options)
    with pytest.raises(ValueError, match=r"scores query 0 and image \d+ as nan; scores must be finite"):
        run(case, lambda q, rows, images, columns: np.full(len(rows), np.nan, np.float32))
    with pytest.raises(ValueError, match="of 3, 2 and 3 images"):
        candidates.Images.of(np.eye(3, dtype=np.float32), np.eye(2), np.arange(3.0))
    with pytest.raises(ValueError, match="found int64"):
        candidates.Images.of(np.eye(3, dtype=np.int64), np.eye(3), np.arange(3.0))


# -- matching -------------------------------------------------------------------------------------------------------


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


@pytest.mark.parametrize("there", [False, True])
def test_features_are_matched_by_a_device_if_it_is_asked_for_or_there(there, monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: there)
    on_processor = {
        device: LocalMatcher(device=device)._backend() == (matching._features, matching._match_on_cpu)
        for device in (None, "cpu", "cuda")
    }
    assert on_processor == {None: not there, "cpu": True, "cuda": False}


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


# -- local features and codes on disk, and the way from images to metrics -------------------------------------------


class TinyLocal(nn.Module):
    """Descriptors and 3 × 4 local features of 6 dimensions, by fixed random maps of the image's patches."""

    seen = 0

    def __init__(self):
        super().__init__()
        generator = torch.Generator().manual_seed(0)
        self.register_buffer("local_map", torch.randn(8 * 8, 6, generator=generator))
        self.register_buffer("map", torch.randn(24 * 32, 5, generator=generator))

    def forward(self, images):
        return functional.normalize((images - images.mean(dim=(2, 3), keepdim=True)).flatten(1) @ self.map, dim=1)

    def global_and_local(self, images):
        TinyLocal.seen += len(images)
        patches = functional.unfold(images, 8, stride=8).transpose(1, 2)
        local = (patches - patches.mean(dim=2, keepdim=True)) @ self.local_map
        return self(images), functional.normalize(local, dim=-1).reshape(len(images), 3, 4, 6)


class TinyCodes(TinyLocal):
    """Descriptors and hash codes of 12 bits."""

    def descriptors_and_codes(self, images):
        TinyLocal.seen += len(images)
        values = self.global_and_local(images)[1].flatten(1)[:, :12]
        return self(images), torch.where(values >= 0, 1, -1).to(torch.int8)


class Wrong(TinyLocal):
    def global_and_local(self, images):
        descriptors, local = super().global_and_local(images)
        return descriptors, 3 * local


TINY = {
    "title": "Tiny",
    "kind": "baseline",
    "backbone": "–",
    "aggregation": "random",
    "dimension": 5,
    "rerank": 4,
    "batch_size": 5,
    "preprocessing": {"resize": "fixed", "size": [24, 32], "colour": "grey", "mean": [0.0], "std": [1.0]},
}
LOCAL = TINY | {"builder": f"{__name__}:TinyLocal", "local_features": {"shape": [3, 4, 6]}}
HALF = TINY | {"builder": f"{__name__}:TinyLocal", "local_features": {"shape": [3, 4, 6], "dtype": "float16"}}
CODES = TINY | {"builder": f"{__name__}:TinyCodes", "code_bits": 12}


def loaded(project, **methods):
    content = tiny_manifest()
    content["methods"] |= {"local": LOCAL, "half": HALF, "codes": CODES} | methods
    found = manifest.load(write_manifest(project, content))
    return found, datasets.load_traversal(found, "street", "day")


@pytest.fixture
def small_parts(monkeypatch):
    """A batch of five images in each part."""
    monkeypatch.setattr(parts, "_BATCHES", 1)


def model_outputs(found, traversal, method):
    entry = found.method(method)
    images = [
        prepare(read_image(path, entry.preprocessing.colour), entry.preprocessing) for path in traversal.image_paths()
    ]
    model = methods.model_of(method, entry)
    both = model.descriptors_and_codes if entry.code_bits else model.global_and_local
    with torch.inference_mode():
        return [output.numpy() for output in both(torch.stack(images))]


def test_both_outputs_come_from_one_pass_and_are_stored_in_parts(project, small_parts):
    found, traversal = loaded(project)
    for method, dtype, tolerance in (("local", np.float32, 1e-6), ("half", np.float16, 1e-3)):
        expected, features = model_outputs(found, traversal, method)
        TinyLocal.seen = 0
        stored = extract.second_stage(found, traversal, method, workers=0)
        assert TinyLocal.seen == len(traversal)
        assert (stored.shape, stored.dtype, len(stored)) == ((12, 3, 4, 6), dtype, 12)
        assert len(stored.parts) == 3
        assert isinstance(stored.parts.read(1, pytest.fail), np.memmap)
        rows = np.array([11, 0, 5, 4, 11])
        np.testing.assert_allclose(stored[rows], features[rows], atol=tolerance)
        np.testing.assert_allclose(extract.descriptors(found, traversal, method).values, expected, atol=1e-6)
        assert TinyLocal.seen == len(traversal), "nothing was computed again"
    packed = extract.second_stage(found, traversal, "codes", workers=0)
    codes = model_outputs(found, traversal, "codes")[1]
    np.testing.assert_array_equal(np.unpackbits(packed[np.arange(12)], axis=1)[:, :12], codes > 0)
    assert packed.shape == (12, 2)
    lines, _ = verify.verify(found, "demo")
    assert lines[0].endswith(".cache: 12 stored results, 0 damaged"), "each part's sidecar tells its digest"


def test_descriptors_alone_do_not_need_the_local_features(project):
    found, traversal = loaded(project)
    first = extract.second_stage(found, traversal, "local", workers=0)
    before = extract.descriptors(found, traversal, "local").sha256
    shutil.rmtree(first.parts.folder)
    TinyLocal.seen = 0
    assert extract.descriptors(found, traversal, "local").sha256 == before
    assert TinyLocal.seen == 0
    again = extract.second_stage(found, traversal, "local", workers=0)
    assert TinyLocal.seen == len(traversal)
    np.testing.assert_array_equal(again[np.arange(12)], first[np.arange(12)])
    assert extract.descriptors(found, traversal, "local").sha256 == before
    assert sorted(path.name for path in again.parts.folder.iterdir()) == ["00000.json", "00000.npy"]


def test_another_dtype_is_another_result_but_the_descriptors_are_shared(project):
    found, traversal = loaded(project)
    keys = {second_stage_key(traversal, "local", found.method(method)) for method in ("local", "half")}
    assert len(keys) == 2
    assert len({descriptor_key(traversal.digest, "x", found.method(method)) for method in ("local", "half")}) == 1


@pytest.mark.parametrize("stop", [1, 2, 3])
def test_interrupted_and_resumed_the_bytes_are_the_same(project, small_parts, monkeypatch, stop):
    found, traversal = loaded(project)
    whole = part_bytes(extract.second_stage(found, traversal, "local", workers=0))
    shutil.rmtree(project / ".cache")
    original, calls = TinyLocal.global_and_local, []

    def stopping(self, images):
        calls.append(len(images))
        if len(calls) == stop:
            raise KeyboardInterrupt
        return original(self, images)

    monkeypatch.setattr(TinyLocal, "global_and_local", stopping)
    with pytest.raises(KeyboardInterrupt):
        extract.descriptors(found, traversal, "local", workers=0)
    assert len(list((project / ".cache" / "local_features").rglob("0*.json"))) == stop - 1
    stored = extract.second_stage(found, traversal, "local", workers=0)
    assert sum(calls) == len(traversal) + [5, 5, 2][stop - 1], "only the part in progress was described again"
    assert part_bytes(stored) == whole


def part_bytes(stored):
    return [stored.parts.path(number).read_bytes() for number in range(len(stored.parts))]


def test_the_disk_is_checked_before_anything_is_computed(project, monkeypatch, capsys):
    found, traversal = loaded(project)
    need = len(traversal) * 3 * 4 * 6 * 4
    extract.check_disk(found, [traversal], ["local", "half", "hog"])
    said = capsys.readouterr().err
    assert f"local features and codes of local · street/day, half · street/day need {need * 1.5 / 1000:.1f} kB" in said
    free = shutil.disk_usage(project)
    monkeypatch.setattr(methods, "model_of", lambda *_: pytest.fail("a model was built"))
    monkeypatch.setattr(shutil, "disk_usage", lambda _: free._replace(free=need - 1))
    for attempt in (
        lambda: extract.descriptors(found, traversal, "local", workers=0),
        lambda: evaluated.evaluation(found, "street", "local"),
    ):
        with pytest.raises(store.StoreError, match=r"local · street/day.* of disk, 3.5 kB are free.* 'dtype: float16'"):
            attempt()
    assert not list((project / ".cache").rglob("*.npy"))


def test_entries_and_models_that_do_not_fit_are_named(project):
    for change, message in (
        ({"rerank": None}, "found local_features without rerank"),
        ({"code_bits": 8}, "found local_features and code_bits together"),
        ({"local_features": {"shape": [3]}}, "shape"),
        ({"local_features": {"shape": [3, 4], "dtype": "int8"}}, "allowed: 'float32' or 'float16'"),
    ):
        with pytest.raises(ManifestError, match=message):
            loaded(project, local=LOCAL | change)
    found, traversal = loaded(
        project,
        none=TINY | {"builder": f"{__name__}:TinyLocal", "code_bits": 8},
        odd=LOCAL | {"local_features": {"shape": [4, 3, 6]}},
        long=LOCAL | {"builder": f"{__name__}:Wrong"},
        silent=TINY | {"builder": f"{__name__}:TinyLocal"},
    )
    for method, message in (
        ("none", r"key 'code_bits', but the model has no descriptors_and_codes\(images\)"),
        ("odd", r"shape \(3, 4, 6\) each, the manifest says \(4, 3, 6\)"),
        ("long", "of length 1 along the last axis; found lengths from 3"),
    ):
        with pytest.raises(ManifestError, match=message):
            extract.descriptors(found, traversal, method, workers=0)
    with pytest.raises(ManifestError, match=r"methods\.hog has neither local_features nor code_bits"):
        extract.second_stage(found, traversal, "hog")
    with pytest.raises(ManifestError, match="silent re-ranks 4 candidates, but does not say by what"):
        evaluated.evaluation(found, "street", "silent")
    with pytest.raises(ValueError, match="compare in their own ways"):
        evaluated.evaluation(found, "street", "local", similarity="l2")


@pytest.mark.parametrize("method", ["local", "half", "codes"])
def test_from_images_to_metrics_and_sweeps(project, method, monkeypatch):
    """The pipeline against the definition, from what the model gives; stored results need no model and no features."""
    found, query = loaded(project)
    database = datasets.load_traversal(found, "street", "night")
    (near, near_second), (far, far_second) = (model_outputs(found, t, method) for t in (query, database))
    if method == "codes":
        pack = lambda codes: np.packbits(codes > 0, axis=1)  # noqa: E731
        first, second = (pack(near_second), pack(far_second)), (near, far)
        score = lambda q, i: np.float32(q.astype(np.float64) @ i)  # noqa: E731
    else:
        dtype = found.method(method).local_features.dtype
        first, second = (near, far), (near_second.astype(dtype), far_second.astype(dtype))
        score = mutual_pairs
    if method == "half":  # ranked in parts of the queries
        monkeypatch.setattr(evaluated, "QUERIES_EACH", 5)
    tables = [np.array([[score(q, i) for i in images] for q in second[0]]) for images in (second[1], second[0])]
    case = Case(*first, query.positions, database.positions, 1.0, tables[0], None, None, tables[1])
    definition = Definition(case)
    result = evaluated.evaluation(found, "street", method, retrieve=2).evaluation
    for distractors in (False, True):
        expected = definition.ranks(4, with_distractors=distractors)
        np.testing.assert_array_equal(result.ranks(distractors=distractors), expected)
    limits = [1.0, 3.0, 7.0, np.inf]
    expected = [share(definition.ranks(4, beyond=limit), 1) for limit in limits]
    np.testing.assert_array_equal(result.dar_by_distance(limits), expected)
    assert result.dar_by_ratio([0, 1]).tolist() == [result.recall(), result.dar()]
    shutil.rmtree(project / ".cache" / "local_features")
    monkeypatch.setattr(methods, "model_of", lambda *_: pytest.fail("a model was built"))
    again = evaluated.evaluation(found, "street", method, retrieve=2).evaluation
    np.testing.assert_array_equal(again.dar_by_distance(limits), expected)
    np.testing.assert_array_equal(again.retrieved(2, distractors=True)[0], result.retrieved(2, distractors=True)[0])


def test_ranking_again_by_local_features_is_cut_into_jobs_of_some_queries(project, monkeypatch):
    monkeypatch.setattr(evaluated, "QUERIES_EACH", 5)
    found, _ = loaded(project)
    parameters = {"k": 1, "seed": 0, "ratios": [0.5], "distances": [1.0], "draws": 2, "dataset": "street"}
    graph = jobs.graph(
        found, [Task(Path(f"{page}.py"), parameters, ("street",), ("local",)) for page in ("tab03", "fig06")]
    )
    again = [job for job in graph if job.kind == "rank again"]
    assert [job.name for job in again] == [
        f"rank again local street {what} {part}" for what in ("ranking", "sweep") for part in range(3)
    ]
    table, number, _ = (
        job for job in graph if job.kind in ("recall_table", "distractor_number", "distractor_distance")
    )
    assert {job.name for job in again[:3]} <= set(table.needs)
    assert {job.name for job in again} <= set(number.needs)
    assert all(job.on_device for job in again)
    assert not table.on_device
    for name in ("day", "night"):
        extract.descriptors(found, datasets.load_traversal(found, "street", name), "local", workers=0)
    for job in reversed(again):
        job.work(found)
    monkeypatch.setattr(LocalMatcher, "__call__", lambda *_: pytest.fail("ranked again"))
    read = replace(found, results=[])
    for job in (table, number):
        job.work(read)
    assert len(set(read.results)) == 2, "parts are no results of a page"


def test_studies_take_two_stage_methods_as_any_other(project):
    write_images(project / "data" / "street" / "rain", 12, seed=1, brightness=20)
    content = tiny_manifest()
    content["methods"] |= {"local": LOCAL, "codes": CODES}
    content["datasets"]["street"]["traversals"]["rain"] = {"condition": "rain"}
    content["datasets"]["street"]["distractor_traversals"] = ["rain"]
    found = manifest.load(write_manifest(project, content))
    names = ["hog", "local", "codes"]
    table = studies.recall.recall_table(found, ["street"], names, k=2).table
    assert table["method"].tolist() == names
    assert table[["R", "DAR", "R_low", "DAR_high"]].notna().all(axis=None)
    number = studies.distractors.distractor_number(found, "street", names, [0.0, 0.5, 1.0]).table
    ends = number.pivot_table(index="method", columns="ratio", values="DAR")
    first = studies.recall.recall_table(found, ["street"], names).table.set_index("method")
    np.testing.assert_allclose(ends[0.0], first.loc[ends.index, "R"])
    np.testing.assert_allclose(ends[1.0], first.loc[ends.index, "DAR"])
    distance = studies.distractors.distractor_distance(found, "street", names, [1.0, 4.0, np.inf]).table
    np.testing.assert_allclose(
        distance[distance["distance"] == 1.0].set_index("method").loc[names, "DAR"], first.loc[names, "DAR"]
    )
    condition = studies.distractors.distractor_condition(found, "street", names).table
    assert condition.groupby("method")["traversal"].apply(list).loc["local"] == ["day", "rain", "none"]


selavpr, selavprpp = (functools.partial(methods.build, name) for name in ("selavpr", "selavprpp"))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "layout"),
    [("selavpr", {"local_features": {"shape": [61, 61, 128], "dtype": "float16"}}), ("selavprpp", {"code_bits": 512})],
)
def test_the_architectures_offer_what_their_layouts_say(project, name, layout):
    """The real models, untrained, on four images of each traversal: an image is nearest to itself."""
    side = 224 if name == "selavpr" else 112
    for traversal in ("day", "night"):
        for path in sorted((project / "data" / "street" / traversal).glob("frame*.png"))[3:]:
            path.unlink()
    entry = (
        TINY
        | layout
        | {
            "builder": f"{__name__}:{name}",
            "dimension": 1024 if name == "selavpr" else 4096,
            "batch_size": 3,
            "preprocessing": {"resize": "fixed", "size": [side, side]},
        }
    )
    found, traversal = loaded(project, real=entry)
    stored = extract.second_stage(found, traversal, "real", workers=0)
    values = extract.descriptors(found, traversal, "real").values
    if name == "selavpr":
        images = candidates.Images.of(values, stored, traversal.positions)
        scores = LocalMatcher(device="cpu")
    else:
        images = candidates.Images.of(stored[np.arange(3)], values, traversal.positions)
        scores = matching.cosines
    result = evaluate_two_stage(images, images, 0.0, scores, candidates=2)
    assert result.recall(1) == 1.0


@pytest.mark.parametrize(
    ("function", "defaults"),
    [
        (evaluate, {"similarity": "cosine", "depth": 10, "draws": 10, "retrieve": 0, "view_sweeps": False, "seed": 0}),
        (evaluate_two_stage, {"candidates": 100, "retrieve": 0, "draws": 10, "seed": 0}),
        (two_stage.sweep, {"candidates": 100, "draws": 10, "seed": 0}),
        (INLP, {"n_iterations": 35, "seed": 0}),
        (LEACE, {"shrinkage": False}),
    ],
)
def test_the_defaults_are_those_of_the_protocol(function, defaults):
    parameters = inspect.signature(function).parameters
    assert {name: parameters[name].default for name in defaults} == defaults
