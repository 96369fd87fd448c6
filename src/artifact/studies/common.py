"""What all studies share: the form of their result, and where a number is from."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from artifact.manifest import Manifest
from artifact.manifest.entries import ManifestError
from artifact.metrics.statistics import interval_of_means
from artifact.studies.evaluated import Measured

PERCENT = 100.0
METRICS = ("R", "DAR", "RSR")


class NothingToShowError(ManifestError):
    """No dataset of the run has what a page needs; the page then says so instead of failing the run."""


@dataclass(frozen=True)
class Study:
    """A result with its provenance.

    Attributes
    ----------
    table
        Tidy frame.
    inputs
        One record per traversal and method used: number of images, descriptor key and source.
    """

    table: pd.DataFrame
    inputs: tuple[dict[str, Any], ...]


def origin(measured: Measured) -> str:
    """Say in words what a measurement is from."""
    sources = {record["source"] for record in measured.inputs}
    if "given descriptors" in sources:
        return "given descriptors" if measured.dataset.real else "made descriptors"
    if not measured.dataset.real:
        return "rendered images"
    stored = any(record["source"] != "images" for record in measured.inputs)
    return "real images, shipped descriptors" if stored else "real images"


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


def percent_interval(values: np.ndarray, evaluation: Any, *, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return the 95 % intervals, in percent, of the means of per-query values ``(n, m)`` of an evaluation."""
    low, high = interval_of_means(values, evaluation.query_positions, evaluation.threshold, seed=seed)
    return PERCENT * low, PERCENT * high


def is_reported(manifest: Manifest, dataset: str, name: str, k: int = 1) -> bool:
    """Whether a dataset is the one that the paper calls ``name``; its curves are for K = 1 only."""
    return k == 1 and manifest.dataset(dataset).reported_as == name
