"""Obtaining published datasets: downloads, files put there by hand, interruptions at any moment, and what is said of it."""

from __future__ import annotations

import json
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import types
import zipfile
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import published_files as files
import pytest
from conftest import REPOSITORY, real_data_root, tiny_manifest, write_images, write_manifest
from PIL import Image
from released import running
from test_published import SHIPPED, fault, index_of, made, obtain, project, put

from artifact import datasets, manifest, pages
from artifact.commands import cli, data
from artifact.datasets import DatasetError, published
from artifact.datasets.published import archives, originals, preparation
from artifact.pages import galleries
from artifact.studies import catalogue


@pytest.fixture
def server():
    with running() as server:
        yield server


NAME = "GardensPoint_Walking.zip"


# -- downloads ---------------------------------------------------------------------------------------------------------


def test_a_dead_link_without_mirror_says_how_to_do_it_by_hand_and_a_file_put_there_is_found(tmp_path, server):
    gone = f"http://127.0.0.1:{server.server_port}/gone"
    loaded = project(tmp_path, "gardens_point", urls={NAME: [gone]})
    text = fault(loaded, "gardens_point")
    path = tmp_path / "data" / "downloads" / "gardens_point" / NAME
    for part in (
        f"{NAME} could not be downloaded",
        "answered 404",
        f"by hand: open {gone}",
        f"save the file (32 MB) as {path}",
    ):
        assert part in text
    assert "make data DATASET=gardens_point" in text
    put(loaded, "gardens_point", {"GardensPoint.zip": b""})
    assert "it holds GardensPoint.zip too: if one of these is meant, give it its name" in fault(loaded, "gardens_point")
    put(loaded, "gardens_point", made("gardens_point"))
    assert any("12 images prepared" in line for line in obtain(loaded, "gardens_point"))


def test_a_server_that_sends_a_page_or_another_file_is_refused_and_the_mirror_taken(tmp_path, server):
    page = server.serve("page", b"<html>quota</html>", kind="text/html")
    other = server.serve("other", b"no archive" * 100)
    right = server.serve("right", made("gardens_point")[NAME])
    loaded = project(tmp_path, "gardens_point", urls={NAME: [page, other, right]})
    obtain(loaded, "gardens_point")
    lock = json.loads((originals.downloads(loaded, "gardens_point") / f"{NAME}.lock.json").read_text())
    assert lock["size"] == len(made("gardens_point")[NAME])


def test_without_any_address_the_files_and_the_steps_are_named(tmp_path):
    loaded = project(tmp_path, "robotcar")
    text = fault(loaded, "robotcar", files.QUERY)
    first = f"{files.QUERY}_stereo_centre_01.tar, {files.QUERY}_stereo_centre_02.tar, {files.QUERY}_gps.tar, rtk.zip"
    assert f"robotcar/{files.QUERY}: 4 of 4 published files are not in {tmp_path / 'data/downloads/robotcar'}" in text
    assert first in text
    assert "from https://robotcar-dataset.robots.ox.ac.uk (register;" in text
    only_ins = fault(loaded, "robotcar", files.QUERY, poses="ins")
    assert "3 of 3" in only_ins
    assert "_gps.tar\n" in only_ins
    shipped = manifest.load(REPOSITORY / "data_manifest.yaml")
    named = originals._names(originals.needed(shipped, "robotcar", [files.RAIN], {"poses": "rtk"}))
    assert list(named) == [f"{files.RAIN}_stereo_centre_01.tar to {files.RAIN}_stereo_centre_07.tar", "rtk.zip"]


def test_what_can_be_prepared_is_prepared_before_what_is_missing_is_said(tmp_path, monkeypatch, capsys):
    loaded = project(tmp_path, "nordland")
    put(loaded, "nordland", {name: content for name, content in made("nordland").items() if "spring" not in name})
    monkeypatch.chdir(tmp_path)
    assert cli.main(["data", "--dataset", "nordland"]) == 1
    shown = capsys.readouterr()
    assert shown.out.count("10 images prepared") == 3
    assert "error: nordland/spring: 1 of 2 published files are not in" in shown.err
    assert "how to get Nordland:" in shown.err
    assert len(datasets.load(loaded, "nordland").query) == 10


def test_a_file_with_another_checksum_is_refused_whatever_it_holds(tmp_path):
    loaded = project(tmp_path, "svox")
    folder = put(loaded, "svox", made("svox"))
    obtain(loaded, "svox")
    shutil.rmtree(tmp_path / "data" / "svox")
    put(loaded, "svox", {"svox.zip": files.zipped(files.svox_images() | {"svox/more.txt": b""})})
    assert "was recorded on" in fault(loaded, "svox")
    (folder / "svox.zip.lock.json").unlink()
    obtain(loaded, "svox")
    shutil.rmtree(tmp_path / "data" / "svox")
    (folder / "svox.zip.lock.json").write_text("{}")
    assert "svox.zip.lock.json: not a lock file; delete it" in fault(loaded, "svox")


def test_a_checksum_and_size_in_the_manifest_are_held_to(tmp_path):
    loaded = project(tmp_path, "svox")
    put(loaded, "svox", made("svox"))
    for known in ({"sha256": "0" * 64}, {"size": 7}):
        file = loaded.dataset("svox").preparation.files[0].model_copy(update=known)
        with pytest.raises(DatasetError, match=f"svox.zip: its {next(iter(known))} is .* that of the published file"):
            originals.digest(originals.Original(originals.downloads(loaded, "svox") / "svox.zip", file), None)


# -- interruptions -----------------------------------------------------------------------------------------------------

KILLED = """
import os, signal
from artifact import manifest
from artifact.datasets import published
from artifact.datasets.published import preparation
moment, calls = {moment!r}, []
whole = getattr(preparation, moment[0])
def dying(*arguments):
    calls.append(1)
    if len(calls) == moment[1]:
        os.kill(os.getpid(), signal.SIGKILL)
    return whole(*arguments)
setattr(preparation, moment[0], dying)
list(published.obtain(manifest.load(), "gardens_point"))
"""
MOMENTS = [("_write_whole", 1), ("_write_whole", 8), ("_check_images", 1), ("_put_in_place", 1), ("_write_whole", 20)]


def test_a_kill_at_any_moment_leaves_nothing_that_looks_complete_and_the_next_run_goes_on(tmp_path):
    loaded = project(tmp_path, "gardens_point")
    put(loaded, "gardens_point", made("gardens_point"))
    environment = {name: value for name, value in os.environ.items() if not name.startswith("ARTIFACT_")}
    for moment in MOMENTS:
        code = KILLED.format(moment=moment)
        done = subprocess.run(
            [sys.executable, "-c", code], cwd=tmp_path, env=environment, capture_output=True, check=False
        )
        assert done.returncode == -signal.SIGKILL, done.stderr.decode()
        for state in published.states(loaded, "gardens_point"):
            assert state.status == "missing" or (state.status, state.images) == ("verified", 12)
    assert [state.status for state in published.states(loaded, "gardens_point")] == ["verified", "verified", "missing"]
    obtain(loaded, "gardens_point")
    assert [state.status for state in published.states(loaded, "gardens_point")] == ["verified"] * 3
    assert not list(tmp_path.rglob("*.preparing*"))


def test_images_that_were_written_are_not_written_again(tmp_path, monkeypatch):
    loaded = project(tmp_path, "robotcar")
    put(loaded, "robotcar", made("robotcar"))
    written, whole = [], preparation._write_whole

    def interrupted(path, content):
        if len(written) == 30:
            raise KeyboardInterrupt
        written.append(path.name)
        whole(path, content)

    monkeypatch.setattr(preparation, "_write_whole", interrupted)
    with pytest.raises(KeyboardInterrupt):
        obtain(loaded, "robotcar", files.QUERY)
    monkeypatch.setattr(
        preparation, "_write_whole", lambda path, content: (written.append(path.name), whole(path, content))
    )
    obtain(loaded, "robotcar", files.QUERY)
    table, _ = index_of(loaded, "robotcar", files.QUERY)
    assert sorted(written) == sorted(table["image"])
    assert len(set(written)) == len(written)


def test_an_image_that_a_crash_of_the_machine_emptied_is_made_again_by_the_next_run_but_one(tmp_path, monkeypatch):
    loaded = project(tmp_path, "gardens_point")
    put(loaded, "gardens_point", made("gardens_point"))
    with monkeypatch.context() as patch:
        patch.setattr(preparation, "_put_in_place", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            obtain(loaded, "gardens_point", "day_right")
    (written,) = (tmp_path / "data").rglob("Image003.jpg")
    written.write_bytes(b"")
    assert "Image003.jpg" in (text := fault(loaded, "gardens_point", "day_right"))
    assert "run again" in text
    obtain(loaded, "gardens_point", "day_right")
    assert [state.status for state in published.states(loaded, "gardens_point")] == ["verified", "missing", "missing"]


def test_two_that_obtain_the_same_prepare_it_once(tmp_path, monkeypatch):
    loaded = project(tmp_path, "gardens_point")
    put(loaded, "gardens_point", made("gardens_point"))
    prepare, prepared = preparation.prepare, []
    monkeypatch.setattr(
        preparation,
        "prepare",
        lambda folder, *rest, **named: (prepared.append(folder), prepare(folder, *rest, **named))[1],
    )
    with ThreadPoolExecutor(2) as pool:
        lines = list(pool.map(lambda _: obtain(loaded, "gardens_point"), range(2)))
    assert sorted(folder.name for folder in prepared) == ["day_left", "day_right", "night_right"]
    assert all(len(one) == 4 for one in lines)


def test_a_disk_that_fills_up_is_said_and_the_next_run_goes_on(tmp_path):
    """The kernel refuses to let a file grow, as a full disk does."""
    loaded = project(tmp_path, "amstertime")
    put(loaded, "amstertime", made("amstertime"))
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    for limit in (700, 5_000):
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, hard))
        try:
            text = fault(loaded, "amstertime")
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        assert "cannot write " in text
        assert "free some room or make it writable and run the same command again" in text
    obtain(loaded, "amstertime")


def test_room_on_the_disk_is_looked_at_first(tmp_path, monkeypatch):
    loaded = project(tmp_path, "nordland")
    put(loaded, "nordland", made("nordland"))
    monkeypatch.setattr(archives.shutil, "disk_usage", lambda _: types.SimpleNamespace(free=67_000_000))
    assert "67 MB free, 71.6 MB are needed; free some room and run again" in fault(loaded, "nordland")


# -- what was prepared, and what was not -------------------------------------------------------------------------------


def test_what_changed_since_it_was_prepared_is_refused(tmp_path):
    loaded = project(tmp_path, "svox")
    put(loaded, "svox", made("svox"))

    def spoil(change):
        shutil.rmtree(tmp_path / "data" / "svox", ignore_errors=True)
        obtain(loaded, "svox")
        change(datasets.image_folder(loaded, "svox", "gallery"))
        with pytest.raises(DatasetError) as caught:
            datasets.load(loaded, "svox")
        assert [state.status for state in published.states(loaded, "svox")] == ["verified", "changed"]
        return str(caught.value)

    def first(folder):
        return sorted(folder.glob("*.jpg"))[0]

    assert "is missing since the traversal was prepared; delete the folder" in spoil(lambda f: first(f).unlink())
    assert "images were changed since" in spoil(lambda f: first(f).write_bytes(sorted(f.glob("*.jpg"))[1].read_bytes()))
    assert "images.csv is missing or was changed" in spoil(lambda f: (f / "images.csv").write_text("image,x,y\n"))
    assert "prepared.json is damaged" in spoil(lambda f: (f / "prepared.json").write_text("{}"))


def test_folders_made_by_hand_are_used_where_that_can_be_right(tmp_path):
    loaded = project(tmp_path, "gardens_point")
    for name in loaded.dataset("gardens_point").traversals:
        folder = tmp_path / "data" / "gardens_point" / name
        folder.mkdir(parents=True)
        for path, content in files.gardens_point_images().items():
            if f"/{name}/" in path:
                (folder / path.rpartition("/")[2]).write_bytes(content)
    assert all("a folder made by hand, used as it is" in line for line in obtain(loaded, "gardens_point")[1:])
    by_hand = datasets.load(loaded, "gardens_point")
    shutil.rmtree(tmp_path / "data")
    put(loaded, "gardens_point", made("gardens_point"))
    obtain(loaded, "gardens_point")
    prepared = datasets.load(loaded, "gardens_point")
    for one, other in ((by_hand.query, prepared.query), (by_hand.database, prepared.database)):
        assert (one.digest, one.image_names) == (other.digest, other.image_names)
        np.testing.assert_array_equal(one.positions, other.positions)


@pytest.mark.parametrize(
    ("dataset", "folder", "names", "message"),
    [
        (
            "nordland",
            "summer",
            ["images-00202.png"],
            "holds images that were not prepared .*make data DATASET=nordland",
        ),
        ("nordland", "summer", [f"{i}.png" for i in range(3450)], "3,450 images are the test split"),
        ("robotcar", files.QUERY, ["1416316812000000.png"], "holds images that were not prepared"),
        ("robotcar", files.QUERY, ["stereo/left/1416316812000000.png"], "stereo/left or stereo/right"),
        ("gardens_point", "day_right", [f"Image{i:03}.jpg" for i in range(100)], "every second of the 200 images"),
        ("amstertime", "new", ["@0@1000@@@@@0001@@@@@@@@.jpg"], "the paper's queries are the new ones"),
    ],
)
def test_folders_made_by_hand_are_refused_where_they_are_something_else(tmp_path, dataset, folder, names, message):
    loaded = project(tmp_path, dataset)
    for name in names:
        path = tmp_path / "data" / dataset / folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"")
    with pytest.raises(DatasetError, match=message):
        datasets.load(loaded, dataset)


def test_raw_mosaics_are_refused_in_a_dataset_of_ones_own(tmp_path):
    """As grey photographs they would give numbers that mean nothing."""
    folder = tmp_path / "data" / "street"
    write_images(folder / "night", 3, seed=1)
    (folder / "day").mkdir()
    for i in range(3):
        image = Image.fromarray(np.kron(np.full((1, 1, 3), (200, 120, 40), np.uint8), np.ones((96, 128, 1), np.uint8)))
        files.mosaic(image).save(folder / "day" / f"{i}.png")
    loaded = manifest.load(write_manifest(tmp_path, tiny_manifest()))
    from artifact.extraction import extract
    from artifact.extraction.reading import ExtractionError

    with pytest.raises(ExtractionError, match="looks like a raw colour mosaic"):
        extract.descriptors(loaded, datasets.load(loaded, "street").query, "thumbnail", workers=0)


def test_other_counts_than_the_papers_name_the_choices_behind_them(tmp_path):
    loaded = project(tmp_path, "robotcar")
    put(loaded, "robotcar", made("robotcar"))
    obtain(loaded, "robotcar", files.QUERY, files.DATABASE)
    ready = datasets.load(loaded, "robotcar")
    choices = loaded.dataset("robotcar").paper.choices
    assert "RTK or INS poses" in choices
    assert ready.differences[0] == f"RobotCar: {len(ready.query)} query images, the paper lists 6,021"
    assert ready.differences[-1].endswith(
        f"evaluated queries, the paper lists 5,987; these numbers depend on {choices}"
    )
    assert len(ready.differences) == 3


def test_a_missing_package_is_named_with_its_extra(tmp_path, monkeypatch):
    loaded = project(tmp_path, "robotcar")
    put(loaded, "robotcar", made("robotcar"))
    monkeypatch.setitem(sys.modules, "cv2", None)
    assert "is prepared with the Python package opencv-python-headless" in (
        text := fault(loaded, "robotcar", files.QUERY)
    )
    assert "python -m pip install 'artifact[datasets]'" in text


@pytest.mark.parametrize(
    ("dataset", "text", "message"),
    [
        (
            "robotcar",
            "poses=gps",
            "preparation parameter poses: found 'gps'; input should be 'rtk_or_ins', 'rtk' or 'ins'",
        ),
        (
            "robotcar",
            "undistrt=true",
            "preparation parameter undistrt: found True; .* the parameters are poses, undistort",
        ),
        ("robotcar", "tab01.poses=ins", "parameters of a preparation have no name before them"),
        ("gardens_point", "spacing=1", "preparation parameter spacing: found 1; .* the parameters are none"),
        ("street", "", "street: is not prepared from published files; those that are: 'robotcar'"),
    ],
)
def test_wrong_parameters_are_one_line(tmp_path, monkeypatch, capsys, dataset, text, message):
    project(tmp_path, dataset if dataset != "street" else "robotcar")
    if dataset == "street":
        content = tiny_manifest()
        content["datasets"]["robotcar"] = SHIPPED["datasets"]["robotcar"]
        write_manifest(tmp_path, content)
    monkeypatch.chdir(tmp_path)
    assert cli.main(["data", "--dataset", dataset, "--set", text]) == 1
    shown = capsys.readouterr().err
    assert shown.startswith("error: ")
    assert shown.count("\n") == 1
    assert re.search(message, shown), shown


# -- tables ------------------------------------------------------------------------------------------------------------


def cells(lines, name):
    return next(line for line in lines if line.startswith(name))


def test_the_state_of_all_published_datasets_is_one_table(tmp_path, monkeypatch, capsys):
    loaded = project(tmp_path, "nordland")
    monkeypatch.chdir(tmp_path)
    assert cli.main(["data", "status"]) == 0
    row = cells(capsys.readouterr().out.splitlines(), "nordland")
    assert "missing" in row
    assert "0 of 5, 47.5 GB" in row
    put(loaded, "nordland", {name: content for name, content in made("nordland").items() if "winter" not in name})
    with pytest.raises(DatasetError):
        obtain(loaded, "nordland")
    (datasets.image_folder(loaded, "nordland", "fall") / files.LISTED[0]).unlink()
    lines = list(data.status_lines(loaded))
    joined = " ".join(" ".join(lines).split())
    assert "4 of 5, 47.5 GB" in joined
    assert "2 verified, 1" in joined
    assert any(line.startswith("nordland/fall: ") and "is missing since" in line for line in lines)


def test_a_run_of_the_paper_with_nothing_here_stops_with_one_table(tmp_path, monkeypatch, capsys):
    shutil.copy(REPOSITORY / "data_manifest.yaml", tmp_path)
    (tmp_path / "notebooks").symlink_to(REPOSITORY / "notebooks")
    monkeypatch.chdir(tmp_path)
    assert cli.main(["reproduce", "--profile", "paper"]) == 1
    text = capsys.readouterr().err
    assert "Traceback" not in text
    lines = text.splitlines()
    for name in ("amstertime", "nordland", "robotcar", "st_lucia", "svox"):
        assert "missing" in cells(lines, name)
    for name in SHIPPED["profiles"]["paper"]["methods"]:
        assert "missing weights" in cells(lines, name)
    assert not any(line.startswith("gardens_point ") for line in lines)
    for way in ("make rehearsal", "make reproduce ", "gardens_point is here: make reproduce SET="):
        assert way in text
    assert max(map(len, lines)) < 150
    assert not (tmp_path / ".cache" / "notebooks").exists()


def test_table_i_shows_counts_beside_the_papers_and_each_dataset_at_a_glance(tmp_path):
    loaded = project(tmp_path, "svox", "robotcar")
    put(loaded, "svox", made("svox"))
    put(loaded, "robotcar", made("robotcar"))
    obtain(loaded, "svox")
    obtain(loaded, "robotcar", files.QUERY, files.DATABASE)
    measured = catalogue.datasets_table(loaded, ["svox", "robotcar"]).table
    beside = catalogue.beside_the_paper(loaded, measured).set_index("dataset")
    assert list(beside.loc["svox", ["queries", "queries_here", "database_images_here"]]) == [872, "12 ≠", "20 ≠"]
    assert (beside.loc["nordland", ["queries_here", "here"]] == ["–", "not in this run"]).all()
    assert beside.loc["robotcar", "citation"] == "Maddern et al., IJRR 2017"
    assert "12 ≠" in pages.catalogue.beside_the_paper(beside.reset_index()).data
    assert "CC BY-NC-SA 4.0" in pages.catalogue.terms_table(beside.reset_index()).data
    shown = pages.catalogue.glance(loaded, "robotcar").data
    assert "query images, the paper lists 6,021." in shown
    assert f"{files.QUERY}: prepared 20" in shown
    assert "poses: rtk" in shown
    assert 'role="group"' in shown, "the map"
    strip = re.search(r'alt="(Examples[^"]*)"', shown)[1]
    assert strip == "Examples of RobotCar: query, positive, distractor"


def test_an_example_is_a_query_its_nearest_positive_and_an_image_farther_than_the_threshold(tmp_path, monkeypatch):
    loaded = project(tmp_path, "svox")
    put(loaded, "svox", made("svox"))
    obtain(loaded, "svox")
    dataset, seen = datasets.load(loaded, "svox"), []
    monkeypatch.setattr(galleries, "_strips", lambda strips, *_: seen.extend(strips))
    galleries.example_strips(dataset, 4)
    assert len(seen) == 4
    for (_, query, _, _), (_, positive, _, _), (pool, other, _, _) in seen:
        away = np.linalg.norm(dataset.database.positions - dataset.query.positions[query], axis=1)
        assert positive == away.argmin()
        assert pool is dataset.query
        assert np.linalg.norm(dataset.query.positions[other] - dataset.query.positions[query]) > dataset.threshold


def test_the_commands_of_the_readme_take_a_person_with_the_archives_there(tmp_path):
    """The section on the full paper, as printed, in a clone whose archives are the miniatures."""
    readme = (REPOSITORY / "README.md").read_text(encoding="utf-8")
    block = re.search(r"## The full paper\n\n```bash\n(.*?)```\n\n## ", readme, re.DOTALL)[1]
    clone, disk, home = tmp_path / "clone", tmp_path / "disk", tmp_path / "home"
    for folder in (clone / ".venv" / "bin", disk, home / "Downloads"):
        folder.mkdir(parents=True)
    project(clone, *files.ALL)
    for file in ("Makefile", "environment.txt", "pyproject.toml"):
        shutil.copy(REPOSITORY / file, clone)
    (clone / ".venv" / "bin" / "python").write_text(f'#!/bin/sh\nexec "{sys.executable}" "$@"\n')
    (clone / ".venv" / "bin" / "python").chmod(0o755)
    (clone / ".venv" / ".ready").write_text(f"{clone}\n")
    for dataset in files.ALL:
        by_hand = dataset in ("robotcar", "st_lucia")
        folder = home / "Downloads" if by_hand else disk / "downloads" / dataset
        folder.mkdir(parents=True, exist_ok=True)
        for name, content in made(dataset).items():
            (folder / name).write_bytes(content)
    typed = block[: block.index("make data PROFILE=paper")].replace("/disk/vpr", str(disk)).replace("~", str(home))
    environment = {n: v for n, v in os.environ.items() if not n.startswith(("ARTIFACT_", "MAKE"))}
    done = subprocess.run(
        ["sh", "-e", "-c", typed], cwd=clone, env=environment, capture_output=True, text=True, check=False, timeout=900
    )
    assert done.returncode == 0, done.stdout + done.stderr
    rows = [cells(done.stdout.splitlines(), f"{name} ") for name in files.ALL]
    assert all("verified" in row for row in rows), done.stdout
    assert not list((home / "Downloads").iterdir())


# -- the real images ---------------------------------------------------------------------------------------------------


@pytest.mark.data
def test_the_real_gardens_point_goes_the_same_way(tmp_path):
    """From a zip of the real images the same traversals come out, by content, as from their folder."""
    real, loaded = real_data_root() / "gardens_point", project(tmp_path, "gardens_point")
    folder = put(loaded, "gardens_point", {})
    with zipfile.ZipFile(folder / NAME, "w") as archive:
        for name in ("day_left", "day_right", "night_right"):
            for path in sorted((real / name).glob("*.jpg")):
                archive.write(path, f"GardensPoint_Walking/{name}/{path.name}")
    obtain(loaded, "gardens_point")
    by_hand = manifest.load(REPOSITORY / "data_manifest.yaml")
    for name in ("day_left", "day_right", "night_right"):
        prepared, own = (datasets.load_traversal(one, "gardens_point", name) for one in (loaded, by_hand))
        assert (prepared.digest, prepared.image_names) == (own.digest, own.image_names)
        np.testing.assert_array_equal(prepared.positions, own.positions)
    assert datasets.load(loaded, "gardens_point").differences == ()
