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
from artifact.methods.blocks.untrained import untrained


class PooledResNet(nn.Module):
    """ResNet, L2 normalisation, GeM and a linear projection.

    Parameters
    ----------
    depths : tuple of int
        Number of bottlenecks in each of the four stages.
    dimension : int
        Length of the descriptor.
    """

    def __init__(self, depths: tuple[int, ...], dimension: int) -> None:
        super().__init__()
        # The released files number the stages instead of naming them.
        self.backbone = nn.Sequential(*resnet_stages(depths).values())
        self.aggregation = nn.Sequential(*unit_gem(), nn.Linear(2048, dimension), L2Norm())

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        """Describe images (b, 3, h, w) of at least 32 × 32 pixels: unit vectors (b, dimension), float32.

        Raises
        ------
        ValueError
            If shape, size, dtype or device do not fit.
        """
        check_images(images, self, at_least=32)
        return self.aggregation(self.backbone(images))


class CosPlace(PooledResNet):
    """CosPlace with ResNet-101 and 1024 dimensions."""

    def __init__(self) -> None:
        super().__init__(RESNET101, 1024)


class EigenPlaces(PooledResNet):
    """EigenPlaces with ResNet-50 and 2048 dimensions."""

    def __init__(self) -> None:
        super().__init__(RESNET50, 2048)


def cosplace() -> CosPlace:
    """Build CosPlace (ResNet-101, 1024 dimensions) without trained weights, in eval mode."""
    return untrained(CosPlace)


def eigenplaces() -> EigenPlaces:
    """Build EigenPlaces (ResNet-50, 2048 dimensions) without trained weights, in eval mode."""
    return untrained(EigenPlaces)
