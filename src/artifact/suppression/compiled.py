"""Compilation of inner loops, and the threads that run them."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from numba import njit


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Compile a function at its first call, without the interpreter lock; ``options`` are those of :func:`numba.njit`.

    The machine code is kept on disk where that can be.
    """

    def compile_one(function: Callable[..., Any]) -> Callable[..., Any]:
        try:
            return njit(nogil=True, cache=True, **options)(function)
        except RuntimeError:  # neither the sources' folder nor one at home can be written
            return njit(nogil=True, **options)(function)

    return compile_one


def threads() -> ThreadPoolExecutor:
    """Return a thread for each core that this process may use."""
    return ThreadPoolExecutor(len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1)
