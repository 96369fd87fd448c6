"""Traversal × method → descriptors on disk, resumable at any moment.

Images are described in parts (:mod:`artifact.extraction.parts`) by jobs (:mod:`artifact.extraction.jobs`), here or on other
machines that share the storage. What is missing is described here; then the parts of the descriptors become one file, which
ranking maps into memory. A killed run goes on from the parts that are there and ends with the same bytes. The file is
complete only when its sidecar exists.
"""

from __future__ import annotations

import contextlib
import functools
import shutil
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from tqdm import tqdm

from artifact import methods, store
from artifact.datasets import imported, shipped
from artifact.datasets.disk import free_bytes, in_words
from artifact.datasets.traversal import CHANGED, DatasetError, Given, Traversal
from artifact.extraction.local_features import SecondOutput
from artifact.extraction.parts import assemble
from artifact.extraction.stored import REVISION, Stored, stored
from artifact.manifest import CACHE_VARIABLE, Manifest
from artifact.manifest.entries import ManifestError, MethodEntry

if TYPE_CHECKING:
    import torch  # imported where descriptors are made: reading stored ones does not need it


class ValuesAbsentError(store.StoreError):
    """Values that an imported results bundle knows of, but does not hold."""


@dataclass(frozen=True)
class Descriptors:
    """Descriptors of one traversal by one method.

    Attributes
    ----------
    array
        The :attr:`values`; ``None`` if they are not at hand, for the reason ``absent``.
    key
        Content key of all that they were made from.
    sha256
        Digest of the stored values.
    source
        ``"images"``, ``"shipped descriptors"`` or ``"given descriptors"``.
    sidecar
        The record stored beside them.
    """

    array: np.ndarray | None = field(repr=False)
    key: str
    sha256: str
    source: str
    sidecar: dict[str, Any] = field(repr=False)
    absent: str = field(default="", repr=False)

    @property
    def values(self) -> np.ndarray:
        """``(n, d)`` float32, unit length, in the order of the traversal; may be a read-only memory map.

        Raises :class:`ValuesAbsentError` if an imported results bundle knows of them, but they are not at hand.
        """
        if self.array is None:
            raise ValuesAbsentError(self.absent)
        return self.array


def descriptors(
    manifest: Manifest,
    traversal: Traversal,
    method: str,
    *,
    device: str | torch.device | None = None,
    precision: str = "float32",
    workers: int | None = None,
    progress: bool = False,
) -> Descriptors:
    """Return a traversal's descriptors: stored ones if their key is equal, else extracted now.

    Parameters
    ----------
    manifest, traversal, method
        What to describe, and the method's name in the manifest.
    device
        One device or several with commas between, such as ``"cuda:0,cuda:1"``, or ``"all"`` CUDA devices. Here the first
        describes what is missing: an engine shares the jobs out. ``None`` takes CUDA if there is any, else the CPU.
    precision
        ``"float32"``, or mixed precision with ``"bfloat16"`` or ``"float16"``, which gives other descriptors, stored
        beside the former.
    workers
        Processes that read images; ``None`` leaves one core to the model; 0 reads in the model's.
    progress
        Whether to show a progress bar with rate and remaining time.

    Raises
    ------
    ExtractionError
        If images cannot be read, or descriptors are not finite and of unit length: all are listed. If a device is not
        there, or memory does not suffice for one image, or for one batch of a method whose descriptors depend on it.
    DatasetError
        If neither images nor shipped descriptors are at hand.
    StoreError
        If the disk has no room for the descriptors, or shipped ones are damaged.
    """
    place, record = stored(manifest, traversal, method, precision), None
    if method in traversal.descriptors and not (traversal.has_images and place.is_complete):
        return _given(manifest, traversal, method)
    with contextlib.suppress(store.DamagedError):  # read before the lock is asked for: many read the same at once
        record = store.check(place.path, place.key)
    if record is None:
        found = None if traversal.has_images else shipped.path_of(place.key)
        if found is not None:
            return _read(found, shipped.record(found), "shipped descriptors")
        first = next(iter(methods.of_trunk(manifest, method)))
        # Notebooks beside each other describe the images once, by all methods of a trunk.
        with store.lock(stored(manifest, traversal, first, precision).path):
            record = store.find(place.path, place.key)
            if record is None:
                store.record_path(place.path).unlink(missing_ok=True)  # of a file that is gone, or of another one
                make = functools.partial(_make, manifest, traversal, method, device, precision, workers, progress)
                make()
                record = _assemble(place, traversal, method, manifest.method(method), precision, make)
    shutil.rmtree(place.parts_folder, ignore_errors=True)
    return _read(place.path, record, "images")


def second_stage(
    manifest: Manifest,
    traversal: Traversal,
    method: str,
    *,
    device: str | torch.device | None = None,
    precision: str = "float32",
    workers: int | None = None,
) -> SecondOutput | np.ndarray:
    """Return what a two-stage method stores besides descriptors: local features, or packed hash codes.

    They are made together with the descriptors. If only they are missing, the images are described once more.
    Parameters and errors are those of :func:`descriptors`.

    Raises
    ------
    ManifestError
        If the method's entry says nothing of local features or codes, or its model gives others.
    """
    if method in traversal.second_stage:
        return _rows_of(manifest, traversal, method, traversal.second_stage[method])
    second = stored(manifest, traversal, method, precision).second
    if second is None:
        raise ManifestError(f"{manifest.path}: methods.{method} has neither local_features nor code_bits")
    make = functools.partial(_make, manifest, traversal, method, device, precision, workers, progress=False)
    if second.missing():
        traversal.image_paths()
        descriptors(manifest, traversal, method, device=device, precision=precision, workers=workers)
        make()
    second.tidy()
    return SecondOutput(second, make)


def check_disk(
    manifest: Manifest, traversals: Iterable[Traversal], names: Iterable[str], precision: str = "float32"
) -> None:
    """Compare the disk that local features and codes of methods need with what is free, and say both.

    Nothing is said if all of them are stored. The need follows from the manifest: nothing is computed for it.

    Raises
    ------
    StoreError
        If what is not stored yet does not fit.
    """
    missing, traversals = {}, list(traversals)
    for method in names:
        for traversal in (t for t in traversals if method not in t.descriptors):
            second = stored(manifest, traversal, method, precision).second
            if second is not None and second.missing():
                missing[_label(method, traversal)] = second.missing_bytes()
    if not missing:
        return
    needed, free = sum(missing.values()), free_bytes(manifest.cache)
    what = f"local features and codes of {', '.join(missing)}"
    if needed > free:
        raise store.StoreError(
            f"{manifest.cache}: {what} need {in_words(needed)} of disk, {in_words(free)} are free. Free some, set "
            f"{CACHE_VARIABLE} to a folder on a larger disk, or store local features as float16 (half the "
            f"size): 'dtype: float16' below 'local_features' in the method's manifest entry"
        )
    store.say(f"{what} need {in_words(needed)} of disk; {in_words(free)} are free in {manifest.cache}")


def is_ready(manifest: Manifest, traversal: Traversal, method: str) -> bool:
    """Whether descriptors are given, stored or shipped, so that nothing would be extracted."""
    if method in traversal.descriptors:
        return True
    place = stored(manifest, traversal, method)
    return place.is_complete or (not traversal.has_images and shipped.path_of(place.key) is not None)


def is_at_hand(manifest: Manifest, traversal: Traversal, method: str) -> bool:
    """Whether the values of the descriptors are here or can be made, and are not just recorded in an imported bundle."""
    given = traversal.descriptors.get(method)
    recorded_only = given is not None and given.path is None
    return not recorded_only or (traversal.has_images and stored(manifest, traversal, method).is_complete)


def _given(manifest: Manifest, traversal: Traversal, method: str) -> Descriptors:
    """Return the descriptors that came with a traversal, or what an imported bundle records of them."""
    file = traversal.descriptors[method]
    if file.path is None:
        kept = {name: file.record[name] for name in ("key", "sha256", "source")}
        return Descriptors(None, **kept, sidecar=file.record["sidecar"], absent=_absent(manifest, traversal, method))
    values = _rows_of(manifest, traversal, method, file)
    if values.ndim != 2 or values.dtype not in (np.float32, np.float16):
        raise DatasetError(f"{file.path}: holds {values.dtype} {values.shape}; allowed: float32 or float16 of (n, d)")
    if not np.isfinite(values.sum(axis=1, dtype=np.float64)).all():
        raise DatasetError(f"{file.path}: has NaN or infinite values")
    sidecar = {"shape": list(values.shape), "key": file.sha256}
    return Descriptors(values.astype(np.float32, copy=False), file.sha256, file.sha256, "given descriptors", sidecar)


def _absent(manifest: Manifest, traversal: Traversal, method: str) -> str:
    return (
        f"{_label(method, traversal)}: descriptors are not in the imported results bundle, only what was computed from them; "
        f"to make them here, delete {manifest.cache / imported.FOLDER} first"
    )


def _rows_of(manifest: Manifest, traversal: Traversal, method: str, file: Given) -> np.ndarray:
    if file.path is None:
        raise ValuesAbsentError(_absent(manifest, traversal, method))
    if store.digest_of_file(file.path) != file.sha256:
        raise DatasetError(f"{file.path}: {CHANGED}")
    try:
        values = np.lib.format.open_memmap(file.path, mode="r")
    except (OSError, ValueError, EOFError) as error:
        raise DatasetError(f"{file.path}: cannot be read as a NumPy array ({error})") from None
    if len(values) != len(traversal):
        raise DatasetError(
            f"{file.path}: {len(values)} rows for the {len(traversal)} images of {traversal.dataset}/{traversal.name}"
        )
    return values


def _read(path: Path, record: dict[str, Any], source: str) -> Descriptors:
    values = np.lib.format.open_memmap(path, mode="r")
    return Descriptors(values.astype(np.float32, copy=False), record["key"], record["sha256"], source, record)


# -- extraction ---------------------------------------------------------------------------------------------


def _make(
    manifest: Manifest,
    traversal: Traversal,
    method: str,
    device: str | torch.device | None,
    precision: str,
    workers: int | None,
    progress: bool,
) -> None:
    """Describe the images of all parts that are missing."""
    from artifact.extraction import forward, jobs

    todo = jobs.jobs_of(manifest, traversal, method, precision)
    if not todo:
        return
    n, label = len(traversal), _label(method, traversal)
    chosen = forward.devices(device)
    if len(chosen) > 1:
        store.say(f"{label}: several devices at once need the extra 'cluster'; going on with the first, {chosen[0]}")
    check_disk(manifest, [traversal], [method], precision)
    _check_room(stored(manifest, traversal, method, precision))
    initial, hidden = n - sum(len(job.images) for job in todo), None if progress else True
    bar = tqdm(total=n, initial=initial, unit="image", desc=label, disable=hidden, smoothing=0.05, leave=False)
    with bar, store.stage("describe"):
        jobs.run(todo, jobs.forward_of(todo[0], chosen[0]), workers=workers, update=bar.update)


def _check_room(place: Stored) -> None:
    """Say before any work that the disk has no room for the descriptors, in parts and then in one file."""
    if place.is_complete:
        return
    n, d = place.parts.n, *place.parts.shape
    needed, free = place.parts.missing_bytes() + 4 * n * d, free_bytes(place.path.parent)
    if needed > free:
        raise store.StoreError(
            f"{place.path.parent}: no room for {n} descriptors of {d} dimensions: {in_words(needed)} are needed, "
            f"{in_words(free)} are free; make room, or set {CACHE_VARIABLE} to a folder elsewhere"
        )


def _assemble(
    place: Stored, traversal: Traversal, method: str, entry: MethodEntry, precision: str, make: Callable[[], object]
) -> dict[str, Any]:
    """Make one file of the parts of the descriptors; its record, which is returned, completes it."""
    assemble(place.parts, place.path, make)
    record = {
        "method": method,
        "dataset": traversal.dataset,
        "traversal": traversal.name,
        "key": place.key,
        "shape": [place.parts.n, *place.parts.shape],
        "images": traversal.digest,
        "revision": REVISION,
        "precision": precision,
        "preprocessing": entry.preprocessing.model_dump(),
        "batch_size": entry.batch_size,
    }
    parts = [place.parts.record(number) for number in range(len(place.parts))]
    record["images_at_once"] = min(part["images_at_once"] for part in parts)
    for name in ("device", "torch", "machine"):
        record[name] = ", ".join(dict.fromkeys(part[name] for part in parts))
    for name in ("seconds", "forward_seconds"):
        record[name] = round(sum(part[name] for part in parts), 3)
    return store.seal(place.path, record)


def _label(method: str, traversal: Traversal) -> str:
    return f"{method} · {traversal.dataset}/{traversal.name}"
