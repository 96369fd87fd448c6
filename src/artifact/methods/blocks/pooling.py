"""Pooling shared by the methods: L2 normalisation and the generalised mean (GeM)."""

from __future__ import annotations

import torch
from torch import nn
from torch.nn import functional

_SMALLEST = 1e-6  # activations are raised to this: a fractional power of a negative number is undefined


class L2Norm(nn.Module):
    """Scale vectors along axis 1 (channels) to unit Euclidean length; zero vectors stay zero."""

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return `x` with unit length along axis 1."""
        return functional.normalize(x, dim=1)


class GeM(nn.Module):
    """Generalised mean over the spatial positions, with a learnt exponent p (Radenović et al., TPAMI 2019).

    Per channel, mean(max(x, 1e-6) ** p) ** (1 / p): the average for p = 1, towards the maximum for large p.

    Examples
    --------
    >>> pool = GeM()
    >>> features = torch.tensor([1.0, 2.0, 3.0, 4.0]).reshape(1, 1, 2, 2)
    >>> round(pool(features).item(), 4)  # ((1 + 8 + 27 + 64) / 4) ** (1 / 3)
    2.924
    """

    def __init__(self) -> None:
        super().__init__()
        self.p = nn.Parameter(torch.full((1,), 3.0))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Pool features (b, c, h, w) to (b, c, 1, 1)."""
        powers = x.clamp(min=_SMALLEST).pow(self.p)
        return powers.mean(dim=(-2, -1), keepdim=True).pow(1 / self.p)


def unit_gem() -> nn.Sequential:
    """GeM of features whose channel vectors are first scaled to unit length: (b, c, h, w) to (b, c)."""
    return nn.Sequential(L2Norm(), GeM(), nn.Flatten())
