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

from PIL import Image

from artifact import datasets, methods, store
from artifact.datasets import shipped
from artifact.datasets.disk import in_words
from artifact.extraction import local_features, reading
from artifact.extraction.stored import descriptor_key, stored_path
from artifact.extraction.timing import PHOTOGRAPH, Timing, Trials
from artifact.manifest import Manifest
from artifact.methods import weights

if TYPE_CHECKING:
    import torch


@dataclass(frozen=True)
class KnownTraversal:
    """A traversal as far as it is known.

    ``images`` is their number, ``None`` if neither the images nor the manifest tell. ``state`` is ``"here"``, ``"not rendered
    yet"`` or ``"not there yet"``. ``image_size`` is height and width of the first image in pixels, if it is here.
    """

    name: str
    images: int | None
    state: str
    image_size: tuple[int, int] | None = None


@dataclass(frozen=True)
class ExtractionCost:
    """What one method takes for one dataset; only for images whose descriptors are not stored yet.

    ``images`` and ``batches`` go through the model; ``seconds`` is ``None`` if it is unknown. ``disk`` is in bytes, of
    descriptors and of local features or codes; ``memory`` the peak in bytes of the model's process, or of the CUDA device,
    and ``reader_memory`` that of each process that reads. ``notes`` say what is stored, missing, assumed or not measured.
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


def known_traversals(manifest: Manifest, dataset: str) -> list[KnownTraversal]:
    """Return the traversals that extraction would describe, with their number of images, reading no image.

    The number is that of the images here, else of the shipped descriptors, else the paper's (query and database).
    """
    entry = manifest.dataset(dataset)
    found = [_known(manifest, dataset, name) for name in entry.traversals]
    return [one for one in found if one.name in (entry.query, entry.database) or one.images is not None]


def _known(manifest: Manifest, dataset: str, name: str) -> KnownTraversal:
    entry, images = manifest.dataset(dataset), datasets.image_folder(manifest, dataset, name)
    if images.is_dir():
        names, _ = datasets.listed(manifest, dataset, name)
        with Image.open(images / names[0]) as first:
            return KnownTraversal(name, len(names), "here", (first.height, first.width))
    if entry.kind == "city":
        return KnownTraversal(name, (entry.traversals[name].render or {}).get("frames"), "not rendered yet")
    without_images = shipped.traversal(entry.root or dataset, name)
    if without_images is not None:
        return KnownTraversal(name, len(without_images[0]), "not there yet")
    counts = {entry.query: entry.paper.queries, entry.database: entry.paper.database} if entry.paper else {}
    return KnownTraversal(name, counts.get(name), "not there yet")


def is_stored(manifest: Manifest, method: str, dataset: str, known: KnownTraversal, precision: str) -> bool:
    """Whether descriptors of the traversal are stored or shipped, judged by their sidecars: no image is read.

    A sidecar counts if it is of this method as the manifest has it now, and of as many images of this traversal, maybe
    as part of another dataset. Images that changed since, and not in number, are noticed only by the extraction itself.
    """
    entry = manifest.method(method)
    if known.state == "not there yet":
        without_images = shipped.traversal(manifest.dataset(dataset).root or dataset, known.name)
        if without_images is not None and shipped.path_of(descriptor_key(without_images[1], method, entry, precision)):
            return True
    roots = {name: other.root or name for name, other in manifest.datasets.items()}
    same = [name for name in roots if roots[name] == roots.get(dataset)] or [dataset]
    return any(
        record.get("dataset") in same
        and record["traversal"] == known.name
        and record["shape"] == [known.images, entry.dimension]
        and record["key"] == descriptor_key(record["images"], method, entry, precision)
        for record in map(store.remembered, stored_path(manifest, method, "").parent.glob("*.json"))
    )


def extraction_cost(
    manifest: Manifest,
    method: str,
    dataset: str,
    traversals: Sequence[KnownTraversal],
    trials: Trials,
    devices: Sequence[torch.device],
    precision: str = "float32",
) -> ExtractionCost:
    """Return what a method takes for those traversals of a dataset whose descriptors are not stored."""
    entry = manifest.method(method)
    todo = [known for known in traversals if not is_stored(manifest, method, dataset, known, precision)]
    counts = [known.images or 0 for known in todo]
    timings = [trials.of_method(method, entry, known.image_size or PHOTOGRAPH, devices[0], precision) for known in todo]
    seconds = [
        None if timing.forward is None else n * seconds_per_image(timing, devices)
        for n, timing in zip(counts, timings, strict=True)
    ]
    layout = local_features.layout_of(entry)
    second = sum(counts) * layout.image_bytes if layout else 0
    notes = [known.state for known in todo if known.state != "here"]
    if todo and weights.state(method, entry).status == "missing":
        notes.append("weights not there yet")
    others = [name for name in methods.of_trunk(manifest, method) if name != method]
    if todo and others:
        notes.append(f"in one pass with {', '.join(others)}: counted for each")
    if second:
        notes.append(f"{in_words(second)} of it {'hash codes' if entry.code_bits else 'local features'}")
    if here := len(traversals) - len(todo):
        notes.append(f"{here} of {len(traversals)} traversals stored" if todo else "stored")
    if unknown := [known.name for known in todo if known.images is None]:
        notes.append(f"number of images unknown: {', '.join(unknown)}")
    notes += [timing.note if timing.forward is None else f"timed with {timing.note}" for timing in timings]
    return ExtractionCost(
        method,
        dataset,
        sum(counts),
        batches=sum(math.ceil(n / entry.batch_size) for n in counts),
        seconds=None if None in seconds else sum(seconds),
        disk=sum(counts) * entry.dimension * 4 + second,
        memory=max((timing.memory or 0 for timing in timings), default=0) or None,
        notes=tuple(dict.fromkeys(notes)),
        reader_memory=max((timing.reader_memory or 0 for timing in timings), default=0) or None,
    )


def seconds_per_image(timing: Timing, devices: Sequence[torch.device]) -> float:
    """Return the expected seconds for an image, reading included.

    On the CPU reading and model share the cores; CUDA devices share the images, and reading goes on beside them.
    """
    if devices[0].type == "cpu":
        return timing.forward + timing.reading / (os.cpu_count() or 1)
    readers = len(devices) * reading.default_workers(len(devices))
    return max(timing.forward / len(devices), timing.reading / readers)
