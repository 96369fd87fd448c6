"""Synthetic weights and images that any implementation can rebuild: the input side of tests/golden.

A weight is a function of its key and shape alone, an image of its size alone, so the official models (filled
with these weights where their outputs were recorded) and ours can be compared without a trained checkpoint.
tests/golden/README.md states the recipe in words.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable

import numpy as np
import torch
from torch import nn

SEED = 20240
_TOKENS = {"pos_embed", "cls_token", "mask_token", "queries"}
# Added to a projection of a unit vector: with the usual scale they would drown what depends on the image.
_WEAK_BIASES = {"aggregation.3.bias", "aggregator.linear.bias", "linear2.bias", "linear4.bias"}
# offset and factor of the standard normals, by the last part of the key
_AFFINE = {"running_mean": (0.0, 0.1), "gamma": (0.3, 0.05), "p": (3.0, 0.25), "dust_bin": (1.0, 0.25)}


def weight(key: str, shape: tuple[int, ...]) -> torch.Tensor:
    """Return the weight of a key: float32, except batch counters (int64)."""
    last = key.rpartition(".")[2]
    if last == "num_batches_tracked":
        return torch.zeros(shape, dtype=torch.int64)
    normal = _normal(np.random.default_rng(zlib.crc32(key.encode())), *shape)
    if last == "running_var":
        return normal.abs() + 0.5
    offset, factor = _AFFINE.get(last, (None, None))
    if last in _TOKENS:
        offset, factor = 0.0, 0.5
    elif last.endswith("bias"):
        offset, factor = 0.0, 0.002 if key in _WEAK_BIASES else 0.1
    elif last == "weight" and len(shape) == 1:
        offset, factor = 1.0, 0.1
    if offset is not None:
        return normal.mul_(factor).add_(offset)
    if len(shape) == 4 and shape[1] > 3:  # without a mean, deep ReLU networks forget the image
        normal -= normal.mean(dim=(1, 2, 3), keepdim=True)
    if key.endswith("score.3.weight"):  # scores far enough apart for the Sinkhorn iterations to matter
        normal *= 16
    return normal.div_(math.sqrt(math.prod(shape[1:])))


def images(height: int, width: int, seed: int = SEED) -> torch.Tensor:
    """Return two "normalised" images (2, 3, height, width): the sum of a cast, a smooth field and noise."""
    generator = np.random.default_rng(seed)
    cast, coarse = _normal(generator, 2, 3, 1, 1), _normal(generator, 2, 3, 8, 8)
    noise = _normal(generator, 2, 3, height, width)
    field = nn.functional.interpolate(coarse, size=(height, width), mode="bicubic", align_corners=False)
    return 0.8 * cast + 0.8 * field + 0.1 * noise


def filled(build: Callable[[], nn.Module], unused: Callable[[str], bool] = lambda _: False) -> nn.Module:
    """Build a model on the meta device and load the synthetic weights strictly, one copy of them in memory.

    Weights that the descriptor must not depend on (`unused`) are not a number, and take no memory.
    """
    with torch.device("meta"):
        model = build()
    state = {
        key: torch.tensor(math.nan).expand(tensor.shape) if unused(key) else weight(key, tuple(tensor.shape))
        for key, tensor in model.state_dict().items()
    }
    model.load_state_dict(state, strict=True, assign=True)
    return model


def _normal(generator: np.random.Generator, *shape: int) -> torch.Tensor:
    return torch.from_numpy(np.asarray(generator.standard_normal(shape, dtype=np.float32)))
