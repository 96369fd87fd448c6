"""Decoding of image files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from PIL import Image


class UnreadableImageError(OSError):
    """An image file that cannot be decoded; the message names it."""


def read_image(path: Path, colour: str = "rgb") -> Image.Image:
    """Decode an image file wholly.

    Parameters
    ----------
    path
        Any format that Pillow reads. EXIF rotation is not applied, as in the evaluation code of the methods.
    colour
        ``"rgb"`` or ``"grey"`` (ITU-R 601 luma).

    Raises
    ------
    UnreadableImageError
        If the file is missing, not an image, truncated or otherwise damaged.
    """
    try:
        with Image.open(path) as image:
            return image.convert("RGB" if colour == "rgb" else "L")
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise UnreadableImageError(f"{path}: {error}") from None


def modes_and_sizes(paths: Sequence[Path]) -> tuple[list[str], list[tuple[int, int]]]:
    """Return Pillow's mode and the size (width, height) of image files, from their headers alone.

    Raises
    ------
    UnreadableImageError
        If a file is not an image.
    """
    modes, sizes = [], []
    for path in paths:
        try:
            with Image.open(path) as image:
                modes.append(image.mode)
                sizes.append(image.size)
        except (OSError, ValueError, SyntaxError) as error:
            raise UnreadableImageError(f"{path}: {error}") from None
    return modes, sizes
