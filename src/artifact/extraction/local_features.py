"""What a two-stage model gives besides descriptors: local features (SelaVPR) or hash codes (SelaVPR++).

They come from the same pass as the descriptors and stay in parts (:mod:`artifact.extraction.parts`), which are read by
mapping them into memory.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from artifact.extraction.parts import Parts
from artifact.manifest.entries import ManifestError, MethodEntry

if TYPE_CHECKING:
    import torch

REVISION = 1  # raise when the same model and images would give other local features or codes

_UNIT_TOLERANCE = 1e-2  # mixed precision may have computed them


@dataclass(frozen=True)
class Layout:
    """Shape and type of what is stored for one image.

    Local features are ``(rows, columns, c)`` float32 or float16, and ``bits`` is 0. Hash codes of that many bits are packed
    eight to a byte, ``(bytes,)`` uint8.
    """

    shape: tuple[int, ...]
    dtype: str
    bits: int = 0

    @property
    def image_bytes(self) -> int:
        """Bytes of one image."""
        return math.prod(self.shape) * np.dtype(self.dtype).itemsize


def layout_of(entry: MethodEntry) -> Layout | None:
    """Return what a method's manifest entry says is stored besides descriptors; ``None`` for one-stage methods."""
    if entry.local_features is not None:
        return Layout(tuple(entry.local_features.shape), entry.local_features.dtype)
    if entry.code_bits is not None:
        return Layout((-(-entry.code_bits // 8),), "uint8", entry.code_bits)
    return None


def outputs_of(model: torch.nn.Module, entry: MethodEntry, label: str) -> Callable[[torch.Tensor], Any]:
    """Return what gives the descriptors of images, and the second output that the entry asks for.

    That is the model itself, or its method ``global_and_local(images)`` for local features or
    ``descriptors_and_codes(images)`` for hash codes, which are +1 and -1. Raises ``ManifestError`` if it has none.
    """
    if entry.local_features is None and entry.code_bits is None:
        return model
    key, name = ("code_bits", "descriptors_and_codes") if entry.code_bits else ("local_features", "global_and_local")
    both = getattr(model, name, None)
    if both is None:
        raise ManifestError(f"{label}: the manifest entry has the key {key!r}, but the model has no {name}(images)")
    return both


def stored_form(values: np.ndarray, layout: Layout) -> np.ndarray:
    """Return the second output of a batch as it is stored.

    Raises ``ManifestError`` if the shape is not the manifest's, or local features are not finite and of unit length.
    """
    expected = (layout.bits,) if layout.bits else layout.shape
    if values.shape[1:] != expected:
        raise ManifestError(
            f"the model gives {'codes' if layout.bits else 'local features'} of the shape {values.shape[1:]} each, "
            f"the manifest says {expected}"
        )
    if layout.bits:
        return np.packbits(values > 0, axis=1)
    lengths = np.linalg.norm(values, axis=-1)
    if not (np.abs(lengths - 1) < _UNIT_TOLERANCE).all():
        raise ManifestError(
            f"local features must be finite and of length 1 along the last axis; found lengths from "
            f"{lengths.min():.4g} to {lengths.max():.4g}: the model should end with torch.nn.functional.normalize"
        )
    return values.astype(layout.dtype, copy=False)


@dataclass(frozen=True)
class SecondOutput:
    """A traversal's local features or codes, read from disk by indexing with an array of image indices.

    ``parts`` says where they are; ``make`` makes those that are missing or damaged.
    """

    parts: Parts
    make: Callable[[], object] = field(repr=False)
    _opened: dict[int, np.ndarray] = field(default_factory=dict, repr=False)

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of images, then the shape per image."""
        return (len(self), *self.parts.shape)

    @property
    def dtype(self) -> np.dtype:
        """Type of the values."""
        return np.dtype(self.parts.dtype)

    def __len__(self) -> int:
        return self.parts.n

    def __getitem__(self, images: np.ndarray) -> np.ndarray:
        images = np.asarray(images)
        out = np.empty((len(images), *self.parts.shape), self.dtype)
        numbers = images // self.parts.rows_each
        for number in np.unique(numbers).tolist():
            if number not in self._opened:
                self._opened[number] = self.parts.read(number, self.make)
            here = np.flatnonzero(numbers == number)
            out[here] = self._opened[number][images[here] - number * self.parts.rows_each]
        return out
