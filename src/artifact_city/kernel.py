"""Compilation of the renderer's inner loops."""

import contextlib
import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path

from numba import njit

# Reassociation and reciprocals are allowed, the absence of NaN and infinity is not assumed.
_FAST = {"contract", "arcp", "nsz", "afn", "reassoc"}


def kernel(function: Callable) -> Callable:
    """Compile a numerical function without the interpreter lock, and keep the machine code on disk.

    The compiler's disk cache notices a change of the function's own file only, not of the files it calls.
    Cached code is therefore dropped whenever any source file of this package has changed.

    Parameters
    ----------
    function : callable
        Plain numerical Python on scalars, arrays and named tuples of them.

    Returns
    -------
    callable
        The compiled function; compiled at its first call.
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
