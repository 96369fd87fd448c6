"""Compilation of the renderer's inner loops, and the records that they read."""

import contextlib
import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
from numba import njit

# Reassociation and reciprocals are allowed, the absence of NaN and infinity is not assumed.
_FAST = {"contract", "arcp", "nsz", "afn", "reassoc"}


def kernel(function: Callable) -> Callable:
    """Compile a numerical function at its first call, without the interpreter lock; keep the machine code on disk.

    The compiler's disk cache notices a change of the function's own file only, not of the files it calls. Cached code
    is therefore dropped whenever any source file of this package has changed.
    """
    options = {"nogil": True, "error_model": "numpy", "fastmath": _FAST}
    try:
        compiled = njit(cache=True, **options)(function)
    except RuntimeError:  # no folder on this machine can hold the cache
        return njit(**options)(function)
    drop_stale(compiled.stats.cache_path)
    return compiled


@cache
def drop_stale(folder: str) -> None:
    """Delete the compiled code in a folder unless it was compiled from the sources as they are now."""
    sources = b"".join(source.read_bytes() for source in sorted(Path(__file__).parent.glob("*.py")))
    digest, stamp = hashlib.sha256(sources).hexdigest(), Path(folder) / "artifact-city.sha256"
    with contextlib.suppress(OSError):
        if not stamp.exists() or stamp.read_text() != digest:
            for code in [*Path(folder).glob("*.nbi"), *Path(folder).glob("*.nbc")]:
                code.unlink(missing_ok=True)
            stamp.write_text(digest)


def layout(fields: str, real: str = "f8", whole: str = "i8") -> np.dtype:
    """Describe a record by the names of its fields: a real number each, ``:i`` a whole one, ``:4x2`` an array of reals.

    >>> layout("height wall:3 kind:i")["wall"].shape
    (3,)
    """
    spec: list[tuple] = []
    for field in fields.split():
        name, _, form = field.partition(":")
        array = (tuple(map(int, form.split("x"))),) if form and form != "i" else ()
        spec.append((name, whole if form == "i" else real, *array))
    return np.dtype(spec, align=True)


def records(dtype: np.dtype, columns: dict[str, object]) -> np.ndarray:
    """Make an array of records from one sequence per field.

    >>> made = records(layout("x wall:3"), {"x": [1, 2], "wall": [(0, 0, 0), (1, 1, 1)]})
    >>> made["wall"][1].tolist()
    [1.0, 1.0, 1.0]
    """
    if set(columns) != set(dtype.names):
        raise ValueError(f"fields {sorted(columns)} given for a record of {sorted(dtype.names)}")
    made = np.zeros(len(next(iter(columns.values()))), dtype=dtype)
    for name, values in columns.items():
        made[name] = np.asarray(values).reshape(len(made), *dtype[name].shape)
    return made


def record(dtype: np.dtype, values: dict[str, object]) -> np.ndarray:
    """Make an array of one record, which is how compiled code takes a group of plain values."""
    return records(dtype, {name: [value] for name, value in values.items()})
