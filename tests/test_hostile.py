"""What others wrote cannot run here or break a page: names, manifests, arrays, downloads, links in the cache."""

import json
import os
import platform
import re
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from conftest import DRIVE, HOG, artifact, copy_book, tiny_manifest, write_drive, write_images, write_manifest
from released import running

from artifact import datasets, manifest, store
from artifact.commands import arguments, cli
from artifact.datasets import download
from artifact.datasets.download import DownloadError
from artifact.extraction import extract
from artifact.extraction.parts import Parts
from artifact.manifest.entries import ManifestError
from artifact.pages.catalogue import how_to_get

# -- names that would run scripts, and the pages that show them -----------------------------------------------------

SCRIPT = "<img src=x onerror=alert(1)><script>alert(2)</script>"
TITLE = f'{SCRIPT} "onmouseover="alert(3) **bold** $x_{{1$ and $y$ [link](javascript:alert(4)) `code` {{{{ 7 * 7 }}}}'
FENCE = f"```\n\n{SCRIPT}\n\n:::{{note}}\n{TITLE}\n:::\n\n[l](javascript:alert(5))"
FOLDER = "<img src=x onerror=alert(6)> $z$"
USER, HOST = "tell-tale-user", "tell-tale-host"
PAGES = ["fig01", "fig06", "fig07", "tab01", "tab02", "tab03", "methods", "preview"]


@pytest.fixture(scope="module")
def book(tmp_path_factory):
    """The built book of a manifest whose every text is hostile, and of a folder with such a name."""
    project = tmp_path_factory.mktemp("hostile")
    copy_book(project)
    write_drive(project, 30)
    for part, brightness in (("queries", 0), ("database", -50)):
        write_images(project / FOLDER / part, 12, seed=9, brightness=brightness, noise=20)
    traversals = {name: {"condition": f"{name} {TITLE}"} for name in DRIVE["traversals"]}
    texts = {"title": TITLE, "shift": TITLE, "licence": TITLE, "obtain": FENCE, "mirrors": TITLE}
    content = tiny_manifest(drive=DRIVE | texts | {"traversals": traversals})
    content["profiles"]["demo"] |= {"datasets": ["drive"], "description": TITLE}
    for method in content["methods"].values():
        method |= {"title": TITLE, "backbone": TITLE, "aggregation": TITLE, "train_data": TITLE, "licence": TITLE}
    weights = {"folder": "w", "files": [{"file": "a.pth"}], "licence": TITLE, "terms": FENCE, "obtain": FENCE}
    content["methods"]["salad"] = HOG | {"title": TITLE, "kind": "paper", "weights": weights}
    write_manifest(project, content)
    chapters = [{"file": f"executed/{page}"} for page in (*PAGES[1:], "fig04", "status")] + [{"file": "references"}]
    toc = {"format": "jb-book", "root": f"executed/{PAGES[0]}", "parts": [{"chapters": chapters}]}
    (project / "book" / "_toc.yml").write_text(yaml.safe_dump(toc))
    asked = f'datasets=["drive",{json.dumps(FOLDER)}]'
    asked = ["--only", *PAGES, "fig04", "--set", asked]
    status, output = artifact(project, "reproduce", *asked, "--jobs", "2", USER=USER, LOGNAME=USER, HOSTNAME=HOST)
    assert status == 0, output
    return project


def outputs_of(project):
    for page in PAGES:
        notebook = json.loads((project / "book" / "executed" / f"{page}.ipynb").read_text())
        for cell in notebook["cells"]:
            for output in cell.get("outputs", []):
                for kind, text in output.get("data", {}).items():
                    yield page, kind, "".join(text)


@pytest.mark.slow
def test_names_and_titles_are_shown_as_they_are(book):
    shown = {}
    for page, kind, text in outputs_of(book):
        assert not re.search(r"<img src=x|<script|&amp;lt;", text) or kind == "text/plain", page
        shown[page] = shown.get(page, "") + text
    for page in PAGES:
        assert "&lt;img src=x" in shown[page], page


@pytest.mark.slow
@pytest.mark.browser
def test_no_page_runs_a_script_or_typesets_a_name(book, browser):
    html = book / "book" / "_build" / "html" / "executed"
    for name in [*PAGES, "status"]:
        page, ran = browser.new_page(), []
        page.on("dialog", lambda dialog, ran=ran: (ran.append(dialog.message), dialog.dismiss()))
        page.on("requestfailed", lambda request, ran=ran: ran.append(request.url))
        page.on("pageerror", lambda error, ran=ran: ran.append(str(error)))
        page.goto((html / f"{name}.html").as_uri())
        page.wait_for_load_state("load")
        page.evaluate("window.MathJax?.startup?.promise")
        page.wait_for_timeout(150)
        page.evaluate("document.querySelectorAll('main *').forEach(e => e.dispatchEvent(new MouseEvent('mouseover')))")
        page.wait_for_timeout(20)
        assert ran == [], name
        for selector in ("a[href^='javascript:' i]", "[onerror], [onmouseover], [onclick]", "img[src='x']"):
            assert page.locator(".bd-article").locator(selector).count() == 0, (name, selector)
        assert page.locator(".cell_output mjx-container").count() == 0, name
        assert name == "status" or "<img src=x onerror=alert(" in page.locator("main").inner_text(), name
        page.close()


@pytest.mark.slow
def test_pages_tell_nothing_of_the_machine(book):
    """No path, no name of user or host, in what a book is made of and in what it is built to."""
    secrets = {str(book), sys.prefix, f"{Path.home()}/", USER, HOST}
    secrets |= {name for name in (platform.node(),) if not name.isalpha()}  # a word may stand on a page
    built = [*(book / "book" / "executed").rglob("*"), *(book / "book" / "_build" / "html").rglob("*")]
    for path in (path for path in built if path.suffix in (".ipynb", ".md", ".html", ".txt", ".js", ".json", ".csv")):
        if "_static" not in path.parts:
            text = path.read_text(encoding="utf-8", errors="replace")
            assert not [s for s in secrets if len(s) > 3 and re.search(rf"(?<!\w){re.escape(s)}", text)], path


def test_how_to_get_weights_is_text():
    import pandas as pd

    shown = how_to_get(pd.DataFrame({"how": ["", FENCE]}))
    assert "<script>" not in shown.data
    assert "&lt;script&gt;" in shown.data
    assert "All weights are here" in how_to_get(pd.DataFrame({"how": [""]})).data


# -- manifests ------------------------------------------------------------------------------------------------------


@pytest.fixture
def others(project, monkeypatch):
    """A manifest from elsewhere that names a builder, and one of our own in the working folder."""
    elsewhere = project / "elsewhere"
    write_images(elsewhere / "data" / "street" / "day", 4, seed=1)
    write_images(elsewhere / "data" / "street" / "night", 4, seed=1, brightness=-30)
    content = tiny_manifest()
    content["methods"]["theirs"] = HOG | {"title": "Theirs", "builder": "theirs_of_this_test:build"}
    content["profiles"]["demo"]["methods"] = ["hog", "theirs"]
    theirs = write_manifest(elsewhere, content)
    (elsewhere / "theirs_of_this_test.py").write_text(
        "from pathlib import Path\nPath(__file__).with_name('ran').touch()\nfrom artifact.methods.hog import HOG as build\n"
    )
    own = project / "own"
    own.mkdir()
    write_manifest(own, tiny_manifest())
    monkeypatch.chdir(own)
    monkeypatch.syspath_prepend(elsewhere)
    return theirs


@pytest.mark.parametrize("command", ["evaluate", "extract", "status", "verify", "plan", "run"])
def test_code_that_a_manifest_from_elsewhere_names_is_not_run_unasked(others, command, capsys):
    assert cli.main([command, "--manifest", str(others)]) == 1
    told = capsys.readouterr().err
    assert told.startswith(
        f"error: {others}: names code that a run would execute (methods.theirs: theirs_of_this_test:build)"
    )
    assert told.endswith("add --trust to run it\n")
    assert told.count("\n") == 1
    assert not others.with_name("ran").exists()


def test_code_that_is_trusted_is_run(others, capsys):
    assert cli.main(["evaluate", "--manifest", str(others), "--trust", "--methods", "theirs"]) == 0
    assert "Street" in capsys.readouterr().out
    assert others.with_name("ran").exists()


def test_a_repair_runs_what_verify_was_told_to_trust(others, monkeypatch):
    asked, main = [], cli.main
    monkeypatch.setattr(cli, "main", lambda arguments: asked.append(arguments) or 0)
    monkeypatch.setattr("artifact.commands.verify.repair", lambda manifest, profile, run: [str(run())])
    for trust in ([], ["--trust"]):
        main(["verify", "--repair", "--manifest", str(others), *trust])
    assert asked == [["reproduce", "--profile", "demo", "--trust", "--manifest", str(others)]]


def test_manifests_of_the_project_and_those_without_code_need_no_trust(others, monkeypatch, capsys):
    named = {"copy.yaml": others.read_text(), "sub/data_manifest.yaml": others.read_text()}
    monkeypatch.chdir(others.parent)
    (others.parent / "sub").mkdir()
    for name, text in named.items():
        (others.parent / name).write_text(text)
        manifest.refuse_code_from_elsewhere(manifest.load(others.parent / name))
    plain = write_manifest(others.parent.parent, tiny_manifest())
    assert cli.main(["status", "--manifest", str(plain)]) == 0
    with pytest.raises(ManifestError, match="add --trust"):
        monkeypatch.chdir(others.parent.parent / "own")
        manifest.refuse_code_from_elsewhere(manifest.load(others))


@pytest.mark.parametrize(
    "tag", ["!!python/object/apply:os.system", "!!python/object/new:os.system", "!!python/name:os.system"]
)
def test_yaml_tags_run_nothing_wherever_yaml_is_read(project, tag, capsys):
    ran = project / "ran"
    hostile = f"{tag} ['touch {ran}']" if "name" not in tag else f"{tag} ''"
    (project / "data_manifest.yaml").write_text(f"version: {hostile}\n")
    with pytest.raises(ManifestError):
        manifest.load(project / "data_manifest.yaml")
    folder = project / "mine"
    folder.mkdir()
    (folder / "dataset.yaml").write_text(f"title: {hostile}\n")
    own = manifest.load(write_manifest(project, tiny_manifest()))
    with pytest.raises(ManifestError):
        own.dataset(str(folder))
    with pytest.raises(Exception, match="not valid YAML"):
        arguments.asked_parameters([f"k={hostile}"])
    assert not ran.exists()


# -- arrays ---------------------------------------------------------------------------------------------------------


class Evil:
    def __init__(self, marker):
        self.marker = marker

    def __reduce__(self):
        return os.mkdir, (self.marker,)


def test_arrays_of_objects_run_nothing(tmp_path, capsys):
    marker = str(tmp_path / "ran")
    objects = np.array([Evil(marker), None, None, None], object)
    np.save(tmp_path / "evil.npy", objects)
    np.savez(tmp_path / "evil.npz", descriptors=objects)
    np.save(tmp_path / "good.npy", np.eye(4, dtype=np.float32))
    for queries, positions in (("evil.npy", None), ("evil.npz", None), ("good.npy", "evil.npy")):
        files = [
            "--queries",
            str(tmp_path / queries),
            "--database",
            str(tmp_path / "good.npy"),
            "--threshold",
            "1frame",
        ]
        files += ["--query-positions", str(tmp_path / positions)] if positions else []
        assert cli.main(["evaluate", *files]) == 1
        assert re.fullmatch(r"error: .*evil\.np[yz].*\n", capsys.readouterr().err)
    store.save_arrays(tmp_path / "result.npz", {"a": np.arange(3)}, {"key": "k"})
    np.savez(tmp_path / "result.npz", a=objects)
    record = store.read_json(tmp_path / "result.json") | {"sha256": store.digest_of_file(tmp_path / "result.npz")}
    store.write_json(tmp_path / "result.json", record)
    with pytest.raises(ValueError, match="allow_pickle=False"):
        store.load_arrays(tmp_path / "result.npz", "k")
    assert not Path(marker).exists()
    np.load(tmp_path / "evil.npy", allow_pickle=True)
    assert Path(marker).exists(), "it would have run"


# -- downloads ------------------------------------------------------------------------------------------------------


def test_an_endless_file_is_given_up_once_it_is_longer_than_it_should_be(tmp_path):
    content = bytes(20_000_000)
    with running() as server:
        url = server.serve("a", content, says_length=False)
        with pytest.raises(DownloadError, match="sends more than the 70,000 bytes that the manifest says"):
            download.retrieve([url], tmp_path / "file", size=70_000, progress=False)
        assert list(tmp_path.iterdir()) == []


def test_an_endless_file_of_unknown_length_does_not_fill_the_disk(tmp_path, monkeypatch):
    free, usage = [200 << 20], shutil.disk_usage(tmp_path)

    def shrinking(_):
        free[0] -= 1 << 20
        return usage._replace(free=free[0])

    monkeypatch.setattr(shutil, "disk_usage", shrinking)
    with running() as server:
        url = server.serve("a", bytes(40_000_000), says_length=False)
        with pytest.raises(DownloadError, match=r"has less than 67\.1 MB left"):
            download.retrieve([url], tmp_path / "file", progress=False)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("scheme", ["file:///etc/hostname", "ftp://127.0.0.1:9/a", "data:,abc", "javascript:alert(1)"])
def test_a_redirection_leads_to_no_other_scheme(tmp_path, scheme):
    with running() as server, pytest.raises(DownloadError):
        download.retrieve([server.serve("a", b"", moved_to=scheme)], tmp_path / "file", progress=False)
    assert not (tmp_path / "file").exists()


# -- links planted in the cache -------------------------------------------------------------------------------------


@pytest.fixture
def victim(tmp_path):
    path = tmp_path / "victim"
    path.write_bytes(b"precious")
    yield path
    assert path.read_bytes() == b"precious"


def test_what_is_written_takes_the_place_of_a_link_and_never_follows_it(tmp_path, victim):
    cache = tmp_path / "cache"
    parts = Parts(cache / "parts", "key", 2, 2, (3,), "float32")
    parts.folder.mkdir(parents=True)
    for path in (
        cache / "a.json",
        cache / "b.npz",
        cache / "b.json",
        parts.path(0),
        parts.path(0).with_suffix(".json"),
    ):
        path.symlink_to(victim)
    store.write_json(cache / "a.json", {"a": 1})
    store.save_arrays(cache / "b.npz", {"a": np.arange(3)}, {"key": "k"})
    parts.write(0, [np.zeros((2, 3), np.float32)], {})
    assert store.read_json(cache / "a.json") == {"a": 1}
    assert store.load_arrays(cache / "b.npz", "k")["a"].tolist() == [0, 1, 2]
    assert parts.has(0)
    assert not [path for path in cache.rglob("*") if path.is_symlink() and path.suffix in (".json", ".npz")]


def test_a_link_in_the_place_of_a_result_is_never_its_content(tmp_path, victim):
    for target in (victim, tmp_path):
        path = tmp_path / "cache" / f"{target.name}.npz"
        path.parent.mkdir(exist_ok=True)
        path.symlink_to(target)
        store.write_json(path.with_suffix(".json"), {"key": "k", "sha256": "0" * 64})
        assert store.load_arrays(path, "k") is None
    assert tmp_path.is_dir()


def test_a_link_in_the_place_of_a_lock_is_not_followed(tmp_path, victim):
    (tmp_path / ".result.lock").symlink_to(victim)
    with pytest.raises(store.StoreError, match="result: cannot be written"), store.lock(tmp_path / "result"):
        pytest.fail("it was followed")


def test_what_killed_runs_left_is_swept_up_without_following_links(project, victim):
    loaded = manifest.load(project / "data_manifest.yaml")
    traversal = datasets.load_traversal(loaded, "street", "day")
    extract.descriptors(loaded, traversal, "hog", workers=0)
    outside = project / "outside"
    outside.mkdir()
    (outside / "kept").write_text("kept")
    (loaded.cache / ".old.tmp").symlink_to(outside)
    (loaded.cache / "linked").symlink_to(outside)
    os.utime(outside, (1, 1))
    store.sweep(loaded.cache)
    assert (outside / "kept").read_text() == "kept"
