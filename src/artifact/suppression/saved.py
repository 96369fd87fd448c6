"""Files of fitted transforms: plain arrays, no pickle."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np

from artifact.suppression.lowrank import LowRankMap
from artifact.suppression.std import STD

_PARTS = {"low-rank": ("left", "right", "offset"), "STD": ("conditions", "mean", "scale")}


def load_transform(path: Path) -> LowRankMap | STD:
    """Read a transform that was saved by :meth:`LowRankMap.save` or :meth:`STD.save`.

    Parameters
    ----------
    path
        An ``.npz`` file.

    Raises
    ------
    ValueError
        If the file is missing, damaged, or no saved transform.
    """
    try:
        with np.load(path, allow_pickle=False) as stored:
            kind = str(stored["kind"])
            parts = [stored[name] for name in _PARTS[kind]]
    except (OSError, ValueError, TypeError, KeyError, EOFError, zipfile.BadZipFile):
        raise ValueError(f"{path}: no saved transform; files that LowRankMap.save or STD.save wrote are read") from None
    widths = {part.shape[0 if kind == "low-rank" else 1] for part in parts if part.ndim == 2}
    if not all(np.isfinite(part).all() for part in parts if part.dtype.kind == "f") or len(widths) != 1:
        raise ValueError(f"{path}: the arrays of the transform do not fit together or are not finite")
    return LowRankMap(*parts) if kind == "low-rank" else STD.from_arrays(*parts)
