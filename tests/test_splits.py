"""Fitting and evaluation regions share no place; the probe trains and tests on different places."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from artifact.suppression.probe import probe_accuracy, probe_split
from artifact.suppression.regions import fit_region, split


@st.composite
def places(draw):
    rng = np.random.default_rng(draw(st.integers(0, 10_000)))
    axes, n, m = draw(st.integers(1, 3)), draw(st.integers(2, 80)), draw(st.integers(1, 120))
    return rng.uniform(0, 300, (n, axes)), rng.uniform(0, 300, (m, axes)), draw(st.floats(0, 60))


@settings(max_examples=300, deadline=None)
@given(places(), st.floats(0, 1), st.sampled_from(["centre", "edge"]))
def test_regions_share_no_place(case, fraction, where):
    queries, database, threshold = case
    region = split(queries, database, threshold, fraction, where=where)
    evaluated = np.flatnonzero((np.linalg.norm(queries[:, None] - database[None], axis=2) <= threshold).any(axis=1))
    assert len(region.fit_queries) == int(np.ceil(round(fraction * len(evaluated), 9)))
    assert set(region.fit_queries) <= set(evaluated)
    together = np.concatenate([region.fit_queries, region.evaluation_queries])
    assert sorted(together) == list(range(len(queries)))
    together = np.concatenate([region.fit_database, region.evaluation_database])
    assert sorted(together) == list(range(len(database)))
    apart = np.linalg.norm(queries[region.fit_queries][:, None] - database[region.evaluation_database][None], axis=2)
    assert (apart > threshold).all()
    near = np.linalg.norm(queries[region.fit_queries][:, None] - database[region.fit_database][None], axis=2)
    assert (near.min(axis=0) <= threshold).all() if len(region.fit_database) else True


@settings(max_examples=200, deadline=None)
@given(places(), st.floats(0.01, 0.5))
def test_the_evaluation_half_stays_the_same_while_the_fitting_region_grows(case, fraction):
    queries, database, threshold = case
    small = split(queries, database, threshold, fraction, evaluation_fraction=0.5)
    large = split(queries, database, threshold, 0.5, evaluation_fraction=0.5)
    np.testing.assert_array_equal(small.evaluation_queries, large.evaluation_queries)
    np.testing.assert_array_equal(small.evaluation_database, large.evaluation_database)
    assert set(small.fit_queries) <= set(large.fit_queries)
    assert not set(small.fit_queries) & set(small.evaluation_queries)


@settings(max_examples=200, deadline=None)
@given(places(), st.floats(0, 1))
def test_the_centre_holds_the_queries_nearest_to_the_mean(case, fraction):
    queries, _, _ = case
    chosen = fit_region(queries, fraction)
    if queries.shape[1] == 1:
        order = np.argsort(queries[:, 0], kind="stable")
        ranks = np.sort(np.flatnonzero(np.isin(order, chosen)))
        assert len(ranks) < 2 or (np.diff(ranks) == 1).all()
        before, after = (ranks[0], len(queries) - 1 - ranks[-1]) if len(ranks) else (0, 0)
        assert abs(int(before) - int(after)) <= 1
    else:
        away = np.linalg.norm(queries - queries.mean(axis=0), axis=1)
        rest = np.setdiff1d(np.arange(len(queries)), chosen)
        assert not len(chosen) or not len(rest) or away[chosen].max() <= away[rest].min()


def test_the_edge_is_a_slice_across_the_longest_direction():
    rng = np.random.default_rng(0)
    positions = np.column_stack([rng.uniform(0, 1000, 200), rng.uniform(0, 50, 200)])
    chosen = fit_region(positions, 0.1, "edge")
    assert positions[chosen, 0].max() < np.delete(positions[:, 0], chosen).min() + 60
    assert np.ptp(positions[chosen, 1]) > 30


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"fraction": 1.2}, "fraction is 1.2; allowed"),
        ({"fraction": 0.2, "where": "corner"}, "where is 'corner'; allowed"),
    ],
)
def test_bad_regions_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        fit_region(np.zeros((5, 2)), **arguments)


def test_fractions_that_overlap_are_named():
    with pytest.raises(ValueError, match="exceed 1 together"):
        split(np.zeros((5, 2)), np.zeros((5, 2)), 1.0, 0.6, evaluation_fraction=0.5)


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 10_000), st.integers(8, 60), st.integers(8, 90))
def test_probe_halves_are_balanced_and_apart(seed, n, m):
    rng = np.random.default_rng(seed)
    queries = np.column_stack([rng.uniform(0, 500, n), rng.uniform(0, 80, n)])
    database = np.column_stack([rng.uniform(0, 500, m), rng.uniform(0, 80, m)])
    along = np.linalg.svd(queries - queries.mean(axis=0), full_matrices=False)[2][0]
    cut = np.median((queries - queries.mean(axis=0)) @ along)
    behind = int(((database - queries.mean(axis=0)) @ along <= cut).sum())
    if min(behind, m - behind) < 2:
        with pytest.raises(ValueError, match="two of each"):
            probe_split(queries, database, seed)
        return
    rows = probe_split(queries, database, seed)
    assert len(rows.train_queries) == len(rows.train_database) >= 2
    assert len(rows.test_queries) == len(rows.test_database) >= 2
    assert not set(rows.train_queries) & set(rows.test_queries)
    assert not set(rows.train_database) & set(rows.test_database)


def test_the_probe_finds_a_linear_condition_and_only_that():
    rng = np.random.default_rng(3)
    where = np.column_stack([np.arange(200.0), np.zeros(200)])
    queries, database = rng.standard_normal((2, 200, 10))
    rows = probe_split(where, where)
    assert abs(probe_accuracy(queries, database, rows) - 0.5) < 0.12
    queries[:, 4] += 4
    assert probe_accuracy(queries, database, rows) > 0.95
