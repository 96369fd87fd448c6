"""What all studies share: the form of their result, and where a number is from."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from artifact.extraction.described import Described
from artifact.manifest import Manifest
from artifact.manifest.entries import ManifestError
from artifact.metrics import statistics
from artifact.metrics.result import Result
from artifact.studies.evaluated import Measured

PERCENT = 100.0
METRICS = ("R", "DAR", "RSR")


class NothingToShowError(ManifestError):
    """No dataset of the run has what a page needs; the page then says so instead of failing the run."""


@dataclass(frozen=True)
class Study:
    """A tidy frame with one record per traversal and method used: number of images, descriptor key and source.

    ``replicates`` hold, for some columns of numbers, what the bootstrap makes of them: ``(rows, count)``, in the unit of the
    column. Rows of the same queries were resampled by the same draws, so that replicates of a difference are differences of
    replicates.
    """

    table: pd.DataFrame
    inputs: tuple[dict[str, Any], ...]
    replicates: Mapping[str, np.ndarray] = field(default_factory=dict)


def joined(studies: Sequence[Study]) -> Study:
    """Put the rows of studies with the same columns one after another."""
    table = pd.concat([one.table for one in studies], ignore_index=True)
    sample = {name: np.concatenate([one.replicates[name] for one in studies]) for name in studies[0].replicates}
    return Study(table, tuple(record for one in studies for record in one.inputs), sample)


def origin(measured: Measured | Described) -> str:
    """Say in words what a measurement is from."""
    sources = {record["source"] for record in measured.inputs}
    if "given descriptors" in sources:
        return "given descriptors" if measured.dataset.real else "made descriptors"
    if not measured.dataset.real:
        return "rendered images"
    return "real images" if sources <= {"images"} else "real images, shipped descriptors"


def cell_of(manifest: Manifest, dataset: str, method: str) -> dict[str, Any]:
    """Return the columns that say of which dataset and method a row is."""
    entry = manifest.dataset(dataset)
    return {"dataset": dataset, "reported_as": entry.reported_as, "title": entry.title, "method": method}


def single_stage(manifest: Manifest, methods: Iterable[str]) -> list[str]:
    """Return the methods that describe an image by one descriptor alone.

    Suppression and mixed databases take these only, as in the paper (§V-A): the first stage of a two-stage method is
    never passed off as the method.
    """
    return [method for method in methods if manifest.method(method).rerank is None]


def require_single_stage(manifest: Manifest, method: str) -> None:
    """Raise :class:`ManifestError` for a two-stage method; see :func:`single_stage`."""
    if not single_stage(manifest, [method]):
        raise ManifestError(f"method {method!r} re-ranks; suppression and mixed databases take methods of one stage")


def replicated(values: np.ndarray, evaluation: Result, dataset: str, seed: int) -> np.ndarray:
    """Return replicates ``(m, count)``, in percent, of the means of per-query values ``(n, m)`` of an evaluation."""
    where = evaluation.query_positions, evaluation.threshold
    return PERCENT * statistics.replicates(values, *where, seed=seed, stream=dataset)


def replicated_hits(evaluation: Result, k: int, dataset: str, seed: int) -> np.ndarray:
    """Return replicates ``(2, count)`` of R@K and DAR@K in percent."""
    hits = [evaluation.hits(k, distractors=added) for added in (False, True)]
    return replicated(np.stack(hits, axis=1), evaluation, dataset, seed)


def by_metric(sample: Sequence[np.ndarray], prefix: str = "") -> dict[str, np.ndarray]:
    """Return the replicates of the columns ``R`` and ``DAR``, with a prefix, from those of each row, ``(2, count)``."""
    return dict(zip((f"{prefix}R", f"{prefix}DAR"), np.stack(sample, axis=1), strict=True)) if sample else {}


def shares(sample: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the ends of the 95 % intervals of replicates of shares in percent."""
    return statistics.ends(sample.clip(0, PERCENT))


def is_reported(manifest: Manifest, dataset: str, name: str, k: int = 1) -> bool:
    """Whether a dataset is the one that the paper calls ``name``; its curves are for K = 1 only."""
    return k == 1 and manifest.dataset(dataset).reported_as == name
