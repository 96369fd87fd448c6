"""Intervals that know that neighbours succeed and fail together."""

import types

import numpy as np
import pytest
from scipy.stats import kendalltau, norm

from artifact import evaluate
from artifact.metrics.statistics import (
    block_length,
    ends,
    holm,
    intervals,
    p_values,
    rank_agreement,
    replicates,
    widened,
)

SHIFT, REACH = 0.15, 8
"""Difference of two methods' success rates in the simulations, and over how many queries successes are correlated."""


def runs(n, length, seed=0):
    """An evaluation whose hits come in runs of consecutive queries."""
    rng = np.random.default_rng(seed)
    good = np.repeat(rng.random(-(-n // length)) < 0.5, length)[:n]
    queries = np.eye(n, dtype=np.float32)
    database = np.where(good[:, None], queries, np.roll(queries, 1, axis=1) + 0.1 * queries).astype(np.float32)
    return evaluate(queries, database, np.arange(n) * 10.0, np.arange(n) * 10.0, 5.0)


def literal(values, block, count, seed, stream):
    """Replicates by gathering every query of every block."""
    import zlib

    n, rng = len(values), np.random.default_rng([seed, zlib.crc32(stream.encode())])
    starts = rng.integers(0, n, (count, -(-n // block)))
    draws = ((starts[:, :, None] + np.arange(block)) % n).reshape(count, -1)[:, :n]
    return values[draws].mean(axis=1).T


@pytest.mark.parametrize(("n", "spacing"), [(50, 5.0), (47, 9.0), (12, 25.0), (30, 0.0)])
def test_replicates_are_means_of_circular_blocks_of_consecutive_queries(n, spacing):
    values, positions = np.random.default_rng(2).random((n, 3)), np.arange(n)[:, None] * spacing
    block = block_length(positions, 25.0)
    expected = widened(literal(values, block, 40, 7, "name"), values.mean(axis=0)[:, None], n / block)
    found = replicates(values, positions, 25.0, seed=7, stream="name", count=40)
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_replicates_are_paired_repeat_and_differ_between_datasets():
    values, positions = np.random.default_rng(0).random((90, 2)), np.arange(90.0)[:, None]
    both = replicates(values, positions, 3.0, stream="a")
    np.testing.assert_allclose(
        replicates(values[:, 0] - values[:, 1], positions, 3.0, stream="a")[0], both[0] - both[1]
    )
    np.testing.assert_array_equal(both, replicates(values, positions, 3.0, stream="a"))
    for other in ({"stream": "b"}, {"stream": "a", "seed": 1}):
        assert abs(np.corrcoef(both[0], replicates(values, positions, 3.0, **other)[0])[0, 1]) < 0.2


def test_the_same_seed_gives_the_same_interval():
    result = runs(120, 6)
    assert intervals(result, seed=4) == intervals(result, seed=4)


def test_the_interval_holds_the_value_and_stays_between_0_and_1():
    for found in intervals(runs(200, 5)).values():
        assert 0 <= found.low <= found.value <= found.high <= 1


def test_a_95_percent_interval_leaves_a_fortieth_of_the_replicates_on_each_side():
    sample = np.random.default_rng(0).permutation(np.arange(2001.0))
    np.testing.assert_allclose(ends(np.stack([sample, -sample])), [[50, -1950], [1950, -50]])
    np.testing.assert_allclose(ends(np.append(sample, np.nan)), [50, 1950], err_msg="of those that are defined")
    assert np.isnan(ends(np.full(5, np.nan))).all()


def test_the_interval_of_rsr_is_of_the_resamples_in_which_anything_is_found():
    hits = np.zeros((12, 2))
    hits[:6, 0] = hits[8] = 1
    result = types.SimpleNamespace(
        hits=lambda k, distractors: hits[:, int(distractors)],
        query_positions=np.arange(12.0)[:, None] * 10,
        threshold=15.0,
        recall=lambda k: 7 / 12,
        dar=lambda k: 1 / 12,
        rsr=lambda k: 1 / 7,
    )
    assert np.isfinite(intervals(result)["RSR"]).all()


def correlated(n, sets, seed):
    """Paired differences of hits of two methods, ``(n, sets)``: both see the same hard stretches; truth is ``SHIFT``."""
    rng, window = np.random.default_rng(seed), np.hanning(REACH + 2)[1:-1]
    spectrum = np.fft.rfft(window / np.linalg.norm(window), n)
    common, one, other = np.fft.irfft(np.fft.rfft(rng.normal(size=(3, sets, n))) * spectrum, n)
    first = 0.8 * common + 0.6 * one < norm.ppf(0.7)
    second = 0.8 * common + 0.6 * other < norm.ppf(0.7 - SHIFT)
    return (first.astype(float) - second).T


@pytest.mark.parametrize("n", [200, 1000])
def test_the_interval_of_a_paired_difference_covers_the_truth_as_often_as_it_says(n):
    """Hits correlated over about a threshold, known truth: 95 % is 92 to 98 %, and far less if queries are independent."""
    values, sets = correlated(n, 600, seed=n), 600
    metres = np.arange(n)[:, None] * 2.0
    assert block_length(metres, REACH * 2.0) == 2 * REACH

    def coverage(positions, threshold):
        low, high = ends(replicates(values, positions, threshold, count=400))
        return ((low <= SHIFT) & (high >= SHIFT)).mean()

    assert sets == values.shape[1]
    assert 0.92 <= coverage(metres, REACH * 2.0) <= 0.98
    assert coverage(np.zeros((n, 1)), 0.0) < 0.85, "queries as if they were independent"


def test_block_length_is_twice_the_threshold_along_the_path():
    assert block_length(np.arange(200.0)[:, None] * 3, 25.0) == 17
    assert block_length(np.arange(200.0)[:, None], 2.0) == 6, "at least the cube root of the number of queries"
    assert block_length(np.arange(200.0)[:, None], 0.0) == 1
    assert block_length(np.arange(8.0)[:, None], 25.0) == 2, "at most a quarter of the queries"
    assert block_length(np.zeros((5, 1)), 1.0) == 1


def test_holm_keeps_the_chance_of_any_false_difference():
    """Twenty true nulls at once: some p is below 0.05 in most runs, some adjusted one in at most about 5 %."""
    rng = np.random.default_rng(0)
    p = 2 * norm.sf(np.abs(rng.normal(size=(1000, 20))))
    assert (p < 0.05).any(axis=1).mean() > 0.5
    assert np.mean([(holm(row) < 0.05).any() for row in p]) < 0.07
    adjusted = holm(p[0])
    assert (adjusted >= p[0]).all()
    assert (np.argsort(adjusted, kind="stable") == np.argsort(np.minimum(adjusted, 1), kind="stable")).all()


def test_p_values_are_small_where_the_interval_excludes_zero():
    rng = np.random.default_rng(1)
    sample = np.array([3.0, 1.0, 0.0])[:, None] + rng.normal(size=(3, 4000))
    found = p_values(np.array([3.0, 1.0, 0.0]), sample)
    np.testing.assert_allclose(found, [0.0027, 0.317, 1.0], atol=0.02)
    assert p_values(np.array([2.0]), np.full((1, 50), 2.0))[0] == 0


def test_rank_agreement_is_kendalls_tau_b():
    rng = np.random.default_rng(0)
    for _ in range(50):
        a, b = rng.integers(0, 5, (2, int(rng.integers(2, 12)))).astype(float)
        assert rank_agreement(a, b) == pytest.approx(kendalltau(a, b).statistic, nan_ok=True)
    many = rng.random((6, 30)), rng.random((6, 30))
    expected = [kendalltau(a, b).statistic for a, b in zip(many[0].T, many[1].T, strict=True)]
    np.testing.assert_allclose(rank_agreement(*many), expected)
