"""Notebooks → executed notebooks, in parallel, each run once per content of its inputs.

The key of an executed notebook holds its cells and parameters, the library's sources, the datasets and methods it
uses, and the versions that ran it. Equal key: the stored notebook is used. A failed notebook is never stored.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import time
import warnings
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jupytext
import nbformat
import papermill
from papermill.exceptions import PapermillExecutionError
from tqdm import tqdm

from artifact import datasets, methods, store
from artifact.book import parameters
from artifact.extraction import extract, timing
from artifact.manifest import TYPED_IN, Manifest
from artifact.manifest.entries import ManifestError
from artifact.methods import weights
from artifact.pages.scope import NothingToShowError
from artifact.studies import reported
from artifact.studies.common import single_stage

_SOURCES = (".py", ".csv", ".json", ".npy", ".mplstyle")
_RUN_WITH = ("papermill", "ipykernel", "numpy", "torch", "scikit-learn", "pandas", "matplotlib")


class NotebookError(RuntimeError):
    """One or more notebooks failed; the message names notebook, cell and error."""


@dataclass(frozen=True)
class Task:
    """A notebook with the parameters of one run.

    Attributes
    ----------
    path
        The ``.py`` source.
    parameters
        Checked values of all its parameters.
    datasets, methods
        What it uses, so that it can be made ready before.
    dataset_asked
        Whether its one dataset was asked for by name and for this notebook alone: then one that does not suit is an error, else
        the page says so.
    """

    path: Path
    parameters: dict[str, Any]
    datasets: tuple[str, ...]
    methods: tuple[str, ...]
    dataset_asked: bool = False

    @property
    def name(self) -> str:
        """File name without its ending, for example ``tab03``."""
        return self.path.stem


@dataclass(frozen=True)
class Outcome:
    """What became of a task."""

    name: str
    key: str
    cached: bool
    seconds: float
    parameters: dict[str, Any] = field(repr=False)
    error: str | None = None
    stored: Path | None = None


def plan(
    manifest: Manifest,
    profile: str,
    *,
    only: Sequence[str] = (),
    asked: Mapping[str, Mapping[str, Any]] | None = None,
    folder: Path | None = None,
) -> list[Task]:
    """Find the notebooks and check every parameter, before anything runs.

    Parameters
    ----------
    manifest, profile
        The profile sets ``profile`` and may set further parameters of each notebook.
    only
        Names of notebooks; default all.
    asked
        Parameters by notebook name; those under ``"*"`` go to every notebook that has them.
    folder
        Folder of the notebooks; default ``notebooks`` beside the manifest.

    Raises
    ------
    ParameterError
        If a notebook or parameter is unknown or a value is not allowed.
    """
    folder = folder or manifest.path.parent / "notebooks"
    found = {path.stem: path for path in sorted(folder.glob("*.py"))}
    asked = dict(asked or {})
    everywhere = dict(asked.pop("*", {}))
    unknown = [name for name in (*only, *asked) if name not in found]
    if unknown:
        raise parameters.ParameterError(f"no notebook {unknown[0]!r} in {folder}; allowed: {', '.join(found)}")
    entry = manifest.profile(profile)
    reported.require(manifest, profile)
    _check_profile(manifest, profile, found)
    tasks, used = [], set()
    for name, path in found.items():
        if only and name not in only:
            continue
        defaults = parameters.read(path)
        here = {key: value for key, value in everywhere.items() if key in defaults}
        used |= set(here)
        base = {"profile": profile} if "profile" in defaults else {}
        wanted = {**base, **entry.parameters.get(name, {}), **here, **asked.get(name, {})}
        values = parameters.merged(path, wanted, manifest)
        names, methods_used = _scope(manifest, profile, values)
        if "single_stage" in path.read_text(encoding="utf-8"):
            methods_used = tuple(single_stage(manifest, methods_used))
        own = "dataset" in asked.get(name, {}) or "dataset" in entry.parameters.get(name, {}).keys() - here.keys()
        tasks.append(Task(path, values, names, methods_used, own))
    if unused := set(everywhere) - used:
        raise parameters.ParameterError(f"no notebook has a parameter {sorted(unused)[0]!r}")
    return tasks


def _check_profile(manifest: Manifest, profile: str, notebooks: Mapping[str, Path]) -> None:
    """Check that a profile's page parameters name what the profile has."""
    entry = manifest.profile(profile)
    for page, values in entry.parameters.items():
        where = f"{manifest.path}: profiles.{profile}.parameters.{page}"
        if page not in notebooks:
            raise ManifestError(f"{where}: no such notebook; allowed: {', '.join(notebooks)}")
        for several, one, allowed in (("datasets", "dataset", entry.datasets), ("methods", "method", entry.methods)):
            named = [*(values.get(several) or []), *([values[one]] if values.get(one) else [])]
            for name in named:
                if name not in allowed:
                    raise ManifestError(
                        f"{where}: names {name!r}, which the profile lacks; it has {', '.join(allowed)}"
                    )


def _scope(manifest: Manifest, profile: str, values: Mapping[str, Any]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Datasets and methods that a notebook uses, read off its parameters."""
    entry = manifest.profile(profile)

    def chosen(several: str, one: str, default: Sequence[str]) -> tuple[str, ...]:
        if several in values:
            return tuple(default if values[several] is None else values[several])
        if one in values:
            return tuple(default) if values[one] is None else (values[one],)
        return ()

    names = chosen("datasets", "dataset", entry.datasets)
    return names, chosen("methods", "method", entry.methods) if names else ()


def prepare(manifest: Manifest, tasks: Sequence[Task], *, device: str | None = None) -> None:
    """Render or find every dataset and extract every descriptor that the tasks use, with progress bars."""
    pairs = dict.fromkeys((dataset, method) for task in tasks for dataset in task.datasets for method in task.methods)
    loaded = {
        name: load_all(manifest, name) for name in dict.fromkeys(name for task in tasks for name in task.datasets)
    }
    extracted = {m for d, m in pairs for t in loaded[d] if t.has_images and not extract.is_ready(manifest, t, m)}
    weights.require({method: manifest.method(method) for method in sorted(extracted)})
    extract.check_disk(manifest, (t for traversals in loaded.values() for t in traversals), sorted(extracted))
    for dataset, method in pairs:
        for traversal in loaded[dataset]:
            extract.descriptors(manifest, traversal, method, device=device, progress=True)


def load_all(manifest: Manifest, dataset: str) -> list[datasets.Traversal]:
    """Load the query, the database, and every further traversal that is at hand.

    Raises
    ------
    DatasetError
        If the query or the database is missing. A missing further traversal fails the notebook that needs it.
    """
    loaded = list(datasets.load(manifest, dataset).traversals.values())
    for name in manifest.dataset(dataset).traversals:
        if name not in {traversal.name for traversal in loaded}:
            with contextlib.suppress(datasets.DatasetError):
                loaded.append(datasets.load_traversal(manifest, dataset, name))
    return loaded


def run(
    manifest: Manifest, tasks: Sequence[Task], output: Path, *, jobs: int | None = None, force: bool = False
) -> list[Outcome]:
    """Run the tasks that have no stored result, in parallel, and put all executed notebooks into ``output``.

    If one fails, ``output`` keeps the pages of the last run that succeeded, and no page of this one.

    Parameters
    ----------
    manifest, tasks
        As from :func:`plan`, with everything prepared.
    output
        Folder that receives ``<name>.ipynb``.
    jobs
        Notebooks that run at once; default the number of cores, at most 8.
    force
        Run even where a stored result has the same key.

    Raises
    ------
    NotebookError
        If any notebook fails, after all have ended.
    """
    shared = _shared_inputs(manifest)
    fingerprints = {name: _fingerprint(manifest, name) for name in dict.fromkeys(n for t in tasks for n in t.datasets)}
    jobs = jobs or min(8, os.cpu_count() or 1)
    with (
        _environment_of_kernels(manifest),
        ThreadPoolExecutor(jobs) as pool,
        tqdm(total=len(tasks), unit="notebook", desc="notebooks", leave=False, disable=None) as bar,
    ):

        def one(task: Task) -> Outcome:
            outcome = _run_one(manifest, task, _key(manifest, task, shared, fingerprints), force=force)
            bar.update()
            return outcome

        outcomes = list(pool.map(one, tasks))
    failed = [outcome for outcome in outcomes if outcome.error]
    if failed:
        raise NotebookError("\n".join(outcome.error for outcome in failed if outcome.error))
    for outcome in outcomes:
        with store.replacing(output / f"{outcome.name}.ipynb") as temporary:
            shutil.copyfile(str(outcome.stored), temporary)
    return outcomes


@contextlib.contextmanager
def _environment_of_kernels(manifest: Manifest) -> Iterator[None]:
    """Set what the kernels inherit, and restore it."""
    before = dict(os.environ)
    # Methods from outside stand beside the manifest; a kernel starts in the folder of the notebooks.
    paths = [str(manifest.path.parent), *filter(None, [os.environ.get("PYTHONPATH")])]
    os.environ |= {
        # A kernel of another environment must not be picked up from the user's Jupyter settings.
        "JUPYTER_PREFER_ENV_PATH": "1",
        "JUPYTER_PATH": "",
        "PYTHONPATH": os.pathsep.join(paths),
        TYPED_IN: str(manifest.relative_to),
    }
    try:
        yield
    finally:
        for name in os.environ.keys() - before.keys():
            del os.environ[name]
        os.environ |= before


def _run_one(manifest: Manifest, task: Task, key: str, *, force: bool) -> Outcome:
    stored = manifest.cache / "notebooks" / f"{task.name}-{key[:24]}.ipynb"
    record = stored.with_suffix(".json")
    with store.lock(stored):
        cached = stored.exists() and record.exists() and not force
        if not cached:
            begun = time.monotonic()
            try:
                _execute(task, stored)
            except PapermillExecutionError as fault:
                if fault.ename == NothingToShowError.__name__ and not task.dataset_asked:
                    _write_empty_page(task, stored, str(fault.evalue))
                else:
                    error = f"notebooks/{task.path.name}: cell {fault.cell_index + 1}: {fault.ename}: {fault.evalue}"
                    return Outcome(task.name, key, False, time.monotonic() - begun, task.parameters, error)
            store.write_json(record, {"key": key, "seconds": round(time.monotonic() - begun, 3)})
        seconds = store.read_json(record)["seconds"]
    return Outcome(task.name, key, cached, seconds, task.parameters, stored=stored)


def _execute(task: Task, stored: Path) -> None:
    """Run one notebook into ``stored``; if it fails, nothing is stored."""
    with store.replacing(stored) as temporary:
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
                    extra_arguments=["--log-level=CRITICAL"],  # the kernel's own chatter; errors reach us as exceptions
                )
            _strip(temporary)
        finally:
            source.unlink(missing_ok=True)


def _write_empty_page(task: Task, stored: Path, reason: str) -> None:
    """Put a page that says why there is nothing to show in the place of a notebook that no dataset suits."""
    cells = jupytext.read(task.path).cells
    first = next(cell for cell in cells if cell.cell_type == "markdown")
    note = nbformat.v4.new_markdown_cell(f":::{{admonition}} Nothing to show in this run\n{reason}\n:::")
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_markdown_cell(first.source), note])
    with store.replacing(stored) as temporary:
        nbformat.write(notebook, temporary)
    _strip(stored)


def _strip(path: Path) -> None:
    """Take out what differs between equal runs (times, paths, identifiers), and hide papermill's own cell.

    The values it injects stand in the page's provenance box.
    """
    notebook = nbformat.read(path, as_version=4)
    notebook.metadata.pop("papermill", None)
    for number, cell in enumerate(notebook.cells):
        if "injected-parameters" in cell.metadata.get("tags", []):
            cell.metadata["tags"] = [*cell.metadata["tags"], "remove-cell"]
        cell.metadata.pop("papermill", None)
        cell.metadata.pop("execution", None)
        cell["id"] = f"cell-{number}"
    nbformat.write(notebook, path)


def _key(manifest: Manifest, task: Task, shared: Mapping[str, Any], fingerprints: Mapping[str, Any]) -> str:
    cells = [[cell.cell_type, cell.source, cell.metadata.get("tags", [])] for cell in jupytext.read(task.path).cells]
    return store.key(
        stage="notebook",
        cells=cells,
        parameters=task.parameters,
        # A page that says that nothing suits is not the answer to one that was asked for.
        **({"dataset_asked": True} if task.dataset_asked else {}),
        shared=shared,
        datasets={name: fingerprints[name] for name in task.datasets},
        methods={name: methods.fingerprint(name, manifest.method(name)) for name in task.methods},
    )


def _shared_inputs(manifest: Manifest) -> dict[str, Any]:
    """What every notebook depends on: the library, the manifest's text and the versions that run it."""
    package = Path(__file__).resolve().parents[1]
    files = sorted(p for p in package.rglob("*") if p.is_file() and p.suffix in _SOURCES)
    sources = dict(zip((str(p.relative_to(package)) for p in files), store.digest_of_files(files), strict=True))
    return {
        "sources": sources,
        "manifest": store.digest_of_file(manifest.path),
        "timings": timing.stored_times(manifest),
        "weights": {name: weights.state(name, entry).summary for name, entry in manifest.methods.items()},
        "versions": {name: version(name) for name in _RUN_WITH},
    }


def _fingerprint(manifest: Manifest, dataset: str) -> list[Any]:
    """Content of a dataset as a notebook sees it: images, positions, and whether images are at hand."""
    return [
        [traversal.name, traversal.digest, traversal.positions, traversal.has_images]
        for traversal in load_all(manifest, dataset)
    ]
