"""Histograms of oriented gradients (Dalal and Triggs 2005) as a global descriptor."""

from __future__ import annotations

import math

import torch
from torch import nn
from torch.nn import functional

_CLIP = 0.2


class HOG(nn.Module):
    """Histograms of unsigned gradient orientation in cells, normalised in overlapping blocks of 2 by 2 cells.

    Images ``(b, 1, h, w)`` to descriptors ``(b, (h / cell - 1) * (w / cell - 1) * 4 * orientations)``, float32. Each
    pixel's gradient magnitude is shared between the two nearest of ``orientations`` bins over 180 degrees; blocks of
    cells of ``cell`` pixels are normalised by the L2-Hys rule (unit length, clip at 0.2, unit length).
    """

    def __init__(self, cell: int = 16, orientations: int = 9) -> None:
        super().__init__()
        self.cell, self.orientations = cell, orientations

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        """Return unit-length descriptors."""
        _, channels, height, width = images.shape
        if channels != 1 or height % self.cell or width % self.cell or min(height, width) < 2 * self.cell:
            raise ValueError(
                f"images have shape {tuple(images.shape)}; allowed: one grey channel and sides that are "
                f"multiples of {self.cell}, at least {2 * self.cell}"
            )
        cells = functional.avg_pool2d(self._orientation_maps(images), self.cell)
        blocks = torch.cat([cells[:, :, :-1, :-1], cells[:, :, :-1, 1:], cells[:, :, 1:, :-1], cells[:, :, 1:, 1:]], 1)
        blocks = functional.normalize(blocks, dim=1, eps=1e-6).clamp(max=_CLIP)
        blocks = functional.normalize(blocks, dim=1, eps=1e-6)
        return functional.normalize(blocks.flatten(1), dim=-1)

    def _orientation_maps(self, images: torch.Tensor) -> torch.Tensor:
        """Gradient magnitude split over orientation bins, ``(b, orientations, h, w)``."""
        padded = functional.pad(images, (1, 1, 1, 1), mode="replicate")
        dx = padded[:, :, 1:-1, 2:] - padded[:, :, 1:-1, :-2]
        dy = padded[:, :, 2:, 1:-1] - padded[:, :, :-2, 1:-1]
        magnitude = torch.sqrt(dx * dx + dy * dy)
        position = torch.remainder(torch.atan2(dy, dx), math.pi) * (self.orientations / math.pi)
        lower = position.floor()
        share = position - lower
        lower = lower.long() % self.orientations
        maps = images.new_zeros(images.shape[0], self.orientations, *images.shape[-2:])
        maps.scatter_add_(1, lower, magnitude * (1 - share))
        return maps.scatter_add_(1, (lower + 1) % self.orientations, magnitude * share)
