"""A dataset with the descriptors of its traversals by one method."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from artifact import datasets
from artifact.datasets import Dataset
from artifact.extraction import extract
from artifact.extraction.extract import Descriptors
from artifact.manifest import Manifest


@dataclass(frozen=True)
class Described:
    """A dataset with the descriptors of its traversals by one method.

    Attributes
    ----------
    dataset, method
        The loaded dataset, and the name of the method.
    descriptors
        By traversal.
    """

    dataset: Dataset
    method: str
    descriptors: dict[str, Descriptors]

    @property
    def query(self) -> Descriptors:
        """Descriptors of the query traversal."""
        return self.descriptors[self.dataset.query_name]

    @property
    def database(self) -> Descriptors:
        """Descriptors of the database traversal."""
        return self.descriptors[self.dataset.database_name]

    @property
    def inputs(self) -> tuple[dict[str, Any], ...]:
        """One record per traversal, for provenance."""
        return tuple(
            {
                "dataset": traversal.dataset,
                "traversal": name,
                "method": self.method,
                "images": len(traversal),
                "descriptors": self.descriptors[name].key[:12],
                "source": self.descriptors[name].source,
            }
            for name, traversal in self.dataset.traversals.items()
        )

    def key_inputs(self) -> dict[str, Any]:
        """Return what a content key of anything made from these descriptors must hold."""
        return {
            "descriptors": {name: found.sha256 for name, found in self.descriptors.items()},
            "positions": {name: traversal.positions for name, traversal in self.dataset.traversals.items()},
            "pair": [self.dataset.query_name, self.dataset.database_name, self.dataset.threshold],
        }


def describe(
    manifest: Manifest, dataset: str, method: str, traversals: Iterable[str] = (), *, device: Any = None
) -> Described:
    """Load a dataset, with further traversals, and get the descriptors of each."""
    loaded = datasets.load(manifest, dataset, traversals)
    found = {
        name: extract.descriptors(manifest, traversal, method, device=device)
        for name, traversal in loaded.traversals.items()
    }
    return Described(loaded, method, found)
