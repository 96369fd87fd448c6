"""A run may die at any system call, and the power may go: what is stored is whole and right, or not there."""

import io
import os
import shutil
import subprocess
import sys

import numpy as np
import pytest
from jupyter_client import AsyncKernelManager

from artifact import store
from artifact.book import notebooks, runner
from artifact.extraction.parts import Parts, assemble
from artifact.manifest import Manifest

both = pytest.mark.parametrize("power", [False, True], ids=["killed", "power lost"])
OLD, NEW = b"old" * 5000, b"new content" * 3000
SYSTEM = {"posix", "nt", "io", "_io", "fcntl"}


def is_system_call(function):
    return getattr(function, "__module__", None) in SYSTEM or isinstance(getattr(function, "__self__", None), io.IOBase)


def states_of(work, folder, *, power):
    """Do a piece of work; return what a folder holds at the beginning and end of each of its system calls, by path.

    That is what a process leaves that is killed there: what it has not handed to the system is lost. With ``power`` a file
    holds what it held when it was last brought to disk.
    """
    files = lambda: [path for path in folder.rglob("*") if path.is_file()]  # noqa: E731
    synced = {path.stat().st_ino: path.read_bytes() for path in files()}
    states, fsync = [], os.fsync

    def bring(descriptor):
        fsync(descriptor)
        inode = os.fstat(descriptor).st_ino
        synced[inode] = next(path for path in files() if path.stat().st_ino == inode).read_bytes()

    def look(_, event, function):
        if event in ("c_call", "c_return") and is_system_call(function):
            held = {path: synced.get(path.stat().st_ino, b"") if power else path.read_bytes() for path in files()}
            if held not in states:
                states.append(held)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", bring)
        sys.setprofile(look)
        try:
            work()
        finally:
            sys.setprofile(None)
    return states


def check_states(work, folder, check, *, power):
    """Check what is in a folder after a crash at each system call of a piece of work, and after all of it."""
    states = states_of(work, folder, power=power)
    assert len(states) > 3
    for state in states:
        empty(folder)
        for path, content in state.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            write(path, content)
        check()


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "cache").mkdir()
    return tmp_path / "cache"


def empty(folder):
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()


def write(path, content):
    with path.open("wb") as stream:
        stream.write(content)
        os.fsync(stream.fileno())


@both
def test_a_file_that_is_replaced_is_the_old_one_or_the_new_one(folder, power):
    path, seen = folder / "result.txt", set()
    write(path, OLD)

    def work():
        with store.replacing(path) as temporary, temporary.open("wb") as stream:
            for start in range(0, len(NEW), 10_000):
                stream.write(NEW[start : start + 10_000])

    check_states(work, folder, lambda: seen.add(path.read_bytes()), power=power)
    assert seen == {OLD, NEW}


@both
def test_json_is_the_old_one_or_the_new_one(folder, power):
    path, old, new = folder / "a.json", {"a": 1}, {"a": list(range(5000))}
    store.write_json(path, old)
    seen = []
    work = lambda: store.write_json(path, new)  # noqa: E731
    check_states(work, folder, lambda: seen.append(store.read_json(path)), power=power)
    assert all(found in (old, new) for found in seen)
    assert seen[0] == old
    assert seen[-1] == new


@both
def test_arrays_are_there_whole_or_not_at_all(folder, power):
    """Also where an array file of another run lies in the place, whose record was never written."""
    path, arrays, seen = folder / "ranks.npz", {"a": np.arange(3000.0), "b": np.array(["x", "yz"])}, []
    np.savez(path, a=np.zeros(3000), b=np.array(["", ""]))

    def check():
        loaded = store.load_arrays(path, "key")
        seen.append(loaded is not None)
        if loaded is not None:
            assert loaded.keys() == arrays.keys()
            for name, value in arrays.items():
                np.testing.assert_array_equal(loaded[name], value)

    check_states(lambda: store.save_arrays(path, arrays, {"key": "key"}), folder, check, power=power)
    assert seen == sorted(seen)
    assert set(seen) == {False, True}


@both
def test_remembered_digests_are_right_or_forgotten(folder, tmp_path, power, monkeypatch):
    monkeypatch.setattr(store, "_SETTLED", -1)  # they are remembered though the files were written just now
    files = [tmp_path / f"{number}.png" for number in range(3)]
    for file in files:
        file.write_bytes(file.name.encode())
    expected = store.digest_of_files(files)

    def check():
        assert store.digest_of_files(files, folder) == expected

    check_states(lambda: store.digest_of_files(files, folder), folder, check, power=power)


ROWS = np.random.default_rng(0).standard_normal((5, 300)).astype(np.float32)


def parts_in(folder):
    return Parts(folder / "parts", "key", 2, 5, (300,), "float32")


def nothing():
    pytest.fail("asked to make what is there")


def write_part(parts, number):
    parts.write(number, [row[None] for row in ROWS[parts.rows(number)]], {"device": "cpu"})


@both
def test_a_part_counts_only_when_it_is_whole(folder, power):
    """Also where the array of a killed run lies in its place without a record."""
    parts, seen = parts_in(folder), []
    write_part(parts, 0)
    np.save(parts.path(1), np.zeros((2, 300), np.float32))

    def check():
        seen.append(parts.has(1))
        assert parts.has(0)
        assert not parts.has(2)
        if parts.has(1):
            np.testing.assert_array_equal(parts.read(1, nothing), ROWS[2:4])
            assert parts.record(1)["device"] == "cpu"

    check_states(lambda: write_part(parts, 1), folder, check, power=power)
    assert seen == sorted(seen)
    assert set(seen) == {False, True}


@both
def test_parts_become_one_file_or_none(folder, power):
    parts, path = parts_in(folder), folder / "all.npy"
    for number in range(3):
        write_part(parts, number)

    def check():
        assert parts.missing() == []
        if path.exists():
            np.testing.assert_array_equal(np.load(path), ROWS)

    check_states(lambda: assemble(parts, path, nothing), folder, check, power=power)
    assert path.exists()


@both
def test_a_notebook_counts_only_when_it_is_whole(folder, power, monkeypatch):
    manifest = Manifest(folder / "data_manifest.yaml", folder, {}, {}, {})
    task, runs = notebooks.Task(folder / "page.py", {}, (), ()), []

    def execute(task, path, manager):
        runs.append(path)
        with store.replacing(path) as temporary:
            temporary.write_bytes(NEW)

    monkeypatch.setattr(runner, "_execute", execute)

    def work():
        return runner._run_one(manifest, task, "k" * 64, AsyncKernelManager)

    def check():
        runs.clear()
        outcome = work()
        assert outcome.cached == (not runs)
        assert outcome.stored.read_bytes() == NEW

    check_states(work, folder, check, power=power)
    assert not runs, "after all of it nothing is run again"


def test_a_lock_is_held_by_one_process_at_a_time(folder):
    path = folder / "result"
    code = "import sys; from pathlib import Path; from artifact import store; print(1, flush=True)\n"
    code += "with store.lock(Path(sys.argv[1])): print(Path(sys.argv[1]).read_text())"
    with store.lock(path):
        path.write_text("begun")
        command = [sys.executable, "-c", code, str(path)]
        other = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert other.stdout.readline() == "1\n"
        for _ in range(20):
            with pytest.raises(subprocess.TimeoutExpired):
                other.wait(0.02)
        path.write_text("done")
    assert other.communicate()[0] == "done\n"
