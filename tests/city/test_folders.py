"""The same bytes always, whole or not at all; positions as promised."""

import dataclasses
import hashlib
import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

import artifact_city
from artifact_city import kernel, rendering, town, traversal
from city.helpers import DRIVE, PLACE, under


def test_a_frame_depends_on_its_description_only():
    frames = [0, 42]
    first = {k: artifact_city.render_frame(DRIVE, k).tobytes() for k in frames}
    assert len(set(first.values())) == len(frames)
    for cache in (town.make_town, traversal.poses, rendering.things_of, traversal._path):
        cache.cache_clear()
    with ThreadPoolExecutor(2) as pool:  # towns and poses are built by both threads at once
        jobs = {k: pool.submit(artifact_city.render_frame, DRIVE, k) for k in reversed(frames)}
        assert {k: job.result().tobytes() for k, job in jobs.items()} == first


@pytest.mark.parametrize("change", [{"seed": 2}, {"condition": "overcast"}, {"spacing": 3.1}, {"wander": 0.0}])
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

import artifact_city

made = artifact_city.CityTraversal(town=4, route="A2-D2-D4", condition="sun", camera="car", frames=60, spacing=3.0, seed=1)
print(hashlib.sha256(artifact_city.render_frame(made, 35).tobytes()).hexdigest(), flush=True)
artifact_city.render(made, sys.argv[1], workers=1)
"""


@pytest.fixture(scope="module")
def killed(tmp_path_factory):
    """A process with other hash seeds that renders a frame, starts to render a folder, and is killed (SIGKILL)."""
    folder = tmp_path_factory.mktemp("killed") / "sun"
    command = [sys.executable, "-c", SCRIPT, str(folder)]
    environment = {**os.environ, "PYTHONHASHSEED": "1"}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as process:
        digest = process.stdout.readline().strip()
        deadline = time.monotonic() + 240
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


def test_compiled_code_of_changed_sources_is_dropped(tmp_path):
    code = [tmp_path / "window.nbi", tmp_path / "window.1.nbc"]
    for kept in (False, True):  # the second time the folder has the stamp of these sources
        for path in code:
            path.touch()
        kernel.drop_stale(str(tmp_path))
        assert [path.exists() for path in code] == [kept, kept]


def test_compiling_at_set_up_compiles_all_that_frames_call():
    before = compiled_signatures()
    assert len(before) > 15
    artifact_city.compile_all()
    for condition in artifact_city.CONDITIONS:
        artifact_city.render_frame(under(condition), PLACE)
    artifact_city.render_frame(under("sun", camera="street_view"), PLACE)
    assert compiled_signatures() == before


def compiled_signatures():
    """What has been compiled so far in this package, by module and function."""
    modules = [m for name, m in sys.modules.items() if name.startswith("artifact_city.")]
    kernels = {f for m in modules for f in vars(m).values() if hasattr(f, "signatures")}
    return {f"{f.__module__}.{f.__name__}": list(f.signatures) for f in kernels if f.signatures}


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


@given(st.floats(0.5, 12), st.integers(0, 50))
@settings(max_examples=25, deadline=None)
def test_frames_of_an_ideal_drive_are_one_spacing_apart(spacing, seed):
    drive = artifact_city.CityTraversal(
        town=4, route="A2-D2", condition="sun", frames=10, spacing=spacing, seed=seed, wander=0.0
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
        ({"wander": -3.0}, "wander must not be negative, not -3.0"),
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
    with pytest.raises(ValueError, match=r"town 4 has room for \d+ places only"):
        artifact_city.positions(dataclasses.replace(DRIVE, route="places", camera="plate", frames=600))
    assert list(tmp_path.iterdir()) == []


def test_frames_count_from_zero_and_workers_from_one(tmp_path):
    for index in (-1, 60):
        with pytest.raises(IndexError, match=f"frame {index} of a traversal of 60 frames"):
            artifact_city.render_frame(DRIVE, index)
    with pytest.raises(ValueError, match="workers must be at least 1, not 0"):
        artifact_city.render(DRIVE, tmp_path / "sun", workers=0)
