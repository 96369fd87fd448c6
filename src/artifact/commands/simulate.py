"""The schedule of a graph of jobs on a number of workers, from what each job is expected to take."""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from graphlib import TopologicalSorter
from operator import itemgetter
from typing import NamedTuple

from artifact.commands.jobs import Job


class Schedule(NamedTuple):
    """How a graph runs on workers: ``seconds`` from the first start to the last end, of which they are ``busy`` a share.

    ``critical`` has names and seconds of the longest chain of jobs of which each needs the one before, and
    ``critical_seconds`` is what those take together: no number of workers is faster.
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
    waiting = TopologicalSorter({place[job.name]: [place[n] for n in job.needs if n in place] for job in jobs})
    waiting.prepare()
    ready: dict[bool, list[int]] = {True: [], False: []}
    free = {True: min(gpus, workers), False: workers - min(gpus, workers)}
    running: list[tuple[float, int, bool]] = []
    now, worked = 0.0, 0.0
    while waiting.is_active():
        for number in waiting.get_ready():
            heapq.heappush(ready[jobs[number].on_device and gpus > 0], number)
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
        waiting.done(number)
    longest, critical = _critical(jobs)
    return Schedule(now, worked / (now * workers) if now else 1.0, critical, longest)


def _critical(jobs: Sequence[Job]) -> tuple[float, tuple[tuple[str, float], ...]]:
    """The longest chain of jobs, and its seconds; every job stands after those that it needs."""
    chains: dict[str, tuple[float, tuple[tuple[str, float], ...]]] = {}
    for job in jobs:
        seconds = job.seconds or 0.0
        before, chain = max((chains[n] for n in job.needs if n in chains), key=itemgetter(0), default=(0.0, ()))
        chains[job.name] = before + seconds, (*chain, (job.name, seconds))
    return max(chains.values(), key=itemgetter(0), default=(0.0, ()))
