"""Workers for the jobs of a run, by Dask ``distributed``: of this machine, of a queueing system, or those of a scheduler that runs."""

from __future__ import annotations

import contextlib
import logging
import os
import signal
from collections.abc import Iterator
from importlib.util import find_spec
from multiprocessing import resource_tracker
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
import yaml

from artifact.book import stages
from artifact.extraction.timing import available_memory

if TYPE_CHECKING:
    from distributed import Client, LocalCluster

OPTIONS = "cluster.yaml"
QUEUES = {"slurm": "SLURMCluster", "pbs": "PBSCluster", "lsf": "LSFCluster", "sge": "SGECluster"}
EXAMPLE = """\
# Options of CLUSTER=slurm; pbs, lsf and sge have sections of the same form.
# They are those of dask_jobqueue's cluster classes, and "workers": how many are asked for.
slurm:
  workers: 8
  cores: 8                 # of each worker
  processes: 1             # one a worker, which has its own copy of a model
  memory: 64GB             # of each worker; `make plan` says what jobs need
  walltime: "04:00:00"     # a job that is cut off is made again: allow for the longest (plan --jobs)
  # queue: gpu             # partition
  # account: my_project
  # interface: ib0         # network that the workers and this machine share
  # job_extra_directives: ["--gres=gpu:1"]
  # worker_extra_args: ["--resources", "GPU=1"]
  # job_script_prologue: ["module load cuda"]
"""

_CONFIG = {
    "distributed.worker.daemon": False,  # workers read images in processes of their own
    "distributed.deploy.lost-worker-timeout": "2s",
    # What jobs need is declared; Dask would count descriptors that are mapped into memory, and end the workers.
    **{f"distributed.worker.memory.{what}": False for what in ("target", "spill", "pause", "terminate")},
}
# The same for the workers of a queueing system.
_PROLOGUE = [
    f"export DASK_{name.replace('.', '__').upper()}=False" for name, value in _CONFIG.items() if value is False
]
_CONNECTING = 10  # seconds until a scheduler counts as not there
_PART_OF_A_PROCESS = 4  # cores that a local worker has at least
_LEAKED = "ignore::UserWarning:multiprocessing.resource_tracker"


class ClusterError(RuntimeError):
    """A cluster that cannot be had, or jobs that failed on it; the message names each with its reason."""


def devices() -> int:
    """Return the number of CUDA devices of this machine."""
    return torch.cuda.device_count()


def is_there() -> bool:
    """Whether the extra ``cluster`` is installed."""
    return find_spec("distributed") is not None


@contextlib.contextmanager
def connected(where: str, folder: Path, memory: float = 0.0) -> Iterator[Client]:
    """Give a client of the cluster that was asked for, and end what was started for it.

    Parameters
    ----------
    where
        ``local``, ``slurm``, ``pbs``, ``lsf``, ``sge``, or the address of a scheduler that runs.
    folder
        Holds ``cluster.yaml``, the options of queueing systems.
    memory
        Bytes that the largest job needs: workers of this machine are at most as many as that fits.

    Raises
    ------
    ClusterError
        If it is none of them, cannot be reached, or the extra ``cluster`` is not installed.
    """
    if not is_there():
        raise ClusterError("several devices or machines need the extra 'cluster': pip install 'artifact[cluster]'")
    import dask
    from distributed import Client

    if where not in ("local", *QUEUES) and "://" not in where:
        known = ", ".join(("local", *QUEUES))
        raise ClusterError(f"CLUSTER={where}: allowed are {known}, and the address of a scheduler as tcp://host:8786")
    with contextlib.ExitStack() as stack:
        stack.enter_context(dask.config.set(_CONFIG))
        try:
            started: Any = where
            if "://" not in where:
                started = stack.enter_context(_local(memory) if where == "local" else _queued(where, folder))
            client = stack.enter_context(Client(started, timeout=_CONNECTING))
        except OSError as error:
            raise ClusterError(f"CLUSTER={where}: {error}") from None
        yield client


@contextlib.contextmanager
def _local(memory: float) -> Iterator[LocalCluster]:
    from distributed import LocalCluster

    # Its threads may say what they lost when the cluster, which keeps them silent, is closed.
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    workers = local_workers(memory)
    resources = {"MEMORY": available_memory() / workers} | ({"GPU": 1} if devices() else {})
    with _undisturbed():
        cluster = LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            memory_limit=0,
            resources=resources,
            dashboard_address=":0",
            silence_logs=logging.CRITICAL,
        )
    cluster.adapt(minimum=workers, maximum=workers)  # replaces workers that do not come back
    try:
        yield cluster
    except BaseException:
        _kill(cluster)
        raise
    finally:
        cluster.close()


def local_workers(memory: float) -> int:
    """Return the number of workers of this machine: for each GPU, else for some cores, if each can hold the largest job."""
    workers = devices() or max(2, (os.cpu_count() or 1) // _PART_OF_A_PROCESS)
    return max(1, min(workers, int(available_memory() // memory))) if memory else workers


@contextlib.contextmanager
def _undisturbed() -> Iterator[None]:
    """Start threads and processes that Ctrl-C does not reach: this process hears it, and ends them.

    What killed workers leave behind is swept up without a warning.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    warnings = ",".join(filter(None, [os.environ.get("PYTHONWARNINGS"), _LEAKED]))
    try:
        with stages.environment({"PYTHONWARNINGS": warnings}):
            resource_tracker.ensure_running()
            signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # which the tracker's start may undo
            yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _kill(cluster: LocalCluster) -> None:
    """End the workers at once, whatever they are doing: their outputs are whole files or none."""
    for nanny in cluster.workers.values():
        nanny.auto_restart = False
        process = getattr(nanny.process, "process", None)
        if process is not None and process.pid is not None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(process.pid, signal.SIGKILL)


def _queued(system: str, folder: Path) -> Any:
    import dask_jobqueue

    path = folder / OPTIONS
    if not path.is_file():
        raise ClusterError(f"CLUSTER={system}: no file {path}; `make cluster-example` writes one to fill in")
    try:
        options = (yaml.safe_load(path.read_text(encoding="utf-8")) or {}).get(system)
    except (yaml.YAMLError, AttributeError) as error:
        raise ClusterError(f"{path}: is not valid YAML ({error})") from None
    if not isinstance(options, dict):
        raise ClusterError(f"{path}: has no section {system!r}; `make cluster-example` writes one to fill in")
    workers = options.pop("workers", 1)
    options["job_script_prologue"] = [*_PROLOGUE, *options.get("job_script_prologue", [])]
    kind, cluster = getattr(dask_jobqueue, QUEUES[system]), None
    try:
        options["worker_extra_args"] = _with_memory(options)
        cluster = kind(**options)
        cluster.job_script()  # made now, so that an unknown option is noticed
    except (TypeError, ValueError, RuntimeError) as error:
        if cluster is not None:
            cluster.close()
        raise ClusterError(f"{path}: {system}: {str(error).splitlines()[0]}") from None
    cluster.adapt(minimum_jobs=workers, maximum_jobs=workers)  # replaces those whose time is up
    return cluster


def _with_memory(options: dict[str, Any]) -> list[str]:
    """Return the arguments of workers, by which they also declare their memory."""
    from dask.utils import parse_bytes

    arguments = [*options.get("worker_extra_args", [])]
    if "memory" in options:
        memory = f"MEMORY={parse_bytes(options['memory']) / options.get('processes', 1):.0f}"
        if "--resources" in arguments[:-1]:
            arguments[arguments.index("--resources") + 1] += f",{memory}"
        else:
            arguments += ["--resources", memory]
    return arguments
