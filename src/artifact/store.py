"""What persists: content keys, whole-file writes, locks, and results with a sidecar that says what made them.

A result is reused only when its key is equal: the key is the hash of everything that the result depends on
(content of the inputs, parameters, revision of the code stage). Nothing is reused because a file exists, and
deleting the cache folder is always safe.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import os
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from filelock import FileLock


class StoreError(RuntimeError):
    """A stored result that does not fit its sidecar."""


# -- keys ---------------------------------------------------------------------------------------------------


def key(**inputs: Any) -> str:
    """Return the content key of named inputs: 64 hexadecimal digits.

    Inputs may be numbers, strings, booleans, ``None``, sequences, mappings with string keys, paths, dataclasses
    and NumPy arrays. The order of mapping keys does not matter; the order of sequences does.

    Examples
    --------
    >>> key(a=1, b=[2, 3]) == key(b=[2, 3], a=1)
    True
    >>> key(a=1) == key(a=1.5)
    False
    """
    return hashlib.sha256(canonical(inputs).encode()).hexdigest()


def canonical(value: Any) -> str:
    """Return JSON text that is equal for equal values, with arrays replaced by their digest."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), default=_jsonable, allow_nan=True)


def _jsonable(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return {"array": digest_of_array(value)}
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, Mapping):
        return dict(value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
    raise TypeError(f"cannot make a content key from {type(value).__name__}")


def digest_of_array(array: np.ndarray) -> str:
    """Return the hash of an array's dtype, shape and values."""
    array = np.ascontiguousarray(array)
    digest = hashlib.sha256(f"{array.dtype.str}{array.shape}".encode())
    digest.update(array.reshape(-1).view(np.uint8).data)
    return digest.hexdigest()


def digest_of_file(path: Path) -> str:
    """Return the SHA-256 of a file's bytes."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def digest_of_files(paths: list[Path], cache: Path | None = None) -> list[str]:
    """Return the SHA-256 of each file, remembering them by path, size and modification time.

    Parameters
    ----------
    paths
        The files.
    cache
        Cache folder for the memory of digests; ``None`` reads every file.
    """
    if cache is None:
        return [digest_of_file(path) for path in paths]
    folder = paths[0].parent if paths else Path()
    memory_path = cache / "digests" / f"{key(folder=folder.resolve())[:16]}.json"
    with lock(memory_path):
        memory: dict[str, list[Any]] = read_json(memory_path) if memory_path.exists() else {}
        digests, changed = [], False
        for path in paths:
            status = path.stat()
            stamp = [status.st_size, status.st_mtime_ns]
            known = memory.get(str(path))
            if known is None or known[:2] != stamp:
                known, changed = [*stamp, digest_of_file(path)], True
                memory[str(path)] = known
            digests.append(known[2])
        if changed:
            write_json(memory_path, memory)
    return digests


# -- whole-file writes --------------------------------------------------------------------------------------


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a temporary path beside ``path``; on success flush it to disk and rename it over ``path``.

    If the body raises, or the process dies, ``path`` keeps its old content (or stays absent).
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=f".tmp{path.suffix}", dir=path.parent)
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        with temporary.open("rb+") as stream:
            os.fsync(stream.fileno())
        temporary.chmod(0o644)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def write_json(path: Path, value: Any) -> None:
    """Write a value as readable JSON, whole or not at all."""
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(value, indent=1, sort_keys=True, default=_jsonable) + "\n", encoding="utf-8")


def read_json(path: Path) -> Any:
    """Read JSON, or raise :class:`StoreError` that names the file."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise StoreError(f"{path}: cannot be read as JSON ({error}); delete it and run again") from None


@contextlib.contextmanager
def lock(path: Path) -> Iterator[None]:
    """Hold the lock of a stored result, so that parallel notebooks make it once."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with FileLock(path.with_name(f".{path.name}.lock")):
        yield


# -- arrays with a sidecar ----------------------------------------------------------------------------------


def save_arrays(path: Path, arrays: Mapping[str, np.ndarray], sidecar: Mapping[str, Any]) -> None:
    """Write ``path`` (``.npz``) and then its sidecar ``.json``, which completes the result.

    Parameters
    ----------
    path
        Target, with the suffix ``.npz``.
    arrays
        Named arrays.
    sidecar
        Everything that the result was made from; must hold its ``key``.
    """
    with replacing(path) as temporary:
        np.savez(temporary, allow_pickle=False, **arrays)
    write_json(path.with_suffix(".json"), {**sidecar, "sha256": digest_of_file(path)})


def load_arrays(path: Path, expected_key: str) -> dict[str, np.ndarray] | None:
    """Read arrays whose sidecar holds ``expected_key``; ``None`` if there is no such complete result."""
    sidecar_path = path.with_suffix(".json")
    if not (path.exists() and sidecar_path.exists()):
        return None
    if read_json(sidecar_path).get("key") != expected_key:
        return None
    with np.load(path, allow_pickle=False) as stored:
        return {name: stored[name] for name in stored.files}
