"""Notebooks → executed notebooks, in parallel, each run once per content of its inputs.

The key of an executed notebook holds its cells and parameters, the library's sources, the datasets and methods it
uses, and the versions that ran it. Equal key: the stored notebook is used. A failed notebook is never stored.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
import time
import warnings
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jupytext
import papermill
from jupyter_client import AsyncKernelManager
from nbclient.exceptions import DeadKernelError
from papermill.exceptions import PapermillExecutionError
from tqdm import tqdm
from traitlets.config import Config

from artifact import methods, store
from artifact.book import finishing, kernels, stages
from artifact.book.notebooks import Task, datasets_of, load_all
from artifact.extraction import extract, timing
from artifact.extraction.extract import ValuesAbsentError
from artifact.manifest import TYPED_IN, Manifest
from artifact.methods import weights
from artifact.pages.scope import NothingToShowError

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
_AT_HOME = ("IPYTHONDIR", "JUPYTER_CONFIG_DIR", "JUPYTER_RUNTIME_DIR", "MPLCONFIGDIR")
_FIRST, _LAST = ("fig10",), ("how_sure", "taken", "opening")
_ALONE = ("how_fast",)  # it measures the machine, with all its cores
_LONGEST_SOCKET_FOLDER = 80  # characters: the system allows about 100 for the path of a socket
_SOURCES = (".py", ".csv", ".json", ".npy", ".mplstyle", ".css")
_RUN_WITH = ("papermill", "ipykernel", "numpy", "torch", "scikit-learn", "pandas", "matplotlib")


class NotebookError(RuntimeError):
    """One or more notebooks failed; the message names notebook, cell and error."""


@dataclass(frozen=True)
class Outcome:
    """What became of a task."""

    name: str
    key: str
    cached: bool
    seconds: float
    error: str | None = None
    stored: Path | None = None


def run(
    manifest: Manifest, tasks: Sequence[Task], output: Path, *, jobs: int | None = None, force: bool = False
) -> list[Outcome]:
    """Run the tasks that have no stored result, in parallel, and put all executed notebooks into ``output``.

    If one fails, ``output`` keeps the pages of the last run that succeeded, and no page of this one. Everything that
    the tasks use must be prepared. ``jobs`` run at once, by default one more than there are cores (a kernel often
    waits), at most 8; with ``force`` also those with a stored result.

    Raises
    ------
    NotebookError
        If any notebook fails, after all have ended.
    """
    keys = _keys(manifest, tasks)
    jobs = jobs or min(8, (os.cpu_count() or 1) + 1)
    turns = sorted(tasks, key=_turn)
    with tqdm(total=len(tasks), unit="notebook", desc="notebooks", leave=False, disable=None) as bar:

        def one(task: Task, manager: type[AsyncKernelManager]) -> Outcome:
            outcome = _run_one(manifest, task, keys[task.page], manager, force=force)
            bar.update()
            return outcome

        with (
            environment_of_kernels(manifest, threads=max(1, (os.cpu_count() or 1) // jobs)),
            kernels.forked() as manager,
            ThreadPoolExecutor(jobs) as pool,
        ):
            together = [task for task in turns if task.name not in _ALONE]
            outcomes = list(pool.map(partial(one, manager=manager), together))
        with environment_of_kernels(manifest):
            outcomes += [one(task, AsyncKernelManager) for task in turns if task.name in _ALONE]
    found = {outcome.name: outcome for outcome in outcomes}
    outcomes = [found[task.page] for task in tasks]
    if errors := [outcome.error for outcome in outcomes if outcome.error]:
        raise NotebookError("\n".join(errors))
    for outcome in outcomes:
        page = output / f"{outcome.name}.ipynb"
        with store.replacing(page) as temporary:
            shutil.copyfile(str(outcome.stored), temporary)
        store.seal(page, {"key": outcome.key})
    return outcomes


def _turn(task: Task) -> int:
    """Start the longest page first, and last those that show what others compute, so that no kernel waits for another."""
    return _LAST.index(task.name) + 1 if task.name in _LAST else -(task.name in _FIRST)


@contextlib.contextmanager
def environment_of_kernels(manifest: Manifest, threads: int | None = None) -> Iterator[None]:
    """Set what the kernels inherit, and restore it; ``threads`` are those that each takes, unless the user says otherwise."""
    log = manifest.cache / f"kernels-{os.getpid()}.log"
    # Methods from outside stand beside the manifest; a kernel starts in the folder of the notebooks.
    paths = [str(manifest.path.parent), *filter(None, [os.environ.get("PYTHONPATH")])]
    variables = {
        # A kernel of another environment must not be picked up from the user's Jupyter settings.
        "JUPYTER_PREFER_ENV_PATH": "1",
        "JUPYTER_PATH": "",
        "PYTHONPATH": os.pathsep.join(paths),
        TYPED_IN: str(manifest.relative_to),
        store.LOG_VARIABLE: str(log),
        # Kernels side by side whose threads wait for the same cores spend more than half of their time on waiting.
        **{name: os.environ.get(name, str(threads)) for name in _THREADS if threads},
    }
    if not os.access(Path.home(), os.W_OK):
        variables |= dict.fromkeys(_AT_HOME, str(manifest.cache / "settings"))
        variables["NUMBA_CACHE_DIR"] = os.environ.get("NUMBA_CACHE_DIR", str(manifest.cache / "compiled"))
    try:
        with stages.environment(variables):
            yield
    finally:
        if log.exists():
            store.say(log.read_text(encoding="utf-8").rstrip())
            log.unlink()


def results_read(manifest: Manifest, tasks: Sequence[Task]) -> list[str]:
    """Return the stored results that the pages of tasks read when they ran: files in the cache, relative to it.

    Raises
    ------
    NotebookError
        If a task has no executed notebook that is up to date.
    """
    found, missing = dict[str, None](), []
    for name, key in _keys(manifest, tasks).items():
        record = _stored_path(manifest, name, key).with_suffix(".json")
        if record.exists():
            found |= dict.fromkeys(store.read_json(record)["results"])
        else:
            missing.append(name)
    if missing:
        raise NotebookError(
            f"{len(missing)} of {len(tasks)} notebooks have not run since something they depend on changed, first "
            f"{missing[0]}: run `make reproduce` first"
        )
    return list(found)


def _stored_path(manifest: Manifest, name: str, key: str) -> Path:
    return manifest.cache / "notebooks" / f"{name}-{key[:24]}.ipynb"


def _run_one(
    manifest: Manifest, task: Task, key: str, manager: type[AsyncKernelManager], *, force: bool = False
) -> Outcome:
    stored = _stored_path(manifest, task.page, key)
    begun = time.monotonic()
    try:
        with store.lock(stored):
            record = None if force else store.find(stored, key)
            cached = record is not None
            if record is None:
                results = _make(task, stored, manager)
                used = {"datasets": task.datasets, "methods": task.methods, "results": results}
                record = store.seal(stored, {"key": key, "seconds": round(time.monotonic() - begun, 3), **used})
        return Outcome(task.page, key, cached, record["seconds"], stored=stored)
    except PapermillExecutionError as fault:
        error = f"cell {fault.cell_index + 1}: {fault.ename}: {fault.evalue}"
    except DeadKernelError:
        again = "run again, or fewer notebooks at once (--jobs 1)"
        error = f"its process ended by itself, perhaps for lack of memory; {again}"
    except (store.StoreError, OSError, RuntimeError) as fault:  # a disk or a kernel that does not serve
        error = f"{type(fault).__name__}: {fault}"
    return Outcome(task.page, key, False, time.monotonic() - begun, f"notebooks/{task.path.name}: {error}")


def _make(task: Task, stored: Path, manager: type[AsyncKernelManager]) -> list[str]:
    """Run a notebook, or where no dataset suits it, put a page in its place that says so; return the results that it read."""
    reason = task.missing
    if not reason:
        try:
            return _execute(task, stored, manager)
        except PapermillExecutionError as fault:
            absent = fault.ename == ValuesAbsentError.__name__
            if not absent and (fault.ename != NothingToShowError.__name__ or task.dataset_asked):
                raise
            reason = str(fault.evalue)
    with store.replacing(stored) as temporary:
        finishing.write_empty_page(task.path, temporary, reason)
        return finishing.finish(temporary, task.name, task.profile, task.changed)


def _execute(task: Task, stored: Path, manager: type[AsyncKernelManager]) -> list[str]:
    """Run one notebook into ``stored`` and return the results that it read; if it fails, nothing is stored."""
    with store.replacing(stored) as temporary, tempfile.TemporaryDirectory() as folder:
        source = temporary.with_suffix(".source.ipynb")
        try:
            jupytext.write(jupytext.read(task.path), source)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of the Jupyter packages themselves; the notebook's own stay in it
                papermill.execute_notebook(
                    source,
                    temporary,
                    parameters=task.parameters,
                    kernel_name="python3",
                    progress_bar=False,
                    cwd=task.path.parent,
                    request_save_on_cell_execute=False,
                    config=_sockets(folder),
                    kernel_manager_class=manager,
                    extra_arguments=kernels.QUIET,
                )
            return finishing.finish(temporary, task.name, task.profile, task.changed)
        finally:
            source.unlink(missing_ok=True)


def _sockets(folder: str) -> Config:
    """Let a kernel talk over socket files: two that start at once can choose one network port, which ends one of them."""
    if len(folder) > _LONGEST_SOCKET_FOLDER:
        return Config()
    return Config(KernelManager={"transport": "ipc", "ip": f"{folder}/kernel"})


def _keys(manifest: Manifest, tasks: Sequence[Task]) -> dict[str, str]:
    shared = _shared_inputs(manifest)
    fingerprints = {name: _fingerprint(manifest, name) for name in datasets_of(tasks)}
    return {task.page: _key(manifest, task, shared, fingerprints) for task in tasks}


def _key(manifest: Manifest, task: Task, shared: Mapping[str, Any], fingerprints: Mapping[str, Any]) -> str:
    cells = [[cell.cell_type, cell.source, cell.metadata.get("tags", [])] for cell in jupytext.read(task.path).cells]
    return store.key(
        stage="notebook",
        cells=cells,
        parameters=task.parameters,
        # A page that says that nothing suits is not the answer to one that was asked for.
        **({"dataset_asked": True} if task.dataset_asked else {}),
        changed=task.changed,
        missing=task.missing,
        shared=shared,
        datasets={name: fingerprints[name] for name in task.datasets},
        methods={name: methods.fingerprint(name, manifest.method(name)) for name in task.methods},
    )


def _shared_inputs(manifest: Manifest) -> dict[str, Any]:
    """What every notebook depends on: the library, the manifest's text and the versions that run it."""
    package = Path(__file__).resolve().parents[1]
    files = sorted(p for p in package.rglob("*") if p.is_file() and p.suffix in _SOURCES)
    return {
        "sources": {str(path.relative_to(package)): store.digest_of_file(path) for path in files},
        "manifest": store.digest_of_file(manifest.path),
        "timings": timing.stored_times(manifest),
        "weights": {name: weights.state(name, entry).summary for name, entry in manifest.methods.items()},
        "versions": {name: version(name) for name in _RUN_WITH},
    }


def _fingerprint(manifest: Manifest, dataset: str) -> list[Any]:
    """Content of a dataset as a notebook sees it: images, positions, and whether images and descriptors are at hand."""
    found = []
    for one in load_all(manifest, dataset):
        recorded = [method for method in one.descriptors if not extract.is_at_hand(manifest, one, method)]
        found.append([one.name, one.digest, one.positions, one.has_images, one.preparation, recorded])
    return found
