"""Released weights: fetched whole or not at all, never taken for another method's, and unchanged from then on."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import re
import signal
import subprocess
import sys
import time
import types
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
import torch
from conftest import REPOSITORY, THUMBNAIL, tiny_manifest, write_images, write_manifest
from filled_weights import filled, images
from released import Aggregated, Tiny, entry_of, equal, names_in, packed, put, running, state_of

from artifact import datasets, manifest, methods, store
from artifact.book import notebooks
from artifact.commands import cli, verify
from artifact.datasets import download
from artifact.extraction import extract
from artifact.manifest.entries import ManifestError, MethodEntry
from artifact.methods import weights
from artifact.methods.weights import WeightsError

PAPER_METHODS = (
    "anyloc",
    "boq",
    "cosplace",
    "cricavpr",
    "eigenplaces",
    "megaloc",
    "mixvpr",
    "salad",
    "salad_cm",
    "selavpr",
    "selavprpp",
)


@pytest.fixture
def server():
    with running() as server:
        yield server


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


def test_a_killed_download_goes_on(tmp_path, server):
    """A process killed in the middle leaves nothing that looks complete, and the next one does not start anew."""
    content = packed(state_of() | {"filler": torch.zeros(200_000)}, tmp_path)
    url = server.serve("a.pth", content, slow=0.01)
    target, partial = tmp_path / "weights" / "tiny.pth", None
    code = (
        "import sys; from artifact.datasets import download; from pathlib import Path\n"
        "download.fetch(sys.argv[1], Path(sys.argv[2]), label='a', progress=False)"
    )
    partial = target.with_name(f".tiny.pth.{hashlib.sha256(url.encode()).hexdigest()[:8]}.partial")
    process = subprocess.Popen([sys.executable, "-c", code, url, str(partial)])
    deadline = time.monotonic() + 240
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
    entry = entry_of(tmp_path, {"urls": [server.serve("a.pth", content, ends_after=[500, 400] * 99, ranges=False)]})
    with pytest.raises(WeightsError, match=rf"ended after [45]00 of {len(content):,} bytes, in 5 attempts"):
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
    assert weights.lock._git_blob(tmp_path / "file") == digest


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


def test_a_folder_that_cannot_be_written_is_named(tmp_path, server, monkeypatch):
    entry = entry_of(tmp_path)
    put(entry, packed(state_of(), tmp_path))

    def refuse(*_):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr(store, "write_json", refuse)
    with pytest.raises(WeightsError, match=r"cannot write beside it \(Read-only file system\).*tiny.pth.lock.json"):
        methods.model_of("tiny", entry)


@pytest.mark.parametrize(
    ("change", "messages"),
    [
        (lambda state: state.pop("head.bias"), ["1 missing: head.bias"]),
        (lambda state: state.update(extra=torch.zeros(1)), ["1 unexpected: extra"]),
        (
            lambda state: state.update({"head.weight": torch.zeros(3, 15)}),
            ["1 of another shape: head.weight (3, 15) for (3, 16)"],
        ),
        (
            lambda state: state.update({"head.bias": torch.zeros(3, dtype=torch.int64)}),
            ["1 of another type: head.bias torch.int64 for torch.float32"],
        ),
        (
            lambda state: state.update({f"x{i}": torch.zeros(1) for i in range(25)}),
            ["25 unexpected: x0, ", "x19, and 5 more"],
        ),
        (
            lambda state: (state.clear(), state.update(a=torch.zeros(1))),
            ["7 missing: head.weight, head.bias", "1 unexpected: a"],
        ),
    ],
)
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
    entry = entry_of(tmp_path, *files, builder="released:aggregated")
    methods.fetch("tiny", entry, progress=False)
    assert equal(methods.model_of("tiny", entry).state_dict(), state | {"c_centers": centres})

    server.serve("b", packed(centres[:1], tmp_path))
    other = entry_of(tmp_path / "other", *files, builder="released:aggregated")
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
    return entry.model_copy(update={"weights": moved, "builder": "released:tiny"})


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
    assert json.loads(path.with_name("tiny.pth.lock.json").read_text())["stamp"] == [*store.stamp(path)]


def test_a_file_that_changed_behind_its_time_stamp_is_refused(tmp_path):
    entry = entry_of(tmp_path)
    path = put(entry, packed(state_of(), tmp_path))
    methods.model_of("tiny", entry)
    stamp, content = path.stat().st_mtime_ns, bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    os.utime(path, ns=(stamp, stamp))
    with pytest.raises(WeightsError, match=r"its SHA-256 is \w{64}, but \w{64} was recorded on"):
        methods.model_of("tiny", entry)


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
    digest_of_file = store.digest_of_file

    def only_sources(path):
        return digest_of_file(path) if path.suffix == ".py" else pytest.fail(f"{path} was read")

    monkeypatch.setattr(store, "digest_of_file", only_sources)
    methods.fingerprint("tiny", entry)
    weights.state("tiny", entry)


def project_with(tmp_path, server, *states):
    """A project whose methods tiny0, tiny1, ... have their weights on the server."""
    content = tiny_manifest()
    for number, state in enumerate(states):
        url = server.serve(f"{number}.pth", packed(state, tmp_path))
        content["methods"][f"tiny{number}"] = THUMBNAIL | {
            "title": f"Tiny {number}",
            "kind": "paper",
            "dimension": 3,
            "builder": "released:tiny",
            "weights": {
                "files": [{"file": f"tiny{number}.pth", "urls": [url], "megabytes": 0.1}],
                "licence": f"GPL-{number}.0",
                "terms": "Ask first.",
            },
        }
    content["profiles"]["demo"]["methods"] = ["thumbnail", *(f"tiny{number}" for number in range(len(states)))]
    for name, brightness in (("day", 0.0), ("night", -35.0)):
        write_images(tmp_path / "data" / "street" / name, 5, seed=1, brightness=brightness)
    return write_manifest(tmp_path, content)


def test_descriptors_are_made_with_the_weights_and_stay_readable_without(tmp_path, server):
    loaded = manifest.load(project_with(tmp_path, server, state_of(1), state_of(2)))
    day = datasets.load_traversal(loaded, "street", "day")
    task = notebooks.Task(tmp_path / "a.py", {}, ("street",), ("thumbnail", "tiny0", "tiny1"))
    with pytest.raises(WeightsError) as caught:
        notebooks.prepare(loaded, [task])
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
    bare = MethodEntry.model_validate(THUMBNAIL | {"kind": "paper", "builder": "released:tiny"})
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
    expected = filled(lambda: methods.build("mixvpr"))
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
        (
            {"files": [{"file": "a", "container": "model"}]},
            ["files.0.container", "'flat', 'state_dict' or 'model_state_dict'"],
        ),
        ({"files": [{"file": "a"}, {"file": "b"}]}, ["a file without the key 'tensor' is named twice"]),
        ({"files": [{"file": "a"}, {"file": "a", "tensor": "c"}]}, ["file 'a' is named twice"]),
    ],
)
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
    arguments = ["--manifest", str(file), "--profile", "demo", "--trust"]
    assert cli.main(["data", *arguments]) == 1
    before = "".join(shown)
    for text in (
        "weights of Tiny 0 (tiny0)",
        "licence: GPL-0.0",
        "licence: GPL-1.0",
        "terms: Ask first.",
        "tiny1.pth, about 100 kB, from http",
        "200 kB in all, ",
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
    assert "weights of tiny1: missing, tiny1.pth (about 100 kB)" in status
    assert "weights of thumbnail" not in status
    assert cli.main(["data", *arguments]) == 0
    again = capsys.readouterr().out
    assert "Tiny 0" not in again, "what is here is not announced again"
    assert "licence: GPL-1.0" in again
    assert cli.main(["status", *arguments]) == 0


def test_verify_finds_weights_that_changed_behind_their_time_stamp(tmp_path, server):
    loaded = manifest.load(project_with(tmp_path, server, state_of(1)))
    methods.fetch("tiny0", loaded.method("tiny0"), progress=False)
    lines, faults = verify.verify(loaded, "demo")
    assert faults == 0
    assert "1 files of weights, 0 changed" in lines
    path = tmp_path / "data" / "weights" / "tiny0.pth"
    stamp, content = path.stat().st_mtime_ns, bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    os.utime(path, ns=(stamp, stamp))
    lines, faults = verify.verify(loaded, "demo")
    assert faults == 1
    assert any(line.startswith(f"CHANGED   {path}") for line in lines)


def test_names_and_states_of_weights_need_no_torch():
    code = "import sys, artifact.methods, artifact.methods.weights; artifact.methods.names(); sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
