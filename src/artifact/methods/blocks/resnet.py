"""ResNet-50 and ResNet-101 trunks (He et al., CVPR 2016), strides in the 3 × 3 convolutions."""

from __future__ import annotations

from collections import OrderedDict

import torch
from torch import nn
from torch.nn import functional

RESNET50 = (3, 4, 6, 3)
RESNET101 = (3, 4, 23, 3)


class Bottleneck(nn.Module):
    """Residual block: 1 × 1, 3 × 3 and 1 × 1 convolutions, the last with four times the channels."""

    def __init__(self, channels: int, hidden: int, stride: int) -> None:
        super().__init__()
        out = 4 * hidden
        self.conv1 = nn.Conv2d(channels, hidden, 1, bias=False)
        self.bn1 = nn.BatchNorm2d(hidden)
        self.conv2 = nn.Conv2d(hidden, hidden, 3, stride=stride, padding=1, bias=False)
        self.bn2 = nn.BatchNorm2d(hidden)
        self.conv3 = nn.Conv2d(hidden, out, 1, bias=False)
        self.bn3 = nn.BatchNorm2d(out)
        projection = nn.Sequential(nn.Conv2d(channels, out, 1, stride=stride, bias=False), nn.BatchNorm2d(out))
        self.downsample = projection if stride != 1 or channels != out else nn.Identity()

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Map features (b, channels, h, w) to (b, 4 · hidden, ⌈h / stride⌉, ⌈w / stride⌉)."""
        y = functional.relu(self.bn1(self.conv1(x)))
        y = functional.relu(self.bn2(self.conv2(y)))
        return functional.relu(self.bn3(self.conv3(y)) + self.downsample(x))


def resnet_stages(depths: tuple[int, ...]) -> OrderedDict[str, nn.Module]:
    """Return the stem and the stages of a ResNet in order: ``conv1, bn1, relu, maxpool, layer1, ...``.

    Fewer than four depths crop the network. After stage i the map has 128 · 2ⁱ channels and a stride of 2 · 2ⁱ pixels.
    """
    stages: OrderedDict[str, nn.Module] = OrderedDict(
        conv1=nn.Conv2d(3, 64, 7, stride=2, padding=3, bias=False),
        bn1=nn.BatchNorm2d(64),
        relu=nn.ReLU(),
        maxpool=nn.MaxPool2d(3, stride=2, padding=1),
    )
    channels = 64
    for stage, depth in enumerate(depths):
        hidden = 64 * 2**stage
        blocks = [Bottleneck(channels, hidden, stride=1 if stage == 0 else 2)]
        channels = 4 * hidden
        blocks += [Bottleneck(channels, hidden, stride=1) for _ in range(depth - 1)]
        stages[f"layer{stage + 1}"] = nn.Sequential(*blocks)
    return stages
