"""Evaluations and arrays on disk, made once for each key."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from artifact import store
from artifact.manifest import Manifest
from artifact.metrics.evaluation import Evaluation


def stored(
    manifest: Manifest, key: str, compute: Callable[[], dict[str, Any]], record: Mapping[str, Any]
) -> dict[str, Any]:
    """Return stored results of a content key, or compute and store evaluations and arrays by name.

    ``compute`` runs while the key's lock is held, so that parallel notebooks compute a result once; ``record`` are
    facts for the sidecar, for people who look into the cache.
    """
    path = path_of(manifest, key)
    manifest.results.append(path.relative_to(manifest.cache).as_posix())
    with store.lock(path):
        arrays = store.load_arrays(path, key)
        if arrays is None:
            mark = len(manifest.results)
            results, arrays = compute(), {}
            del manifest.results[mark:]  # what it was computed from is in it
            for name, value in results.items():
                if isinstance(value, Evaluation):
                    arrays |= {f"evaluation:{name}:{part}": array for part, array in value.arrays().items()}
                else:
                    arrays[f"array:{name}"] = np.asarray(value)
            store.save_arrays(path, arrays, {"key": key, **record})
            return results
    return read(arrays)


def path_of(manifest: Manifest, key: str) -> Path:
    """Return the file that holds, or would hold, the results of a content key."""
    return manifest.cache / "rankings" / f"{key[:24]}.npz"


def is_stored(manifest: Manifest, key: str) -> bool:
    """Whether results of a content key are stored."""
    return store.record_path(path_of(manifest, key)).exists()


def read(arrays: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Return the evaluations and arrays by name that are stored as arrays."""
    results: dict[str, Any] = {}
    parts: dict[str, dict[str, np.ndarray]] = {}
    for full, array in arrays.items():
        kind, name, *rest = full.split(":")
        if kind == "array":
            results[name] = array
        else:
            parts.setdefault(name, {})[rest[0]] = array
    return results | {name: Evaluation.from_arrays(part) for name, part in parts.items()}
