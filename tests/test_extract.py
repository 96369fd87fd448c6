"""Extraction: complete or resumable at any moment, and every bad image named."""

import contextlib
import dataclasses
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import torch
from conftest import HOG, THUMBNAIL, tiny_manifest, write_images, write_manifest
from torch import nn

from artifact import datasets, manifest, methods, store
from artifact.commands import bench
from artifact.datasets import shipped
from artifact.extraction import extract, forward, jobs, parts, reading, stored
from artifact.extraction.reading import ExtractionError
from artifact.manifest import entries

WORKERS = pytest.mark.parametrize("workers", [0, 2])


def load(project):
    loaded = manifest.load(project / "data_manifest.yaml")
    return loaded, datasets.load_traversal(loaded, "street", "day")


def left_in(project):
    """What is stored besides whole descriptors with their sidecars."""
    folder = project / ".cache" / "descriptors"
    whole = [path for path in folder.rglob("*.npy") if path.parent.parent == folder]
    sidecars = [path.with_suffix(".json") for path in whole]
    return sorted({p for p in folder.rglob("*") if p.is_file() and p.suffix != ".lock"} - {*whole, *sidecars})


def direct(traversal, entry, name):
    """Descriptors computed image by image, without the pipeline."""
    from artifact import methods
    from artifact.datasets.images import read_image
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
    assert left_in(project) == []


def test_a_stored_result_is_used_only_while_its_key_is_equal(project, monkeypatch):
    loaded, traversal = load(project)
    first = extract.descriptors(loaded, traversal, "hog", workers=0)
    monkeypatch.setattr(jobs, "run", lambda *a, **k: pytest.fail("extracted again"))
    assert extract.descriptors(loaded, traversal, "hog", workers=0).sha256 == first.sha256
    changed = tiny_manifest()
    changed["methods"]["hog"]["preprocessing"]["size"] = [48, 64]
    changed["methods"]["hog"]["dimension"] = 216
    other = manifest.load(write_manifest(project, changed))
    assert stored.descriptor_key(traversal.digest, "hog", other.method("hog")) != first.key
    (project / "data" / "street" / "day" / "frame3.png").write_bytes(
        (project / "data" / "street" / "day" / "frame4.png").read_bytes()
    )
    assert (
        stored.descriptor_key(datasets.load_traversal(loaded, "street", "day").digest, "hog", loaded.method("hog"))
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
    path = stored.stored_path(
        loaded, "thumbnail", stored.descriptor_key(traversal.digest, "thumbnail", loaded.method("thumbnail"))
    )
    assert not path.exists()
    assert not path.with_suffix(".json").exists()


def test_an_image_without_contrast_is_named(project):
    from PIL import Image

    Image.new("RGB", (64, 48), (90, 90, 90)).save(project / "data" / "street" / "day" / "frame5.png")
    loaded, traversal = load(project)
    with pytest.raises(ExtractionError, match=r"of length 1; these images have other lengths: /.*/frame5.png \(0\)"):
        extract.descriptors(loaded, traversal, "thumbnail", workers=0)


def test_a_wrong_dimension_in_the_manifest_is_named(project):
    content = tiny_manifest()
    content["methods"]["hog"]["dimension"] = 7
    loaded = manifest.load(write_manifest(project, content))
    with pytest.raises(ExtractionError, match=r"the shape \(5, 108\) for 5 images; the manifest says dimension 7"):
        extract.descriptors(loaded, datasets.load_traversal(loaded, "street", "day"), "hog", workers=0)


# -- interruption ---------------------------------------------------------------------------------------------------


@pytest.fixture
def small_parts(monkeypatch):
    """Parts of one batch each."""
    monkeypatch.setattr(parts, "_BATCHES", 1)


def test_resuming_does_only_the_rest(project, monkeypatch, small_parts):
    loaded, traversal = load(project)
    seen = []

    class Stopping(nn.Module):
        def forward(self, images):
            seen.append(len(images))
            if len(seen) == 3:
                raise KeyboardInterrupt
            return torch.nn.functional.normalize(images.flatten(1)[:, :108], dim=-1)

    monkeypatch.setattr(methods, "model_of", lambda name, entry: Stopping())
    with pytest.raises(KeyboardInterrupt):
        extract.descriptors(loaded, traversal, "hog", workers=0)
    assert seen == [5, 5, 2]
    extract.descriptors(loaded, traversal, "hog", workers=0)
    assert seen == [5, 5, 2, 2]


@pytest.mark.parametrize("ending", [".npy", ".json"])
def test_killed_between_the_last_two_steps_or_robbed_of_a_file_the_result_is_completed(project, ending):
    loaded, traversal = load(project)
    first = extract.descriptors(loaded, traversal, "hog", workers=0)
    path = stored.stored_path(loaded, "hog", first.key)
    path.with_suffix(ending).unlink()
    assert extract.descriptors(loaded, traversal, "hog", workers=0).sha256 == first.sha256


def flipped(path):
    content = bytearray(path.read_bytes())
    content[-5] ^= 8
    path.write_bytes(content)


DAMAGES = {
    "a flipped bit": flipped,
    "cut": lambda path: path.write_bytes(path.read_bytes()[:50]),
    "emptied": lambda path: path.write_bytes(b""),
    "another array": lambda path: np.save(path, np.zeros((12, 108), np.float32)),
    "record cut": lambda path: path.with_suffix(".json").write_bytes(path.with_suffix(".json").read_bytes()[:50]),
    "record emptied": lambda path: path.with_suffix(".json").write_bytes(b""),
    "another digest": lambda path: path.with_suffix(".json").write_text(
        re.sub(r'(sha256": ")....', r"\1beef", path.with_suffix(".json").read_text())
    ),
    "record of the wrong type": lambda path: path.with_suffix(".json").write_text("[1]"),
    "record of another": lambda path: store.seal(path, {"key": "another"}),
}


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
def test_damaged_descriptors_are_never_used_but_made_again(project, damage, capsys):
    loaded, traversal = load(project)
    found = extract.descriptors(loaded, traversal, "hog", workers=0)
    path, values = stored.stored_path(loaded, "hog", found.key), found.values.copy()
    damage(path)
    again = extract.descriptors(loaded, traversal, "hog", workers=0)
    np.testing.assert_array_equal(again.values, values)
    assert again.sha256 == found.sha256 == store.digest_of_file(path)
    for line in capsys.readouterr().err.splitlines():
        assert line.startswith((f"{path}: ", f"{path.with_suffix('.json')}: "))
        assert line.endswith(f"it is set aside as {path.name}.damaged and made again")


def test_damaged_shipped_descriptors_are_refused(project, monkeypatch, tmp_path):
    folder = tmp_path / "shipped"
    shutil.copytree(shipped.folder(), folder)
    monkeypatch.setattr(shipped, "folder", lambda: folder)
    loaded = manifest.load(Path(__file__).resolve().parents[1] / "data_manifest.yaml")
    loaded = dataclasses.replace(loaded, data_root=tmp_path / "none", path=tmp_path / "data_manifest.yaml")
    traversal = datasets.load_traversal(loaded, "gardens_point", "day_right")
    flipped(folder / "gardens_point" / "day_right-hog.npy")
    with pytest.raises(store.StoreError, match=r"day_right-hog.npy: its content differs from its record; it came with"):
        extract.descriptors(loaded, traversal, "hog")
    flipped(folder / "gardens_point" / "traversals.json")
    with pytest.raises(store.StoreError, match=r"traversals.json: .*; it came with the package: install it again"):
        datasets.load_traversal(loaded, "gardens_point", "day_right")


def test_images_that_changed_since_they_were_read_are_not_described(project):
    loaded, traversal = load(project)
    flipped(project / "data" / "street" / "day" / "frame4.png")
    with pytest.raises(ExtractionError, match=r"frame4.png: its content is not what its digest says, .*--check-images"):
        extract.descriptors(loaded, traversal, "hog", workers=0)


# -- batches, whatever happens --------------------------------------------------------------------------------------


class Jointly(nn.Module):
    """Descriptors that depend on the images that share a batch, as CricaVPR's do."""

    def forward(self, images):
        pixels = images.flatten(1)[:, :108]
        return torch.nn.functional.normalize(pixels - 0.9 * pixels.mean(dim=0), dim=-1)


class Convolutions(nn.Module):
    """A small network whose last digits depend on how the work is divided."""

    def __init__(self):
        super().__init__()
        generator = torch.Generator().manual_seed(0)
        self.kernels = nn.Parameter(torch.randn(108, 1, 9, 9, generator=generator))

    def forward(self, images):
        features = torch.nn.functional.conv2d(images, self.kernels).relu()
        return torch.nn.functional.normalize(features.mean(dim=(2, 3)), dim=-1)


def with_method(project, builder, **changes):
    """The tiny project with a further method 'own' that a function of this file builds."""
    content = tiny_manifest()
    content["methods"]["own"] = HOG | {"title": "Own", "builder": f"{__name__}:{builder}"} | changes
    loaded = manifest.load(write_manifest(project, content))
    return loaded, datasets.load_traversal(loaded, "street", "day")


def jointly():
    return Jointly()


def convolutions():
    return Convolutions().requires_grad_(False)


def batch_by_batch(traversal, entry, model):
    """Descriptors by the protocol, written down directly: batches of fixed size from the first image on."""
    images, _ = reading.prepare_batch(traversal.image_paths(), entry.preprocessing)
    with torch.inference_mode():
        return np.concatenate(
            [
                model(torch.from_numpy(images[start : start + entry.batch_size])).numpy()
                for start in range(0, len(images), entry.batch_size)
            ]
        )


@pytest.mark.parametrize("stop_after", [0, 1, 2])
@pytest.mark.parametrize("batches_each", [1, 2, 16])
def test_batches_are_the_protocols_in_any_parts_and_after_any_stop(project, monkeypatch, stop_after, batches_each):
    monkeypatch.setattr(parts, "_BATCHES", batches_each)
    loaded, traversal = with_method(project, "jointly", batch_dependent=True)
    expected = batch_by_batch(traversal, loaded.method("own"), Jointly())
    calls = []

    class Stopping(Jointly):
        def forward(self, images):
            if len(calls) == stop_after:
                raise KeyboardInterrupt
            calls.append(len(images))
            return super().forward(images)

    with monkeypatch.context() as patch:
        patch.setattr(methods, "model_of", lambda name, entry: Stopping())
        with pytest.raises(KeyboardInterrupt):
            extract.descriptors(loaded, traversal, "own", device="cpu", workers=0)
    found = extract.descriptors(loaded, traversal, "own", workers=0)
    np.testing.assert_array_equal(found.values, expected)
    assert left_in(project) == []


def test_a_batch_dependent_method_has_the_batch_size_in_its_key(project):
    keys = []
    for size, dependent in ((5, True), (4, True), (5, False), (4, False)):
        loaded, traversal = with_method(project, "jointly", batch_dependent=dependent, batch_size=size)
        keys.append(stored.descriptor_key(traversal.digest, "own", loaded.method("own")))
    assert keys[2] == keys[3]
    assert len(set(keys)) == 3


def test_several_devices_need_an_engine_and_the_first_goes_on(project, capsys, monkeypatch):
    loaded, traversal = load(project)
    monkeypatch.setattr(forward, "devices", lambda _: [torch.device("cpu"), torch.device("meta")])
    found = extract.descriptors(loaded, traversal, "hog", device="cpu,meta", workers=0)
    assert found.sidecar["device"] == "cpu"
    (line,) = capsys.readouterr().err.splitlines()
    assert line == "hog · street/day: several devices at once need the extra 'cluster'; going on with the first, cpu"


def test_resuming_with_another_batch_size_mixes_no_batches(project, monkeypatch, small_parts):
    """The last digits depend on the batch: what was made in batches of three is no part of a run in batches of five."""
    loaded, traversal = with_method(project, "convolutions", batch_size=3)
    calls = []

    class Stopping(Convolutions):
        def forward(self, images):
            calls.append(len(images))
            if len(calls) == 3:
                raise KeyboardInterrupt
            return super().forward(images)

    monkeypatch.setattr(methods, "model_of", lambda name, entry: Stopping().requires_grad_(False))
    with pytest.raises(KeyboardInterrupt):
        extract.descriptors(loaded, traversal, "own", workers=0)
    loaded, traversal = with_method(project, "convolutions", batch_size=5)
    found = extract.descriptors(loaded, traversal, "own", workers=0)
    assert calls == [3, 3, 3, 5, 5, 2]
    np.testing.assert_array_equal(found.values, batch_by_batch(traversal, loaded.method("own"), convolutions()))
    assert left_in(project) == []


def test_broken_images_of_all_parts_are_named_and_whole_parts_stay(project, small_parts):
    folder = project / "data" / "street" / "day"
    for name in ("frame5.png", "frame11.png"):
        (folder / name).write_bytes(b"not an image")
    loaded, traversal = load(project)
    with pytest.raises(ExtractionError, match="2 of 12 images cannot be read") as caught:
        extract.descriptors(loaded, traversal, "thumbnail", workers=0)
    assert "frame5.png" in str(caught.value)
    assert "frame11.png" in str(caught.value)
    assert [path.name for path in left_in(project)] == ["00000.json", "00000.npy"]


def processes_with(mark):
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            if mark.encode() in (entry / "environ").read_bytes():
                found.append(entry.name)
    return found


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="looks for processes in /proc, which is not here")
def test_nothing_outlives_a_killed_run(project):
    write_images(project / "data" / "street" / "day", 400, seed=5)
    with_method(project, "slow")
    mark = f"mark-{os.getpid()}-{time.monotonic_ns()}"
    code = (
        "from artifact import datasets, manifest\nfrom artifact.extraction import extract\n"
        "loaded = manifest.load('data_manifest.yaml')\n"
        "traversal = datasets.load_traversal(loaded, 'street', 'day')\n"
        "extract.descriptors(loaded, traversal, 'own', workers=2)"
    )
    modules = os.pathsep.join([str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")])
    environment = os.environ | {"ARTIFACT_TEST_MARK": mark, "PYTHONPATH": modules}
    process = subprocess.Popen([sys.executable, "-c", code], cwd=project, env=environment)
    try:
        deadline = time.monotonic() + 120
        while not left_in(project) and time.monotonic() < deadline:
            assert process.poll() is None
            time.sleep(0.05)
        assert len(processes_with(mark)) >= 4  # the run, what forks for it, two readers
    finally:
        process.kill()
        process.wait()
    deadline = time.monotonic() + 120
    while processes_with(mark) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert processes_with(mark) == []


def slow():
    def describe(images):
        time.sleep(0.1)
        return torch.nn.functional.normalize(images.flatten(1)[:, :108], dim=-1)

    return describe


def batches_read(project, monkeypatch, end, most=1):
    """Read batches much larger than a pipe holds, while ``end(process)`` ends readers as long as they are fewer than `most`."""
    started, original = [], reading.start_process

    def start(*arguments, **options):
        reader = original(*arguments, **options)
        started.append(reader)
        if len(started) <= most:
            while not reader[1].poll(0.05):  # in the middle of a batch
                pass
            end(reader[0])
        return reader

    monkeypatch.setattr(reading, "start_process", start)
    loaded, traversal = load(project)
    wide = loaded.method("hog").preprocessing.model_copy(update={"size": (512, 512)})
    return list(reading.read_batches(jobs.batches(traversal.image_paths(), 5), wide, 1)), wide, traversal


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM, signal.SIGSEGV, "the fork server"])
def test_a_reading_process_that_dies_is_replaced_once(project, monkeypatch, capfd, how):
    def end(process):
        if how == "the fork server":
            from multiprocessing.forkserver import _forkserver

            os.kill(_forkserver._forkserver_pid, signal.SIGKILL)
        else:
            os.kill(process.pid, how)

    found, wide, traversal = batches_read(project, monkeypatch, end)
    expected = [reading.prepare_batch(paths, wide) for paths in jobs.batches(traversal.image_paths(), 5)]
    assert len(found) == len(expected) == 3
    for (images, errors), (right, _) in zip(found, expected, strict=True):
        np.testing.assert_array_equal(images, right)
        assert errors == []
    if how != "the fork server":
        assert f"(exit status {-how}); another takes its place" in capfd.readouterr().err


def test_reading_processes_that_die_again_and_again_end_in_one_line(project, monkeypatch):
    with pytest.raises(ExtractionError, match=r"has ended \(exit status -9\), and so has another; memory may be short"):
        batches_read(project, monkeypatch, lambda process: os.kill(process.pid, signal.SIGKILL), most=9)


# -- memory, devices, precision -------------------------------------------------------------------------------------


class Hungry(nn.Module):
    """A model for which no more than `most` images fit into memory."""

    def __init__(self, most, error=None):
        super().__init__()
        self.most, self.seen = most, []
        self.error = error or torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 2 GiB.")

    def forward(self, images):
        self.seen.append(len(images))
        if len(images) > self.most:
            raise self.error
        return torch.nn.functional.normalize(images.flatten(1)[:, :108], dim=-1)


ON_THE_CPU = RuntimeError("[enforce fail at alloc_cpu.cpp:1] DefaultCPUAllocator: can't allocate memory")


@pytest.mark.parametrize("error", [torch.OutOfMemoryError("CUDA out of memory."), ON_THE_CPU])
def test_out_of_memory_goes_on_with_smaller_batches(project, monkeypatch, error):
    loaded, traversal = with_method(project, "convolutions", batch_size=10)
    model = Hungry(3, error)
    monkeypatch.setattr(methods, "model_of", lambda name, entry: model)
    with pytest.warns(RuntimeWarning) as told:
        found = extract.descriptors(loaded, traversal, "own", workers=0)
    assert [str(one.message) for one in told] == [
        "Own: cpu has too little memory for 10 images at once; going on with 5",
        "Own: cpu has too little memory for 5 images at once; going on with 3",
    ]
    assert model.seen == [10, 5, 3, 3, 3, 1, 2]  # halved until it fits, and remembered for the last batch
    assert found.sidecar["images_at_once"] == 3
    np.testing.assert_allclose(found.values, batch_by_batch(traversal, loaded.method("own"), Hungry(10)), atol=1e-6)


def test_out_of_memory_never_divides_a_batch_that_descriptors_depend_on(project, monkeypatch):
    loaded, traversal = with_method(project, "jointly", batch_dependent=True)
    model = Hungry(3)
    monkeypatch.setattr(methods, "model_of", lambda name, entry: model)
    with pytest.raises(ExtractionError, match="A smaller batch would give other descriptors") as caught:
        extract.descriptors(loaded, traversal, "own", workers=0)
    assert "the protocol says 5" in str(caught.value)
    assert "more memory" in str(caught.value)
    assert model.seen == [5]
    assert left_in(project) == []


def test_one_image_too_many_for_memory_is_an_error(project, monkeypatch):
    loaded, traversal = with_method(project, "convolutions", batch_size=2)
    monkeypatch.setattr(methods, "model_of", lambda name, entry: Hungry(0))
    with (
        pytest.warns(RuntimeWarning, match="going on with 1"),
        pytest.raises(ExtractionError, match="too little memory for one image of 32 × 64 pixels"),
    ):
        extract.descriptors(loaded, traversal, "own", workers=0)


def test_other_errors_of_a_model_are_not_taken_for_short_memory(project, monkeypatch):
    loaded, traversal = with_method(project, "convolutions")
    model = Hungry(0, RuntimeError("shapes do not fit"))
    monkeypatch.setattr(methods, "model_of", lambda name, entry: model)
    with pytest.raises(RuntimeError, match="shapes do not fit"):
        extract.descriptors(loaded, traversal, "own", workers=0)
    assert model.seen == [5]


def test_batch_dependent_images_of_different_sizes_are_refused(project):
    from PIL import Image

    Image.new("RGB", (20, 90), (10, 200, 30)).save(project / "data" / "street" / "day" / "frame2.png")
    native = {"resize": "native", "mean": [0.0] * 3, "std": [1.0] * 3}
    loaded, traversal = with_method(project, "jointly", batch_dependent=True, preprocessing=native)
    with pytest.raises(ExtractionError, match=r"different sizes \(48 × 64, 90 × 20\).*'resize: fixed'"):
        extract.descriptors(loaded, traversal, "own", workers=0)


def test_a_full_disk_is_said_before_any_work(project, monkeypatch):
    """Room is needed for the parts and for the one file that they become."""
    loaded, traversal = load(project)
    free, need = shutil.disk_usage(project), 2 * 12 * 108 * 4
    monkeypatch.setattr(methods, "model_of", lambda name, entry: pytest.fail("a model was built"))
    monkeypatch.setattr(shutil, "disk_usage", lambda _: free._replace(free=need - 1))
    with pytest.raises(store.StoreError, match=r"no room for 12 descriptors of 108 dimensions: .* ARTIFACT_CACHE"):
        extract.descriptors(loaded, traversal, "hog", workers=0)
    assert not list((project / ".cache" / "descriptors").rglob("*.npy"))


def test_mixed_precision_is_another_result(project):
    loaded, traversal = with_method(project, "convolutions")
    entry = loaded.method("own")
    exact = extract.descriptors(loaded, traversal, "own", workers=0)
    mixed = extract.descriptors(loaded, traversal, "own", workers=0, precision="bfloat16")
    assert (exact.sidecar["precision"], mixed.sidecar["precision"]) == ("float32", "bfloat16")
    assert (
        len({stored.descriptor_key(traversal.digest, "own", entry, precision) for precision in stored.PRECISIONS}) == 3
    )
    assert exact.key == stored.descriptor_key(traversal.digest, "own", entry)
    assert mixed.values.dtype == np.float32
    np.testing.assert_allclose(np.linalg.norm(mixed.values, axis=1), 1, atol=1e-5)
    assert 1e-5 < np.abs(exact.values - mixed.values).max() < 0.05
    with pytest.raises(ExtractionError, match="precision 'int4': allowed are float32, bfloat16, float16"):
        extract.descriptors(loaded, traversal, "own", precision="int4")


def test_float32_is_never_tf32():
    before = torch.backends.cudnn.allow_tf32, torch.get_float32_matmul_precision()
    torch.set_float32_matmul_precision("high")
    with forward.numerics(torch.device("cuda"), "float32"):
        assert not torch.backends.cudnn.allow_tf32
        assert torch.backends.cudnn.deterministic
        assert torch.get_float32_matmul_precision() == "highest"
    assert torch.get_float32_matmul_precision() == "high"
    torch.set_float32_matmul_precision(before[1])
    assert torch.backends.cudnn.allow_tf32 == before[0]


@pytest.mark.parametrize("text", ["gpu", "cuda:99", "cpu,cuda:99", "cuda:x", "", "cpu,"])
def test_devices_that_are_not_here_are_named(project, text):
    loaded, traversal = load(project)
    with pytest.raises(ExtractionError, match=r"not on this machine; here are cpu"):
        extract.descriptors(loaded, traversal, "hog", device=text)
    assert left_in(project) == []


def test_without_cuda_the_cpu_is_taken(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert forward.devices(None) == forward.devices("all") == [torch.device("cpu")]
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    assert forward.devices(None) == [torch.device("cuda", 0)]
    assert forward.devices("all") == forward.devices("cuda:0, cuda:1")


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device; this machine has none")
@pytest.mark.parametrize("devices", ["cuda", "all"])
def test_cuda_gives_the_descriptors_of_the_cpu(project, devices):
    loaded, traversal = with_method(project, "convolutions", batch_size=2)
    found = extract.descriptors(loaded, traversal, "own", device=devices)
    np.testing.assert_allclose(found.values, batch_by_batch(traversal, loaded.method("own"), convolutions()), atol=1e-5)


# -- reading --------------------------------------------------------------------------------------------------------


def test_reading_in_this_process_leaves_the_threads_of_the_model_alone(project):
    loaded, traversal = load(project)
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        extract.descriptors(loaded, traversal, "hog", workers=0)
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)


def test_batches_are_read_in_order_whatever_the_workers(project):
    loaded, traversal = load(project)
    paths = traversal.image_paths()
    batches = [paths[start : start + 1] for start in range(12)]
    how = loaded.method("hog").preprocessing
    alone = [images for images, _ in reading.read_batches(batches, how, 0)]
    for workers in (1, 3):
        together = [images for images, _ in reading.read_batches(batches, how, workers)]
        np.testing.assert_array_equal(np.stack(together), np.stack(alone))


def test_the_bench_compares_extraction_with_the_model(project):
    loaded, _ = load(project)
    (line,) = bench.extraction_lines(loaded, "hog", 4, device="cpu")
    found = re.match(
        r"extraction of 20 images with HOG on cpu: ([\d.]+) images/s, the model alone ([\d.]+) images/s, (\d+) %; "
        r"to read an image takes a core ([\d.]+) ms, which alone leaves the model (\d+) % of \d+ busy cores$",
        line,
    )
    rate, alone, percentage = (float(found[group]) for group in (1, 2, 3))
    assert abs(100 * rate / alone - percentage) < 1
    assert 0 < float(found[5]) < 100


def test_the_second_output_comes_with_its_rows(project):
    loaded, traversal = load(project)
    entry = loaded.method("hog")

    def both(images):
        flat = images.flatten(1)
        return torch.nn.functional.normalize(flat[:, :108], dim=-1), (flat[:, :8] > 0).to(torch.int8)

    run = forward.Forward(both, entry, torch.device("cpu"))
    batches = jobs.batches(traversal.image_paths(), 5)
    found = list(jobs.describe(batches, run, "street/day", workers=0))
    assert [len(values) for values, _ in found] == [len(second) for _, second in found] == [5, 5, 2]
    assert all(second.dtype == np.int8 for _, second in found)
    images, _ = reading.prepare_batch(traversal.image_paths(), entry.preprocessing)
    np.testing.assert_array_equal(np.concatenate([second for _, second in found]), images.reshape(12, -1)[:, :8] > 0)


# -- images of different sizes, methods from outside ----------------------------------------------------------------


def mean_colour(images):
    """A method from outside: a plain function."""
    return torch.nn.functional.normalize(images.mean(dim=(2, 3)), dim=-1)


def test_images_of_different_sizes_go_one_by_one(project):
    from PIL import Image

    content = tiny_manifest()
    content["methods"]["colour"] = THUMBNAIL | {
        "dimension": 3,
        "builder": f"{__name__}:outside",
        "preprocessing": {"resize": "native", "mean": [0.0] * 3, "std": [1.0] * 3},
    }
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
    with pytest.raises(entries.ManifestError, match=message):
        extract.descriptors(loaded, datasets.load_traversal(loaded, "street", "day"), "own", workers=0)


def number():
    return 3


def test_an_unknown_method_without_a_builder_is_named(project):
    content = tiny_manifest()
    content["methods"]["own"] = HOG
    loaded = manifest.load(write_manifest(project, content))
    with pytest.raises(
        entries.ManifestError, match=r"methods.own: this version has no model of that name; .* 'builder"
    ):
        extract.descriptors(loaded, datasets.load_traversal(loaded, "street", "day"), "own", workers=0)
