"""The form in which fitted transforms are written to a file: arrays in NumPy's format, without pickle."""

from __future__ import annotations

import os
import zipfile
from pathlib import Path

import numpy as np

from artifact import store

_FORMAT = "artifact transform 1, "


def write(path: str | os.PathLike[str], kind: str, **arrays: np.ndarray) -> None:
    """Write named arrays, whole or not at all."""
    with store.replacing(Path(path)) as temporary, temporary.open("wb") as stream:
        np.savez(stream, **{"format": np.array(_FORMAT + kind), **arrays})  # type: ignore[arg-type]  # its allow_pickle


def read(path: str | os.PathLike[str], shapes: dict[str, dict[str, str]]) -> tuple[str, dict[str, np.ndarray]]:
    """Return kind and arrays of a file, or raise ``ValueError`` if it is none of :func:`write`.

    ``shapes`` gives, by kind, the arrays and a letter for each axis; equal letters are equal lengths.
    """
    try:
        with Path(path).open("rb") as stream, np.load(stream, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
    except (ValueError, EOFError, zipfile.BadZipFile, AttributeError, TypeError) as error:
        raise _refusal(path, str(error).splitlines()[0] if str(error) else "empty") from None
    kind = str(arrays.pop("format", "")).removeprefix(_FORMAT)
    if kind not in shapes:
        raise _refusal(path, "no known format in it")
    lengths: dict[str, int] = {}
    for name, axes in shapes[kind].items():
        array = arrays.get(name)
        if (
            array is None
            or array.ndim != len(axes)
            or array.dtype.kind not in "fiuU"
            or any(lengths.setdefault(a, n) != n for a, n in zip(axes, array.shape, strict=True))
        ):
            raise _refusal(path, f"its {name!r} is missing or does not fit the others")
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            raise _refusal(path, f"its {name!r} is not finite")
    return kind, arrays


def _refusal(path: str | os.PathLike[str], found: str) -> ValueError:
    return ValueError(
        f"{os.fspath(path)}: not a saved transform ({found}); allowed: files written by LowRankMap.save or STD.save"
    )
