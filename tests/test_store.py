"""Keys follow content; files are whole or absent."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from artifact import store

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
    with pytest.raises(store.StoreError, match=r"a.json: cannot be read as JSON .*; delete it and run again"):
        store.read_json(tmp_path / "a.json")


def test_digests_are_remembered_until_a_file_changes(tmp_path, monkeypatch):
    files = [tmp_path / f"{i}.txt" for i in range(3)]
    for file in files:
        file.write_text(file.name)
    first = store.digest_of_files(files, tmp_path / "cache")
    assert first == store.digest_of_files(files)
    read = []
    original = store.digest_of_file
    monkeypatch.setattr(store, "digest_of_file", lambda path: read.append(path.name) or original(path))
    assert store.digest_of_files(files, tmp_path / "cache") == first
    assert read == []
    files[1].write_text("longer than before")
    assert store.digest_of_files(files, tmp_path / "cache")[1] != first[1]
    assert read == ["1.txt"]
