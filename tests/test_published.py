"""The six datasets from their published files, in miniature: from a download to DAR, and every fault that files can have."""

from __future__ import annotations

import copy
import hashlib
import io
import json
import re
import zipfile

import numpy as np
import pandas as pd
import published_files as files
import pytest
import yaml
from conftest import REPOSITORY, THUMBNAIL, write_manifest
from PIL import Image
from released import names_in, running

import artifact
from artifact import datasets, manifest
from artifact.commands import cli
from artifact.datasets import DatasetError, published
from artifact.datasets.published import originals, poses, preparation
from artifact.extraction import extract

SHIPPED = yaml.safe_load((REPOSITORY / "data_manifest.yaml").read_text(encoding="utf-8"))
SMALL = {
    "nordland": {"list_sha256": hashlib.sha256("".join(f"{name}\n" for name in files.LISTED).encode()).hexdigest()},
    "robotcar": {"size": list(files.SIZE)},
}
MADE: dict[str, dict[str, bytes]] = {}


@pytest.fixture
def server():
    with running() as server:
        yield server


def made(dataset):
    """The published files of a dataset in miniature, made once."""
    if dataset not in MADE:
        MADE[dataset] = files.ALL[dataset]()
    return dict(MADE[dataset])


def small(dataset, urls=None, **parameters):
    """The shipped entry of a dataset with its miniature parameters, and addresses of files by their names."""
    entry = copy.deepcopy(SHIPPED["datasets"][dataset])
    entry["preparation"]["parameters"] = (
        entry["preparation"].get("parameters", {}) | SMALL.get(dataset, {}) | parameters
    )
    for file in entry["preparation"]["files"]:
        file["urls"] = (urls or {}).get(file["file"], [])
        file.pop("size", None)
        if "parts" in file:
            file["parts"] = 2
    return entry


def project(folder, *names, urls=None, **parameters):
    """A manifest with small entries of datasets."""
    content = {
        "version": 1,
        "data_root": "data",
        "datasets": {name: small(name, urls, **parameters) for name in names},
        "methods": {"thumbnail": THUMBNAIL},
        "profiles": {"demo": {"description": "small", "datasets": list(names), "methods": ["thumbnail"]}},
    }
    return manifest.load(write_manifest(folder, content))


def put(loaded, dataset, contents):
    """Put files into the folder of downloads, as a person does."""
    folder = originals.downloads(loaded, dataset)
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in contents.items():
        (folder / name).write_bytes(content)
    return folder


def obtain(loaded, dataset, *traversals, **given):
    return list(published.obtain(loaded, dataset, traversals, given))


def fault(loaded, dataset, *traversals, **given):
    """The message of a preparation that fails; whatever happened, no traversal may look complete."""
    with pytest.raises(DatasetError) as caught:
        obtain(loaded, dataset, *traversals, **given)
    names = traversals or list(loaded.dataset(dataset).traversals)
    assert not any(datasets.image_folder(loaded, dataset, name).exists() for name in names)
    return str(caught.value)


def index_of(loaded, dataset, traversal):
    folder = datasets.image_folder(loaded, dataset, traversal)
    return pd.read_csv(folder / "images.csv", dtype={"original": str}), folder


# -- from a download to DAR --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dataset", files.ALL)
def test_every_dataset_goes_from_a_download_to_dar(tmp_path, server, monkeypatch, dataset):
    contents = made(dataset)
    gone = f"http://127.0.0.1:{server.server_port}/gone"
    urls = {
        name: [gone, server.serve(name, content, ends_after=[len(content) // 2])] for name, content in contents.items()
    }
    loaded = project(tmp_path, dataset, urls=urls)
    by_hand = {
        name: content for name, content in contents.items() if "-" in name and name[:4].isdecimal()
    }  # RobotCar's
    put(loaded, dataset, by_hand)
    if dataset == "st_lucia":
        put(loaded, dataset, contents)
    monkeypatch.chdir(tmp_path)
    assert cli.main(["data", "--dataset", dataset]) == 0

    entry = loaded.dataset(dataset)
    ready = datasets.load(loaded, dataset, entry.traversals)
    for name, traversal in ready.traversals.items():
        table, folder = index_of(loaded, dataset, name)
        assert list(table["image"]) == list(traversal.image_names)
        assert names_in(folder) == {*table["image"], "images.csv", "prepared.json"}
        assert (table["traversal"] == name).all()
        assert (table["condition"] == entry.traversals[name].condition).all()
        sidecar = json.loads((folder / "prepared.json").read_text())
        digests = {source["file"]: source["sha256"] for source in sidecar["sources"]}
        assert digests
        assert all(digest == hashlib.sha256(contents[file]).hexdigest() for file, digest in digests.items())
    assert names_in(tmp_path / "data") <= {"downloads", dataset}
    assert not list((tmp_path / "data").rglob("*.preparing*"))

    described = [
        extract.descriptors(loaded, one, "thumbnail", workers=0).values for one in (ready.query, ready.database)
    ]
    result = artifact.evaluate(*described, ready.query.positions, ready.database.positions, threshold=ready.threshold)
    assert result.n_queries == len(ready.query)
    assert 0 < result.dar(1) <= result.recall(1) == 1

    before = {
        path: path.stat().st_mtime_ns
        for path in (tmp_path / "data").rglob("*")
        if path.is_file() and path.stat().st_size
    }
    asked = {name: len(page.asked) for name, page in server.pages.items()}
    assert cli.main(["data", "--dataset", dataset]) == 0
    assert {path: path.stat().st_mtime_ns for path in before} == before
    assert {name: len(page.asked) for name, page in server.pages.items()} == asked
    assert [state.status for state in published.states(loaded, dataset)] == ["verified"] * len(entry.traversals)


def test_images_that_are_not_converted_keep_their_bytes(tmp_path):
    for dataset, images in (
        ("gardens_point", files.gardens_point_images()),
        ("amstertime", files.amstertime_images()),
        ("svox", files.svox_images()),
    ):
        (tmp_path / dataset).mkdir()
        loaded = project(tmp_path / dataset, dataset)
        put(loaded, dataset, made(dataset))
        obtain(loaded, dataset)
        for name in loaded.dataset(dataset).traversals:
            table, folder = index_of(loaded, dataset, name)
            for row in table.itertuples():
                assert (folder / row.image).read_bytes() == images[row.original]


def test_positions_are_places_in_lists_and_the_first_two_fields_of_names(tmp_path):
    """Across a gap in the numbers neighbours of the list are one apart: that is what ±1 frame means."""
    expected = {
        "gardens_point": ("day_left", lambda row, _: int(row.image[5:8])),
        "amstertime": ("old", lambda row, _: files.NUMBERS.index(int(row.image[:4]))),
        "nordland": ("Winter", lambda row, _: files.LISTED.index(row.image)),
        "svox": ("gallery", lambda row, at: float(row.image.split("@")[1 if at == "x" else 2])),
    }
    for dataset, (traversal, position) in expected.items():
        (tmp_path / dataset).mkdir()
        loaded = project(tmp_path / dataset, dataset)
        put(loaded, dataset, made(dataset))
        obtain(loaded, dataset, traversal)
        table, _ = index_of(loaded, dataset, traversal)
        for axis in ("x", "y") if dataset == "svox" else ("index",):
            assert list(table[axis]) == [position(row, axis) for row in table.itertuples()]


# -- RobotCar: colours, poses, spacing -------------------------------------------------------------------------------


def test_robotcar_positions_are_on_the_track_and_as_far_apart_as_asked(tmp_path):
    """The car drives at constant speed, so that the position at any time is known; RTK and INS are on the same track."""
    loaded = project(tmp_path, "robotcar")
    put(loaded, "robotcar", made("robotcar"))
    lines = obtain(loaded, "robotcar")
    for traversal, kind in ((files.QUERY, "rtk"), (files.OVERCAST, "ins")):
        table, folder = index_of(loaded, "robotcar", traversal)
        times = table["original"].astype(np.int64)
        assert list(table["image"]) == [f"{time}.png" for time in times]
        np.testing.assert_allclose(table["x"], [files.easting(traversal, time) for time in times], atol=1e-6)
        np.testing.assert_allclose(table["y"], files.CORNER[1], atol=1e-6)
        every = [t for t in files.times(traversal) if t >= files.BEGIN[traversal] + 500_000]
        expected = every[:: int(np.ceil(1 / (files.SPEED * files.INTERVAL / 1e6)))]  # the greedy rule at constant speed
        assert list(times) == expected
        found = json.loads((folder / "prepared.json").read_text())["found"]
        assert (found["poses"], found["frames"], found["frames_without_pose"]) == (
            kind,
            files.FRAMES,
            files.FRAMES - len(every),
        )
    assert any("frames without pose: 9" in line for line in lines)


def test_robotcar_mosaics_become_the_colours_that_they_sampled(tmp_path):
    """In the middle of each flat patch of the scene the colour is exact, whatever the pattern's phase."""
    loaded = project(tmp_path, "robotcar")
    put(loaded, "robotcar", made("robotcar"))
    obtain(loaded, "robotcar", files.QUERY)
    table, folder = index_of(loaded, "robotcar", files.QUERY)
    for row in table.iloc[::10].itertuples():
        with Image.open(folder / row.image) as image:
            assert (image.mode, image.size) == ("RGB", files.SIZE)
            colours = np.asarray(image)
        expected = np.asarray(files.scene(files.place(files.QUERY, int(row.original))))
        np.testing.assert_array_equal(colours[4::8, 4::8], expected[4::8, 4::8])
        np.testing.assert_array_equal(colours[3::8, 3::8], expected[3::8, 3::8])


def test_robotcar_undistortion_samples_the_columns_and_rows_of_the_table(tmp_path):
    """A table that reads two pixels to the right and four down shifts the image; what is outside is black."""
    loaded = project(tmp_path, "robotcar")
    width, height = files.SIZE
    u, v = np.meshgrid(np.arange(width) + 2.0, np.arange(height) + 4.0)
    table = np.concatenate([u.ravel(), v.ravel()]).astype("<f8").tobytes()
    put(loaded, "robotcar", made("robotcar"))
    obtain(loaded, "robotcar", files.QUERY)
    plain = index_of(loaded, "robotcar", files.QUERY)[1]
    name = sorted(path.name for path in plain.glob("*.png"))[0]
    before = np.asarray(Image.open(plain / name)).copy()
    put(loaded, "robotcar", {"stereo_narrow_left_distortion_lut.bin": table})
    obtain(loaded, "robotcar", files.QUERY, undistort=True)
    after = np.asarray(Image.open(plain / name))
    np.testing.assert_array_equal(after[:-4, :-2], before[4:, 2:])
    assert not after[-4:].any()
    assert not after[:, -2:].any()
    assert obtain(loaded, "robotcar", files.QUERY)[-1].endswith(
        f"prepared, verified: {plain}"
    )  # as it was last asked for
    put(loaded, "robotcar", {"stereo_narrow_left_distortion_lut.bin": table[:-8]})
    (originals.downloads(loaded, "robotcar") / "stereo_narrow_left_distortion_lut.bin.lock.json").unlink()
    with pytest.raises(DatasetError, match="6,143 numbers; 64 × 48 pixels need 6,144"):
        obtain(loaded, "robotcar", files.QUERY, undistort=True, spacing=2.0)
    assert len(datasets.load_traversal(loaded, "robotcar", files.QUERY)) > 0  # what was there is still there


def test_robotcar_at_its_true_size(tmp_path):
    """One raw image of 1280 × 960 pixels, with the shipped parameters."""
    rng = np.random.default_rng(0)
    image = Image.fromarray(np.kron(rng.integers(0, 255, (12, 16, 3), np.uint8), np.ones((80, 80, 1), np.uint8)))
    entry = manifest.load(REPOSITORY / "data_manifest.yaml").dataset("robotcar")
    parameters = preparation.parameters_of("robotcar", entry, {})
    sources = preparation.Sources(entry, files.QUERY, {}, parameters)
    from artifact.datasets.published.robotcar import _converter

    converted = _converter(sources)(files.encoded(files.mosaic(image), "PNG"), "here")
    with Image.open(io.BytesIO(converted)) as found:
        assert found.size == (1280, 960)
        np.testing.assert_array_equal(np.asarray(found)[40::80, 40::80], np.asarray(image)[40::80, 40::80])
    with pytest.raises(
        DatasetError, match=r"here: 64 × 48 pixels of mode L; raw images .* have 1280 × 960 of one channel"
    ):
        _converter(sources)(files.encoded(files.mosaic(files.scene(0)), "PNG"), "here")


REGION = (0.0, 1000.0), (0.0, 1000.0)


def track(rows):
    return "\n".join(["timestamp,northing,easting", *(f"{10**15 + int(t * 1e6)},{y},{x}" for t, x, y in rows)])


def test_outliers_of_poses_are_left_out_and_counted():
    steady = [(0.1 * i, 10 + i, 5.0) for i in range(20)]
    for spoiled in (0, 7, 8, 19):
        rows = [(t, 900.0, 5.0) if i == spoiled else (t, x, y) for i, (t, x, y) in enumerate(steady)]
        found = poses.read(track(rows), "here", REGION, 50.0)
        assert found.found == {"pose_rows": 20, "implausible_pose_rows": 1}
        np.testing.assert_array_equal(found.positions[:, 0], [10 + i for i in range(20) if i != spoiled])
    outside = [*steady[:5], (0.5, 15.0, -3.0), *steady[6:]]
    assert poses.read(track(outside), "here", REGION, 50.0).found["implausible_pose_rows"] == 1
    with pytest.raises(DatasetError, match=r"here: only 0 of 20 positions are plausible"):
        poses.read(track([(t, x + 5000, y) for t, x, y in steady]), "here", REGION, 50.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("timestamp,x,y\n", "here:1: needs the columns timestamp, easting and northing; found 'timestamp,x,y'"),
        (
            track([(0, 1, 1), (1, "east", 1)]),
            "here:3: found '1000000001000000,1,east'; easting and northing must be numbers",
        ),
        (track([(0, 1, 1), (2, 2, 1), (1, 3, 1)]), "here:4: the time 1000000001000000 is before the one above"),
        (track([(0, 1, 1), (0, 2, 1)]), "here:3: the time 1000000000000000 is there twice"),
        (track([(0, 1, 1)]), "here: 1 rows of poses; the file is cut short"),
        (
            "timestamp,northing,easting\n1000000000000000000,1,1",
            "here:2: found the time '1000000000000000000'; .* 16 digits",
        ),
        ("timestamp,northing,easting\n1000000000000000,1", "here:2: found '1000000000000000,1'"),
    ],
)
def test_faults_of_pose_files_have_their_line(text, message):
    with pytest.raises(DatasetError, match=f"^{message}"):
        poses.read(text, "here", REGION, 50.0)


# -- St Lucia ----------------------------------------------------------------------------------------------------------


def test_st_lucia_keeps_the_first_frame_of_each_fix_in_the_south(tmp_path):
    loaded = project(tmp_path, "st_lucia")
    put(loaded, "st_lucia", made("st_lucia"))
    obtain(loaded, "st_lucia")
    table, folder = index_of(loaded, "st_lucia", "100909_0845")
    assert list(table["original"]) == [f"frame {i}" for i in range(0, files.FILM, files.PER_FIX)]
    assert table["y"].between(6.94e6, 6.97e6).all()  # of the southern hemisphere
    assert (np.diff(table["y"]) > 0).all()  # to the north, not mirrored
    np.testing.assert_allclose(np.hypot(np.diff(table["x"]), np.diff(table["y"])), files.METRES, rtol=2e-3)
    for row in table.iloc[[0, 5, -1]].itertuples():
        frame = int(row.original.split()[1])
        seen = np.asarray(Image.open(folder / row.image), np.float64)
        differences = [np.abs(seen - np.asarray(files.scene(p), np.float64)).mean() for p in range(8)]
        assert int(np.argmin(differences)) == frame // files.PER_FIX // 2
    assert obtain(loaded, "st_lucia", "100909_0845")[1].startswith(
        "st_lucia/100909_0845: 15 images, prepared, verified"
    )


@pytest.mark.parametrize("more", [1, -1])
def test_st_lucia_passes_over_a_line_or_frame_too_many_and_says_so(tmp_path, more):
    """Nothing is shifted: the frames before are paired as ever."""
    loaded = project(tmp_path, "st_lucia")
    lines = files.gps_lines()
    lines = [*lines, "27.4,153.012345"] if more > 0 else lines[:-1]
    put(loaded, "st_lucia", {"100909_0845.zip": files.st_lucia_zip("100909_0845", lines)})
    (*_, line) = obtain(loaded, "st_lucia", "100909_0845")
    assert f"lines: {len(lines)}, frames: 90, frames in the header: 90" in line
    table, _ = index_of(loaded, "st_lucia", "100909_0845")
    assert list(table["original"]) == [f"frame {i}" for i in range(0, files.FILM, files.PER_FIX)]


# -- bad files: each a clear error, and nothing that looks complete ----------------------------------------------------

ONE = "100909_0845"


def robotcar_with(changes, without=()):
    contents = {k: v for k, v in made("robotcar").items() if files.QUERY in k or k == "rtk.zip"}
    return {k: v for k, v in (contents | changes).items() if k not in without}


def chunk(number):
    return f"{files.QUERY}_stereo_centre_{number:02}.tar"


def raw(size=files.SIZE, mode="L"):
    return {
        f"{files.QUERY}/stereo/centre/{t}.png": files.encoded(Image.new(mode, size), "PNG")
        for t in files.times(files.QUERY)[:60]
    }


def changed(rows, number, text):
    return [*rows[:number], text, *rows[number + 1 :]]


def late(rows, seconds):
    return [rows[0], *(f"{int(row[:16]) + seconds * 1_000_000}{row[16:]}" for row in rows[1:])]


def amster(images):
    return {"AmsterTime.zip": files.zipped({"AmsterTime-v1.0.zip": files.zipped(images)})}


def summer(names):
    frame = files.encoded(files.scene(1), "PNG")
    return made("nordland") | {"summer.tar.gz": files.tarred(dict.fromkeys(names, frame), "w:gz")}


def listed_as(names):
    return made("nordland") | {"nordland_imageNames.txt": "\n".join(names).encode()}


PAGE = b"<!DOCTYPE html><html><title>Sign in</title></html>"
RTK, INS = files.rtk(files.QUERY), files.ins(files.QUERY)
BAD = {
    "a page, not an archive": ("svox", lambda: {"svox.zip": PAGE}, "is a web page, not an archive"),
    "a zip cut short": ("svox", lambda: {"svox.zip": made("svox")["svox.zip"][:-200]}, "damaged or cut short"),
    "a zip with a damaged member": (
        "svox",
        lambda: {"svox.zip": damaged(made("svox")["svox.zip"])},
        "damaged or cut short .*CRC",
    ),
    "no archive at all": ("svox", lambda: {"svox.zip": b"text " * 400}, "damaged or cut short"),
    "a zip that leads out": (
        "svox",
        lambda: {"svox.zip": files.zipped({"../evil.jpg": b""})},
        r"holds '\.\./evil\.jpg', which leads out",
    ),
    "an absolute name": (
        "svox",
        lambda: {"svox.zip": files.zipped({"/etc/x.jpg": b""})},
        r"holds '/etc/x\.jpg', which leads out",
    ),
    "a link in a zip": ("svox", lambda: {"svox.zip": linked()}, "holds the link 'images/test/gallery'"),
    "a bomb": ("svox", lambda: {"svox.zip": bomb()}, "unpacks to more than 67.1 MB"),
    "another split only": (
        "svox",
        lambda: {"svox.zip": files.zipped({"svox/images/val/gallery/@1@2@.jpg": b""})},
        "it holds val/gallery",
    ),
    "a position that is none": (
        "svox",
        lambda: {
            "svox.zip": files.zipped(
                {"images/test/gallery/@east@2@.jpg": b"", "images/test/queries_overcast/@x@1@.jpg": b""}
            )
        },
        "the name should begin with @easting@northing@",
    ),
    "an image that is none": (
        "svox",
        lambda: {
            "svox.zip": files.zipped(
                {"images/test/gallery/@1@2@.jpg": b"x", "images/test/queries_overcast/@1@2@.jpg": b""}
            )
        },
        "an image of the published files cannot be used",
    ),
    "a missing image": (
        "gardens_point",
        lambda: {
            "GardensPoint_Walking.zip": files.zipped(
                {k: v for k, v in files.gardens_point_images().items() if "005" not in k}
            )
        },
        r"numbered without gaps; 11 are there, missing: \[5\]",
    ),
    "pairs without a partner": (
        "amstertime",
        lambda: amster({k: v for k, v in files.amstertime_images().items() if k != "old/0040.jpg"}),
        "1 numbers are in one only, first 0040",
    ),
    "AmsterTime of the downloader": (
        "amstertime",
        lambda: amster({"images/test/queries/@0@1000@@@@@0001@@@@@@@@.jpg": b""}),
        "the paper's queries are the new ones",
    ),
    "a list that is another": (
        "nordland",
        lambda: listed_as(files.LISTED[:-1]),
        "its 9 names are not those of the list of 27,592",
    ),
    "a list of 3,450": (
        "nordland",
        lambda: listed_as(f"{i}.png" for i in range(3450)),
        "3,450 images are the test split",
    ),
    "an archive without a listed frame": (
        "nordland",
        lambda: summer(files.LISTED[:-1]),
        "1 of the 10 frames of the list are not in it, first images-35582.png",
    ),
    "renumbered frames": (
        "nordland",
        lambda: summer(f"images-{i:05}.png" for i in range(1, 11)),
        "its frames were renumbered",
    ),
    "Nordland of the downloader": (
        "nordland",
        lambda: summer(["images/test/queries/@0@00001.1@@@@@1@@@@@@@@.jpg"]),
        "in which winter is the query",
    ),
    "the partition of 28,865": (
        "nordland",
        lambda: summer(["data/train-00000-of-00400.parquet"]),
        "the partition of Olid et al.",
    ),
    "swapped seasons": (
        "nordland",
        lambda: summer(f"winter/{name}" for name in files.LISTED),
        "holds frames of winter, not of Summer",
    ),
    "a season cut short": (
        "nordland",
        lambda: made("nordland") | {"summer.tar.gz": made("nordland")["summer.tar.gz"][:-3000]},
        "summer.tar.gz: damaged or cut short",
    ),
    "a link in a tar": (
        "nordland",
        lambda: made("nordland") | {"summer.tar.gz": files.tarred({}, "w:gz", [("images-00202.png", "/etc/passwd")])},
        "holds the link 'images-00202.png' to '/etc/passwd'",
    ),
    "a missing chunk": (
        "robotcar",
        lambda: robotcar_with({}, [chunk(2)]),
        f"1 of 4 published files are not in .*: {chunk(2)}",
    ),
    "a chunk cut short": (
        "robotcar",
        lambda: robotcar_with({chunk(2): made("robotcar")[chunk(2)][:-30000]}),
        "damaged or cut short",
    ),
    "a chunk that lacks frames": (
        "robotcar",
        lambda: robotcar_with({chunk(2): files.tarred(lacking(files.times(files.QUERY)[60:80]))}),
        f"{chunk(2)}: 40 of its 60 frames are absent",
    ),
    "frames in two chunks": (
        "robotcar",
        lambda: robotcar_with({chunk(2): made("robotcar")[chunk(1)]}),
        f"the frame {files.BEGIN[files.QUERY]} is in {chunk(1)} too",
    ),
    "another traversal": (
        "robotcar",
        lambda: robotcar_with({chunk(2): made("robotcar")[f"{files.RAIN}_stereo_centre_02.tar"]}),
        f"is of the traversal {files.RAIN}",
    ),
    "unsorted times of frames": (
        "robotcar",
        lambda: robotcar_with(
            {
                chunk(2): files.tarred(
                    lacking(files.times(files.QUERY)[60:], files.stamps(files.QUERY).splitlines()[::-1])
                )
            }
        ),
        r"stereo.timestamps:2: the time \d+ is before the one above",
    ),
    "stereo/left": (
        "robotcar",
        lambda: robotcar_with(
            {chunk(1): files.tarred({f"{files.QUERY}/stereo/left/{files.BEGIN[files.QUERY]}.png": b""})}
        ),
        "images of stereo/left or stereo/right",
    ),
    "RobotCar Seasons": (
        "robotcar",
        lambda: robotcar_with({chunk(1): files.tarred({"overcast-reference/rear/1417176458999821.jpg": b""})}),
        "RobotCar Seasons",
    ),
    "the radar dataset": (
        "robotcar",
        lambda: robotcar_with({chunk(1): files.tarred({"x/stereo/1547131046353776000.png": b""})}),
        "the radar dataset of 2019",
    ),
    "mosaics of another size": (
        "robotcar",
        lambda: robotcar_with({chunk(1): files.tarred(raw((66, 48)))}),
        "66 × 48 pixels of mode L",
    ),
    "images in colour": (
        "robotcar",
        lambda: robotcar_with({chunk(1): files.tarred(raw(mode="RGB"))}),
        "64 × 48 pixels of mode RGB",
    ),
    "poses of another day": (
        "robotcar",
        lambda: robotcar_with(files.rtk_zip(**{files.QUERY: late(RTK, 86_400)})),
        r"only 0 of 120 frames have a position: the poses \(rtk\) cover",
    ),
    "poses that cover a third": (
        "robotcar",
        lambda: robotcar_with(files.rtk_zip(**{files.QUERY: RTK[:30]})),
        r"only \d\d of 120 frames have a position",
    ),
    "unsorted poses": (
        "robotcar",
        lambda: robotcar_with(files.rtk_zip(**{files.QUERY: [*RTK[:5], RTK[6], RTK[5], *RTK[7:]]})),
        "rtk.csv:7: the time",
    ),
    "doubled poses": (
        "robotcar",
        lambda: robotcar_with(files.rtk_zip(**{files.QUERY: [*RTK[:5], *RTK[4:]]})),
        r"rtk.csv:6: the time \d+ is there twice",
    ),
    "poses without numbers": (
        "robotcar",
        lambda: robotcar_with(files.rtk_zip(**{files.QUERY: changed(RTK, 3, RTK[3].replace("619", "east"))})),
        "rtk.csv:4: .* easting and northing must be numbers",
    ),
    "no GPS text": (
        "st_lucia",
        lambda: {f"{ONE}.zip": files.zipped({f"{ONE}/webcam_video.avi": files.film(12)})},
        "holds no fGPS.txt",
    ),
    "StLucia_small": (
        "st_lucia",
        lambda: {f"{ONE}.zip": files.zipped({f"{ONE}/Image001.jpg": b"", "GT.npz": b""})},
        "StLucia_small, frames without GPS",
    ),
    "St Lucia at 5 m": (
        "st_lucia",
        lambda: {
            f"{ONE}.zip": files.zipped({"@0503123.45@6957123.45@56@J@-27.5@153.0@100909_0845_1@@@@@@@@.jpg": b""})
        },
        "thinned to 5 m",
    ),
    "another St Lucia": (
        "st_lucia",
        lambda: {f"{ONE}.zip": files.st_lucia_zip("180809_1545")},
        "holds the traversal 180809_1545, not 100909_0845",
    ),
    "more lines than frames": (
        "st_lucia",
        lambda: {f"{ONE}.zip": files.st_lucia_zip(ONE, files.gps_lines(99))},
        r"9 lines of fGPS.txt have no frame \(90 frames, 99 lines\)",
    ),
    "frames without lines": (
        "st_lucia",
        lambda: {f"{ONE}.zip": files.st_lucia_zip(ONE, files.gps_lines(80))},
        "10 frames have no line in fGPS.txt",
    ),
    "coordinates that are no numbers": (
        "st_lucia",
        lambda: {f"{ONE}.zip": files.st_lucia_zip(ONE, changed(files.gps_lines(), 4, "27.5,east"))},
        "fGPS.txt:5: found '27.5,east'",
    ),
    "an empty line": (
        "st_lucia",
        lambda: {f"{ONE}.zip": files.st_lucia_zip(ONE, changed(files.gps_lines(), 4, ""))},
        "fGPS.txt:5: found ''",
    ),
    "another town": (
        "st_lucia",
        lambda: {f"{ONE}.zip": files.st_lucia_zip(ONE, ["51.75,-1.26"])},
        "fGPS.txt:1: .* is not in Brisbane",
    ),
    "a film that is none": (
        "st_lucia",
        lambda: {f"{ONE}.zip": files.st_lucia_zip(ONE, video=b"RIFF" * 50)},
        "webcam_video.avi: cannot be decoded",
    ),
    "a film cut short": (
        "st_lucia",
        lambda: {f"{ONE}.zip": files.st_lucia_zip(ONE, video=files.film()[:60_000])},
        "webcam_video.avi: ",
    ),
}
FIRST = {"robotcar": [files.QUERY], "st_lucia": [ONE], "nordland": ["Summer"], "svox": ["queries_overcast"]}


def damaged(content):
    at = content.index(b"\xff\xd8", content.index(b"test/queries_overcast")) + 300
    return content[:at] + bytes([content[at] ^ 255]) + content[at + 1 :]


def linked():
    stream, info = io.BytesIO(), zipfile.ZipInfo("images/test/gallery")
    info.external_attr = 0o120777 << 16
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr(info, "/etc")
    return stream.getvalue()


def bomb():
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("images/test/gallery/@1@2@.jpg", bytes(70_000_000))
    return stream.getvalue()


def lacking(times, lines=None):
    """A second chunk with the frames of these times alone."""
    every = files.centre(files.QUERY)
    images = {name: every[name] for t in times for name in [f"{files.QUERY}/stereo/centre/{t}.png"]}
    stamps = files.stamps(files.QUERY) if lines is None else b"\n".join(lines)
    return images | {f"{files.QUERY}/stereo.timestamps": stamps}


@pytest.mark.parametrize("name", BAD)
def test_bad_files_are_one_clear_error_and_nothing_is_lost(tmp_path, name):
    dataset, make, message = BAD[name]
    loaded = project(tmp_path, dataset)
    folder = put(loaded, dataset, contents := make())
    text = fault(loaded, dataset, *FIRST.get(dataset, []))
    assert re.search(message, text), text
    assert {
        path.name: path.read_bytes() for path in folder.iterdir() if path.stat().st_size and "lock" not in path.name
    } == contents
    assert not list(folder.glob("*.lock.json"))  # what could not be used is not what later files are held to
    if dataset in ("robotcar", "st_lucia", "nordland", "svox"):  # the right files afterwards are taken at once
        put(loaded, dataset, made(dataset))
        obtain(loaded, dataset, *FIRST[dataset])
        assert not list(tmp_path.rglob("*.preparing*"))
