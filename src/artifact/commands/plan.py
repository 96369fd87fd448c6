"""What a run at full size would take on this machine, for people: tables of time, disk and memory.

:func:`lines` is the dry run of the extraction and leaves no trace. :func:`run_lines` covers the whole run, and keeps
nothing but its short measured probes.
"""

from __future__ import annotations

import os
import platform
from collections.abc import Iterator, Sequence
from importlib.metadata import version

import pandas as pd
import torch
from tqdm import tqdm

from artifact.book import notebooks
from artifact.commands import costs, jobs, probes
from artifact.commands.costs import STEPS, PairCost
from artifact.commands.jobs import Job
from artifact.commands.simulate import schedule
from artifact.datasets.disk import free_bytes, in_words
from artifact.extraction import forward, local_features, reading, timing
from artifact.extraction.costs import ExtractionCost, KnownTraversal, extraction_cost, known_traversals
from artifact.extraction.timing import Trials
from artifact.manifest import Manifest

_SHOWN_NEEDS = 6  # of a job, in a line


def lines(manifest: Manifest, profile: str, *, device: str | None = None, precision: str = "float32") -> Iterator[str]:
    """Yield the lines of the dry run of one profile: a table with a row for each method and dataset, and totals.

    ``device`` and ``precision`` are as for :func:`artifact.extraction.extract.descriptors`.

    Raises
    ------
    ExtractionError
        If a device is not on this machine.
    """
    devices = forward.devices(device)
    extractions, _ = _extractions(manifest, profile, Trials(), devices, precision)
    yield from table(extractions)
    yield from _footnotes(manifest, extractions, devices)
    needed, free = sum(cost.disk for cost in extractions), free_bytes(manifest.cache)
    short = "" if needed <= free else "; too little: set ARTIFACT_CACHE to a folder on a larger disk"
    yield f"disk: {in_words(needed)} needed, {in_words(free)} free in {manifest.cache}{short}"


def run_lines(manifest: Manifest, profile: str, *, device: str | None = None) -> Iterator[str]:
    """Yield the lines of the plan of a whole run: extraction, ranking, suppression, probes and embedding.

    Parameters and errors are those of :func:`lines`.
    """
    devices = forward.devices(device)
    extractions, images, pairs = _measured(manifest, profile, devices)
    yield from run_table(pairs)
    yield from _footnotes(manifest, extractions, devices)
    accuracy = "short probes on made descriptors, scaled by size, right to a factor of about three"
    yield f"ranking and later: {accuracy}; memory is without descriptors mapped from disk"
    every = [(name, traversal) for name in images for traversal in manifest.dataset(name).traversals]
    if unknown := [f"{name}/{traversal}" for name, traversal in every if traversal not in images[name]]:
        yield f"not counted in extraction, since nobody knows their number of images yet: {', '.join(unknown)}"
    free, memory = free_bytes(manifest.cache), timing.available_memory()
    yield f"disk: {in_words(sum(p.disk for p in pairs))} needed, {in_words(free)} free in {manifest.cache}"
    yield f"memory: at most {in_words(max(p.memory for p in pairs))} needed, {in_words(memory)} available"
    on_device = {"extraction"} if devices[0].type != "cpu" else set()
    for pair, step, what, needed, there in costs.that_do_not_fit(pairs, memory, free):
        if what == "disk" or step.name not in on_device:
            short = f"{in_words(needed)} of {what} needed, {in_words(there)} there"
            yield f"will not fit: {pair.method} × {pair.dataset} × {step.name}: {short}"


def run_frame(manifest: Manifest, profile: str, *, device: str | None = None) -> pd.DataFrame:
    """Return the plan of :func:`run_lines` as a row per method and dataset, with the machine that it was measured on.

    Columns: ``method``, ``dataset``, ``images`` to describe, hours of each step (``extraction_h``, ...), peak ``memory`` and
    ``disk`` in bytes, and ``machine`` in words.
    """
    devices = forward.devices(device)
    extractions, _, pairs = _measured(manifest, profile, devices)
    memory, torch_ = in_words(timing.available_memory()), version("torch")
    machine = f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores, {memory} free, {devices[0]}, PyTorch {torch_}"
    rows = [
        {"method": pair.method, "dataset": pair.dataset, "images": extraction.images}
        | {f"{step.name}_h": None if step.seconds is None else round(step.seconds / 3600, 3) for step in pair.steps}
        | {"memory": int(pair.memory), "disk": int(pair.disk), "machine": machine}
        for pair, extraction in zip(pairs, extractions, strict=True)
    ]
    return pd.DataFrame(rows)


def planned_jobs(manifest: Manifest, profile: str, *, device: str | None = None) -> list[Job]:
    """Return the jobs of a whole run with what each is expected to take; parameters and errors are those of :func:`run_lines`.

    Traversals whose number of images nobody knows yet are left out.
    """
    _, images, pairs = _measured(manifest, profile, forward.devices(device)[:1])  # each job runs on one
    known = {name: {traversal: n for traversal, n in numbers.items() if n} for name, numbers in images.items()}
    return jobs.planned(manifest, notebooks.plan(manifest, profile), known, pairs)


def job_lines(graph: Sequence[Job]) -> Iterator[str]:
    """Yield a line for each job: its name, time, memory, whether it wants a GPU, and what it needs."""
    yield f"{len(graph)} jobs: time, memory, device, name, needs"
    for job in graph:
        needs = job.needs
        if len(needs) >= _SHOWN_NEEDS:
            needs = needs[0], f"… ({len(needs)})", needs[-1]
        memory, device = in_words(job.memory) if job.memory else "–", "GPU" if job.on_device else "CPU"
        after = f"  ← {', '.join(needs)}" if needs else ""
        yield f"{duration(job.seconds):>12}  {memory:>9}  {device}  {job.name}{after}"


def schedule_lines(graph: Sequence[Job], workers: Sequence[int], gpus: int) -> Iterator[str]:
    """Yield the schedule of jobs on each number of workers like this machine: time, share of it at work, critical path."""
    rows = [("workers", "GPUs", "time", "at work")]
    for number in workers:
        found = schedule(graph, number, min(gpus, number))
        rows.append((str(number), str(min(gpus, number)), duration(found.seconds), f"{100 * found.busy:.0f} %"))
    yield from _aligned(rows)
    unknown = sum(job.seconds is None for job in graph)
    chain = " → ".join(f"{name} ({duration(seconds)})" for name, seconds in found.critical if seconds)
    yield f"critical path, which no number of workers shortens: {duration(found.critical_seconds)}: {chain}"
    yield f"{len(graph)} jobs, {unknown} of unknown time, taken as none; every worker as fast as this machine, a GPU only if it has one"


def _measured(
    manifest: Manifest, profile: str, devices: Sequence[torch.device]
) -> tuple[list[ExtractionCost], dict[str, dict[str, int | None]], list[PairCost]]:
    """What extractions take, the images of each known traversal, and what all steps of each pair take, by short probes."""
    trials = Trials(manifest.cache / "probes.json")
    extractions, found = _extractions(manifest, profile, trials, devices, "float32")
    images = {name: {one.name: one.images for one in known} for name, known in found.items()}
    entry = manifest.profile(profile)
    methods = {name: manifest.method(name) for name in entry.methods}
    layouts = [local_features.layout_of(method) for method in methods.values()]
    rates = probes.rates(trials, sorted({layout.shape for layout in layouts if layout and not layout.bits}))
    # Fig. 3 shows the first method that does not re-rank, on a dataset with mixed maps if there is one.
    single_stage = [name for name in entry.methods if methods[name].rerank is None]
    mixed = [name for name in entry.datasets if manifest.dataset(name).same_condition_traversal]
    shown = single_stage[:1], (mixed or entry.datasets)[:1]
    pairs = []
    for cost in extractions:
        embedded = ([cost.method], [cost.dataset]) == shown
        pair = costs.sizes(manifest, cost.method, cost.dataset, images[cost.dataset], embedded=embedded)
        pairs.append(costs.pair_cost(pair, methods[cost.method], cost, rates))
    return extractions, images, pairs


def _extractions(
    manifest: Manifest, profile: str, trials: Trials, devices: Sequence[torch.device], precision: str
) -> tuple[list[ExtractionCost], dict[str, list[KnownTraversal]]]:
    entry = manifest.profile(profile)
    known = {name: known_traversals(manifest, name) for name in entry.datasets}
    found = []
    bar = tqdm(entry.methods, unit="method", desc="timing", leave=False, disable=None)
    for method in bar:
        bar.set_postfix_str(method)
        for name in entry.datasets:
            found.append(extraction_cost(manifest, method, name, known[name], trials, devices, precision))
    return found, known


# -- printing -----------------------------------------------------------------------------------------------


def table(found: Sequence[ExtractionCost]) -> list[str]:
    """Return what extractions take as lines of equal columns, with their totals."""
    rows = [("method", "dataset", "images", "batches", "time", "disk", "memory", "notes")]
    for cost in found:
        counts = f"{cost.images:,}", f"{cost.batches:,}", duration(cost.seconds)
        memory = in_words(cost.memory) if cost.memory else "–"
        rows.append((cost.method, cost.dataset, *counts, in_words(cost.disk), memory, "; ".join(cost.notes)))
    counts = f"{sum(cost.images for cost in found):,}", f"{sum(cost.batches for cost in found):,}"
    known = [cost.seconds for cost in found if cost.seconds is not None]
    total = ("" if len(known) == len(found) else "over ") + duration(sum(known))
    room = in_words(sum(cost.disk for cost in found)), in_words(max((cost.memory or 0 for cost in found), default=0))
    rows.append(("total", "", *counts, total, *room, ""))
    return _aligned(rows)


def run_table(pairs: Sequence[PairCost]) -> list[str]:
    """Return hours of each step, peak memory and disk of method–dataset pairs as lines of equal columns, with totals."""

    def hours(of: Sequence[PairCost]) -> list[str]:
        steps = [step for pair in of for step in pair.steps]
        alike = [[step for step in steps if step.name == name] for name in STEPS]
        return [_hours([step.seconds for step in some]) for some in (*alike, steps)]

    rows = [("method", "dataset", *(f"{step} h" for step in STEPS), "total h", "memory", "disk")]
    for pair in pairs:
        rows.append((pair.method, pair.dataset, *hours([pair]), in_words(pair.memory), in_words(pair.disk)))
    memory, disk = max((pair.memory for pair in pairs), default=0.0), sum(pair.disk for pair in pairs)
    rows.append(("total", "", *hours(pairs), in_words(memory), in_words(disk)))
    return _aligned(rows)


def _aligned(rows: Sequence[tuple[str, ...]]) -> list[str]:
    """Texts to the left, numbers to the right."""
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    left = {column for column, name in enumerate(rows[0]) if name in ("method", "dataset", "notes")}
    lines = []
    for row in rows:
        cells = enumerate(zip(row, widths, strict=True))
        shown = [text.ljust(width) if column in left else text.rjust(width) for column, (text, width) in cells]
        lines.append("  ".join(shown).rstrip())
    return lines


def _hours(seconds: Sequence[float | None]) -> str:
    known = [one for one in seconds if one is not None]
    if not known:
        return "?" if seconds else "–"
    return f"{'' if len(known) == len(seconds) else 'over '}{sum(known) / 3600:,.2f}"


def _footnotes(manifest: Manifest, found: Sequence[ExtractionCost], devices: Sequence[torch.device]) -> Iterator[str]:
    where = ", ".join(map(str, devices))
    yield f"time of extraction: on {where}, from a short trial of each model; trained weights do not change it"
    if any("not there yet" in cost.notes for cost in found):
        size = f"images are taken to be {timing.PHOTOGRAPH[0]} × {timing.PHOTOGRAPH[1]} pixels"
        yield f"not there yet: the number of images is the paper's, or that of the descriptors that ship; {size}"
    yield from dict.fromkeys(note for cost in found for note in cost.notes if note.startswith("number of images"))
    if readers := [cost.reader_memory for cost in found if cost.reader_memory]:
        n = len(devices) * reading.default_workers(len(devices))
        yield f"memory: of the model's process for a batch; reading takes {n} × {in_words(max(readers))} besides"


def duration(seconds: float | None) -> str:
    """Write a time for people.

    Examples
    --------
    >>> [duration(seconds) for seconds in (None, 0, 0.4, 59, 3700, 1e6)]
    ['?', '0 s', '0.4 s', '59 s', '1 h 1 min', '11 d 13 h']
    """
    if seconds is None:
        return "?"
    if seconds < 60:
        return f"{seconds:.1f} s" if 0 < seconds < 9.95 else f"{seconds:.0f} s"
    units = (86400, 3600, "d", "h"), (3600, 60, "h", "min"), (60, 1, "min", "s")
    large, small, *names = next(unit for unit in units if seconds >= unit[0])
    return f"{seconds // large:.0f} {names[0]} {seconds % large // small:.0f} {names[1]}"
