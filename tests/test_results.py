"""Results bundles: a book from stored results alone, and nothing that a hostile file could do."""

import getpass
import io
import json
import os
import re
import shutil
import socket
import stat
import zipfile
from pathlib import Path

import nbformat
import numpy as np
import pytest
from conftest import DRIVE, artifact, copy_book, tiny_manifest, write_drive, write_manifest

from artifact import datasets, manifest, store
from artifact.commands import results
from artifact.datasets import imported
from artifact.extraction import extract

PAGES = {"tab03", "tab05", "within_session", "in_one_screen", "fig01"}
NEED_MORE = {"in_one_screen": "the values of its descriptors at hand", "fig01": "its images at hand"}


def lay_out(project):
    copy_book(project, PAGES)
    content = tiny_manifest(drive=DRIVE)
    content["profiles"]["demo"]["parameters"] = {"within_session": {"statistics": ["brightness"], "iterations": 3}}
    write_manifest(project, content)


@pytest.fixture(scope="module")
def origin(tmp_path_factory):
    """A project whose pages have run on images, and the bundle of its results."""
    project = tmp_path_factory.mktemp("origin")
    lay_out(project)
    write_drive(project, 40)
    status, output = artifact(project, "run", "--jobs", "2")
    assert status == 0, output
    status, output = artifact(project, "results", "export", "drive.zip", "--profile", "demo")
    assert status == 0, output
    assert re.match(r"drive.zip: \d+ results of 5 pages, at most [\d.]+ [kM]B; no images, no descriptors\n", output)
    return project


@pytest.fixture(scope="module")
def clone(origin, tmp_path_factory):
    """An empty clone that has imported the bundle and run the pages."""
    project = tmp_path_factory.mktemp("clone")
    lay_out(project)
    shutil.copy(origin / "drive.zip", project)
    status, output = artifact(project, "results", "import", "drive.zip")
    assert status == 0, output
    assert "make reproduce PROFILE=demo" in output
    status, output = artifact(project, "run", "--jobs", "2")
    assert status == 0, output
    return project


@pytest.fixture
def empty(tmp_path):
    """An empty clone, as its manifest."""
    return manifest.load(write_manifest(tmp_path, json.loads(json.dumps(tiny_manifest(drive=DRIVE)))))


def shown(project, page):
    """All outputs of an executed page, without the time of the run."""
    notebook = nbformat.read(project / "book" / "executed" / f"{page}.ipynb", as_version=4)
    outputs = [dict(output.get("data", {})) for cell in notebook.cells for output in cell.get("outputs", [])]
    return re.sub(r"Run: [^<]*", "", json.dumps(outputs, sort_keys=True))


def test_the_pages_are_those_of_the_images(origin, clone):
    for page in sorted(PAGES - NEED_MORE.keys()):
        assert shown(clone, page) == shown(origin, page), page
    for page, need in NEED_MORE.items():
        assert need in (clone / "book" / "executed" / f"{page}.ipynb").read_text()
        assert need not in (origin / "book" / "executed" / f"{page}.ipynb").read_text()


def test_every_page_is_marked_with_the_date_of_the_bundle(origin, clone):
    date = json.loads(zipfile.ZipFile(origin / "drive.zip").read("bundle.json"))["date"]
    assert (clone / "book" / "executed" / "notice.txt").read_text() == f"From the results bundle of {date}."
    assert not (origin / "book" / "executed" / "notice.txt").exists()
    status, output = artifact(clone, "status")
    assert status == 0
    assert f"bundle    results of {date}, profile demo" in output


def test_a_bundle_has_all_that_was_read_and_nothing_that_tells_of_a_machine(origin, clone):
    with zipfile.ZipFile(origin / "drive.zip") as archive:
        names = archive.namelist()
        texts = [archive.read(name) for name in names]
    rankings = {path.name for path in (origin / ".cache" / "rankings").iterdir() if path.suffix in (".npz", ".json")}
    read = {Path(name).name for name in names if name.startswith("rankings/")}
    assert read < rankings  # what transforms were fitted to make the results is not read by a page
    assert {path.name for path in (clone / ".cache" / "rankings").glob("*.npz")} == {n for n in read if ".npz" in n}
    whole = b"\n".join(texts)
    for secret in (str(Path.home()), str(origin), socket.gethostname(), getpass.getuser()):
        assert len(secret) < 4 or secret.encode() not in whole, secret
    kinds = {name.partition("/")[0] for name in names}
    assert kinds == {"bundle.json", "rankings", "appearance", "traversals"}


def test_equal_results_give_equal_bundles_but_for_the_date(origin, tmp_path):
    status, output = artifact(origin, "results", "export", str(tmp_path / "again.zip"), "--profile", "demo")
    assert status == 0, output
    contents = []
    for path in (tmp_path / "again.zip", origin / "drive.zip"):
        with zipfile.ZipFile(path) as archive:
            found = {info.filename: (archive.read(info), info.date_time) for info in archive.infolist()}
        bundle = json.loads(found.pop("bundle.json")[0])
        contents.append((found, bundle | {"date": ""}))
    assert contents[0] == contents[1]


def test_an_imported_bundle_can_be_passed_on(origin, clone, tmp_path):
    status, output = artifact(clone, "results", "export", str(tmp_path / "again.zip"), "--profile", "demo")
    assert status == 0, output
    with zipfile.ZipFile(tmp_path / "again.zip") as again, zipfile.ZipFile(origin / "drive.zip") as first:
        assert set(again.namelist()) < set(first.namelist())  # two of its pages had nothing to show
        same = [n for n in again.namelist() if n.startswith(("rankings", "traversals"))]
        assert all(again.read(name) == first.read(name) for name in same)


def test_pages_that_have_not_run_are_not_exported(empty):
    (empty.path.parent / "notebooks").mkdir()
    page = (Path(__file__).parents[1] / "notebooks" / "tab03.py").read_text()
    (empty.path.parent / "notebooks" / "tab03.py").write_text(page)
    write_drive(empty.path.parent, 6)
    with pytest.raises(Exception, match="1 of 1 notebooks have not run .*, first tab03: run `make reproduce` first"):
        list(results.export(empty, "demo", empty.path.parent / "out.zip"))
    assert not (empty.path.parent / "out.zip").exists()


# -- what is recorded, and what is not -----------------------------------------------------------------------------


def test_what_is_not_in_the_bundle_is_one_line(clone):
    loaded = manifest.load(clone / "data_manifest.yaml")
    day = datasets.load_traversal(loaded, "drive", "day")
    assert len(day) == 40
    assert not day.has_images
    found = extract.descriptors(loaded, day, "hog")
    assert found.source == "images"
    with pytest.raises(store.StoreError, match="hog · drive/day: descriptors are not in the imported results bundle"):
        _ = found.values
    assert not extract.is_at_hand(loaded, day, "hog")
    status, output = artifact(clone, "extract")
    assert status == 1
    assert "Traceback" not in output
    assert "to make them here, delete" in output
    status, output = artifact(clone, "verify")
    assert status == 0, output


def test_images_at_hand_are_used_with_the_records_if_they_are_the_same(origin, clone, tmp_path):
    project = tmp_path / "both"
    shutil.copytree(clone, project, ignore=shutil.ignore_patterns("book", "notebooks"))
    shutil.copytree(origin / "data", project / "data")
    loaded = manifest.load(project / "data_manifest.yaml")
    day = datasets.load_traversal(loaded, "drive", "day")
    assert day.has_images
    assert not extract.is_at_hand(loaded, day, "hog")
    (project / "data" / "drive" / "day" / "frame3.png").write_bytes(
        (project / "data" / "drive" / "day" / "frame4.png").read_bytes()
    )
    changed = datasets.load_traversal(loaded, "drive", "day")
    assert changed.descriptors == {}
    assert len(extract.descriptors(loaded, changed, "hog", workers=0).values) == 40


def test_a_part_is_recomputed_from_images_and_compared(origin, clone, tmp_path):
    status, output = artifact(clone, "verify", "--recompute", "drive x hog")
    assert status == 1
    assert "the images are not on this machine" in output or "no folder" in output
    root = {"ARTIFACT_DATA_ROOT": str(origin / "data")}
    status, output = artifact(clone, "verify", "--recompute", "drive × hog", **root)
    assert status == 0, output
    assert len(re.findall(r"^EQUAL +descriptors of drive/", output, re.MULTILINE)) == 4
    assert re.search(r"^EQUAL +recall_table hog drive: R@1 [\d.]+ %; DAR@1 [\d.]+ %$", output, re.MULTILINE)
    assert re.search(r"^EQUAL +within_session hog drive: original R@1", output, re.MULTILINE)
    assert not (clone / ".cache" / "descriptors").exists()
    status, output = artifact(clone, "verify", "--recompute", "drive by hog", **root)
    assert status == 1
    assert "is not 'DATASET x METHOD' of profile 'demo': its datasets are drive, its methods thumbnail, hog" in output


def test_a_result_that_differs_is_told(origin, tmp_path):
    """One query of Table III is given another rank, with a digest that fits."""
    project = tmp_path / "changed"
    shutil.copytree(origin, project, ignore=shutil.ignore_patterns("book"))
    for path in (project / ".cache" / "rankings").glob("*.json"):
        record = store.read_json(path)
        if (record.get("stage"), record.get("method")) == ("ranking", "hog"):
            with np.load(path.with_suffix(".npz")) as found:
                arrays = dict(found)
            name = "evaluation:evaluation:database/0/outranking"
            arrays[name] = np.where(arrays[name] == 0, 1, arrays[name])
            store.save_arrays(path.with_suffix(".npz"), arrays, record)
    status, output = artifact(project, "verify", "--recompute", "drive x hog")
    assert status == 1, output
    assert re.search(r"^DIFFERS +recall_table hog drive: R@1 0.00 %, now [\d.]+ %", output, re.MULTILINE)
    assert re.search(r"^EQUAL +within_session hog drive", output, re.MULTILINE)


# -- hostile bundles ------------------------------------------------------------------------------------------------


class Forged:
    """The files of a bundle, to be changed one by one; the list of files is made to fit unless a test changes that."""

    def __init__(self, source):
        with zipfile.ZipFile(source) as archive:
            self.files = {name: archive.read(name) for name in archive.namelist()}
        self.bundle = json.loads(self.files.pop("bundle.json"))
        self.infos = []

    def first(self, start, end=".npz"):
        return next(name for name in sorted(self.files) if name.startswith(start) and name.endswith(end))

    def listed(self):
        import hashlib

        sizes = {n: {"size": len(d), "sha256": hashlib.sha256(d).hexdigest()} for n, d in self.files.items()}
        self.bundle["files"] = sizes
        return self

    def result(self, data):
        """Replace a result by other bytes, its record fitting."""
        import hashlib

        name = self.first("rankings/")
        self.files[name] = data
        record = json.loads(self.files[name.replace(".npz", ".json")])
        record["sha256"] = hashlib.sha256(data).hexdigest()
        self.files[name.replace(".npz", ".json")] = json.dumps(record).encode()

    def edit(self, name, change):
        content = json.loads(self.files[name])
        change(content)
        self.files[name] = json.dumps(content).encode()

    def write(self, path):
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("bundle.json", json.dumps(self.bundle))
            for name, data in self.files.items():
                archive.writestr(name, data)
            for info, data in self.infos:
                archive.writestr(info, data)
        return path


def npz(**arrays):
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return stream.getvalue()


def with_header(shape, dtype="<f8", data=b""):
    """A result whose one array claims a shape."""
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": dtype, "fortran_order": False, "shape": shape})
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr("array:x.npy", header.getvalue() + data)
    return stream.getvalue()


def compressed():
    stream = io.BytesIO()
    np.savez_compressed(stream, **{"array:x": np.zeros(10**6)})
    return stream.getvalue()


class Evil:
    def __reduce__(self):
        return os.mkdir, ("pwned",)


def linked(forged):
    info = zipfile.ZipInfo("rankings/" + "0" * 24 + ".npz")
    info.external_attr = (stat.S_IFLNK | 0o777) << 16
    forged.infos.append((info, "/etc/passwd"))


def added(name, data=b"x"):
    def change(forged):
        forged.files[name] = data
        forged.listed()

    return change


def of_result(data):
    def change(forged):
        forged.result(data)
        forged.listed()

    return change


def of_traversal(edit):
    def change(forged):
        forged.edit("traversals/drive/day.json", edit)
        forged.listed()

    return change


def of_contents(**values):
    return lambda forged: forged.bundle.update(values)


def damaged(forged):
    name = forged.first("rankings/")
    forged.files[name] = forged.files[name][:-1] + b"?"


def bomb(forged):
    forged.files["rankings/" + "0" * 24 + ".json"] = b" " * (65 * 2**20)


def revised(forged):
    forged.bundle["revisions"]["ranking"] = 99


HOSTILE = {
    "a path out of the cache": (added("../evil.npz"), "holds a file '../evil.npz', which no results bundle has"),
    "an absolute path": (added("/tmp/evil.npz"), "holds a file '/tmp/evil.npz'"),
    "a path within": (added("rankings/../../x.json"), "which no results bundle has"),
    "another file": (added("notebooks/x.ipynb"), "which no results bundle has"),
    "a hidden traversal": (added("traversals/.git/config.json"), "which no results bundle has"),
    "a link": (linked, "is a link or encrypted; allowed: plain files"),
    "a file not listed": (lambda forged: forged.files.update({"timings.json": b"{}"}), "'timings.json' is listed or"),
    "a listed file not there": (lambda forged: forged.files.pop(forged.first("rankings/")), "is listed or there"),
    "a changed byte": (damaged, "differs from its digest; the bundle is damaged"),
    "a bomb": (bomb, "takes 68.2 MB; no result is as large"),
    "objects": (of_result(npz(**{"array:x": np.array([Evil()], object)})), "holds values of type object"),
    "an array of terabytes": (of_result(with_header((2**40,))), "has another size than its header says"),
    "a compressed array": (of_result(compressed()), "is compressed"),
    "no arrays": (of_result(b"not a zip file"), "holds no result"),
    "an unfinished evaluation": (of_result(npz(**{"evaluation:x:evaluated": np.arange(3)})), "holds no result"),
    "another format": (of_contents(format=2), "is of format 2; this code reads format 1"),
    "another revision": (revised, "was made with ranking 99, here is"),
    "a path as profile": (of_contents(profile="../x"), "profile: String should match pattern"),
    "an unknown profile": (of_contents(profile="paper"), "no profile 'paper'"),
    "an unknown key": (of_contents(home="/home/x"), "home: Extra inputs are not permitted"),
    "another dataset": (of_contents(datasets=["drive", "x"]), "profile demo has other datasets here: x"),
    "another method": (of_contents(weights={"hog": []}), "profile demo has other methods here: thumbnail"),
    "a condition of another manifest": (
        of_traversal(lambda record: record.update(condition="<script>")),
        "is folder, <script>; the manifest says folder, day",
    ),
    "positions that are no numbers": (of_traversal(lambda r: r["positions"].append([float("nan"), 0])), "positions"),
    "too few positions": (of_traversal(lambda record: record["positions"].pop()), "has 40 images and positions 39"),
    "descriptors of other images": (
        of_traversal(lambda record: record["descriptors"]["hog"].update(key="0" * 64)),
        "descriptors of hog have another key than this manifest, its weights and this code give",
    ),
    "other images": (of_traversal(lambda record: record.update(digest="0" * 64)), "have another key"),
    "fewer descriptors than images": (
        of_traversal(lambda record: record["descriptors"]["hog"]["sidecar"].update(shape=[39, 108])),
        "descriptors of hog are of 39 images, not 40",
    ),
}


@pytest.mark.parametrize("what", HOSTILE)
def test_a_hostile_bundle_is_refused_in_one_line_and_leaves_nothing(origin, empty, monkeypatch, what):
    change, message = HOSTILE[what]
    monkeypatch.chdir(empty.path.parent)
    forged = Forged(origin / "drive.zip")
    change(forged)
    path = forged.write(empty.path.parent / "forged.zip")
    with pytest.raises((store.StoreError, ValueError)) as caught:
        list(results.read(empty, path))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
    left = sorted(p.relative_to(empty.path.parent).as_posix() for p in empty.path.parent.rglob("*"))
    assert [name for name in left if name not in (".cache", ".cache/imported")] == ["data_manifest.yaml", "forged.zip"]
    assert list(imported.bundles(empty)) == []


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_two_files_of_one_name_are_refused(origin, empty):
    forged = Forged(origin / "drive.zip")
    name = forged.first("rankings/")
    forged.infos.append((zipfile.ZipInfo(name), forged.files[name]))
    with pytest.raises(store.StoreError, match="holds two files of one name"):
        list(results.read(empty, forged.write(empty.path.parent / "forged.zip")))


@pytest.mark.parametrize(
    ("content", "message"),
    [(b"", "is no results bundle"), (b"PK\x03\x04 and so on", "is no results bundle"), (None, "cannot be read")],
)
def test_what_is_no_bundle_is_told(empty, content, message):
    path = empty.path.parent / "x.zip"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(store.StoreError, match=f"x.zip: {message}"):
        list(results.read(empty, path))


def test_a_bundle_that_is_cut_off_anywhere_is_refused(origin, empty):
    whole = (origin / "drive.zip").read_bytes()
    path = empty.path.parent / "cut.zip"
    for size in np.linspace(0, len(whole) - 1, 12).astype(int):
        path.write_bytes(whole[:size])
        with pytest.raises(store.StoreError):
            list(results.read(empty, path))


def test_results_that_are_there_already_stay(origin, empty):
    path = Forged(origin / "drive.zip").listed().write(empty.path.parent / "same.zip")
    with zipfile.ZipFile(path) as archive:
        name = next(name for name in archive.namelist() if name.startswith("rankings/") and name.endswith(".npz"))
    ours = empty.cache / name
    store.save_arrays(ours, {"array:x": np.arange(3)}, {"key": "mine"})
    before = ours.read_bytes()
    lines = list(results.read(empty, path))
    assert ours.read_bytes() == before
    n = len(list((empty.cache / "rankings").glob("*.npz"))) + len(list((empty.cache / "appearance").glob("*.npz")))
    assert lines[-1].startswith(f"imported: {n - 1} results are new")
    assert list(results.read(empty, path))[-1].startswith("imported: 0 results are new")
    assert [bundle.profile for bundle in imported.bundles(empty)] == ["demo"]
