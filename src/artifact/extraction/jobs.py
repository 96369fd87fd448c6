"""Jobs: to describe the images of one part and write it, on any machine that shares the storage.

Batches are ranges of images of fixed size from the first image on, and a job describes some of them, whole and in order.
So the bytes of a part do not depend on who makes it, or on where a run was stopped, even for a method whose descriptors
depend on the images that share a batch. An engine runs the jobs of :func:`jobs_of` wherever it likes;
:func:`artifact.extraction.extract.descriptors` runs those that are left.
"""

from __future__ import annotations

import contextlib
import itertools
import platform
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from artifact import methods, store
from artifact.datasets import shipped
from artifact.datasets.traversal import CHANGED, Traversal
from artifact.extraction import local_features, reading
from artifact.extraction.forward import Forward, devices
from artifact.extraction.parts import Parts
from artifact.extraction.reading import ExtractionError
from artifact.extraction.stored import stored
from artifact.manifest import Manifest
from artifact.manifest.entries import MethodEntry

_LISTED = 20


@dataclass(frozen=True)
class ExtractionJob:
    """To make one part of the descriptors of a traversal, and of its local features or codes.

    Of methods with the same trunk it makes the parts of all; ``method`` is the first of them in the manifest.

    It holds all that it needs, so that it can be sent to another process or machine.

    Attributes
    ----------
    dataset, traversal, method, entry
        Names in the manifest, and the method's entry.
    precision
        ``"float32"``, ``"bfloat16"`` or ``"float16"``.
    number, images, digests
        Which part, and the files of its images in order, with what their SHA-256 must be.
    descriptors, second
        Where both outputs go; ``None`` for one that is complete already or that the method has not.
    others
        Entries of the other methods of its trunk by name, and where their descriptors go.
    """

    dataset: str
    traversal: str
    method: str
    entry: MethodEntry
    precision: str
    number: int
    images: tuple[Path, ...]
    digests: tuple[str, ...]
    descriptors: Parts | None
    second: Parts | None
    others: tuple[tuple[str, MethodEntry, Parts | None], ...] = ()

    @property
    def batches(self) -> list[Sequence[Path]]:
        """Image files of each batch."""
        return batches(self.images, self.entry.batch_size)

    @property
    def is_done(self) -> bool:
        """Whether somebody has made the part."""
        outputs = self.second, self.descriptors, *(parts for *_, parts in self.others)
        return all(parts is None or parts.has(self.number) for parts in outputs)


def batches(images: Sequence[Path], size: int) -> list[Sequence[Path]]:
    """Divide images into batches of a size, from the first image on; the last may be smaller.

    Examples
    --------
    >>> batches("abcde", 2)
    ['ab', 'cd', 'e']
    """
    return [images[start : start + size] for start in range(0, len(images), size)]


def jobs_of(manifest: Manifest, traversal: Traversal, method: str, precision: str = "float32") -> list[ExtractionJob]:
    """Return the jobs for what is missing of a traversal's descriptors and local features or codes.

    Of the parts that the method lacks, they make what all methods of its trunk lack. There are none where descriptors are
    given, or shipped and the images are not at hand.

    Raises
    ------
    DatasetError
        If something is missing and the images are not at hand.
    """
    place = stored(manifest, traversal, method, precision)
    if method in traversal.descriptors or not (traversal.has_images or shipped.path_of(place.key) is None):
        return []
    entries = methods.of_trunk(manifest, method)
    places = {name: stored(manifest, traversal, name, precision) for name in entries}
    parts = {name: None if one.is_complete else one.parts for name, one in places.items()}
    second = place.second if place.second is not None and place.second.missing() else None
    missing = {number for one in (parts[method], second) if one is not None for number in one.missing()}
    images, (first, *others) = traversal.image_paths() if missing else [], entries
    rows = {number: place.parts.rows(number) for number in sorted(missing)}
    return [
        ExtractionJob(
            *(traversal.dataset, traversal.name, first, entries[first], precision, number),
            *(tuple(images[own]), traversal.image_digests[own]),
            parts[first],
            second,
            tuple((name, entries[name], parts[name]) for name in others),
        )
        for number, own in rows.items()
    ]


def forward_of(job: ExtractionJob, device: str | torch.device | None = None) -> Forward:
    """Return the model of a job on a device, for all jobs of the same method and precision.

    Errors are those of :func:`artifact.extraction.forward.devices` and :func:`artifact.methods.model_of`.
    """
    where = devices(device)[0]
    if job.others:
        entries = {job.method: job.entry} | {name: entry for name, entry, _ in job.others}
        others = [entry for _, entry, _ in job.others]
        return Forward(methods.shared(entries, where), job.entry, where, job.precision, others)
    return Forward.of(methods.model_of(job.method, job.entry), job.entry, where, job.precision, job.method)


def run(
    jobs: Sequence[ExtractionJob],
    forward: Forward,
    *,
    workers: int | None = None,
    update: Callable[[int], Any] = lambda _: None,
) -> None:
    """Describe the images of some jobs of one traversal and method, and write their parts.

    Images are read ahead across jobs; what somebody has made meanwhile is left. Of a part, the descriptors come last: where
    they are, the rest is.

    Parameters
    ----------
    jobs, forward
        Jobs of the same traversal, method and precision, and their model from :func:`forward_of`.
    workers
        Processes that read images; see :func:`artifact.extraction.reading.read_batches`.
    update
        Called with the number of images after each batch.

    Raises
    ------
    ExtractionError
        If images cannot be read, after all parts before them are written: the message names those of all the jobs.
    StoreError
        If a part cannot be written.
    """
    jobs = [job for job in jobs if not job.is_done]
    if not jobs:
        return
    for job in jobs:
        _require_unchanged(job)
    stream = describe(
        [batch for job in jobs for batch in job.batches], forward, f"{jobs[0].dataset}/{jobs[0].traversal}", workers
    )
    layout = local_features.layout_of(jobs[0].entry)
    with contextlib.closing(stream):
        for job in jobs:
            begun, computed = time.monotonic(), forward.seconds
            done = []
            for arrays in itertools.islice(stream, len(job.batches)):
                done.append(arrays)
                update(len(arrays[0]))
            outputs = list(zip(*done, strict=True))
            record = {
                "method": job.method,
                "dataset": job.dataset,
                "traversal": job.traversal,
                "images_at_once": forward.at_once or job.entry.batch_size,
                "device": str(forward.device),
                "torch": torch.__version__,
                "machine": platform.machine(),
                "seconds": time.monotonic() - begun,
                "forward_seconds": forward.seconds - computed,
            }
            if job.second is not None and layout is not None:
                second = [local_features.stored_form(block, layout) for block in outputs[1]]
                job.second.write(job.number, second, record)
            written = [(name, parts) for name, _, parts in job.others] + [(job.method, job.descriptors)]
            for (name, parts), blocks in zip(written, [*outputs[1 : len(written)], outputs[0]], strict=True):
                if parts is not None:
                    parts.write(job.number, blocks, record | {"method": name})


def _require_unchanged(job: ExtractionJob) -> None:
    """Read the images once more before they are described under the key that their digests are part of."""
    if job.digests and tuple(store.digest_of_files(job.images)) != job.digests:
        changed = [p for p, known in zip(job.images, job.digests, strict=True) if store.digest_of_file(p) != known]
        raise ExtractionError(f"{changed[0]}: {CHANGED} ({len(changed)} of {len(job.images)} images)")


def describe(
    batches: Sequence[Sequence[Path]], forward: Forward, what: str, workers: int | None = None
) -> Iterator[tuple[np.ndarray, ...]]:
    """Yield the descriptors of each batch of image files, ``(b, d)`` float32, and the second output if there is one.

    The ``seconds`` of ``forward`` grow; ``what`` names the traversal in messages. Raises ``ExtractionError`` if descriptors are
    not finite and of unit length, and at the end if images could not be read: the message names all of them, and from the
    first one on nothing more is described.
    """
    unreadable: list[str] = []
    started: deque[tuple[Sequence[Path], tuple[torch.Tensor, ...]]] = deque()

    def finished() -> tuple[np.ndarray, ...]:
        images, outputs = started.popleft()
        begun = time.perf_counter()
        arrays = tuple(output.cpu().numpy() for output in outputs)
        forward.seconds += time.perf_counter() - begun
        for values, entry in zip(arrays, [forward.entry, *forward.others], strict=False):  # a second output may follow
            _check(values, entry, images, f"{entry.title} · {what}")
        return arrays

    prepared = reading.read_batches(batches, forward.entry.preprocessing, workers)
    for paths, (images, errors) in zip(batches, prepared, strict=True):
        unreadable += errors
        if unreadable:
            continue
        begun = time.perf_counter()
        outputs = forward(images)
        forward.seconds += time.perf_counter() - begun
        started.append((paths, outputs))
        # On CUDA `forward` only launches: fetch a batch after the next one is launched, and the device never waits.
        while len(started) > (1 if outputs[0].device.type == "cuda" else 0):
            yield finished()
    while started:
        yield finished()
    if unreadable:
        more = f"\n  and {len(unreadable) - _LISTED} more" if len(unreadable) > _LISTED else ""
        listed, n = "\n  ".join(unreadable[:_LISTED]), sum(map(len, batches))
        fault = f"{forward.entry.title} · {what}: {len(unreadable)} of {n} images cannot be read:\n  {listed}{more}"
        raise ExtractionError(fault, unreadable)


def _check(values: np.ndarray, entry: MethodEntry, images: Sequence[Path], label: str) -> None:
    if values.shape != (len(images), entry.dimension):
        raise ExtractionError(
            f"{label}: the model gave the shape {values.shape} for {len(images)} images; "
            f"the manifest says dimension {entry.dimension}"
        )
    lengths = np.linalg.norm(values, axis=1)
    bad = np.flatnonzero(~(np.abs(lengths - 1) < 1e-3))
    if bad.size:
        listed = ", ".join(f"{images[i]} ({lengths[i]:.4g})" for i in bad[:_LISTED])
        raise ExtractionError(
            f"{label}: descriptors must be finite and of length 1; these images have other lengths: {listed}. "
            f"An image without any contrast has no {entry.title} descriptor; a model from outside should end with "
            f"torch.nn.functional.normalize(x, dim=-1)"
        )
