"""What a run spent on each of its stages, and the variables by which the processes that it starts report their part."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path

from artifact import store

_STAGES = {"preparation": ("render", "describe"), "notebooks": ("rank", "fit"), "book": ()}


@contextlib.contextmanager
def measured() -> Iterator[Path]:
    """Give the file in which :func:`artifact.store.stage` reports here and in the processes that this one starts."""
    with tempfile.TemporaryDirectory() as folder:
        reported = Path(folder, "times.csv")
        reported.touch()
        with environment({store.TIMES_VARIABLE: str(reported)}):
            yield reported


def lines(reported: Path) -> list[str]:
    """Return the stages that took a second or more, as lines of text."""
    spent: Counter[str] = Counter()
    for line in reported.read_text(encoding="utf-8").splitlines():
        name, seconds = line.split(",")
        spent[name] += float(seconds)
    return table(spent)


def table(spent: Mapping[str, float]) -> list[str]:
    r"""Return seconds by stage as lines of text: wall time, and within it the work of its processes.

    Examples
    --------
    >>> spent = {"preparation": 90.2, "notebooks": 150.0, "book": 0.1, "render": 80.0, "rank": 60.4, "fit": 210.0}
    >>> print(*table(spent), sep="\n")
    preparation      90 s
      render         80 s
    notebooks       150 s
      rank           60 s of all processes
      fit           210 s of all processes
    """
    found = []
    for stage, parts in _STAGES.items():
        for name in (stage, *parts):
            label = name if name == stage else f"  {name}"
            note = " of all processes" if name in _STAGES["notebooks"] else ""
            if (seconds := spent.get(name, 0.0)) >= 1:
                found.append(f"{label:12} {seconds:6.0f} s{note}")
    return found


@contextlib.contextmanager
def environment(variables: Mapping[str, str]) -> Iterator[None]:
    """Set environment variables for a block and the processes that it starts."""
    before = {name: os.environ.get(name) for name in variables}
    os.environ |= variables
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name, None)
            if value is not None:
                os.environ[name] = value
