"""Evaluations and arrays on disk, made once for each key."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from artifact import store
from artifact.manifest import Manifest
from artifact.metrics.evaluation import NO_POOL, Evaluation
from artifact.ranking.counting import Counts
from artifact.ranking.one_pass import Ranking


def stored(
    manifest: Manifest, key: str, compute: Callable[[], dict[str, Any]], record: Mapping[str, Any]
) -> dict[str, Any]:
    """Return stored results of a key, or compute and store them.

    Parameters
    ----------
    manifest
        Its folder holds the cache.
    key
        Content key of all inputs.
    compute
        Returns evaluations and arrays by name; called while the key's lock is held, so that parallel notebooks
        compute a result once.
    record
        Facts for the sidecar, for people who look into the cache.
    """
    path = manifest.cache / "rankings" / f"{key[:24]}.npz"
    with store.lock(path):
        arrays = store.load_arrays(path, key)
        if arrays is not None:
            return _unflattened(arrays)
        results = compute()
        store.save_arrays(path, _flattened(results), {"key": key, **record})
    return results


def _flattened(results: Mapping[str, Any]) -> dict[str, np.ndarray]:
    arrays: dict[str, np.ndarray] = {}
    for name, value in results.items():
        if isinstance(value, Evaluation):
            arrays |= {f"evaluation:{name}:{part}": array for part, array in packed(value).items()}
        else:
            arrays[f"array:{name}"] = np.asarray(value)
    return arrays


def _unflattened(arrays: Mapping[str, np.ndarray]) -> dict[str, Any]:
    results: dict[str, Any] = {}
    parts: dict[str, dict[str, np.ndarray]] = {}
    for full, array in arrays.items():
        kind, name, *rest = full.split(":")
        if kind == "array":
            results[name] = array
        else:
            parts.setdefault(name, {})[rest[0]] = array
    return results | {name: unpacked(part) for name, part in parts.items()}


def packed(result: Evaluation) -> dict[str, np.ndarray]:
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
            arrays |= {f"{prefix}/{name}": array for name, array in counts._asdict().items()}
    return arrays


def unpacked(arrays: dict[str, np.ndarray]) -> Evaluation:
    """Rebuild an evaluation from :func:`packed`."""

    def counts(prefix: str) -> Counts:
        return Counts(**{name: arrays[f"{prefix}/{name}"] for name in Counts._fields})

    views, pools = arrays["views"].tolist(), arrays["pools"].tolist()
    ranks = Ranking(
        evaluated=arrays["evaluated"],
        n_listed=int(arrays["numbers"][0]),
        n_database=int(arrays["numbers"][1]),
        pool_sizes=dict(zip(pools, arrays["pool_sizes"].tolist(), strict=True)),
        database={view: counts(f"database/{v}") for v, view in enumerate(views)},
        pools={(view, pool): counts(f"pool/{v}/{p}") for v, view in enumerate(views) for p, pool in enumerate(pools)},
    )
    return Evaluation(
        ranking=ranks,
        query_positions=arrays["query_positions"],
        database_positions=arrays["database_positions"],
        pool_positions={pool: arrays[f"pool_positions/{p}"] for p, pool in enumerate(pools)},
        threshold=float(arrays["threshold"]),
        pool_name=pools[0] if pools else NO_POOL,
    )
