"""Multi-head attention and the transformer encoder layer of Vaswani et al. (NeurIPS 2017), for inference.

Parameter names are those of PyTorch's modules of the same purpose, which the released checkpoints use;
dropout and random initialisation are left out.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import nn
from torch.nn import functional

Activation = Callable[[torch.Tensor], torch.Tensor]


class MultiHeadAttention(nn.Module):
    """Attention of queries to a context, with one stacked projection of queries, keys and values."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.in_proj_weight = nn.Parameter(torch.empty(3 * width, width))
        self.in_proj_bias = nn.Parameter(torch.empty(3 * width))
        self.out_proj = nn.Linear(width, width)

    def forward(self, queries: torch.Tensor, context: torch.Tensor) -> torch.Tensor:
        """Map queries (b, m, width) and a context (b, n, width) to (b, m, width)."""
        projections = zip(self.in_proj_weight.chunk(3), self.in_proj_bias.chunk(3), strict=True)
        heads = [
            functional.linear(x, weight, bias).unflatten(-1, (self.heads, -1)).transpose(1, 2)
            for x, (weight, bias) in zip((queries, context, context), projections, strict=True)
        ]
        attended = functional.scaled_dot_product_attention(*heads)
        return self.out_proj(attended.transpose(1, 2).flatten(2))


class EncoderLayer(nn.Module):
    """Transformer encoder layer that normalises after each residual addition, with `hidden` channels inside."""

    def __init__(self, width: int, heads: int, hidden: int, activation: Activation = functional.relu) -> None:
        super().__init__()
        self.self_attn = MultiHeadAttention(width, heads)
        self.linear1 = nn.Linear(width, hidden)
        self.linear2 = nn.Linear(hidden, width)
        self.norm1 = nn.LayerNorm(width)
        self.norm2 = nn.LayerNorm(width)
        self.activation = activation

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Map tokens (b, n, width) to (b, n, width); attention runs over n."""
        x = self.norm1(x + self.self_attn(x, x))
        return self.norm2(x + self.linear2(self.activation(self.linear1(x))))
