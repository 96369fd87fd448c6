"""Dataset × method → :class:`~artifact.metrics.Evaluation`, stored under the key of its inputs.

The studies call :func:`evaluation`; it loads the traversals, gets their descriptors and ranks them, or reads the
stored ranking when every input is the same.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from artifact import datasets, extract, ranking, store
from artifact.counting import Counts
from artifact.datasets import Dataset, Traversal
from artifact.extract import Descriptors
from artifact.manifest import Manifest
from artifact.metrics import QUERY_POOL, Evaluation, evaluate
from artifact.ranking import Ranking


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
    loaded = datasets.load(manifest, dataset, names)
    described = {
        name: extract.descriptors(manifest, traversal, method, device=device)
        for name, traversal in loaded.traversals.items()
    }
    query, database = described[loaded.query_name], described[loaded.database_name]
    pools = {name: _pool(loaded, name, described[name], pool_size, seed) for name in names}
    options = {"retrieve": retrieve, "seed": seed, "similarity": similarity}
    key = store.key(
        stage="ranking", revision=ranking.REVISION, query=query.sha256, database=database.sha256,
        query_positions=loaded.query.positions, database_positions=loaded.database.positions,
        threshold=loaded.threshold, options=options,
        pools={name: [described[name].sha256, positions] for name, (_, positions) in pools.items()},
    )  # fmt: skip
    path = store.cache_folder(manifest.path.parent) / "rankings" / f"{key[:24]}.npz"
    with store.lock(path):
        stored = store.load_arrays(path, key)
        if stored is None:
            result = evaluate(
                query.values, database.values, loaded.query.positions, loaded.database.positions, loaded.threshold,
                {name: values for name, (values, _) in pools.items()} or None,
                {name: positions for name, (_, positions) in pools.items()} or None,
                device=device, **options,
            )  # fmt: skip
            store.save_arrays(
                path, _packed(result), {"key": key, "dataset": dataset, "method": method, **options}
            )
        else:
            result = _unpacked(stored)
    inputs = tuple(_record(loaded.traversals[name], method, found) for name, found in described.items())
    return Measured(result, loaded, method, inputs)


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


def _record(traversal: Traversal, method: str, found: Descriptors) -> dict[str, Any]:
    return {
        "dataset": traversal.dataset,
        "traversal": traversal.name,
        "method": method,
        "images": len(traversal),
        "descriptors": found.key[:12],
        "source": found.source,
    }


# -- an evaluation as plain arrays ----------------------------------------------------------------------------


def _packed(result: Evaluation) -> dict[str, np.ndarray]:
    """Flatten an evaluation into named arrays."""
    ranks = result.ranking
    arrays: dict[str, np.ndarray] = {
        "evaluated": ranks.evaluated,
        "numbers": np.array([ranks.n_listed, ranks.n_database]),
        "threshold": np.array(result.threshold),
        "query_positions": result.query_positions,
        "database_positions": result.database_positions,
        "views": np.array(list(ranks.database)),
        "pools": np.array(list(ranks.pool_sizes)),
        "pool_sizes": np.array(list(ranks.pool_sizes.values())),
    }
    for number, name in enumerate(ranks.pool_sizes):
        arrays[f"pool_positions/{number}"] = result.pool_positions[name]
    for view_number, view in enumerate(ranks.database):
        named = {f"database/{view_number}": ranks.database[view]}
        for number, pool in enumerate(ranks.pool_sizes):
            named[f"pool/{view_number}/{number}"] = ranks.pools[view, pool]
        for prefix, counts in named.items():
            arrays |= {f"{prefix}/{field.name}": getattr(counts, field.name) for field in fields(Counts)}
    return arrays


def _unpacked(arrays: dict[str, np.ndarray]) -> Evaluation:
    """Rebuild an evaluation from :func:`_packed`."""

    def counts(prefix: str) -> Counts:
        return Counts(**{field.name: arrays[f"{prefix}/{field.name}"] for field in fields(Counts)})

    views, pools = arrays["views"].tolist(), arrays["pools"].tolist()
    ranks = Ranking(
        evaluated=arrays["evaluated"],
        n_listed=int(arrays["numbers"][0]),
        n_database=int(arrays["numbers"][1]),
        pool_sizes=dict(zip(pools, arrays["pool_sizes"].tolist(), strict=True)),
        database={view: counts(f"database/{v}") for v, view in enumerate(views)},
        pools={
            (view, pool): counts(f"pool/{v}/{p}")
            for v, view in enumerate(views)
            for p, pool in enumerate(pools)
        },
    )
    return Evaluation(
        ranking=ranks,
        query_positions=arrays["query_positions"],
        database_positions=arrays["database_positions"],
        pool_positions={pool: arrays[f"pool_positions/{p}"] for p, pool in enumerate(pools)},
        threshold=float(arrays["threshold"]),
        pool_name=pools[0] if pools else QUERY_POOL,
    )
