"""CosPlace (Berton et al., CVPR 2022) and EigenPlaces (Berton et al., ICCV 2023).

Both are a ResNet whose last feature map is scaled to unit channel vectors, pooled by a generalised mean and
projected; they differ in their training. The authors run them at the images' own resolution.
"""

from __future__ import annotations

import torch
from torch import nn

from artifact.methods.blocks.inputs import check_images
from artifact.methods.blocks.pooling import L2Norm, unit_gem
from artifact.methods.blocks.resnet import RESNET50, RESNET101, resnet_stages


class _PooledResNet(nn.Module):
    depths: tuple[int, ...]
    dimension: int

    def __init__(self) -> None:
        super().__init__()
        # The released files number the stages instead of naming them.
        self.backbone = nn.Sequential(*resnet_stages(self.depths).values())
        self.aggregation = nn.Sequential(*unit_gem(), nn.Linear(2048, self.dimension), L2Norm())

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        """Describe images (b, 3, h, w) of at least 32 × 32 pixels: unit vectors (b, dimension), float32."""
        check_images(images, self, at_least=32)
        return self.aggregation(self.backbone(images))


class CosPlace(_PooledResNet):
    """CosPlace with ResNet-101 and 1024 dimensions."""

    depths, dimension = RESNET101, 1024


class EigenPlaces(_PooledResNet):
    """EigenPlaces with ResNet-50 and 2048 dimensions."""

    depths, dimension = RESNET50, 2048
