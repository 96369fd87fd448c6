"""Made descriptors in the place of images and weights: a rehearsal of a run on datasets that are not here.

A made descriptor is the sum of a place code that changes smoothly along the route, of the condition (one direction for
all its images, and one that changes along the route), and of noise. How strong condition and noise are, for each
dataset and method, is recorded in ``made.csv``: with these values R@1 and DAR@1 come near the paper's. The numbers that
follow say nothing about any method; they show that every page can be made and that its verdicts are right.
"""

from __future__ import annotations

import csv
import math
import zlib
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import numpy as np

from artifact import store
from artifact.datasets import imported
from artifact.manifest import Manifest
from artifact.manifest.entries import DatasetEntry

REVISION = 1  # raise when any made value changes: it is part of the folder's name
_SHAPES = {"global": (192,), "local": (4, 4, 64), "codes": (256,)}
_IMAGES = {"pairs": 200, "frames": 200, "metres": 200}
_GALLERY = 4  # database images off the route for each on it, where the paper's database is much the larger
_SPACING = 8.0  # metres between images of a route
_STRAY = 3  # queries of a route in metres that have no positive

# How alike conditions are: coordinates on axes of which the first is the query's and the second the database's.
_KINDS = {
    "overcast": (0.86, 0.0, 0.51),
    "rain": (0.74, 0.0, 0.0, 0.67),
    "spring": (0.7, 0.1, 0.7),
    "fall": (0.7, 0.1, 0.5, 0.5),
}
_SAME_KIND = 0.95  # of a further traversal under the database's condition


@dataclass(frozen=True)
class Strength:
    """How strong noise and condition are in the descriptors of one dataset and method; a place code has length 1."""

    noise: float
    condition: float


def strengths() -> dict[tuple[str, str], Strength]:
    """Return the recorded strengths by the paper's name of the dataset and method."""
    with (files("artifact.extraction") / "made.csv").open(encoding="utf-8") as stream:
        return {
            (row["dataset"], row["method"]): Strength(float(row["noise"]), float(row["condition"]))
            for row in csv.DictReader(stream)
        }


def make(manifest: Manifest, profile: str) -> None:
    """Write positions and descriptors of all datasets of a profile that asks for made ones, where they are missing.

    What an imported results bundle records is not made. The manifest is as from :meth:`artifact.manifest.Manifest.for_profile`.
    """
    entry = manifest.profile(profile)
    for name in entry.datasets if entry.made else ():
        dataset = manifest.dataset(name)
        folder = Path(str(dataset.root))
        with store.lock(folder):
            for traversal in dataset.traversals:
                if imported.traversal(manifest, name, traversal) is None:
                    _write_traversal(manifest, name, dataset, traversal, folder)


def _write_traversal(manifest: Manifest, name: str, entry: DatasetEntry, traversal: str, folder: Path) -> None:
    along, positions = route(entry, traversal)
    described = entry.traversals[traversal]
    table = folder / str(described.positions_file)
    if store.find(table) is None:
        with store.replacing(table) as temporary:
            temporary.write_text(_positions_csv(positions, entry.threshold.unit), encoding="utf-8")
        store.seal(table, {"dataset": name})
    wanted = [(method, file, "global") for method, file in described.descriptors.items()]
    for method, file in described.second_stage.items():
        wanted.append((method, file, "codes" if manifest.method(method).local_features is None else "local"))
    recorded = strengths()
    for method, file, what in wanted:
        path = folder / file
        if store.find(path) is None:
            strength = recorded[entry.reported_as or name, method]
            with store.replacing(path) as temporary:
                np.save(temporary, descriptors(entry, traversal, method, along, strength, what))
            store.seal(path, {"dataset": path.parent.name})


def _positions_csv(positions: np.ndarray, unit: str) -> str:
    head = "image,x,y" if unit == "metres" else "image,index"
    rows = [",".join([f"{row:05d}", *(f"{value:.3f}" for value in place)]) for row, place in enumerate(positions)]
    return "\n".join([head, *rows, ""])


def route(entry: DatasetEntry, traversal: str, images: int | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return where the images of a traversal are; by default as many are on the route as a rehearsal needs.

    The first array, ``(n,)``, has their places along the route in units of the threshold; places off the route are far beyond
    its end. The second has positions: ``(n, 2)`` metres, or ``(n, 1)`` frames or pairs.
    """
    unit, n = entry.threshold.unit, images or _IMAGES[entry.threshold.unit]
    if unit != "metres":
        index = np.arange(n, dtype=np.float64)
        return index / max(entry.threshold.value, 0.2), index[:, None]
    generator = _generator(entry, traversal, "route")
    length = _SPACING * n if images is None or entry.paper is None else 1.0 * entry.paper.queries
    metres = length / n * (np.arange(n) + generator.uniform(0, 0.5, n))
    angle = 2 * np.pi * metres / length
    radius = length / (2 * np.pi) + generator.normal(0, 1.0, n)
    positions = np.column_stack([radius * np.cos(angle), 0.8 * radius * np.sin(angle)])
    counts = entry.paper
    if traversal == entry.query and counts is not None and counts.evaluated not in (None, counts.queries):
        stray = _STRAY if images is None else counts.queries - counts.evaluated
        positions[-stray:] += np.column_stack([1e5 + 100.0 * np.arange(stray), np.zeros(stray)])
        metres[-stray:] = 1e6 + 100.0 * np.arange(stray)
    if traversal == entry.database and counts is not None and counts.database > 5 * counts.queries:
        off = _GALLERY * n
        metres = np.concatenate([metres, 2e6 + 40.0 * np.arange(off)])
        grid = np.column_stack(np.divmod(np.arange(off), 40)) * 40.0 + [600.0, -800.0]
        positions = np.concatenate([positions, grid])
    return metres / entry.threshold.value, positions


def descriptors(
    entry: DatasetEntry, traversal: str, method: str, along: np.ndarray, strength: Strength, what: str = "global"
) -> np.ndarray:
    """Return made descriptors of places along a route; those of all traversals share their place codes.

    ``what`` is ``"global"`` for ``(n, 192)`` or ``"local"`` for ``(n, 4, 4, 64)``, both float32 of unit length along the last
    axis, or ``"codes"`` for ``(n, 32)`` uint8, packed bits.
    """
    d, shared = math.prod(_SHAPES[what]), _generator(entry, method, what)
    seeds = shared.integers(2**31, size=5)
    place = _field(along, d, int(seeds[0]))
    kind = _kind(entry, traversal)
    directions = [np.random.default_rng(seed).normal(0, d**-0.5, d) for seed in seeds[1:5]]
    constant = sum(weight * direction for weight, direction in zip(kind, directions, strict=False))
    changing = sum(weight * _field(along, d, int(seed) + 1) for weight, seed in zip(kind, seeds[1:5], strict=False))
    own = _generator(entry, traversal, method, what)
    amount = strength.condition * own.lognormal(0, 0.25, (len(along), 1))
    noise = strength.noise * own.normal(0, d**-0.5, (len(along), d))
    values = place + amount * (0.8 * constant + 0.6 * changing) + noise
    return np.packbits(values > 0, axis=1) if what == "codes" else _unit(values.reshape(-1, *_SHAPES[what]))


def _kind(entry: DatasetEntry, traversal: str) -> tuple[float, ...]:
    condition = entry.traversals[traversal].condition
    if traversal == entry.query:
        return (1.0,)
    if traversal == entry.database:
        return (0.0, 1.0)
    if condition == entry.traversals[entry.database].condition:
        return (0.0, _SAME_KIND, (1 - _SAME_KIND**2) ** 0.5)
    return _KINDS.get(condition, (0.7, 0.0, 0.7))


def _field(along: np.ndarray, d: int, seed: int) -> np.ndarray:
    """Interpolate random unit codes one threshold apart, ``(n, d)``: near places have alike codes, far ones none."""
    step = np.floor(along).astype(np.int64)
    rest = (along - step)[:, None]
    needed = np.unique(np.concatenate([step, step + 1]))
    anchors = np.stack([np.random.default_rng([seed, number]).normal(0, 1, d) for number in needed])
    rows = np.searchsorted(needed, step)
    return _unit((1 - rest) * anchors[rows] + rest * anchors[np.searchsorted(needed, step + 1)])


def _unit(values: np.ndarray) -> np.ndarray:
    return (values / np.linalg.norm(values, axis=-1, keepdims=True)).astype(np.float32)


def _generator(entry: DatasetEntry, *names: str) -> np.random.Generator:
    return np.random.default_rng([zlib.crc32(name.encode()) for name in (entry.title, *names)])
