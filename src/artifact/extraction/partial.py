"""The growing descriptor file, its journals, and the steps that make it whole.

Rows are written in any order, by one process or several; each writer keeps a journal of the rows that are safely on
disk. A killed run goes on from the union of the journals. The result is complete when its sidecar exists.
"""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

import numpy as np

from artifact import store
from artifact.extraction.disk import free_bytes, in_words
from artifact.manifest import CACHE_VARIABLE

JOURNAL_SECONDS = 2.0

Rows = list[list[int]]
"""Ranges of rows ``[start, stop)``."""


def start(path: Path, key: str, shape: tuple[int, int]) -> np.ndarray:
    """Make the partial file of a result ready for writing, and return which rows are in it already.

    Parameters
    ----------
    path
        The result's ``.npy`` file; the partial file and the journals stand beside it.
    key
        The result's content key: journals of another key count for nothing.
    shape
        Rows and columns of the result, float32.

    Returns
    -------
    numpy.ndarray
        ``(rows,)`` bool.

    Raises
    ------
    StoreError
        If the disk has no room for the whole file: said now, not after hours of work.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = _partial(path)
    if path.exists():  # killed between the last two steps of `complete`
        path.replace(partial)
    done = np.zeros(shape[0], dtype=bool)
    journals = _journals(path)
    if holds(partial, shape, np.float32):
        for journal in journals:
            record = store.read_json(journal)
            for first, stop in record.get("rows", []) if record.get("key") == key else []:
                done[first:stop] = True
    if not done.any():
        for journal in journals:
            journal.unlink()
        _allocate(partial, shape)
        return done
    merged = path.with_suffix(".journal.json")
    store.write_json(merged, {"key": key, "rows": _ranges(done)})
    for journal in journals:
        if journal != merged:
            journal.unlink()
    return done


class RowWriter:
    """Writes rows into the partial file of a result that :func:`start` made ready.

    Parameters
    ----------
    path, key
        As for :func:`start`.
    number
        Tells the journals of several writers apart.
    """

    def __init__(self, path: Path, key: str, number: int = 0) -> None:
        self._key = key
        self._journal = path.with_suffix(f".journal-{number}.json")
        self._values = np.load(_partial(path), mmap_mode="r+", allow_pickle=False)
        self._rows: Rows = []
        self._last = time.monotonic()

    def write(self, rows: slice, values: np.ndarray) -> None:
        """Write descriptors of a range of rows; every few seconds bring all to disk."""
        self._values[rows] = values
        if self._rows and self._rows[-1][1] == rows.start:
            self._rows[-1][1] = rows.stop
        else:
            self._rows.append([rows.start, rows.stop])
        if time.monotonic() - self._last > JOURNAL_SECONDS:
            self.pause()

    def pause(self) -> None:
        """Bring all written rows to disk, then say so in the journal."""
        if self._rows:
            self._values.flush()
            store.write_json(self._journal, {"key": self._key, "rows": self._rows})
        self._last = time.monotonic()


def complete(path: Path, sidecar: dict[str, Any]) -> None:
    """Turn the partial file, all rows of which are written, into the result; the sidecar comes last."""
    partial = _partial(path)
    with partial.open("rb+") as stream:
        os.fsync(stream.fileno())
    digest = store.digest_of_file(partial)
    partial.replace(path)
    store.write_json(path.with_suffix(".json"), {**sidecar, "sha256": digest})
    for journal in _journals(path):
        journal.unlink()


def abandon(path: Path) -> None:
    """Delete the partial file of a run that failed before any row was safely on disk."""
    if not _journals(path):
        _partial(path).unlink(missing_ok=True)


def _partial(path: Path) -> Path:
    return path.with_suffix(".partial.npy")


def _journals(path: Path) -> list[Path]:
    return sorted(path.parent.glob(f"{path.stem}.journal*.json"))


def _ranges(done: np.ndarray) -> Rows:
    edges = np.flatnonzero(np.diff(np.concatenate(([False], done, [False])).astype(np.int8)))
    return edges.reshape(-1, 2).tolist()


def _allocate(partial: Path, shape: tuple[int, int]) -> None:
    try:
        reserve(partial, shape, np.float32)
    except OSError as error:
        needed, free = in_words(4 * shape[0] * shape[1]), in_words(free_bytes(partial.parent))
        raise store.StoreError(
            f"{partial.parent}: no room for {shape[0]} descriptors of {shape[1]} dimensions: {needed} are needed, {free} "
            f"are free ({error}); make room, or set {CACHE_VARIABLE} to a folder elsewhere"
        ) from None


# -- arrays that are written into files bit by bit ----------------------------------------------------------


def holds(path: Path, shape: tuple[int, ...], dtype: Any) -> bool:
    """Whether a file is a readable array of a shape and type."""
    try:
        stored = np.load(path, mmap_mode="r", allow_pickle=False)
    except (OSError, ValueError):
        return False
    return stored.shape == shape and stored.dtype == dtype


def reserve(path: Path, shape: tuple[int, ...], dtype: Any) -> None:
    """Create an array file with all its blocks: a memory map that meets a full disk later kills the process.

    Raises
    ------
    OSError
        If the disk has no room; the file is gone then.
    """
    path.unlink(missing_ok=True)
    try:
        np.lib.format.open_memmap(path, mode="w+", dtype=dtype, shape=shape)
        size = path.stat().st_size
        if hasattr(os, "posix_fallocate"):
            with path.open("rb+") as stream:
                os.posix_fallocate(stream.fileno(), 0, size)
        elif free_bytes(path.parent) < size:
            raise OSError("too little free space")
    except OSError:
        path.unlink(missing_ok=True)
        raise
