"""Adapters: small networks beside or inside frozen transformer blocks (CricaVPR, SelaVPR, SelaVPR++).

Parameter names are those of the released checkpoints.
"""

from __future__ import annotations

import torch
from torch import nn
from torch.nn import functional


class BottleneckAdapter(nn.Module):
    """Perceptron with half the width inside (SelaVPR)."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.D_fc1 = nn.Linear(width, width // 2)
        self.D_fc2 = nn.Linear(width // 2, width)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Map tokens (b, n, width) to (b, n, width)."""
        return self.D_fc2(functional.relu(self.D_fc1(x)))


class _ConvolutionUnit(nn.Module):
    def __init__(self, channels: int, out: int, kernel: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(channels, out, kernel, padding=kernel // 2)
        self.bn = nn.BatchNorm2d(out, eps=1e-3)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return functional.relu(self.bn(self.conv(x)))


class MultiScaleAdapter(nn.Module):
    """Bottleneck with convolutions of three sizes over the patch grid (CricaVPR, SelaVPR++).

    The hidden channels come from a 1 × 1 convolution (half of them) and from 3 × 3 and 5 × 5 convolutions
    behind 1 × 1 reductions (a quarter each). They are added to their input; the class token, which has no
    place in the grid, is added to itself.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        hidden, reduced = width // 2, width // 32
        self.D_fc1 = nn.Linear(width, hidden)
        self.branch1 = _ConvolutionUnit(hidden, hidden // 2, 1)
        self.branch2 = nn.Sequential(_ConvolutionUnit(hidden, reduced, 1), _ConvolutionUnit(reduced, hidden // 4, 3))
        self.branch3 = nn.Sequential(_ConvolutionUnit(hidden, reduced, 1), _ConvolutionUnit(reduced, hidden // 4, 5))
        self.D_fc2 = nn.Linear(hidden, width)

    def forward(self, x: torch.Tensor, grid: tuple[int, int]) -> torch.Tensor:
        """Map tokens (b, 1 + rows · columns, width) to the same shape; `grid` is (rows, columns)."""
        hidden = functional.relu(self.D_fc1(x))
        token, patches = hidden[:, :1], hidden[:, 1:]
        features = patches.transpose(1, 2).unflatten(2, grid)
        mixed = torch.cat((self.branch1(features), self.branch2(features), self.branch3(features)), dim=1)
        added = torch.cat((token, mixed.flatten(2).transpose(1, 2)), dim=1)
        return self.D_fc2(hidden + added)
