"""A part of a run computed anew, from images on, in a cache of its own, beside what is stored or imported."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from artifact.book import notebooks, stages
from artifact.commands import jobs
from artifact.commands.jobs import Job
from artifact.extraction import extract, made
from artifact.manifest import CACHE_VARIABLE, Manifest
from artifact.manifest.entries import ManifestError
from artifact.metrics import stored
from artifact.metrics.evaluation import Evaluation
from artifact.metrics.two_stage import Sweep, TwoStageEvaluation

Arrays = Mapping[str, np.ndarray]

_CLOSE = 1e-5
"""Difference of two cosines that counts as none: the last digit of a product turns on where its operands lie."""

_CHAOTIC = "embedding"
"""The study whose numbers turn on the last digit: UMAP."""


def lines(manifest: Manifest, profile: str, asked: str) -> Iterator[tuple[str, bool]]:
    """Compute the results of the pages for one dataset and method anew; yield lines, and whether each is of a difference.

    Parameters
    ----------
    manifest, profile
        The profile whose pages have run, here or on the machine that a bundle is from.
    asked
        ``"DATASET × METHOD"``, with ``x`` as well.

    Raises
    ------
    ManifestError
        If the profile has no such dataset and method.
    DatasetError
        If the images are not on this machine.
    """
    dataset, method = _pair(manifest, profile, asked)
    tasks = [
        replace(task, datasets=(dataset,), methods=(method,))
        for task in notebooks.plan(manifest, profile)
        if dataset in task.datasets and method in task.methods
    ]
    with tempfile.TemporaryDirectory(prefix="artifact-") as folder:
        with stages.environment({CACHE_VARIABLE: folder}):
            anew = manifest.for_profile(profile)
            if anew.profile(profile).made:
                made.make(anew, profile)
            else:
                for traversal in notebooks.load_all(anew, dataset):
                    traversal.image_paths()
            notebooks.prepare(anew, tasks)
            there = _digests(anew, dataset, method)
        here = _digests(manifest, dataset, method)
        for name, digest in here.items():
            same = there.get(name) == digest
            words = "" if same else ": other bytes, as on another machine; what follows decides"
            yield f"{'EQUAL' if same else 'OTHER':<8} descriptors of {dataset}/{name}{words}", False
        known = {path.name for path in (manifest.cache / "rankings").glob("*.npz")}
        for job in jobs.graph(manifest, tasks):
            if job.pair == (method, dataset) and job.kind != "extract":
                before = _results(manifest, job)
                if not before.keys() <= known:
                    yield f"{'SKIPPED':<8} {job.name}: was not stored, so there is nothing to compare with", False
                    continue
                with stages.environment({CACHE_VARIABLE: folder}):
                    found = _results(anew, job)
                yield from _compared(job, before, found, exact=here == there)


def _pair(manifest: Manifest, profile: str, asked: str) -> tuple[str, str]:
    names = [part.strip() for part in re.split(r"\s+[x×]\s+|×", asked.strip())]
    entry = manifest.profile(profile)
    if len(names) != 2 or names[0] not in entry.datasets or names[1] not in entry.methods:
        known = f"its datasets are {', '.join(entry.datasets)}, its methods {', '.join(entry.methods)}"
        raise ManifestError(f"{asked!r} is not 'DATASET x METHOD' of profile {profile!r}: {known}")
    return names[0], names[1]


def _digests(manifest: Manifest, dataset: str, method: str) -> dict[str, str]:
    loaded = notebooks.load_all(manifest, dataset)
    return {one.name: extract.descriptors(manifest, one, method).sha256 for one in loaded}


def _results(manifest: Manifest, job: Job) -> dict[str, dict[str, np.ndarray]]:
    """Arrays of all results that a job reads or makes, in order, by the names of their files."""
    mine, found = replace(manifest, results=[]), {}
    assert callable(job.work)
    job.work(mine)
    for name in dict.fromkeys(mine.results):
        with np.load(manifest.cache / name, allow_pickle=False) as arrays:
            found[Path(name).name] = dict(arrays)
    return found


def _compared(
    job: Job, before: Mapping[str, Arrays], found: Mapping[str, Arrays], *, exact: bool
) -> Iterator[tuple[str, bool]]:
    """Compare results of equal descriptors number by number, those of others by the hits at 1."""
    if job.kind == _CHAOTIC:
        yield f"{'SKIPPED':<8} {job.name}: not compared, UMAP's picture turns on the last digit", False
        return
    for one, other in zip(before.values(), found.values(), strict=True):
        words = [
            f"{name} {_percent(hits)}{'' if np.array_equal(hits, now) else f', now {_percent(now)}'}"
            for (name, hits), now in zip(_hits(one).items(), _hits(other).values(), strict=True)
        ]
        differs = any(", now " in text for text in words)
        if exact and (odd := [name for name in one if not _same(one[name], other.get(name))]):
            differs = True
            words.append(f"other values in {len(odd)} arrays, first {odd[0]}")
        yield f"{'DIFFERS' if differs else 'EQUAL':<8} {job.name}: {'; '.join(words) or f'{len(one)} arrays'}", differs


def _hits(arrays: Arrays) -> dict[str, np.ndarray]:
    """Hits at 1 without and with distractors of every evaluation and view."""
    results, found = stored.read(arrays), {}
    if "database_ranks" in results:
        results = {"": TwoStageEvaluation.from_arrays(results, _no_sweep)}
    for name, one in results.items():
        if isinstance(one, (Evaluation, TwoStageEvaluation)):
            views = getattr(one, "views", [""])
            for view in views:
                shown = one[view] if view else one
                words = (name, view if len(views) > 1 else "")
                label = " ".join(word for word in words if word not in ("", "evaluation", "views"))
                for metric, distractors in (("R@1", False), ("DAR@1", True)):
                    found[f"{label} {metric}".strip()] = shown.hits(1, distractors=distractors)
    return found


def _no_sweep(_: str) -> Sweep:
    raise NotImplementedError


def _percent(hits: np.ndarray) -> str:
    return f"{100 * hits.mean():.2f} %"


def _same(one: np.ndarray, other: np.ndarray | None) -> bool:
    if other is None or one.shape != other.shape:
        return False
    if one.dtype.kind == "f":
        return bool(np.allclose(one, other, rtol=_CLOSE, atol=_CLOSE, equal_nan=True))
    return bool(np.array_equal(one, other))
