"""DINOv2 vision transformers (Oquab et al., TMLR 2024) for inference: ViT-B/14, ViT-L/14 and ViT-g/14.

Parameter names are Meta's, so that a released checkpoint, or that of a method built on it, loads strictly.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable
from functools import partial

import torch
from torch import nn
from torch.nn import functional

from artifact.methods.blocks.inputs import PATCH

TRAINED_GRID = 37  # patches on a side of the 518 × 518 pixel images of the last training stage
_EPSILON = 1e-6  # of the layer normalisations; PyTorch's default is ten times larger
_OFFSET = 0.1  # patches, see `interpolate_positions`

FeedForward = Callable[[int], nn.Module]  # from the width of a token


def interpolate_positions(embedding: torch.Tensor, rows: int, columns: int) -> torch.Tensor:
    """Resample position embeddings to another grid of patches, as DINOv2 does.

    Bicubic, without antialiasing, from (1, 1 + 37², c) to (1, 1 + rows · columns, c); the class token comes first. The
    step between samples is 37 / (rows + 0.1), not 37 / rows: DINOv2 adds 0.1 patches, historically against rounding
    errors, and every method built on it inherits that.

    Examples
    --------
    >>> interpolate_positions(torch.ones(1, 1 + 37 * 37, 4), 9, 12).shape
    torch.Size([1, 109, 4])
    """
    if rows == columns == TRAINED_GRID:
        return embedding
    exact = embedding.to(torch.promote_types(embedding.dtype, torch.float32))  # half precision would shift it
    grid = exact[:, 1:].reshape(1, TRAINED_GRID, TRAINED_GRID, -1).permute(0, 3, 1, 2)
    scales = ((rows + _OFFSET) / TRAINED_GRID, (columns + _OFFSET) / TRAINED_GRID)
    grid = functional.interpolate(grid, scale_factor=scales, mode="bicubic", align_corners=False)
    return torch.cat((exact[:, :1], grid.flatten(2).transpose(1, 2)), dim=1).to(embedding.dtype)


class SelfAttention(nn.Module):
    """Multi-head self-attention with one projection for queries, keys and values."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.qkv = nn.Linear(width, 3 * width)
        self.proj = nn.Linear(width, width)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Map tokens (b, n, width) to (b, n, width)."""
        queries, keys, values = self.qkv(x).unflatten(-1, (3, self.heads, -1)).permute(2, 0, 3, 1, 4)
        attended = functional.scaled_dot_product_attention(queries, keys, values)
        return self.proj(attended.transpose(1, 2).flatten(2))


def perceptron(width: int) -> nn.Module:
    """Feed-forward network of tokens (b, n, width) with exact GELU and four times the width inside."""
    hidden = 4 * width
    return nn.Sequential(OrderedDict(fc1=nn.Linear(width, hidden), gelu=nn.GELU(), fc2=nn.Linear(hidden, width)))


class GatedPerceptron(nn.Module):
    """Feed-forward network of ViT-g: SwiGLU (Shazeer 2020), w3(silu(w1 x) · w2 x), w1 and w2 in one matrix.

    The hidden width is two thirds of the usual four times, rounded up to a multiple of 8: as many parameters.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        hidden = math.ceil(4 * width * 2 // 3 / 8) * 8
        self.w12 = nn.Linear(width, 2 * hidden)
        self.w3 = nn.Linear(hidden, width)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Map tokens (b, n, width) to (b, n, width)."""
        gate, value = self.w12(x).chunk(2, dim=-1)
        return self.w3(functional.silu(gate) * value)


class LayerScale(nn.Module):
    """A learnt factor per channel at the end of a residual branch (Touvron et al., ICCV 2021)."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.gamma = nn.Parameter(torch.ones(width))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Scale the last axis of `x`."""
        return x * self.gamma


class Block(nn.Module):
    """Transformer block: attention and feed-forward branches, each normalised before and scaled after.

    A method that puts adapters into the block overrides `attention_branch` or `feed_forward_branch`.
    """

    def __init__(self, width: int, heads: int, feed_forward: FeedForward = perceptron) -> None:
        super().__init__()
        self.norm1 = nn.LayerNorm(width, eps=_EPSILON)
        self.attn = SelfAttention(width, heads)
        self.ls1 = LayerScale(width)
        self.norm2 = nn.LayerNorm(width, eps=_EPSILON)
        self.mlp = feed_forward(width)
        self.ls2 = LayerScale(width)

    def attention_branch(self, x: torch.Tensor) -> torch.Tensor:
        """Map normalised tokens (b, n, width) to what the first residual branch adds, before its scale."""
        return self.attn(x)

    def feed_forward_branch(self, x: torch.Tensor) -> torch.Tensor:
        """Map normalised tokens (b, n, width) to what the second residual branch adds, before its scale."""
        return self.mlp(x)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Map tokens (b, n, width) to (b, n, width)."""
        x = x + self.ls1(self.attention_branch(self.norm1(x)))
        return x + self.ls2(self.feed_forward_branch(self.norm2(x)))


class VisionTransformer(nn.Module):
    """DINOv2 vision transformer with patches of 14 × 14 pixels.

    `block` is `Block` or a subclass with adapters, `feed_forward` is `perceptron`, or `GatedPerceptron` for ViT-g.
    `mask_token` says whether the checkpoint holds the mask token, which only pre-training uses.
    """

    def __init__(
        self,
        width: int,
        depth: int,
        heads: int,
        *,
        block: type[Block] = Block,
        feed_forward: FeedForward = perceptron,
        mask_token: bool = True,
    ) -> None:
        super().__init__()
        self.cls_token = nn.Parameter(torch.zeros(1, 1, width))
        self.pos_embed = nn.Parameter(torch.zeros(1, 1 + TRAINED_GRID**2, width))
        if mask_token:
            self.mask_token = nn.Parameter(torch.zeros(1, width))
        self.patch_embed = nn.ModuleDict({"proj": nn.Conv2d(3, width, PATCH, stride=PATCH)})
        self.blocks = nn.ModuleList(block(width, heads, feed_forward) for _ in range(depth))
        self.norm = nn.LayerNorm(width, eps=_EPSILON)

    def encode(self, images: torch.Tensor, end: int | None = None) -> torch.Tensor:
        """Map images to the tokens (b, 1 + h / 14 · w / 14, width) behind the blocks up to `end`, not normalised."""
        rows, columns = images.shape[-2] // PATCH, images.shape[-1] // PATCH
        patches = self.patch_embed["proj"](images).flatten(2).transpose(1, 2)
        tokens = torch.cat((self.cls_token.expand(len(patches), -1, -1), patches), dim=1)
        tokens = tokens + interpolate_positions(self.pos_embed, rows, columns)
        for block in self.blocks[:end]:
            tokens = block(tokens)
        return tokens

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        """Map images (b, 3, h, w) to normalised tokens: the class token, then the patches row by row."""
        return self.norm(self.encode(images))


vit_base = partial(VisionTransformer, 768, 12, 12)
vit_large = partial(VisionTransformer, 1024, 24, 16)


def feature_map(tokens: torch.Tensor, height: int, width: int) -> torch.Tensor:
    """Lay the patches of tokens (b, 1 + n, c) out as a map (b, c, height / 14, width / 14); the size is in pixels."""
    return tokens[:, 1:].transpose(1, 2).unflatten(2, (height // PATCH, width // PATCH))
