"""A traversal: ordered images with positions, under one condition."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from artifact.datasets.positives import positives_of
from artifact.manifest.entries import PaperCounts


class DatasetError(ValueError):
    """A dataset that cannot be used; the message names the file or folder and what to do."""


@dataclass(frozen=True)
class Given:
    """A file of descriptors, local features or codes that came with a dataset.

    Attributes
    ----------
    path
        The ``.npy`` file.
    sha256
        Digest of its bytes.
    """

    path: Path
    sha256: str


@dataclass(frozen=True)
class Traversal:
    """One pass through the places of a dataset.

    Attributes
    ----------
    dataset, name
        Names in the manifest.
    condition
        Condition under which the images were taken, for example ``night``.
    image_names
        File name of each image, relative to ``folder``, in the order of ``positions``.
    positions
        ``(n, p)`` float64: metres, or one column of frame indices or pair indices.
    digest
        Content key of image names, image bytes and order. Positions are not in it: the descriptors of a
        traversal do not depend on them.
    folder
        Folder of the images; ``None`` if only stored descriptors are at hand.
    descriptors, second_stage
        Files that came with the dataset, by method.
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

    def __len__(self) -> int:
        return len(self.image_names)

    @property
    def has_images(self) -> bool:
        """Whether the image files are at hand."""
        return self.folder is not None

    def image_paths(self) -> list[Path]:
        """Return the image files in order.

        Raises
        ------
        DatasetError
            If only stored descriptors are at hand.
        """
        if self.folder is None:
            raise DatasetError(
                f"{self.dataset}/{self.name}: the images are not on this machine; set ARTIFACT_DATA_ROOT to the "
                f"folder that holds them"
            )
        return [self.folder / name for name in self.image_names]


@dataclass(frozen=True)
class Dataset:
    """Query and database traversals with the threshold between them, ready to evaluate.

    Attributes
    ----------
    name, title, shift
        From the manifest, for example ``robotcar``, ``RobotCar``, ``day→night``.
    threshold, unit
        Positive threshold and its unit: ``metres``, ``frames`` or ``pairs``.
    traversals
        All traversals by name.
    query_name, database_name
        Which of them are the query and the database.
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
        return tuple(
            f"{self.title}: {found:,} {what}, the paper lists {listed:,}"
            for what, (found, listed) in counts.items()
            if listed is not None and found != listed
        )

    @property
    def query(self) -> Traversal:
        """The query traversal."""
        return self.traversals[self.query_name]

    @property
    def database(self) -> Traversal:
        """The cross-condition database traversal."""
        return self.traversals[self.database_name]
