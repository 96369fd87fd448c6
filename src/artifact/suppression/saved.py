"""The form in which fitted transforms are written to a file: arrays in NumPy's format, without pickle."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from artifact import store

FORMAT = "artifact transform 1, "


def write(path: str | os.PathLike[str], kind: str, **arrays: np.ndarray) -> None:
    """Write named arrays, whole or not at all."""
    with store.replacing(Path(path)) as temporary, temporary.open("wb") as stream:
        np.savez(stream, **{"format": np.array(FORMAT + kind), **arrays})  # type: ignore[arg-type]  # its allow_pickle
