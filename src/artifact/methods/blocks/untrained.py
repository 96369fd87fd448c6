"""Construction of a model without trained weights, cheaply and reproducibly."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import torch
from torch import nn


def untrained(make: Callable[..., nn.Module], seed: int = 0, **options: Any) -> nn.Module:
    """Return ``make(**options)`` for inference, in eval mode, with reproducible weights that no training has touched.

    The constructor runs on the meta device, so PyTorch's own initialisation costs nothing and the global random state
    is not used. Inside ``with torch.device("meta")`` nothing is allocated: a checkpoint then costs one copy
    (``assign=True``).

    Examples
    --------
    >>> layer = untrained(nn.Linear, in_features=3, out_features=2)
    >>> layer.training, layer.weight.requires_grad, layer.bias.tolist()
    (False, False, [0.0, 0.0])
    """
    with torch.device("meta"):
        model = make(**options)
    model.eval().requires_grad_(False)
    device = torch.get_default_device()
    if device.type != "meta":
        model.to_empty(device=device)
        generator = torch.Generator(device).manual_seed(seed)
        for name, tensor in model.state_dict().items():
            _initialise(name.rsplit(".", 1)[-1], tensor, generator)
    return model


def _initialise(name: str, tensor: torch.Tensor, generator: torch.Generator) -> None:
    if tensor.ndim >= 2:  # variance 1 / fan-in keeps activations finite in every depth used here
        bound = math.sqrt(3 / math.prod(tensor.shape[1:]))
        tensor.uniform_(-bound, bound, generator=generator)
    elif name == "p":  # the customary exponent of generalised-mean pooling
        tensor.fill_(3)
    elif name.endswith(("bias", "running_mean", "num_batches_tracked")):
        tensor.zero_()
    else:  # normalisation scales and variances, layer scales, the dustbin score
        tensor.fill_(1)
