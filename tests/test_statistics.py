"""Intervals that know that neighbours succeed and fail together."""

import numpy as np
import pytest
from scipy.stats import kendalltau

from artifact import evaluate
from artifact.metrics.statistics import block_length, intervals, rank_agreement, resamples


def runs(n, length, seed=0):
    """An evaluation whose hits come in runs of consecutive queries."""
    rng = np.random.default_rng(seed)
    good = np.repeat(rng.random(-(-n // length)) < 0.5, length)[:n]
    queries = np.eye(n, dtype=np.float32)
    database = np.where(good[:, None], queries, np.roll(queries, 1, axis=1) + 0.1 * queries).astype(np.float32)
    return evaluate(queries, database, np.arange(n) * 10.0, np.arange(n) * 10.0, 5.0), good


def test_resamples_are_circular_blocks_of_consecutive_queries():
    draws = resamples(50, 8, 200, seed=1)
    assert draws.shape == (200, 50)
    steps = np.diff(draws, axis=1) % 50
    inside = np.arange(1, 50) % 8 != 0
    assert (steps[:, inside] == 1).all()
    assert set(np.unique(draws)) == set(range(50))


def test_the_same_seed_gives_the_same_interval():
    result, _ = runs(120, 6)
    assert intervals(result, seed=4) == intervals(result, seed=4)
    assert intervals(result, seed=4) != intervals(result, seed=5)


def test_the_interval_holds_the_value_and_orders_its_ends():
    result, _ = runs(200, 5)
    for found in intervals(result).values():
        assert found.low <= found.value <= found.high


def test_blocks_widen_the_interval_of_correlated_hits():
    _result, good = runs(600, 30)
    blocks = np.ptp(np.quantile(good[resamples(600, 30, 2000, 0)].mean(axis=1), [0.025, 0.975]))
    single = np.ptp(np.quantile(good[resamples(600, 1, 2000, 0)].mean(axis=1), [0.025, 0.975]))
    assert blocks > 3 * single


def test_intervals_cover_the_truth_about_as_often_as_they_say():
    rng, covered = np.random.default_rng(0), 0
    for seed in range(200):
        hits = np.repeat(rng.random(40) < 0.7, 5)
        sample = hits[resamples(200, 5, 400, seed)].mean(axis=1)
        low, high = np.quantile(sample, [0.025, 0.975])
        covered += low <= 0.7 <= high
    assert 0.86 <= covered / 200 <= 0.99


def test_block_length_is_twice_the_threshold_along_the_path():
    assert block_length(np.arange(200.0)[:, None] * 3, 25.0) == 17
    assert block_length(np.arange(200.0)[:, None], 2.0) == 4
    assert block_length(np.arange(200.0)[:, None], 0.0) == 1
    assert block_length(np.arange(8.0)[:, None], 25.0) == 2, "at most a quarter of the queries"
    assert block_length(np.zeros((5, 1)), 1.0) == 1


def test_rank_agreement_is_kendalls_tau_b():
    rng = np.random.default_rng(0)
    for _ in range(50):
        a, b = rng.integers(0, 5, (2, int(rng.integers(2, 12)))).astype(float)
        assert rank_agreement(a, b) == pytest.approx(kendalltau(a, b).statistic, nan_ok=True)
