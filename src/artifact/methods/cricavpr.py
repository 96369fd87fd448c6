"""CricaVPR (Lu et al., CVPR 2024): regional features that attend to each other across the images of a batch.

A descriptor depends on the other images of its batch (not on their order). The authors use batches of 16
images in the order of their file names; evaluate it that way.
"""

from __future__ import annotations

from itertools import pairwise, product

import torch
from torch import nn
from torch.nn import functional

from artifact.methods.blocks.adapters import MultiScaleAdapter
from artifact.methods.blocks.attention import EncoderLayer
from artifact.methods.blocks.dinov2 import Block, FeedForward, feature_map, vit_base
from artifact.methods.blocks.inputs import PATCH, check_images
from artifact.methods.blocks.pooling import unit_gem

_SIDE = 224  # pixels: the regions are fixed on a grid of 16 × 16 patches
_GRID = (_SIDE // PATCH, _SIDE // PATCH)
_ADAPTER_SCALE = 0.2
_EDGES = ((0, 8, 16), (0, 5, 11, 16))  # patches at which two and three bands begin and end, on both axes


class _AdaptedBlock(Block):
    def __init__(self, width: int, heads: int, feed_forward: FeedForward) -> None:
        super().__init__(width, heads, feed_forward)
        self.adapter = MultiScaleAdapter(width)

    def feed_forward_branch(self, x: torch.Tensor) -> torch.Tensor:
        return self.mlp(x) + _ADAPTER_SCALE * self.adapter(x, _GRID)


class CricaVPR(nn.Module):
    """CricaVPR with DINOv2 ViT-B/14: class token, 2 × 2 and 3 × 3 regions, 14 · 768 = 10752 dimensions."""

    def __init__(self) -> None:
        super().__init__()
        self.backbone = vit_base(block=_AdaptedBlock)
        self.aggregation = unit_gem()
        layers = nn.ModuleList(EncoderLayer(768, 16, 2048, functional.gelu) for _ in range(2))
        self.encoder = nn.ModuleDict({"layers": layers})

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        """Describe one batch of images (b, 3, 224, 224), jointly: unit vectors (b, 10752), float32."""
        check_images(images, self, exact=_SIDE)
        tokens = self.backbone(images)
        features = feature_map(tokens, _SIDE, _SIDE)
        regions = [tokens[:, 0]]
        for edges in _EDGES:
            bands = list(pairwise(edges))
            for (top, bottom), (left, right) in product(bands, bands):
                regions.append(self.aggregation(features[:, :, top:bottom, left:right]))
        x = torch.stack(regions)  # (14, b, 768): attention runs over the batch, for each region by itself
        for layer in self.encoder["layers"]:
            x = layer(x)
        return functional.normalize(x.transpose(0, 1).flatten(1), dim=1)
