"""The jobs of a run on several devices or machines, by Dask ``distributed``.

Every job writes its outputs under content keys to storage that all workers share; a worker that is lost costs the jobs that
it was running, which run elsewhere. A job that fails by its own fault (an image that cannot be read) is not tried again, and
what needs it is passed over; everything else goes on.
"""

from __future__ import annotations

import asyncio
import concurrent.futures
import multiprocessing
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import scipy.linalg  # noqa: F401  (threads are limited of the libraries that are loaded: SciPy has a BLAS of its own)
import torch
from threadpoolctl import threadpool_info, threadpool_limits
from tqdm import tqdm

from artifact import store
from artifact.book.notebooks import Task
from artifact.commands import jobs
from artifact.commands.jobs import Job
from artifact.commands.plan import duration
from artifact.commands.simulate import schedule
from artifact.commands.workers import ClusterError, connected, devices
from artifact.datasets import DatasetError
from artifact.datasets.disk import in_words
from artifact.datasets.images import UnreadableImageError
from artifact.extraction import jobs as extraction_jobs
from artifact.extraction.jobs import ExtractionJob
from artifact.extraction.reading import ExtractionError
from artifact.manifest import CACHE_VARIABLE, DATA_ROOT_VARIABLE, Manifest
from artifact.manifest.entries import ManifestError
from artifact.methods.weights import WeightsError

if TYPE_CHECKING:
    from distributed import Client

_RETRIES = 2  # of a job that fails for a reason that is not its own
_USER_ERRORS = (DatasetError, ExtractionError, ManifestError, UnreadableImageError, WeightsError)
_TOLD_EVERY = 1.0  # seconds
_NOT_RUN = "not run, since a job that it needs failed"


class Ended(NamedTuple):
    """What became of a job: its seconds, the worker, and why it failed, if it did."""

    seconds: float
    worker: str
    fault: str | None = None


@dataclass(frozen=True)
class Place:
    """What a worker must know of the run: the manifest, and the environment variables that say where results and data are.

    The threads are those of a product here: their number decides the last digits.
    """

    manifest: Manifest
    variables: Mapping[str, str]
    torch_threads: int
    blas_threads: int


def lines(where: str, manifest: Manifest, tasks: Sequence[Task], *, precision: str = "float32") -> Iterator[str]:
    """Do the heavy work of some pages on a cluster; yield what a user should know, one line at a time.

    Raises
    ------
    ClusterError
        If the cluster cannot be had, or jobs failed: after all others have ended.
    """
    graph = jobs.graph(manifest, tasks, precision=precision)
    if not graph:
        return
    begun, needed = time.monotonic(), max(job.memory or 0.0 for job in graph)
    with connected(where, manifest.path.parent, needed) as client:
        yield f"cluster {where}: {len(graph)} jobs; dashboard (with the package bokeh): {client.dashboard_link}"
        if needed > (most := _offered(client).get("MEMORY", needed)):
            yield f"memory may be short: a job needs {in_words(needed)}, no worker has more than {in_words(most)}"
        try:
            ended = run(client, manifest, graph)
            logs = client.get_worker_logs()
        except (OSError, TimeoutError, concurrent.futures.CancelledError, asyncio.CancelledError) as error:
            gone = f"the scheduler is gone ({type(error).__name__}); what is finished stays, run again to go on"
            raise ClusterError(f"cluster {where}: {gone}") from None
    kept = record(manifest, where, ended, logs)
    require_success(ended, kept)
    yield f"cluster {where}: {len(graph)} jobs done in {time.monotonic() - begun:.0f} s; record: {kept}"


def run(client: Client, manifest: Manifest, graph: Sequence[Job]) -> dict[str, Ended]:
    """Run jobs where their needs are met; return what became of each.

    A progress bar says what is done, what runs, what failed, and how long the rest will take.
    """
    from distributed import as_completed

    blas = max((pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"), default=1)
    variables = {CACHE_VARIABLE: str(manifest.cache), DATA_ROOT_VARIABLE: str(manifest.data_root)}
    place = Place(manifest, variables, torch.get_num_threads(), blas)
    tag = f"{time.time_ns():x}"
    shared = client.submit(_same, place, key=f"place-{tag}")
    offered = _offered(client)
    futures: dict[str, Any] = {}
    for number, job in enumerate(graph):
        needed = [futures[need] for need in job.needs]
        how = {"priority": -number, "retries": _RETRIES, "resources": _resources(job, offered)}
        futures[job.name] = client.submit(perform, job, shared, needed, key=f"{job.name}-{tag}", **how)
    names = {future.key: name for name, future in futures.items()}
    ended: dict[str, Ended] = {}
    look = "{desc}: {percentage:3.0f}%|{bar}| {n_fmt}/{total_fmt} [{elapsed}, {rate_fmt}{postfix}]"
    told = 0.0
    with tqdm(total=len(graph), unit="job", desc="jobs", disable=None, leave=False, bar_format=look) as bar:
        for future in as_completed(futures.values()):
            name = names[future.key]
            ended[name] = outcome(future)
            if time.monotonic() - told > _TOLD_EVERY and not bar.disable:
                bar.set_postfix_str(progress(graph, ended, *_workers(client)), refresh=False)
                told = time.monotonic()
            bar.update()
    for job in graph:  # each stands after those that it needs
        if ended[job.name].fault is not None and any(ended[need].fault is not None for need in job.needs):
            ended[job.name] = Ended(0.0, "", _NOT_RUN)
    return {job.name: ended[job.name] for job in graph}


def progress(graph: Sequence[Job], ended: Mapping[str, Ended], workers: int, gpus: int) -> str:
    """Say how many jobs run and failed, and how long the rest takes on the workers, by the schedule of the plan.

    A job whose time nobody knows takes as long as those of its kind took on average.
    """
    took: dict[str, list[float]] = {}
    for job in graph:
        if job.name in ended and ended[job.name].fault is None:
            took.setdefault(job.kind, []).append(ended[job.name].seconds)
    means = {kind: sum(seconds) / len(seconds) for kind, seconds in took.items()}
    rest = [job for job in graph if job.name not in ended]
    ready = sum(all(need in ended for need in job.needs) for job in rest)
    failed = sum(one.fault is not None for one in ended.values())
    known = [replace(job, seconds=means.get(job.kind) if job.seconds is None else job.seconds) for job in rest]
    left = schedule(known, max(1, workers), gpus).seconds
    words = [f"{min(ready, workers)} running", f"{failed} failed" if failed else "", f"about {duration(left)} left"]
    return ", ".join(filter(None, words))


def _workers(client: Client) -> tuple[int, int]:
    """Number of threads that work on jobs, and of those that have a GPU."""
    known = client.scheduler_info(n_workers=-1)["workers"].values()
    return sum(one["nthreads"] for one in known), sum(one["resources"].get("GPU", 0) >= 1 for one in known)


def _same(place: Place) -> Place:
    return place


def _offered(client: Client) -> dict[str, float]:
    """The most of each resource that a worker there declares."""
    offered: dict[str, float] = {}
    for worker in client.scheduler_info(n_workers=-1)["workers"].values():
        for name, amount in worker.get("resources", {}).items():
            offered[name] = max(offered.get(name, 0.0), amount)
    return offered


def _resources(job: Job, offered: Mapping[str, float]) -> dict[str, float]:
    """What a job asks for, of what there is: nobody would ever grant more."""
    wanted = {"GPU": 1.0 if job.on_device else 0.0, "MEMORY": job.memory or 0.0}
    return {name: min(amount, offered[name]) for name, amount in wanted.items() if amount and name in offered}


def outcome(future: Any) -> Ended:
    """Wait for what became of a job: a result that is lost with the worker that held it is computed again.

    Raises
    ------
    concurrent.futures.CancelledError
        If the scheduler is gone.
    """
    try:
        return future.result()
    except Exception as error:
        if future.status != "error":
            raise
        text = str(error).strip().splitlines()
        return Ended(0.0, "", f"{type(error).__name__}: {text[0] if text else ''}".rstrip(": "))


def perform(job: Job, place: Place, needed: Sequence[Ended]) -> Ended:
    """Do one job on a worker; a fault of its own is a result, so that nobody tries it again."""
    from distributed import get_worker

    worker, begun = get_worker(), time.monotonic()
    if any(one.fault is not None for one in needed):
        return Ended(0.0, worker.address, _NOT_RUN)
    os.environ.update(place.variables)
    torch.set_num_threads(place.torch_threads)
    if devices():
        torch.cuda.set_device(_device(worker))
    fault = None
    try:
        with threadpool_limits(place.blas_threads, user_api="blas"):
            _do(job, place.manifest, worker)
    except _USER_ERRORS as error:
        fault = str(error)
    return Ended(time.monotonic() - begun, worker.address, fault)


def _do(job: Job, manifest: Manifest, worker: Any) -> None:
    if isinstance(job.work, ExtractionJob):
        # Workers of a scheduler that was there may not start processes that read images: they read in their own.
        readers = 0 if multiprocessing.current_process().daemon else None
        extraction_jobs.run([job.work], _forward(worker, job.work), workers=readers)
    elif job.work is not None:
        job.work(manifest)


def _forward(worker: Any, job: ExtractionJob) -> Any:
    """The model of a job; a worker keeps that of its last one, since loading it can take longer than a part."""
    wanted = (job.method, job.precision)
    kept = getattr(worker, "artifact_model", None)
    if kept is None or kept[0] != wanted:
        worker.artifact_model = None  # its memory is needed before the next one is there
        kept = (wanted, extraction_jobs.forward_of(job, _device(worker)))
        worker.artifact_model = kept
    return kept[1]


def _device(worker: Any) -> str:
    number = int(worker.name) if str(worker.name).isdigit() else 0
    return f"cuda:{number % count}" if (count := devices()) else "cpu"


def record(manifest: Manifest, where: str, ended: Mapping[str, Ended], logs: Mapping[str, Any]) -> Path:
    """Keep what became of each job, and the workers' logs, beside the results; return the file."""
    path = manifest.cache / "jobs" / f"{time.strftime('%Y%m%d-%H%M%S')}.json"
    jobs = {name: one._asdict() for name, one in ended.items()}
    store.write_json(path, {"cluster": where, "jobs": jobs, "logs": {str(key): text for key, text in logs.items()}})
    return path


def require_success(ended: Mapping[str, Ended], kept: Path) -> None:
    """Raise :class:`ClusterError` with each job that failed and its reason, if any did."""
    failed = {name: one.fault for name, one in ended.items() if one.fault is not None}
    if failed:
        listed = "\n  ".join(f"{name}: {fault}" for name, fault in failed.items())
        raise ClusterError(
            f"{len(failed)} of {len(ended)} jobs failed; the others' results are kept, and running again does what is "
            f"missing (logs of the workers: {kept}):\n  {listed}"
        )
