"""Evaluations and arrays on disk, made once for each key."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from artifact import store
from artifact.manifest import Manifest
from artifact.metrics.evaluation import Evaluation


def stored(
    manifest: Manifest, key: str, compute: Callable[[], dict[str, Any]], record: Mapping[str, Any]
) -> dict[str, Any]:
    """Return stored results of a content key, or compute and store evaluations and arrays by name.

    ``compute`` runs while the key's lock is held, so that parallel notebooks compute a result once; ``record`` are facts for
    the sidecar, for people who look into the cache.
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
            arrays |= {f"evaluation:{name}:{part}": array for part, array in value.arrays().items()}
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
    return results | {name: Evaluation.from_arrays(part) for name, part in parts.items()}
