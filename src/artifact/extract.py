"""Traversal × method → descriptors on disk, resumable at any moment.

Worker processes decode and prepare images ahead of the model. Descriptors go to a partial file; a journal beside
it records how many batches are safely on disk, so that a killed run goes on from there and, because batches are
always the same, ends with the same bytes. A result is complete only when its sidecar exists.
"""

from __future__ import annotations

import multiprocessing
import os
import platform
import sys
import time
import types
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from tqdm import tqdm

from artifact import methods, store
from artifact.datasets import shipped
from artifact.datasets.traversal import Traversal
from artifact.images import UnreadableImageError, read_image
from artifact.manifest import Manifest, MethodEntry, Preprocessing

if TYPE_CHECKING:
    import torch  # imported where descriptors are made: reading stored ones does not need it

REVISION = 1  # raise when the same model and images would give other descriptors

_JOURNAL_SECONDS = 2.0
_LISTED = 20


class ExtractionError(RuntimeError):
    """Descriptors that cannot be made; the message names every image at fault."""


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
        ``"images"`` or ``"shipped descriptors"``.
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
    workers: int | None = None,
    progress: bool = False,
) -> Descriptors:
    """Return a traversal's descriptors: stored ones if their key is equal, else extracted now.

    Parameters
    ----------
    manifest, traversal, method
        What to describe, and the method's name in the manifest.
    device
        ``None`` takes CUDA if there is any, else the CPU.
    workers
        Processes that read images; ``None`` leaves one core to the model; 0 reads in this process.
    progress
        Whether to show a progress bar with rate and remaining time.

    Raises
    ------
    ExtractionError
        If images cannot be read, or descriptors are not finite and of unit length. All are listed.
    DatasetError
        If neither images nor shipped descriptors are at hand.
    """
    entry = manifest.method(method)
    key = descriptor_key(traversal, method, entry)
    path = stored_path(manifest, method, key)
    if not traversal.has_images and not path.with_suffix(".json").exists():
        found = shipped.descriptors(key)
        if found is not None:
            return _load(found, key, "shipped descriptors")
        traversal.image_paths()
    with store.lock(path):
        if not path.with_suffix(".json").exists():
            _extract(path, key, traversal, method, entry, device, workers, progress=progress)
    return _load(path, key, "images")


def is_ready(manifest: Manifest, traversal: Traversal, method: str) -> bool:
    """Whether descriptors are stored or shipped, so that nothing would be extracted."""
    key = descriptor_key(traversal, method, manifest.method(method))
    stored = stored_path(manifest, method, key).with_suffix(".json").exists()
    return stored or (not traversal.has_images and shipped.descriptors(key) is not None)


def descriptor_key(traversal: Traversal, method: str, entry: MethodEntry) -> str:
    """Return the content key of descriptors: images, order, model, preprocessing and code revisions."""
    model = methods.fingerprint(method, entry)
    return store.key(stage="descriptors", revision=REVISION, images=traversal.digest, model=model)


def stored_path(manifest: Manifest, method: str, key: str) -> Path:
    """Return the file that holds, or would hold, the descriptors of a key."""
    return store.cache_folder(manifest.path.parent) / "descriptors" / method / f"{key[:24]}.npy"


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
    *, progress: bool,
) -> None:  # fmt: skip
    import torch

    begun = time.monotonic()
    chosen = torch.device(device or ("cuda" if torch.cuda.is_available() else "cpu"))
    model = methods.model_of(method, entry).to(chosen)
    output = _PartialFile(path, key, (len(traversal), entry.dimension))
    clock = Clock()
    label = f"{method} · {traversal.dataset}/{traversal.name}"
    with tqdm(
        total=len(traversal), initial=min(output.done * entry.batch_size, len(traversal)), unit="image", desc=label,
        disable=None if progress else True, smoothing=0.05, leave=False,
    ) as bar:  # fmt: skip
        try:
            for rows, values in describe(traversal, model, entry, chosen, workers, bar, first=output.done, clock=clock):
                output.write(rows, values)
        except BaseException:
            output.pause()
            raise
    output.complete(
        {
            "key": key, "method": method, "dataset": traversal.dataset, "traversal": traversal.name,
            "images": traversal.digest, "preprocessing": entry.preprocessing.model_dump(), "revision": REVISION,
            "device": str(chosen), "torch": torch.__version__, "machine": platform.machine(),
            "seconds": round(time.monotonic() - begun, 3), "forward_seconds": round(clock.seconds, 3),
        }
    )  # fmt: skip


@dataclass
class Clock:
    """Seconds that the model computed."""

    seconds: float = 0.0


def describe(
    traversal: Traversal, model: torch.nn.Module, entry: MethodEntry, device: torch.device, workers: int | None, bar: tqdm,
    *, first: int = 0, clock: Clock | None = None,
) -> Iterator[tuple[slice, np.ndarray]]:  # fmt: skip
    """Yield the rows and descriptors of each batch, from batch ``first`` on.

    Raises
    ------
    ExtractionError
        At the end, if images could not be read: the message names all of them. From the first one on, nothing more is
        described.
    """
    clock = clock or Clock()
    label = f"{entry.title} · {traversal.dataset}/{traversal.name}"
    batches = list(_batches(len(traversal), entry.batch_size))[first:]
    paths = traversal.image_paths()
    unreadable: list[str] = []
    prepared = _read([paths[rows] for rows in batches], entry.preprocessing, workers)
    for rows, (images, errors) in zip(batches, prepared, strict=True):
        unreadable += errors
        if not unreadable:
            begun = time.perf_counter()
            values = _forward(model, images, device)
            clock.seconds += time.perf_counter() - begun
            yield rows, _checked(values, entry, list(traversal.image_names[rows]), label)
        bar.update(rows.stop - rows.start)
    if unreadable:
        more = f"\n  and {len(unreadable) - _LISTED} more" if len(unreadable) > _LISTED else ""
        listed = "\n  ".join(unreadable[:_LISTED])
        raise ExtractionError(
            f"{label}: {len(unreadable)} of {len(traversal)} images cannot be read:\n  {listed}{more}"
        )


def _batches(n: int, size: int) -> Iterator[slice]:
    for start in range(0, n, size):
        yield slice(start, min(start + size, n))


def _forward(model: torch.nn.Module, images: list[np.ndarray], device: torch.device) -> np.ndarray:
    """Run the model on a batch; images of different sizes go one by one."""
    import torch

    groups = [images] if len({image.shape for image in images}) == 1 else [[image] for image in images]
    with torch.inference_mode():
        outputs = [model(torch.from_numpy(np.stack(group)).to(device)).float().cpu() for group in groups]
    return torch.cat(outputs).numpy()


def _checked(values: np.ndarray, entry: MethodEntry, names: list[str], label: str) -> np.ndarray:
    if values.shape != (len(names), entry.dimension):
        raise ExtractionError(
            f"{label}: the model gave the shape {values.shape} for {len(names)} images; "
            f"the manifest says dimension {entry.dimension}"
        )
    lengths = np.linalg.norm(values, axis=1)
    bad = np.flatnonzero(~(np.abs(lengths - 1) < 1e-3))
    if bad.size:
        listed = ", ".join(f"{names[i]} ({lengths[i]:.4g})" for i in bad[:_LISTED])
        raise ExtractionError(
            f"{label}: descriptors must be finite and of length 1; these images have other lengths: {listed}. "
            f"An image without any contrast has no {entry.title} descriptor; a model from outside should end with "
            f"torch.nn.functional.normalize(x, dim=-1)"
        )
    return values


class _PartialFile:
    """The growing descriptor file, its journal, and the steps that make it whole."""

    def __init__(self, path: Path, key: str, shape: tuple[int, int]) -> None:
        self._path, self._key = path, key
        self._partial = path.with_suffix(".partial.npy")
        self._journal = path.with_suffix(".journal.json")
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.exists():  # killed between the last two steps of `complete`
            path.replace(self._partial)
        journal = store.read_json(self._journal) if self._journal.exists() else {}
        self.done = journal.get("batches", 0) if journal.get("key") == key and self._partial.exists() else 0
        mode = "r+" if self.done else "w+"
        self._values = np.lib.format.open_memmap(self._partial, mode=mode, dtype=np.float32, shape=shape)
        self._written, self._last = self.done, time.monotonic()

    def write(self, rows: slice, values: np.ndarray) -> None:
        self._values[rows] = values
        self._written += 1
        if time.monotonic() - self._last > _JOURNAL_SECONDS:
            self.pause()

    def pause(self) -> None:
        """Bring all written batches to disk, then say so in the journal."""
        self._values.flush()
        store.write_json(self._journal, {"key": self._key, "batches": self._written})
        self._last = time.monotonic()

    def complete(self, sidecar: dict[str, Any]) -> None:
        self.pause()
        shape = list(self._values.shape)
        del self._values
        with self._partial.open("rb+") as stream:
            os.fsync(stream.fileno())
        digest = store.digest_of_file(self._partial)
        self._partial.replace(self._path)
        store.write_json(self._path.with_suffix(".json"), {**sidecar, "shape": shape, "sha256": digest})
        self._journal.unlink()


# -- reading ------------------------------------------------------------------------------------------------


def _read(
    batches: list[list[Path]], preprocessing: Preprocessing, workers: int | None
) -> Iterator[tuple[list[np.ndarray], list[str]]]:
    """Yield prepared batches in order, read ahead by worker processes."""
    if workers is None:
        workers = max(1, min(8, (os.cpu_count() or 2) - 1))
    if workers == 0 or not batches:
        for batch in batches:
            yield _prepare_batch(batch, preprocessing)
        return
    with ProcessPoolExecutor(workers, mp_context=_context()) as pool:
        waiting: deque[Future[tuple[list[np.ndarray], list[str]]]] = deque()
        try:
            for batch in batches:
                with _main_unseen():
                    waiting.append(pool.submit(_prepare_batch, batch, preprocessing))
                if len(waiting) > workers + 2:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            for future in waiting:
                future.cancel()


def _context() -> multiprocessing.context.BaseContext:
    """Return a way to start workers that never forks a process with running threads."""
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["artifact.methods.preprocessing"])
    return context


@contextmanager
def _main_unseen() -> Iterator[None]:
    """Keep a worker that starts now from running the caller's script again, which needs no ``__main__`` guard then."""
    main = sys.modules["__main__"]
    sys.modules["__main__"] = types.ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = main


def _prepare_batch(paths: list[Path], preprocessing: Preprocessing) -> tuple[list[np.ndarray], list[str]]:
    import torch

    from artifact.methods.preprocessing import prepare

    torch.set_num_threads(1)
    images, errors = [], []
    for path in paths:
        try:
            images.append(prepare(read_image(path, preprocessing.colour), preprocessing).numpy())
        except UnreadableImageError as error:
            errors.append(str(error))
    return images, errors
