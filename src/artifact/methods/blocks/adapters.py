"""Adapters: small networks beside or inside frozen transformer blocks (CricaVPR, SelaVPR, SelaVPR++).

Parameter names are those of the released checkpoints.
"""

from __future__ import annotations

from collections import OrderedDict

import torch
from torch import nn
from torch.nn import functional


def bottleneck_adapter(width: int) -> nn.Sequential:
    """Perceptron of tokens (b, n, width) with half the width inside (SelaVPR)."""
    half = width // 2
    return nn.Sequential(OrderedDict(D_fc1=nn.Linear(width, half), relu=nn.ReLU(), D_fc2=nn.Linear(half, width)))


def _convolution(channels: int, out: int, kernel: int) -> nn.Sequential:
    conv = nn.Conv2d(channels, out, kernel, padding=kernel // 2)
    return nn.Sequential(OrderedDict(conv=conv, bn=nn.BatchNorm2d(out, eps=1e-3), relu=nn.ReLU()))


class MultiScaleAdapter(nn.Module):
    """Bottleneck with convolutions of three sizes over the patch grid (CricaVPR, SelaVPR++).

    The hidden channels come from a 1 × 1 convolution (half of them) and from 3 × 3 and 5 × 5 convolutions behind 1 × 1
    reductions (a quarter each). They are added to their input; the class token, with no place in the grid, to itself.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        hidden, reduced = width // 2, width // 32
        self.D_fc1 = nn.Linear(width, hidden)
        self.branch1 = _convolution(hidden, hidden // 2, 1)
        self.branch2 = nn.Sequential(_convolution(hidden, reduced, 1), _convolution(reduced, hidden // 4, 3))
        self.branch3 = nn.Sequential(_convolution(hidden, reduced, 1), _convolution(reduced, hidden // 4, 5))
        self.D_fc2 = nn.Linear(hidden, width)

    def forward(self, x: torch.Tensor, grid: tuple[int, int]) -> torch.Tensor:
        """Map tokens (b, 1 + rows · columns, width) to the same shape; `grid` is (rows, columns)."""
        hidden = functional.relu(self.D_fc1(x))
        token, patches = hidden[:, :1], hidden[:, 1:]
        features = patches.transpose(1, 2).unflatten(2, grid)
        mixed = torch.cat((self.branch1(features), self.branch2(features), self.branch3(features)), dim=1)
        added = torch.cat((token, mixed.flatten(2).transpose(1, 2)), dim=1)
        return self.D_fc2(hidden + added)
