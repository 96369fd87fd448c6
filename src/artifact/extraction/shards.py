"""The batches of a traversal through a model: in this process, or shared out over one process for each device.

Batches are the same however they are shared out: ranges of rows of fixed size from the first row on. A shard is some
of them, whole, and in order. So the descriptors do not depend on the number of devices, nor on where a run was
stopped, even for a method whose descriptors depend on the images that share a batch.
"""

from __future__ import annotations

import pickle
import signal
import sys
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection, wait
from typing import Any

import numpy as np
import torch

from artifact import methods
from artifact.datasets.traversal import Traversal
from artifact.extraction import local_features, partial, reading
from artifact.extraction.forward import Forward
from artifact.extraction.local_features import Job
from artifact.extraction.reading import ExtractionError
from artifact.manifest.entries import MethodEntry

_LISTED = 20


@dataclass
class Work:
    """What the model did: seconds that it computed, and images at once if memory was short (else ``None``)."""

    seconds: float = 0.0
    at_once: int | None = None


def batches(n: int, size: int) -> list[slice]:
    """Return the rows of each batch.

    Examples
    --------
    >>> batches(5, 2)
    [slice(0, 2, None), slice(2, 4, None), slice(4, 5, None)]
    """
    return [slice(start, min(start + size, n)) for start in range(0, n, size)]


def share_out(remaining: Sequence[slice], shards: int) -> list[list[slice]]:
    """Divide batches into at most ``shards`` contiguous parts that differ by one batch at most.

    Examples
    --------
    >>> [[rows.start for rows in part] for part in share_out(batches(10, 2), 2)]
    [[0, 2, 4], [6, 8]]
    """
    parts = [[remaining[i] for i in part] for part in np.array_split(np.arange(len(remaining)), shards)]
    return [part for part in parts if part]


def run(job: Job, remaining: Sequence[slice], devices: Sequence[torch.device], update: Callable[[int], Any]) -> Work:
    """Describe the remaining batches and write them to the partial file of the job.

    Parameters
    ----------
    job
        Its partial file is ready for writing.
    remaining
        Rows of the batches to describe.
    devices
        One shard each; a single one works in this process.
    update
        Called with the number of images done since the last call.

    Raises
    ------
    ExtractionError
        If images cannot be read: the message names those of all shards.
    """
    parts = share_out(remaining, len(devices))
    if len(parts) <= 1:
        works, unreadable = [_run_shard(job, part, devices[0], 0, update) for part in parts], []
    else:
        works, unreadable = _run_processes(job, parts, devices, update)
    if unreadable:
        raise unreadable_images(job.label, unreadable, len(job.traversal))
    smallest = min((work.at_once for work in works if work.at_once is not None), default=None)
    return Work(sum(work.seconds for work in works), smallest)


def unreadable_images(label: str, messages: Sequence[str], n: int) -> ExtractionError:
    """Return the error that names the images that cannot be read."""
    more = f"\n  and {len(messages) - _LISTED} more" if len(messages) > _LISTED else ""
    listed = "\n  ".join(messages[:_LISTED])
    return ExtractionError(f"{label}: {len(messages)} of {n} images cannot be read:\n  {listed}{more}", messages)


def describe(
    traversal: Traversal,
    entry: MethodEntry,
    forward: Forward,
    rows_of_batches: Sequence[slice],
    *,
    workers: int | None = None,
    work: Work | None = None,
    second: Callable[[slice, np.ndarray], Any] | None = None,
) -> Iterator[tuple[slice, np.ndarray]]:
    """Yield the rows and descriptors of each batch.

    Parameters
    ----------
    traversal, entry, forward
        What to describe, and by what.
    rows_of_batches
        Rows of the batches to describe, in order.
    workers
        Processes that read images; see :func:`artifact.extraction.reading.read_batches`.
    work
        Receives what the model did.
    second
        Receives the rows and the second output of each batch, before its descriptors are yielded.

    Raises
    ------
    ExtractionError
        At the end, if images could not be read: the message names all of them. From the first one on, nothing more is
        described.
    """
    work = work or Work()
    label = f"{entry.title} · {traversal.dataset}/{traversal.name}"
    paths = traversal.image_paths()
    unreadable: list[str] = []
    started: deque[tuple[slice, tuple[torch.Tensor, ...]]] = deque()

    def finished() -> tuple[slice, np.ndarray]:
        rows, outputs = started.popleft()
        begun = time.perf_counter()
        values, *others = (output.cpu().numpy() for output in outputs)
        work.seconds += time.perf_counter() - begun
        values = _checked(values, entry, list(traversal.image_names[rows]), label)
        if second is not None:
            second(rows, others[0])
        return rows, values

    prepared = reading.read_batches([paths[rows] for rows in rows_of_batches], entry.preprocessing, workers)
    for rows, (images, errors) in zip(rows_of_batches, prepared, strict=True):
        unreadable += errors
        if unreadable:
            continue
        begun = time.perf_counter()
        outputs = forward(images)
        work.seconds += time.perf_counter() - begun
        work.at_once = forward.at_once
        started.append((rows, outputs))
        # On CUDA `forward` only launches: fetch a batch after the next one is launched, and the device never waits.
        while len(started) > (1 if outputs[0].device.type == "cuda" else 0):
            yield finished()
    while started:
        yield finished()
    if unreadable:
        raise unreadable_images(label, unreadable, len(traversal))


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


def _run_shard(
    job: Job, part: Sequence[slice], device: torch.device, number: int, update: Callable[[int], Any]
) -> Work:
    model = methods.model_of(job.method, job.entry).to(device)
    if job.files is None:
        output, second = partial.RowWriter(job.path, job.key, number), None
    else:
        model = local_features.both_outputs(model, job.files.layout, job.label)
        output = local_features.TwoOutputWriter(job.path, job.key, number, job.files)
        second = output.write_second
    forward, work = Forward(model, job.entry, device, job.precision), Work()
    described = describe(job.traversal, job.entry, forward, part, workers=job.workers, work=work, second=second)
    try:
        for rows, values in described:
            output.write(rows, values)
            update(rows.stop - rows.start)
    finally:
        output.pause()
    return work


# -- one process for each device ----------------------------------------------------------------------------


def _run_processes(
    job: Job, parts: Sequence[Sequence[slice]], devices: Sequence[torch.device], update: Callable[[int], Any]
) -> tuple[list[Work], list[str]]:
    """Run one process for each part; returns what each did, and the images that cannot be read."""
    context = reading.process_context()
    workers = reading.default_workers(len(parts)) if job.workers is None else job.workers
    job = replace(job, workers=workers)
    running, processes = {}, []
    works, unreadable = [], []
    try:
        for number, (part, device) in enumerate(zip(parts, devices, strict=False)):
            receiver, sender = context.Pipe(duplex=False)
            arguments = (sender, job, part, str(device), number, torch.get_num_threads())
            process = context.Process(target=_shard_process, args=arguments, name=f"{job.label} on {device}")
            with reading.main_unseen():
                process.start()
            sender.close()
            processes.append(process)
            running[receiver] = process
        while running:
            for receiver in wait(list(running)):
                kind, content = _received(receiver, running[receiver])
                if kind == "images":
                    update(content)
                    continue
                del running[receiver]
                if kind == "work":
                    works.append(content)
                elif isinstance(content, ExtractionError) and content.unreadable:
                    unreadable += content.unreadable
                else:
                    raise content
    finally:
        for process in processes:
            process.terminate()
        for process in processes:
            process.join()
    return works, unreadable


def _received(receiver: Connection, process: Any) -> tuple[str, Any]:
    try:
        return receiver.recv()
    except EOFError:
        process.join()
        code = process.exitcode
        ended = f"was ended by the signal {-code}" if code < 0 else f"ended with the status {code}"
        advice = "; if memory ran out, use fewer devices" if code == -signal.SIGKILL else ""
        return "error", ExtractionError(f"{process.name}: its process {ended}{advice}. Run again to go on")


def _shard_process(sender: Connection, job: Job, part: Sequence[slice], device: str, number: int, threads: int) -> None:
    reading.end_with_parent()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # so that the journal is written
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent hears it too, and ends this process
    torch.set_num_threads(threads)  # the last digits depend on it
    try:
        work = _run_shard(job, part, torch.device(device), number, lambda images: sender.send(("images", images)))
        sender.send(("work", work))
    except Exception as error:
        error.add_note("".join(traceback.format_exception(error)))
        sender.send(("error", _that_travels(error)))


def _that_travels(error: Exception) -> Exception:
    """Return the error, or one with its text if it cannot be sent to another process."""
    try:
        return pickle.loads(pickle.dumps(error))
    except Exception:
        return RuntimeError("\n".join(error.__notes__))
