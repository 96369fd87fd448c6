"""Decoding of image files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import ExifTags, Image, ImageOps

_RANGE_OF_12_BITS = 4096
_ON_THEIR_SIDE = (5, 6, 7, 8)  # EXIF orientations
_SMALLEST_MOSAIC = 64  # pixels; smaller pictures are no camera's
_MOSAIC = 0.05  # of the mean brightness, between the four places of the pattern


class UnreadableImageError(OSError):
    """An image file that cannot be decoded; the message names it."""


def read_image(path: Path, colour: str = "rgb") -> Image.Image:
    """Decode an image file wholly, upright and in 8 bits.

    ``path`` is in any format that Pillow reads, ``colour`` is ``"rgb"`` or ``"grey"`` (ITU-R 601 luma). A photograph
    that its camera marked as rotated (EXIF) is turned upright. What is transparent lies on white. 16-bit values are
    divided by 257.

    Raises ``UnreadableImageError`` if the file is missing, not an image, truncated or otherwise damaged; or if its values have
    no defined range (32-bit, float, 12 bits in 16), or are a raw colour mosaic.
    """
    try:
        with Image.open(path) as image:
            _require_range(path, image)
            upright = ImageOps.exif_transpose(image)
            return _in_8_bits(path, upright).convert("RGB" if colour == "rgb" else "L")
    except UnreadableImageError:
        raise
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise UnreadableImageError(f"{path}: {error}") from None


def evenly_spaced(n: int, most: int) -> np.ndarray:
    """Return the positions of at most ``most`` of ``n`` images, as far apart as they can be.

    Examples
    --------
    >>> evenly_spaced(9, 3), evenly_spaced(2, 3)
    (array([0, 4, 8]), array([0, 1]))
    """
    return np.linspace(0, n - 1, min(most, n)).astype(int)


def _require_range(path: Path, image: Image.Image) -> None:
    """Colour of 16 bits, which Pillow cuts to the upper 8, must use them."""
    deep = any(";16" in str(tile.args) for tile in image.tile) and image.mode.startswith("RGB")
    if deep and max(high for _, high in image.getextrema()) < _RANGE_OF_12_BITS // 256:
        raise UnreadableImageError(f"{path}: 16-bit colours as of a 12-bit camera; scale them to 8 or 16 bits first")


def _in_8_bits(path: Path, image: Image.Image) -> Image.Image:
    """The image in a mode that converts to RGB or grey without a hidden choice."""
    if image.mode in ("RGBA", "LA", "PA") or "transparency" in image.info:
        over = image.convert("RGBA")
        return Image.alpha_composite(Image.new("RGBA", over.size, "white"), over)
    if image.mode.startswith("I;16"):
        values = np.asarray(image).astype(np.uint16)  # in this machine's byte order
        if values.max() < _RANGE_OF_12_BITS:
            found = f"16-bit values up to {values.max()}, as of a 12-bit camera"
            raise UnreadableImageError(f"{path}: {found}; scale them to 8 or 16 bits first")
        return Image.fromarray((values / 257).round().astype(np.uint8))
    if image.mode in ("I", "F"):
        found = f"values of mode {image.mode!r} have no defined range"
        raise UnreadableImageError(f"{path}: {found}; convert to 8 or 16 bits")
    if image.mode == "L" and _is_mosaic(np.asarray(image)):
        raise UnreadableImageError(f"{path}: looks like a raw colour mosaic (Bayer pattern); demosaic it first")
    return image


def _is_mosaic(values: np.ndarray) -> bool:
    """Whether every second pixel is clearly brighter or darker, which no photograph in grey is."""
    if min(values.shape) < _SMALLEST_MOSAIC:
        return False
    h, w = (side - side % 2 for side in values.shape)
    means = values[:h, :w].reshape(h // 2, 2, w // 2, 2).mean(axis=(0, 2))
    return bool(means.max() - means.min() > _MOSAIC * max(1.0, float(means.mean())))


def modes_and_sizes(paths: Sequence[Path]) -> tuple[list[str], list[tuple[int, int]]]:
    """Return Pillow's mode and the upright size (width, height) of image files, from their headers alone.

    Raises :class:`UnreadableImageError` if a file is not an image.
    """
    modes, sizes = [], []
    for path in paths:
        try:
            with Image.open(path) as image:
                modes.append(image.mode)
                turned = image.getexif().get(ExifTags.Base.Orientation) in _ON_THEIR_SIDE
                sizes.append(image.size[::-1] if turned else image.size)
        except (OSError, ValueError, SyntaxError) as error:
            raise UnreadableImageError(f"{path}: {error}") from None
    return modes, sizes
