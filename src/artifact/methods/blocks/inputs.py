"""Checks of a batch of images at the boundary of a descriptor model."""

from __future__ import annotations

import torch
from torch import nn

PATCH = 14  # pixels on a side: every vision transformer here is a ViT-*/14


def check_images(
    images: torch.Tensor,
    model: nn.Module,
    *,
    exact: int | None = None,
    multiple: int = 1,
    at_least: int = 0,
    square: bool = False,
    more_patches_than: int = 0,
) -> tuple[int, int]:
    """Check that a model can describe images (b, 3, height, width), and return height and width.

    The rules are in pixels, but for the number of 14 × 14 pixel patches (after rounding to whole ones), a lower bound.
    Shape, dtype and device must be the model's; a broken rule is a ``ValueError`` that says what to do.
    """
    name = type(model).__name__
    _check_tensor(images, next(model.parameters()), name)
    height, width = images.shape[-2:]
    smallest = min(height, width)
    if exact is not None and (height, width) != (exact, exact):
        rule, remedy = f"exactly {exact} × {exact} pixels", f"Resize them to {exact} × {exact}."
    elif smallest < at_least:
        rule, remedy = f"at least {at_least} pixels on each side", "Resize them, or leave out broken images."
    elif square and height != width:
        rule = "square images" + (f" with a side that is a multiple of {multiple}" if multiple > 1 else "")
        remedy = "Resize them to a square, for example 322 × 322."
    elif multiple > 1 and (height % multiple or width % multiple or smallest == 0):
        rule = f"a height and a width that are positive multiples of {multiple} pixels"
        nearest = (max(1, round(size / multiple)) * multiple for size in (height, width))
        remedy = f"Resize them, for example to {' × '.join(map(str, nearest))}."
    elif round(height / PATCH) * round(width / PATCH) <= more_patches_than:
        rule = f"more than {more_patches_than} patches of {PATCH} × {PATCH} pixels, such as 126 × 126 pixels"
        remedy = "Resize them to a larger size, for example 322 × 322."
    else:
        return height, width
    raise ValueError(f"{name} takes images of {rule}; found height {height}, width {width}. {remedy}")


def _check_tensor(images: torch.Tensor, weight: torch.Tensor, name: str) -> None:
    if not isinstance(images, torch.Tensor):
        raise ValueError(
            f"{name} takes a torch.Tensor of images; found {type(images).__name__}. Stack the images with torch.stack."
        )
    if images.ndim != 4 or images.shape[1] != 3 or len(images) == 0:
        raise ValueError(
            f"{name} takes images of shape (b, 3, height, width), b at least 1; found {tuple(images.shape)}. "
            "Give RGB images, channels first, with a leading batch axis."
        )
    if weight.device.type == "meta" and images.device.type != "meta":
        raise ValueError(f"{name} holds no weights (it is on the meta device). Load a checkpoint first.")
    if images.dtype != weight.dtype or images.device != weight.device:
        raise ValueError(
            f"{name} has weights of type {weight.dtype} on {weight.device}; found images of type "
            f"{images.dtype} on {images.device}. Normalise the images (ImageNet mean and standard deviation) "
            f"and call images.to({str(weight.device)!r}, {weight.dtype})."
        )
