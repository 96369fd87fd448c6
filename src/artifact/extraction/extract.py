"""Traversal × method → descriptors on disk, resumable at any moment.

Worker processes decode and prepare images ahead of the model (:mod:`artifact.extraction.reading`), which describes them in
batches that are always the same (:mod:`artifact.extraction.shards`). Descriptors go to a partial file, and a journal beside it
records the rows that are safely on disk (:mod:`artifact.extraction.partial`): a killed run goes on from there and ends with the
same bytes. A result is complete only when its sidecar exists.
"""

from __future__ import annotations

import platform
import sys
import time
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from tqdm import tqdm

from artifact import methods, store
from artifact.datasets import shipped
from artifact.datasets.traversal import DatasetError, Given, Traversal
from artifact.extraction import local_features, partial
from artifact.extraction.local_features import Job
from artifact.extraction.reading import ExtractionError
from artifact.manifest import Manifest
from artifact.manifest.entries import ManifestError, MethodEntry

if TYPE_CHECKING:
    import torch  # imported where descriptors are made: reading stored ones does not need it

__all__ = ["PRECISIONS", "Descriptors", "ExtractionError", "descriptor_key", "descriptors", "is_ready", "stored_path"]

PRECISIONS = ("float32", "bfloat16", "float16")
REVISION = 2  # raise when the same model and images would give other descriptors


@dataclass(frozen=True)
class Descriptors:
    """Descriptors of one traversal by one method.

    Attributes
    ----------
    values
        ``(n, d)`` float32, unit length, in the order of the traversal; may be a read-only memory map.
    key
        Content key of all that they were made from.
    sha256
        Digest of the stored values.
    source
        ``"images"``, ``"shipped descriptors"`` or ``"given descriptors"``.
    sidecar
        The record stored beside them.
    """

    values: np.ndarray = field(repr=False)
    key: str
    sha256: str
    source: str
    sidecar: dict[str, Any] = field(repr=False)


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
        One device or several with commas between, such as ``"cuda:0,cuda:1"``, or ``"all"`` CUDA devices; several share
        the images, one process each. ``None`` takes CUDA if there is any, else the CPU.
    precision
        ``"float32"``, or mixed precision with ``"bfloat16"`` or ``"float16"``, which gives other descriptors, stored
        beside the former.
    workers
        Processes that read images for each device; ``None`` leaves one core to the model; 0 reads in the model's.
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
        If the disk has no room for the descriptors.
    """
    entry = manifest.method(method)
    if method in traversal.descriptors:
        return _given(traversal, method)
    key = descriptor_key(traversal, method, entry, precision)
    path = stored_path(manifest, method, key)
    if not traversal.has_images and not path.with_suffix(".json").exists():
        found = shipped.path_of(key)
        if found is not None:
            return _read(found, key, "shipped descriptors")
        traversal.image_paths()
    with store.lock(path):
        if not path.with_suffix(".json").exists():
            files = _files(manifest, traversal, method, key)
            job = Job(path, key, traversal, method, entry, precision, workers, files)
            _extract(job, device, progress=progress)
    return _read(path, key, "images")


def second_stage(
    manifest: Manifest,
    traversal: Traversal,
    method: str,
    *,
    device: str | torch.device | None = None,
    precision: str = "float32",
    workers: int | None = None,
    progress: bool = False,
) -> local_features.SecondOutput | np.ndarray:
    """Return what a two-stage method stores besides descriptors: local features, or packed hash codes.

    They are made together with the descriptors. If only they are missing, the images are described once more.
    Parameters and errors are those of :func:`descriptors`.

    Raises
    ------
    ManifestError
        If the method's entry says nothing of local features or codes, or its model gives others.
    """
    if method in traversal.second_stage:
        return _rows_of(traversal, traversal.second_stage[method])
    entry = manifest.method(method)
    key = descriptor_key(traversal, method, entry, precision)
    files = _files(manifest, traversal, method, key)
    if files is None:
        raise ManifestError(f"{manifest.path}: methods.{method} has neither local_features nor code_bits")
    if files.missing():
        traversal.image_paths()
        options = {"device": device, "precision": precision, "workers": workers, "progress": progress}
        descriptors(manifest, traversal, method, **options)
        with store.lock(stored_path(manifest, method, key)):
            if files.missing():
                again = files.folder / "descriptors.npy"
                job = Job(again, key, traversal, method, entry, precision, workers, files)
                _extract(job, device, progress=progress)
                again.with_suffix(".json").unlink()
                again.unlink()
    return local_features.opened(files)


def second_stage_key(traversal: Traversal, method: str, entry: MethodEntry) -> str:
    """Return the content key of a traversal's local features or codes."""
    if method in traversal.second_stage:
        return traversal.second_stage[method].sha256
    return _second_stage_key(descriptor_key(traversal, method, entry), entry)


def check_disk(manifest: Manifest, traversals: Iterable[Traversal], names: Iterable[str]) -> None:
    """Say how much disk the local features and codes of methods take, and compare it with what is free.

    Raises
    ------
    StoreError
        If what is not stored yet does not fit.
    """
    missing, traversals = {}, list(traversals)
    for method in names:
        for traversal in (t for t in traversals if method not in t.descriptors):
            files = _files(manifest, traversal, method, descriptor_key(traversal, method, manifest.method(method)))
            if files is not None:
                missing[local_features.label_of(method, traversal)] = files.missing_bytes()
    local_features.check_disk(missing, manifest.cache, _say)


def _say(line: str) -> None:
    tqdm.write(line, file=sys.stderr)


def _second_stage_key(key: str, entry: MethodEntry) -> str:
    layout = local_features.layout_of(entry)
    return store.key(
        stage="local features",
        revision=local_features.REVISION,
        descriptors=key,
        layout=layout,
        images_each=None if layout is None else layout.images_per_file,
    )


def _files(manifest: Manifest, traversal: Traversal, method: str, key: str) -> local_features.Files | None:
    """Where the second output goes that comes with the descriptors of a key; ``None`` for one-stage methods."""
    entry = manifest.method(method)
    layout, second_key = local_features.layout_of(entry), _second_stage_key(key, entry)
    folder = manifest.cache / "local_features" / method / second_key[:24]
    return (
        None
        if layout is None
        else local_features.Files(folder, second_key, len(traversal), layout, layout.images_per_file)
    )


def is_ready(manifest: Manifest, traversal: Traversal, method: str) -> bool:
    """Whether descriptors are given, stored or shipped, so that nothing would be extracted."""
    if method in traversal.descriptors:
        return True
    key = descriptor_key(traversal, method, manifest.method(method))
    stored = stored_path(manifest, method, key).with_suffix(".json").exists()
    return stored or (not traversal.has_images and shipped.path_of(key) is not None)


def descriptor_key(traversal: Traversal, method: str, entry: MethodEntry, precision: str = "float32") -> str:
    """Return the content key of descriptors: images, order, model, preprocessing, precision and code revisions.

    Raises
    ------
    ExtractionError
        If the precision is none of :data:`PRECISIONS`.
    """
    if precision not in PRECISIONS:
        raise ExtractionError(f"precision {precision!r}: allowed are {', '.join(PRECISIONS)}")
    model = methods.fingerprint(method, entry)
    mixed = {} if precision == "float32" else {"precision": precision}
    return store.key(stage="descriptors", revision=REVISION, images=traversal.digest, model=model, **mixed)


def stored_path(manifest: Manifest, method: str, key: str) -> Path:
    """Return the file that holds, or would hold, the descriptors of a key."""
    return manifest.cache / "descriptors" / method / f"{key[:24]}.npy"


def _given(traversal: Traversal, method: str) -> Descriptors:
    """Return the descriptors that came with a traversal."""
    file = traversal.descriptors[method]
    values = _rows_of(traversal, file)
    if values.ndim != 2 or values.dtype not in (np.float32, np.float16):
        raise DatasetError(f"{file.path}: holds {values.dtype} {values.shape}; allowed: float32 or float16 of (n, d)")
    if not np.isfinite(values.sum(axis=1, dtype=np.float64)).all():
        raise DatasetError(f"{file.path}: has NaN or infinite values")
    sidecar = {"shape": list(values.shape), "key": file.sha256}
    return Descriptors(values.astype(np.float32, copy=False), file.sha256, file.sha256, "given descriptors", sidecar)


def _rows_of(traversal: Traversal, file: Given) -> np.ndarray:
    try:
        values = np.load(file.path, mmap_mode="r", allow_pickle=False)
    except (OSError, ValueError) as error:
        raise DatasetError(f"{file.path}: cannot be read as a NumPy array ({error})") from None
    if len(values) != len(traversal):
        raise DatasetError(
            f"{file.path}: {len(values)} rows for the {len(traversal)} images of {traversal.dataset}/{traversal.name}"
        )
    return values


def _read(path: Path, key: str, source: str) -> Descriptors:
    sidecar = store.read_json(path.with_suffix(".json"))
    try:
        values = np.load(path, mmap_mode="r", allow_pickle=False)
    except (OSError, ValueError) as error:
        raise store.StoreError(f"{path}: cannot be read ({error}); delete it and its .json and run again") from None
    if sidecar["key"] != key or list(values.shape) != sidecar["shape"]:
        raise store.StoreError(
            f"{path}: does not fit its sidecar {path.with_suffix('.json').name}; delete both and run again"
        )
    if values.dtype != np.float32:
        values = values.astype(np.float32)
    return Descriptors(values, key, sidecar["sha256"], source, sidecar)


# -- extraction ---------------------------------------------------------------------------------------------


def _extract(job: Job, device: Any, *, progress: bool) -> None:
    import torch

    from artifact.extraction import forward, shards

    begun = time.monotonic()
    devices = forward.devices(device)
    traversal, entry, n = job.traversal, job.entry, len(job.traversal)
    if job.files is not None:
        local_features.check_disk({job.label: job.files.missing_bytes()}, job.files.folder, _say)
        job = replace(job, key=f"{job.key}+{local_features.start(job.files)}")
    done = partial.start(job.path, job.key, (n, entry.dimension))
    remaining = [rows for rows in shards.batches(n, entry.batch_size) if not done[rows].all()]
    initial = n - sum(rows.stop - rows.start for rows in remaining)
    hidden = None if progress else True
    with tqdm(
        total=n, initial=initial, unit="image", desc=job.label, disable=hidden, smoothing=0.05, leave=False
    ) as bar:
        try:
            work = shards.run(job, remaining, devices, bar.update)
        except BaseException:
            partial.abandon(job.path)
            raise
    names = {"method": job.method, "dataset": traversal.dataset, "traversal": traversal.name}
    if job.files is not None:
        local_features.complete(job.files, names)
    sidecar = names | {
        "key": job.key.partition("+")[0],
        "shape": [n, entry.dimension],
        "images": traversal.digest,
        "revision": REVISION,
        "precision": job.precision,
        "preprocessing": entry.preprocessing.model_dump(),
        "batch_size": entry.batch_size,
        "images_at_once": work.at_once or entry.batch_size,
        "device": ", ".join(map(str, devices)),
        "torch": torch.__version__,
        "machine": platform.machine(),
        "seconds": round(time.monotonic() - begun, 3),
        "forward_seconds": round(work.seconds, 3),
    }
    partial.complete(job.path, sidecar)
