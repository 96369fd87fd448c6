"""MixVPR (Ali-bey et al., WACV 2023): a ResNet-50 cropped after its third stage, and feature mixing.

Written from the paper. Each of the 1024 feature maps of 20 × 20 positions is flattened to a vector of 400,
mixed by four residual two-layer perceptrons that all maps share, and reduced by two linear maps, over
channels and over positions.
"""

from __future__ import annotations

import torch
from torch import nn
from torch.nn import functional

from artifact.methods.blocks.inputs import check_images
from artifact.methods.blocks.resnet import RESNET50, resnet_stages

_SIDE = 320  # pixels: the perceptrons are trained for (320 / 16)² = 400 positions
_POSITIONS = 400
_CHANNELS = 1024
_ROWS = 4


class _FeatureMixer(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        first, second = nn.Linear(_POSITIONS, _POSITIONS), nn.Linear(_POSITIONS, _POSITIONS)
        self.mix = nn.Sequential(nn.LayerNorm(_POSITIONS), first, nn.ReLU(), second)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return x + self.mix(x)


class MixVPR(nn.Module):
    """MixVPR with ResNet-50, 1024 channels and 4 rows: 4096 dimensions."""

    def __init__(self) -> None:
        super().__init__()
        self.backbone = nn.ModuleDict({"model": nn.Sequential(resnet_stages(RESNET50[:3]))})
        self.aggregator = nn.ModuleDict(
            {
                "mix": nn.Sequential(*(_FeatureMixer() for _ in range(4))),
                "channel_proj": nn.Linear(_CHANNELS, _CHANNELS),
                "row_proj": nn.Linear(_POSITIONS, _ROWS),
            }
        )

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        """Describe images (b, 3, 320, 320): unit vectors (b, 4096), float32."""
        check_images(images, self, exact=_SIDE)
        features = self.backbone["model"](images)  # (b, 1024, 20, 20)
        x = self.aggregator["mix"](features.flatten(2))
        x = self.aggregator["channel_proj"](x.transpose(1, 2)).transpose(1, 2)
        return functional.normalize(self.aggregator["row_proj"](x).flatten(1), dim=1)
