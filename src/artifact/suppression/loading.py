"""Fitted transforms from files."""

from __future__ import annotations

import os

from artifact.suppression import saved
from artifact.suppression.lowrank import LowRankMap
from artifact.suppression.std import STD

_SHAPES = {
    "low-rank map": {"left": "dk", "right": "dk", "offset": "k"},
    "std": {"conditions": "c", "mean": "cd", "scale": "cd"},
}


def load_transform(path: str | os.PathLike[str]) -> LowRankMap | STD:
    """Read a transform that ``LowRankMap.save`` or ``STD.save`` wrote; nothing in the file is run.

    Raises
    ------
    OSError
        If the file cannot be opened.
    ValueError
        If it is anything else than a saved transform.
    """
    kind, arrays = saved.read(path, _SHAPES)
    if kind == "low-rank map":
        return LowRankMap(**arrays)
    loaded = STD()
    loaded.conditions_, loaded.mean_, loaded.scale_ = arrays["conditions"], arrays["mean"], arrays["scale"]
    return loaded
