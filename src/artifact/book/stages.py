"""What a run spent on each of its stages, and the variables by which the processes that it starts report their part."""

from __future__ import annotations

import contextlib
import os
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from artifact import store

_WITHIN = {"preparation": ("render", "describe"), "notebooks": ("rank", "fit")}


@dataclass(frozen=True)
class Stages:
    """Wall seconds by stage, and the file in which processes report their work by :func:`artifact.store.stage`."""

    reported: Path
    wall: dict[str, float] = field(default_factory=dict)

    @contextlib.contextmanager
    def of(self, name: str) -> Iterator[None]:
        """Measure the wall time of a block."""
        begun = time.monotonic()
        try:
            yield
        finally:
            self.wall[name] = time.monotonic() - begun

    def lines(self) -> list[str]:
        """Return the stages that took a second or more, as lines of text."""
        work: dict[str, float] = defaultdict(float)
        for line in self.reported.read_text(encoding="utf-8").splitlines():
            name, seconds = line.split(",")
            work[name] += float(seconds)
        return table(self.wall, work)


def table(wall: Mapping[str, float], work: Mapping[str, float]) -> list[str]:
    r"""Return seconds by stage as lines of text.

    Examples
    --------
    >>> wall = {"preparation": 90.2, "notebooks": 150.0, "book": 0.1}
    >>> print(*table(wall, {"render": 80.0, "rank": 60.4, "fit": 210.0}), sep="\n")
    preparation      90 s
      render         80 s
    notebooks       150 s
      rank           60 s of all processes
      fit           210 s of all processes
    """
    found = []
    for stage, seconds in wall.items():
        rows = [(stage, seconds, ""), *((f"  {part}", work.get(part, 0.0), stage) for part in _WITHIN.get(stage, ()))]
        for label, spent, within in rows:
            if spent >= 1:
                found.append(f"{label:12} {spent:6.0f} s" + (" of all processes" if within == "notebooks" else ""))
    return found


@contextlib.contextmanager
def measured() -> Iterator[Stages]:
    """Collect what this process and those that it starts report."""
    with tempfile.TemporaryDirectory() as folder:
        reported = Path(folder, "times.csv")
        reported.touch()
        with environment({store.TIMES_VARIABLE: str(reported)}):
            yield Stages(reported)


@contextlib.contextmanager
def environment(variables: Mapping[str, str]) -> Iterator[None]:
    """Set environment variables for a block and the processes that it starts."""
    before = {name: os.environ.get(name) for name in variables}
    os.environ |= variables
    try:
        yield
    finally:
        for name, value in before.items():
            del os.environ[name]
            if value is not None:
                os.environ[name] = value
