"""Keys follow content; files are whole or absent."""

import dataclasses
import errno
import hashlib
import os
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from artifact import store
from artifact.manifest import layout

values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


@given(st.dictionaries(st.text(min_size=1).filter(str.isidentifier), values, max_size=4))
def test_the_order_of_names_does_not_matter(inputs):
    assert store.key(**inputs) == store.key(**dict(reversed(list(inputs.items()))))


def test_keys_tell_values_types_orders_and_arrays_apart():
    @dataclasses.dataclass
    class Options:
        k: int

    different = [
        {"a": 1},
        {"a": 2},
        {"a": "1"},
        {"a": [1]},
        {"b": 1},
        {"a": True},
        {"a": None},
        {"a": [1, 2]},
        {"a": [2, 1]},
        {"a": np.zeros(3)},
        {"a": np.zeros(3, np.float32)},
        {"a": np.zeros((3, 1))},
        {"a": np.array([0, 0, 1.0])},
        {"a": Options(1)},
        {"a": Options(2)},
    ]
    assert len({store.key(**inputs) for inputs in different}) == len(different)
    assert store.key(a=np.arange(6.0)[::2]) == store.key(a=np.array([0.0, 2, 4]))
    with pytest.raises(TypeError, match="cannot make a content key from object"):
        store.key(a=object())


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path):
    path = tmp_path / "result.txt"
    path.write_text("old")
    with pytest.raises(RuntimeError), store.replacing(path) as temporary:
        temporary.write_text("half")
        raise RuntimeError
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["result.txt"]
    with store.replacing(path) as temporary:
        temporary.write_text("new")
    assert path.read_text() == "new"


def test_arrays_come_back_only_under_their_key_and_with_their_sidecar(tmp_path):
    path = tmp_path / "ranks.npz"
    arrays = {"a": np.arange(3), "b": np.array(["x", "yz"])}
    store.save_arrays(path, arrays, {"key": "k1"})
    for name, value in store.load_arrays(path, "k1").items():
        np.testing.assert_array_equal(value, arrays[name])
    assert store.load_arrays(path, "k2") is None
    path.with_suffix(".json").unlink()
    assert store.load_arrays(path, "k1") is None


def test_broken_json_is_named(tmp_path):
    (tmp_path / "a.json").write_text("{")
    with pytest.raises(store.StoreError, match=r"a.json: cannot be read as JSON "):
        store.read_json(tmp_path / "a.json")


def test_digests_are_remembered_until_a_file_changes(tmp_path, monkeypatch):
    files = [tmp_path / f"{i}.txt" for i in range(3)]
    for file in files:
        file.write_text(file.name)
    first = store.digest_of_files(files, tmp_path / "cache")
    assert first == store.digest_of_files(files)
    assert not list((tmp_path / "cache").rglob("*.json")), "what was written just now may be written again unnoticed"
    monkeypatch.setattr(store, "_SETTLED", -1)
    store.digest_of_files(files, tmp_path / "cache")
    read, original = [], store.digest_of_file
    monkeypatch.setattr(store, "digest_of_file", lambda path: read.append(path.name) or original(path))
    assert store.digest_of_files(files, tmp_path / "cache") == first
    assert read == []
    files[1].write_text("longer than before")
    assert store.digest_of_files(files, tmp_path / "cache")[1] != first[1]
    assert read == ["1.txt"]
    read.clear()
    for change in (replaced_by_another, written_in_place):
        times = files[2].stat().st_atime_ns, files[2].stat().st_mtime_ns
        change(files[2], f"{change.__name__[0]}.txt")
        os.utime(files[2], ns=times)
        assert store.digest_of_files(files, tmp_path / "cache")[2] == hashlib.sha256(files[2].read_bytes()).hexdigest()
    assert read == ["2.txt", "2.txt"], "of equal size and modification time"


def replaced_by_another(path, text):
    path.with_suffix(".new").write_text(text)
    path.with_suffix(".new").replace(path)


def written_in_place(path, text):
    path.write_text(text)


@pytest.fixture
def settled(monkeypatch):
    """Digests are remembered though the files were written just now."""
    monkeypatch.setattr(store, "_SETTLED", -1)


DAMAGED_MEMORY = ["", "{", "[]", "3", '{"FILE": 3}', '{"FILE": []}', "null", '{"checksum": "0"}', "[" * 100_000, "\0"]


@pytest.mark.parametrize("damage", DAMAGED_MEMORY)
def test_damaged_memory_of_digests_is_forgotten(tmp_path, damage, settled, capsys):
    file = tmp_path / "a.png"
    file.write_bytes(b"image")
    expected = store.digest_of_files([file], tmp_path / "cache")
    memory = next((tmp_path / "cache" / "digests").glob("*.json"))
    memory.write_text(damage.replace("FILE", str(file)))
    assert store.digest_of_files([file], tmp_path / "cache") == expected
    assert str(file) in memory.read_text()
    told = capsys.readouterr().err.splitlines()
    if "FILE" not in damage:  # a value of another form is no damage that could be told from an older form
        assert len(told) == 1
        assert told[0].startswith(f"{memory}: ")
        assert told[0].endswith(f"it is set aside as {memory.name}.damaged and made again")


def test_a_flipped_digit_in_the_memory_of_digests_is_noticed(tmp_path, settled):
    file = tmp_path / "a.png"
    file.write_bytes(b"image")
    (expected,) = store.digest_of_files([file], tmp_path / "cache")
    memory = next((tmp_path / "cache" / "digests").glob("*.json"))
    memory.write_text(memory.read_text().replace(expected[:8], "00000000"))
    assert store.digest_of_files([file], tmp_path / "cache") == [expected]


def test_a_file_that_changed_without_being_written_is_found_and_counts_as_it_is(tmp_path, settled):
    files = [tmp_path / f"{i}.txt" for i in range(3)]
    for file in files:
        file.write_text(file.name)
    digests, cache = store.digest_of_files(files, tmp_path / "cache"), tmp_path / "cache"
    assert store.changed_in_silence(files, cache) == []
    memory = next((cache / "digests").glob("*.json"))
    kept = store.read_json(memory)
    kept[str(files[1])][-1] = "0" * 64  # as if the disk had changed the file since
    store.write_json(memory, kept)
    assert store.digest_of_files(files, cache)[1] == "0" * 64
    assert store.changed_in_silence(files, cache) == [files[1]]
    assert store.digest_of_files(files, cache) == digests


# -- records ----------------------------------------------------------------------------------------------------------


def every_bit_flipped(content):
    for place in range(8 * len(content)):
        flipped = bytearray(content)
        flipped[place // 8] ^= 1 << place % 8
        yield bytes(flipped)


def test_every_flipped_bit_of_a_result_and_of_its_record_is_noticed(tmp_path):
    path, record = tmp_path / "ranks.npz", {"key": "k", "n": 12.5, "names": ["ä", None]}
    path.write_bytes(b"numbers")
    sealed = store.seal(path, record)
    assert store.check(path) == store.check(path, "k") == sealed
    assert store.check(path, "another") is None
    for file in (path, path.with_suffix(".json")):
        whole, unnoticed = file.read_bytes(), 0
        for flipped in every_bit_flipped(whole):
            file.write_bytes(flipped)
            try:
                assert store.check(path) == sealed or b'"checksum"' not in flipped
            except store.StoreError:
                continue
            unnoticed += 1
        assert unnoticed <= 8 * len("checksum") * (file.suffix == ".json"), "but in the name of the checksum itself"
        file.write_bytes(whole)


@pytest.mark.parametrize(
    ("error", "cause"),
    [
        (OSError(errno.ENOSPC, "No space left on device"), "No space left on device"),
        (OSError("16 requested and 8 written"), "16 requested and 8 written"),  # so NumPy says it, without a number
    ],
)
def test_a_full_disk_is_said_with_its_cause_and_what_to_do(error, cause):
    with pytest.raises(store.StoreError) as caught, store.writing(Path("ranks.npz")):
        raise error
    line = f"ranks.npz: cannot be written ({cause}). What is finished stays: make room, or make it writable, or "
    assert str(caught.value).startswith(line)


@pytest.mark.parametrize("record", ["[1, 2]", '"sha256"', "7", "null", "{}", '{"key": "k"}'])
def test_what_is_no_record_is_damage(tmp_path, record):
    path = tmp_path / "ranks.npz"
    path.write_bytes(b"numbers")
    store.record_path(path).write_text(record)
    with pytest.raises(store.DamagedError, match=r"ranks\.json: is no record of ranks\.npz"):
        store.check(path)


@pytest.mark.parametrize("damage", [b"", b"half a res", None])
def test_a_damaged_file_in_a_folder_is_noticed_and_the_folder_set_aside(tmp_path, damage, capsys):
    folder = tmp_path / "images"
    folder.mkdir()
    for name in ("a.jpg", "b.jpg"):
        (folder / name).write_bytes(b"whole result")
    store.seal(folder, {"key": "k"})
    assert store.find(folder, cache=tmp_path / "cache")["key"] == "k"
    if damage is None:
        (folder / "b.jpg").unlink()
    else:
        (folder / "b.jpg").write_bytes(damage)
    assert store.find(folder, cache=tmp_path / "cache") is None
    assert not folder.exists()
    assert (tmp_path / "images.damaged" / "a.jpg").exists()
    line = f"{folder}: its content differs from its record (b.jpg); it is set aside as images.damaged and made again\n"
    assert capsys.readouterr().err == line


def test_arrays_that_are_damaged_are_set_aside(tmp_path, capsys):
    path = tmp_path / "ranks.npz"
    for damage in (b"", path.name.encode(), None):
        store.save_arrays(path, {"a": np.arange(3)}, {"key": "k"})
        path.write_bytes(path.read_bytes()[:-1] + b"!" if damage is None else damage)
        assert store.load_arrays(path, "k") is None
        assert sorted(p.name for p in tmp_path.iterdir()) == ["ranks.npz.damaged"]
    assert capsys.readouterr().err.count("its content differs from its record; it is set aside") == 3


def test_lines_of_notebooks_go_to_the_run_and_not_into_the_page(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv(store.LOG_VARIABLE, str(tmp_path / "log"))
    store.say("one")
    store.say("two")
    assert (tmp_path / "log").read_text() == "one\ntwo\n"
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("error", [errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES])
def test_a_file_that_cannot_be_written_is_told_in_one_line(tmp_path, monkeypatch, error):
    def full(*_, **__):
        raise OSError(error, os.strerror(error))

    for name, write in (
        ("fsync", lambda: store.write_json(tmp_path / "a.json", {})),
        ("replace", lambda: store.write_json(tmp_path / "a.json", {})),
        ("open", lambda: store.write_json(tmp_path / "a.json", {})),  # no inode: the temporary file cannot be made
        ("open", lambda: store.lock(tmp_path / "b").__enter__()),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(os, name, full)
            with pytest.raises(store.StoreError, match=rf"{os.strerror(error)}\). What is finished stays: make room"):
                write()
    assert not [path for path in tmp_path.iterdir() if path.suffix == ".json"]


def test_whoever_waits_for_a_lock_says_so(tmp_path, capsys):
    with store.lock(tmp_path / "pages", "waiting for another"):
        assert capsys.readouterr().err == ""
        waiting = threading.Thread(target=lambda: store.lock(tmp_path / "pages", "waiting for another").__enter__())
        waiting.start()
        deadline = time.monotonic() + 120
        told = ""
        while not told and time.monotonic() < deadline:
            told = capsys.readouterr().err
        assert told == "waiting for another\n"
    waiting.join()


def test_what_killed_runs_left_is_swept_up_after_a_day(tmp_path):
    folder = tmp_path / "city" / ".abc-xyz.partial"
    folder.mkdir(parents=True)
    old, young = tmp_path / ".a.npz.abc.tmp.npz", tmp_path / ".b.npz.abc.tmp.npz"
    for file in (old, young, tmp_path / "a.npz", folder / "0.jpg"):
        file.write_bytes(b"")
    for file, hours in ((old, 25), (tmp_path / "a.npz", 25), (folder, 25), (young, 23)):
        os.utime(file, (time.time() - 3600 * hours,) * 2)
    store.sweep(tmp_path)
    assert sorted(p.name for p in tmp_path.rglob("*")) == [young.name, "a.npz", "city"]


def test_what_is_removed_leaves_nothing_of_its_own_and_all_of_others(tmp_path):
    for name in ("ranks.npz", "ranks.json", "ranks.npz.damaged", "other.npz", "other.json"):
        (tmp_path / name).write_bytes(b"{}")
    for name in ("images", "images.damaged", "others"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "0.jpg").write_bytes(b"")
    for name in ("ranks.npz", "images", "images"):  # what is not there any more needs no removal
        store.remove(tmp_path / name)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["other.json", "other.npz", "others"]


def test_the_time_of_a_stage_is_reported_where_it_can_be(tmp_path, monkeypatch):
    monkeypatch.setenv(store.TIMES_VARIABLE, str(tmp_path / "times.csv"))
    with store.stage("rank"):
        pass
    assert (tmp_path / "times.csv").read_text().startswith("rank,0.0")
    monkeypatch.setenv(store.TIMES_VARIABLE, str(tmp_path / "another machine" / "times.csv"))
    with store.stage("rank"):  # a worker that inherited the variable goes on
        pass


def test_names_below_a_folder_are_those_of_its_files_but_hidden_ones(tmp_path):
    inside = tmp_path / "inside"
    for name in (
        "a.jpg",
        "b/c.JPG",
        "b/d/e f.png",
        ".hidden.jpg",
        ".folder/a.jpg",
        "b/.x",
        "__MACOSX/a.jpg",
        "notes.txt",
    ):
        place = inside / name
        place.parent.mkdir(parents=True, exist_ok=True)
        place.touch()
    (inside / "link.jpg").symlink_to(inside / "a.jpg")
    (inside / "gone.jpg").symlink_to(tmp_path / "nowhere.jpg")
    (inside / "linked").symlink_to(inside / "b")
    os.mkfifo(inside / "pipe.jpg")
    shown = {path for path in inside.rglob("*") if path.is_file()}
    expected = {path.relative_to(inside).as_posix() for path in shown}
    expected = {name for name in expected if not any(part.startswith(".") for part in name.split("/"))}
    found = layout.names_below(inside)
    assert len(found) == len(set(found)) == 6
    assert set(found) == expected
    images, others = layout.files_below(inside)
    assert sorted(images) == ["a.jpg", "b/c.JPG", "b/d/e f.png", "link.jpg"]
    assert others == ["notes.txt"]
    assert layout.names_below(tmp_path / "nowhere") == layout.names_below(inside / "a.jpg") == []
