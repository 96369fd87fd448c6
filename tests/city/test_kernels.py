"""Compiled code against slower truths."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import artifact_city
from artifact_city import noise, rendering, view
from artifact_city.buildings import roof_at
from artifact_city.grids import cast_shadows
from artifact_city.trace import BUILDING, GROUND, LEAF, SKY
from city.helpers import DRIVE, PLACE


def test_traced_depths_are_where_rays_first_meet_the_town():
    """March along rays: above the roofs until just before the traced depth, and inside a building just behind it."""
    traced = rendering.trace_frame(DRIVE, PLACE)
    camera, scene = traced.view[0], rendering.town_of(DRIVE).scene
    rng = np.random.default_rng(3)
    checked = {"ground": 0, "wall": 0, "roof": 0, "sky": 0}
    for column, row in zip(rng.integers(0, 640, 400), rng.integers(0, 480, 400), strict=True):
        code, depth = int(traced.surface[column, row]), float(traced.depth[column, row])
        ray = np.array(view.ray_of(camera, column + 0.5))
        slope = (view.horizon_at(camera, column + 0.5) - row - 0.5) / camera["focal"]
        side = (code - BUILDING) & 15
        if code >= LEAF:
            continue  # leaves and things have their own tracer

        def inside(t, ray=ray, slope=slope):
            x, y = camera["x"] + t * ray[0], camera["y"] + t * ray[1]
            z = camera["z"] + t * slope
            within = (scene.buildings["normal"] @ (x, y) < scene.buildings["offset"] - 1e-6).all(axis=1)
            return any(roof_at(scene.buildings[b], x, y) > z + 1e-6 for b in np.flatnonzero(within))

        reach = min(depth, 60.0)
        for t in rng.uniform(0.05, 1.0, 8) * reach * 0.999:
            assert not inside(t), f"({column}, {row}) passes through a building"
        if code == GROUND:
            assert abs(camera["z"] + depth * slope) < 1e-3 * depth
            checked["ground"] += 1
        elif code == SKY:
            checked["sky"] += 1
        else:
            assert inside(depth + 0.02)
            checked["wall" if side < 4 else "roof"] += 1
    assert min(checked["ground"], checked["wall"], checked["sky"]) > 10


@given(
    st.floats(0, 640), st.floats(0, 480), st.floats(0.5, 300), st.booleans(), st.floats(-3, 3), st.floats(-0.05, 0.05)
)
@settings(max_examples=100, deadline=None)
def test_projection_inverts_the_rays(column, row, depth, panorama, heading, roll):
    camera = artifact_city.CAMERAS["street_view" if panorama else "car"]
    made = view.make_view(camera, view.Pose(12.0, -7.0, heading, roll=roll))[0]
    ray = view.ray_of(made, column)
    slope = (view.horizon_at(made, column) - row) / made["focal"]
    point = made["x"] + depth * ray[0], made["y"] + depth * ray[1], made["z"] + depth * slope
    np.testing.assert_allclose(view.project(made, *point), (column, row, depth), rtol=1e-6, atol=1e-6)


@given(st.floats(-5, 5), st.floats(0.01, 3), st.floats(0.01, 4))
@settings(max_examples=50, deadline=None)
def test_cover_is_the_mean_of_a_bar_over_a_footprint(x, half, foot):
    at = x + foot * ((np.arange(20_000) + 0.5) / 20_000 - 0.5)
    assert abs(noise.cover(x, half, foot) - (np.abs(at) < half).mean()) < 2e-3


@given(st.floats(-9, 9), st.floats(0.2, 3), st.floats(0.05, 0.95), st.floats(0.01, 6))
@settings(max_examples=50, deadline=None)
def test_stripes_are_the_mean_of_bars_over_a_footprint(x, period, share, foot):
    at = x + foot * ((np.arange(20_000) + 0.5) / 20_000 - 0.5)
    assert abs(noise.stripes(x, period, share * period, foot) - (at % period < share * period).mean()) < 4e-3


@given(st.floats(-1e4, 1e4), st.floats(-1e4, 1e4), st.integers(0, 10**6))
@settings(max_examples=100, deadline=None)
def test_noise_is_bounded_and_smooth(x, y, seed):
    value = noise.noise2(x, y, float(seed))
    assert 0 <= value < 1
    assert abs(noise.noise2(x + 1e-4, y, float(seed)) - value) < 1e-3


def test_hashes_are_evenly_spread():
    values = np.array([noise.hash3(float(i), float(j), 5.0) for i in range(60) for j in range(60)])
    counts, _ = np.histogram(values, bins=20, range=(0, 1))
    assert counts.sum() == 3600
    assert np.abs(counts - 180).max() < 60  # 4.6 standard deviations
    assert abs(np.corrcoef(values[:-1], values[1:])[0, 1]) < 0.06


@pytest.mark.parametrize("azimuth", [0, 40, 90, 135, 200, 270, 330])
def test_a_tower_casts_a_shadow_as_long_as_geometry_says(azimuth):
    heights = np.zeros((161, 161), np.float32)
    heights[76:85, 76:85] = 10.0  # cells of half a metre
    shadow = np.zeros_like(heights)
    elevation = 30.0
    cast_shadows(heights, np.radians(azimuth), np.radians(elevation), shadow)
    away = -np.array([np.cos(np.radians(azimuth)), np.sin(np.radians(azimuth))])
    centre, towards_sun = np.array([80.0, 80.0]), -away
    length = 10.0 / np.tan(np.radians(elevation)) / 0.5  # cells
    for distance in (8, 14, 20, 26):
        column, row = np.round(centre + distance * away).astype(int)
        assert abs(shadow[row, column] - 10.0 * (1 - (distance - 4.5) / length)) < 1.6
    column, row = np.round(centre + (length + 9) * away).astype(int)
    assert shadow[row, column] == 0
    column, row = np.round(centre + 8 * towards_sun).astype(int)
    assert shadow[row, column] == 0
