"""Jobs on workers: the same results as in one process, whatever happens to the workers."""

import contextlib
import gc
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from conftest import DRIVE, artifact, copy_book, tiny_manifest, write_drive, write_manifest

from artifact import manifest
from artifact.book import notebooks
from artifact.commands import cluster, jobs, workers
from artifact.commands.jobs import Job
from artifact.commands.simulate import schedule

pytest.importorskip("distributed")
# Dask's own processes warn of what it does itself when workers die.
pytestmark = pytest.mark.filterwarnings("ignore")

PAGES = {"tab03", "fig06", "fig08", "tab04", "fig07"}


@pytest.fixture(scope="module")
def laid_out(tmp_path_factory):
    """A project with one small dataset, two methods and some pages."""
    project = tmp_path_factory.mktemp("cluster")
    copy_book(project, PAGES)
    write_drive(project, 24)
    content = tiny_manifest(drive=DRIVE)
    content["profiles"]["demo"] |= {
        "datasets": ["drive"],
        "methods": ["thumbnail", "hog"],
        "parameters": {
            "fig06": {"dataset": "drive"},
            "fig07": {"dataset": "drive"},
            "fig08": {"iterations": 5},
            "tab04": {"iterations": 5},
        },
    }
    write_manifest(project, content)
    with pytest.MonkeyPatch.context() as patch:
        for name in ("ARTIFACT_CACHE", "ARTIFACT_DATA_ROOT"):
            patch.delenv(name, raising=False)
        yield project


@pytest.fixture
def project(laid_out, tmp_path):
    """A copy of that project, without results."""
    return shutil.copytree(laid_out, tmp_path / "project", ignore=shutil.ignore_patterns(".cache", "executed"))


def graph_of(project):
    loaded = manifest.load(project / "data_manifest.yaml")
    return loaded, jobs.graph(loaded, notebooks.plan(loaded, "demo"))


def results(project):
    """All stored descriptors, as bytes, and the arrays of all stored results; nothing that a killed process left."""
    cache = project / ".cache"
    found = {path.relative_to(cache): path.read_bytes() for path in (cache / "descriptors").rglob("[!.]*.npy")}
    for path in (cache / "rankings").glob("[!.]*.npz"):
        with np.load(path) as arrays:
            found |= {path.relative_to(cache) / name: arrays[name] for name in arrays.files}
    return found


def assert_same(found, expected):
    """Descriptors and rankings of them are equal to the byte, all counts are equal; fits may round their sums otherwise."""
    assert set(found) == set(expected)
    for name, value in expected.items():
        if isinstance(value, bytes):
            assert found[name] == value, name
        elif value.dtype.kind != "f":
            assert np.array_equal(found[name], value), name
        elif re.search(r"(similarity|database|pool)/0(/|$)", str(name)):  # of the descriptors as they are
            assert found[name].tobytes() == value.tobytes(), name
        else:
            np.testing.assert_allclose(found[name], value, rtol=1e-5, atol=1e-5, err_msg=str(name))


def run_here(loaded, graph):
    """The graph in this process, one job after another."""
    for job in graph:
        if isinstance(job.work, jobs.ExtractionJob):
            cluster.extraction_jobs.run([job.work], cluster.extraction_jobs.forward_of(job.work))
        else:
            job.work(loaded)


def test_a_graph_lists_every_job_after_those_that_it_needs(project):
    _, graph = graph_of(project)
    seen = set()
    for job in graph:
        assert set(job.needs) <= seen, job
        seen.add(job.name)
    assert len(seen) == len(graph)
    kinds = {job.name.split(" ")[0] for job in graph}
    assert kinds == {
        "extract",
        "assemble",
        "recall_table",
        "distractor_number",
        "distractor_distance",
        "distractor_condition",
        "suppression_table",
        "single_against_multi",
        "by_iterations",
    }
    assert "recall_table hog drive" in seen


@pytest.fixture(scope="module")
def reference(laid_out):
    """The results of one process."""
    run_here(*graph_of(laid_out))
    return results(laid_out)


def test_the_graph_makes_all_that_the_pages_need_and_then_is_empty(laid_out, reference):
    status, output = artifact(laid_out, "run", "--jobs", "2")
    assert status == 0, output
    assert set(results(laid_out)) == set(reference), "the pages computed what no job had made"
    kinds = {job.name.split(" ")[0] for job in graph_of(laid_out)[1]}
    assert not kinds & {"extract", "assemble"}


@pytest.fixture(scope="module")
def client(laid_out):
    """Two local workers, started once, that may be killed often."""
    import dask

    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 100}),
        cluster.connected("local", laid_out) as connected,
    ):
        yield connected


def test_a_local_cluster_gives_the_same_results(project, reference, client):
    loaded, graph = graph_of(project)
    assert all(job.memory > 1e8 for job in graph if job.work is not None and job.kind), "every job declares its memory"
    ended = cluster.run(client, loaded, graph)
    assert [one.fault for one in ended.values() if one.fault] == []
    assert_same(results(project), reference)


def test_a_job_that_fails_is_named_and_everything_else_goes_on(project, client):
    bad = project / "data" / "drive" / "dusk" / "frame3.png"
    bad.write_bytes(b"no image")
    loaded, graph = graph_of(project)
    ended = cluster.run(client, loaded, graph)
    kept = cluster.record(loaded, "local", ended, client.get_worker_logs())
    with pytest.raises(cluster.ClusterError) as caught:
        cluster.require_success(ended, kept)
    text = str(caught.value)
    assert "frame3.png" in text
    assert "extract hog drive/dusk 0" in text
    assert "not run, since a job that it needs failed" in text
    written = json.loads(kept.read_text())
    done = {name for name, one in written["jobs"].items() if one["fault"] is None}
    assert {"assemble hog drive/day", "assemble hog drive/night"} <= done
    assert len(written["logs"]) == 2
    bad.unlink()
    shutil.copy(project / "data" / "drive" / "dusk" / "frame4.png", bad)
    _, again = graph_of(project)
    assert not {job.name for job in again} & {name for name in done if name.startswith(("extract", "assemble"))} - {
        job.name for job in again if "dusk" in job.name
    }
    ended = cluster.run(client, loaded, again)
    assert [one.fault for one in ended.values() if one.fault] == []


def test_workers_that_are_killed_cost_nothing_but_time(project, reference, client):
    loaded, graph = graph_of(project)
    rng, stop, kills = random.Random(0), threading.Event(), []

    def kill():
        while not stop.wait(rng.uniform(0.1, 1)) and len(kills) < 20:
            processes = [pid for pid in client.run(os.getpid, on_error="ignore").values() if pid]
            if processes:
                kills.append(rng.choice(processes))
                with contextlib.suppress(ProcessLookupError):
                    os.kill(kills[-1], signal.SIGKILL)

    killer = threading.Thread(target=kill, daemon=True)
    killer.start()
    ended = cluster.run(client, loaded, graph)
    while len(kills) < 20:
        shutil.rmtree(project / ".cache", ignore_errors=True)  # a job that was given up may still write
        ended = cluster.run(client, loaded, graph)
    stop.set()
    killer.join()
    assert len(kills) >= 20
    assert [one.fault for one in ended.values() if one.fault] == []
    assert_same(results(project), reference)


def test_a_result_that_is_lost_with_its_worker_after_the_job_ended_is_computed_again(client):
    def process():
        time.sleep(1)  # that it is not there can be seen
        return cluster.Ended(float(os.getpid()), "here")

    future = client.submit(process)
    wait_for(future.done, seconds=60)
    first = cluster.outcome(future)
    assert first.fault is None
    os.kill(int(first.seconds), signal.SIGKILL)
    wait_for(lambda: future.status != "finished", seconds=60)  # what a run can meet: it ended, and now it has not
    again = cluster.outcome(future)
    assert again.fault is None
    assert again.seconds != first.seconds


def test_a_job_that_fails_for_a_reason_that_is_not_its_own_says_the_reason(client):
    def fails():
        raise OSError("no space left\nsecond line")

    assert cluster.outcome(client.submit(fails)) == cluster.Ended(0.0, "", "OSError: no space left")


# -- a run that is stopped, and a scheduler that is lost -----------------------------------------------------------

SLOW = """
import time, torch
def build():
    def describe(images):
        time.sleep(0.1)
        return torch.nn.functional.normalize(images.flatten(1)[:, :108], dim=-1)
    return describe
"""


SLOW_PARTS = 8  # two of each traversal


@pytest.fixture
def slow(project, monkeypatch):
    """The project with a method that takes a second or two for each of its parts."""
    monkeypatch.syspath_prepend(project)
    (project / "slow.py").write_text(SLOW)
    content = tiny_manifest(drive=DRIVE)
    content["methods"]["hog"] |= {"builder": "slow:build", "title": "Slow", "batch_size": 1}
    content["profiles"]["demo"] |= {"methods": ["hog"]}
    write_manifest(project, content)
    return project


def parts_of(project):
    return {path: path.stat().st_mtime_ns for path in (project / ".cache" / "descriptors").rglob("[0-9]*.npy")}


def wait_for(what, seconds=300):
    deadline = time.monotonic() + seconds
    while not (found := what()):
        assert time.monotonic() < deadline, "nothing came in time"
        time.sleep(0.05)
    return found


def test_ctrl_c_ends_the_run_and_its_workers_in_one_line_and_running_again_goes_on(slow):
    command = [sys.executable, "-m", "artifact", "extract", "--cluster", "local"]
    environment = os.environ | {"PYTHONPATH": f"{slow}:{os.environ.get('PYTHONPATH', '')}"}
    before = signal.signal(
        signal.SIGINT, signal.default_int_handler
    )  # tests in the background ignore it, and so would this
    running = subprocess.Popen(
        command,
        cwd=slow,
        env=environment,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )
    signal.signal(signal.SIGINT, before)
    wait_for(lambda: parts_of(slow))
    os.killpg(running.pid, signal.SIGINT)  # as a terminal does: everything that runs hears it
    output, errors = running.communicate(timeout=240)
    assert running.returncode == 130
    assert errors == "\nstopped; what is finished stays, run the same command again to go on\n"
    assert re.fullmatch(r"cluster local: \d+ jobs; dashboard .*: http://\S+/status\n", output)
    time.sleep(0.2)
    before = parts_of(slow)
    assert before
    left = [job for job in graph_of(slow)[1] if job.kind == "extract"]
    assert 0 < len(left) < SLOW_PARTS
    assert not [job for job in left if job.work.descriptors.path(job.work.number) in before]


def test_a_scheduler_that_is_lost_is_one_line_and_running_again_goes_on(slow):
    environment = os.environ | {"PYTHONPATH": f"{slow}:{os.environ.get('PYTHONPATH', '')}"}
    file = slow / "scheduler.json"

    def start(*arguments):
        command = [sys.executable, "-m", "distributed.cli.dask_" + arguments[0], "--scheduler-file", str(file)]
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        return subprocess.Popen([*command, *arguments[1:]], env=environment, start_new_session=True, **quiet)

    started = [start("scheduler", "--port", "0", "--no-dashboard", "--host", "127.0.0.1")]
    try:
        wait_for(file.exists)
        started.append(start("worker", "--nthreads", "1", "--no-nanny", "--no-dashboard"))
        address = json.loads(file.read_text())["address"]
        loaded = manifest.load(slow / "data_manifest.yaml")
        tasks = [notebooks.Task(Path("extract"), {}, ("drive",), ("hog",))]
        threading.Thread(target=lambda: wait_for(lambda: parts_of(slow)) and started[0].kill(), daemon=True).start()
        with pytest.raises(cluster.ClusterError, match="the scheduler is gone .*; what is finished stays, run again"):
            list(cluster.lines(address, loaded, tasks))
        assert 0 < len([job for job in jobs.graph(loaded, tasks) if job.kind == "extract"]) < SLOW_PARTS
    finally:
        for process in started:
            process.kill()
            process.wait()


# -- queueing systems ----------------------------------------------------------------------------------------------

FAKE_SLURM = {
    # As the real one, it keeps a copy of the script before it answers. The time of the first job is up as soon as it has
    # made something.
    "sbatch": '#!/bin/sh\nfor last; do :; done\ncp "$last" "$SLURM_LOG/$$.sh"\n'
    'setsid /bin/sh "$SLURM_LOG/$$.sh" >"$SLURM_LOG/$$.log" 2>&1 &\njob=$!\n'
    'if ! test -e "$SLURM_LOG/started"; then (while ! ls "$SLURM_MADE"/*/*/*/*.npy >/dev/null 2>&1; do sleep 0.1; done; '
    'kill -KILL -"$job") >/dev/null 2>&1 & fi\n'
    'echo $job >>"$SLURM_LOG/started"\necho "Submitted batch job $job"\n',
    "squeue": "#!/bin/sh\nexit 0\n",
    "scancel": '#!/bin/sh\nfor job; do kill -TERM -"$job" 2>/dev/null; done\nexit 0\n',
}


def test_a_queueing_system_runs_the_jobs_and_replaces_those_whose_time_is_up(project, reference, tmp_path):
    pytest.importorskip("dask_jobqueue")
    tools = tmp_path / "bin"
    tools.mkdir()
    for name, script in FAKE_SLURM.items():
        (tools / name).write_text(script)
        (tools / name).chmod(0o755)
    options = {"workers": 1, "cores": 1, "processes": 1, "memory": "2GB", "walltime": "00:10:00", "interface": "lo"}
    (project / "cluster.yaml").write_text(json.dumps({"slurm": options}))
    paths = {
        "PATH": f"{tools}:{os.environ['PATH']}",
        "SLURM_LOG": str(tools),
        "SLURM_MADE": str(project / ".cache" / "descriptors"),
        "PYTHONPATH": os.environ.get("PYTHONPATH", ""),
    }
    status, output = artifact(project, "extract", "--cluster", "slurm", **paths)
    assert status == 0, output
    assert len((tools / "started").read_text().splitlines()) >= 2
    script = next(tools.glob("*.sh")).read_text()
    assert "--resources MEMORY=2000000000" in script
    assert "DASK_DISTRIBUTED__WORKER__MEMORY__TERMINATE=False" in script
    made = results(project)
    assert made == {name: value for name, value in reference.items() if isinstance(value, bytes)}


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"memory": "64GB", "processes": 2}, ["--resources", "MEMORY=32000000000"]),
        (
            {"memory": "1GB", "worker_extra_args": ["--resources", "GPU=1", "-v"]},
            ["--resources", "GPU=1,MEMORY=1000000000", "-v"],
        ),
        ({"worker_extra_args": ["-v"]}, ["-v"]),
    ],
)
def test_workers_of_a_queueing_system_declare_their_memory(options, expected):
    assert workers._with_memory(options) == expected


def test_local_workers_are_as_many_as_the_memory_holds(monkeypatch, tmp_path):
    monkeypatch.setattr(workers, "available_memory", lambda: 10e9)
    monkeypatch.setattr(workers.os, "cpu_count", lambda: 16)
    monkeypatch.setattr(workers, "devices", lambda: 0)
    assert [workers.local_workers(memory) for memory in (0.0, 1e9, 3e9, 6e9, 2e10)] == [4, 4, 3, 1, 1]
    monkeypatch.setattr(workers, "devices", lambda: 8)
    assert [workers.local_workers(memory) for memory in (0.0, 3e9)] == [8, 3]


@pytest.mark.parametrize(
    ("where", "prepare", "message"),
    [
        ("lokal", None, "CLUSTER=lokal: allowed are local, slurm, pbs, lsf, sge, and the address"),
        ("tcp://127.0.0.1:9", None, "CLUSTER=tcp://127.0.0.1:9: "),
        ("slurm", None, "make cluster-example"),
        ("slurm", "pbs: {}", "has no section 'slurm'"),
        ("slurm", "slurm: {cores: 1, memory: 1GB, wall: 3}", "cluster.yaml: slurm: "),
    ],
)
def test_a_cluster_that_cannot_be_had_is_one_line(tmp_path, monkeypatch, where, prepare, message):
    monkeypatch.setattr(workers, "_CONNECTING", 1)
    if prepare:
        (tmp_path / "cluster.yaml").write_text(prepare)
    with pytest.raises(cluster.ClusterError) as caught, cluster.connected(where, tmp_path):
        pass
    text = str(caught.value)
    assert message in text
    assert "\n" not in text
    del caught
    gc.collect()  # a cluster that was made in part warns when it goes


def test_the_example_of_options_is_read(tmp_path):
    import yaml

    options = yaml.safe_load(workers.EXAMPLE)["slurm"]
    assert {"workers", "cores", "memory", "walltime"} <= set(options)


# -- schedules ------------------------------------------------------------------------------------------------------


def chain(*seconds):
    return [Job(str(i), (str(i - 1),) if i else (), None, seconds=s) for i, s in enumerate(seconds)]


def test_a_chain_takes_the_sum_on_any_number_of_workers():
    for number in (1, 2, 64):
        found = schedule(chain(1.0, 2.0, 3.0), number)
        assert (found.seconds, found.critical_seconds) == (6.0, 6.0)
        assert found.critical == (("0", 1.0), ("1", 2.0), ("2", 3.0))
        assert found.busy == pytest.approx(1 / number)


def test_independent_jobs_share_the_workers():
    free = [Job(str(i), (), None, seconds=1.0) for i in range(100)]
    assert [schedule(free, workers).seconds for workers in (1, 8, 64, 512)] == [100.0, 13.0, 2.0, 1.0]


def test_jobs_that_want_a_gpu_wait_for_one():
    wanting = [Job(str(i), (), None, on_device=True, seconds=1.0) for i in range(8)]
    other = [Job("x", (), None, seconds=1.0)]
    assert schedule([*wanting, *other], workers=8, gpus=2).seconds == 4.0
    assert schedule(wanting, workers=8).seconds == 1.0


def test_bounds_of_every_schedule():
    rng = np.random.default_rng(0)
    for _ in range(20):
        n = int(rng.integers(1, 40))
        needs = [tuple(str(j) for j in range(i) if rng.random() < 0.1) for i in range(n)]
        graph = [Job(str(i), needs[i], None, seconds=float(rng.random())) for i in range(n)]
        total = sum(job.seconds for job in graph)
        for number in (1, 3, 10):
            found = schedule(graph, number)
            assert max(found.critical_seconds, total / number) <= found.seconds + 1e-9
            assert found.seconds <= total / number + found.critical_seconds + 1e-9


def test_a_plan_lists_jobs_and_foretells_their_schedule(project):
    status, output = artifact(project, "plan", "--jobs")
    assert status == 0, output
    line = next(line for line in output.splitlines() if "recall_table hog drive" in line)
    assert re.match(r" +[\d.]+ s +[\d.]+ [GM]B  CPU  recall_table hog drive  ← assemble hog drive/day, ", line)
    assert len([line for line in output.splitlines() if "GPU  extract hog" in line]) == 4
    status, output = artifact(project, "plan", "--workers", "1", "8", "--gpus", "2")
    assert status == 0, output
    assert re.search(r"^ +1 +1 .* 100 %$", output, re.MULTILINE)
    assert re.search(r"^ +8 +2 ", output, re.MULTILINE)
    assert "critical path, which no number of workers shortens" in output


@pytest.fixture
def threads(tmp_path, monkeypatch):
    """A manifest, and a way to run jobs on workers that are threads of this process."""
    from distributed import Client, LocalCluster

    for name in ("ARTIFACT_CACHE", "ARTIFACT_DATA_ROOT"):
        monkeypatch.setenv(name, str(tmp_path))  # a worker sets them in its process
    loaded = manifest.load(write_manifest(tmp_path, tiny_manifest()))

    @contextlib.contextmanager
    def started(**options):
        with (
            LocalCluster(processes=False, dashboard_address=None, **options) as local,
            Client(local) as connected,
        ):
            yield partial(cluster.run, connected, loaded)

    return started


LOG = []  # name, worker, begin and end of each job that paused


def pause(seconds, name, _):
    from distributed import get_worker

    begun = time.monotonic()
    time.sleep(seconds)
    LOG.append((name, get_worker().name, begun, time.monotonic()))


def test_the_schedule_of_a_real_run_is_foretold(threads):
    """Jobs that sleep, on two workers. The order and the workers are those of the run, and each job takes its time: what the
    machine is late with between jobs, since others use it, is none of the schedule's.
    """
    rng = np.random.default_rng(1)
    seconds = {f"j{i}": float(one) for i, one in enumerate(rng.uniform(0.15, 0.45, 16))}
    needs = {f"j{i}": (f"j{i - 4}",) if i >= 4 else () for i in range(16)}
    foretold = schedule([Job(name, needs[name], None, seconds=one) for name, one in seconds.items()], 2).seconds
    real = []
    for _ in range(3):
        LOG.clear()
        with threads(n_workers=2, threads_per_worker=1) as run:
            run([Job(name, needs[name], partial(pause, one, name), seconds=one) for name, one in seconds.items()])
        ends, free = {}, {}
        for name, worker, *_ in sorted(LOG, key=lambda entry: entry[2]):
            begins = max([free.get(worker, 0.0), *(ends[need] for need in needs[name])])
            ends[name] = free[worker] = begins + seconds[name]
        assert len(ends) == 16
        real.append(max(ends.values()))
        if real[-1] == pytest.approx(foretold, rel=0.25):
            break
    assert min(real) == pytest.approx(foretold, rel=0.25)
    assert min(real) >= sum(seconds.values()) / 2


def test_a_worker_takes_no_more_jobs_than_its_memory_holds(threads):
    LOG.clear()
    big = [Job(f"big {i}", (), partial(pause, 0.1, f"big {i}"), memory=1e9) for i in range(4)]
    small = [Job(f"small {i}", (), partial(pause, 0.1, f"small {i}"), memory=0.4e9) for i in range(4)]
    huge = [Job("huge", (), partial(pause, 0.1, "huge"), memory=9e9)]
    with threads(n_workers=1, threads_per_worker=4, resources={"MEMORY": 1.5e9}) as run:
        ended = run([*big, *small, *huge])
    assert [one.fault for one in ended.values() if one.fault] == []
    assert len(LOG) == 9
    memory = {"big": 1e9, "small": 0.4e9, "huge": 1.5e9}  # more than there is: it runs alone
    moments = sorted(begun for _, _, begun, _ in LOG)
    for at in moments:
        together = [name.split()[0] for name, _, begun, end in LOG if begun <= at < end]
        assert sum(memory[name] for name in together) <= 1.5e9, together


def test_progress_says_what_runs_what_failed_and_what_is_left():
    graph = [Job(f"a{i}", (), None, kind="a") for i in range(6)] + [Job("b", ("a5",), None, kind="b", seconds=30.0)]
    ended = {"a0": cluster.Ended(9.0, "w"), "a1": cluster.Ended(11.0, "w"), "a2": cluster.Ended(0.0, "w", "bad image")}
    assert cluster.progress(graph, ended, 2, 0) == "2 running, 1 failed, about 50 s left"
    assert cluster.progress(graph, {}, 8, 0) == "6 running, about 30 s left"
