"""What persists: content keys, whole-file writes, locks, and results with a record that says what made them.

A result is reused only when its key is equal: the key is the hash of everything that the result depends on
(content of the inputs, parameters, revision of the code stage). Nothing is reused because a file exists, and
deleting the cache folder is always safe.

Whatever is read is checked first: the record beside a file or in a folder has the digest of its content, and itself a
checksum. What is damaged is set aside, which a line says, and made again.
"""

from __future__ import annotations

import contextlib
import dataclasses
import errno
import functools
import hashlib
import json
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from filelock import FileLock, Timeout
from tqdm import tqdm

from artifact.manifest import CACHE_VARIABLE
from artifact.manifest.layout import names_below

LOG_VARIABLE = "ARTIFACT_LOG"  # a file for lines of processes whose standard error is kept as part of a page
TIMES_VARIABLE = "ARTIFACT_TIMES"  # a file for what the processes of a run spent on its stages
_CHECKSUM = "checksum"
_SETTLED = 2 * 10**9  # nanoseconds: a file that changed less long ago may change again within the same time stamp
_ABANDONED = 24 * 3600  # seconds after which nobody is at work on a temporary file any more
_CANNOT_WRITE = (
    errno.ENOSPC,
    errno.EDQUOT,
    errno.EFBIG,
    errno.EACCES,
    errno.EPERM,
    errno.EROFS,
    errno.EIO,
    errno.ELOOP,
)


class StoreError(RuntimeError):
    """A file that cannot be read or written; the message names it and says what to do."""


class DamagedError(StoreError):
    """A stored result or record whose content is not what it should be."""


def say(line: str) -> None:
    """Write a line to the standard error, above a progress bar if there is one; of a notebook, to that of its run."""
    log = os.environ.get(LOG_VARIABLE)
    if log:
        with Path(log).open("a", encoding="utf-8") as stream:
            stream.write(f"{line}\n")
    else:
        tqdm.write(line, file=sys.stderr)


@contextlib.contextmanager
def stage(name: str) -> Iterator[None]:
    """Report the seconds of a block to the run that this process is part of, if any, as those of a stage."""
    begun = time.monotonic()
    try:
        yield
    finally:
        if times := os.environ.get(TIMES_VARIABLE):
            # A worker on another machine may have inherited the variable without the folder.
            with contextlib.suppress(OSError), Path(times).open("a", encoding="utf-8") as stream:
                stream.write(f"{name},{time.monotonic() - begun:.3f}\n")


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


def digest_of_file(path: Path | str) -> str:
    """Return the SHA-256 of a file's bytes; a file that is not written in between is read once per process."""
    now = stamp(path)
    return _digest_under(str(path), now) if _is_settled(now) else _read_digest(path)


def _read_digest(path: Path | str) -> str:
    with Path(path).open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


@functools.lru_cache(maxsize=1 << 16)
def _digest_under(path: str, _: tuple[int, ...]) -> str:
    return _read_digest(path)


def stamp(path: Path | str) -> tuple[int, ...]:
    """Return what changes whenever a file is written: its size, times and inode; the change time nobody can set."""
    status = os.stat(path)
    return status.st_size, status.st_mtime_ns, status.st_ino, status.st_ctime_ns


def _is_settled(found: tuple[int, ...]) -> bool:
    return time.time_ns() - found[-1] > _SETTLED


def digest_of_files(paths: Sequence[Path] | Sequence[str], cache: Path | None = None) -> list[str]:
    """Return the SHA-256 of each file, remembering them by path, size, times and inode.

    Parameters
    ----------
    paths
        The files.
    cache
        Cache folder for the memory of digests; ``None`` reads every file.
    """
    if cache is None:
        return [digest_of_file(path) for path in paths]
    with _memory_of(paths, cache) as memory:
        digests = []
        for path in paths:
            now = stamp(path)
            digest = _known(memory, path, now) or digest_of_file(path)
            if _is_settled(now):
                memory[str(path)] = [*now, digest]
            digests.append(digest)
    return digests


def changed_in_silence(paths: Sequence[Path], cache: Path) -> list[Path]:
    """Read all files and return those whose content is not what is remembered, though nobody has written them.

    A disk does that, or whoever sets the clock back. Their digests are forgotten, so that they count as they are now.
    """
    with _memory_of(paths, cache) as memory:
        changed = [p for p in paths if _known(memory, p, stamp(p)) not in (None, digest_of_file(p))]
        for path in changed:
            del memory[str(path)]
    return changed


@contextlib.contextmanager
def _memory_of(paths: Sequence[Path] | Sequence[str], cache: Path) -> Iterator[dict[str, Any]]:
    folder = Path(paths[0]).parent if paths else Path()
    place = cache / "digests" / f"{key(folder=folder.resolve())[:16]}.json"
    with lock(place):
        memory = remembered(place)
        before = dict(memory)
        yield memory
        if memory != before:
            write_json(place, memory)


def _known(memory: Mapping[str, Any], path: Path | str, now: tuple[int, ...]) -> str | None:
    known = memory.get(str(path))
    return known[-1] if isinstance(known, list) and known[:-1] == [*now] else None


def remembered(path: Path) -> dict[str, Any]:
    """Read what can be found out again, such as digests; what is damaged is set aside and forgotten."""
    try:
        memory = read_json(path) if path.exists() else {}
        if not isinstance(memory, dict):
            raise DamagedError(f"{path}: holds {type(memory).__name__}, not a mapping")
    except DamagedError as error:
        set_aside(path, str(error))
        return {}
    return memory


# -- whole-file writes --------------------------------------------------------------------------------------


@contextlib.contextmanager
def writing(path: Path) -> Iterator[None]:
    """Say in one line that a file or folder cannot be written, for example because the disk is full."""
    try:
        yield
    except OSError as error:
        if error.errno not in _CANNOT_WRITE and "requested and" not in str(
            error
        ):  # so NumPy says that the disk is full
            raise
        raise StoreError(
            f"{path}: cannot be written ({error.strerror or error}). What is finished stays: make room, or make it writable, or "
            f"set {CACHE_VARIABLE} to a folder on a larger disk, and run again"
        ) from None


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a temporary path beside ``path``; on success flush it to disk and rename it over ``path``.

    If the body raises, or the process dies, ``path`` keeps its old content (or stays absent). Raises ``StoreError`` if it
    cannot be written.
    """
    with writing(path):
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


def sweep(folder: Path) -> None:
    """Delete temporary files and folders that killed runs left below a folder, once they are a day old."""
    for pattern in (".*.tmp*", ".*.partial"):
        for left in [*folder.rglob(pattern)]:
            with contextlib.suppress(OSError):
                if time.time() - left.stat().st_mtime > _ABANDONED:
                    _delete(left)


def write_json(path: Path, value: Any) -> None:
    """Write a value as readable JSON, whole or not at all; a mapping gets a checksum that :func:`read_json` takes out."""
    plain = json.loads(json.dumps(value, default=_jsonable))
    if isinstance(plain, dict):
        plain[_CHECKSUM] = key(of=plain)
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(plain, indent=1, sort_keys=True) + "\n", encoding="utf-8")


def read_json(path: Path) -> Any:
    """Read JSON, or raise :class:`DamagedError` that names the file; one without a checksum is trusted."""
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise StoreError(f"{path}: cannot be read ({error.strerror})") from None
    except (ValueError, RecursionError) as error:
        raise DamagedError(f"{path}: cannot be read as JSON ({error})") from None
    if isinstance(value, dict) and value.pop(_CHECKSUM, None) not in (None, key(of=value)):
        raise DamagedError(f"{path}: its content differs from its checksum")
    return value


@contextlib.contextmanager
def lock(path: Path, waiting: str = "") -> Iterator[None]:
    """Hold the lock of a stored result, so that parallel notebooks make it once; ``waiting`` is said if another has it.

    Results do not depend on it: where the file system has no locks, two that make the same one write the same bytes.
    """
    held = FileLock(path.with_name(f".{path.name}.lock"))
    with writing(path), contextlib.suppress(NotImplementedError):
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            held.acquire(timeout=0)
        except Timeout:
            if waiting:
                say(waiting)
            held.acquire()
    try:
        yield
    finally:
        held.release()


# -- files and folders with a record ------------------------------------------------------------------------


def record_path(path: Path) -> Path:
    """Return the record of a stored file, beside it, or of a stored folder, in it."""
    return path / ".record.json" if path.is_dir() else path.with_suffix(".json")


def seal(path: Path, record: Mapping[str, Any]) -> dict[str, Any]:
    """Write the record of a file or folder, with the digest of its content, which completes it; return the record."""
    sealed = {**record, "sha256": _content(path)}
    write_json(record_path(path), sealed)
    return sealed


def check(path: Path, expected_key: str | None = None, cache: Path | None = None) -> dict[str, Any] | None:
    """Return the record of a file or folder that is whole; ``None`` if it is not complete or made under another key.

    Parameters
    ----------
    path
        The file or folder; its content is read and compared with its record.
    expected_key
        Key that the record must hold; ``None`` takes any.
    cache
        Cache folder for the memory of digests of the files in a folder.

    Raises
    ------
    DamagedError
        If the content or the record is damaged.
    """
    place = record_path(path)
    if not (path.exists() and place.exists()):
        return None
    record = read_json(place)
    if not isinstance(record, dict) or "sha256" not in record:
        raise DamagedError(f"{place}: is no record of {path.name}")
    if expected_key is not None and record.get("key") != expected_key:
        return None
    found = _content(path, cache)
    if found != record["sha256"]:
        what = ""
        if isinstance(found, dict) and isinstance(record["sha256"], dict):
            what = f" ({min(name for name, _ in found.items() ^ record['sha256'].items())})"
        raise DamagedError(f"{path}: its content differs from its record{what}")
    return record


def _content(path: Path, cache: Path | None = None) -> str | dict[str, str]:
    """Digest of a file, or of each file in a folder but for hidden ones."""
    if not path.is_dir():
        return digest_of_file(path)
    names = sorted(names_below(path))
    return dict(zip(names, digest_of_files([f"{path}/{name}" for name in names], cache), strict=True))


def find(path: Path, expected_key: str | None = None, cache: Path | None = None) -> dict[str, Any] | None:
    """As :func:`check`, but what is damaged is set aside, so that it is made again, and counts as not there."""
    try:
        return check(path, expected_key, cache)
    except DamagedError as error:
        set_aside(path, str(error))
        return None


def remove(path: Path) -> None:
    """Delete a stored file or folder with its record, and what was set aside of it."""
    record_path(path).unlink(missing_ok=True)
    for one in (path, path.with_name(f"{path.name}.damaged")):
        _delete(one)


def _delete(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def set_aside(path: Path, reason: str) -> None:
    """Give a damaged file or folder another name, delete the record of a file, and say so."""
    place, aside = record_path(path), path.with_name(f"{path.name}.damaged")
    say(f"{reason}; it is set aside as {aside.name} and made again")
    _delete(aside)
    with contextlib.suppress(FileNotFoundError):  # another process was faster
        path.replace(aside)
    place.unlink(missing_ok=True)


# -- arrays with a record -----------------------------------------------------------------------------------


def save_arrays(path: Path, arrays: Mapping[str, np.ndarray], record: Mapping[str, Any]) -> None:
    """Write ``path`` (``.npz``) and then its record ``.json``, which completes the result.

    Parameters
    ----------
    path
        Target, with the suffix ``.npz``.
    arrays
        Named arrays.
    record
        Everything that the result was made from; must hold its ``key``.
    """
    with replacing(path) as temporary:
        np.savez(temporary, allow_pickle=False, **arrays)
    seal(path, record)


def load_arrays(path: Path, expected_key: str) -> dict[str, np.ndarray] | None:
    """Read arrays whose record holds ``expected_key``; ``None`` if there is no such complete and whole result."""
    if find(path, expected_key) is None:
        return None
    with np.load(path, allow_pickle=False) as stored:
        return {name: stored[name] for name in stored.files}
