"""Checkpoints: nothing in a file is run, and damage never passes unnoticed."""

from __future__ import annotations

import os
import pickle
import re
import subprocess
import sys
import types
from collections import OrderedDict
from pathlib import Path

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from released import Tiny, entry_of, equal, names_in, packed, put, running, state_of
from safetensors.torch import save_file
from torch import nn

from artifact import methods
from artifact.methods.weights import WeightsError, checkpoints
from artifact.methods.weights.checkpoints import CheckpointError


@pytest.fixture
def server():
    with running() as server:
        yield server


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
)
def test_content_that_is_no_weights_is_refused(tmp_path, content, message):
    (tmp_path / "file").write_bytes(packed(content, tmp_path))
    with pytest.raises(CheckpointError, match=message):
        checkpoints.read(tmp_path / "file")


@pytest.mark.filterwarnings("ignore:The PyTorch API of nested tensors")
@pytest.mark.parametrize("layout", [torch.strided, torch.jagged])
def test_a_nested_tensor_is_refused(tmp_path, layout):
    content = torch.nested.nested_tensor([torch.zeros(2, 3), torch.zeros(1, 3)], layout=layout)
    refused_everywhere(tmp_path, content, "holds no weights, but entries such as head.weight|cannot be read")


def test_a_tensor_that_claims_more_than_its_file_holds_is_refused(tmp_path):
    refused_everywhere(
        tmp_path, torch.zeros(1).expand(10**12, 3), r"head.weight claims 12,000,000,000,000 bytes in a file"
    )
    save_file({"a": torch.zeros(4)}, tmp_path / "safe")  # what fills its file exactly is not refused
    assert checkpoints.read(tmp_path / "safe")["a"].shape == (4,)


def refused_everywhere(folder, harmful, message):
    """Refused among other tensors and alone, by the reader and in a method, in one line and unrecorded."""
    for content, keys in ((state_of() | {"head.weight": harmful}, {}), (harmful, {"tensor": "head.weight"})):
        entry = entry_of(folder, keys)
        path = put(entry, packed(content, folder))
        with pytest.raises(CheckpointError, match=message) as caught:
            checkpoints.read(path, **keys)
        assert "\n" not in str(caught.value)
        with pytest.raises(WeightsError, match=message):
            methods.model_of("tiny", entry)
        assert names_in(path.parent) == {path.name}


def test_a_directory_in_place_of_the_file_is_refused(tmp_path, server):
    with pytest.raises(CheckpointError, match=r"^cannot be read \(IsADirectoryError.*$"):
        checkpoints.read(tmp_path)
    entry = entry_of(tmp_path, {"urls": [server.serve("a", b"")]})
    (tmp_path / "weights" / "tiny.pth").mkdir(parents=True)
    for use in (methods.model_of, methods.fetch, methods.fingerprint):
        with pytest.raises(WeightsError, match=r"tiny.pth: cannot be read \(Is a directory\); a file .* is needed"):
            use("tiny", entry)


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
