"""Damage is repaired with all that was made from it; faults of a run end in one line, and the rest goes on."""

import re
import threading
import time

import pytest
from conftest import STREET, artifact, flip, tiny_manifest, write_images, write_manifest

from artifact import datasets, manifest, store
from artifact.book import build
from artifact.commands import verify
from artifact.datasets.appearance import appearance
from artifact.studies import evaluated


@pytest.fixture
def two_streets(project):
    """Two datasets by two methods, all evaluated; returns what evaluates them, and the project."""
    for name, brightness in (("day", 0), ("night", -35)):
        write_images(project / "data" / "road" / name, 12, seed=2, brightness=brightness)
    write_manifest(project, tiny_manifest(street=STREET, road=STREET))
    loaded = manifest.load(project / "data_manifest.yaml")

    def everything():
        found = {}
        for name in ("street", "road"):
            appearance(datasets.load_traversal(loaded, name, "day"), loaded.cache)
            for method in ("hog", "thumbnail"):
                result = evaluated.evaluation(loaded, name, method).evaluation
                found[name, method] = result.recall(1), result.dar(1), result.rsr(1)
        return found

    everything()
    return loaded, everything


def stored_results(loaded):
    return sorted(p for ending in ("npy", "npz") for p in loaded.cache.rglob(f"*.{ending}"))


def made_of(path):
    record = store.read_json(store.record_path(path))
    return record["dataset"], record.get("method")


def test_repair_makes_again_what_is_damaged_and_what_was_made_from_it(two_streets):
    loaded, everything = two_streets
    numbers, whole = everything(), {path: path.read_bytes() for path in stored_results(loaded)}
    assert len(whole) == 8 + 4 + 2
    damaged = next(path for path in whole if path.suffix == ".npy" and made_of(path) == ("street", "hog"))
    (ranking,) = [path for path in whole if path.parent.name == "rankings" and made_of(path) == ("street", "hog")]
    others = {path: path.stat().st_ino for path in whole if path not in (damaged, ranking)}
    flip(damaged)
    lines, faults = verify.verify(loaded, "demo")
    assert faults == 1
    assert f"DAMAGED {damaged}: its content differs from its record" in lines
    again = []
    lines = list(verify.repair(loaded, "demo", lambda: again.append(everything())))
    assert sorted(lines[:2]) == sorted(f"DELETED   {path}" for path in (damaged, ranking))
    assert sorted(lines[2:]) == sorted(f"AS BEFORE  {path}" for path in (damaged, ranking))
    assert again == [numbers]
    assert {path: path.read_bytes() for path in stored_results(loaded)} == whole
    assert {path: path.stat().st_ino for path in others} == others, "what was sound stays"
    assert verify.verify(loaded, "demo")[1] == 0


def test_what_a_killed_run_left_half_written_is_no_damage(two_streets):
    loaded, _ = two_streets
    number = verify.look_at(loaded.cache)[0]
    left = [loaded.cache / "rankings" / ".0a1b.json.x1y2.tmp.json", loaded.cache / "results" / ".z.partial" / "b.json"]
    for path in left:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text('{"half": ')
    assert verify.look_at(loaded.cache) == (number, [])


@pytest.mark.parametrize("kind", ["descriptors", "rankings", "appearance", "digests"])
@pytest.mark.parametrize("record", [False, True])
def test_damage_of_every_kind_is_found_by_verify_and_changes_no_number(two_streets, monkeypatch, kind, record):
    loaded, everything = two_streets
    monkeypatch.setattr(store, "_SETTLED", -1)
    numbers, whole = everything(), {path: path.read_bytes() for path in stored_results(loaded)}
    path = next(iter(sorted((loaded.cache / kind).rglob("*.json"))))
    flip(path if record or kind == "digests" else next(p for p in whole if p.stem == path.stem))
    assert len(verify.look_at(loaded.cache)[1]) == 1
    assert everything() == numbers
    assert {path: path.read_bytes() for path in stored_results(loaded)} == whole
    assert verify.look_at(loaded.cache)[1] == []


def test_images_that_changed_without_being_written_are_found(two_streets, monkeypatch):
    loaded, _ = two_streets
    monkeypatch.setattr(store, "_SETTLED", -1)
    path = loaded.data_root / "street" / "day" / "frame3.png"
    known = datasets.load_traversal(loaded, "street", "day").digest
    (memory,) = [p for p in (loaded.cache / "digests").glob("*.json") if str(path) in store.read_json(p)]
    kept = store.read_json(memory)
    kept[str(path)][-1] = "0" * 64  # as if the disk had changed the image since
    store.write_json(memory, kept)
    assert datasets.load_traversal(loaded, "street", "day").digest != known
    (line,) = verify.changed_files(loaded, ["street", "road"])
    assert line == f"CHANGED   {path}: its content is not what it was, though it was not written since"
    assert datasets.load_traversal(loaded, "street", "day").digest == known
    assert verify.changed_files(loaded, ["street", "road"]) == []


NOTEBOOK = """# ---
# jupyter:
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---
# %% [markdown]
# # Page
# %% tags=["parameters"]
profile = "demo"
# %%
{}
"""
FULL = 'raise OSError(28, "No space left on device", "/full/disk")'


def test_kernels_that_die_and_full_disks_end_in_one_line_and_other_notebooks_go_on(project):
    (project / "notebooks").mkdir()
    (project / "book").mkdir()
    for name, cell in (("dies", "import os; os._exit(1)"), ("full", FULL), ("sound", "print(7)")):
        (project / "notebooks" / f"{name}.py").write_text(NOTEBOOK.format(cell))
    status, output = artifact(project, "run", "--jobs", "2")
    assert status == 1
    assert "Traceback" not in output
    assert "notebooks/dies.py: its process ended by itself, perhaps for lack of memory; run again" in output
    assert re.search(r"notebooks/full.py: cell \d+: OSError: .*No space left on device: ./full/disk", output)
    stored = [path.name.partition("-")[0] for path in (project / ".cache" / "notebooks").glob("*.ipynb")]
    assert stored == ["sound"]
    assert not list((project / "book").rglob("*.ipynb")), "pages are those of one run, all of them"


def test_a_second_run_in_the_same_clone_waits_for_the_pages(project):
    loaded = manifest.load(project / "data_manifest.yaml")
    (project / "book").mkdir()
    (project / "book" / "_toc.yml").write_text("root: executed/nowhere\n")
    ended = []
    with build.alone(loaded):
        other = threading.Thread(target=lambda: ended.append((artifact(project, "book"), time.monotonic())))
        other.start()
        other.join(timeout=5)
        assert other.is_alive()
        released = time.monotonic()
    other.join()
    ((status, output), when) = ended[0]
    assert when > released
    assert status == 1
    assert "pages are missing, first" in output


@pytest.mark.parametrize("what", ["digests", "notebooks", "executed"])
def test_folders_that_cannot_be_written_are_told_in_one_line(project, what):
    """A file stands where a folder must be made, which no right to write helps against."""
    (project / "notebooks").mkdir()
    (project / "book").mkdir()
    (project / "notebooks" / "page.py").write_text(NOTEBOOK.format("print(7)"))
    place = project / "book" / what if what == "executed" else project / ".cache" / what
    place.parent.mkdir(exist_ok=True)
    place.write_text("")
    status, output = artifact(project, "run" if what != "digests" else "extract")
    assert status == 1
    assert "Traceback" not in output
    (line,) = [line for line in output.splitlines() if "error" in line]
    assert str(place) in line
