"""Fitted transforms from files."""

from __future__ import annotations

import os
import zipfile
from pathlib import Path

import numpy as np

from artifact.suppression.lowrank import LowRankMap
from artifact.suppression.saved import FORMAT
from artifact.suppression.std import STD

# The arrays of each kind, with a letter for each axis: equal letters are equal lengths.
_SHAPES = {
    "low-rank map": {"left": "dk", "right": "dk", "offset": "k"},
    "std": {"conditions": "c", "mean": "cd", "scale": "cd"},
}


def load_transform(path: str | os.PathLike[str]) -> LowRankMap | STD:
    """Read a transform that ``LowRankMap.save`` or ``STD.save`` wrote; nothing in the file is run.

    Raises ``OSError`` if the file cannot be opened, ``ValueError`` if it is anything else than a saved transform.
    """
    try:
        with Path(path).open("rb") as stream, np.load(stream, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
    except TypeError:
        raise _refusal(path, "it holds one plain array") from None
    except (ValueError, EOFError, zipfile.BadZipFile, AttributeError) as error:
        raise _refusal(path, str(error).split("\n")[0]) from None
    kind = str(arrays.pop("format", "")).removeprefix(FORMAT)
    if kind not in _SHAPES:
        raise _refusal(path, "no known format in it")
    lengths: dict[str, int] = {}
    for name, axes in _SHAPES[kind].items():
        array = arrays.get(name)
        fits = array is not None and array.ndim == len(axes) and array.dtype.kind in "fiuU"
        if not fits or any(lengths.setdefault(a, n) != n for a, n in zip(axes, arrays[name].shape, strict=True)):
            raise _refusal(path, f"its {name!r} is missing or does not fit the others")
        if arrays[name].dtype.kind == "f" and not np.isfinite(arrays[name]).all():
            raise _refusal(path, f"its {name!r} is not finite")
    if kind == "low-rank map":
        return LowRankMap(**arrays)
    loaded = STD()
    loaded.conditions_, loaded.mean_, loaded.scale_ = arrays["conditions"], arrays["mean"], arrays["scale"]
    return loaded


def _refusal(path: str | os.PathLike[str], found: str) -> ValueError:
    return ValueError(
        f"{os.fspath(path)}: not a saved transform ({found}); allowed: files written by LowRankMap.save or STD.save"
    )
