"""What things take on this machine: seconds and peak memory, tried in a process of its own.

The process ends after the trial, so that its peak memory is that of the trial alone, and what is too large for the
machine takes nothing else down with it. Planning, Table II and the bench all measure here.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import platform
import re
import resource
import sys
import tempfile
import timeit
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image

from artifact import methods, store
from artifact.datasets.disk import in_words
from artifact.extraction import reading
from artifact.manifest import Manifest
from artifact.manifest.entries import MethodEntry

if TYPE_CHECKING:
    import torch

    from artifact.extraction.forward import Forward

LIMIT_SECONDS = 300.0
PHOTOGRAPH = (480, 640)
"""Height and width in pixels of the photograph that stored times are for, and of images that are not there."""

_SLOW_SECONDS = 10.0  # an image that takes longer is timed once, without a warm-up
_BATCH_SECONDS = 20.0  # a whole batch is timed if it is expected to take less
_OVERHEAD = 600e6  # bytes that Python, PyTorch and a small model's activations take
_LIBRARIES = ("numpy", "scipy", "torch", "numba", "scikit-learn", "umap-learn", "pillow")


@dataclass(frozen=True)
class Timing:
    """What a trial measured; ``None`` where it could not.

    ``forward`` is in seconds of the model for an image, ``reading`` in seconds of one core to decode and prepare it. ``memory`` is
    the peak in bytes for a whole batch, of the process or on CUDA of the device; ``reader_memory`` that of a process that
    reads. ``note`` says what was timed (``"a batch of 16"``), or why nothing was.
    """

    forward: float | None
    reading: float | None
    memory: float | None
    reader_memory: float | None
    note: str = ""


def best_of(function: Callable[[], object], repeats: int = 3) -> float:
    """Return the shortest of several wall times in seconds."""
    return min(timeit.repeat(function, number=1, repeat=repeats))


def peak_memory(device: torch.device | None = None) -> float:
    """Return the peak bytes of this process, or of a CUDA device."""
    if device is not None and device.type == "cuda":
        import torch

        return float(torch.cuda.max_memory_reserved(device))
    status = Path("/proc/self/status")
    # Where there is none: what getrusage says may count the process that started this one too.
    if status.exists() and (found := re.search(r"VmHWM:\s*(\d+) kB", status.read_text())):
        return 1024.0 * int(found[1])
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return float(peak if sys.platform == "darwin" else peak * 1024)


def forget_peak() -> None:
    """Give back memory that was let go of, and let the peak of this process be what it holds now, where the system can (Linux)."""
    with contextlib.suppress(AttributeError, OSError):
        ctypes.CDLL(None).malloc_trim(0)
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


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


def reading_seconds(paths: Sequence[Path], entry: MethodEntry) -> float:
    """Return the seconds that one core takes to decode and prepare an image."""
    import torch

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        return best_of(lambda: reading.prepare_batch(paths, entry.preprocessing), 5) / len(paths)
    finally:
        torch.set_num_threads(threads)


def model_seconds(model: Forward, images: reading.Prepared, repeats: int = 1) -> float:
    """Return the shortest time of several that a model takes for a batch, until its descriptors are at hand."""

    def describe() -> None:
        model(images)[0].cpu()

    return best_of(describe, repeats)


def untrained(method: str, entry: MethodEntry, device: torch.device, precision: str = "float32") -> Forward:
    """Return a method's model, ready to describe batches: trained weights change neither time nor memory."""
    from artifact.extraction.forward import Forward

    model = methods.build(method) if entry.builder is None else methods.model_of(method, entry)
    return Forward.of(model, entry, device, precision, method)


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


def in_own_process(function: Callable[..., Any], *arguments: Any, limit: float = LIMIT_SECONDS) -> Any:
    """Return what a function gives that runs in a new process, with as many threads as here.

    Raises ``TimeoutError`` if it takes longer than the limit in seconds, and ``RuntimeError`` with the first line of the
    reason if it fails or its process is ended.
    """
    import torch

    process, receiver = reading.start_process(_run, torch.get_num_threads(), function, arguments, daemon=False)
    try:
        if not receiver.poll(limit):
            raise TimeoutError(f"nothing within {limit:.0f} s")
        reason, result = receiver.recv()
    except EOFError:
        process.join()
        raise RuntimeError(f"the process ended ({process.exitcode}), memory may be short") from None
    finally:
        process.kill()
        process.join()
    if reason:
        raise RuntimeError(reason)
    return result


def _run(sender: Connection, threads: int, function: Callable[..., Any], arguments: Sequence[Any]) -> None:
    import torch

    torch.set_num_threads(threads)
    try:
        sender.send(("", function(*arguments)))
    except Exception as error:
        sender.send((str(error).partition("\n")[0] or type(error).__name__, None))


def time_method(
    method: str,
    entry: MethodEntry,
    image_size: tuple[int, int],
    device: torch.device,
    precision: str = "float32",
    limit: float = LIMIT_SECONDS,
) -> Timing:
    """Time a method on a made-up photograph of a height and width in pixels, after a warm-up.

    The size is that before the method's own preprocessing; after the limit in seconds the trial is given up.
    """
    import torch

    if device.type == "cpu" and entry.kind == "paper" and entry.builder is None:
        with torch.device("meta"):  # counts bytes without allocating them
            state = methods.build(method).state_dict()
        least, free = 1.1 * sum(tensor.nbytes for tensor in state.values()) + _OVERHEAD, available_memory()
        if least > free:
            note = f"not timed: it needs at least {in_words(least)} of memory, {in_words(free)} are free"
            return Timing(None, None, least, None, note)
    try:
        return in_own_process(_trial, method, entry, image_size, device, precision, limit=limit)
    except TimeoutError:
        reason = f"no image within {limit:.0f} s"
    except RuntimeError as error:
        reason = str(error)
    return Timing(None, None, None, None, f"not timed: {reason}")


def _trial(
    method: str, entry: MethodEntry, image_size: tuple[int, int], device: torch.device, precision: str
) -> Timing:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "photograph.jpg"
        photograph(*image_size).save(path, quality=90)
        images, _ = reading.prepare_batch([path], entry.preprocessing)
        read = reading_seconds([path], entry)
    reader, n = peak_memory(), entry.batch_size
    model = untrained(method, entry, device, precision)
    loaded = peak_memory(device)
    seconds, note = model_seconds(model, images), "one image, no warm-up"
    if seconds < _SLOW_SECONDS:
        seconds, note = model_seconds(model, images), "one image"
    one = peak_memory(device)
    if n == 1 or seconds * n > _BATCH_SECONDS:
        return Timing(seconds, read, loaded + n * (one - loaded), reader, note)
    batch = np.concatenate([images] * n)
    seconds = model_seconds(model, batch, 2 if device.type == "cuda" else 1) / n
    note = f"a batch of {n}" if model.at_once is None else f"{model.at_once} images at once"
    return Timing(seconds, read, peak_memory(device), reader, note)


class Trials:
    """Trials on this machine, each made once; in a file, if one is given, they outlast the process."""

    def __init__(self, path: Path | None = None) -> None:
        machine = {"node": platform.node(), "processor": platform.machine(), "cores": os.cpu_count()}
        self._machine = machine | {"versions": {name: version(name) for name in _LIBRARIES}}
        self._path, self._failed = path, set[str]()
        self._kept: dict[str, Any] = store.remembered(path) if path else {}

    def __call__(self, measure: Callable[[], Any], failed: Callable[[Any], bool], **inputs: Any) -> Any:
        """Return what was measured for these inputs on this machine with these libraries, or measure it.

        A failed trial is not kept in the file: the next process tries again.
        """
        key = store.key(machine=self._machine, **inputs)
        if key not in self._kept:
            self._kept[key] = measure()
            if failed(self._kept[key]):
                self._failed.add(key)
            elif self._path is not None:
                store.write_json(self._path, {k: v for k, v in self._kept.items() if k not in self._failed})
        return self._kept[key]

    def of_method(
        self, method: str, entry: MethodEntry, image_size: tuple[int, int], device: torch.device, precision: str
    ) -> Timing:
        """Time a method once for each size of its input; see :func:`time_method`."""
        from artifact.methods.preprocessing import target_size

        measured = self(
            lambda: asdict(time_method(method, entry, image_size, device, precision)),
            lambda found: found["forward"] is None,
            model=methods.fingerprint(method, entry) | {"weights": None},
            batch_size=entry.batch_size,
            input=target_size(*image_size, entry.preprocessing),
            device=str(device),
            precision=precision,
        )
        return Timing(**measured)


def store_times(manifest: Manifest, names: Sequence[str], device: torch.device) -> Iterator[str]:
    """Time methods on a photograph of 480 × 640 pixels and keep that for Table II; yields a line for each."""
    times = stored_times(manifest)
    for name in names:
        found = time_method(name, manifest.method(name), PHOTOGRAPH, device)
        times[name] = {"seconds": found.forward, "note": found.note, "device": str(device), "cores": os.cpu_count()}
        store.write_json(_times_path(manifest), times)
        took = "–" if found.forward is None else f"{found.forward:.3g} s an image"
        yield f"{manifest.method(name).title}: {took} ({found.note})"


def stored_times(manifest: Manifest) -> dict[str, Any]:
    """Return what :func:`store_times` measured on this machine, by method."""
    return store.remembered(_times_path(manifest))


def _times_path(manifest: Manifest) -> Path:
    return manifest.cache / "timings.json"
