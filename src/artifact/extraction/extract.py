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
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from tqdm import tqdm

from artifact import methods, store
from artifact.datasets import shipped
from artifact.datasets.traversal import DatasetError, Given, Traversal
from artifact.extraction import local_features, partial
from artifact.extraction.reading import ExtractionError
from artifact.manifest import Manifest
from artifact.manifest.entries import ManifestError, MethodEntry

if TYPE_CHECKING:
    import torch  # imported where descriptors are made: reading stored ones does not need it

__all__ = ["PRECISIONS", "Descriptors", "ExtractionError", "descriptor_key", "descriptors", "is_ready", "stored_path"]

PRECISIONS = ("float32", "bfloat16", "float16")
REVISION = 1  # raise when the same model and images would give other descriptors


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
        found = shipped.descriptors(key)
        if found is not None:
            return _load(found, key, "shipped descriptors")
        traversal.image_paths()
    with store.lock(path):
        if not path.with_suffix(".json").exists():
            files = _files(manifest, traversal, method, entry, key)
            _extract(path, key, traversal, method, entry, device, workers, precision, files, progress=progress)
    return _load(path, key, "images")


def second_stage(
    manifest: Manifest,
    traversal: Traversal,
    method: str,
    *,
    device: str | torch.device | None = None,
    precision: str = "float32",
    workers: int | None = None,
    progress: bool = False,
) -> local_features.Stored | np.ndarray:
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
    files = _files(manifest, traversal, method, entry, key)
    if files is None:
        raise ManifestError(f"{manifest.path}: methods.{method} has neither local_features nor code_bits")
    options = {"device": device, "precision": precision, "workers": workers, "progress": progress}
    if files.missing():
        traversal.image_paths()
        descriptors(manifest, traversal, method, **options)
        with store.lock(stored_path(manifest, method, key)):
            if files.missing():
                again = files.folder / "descriptors.npy"
                _extract(again, key, traversal, method, entry, device, workers, precision, files, progress=progress)
                again.with_suffix(".json").unlink()
                again.unlink()
    return local_features.load(files)


def second_stage_key(traversal: Traversal, method: str, entry: MethodEntry, precision: str = "float32") -> str:
    """Return the content key of a traversal's local features or codes."""
    if method in traversal.second_stage:
        return traversal.second_stage[method].sha256
    return _second_key(descriptor_key(traversal, method, entry, precision), entry)


def check_disk(manifest: Manifest, traversals: Iterable[Traversal], names: Iterable[str]) -> None:
    """Say how much disk the local features and codes of methods take, and compare it with what is free.

    Raises
    ------
    StoreError
        If what is not stored yet does not fit.
    """
    needs, traversals = [], list(traversals)
    for method in names:
        entry = manifest.method(method)
        for traversal in (t for t in traversals if method not in t.descriptors):
            files = _files(manifest, traversal, method, entry, descriptor_key(traversal, method, entry))
            if files is not None:
                needs.append(files.need(f"{method} · {traversal.dataset}/{traversal.name}"))
    local_features.check_disk(needs, manifest.cache, _say)


def _say(line: str) -> None:
    tqdm.write(line, file=sys.stderr)


def _second_key(descriptors_key: str, entry: MethodEntry) -> str:
    layout, revision = local_features.layout_of(entry), local_features.REVISION
    return store.key(
        stage="local features", revision=revision, descriptors=descriptors_key, layout=layout,
        images_each=None if layout is None else layout.images_per_file,
    )  # fmt: skip


def _files(
    manifest: Manifest, traversal: Traversal, method: str, entry: MethodEntry, descriptors_key: str
) -> local_features.Files | None:
    layout = local_features.layout_of(entry)
    if layout is None:
        return None
    key = _second_key(descriptors_key, entry)
    folder = manifest.cache / "local_features" / method / key[:24]
    return local_features.Files(folder, key, len(traversal), layout, layout.images_per_file)


def is_ready(manifest: Manifest, traversal: Traversal, method: str) -> bool:
    """Whether descriptors are given, stored or shipped, so that nothing would be extracted."""
    if method in traversal.descriptors:
        return True
    key = descriptor_key(traversal, method, manifest.method(method))
    stored = stored_path(manifest, method, key).with_suffix(".json").exists()
    return stored or (not traversal.has_images and shipped.descriptors(key) is not None)


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


def _load(path: Path, key: str, source: str) -> Descriptors:
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


def _extract(
    path: Path, key: str, traversal: Traversal, method: str, entry: MethodEntry, device: Any, workers: int | None,
    precision: str, files: local_features.Files | None, *, progress: bool,
) -> None:  # fmt: skip
    import torch

    from artifact.extraction import forward, shards

    begun = time.monotonic()
    chosen = forward.devices(device)
    shape = (len(traversal), entry.dimension)
    journal_key = key
    if files is not None:
        label = f"{method} · {traversal.dataset}/{traversal.name}"
        local_features.check_disk([files.need(label)], files.folder, _say)
        journal_key = f"{key}+{local_features.start(files)}"
    done = partial.start(path, journal_key, shape)
    remaining = [rows for rows in shards.batches(len(traversal), entry.batch_size) if not done[rows].all()]
    with tqdm(
        total=len(traversal), initial=len(traversal) - sum(rows.stop - rows.start for rows in remaining), unit="image",
        desc=f"{method} · {traversal.dataset}/{traversal.name}", disable=None if progress else True, smoothing=0.05,
        leave=False,
    ) as bar:  # fmt: skip
        job = shards.Job(path, journal_key, traversal, method, entry, precision, workers, files)
        try:
            work = shards.run(job, remaining, chosen, bar.update)
        except BaseException:
            partial.abandon(path)
            raise
    if files is not None:
        local_features.complete(files, {"method": method, "dataset": traversal.dataset, "traversal": traversal.name})
    partial.complete(
        path,
        {
            "key": key, "method": method, "dataset": traversal.dataset, "traversal": traversal.name,
            "shape": list(shape), "images": traversal.digest, "revision": REVISION, "precision": precision,
            "preprocessing": entry.preprocessing.model_dump(), "batch_size": entry.batch_size,
            "images_at_once": work.at_once or entry.batch_size, "device": ", ".join(map(str, chosen)),
            "torch": torch.__version__, "machine": platform.machine(),
            "seconds": round(time.monotonic() - begun, 3), "forward_seconds": round(work.seconds, 3),
        },
    )  # fmt: skip
