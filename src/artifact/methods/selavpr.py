"""SelaVPR (Lu et al., ICLR 2024): global descriptors for retrieval, dense local features for re-ranking."""

from __future__ import annotations

from collections import OrderedDict

import torch
from torch import nn
from torch.nn import functional

from artifact.methods.blocks.adapters import bottleneck_adapter
from artifact.methods.blocks.dinov2 import Block, FeedForward, feature_map, vit_large
from artifact.methods.blocks.inputs import check_images
from artifact.methods.blocks.pooling import unit_gem

_SIDE = 224  # pixels: the authors lay the patches out on 16 × 16 whatever the image
_ADAPTER_SCALE = 0.2


class _AdaptedBlock(Block):
    def __init__(self, width: int, heads: int, feed_forward: FeedForward) -> None:
        super().__init__(width, heads, feed_forward)
        self.adapter1 = bottleneck_adapter(width)
        self.adapter2 = bottleneck_adapter(width)

    def attention_branch(self, x: torch.Tensor) -> torch.Tensor:
        attended = self.attn(x)
        return attended + self.adapter1(attended)

    def feed_forward_branch(self, x: torch.Tensor) -> torch.Tensor:
        return self.mlp(x) + _ADAPTER_SCALE * self.adapter2(x)


class SelaVPR(nn.Module):
    """SelaVPR with DINOv2 ViT-L/14: 1024 dimensions, and 61 × 61 local features of 128 dimensions."""

    def __init__(self) -> None:
        super().__init__()
        self.backbone = vit_large(block=_AdaptedBlock)
        self.aggregation = unit_gem()
        first = nn.ConvTranspose2d(1024, 256, 3, stride=2, padding=1)
        second = nn.ConvTranspose2d(256, 128, 3, stride=2, padding=1)  # from 16 × 16 patches to 61 × 61
        self.LocalAdapt = nn.Sequential(OrderedDict(upconv1=first, relu=nn.ReLU(), upconv2=second))

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        """Describe images (b, 3, 224, 224): unit vectors (b, 1024), float32."""
        return self._describe(self._features(images))

    def global_and_local(self, images: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return what `forward` does, and unit local features (b, 61, 61, 128): 1.9 MB per image in float32."""
        features = self._features(images)
        local = functional.normalize(self.LocalAdapt(features).permute(0, 2, 3, 1), dim=3)
        return self._describe(features), local

    def _features(self, images: torch.Tensor) -> torch.Tensor:
        height, width = check_images(images, self, exact=_SIDE)
        return feature_map(self.backbone(images), height, width)

    def _describe(self, features: torch.Tensor) -> torch.Tensor:
        return functional.normalize(self.aggregation(features), dim=1)
