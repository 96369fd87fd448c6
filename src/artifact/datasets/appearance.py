"""Incidental statistics of images: what may differ between frames of one session without the place being another."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from artifact import store
from artifact.datasets import shipped
from artifact.datasets.images import read_image
from artifact.datasets.traversal import Traversal

STATISTICS = ("brightness", "contrast", "saturation", "sharpness")
"""Mean luminance, its standard deviation, mean saturation, mean absolute Laplacian of luminance; from 0 to 1."""

REVISION = 2  # raise when a value changes
_SIDE = 320  # images are measured at this length of their longer side, so that sizes do not matter


def appearance_key(traversal: Traversal) -> str:
    """Return the content key of a traversal's statistics."""
    return store.key(stage="appearance", revision=REVISION, images=traversal.digest)


def has_appearance(traversal: Traversal, cache: Path) -> bool:
    """Whether the statistics of a traversal can be had: its images are here, or the statistics are stored or ship."""
    key = appearance_key(traversal)
    return traversal.has_images or stored_path(cache, key).exists() or shipped.appearance(key) is not None


def stored_path(cache: Path, key: str) -> Path:
    """Return the file that holds, or would hold, the statistics of a key."""
    return cache / "appearance" / f"{key[:24]}.npz"


def appearance(traversal: Traversal, cache: Path) -> np.ndarray:
    """Measure :data:`STATISTICS` of every image, ``(n, 4)`` float64, or read them if they are in the cache or shipped.

    Raises ``DatasetError`` if the images are not on this machine and nothing is stored or shipped, and
    ``UnreadableImageError`` if an image cannot be read.
    """
    key = appearance_key(traversal)
    path = stored_path(cache, key)
    with store.lock(path):
        arrays = store.load_arrays(path, key)
        if arrays is None and not traversal.has_images and (found := shipped.appearance(key)) is not None:
            return found
        if arrays is None:
            with ThreadPoolExecutor(2) as pool:
                arrays = {"values": np.array(list(pool.map(measure, traversal.image_paths())))}
            store.save_arrays(path, arrays, {"key": key, "dataset": traversal.dataset, "traversal": traversal.name})
    return arrays["values"]


def measure(path: Path) -> tuple[float, float, float, float]:
    """Measure one image; the order is that of :data:`STATISTICS`."""
    image = read_image(path)
    image.thumbnail((_SIDE, _SIDE))
    colour = np.asarray(image, dtype=np.float64) / 255
    grey = colour @ [0.299, 0.587, 0.114]
    highest, lowest = colour.max(axis=2), colour.min(axis=2)
    saturation = np.divide(highest - lowest, highest, out=np.zeros_like(highest), where=highest > 0)
    centre = grey[1:-1, 1:-1]
    laplacian = grey[:-2, 1:-1] + grey[2:, 1:-1] + grey[1:-1, :-2] + grey[1:-1, 2:] - 4 * centre
    return float(grey.mean()), float(grey.std()), float(saturation.mean()), float(np.abs(laplacian).mean() / 4)
