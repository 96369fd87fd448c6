"""The dry run: what it counts is what extraction would do, and it leaves no trace."""

import multiprocessing
import os
import re
import subprocess
import sys
import time
import types

import pytest
import torch
from conftest import HOG, REPOSITORY, tiny_manifest, write_images, write_manifest

from artifact import datasets, manifest
from artifact.commands import cli, costs, plan, probes
from artifact.extraction import costs as extraction_costs
from artifact.extraction import extract, timing
from artifact.extraction.costs import ExtractionCost, KnownTraversal
from artifact.extraction.timing import Timing
from artifact.manifest import entries

CPU = torch.device("cpu")


def files_below(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def table_of(output):
    """Rows of the printed table by method and dataset: images, batches, and the rest as text."""
    rows = {}
    for line in output.splitlines():
        words = line.split()
        numbers = [word.replace(",", "") for word in words[2:4]]
        if len(words) > 4 and words[0] != "total" and all(number.isdigit() for number in numbers):
            rows[words[0], words[1]] = (*map(int, numbers), line)
    return rows


@pytest.fixture
def quick(monkeypatch):
    """Trials that take no time, and the methods and image sizes that were tried."""
    tried = []

    def trial(method, entry, image_size, device, precision):
        tried.append((method, image_size, str(device), precision))
        return Timing(0.5, 0.01, 2e9, 2e8, "one image")

    monkeypatch.setattr(timing, "time_method", trial)
    return tried


def test_a_dry_run_counts_measures_and_leaves_no_trace(project, capsys):
    before = files_below(project)
    assert cli.main(["extract", "--dry-run", "--manifest", str(project / "data_manifest.yaml")]) == 0
    assert files_below(project) == before
    assert not (project / ".cache").exists()
    output = capsys.readouterr().out
    rows = table_of(output)
    assert rows["thumbnail", "street"][:2] == (24, 6)  # two traversals of twelve images, batches of four
    assert rows["hog", "street"][:2] == (24, 6)  # batches of five: 5, 5, 2
    assert "timed with a batch of 5" in rows["hog", "street"][2]
    assert "total" in output
    assert " free in " in output
    assert "?" not in output


def test_what_is_stored_needs_nothing(project, quick):
    loaded = manifest.load(project / "data_manifest.yaml")
    day = datasets.load_traversal(loaded, "street", "day")
    extract.descriptors(loaded, day, "hog", workers=0)
    rows = table_of("\n".join(plan.lines(loaded, "demo")))
    assert rows["hog", "street"][:2] == (12, 3)
    assert "1 of 2 traversals stored" in rows["hog", "street"][2]
    assert rows["thumbnail", "street"][0] == 24
    extract.descriptors(loaded, datasets.load_traversal(loaded, "street", "night"), "hog", workers=0)
    quick.clear()
    rows = table_of("\n".join(plan.lines(loaded, "demo")))
    assert rows["hog", "street"][:2] == (0, 0)
    assert rows["hog", "street"][2].endswith("stored")
    assert [method for method, *_ in quick] == ["thumbnail"]
    assert table_of("\n".join(plan.lines(loaded, "demo", precision="bfloat16")))["hog", "street"][0] == 24


@pytest.mark.parametrize("change", ["preprocessing", "number of images"])
def test_descriptors_of_another_time_do_not_count_as_stored(project, quick, change):
    loaded = manifest.load(project / "data_manifest.yaml")
    extract.descriptors(loaded, datasets.load_traversal(loaded, "street", "day"), "hog", workers=0)
    if change == "preprocessing":
        content = tiny_manifest()
        content["methods"]["hog"]["preprocessing"]["interpolation"] = "bicubic"
        loaded = manifest.load(write_manifest(project, content))
    else:
        (project / "data" / "street" / "day" / "frame3.png").unlink()
    known = extraction_costs.known_traversals(loaded, "street")
    assert not any(extraction_costs.is_stored(loaded, "hog", "street", one, "float32") for one in known)


def test_counts_are_those_of_the_loaded_traversals(project):
    """Image lists and thinning by distance are counted as loading applies them."""
    folder = project / "data" / "drive"
    for name in ("day", "night"):
        write_images(folder / name, 20, seed=3)
        lines = [f"frame{i}.png,{0.4 * i:.1f},0" for i in range(20)]
        (folder / name / "positions.csv").write_text("\n".join(["image,x,y", *lines]))
    (folder / "list.txt").write_text("\n".join(f"frame{i}.png" for i in range(3, 17)))
    drive = {
        "title": "Drive",
        "kind": "folder",
        "threshold": {"value": 25, "unit": "metres"},
        "query": "day",
        "database": "night",
        "traversals": {
            "day": {"condition": "day", "spacing": 1.0, "positions": "csv"},
            "night": {"condition": "night", "image_list": "list.txt"},
            "dusk": {"condition": "dusk"},
        },
    }
    loaded = manifest.load(write_manifest(project, tiny_manifest(drive=drive)))
    known = extraction_costs.known_traversals(loaded, "drive")
    assert [one.name for one in known] == ["day", "night"]  # dusk is neither here nor needed
    for one in known:
        assert one.images == len(datasets.load_traversal(loaded, "drive", one.name)) < 20
        assert (one.state, one.image_size) == ("here", (48, 64))


def test_the_papers_profile_is_planned_without_data_and_weights(tmp_path, monkeypatch, quick):
    monkeypatch.setenv("ARTIFACT_DATA_ROOT", str(tmp_path / "none"))
    monkeypatch.setenv("ARTIFACT_CACHE", str(tmp_path / "cache"))
    loaded = manifest.load(REPOSITORY / "data_manifest.yaml")
    text = "\n".join(plan.lines(loaded, "paper"))
    rows = table_of(text)
    assert len(rows) == 6 * 11
    for (method, dataset), (images, batches, line) in rows.items():
        counts = loaded.dataset(dataset).paper
        size = loaded.method(method).batch_size
        assert "not there yet" in line
        assert "weights not there yet" in line
        if dataset != "gardens_point":  # its third traversal is known from the descriptors that ship
            assert images == counts.queries + counts.database
            assert batches == -(-counts.queries // size) - (-counts.database // size)
    assert "10.8 GB" in rows["anyloc", "nordland"][2]  # 55,184 descriptors of 49,152 float32
    assert "480 × 640 pixels" in text
    assert not (tmp_path / "cache").exists()
    assert {size for _, size, *_ in quick} == {(480, 640)}
    assert len(quick) == 11


def test_each_size_of_input_is_tried_once(project, quick):
    content = tiny_manifest()
    content["methods"]["hog"]["preprocessing"] = HOG["preprocessing"] | {"resize": "native"}
    del content["methods"]["hog"]["preprocessing"]["size"]
    write_images(project / "data" / "street" / "night", 12, seed=1)
    from PIL import Image

    for path in (project / "data" / "street" / "night").iterdir():
        Image.open(path).resize((80, 60)).save(path)
    loaded = manifest.load(write_manifest(project, content))
    lines = "\n".join(plan.lines(loaded, "demo", precision="bfloat16"))
    assert re.search(r"reading takes \d+ × 200 MB besides", lines), "that of a trial, 2e8 bytes"
    assert quick == [
        ("thumbnail", (48, 64), "cpu", "bfloat16"),
        ("hog", (48, 64), "cpu", "bfloat16"),
        ("hog", (60, 80), "cpu", "bfloat16"),
    ]


def test_time_shares_cores_on_the_cpu_and_images_on_cuda(monkeypatch):
    monkeypatch.setattr(extraction_costs.os, "cpu_count", lambda: 4)
    assert extraction_costs.seconds_per_image(Timing(0.5, 0.1, 1, 1), [CPU]) == pytest.approx(0.5 + 0.1 / 4)
    one, two = [torch.device("cuda", 0)], [torch.device("cuda", 0), torch.device("cuda", 1)]
    assert extraction_costs.seconds_per_image(Timing(0.5, 0.1, 1, 1), one) == pytest.approx(0.5)
    assert extraction_costs.seconds_per_image(Timing(0.5, 0.1, 1, 1), two) == pytest.approx(0.25)
    assert extraction_costs.seconds_per_image(Timing(0.01, 0.9, 1, 1), one) == pytest.approx(
        0.3
    )  # three readers are too few


def test_totals_say_when_something_is_unknown():
    found = [
        ExtractionCost("a", "x", 10, 2, 60.0, 10**9, 1e9),
        ExtractionCost("a", "y", 5, 1, None, 10**9, None, ("not timed: because",)),
    ]
    total = plan.table(found)[-1].split()
    assert total == ["total", "15", "3", "over", "1", "min", "0", "s", "2", "GB", "1", "GB"]
    assert "?" in plan.table(found)[2]
    assert plan.table(found)[2].endswith("not timed: because")


# -- trials ---------------------------------------------------------------------------------------------------------


def entry_of(builder=None, **changes):
    content = tiny_manifest()["methods"]["hog"] | ({"builder": f"{__name__}:{builder}"} if builder else {}) | changes
    return entries.MethodEntry.model_validate(content)


def test_a_trial_measures_model_reading_and_memory():
    trial = timing.time_method("hog", entry_of(), (48, 64), CPU)
    assert 0 < trial.forward < 5
    assert 0 < trial.reading < 5
    assert 5e7 < trial.reader_memory <= trial.memory < 5e9
    assert trial.note == "a batch of 5"


def test_memory_that_is_free_is_some_of_the_machines():
    assert 5e7 < timing.available_memory() <= os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


def test_the_memory_of_a_trial_is_that_of_the_model():
    """600 MB that the model holds are in its peak, and gone when the trial is over."""
    small = timing.time_method("own", entry_of("light"), (48, 64), CPU)
    large = timing.time_method("own", entry_of("heavy"), (48, 64), CPU)
    assert 5e8 < large.memory - small.memory < 9e8
    assert multiprocessing.active_children() == []


def light(numbers=1000):
    held = torch.ones(numbers)
    return lambda images: torch.nn.functional.normalize(images.flatten(1)[:, :108] + held[0], dim=-1)


def heavy():
    return light(150_000_000)


def with_processes():
    ended = multiprocessing.get_context("spawn").Process(target=time.sleep, args=(0,))
    ended.start()
    ended.join()
    return light()


def test_a_model_in_a_trial_may_start_processes():
    assert timing.time_method("own", entry_of("with_processes"), (48, 64), CPU).note == "a batch of 5"


def test_a_trial_that_cannot_end_well_says_why(monkeypatch):
    trial = timing.time_method("own", entry_of("broken"), (48, 64), CPU)
    assert (trial.forward, trial.note) == (None, "not timed: no such kernel")
    begun = time.monotonic()
    trial = timing.time_method("own", entry_of("endless"), (48, 64), CPU, limit=3)
    assert (trial.forward, trial.note) == (None, "not timed: no image within 3 s")
    assert time.monotonic() - begun < 90
    trial = timing.time_method("own", entry_of("killed"), (48, 64), CPU)
    assert (trial.forward, trial.note) == (None, "not timed: the process ended (-9), memory may be short")
    monkeypatch.setattr(timing, "available_memory", lambda: 5e9)
    paper = manifest.load(REPOSITORY / "data_manifest.yaml").method("anyloc")
    trial = timing.time_method("anyloc", paper, (480, 640), CPU)
    assert trial.forward is None
    assert trial.note.startswith("not timed: it needs at least 5.")
    assert trial.note.endswith("GB of memory, 5 GB are free")


def broken():
    raise RuntimeError("no such kernel\nand a stack of C++ frames")


def endless():
    time.sleep(600)


def killed():
    import os

    os.kill(os.getpid(), 9)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device; this machine has none")
def test_a_trial_on_cuda_measures_the_memory_of_the_device():
    trial = timing.time_method("hog", entry_of(), (48, 64), torch.device("cuda"))
    assert trial.forward is not None
    assert 0 < trial.memory < 1e9


def test_make_passes_the_options_on():
    command = ["make", "--no-print-directory", "--dry-run", "--always-make", "extract", "PROFILE=paper"]

    def asked(*more):
        done = subprocess.run([*command, *more], cwd=REPOSITORY, capture_output=True, text=True, check=True)
        return done.stdout.replace("\\\n", " ").split("-m artifact")[-1].split()

    assert asked() == ["extract", "--profile", "paper"]
    command[-2] = "plan"
    assert asked() == ["plan", "--profile", "paper"]
    command[-2] = "extract"
    assert asked("DRY_RUN=1") == ["extract", "--profile", "paper", "--dry-run"]
    assert asked("DRY_RUN=0") == ["extract", "--profile", "paper"]
    assert asked("DEVICES=cuda:0,cuda:1", "PRECISION=bfloat16") == [
        "extract",
        "--profile",
        "paper",
        "--devices",
        "cuda:0,cuda:1",
        "--precision",
        "bfloat16",
    ]


@pytest.mark.slow
def test_devices_and_precision_reach_extraction(project):
    content = tiny_manifest()
    content["profiles"]["demo"]["methods"] = ["hog"]
    write_manifest(project, content)
    command = [sys.executable, "-m", "artifact", "extract", "--devices", "cpu,cpu", "--precision", "bfloat16"]
    done = subprocess.run(command, cwd=project, capture_output=True, text=True, check=False, timeout=900)
    assert done.returncode == 0, done.stderr
    loaded = manifest.load(project / "data_manifest.yaml")
    for known in (KnownTraversal("day", 12, "here"), KnownTraversal("night", 12, "here")):
        assert extraction_costs.is_stored(loaded, "hog", "street", known, "bfloat16")
        assert not extraction_costs.is_stored(loaded, "hog", "street", known, "float32")
    command[-2:] = ["--devices", "cuda:77"]
    done = subprocess.run(command, cwd=project, capture_output=True, text=True, check=False, timeout=900)
    assert done.returncode == 1
    assert done.stderr.startswith("error: device 'cuda:77': not on this machine")


def test_recorded_times_are_kept_for_the_book(project, monkeypatch):
    given = manifest.load(project / "data_manifest.yaml")
    times = iter([timing.Timing(0.25, 0.01, 1e9, 1e8, "one image"), timing.Timing(None, None, None, None, "not timed")])
    monkeypatch.setattr(timing, "time_method", lambda *_: next(times))
    lines = list(timing.store_times(given, ["hog", "thumbnail"], CPU))
    assert "0.25 s an image" in lines[0]
    assert "not timed" in lines[1]
    kept = timing.stored_times(given)
    assert kept["hog"]["seconds"] == 0.25
    assert kept["thumbnail"]["seconds"] is None
    assert kept["hog"]["device"] == "cpu"


# -- the whole run --------------------------------------------------------------------------------------------------

RATES = {
    "product": 1e-11,
    "pair": 1e-9,
    "view": 1e-9,
    "gram": 1e-11,
    "eigen": 1e-10,
    "inlp": 1e-8,
    "scale": 1e-9,
    "probe_dual": 1e-7,
    "probe_primal": 1e-7,
    "umap": 1e-5,
    "cosine": 1e-10,
    "match (3, 4, 6)": 1e-3,
}
LOCAL = {"rerank": 4, "local_features": {"shape": [3, 4, 6]}}


@pytest.fixture
def rated(monkeypatch):
    monkeypatch.setattr(probes, "rates", lambda *_: RATES)


def steps_of(pair, **changes):
    entry = entry_of(**changes)
    extraction = ExtractionCost("m", "d", pair.images, 1, 60.0, 10**6, 1e9)
    return {step.name: step for step in costs.pair_cost(pair, entry, extraction, RATES).steps}


def test_costs_grow_with_images_and_dimensions_as_the_work_does():
    n, d = 2000, 10_000_000  # so many dimensions that only products count
    one, more, wider = costs.Pair(n, n, d), costs.Pair(2 * n, 2 * n, d), costs.Pair(n, n, 2 * d)
    passes = [costs.pass_seconds(pair, RATES) for pair in (one, more, wider)]
    assert passes[0] == pytest.approx(1.5 * n * n * d * RATES["product"], rel=1e-3)
    assert passes[1] / passes[0] == pytest.approx(4, rel=1e-3)
    assert passes[2] / passes[0] == pytest.approx(2, rel=1e-3)
    base, rows, columns = (
        steps_of(costs.Pair(*size))
        for size in ((200_000, 200_000, 64), (400_000, 400_000, 64), (200_000, 200_000, 128))
    )
    assert rows["INLP"].seconds / base["INLP"].seconds == pytest.approx(2, rel=0.01)  # more rows than columns: n·d
    assert columns["INLP"].seconds / base["INLP"].seconds == pytest.approx(2, rel=0.01)
    assert columns["LEACE"].seconds / base["LEACE"].seconds == pytest.approx(4, rel=0.03)  # n·d²
    assert rows["probe"].seconds / base["probe"].seconds == pytest.approx(2, rel=0.01)
    tall, taller = (steps_of(costs.Pair(size, size, 10**6)) for size in (2000, 4000))
    assert taller["LEACE"].seconds / tall["LEACE"].seconds == pytest.approx(4, rel=0.05)  # fewer rows: n²·d
    assert base["probe"].memory > 32 * 180_000 * 64


def test_an_unknown_rate_makes_its_step_unknown_and_no_other():
    extraction = ExtractionCost("m", "d", 10, 1, None, 0, None)
    found = costs.pair_cost(
        costs.Pair(100, 100, 64), entry_of(), extraction, RATES | {"probe_dual": None, "probe_primal": None}
    )
    assert [step.name for step in found.steps if step.seconds is None] == ["extraction", "probe"]
    assert "?" in plan.run_table([found])[1]
    assert "over " in plan.run_table([found])[2]


def test_two_stage_methods_have_no_suppression(monkeypatch):
    monkeypatch.setitem(RATES, "match (3, 4, 6)", 1e-3)
    two = steps_of(costs.Pair(100, 100, 108), **LOCAL)
    assert list(two) == ["extraction", "ranking"]
    assert two["ranking"].seconds == pytest.approx(100 * 8 * 1e-3, rel=0.01)  # twice four candidates
    assert list(steps_of(costs.Pair(100, 100, 108, embedded=True))) == list(costs.STEPS)


def test_the_plan_covers_every_pair_and_keeps_nothing_but_its_probes(project, quick, rated, capsys, monkeypatch):
    monkeypatch.setattr(timing, "available_memory", lambda: 2e10)  # what other work leaves free changes
    monkeypatch.setattr(plan, "free_bytes", lambda _: 1e11)
    before = files_below(project)
    assert cli.main(["plan", "--manifest", str(project / "data_manifest.yaml")]) == 0
    added = {path: content for path, content in files_below(project).items() if path not in before}
    assert list(added) == [project / ".cache" / "probes.json"]
    output = capsys.readouterr().out
    rows = {tuple(line.split()[:2]) for line in output.splitlines()}
    assert {("thumbnail", "street"), ("hog", "street")} <= rows
    assert "will not fit" not in output
    assert len(quick) == 2
    assert cli.main(["plan", "--manifest", str(project / "data_manifest.yaml")]) == 0
    assert capsys.readouterr().out == output
    assert len(quick) == 2, "what was measured is kept"


def test_nothing_is_to_extract_when_all_is_stored(project, quick, rated):
    loaded = manifest.load(project / "data_manifest.yaml")
    for name in ("day", "night"):
        for method in ("hog", "thumbnail"):
            extract.descriptors(loaded, datasets.load_traversal(loaded, "street", name), method, workers=0)
    lines = list(plan.run_lines(loaded, "demo"))
    assert [line.split()[2] for line in lines[1:3]] == ["0.00", "0.00"]
    assert quick == []


def test_what_will_not_fit_is_said(project, quick, rated, monkeypatch):
    monkeypatch.setattr(timing, "available_memory", lambda: 6e8)
    loaded = manifest.load(project / "data_manifest.yaml")
    lines = list(plan.run_lines(loaded, "demo"))
    assert "will not fit: hog × street × extraction: 2 GB of memory needed, 600 MB there" in lines
    assert any(line.startswith("will not fit: thumbnail × street × ranking: ") for line in lines)
    pairs = [
        costs.PairCost(name, "d", (costs.Step("extraction", 1.0, 0, size),))
        for name, size in (("a", 6), ("b", 5), ("c", 4))
    ]
    found = [(cost.method, what, needed, left) for cost, _, what, needed, left in costs.that_do_not_fit(pairs, 1, 10)]
    assert found == [("b", "disk", 5, 4)]


def test_a_failed_trial_is_not_kept(tmp_path):
    trials = timing.Trials(tmp_path / "probes.json")
    assert trials(lambda: None, lambda found: found is None, probe="x") is None
    assert not (tmp_path / "probes.json").exists()
    assert trials(lambda: pytest.fail("tried twice"), lambda found: found is None, probe="x") is None
    again = timing.Trials(tmp_path / "probes.json")
    assert again(lambda: [1.0], lambda found: found is None, probe="x") == [1.0]
    assert timing.Trials(tmp_path / "probes.json")(lambda: pytest.fail("kept"), bool, probe="x") == [1.0]


@pytest.mark.slow
def test_the_probes_measure_every_rate():
    found = probes.rates(timing.Trials(), [(4, 4, 8)])
    assert set(found) == {*RATES, "match (4, 4, 8)"} - {"match (3, 4, 6)"}
    assert all(value is not None and value >= 0 for value in found.values())


@pytest.mark.parametrize(("platform", "bytes_"), [("linux", 5 * 1024), ("darwin", 5)])
def test_peak_memory_where_the_system_tells_no_more(monkeypatch, tmp_path, platform, bytes_):
    monkeypatch.setattr(timing, "Path", lambda _: tmp_path / "nothing")
    monkeypatch.setattr(timing.sys, "platform", platform)
    monkeypatch.setattr(timing.resource, "getrusage", lambda _: types.SimpleNamespace(ru_maxrss=5))
    assert timing.peak_memory() == bytes_


@pytest.mark.parametrize(("method", "what"), [("selavpr", "local features"), ("selavprpp", "hash codes")])
def test_a_plan_says_what_of_the_disk_is_the_second_stage(monkeypatch, method, what):
    trials = types.SimpleNamespace(of_method=lambda *_: Timing(0.5, 0.01, 2e9, 2e8, "one image"))
    monkeypatch.setattr(extraction_costs, "is_stored", lambda *_: False)
    known = [KnownTraversal("day", 10, "here", (480, 640))]
    cost = extraction_costs.extraction_cost(
        manifest.load(), method, "gardens_point", known, trials, [torch.device("cpu")]
    )
    assert sum(what in note for note in cost.notes) == 1
