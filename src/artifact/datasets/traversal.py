"""A traversal: ordered images with positions, under one condition."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from artifact.datasets.positives import positives_of
from artifact.manifest.entries import PaperCounts

CHANGED = (
    "its content is not what its digest says, though it was not written since, as on a damaged disk; restore it, or take "
    "it as it is: run again with --check-images"
)


class DatasetError(ValueError):
    """A dataset that cannot be used; the message names the file or folder and what to do."""


@dataclass(frozen=True)
class Given:
    """A ``.npy`` file of descriptors, local features or codes that came with a dataset, and the digest of its bytes.

    Of a results bundle there is no file: ``path`` is ``None``, and ``record`` says what the descriptors were made from. For
    local features and codes ``sha256`` then is their content key.
    """

    path: Path | None
    sha256: str
    record: Mapping[str, Any] = field(default_factory=dict, repr=False)


@dataclass(frozen=True)
class Traversal:
    """One pass through the places of a dataset, under one condition, for example ``night``.

    Attributes
    ----------
    image_names
        File name of each image, relative to ``folder``, in the order of ``positions``.
    positions
        ``(n, p)`` float64: metres, or one column of frame indices or pair indices.
    digest
        Content key of image names, image bytes and order; descriptors do not depend on positions.
    folder
        Folder of the images; ``None`` if only stored descriptors are at hand.
    descriptors, second_stage
        Files that came with the dataset, or records of a results bundle, by method.
    image_digests
        SHA-256 of each image, as far as they were read.
    preparation
        What the sidecar of a traversal that was prepared from published files records, else empty.
    """

    dataset: str
    name: str
    condition: str
    image_names: tuple[str, ...]
    positions: np.ndarray = field(repr=False)
    digest: str
    folder: Path | None = None
    descriptors: Mapping[str, Given] = field(default_factory=dict, repr=False)
    second_stage: Mapping[str, Given] = field(default_factory=dict, repr=False)
    image_digests: tuple[str, ...] = field(default=(), repr=False)
    preparation: Mapping[str, Any] = field(default_factory=dict, repr=False)

    def __len__(self) -> int:
        return len(self.image_names)

    @property
    def has_images(self) -> bool:
        """Whether the image files are at hand."""
        return self.folder is not None

    def image_paths(self) -> list[Path]:
        """Return the image files in order, or raise ``DatasetError`` if only stored descriptors are at hand."""
        if self.folder is None:
            remedy = "set ARTIFACT_DATA_ROOT to the folder that holds them"
            raise DatasetError(f"{self.dataset}/{self.name}: the images are not on this machine; {remedy}")
        return [self.folder / name for name in self.image_names]


@dataclass(frozen=True)
class Dataset:
    """Query and database among traversals by name, with the threshold between them, ready to evaluate.

    Attributes
    ----------
    name, title, shift
        From the manifest, for example ``robotcar``, ``RobotCar``, ``day→night``.
    threshold, unit
        Positive threshold and its unit: ``metres``, ``frames`` or ``pairs``.
    real
        Whether the images are photographs; ``False`` for the rendered town and for made descriptors.
    paper
        Numbers of images that the paper lists, if it has the dataset.
    """

    name: str
    title: str
    shift: str
    threshold: float
    unit: str
    traversals: dict[str, Traversal]
    query_name: str
    database_name: str
    real: bool
    paper: PaperCounts | None = None

    @property
    def differences(self) -> tuple[str, ...]:
        """How the numbers of images differ from those that the paper lists, one sentence each."""
        if self.paper is None:
            return ()
        starts, _ = positives_of(self.query.positions, self.database.positions, self.threshold)
        counts = {
            "query images": (len(self.query), self.paper.queries),
            "database images": (len(self.database), self.paper.database),
            "evaluated queries": (int((np.diff(starts) > 0).sum()), self.paper.evaluated),
        }
        differ = [
            f"{self.title}: {found:,} {what}, the paper lists {listed:,}"
            for what, (found, listed) in counts.items()
            if listed is not None and found != listed
        ]
        if differ and self.paper.choices:
            differ[-1] += f"; these numbers depend on {self.paper.choices}"
        return tuple(differ)

    @property
    def query(self) -> Traversal:
        """The query traversal."""
        return self.traversals[self.query_name]

    @property
    def database(self) -> Traversal:
        """The cross-condition database traversal."""
        return self.traversals[self.database_name]
