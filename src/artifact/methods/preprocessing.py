"""From an image file to a model's input tensor, as the manifest says for each method."""

from __future__ import annotations

import numpy as np
import torch
from PIL import Image
from torch.nn import functional

from artifact.manifest.entries import Preprocessing

_PILLOW_FILTERS = {"bilinear": Image.Resampling.BILINEAR, "bicubic": Image.Resampling.BICUBIC}


def prepare(image: Image.Image, preprocessing: Preprocessing) -> torch.Tensor:
    """Resize, crop and normalise one decoded image to ``(value / 255 - mean) / std``, ``(3 or 1, h, w)`` float32."""
    size = target_size(image.height, image.width, preprocessing)
    if preprocessing.library == "pillow" and size != (image.height, image.width):
        image = image.resize(size[::-1], _PILLOW_FILTERS[preprocessing.interpolation])
    array = np.asarray(image).reshape(image.height, image.width, -1)
    tensor = torch.from_numpy(array.transpose(2, 0, 1).copy()).float().div_(255)
    if preprocessing.library == "tensor" and tuple(tensor.shape[-2:]) != size:
        how = {"mode": preprocessing.interpolation, "align_corners": False, "antialias": preprocessing.antialias}
        tensor = functional.interpolate(tensor[None], size=size, **how)[0]
    height, width = (size - size % preprocessing.crop_to_multiple_of for size in tensor.shape[-2:])
    top, left = (tensor.shape[-2] - height) // 2, (tensor.shape[-1] - width) // 2
    tensor = tensor[:, top : top + height, left : left + width]
    mean, std = (torch.tensor(v, dtype=torch.float32).view(-1, 1, 1) for v in (preprocessing.mean, preprocessing.std))
    return tensor.sub_(mean).div_(std).contiguous()


def target_size(height: int, width: int, preprocessing: Preprocessing) -> tuple[int, int]:
    """Return the height and width in pixels after resizing and before cropping.

    Examples
    --------
    >>> target_size(480, 640, Preprocessing(resize="fixed", size=[322, 322]))
    (322, 322)
    >>> target_size(960, 1280, Preprocessing(resize="native", longest_side=1024))
    (768, 1024)
    """
    if preprocessing.resize == "fixed":
        return preprocessing.size[0], preprocessing.size[1]
    longest = preprocessing.longest_side
    if longest is not None and max(height, width) > longest:
        scale = longest / max(height, width)
        return round(height * scale), round(width * scale)
    return height, width
