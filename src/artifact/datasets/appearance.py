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
"""Mean luminance, its standard deviation, mean saturation, mean absolute Laplacian of the luminance; all from 0 to 1."""

REVISION = 2  # raise when a value changes
_SIDE = 320  # images are measured at this length of their longer side, so that sizes do not matter


def appearance_key(traversal: Traversal) -> str:
    """Return the content key of a traversal's statistics."""
    return store.key(stage="appearance", revision=REVISION, images=traversal.digest)


def has_appearance(traversal: Traversal) -> bool:
    """Whether the statistics of a traversal can be had: its images are here, or their statistics ship."""
    return traversal.has_images or shipped.appearance(appearance_key(traversal)) is not None


def appearance(traversal: Traversal, cache: Path) -> np.ndarray:
    """Measure the statistics of every image, or read them if they are stored or shipped.

    Parameters
    ----------
    traversal
        The images.
    cache
        Folder of stored results.

    Returns
    -------
    numpy.ndarray
        ``(n, 4)`` float64, columns in the order of :data:`STATISTICS`.

    Raises
    ------
    DatasetError
        If the images are not on this machine and nothing is stored or shipped.
    UnreadableImageError
        If an image cannot be read.
    """
    key = appearance_key(traversal)
    if not traversal.has_images:
        found = shipped.appearance(key)
        if found is not None:
            return found
    path = cache / "appearance" / f"{key[:24]}.npz"
    with store.lock(path):
        arrays = store.load_arrays(path, key)
        if arrays is None:
            with ThreadPoolExecutor(2) as pool:
                values = np.array(list(pool.map(measure, traversal.image_paths())))
            arrays = {"values": values}
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
