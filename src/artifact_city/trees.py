"""Trees: crowns as clusters of ellipsoids for the leaves, branches as tapering rods for the wood."""

from enum import IntEnum
from functools import cache
from typing import NamedTuple

import numpy as np

from artifact_city.kernel import layout, records


class Species(IntEnum):
    """Kinds of tree; the values index the templates."""

    LINDEN = 0
    POPLAR = 1
    SPRUCE = 2
    SHRUB = 3


# Height and crown radius in metres of a tree of size 1.
HEIGHT = np.array([9.5, 15.0, 12.0, 2.2])
CROWN = np.array([3.2, 1.7, 2.6, 1.4])
_BRANCHINESS = (5, 6, 0, 3)

# Templates and trees as compiled code reads them. Template lengths are for a tree of size 1.
BLOB = layout("x y z radius half")
LIMB = layout("x0 y0 z0 x1 y1 z1 r0 r1 order")
SHAPE = layout("first_blob:i last_blob:i first_limb:i last_limb:i reach top")
TREE = layout("x y size yaw species:i seed")


class TreeShapes(NamedTuple):
    """Templates of all species: ellipsoids of leaves, limbs of wood, and which of them belong to a species."""

    shapes: np.ndarray
    blobs: np.ndarray
    limbs: np.ndarray


def _crown(species: Species, rng: np.random.Generator) -> np.ndarray:
    h, r = HEIGHT[species], CROWN[species]
    if species == Species.SPRUCE:
        level = np.linspace(0.14, 0.97, 9)
        radius = r * (1.0 - level) ** 0.85 + 0.12
        return np.stack([0 * level, 0 * level, h * level, radius, 0.55 * (h / 9) + 0.25 * radius], axis=1)
    if species == Species.POPLAR:
        level = np.linspace(0.2, 0.92, 7)
        radius = r * np.sqrt(np.sin(np.pi * np.clip(level * 0.9, 0, 1)))
        return np.stack([*rng.normal(0, 0.2, (2, 7)), h * level, radius, np.full(7, 0.14 * h)], axis=1)
    if species == Species.SHRUB:
        centre = rng.uniform(-0.6, 0.6, (4, 2))
        return np.column_stack([centre, rng.uniform(0.7, 1.3, 4), rng.uniform(0.7, 1.0, 4), rng.uniform(0.6, 0.9, 4)])
    found = []  # a dome: a wide ring low down, a narrower one above it, and a top
    for count, out, level, size in ((6, 0.62, 0.50, 0.42), (5, 0.42, 0.70, 0.46), (2, 0.14, 0.86, 0.42)):
        turn = 2 * np.pi * (np.arange(count) / count + rng.uniform(0, 1)) + rng.normal(0, 0.2, count)
        reach = r * out * rng.uniform(0.8, 1.15, count)
        radius = r * size * rng.uniform(0.8, 1.2, count)
        lift = h * (level + rng.normal(0, 0.035, count))
        half = radius * rng.uniform(0.75, 1.0, count)
        found.append(np.stack([reach * np.cos(turn), reach * np.sin(turn), lift, radius, half], axis=1))
    return np.concatenate(found)


def _limbs(species: Species, rng: np.random.Generator) -> np.ndarray:
    h = HEIGHT[species]
    found: list[tuple] = []

    def grow(start: np.ndarray, heading: np.ndarray, length: float, radius: float, order: int) -> None:
        bend = heading + rng.normal(0, 0.12, 3) + np.array([0, 0, 0.12])
        bend /= np.linalg.norm(bend)
        end = start + length * bend
        tip = radius * (0.72 if order else 0.8)
        found.append((*start, *end, radius, tip, order))
        if order >= _BRANCHINESS[species]:
            return
        for _ in range(3 if order < 4 else 2):
            turned = bend + rng.normal(0, 0.22 if species == Species.POPLAR else 0.55, 3) + np.array([0, 0, 0.1])
            fork, thickness = start + (end - start) * rng.uniform(0.55, 1.0), tip * rng.uniform(0.5, 0.68)
            shorter = length * rng.uniform(0.6, 0.8)
            grow(fork, turned / np.linalg.norm(turned), shorter, max(0.012, thickness), order + 1)

    if species == Species.SPRUCE:
        return np.array([(0, 0, 0, 0, 0, h * 0.95, 0.2, 0.03, 0)], dtype=float)
    if species == Species.SHRUB:
        for _ in range(4):
            grow(np.zeros(3), rng.normal(0, 0.5, 3) + np.array([0, 0, 1.0]), 0.7, 0.04, 1)
    else:
        grow(np.zeros(3), np.array([0, 0, 1.0]), h * 0.3, 0.022 * h, 0)
    limbs = np.array(found)
    return limbs[limbs[:, 5] < h * 1.05]


@cache
def tree_shapes() -> TreeShapes:
    """Build the templates once; they are the same in every town, turned and scaled tree by tree."""
    rng = np.random.default_rng(20)
    blobs = [_crown(s, rng) for s in Species]
    limbs = [_limbs(s, rng) for s in Species]
    first_blob, first_limb = (np.cumsum([0] + [len(part) for part in parts]) for parts in (blobs, limbs))
    shapes = {
        "first_blob": first_blob[:-1],
        "last_blob": first_blob[1:],
        "first_limb": first_limb[:-1],
        "last_limb": first_limb[1:],
        "reach": [(np.hypot(b[:, 0], b[:, 1]) + b[:, 3]).max() for b in blobs],
        "top": [(b[:, 2] + b[:, 4]).max() for b in blobs],
    }
    return TreeShapes(
        records(SHAPE, shapes),
        records(BLOB, dict(zip(BLOB.names, np.concatenate(blobs).T, strict=True))),
        records(LIMB, dict(zip(LIMB.names, np.concatenate(limbs).T, strict=True))),
    )
