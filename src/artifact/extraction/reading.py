"""Image files → prepared batches, read ahead of the model by other processes.

Each process has a pipe of its own, so that its death is noticed at once: with a queue that several share, as that of a
PyTorch ``DataLoader``, the model waits for ever for the rest of a batch that a killed process has sent in part. Batches travel as
NumPy arrays: tensors would go through shared memory, of which containers have little by default.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import sys
import threading
import types
from collections.abc import Callable, Iterator, Sequence
from multiprocessing.connection import Connection
from multiprocessing.context import BaseContext
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

import numpy as np

from artifact import store
from artifact.datasets.images import UnreadableImageError, read_image
from artifact.manifest.entries import Preprocessing

Prepared = np.ndarray | list[np.ndarray]
"""A batch ``(b, c, h, w)`` float32, or one ``(c, h, w)`` per image where their sizes differ."""

_NICENESS = 5
_MOST_WORKERS = 16


class ExtractionError(RuntimeError):
    """Descriptors that cannot be made; the message names every image at fault, ``unreadable`` has one for each."""

    def __init__(self, message: str, unreadable: Sequence[str] = ()) -> None:
        super().__init__(message)
        self.unreadable = list(unreadable)


def read_batches(
    batches: Sequence[Sequence[Path]], preprocessing: Preprocessing, workers: int | None = None
) -> Iterator[tuple[Prepared, list[str]]]:
    """Yield prepared batches in order, a few of them read ahead.

    ``workers`` is the number of processes that read; ``None`` takes :func:`default_workers`, and 0 reads in this process when
    a batch is asked for. With a batch comes a message for each of its images that cannot be read and so is not in it. Where
    one of the processes dies, others take their place once; then ``ExtractionError`` is raised.
    """
    workers = min(default_workers() if workers is None else workers, len(batches))
    if not workers:
        for paths in batches:
            yield prepare_batch(paths, preprocessing)
        return
    readers: dict[int, tuple[BaseProcess, Connection]] = {}
    died = ""
    try:
        for number in range(workers):
            readers[number] = start_process(_serve, batches[number::workers], preprocessing, daemon=True)
        for number in range(len(batches)):
            prepared = None
            while prepared is None:
                try:
                    prepared = readers[number % workers][1].recv()
                except (EOFError, OSError):
                    if died:
                        raise ExtractionError(f"{died}, and so has another; memory may be short. Run again") from None
                    died = f"a process that reads images has ended (exit status {_end(*readers[number % workers])})"
                    store.say(f"{died}; another takes its place")
                    readers[number % workers] = start_process(
                        _serve, batches[number::workers], preprocessing, daemon=True
                    )
            if isinstance(prepared, Exception):
                raise prepared
            yield prepared
    finally:
        for reader in readers.values():
            _end(*reader)


def _serve(connection: Connection, batches: Sequence[Sequence[Path]], preprocessing: Preprocessing) -> None:
    """Prepare some batches, each while the one before is on its way."""
    import torch

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the model's process hears it too, and ends this one
    torch.set_num_threads(1)
    # The model's threads wait for each other at every layer: a reader that delays one of them delays all.
    with contextlib.suppress(OSError, AttributeError):
        os.nice(_NICENESS)
    with contextlib.suppress(BrokenPipeError):  # nobody wants more
        for paths in batches:
            try:
                prepared: Any = prepare_batch(paths, preprocessing)
            except Exception as error:
                prepared = error
            connection.send(prepared)


def _end(process: BaseProcess, connection: Connection) -> int | None:
    connection.close()
    process.terminate()
    process.join()
    return process.exitcode


def default_workers(devices: int = 1) -> int:
    """Return the number of reading processes for each of several devices: all cores but one, shared, at most 16."""
    return max(1, min(_MOST_WORKERS, ((os.cpu_count() or 2) - 1) // devices))


def prepare_batch(paths: Sequence[Path], preprocessing: Preprocessing) -> tuple[Prepared, list[str]]:
    """Read and prepare the images of one batch; see :func:`read_batches`."""
    from artifact.methods.preprocessing import prepare

    images, errors = [], []
    for path in paths:
        try:
            images.append(prepare(read_image(path, preprocessing.colour), preprocessing).numpy())
        except UnreadableImageError as error:
            errors.append(str(error))
    alike = len({image.shape for image in images}) == 1
    return (np.stack(images) if alike else images), errors


# -- processes ----------------------------------------------------------------------------------------------


def process_context() -> BaseContext:
    """Return a way to start processes that never forks one with running threads."""
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["artifact.methods.preprocessing"])
    return context


@contextlib.contextmanager
def main_unseen() -> Iterator[None]:
    """Keep a process that starts now from running the caller's script again, which needs no ``__main__`` guard then."""
    main = sys.modules["__main__"]
    sys.modules["__main__"] = types.ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = main


def start_process(function: Callable[..., None], *arguments: Any, daemon: bool) -> tuple[BaseProcess, Connection]:
    """Start a process that ends with this one; return it and what its function sends, by the first of its arguments."""
    context = process_context()
    ours, theirs = context.Pipe(duplex=False)
    process = context.Process(target=_run, args=(function, theirs, *arguments), daemon=daemon)
    with main_unseen():
        process.start()
    theirs.close()  # so that its death is the end of the pipe
    return process, ours


def _run(function: Callable[..., None], *arguments: Any) -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:  # it may be killed: nobody else would end this process then
        threading.Thread(target=lambda: (parent.join(), os._exit(1)), daemon=True).start()
    function(*arguments)
