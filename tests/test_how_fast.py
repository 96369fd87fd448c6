"""What the page on speed measures is what it says; no test looks at the seconds themselves."""

import re

import numpy as np
import pytest

from artifact import pages
from artifact.commands import bench
from artifact.studies import how_fast


@pytest.fixture(scope="module")
def times():
    return how_fast.ranking_times(how_fast.synthetic(90, 120, 64), n_views=2, repeats=1)


def test_shares_are_of_the_faster_bare_product_and_looks_are_counted(times):
    bare = times["seconds"].iloc[:2].min()
    np.testing.assert_allclose(times["share"], times["seconds"] / bare)
    pairs = times.set_index("work")["pairs"]
    assert pairs[how_fast.COUNTS] == pairs[how_fast.LISTS] == 90 * 210
    assert pairs[how_fast.NO_DISTRACTORS] == 90 * 120
    assert pairs["with 2 INLP views"] == 3 * 90 * 210
    evaluations = times.dropna(subset="pairs")
    assert (evaluations["third"] <= evaluations["second"]).all()
    assert (evaluations["second"] <= evaluations["pairs"]).all()


def test_the_limit_of_symmetry():
    assert how_fast.symmetry_limit(6000, 7500) == pytest.approx(10500 / 13500)


def test_the_page_names_the_processor_and_draws_a_bar_for_each_work(times):
    assert how_fast.processor() in pages.how_fast.costs_sentence(times)
    figure = pages.how_fast.costs_figure(times).data
    for work in times["work"]:
        assert work in figure
    grown = pages.how_fast.growth_figure(how_fast.growth([20, 40], 16)).data
    assert "million pairs" in grown
    assert "In float64" in pages.how_fast.costs_table(times).data


def test_the_bench_prints_a_line_for_each_work():
    lines = list(bench.ranking_lines("made descriptors", how_fast.synthetic(60, 80, 32), 1))
    assert "symmetry leaves 0.79 of the pairs" in lines[0]
    assert any(line.startswith(f"  {how_fast.COUNTS}: ") and "in float64" in line for line in lines)
    *grown, memory = bench.growth_lines([30, 60], 16)
    assert [line.partition(":")[0] for line in grown] == [f"ranking {n} + {n} images, d = 16" for n in (30, 60)]
    assert re.fullmatch(r"  the last takes \d+ MiB beyond the descriptors", memory)


def test_memory_beyond_the_descriptors_is_that_of_a_tile_and_little_more():
    large = np.ones(2**25)  # whatever the process that asks has taken
    tile = 4 * 2048 * 8000
    assert tile < how_fast.memory_beyond_inputs(8000, 64) < tile + 100 * 2**20
    assert large.all()


def test_real_descriptors_come_again_with_noise_and_are_recognised():
    queries, database, *places = how_fast.tiled(450, 500)
    np.testing.assert_allclose(np.linalg.norm(queries, axis=1), 1, rtol=1e-6)
    assert [rows.shape for rows in (queries, database)] == [(450, 1792), (500, 1792)]
    assert [len(rows) for rows in places] == [450, 500]
    nearest = (queries @ queries[:200].T)[200:400].argmax(axis=1)
    assert (nearest == np.arange(200)).all(), "the same frame is the most similar one of the next turn"
    assert (queries[0] != queries[200]).all()
    apart = np.abs((queries @ database[:200].T).argmax(axis=1) - np.arange(450) % 200)
    assert np.median(apart) <= 2, "day and night show the same places"
