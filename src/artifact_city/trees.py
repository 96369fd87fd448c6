"""Trees: crowns as clusters of ellipsoids for the leaves, branches as tapering rods for the wood."""

from enum import IntEnum
from functools import cache
from typing import NamedTuple

import numpy as np

from artifact_city.records import layout, records


class Species(IntEnum):
    """Kinds of tree; the values index the templates."""

    LINDEN = 0
    PLANE = 1
    POPLAR = 2
    SPRUCE = 3
    BIRCH = 4
    SHRUB = 5


# Height and crown radius in metres of a tree of size 1.
HEIGHT = np.array([8.5, 11.5, 15.0, 12.0, 9.5, 2.2])
CROWN = np.array([2.9, 4.3, 1.7, 2.6, 2.3, 1.4])
_BRANCHINESS = (5, 5, 6, 0, 5, 3)


# Templates and trees as compiled code reads them. Template lengths are for a tree of size 1.
BLOB = layout(x="f8", y="f8", z="f8", radius="f8", half="f8")
LIMB = layout(x0="f8", y0="f8", z0="f8", x1="f8", y1="f8", z1="f8", r0="f8", r1="f8", order="f8")
SHAPE = layout(first_blob="i8", last_blob="i8", first_limb="i8", last_limb="i8", reach="f8", top="f8")
TREE = layout(x="f8", y="f8", size="f8", yaw="f8", species="i8", seed="f8")


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
        drift = rng.normal(0, 0.2, (2, 7))
        return np.stack([*drift, h * level, radius, np.full(7, 0.14 * h)], axis=1)
    if species == Species.SHRUB:
        centre = rng.uniform(-0.6, 0.6, (4, 2))
        return np.column_stack([centre, rng.uniform(0.7, 1.3, 4), rng.uniform(0.7, 1.0, 4), rng.uniform(0.6, 0.9, 4)])
    # A dome: a wide ring low down, a narrower one above it, and a top; birches are slimmer and sparser.
    rings = [(6, 0.62, 0.50, 0.42), (5, 0.42, 0.70, 0.46), (2, 0.14, 0.86, 0.42)]
    if species == Species.BIRCH:
        rings = [(4, 0.48, 0.45, 0.52), (4, 0.42, 0.60, 0.54), (3, 0.30, 0.75, 0.48), (2, 0.10, 0.89, 0.36)]
    found = []
    for count, out, level, size in rings:
        turn = 2 * np.pi * (np.arange(count) / count + rng.uniform(0, 1)) + rng.normal(0, 0.2, count)
        reach = r * out * rng.uniform(0.8, 1.15, count)
        radius = r * size * rng.uniform(0.8, 1.2, count)
        lift = h * (level + rng.normal(0, 0.035, count))
        half = radius * rng.uniform(0.75, 1.0, count) * (1.5 if species == Species.BIRCH else 1.0)
        found.append(np.stack([reach * np.cos(turn), reach * np.sin(turn), lift, radius, half], axis=1))
    return np.concatenate(found)


def _limbs(species: Species, rng: np.random.Generator) -> np.ndarray:
    h = HEIGHT[species]
    found: list[tuple] = []

    def grow(start: np.ndarray, heading: np.ndarray, length: float, radius: float, order: int) -> None:
        bend = heading + rng.normal(0, 0.12, 3) + np.array([0, 0, 0.12])
        end = start + length * bend / np.linalg.norm(bend)
        tip = radius * (0.72 if order else 0.8)
        found.append((*start, *end, radius, tip, order))
        if order >= _BRANCHINESS[species]:
            return
        for _ in range(3 if order < 4 else 2):
            spread = 0.55 if species != Species.POPLAR else 0.22
            turned = bend / np.linalg.norm(bend) + rng.normal(0, spread, 3) + np.array([0, 0, 0.1])
            grow(
                start + (end - start) * rng.uniform(0.55, 1.0),
                turned / np.linalg.norm(turned),
                length * rng.uniform(0.6, 0.8),
                max(0.012, tip * rng.uniform(0.5, 0.68)),
                order + 1,
            )

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
    first_blob = np.cumsum([0] + [len(b) for b in blobs])
    first_limb = np.cumsum([0] + [len(m) for m in limbs])
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
