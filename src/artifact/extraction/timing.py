"""How long a model takes for an image on this machine, and how much memory: tried in a process of its own.

The process ends after the trial, so that its peak memory is that of one model, and a model that is too large for the
machine takes nothing else down with it. Trained weights are not needed: they change neither time nor memory.
"""

from __future__ import annotations

import os
import resource
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image

from artifact import methods, store
from artifact.extraction import local_features, reading
from artifact.manifest import Manifest
from artifact.manifest.entries import MethodEntry

if TYPE_CHECKING:
    import torch

LIMIT_SECONDS = 300.0
PHOTOGRAPH = (480, 640)
"""Height and width in pixels of the photograph that recorded times are for."""

_SLOW_SECONDS = 10.0  # an image that takes longer is timed once, without a warm-up
_BATCH_SECONDS = 20.0  # a whole batch is timed if it is expected to take less
_OVERHEAD = 600e6  # bytes that Python, PyTorch and a small model's activations take


@dataclass(frozen=True)
class Timing:
    """What a trial measured.

    Attributes
    ----------
    forward
        Seconds of the model for an image; ``None`` if it was not measured.
    reading
        Seconds of one core to decode and prepare an image.
    memory
        Peak bytes for a whole batch: of the process, or on CUDA of the device.
    reader_memory
        Bytes of a process that reads images.
    note
        What was timed (``"a batch of 16"``), or why nothing was.
    """

    forward: float | None
    reading: float | None
    memory: float | None
    reader_memory: float | None
    note: str = ""


def time_method(
    method: str, entry: MethodEntry, image_size: tuple[int, int], device: torch.device, precision: str = "float32",
    limit: float = LIMIT_SECONDS,
) -> Timing:  # fmt: skip
    """Time a method on a made-up photograph, after a warm-up.

    Parameters
    ----------
    method, entry
        The method's name and its manifest entry.
    image_size
        Height and width of the photograph in pixels, before the method's own preprocessing.
    device, precision
        As for extraction.
    limit
        Seconds after which the trial is given up.
    """
    import torch

    needed, free = _weights_bytes(method, entry), available_memory()
    if needed is not None and device.type == "cpu" and 1.1 * needed + _OVERHEAD > free:
        least = 1.1 * needed + _OVERHEAD
        note = f"not timed: it needs at least {least / 1e9:.1f} GB of memory, {free / 1e9:.1f} GB are free"
        return Timing(None, None, least, None, note)
    context = reading.process_context()
    receiver, sender = context.Pipe(duplex=False)
    arguments = (sender, method, entry, image_size, str(device), precision, torch.get_num_threads())
    process = context.Process(target=_trial, args=arguments)
    with reading.main_unseen():
        process.start()
    sender.close()
    try:
        if not receiver.poll(limit):
            return Timing(None, None, None, None, f"not timed: no image within {limit:.0f} s")
        return receiver.recv()
    except EOFError:
        process.join()
        return Timing(None, None, None, None, f"not timed: the process ended ({process.exitcode}), memory may be short")
    finally:
        process.kill()
        process.join()


def record(manifest: Manifest, names: Sequence[str], device: torch.device) -> Iterator[str]:
    """Time methods on a photograph of 480 × 640 pixels and keep what was measured for Table II; yields a line for each."""
    path = record_path(manifest)
    kept = recorded(manifest)
    for name in names:
        found = time_method(name, manifest.method(name), PHOTOGRAPH, device)
        kept[name] = {"seconds": found.forward, "note": found.note, "device": str(device), "cores": os.cpu_count()}
        store.write_json(path, kept)
        took = "–" if found.forward is None else f"{found.forward:.3g} s an image"
        yield f"{manifest.method(name).title}: {took} ({found.note})"


def recorded(manifest: Manifest) -> dict[str, Any]:
    """Return what :func:`record` kept on this machine, by method."""
    path = record_path(manifest)
    return store.read_json(path) if path.exists() else {}


def record_path(manifest: Manifest) -> Path:
    """Return the file that holds the recorded times."""
    return manifest.cache / "timings.json"


def available_memory() -> float:
    """Return the bytes of memory that this process and its children may still take."""
    free = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    meminfo = Path("/proc/meminfo")
    if meminfo.exists():
        found = dict(line.split(":") for line in meminfo.read_text().splitlines())
        free = min(free, int(found["MemAvailable"].split()[0]) * 1024)
    group = Path("/sys/fs/cgroup")
    if (group / "memory.max").exists() and (limit := (group / "memory.max").read_text().strip()) != "max":
        free = min(free, int(limit) - int((group / "memory.current").read_text()))
    return float(free)


def _weights_bytes(method: str, entry: MethodEntry) -> int | None:
    """Bytes of a library model's weights, counted without allocating them; ``None`` for other models."""
    import torch

    if entry.builder is not None or entry.kind != "paper":
        return None
    with torch.device("meta"):
        model = methods.build(method)
    return sum(tensor.numel() * tensor.element_size() for tensor in model.state_dict().values())


# -- in the trial's process ---------------------------------------------------------------------------------


def _trial(
    sender: Connection, method: str, entry: MethodEntry, size: tuple[int, int], device: str, precision: str,
    threads: int,
) -> None:  # fmt: skip
    import torch

    reading.end_with_parent()
    try:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "photograph.jpg"
            photograph(*size).save(path, quality=90)
            torch.set_num_threads(1)
            images, seconds = _reading(path, entry)
            torch.set_num_threads(threads)
        sender.send(_forward(method, entry, images, torch.device(device), precision, seconds))
    except Exception as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        sender.send(Timing(None, None, None, None, f"not timed: {reason}"))


def _reading(path: Path, entry: MethodEntry) -> tuple[np.ndarray, float]:
    images, _ = reading.prepare_batch([path], entry.preprocessing)
    return images, min(_timed(lambda: reading.prepare_batch([path], entry.preprocessing)) for _ in range(5))


def _forward(
    method: str, entry: MethodEntry, images: np.ndarray, device: torch.device, precision: str, read: float
) -> Timing:
    from artifact.extraction.forward import Forward

    reader, n = _peak(), entry.batch_size
    model = methods.build(method) if entry.builder is None else methods.model_of(method, entry)
    layout = local_features.layout_of(entry)
    outputs = model.to(device) if layout is None else local_features.both_outputs(model.to(device), layout, method)
    forward = Forward(outputs, entry, device, precision)
    loaded = _peak(device)

    def seconds_of(batch: np.ndarray) -> float:
        begun = time.perf_counter()
        forward(batch)[0].cpu()
        return time.perf_counter() - begun

    seconds, note = seconds_of(images), "one image, no warm-up"
    if seconds < _SLOW_SECONDS:
        seconds, note = seconds_of(images), "one image"
    one = _peak(device)
    if n == 1 or seconds * n > _BATCH_SECONDS:
        return Timing(seconds, read, loaded + n * (one - loaded), reader, note)
    batch = np.concatenate([images] * n)
    if device.type == "cuda":
        seconds_of(batch)
    seconds = seconds_of(batch) / n
    note = f"a batch of {n}" if forward.at_once is None else f"{forward.at_once} images at once"
    return Timing(seconds, read, _peak(device), reader, note)


def photograph(height: int, width: int, seed: int = 0) -> Image.Image:
    """Make an image that is as hard to decode as a photograph: structure of several scales and sensor noise.

    Examples
    --------
    >>> photograph(480, 640).size
    (640, 480)
    """
    rng = np.random.default_rng(seed)
    pixels = np.full((height, width, 3), 40.0)
    for cell in (160, 32, 8):
        blocks = rng.uniform(0, 60, (-(-height // cell), -(-width // cell), 3))
        pixels += blocks.repeat(cell, axis=0).repeat(cell, axis=1)[:height, :width]
    pixels += rng.normal(0, 4, (height, width, 1))
    return Image.fromarray(pixels.clip(0, 255).astype(np.uint8))


def _timed(function: Callable[[], object]) -> float:
    begun = time.perf_counter()
    function()
    return time.perf_counter() - begun


def _peak(device: torch.device | None = None) -> float:
    """Peak bytes: of this process, or of a CUDA device."""
    if device is not None and device.type == "cuda":
        import torch

        return float(torch.cuda.max_memory_reserved(device))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return float(peak if sys.platform == "darwin" else peak * 1024)
