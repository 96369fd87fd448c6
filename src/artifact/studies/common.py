"""What all studies share: the form of their result, and where a number is from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import pandas as pd

from artifact.manifest import Manifest
from artifact.studies.evaluated import Measured

PERCENT = 100.0
METRICS = ("R", "DAR", "RSR")


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
    if not measured.dataset.real:
        return "rendered images"
    stored = any(record["source"] != "images" for record in measured.inputs)
    return "real images, shipped descriptors" if stored else "real images"


def is_reported(manifest: Manifest, dataset: str, name: str, k: int = 1) -> bool:
    """Whether a dataset is the one that the paper calls ``name``; its curves are for K = 1 only."""
    return k == 1 and manifest.dataset(dataset).reported_as == name
