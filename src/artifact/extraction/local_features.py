"""What a two-stage model gives besides descriptors: local features (SelaVPR) or hash codes (SelaVPR++).

They come from the same pass as the descriptors and stand in files of some hundred images each, which are reserved on
disk before a model runs: the need follows from the manifest and is compared with the free space first. Rows count as
done by the journal of the descriptors (:mod:`artifact.extraction.partial`), which is written after both are on disk. A file is
complete when its sidecar exists. Reading maps the files into memory.
"""

from __future__ import annotations

import math
import os
import uuid
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from artifact import store
from artifact.datasets.traversal import Traversal
from artifact.extraction import partial
from artifact.extraction.disk import free_bytes, in_words
from artifact.manifest import CACHE_VARIABLE
from artifact.manifest.entries import ManifestError, MethodEntry

if TYPE_CHECKING:
    import torch

REVISION = 1  # raise when the same model and images would give other local features or codes

_FILE_BYTES = 256 * 2**20
_FILE_IMAGES = 1024
_UNIT_TOLERANCE = 1e-2  # mixed precision may have computed them


# -- what is stored -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Layout:
    """Shape and type of what is stored for one image.

    Attributes
    ----------
    shape
        ``(rows, columns, c)`` of the local features; ``(bytes,)`` of packed hash codes, eight bits in each.
    dtype
        ``float32`` or ``float16`` for local features, ``uint8`` for codes.
    bits
        Length of the hash code; 0 for local features.
    """

    shape: tuple[int, ...]
    dtype: str
    bits: int = 0

    @property
    def image_bytes(self) -> int:
        """Bytes of one image."""
        return math.prod(self.shape) * np.dtype(self.dtype).itemsize

    @property
    def images_per_file(self) -> int:
        """Images that share a file."""
        return max(1, min(_FILE_IMAGES, _FILE_BYTES // self.image_bytes))


def layout_of(entry: MethodEntry) -> Layout | None:
    """Return what a method's manifest entry says is stored besides descriptors; ``None`` for one-stage methods."""
    if entry.local_features is not None:
        return Layout(tuple(entry.local_features.shape), entry.local_features.dtype)
    if entry.code_bits is not None:
        return Layout((-(-entry.code_bits // 8),), "uint8", entry.code_bits)
    return None


def both_outputs(model: torch.nn.Module, layout: Layout, label: str) -> Callable[[torch.Tensor], Any]:
    """Return the model's method that gives descriptors and second output of a batch of images.

    It is ``global_and_local(images)`` for local features, and ``descriptors_and_codes(images)`` for hash codes, which
    are +1 and -1.

    Raises
    ------
    ManifestError
        If the model has no such method.
    """
    name = "descriptors_and_codes" if layout.bits else "global_and_local"
    both = getattr(model, name, None)
    if both is None:
        key = "code_bits" if layout.bits else "local_features"
        raise ManifestError(f"{label}: the manifest entry has the key {key!r}, but the model has no {name}(images)")
    return both


def _stored_form(values: np.ndarray, layout: Layout) -> np.ndarray:
    """Check the second output of a batch and turn it into what is stored."""
    expected = (layout.bits,) if layout.bits else layout.shape
    if values.shape[1:] != expected:
        raise ManifestError(
            f"the model gives {'codes' if layout.bits else 'local features'} of the shape {values.shape[1:]} each, "
            f"the manifest says {expected}"
        )
    if layout.bits:
        return np.packbits(values > 0, axis=1)
    lengths = np.linalg.norm(values, axis=-1)
    if not (np.abs(lengths - 1) < _UNIT_TOLERANCE).all():
        raise ManifestError(
            f"local features must be finite and of length 1 along the last axis; found lengths from "
            f"{lengths.min():.4g} to {lengths.max():.4g}: the model should end with torch.nn.functional.normalize"
        )
    return values.astype(layout.dtype, copy=False)


# -- disk ---------------------------------------------------------------------------------------------------


def check_disk(missing: Mapping[str, int], folder: Path, say: Callable[[str], object]) -> None:
    """Compare the disk that is needed with what is free, before anything is computed.

    Parameters
    ----------
    missing
        Bytes that are not stored yet, by the name of method and traversal.
    folder
        The cache folder.
    say
        Receives one line with the need and the free space, if anything is missing.

    Raises
    ------
    StoreError
        If the missing part does not fit.
    """
    missing = {label: needed for label, needed in missing.items() if needed}
    if not missing:
        return
    needed, free = sum(missing.values()), free_bytes(folder)
    what = f"local features and codes of {', '.join(missing)}"
    if needed > free:
        raise store.StoreError(
            f"{folder}: {what} need {in_words(needed)} of disk, {in_words(free)} are free. Free some, set "
            f"{CACHE_VARIABLE} to a folder on a larger disk, or store local features as float16 (half the "
            f"size): 'dtype: float16' below 'local_features' in the method's manifest entry"
        )
    say(f"{what} need {in_words(needed)} of disk; {in_words(free)} are free in {folder}")


# -- files --------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Files:
    """Where the second output of one traversal and method is, or will be, on disk.

    Attributes
    ----------
    folder
        Holds ``00000.npy``, ``00000.json``, ...
    key
        Content key of all that it is made from.
    n_images
        Images of the traversal.
    layout
        What is stored per image.
    images_each
        Images in each file but the last.
    """

    folder: Path
    key: str
    n_images: int
    layout: Layout
    images_each: int

    @property
    def rows(self) -> list[slice]:
        """Images of each file."""
        step = self.images_each
        return [slice(start, min(start + step, self.n_images)) for start in range(0, self.n_images, step)]

    def path(self, number: int) -> Path:
        """Return the path of a file."""
        return self.folder / f"{number:05d}.npy"

    def partial(self, number: int) -> Path:
        """Return the path of a file while it grows."""
        return self.folder / f"{number:05d}.partial.npy"

    def shape(self, number: int) -> tuple[int, ...]:
        """Return the shape of a file's array."""
        return (self.rows[number].stop - self.rows[number].start, *self.layout.shape)

    def missing(self) -> list[int]:
        """Return the numbers of the files that are not complete."""
        return [number for number in range(len(self.rows)) if not self._is_complete(number)]

    def _is_complete(self, number: int) -> bool:
        sidecar = self.path(number).with_suffix(".json")
        return sidecar.exists() and self.path(number).exists() and store.read_json(sidecar).get("key") == self.key

    def missing_bytes(self) -> int:
        """Return the disk that the files take which are neither complete nor reserved."""
        unreserved = [number for number in self.missing() if not self.partial(number).exists()]
        return sum(self.shape(number)[0] for number in unreserved) * self.layout.image_bytes


def label_of(method: str, traversal: Traversal) -> str:
    """Return the name of an extraction, for messages."""
    return f"{method} · {traversal.dataset}/{traversal.name}"


@dataclass(frozen=True)
class Job:
    """What all shards of one extraction share.

    Attributes
    ----------
    path, key
        The result's file and content key.
    traversal, method, entry
        What to describe, and by which method.
    precision
        ``"float32"``, ``"bfloat16"`` or ``"float16"``.
    workers
        Reading processes of each shard; ``None`` shares the cores among the shards.
    files
        For a two-stage method, where its local features or codes go.
    """

    path: Path
    key: str
    traversal: Traversal
    method: str
    entry: MethodEntry
    precision: str = "float32"
    workers: int | None = None
    files: Files | None = None

    @property
    def label(self) -> str:
        """Method and traversal, for messages."""
        return label_of(self.method, self.traversal)


def start(files: Files) -> str:
    """Reserve the files that are missing, and return a name under which rows may be said to be in them.

    The name is a new one whenever a file had to be made afresh: what a journal says of another name counts for nothing.

    Raises
    ------
    StoreError
        If the disk has no room.
    """
    files.folder.mkdir(parents=True, exist_ok=True)
    record = files.folder / "growing.json"
    name = store.read_json(record)["name"] if record.exists() else None
    for number in files.missing():
        files.path(number).with_suffix(".json").unlink(missing_ok=True)
        if files.path(number).exists():  # stopped between the last two steps of `complete`
            files.path(number).replace(files.partial(number))
        if not partial.holds(files.partial(number), files.shape(number), files.layout.dtype):
            name = None
            _reserve(files, number)
    if name is None:
        name = uuid.uuid4().hex
        store.write_json(record, {"name": name})
    return name


class TwoOutputWriter(partial.RowWriter):
    """Writes descriptors and second output of the same rows; the journal speaks of rows that are on disk in both.

    Parameters
    ----------
    path, key, number
        As for :class:`artifact.extraction.partial.RowWriter`.
    files
        Made ready by :func:`start`.
    """

    def __init__(self, path: Path, key: str, number: int, files: Files) -> None:
        super().__init__(path, key, number)
        self._files = files
        self._maps = {
            n: np.load(files.partial(n), mmap_mode="r+", allow_pickle=False)
            for n in range(len(files.rows))
            if files.partial(n).exists()
        }
        self._changed: set[int] = set()

    def write_second(self, rows: slice, values: np.ndarray) -> None:
        """Write the second output of a range of rows; call it before ``write``, which says that the rows are there.

        Raises
        ------
        ManifestError
            If the shape is not the manifest's, or local features are not finite and of unit length.
        """
        values = _stored_form(values, self._files.layout)
        step = self._files.images_each
        for number in range(rows.start // step, -(-rows.stop // step)):
            if number in self._maps:
                place = self._files.rows[number]
                begin, end = max(rows.start, place.start), min(rows.stop, place.stop)
                part = values[begin - rows.start : end - rows.start]
                self._maps[number][begin - place.start : end - place.start] = part
                self._changed.add(number)

    def pause(self) -> None:
        """Bring all written rows to disk, then say so in the journal."""
        for number in self._changed:
            self._maps[number].flush()
        self._changed.clear()
        super().pause()


def complete(files: Files, sidecar: dict[str, Any]) -> None:
    """Complete the files, all rows of which are written; each one's sidecar comes last."""
    for number in files.missing():
        partial_path, path = files.partial(number), files.path(number)
        with partial_path.open("rb+") as stream:
            os.fsync(stream.fileno())
        digest = store.digest_of_file(partial_path)
        partial_path.replace(path)
        rows = files.rows[number]
        record = {"key": files.key, "rows": [rows.start, rows.stop], "shape": list(files.shape(number))}
        store.write_json(path.with_suffix(".json"), {**sidecar, **record, "sha256": digest})


def _reserve(files: Files, number: int) -> None:
    path, shape = files.partial(number), files.shape(number)
    try:
        partial.reserve(path, shape, files.layout.dtype)
    except OSError as error:
        raise store.StoreError(
            f"{path}: no room for {in_words(math.prod(shape) * np.dtype(files.layout.dtype).itemsize)} "
            f"({error}); what is there stays: make room and run again"
        ) from None


@dataclass(frozen=True)
class SecondOutput:
    """A traversal's local features or codes, read from disk by indexing with an array of image indices.

    Attributes
    ----------
    files
        Where they are.
    maps
        The memory-mapped files.
    """

    files: Files
    maps: tuple[np.ndarray, ...] = field(repr=False)

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of images, then the shape per image."""
        return (len(self), *self.files.layout.shape)

    @property
    def dtype(self) -> np.dtype:
        """Type of the values."""
        return np.dtype(self.files.layout.dtype)

    def __len__(self) -> int:
        return self.files.n_images

    def __getitem__(self, images: np.ndarray) -> np.ndarray:
        images = np.asarray(images)
        out = np.empty((len(images), *self.files.layout.shape), self.dtype)
        numbers = images // self.files.images_each
        for number in np.unique(numbers):
            here = np.flatnonzero(numbers == number)
            out[here] = self.maps[number][images[here] - number * self.files.images_each]
        return out


def opened(files: Files) -> SecondOutput:
    """Open complete files.

    Raises
    ------
    StoreError
        If one is missing, unreadable or of another shape.
    """
    maps = []
    missing = files.missing()
    for number in range(len(files.rows)):
        path = files.path(number)
        advice = "delete it and its .json and run again"
        if number in missing:
            raise store.StoreError(f"{path}: missing or made from other inputs; {advice}")
        try:
            values = np.load(path, mmap_mode="r", allow_pickle=False)
        except (OSError, ValueError) as error:
            raise store.StoreError(f"{path}: cannot be read ({error}); {advice}") from None
        if (values.shape, values.dtype) != (files.shape(number), files.layout.dtype):
            raise store.StoreError(f"{path}: holds {values.dtype} {values.shape}, unlike its manifest entry; {advice}")
        maps.append(values)
    return SecondOutput(files, tuple(maps))
