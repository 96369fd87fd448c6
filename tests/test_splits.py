"""Fitting and evaluation regions share no place; the probe trains and tests on different places."""

import functools
import importlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.svm import LinearSVC

from artifact import LEACE, STD, probe
from artifact.suppression.probe import probe_split
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
        assert not len(chosen) or 0 <= int(after) - int(before) <= 1, "the middle, or just before it"
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
@given(st.integers(0, 10_000), st.integers(8, 60), st.integers(8, 90), st.floats(0, 80))
def test_probe_halves_are_balanced_and_apart(seed, n, m, threshold):
    rng = np.random.default_rng(seed)
    queries = np.column_stack([rng.uniform(0, 500, n), rng.uniform(0, 80, n)])
    database = np.column_stack([rng.uniform(0, 500, m), rng.uniform(0, 80, m)])
    along = np.linalg.svd(queries - queries.mean(axis=0), full_matrices=False)[2][0]
    border = np.median(queries @ along)
    beyond = [
        (np.abs(x @ along - border) > threshold / 2) & (np.sign(x @ along - border) == s)
        for x in (queries, database)
        for s in (-1, 1)
    ]
    if min(group.sum() for group in beyond) < 2:
        with pytest.raises(ValueError, match="two of each"):
            probe_split(queries, database, threshold, seed)
        return
    train, test = probe_split(queries, database, threshold, seed)
    for half in (train, test):
        assert len(half.queries) == len(half.database) >= 2
    sizes = sorted(min(beyond[half].sum(), beyond[2 + half].sum()) for half in (0, 1))
    assert sorted([len(train.queries), len(test.queries)]) == sizes, "nothing more than the gap and the balance leaves"
    near, far = (np.concatenate([queries[half.queries], database[half.database]]) for half in (train, test))
    assert np.linalg.norm(near[:, None] - far[None], axis=2).min() > threshold


def test_the_probe_finds_a_linear_condition_and_only_that():
    rng = np.random.default_rng(3)
    where = np.column_stack([np.arange(200.0), np.zeros(200)])
    queries, database = rng.standard_normal((2, 200, 10))
    found = probe(queries, database, where, where, 10.0)
    assert abs(found.accuracy - 0.5) < 0.12
    assert found.converged
    assert [len(half.queries) for half in probe_split(where, where, 10.0)] == [95, 95]
    queries[:, 4] += 4
    assert probe(queries, database, where, where, 10.0).accuracy > 0.95


@pytest.mark.parametrize(("n", "d"), [(120, 400), (400, 60)])
@pytest.mark.parametrize("erased", [None, "low rank", "std"])
def test_the_probe_is_the_default_classifier_on_the_transformed_descriptors(n, d, erased, monkeypatch):
    """With fewer rows than columns and with more, read in many blocks: the accuracy of the classifier on the rows themselves."""
    monkeypatch.setattr(importlib.import_module("artifact.suppression.probe"), "_BLOCK", 7 * d)
    rng = np.random.default_rng(5)
    queries, database = (rng.standard_normal((2, n, d)) + 0.12 * rng.standard_normal((2, 1, d))).astype(np.float32)
    queries[1], where = queries[0], np.arange(float(n))  # two equal rows: their inner products are singular
    both, condition = np.concatenate([queries, database]), np.repeat([0, 1], n)
    few = np.arange(0, 2 * n, 3)
    transform = {None: None, "low rank": LEACE(), "std": STD()}[erased]
    shown = queries, database
    if transform is not None:
        transform.fit(both[few], condition[few])
        shown = [transform.transform(x, *([c] if erased == "std" else [])) for c, x in enumerate(shown)]
    train, test = probe_split(where, where, 3.0)
    rows = [
        np.concatenate([images[chosen] for images, chosen in zip(shown, half, strict=True)]) for half in (train, test)
    ]
    labels = [np.repeat([0, 1], len(half.queries)) for half in (train, test)]
    expected = LinearSVC(random_state=0, max_iter=100_000).fit(rows[0], labels[0]).score(rows[1], labels[1])
    found = probe(queries, database, where, where, 3.0, transform=transform)
    assert 0.2 < expected < 1
    assert found.accuracy == pytest.approx(expected, abs=1.01 / len(labels[1]))


def test_a_probe_that_does_not_converge_says_so(monkeypatch):
    module = importlib.import_module("artifact.suppression.probe")
    monkeypatch.setattr(module, "LinearSVC", functools.partial(LinearSVC, max_iter=2))
    queries, database = np.random.default_rng(0).standard_normal((2, 60, 200))
    assert not probe(queries, database, np.arange(60.0), np.arange(60.0), 1.0).converged
