"""MegaLoc (Berton and Masone, CVPR Workshops 2025): SALAD's aggregation and a linear projection."""

from __future__ import annotations

import torch
from torch import nn
from torch.nn import functional

from artifact.methods.blocks.dinov2 import feature_map, vit_base
from artifact.methods.blocks.inputs import PATCH, check_images
from artifact.methods.salad import CLUSTERS, OptimalTransportAggregator

_DIMENSION = 8448


def resize_to_patches(images: torch.Tensor) -> torch.Tensor:
    """Resize images (b, 3, h, w), bilinearly with antialiasing, to the nearest multiples of 14 (a half: the even one).

    Examples
    --------
    >>> resize_to_patches(torch.zeros(1, 3, 300, 400)).shape
    torch.Size([1, 3, 294, 406])
    """
    size = [round(pixels / PATCH) * PATCH for pixels in images.shape[-2:]]
    if size == list(images.shape[-2:]):
        return images
    return functional.interpolate(images, size=size, mode="bilinear", align_corners=False, antialias=True)


class MegaLoc(nn.Module):
    """MegaLoc with DINOv2 ViT-B/14, 64 clusters of 256 and a token of 256, projected to 8448 dimensions."""

    def __init__(self) -> None:
        super().__init__()
        self.backbone = vit_base(mask_token=False)
        aggregation = OptimalTransportAggregator(256)
        self.aggregator = nn.ModuleDict({"agg": aggregation, "linear": nn.Linear(aggregation.dimension, _DIMENSION)})

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        """Describe images (b, 3, h, w) of more than 64 patches (after resizing): unit vectors (b, 8448), float32."""
        check_images(images, self, more_patches_than=CLUSTERS)
        images = resize_to_patches(images)
        tokens = self.backbone(images)
        aggregated = self.aggregator["agg"](feature_map(tokens, *images.shape[-2:]), tokens[:, 0])
        return functional.normalize(self.aggregator["linear"](aggregated), dim=1)
