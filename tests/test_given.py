"""Datasets that come as descriptors, without images; and the rehearsal, which is made of them."""

from pathlib import Path

import numpy as np
import pytest
from conftest import STREET, flip, tiny_manifest, write_manifest

from artifact import datasets, evaluate, manifest
from artifact.datasets import DatasetError
from artifact.extraction import extract, made
from artifact.studies import evaluated, reported


@pytest.fixture
def given(tmp_path):
    """A manifest with two traversals of ten images that are known by their descriptors alone."""
    rng = np.random.default_rng(0)
    entry = STREET | {"traversals": {}}
    arrays = {}
    for name in ("day", "night"):
        folder = tmp_path / "data" / "street"
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"{name}.csv").write_text("\n".join(["image,index", *(f"{i}.png,{i}" for i in range(10))]))
        arrays[name] = rng.normal(size=(10, 8)).astype(np.float32)
        np.save(folder / f"{name}.npy", arrays[name])
        entry["traversals"][name] = {"condition": name, "descriptors": {"hog": f"{name}.npy"}}
    write_manifest(tmp_path, tiny_manifest(street=entry))
    return tmp_path, arrays


def test_descriptors_alone_are_a_dataset(given):
    project, arrays = given
    loaded = manifest.load(project / "data_manifest.yaml")
    traversal = datasets.load_traversal(loaded, "street", "day")
    assert (len(traversal), traversal.has_images) == (10, False)
    found = extract.descriptors(loaded, traversal, "hog")
    assert found.source == "given descriptors"
    np.testing.assert_array_equal(found.values, arrays["day"])
    measured = evaluated.evaluation(loaded, "street", "hog").evaluation
    where = np.arange(10.0)[:, None]
    expected = evaluate(arrays["day"], arrays["night"], where, where, 1.0)
    assert (measured.recall(1), measured.dar(1)) == (expected.recall(1), expected.dar(1))


def test_other_descriptors_are_another_dataset(given):
    project, arrays = given
    loaded = manifest.load(project / "data_manifest.yaml")
    before = datasets.load_traversal(loaded, "street", "day").digest
    np.save(project / "data" / "street" / "day.npy", arrays["day"] + 1)
    assert datasets.load_traversal(loaded, "street", "day").digest != before


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (np.zeros((9, 8), np.float32), r"day.npy: 9 rows for the 10 images of street/day"),
        (np.zeros((10, 8), np.float64), r"day.npy: holds float64 \(10, 8\); allowed: float32 or float16 of \(n, d\)"),
        (np.full((10, 8), np.nan, np.float32), "day.npy: has NaN or infinite values"),
        (np.array([object()] * 10), "day.npy: cannot be read as a NumPy array"),
    ],
)
def test_bad_descriptors_are_named(given, values, message):
    project, _ = given
    np.save(project / "data" / "street" / "day.npy", values)
    loaded = manifest.load(project / "data_manifest.yaml")
    with pytest.raises(DatasetError, match=message):
        extract.descriptors(loaded, datasets.load_traversal(loaded, "street", "day"), "hog")


def test_a_missing_file_is_named(given):
    project, _ = given
    (project / "data" / "street" / "day.npy").unlink()
    loaded = manifest.load(project / "data_manifest.yaml")
    with pytest.raises(DatasetError, match=r"street/day: no file .*day.npy, which the manifest names"):
        datasets.load_traversal(loaded, "street", "day")


# -- the rehearsal --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def rehearsal(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ARTIFACT_CACHE", str(tmp_path_factory.mktemp("cache")))
        loaded = manifest.load().for_profile("rehearsal")
        made.make(loaded, "rehearsal")
        yield loaded


def test_made_descriptors_come_near_the_papers_numbers(rehearsal):
    entry = rehearsal.profile("rehearsal")
    paper = reported.table("fig05").set_index(["dataset", "method"])
    off = {"R": [], "DAR": []}
    for dataset in entry.datasets:
        for method in entry.methods:
            found = evaluated.evaluation(rehearsal, dataset, method).evaluation
            off["R"].append(abs(100 * found.recall(1) - paper.loc[(dataset, method), "recall_percent"]))
            off["DAR"].append(abs(100 * found.dar(1) - paper.loc[(dataset, method), "dar_percent"]))
    for values in off.values():
        assert np.median(values) < 1
        assert max(values) < 12


def test_made_values_are_never_called_real(rehearsal):
    loaded = datasets.load(rehearsal, "robotcar")
    assert not loaded.real
    assert datasets.load(rehearsal, "robotcar").query.image_names[0] == "00000"
    assert all(not t.has_images for t in loaded.traversals.values())


def test_as_many_made_queries_stray_as_the_paper_leaves_out():
    entry = manifest.load().dataset("robotcar")
    along, positions = made.route(entry, entry.query, entry.paper.queries)
    off = along > 1e4
    assert off.sum() == entry.paper.queries - entry.paper.evaluated == 34
    assert np.linalg.norm(positions[off], axis=1).min() > 10 * np.linalg.norm(positions[~off], axis=1).max()


def test_the_condition_of_every_made_traversal_is_as_strong(rehearsal):
    for name in rehearsal.profile("rehearsal").datasets:
        entry = rehearsal.dataset(name)
        for traversal in entry.traversals:
            assert np.linalg.norm(made._kind(entry, traversal)) == pytest.approx(1, abs=0.02), (name, traversal)


def test_made_files_that_are_damaged_are_made_again(rehearsal, capsys):
    folder = Path(str(rehearsal.dataset("svox").root))
    described = rehearsal.dataset("svox").traversals[rehearsal.dataset("svox").query]
    paths = [folder / str(described.positions_file)]
    paths += [folder / next(iter(files.values())) for files in (described.descriptors, described.second_stage)]
    before = [path.read_bytes() for path in paths]
    for path in paths:
        flip(path)
    made.make(rehearsal, "rehearsal")
    assert [path.read_bytes() for path in paths] == before
    told = capsys.readouterr().err.splitlines()
    assert [line.partition(" is set aside as ")[2] for line in told] == [
        f"{path.name}.damaged and made again" for path in paths
    ]


def test_kind_made_is_not_for_manifests(tmp_path):
    path = write_manifest(tmp_path, tiny_manifest(street=STREET | {"kind": "made"}))
    with pytest.raises(manifest.ManifestError, match="found kind 'made', which a profile with 'made: true' makes"):
        manifest.load(path)
