"""Image files → prepared batches, read ahead of the model by worker processes."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import sys
import threading
import types
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from multiprocessing.context import BaseContext
from pathlib import Path

import numpy as np

from artifact.datasets.images import UnreadableImageError, read_image
from artifact.manifest.entries import Preprocessing

Prepared = np.ndarray | list[np.ndarray]
"""A batch ``(b, c, h, w)`` float32, or one ``(c, h, w)`` per image where their sizes differ."""

_NICENESS = 5
_MOST_WORKERS = 16


class ExtractionError(RuntimeError):
    """Descriptors that cannot be made; the message names every image at fault.

    Attributes
    ----------
    unreadable
        A message for each image that cannot be read.
    """

    def __init__(self, message: str, unreadable: Sequence[str] = ()) -> None:
        super().__init__(message)
        self.unreadable = list(unreadable)


def read_batches(
    batches: Sequence[Sequence[Path]], preprocessing: Preprocessing, workers: int | None = None
) -> Iterator[tuple[Prepared, list[str]]]:
    """Yield prepared batches in order, a few of them read ahead.

    Parameters
    ----------
    batches
        Image files of each batch.
    preprocessing
        How an image becomes the model's input.
    workers
        Processes that read; ``None`` takes :func:`default_workers`; 0 reads in this process when a batch is asked for.

    Yields
    ------
    images
        The batch.
    errors
        One message for each image that cannot be read; those images are not in ``images``.
    """
    workers = default_workers() if workers is None else workers
    workers = min(workers, len(batches))
    if workers == 0:
        for batch in batches:
            yield prepare_batch(batch, preprocessing)
        return
    with ProcessPoolExecutor(workers, mp_context=process_context(), initializer=_start_worker) as pool:
        waiting: deque[Future[tuple[Prepared, list[str]]]] = deque()
        try:
            for batch in batches:
                with main_unseen():
                    waiting.append(pool.submit(prepare_batch, batch, preprocessing))
                if len(waiting) > workers + 2:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            for future in waiting:
                future.cancel()


def default_workers(shards: int = 1) -> int:
    """Return the number of reading processes for each of several shards: all cores but one, shared, at most 16."""
    return max(1, min(_MOST_WORKERS, ((os.cpu_count() or 2) - 1) // shards))


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


def end_with_parent() -> None:
    """End this process when the one that started it dies, however it dies; nobody else would end it then."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=lambda: (parent.join(), os._exit(1)), daemon=True).start()


def _start_worker() -> None:
    import torch

    end_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the model's process hears it too, and ends this one
    torch.set_num_threads(1)
    # The model's threads wait for each other at every layer: a reader that delays one of them delays all.
    with contextlib.suppress(OSError, AttributeError):
        os.nice(_NICENESS)
