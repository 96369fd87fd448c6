"""Conditions change the light, the season and the sensor as they should, and not the place."""

import dataclasses

import numpy as np
import pytest

import artifact_city
from artifact_city import rendering
from artifact_city.conditions import CONDITIONS
from artifact_city.models import CARS, NUMBER
from artifact_city.town import make_town
from artifact_city.trace import BUILDING, GROUND, LEAF, SKY, THING
from city.helpers import DRIVE, PLACE, grey, pixels_of, under


def wall_normals(t, codes):
    """Outward normal of the wall in each pixel, (rows, columns, 2); zero where there is none."""
    buildings = make_town(t.town).scene.buildings
    number, side = (codes - BUILDING) >> 4, (codes - BUILDING) & 15
    wall = (codes >= BUILDING) & (codes < LEAF) & (side < 4)
    normals = np.zeros((*codes.shape, 2))
    normals[wall] = buildings["normal"][number[wall], side[wall]]
    return normals


def test_every_condition_makes_a_picture(seen):
    assert set(seen) == set(artifact_city.CONDITIONS)
    for image in seen.values():
        assert image.shape == (240, 320, 3)
        assert image.dtype == np.uint8
        assert grey(image).std() > 15
    assert len({image.tobytes() for image in seen.values()}) == len(seen)


def test_conditions_change_the_light_and_not_the_place():
    traced = [rendering.trace_frame(under(name), PLACE) for name in ("sun", "overcast", "night", "rain", "morning")]
    for other in traced[1:]:
        at = (traced[0].surface < LEAF) & (other.surface < LEAF)  # neither leaves nor cars and people
        assert at.mean() > 0.6
        np.testing.assert_array_equal(traced[0].surface[at], other.surface[at])
        np.testing.assert_array_equal(traced[0].view, other.view)


def test_night_is_dark_but_for_its_lights(seen):
    assert grey(seen["night"]).mean() < 0.55 * grey(seen["sun"]).mean()
    assert np.median(grey(seen["night"])[:40]) < 90  # sky
    assert (grey(seen["night"]) > 170).mean() > 0.002  # lamps and lit windows


def test_lit_windows_and_lamps_depend_on_the_traversal_not_on_the_frame():
    assert not np.array_equal(
        artifact_city.render_frame(under("night", seed=2), 3), artifact_city.render_frame(under("night"), 3)
    )
    lights = [rendering.light_of(under("night", seed=s)) for s in (1, 1, 2)]
    assert lights[0] == lights[1]
    assert lights[0] != lights[2]


def test_winter_is_whiter_on_the_ground_and_bare_of_leaves(seen):
    traced = {name: rendering.trace_frame(under(name), PLACE) for name in ("overcast", "winter")}
    ground = pixels_of(traced["winter"]) == GROUND
    white = {name: (grey(seen[name])[ground] > 165).mean() for name in traced}
    assert white["winter"] > 0.2
    assert white["winter"] > 2 * white["overcast"]
    leaves = {name: ((made.surface >= LEAF) & (made.surface < THING)).sum() for name, made in traced.items()}
    assert leaves["winter"] < 0.2 * leaves["overcast"]


def test_clouds_take_contrast_from_walls_and_rain_takes_more(seen):
    codes = pixels_of(rendering.trace_frame(DRIVE, PLACE))
    walls = (codes >= BUILDING) & (codes < LEAF)
    contrast = {name: grey(seen[name])[walls].std() for name in ("sun", "overcast", "rain")}
    assert contrast["sun"] > 1.15 * contrast["overcast"] > 1.15 * contrast["rain"]


def test_water_changes_the_ground_by_what_stands_above_it():
    t = under("rain")
    traced, lights = rendering.trace_frame(t, PLACE), [rendering.light_of(t).copy() for _ in range(2)]
    lights[0]["wet"] = 0.0
    dry, wet = (rendering.shade(rendering.town_of(t), CONDITIONS["rain"], light, traced) for light in lights)
    samples = traced.surface.reshape(320, 2, 240, 2)
    sky, ground = ((samples == code).all(axis=(1, 3)).T for code in (SKY, GROUND))
    # Lens and sensor come later: where only the sky is seen, nothing has changed.
    assert np.median(np.abs(dry - wet)[sky]) == 0
    assert (np.abs(dry - wet)[ground].max(axis=1) > 0.005).mean() > 0.9


def test_the_sun_lights_opposite_sides_of_the_street_in_the_morning_and_in_the_afternoon():
    names, frames = ("morning", "afternoon"), (4, 12, 20)
    northward = {n: under(n, route="D2-D5") for n in names}
    images = {n: np.stack([grey(artifact_city.render_frame(t, k)) for k in frames]) for n, t in northward.items()}
    normals = np.stack(
        [wall_normals(t, pixels_of(rendering.trace_frame(t, k))) for t in [northward["morning"]] for k in frames]
    )
    east, west = normals[..., 0] > 0.8, normals[..., 0] < -0.8
    assert min(east.sum(), west.sum()) > 2000
    brightness = {(n, side): images[n][wall].mean() for n in names for side, wall in (("east", east), ("west", west))}
    # The sun rises in the east; the two sides of a street are compared with themselves.
    assert brightness["morning", "east"] > 1.15 * brightness["afternoon", "east"]
    assert brightness["afternoon", "west"] > 1.15 * brightness["morning", "west"]


@pytest.mark.parametrize("name", ["night_grey", "historical"])
def test_monochrome_is_monochrome(seen, name):
    """Each pixel is a grey value times the tint; only rounding differs."""
    tint = np.array(CONDITIONS[name].sensor.tint)
    image = seen[name].astype(float)
    level = image[..., :1] / tint[0]
    unclipped = image[..., 0] < 255
    assert np.abs(image - level * tint)[unclipped].max() <= 1.0
    assert np.ptp(seen["sun"].astype(float), axis=2).mean() > 8  # and others are not


def test_the_past_has_the_same_lots_other_houses_and_no_modern_cars():
    now, past = make_town(DRIVE.town), make_town(DRIVE.town, "past")
    np.testing.assert_array_equal(now.scene.buildings["corners"], past.scene.buildings["corners"])
    rebuilt = (now.scene.buildings["height"] != past.scene.buildings["height"]).mean()
    assert 0.02 < rebuilt < 0.3
    assert not any("modern" in b.tags and "house" in b.tags for b in past.buildings)
    cars = {NUMBER[name] for name in CARS}
    old, new = (set(rendering.things_of(under(name))["model"].tolist()) for name in ("historical", "sun"))
    assert NUMBER["traffic_sign"] in new - old
    assert cars & new == cars
    assert not cars & set(rendering.trace_frame(under("historical"), PLACE).things["model"].tolist())
    assert not cars & old


def test_parked_cars_and_people_differ_between_traversals_and_houses_do_not():
    one, other = rendering.trace_frame(DRIVE, PLACE), rendering.trace_frame(under("sun", seed=2, wander=0.0), PLACE)
    parked = [{(t["x"], t["y"], t["model"]) for t in made.things if t["model"] < len(CARS)} for made in (one, other)]
    assert parked[0] != parked[1]
    assert len(parked[0]) > 3


def test_cameras_differ_as_described():
    wide, narrow = (dataclasses.replace(DRIVE, camera=c, wander=0.0) for c in ("street_view", "car"))
    views = [rendering.trace_frame(t, PLACE).view[0] for t in (wide, narrow)]
    assert views[0]["z"] > views[1]["z"]
    assert views[0]["focal"] < views[1]["focal"]
    assert (views[0]["panorama"], views[1]["panorama"]) == (1, 0)
