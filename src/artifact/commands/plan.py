"""What extraction at full size would take on this machine: images, batches, time, disk and memory.

Nothing is extracted or stored, and neither images nor trained weights need to be there: where images are missing, their
number is the paper's, and time and memory come from a short trial of each model (:mod:`artifact.extraction.timing`).
"""

from __future__ import annotations

import math
import os
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image
from tqdm import tqdm

from artifact import store
from artifact.datasets import folder, shipped
from artifact.datasets.rendered import is_rendered, rendered
from artifact.datasets.traversal import Traversal
from artifact.extraction import extract, local_features, reading, timing
from artifact.manifest import Manifest
from artifact.manifest.entries import DatasetEntry, MethodEntry
from artifact.methods import weights

if TYPE_CHECKING:
    import torch

ASSUMED_SIZE = (480, 640)
"""Height and width in pixels of images that are not there."""


@dataclass(frozen=True)
class Part:
    """One traversal as far as it is known.

    Attributes
    ----------
    name
        The traversal.
    images
        Number of images; ``None`` if neither the images nor the manifest tell.
    state
        Of its images: ``"here"``, ``"not rendered yet"`` or ``"not there yet"``.
    image_size
        Height and width of its first image, in pixels; ``None`` if it is not here.
    """

    name: str
    images: int | None
    state: str
    image_size: tuple[int, int] | None = None


@dataclass(frozen=True)
class Need:
    """What one method needs for one dataset; only for images whose descriptors are not stored yet.

    Attributes
    ----------
    method, dataset
        Names in the manifest.
    images, batches
        Images and batches that go through the model.
    seconds
        Expected time; ``None`` if it is unknown.
    disk
        Bytes of the descriptors, and of the local features or codes of a two-stage method.
    memory
        Peak bytes of the model's process, or of the CUDA device.
    notes
        What is stored, missing, assumed or not measured.
    """

    method: str
    dataset: str
    images: int
    batches: int
    seconds: float | None
    disk: int
    memory: float | None
    notes: tuple[str, ...] = ()


def lines(manifest: Manifest, profile: str, *, device: str | None = None, precision: str = "float32") -> Iterator[str]:
    """Yield the lines of the dry run of one profile: a table with a row for each method and dataset, and totals.

    Parameters
    ----------
    manifest, profile
        What would be extracted.
    device, precision
        As for :func:`artifact.extraction.extract.descriptors`.

    Raises
    ------
    ExtractionError
        If a device is not on this machine.
    """
    from artifact.extraction import forward

    chosen = forward.devices(device)
    entry = manifest.profile(profile)
    parts = {name: known_parts(manifest, name) for name in entry.datasets}
    trials: dict[tuple[str, tuple[int, int]], timing.Timing] = {}
    needs = []
    with tqdm(total=len(entry.methods), unit="method", desc="timing", leave=False, disable=None) as bar:
        for method in entry.methods:
            bar.set_postfix_str(method)
            for name in entry.datasets:
                needs.append(_need(manifest, method, name, parts[name], trials, chosen, precision))
            bar.update()
    yield from table(needs)
    yield from _footnotes(manifest, needs, list(trials.values()), chosen)


# -- images -------------------------------------------------------------------------------------------------


def known_parts(manifest: Manifest, dataset: str) -> list[Part]:
    """Return the traversals that extraction would describe, with their number of images, reading no image.

    The number is that of the images here, else of the shipped descriptors, else the paper's (query and database).
    """
    entry = manifest.dataset(dataset)
    parts = [_part(manifest, dataset, entry, name) for name in entry.traversals]
    needed = {entry.query, entry.database}
    return [part for part in parts if part.name in needed or part.images is not None]


def _part(manifest: Manifest, dataset: str, entry: DatasetEntry, name: str) -> Part:
    traversal = entry.traversals[name]
    images = manifest.data_root / (entry.root or dataset) / (traversal.images or name)
    if entry.kind == "city":
        render, label = traversal.render or {}, f"{dataset}/{name}"
        cache = manifest.cache
        if not is_rendered(render, cache, label):
            return Part(name, render.get("frames"), "not rendered yet")
        images = rendered(render, cache, label, progress=False)
    if images.is_dir():
        names = _image_names(manifest, dataset, entry, name, images)
        with Image.open(images / names[0]) as first:
            return Part(name, len(names), "here", (first.height, first.width))
    stored = shipped.traversal(entry.root or dataset, name)
    if stored is not None:
        return Part(name, len(stored[0]), "not there yet")
    listed = {entry.query: entry.paper.queries, entry.database: entry.paper.database} if entry.paper else {}
    return Part(name, listed.get(name), "not there yet")


def _image_names(manifest: Manifest, dataset: str, entry: DatasetEntry, name: str, images: Path) -> list[str]:
    """Names of a traversal's images as loading would choose them, without reading their bytes."""
    traversal = entry.traversals[name]
    root = manifest.data_root / (entry.root or dataset)
    names = folder.list_images(images, root / traversal.image_list if traversal.image_list else None)
    if traversal.spacing is None:
        return names
    if traversal.positions == "names":
        positions = folder.positions_from_names(images, names)
    else:
        file = root / traversal.positions_file if traversal.positions_file else images / folder.POSITIONS_FILE
        positions, _ = folder.positions_from_csv(file, names)
    return [names[index] for index in folder.keep_spacing(positions, traversal.spacing)]


def is_stored(manifest: Manifest, method: str, dataset: str, part: Part, precision: str) -> bool:
    """Whether descriptors of the traversal are stored or shipped, judged by their sidecars: no image is read.

    A sidecar counts if it is of this method as the manifest has it now, and of as many images of this traversal, maybe
    as part of another dataset. Images that changed since, and not in number, are noticed only by the extraction itself.
    """
    entry = manifest.method(method)
    if part.state == "not there yet":
        listed = shipped.traversal(manifest.dataset(dataset).root or dataset, part.name)
        if listed is not None and shipped.descriptors(_key(dataset, part.name, listed[1], method, entry, precision)):
            return True
    folders = {name: other.root or name for name, other in manifest.datasets.items()}
    same = [name for name in folders if folders[name] == folders.get(dataset)] or [dataset]
    for path in extract.stored_path(manifest, method, "").parent.glob("*.json"):
        record = store.read_json(path)
        if record.get("dataset") in same and record["traversal"] == part.name:
            key = _key(dataset, part.name, record["images"], method, entry, precision)
            if (record["shape"], record["key"]) == ([part.images, entry.dimension], key):
                return True
    return False


def _key(dataset: str, name: str, digest: str, method: str, entry: MethodEntry, precision: str) -> str:
    images = Traversal(dataset, name, "", (), np.zeros((0, 1)), digest)
    return extract.descriptor_key(images, method, entry, precision)


# -- needs --------------------------------------------------------------------------------------------------


def _need(
    manifest: Manifest, method: str, dataset: str, parts: Sequence[Part],
    trials: dict[tuple[str, tuple[int, int]], timing.Timing], devices: Sequence[torch.device], precision: str,
) -> Need:  # fmt: skip
    entry = manifest.method(method)
    stored = [part for part in parts if is_stored(manifest, method, dataset, part, precision)]
    todo = [part for part in parts if part not in stored]
    images = sum(part.images or 0 for part in todo)
    notes = [part.state for part in todo if part.state != "here"]
    if todo and weights.state(method, entry).status == "missing":
        notes.append("weights not there yet")
    layout = local_features.layout_of(entry)
    second = images * layout.image_bytes if layout else 0
    if second:
        notes.append(f"{size(second)} of it {'hash codes' if layout.bits else 'local features'}")
    if stored:
        notes.append("stored" if not todo else f"{len(stored)} of {len(parts)} traversals stored")
    if unknown := [part.name for part in todo if part.images is None]:
        notes.append(f"number of images unknown: {', '.join(unknown)}")
    seconds, memory = 0.0, 0.0
    for part in todo:
        trial = _trial(method, entry, part.image_size or ASSUMED_SIZE, trials, devices[0], precision)
        memory = max(memory, trial.memory or 0)
        if trial.forward is None:
            seconds = math.nan
        else:
            seconds += (part.images or 0) * seconds_per_image(trial, devices)
        notes.append(trial.note if trial.forward is None else f"timed with {trial.note}")
    return Need(
        method,
        dataset,
        images,
        batches=sum(-(-(part.images or 0) // entry.batch_size) for part in todo),
        seconds=None if math.isnan(seconds) else seconds,
        disk=images * entry.dimension * 4 + second,
        memory=memory or None,
        notes=tuple(dict.fromkeys(notes)),
    )


def _trial(
    method: str, entry: MethodEntry, image_size: tuple[int, int],
    trials: dict[tuple[str, tuple[int, int]], timing.Timing], device: torch.device, precision: str,
) -> timing.Timing:  # fmt: skip
    """Time a method once for each size of its input."""
    from artifact.methods.preprocessing import target_size

    at = (method, target_size(*image_size, entry.preprocessing))
    if at not in trials:
        trials[at] = timing.time_method(method, entry, image_size, device, precision)
    return trials[at]


def seconds_per_image(trial: timing.Timing, devices: Sequence[torch.device]) -> float:
    """Return the expected seconds for an image, reading included.

    On the CPU reading and model share the cores; CUDA devices share the images, and reading goes on beside them.
    """
    assert trial.forward is not None
    assert trial.reading is not None
    if devices[0].type == "cpu":
        return trial.forward + trial.reading / (os.cpu_count() or 1)
    readers = len(devices) * reading.default_workers(len(devices))
    return max(trial.forward / len(devices), trial.reading / readers)


# -- printing -----------------------------------------------------------------------------------------------


def table(needs: Sequence[Need]) -> list[str]:
    """Return the needs as lines of equal columns, with their totals."""
    head = ("method", "dataset", "images", "batches", "time", "disk", "memory", "notes")
    rows = [
        (
            need.method, need.dataset, f"{need.images:,}", f"{need.batches:,}", duration(need.seconds), size(need.disk),
            size(need.memory) if need.memory else "–", "; ".join(need.notes),
        )
        for need in needs
    ]  # fmt: skip
    known = [need.seconds for need in needs if need.seconds is not None]
    total = (
        "total", "", f"{sum(need.images for need in needs):,}", f"{sum(need.batches for need in needs):,}",
        ("" if len(known) == len(needs) else "over ") + duration(sum(known)), size(sum(need.disk for need in needs)),
        size(max((need.memory or 0 for need in needs), default=0)), "",
    )  # fmt: skip
    widths = [max(len(row[column]) for row in (head, *rows, total)) for column in range(len(head))]
    left = {"method", "dataset", "notes"}
    return [
        "  ".join(
            text.ljust(width) if name in left else text.rjust(width)
            for name, text, width in zip(head, row, widths, strict=True)
        ).rstrip()
        for row in (head, *rows, total)
    ]


def _footnotes(
    manifest: Manifest, needs: Sequence[Need], trials: Sequence[timing.Timing], devices: Sequence[torch.device]
) -> Iterator[str]:
    yield f"time: on {', '.join(map(str, devices))}, from a short trial of each model; trained weights do not change it"
    if any("not there yet" in need.notes for need in needs):
        yield (
            f"not there yet: the number of images is the paper's, or that of the descriptors that ship; images are "
            f"taken to be {ASSUMED_SIZE[0]} × {ASSUMED_SIZE[1]} pixels"
        )
    readers = [trial.reader_memory for trial in trials if trial.reader_memory]
    if readers:
        n = len(devices) * reading.default_workers(len(devices))
        yield f"memory: of the model's process for a batch; reading takes {n} × {size(max(readers))} besides"
    cache = manifest.cache
    nearest = next(place for place in (cache, *cache.parents) if place.exists())
    needed, free = sum(need.disk for need in needs), shutil.disk_usage(nearest).free
    short = "" if needed <= free else "; too little: set ARTIFACT_CACHE to a folder on a larger disk"
    yield f"disk: {size(needed)} needed, {size(free)} free in {nearest}{short}"


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
    for large, small, names in ((86400, 3600, ("d", "h")), (3600, 60, ("h", "min")), (60, 1, ("min", "s"))):
        if seconds >= large:
            return f"{seconds // large:.0f} {names[0]} {seconds % large // small:.0f} {names[1]}"
    raise AssertionError


def size(n_bytes: float) -> str:
    """Write a number of bytes for people.

    Examples
    --------
    >>> size(0), size(2_300_000), size(10.9e9)
    ('0 MB', '2 MB', '10.9 GB')
    """
    return f"{n_bytes / 1e9:.1f} GB" if n_bytes >= 1e9 else f"{n_bytes / 1e6:.0f} MB"
