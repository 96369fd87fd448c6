"""The rendered town: the same bytes always, the same places under every condition, streets that hold together."""

import dataclasses
import hashlib
import itertools
import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from PIL import Image

import artifact_city
from artifact import manifest
from artifact_city import frame, kernel, noise, records, traversal, view, warm_up
from artifact_city.buildings import Building, as_records, rectangle
from artifact_city.conditions import CONDITIONS
from artifact_city.grids import cast_shadows, roof_at
from artifact_city.models import CARS, MODEL
from artifact_city.palette import SIGN, choose
from artifact_city.routes import drive_path, junctions_of, place_poses
from artifact_city.streets import TOTAL_HALF, blocks, make_plan, railway
from artifact_city.town import make_town
from artifact_city.trace import BUILDING, GROUND, LEAF, SKY, THING

REPOSITORY = Path(__file__).resolve().parents[1]
ENTRIES = {n: e for n, e in manifest.load(REPOSITORY / "data_manifest.yaml").datasets.items() if e.kind == "city"}
DRIVE = artifact_city.CityTraversal(
    town=4, route="A2-D2-D4", condition="sun", camera="car", frames=60, spacing=3.0, seed=1
)
PLACE = 21  # a frame of DRIVE in the middle of a street, with facades on both sides
SEEDS = st.integers(0, 2**31)


@pytest.fixture(scope="module", autouse=True)
def compiled():
    """On a fresh machine the first use compiles; two processes do it in half the time of one."""
    traversal.prepare(DRIVE)


def under(condition, **changes):
    return dataclasses.replace(DRIVE, condition=condition, **changes)


def grey(image):
    return image.astype(float).mean(axis=2)


@pytest.fixture(scope="module")
def seen():
    """One place under every condition, from the same pose."""
    return {name: artifact_city.render_frame(under(name), PLACE) for name in CONDITIONS}


def pixels_of(traced):
    """What the first of each pixel's samples sees: code of the surface, (rows, columns)."""
    return traced.surface[:: view.SAMPLES, :: view.SAMPLES].T


def wall_normals(t, codes):
    """Outward normal of the wall in each pixel, (rows, columns, 2); zero where there is none."""
    buildings = traversal.make_town(t.town).scene.buildings
    number, side = (codes - BUILDING) >> 4, (codes - BUILDING) & 15
    wall = (codes >= BUILDING) & (codes < LEAF) & (side < 4)
    normals = np.zeros((*codes.shape, 2))
    normals[wall] = buildings["normal"][number[wall], side[wall]]
    return normals


def overlap(p, q):
    """How deep two convex polygons overlap, by the theorem of the separating axis; negative is a gap. Metres."""
    depth = np.inf
    for polygon in (p, q):
        edge = np.roll(polygon, -1, axis=0) - polygon
        normal = np.stack([edge[:, 1], -edge[:, 0]], axis=1) / np.linalg.norm(edge, axis=1)[:, None]
        a, b = p @ normal.T, q @ normal.T
        depth = min(depth, np.minimum(a.max(axis=0) - b.min(axis=0), b.max(axis=0) - a.min(axis=0)).min())
    return depth


def pairs_near(first, second):
    """Index pairs of polygons whose bounding boxes meet."""
    low, high = [p.min(axis=1) for p in (first, second)], [p.max(axis=1) for p in (first, second)]
    apart = np.maximum(low[0][:, None] - high[1][None], low[1][None] - high[0][:, None]).max(axis=2)
    return np.argwhere(apart < 0)


def turning(corners):
    edge = np.roll(corners, -1, axis=-2) - corners
    following = np.roll(edge, -1, axis=-2)
    return edge[..., 0] * following[..., 1] - edge[..., 1] * following[..., 0]


def street_strips(plan):
    strips = []
    for a, b in plan.edges():
        p, q = plan.junctions[a], plan.junctions[b]
        u = (q - p) / np.linalg.norm(q - p)
        n = TOTAL_HALF[plan.kind(a, b)] * np.array([-u[1], u[0]])
        strips.append([p - n, q - n, q + n, p + n])
    return np.array(strips)


def outside(buildings, points):
    """Distance of each point from the nearest building, metres; a lower bound near corners, negative inside."""
    return (np.einsum("bkc,nc->nbk", buildings["normal"], points) - buildings["offset"]).max(axis=2).min(axis=1)


# ---------------------------------------------------------------------------------------------------------------
# The same bytes, whatever was rendered before, in whichever thread or process
# ---------------------------------------------------------------------------------------------------------------


def test_a_frame_depends_on_its_description_only():
    frames = [0, 42]
    first = {k: artifact_city.render_frame(DRIVE, k).tobytes() for k in frames}
    assert len(set(first.values())) == len(frames)
    for cache in (traversal.make_town, traversal.poses, traversal._standing, traversal._path):
        cache.cache_clear()
    with ThreadPoolExecutor(2) as pool:  # towns and poses are built by both threads at once
        jobs = {k: pool.submit(artifact_city.render_frame, DRIVE, k) for k in reversed(frames)}
        assert {k: job.result().tobytes() for k, job in jobs.items()} == first


@pytest.mark.parametrize("change", [{"seed": 2}, {"condition": "overcast"}, {"start": 0.5}, {"wander": 0.0}])
def test_every_field_that_should_matter_does(change):
    other = dataclasses.replace(DRIVE, **change)
    assert artifact_city.render_frame(other, PLACE).tobytes() != artifact_city.render_frame(DRIVE, PLACE).tobytes()


def test_folders_are_equal_for_any_number_of_workers_and_hold_what_render_frame_makes(tmp_path):
    few = dataclasses.replace(DRIVE, frames=7)
    done = []
    artifact_city.render(few, tmp_path / "one", workers=1, progress=done.append)
    artifact_city.render(few, tmp_path / "three", workers=3)
    names = [f"{k:06d}.jpg" for k in range(7)]
    assert sorted(p.name for p in (tmp_path / "one").iterdir()) == [*names, "positions.csv"]
    for path in (tmp_path / "one").iterdir():
        assert path.read_bytes() == (tmp_path / "three" / path.name).read_bytes()
    assert done == list(range(1, 8))
    for k in (0, 6):
        stored = np.asarray(Image.open(tmp_path / "one" / names[k])).astype(int)
        assert stored.shape == (240, 320, 3)
        assert np.abs(stored - artifact_city.render_frame(few, k)).mean() < 4  # JPEG


SCRIPT = """
import hashlib, sys
from artifact.datasets import city
made = city.CityTraversal(town=4, route="A2-D2-D4", condition="sun", camera="car", frames=60, spacing=3.0, seed=1)
print(hashlib.sha256(city.render_frame(made, 21).tobytes()).hexdigest(), flush=True)
city.render(made, sys.argv[1], workers=1)
"""


@pytest.fixture(scope="module")
def killed(tmp_path_factory):
    """A process with other hash seeds that renders a frame, starts to render a folder, and is killed (SIGKILL)."""
    folder = tmp_path_factory.mktemp("killed") / "sun"
    command = [sys.executable, "-c", SCRIPT, str(folder)]
    environment = {**os.environ, "PYTHONHASHSEED": "1"}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as process:
        digest = process.stdout.readline().strip()
        deadline = time.monotonic() + 60
        while len(list(folder.parent.glob(".*/*.jpg"))) < 3 and time.monotonic() < deadline:
            time.sleep(0.01)
        process.send_signal(signal.SIGKILL)
    return folder, digest, process.returncode


def test_another_process_renders_the_same_bytes(killed):
    assert killed[1] == hashlib.sha256(artifact_city.render_frame(DRIVE, PLACE).tobytes()).hexdigest()


def test_a_killed_process_leaves_no_folder_and_no_obstacle(killed):
    folder, _, code = killed
    assert code == -signal.SIGKILL
    assert not folder.exists()
    (left,) = folder.parent.iterdir()
    assert left.name.startswith(".")
    assert left.suffix == ".partial"
    assert not (left / "positions.csv").exists()
    artifact_city.render(dataclasses.replace(DRIVE, frames=2), folder)
    assert len(list(folder.glob("*.jpg"))) == 2


def test_an_interrupted_rendering_leaves_nothing_and_stops_its_workers(tmp_path):
    def interrupt(done):
        if done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        artifact_city.render(DRIVE, tmp_path / "sun", workers=2, progress=interrupt)
    assert list(tmp_path.iterdir()) == []
    assert not [t for t in threading.enumerate() if t.name.startswith("ThreadPoolExecutor")]


def test_a_folder_that_exists_is_never_touched(tmp_path):
    (tmp_path / "sun").mkdir()
    with pytest.raises(FileExistsError, match="exists already; delete it"):
        artifact_city.render(DRIVE, tmp_path / "sun")
    assert list((tmp_path / "sun").iterdir()) == []


def test_compiled_code_of_changed_sources_is_dropped(tmp_path, monkeypatch):
    monkeypatch.setattr(kernel, "_checked", set())
    code = [tmp_path / "window.nbi", tmp_path / "window.1.nbc"]
    for path in code:
        path.touch()
    kernel._drop_stale(str(tmp_path))
    assert not any(path.exists() for path in code)
    for path in code:
        path.touch()
    monkeypatch.setattr(kernel, "_checked", set())
    kernel._drop_stale(str(tmp_path))
    assert all(path.exists() for path in code)


def test_an_empty_frame_compiles_what_real_frames_call():
    artifact_city.render_frame(under("rain"), PLACE)
    called = [f for f in vars(frame).values() if hasattr(f, "signatures")]
    assert len(called) > 15
    before = {f: list(f.signatures) for f in called}
    warm_up.compile_painting()
    warm_up.compile_finishing()
    assert {f: list(f.signatures) for f in called} == before
    assert warm_up.is_compiled()


@pytest.fixture
def assistant(tmp_path, monkeypatch):
    """Stands in for the second Python: leaves its process number in a file, then does as it is told."""

    def make(then):
        path = tmp_path / "python"
        path.write_text(f"#!/bin/sh\necho $$ > {tmp_path}/started\n{then}\n")
        path.chmod(0o755)
        monkeypatch.setattr(sys, "executable", str(path))
        monkeypatch.setattr(warm_up, "is_compiled", lambda: False)
        return tmp_path

    return make


def test_rendering_waits_for_the_second_compiler_and_survives_its_failure(assistant):
    folder = assistant('sleep 0.3; touch "$(dirname "$0")/done"; exit 1')
    with warm_up.second_compiler():
        pass
    assert (folder / "done").exists()


def test_an_interrupted_rendering_ends_the_second_compiler(assistant):
    folder = assistant("exec sleep 60")
    began = time.monotonic()

    def interrupted():
        with warm_up.second_compiler():
            while not (folder / "started").exists() or not (folder / "started").read_text():
                time.sleep(0.01)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert time.monotonic() - began < 30
    with pytest.raises(ProcessLookupError):
        os.kill(int((folder / "started").read_text()), 0)


def test_no_second_compiler_starts_where_all_is_compiled(assistant, monkeypatch):
    folder = assistant("true")
    monkeypatch.setattr(warm_up, "is_compiled", lambda: True)
    with warm_up.second_compiler():
        pass
    assert not (folder / "started").exists()


# ---------------------------------------------------------------------------------------------------------------
# Positions
# ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("unit", ["metres", "frames"])
def test_the_written_positions_are_those_promised(tmp_path, unit):
    few = dataclasses.replace(DRIVE, frames=3, positions=unit)
    artifact_city.render(few, tmp_path / "sun")
    header, *lines = (tmp_path / "sun" / "positions.csv").read_text().splitlines()
    rows = [line.split(",") for line in lines]
    assert [row[0] for row in rows] == ["000000.jpg", "000001.jpg", "000002.jpg"]
    if unit == "frames":
        assert header == "image,index"
        assert [row[1] for row in rows] == ["0", "1", "2"]
        assert artifact_city.positions(few).tolist() == [[0, 0], [1, 0], [2, 0]]
    else:
        assert header == "image,x,y"
        np.testing.assert_allclose(np.array(rows)[:, 1:].astype(float), artifact_city.positions(few), atol=5e-4)


@given(st.floats(0.5, 12), st.floats(0, 20), st.integers(0, 50))
@settings(max_examples=25, deadline=None)
def test_frames_of_an_ideal_drive_are_one_spacing_apart(spacing, start, seed):
    drive = artifact_city.CityTraversal(
        town=4, route="A2-D2", condition="sun", frames=10, spacing=spacing, start=start, seed=seed, wander=0.0
    )
    steps = np.linalg.norm(np.diff(artifact_city.positions(drive), axis=0), axis=1)
    # A chord is never longer than the way, and shorter only where the street bends.
    assert (steps <= spacing * 1.001).all()
    assert (steps > spacing * 0.97).all()


def test_wandering_stays_near_the_lane():
    ideal, real = artifact_city.positions(under("sun", wander=0.0)), artifact_city.positions(DRIVE)
    aside = np.linalg.norm(ideal - real, axis=1)
    assert 0.05 < aside.mean() < 1.0
    assert aside.max() < 2.0


def test_the_phase_of_a_drive_differs_with_its_seed_by_less_than_a_spacing():
    starts = np.array([artifact_city.positions(under("sun", wander=0.0, seed=s))[0] for s in range(8)])
    gaps = np.linalg.norm(starts[:, None] - starts[None], axis=2)
    assert gaps.max() < DRIVE.spacing
    assert gaps[np.triu_indices(8, 1)].min() > 0


# ---------------------------------------------------------------------------------------------------------------
# The six pairs of the manifest
# ---------------------------------------------------------------------------------------------------------------


def test_the_pairs_mirror_the_six_datasets_of_the_paper():
    assert {e.mirrors: (e.threshold.value, e.threshold.unit) for e in ENTRIES.values()} == {
        "AmsterTime": (0, "pairs"), "Gardens Point": (2, "frames"), "Nordland": (1, "frames"),
        "RobotCar": (25, "metres"), "St Lucia": (25, "metres"), "SVOX": (25, "metres"),
    }  # fmt: skip


@pytest.fixture(scope="module", params=ENTRIES)
def pair(request):
    """Query and database traversal of one dataset, with its entry; pytest runs all tests of one pair together."""
    entry = ENTRIES[request.param]
    made = {key: artifact_city.CityTraversal(**t.render) for key, t in entry.traversals.items()}
    return entry, made, made[entry.query], made[entry.database]


def test_every_query_has_a_positive_and_distractor_traversals_suffice(pair):
    entry, made, queries, database = pair
    distance = np.linalg.norm(
        artifact_city.positions(queries)[:, None] - artifact_city.positions(database)[None], axis=2
    )
    assert (distance.min(axis=1) <= entry.threshold.value).all()
    assert all(made[name].frames >= queries.frames for name in entry.distractor_traversals or [])
    assert len({t.seed for t in made.values()}) == len(made)


def best_view(distance, turn, threshold):
    """Which frame within the threshold looks most nearly the same way from most nearly the same place."""
    within = np.flatnonzero(distance <= threshold)
    return within[np.argmin(distance[within] / 100 + turn[within])]


def shared(a, b):
    return len(a & b) / max(1, min(len(a), len(b)))


def test_both_traversals_of_a_pair_see_the_same_buildings(pair):
    entry, _, queries, database = pair
    heading = [np.array([p.heading for p in traversal.poses(t)[0]]) for t in (queries, database)]
    where = artifact_city.positions(queries), artifact_city.positions(database)
    near, far = [], []
    for i in np.linspace(0, queries.frames - 1, 5).astype(int):
        distance = np.linalg.norm(where[1] - where[0][i], axis=1)
        turn = np.abs(np.angle(np.exp(1j * (heading[1] - heading[0][i]))))
        j = best_view(distance, turn, entry.threshold.value)
        assert turn[j] < np.radians(25)
        shots = (queries, i), (database, j), (database, int(np.argmax(distance)))
        seen = [set(artifact_city.visible_buildings(*shot).tolist()) for shot in shots]
        if len(seen[0]) > 2:  # along the railway there are places without buildings
            near.append(shared(seen[0], seen[1]))
            far.append(shared(seen[0], seen[2]))
    assert len(near) > 2
    assert min(near) > 0.5
    assert np.mean(near) > 0.8
    assert np.mean(far) < 0.3


def test_no_camera_stands_in_a_building(pair):
    for made in pair[1].values():
        buildings = traversal._town(made).scene.buildings
        at = np.array([(p.x, p.y) for p in traversal.poses(made)[0]])
        for some in np.array_split(at, 8):
            assert outside(buildings, some).min() > 0.3  # metres to the nearest wall


def test_buildings_overlap_neither_streets_nor_each_other(pair):
    town = make_town(pair[2].town)
    corners = town.scene.buildings["corners"]
    assert (turning(corners) > 0).all()  # convex and counter-clockwise, as the ray caster takes for granted
    # Walls along canals and hedges at their lots' edges are not houses.
    houses = np.array([b.corners for b in town.buildings if b.tags & {"house", "landmark"}])
    assert 300 < len(houses) < 1500
    strips = street_strips(town.plan)
    assert max(overlap(houses[i], strips[k]) for i, k in pairs_near(houses, strips)) < 1e-6
    assert max(overlap(houses[i], houses[k]) for i, k in pairs_near(houses, houses) if i < k) < 0.02


def test_what_is_built_on_a_block_stays_on_it(pair):
    for site in make_town(pair[2].town).sites:
        edge = np.roll(site.block.corners, -1, axis=0) - site.block.corners
        normal = np.stack([edge[:, 1], -edge[:, 0]], axis=1) / np.linalg.norm(edge, axis=1)[:, None]
        for b in site.buildings:
            assert ((b.corners[:, None] - site.block.corners) * normal).sum(axis=2).max() < 1e-6


def test_trees_and_lamps_stand_outside_houses(pair):
    town = make_town(pair[2].town)
    houses = town.scene.buildings[[i for i, b in enumerate(town.buildings) if "house" in b.tags]]
    edge = town.plan.junctions.reshape(-1, 2)
    for kind in (town.scene.trees, town.scene.lamps):
        at = np.stack([kind["x"], kind["y"]], axis=1)
        in_town = ((at > edge.min(axis=0) - 10) & (at < edge.max(axis=0) + 10)).all(axis=1)
        assert in_town.sum() > 50
        assert outside(houses, at[in_town]).min() > 0


# ---------------------------------------------------------------------------------------------------------------
# Conditions
# ---------------------------------------------------------------------------------------------------------------


def test_every_condition_makes_a_picture(seen):
    assert set(seen) == set(artifact_city.CONDITIONS)
    for image in seen.values():
        assert image.shape == (240, 320, 3)
        assert image.dtype == np.uint8
        assert grey(image).std() > 15
    assert len({image.tobytes() for image in seen.values()}) == len(seen)


def test_conditions_change_the_light_and_not_the_place():
    traced = [traversal.trace_frame(under(name), PLACE) for name in ("sun", "overcast", "night", "rain", "morning")]
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
    lights = [traversal._light(under("night", seed=s)) for s in (1, 1, 2)]
    assert lights[0] == lights[1]
    assert lights[0] != lights[2]


def test_winter_is_whiter_on_the_ground_and_bare_of_leaves(seen):
    traced = {name: traversal.trace_frame(under(name), PLACE) for name in ("overcast", "winter")}
    ground = pixels_of(traced["winter"]) == GROUND
    white = {name: (grey(seen[name])[ground] > 165).mean() for name in traced}
    assert white["winter"] > 0.2
    assert white["winter"] > 2 * white["overcast"]
    leaves = {name: ((made.surface >= LEAF) & (made.surface < THING)).sum() for name, made in traced.items()}
    assert leaves["winter"] < 0.2 * leaves["overcast"]


def test_clouds_take_contrast_from_walls_and_rain_takes_more(seen):
    codes = pixels_of(traversal.trace_frame(DRIVE, PLACE))
    walls = (codes >= BUILDING) & (codes < LEAF)
    contrast = {name: grey(seen[name])[walls].std() for name in ("sun", "overcast", "rain")}
    assert contrast["sun"] > 1.15 * contrast["overcast"] > 1.15 * contrast["rain"]


def test_water_changes_the_ground_by_what_stands_above_it():
    t = under("rain")
    traced, lights = traversal.trace_frame(t, PLACE), [traversal._light(t).copy() for _ in range(2)]
    lights[0]["wet"] = 0.0
    dry, wet = (traversal.shade(traversal._town(t), CONDITIONS["rain"], light, traced) for light in lights)
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
        [wall_normals(t, pixels_of(traversal.trace_frame(t, k))) for t in [northward["morning"]] for k in frames]
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
    tint = np.array(CONDITIONS[name].tint)
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
    cars = {MODEL[name] for name in CARS}
    old, new = (set(traversal._standing(under(name))["model"].tolist()) for name in ("historical", "sun"))
    assert MODEL["cart"] in old - new
    assert cars & new == cars
    assert not cars & set(traversal.trace_frame(under("historical"), PLACE).things["model"].tolist())
    assert not cars & old


def test_parked_cars_and_people_differ_between_traversals_and_houses_do_not():
    one, other = traversal.trace_frame(DRIVE, PLACE), traversal.trace_frame(under("sun", seed=2, wander=0.0), PLACE)
    parked = [{(t["x"], t["y"], t["model"]) for t in made.things if t["model"] < len(CARS)} for made in (one, other)]
    assert parked[0] != parked[1]
    assert len(parked[0]) > 3


def test_cameras_differ_as_described():
    wide, narrow = (dataclasses.replace(DRIVE, camera=c, wander=0.0) for c in ("street_view", "car"))
    views = [traversal.trace_frame(t, PLACE).view[0] for t in (wide, narrow)]
    assert views[0]["z"] > views[1]["z"]
    assert views[0]["focal"] < views[1]["focal"]
    assert (views[0]["panorama"], views[1]["panorama"]) == (1, 0)


# ---------------------------------------------------------------------------------------------------------------
# Bad input
# ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"condition": "snow"}, "condition 'snow' is not known; choose one of afternoon, .* winter"),
        ({"camera": "drone"}, "camera 'drone' is not known; choose one of car, .* walker"),
        ({"positions": "miles"}, "positions 'miles' is not known; choose one of frames, metres"),
        ({"frames": 0}, "frames must be a whole number of at least 1, not 0"),
        ({"frames": 2.0}, "frames must be a whole number of at least 1, not 2.0"),
        ({"town": -1}, "town must be a whole number of at least 0, not -1"),
        ({"seed": True}, "seed must be a whole number of at least 0, not True"),
        ({"spacing": 0.0}, "spacing must be a positive number of metres, not 0.0"),
        ({"spacing": float("nan")}, "spacing must be a positive number of metres, not nan"),
        ({"start": -3.0}, "start and wander must not be negative, not -3.0"),
        (
            {"route": "A2"},
            "write junctions from A1 to G6 such as 'A2-D2-D4', or one of 'railway', 'all streets', 'places'",
        ),
        ({"route": "A2-H2"}, "route 'A2-H2' is not known"),
        ({"route": "A2-D4"}, "the leg to D4 does not follow a street"),
        ({"route": "A2-A2"}, "the leg to A2 does not follow a street"),
        ({"route": "A2-D2-B2"}, "the leg to B2 turns round in the street"),
        ({"route": "railway"}, "route 'railway' and camera 'train' go together"),
        ({"camera": "train"}, "route 'railway' and camera 'train' go together"),
        ({"route": "places"}, r"route 'places' goes with a camera of \['handheld', 'plate'\]"),
        ({"camera": "plate"}, r"route 'places' goes with a camera of \['handheld', 'plate'\]"),
    ],
)
def test_bad_descriptions_say_what_is_allowed(change, message):
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(DRIVE, **change)


def test_a_route_that_is_too_short_says_how_many_frames_fit(tmp_path):
    long = dataclasses.replace(DRIVE, frames=5000)
    with pytest.raises(ValueError, match=r"route 'A2-D2-D4' of town 4 is \d+ m long: .* room for \d+ frames, not 5000"):
        artifact_city.render(long, tmp_path / "sun")
    with pytest.raises(ValueError, match=r"all streets of town 4 give \d+ images at this spacing, not 99999"):
        artifact_city.positions(dataclasses.replace(DRIVE, route="all streets", frames=99_999))
    everywhere = as_records([Building(rectangle(np.zeros(2), 0.0, 2000, 2000), 9.0, (1, 1, 1))])
    with pytest.raises(ValueError, match="town 1 has room for 0 places only"):
        place_poses(make_plan(1), everywhere, 5)
    assert list(tmp_path.iterdir()) == []


def test_frames_count_from_zero_and_workers_from_one(tmp_path):
    for index in (-1, 60):
        with pytest.raises(IndexError, match=f"frame {index} of a traversal of 60 frames"):
            artifact_city.render_frame(DRIVE, index)
    with pytest.raises(ValueError, match="workers must be at least 1, not 0"):
        artifact_city.render(DRIVE, tmp_path / "sun", workers=0)


def test_records_need_exactly_their_fields():
    with pytest.raises(ValueError, match=r"fields \['a'\] given for a record of \['b'\]"):
        records.record(records.layout(b="f8"), {"a": 1.0})


# ---------------------------------------------------------------------------------------------------------------
# The town
# ---------------------------------------------------------------------------------------------------------------


@given(SEEDS)
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
    assert max((overlap(everything[i], strips[k]) for i, k in pairs_near(everything, strips)), default=0.0) < 1e-6


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


# ---------------------------------------------------------------------------------------------------------------
# Compiled code against slower truths
# ---------------------------------------------------------------------------------------------------------------


def test_traced_depths_are_where_rays_first_meet_the_town():
    """March along rays: above the roofs until just before the traced depth, and inside a building just behind it."""
    traced = traversal.trace_frame(DRIVE, PLACE)
    camera, scene = traced.view[0], traversal._town(DRIVE).scene
    rng = np.random.default_rng(3)
    checked = {"ground": 0, "wall": 0, "roof": 0, "sky": 0}
    for column, row in zip(rng.integers(0, 640, 400), rng.integers(0, 480, 400), strict=True):
        code, depth = int(traced.surface[column, row]), float(traced.depth[column, row])
        ray = np.array(view.ray_of(camera, column + 0.5))
        slope = (view.horizon_at(camera, column + 0.5) - row - 0.5) / camera["focal"]
        number, side = (code - BUILDING) >> 4, (code - BUILDING) & 15
        if code >= LEAF or (code >= BUILDING and side == 0 and scene.buildings["gable"][number]):
            continue  # leaves and things have their own tracer; ornamental gables stand above the roof

        def inside(t, ray=ray, slope=slope):
            x, y = camera["x"] + t * ray[0], camera["y"] + t * ray[1]
            z = camera["z"] + t * slope
            within = (scene.buildings["normal"] @ (x, y) < scene.buildings["offset"] - 1e-6).all(axis=1)
            plain = within & (scene.buildings["gable"] == 0)
            return any(roof_at(scene.buildings[b], x, y) > z + 1e-6 for b in np.flatnonzero(plain))

        reach = min(depth, 60.0)
        for t in rng.uniform(0.05, 1.0, 8) * reach * 0.999:
            assert not inside(t), f"({column}, {row}) passes through a building"
        if code == GROUND:
            assert abs(camera["z"] + depth * slope) < 1e-3 * depth
            checked["ground"] += 1
        elif code == SKY:
            checked["sky"] += 1
        elif scene.buildings["gable"][number] == 0:
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
