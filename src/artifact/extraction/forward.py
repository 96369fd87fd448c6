"""A model on one device: prepared batches to descriptors, in halves where memory is short."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import nn

from artifact.extraction import local_features
from artifact.extraction.reading import ExtractionError, Prepared
from artifact.manifest.entries import MethodEntry

Model = Callable[[torch.Tensor], torch.Tensor | tuple[torch.Tensor, ...]]

_NEARLY_UNIT = 0.02  # bfloat16 has eight bits of mantissa


def devices(text: str | torch.device | None) -> list[torch.device]:
    """Return the devices that a text names, or raise ``ExtractionError`` if one is not on this machine.

    It is one device (``"cpu"``, ``"cuda"``, ``"cuda:1"``), several with commas between, ``"all"`` (all CUDA devices), or
    ``None``: the first CUDA device. ``"all"`` and ``None`` take the CPU where there is no CUDA.

    Examples
    --------
    >>> devices("cpu,cpu")
    [device(type='cpu'), device(type='cpu')]
    """
    count = torch.cuda.device_count() if torch.cuda.is_available() else 0
    if text is None or text == "all":
        every = [torch.device("cuda", index) for index in range(count)]
        return (every if text else every[:1]) or [torch.device("cpu")]
    return [_device(name.strip(), count) for name in str(text).split(",")]


def _device(name: str, count: int) -> torch.device:
    here = ", ".join(["cpu", *(f"cuda:{index}" for index in range(count))])
    try:
        device = torch.device(name)
    except RuntimeError:
        device = None
    known = device is not None and (
        device.type == "cpu"
        or (device.type == "cuda" and (device.index or 0) < count)
        or (device.type == "mps" and torch.backends.mps.is_available())
    )
    if not known:
        raise ExtractionError(
            f"device {name!r}: not on this machine; here are {here}. Several have commas between, 'all' takes every "
            f"CUDA device, and without the option the first CUDA device or else the CPU is taken"
        )
    return device


@dataclass
class Forward:
    """Descriptors of batches by one model on one device.

    The ``model``, already on the device, turns images into descriptors, or into descriptors and another tensor with one row for
    each image. In the ``precision`` ``"float32"`` products too are computed in float32, never in TF32; ``"bfloat16"`` and
    ``"float16"`` are mixed precision by :class:`torch.autocast`. Descriptors are float32 always.

    Attributes
    ----------
    entry
        The method, or the first of several of one trunk.
    others
        The further methods of the trunk, whose descriptors follow those of the first.
    at_once
        Images that the model takes at once since memory ran out; ``None`` as long as it has not.
    seconds
        Time spent in the model, as far as whoever uses it adds it up.
    """

    model: Model
    entry: MethodEntry
    device: torch.device
    precision: str = "float32"
    others: Sequence[MethodEntry] = ()
    at_once: int | None = None
    seconds: float = 0.0

    @classmethod
    def of(cls, model: nn.Module, entry: MethodEntry, device: torch.device, precision: str, label: str) -> Forward:
        """Bring a method's model to a device, with the second output that its manifest entry asks for."""
        return cls(local_features.outputs_of(model.to(device), entry, label), entry, device, precision)

    def __call__(self, images: Prepared) -> tuple[torch.Tensor, ...]:
        """Describe one batch: ``(b, d)`` float32, and the second output if there is one, perhaps still being computed.

        Images of different sizes go one by one. Where memory runs out, the batch goes in halves, and so do all later
        ones; a warning says so once for each halving. Raises ``ExtractionError`` if memory runs out with a single image, or
        with a batch of a method whose descriptors depend on it.
        """
        if isinstance(images, np.ndarray):
            return self._described(images)
        if self.entry.batch_dependent:
            sizes = sorted({f"{image.shape[1]} × {image.shape[2]}" for image in images})
            raise ExtractionError(
                f"{self.entry.title}: the images of a batch have different sizes ({', '.join(sizes)}). Its "
                f"descriptors depend on the images that share a batch, so they cannot go singly; use 'resize: fixed'"
            )
        return _joined([self._described(image[None]) for image in images])

    def _described(self, images: np.ndarray) -> tuple[torch.Tensor, ...]:
        while True:
            size = min(self.at_once or len(images), len(images))
            try:
                return _joined([self._run(images[start : start + size]) for start in range(0, len(images), size)])
            except RuntimeError as error:
                if not _is_out_of_memory(error):
                    raise
                reason = str(error).splitlines()[0]
            # Here, not in the handler: the error holds the frames and so the tensors of the failed attempt.
            self._take_fewer(size, images.shape[2:], reason)

    def _run(self, images: np.ndarray) -> tuple[torch.Tensor, ...]:
        batch = torch.from_numpy(images)
        if self.device.type == "cuda":
            batch = batch.pin_memory()
        with torch.inference_mode(), numerics(self.device, self.precision):
            outputs = self.model(batch.to(self.device, non_blocking=True))
            outputs = outputs if isinstance(outputs, tuple) else (outputs,)
            return tuple(self._float32(output) if output.is_floating_point() else output for output in outputs)

    def _float32(self, output: torch.Tensor) -> torch.Tensor:
        """Return an output as float32; what was scaled to unit length in few digits has unit length again."""
        output = output.float()
        if self.precision == "float32":
            return output
        length = torch.linalg.vector_norm(output, dim=-1, keepdim=True)
        return torch.where((length - 1).abs() < _NEARLY_UNIT, output / length, output)

    def _take_fewer(self, size: int, image_size: Sequence[int], reason: str) -> None:
        if self.device.type == "cuda":
            torch.cuda.empty_cache()
        title, height, width = self.entry.title, *image_size
        if self.entry.batch_dependent:
            raise ExtractionError(
                f"{title}: {self.device} has too little memory for a batch of {size} images ({reason}). A smaller "
                f"batch would give other descriptors: those of {title} depend on the images that share a batch, and "
                f"the protocol says {self.entry.batch_size}. Use a device with more memory, or the CPU (--devices "
                f"cpu), or mixed precision (--precision bfloat16)"
            )
        if size == 1:
            raise ExtractionError(
                f"{title}: {self.device} has too little memory for one image of {height} × {width} pixels ({reason}). "
                f"Use a device with more memory, or the CPU (--devices cpu), or mixed precision (--precision "
                f"bfloat16), or set 'longest_side' in the method's preprocessing"
            )
        self.at_once = (size + 1) // 2
        warnings.warn(
            f"{title}: {self.device} has too little memory for {size} images at once; going on with {self.at_once}",
            RuntimeWarning,
            stacklevel=4,
        )


def _joined(parts: list[tuple[torch.Tensor, ...]]) -> tuple[torch.Tensor, ...]:
    return parts[0] if len(parts) == 1 else tuple(torch.cat(outputs) for outputs in zip(*parts, strict=True))


@contextlib.contextmanager
def numerics(device: torch.device, precision: str) -> Iterator[None]:
    """Compute in float32 or in mixed precision, by repeatable kernels, whatever the process's own settings are."""
    with contextlib.ExitStack() as stack:
        if device.type == "cuda":
            stack.callback(torch.set_float32_matmul_precision, torch.get_float32_matmul_precision())
            torch.set_float32_matmul_precision("highest")
            # PyTorch convolves float32 in TF32 (10 bits of mantissa) unless told not to.
            stack.enter_context(torch.backends.cudnn.flags(enabled=True, deterministic=True, allow_tf32=False))
        if precision != "float32":
            stack.enter_context(torch.autocast(device.type, dtype=getattr(torch, precision)))
        yield


def _is_out_of_memory(error: RuntimeError) -> bool:
    return isinstance(error, torch.OutOfMemoryError) or "DefaultCPUAllocator" in str(error)
