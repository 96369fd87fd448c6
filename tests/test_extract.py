"""Extraction: complete or resumable at any moment, and every bad image named."""

import contextlib
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import torch
from conftest import HOG, THUMBNAIL, tiny_manifest, write_images, write_manifest
from torch import nn

from artifact import datasets, extract, manifest, partial, store
from artifact.extract import ExtractionError

WORKERS = pytest.mark.parametrize("workers", [0, 2])


def load(project):
    loaded = manifest.load(project / "data_manifest.yaml")
    return loaded, datasets.load_traversal(loaded, "street", "day")


def direct(traversal, entry, name):
    """Descriptors computed image by image, without the pipeline."""
    from artifact import methods
    from artifact.images import read_image
    from artifact.methods.preprocessing import prepare

    model = methods.build(name)
    images = [
        prepare(read_image(path, entry.preprocessing.colour), entry.preprocessing) for path in traversal.image_paths()
    ]
    with torch.inference_mode():
        return torch.cat([model(image[None]) for image in images]).numpy()


@WORKERS
@pytest.mark.parametrize("method", ["thumbnail", "hog"])
def test_descriptors_equal_the_model_on_each_image(project, method, workers):
    loaded, traversal = load(project)
    found = extract.descriptors(loaded, traversal, method, workers=workers)
    np.testing.assert_allclose(found.values, direct(traversal, loaded.method(method), method), atol=1e-6)
    assert found.source == "images"
    np.testing.assert_allclose(np.linalg.norm(found.values, axis=1), 1, atol=1e-5)
    assert found.sidecar["images"] == traversal.digest
    assert not list((project / ".cache").rglob("*.partial.npy"))
    assert not list((project / ".cache").rglob("*.journal.json"))


def test_a_stored_result_is_used_only_while_its_key_is_equal(project, monkeypatch):
    loaded, traversal = load(project)
    first = extract.descriptors(loaded, traversal, "hog", workers=0)
    monkeypatch.setattr(extract, "_extract", lambda *a, **k: pytest.fail("extracted again"))
    assert extract.descriptors(loaded, traversal, "hog", workers=0).sha256 == first.sha256
    changed = tiny_manifest()
    changed["methods"]["hog"]["preprocessing"]["size"] = [48, 64]
    changed["methods"]["hog"]["dimension"] = 216
    other = manifest.load(write_manifest(project, changed))
    assert extract.descriptor_key(traversal, "hog", other.method("hog")) != first.key
    (project / "data" / "street" / "day" / "frame3.png").write_bytes(
        (project / "data" / "street" / "day" / "frame4.png").read_bytes()
    )
    assert (
        extract.descriptor_key(datasets.load_traversal(loaded, "street", "day"), "hog", loaded.method("hog"))
        != first.key
    )


@WORKERS
def test_all_broken_images_are_named_before_anything_is_complete(project, workers):
    folder = project / "data" / "street" / "day"
    (folder / "frame1.png").write_bytes(b"not an image")
    (folder / "frame7.png").write_bytes((folder / "frame2.png").read_bytes()[:900])
    (folder / "frame11.png").write_bytes(b"")
    loaded, traversal = load(project)
    with pytest.raises(ExtractionError) as caught:
        extract.descriptors(loaded, traversal, "thumbnail", workers=workers)
    text = str(caught.value)
    assert "3 of 12 images cannot be read" in text
    for name in ("frame1.png", "frame7.png", "frame11.png"):
        assert str(folder / name) in text
    path = extract.stored_path(
        loaded, "thumbnail", extract.descriptor_key(traversal, "thumbnail", loaded.method("thumbnail"))
    )
    assert not path.exists()
    assert not path.with_suffix(".json").exists()


def test_an_image_without_contrast_is_named(project):
    from PIL import Image

    Image.new("RGB", (64, 48), (90, 90, 90)).save(project / "data" / "street" / "day" / "frame5.png")
    loaded, traversal = load(project)
    with pytest.raises(ExtractionError, match=r"of length 1; these images have other lengths: frame5.png \(0\)"):
        extract.descriptors(loaded, traversal, "thumbnail", workers=0)


def test_a_wrong_dimension_in_the_manifest_is_named(project):
    content = tiny_manifest()
    content["methods"]["hog"]["dimension"] = 7
    loaded = manifest.load(write_manifest(project, content))
    with pytest.raises(ExtractionError, match=r"the shape \(5, 108\) for 5 images; the manifest says dimension 7"):
        extract.descriptors(loaded, datasets.load_traversal(loaded, "street", "day"), "hog", workers=0)


# -- interruption ---------------------------------------------------------------------------------------------------

SLOW = """
import sys, time
from artifact import datasets, extract, manifest, methods, partial
from artifact.methods.hog import HOG
class Slow(HOG):
    def forward(self, images):
        time.sleep(0.05)
        return super().forward(images)
if __name__ == "__main__":
    partial.JOURNAL_SECONDS = float(sys.argv[1])
    methods.model_of = lambda name, entry: Slow().eval()
    loaded = manifest.load("data_manifest.yaml")
    extract.descriptors(loaded, datasets.load_traversal(loaded, "street", "day"), "hog", workers=0)
"""


def rows_done(path):
    """Rows that the journals of a result say are on disk."""
    records = []
    for journal in path.parent.glob(f"{path.stem}.journal*.json"):
        with contextlib.suppress(store.StoreError):  # deleted in between
            records += store.read_json(journal)["rows"]
    return sum(stop - first for first, stop in records)


def test_killed_at_any_moment_and_resumed_the_bytes_are_the_same(project):
    write_images(project / "data" / "street" / "day", 120, seed=5)
    (project / "slow.py").write_text(SLOW)
    loaded, traversal = load(project)
    path = extract.stored_path(loaded, "hog", extract.descriptor_key(traversal, "hog", loaded.method("hog")))
    moments, done = np.random.default_rng(0), 0
    for _ in range(3):
        process = subprocess.Popen([sys.executable, "slow.py", "0.0"], cwd=project)
        wanted = done + int(moments.integers(1, 5))
        deadline = time.monotonic() + 120
        while done < wanted and process.poll() is None and time.monotonic() < deadline:
            time.sleep(0.002)
            done = rows_done(path) // 5
        time.sleep(moments.uniform(0, 0.06))
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
        done = rows_done(path) // 5
        assert not path.with_suffix(".json").exists()
    assert 3 <= done < 24
    found = extract.descriptors(loaded, traversal, "hog", workers=0)
    interrupted = path.read_bytes()
    path.unlink()
    path.with_suffix(".json").unlink()
    assert extract.descriptors(loaded, traversal, "hog", workers=0).sha256 == found.sha256
    assert path.read_bytes() == interrupted


def test_resuming_does_only_the_rest(project, monkeypatch):
    loaded, traversal = load(project)
    seen = []

    class Stopping(nn.Module):
        def forward(self, images):
            seen.append(len(images))
            if len(seen) == 3:
                raise KeyboardInterrupt
            return torch.nn.functional.normalize(images.flatten(1)[:, :108], dim=-1)

    monkeypatch.setattr(extract.methods, "model_of", lambda name, entry: Stopping())
    with pytest.raises(KeyboardInterrupt):
        extract.descriptors(loaded, traversal, "hog", workers=0)
    assert seen == [5, 5, 2]
    extract.descriptors(loaded, traversal, "hog", workers=0)
    assert seen == [5, 5, 2, 2]


def test_killed_between_the_last_two_steps_the_result_is_completed(project):
    loaded, traversal = load(project)
    first = extract.descriptors(loaded, traversal, "hog", workers=0)
    path = extract.stored_path(loaded, "hog", first.key)
    path.with_suffix(".json").unlink()
    store.write_json(path.with_suffix(".journal.json"), {"key": first.key, "rows": [[0, 12]]})
    assert extract.descriptors(loaded, traversal, "hog", workers=0).sha256 == first.sha256


def test_a_journal_of_another_key_is_not_trusted(project):
    loaded, traversal = load(project)
    key = extract.descriptor_key(traversal, "hog", loaded.method("hog"))
    path = extract.stored_path(loaded, "hog", key)
    path.parent.mkdir(parents=True)
    np.save(path.with_suffix(".partial.npy"), np.zeros((12, 108), np.float32))
    store.write_json(path.with_suffix(".journal.json"), {"key": "another", "rows": [[0, 12]]})
    found = extract.descriptors(loaded, traversal, "hog", workers=0)
    np.testing.assert_allclose(np.linalg.norm(found.values, axis=1), 1, atol=1e-5)


def test_a_damaged_result_is_named(project):
    loaded, traversal = load(project)
    found = extract.descriptors(loaded, traversal, "hog", workers=0)
    path = extract.stored_path(loaded, "hog", found.key)
    path.write_bytes(path.read_bytes()[:50])
    with pytest.raises(store.StoreError, match=r"cannot be read .*; delete it and its .json and run again"):
        extract.descriptors(loaded, traversal, "hog", workers=0)
    np.save(path, np.zeros((3, 3), np.float32))
    with pytest.raises(store.StoreError, match="does not fit its sidecar"):
        extract.descriptors(loaded, traversal, "hog", workers=0)


# -- images of different sizes, methods from outside ----------------------------------------------------------------


def mean_colour(images):
    """A method from outside: a plain function."""
    return torch.nn.functional.normalize(images.mean(dim=(2, 3)), dim=-1)


def test_images_of_different_sizes_go_one_by_one(project):
    from PIL import Image

    content = tiny_manifest()
    content["methods"]["colour"] = THUMBNAIL | {
        "dimension": 3, "builder": f"{__name__}:outside", "preprocessing": {"resize": "native", "mean": [0.0] * 3, "std": [1.0] * 3},
    }  # fmt: skip
    Image.new("RGB", (20, 90), (10, 200, 30)).save(project / "data" / "street" / "day" / "frame2.png")
    loaded = manifest.load(write_manifest(project, content))
    traversal = datasets.load_traversal(loaded, "street", "day")
    found = extract.descriptors(loaded, traversal, "colour", workers=0)
    np.testing.assert_allclose(found.values[2], np.array([10, 200, 30]) / np.linalg.norm([10, 200, 30]), atol=1e-5)


def outside():
    return mean_colour


@pytest.mark.parametrize(
    ("builder", "message"),
    [
        ("no.such.module:f", "cannot be imported"),
        (f"{__name__}:missing", "cannot be imported"),
        (f"{__name__}:number", "must return an nn.Module or a function"),
    ],
)
def test_builders_that_do_not_work_are_named(project, builder, message):
    content = tiny_manifest()
    content["methods"]["own"] = HOG | {"builder": builder}
    loaded = manifest.load(write_manifest(project, content))
    with pytest.raises(manifest.ManifestError, match=message):
        extract.descriptors(loaded, datasets.load_traversal(loaded, "street", "day"), "own", workers=0)


def number():
    return 3


def test_an_unknown_method_without_a_builder_is_named(project):
    content = tiny_manifest()
    content["methods"]["own"] = HOG
    loaded = manifest.load(write_manifest(project, content))
    with pytest.raises(
        manifest.ManifestError, match=r"methods.own: this version has no model of that name; .* 'builder"
    ):
        extract.descriptors(loaded, datasets.load_traversal(loaded, "street", "day"), "own", workers=0)
