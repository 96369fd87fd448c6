"""Own images and own descriptors: from two folders or two files to numbers, as a new user types it."""

import json
import os
import re
import struct
import subprocess
import unicodedata
import zlib

import numpy as np
import pandas as pd
import pytest
import yaml
from conftest import REPOSITORY, artifact, real_data_root, tiny_manifest, write_images, write_manifest
from PIL import Image

from artifact import INLP, LEACE, STD, datasets, evaluate, manifest, split
from artifact.commands.arguments import assignments
from artifact.commands.cli import main
from artifact.datasets import DatasetError
from artifact.datasets.arrays import Descriptors, read_descriptors, read_positions, read_threshold
from artifact.datasets.images import UnreadableImageError, read_image
from artifact.datasets.positions import in_metres, positions_from_csv, positions_from_names
from artifact.studies import preview

RNG = np.random.default_rng(0)


def type_in(folder, *arguments):
    """Run the command as a user does, in a folder; return its status and output."""
    status, output = artifact(folder, *arguments, ARTIFACT_CACHE=str(folder / ".cache"), COLUMNS="200")
    assert "Traceback" not in output
    return status, output


@pytest.fixture
def town(tmp_path):
    """A folder with a manifest and two folders of photographs with awkward names."""
    write_manifest(tmp_path, tiny_manifest())
    write_images(tmp_path / "photos" / "night's $view", 24, seed=9, brightness=-50)
    write_images(tmp_path / "photos" / "day time", 24, seed=9)
    return tmp_path


ADD = ("data", "add", "my_town", "--query", "photos/night's $view", "--database", "photos/day time/")


# -- two folders of images ------------------------------------------------------------------------------------------


def test_two_folders_become_a_dataset_by_one_command(town):
    status, output = type_in(town, *ADD)
    assert status == 0, output
    assert "24 queries (all evaluated), 24 database images; positives within ±1 frame: 2 to 3" in output
    written = yaml.safe_load((town / "my_town" / "dataset.yaml").read_text())
    assert written["traversals"]["night_s_view"]["condition"] == "night's $view"
    assert written["traversals"]["night_s_view"]["images"] == "../photos/night's $view"
    page = (town / "my_town" / "preview.html").read_text()
    assert "night&#39;s $view" in page
    assert "<svg" in page or "data:image" in page
    before = {path: path.read_bytes() for path in (town / "my_town").iterdir()}
    assert type_in(town, *ADD)[0] == 0
    assert before == {path: path.read_bytes() for path in (town / "my_town").iterdir()}
    status, output = type_in(town, *ADD, "--threshold", "2frames")
    assert status == 1
    assert "says something else" in output


def test_the_dataset_is_found_where_the_command_was_typed(town):
    type_in(town, *ADD)
    deeper = town / "deeper"
    deeper.mkdir()
    manifest = ("--manifest", "../data_manifest.yaml")
    status, output = type_in(deeper, "evaluate", *manifest, "--datasets", "../my_town/", "--methods", "hog")
    assert status == 0, output
    assert "24 queries (all evaluated)" in output
    assert "hog 100.00" in output
    status, output = type_in(deeper, "evaluate", *manifest, "--datasets", "my_town/", "--methods", "hog")
    assert status == 1
    assert "no dataset 'my_town/'" in output


def test_a_look_writes_nothing(town):
    status, output = type_in(town, *ADD, "--dry-run")
    assert status == 0
    assert "nothing was written" in output
    assert not (town / "my_town").exists()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("--threshold", "5m"), "the threshold is in metres but the positions are the frame order"),
        (("--threshold", "far"), "the threshold is 'far'; allowed: metres as 25m, frames as 2frames, or exact"),
        (("--names",), "the name does not begin with @utm_east@utm_north@"),
        (("--positions", "nowhere.csv"), "no file"),
        (("--traversal", "photos"), "allowed: NAME=DIR"),
        (("--traversal", "rain=photos/rain"), "no folder"),
        (("--traversal", "day_time=photos/day time"), "every name must be there once"),
    ],
)
def test_what_cannot_be_a_dataset_is_one_line_and_writes_nothing(town, change, message):
    status, output = type_in(town, *ADD, *change)
    assert status == 1
    assert message in output
    assert len(output.strip().splitlines()) <= 4
    assert not (town / "my_town").exists()


def test_positions_from_files_and_a_further_pool(town):
    for part in ("night's $view", "day time"):
        names = [path.name for path in sorted((town / "photos" / part).iterdir())]
        rows = [f"{name},{int(name[5:-4]) * 10},0" for name in names]
        (town / f"{part[:3]}.csv").write_text("image,x,y\n" + "\n".join(rows))
    more = ("--positions", "nig.csv", "day.csv", "day.csv", "--traversal", "rain=photos/day time", "--threshold", "15m")
    status, output = type_in(town, *ADD, *more)
    assert status == 0, output
    written = yaml.safe_load((town / "my_town" / "dataset.yaml").read_text())
    assert written["threshold"] == {"value": 15.0, "unit": "metres"}
    assert written["distractor_traversals"] == ["rain"]
    assert written["traversals"]["rain"]["positions_file"] == "../day.csv"


# -- parameters as they are typed -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("", []),
        ("k=5", ["k=5"]),
        ('datasets=["my town", "b"]  k=5', ['datasets=["my town", "b"]', "k=5"]),
        ("datasets=['it]s'] fig06.k=5", ["datasets=['it]s']", "fig06.k=5"]),
        ('dataset="a $HOME b"', ['dataset="a $HOME b"']),
    ],
)
def test_parameters_are_split_at_spaces_outside_quotes_and_brackets(text, parts):
    assert assignments(text) == parts


@pytest.mark.parametrize("name", ["my town", "it's", "a$b", "ä#%"])
def test_make_hands_on_what_was_typed(name, tmp_path):
    ready = tmp_path / ".venv" / "bin"
    ready.mkdir(parents=True)
    (ready / "python").write_text('#!/bin/sh\nprintf "%s\\n" "$@"\n')
    (ready / "python").chmod(0o755)
    for file in ("Makefile", "environment.txt", "pyproject.toml"):
        (tmp_path / file).write_bytes((REPOSITORY / file).read_bytes())
    (tmp_path / ".venv" / ".ready").write_text(f"{tmp_path}\n")
    typed = f'SET=datasets=["{name}"] k=5'
    outside = {key: value for key, value in os.environ.items() if not key.startswith("MAKE")}
    done = subprocess.run(
        ["make", "reproduce", typed], cwd=tmp_path, env=outside, capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines()[-1] == f'datasets=["{name}"] k=5'
    assert assignments(done.stdout.splitlines()[-1]) == [f'datasets=["{name}"]', "k=5"]


# -- descriptors in files -------------------------------------------------------------------------------------------


@pytest.fixture
def files(tmp_path, monkeypatch):
    """Descriptors of 60 places under two conditions, with positions, in the folder where commands are typed."""
    monkeypatch.chdir(tmp_path)
    place = RNG.normal(size=(60, 32))
    queries = place + RNG.normal(size=place.shape) * 0.6 + 2 * RNG.normal(size=32)
    database = place + RNG.normal(size=place.shape) * 0.6
    for name, values in (("q", queries), ("d", database)):
        np.save(f"{name}.npy", values.astype(np.float32))
        rows = "".join(f"{name}{i}.jpg,{i * 10},0\n" for i in range(60))
        (tmp_path / f"{name}.csv").write_text(f"image,x,y\n{rows}")
    return tmp_path


FILES = (
    "evaluate",
    "--queries",
    "q.npy",
    "--database",
    "d.npy",
    "--query-positions",
    "q.csv",
    "--database-positions",
    "d.csv",
    "--threshold",
    "25",
)


def printed(capsys, *arguments):
    assert main(list(arguments)) == 0
    return json.loads(capsys.readouterr().out)


def by_view(found, k=1):
    return {row["what"]: row for row in found["results"] if row["K"] == k}


def test_files_of_descriptors_give_what_the_library_gives(files, capsys):
    arrays = np.load("q.npy"), np.load("d.npy")
    where = np.column_stack([np.arange(60) * 10.0, np.zeros(60)])
    expected = evaluate(*arrays, where, where, 25.0)
    found = printed(capsys, *FILES, "--json", "--per-query", "out.csv")
    assert (found["queries"], found["evaluated"], found["fewest"], found["most"]) == (60, 60, 3, 5)
    for k in (1, 5, 10):
        row = by_view(found, k)["original"]
        assert row["R"] == pytest.approx(100 * expected.recall(k))
        assert row["DAR"] == pytest.approx(100 * expected.dar(k))
        assert row["DAR_low"] <= row["DAR"] <= row["DAR_high"]
    table = pd.read_csv("out.csv")
    assert len(table) == 60
    assert (table["rank_with_distractors"] <= 1).mean() == pytest.approx(expected.dar(1))


def test_suppression_is_fitted_in_the_centre_and_evaluated_elsewhere(files, capsys):
    queries, database = np.load("q.npy"), np.load("d.npy")
    where = np.column_stack([np.arange(60) * 10.0, np.zeros(60)])
    region = split(where, where, 25.0, 0.2)
    parts = queries[region.fit_queries], database[region.fit_database]
    X, condition = np.concatenate(parts), np.repeat(["query", "database"], [len(part) for part in parts])
    rest = queries[region.evaluation_queries], database[region.evaluation_database]
    places = where[region.evaluation_queries], where[region.evaluation_database], 25.0
    std = STD().fit(X, condition)
    expected = {
        "original": evaluate(*rest, *places).dar(1),
        "LEACE": evaluate(*rest, *places, views={"LEACE": LEACE().fit(X, condition)})["LEACE"].dar(1),
        "STD": evaluate(std.transform(rest[0], "query"), std.transform(rest[1], "database"), *places).dar(1),
    }
    found = by_view(printed(capsys, *FILES, "--suppress", "LEACE", "STD", "--fraction", "0.2", "--json"))
    assert {name: row["DAR"] / 100 for name, row in found.items()} == pytest.approx(expected)
    assert expected["LEACE"] > expected["original"]


def test_pools_of_distractors(files, capsys):
    found = by_view(
        printed(capsys, *FILES, "--distractors", "same=q.npy,q.csv", "other=d.npy,d.csv", "--json", "--k", "1")
    )
    where = np.column_stack([np.arange(60) * 10.0, np.zeros(60)])
    assert found["original, same"]["DAR"] == pytest.approx(
        100 * evaluate(np.load("q.npy"), np.load("d.npy"), where, where, 25.0).dar(1)
    )
    assert found["original, other"]["DAR"] != found["original, same"]["DAR"]


def test_the_formats_of_other_tools(files, capsys):
    from safetensors.numpy import save_file

    expected = by_view(printed(capsys, *FILES, "--json"))["original"]["DAR"]
    queries, database = np.load("q.npy"), np.load("d.npy")
    np.savez("q.npz", descriptors=queries, names=[f"q{i}.jpg" for i in range(60)])
    save_file({"descriptors": database}, "d.safetensors")
    other = ["q.npz" if a == "q.npy" else "d.safetensors" if a == "d.npy" else a for a in FILES]
    assert by_view(printed(capsys, *other, "--json"))["original"]["DAR"] == expected
    names = [f"@{i * 10}@0@{i}@.jpg" for i in range(60)]
    (files / "names.txt").write_text("\n".join(names))
    (files / "images").mkdir()
    for name in names:
        (files / "images" / name).touch()
    other = ["names.txt" if a == "q.csv" else a for a in FILES]
    assert by_view(printed(capsys, *other, "--json"))["original"]["DAR"] == expected
    found = read_positions(files / "images", read_descriptors(files / "q.npy"), "queries")
    assert sorted(found[0][:, 0].tolist()) == [i * 10.0 for i in range(60)]


def test_an_hdf5_file_of_hloc(files, capsys):
    h5py = pytest.importorskip("h5py")
    expected = by_view(printed(capsys, *FILES, "--json"))["original"]["DAR"]
    for part in ("q", "d"):
        with h5py.File(f"{part}.h5", "w") as file:
            for index, values in enumerate(np.load(f"{part}.npy")):
                file.create_group(f"{part}{index}.jpg").create_dataset("global_descriptor", data=values)
    other = [a.replace(".npy", ".h5") for a in FILES]
    assert by_view(printed(capsys, *other, "--json"))["original"]["DAR"] == expected


def write_text(name, text):
    def write(folder):
        (folder / name).write_text(text)

    return write


def save(name, values):
    return lambda folder: np.save(folder / name, values)


@pytest.mark.parametrize(
    ("change", "message", "prepare"),
    [
        ({"q.npy": "nowhere.npy"}, "nowhere.npy: no such file", None),
        ({"q.npy": "q.csv"}, "the ending is '.csv'", None),
        ({"q.npy": "bad.npy"}, "bad.npy: cannot be read as .npy", write_text("bad.npy", "not an array")),
        ({"q.npy": "bad.npz"}, "bad.npz: cannot be read as .npz", write_text("bad.npz", "no zip")),
        ({"q.npy": "bad.safetensors"}, "cannot be read as .safetensors", write_text("bad.safetensors", "no")),
        ({"q.npy": "flat.npy"}, "shape (5,); descriptors are floats of shape (n, d)", save("flat.npy", np.ones(5))),
        ({"q.npy": "ints.npy"}, "descriptors are floats", save("ints.npy", np.ones((60, 32), int))),
        ({"q.npy": "short.npy"}, "60 positions for 59 descriptors", save("short.npy", np.ones((59, 32), np.float32))),
        ({"q.npy": "thin.npy"}, "d", save("thin.npy", np.ones((60, 31), np.float32))),
        ({"q.csv": "nowhere.csv"}, "nowhere.csv: no such file", None),
        ({"25": "2frames"}, "the threshold is in frames, the positions are in metres", None),
        ({"25": "-3"}, "the threshold is '-3'", None),
        (
            {"q.csv": "far.csv"},
            "nothing can be evaluated",
            write_text("far.csv", "image,x,y\n" + "\n".join(f"{i},{i},9999" for i in range(60))),
        ),
    ],
)
def test_unusable_files_are_one_line(files, capsys, change, message, prepare):
    if prepare:
        prepare(files)
    arguments = [change.get(argument, argument) for argument in FILES]
    arguments = ["--threshold=" + arguments[-1] if a == "--threshold" else a for a in arguments[:-1]]
    assert main(arguments) == 1
    error = capsys.readouterr().err
    assert message in error
    assert error.startswith("error: ")
    assert len(error.strip().splitlines()) == 1


@pytest.mark.parametrize("method", ["INLP", "LEACE", "STD"])
def test_transforms_are_fitted_saved_and_applied(files, capsys, method):
    assert (
        main(["suppress", "fit", "--queries", "q.npy", "--database", "d.npy", "--method", method, "--save", "t.npz"])
        == 0
    )
    which = ["--condition", "query"] if method == "STD" else []
    assert main(["suppress", "apply", "t.npz", "q.npy", "out.npy", *which]) == 0
    assert "out.npy: 60 descriptors of 32 values" in capsys.readouterr().out
    X, condition = np.concatenate([np.load("q.npy"), np.load("d.npy")]), np.repeat(["query", "database"], 60)
    fitted = {"INLP": INLP(), "LEACE": LEACE(), "STD": STD()}[method].fit(X, condition)
    expected = fitted.transform(np.load("q.npy"), *(["query"] if which else []))
    np.testing.assert_allclose(np.load("out.npy"), expected, atol=1e-6)


def test_a_transform_that_cannot_be_applied_writes_nothing(files, capsys):
    np.save("thin.npy", np.ones((3, 31), np.float32))
    STD().fit(np.load("q.npy"), np.repeat(["query", "database"], 30)).save("std.npz")
    for arguments, message in (
        (("std.npz", "q.npy", "out.npy"), "STD needs --condition; the conditions are database, query"),
        (("std.npz", "thin.npy", "out.npy", "--condition", "query"), "this transform was fitted on (n, 32)"),
        (("q.npy", "q.npy", "out.npy"), "q.npy: not a saved transform (it holds one plain array)"),
        (("std.npz", "q.npy", "out.txt"), "the ending is '.txt'"),
    ):
        assert main(["suppress", "apply", *arguments]) == 1
        assert message in capsys.readouterr().err
    assert not (files / "out.npy").exists()


def test_thresholds():
    assert str(read_threshold(" 25 m ")) == "25 m"
    with pytest.raises(DatasetError, match="allowed: metres as 25m"):
        read_threshold("25km")


# -- images and positions as other people have them -----------------------------------------------------------------


@pytest.fixture
def pair(tmp_path):
    """A folder with queries and database, and what the library makes of it after a change."""
    write_manifest(tmp_path, tiny_manifest())
    for part, brightness in (("queries", 0), ("database", -50)):
        write_images(tmp_path / "town" / part, 6, seed=9, brightness=brightness)

    def load():
        loaded = manifest.load(tmp_path / "data_manifest.yaml")
        name = str(tmp_path / "town")
        dataset = datasets.load(loaded, name)
        return dataset, preview.remarks_on(loaded, dataset)

    return tmp_path / "town", load


def csv_of(town, text, parts=("queries", "database"), encoding="utf-8"):
    for part in parts:
        (town / part / "positions.csv").write_bytes(text.encode(encoding))


ROWS = [(f"frame{i}.png", 10.0 * i, 2.0 * i) for i in range(6)]


@pytest.mark.parametrize(
    ("header", "row", "encoding"),
    [
        ("image,x,y", "{0},{1},{2}", "utf-8"),
        ("y,heading,IMAGE,time,x", "{2},90,{0},2020,{1}", "utf-8"),
        ("image;x;y", "{0};{c1};{c2}", "utf-8"),
        ("image\tx\ty", "{0}\t{c1}\t{c2}", "utf-8"),
        ("image,easting,northing", "{0},{1},{2}", "utf-16"),
        ("image,x,y,Straße", "{0},{1},{2},ü", "latin-1"),
        ("image,x,y", "./{0},{1},{2}", "utf-8-sig"),
        ("image,x,y", "{0},{1},{2}\r", "utf-8"),
    ],
)
def test_positions_are_read_by_column_name(pair, header, row, encoding):
    town, load = pair
    lines = [row.format(*r, c1=str(r[1]).replace(".", ","), c2=str(r[2]).replace(".", ",")) for r in ROWS]
    csv_of(town, "\n".join([header, *lines]) + "\n", encoding=encoding)
    loaded, remarks = load()
    assert loaded.unit == "metres"
    np.testing.assert_array_equal(loaded.query.positions, [row[1:] for row in ROWS])
    assert remarks == []


def test_latitude_and_longitude_become_metres(pair):
    town, load = pair
    csv_of(
        town, "image,lon,lat\n" + "\n".join(f"frame{i}.png,{179.9999 + i * 1e-4 - 360 * (i > 1)},51" for i in range(6))
    )
    loaded, remarks = load()
    steps = np.linalg.norm(np.diff(loaded.query.positions, axis=0), axis=1)
    np.testing.assert_allclose(steps, 7.02, atol=0.01)  # across the date line too
    assert remarks == []
    csv_of(town, "image,lon,lat\n" + "\n".join(f"frame{i}.png,0,{91 + i}" for i in range(6)))
    with pytest.raises(DatasetError, match="latitude and longitude of 'frame0.png'"):
        load()


LONG = np.linspace([10.4, 63.4], [15.0, 68.4], 6000)  # degrees along a railway of 729 km


@pytest.mark.parametrize("places", [13.4 + np.linspace([0, 39], [1e-3, 39.001], 6), LONG])
def test_degrees_in_place_of_metres_are_refused(tmp_path, places):
    names = [f"frame{i}.png" for i in range(len(places))]
    rows = [f"{name},{x},{y}" for name, (x, y) in zip(names, places, strict=True)]
    (tmp_path / "p.csv").write_text("\n".join(["image,x,y", *rows]))
    np.save(tmp_path / "p.npy", places)
    in_names = [f"@{x:.6f}@{y:.6f}@.png" for x, y in places]
    found = Descriptors(np.zeros((len(places), 2), np.float32), None)
    for read in (
        lambda: positions_from_csv(tmp_path / "p.csv", names),
        lambda: positions_from_names(tmp_path, in_names),
        lambda: read_positions(tmp_path / "p.npy", found, "queries"),
    ):
        with pytest.raises(DatasetError, match="of the size of degrees and hardly differ.*latitude and longitude"):
            read()


def test_metres_of_a_small_room_are_not_taken_for_degrees(tmp_path):
    room = np.column_stack([np.linspace(2, 6, 30), np.linspace(1, 3, 30)])
    np.testing.assert_array_equal(in_metres(room, tmp_path, range(30)), room)


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (np.array([[0.0, 1], [np.nan, 2]]), "the position of 1 is not a finite number"),
        (np.array([["a", "b"]] * 2), "found <U1 of shape .2, 2.; positions are numbers"),
        (np.zeros((2, 2, 2)), "positions are numbers of shape"),
        (np.zeros((3, 2)), "3 positions for 2 descriptors of the queries"),
    ],
)
def test_arrays_that_are_no_positions_are_refused(tmp_path, array, message):
    np.save(tmp_path / "p.npy", array)
    with pytest.raises(DatasetError, match=f"p.npy: .*{message}"):
        read_positions(tmp_path / "p.npy", Descriptors(np.zeros((2, 2), np.float32), None), "queries")


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04"])
def test_a_damaged_array_of_positions_is_one_line(tmp_path, content):
    (tmp_path / "p.npy").write_bytes(content)
    with pytest.raises(DatasetError, match="p.npy: cannot be read as a NumPy array"):
        read_positions(tmp_path / "p.npy", Descriptors(np.zeros((2, 2), np.float32), None), "queries")


def test_names_in_another_form_of_unicode_are_hinted_at(pair):
    town, load = pair
    rows = [(f"Stra\u0308\u00dfe{i}.png", 10.0 * i) for i in range(6)]
    for part in ("queries", "database"):
        for (name, _), path in zip(rows, sorted((town / part).iterdir()), strict=True):
            path.rename(path.with_name(unicodedata.normalize("NFC", name)))
    csv_of(town, "image,x,y\n" + "\n".join(f"{name},{x},0" for name, x in rows))
    with pytest.raises(DatasetError, match="no row for 6 of 6 images.*in other case or another form of Unicode"):
        load()


def test_zones_of_query_and_database_must_be_one(pair, files, capsys):
    town, load = pair
    for part, zone in (("queries", 31), ("database", 32)):
        for index, path in enumerate(sorted((town / part).iterdir())):
            path.rename(path.with_name(f"@{500000 + 10 * index}@4000000@{zone}@U@{index}@.png"))
    with pytest.raises(DatasetError, match="the names are in the UTM zones 31, 32"):
        load()
    for part in ("queries", "database"):  # the way out that the message names
        rows = [f"{path.name},51,{5.999 + 1e-4 * i}" for i, path in enumerate(sorted((town / part).iterdir()))]
        (town / part / "positions.csv").write_text("\n".join(["image,latitude,longitude", *rows]))
    assert load()[0].query.positions.shape == (6, 3)
    for name, zone in (("a", 31), ("b", 32)):
        lines = [f"@{500000 + 10 * i}@4000000@{zone}@U@{i}@.png" for i in range(60)]
        (files / f"{name}.txt").write_text("\n".join(lines))
    arguments = [{"q.csv": "a.txt", "d.csv": "b.txt"}.get(argument, argument) for argument in FILES]
    assert main(arguments) == 1
    assert "in the UTM zone 32, those of the queries in 31" in capsys.readouterr().err


def test_one_positions_file_beside_described_folders(pair):
    town, load = pair
    rows = [f"{part}/{name},{x},{y + (part == 'database')}" for part in ("queries", "database") for name, x, y in ROWS]
    (town / "positions.csv").write_text("image,x,y\n" + "\n".join(rows))
    traversals = {part: {"condition": part} for part in ("queries", "database")}
    description = {"title": "T", "kind": "folder", "query": "queries", "database": "database", "traversals": traversals}
    description["threshold"] = {"value": 25, "unit": "metres"}
    (town / "dataset.yaml").write_text(yaml.safe_dump(description))
    np.testing.assert_array_equal(load()[0].database.positions[:, 1], [row[2] + 1 for row in ROWS])


def test_one_positions_file_beside_the_folders(pair):
    town, load = pair
    rows = [f"{part}/{name},{x},{y + (part == 'database')}" for part in ("queries", "database") for name, x, y in ROWS]
    (town / "positions.csv").write_text("image,x,y\n" + "\n".join(rows))
    loaded, _ = load()
    np.testing.assert_array_equal(loaded.query.positions, [row[1:] for row in ROWS])
    np.testing.assert_array_equal(loaded.database.positions[:, 1], [row[2] + 1 for row in ROWS])


@pytest.mark.parametrize("form", ["@{0}@{1}@.png", "cam0_{2}@{0}@{1}@.png", "@{0}@{1}@31@U@{2}@.png"])
def test_positions_in_names(pair, form):
    town, load = pair
    for part in ("queries", "database"):
        for index, path in enumerate(sorted((town / part).iterdir())):
            path.rename(path.with_name(form.format(500000 + 10 * index, 4000000.5, index)))
    loaded, _ = load()
    assert loaded.unit == "metres"
    assert sorted(loaded.query.positions[:, 0]) == [500000 + 10 * index for index in range(6)]
    first = next((town / "queries").iterdir())
    if "31" in form:
        first.rename(first.with_name("@500000@4000000@32@U@0@.png"))
        with pytest.raises(DatasetError, match="in the UTM zones 31, 32"):
            load()
    else:
        first.rename(first.with_name("plain.png"))
        with pytest.raises(
            manifest.ManifestError, match="5 of 6 names hold @utm_east@utm_north@, 'plain.png' does not"
        ):
            load()


def test_coordinates_that_jump_are_remarked(pair):
    town, load = pair
    csv_of(town, "image,x,y\n" + "\n".join(f"frame{i}.png,{500000 + i * 10 + 3e5 * (i > 2)},0" for i in range(6)))
    assert any("do the coordinates cross the border of a zone?" in remark for remark in load()[1])


def test_frames_of_which_some_are_missing_are_remarked_and_paired_by_name(pair):
    town, load = pair
    (town / "queries" / "frame1.png").unlink()
    loaded, remarks = load()
    assert remarks[0] == "frames are paired by their order, but queries has 5 images and database 6"
    assert remarks[1].startswith(
        "frames are paired by their order though names differ: frame2 with frame1, frame3 with frame2"
    )
    description = {
        "title": "Town",
        "kind": "folder",
        "threshold": {"value": 0, "unit": "frames"},
        "query": "queries",
        "database": "database",
        "by_name": True,
        "traversals": {p: {"condition": p} for p in ("queries", "database")},
    }
    (town / "dataset.yaml").write_text(yaml.safe_dump(description))
    loaded, remarks = load()
    assert remarks == []
    np.testing.assert_array_equal(loaded.query.positions[:, 0], [0, 2, 3, 4, 5])
    np.testing.assert_array_equal(loaded.database.positions[:, 0], range(6))


@pytest.mark.parametrize(
    ("rename", "remark"),
    [
        (lambda i: f"night_{i}.png", None),  # numbers tell frames
        (lambda i: f"night_{i + 1:03d}.png", "frame0 with night_001, frame1 with night_002"),
        (lambda i: f"{'abcdef'[i]}.png", "frame0 with a, frame1 with b, frame2 with c, frame3 with d, frame4 with e;"),
    ],
)
def test_names_that_number_frames_otherwise_are_remarked(pair, rename, remark):
    town, load = pair
    for index, path in enumerate(sorted((town / "database").iterdir())):
        path.rename(path.with_name(rename(index)))
    remarks = load()[1]
    assert len(remarks) == (remark is not None)
    assert remark is None or remark in remarks[0]


def test_the_same_images_twice_are_remarked(pair):
    town, load = pair
    for index in range(3):
        (town / "database" / f"frame{index}.png").write_bytes((town / "queries" / f"frame{index}.png").read_bytes())
    assert load()[1] == ["3 images are both query and database: their places are found by themselves"]
    for path in (town / "queries").iterdir():
        path.write_bytes((town / "queries" / "frame5.png").read_bytes())
    assert "all images of queries are the same" in load()[1]


@pytest.mark.parametrize("ending", ["png", "jpg"])
def test_pictures_saved_again_are_remarked(pair, ending):
    town, _ = pair
    loaded = manifest.load(town.parent / "data_manifest.yaml")
    assert not [text for text in preview.look_at(loaded, str(town)).remarks if "copies" in text]
    for path in sorted((town / "queries").iterdir()):
        with Image.open(path) as image:
            image.save(town / "database" / path.with_suffix(f".{ending}").name, compress_level=1, quality=90)
        if ending == "jpg":
            (town / "database" / path.name).unlink()
    assert preview.look_at(loaded, str(town)).remarks[-1].startswith("6 of 6 query images look like copies")


def test_a_threshold_that_all_images_lie_within_is_remarked(pair):
    town, load = pair
    csv_of(town, "image,x,y\n" + "\n".join(f"frame{i}.png,{500 + 3 * i},7" for i in range(6)))
    assert load()[1] == [
        "every database image is a positive of most queries: is the threshold in the unit of the positions?"
    ]


def test_one_position_for_all_is_remarked(pair):
    town, load = pair
    csv_of(town, "image,x,y\n" + "\n".join(f"frame{i}.png,500,7" for i in range(6)))
    assert len([remark for remark in load()[1] if "every image is a positive of every query" in remark]) == 2


def test_system_files_are_passed_over_and_unreadable_ones_named(pair):
    town, load = pair
    for name in (".DS_Store", "._frame0.png", "Thumbs.db", "__MACOSX/frame0.png"):
        (town / "queries" / name).parent.mkdir(exist_ok=True)
        (town / "queries" / name).write_text("x")
    loaded, remarks = load()
    assert (len(loaded.query), remarks) == (6, [])
    (town / "queries" / "IMG_1.HEIC").write_text("x")
    assert load()[1] == [
        "queries: 1 file is no image that can be read here, first 'IMG_1.HEIC'; HEIC must be converted first"
    ]


def test_odd_file_names_are_sorted(pair):
    town, load = pair
    names = ["12²3.png", "a\nb.png", "x" * 250 + ".png", "UPPER.PNG", "ä #%.png", "7.png"]
    for path, name in zip(sorted((town / "queries").iterdir()), names, strict=True):
        path.rename(path.with_name(name))
    assert sorted(load()[0].query.image_names) == sorted(names)


GREY = np.kron(np.linspace(20, 230, 48).reshape(6, 8), np.ones((16, 16)))


def saved(tmp_path, image, name="image.png", **options):
    image.save(tmp_path / name, **options)
    return tmp_path / name


def test_sixteen_bits_are_scaled_and_other_ranges_refused(tmp_path):
    values = (GREY * 257).round().astype(np.uint16)
    for name, array in (("grey.png", values), ("big.tif", values.astype(">u2"))):
        if name.endswith("png"):
            path = saved(tmp_path, Image.fromarray(array), name)
        else:
            path = tmp_path / name
            path.write_bytes(big_endian_tiff(array))
        np.testing.assert_array_equal(np.asarray(read_image(path, "grey")), GREY.round().astype(np.uint8))
    for array, message in (
        ((GREY * 16).astype(np.uint16), "as of a 12-bit camera"),
        (GREY.astype(np.float32), "mode 'F' have no defined range"),
        (GREY.astype(np.int32), "mode 'I' have no defined range"),
    ):
        path = saved(tmp_path, Image.fromarray(array), "odd.tif")
        with pytest.raises(UnreadableImageError, match=f"odd.tif: .*{message}"):
            read_image(path)


@pytest.mark.parametrize("peak", [255, 4095, 65535])
def test_deep_colours_must_use_their_range(tmp_path, peak):
    values = (GREY / GREY.max() * peak).astype(">u2")
    rows = np.repeat(values[:, :, None], 3, axis=2)
    (tmp_path / "deep.png").write_bytes(deep_png(rows))
    if peak < 65535:
        with pytest.raises(UnreadableImageError, match="deep.png: 16-bit colours as of a 12-bit camera"):
            read_image(tmp_path / "deep.png")
    else:
        np.testing.assert_allclose(np.asarray(read_image(tmp_path / "deep.png"))[..., 0], values / 257, atol=1)


def deep_png(values):
    """The simplest PNG of 16-bit colours, which Pillow reads and does not write."""

    def chunk(name, content):
        return struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content))

    h, w, _ = values.shape
    rows = b"".join(b"\0" + row.tobytes() for row in values)
    header = struct.pack(">IIBBBBB", w, h, 16, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


def big_endian_tiff(values):
    """The simplest big-endian TIFF: one strip of 16-bit grey values."""
    h, w = values.shape
    tags = [
        (256, 4, w),
        (257, 4, h),
        (258, 3, 16),
        (259, 3, 1),
        (262, 3, 1),
        (273, 4, 8),
        (277, 3, 1),
        (278, 4, h),
        (279, 4, 2 * h * w),
    ]
    body = values.astype(">u2").tobytes()
    entries = b"".join(
        struct.pack(">HHI", tag, kind, 1) + (struct.pack(">I", value) if kind == 4 else struct.pack(">HH", value, 0))
        for tag, kind, value in tags
    )
    return b"MM\x00*" + struct.pack(">I", 8 + len(body)) + body + struct.pack(">H", len(tags)) + entries + bytes(4)


def test_photographs_of_a_phone_go_from_two_folders_to_numbers(tmp_path):
    write_manifest(tmp_path, tiny_manifest())
    write_images(tmp_path / "plain", 12, seed=9, noise=5)
    for folder, first, darker in (("day", 2031, 0), ("night", 3107, 60)):
        (tmp_path / folder).mkdir()
        for i, path in enumerate(sorted((tmp_path / "plain").iterdir(), key=lambda path: int(path.stem[5:]))):
            with Image.open(path) as image:
                photograph = image.resize((800, 600)).point(lambda value, darker=darker: max(0, value - darker))
            exif = Image.Exif()
            if i % 3 == 0:
                photograph, exif[0x0112] = photograph.transpose(Image.Transpose.ROTATE_90), 6
            photograph.save(tmp_path / folder / f"IMG_{first + i}.JPG", quality=88, exif=exif)
    for other in ("IMG_2040.HEIC", "IMG_2041.MOV", ".DS_Store"):
        (tmp_path / "day" / other).write_bytes(b"x")
    status, output = type_in(tmp_path, "data", "add", "walk", "--query", "night", "--database", "day")
    assert status == 0, output
    assert re.search(r"night\s+night\s+query\s+12\s+1.00 800 × 600\s+0 ", output)
    assert "day: 2 files are no images that can be read here, first 'IMG_2040.HEIC'; HEIC must be converted" in output
    assert "by their order though names differ: IMG_3107 with IMG_2031" in output
    status, output = type_in(tmp_path, "evaluate", "--datasets", "walk", "--methods", "hog")
    assert status == 0, output
    assert re.search(r"walk\s+hog\s+\d+\.\d\d", output)


@pytest.mark.data
def test_the_real_pair_with_frames_removed_is_told_and_paired_by_name(tmp_path):
    """Frames 10, 20 and 30 of the day and 100 of the night are gone: by order most pairs are of other places."""
    write_manifest(tmp_path, tiny_manifest())
    for name, removed in (("day_right", (10, 20, 30)), ("night_right", (100,))):
        (tmp_path / name).mkdir()
        for path in sorted((real_data_root() / "gardens_point" / name).iterdir()):
            if int(path.stem[-3:]) not in removed:
                (tmp_path / name / path.name).symlink_to(path)
    add = ["data", "add", "gardens", "--query", "night_right", "--database", "day_right", "--threshold", "1frame"]
    status, output = type_in(tmp_path, *add)
    assert status == 0, output
    assert "night_right has 199 images and day_right 197" in output
    assert re.search(r"names differ: Image010 with Image011, .*; 'by_name: true' pairs equal names", output)
    recalls = []
    for by_name in (False, True):
        status, output = type_in(tmp_path, "evaluate", "--datasets", "gardens", "--methods", "hog")
        assert status == 0, output
        assert ("names differ" in output) != by_name
        recalls.append(float(re.search(r"gardens +hog +(\d+\.\d+)", output)[1]))
        description = yaml.safe_load((tmp_path / "gardens" / "dataset.yaml").read_text())
        (tmp_path / "gardens" / "dataset.yaml").write_text(yaml.safe_dump(description | {"by_name": True}))
    assert recalls[1] > recalls[0] + 5


def test_photographs_are_turned_upright(tmp_path):
    pixels = np.zeros((40, 60, 3), np.uint8)
    pixels[:20] = 200
    exif = Image.Exif()
    exif[0x0112] = 6  # the camera was turned: rotate by 270 degrees
    path = saved(tmp_path, Image.fromarray(pixels), "turned.jpg", exif=exif, quality=95)
    upright = np.asarray(read_image(path))
    assert upright.shape == (60, 40, 3)
    assert upright[:, 30:].mean() > 190
    assert upright[:, :10].mean() < 10


@pytest.mark.parametrize("mode", ["RGBA", "LA", "P"])
def test_what_is_transparent_lies_on_white(tmp_path, mode):
    rgba = np.zeros((8, 8, 4), np.uint8)
    rgba[:4, :, 3] = 255
    image = Image.fromarray(rgba)
    if mode == "P":
        image = Image.fromarray(np.repeat([[0], [1]], 4, axis=0).repeat(8, axis=1).astype(np.uint8), "L").convert("P")
        image.putpalette([0, 0, 0, 0, 0, 0])
        path = saved(tmp_path, image, transparency=1)
    else:
        path = saved(tmp_path, image.convert(mode))
    found = np.asarray(read_image(path))
    assert (found[:4] == 0).all()
    assert (found[4:] == 255).all()


def test_raw_mosaics_are_refused_and_grey_photographs_are_not(tmp_path):
    rng = np.random.default_rng(0)
    grey = np.clip(GREY + rng.normal(0, 12, GREY.shape), 0, 255)
    read_image(saved(tmp_path, Image.fromarray(grey.astype(np.uint8))))
    mosaic = grey * np.tile([[0.6, 1.0], [1.0, 0.8]], (GREY.shape[0] // 2, GREY.shape[1] // 2))
    path = saved(tmp_path, Image.fromarray(mosaic.astype(np.uint8)), "raw.png")
    with pytest.raises(
        UnreadableImageError, match=r"raw.png: looks like a raw colour mosaic \(Bayer pattern\); demosaic it"
    ):
        read_image(path)
