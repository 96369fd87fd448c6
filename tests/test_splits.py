"""Fitting and evaluation regions share no place; the probe trains and tests on different places."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.svm import LinearSVC

import artifact
from artifact.suppression.probe import probe_on, probe_split
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
@given(st.integers(0, 10_000), st.integers(8, 60), st.integers(8, 90), st.sampled_from([0.0, 5.0, 60.0]))
def test_probe_halves_are_balanced_and_apart(seed, n, m, threshold):
    rng = np.random.default_rng(seed)
    queries = np.column_stack([rng.uniform(0, 500, n), rng.uniform(0, 80, n)])
    database = np.column_stack([rng.uniform(0, 500, m), rng.uniform(0, 80, m)])
    along = np.linalg.svd(queries - queries.mean(axis=0), full_matrices=False)[2][0]
    places = [(part - queries.mean(axis=0)) @ along for part in (queries, database)]
    cut = np.median(places[0])
    sizes = [(part <= cut - threshold / 2).sum() for part in places] + [
        (part > cut + threshold / 2).sum() for part in places
    ]
    if min(sizes) < 2:
        with pytest.raises(ValueError, match="two of each"):
            probe_split(queries, database, threshold, seed)
        return
    rows = probe_split(queries, database, threshold, seed)
    assert len(rows.train_queries) == min(sizes[:2])
    assert len(rows.test_queries) == min(sizes[2:])
    trained = np.concatenate([queries[rows.train_queries], database[rows.train_database]])
    tested = np.concatenate([queries[rows.test_queries], database[rows.test_database]])
    assert np.linalg.norm(trained[:, None] - tested, axis=2).min() > threshold
    assert len(rows.train_queries) == len(rows.train_database) >= 2
    assert len(rows.test_queries) == len(rows.test_database) >= 2
    assert not set(rows.train_queries) & set(rows.test_queries)
    assert not set(rows.train_database) & set(rows.test_database)


def test_the_probe_finds_a_linear_condition_and_only_that():
    rng = np.random.default_rng(3)
    where = np.column_stack([np.arange(200.0), np.zeros(200)])
    queries, database = rng.standard_normal((2, 200, 10))
    assert abs(artifact.probe(queries, database, where, where, 5.0).accuracy - 0.5) < 0.12
    queries[:, 4] += 4
    assert artifact.probe(queries, database, where, where, 5.0).accuracy > 0.95
    found = artifact.probe(
        queries,
        database,
        where,
        where,
        5.0,
        transform=lambda block, name: block - 4 * (name == "query") * np.eye(10)[4],
    )
    assert abs(found.accuracy - 0.5) < 0.12


@pytest.mark.parametrize(("n", "d"), [(40, 300), (150, 120), (30, 31)])
def test_the_probe_is_the_default_classifier_whatever_the_shape(n, d):
    """Fewer rows than columns are classified by the factor of their Gram matrix: the same classifier."""
    rng = np.random.default_rng(n)
    where = np.column_stack([np.arange(2.0 * n), np.zeros(2 * n)])
    queries, database = rng.standard_normal((2, 2 * n, d)).astype(np.float32)
    queries += 0.15
    rows = probe_split(where, where, 3.0)
    labels = np.repeat([0, 1], len(rows.train_queries))
    train = np.concatenate([queries[rows.train_queries], database[rows.train_database]])
    test = np.concatenate([queries[rows.test_queries], database[rows.test_database]])
    plain = LinearSVC(random_state=0).fit(train.astype(np.float64), labels)
    found = probe_on(queries, database, rows)
    expected = plain.score(test.astype(np.float64), np.repeat([0, 1], len(rows.test_queries)))
    assert abs(found.accuracy - expected) <= 1 / len(test)
    assert found.converged == (plain.n_iter_ < plain.max_iter)


def test_a_probe_that_does_not_converge_says_so():
    rng = np.random.default_rng(0)
    where = np.column_stack([np.arange(400.0), np.zeros(400)])
    queries = rng.standard_normal((400, 420))
    assert not artifact.probe(queries, queries + 0.01 * rng.standard_normal((400, 420)), where, where, 2.0).converged
    assert artifact.probe(queries + 1, queries - 1, where, where, 2.0).converged
