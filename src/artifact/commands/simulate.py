"""The schedule of a graph of jobs on a number of workers, from what each job is expected to take."""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from typing import NamedTuple

from artifact.commands.jobs import Job


class Schedule(NamedTuple):
    """How a graph runs on workers.

    Attributes
    ----------
    seconds
        From the first start to the last end.
    busy
        Share of the workers' time in which they work.
    critical
        Names and seconds of the longest chain of jobs of which each needs the one before.
    critical_seconds
        What those take together: no number of workers is faster.
    """

    seconds: float
    busy: float
    critical: tuple[tuple[str, float], ...]
    critical_seconds: float


def schedule(jobs: Sequence[Job], workers: int, gpus: int = 0) -> Schedule:
    """Return the schedule of jobs on workers, of which the first ``gpus`` have a GPU each.

    A free worker takes, of the jobs whose needs are met, the first of the list; one that wants a GPU waits for a worker that
    has one, if any has. A job of unknown duration takes no time.

    Examples
    --------
    >>> a, b, c = Job("a", (), None, seconds=2), Job("b", (), None, seconds=1), Job("c", ("a",), None, seconds=3)
    >>> schedule([a, b, c], workers=2).seconds, schedule([a, b, c], workers=1).seconds
    (5.0, 6.0)
    """
    place = {job.name: number for number, job in enumerate(jobs)}
    waits = [len([need for need in job.needs if need in place]) for job in jobs]
    wanted_by: list[list[int]] = [[] for _ in jobs]
    for number, job in enumerate(jobs):
        for need in job.needs:
            if need in place:
                wanted_by[place[need]].append(number)
    ready: dict[bool, list[int]] = {True: [], False: []}
    for number, job in enumerate(jobs):
        if not waits[number]:
            heapq.heappush(ready[job.on_device and gpus > 0], number)
    free = {True: min(gpus, workers), False: workers - min(gpus, workers)}
    running: list[tuple[float, int, bool]] = []
    now, worked = 0.0, 0.0
    while running or ready[True] or ready[False]:
        # Workers with a GPU take other work as well, if none waits for them.
        for kind, has_gpu in ((True, True), (False, False), (False, True)):
            while ready[kind] and free[has_gpu]:
                number = heapq.heappop(ready[kind])
                seconds = jobs[number].seconds or 0.0
                worked += seconds
                free[has_gpu] -= 1
                heapq.heappush(running, (now + seconds, number, has_gpu))
        now, number, has_gpu = heapq.heappop(running)
        free[has_gpu] += 1
        for later in wanted_by[number]:
            waits[later] -= 1
            if not waits[later]:
                heapq.heappush(ready[jobs[later].on_device and gpus > 0], later)
    critical, longest = _critical(jobs, place)
    return Schedule(now, worked / (now * workers) if now else 1.0, critical, longest)


def _critical(jobs: Sequence[Job], place: dict[str, int]) -> tuple[tuple[tuple[str, float], ...], float]:
    """The longest chain of jobs; every job stands after those that it needs."""
    ends: list[float] = []
    before: list[int | None] = []
    for job in jobs:
        needed = [place[need] for need in job.needs if need in place]
        last = max(needed, key=lambda number: ends[number], default=None)
        before.append(last)
        ends.append((0.0 if last is None else ends[last]) + (job.seconds or 0.0))
    chain: list[tuple[str, float]] = []
    at = max(range(len(jobs)), key=lambda number: ends[number], default=None)
    longest = 0.0 if at is None else ends[at]
    while at is not None:
        chain.append((jobs[at].name, jobs[at].seconds or 0.0))
        at = before[at]
    return tuple(chain[::-1]), longest
