"""What the extraction of a dataset's descriptors would take on this machine; nothing is extracted or stored.

Neither images nor trained weights need to be there: where images are missing, their number is the paper's, and time and
memory come from a short trial of each model (:mod:`artifact.extraction.timing`).
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image

from artifact import datasets, store
from artifact.datasets import shipped
from artifact.datasets.traversal import Traversal
from artifact.extraction import extract, local_features, reading
from artifact.extraction.disk import in_words
from artifact.extraction.timing import PHOTOGRAPH, Timing, Trials
from artifact.manifest import Manifest
from artifact.manifest.entries import MethodEntry
from artifact.methods import weights

if TYPE_CHECKING:
    import torch


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
class ExtractionCost:
    """What one method takes for one dataset; only for images whose descriptors are not stored yet.

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
    reader_memory
        Bytes of each process that reads images.
    """

    method: str
    dataset: str
    images: int
    batches: int
    seconds: float | None
    disk: int
    memory: float | None
    notes: tuple[str, ...] = ()
    reader_memory: float | None = None


def known_parts(manifest: Manifest, dataset: str) -> list[Part]:
    """Return the traversals that extraction would describe, with their number of images, reading no image.

    The number is that of the images here, else of the shipped descriptors, else the paper's (query and database).
    """
    entry = manifest.dataset(dataset)
    parts = [_part(manifest, dataset, name) for name in entry.traversals]
    needed = {entry.query, entry.database}
    return [part for part in parts if part.name in needed or part.images is not None]


def _part(manifest: Manifest, dataset: str, name: str) -> Part:
    entry, images = manifest.dataset(dataset), datasets.image_folder(manifest, dataset, name)
    if images.is_dir():
        names, _ = datasets.listed(manifest, dataset, name)
        with Image.open(images / names[0]) as first:
            return Part(name, len(names), "here", (first.height, first.width))
    if entry.kind == "city":
        return Part(name, (entry.traversals[name].render or {}).get("frames"), "not rendered yet")
    without_images = shipped.traversal(entry.root or dataset, name)
    if without_images is not None:
        return Part(name, len(without_images[0]), "not there yet")
    counts = {entry.query: entry.paper.queries, entry.database: entry.paper.database} if entry.paper else {}
    return Part(name, counts.get(name), "not there yet")


def is_stored(manifest: Manifest, method: str, dataset: str, part: Part, precision: str) -> bool:
    """Whether descriptors of the traversal are stored or shipped, judged by their sidecars: no image is read.

    A sidecar counts if it is of this method as the manifest has it now, and of as many images of this traversal, maybe
    as part of another dataset. Images that changed since, and not in number, are noticed only by the extraction itself.
    """
    entry = manifest.method(method)

    def key(digest: str) -> str:
        images = Traversal(dataset, part.name, "", (), np.zeros((0, 1)), digest)
        return extract.descriptor_key(images, method, entry, precision)

    if part.state == "not there yet":
        without_images = shipped.traversal(manifest.dataset(dataset).root or dataset, part.name)
        if without_images is not None and shipped.path_of(key(without_images[1])):
            return True
    roots = {name: other.root or name for name, other in manifest.datasets.items()}
    same = [name for name in roots if roots[name] == roots.get(dataset)] or [dataset]
    for path in extract.stored_path(manifest, method, "").parent.glob("*.json"):
        sidecar = store.read_json(path)
        if sidecar.get("dataset") in same and sidecar["traversal"] == part.name:
            found = sidecar["shape"], sidecar["key"]
            if found == ([part.images, entry.dimension], key(sidecar["images"])):
                return True
    return False


def extraction_cost(
    manifest: Manifest,
    method: str,
    dataset: str,
    parts: Sequence[Part],
    trials: Trials,
    devices: Sequence[torch.device],
    precision: str = "float32",
) -> ExtractionCost:
    """Return what a method takes for those traversals of a dataset whose descriptors are not stored."""
    entry = manifest.method(method)
    stored = [part for part in parts if is_stored(manifest, method, dataset, part, precision)]
    todo = [part for part in parts if part not in stored]
    images = sum(part.images or 0 for part in todo)
    layout = local_features.layout_of(entry)
    second = images * layout.image_bytes if layout else 0
    timings = [trials.of_method(method, entry, part.image_size or PHOTOGRAPH, devices[0], precision) for part in todo]
    seconds = [
        math.nan if timing.forward is None else (part.images or 0) * seconds_per_image(timing, devices)
        for part, timing in zip(todo, timings, strict=True)
    ]
    return ExtractionCost(
        method,
        dataset,
        images,
        batches=sum(-(-(part.images or 0) // entry.batch_size) for part in todo),
        seconds=None if math.isnan(sum(seconds)) else sum(seconds),
        disk=images * entry.dimension * 4 + second,
        memory=max((timing.memory or 0 for timing in timings), default=0) or None,
        notes=tuple(dict.fromkeys(_notes(method, entry, parts, todo, timings, second))),
        reader_memory=max((timing.reader_memory or 0 for timing in timings), default=0) or None,
    )


def _notes(
    method: str,
    entry: MethodEntry,
    parts: Sequence[Part],
    todo: Sequence[Part],
    timings: Sequence[Timing],
    second: int,
) -> list[str]:
    notes = [part.state for part in todo if part.state != "here"]
    if todo and weights.state(method, entry).status == "missing":
        notes.append("weights not there yet")
    if second:
        notes.append(f"{in_words(second)} of it {'hash codes' if entry.code_bits else 'local features'}")
    if len(todo) < len(parts):
        notes.append(f"{len(parts) - len(todo)} of {len(parts)} traversals stored" if todo else "stored")
    if unknown := [part.name for part in todo if part.images is None]:
        notes.append(f"number of images unknown: {', '.join(unknown)}")
    return notes + [timing.note if timing.forward is None else f"timed with {timing.note}" for timing in timings]


def seconds_per_image(timing: Timing, devices: Sequence[torch.device]) -> float:
    """Return the expected seconds for an image, reading included.

    On the CPU reading and model share the cores; CUDA devices share the images, and reading goes on beside them.
    """
    assert timing.forward is not None
    assert timing.reading is not None
    if devices[0].type == "cpu":
        return timing.forward + timing.reading / (os.cpu_count() or 1)
    readers = len(devices) * reading.default_workers(len(devices))
    return max(timing.forward / len(devices), timing.reading / readers)
