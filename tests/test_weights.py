"""Released weights: fetched whole or not at all, never run, never taken for another method's."""

from __future__ import annotations

import errno
import hashlib
import http.server
import json
import os
import pickle
import re
import resource
import signal
import subprocess
import sys
import threading
import time
import types
from collections import OrderedDict
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import pytest
import torch
from conftest import REPOSITORY, THUMBNAIL, tiny_manifest, write_images, write_manifest
from filled_weights import filled, images
from hypothesis import given, settings
from hypothesis import strategies as st
from safetensors.torch import save_file
from torch import nn

from artifact import (
    checkpoints,
    cli,
    datasets,
    download,
    extract,
    manifest,
    methods,
    runner,
    store,
    verification,
    weights,
)
from artifact.checkpoints import CheckpointError
from artifact.download import DownloadError
from artifact.manifest import ManifestError, MethodEntry
from artifact.methods.mixvpr import mixvpr
from artifact.weights import WeightsError

PAPER_METHODS = (
    "anyloc", "boq", "cosplace", "cricavpr", "eigenplaces", "megaloc", "mixvpr", "salad", "salad_cm", "selavpr", "selavprpp",
)  # fmt: skip


# --- a server with all the habits of real ones, and a small model ---


@dataclass
class Page:
    """One file of the server, and how it is served."""

    content: bytes
    etag: str | None = '"one"'
    modified: str | None = None
    kind: str = "application/octet-stream"
    ranges: bool = True
    heeds_if_range: bool = True
    says_length: bool = True
    statuses: list[int] = field(default_factory=list)  # answered first, one by one
    ends_after: list[int] = field(default_factory=list)  # bytes after which each of the next answers breaks off
    moved_to: str | None = None
    slow: float = 0.0
    asked: list[dict[str, str]] = field(default_factory=list)


class Handler(http.server.BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.0"

    def do_GET(self):
        page = self.server.pages.get(self.path)
        if page is None:
            self.send_error(404)
            return
        page.asked.append(dict(self.headers))
        if page.statuses:
            self.send_error(page.statuses.pop(0))
            return
        if page.moved_to:
            self.send_response(302)
            self.send_header("Location", page.moved_to)
            self.end_headers()
            return
        self._send(page)

    def _send(self, page):
        start, asked, condition = 0, self.headers.get("Range"), self.headers.get("If-Range")
        current = condition in (None, page.etag, page.modified) or not page.heeds_if_range
        if asked and page.ranges and current:
            start = int(re.fullmatch(r"bytes=(\d+)-", asked)[1])
            if start >= len(page.content):
                self.send_error(416)
                return
            self.send_response(206)
            self.send_header("Content-Range", f"bytes {start}-{len(page.content) - 1}/{len(page.content)}")
        else:
            self.send_response(200)
        body = page.content[start:]
        self.send_header("Content-Type", page.kind)
        if page.says_length:
            self.send_header("Content-Length", str(len(body)))
        for name, value in (("ETag", page.etag), ("Last-Modified", page.modified)):
            if value:
                self.send_header(name, value)
        self.end_headers()
        body = body[: page.ends_after.pop(0)] if page.ends_after else body
        for at in range(0, len(body), 4096):
            self.wfile.write(body[at : at + 4096])
            time.sleep(page.slow)

    def log_message(self, *_):
        pass


class Server(http.server.ThreadingHTTPServer):
    daemon_threads = True

    def __init__(self):
        super().__init__(("127.0.0.1", 0), Handler)
        self.pages = {}

    def handle_error(self, *_):  # a client that went away
        pass

    def serve(self, path, content, **habits):
        self.pages[f"/{path}"] = Page(content, **habits)
        return f"http://127.0.0.1:{self.server_port}/{path}"

    def requests(self, path):
        return self.pages[f"/{path}"].asked


@pytest.fixture(scope="module")
def running():
    with Server() as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield server
        server.shutdown()
        thread.join()


@pytest.fixture
def server(running, monkeypatch):
    running.pages.clear()
    monkeypatch.setenv("no_proxy", "*")
    monkeypatch.setattr(download, "PAUSE", 0.0)
    return running


class Tiny(nn.Module):
    """Sixteen grey values to three: enough of a descriptor to run."""

    def __init__(self):
        super().__init__()
        self.head = nn.Linear(16, 3)
        self.norm = nn.BatchNorm1d(3)

    def forward(self, batch):
        return nn.functional.normalize(self.norm(self.head(batch.flatten(1)[:, :16])), dim=1)


def tiny():
    return Tiny()


class Aggregated(Tiny):
    def __init__(self):
        super().__init__()
        self.c_centers = nn.Parameter(torch.zeros(2, 5))


def aggregated():
    return Aggregated()


def state_of(seed=0, build=Tiny):
    generator = torch.Generator().manual_seed(seed)
    state = build().state_dict()
    return {k: torch.rand(t.shape, generator=generator) + 0.1 if t.is_floating_point() else t for k, t in state.items()}


def packed(content, folder, *, legacy=False):
    path = folder / "packed"
    torch.save(content, path, _use_new_zipfile_serialization=not legacy)
    return path.read_bytes()


def entry_of(folder, *files, builder=f"{__name__}:tiny", kind="paper", **keys):
    """A method whose weights are these files, each a mapping of manifest keys, in a folder of their own."""
    files = [{"file": "tiny.pth"} | file for file in files or [{}]]
    content = THUMBNAIL | {
        "title": "Tiny",
        "kind": kind,
        "dimension": 3,
        "weights": {"files": files, "licence": "MIT"} | keys,
    }
    content |= {"builder": builder} if builder else {}
    content["weights"] |= {"folder": str(folder / "weights")}
    return MethodEntry.model_validate(content)


def put(entry, content, number=0):
    path = weights.path_of(entry.weights, entry.weights.files[number])
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    return path


def names_in(folder):
    """Files of a folder, but for the locks between processes, which are empty."""
    return {path.name for path in folder.iterdir() if path.stat().st_size} if folder.is_dir() else set()


def equal(state, other):
    return state.keys() == other.keys() and all(torch.equal(state[key], other[key]) for key in state)


# --- whole, or not at all ---


def test_weights_are_fetched_checked_recorded_and_loaded(tmp_path, server):
    state = state_of()
    content = packed(state, tmp_path)
    entry = entry_of(tmp_path, {"urls": [server.serve("a.pth", content)]})
    assert weights.state("tiny", entry).status == "missing"
    methods.fetch("tiny", entry, progress=False)

    model = methods.model_of("tiny", entry)
    assert equal(model.state_dict(), state)
    assert not model.training
    assert not any(parameter.requires_grad for parameter in model.parameters())
    assert weights.state("tiny", entry).status == "present"
    assert names_in(tmp_path / "weights") == {"tiny.pth", "tiny.pth.lock.json"}
    assert (tmp_path / "weights" / "tiny.pth").read_bytes() == content
    record = json.loads((tmp_path / "weights" / "tiny.pth.lock.json").read_text())
    assert record["url"] == entry.weights.files[0].urls[0]
    assert (record["size"], record["sha256"]) == (len(content), hashlib.sha256(content).hexdigest())
    assert re.fullmatch(r"\d{4}-\d\d-\d\d", record["date"])

    methods.fetch("tiny", entry, progress=False)
    assert len(server.requests("a.pth")) == 1


@pytest.fixture(scope="module")
def content():
    return bytes(range(256)) * 256


@pytest.mark.parametrize(
    "habits", [{}, {"etag": None, "modified": "Sun, 22 Nov 2026 08:00:00 GMT"}, {"etag": 'W/"weak"'}]
)
def test_an_interrupted_download_goes_on_where_it_was(tmp_path, server, monkeypatch, content, habits):
    monkeypatch.setattr(download, "ATTEMPTS", 1)
    partial, url = tmp_path / ".partial", server.serve("a", content, ends_after=[10_000, 0, 20_000, 0], **habits)
    for arrived in (10_000, 30_000):
        with pytest.raises(DownloadError, match=f"ended after {arrived:,} of 65,536 bytes.*{arrived:,} bytes are kept"):
            download.fetch(url, partial, label="a", progress=False)
        assert partial.read_bytes() == content[:arrived]
    download.fetch(url, partial, label="a", progress=False)
    assert partial.read_bytes() == content
    assert [asked.get("Range") for asked in server.requests("a")] == [
        None, "bytes=10000-", "bytes=10000-", "bytes=30000-", "bytes=30000-",
    ]  # fmt: skip
    condition = server.requests("a")[1].get("If-Range")
    assert condition == (None if "W/" in str(habits) else habits.get("modified", '"one"'))
    download.fetch(url, partial, label="a", progress=False)  # whole already: killed before it was examined, say
    assert len(server.requests("a")) == 5


@settings(max_examples=25, deadline=None, derandomize=True)
@given(ends=st.lists(st.integers(1, 70_000), max_size=8), ranges=st.booleans(), etag=st.sampled_from(['"one"', None]))
def test_however_a_server_breaks_off_the_bytes_are_right_or_there_is_an_error(
    tmp_path_factory, running, content, ends, ranges, etag
):
    folder = tmp_path_factory.mktemp("download")
    url = running.serve("a", content, ends_after=list(ends), ranges=ranges, etag=etag)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(download, "PAUSE", 0.0)
        patch.setenv("no_proxy", "*")
        try:
            download.fetch(url, folder / "partial", label="a", progress=False)
        except DownloadError:
            assert len(running.requests("a")) >= download.ATTEMPTS
        else:
            assert (folder / "partial").read_bytes() == content
        if ranges and etag:
            assert (folder / "partial").read_bytes() == content


@pytest.mark.parametrize(
    "habits",
    [
        pytest.param({"etag": '"two"'}, id="other version, the server notices"),
        pytest.param({"etag": '"two"', "heeds_if_range": False}, id="other version, the server does not notice"),
        pytest.param({"heeds_if_range": False, "longer": 1000}, id="other length under the same name"),
        pytest.param({"heeds_if_range": False, "longer": -60_000}, id="now shorter than what has arrived"),
        pytest.param({"ranges": False}, id="no ranges any more"),
    ],
)  # fmt: skip
def test_bytes_of_two_versions_are_never_mixed(tmp_path, server, monkeypatch, content, habits):
    partial, url = tmp_path / ".partial", server.serve("a", content, ends_after=[10_000, 0])
    with monkeypatch.context() as patch:
        patch.setattr(download, "ATTEMPTS", 1)
        with pytest.raises(DownloadError):
            download.fetch(url, partial, label="a", progress=False)
    longer = habits.pop("longer", 0)
    other = content[::-1] + bytes(longer) if longer >= 0 else content[::-1][:longer]
    server.serve("a", other, **habits)
    download.fetch(url, partial, label="a", progress=False)
    assert partial.read_bytes() == other


def test_without_a_name_for_the_version_nothing_is_resumed(tmp_path, server, content):
    url = server.serve("a", content, etag=None, ends_after=[10_000])
    download.fetch(url, tmp_path / "partial", label="a", progress=False)
    assert (tmp_path / "partial").read_bytes() == content
    assert [asked.get("Range") for asked in server.requests("a")] == [None, None]


def test_a_file_of_unknown_length_and_a_redirection(tmp_path, server, content):
    server.serve("b", content, says_length=False)
    url = server.serve("a", b"", moved_to="/b")
    download.fetch(url, tmp_path / "partial", label="a", progress=False)
    assert (tmp_path / "partial").read_bytes() == content


def test_a_killed_download_goes_on(tmp_path, server):
    """A process killed in the middle leaves nothing that looks complete, and the next one does not start anew."""
    content = packed(state_of() | {"filler": torch.zeros(200_000)}, tmp_path)
    url = server.serve("a.pth", content, slow=0.01)
    target, partial = tmp_path / "weights" / "tiny.pth", None
    code = (
        "import sys; from artifact import download; from pathlib import Path\n"
        "download.fetch(sys.argv[1], Path(sys.argv[2]), label='a', progress=False)"
    )
    partial = target.with_name(f".tiny.pth.{hashlib.sha256(url.encode()).hexdigest()[:8]}.partial")
    process = subprocess.Popen([sys.executable, "-c", code, url, str(partial)])
    deadline = time.monotonic() + 60
    while not (partial.exists() and partial.stat().st_size > 40_000):
        assert time.monotonic() < deadline
        time.sleep(0.005)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert not target.exists()
    arrived = partial.stat().st_size
    assert arrived < len(content)

    server.pages["/a.pth"].slow = 0.0
    entry = entry_of(tmp_path, {"urls": [url]}, builder=f"{__name__}:with_filler")
    methods.fetch("tiny", entry, progress=False)
    assert target.read_bytes() == content
    assert server.requests("a.pth")[-1]["Range"] == f"bytes={arrived}-"
    assert names_in(target.parent) == {"tiny.pth", "tiny.pth.lock.json"}


def with_filler():
    model = Tiny()
    model.register_buffer("filler", torch.zeros(200_000))
    return model


def test_two_processes_that_want_the_same_file_fetch_it_once(tmp_path, server):
    entry = entry_of(tmp_path, {"urls": [server.serve("a.pth", packed(state_of(), tmp_path), slow=0.05)]})
    with ThreadPoolExecutor(4) as pool:
        for outcome in [pool.submit(methods.fetch, "tiny", entry, progress=False) for _ in range(4)]:
            outcome.result()
    assert len(server.requests("a.pth")) == 1
    assert weights.state("tiny", entry).status == "present"


# --- what servers send instead ---


def test_a_truncated_answer_is_no_file(tmp_path, server):
    content = packed(state_of(), tmp_path)
    entry = entry_of(tmp_path, {"urls": [server.serve("a.pth", content, ends_after=[500] * 99, ranges=False)]})
    with pytest.raises(WeightsError, match=rf"ended after 500 of {len(content):,} bytes, in 5 attempts"):
        methods.fetch("tiny", entry, progress=False)
    assert not (tmp_path / "weights" / "tiny.pth").exists()


def test_a_file_that_is_truncated_on_the_server_is_refused_and_not_kept(tmp_path, server):
    entry = entry_of(tmp_path, {"urls": [server.serve("a.pth", packed(state_of(), tmp_path)[:-200])]})
    with pytest.raises(WeightsError, match=r"tiny.pth cannot be read .*damaged, incomplete or no checkpoint"):
        methods.fetch("tiny", entry, progress=False)
    assert names_in(tmp_path / "weights") == set()


@pytest.mark.parametrize("key", ["sha256", "git_blob", "size"])
def test_a_file_of_another_content_than_the_manifest_says_gives_way_to_a_mirror(tmp_path, server, key):
    wanted, other = packed(state_of(1), tmp_path), packed(state_of(2) | {"more": torch.zeros(9)}, tmp_path)
    blob = hashlib.sha1(f"blob {len(wanted)}\0".encode() + wanted).hexdigest()
    known = {"sha256": hashlib.sha256(wanted).hexdigest(), "git_blob": blob, "size": len(wanted)}[key]
    found = {"sha256": hashlib.sha256(other).hexdigest(), "git_blob": "[0-9a-f]{40}", "size": len(other)}[key]
    wrong, right = server.serve("a.pth", other), server.serve("b.pth", wanted)
    with pytest.raises(WeightsError, match=rf"{found}, the manifest says {known}") as caught:
        methods.fetch("tiny", entry_of(tmp_path, {"urls": [wrong], key: known}), progress=False)
    assert wrong in str(caught.value)
    assert names_in(tmp_path / "weights") == set()

    methods.fetch("tiny", entry_of(tmp_path, {"urls": [wrong, right], key: known}), progress=False)
    assert names_in(tmp_path / "weights") == {"tiny.pth", "tiny.pth.lock.json"}
    assert json.loads((tmp_path / "weights" / "tiny.pth.lock.json").read_text())["url"] == right


@pytest.mark.parametrize(
    ("text", "digest"),
    [(b"", "e69de29bb2d1d6434b8b29ae775ad8c2e48c5391"), (b"hello\n", "ce013625030ba8dba906f756967f9e9ca394464a")],
)
def test_git_blobs_are_those_of_git(tmp_path, text, digest):
    (tmp_path / "file").write_bytes(text)
    assert weights.weights_lock._git_blob(tmp_path / "file") == digest


@pytest.mark.parametrize("kind", ["text/html; charset=utf-8", "application/octet-stream"])
def test_a_page_of_google_drive_in_place_of_the_file_leads_to_instructions(tmp_path, server, monkeypatch, kind):
    page = server.serve("drive/1aB_c-d", b"\n<!DOCTYPE html><title>Quota exceeded</title>", kind=kind)
    monkeypatch.setattr(download, "_DRIVE_FILE", page.replace("1aB_c-d", "{}"))
    url = "https://drive.google.com/file/d/1aB_c-d/view"
    entry = entry_of(tmp_path, {"urls": [url], "megabytes": 352}, obtain="Only this file is right.")
    with pytest.raises(WeightsError) as caught:
        methods.fetch("tiny", entry, progress=False)
    text = str(caught.value)
    assert "a web page in place of the file; Google Drive does so" in text
    assert f"by hand: open {url} in a browser and download the file (about 352 MB)" in text
    assert "Only this file is right." in text
    assert f"save it as {tmp_path / 'weights' / 'tiny.pth'} and run the same command again" in text
    assert len(server.requests("drive/1aB_c-d")) == 1
    assert names_in(tmp_path / "weights") == set()

    put(entry, b"<html>saved by hand</html>")
    with pytest.raises(WeightsError, match="is a web page, saved in place of the file"):
        methods.fetch("tiny", entry, progress=False)
    put(entry, packed(state_of(), tmp_path))
    methods.fetch("tiny", entry, progress=False)
    assert weights.state("tiny", entry).status == "present"


def test_a_file_on_google_drive_is_fetched_where_drive_gives_it(tmp_path, server, monkeypatch):
    page = server.serve("drive/1aB", packed(state_of(), tmp_path))
    monkeypatch.setattr(download, "_DRIVE_FILE", page.replace("1aB", "{}"))
    entry = entry_of(tmp_path, {"urls": ["https://drive.google.com/file/d/1aB/view?usp=sharing"]})
    methods.fetch("tiny", entry, progress=False)
    assert weights.state("tiny", entry).status == "present"


@pytest.mark.parametrize(("statuses", "asked"), [([503, 429, 500], 4), ([404], 1), ([403], 1), ([503] * 9, 5)])
def test_passing_faults_of_a_server_are_waited_out_and_others_reported(tmp_path, server, content, statuses, asked):
    url = server.serve("a", content, statuses=list(statuses))
    if asked == 4:
        download.fetch(url, tmp_path / "partial", label="a", progress=False)
        assert (tmp_path / "partial").read_bytes() == content
    else:
        with pytest.raises(DownloadError, match=f"the server answered {statuses[0]}"):
            download.fetch(url, tmp_path / "partial", label="a", progress=False)
        assert not (tmp_path / "partial").exists()
    assert len(server.requests("a")) == asked


def test_no_network_is_said_at_once(tmp_path, server):
    with pytest.raises(DownloadError, match=r"the address of nowhere.invalid cannot be found; is there a network\?"):
        download.fetch("http://nowhere.invalid/a", tmp_path / "partial", label="a", progress=False)
    with pytest.raises(DownloadError, match=r"the connection failed .*refused.* in 5 attempts"):
        download.fetch("http://127.0.0.1:9/a", tmp_path / "partial", label="a", progress=False)


# --- disk ---


def test_a_download_that_the_disk_cannot_hold_is_not_begun(tmp_path, server, monkeypatch, content):
    free = types.SimpleNamespace(free=download._SPARE + len(content) - 1)
    monkeypatch.setattr(download.shutil, "disk_usage", lambda _: free)
    url = server.serve("a", content)
    with pytest.raises(DownloadError, match=r"67 MB free, the download needs 67 MB; free some room"):
        download.fetch(url, tmp_path / "partial", label="a", progress=False)
    assert names_in(tmp_path) == set()
    free.free += 1
    download.fetch(url, tmp_path / "partial", label="a", progress=False)


def test_a_disk_that_fills_up_is_named_and_the_download_goes_on_later(tmp_path, server, content):
    """The kernel refuses to let a file grow, as a full disk does."""
    url = server.serve("a", content)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (30_000, hard))
    try:
        with pytest.raises(DownloadError, match=r"cannot write .*partial \(.*\).* run again: it goes on"):
            download.fetch(url, tmp_path / "partial", label="a", progress=False)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert (tmp_path / "partial").read_bytes() == content[:30_000]
    download.fetch(url, tmp_path / "partial", label="a", progress=False)
    assert (tmp_path / "partial").read_bytes() == content
    assert server.requests("a")[-1]["Range"] == "bytes=30000-"


def test_a_folder_that_cannot_be_written_is_named(tmp_path, server, monkeypatch):
    entry = entry_of(tmp_path)
    put(entry, packed(state_of(), tmp_path))

    def refuse(*_):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr(store, "write_json", refuse)
    with pytest.raises(WeightsError, match=r"cannot write beside it \(Read-only file system\).*tiny.pth.lock.json"):
        methods.model_of("tiny", entry)


# --- nothing in a file is run ---


class Malicious:
    """Runs a command when it is unpickled."""

    def __init__(self, *call):
        self.call = call

    def __reduce__(self):
        return self.call[0], tuple(self.call[1:])


def malicious_files(folder):
    marker = folder / "executed"
    for number, call in enumerate(
        [
            (os.system, f"touch {marker}"),
            (subprocess.check_call, ["touch", str(marker)]),
            (eval, f"open({str(marker)!r}, 'w')"),
        ]
    ):
        for where in ("beside", "inside"):
            harm = Malicious(*call)
            content = (
                {"state_dict": state_of(), "extra": harm} if where == "beside" else state_of() | {"head.weight": harm}
            )
            for legacy in (False, True):
                yield f"{number} {where} {'legacy' if legacy else 'zip'}", packed(content, folder, legacy=legacy)
        yield f"{number} bare", pickle.dumps(Malicious(*call))
    assert not marker.exists()
    eval("open")(marker, "w").close()  # the marker can be made: the test below would see it
    marker.unlink()


def test_a_checkpoint_that_would_run_code_is_refused_unrun(tmp_path):
    entry, marker = entry_of(tmp_path), tmp_path / "executed"
    for name, content in malicious_files(tmp_path):
        path = put(entry, content)
        with pytest.raises(WeightsError, match=r"could run code: it asks for \S+|cannot be read") as caught:
            methods.model_of("tiny", entry)
        assert str(path) in str(caught.value), name
        if "bare" not in name:
            assert re.search(
                r"asks for (posix.system|(subprocess|commands).check_call|(builtins.|__builtin__.)?eval)",
                str(caught.value),
            ), name
        assert not marker.exists(), name
        assert not path.with_name("tiny.pth.lock.json").exists()


def test_a_malicious_download_is_not_kept(tmp_path, server):
    content = packed(
        {"state_dict": state_of(), "extra": Malicious(os.system, f"touch {tmp_path / 'executed'}")}, tmp_path
    )
    with pytest.raises(WeightsError, match=r"could run code: it asks for posix.system"):
        methods.fetch("tiny", entry_of(tmp_path, {"urls": [server.serve("a.pth", content)]}), progress=False)
    assert names_in(tmp_path / "weights") == set()
    assert not (tmp_path / "executed").exists()


def test_the_bookkeeping_of_trainers_is_passed_over_and_never_imported(tmp_path, monkeypatch):
    """A Lightning checkpoint carries settings and paths as objects of packages that are not installed here."""
    module = types.ModuleType("pytorch_lightning")
    module.AttributeDict = type("AttributeDict", (dict,), {"__module__": "pytorch_lightning"})
    module.Score = type("Score", (), {"__module__": "pytorch_lightning"})
    monkeypatch.setitem(sys.modules, "pytorch_lightning", module)
    settings_, score = module.AttributeDict(lr=0.1, path=Path("a/b")), module.Score()
    score.best = {"k": [1, 2]}
    content = packed(
        {"state_dict": OrderedDict(state_of()), "hyper_parameters": settings_, "callbacks": {"best": score}}, tmp_path
    )
    monkeypatch.delitem(sys.modules, "pytorch_lightning")

    entry, allowed = entry_of(tmp_path, {"container": "state_dict"}), set(torch.serialization.get_safe_globals())
    put(entry, content)
    assert equal(methods.model_of("tiny", entry).state_dict(), state_of())
    assert "pytorch_lightning" not in sys.modules
    assert set(torch.serialization.get_safe_globals()) == allowed


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"epoch": 3}, "holds no weights, but entries such as epoch"),
        ({}, "holds no weights"),
        ([1, 2], "holds an object of type list; a mapping"),
        (state_of() | {"head.weight": [[0.0]]}, "entries such as head.weight"),
        (state_of() | {"head.weight": torch.zeros(3, 16).to_sparse()}, "entries such as head.weight"),
        (state_of() | {"head.weight": torch.zeros(3, 16, device="meta")}, "entries such as head.weight"),
    ],
)  # fmt: skip
def test_content_that_is_no_weights_is_refused(tmp_path, content, message):
    (tmp_path / "file").write_bytes(packed(content, tmp_path))
    with pytest.raises(CheckpointError, match=message):
        checkpoints.read(tmp_path / "file")


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory):
    return packed(state_of(), tmp_path_factory.mktemp("checkpoint"))


@settings(max_examples=40, deadline=None, derandomize=True)
@given(st.data())
def test_a_checkpoint_cut_at_any_place_is_refused(tmp_path_factory, checkpoint, data):
    path = tmp_path_factory.mktemp("cut") / "file"
    path.write_bytes(checkpoint[: data.draw(st.integers(0, len(checkpoint) - 1))])
    with pytest.raises(CheckpointError, match="damaged, incomplete or no checkpoint"):
        checkpoints.read(path)


@settings(max_examples=100, deadline=None, derandomize=True)
@given(st.data())
def test_an_altered_byte_is_noticed_or_leaves_plain_tensors(tmp_path_factory, checkpoint, data):
    """PyTorch's reader does not check the bytes of tensors: there the SHA-256 is the guard. It must not fail otherwise."""
    path, altered = tmp_path_factory.mktemp("altered") / "file", bytearray(checkpoint)
    altered[data.draw(st.integers(0, len(checkpoint) - 1))] ^= data.draw(st.integers(1, 255))
    path.write_bytes(altered)
    try:
        found = checkpoints.read(path)
    except CheckpointError:
        return
    assert all(type(value) is torch.Tensor for value in found.values())
    if not checkpoints.faults(found, state_of()):
        checkpoints.load_into(Tiny(), found)


# --- containers, names and shapes ---


@pytest.mark.parametrize("legacy", [False, True])
@pytest.mark.parametrize("prefix", ["", "module."])
@pytest.mark.parametrize("container", ["flat", "state_dict", "model_state_dict"])
def test_every_released_layout_gives_the_same_weights(tmp_path, container, prefix, legacy):
    state = state_of()
    named = OrderedDict(
        (prefix + key, nn.Parameter(value) if value.is_floating_point() else value) for key, value in state.items()
    )
    content = named if container == "flat" else {"epoch": 7, container: named}
    path = tmp_path / "file"
    path.write_bytes(packed(content, tmp_path, legacy=legacy))
    for asked in (None, container):
        found = checkpoints.read(path, container=asked)
        assert equal(found, state)
        assert not any(value.requires_grad for value in found.values())
    for other in {"flat", "state_dict", "model_state_dict"} - {container}:
        with pytest.raises(CheckpointError, match=r"has its weights .*; the released file has them"):
            checkpoints.read(path, container=other)
    save_file(state, tmp_path / "safe")
    assert checkpoints.digest(checkpoints.read(tmp_path / "safe")) == checkpoints.digest(checkpoints.read(path))


def test_a_damaged_safetensors_file_is_refused(tmp_path):
    save_file(state_of(), tmp_path / "safe")
    for cut in (9, 100, 300):
        (tmp_path / "cut").write_bytes((tmp_path / "safe").read_bytes()[:cut])
        with pytest.raises(CheckpointError, match="cannot be read"):
            checkpoints.read(tmp_path / "cut")


def test_a_prefix_is_removed_only_where_all_names_have_it(tmp_path):
    (tmp_path / "file").write_bytes(packed({"module.a": torch.zeros(1), "b": torch.zeros(1)}, tmp_path))
    assert set(checkpoints.read(tmp_path / "file")) == {"module.a", "b"}


@pytest.mark.parametrize(
    ("change", "messages"),
    [
        (lambda state: state.pop("head.bias"), ["1 missing: head.bias"]),
        (lambda state: state.update(extra=torch.zeros(1)), ["1 unexpected: extra"]),
        (lambda state: state.update({"head.weight": torch.zeros(3, 15)}), ["1 of another shape: head.weight (3, 15) for (3, 16)"]),
        (lambda state: state.update({"head.bias": torch.zeros(3, dtype=torch.int64)}), ["1 of another type: head.bias torch.int64 for torch.float32"]),
        (lambda state: state.update({f"x{i}": torch.zeros(1) for i in range(25)}), ["25 unexpected: x0, ", "x19, and 5 more"]),
        (lambda state: (state.clear(), state.update(a=torch.zeros(1))), ["7 missing: head.weight, head.bias", "1 unexpected: a"]),
    ],
)  # fmt: skip
@pytest.mark.parametrize("by_hand", [True, False])
def test_missing_extra_and_misshaped_keys_are_refused_with_the_list(tmp_path, server, change, messages, by_hand):
    state = state_of()
    change(state)
    content = packed(state, tmp_path)
    entry = entry_of(tmp_path, {"urls": [server.serve("a.pth", content)]})
    if by_hand:
        path = put(entry, content)
    with pytest.raises(WeightsError) as caught:
        methods.model_of("tiny", entry) if by_hand else methods.fetch("tiny", entry, progress=False)
    for message in ["tiny.pth does not fit the model", *messages]:
        assert message in str(caught.value)
    # A user's file stays where it is, a downloaded one is not kept; neither is recorded.
    assert names_in(tmp_path / "weights") == ({path.name} if by_hand else set())


def test_half_precision_is_converted_exactly(tmp_path):
    entry, half = entry_of(tmp_path), {k: t.half() if t.is_floating_point() else t for k, t in state_of().items()}
    put(entry, packed(half, tmp_path))
    model = methods.model_of("tiny", entry)
    for key, value in model.state_dict().items():
        assert value.dtype == Tiny().state_dict()[key].dtype
        assert torch.equal(value, half[key].to(value.dtype))


def test_weights_in_two_files_each_checked_for_its_part(tmp_path, server):
    state = state_of(build=Aggregated)
    centres = state.pop("c_centers")
    files = [
        {"file": "backbone.pth", "urls": [server.serve("a", packed(state, tmp_path))]},
        {"file": "centres.pt", "urls": [server.serve("b", packed(centres, tmp_path))], "tensor": "c_centers"},
    ]
    entry = entry_of(tmp_path, *files, builder=f"{__name__}:aggregated")
    methods.fetch("tiny", entry, progress=False)
    assert equal(methods.model_of("tiny", entry).state_dict(), state | {"c_centers": centres})

    server.serve("b", packed(centres[:1], tmp_path))
    other = entry_of(tmp_path / "other", *files, builder=f"{__name__}:aggregated")
    with pytest.raises(
        WeightsError,
        match=r"centres.pt does not fit the model\n    1 of another shape: c_centers \(1, 5\) for \(2, 5\)",
    ):
        methods.fetch("tiny", other, progress=False)
    server.serve("b", packed({"c_centers": centres}, tmp_path))
    with pytest.raises(WeightsError, match=r"holds an object of type dict; a single tensor"):
        methods.fetch("tiny", other, progress=False)
    assert names_in(tmp_path / "other" / "weights") == {"backbone.pth", "backbone.pth.lock.json"}
    assert weights.state("tiny", other).status == "missing"


# --- one method's file is not another's ---


def shipped_entry(name, folder):
    """A method of the shipped manifest with the tiny model in place of its own."""
    entry = manifest.load(REPOSITORY / "data_manifest.yaml").method(name)
    moved = entry.weights.model_copy(update={"folder": str(folder)})
    return entry.model_copy(update={"weights": moved, "builder": f"{__name__}:tiny"})


def test_salad_cm_refuses_the_file_of_salad(tmp_path):
    salad, salad_cm = shipped_entry("salad", tmp_path), shipped_entry("salad_cm", tmp_path)
    flat = packed(state_of(), tmp_path)
    path = put(salad_cm, flat)
    with pytest.raises(
        WeightsError, match=r"has its weights at the top level; the released file has them under the key"
    ) as caught:
        methods.model_of("salad_cm", salad_cm)
    assert "The torch.hub entry of serizba/cliquemining loads dino_salad.ckpt" in str(caught.value)

    # Packed as the right file is, but with SALAD's weights: seen as soon as both are there, whichever comes first.
    put(salad, flat)
    methods.model_of("salad", salad)
    wrapped = packed({"state_dict": state_of()}, tmp_path)
    path.write_bytes(wrapped)
    with pytest.raises(WeightsError, match=r"cliquemining.ckpt holds the same weights as dino_salad.ckpt of salad"):
        methods.model_of("salad_cm", salad_cm)
    assert not path.with_name("cliquemining.ckpt.lock.json").exists()

    first = shipped_entry("salad_cm", tmp_path / "first"), shipped_entry("salad", tmp_path / "first")
    put(first[0], wrapped)
    methods.model_of("salad_cm", first[0])
    put(first[1], flat)
    with pytest.raises(WeightsError, match=r"dino_salad.ckpt holds the same weights as cliquemining.ckpt of salad_cm"):
        methods.model_of("salad", first[1])

    path.write_bytes(packed({"state_dict": state_of(5)}, tmp_path))
    assert equal(methods.model_of("salad_cm", salad_cm).state_dict(), state_of(5))


# --- what was accepted once stays the same ---


def test_a_changed_file_is_an_error_that_names_both_digests(tmp_path):
    entry = entry_of(tmp_path)
    path = put(entry, packed(state_of(1), tmp_path))
    methods.model_of("tiny", entry)
    before = store.digest_of_file(path)
    path.write_bytes(packed(state_of(2), tmp_path))
    os.utime(path, ns=(1, 1))
    after = store.digest_of_file(path)
    for use in (
        lambda: methods.model_of("tiny", entry),
        lambda: methods.fingerprint("tiny", entry),
        lambda: methods.fetch("tiny", entry),
    ):
        with pytest.raises(
            WeightsError, match=rf"{after}, but {before} was recorded on .*put there by hand.*delete tiny.pth.lock.json"
        ):
            use()
    assert weights.state("tiny", entry).status == "changed"
    path.with_name("tiny.pth.lock.json").unlink()
    assert equal(methods.model_of("tiny", entry).state_dict(), state_of(2))


def test_a_deleted_file_comes_back_only_as_it_was(tmp_path, server):
    entry = entry_of(tmp_path, {"urls": [server.serve("a.pth", packed(state_of(1), tmp_path))]})
    methods.fetch("tiny", entry, progress=False)
    path = weights.path_of(entry.weights, entry.weights.files[0])
    original = path.read_bytes()
    path.unlink()
    server.serve("a.pth", packed(state_of(2), tmp_path))
    with pytest.raises(WeightsError, match="was recorded on"):
        methods.fetch("tiny", entry, progress=False)
    assert not path.exists()
    server.serve("a.pth", original)
    methods.fetch("tiny", entry, progress=False)
    assert path.read_bytes() == original


def test_a_file_that_was_only_touched_is_read_again_once(tmp_path, monkeypatch):
    entry = entry_of(tmp_path)
    path = put(entry, packed(state_of(), tmp_path))
    methods.model_of("tiny", entry)
    os.utime(path, ns=(10**18, 10**18))
    read = []
    digest = store.digest_of_file
    monkeypatch.setattr(store, "digest_of_file", lambda p: read.append(p) or digest(p))
    for _ in range(3):
        assert weights.state("tiny", entry).status == "present"
    assert read == [path]
    assert json.loads(path.with_name("tiny.pth.lock.json").read_text())["mtime_ns"] == 10**18


@pytest.mark.parametrize("text", ["", "[]", "{}", "not json"])
def test_a_spoilt_lock_file_is_named(tmp_path, text):
    entry = entry_of(tmp_path)
    path = put(entry, packed(state_of(), tmp_path))
    path.with_name("tiny.pth.lock.json").write_text(text)
    with pytest.raises(WeightsError, match=r"tiny.pth.lock.json: not a lock file; delete it"):
        methods.model_of("tiny", entry)


def test_a_lock_file_and_a_manifest_that_disagree_are_both_quoted(tmp_path):
    entry = entry_of(tmp_path)
    path = put(entry, packed(state_of(), tmp_path))
    methods.model_of("tiny", entry)
    other = entry_of(tmp_path, {"sha256": "0" * 64})
    with pytest.raises(WeightsError, match=rf"manifest says SHA-256 {'0' * 64}, .* says {store.digest_of_file(path)}"):
        methods.model_of("tiny", other)


# --- the key of descriptors ---


def test_the_key_of_descriptors_follows_the_weights(tmp_path):
    entry = entry_of(tmp_path)
    unknown = methods.fingerprint("tiny", entry)
    assert unknown["weights"] == [None]
    path = put(entry, packed(state_of(1), tmp_path))
    digest = store.digest_of_file(path)
    assert methods.fingerprint("tiny", entry)["weights"] == [digest]
    methods.model_of("tiny", entry)
    assert methods.fingerprint("tiny", entry) == unknown | {"weights": [digest]}

    elsewhere = entry_of(tmp_path / "elsewhere")
    put(elsewhere, packed(state_of(2), tmp_path))
    assert methods.fingerprint("tiny", elsewhere) != methods.fingerprint("tiny", entry)
    path.unlink()  # 4.5 GB may go once the descriptors are made
    assert methods.fingerprint("tiny", entry)["weights"] == [digest]
    named = entry_of(tmp_path / "named", {"sha256": digest})
    assert methods.fingerprint("tiny", named)["weights"] == [digest]


def test_methods_without_files_of_weights_keep_their_keys():
    """Descriptors of the baselines ship with the package: their keys must not change."""
    for name, entry in manifest.load(REPOSITORY / "data_manifest.yaml").methods.items():
        assert ("weights" in methods.fingerprint(name, entry)) == (entry.kind == "paper")


def test_locked_weights_are_not_read_to_find_descriptors(tmp_path, monkeypatch):
    entry = entry_of(tmp_path)
    put(entry, packed(state_of(), tmp_path))
    methods.model_of("tiny", entry)
    weights.weights_lock._sha256.cache_clear()
    monkeypatch.setattr(store, "digest_of_file", lambda path: pytest.fail(f"{path} was read"))
    methods.fingerprint("tiny", entry)
    weights.state("tiny", entry)


def project_with(tmp_path, server, *states):
    """A project whose methods tiny0, tiny1, ... have their weights on the server."""
    content = tiny_manifest()
    for number, state in enumerate(states):
        url = server.serve(f"{number}.pth", packed(state, tmp_path))
        content["methods"][f"tiny{number}"] = THUMBNAIL | {
            "title": f"Tiny {number}", "kind": "paper", "dimension": 3, "builder": f"{__name__}:tiny",
            "weights": {"files": [{"file": f"tiny{number}.pth", "urls": [url], "megabytes": 0.1}], "licence": f"GPL-{number}.0", "terms": "Ask first."},
        }  # fmt: skip
    content["profiles"]["demo"]["methods"] = ["thumbnail", *(f"tiny{number}" for number in range(len(states)))]
    for name, brightness in (("day", 0.0), ("night", -35.0)):
        write_images(tmp_path / "data" / "street" / name, 5, seed=1, brightness=brightness)
    return write_manifest(tmp_path, content)


def test_descriptors_are_made_with_the_weights_and_stay_readable_without(tmp_path, server):
    loaded = manifest.load(project_with(tmp_path, server, state_of(1), state_of(2)))
    day = datasets.load_traversal(loaded, "street", "day")
    task = runner.Task(tmp_path / "a.py", {}, ("street",), ("thumbnail", "tiny0", "tiny1"))
    with pytest.raises(WeightsError) as caught:
        runner.prepare(loaded, [task])
    assert re.findall(r"(\w+): the weights \S+ are missing", str(caught.value)) == ["tiny0", "tiny1"]
    assert str(caught.value).count("make data PROFILE=paper") == 1
    assert not (tmp_path / ".cache" / "descriptors" / "thumbnail").exists(), "nothing was extracted before"

    found = []
    for name in ("tiny0", "tiny1"):
        with pytest.raises(WeightsError, match=f"{name}.pth are missing"):
            extract.descriptors(loaded, day, name, workers=0)
        methods.fetch(name, loaded.method(name), progress=False)
        found.append(extract.descriptors(loaded, day, name, workers=0))
    assert found[0].key != found[1].key
    assert abs(found[0].values - found[1].values).max() > 0.01
    (tmp_path / "data" / "weights" / "tiny0.pth").unlink()
    assert (extract.descriptors(loaded, day, "tiny0").values == found[0].values).all()
    assert extract.is_ready(loaded, day, "tiny0")


# --- a method of the paper never runs untrained ---


@pytest.mark.parametrize("name", PAPER_METHODS)
def test_no_method_of_the_paper_is_built_without_its_weights(name, tmp_path, monkeypatch):
    monkeypatch.setenv("ARTIFACT_DATA_ROOT", str(tmp_path))
    monkeypatch.setattr(methods, "build", lambda *_: pytest.fail("an untrained model was built"))
    loaded = manifest.load(REPOSITORY / "data_manifest.yaml")
    entry = loaded.method(name)
    for use in (lambda: methods.load(name, loaded), lambda: methods.model_of(name, entry)):
        with pytest.raises(WeightsError) as caught:
            use()
        for file in entry.weights.files:
            assert f"{tmp_path / 'weights' / file.file} are missing" in str(caught.value)
            assert all(url in str(caught.value) for url in file.urls)
        assert "make data PROFILE=paper" in str(caught.value)
        assert "python -m artifact data --profile paper" in str(caught.value)
    if name == "anyloc":  # one of two is not enough
        (tmp_path / "weights").mkdir()
        (tmp_path / "weights" / entry.weights.files[0].file).touch()
        with pytest.raises(WeightsError, match=r"c_centers\.pt are missing"):
            methods.model_of(name, entry)


def test_a_method_of_the_paper_that_names_no_weights_is_refused():
    entry = MethodEntry.model_validate(THUMBNAIL | {"kind": "paper", "dimension": 8448})
    for use in (methods.model_of, methods.fetch):
        with pytest.raises(WeightsError, match="salad: the manifest names no files of weights"):
            use("salad", entry)
    assert weights.state("salad", entry).status == "missing"


def test_builders_from_outside_bring_their_own_weights_or_take_those_of_the_manifest(tmp_path):
    bare = MethodEntry.model_validate(THUMBNAIL | {"kind": "paper", "builder": f"{__name__}:tiny"})
    assert isinstance(methods.model_of("own", bare), Tiny)
    assert weights.state("own", bare).status == "not needed"
    for kind in ("paper", "baseline"):
        entry = entry_of(tmp_path / kind, kind=kind)
        with pytest.raises(WeightsError, match="are missing"):
            methods.model_of("own", entry)
        put(entry, packed(state_of(3), tmp_path))
        assert equal(methods.model_of("own", entry).state_dict(), state_of(3))


def test_a_method_of_the_library_is_filled_without_being_initialised(tmp_path, monkeypatch):
    monkeypatch.setitem(methods._BUILDERS, "own", (f"{__name__}:on_meta", 1))
    entry = entry_of(tmp_path, builder=None)
    put(entry, packed(state_of(), tmp_path))
    assert equal(methods.model_of("own", entry).state_dict(), state_of())


def on_meta():
    model = Tiny()
    assert model.head.weight.is_meta
    return model


def test_a_real_method_with_a_checkpoint_equals_the_model_filled_with_it(tmp_path, monkeypatch):
    content = tiny_manifest()
    entry = manifest.load(REPOSITORY / "data_manifest.yaml").method("mixvpr").model_dump(exclude_none=True)
    del entry["weights"]["files"][0]["git_blob"]  # the weights are synthetic here
    entry["weights"]["folder"] = "weights"
    content["methods"]["mixvpr"] = entry
    write_manifest(tmp_path, content)
    monkeypatch.setenv("ARTIFACT_DATA_ROOT", str(tmp_path / "elsewhere"))
    monkeypatch.chdir(tmp_path)
    expected = filled(mixvpr)
    path = tmp_path / "elsewhere" / "weights" / "resnet50_MixVPR_4096_channels(1024)_rows(4).ckpt"
    path.parent.mkdir(parents=True)
    torch.save(expected.state_dict(), path)

    model = methods.load("mixvpr")
    assert equal(model.state_dict(), expected.state_dict())
    batch = images(320, 320)
    assert torch.equal(model(batch), expected(batch))
    assert path.with_name(f"{path.name}.lock.json").exists()

    cut = {key: value for key, value in expected.state_dict().items() if "row_proj" not in key}
    path.with_name(f"{path.name}.lock.json").unlink()
    torch.save(cut, path)
    with pytest.raises(WeightsError, match=r"2 missing: aggregator.row_proj.weight, aggregator.row_proj.bias"):
        methods.load("mixvpr")


# --- the manifest and the command line ---


def test_the_shipped_manifest_names_the_weights_of_every_method_of_the_paper():
    loaded = manifest.load(REPOSITORY / "data_manifest.yaml")
    assert [name for name, entry in loaded.methods.items() if entry.kind == "paper"] == list(PAPER_METHODS)
    files = [file.file for name in PAPER_METHODS for file in loaded.method(name).weights.files]
    assert len(set(files)) == len(files), "two methods with one file"
    for name in PAPER_METHODS:
        entry = loaded.method(name).weights
        assert entry.licence
        assert Path(entry.folder) == loaded.data_root / "weights"
        with torch.device("meta"):
            model = methods.build(name)
        parameters = {key: tensor.numel() for key, tensor in model.state_dict().items()}
        for file in entry.files:
            assert file.urls
            mine = (
                parameters.pop(file.tensor)
                if file.tensor
                else sum(parameters.values()) - sum(parameters[f.tensor] for f in entry.files if f.tensor)
            )
            assert file.megabytes == pytest.approx(4e-6 * mine, rel=0.02), file.file
    assert loaded.method("mixvpr").weights.files[0].git_blob == "21fb6324ecb5b3a048f948ab11c5083b85fe42d7"
    assert loaded.method("salad_cm").weights.files[0].container == "state_dict"


@pytest.mark.parametrize(
    ("change", "messages"),
    [
        ({"licence": None}, ["methods.own.weights.licence", "missing"]),
        ({"files": []}, ["methods.own.weights.files", "at least 1"]),
        ({"files": [{"file": "../a.pth"}]}, ["files.0.file", "'../a.pth'"]),
        ({"files": [{"file": "a", "urls": ["file:///etc/passwd"]}]}, ["files.0.urls.0", "'file:///etc/passwd'"]),
        ({"files": [{"file": "a", "sha256": "12ab"}]}, ["files.0.sha256", "'12ab'"]),
        ({"files": [{"file": "a", "md5": "12ab"}]}, ["files.0.md5: unknown key", "'sha256'"]),
        ({"files": [{"file": "a", "container": "model"}]}, ["files.0.container", "'flat', 'state_dict' or 'model_state_dict'"]),
        ({"files": [{"file": "a"}, {"file": "b"}]}, ["a file without the key 'tensor' is named twice"]),
        ({"files": [{"file": "a"}, {"file": "a", "tensor": "c"}]}, ["file 'a' is named twice"]),
    ],
)  # fmt: skip
def test_faults_in_the_weights_of_a_manifest_are_named(tmp_path, change, messages):
    content = tiny_manifest()
    named = {"files": [{"file": "a"}], "licence": "MIT"} | change
    content["methods"]["own"] = THUMBNAIL | {"weights": {k: v for k, v in named.items() if v is not None}}
    with pytest.raises(ManifestError) as caught:
        manifest.load(write_manifest(tmp_path, content))
    for message in messages:
        assert message in str(caught.value)


def test_data_shows_licence_and_terms_before_it_downloads_and_says_what_is_missing(tmp_path, server, capsys):
    file = project_with(tmp_path, server, state_of(1), state_of(2))
    shown = []
    page = server.pages["/0.pth"]
    page.asked = types.SimpleNamespace(append=lambda _: shown.append(capsys.readouterr().out))
    server.pages["/1.pth"].statuses = [404]
    arguments = ["--manifest", str(file), "--profile", "demo"]
    assert cli.main(["data", *arguments]) == 1
    before = "".join(shown)
    for text in (
        "weights of Tiny 0 (tiny0)",
        "licence: GPL-0.0",
        "licence: GPL-1.0",
        "terms: Ask first.",
        "tiny1.pth, about 0.1 MB, from http",
        "MB in all, ",
    ):
        assert text in before
    after = capsys.readouterr().out
    assert "weights of tiny0: present, tiny0.pth" in after
    assert "tiny1: no weights\ntiny1: tiny1.pth could not be downloaded" in after
    assert "the server answered 404" in after
    assert f"save it as {tmp_path / 'data' / 'weights' / 'tiny1.pth'}" in after

    assert cli.main(["status", *arguments]) == 0
    status = capsys.readouterr().out
    assert "weights of tiny0: present" in status
    assert "weights of tiny1: missing, tiny1.pth (about 0.1 MB)" in status
    assert "weights of thumbnail" not in status
    assert cli.main(["data", *arguments]) == 0
    again = capsys.readouterr().out
    assert "Tiny 0" not in again, "what is here is not announced again"
    assert "licence: GPL-1.0" in again
    assert cli.main(["status", *arguments]) == 0


def test_verify_finds_weights_that_changed_behind_their_time_stamp(tmp_path, server):
    loaded = manifest.load(project_with(tmp_path, server, state_of(1)))
    methods.fetch("tiny0", loaded.method("tiny0"), progress=False)
    lines, faults = verification.verify(loaded, "demo")
    assert faults == 0
    assert "1 files of weights, 0 changed" in lines
    path = tmp_path / "data" / "weights" / "tiny0.pth"
    stamp, content = path.stat().st_mtime_ns, bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    os.utime(path, ns=(stamp, stamp))
    lines, faults = verification.verify(loaded, "demo")
    assert faults == 1
    assert any(line.startswith(f"CHANGED   {path}") for line in lines)


def test_names_and_states_of_weights_need_no_torch():
    code = "import sys, artifact.methods, artifact.weights; artifact.methods.names(); sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
