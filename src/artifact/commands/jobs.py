"""The heavy work of a run as a graph of pure jobs, whose outputs stand under content keys on storage that all workers share.

A job describes the images of one part of a traversal by one method, puts the parts of a traversal together, or makes the
results of one page for one method: on one of its datasets, or on all of them where transforms are composed. Whatever a job
finds made already it leaves, so that a run that was interrupted does only what is missing. Pages read what the jobs made.
"""

from __future__ import annotations

import contextlib
import inspect
import math
from collections import Counter
from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import partial
from itertools import product
from typing import Any, NamedTuple

from artifact import datasets, methods, studies
from artifact.book import notebooks
from artifact.book.notebooks import Task
from artifact.commands.costs import PairCost, pair_cost, sizes
from artifact.datasets import Traversal
from artifact.extraction import extract
from artifact.extraction.costs import ExtractionCost
from artifact.extraction.jobs import ExtractionJob, jobs_of
from artifact.extraction.stored import images_of_a_part
from artifact.manifest import Manifest
from artifact.metrics.result import QUERY_POOL
from artifact.studies.evaluated import TwoStage, parts_of
from artifact.studies.fitted import Fitting

_MODEL = 1.0e9  # bytes of Python, the libraries and a small model at work
Work = Callable[[Manifest], object]


@dataclass(frozen=True)
class Job:
    """One piece of work, with a ``name`` of its own in its graph, for example ``extract anyloc robotcar/day 3``.

    ``needs`` are the names of the jobs whose outputs it reads. ``work`` is what it does, given the manifest; an
    :class:`ExtractionJob` runs on the worker's own device, and ``on_device`` says whether a GPU is wanted. ``kind`` is
    ``"extract"`` or the name of a study, with its method and dataset in ``pair``, for what it is expected to take: ``seconds``
    and bytes of ``memory``, or ``None`` if nobody knows.
    """

    name: str
    needs: tuple[str, ...]
    work: Work | ExtractionJob | None = field(repr=False)
    on_device: bool = False
    kind: str = ""
    pair: tuple[str, str] = ("", "")
    seconds: float | None = None
    memory: float | None = None


class _Page(NamedTuple):
    """How the results of a page are cut into jobs.

    ``scope`` is ``each`` (one method on each dataset), ``all`` (one method on all datasets), or ``one`` (one method on the
    page's dataset). ``steps`` are those of :data:`artifact.commands.costs.STEPS` whose time its jobs account for in a plan;
    with ``like`` they need the memory of the largest. ``again`` is what a method that ranks again by local features does in
    parts before: the main ``ranking``, its ``sweep``, or that of the ``pools`` of Fig. 7.
    """

    study: Callable[..., object]
    scope: str
    steps: tuple[str, ...] = ()
    like: tuple[str, ...] = ()
    again: tuple[str, ...] = ()


_SHARED = {"extract": ("extraction",), "rank again": ("ranking",)}  # steps that the jobs of a kind share
_FITTED = ("INLP", "LEACE", "suppressed")
_PAGES: Mapping[str, tuple[_Page, ...]] = {
    "tab03": (_Page(studies.recall.recall_table, "each", ("ranking",), again=("ranking",)),),
    "fig06": (
        _Page(studies.distractors.distractor_number, "one", like=("ranking",), again=("ranking", "sweep")),
        _Page(studies.distractors.distractor_distance, "one", like=("ranking",)),
    ),
    "fig07": (_Page(studies.distractors.distractor_condition, "one", like=("ranking",), again=("pools",)),),
    "fig08": (_Page(studies.suppression.suppression_table, "each", ("LEACE", "suppressed", "probe")),),
    "fig10": (_Page(studies.suppression.fitting_fraction, "each", ("INLP",)),),
    "tab04": (
        _Page(studies.composition.single_against_multi, "all", like=_FITTED),
        _Page(studies.composition.by_iterations, "all", like=_FITTED),
    ),
    "tab05": (_Page(studies.composition.irrelevant_conditions, "all", like=_FITTED),),
    "fig02": (_Page(studies.mixed_database.mixed_database, "one", like=("suppressed",)),),
    "fig09": (_Page(studies.mixed_database.mixed_database_suppressed, "one", like=_FITTED),),
    "fig03": (_Page(studies.embedding.embedding, "one", ("UMAP",)),),
    "erased": (_Page(studies.erased.what_is_erased, "one", like=_FITTED),),
    "within_session": (_Page(studies.within_session.within_session, "each", like=_FITTED),),
}


def graph(manifest: Manifest, tasks: Sequence[Task], *, precision: str = "float32") -> list[Job]:
    """Return the jobs of a run whose datasets are at hand, each after those that it needs.

    Parameters
    ----------
    manifest, tasks
        The pages of the run, as from :func:`artifact.book.notebooks.plan`.
    precision
        Of the descriptors; results of pages are of ``"float32"``.
    """
    found: dict[str, Job] = {}
    traversals: dict[str, dict[str, int]] = {}
    loaded = notebooks.check(manifest, tasks)
    for (name, method), here in loaded.items():
        traversals[name] = {traversal.name: len(traversal) for traversal in here}
        for traversal in here:
            works = jobs_of(manifest, traversal, method, precision)
            parts = [_part(work.method, name, traversal.name, work.number, work) for work in works]
            if parts:
                whole = _whole(name, traversal.name, method)
                assemble = partial(_assemble, name, traversal.name, method, precision)
                found |= {job.name: job for job in parts}
                found[whole] = Job(whole, tuple(job.name for job in parts), assemble)
    found |= _study_jobs(manifest, tasks, traversals, found)
    return with_costs(list(found.values()), [_sizes_of(manifest, *pair) for pair in loaded.items()])


def _sizes_of(manifest: Manifest, pair: tuple[str, str], traversals: Sequence[Traversal]) -> PairCost:
    """What the steps of a pair need of memory, which follows from their sizes; their time is unknown."""
    name, method = pair
    entry, images = manifest.method(method), {one.name: len(one) for one in traversals}
    part = 4.0 * images_of_a_part(entry) * entry.dimension
    weights = sum(file.n_bytes for file in (entry.weights.files if entry.weights else ()))
    extraction = ExtractionCost(method, name, sum(images.values()), 0, None, 0, _MODEL + 2 * weights + part)
    return pair_cost(sizes(manifest, method, name, images), entry, extraction, {})


def planned(
    manifest: Manifest, tasks: Sequence[Task], images: Mapping[str, Mapping[str, int]], costs: Sequence[PairCost]
) -> list[Job]:
    """Return the jobs of a run whose datasets need not be at hand, for a plan: they cannot be run.

    ``images`` are the numbers of images of the traversals of each dataset, as far as they are known.
    """
    pairs = notebooks.pairs_of(tasks)
    found: dict[str, Job] = {}
    for name, method in pairs:
        first = next(other for other in methods.of_trunk(manifest, method) if (name, other) in pairs)
        for traversal, n in images[name].items():
            number = math.ceil(n / images_of_a_part(manifest.method(method)))
            parts = [_part(first, name, traversal, part, None) for part in range(number)]
            found |= {job.name: job for job in parts}
            whole = _whole(name, traversal, method)
            found[whole] = Job(whole, tuple(job.name for job in parts), None, seconds=0.0)
    found |= _study_jobs(manifest, tasks, images, found)
    return with_costs(list(found.values()), costs)


def _part(method: str, dataset: str, traversal: str, number: int, work: ExtractionJob | None) -> Job:
    name = f"extract {method} {dataset}/{traversal} {number}"
    return Job(name, (), work, on_device=True, kind="extract", pair=(method, dataset))


def _whole(dataset: str, traversal: str, method: str) -> str:
    return f"assemble {method} {dataset}/{traversal}"


def _assemble(dataset: str, traversal: str, method: str, precision: str, manifest: Manifest) -> None:
    extract.descriptors(manifest, datasets.load_traversal(manifest, dataset, traversal), method, precision=precision)


def _study_jobs(
    manifest: Manifest, tasks: Sequence[Task], traversals: Mapping[str, Mapping[str, int]], before: Container[str]
) -> dict[str, Job]:
    """Return the jobs of all pages that name their datasets; a page that chooses one for itself computes by itself.

    They need those of the jobs ``before`` that put their traversals together.
    """
    found: dict[str, Job] = {}
    for task in tasks:
        for page in _PAGES.get(task.name, ()):
            if page.scope == "one" and task.parameters.get("dataset") is None:
                continue
            groups = [[name] for name in task.datasets]
            if page.scope == "all":
                groups = [studies.composition.order_of_fitting(manifest, task.datasets)]
            for names in groups:
                for method in task.methods:
                    wholes = [_whole(name, traversal, method) for name in names for traversal in traversals[name]]
                    needs = tuple(whole for whole in wholes if whole in before)
                    kind, where = page.study.__name__, "all" if page.scope == "all" else names[0]
                    parts = _ranked_again(manifest, page, where, method, traversals, task.parameters, needs)
                    found |= {job.name: job for job in parts}
                    on_device = bool(page.again) and manifest.method(method).local_features is not None and not parts
                    name, needs = f"{kind} {method} {where}", (*needs, *(job.name for job in parts))
                    work = partial(_study, page.study, names, method, task.parameters)
                    found[name] = Job(name, needs, work, on_device, kind, (method, where))
    return found


def _ranked_again(
    manifest: Manifest,
    page: _Page,
    dataset: str,
    method: str,
    traversals: Mapping[str, Mapping[str, int]],
    parameters: Mapping[str, Any],
    needs: tuple[str, ...],
) -> list[Job]:
    """Return a job for each part of the queries that a method ranks again by local features, if there are several."""
    entry = manifest.method(method)
    queries = traversals[dataset].get(manifest.dataset(dataset).query, 0) if page.again else 0
    number = len(parts_of(entry, queries))
    if entry.local_features is None or number < 2:
        return []
    found = []
    for what, part in product(page.again, range(number)):
        work = partial(_rank_again, what, part, dataset, method, parameters)
        name = f"rank again {method} {dataset} {what} {part}"
        found.append(Job(name, needs, work, on_device=True, kind="rank again", pair=(method, dataset)))
    return found


def _rank_again(
    what: str, part: int, dataset: str, method: str, parameters: Mapping[str, Any], manifest: Manifest
) -> None:
    pools = studies.distractors.pools_of_conditions(manifest, dataset) if what == "pools" else ((), None)
    both = TwoStage(manifest, dataset, method, *pools, seed=parameters.get("seed", 0))
    if what == "sweep":
        both.make_sweep(part, QUERY_POOL, parameters.get("draws", 20))
    else:
        both.make_ranking(part)


def _study(
    study: Callable[..., object], names: Sequence[str], method: str, parameters: Mapping[str, Any], manifest: Manifest
) -> None:
    """Make the results of a page for one method; a pair that has nothing to show is the page's to say."""
    takes = {*inspect.signature(study).parameters}
    if "fitting" in takes:
        takes |= {one.name for one in fields(Fitting)}
    given = {**parameters, "names": names, "methods": [method], "dataset": names[0], "method": method}
    with contextlib.suppress(studies.common.NothingToShowError):
        study(manifest, **{name: given[name] for name in takes if name in given})


def with_costs(jobs: Sequence[Job], costs: Sequence[PairCost]) -> list[Job]:
    """Return the jobs with what they are expected to take: the steps of each pair, shared among its jobs."""
    steps = {(cost.method, cost.dataset, step.name): step for cost in costs for step in cost.steps}
    for cost in costs:  # a job of all datasets needs the memory of the largest
        for step in cost.steps:
            largest = steps.setdefault((cost.method, "all", step.name), step)
            if step.memory > largest.memory:
                steps[cost.method, "all", step.name] = step
    pages = {page.study.__name__: page for pages in _PAGES.values() for page in pages}
    number = Counter((job.kind, job.pair) for job in jobs if job.kind in _SHARED)
    found = []
    for job in jobs:
        page, timed = pages.get(job.kind), _SHARED.get(job.kind, ())
        if page and ("rank again", job.pair) not in number:  # else the parts take all the time
            timed = page.steps
        mine = [steps[*job.pair, name] for name in timed if (*job.pair, name) in steps]
        alike = [steps[*job.pair, name] for name in (page.like if page else ()) if (*job.pair, name) in steps]
        known = [step.seconds for step in mine if step.seconds is not None]
        seconds = sum(known) / number.get((job.kind, job.pair), 1) if known else job.seconds
        memory = max((step.memory for step in [*mine, *alike]), default=job.memory)
        found.append(replace(job, seconds=seconds, memory=memory))
    return found
