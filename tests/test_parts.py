"""Parts: whole or not there, the same bytes whoever makes them, and made again where they are damaged."""

import errno
import os
import pickle
import shutil
import time

import made_in_parts
import numpy as np
import pytest
import torch
from conftest import write_images

from artifact import methods, store
from artifact.commands import verify
from artifact.datasets import DatasetError
from artifact.extraction import extract, jobs, parts, reading
from artifact.extraction.stored import stored


@pytest.fixture
def own(project, monkeypatch):
    """Twelve images in three parts of one batch each."""
    monkeypatch.setattr(parts, "_BATCHES", 1)
    return project, *made_in_parts.write(project)


def start(target, *arguments):
    """Start a process that ends with this one, and runs neither this script nor the tests again."""
    process = reading.process_context().Process(target=target, args=arguments)
    with reading.main_unseen():
        process.start()
    return process


def contents(project):
    """Bytes of all arrays that are stored, by their place."""
    cache = project / ".cache"
    return {str(path.relative_to(cache)): path.read_bytes() for path in sorted(cache.rglob("*.npy"))}


def arrays_in(project):
    """Names of all arrays, half written ones too; a process may be at work."""
    return sorted(n for _, _, names in os.walk(project / ".cache") for n in names if n.endswith(".npy"))


def make_both(loaded, traversal):
    second = extract.second_stage(loaded, traversal, "both", workers=0)
    return extract.descriptors(loaded, traversal, "both").values.copy(), second[np.arange(len(traversal))]


def made_by(project, loaded, traversal):
    make_both(loaded, traversal)
    made = contents(project)
    shutil.rmtree(project / ".cache")
    return made


@pytest.fixture
def counted(monkeypatch):
    """Sizes of the batches that go through the model."""
    sizes, original = [], made_in_parts.Both.descriptors_and_codes

    def counting(self, images):
        sizes.append(len(images))
        return original(self, images)

    monkeypatch.setattr(made_in_parts.Both, "descriptors_and_codes", counting)
    return sizes


def test_killed_at_twenty_random_moments_the_bytes_are_the_same(own):
    project, loaded, traversal = own
    write_images(project / "data" / "street" / "day", 96, seed=5)
    loaded, traversal = made_in_parts.load(project)
    undisturbed = made_by(project, loaded, traversal)
    assert len(undisturbed) == 1 + 24
    moments, seen = np.random.default_rng(0), set()
    for _ in range(20):
        before = arrays_in(project)
        process = start(made_in_parts.all_of_it, project, 1)
        deadline = time.monotonic() + 240
        while arrays_in(project) == before and process.is_alive() and time.monotonic() < deadline:
            time.sleep(0.001)
        time.sleep(moments.uniform(0, 0.05))
        process.kill()
        process.join()
        seen.add(tuple(arrays_in(project)))
        if process.exitcode == 0:  # it was done before
            assert contents(project) == undisturbed
            shutil.rmtree(project / ".cache")
    assert len(seen) >= 10, "the moments were not random enough"
    make_both(loaded, traversal)
    assert contents(project) == undisturbed
    assert not [path for path in (project / ".cache").rglob("*") if "tmp" in path.name or "damaged" in path.name]


def test_processes_that_make_the_same_parts_at_once_write_the_same_bytes(own, capsys):
    project, loaded, traversal = own
    write_images(project / "data" / "street" / "day", 96, seed=5)
    loaded, traversal = made_in_parts.load(project)
    undisturbed = made_by(project, loaded, traversal)
    barrier = reading.process_context().Barrier(2)
    processes = [start(made_in_parts.all_jobs, project, 1, barrier) for _ in range(2)]
    for process in processes:
        process.join()
    assert [process.exitcode for process in processes] == [0, 0]
    assert jobs.jobs_of(loaded, traversal, "both") == []
    make_both(loaded, traversal)
    assert contents(project) == undisturbed
    assert "damaged" not in capsys.readouterr().err


def test_jobs_of_other_machines_are_assembled_without_images_or_model(own, monkeypatch):
    """What an engine does: jobs travel, run anywhere and in any order, and leave nothing to do."""
    project, loaded, traversal = own
    expected = made_by(project, loaded, traversal)
    todo = jobs.jobs_of(loaded, traversal, "both")
    assert [job.number for job in todo] == [0, 1, 2]
    for sent in reversed(pickle.loads(pickle.dumps(todo))):
        assert len(pickle.dumps(sent)) < 5000
        jobs.run([sent], jobs.forward_of(sent), workers=0)
    jobs.run(todo, pytest.fail)  # an engine that lost the answer asks again: nothing is described
    assert jobs.jobs_of(loaded, traversal, "both") == []
    monkeypatch.setattr(methods, "model_of", lambda *_: pytest.fail("a model was built"))
    shutil.rmtree(project / "data")
    make_both(loaded, traversal)
    assert contents(project) == expected


def test_of_a_part_the_descriptors_come_last(own, monkeypatch):
    _, loaded, traversal = own
    written, original = [], parts.Parts.write

    def write(self, number, *rest):
        written.append((self.dtype, number))
        original(self, number, *rest)

    monkeypatch.setattr(parts.Parts, "write", write)
    extract.descriptors(loaded, traversal, "both", workers=0)
    assert written == [(dtype, number) for number in range(3) for dtype in ("uint8", "float32")]


def test_parts_hold_whole_batches():
    for size in (1, 3, 4, 16, 64, 1000, 5000):
        for image_bytes in (16, 4 * 4096, 61 * 61 * 128 * 4, 2**30):
            each = parts.rows_each(size, image_bytes)
            assert each % size == 0
            assert each == size or (each <= 1024 and each * image_bytes <= 2**28 and each <= 16 * size)


# -- parts that do not fit ------------------------------------------------------------------------------------------


def emptied(path):
    path.write_bytes(b"")


def cut(path):
    path.write_bytes(path.read_bytes()[:-7])


def changed(path):
    content = bytearray(path.read_bytes())
    content[-3] ^= 1
    path.write_bytes(content)


def another_shape(path):
    np.save(path, np.zeros((4, 3), np.float32))


def start_of_an_archive(path):
    path.write_bytes(b"PK\x03\x04")


def without_record(path):
    path.with_suffix(".json").write_text("")


def record_of_something_else(path):
    path.with_suffix(".json").write_text("[1, 2]")


DAMAGES = [emptied, cut, changed, another_shape, start_of_an_archive, without_record]


@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.parametrize("which", ["parts", "second"])
def test_a_damaged_part_is_set_aside_and_made_again(own, damage, which, counted, capsys):
    """Before the descriptors are assembled: the rest of the parts stays as it is."""
    project, loaded, traversal = own
    expected = made_by(project, loaded, traversal)
    counted.clear()
    todo = jobs.jobs_of(loaded, traversal, "both")
    jobs.run(todo, jobs.forward_of(todo[0]), workers=0)
    place = stored(loaded, traversal, "both")
    path = getattr(place, which).path(1)
    damage(path)
    make_both(loaded, traversal)
    assert counted == [4, 4, 4, 4], "only the images of one part were described again"
    told = [line for line in capsys.readouterr().err.splitlines() if "set aside" in line]
    assert len(told) == 1
    assert told[0].startswith(f"{path}: ")
    assert told[0].endswith("it is set aside as 00001.npy.damaged and made again")
    if which == "second":
        assert path.with_name("00001.npy.damaged").exists()
    assert contents(project) == expected


@pytest.mark.parametrize("damage", DAMAGES)
def test_codes_that_are_damaged_later_are_made_again_when_they_are_read(own, damage, counted):
    _, loaded, traversal = own
    values, codes = make_both(loaded, traversal)
    counted.clear()
    opened = extract.second_stage(loaded, traversal, "both", workers=0)
    assert np.array_equal(opened[np.array([0])], codes[:1])
    damage(opened.parts.path(2))
    np.testing.assert_array_equal(opened[np.arange(12)], codes)
    assert counted == [4]
    np.testing.assert_array_equal(extract.descriptors(loaded, traversal, "both").values, values)
    assert not stored(loaded, traversal, "both").parts_folder.exists()


def test_a_disk_that_damages_everything_is_told(own, monkeypatch, capsys):
    _, loaded, traversal = own
    original = store.digest_of_file
    monkeypatch.setattr(store, "digest_of_file", lambda p: os.urandom(4).hex() if p.suffix == ".npy" else original(p))
    with pytest.raises(store.StoreError, match=r"00000.npy: missing or damaged again .*; check the disk it is on"):
        extract.descriptors(loaded, traversal, "both", workers=0)
    assert capsys.readouterr().err.count("00000.npy: its content differs from its record") == 3


def test_parts_of_another_key_are_not_trusted(own, capsys):
    project, loaded, traversal = own
    expected = made_by(project, loaded, traversal)
    place = stored(loaded, traversal, "both")
    place.parts.folder.mkdir(parents=True)
    for number, found in enumerate(("another", place.parts.key, None)):
        np.save(place.parts.path(number), np.zeros((4, 108), np.float32))
        if found is not None:  # the second says that it is right, and its digest is not its content's
            record = {"key": found, "sha256": "0"}
            store.write_json(place.parts.path(number).with_suffix(".json"), record)
    record_of_something_else(place.parts.path(2))
    make_both(loaded, traversal)
    assert contents(project) == expected
    assert capsys.readouterr().err.count("set aside") == 1


def test_a_part_of_another_shape_does_not_count_whatever_its_record_says(own):
    _, loaded, traversal = own
    place = stored(loaded, traversal, "both")
    for values in (np.zeros((4, 107), np.float32), np.zeros((3, 108), np.float32), np.zeros((4, 108), np.float64)):
        place.parts.folder.mkdir(parents=True, exist_ok=True)
        np.save(place.parts.path(0), values)
        record = {"key": place.parts.key, "sha256": store.digest_of_file(place.parts.path(0))}
        store.write_json(place.parts.path(0).with_suffix(".json"), record)
        assert place.parts.missing() == [0, 1, 2]


def test_what_is_lost_later_is_all_that_is_made_again(own, counted):
    _, loaded, traversal = own
    values, codes = make_both(loaded, traversal)
    place = stored(loaded, traversal, "both")
    counted.clear()
    place.second.path(1).unlink()
    np.testing.assert_array_equal(extract.descriptors(loaded, traversal, "both").values, values)
    assert counted == []
    np.testing.assert_array_equal(extract.second_stage(loaded, traversal, "both", workers=0)[np.arange(12)], codes)
    assert counted == [4]


def test_without_images_what_is_lost_cannot_be_made_and_that_is_said(own):
    _, loaded, traversal = own
    make_both(loaded, traversal)
    stored(loaded, traversal, "both").second.path(1).unlink()
    gone = type(traversal)(**{**vars(traversal), "folder": None})
    with pytest.raises(DatasetError, match="the images are not on this machine"):
        extract.second_stage(loaded, gone, "both", workers=0)


def test_codes_of_another_batch_size_are_as_good(own, counted):
    project, *_ = own
    loaded, traversal = made_in_parts.write(project, batch_dependent=False, batch_size=4)
    extract.second_stage(loaded, traversal, "both", workers=0)
    loaded, traversal = made_in_parts.write(project, batch_dependent=False, batch_size=6)
    counted.clear()
    assert len(extract.second_stage(loaded, traversal, "both", workers=0).parts) == 3
    assert counted == []


# -- disk -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("fills_up_at", range(1, 8))
def test_a_disk_that_fills_up_is_told_and_the_run_goes_on_later(own, monkeypatch, fills_up_at, counted):
    """Six parts and one whole file: whichever does not fit, no half file has a name, and no part is made twice."""
    project, loaded, traversal = own
    expected = made_by(project, loaded, traversal)
    counted.clear()
    opened, original = [], parts._write_header

    def full(*arguments):
        opened.append(arguments)
        if len(opened) == fills_up_at:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        original(*arguments)

    monkeypatch.setattr(parts, "_write_header", full)
    with pytest.raises(store.StoreError, match=r"npy: cannot be written \(No space left.*make room"):
        extract.descriptors(loaded, traversal, "both", workers=0)
    assert not [path for path in (project / ".cache").rglob("*") if "tmp" in path.name]
    assert verify.look_at(project / ".cache")[1] == []
    make_both(loaded, traversal)
    assert contents(project) == expected
    assert len(counted) == 3 + (fills_up_at < 7)


def test_what_a_killed_run_left_is_swept_up(own):
    project, loaded, traversal = own
    place = stored(loaded, traversal, "both")
    for folder in (place.parts.folder, place.second.folder):
        folder.mkdir(parents=True)
        (folder / ".00001.npy.abc.tmp.npy").write_bytes(b"half")
    make_both(loaded, traversal)
    assert not list((project / ".cache").rglob(".*.tmp.*"))
    assert not place.parts_folder.exists()


def test_whoever_comes_last_is_not_told_of_files_that_were_swept_up(own, monkeypatch):
    """Another process makes the same part and sweeps up between the writing and the renaming of this one."""
    _, loaded, traversal = own
    (job, *_) = jobs.jobs_of(loaded, traversal, "both")
    forward, original = jobs.forward_of(job), parts._write_header

    def overtaken(*arguments):
        monkeypatch.setattr(parts, "_write_header", original)
        jobs.run([job], forward, workers=0)
        job.second.tidy()
        original(*arguments)

    monkeypatch.setattr(parts, "_write_header", overtaken)
    jobs.run([job], forward, workers=0)
    assert job.second.missing() == job.descriptors.missing() == [1, 2]


def test_reading_leaves_the_random_numbers_of_the_caller_alone(own):
    _, loaded, traversal = own
    before = torch.get_rng_state()
    extract.descriptors(loaded, traversal, "both", workers=0)
    assert torch.equal(torch.get_rng_state(), before)
