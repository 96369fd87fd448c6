"""Dataset × method → :class:`~artifact.metrics.Evaluation`, stored under the key of its inputs.

The studies call :func:`evaluation`; it loads the traversals, gets their descriptors and ranks them, or reads the
stored ranking when every input is the same.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from artifact import datasets, extract, ranking, store
from artifact.archive import stored
from artifact.datasets import Dataset
from artifact.extract import Descriptors
from artifact.manifest import Manifest
from artifact.metrics import Evaluation, evaluate


@dataclass(frozen=True)
class Measured:
    """An evaluation with the record of what it was made from.

    Attributes
    ----------
    evaluation
        The metrics.
    dataset
        The dataset with its loaded traversals.
    method
        Name of the method.
    inputs
        One record per traversal used: names, number of images, descriptor key and source.
    """

    evaluation: Evaluation
    dataset: Dataset
    method: str
    inputs: tuple[dict[str, Any], ...]


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
) -> Described:  # fmt: skip
    """Load a dataset, with further traversals, and get the descriptors of each."""
    loaded = datasets.load(manifest, dataset, traversals)
    found = {
        name: extract.descriptors(manifest, traversal, method, device=device)
        for name, traversal in loaded.traversals.items()
    }
    return Described(loaded, method, found)


def evaluation(
    manifest: Manifest,
    dataset: str,
    method: str,
    *,
    distractors: Iterable[str] = (),
    pool_size: int | None = None,
    retrieve: int = 0,
    similarity: str = "cosine",
    seed: int = 0,
    device: Any = None,
) -> Measured:
    """Evaluate a method on a dataset.

    Parameters
    ----------
    manifest
        The manifest.
    dataset, method
        Names in the manifest; ``dataset`` may be a folder.
    distractors
        Traversals that serve as distractor pools, one pool each; none takes the evaluated queries (the paper's
        main setting). The query traversal may be among them and then also means the evaluated queries.
    pool_size
        Cut every pool to this many images, chosen by ``seed`` (paper Fig. 7: the number is held constant).
    retrieve
        Length of the retrieval lists.
    similarity, seed, device
        As in :func:`artifact.evaluate`.
    """
    names = list(distractors)
    described = describe(manifest, dataset, method, names, device=device)
    loaded = described.dataset
    options = {"retrieve": retrieve, "seed": seed, "similarity": similarity}
    key = store.key(
        stage="ranking", revision=ranking.REVISION, inputs=described.key_inputs(), options=options,
        pools=names, pool_size=pool_size,
    )  # fmt: skip

    def compute() -> dict[str, Evaluation]:
        pools = {name: _pool(loaded, name, described.descriptors[name], pool_size, seed) for name in names}
        result = evaluate(
            described.query.values, described.database.values, loaded.query.positions, loaded.database.positions,
            loaded.threshold,
            {name: values for name, (values, _) in pools.items()} or None,
            {name: positions for name, (_, positions) in pools.items()} or None,
            device=device, **options,
        )  # fmt: skip
        return {"evaluation": result}

    result = stored(manifest, key, compute, {"dataset": dataset, "method": method, "stage": "ranking"})
    return Measured(result["evaluation"], loaded, method, described.inputs)


def _pool(
    dataset: Dataset, name: str, described: Descriptors, size: int | None, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """Descriptors and positions of a distractor pool; the query traversal gives its evaluated queries."""
    values, positions = described.values, dataset.traversals[name].positions
    if name == dataset.query_name:
        starts, _ = ranking.positives_of(positions, dataset.database.positions, dataset.threshold)
        evaluated = np.flatnonzero(np.diff(starts))
        values, positions = values[evaluated], positions[evaluated]
    if size is not None:
        if size > len(positions):
            raise ValueError(
                f"{dataset.name}/{name} has {len(positions)} images for a pool of {size}; ask for at most that"
            )
        chosen = np.sort(np.random.default_rng(seed).choice(len(positions), size, replace=False))
        values, positions = values[chosen], positions[chosen]
    return values, positions
