"""Which notebooks run with which parameters, and what each of them needs; all is checked before anything runs."""

from __future__ import annotations

import contextlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from artifact import datasets, store
from artifact.book import parameters
from artifact.extraction import extract
from artifact.manifest import Manifest
from artifact.manifest.entries import ManifestError
from artifact.methods import weights
from artifact.pages.scope import named
from artifact.studies import reported
from artifact.studies.common import single_stage


@dataclass(frozen=True)
class Task:
    """A notebook, a ``.py`` file, with the checked parameters of one run and what it uses, to be made ready before.

    ``dataset_asked`` says that its one dataset was asked for by name and for this notebook alone: then one that does
    not suit is an error, else the page says so. ``changed`` are the parameters in which it differs from the profile's own
    page; that one is its ``companion``, and ``missing`` says what that one needs and this machine lacks.
    """

    path: Path
    parameters: dict[str, Any]
    datasets: tuple[str, ...]
    methods: tuple[str, ...]
    dataset_asked: bool = False
    profile: str = "demo"
    changed: Mapping[str, Any] = field(default_factory=dict)
    companion: bool = False
    missing: str | None = None

    @property
    def name(self) -> str:
        """File name without its ending, for example ``tab03``."""
        return self.path.stem

    @property
    def page(self) -> str:
        """Name of the page: the notebook's own, or with changed parameters one that tells them from each other."""
        if not self.changed:
            return self.name
        words = "-".join(re.findall(r"[A-Za-z0-9]+", json.dumps(self.changed)))[:40]
        return f"{self.name}-{words}-{store.key(**self.changed)[:4]}"


def plan(
    manifest: Manifest,
    profile: str,
    *,
    only: Sequence[str] = (),
    asked: Mapping[str, Mapping[str, Any]] | None = None,
) -> list[Task]:
    """Find the notebooks and check every parameter, before anything runs.

    A notebook for which other parameters are asked makes two pages: that of the profile, and beside it the one asked for.

    Parameters
    ----------
    profile
        Sets ``profile`` and may set further parameters of each notebook.
    only
        Names of notebooks; default all.
    asked
        Parameters by notebook name; those under ``"*"`` go to every notebook that has them.

    Raises
    ------
    ParameterError
        If a notebook or parameter is unknown or a value is not allowed.
    """
    folder = manifest.path.parent / "notebooks"
    found = {path.stem: path for path in sorted(folder.glob("*.py"))}
    asked = dict(asked or {})
    everywhere = dict(asked.pop("*", {}))
    if unknown := [name for name in (*only, *asked) if name not in found]:
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
        own = {"profile": profile} if "profile" in defaults else {}
        own |= entry.parameters.get(name, {})
        values = parameters.merged(path, own, manifest)
        tasks.append(_task(manifest, profile, path, values, "dataset" in entry.parameters.get(name, {})))
        wanted = parameters.merged(path, {**own, **here, **asked.get(name, {})}, manifest)
        if changed := {key: value for key, value in wanted.items() if value != values[key]}:
            tasks[-1] = replace(tasks[-1], companion=True)
            alone = "dataset" in asked.get(name, {}) or "dataset" in entry.parameters.get(name, {}).keys() - here.keys()
            tasks.append(replace(_task(manifest, profile, path, wanted, alone), changed=changed))
    if unused := set(everywhere) - used:
        raise parameters.ParameterError(f"no notebook has a parameter {sorted(unused)[0]!r}")
    return tasks


def _task(manifest: Manifest, profile: str, path: Path, values: dict[str, Any], dataset_asked: bool) -> Task:
    """A notebook with the datasets and methods that it uses, read off its parameters."""
    entry = manifest.profile(profile)
    names = named(values, "dataset", entry.datasets) if {"dataset", "datasets"} & values.keys() else ()
    used = named(values, "method", entry.methods) if names and {"method", "methods"} & values.keys() else ()
    if "single_stage" in path.read_text(encoding="utf-8"):
        used = tuple(single_stage(manifest, used))
    return Task(path, values, names, used, dataset_asked, profile)


def _check_profile(manifest: Manifest, profile: str, notebooks: Mapping[str, Path]) -> None:
    """Check that a profile's page parameters name what the profile has."""
    entry = manifest.profile(profile)
    for page, values in entry.parameters.items():
        where = f"{manifest.path}: profiles.{profile}.parameters.{page}"
        if page not in notebooks:
            raise ManifestError(f"{where}: no such notebook; allowed: {', '.join(notebooks)}")
        for several, one, allowed in (("datasets", "dataset", entry.datasets), ("methods", "method", entry.methods)):
            for name in [*(values.get(several) or []), *filter(None, [values.get(one)])]:
                if name not in allowed:
                    has = ", ".join(allowed)
                    raise ManifestError(f"{where}: names {name!r}, which the profile lacks; it has {has}")


def with_what_is_here(manifest: Manifest, tasks: Sequence[Task]) -> list[Task]:
    """Return the tasks; a companion whose data or weights are not on this machine says so on its page instead of failing."""

    def possible(task: Task) -> Task:
        try:
            check(manifest, [task])
        except (datasets.DatasetError, weights.WeightsError, ManifestError) as error:
            return replace(task, datasets=(), methods=(), missing=str(error))
        return task

    return [possible(task) if task.companion else task for task in tasks]


def prepare(manifest: Manifest, tasks: Sequence[Task]) -> None:
    """Render or find every dataset and extract every descriptor that the tasks use, with progress bars."""
    for (_, method), traversals in check(manifest, tasks).items():
        for traversal in traversals:
            extract.descriptors(manifest, traversal, method, progress=True)


def check(manifest: Manifest, tasks: Sequence[Task]) -> dict[tuple[str, str], list[datasets.Traversal]]:
    """Render or find every dataset that the tasks use; return the traversals of each dataset and method.

    Raises
    ------
    WeightsError
        If weights are missing that something must still be extracted with.
    StoreError
        If the disk has no room for the local features and codes that are missing.
    """
    pairs = pairs_of(tasks)
    loaded = {name: load_all(manifest, name) for name in datasets_of(tasks)}
    extracted = {m for d, m in pairs for t in loaded[d] if t.has_images and not extract.is_ready(manifest, t, m)}
    weights.require({method: manifest.method(method) for method in sorted(extracted)})
    extract.check_disk(manifest, (t for traversals in loaded.values() for t in traversals), sorted(extracted))
    return {(dataset, method): loaded[dataset] for dataset, method in pairs}


def datasets_of(tasks: Sequence[Task]) -> list[str]:
    """Return the datasets that tasks use, each once."""
    return list(dict.fromkeys(name for task in tasks for name in task.datasets))


def pairs_of(tasks: Sequence[Task]) -> list[tuple[str, str]]:
    """Return the datasets and methods that tasks use together, each pair once."""
    return list(dict.fromkeys((name, method) for task in tasks for name in task.datasets for method in task.methods))


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
