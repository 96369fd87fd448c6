"""Results in parts: whole files of some hundred images each, which any number of processes and machines may make.

A part is an array file with a record beside it. Each is written under a temporary name, brought to disk and renamed, the
record last. The record holds the key of all that the part is made from, its rows, and the digest of the file. Whoever makes
the same part writes the same bytes: nobody needs a lock or a journal, and a killed run loses the part in progress. A part
that does not fit its record is set aside and made again.

Parts are ``.npy`` files and not chunks of a Zarr array: ranking 4,000 queries and 4,000 database images of 4,096 dimensions
took 1.17 times as long from Zarr 3.1 (chunks of 1,024 rows, not compressed) as from a memory map.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from artifact import store

# The largest part: it is held in memory while it is made, and lost if the run is killed meanwhile. That bounds its bytes, and
# through the number of batches its time, since slow models have small batches.
_BATCHES = 16
_IMAGES = 1024
_BYTES = 256 * 2**20

_ATTEMPTS = 3  # to make a part that is found damaged again and again
_ABSENT = "not there"


def rows_each(batch_size: int, image_bytes: int) -> int:
    """Return the images of a part: whole batches, at least one.

    Examples
    --------
    >>> rows_each(16, 4 * 4096), rows_each(64, 4 * 4096), rows_each(16, 61 * 61 * 128 * 4), rows_each(1, 10**9)
    (256, 1024, 128, 1)
    """
    return batch_size * max(1, min(_BATCHES, _IMAGES // batch_size, _BYTES // (batch_size * image_bytes)))


@dataclass(frozen=True)
class Parts:
    """An array that is stored in parts: where they are, and what they must be to count.

    Attributes
    ----------
    folder
        Holds ``00000.npy``, ``00000.json``, ...
    key
        Content key of all that the parts are made from, their division into rows and batches included.
    rows_each
        Rows of each part but the last, which may be smaller.
    n
        Rows of all parts together.
    shape, dtype
        Of one row.
    """

    folder: Path
    key: str
    rows_each: int
    n: int
    shape: tuple[int, ...]
    dtype: str

    def __len__(self) -> int:
        return math.ceil(self.n / self.rows_each)

    def rows(self, number: int) -> slice:
        """Return the rows of a part."""
        return slice(number * self.rows_each, min((number + 1) * self.rows_each, self.n))

    def path(self, number: int) -> Path:
        """Return the array file of a part; its record has the suffix ``.json``."""
        return self.folder / f"{number:05d}.npy"

    def has(self, number: int) -> bool:
        """Whether a part is there and, as far as can be told without reading its values, whole."""
        return self._fault(number) is None

    def missing(self) -> list[int]:
        """Return the numbers of the parts that are not there or not whole."""
        return [number for number in range(len(self)) if not self.has(number)]

    def missing_bytes(self) -> int:
        """Return the disk that the missing parts will take."""
        return sum(math.prod(self._shape(number)) for number in self.missing()) * np.dtype(self.dtype).itemsize

    def write(self, number: int, blocks: Sequence[np.ndarray], record: Mapping[str, Any]) -> None:
        """Write a part from arrays that hold its rows in order, unless somebody has made it meanwhile.

        ``record`` says how it was made; the key, the rows and the digest are added. A damaged part is set aside first. Raises
        ``StoreError`` if the file cannot be written, for example because the disk is full.
        """
        fault = self._fault(number)
        if fault is None:
            return
        path, rows = self.path(number), self.rows(number)
        if fault != _ABSENT:
            store.set_aside(path, f"{path}: {fault}")
        try:
            with store.replacing(path) as temporary, temporary.open("wb") as stream:
                _write_header(stream, self._shape(number), self.dtype)
                for block in blocks:
                    stream.write(np.ascontiguousarray(block).data)
            own = {"key": self.key, "rows": [rows.start, rows.stop], "shape": self._shape(number)}
            store.seal(path, {**record, **own})
        except FileNotFoundError:
            if not self.has(number):  # else somebody has made all parts meanwhile, and swept up
                raise

    def read(self, number: int, make: Callable[[], object]) -> np.ndarray:
        """Return a part as a memory map, its digest verified; ``make`` is called to make it if it is missing or damaged.

        Raises ``StoreError`` if the part is damaged however often it is made.
        """
        path = self.path(number)
        for _ in range(_ATTEMPTS):
            if self.has(number) and store.find(path, self.key) is not None:
                return np.lib.format.open_memmap(path, mode="r")
            make()
        raise store.StoreError(f"{path}: missing or damaged again as soon as it is made; check the disk it is on")

    def record(self, number: int) -> dict[str, Any]:
        """Return the record of a part that is there."""
        return store.read_json(self.path(number).with_suffix(".json"))

    def tidy(self) -> None:
        """Delete what killed runs left half written: for when no part is missing."""
        for left in self.folder.glob(".*.tmp.*"):
            left.unlink(missing_ok=True)

    def _shape(self, number: int) -> tuple[int, ...]:
        rows = self.rows(number)
        return (rows.stop - rows.start, *self.shape)

    def _fault(self, number: int) -> str | None:
        """Say why a part does not count; ``None`` if it does, as far as can be told without reading its values."""
        path = self.path(number)
        if not (path.exists() and path.with_suffix(".json").exists()):
            return _ABSENT
        try:
            record = self.record(number)
            values = np.lib.format.open_memmap(path, mode="r")
        except (store.StoreError, OSError, ValueError, EOFError):
            return "the file or its record is damaged"
        if not isinstance(record, dict) or record.get("key") != self.key:
            return _ABSENT  # made from other inputs: whole, but not asked for
        if (values.shape, values.dtype) != (self._shape(number), self.dtype):
            return f"it holds {values.dtype} {values.shape}, not {self.dtype} {self._shape(number)}"
        return None


def assemble(parts: Parts, path: Path, make: Callable[[], object]) -> None:
    """Write the rows of all parts into one array file on the same disk, a part at a time.

    The parts stay, and the temporary file stands among them: nothing is left of it once they are deleted. ``make`` and errors
    are those of :meth:`Parts.read` and :meth:`Parts.write`.
    """
    whole = parts.folder / "whole.npy"
    with store.writing(path):
        with store.replacing(whole) as temporary, temporary.open("wb") as stream:
            _write_header(stream, (parts.n, *parts.shape), parts.dtype)
            for number in range(len(parts)):
                stream.write(parts.read(number, make).data)
        whole.replace(path)


def _write_header(stream: BinaryIO, shape: tuple[int, ...], dtype: str) -> None:
    description = np.lib.format.dtype_to_descr(np.dtype(dtype))
    header = {"descr": description, "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(stream, header)
