"""Streets, houses and routes that hold together, in any town."""

import itertools

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from artifact_city import kernel
from artifact_city.palette import SIGN, choose
from artifact_city.routes import drive_path, junctions_of
from artifact_city.streets import blocks, make_plan, railway
from artifact_city.town import make_town
from city.helpers import SEEDS, outside, overlap, pairs_near, street_strips, turning


@pytest.fixture(scope="module", params=[1, 4])
def town(request):
    return make_town(request.param)


def test_buildings_overlap_neither_streets_nor_each_other(town):
    corners = town.scene.buildings["corners"]
    assert (turning(corners) > 0).all()  # convex and counter-clockwise, as the ray caster takes for granted
    # Walls along canals and hedges at their lots' edges are not houses.
    houses = np.array([b.corners for b in town.buildings if b.tags & {"house", "landmark"}])
    assert 300 < len(houses) < 1500
    strips = street_strips(town.plan)
    assert max(overlap(houses[i], strips[k]) for i, k in pairs_near(houses, strips)) < 1e-6
    assert max(overlap(houses[i], houses[k]) for i, k in pairs_near(houses, houses) if i < k) < 0.02


def test_what_is_built_on_a_block_stays_on_it(town):
    for site in town.sites:
        edge = np.roll(site.block.corners, -1, axis=0) - site.block.corners
        normal = np.stack([edge[:, 1], -edge[:, 0]], axis=1) / np.linalg.norm(edge, axis=1)[:, None]
        for b in site.buildings:
            assert ((b.corners[:, None] - site.block.corners) * normal).sum(axis=2).max() < 1e-6


def test_trees_and_lamps_stand_outside_houses(town):
    houses = town.scene.buildings[[i for i, b in enumerate(town.buildings) if "house" in b.tags]]
    edge = town.plan.junctions.reshape(-1, 2)
    for kind in (town.scene.trees, town.scene.lamps):
        at = np.stack([kind["x"], kind["y"]], axis=1)
        in_town = ((at > edge.min(axis=0) - 10) & (at < edge.max(axis=0) + 10)).all(axis=1)
        assert in_town.sum() > 50
        assert outside(houses, at[in_town]).min() > 0


def test_records_need_exactly_their_fields():
    with pytest.raises(ValueError, match=r"fields \['a'\] given for a record of \['b'\]"):
        kernel.record(kernel.layout("b"), {"a": 1.0})


@given(SEEDS)
@example(1989)
@settings(max_examples=30, deadline=None)
def test_any_plan_is_a_town(seed):
    plan = make_plan(seed)
    for a, b in plan.edges():
        length = np.linalg.norm(plan.junctions[b] - plan.junctions[a])
        assert 40 < length < 140
    for block in blocks(plan):
        assert (turning(block.corners) > 0).all()
        assert np.linalg.norm(np.roll(block.corners, -1, axis=0) - block.corners, axis=1).min() > 15
    inner = np.array([b.corners for b in blocks(plan) if not b.outer])
    assert max((overlap(inner[i], inner[k]) for i, k in pairs_near(inner, inner) if i < k), default=0.0) < 1e-6
    strips = street_strips(plan)
    everything = np.array([b.corners for b in blocks(plan)])
    # Where streets meet askew, the square end of one reaches the corner of a block: by centimetres, in one town of a thousand.
    assert max((overlap(everything[i], strips[k]) for i, k in pairs_near(everything, strips)), default=0.0) < 0.1


@given(SEEDS)
@settings(max_examples=15, deadline=None)
def test_the_railway_runs_round_every_town_without_touching_it(seed):
    plan = make_plan(seed)
    track = railway(plan, 6.0)
    steps = np.linalg.norm(np.diff(track, axis=0), axis=1)
    assert np.allclose(steps, 6.0, rtol=0.02)
    assert np.linalg.norm(track[0] - track[-1]) < 7.0
    along, out = np.diff(track, axis=0), track[:-1] - plan.junctions.mean(axis=(0, 1))
    assert (out[:, 0] * along[:, 1] - out[:, 1] * along[:, 0] > 0).all()  # counter-clockwise
    corners = np.concatenate([b.corners for b in blocks(plan)])
    assert np.linalg.norm(track[:, None] - corners[None], axis=2).min() > 8


JUNCTIONS = st.tuples(st.integers(0, 6), st.integers(0, 5))


@given(SEEDS, JUNCTIONS, st.lists(st.integers(0, 6), min_size=1, max_size=4), st.sampled_from(["lane", "pavement"]))
@settings(max_examples=30, deadline=None)
def test_any_route_can_be_driven_smoothly(seed, start, turns, lateral):
    stops = [start]
    for k, target in enumerate(turns):  # alternately along a row and along a column
        i, j = stops[-1]
        stops.append((target, j) if k % 2 == 0 else (i, target % 6))
    assume(all(a != b for a, b in itertools.pairwise(stops)))
    route = "-".join("ABCDEFG"[i] + str(j + 1) for i, j in stops)
    listed = junctions_of(route)
    assert listed[0] == stops[0]
    assert listed[-1] == stops[-1]
    assert all(abs(a[0] - b[0]) + abs(a[1] - b[1]) == 1 for a, b in itertools.pairwise(listed))
    path = drive_path(make_plan(seed), route, lateral)
    assert np.allclose(np.linalg.norm(np.diff(path.points, axis=0), axis=1), path.step, rtol=0.05)
    assert np.abs(np.diff(path.headings)).max() / path.step < 1.4  # radians per metre
    x, y, _, _ = path.at(path.length)
    assert np.hypot(x - path.points[-1, 0], y - path.points[-1, 1]) < 0.01


def test_colours_are_reflectances():
    rng = np.random.default_rng(0)
    drawn = np.array([choose(rng, SIGN) for _ in range(200)])
    assert drawn.min() >= 0
    assert drawn.max() <= 0.95
