"""Patch-normalised thumbnail: the descriptor of SeqSLAM (Milford and Wyeth 2012)."""

from __future__ import annotations

import torch
from torch import nn
from torch.nn import functional


class Thumbnail(nn.Module):
    """Normalise every patch of a small grey image to mean 0 and standard deviation 1; flatten; unit length.

    Images ``(b, 1, h, w)`` to descriptors ``(b, h * w)``, float32. A patch without contrast becomes zeros. Patch
    normalisation takes out local brightness and contrast, so it is itself a simple, fixed form of condition
    suppression; it keeps the exact layout of edges, so it fails when the viewpoint moves.
    """

    def __init__(self, patch: int = 8) -> None:
        super().__init__()
        self.patch = patch

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        """Return unit-length descriptors ``(b, h * w)``."""
        batch, channels, height, width = images.shape
        if channels != 1 or height % self.patch or width % self.patch:
            raise ValueError(
                f"images have shape {tuple(images.shape)}; allowed: one grey channel and sides that are "
                f"multiples of {self.patch}"
            )
        patches = functional.unfold(images, self.patch, stride=self.patch)
        deviation, mean = torch.std_mean(patches, dim=1, keepdim=True, correction=0)
        flat = deviation < 1e-4
        normalised = torch.where(flat, 0.0, (patches - mean) / deviation.masked_fill(flat, 1.0))
        return functional.normalize(normalised.reshape(batch, -1), dim=-1)
