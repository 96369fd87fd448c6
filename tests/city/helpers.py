"""A drive that most tests use, and geometry."""

import dataclasses

import numpy as np
from hypothesis import strategies as st

import artifact_city
from artifact_city import view
from artifact_city.streets import TOTAL_HALF

DRIVE = artifact_city.CityTraversal(
    town=4, route="A2-D2-D4", condition="sun", camera="car", frames=60, spacing=3.0, seed=1
)


PLACE = 35  # a frame of DRIVE in the middle of a street, with facades on both sides


SEEDS = st.integers(0, 2**31)


def under(condition, **changes):
    return dataclasses.replace(DRIVE, condition=condition, **changes)


def grey(image):
    return image.astype(float).mean(axis=2)


def pixels_of(traced):
    """What the first of each pixel's samples sees: code of the surface, (rows, columns)."""
    return traced.surface[:: view.SAMPLES, :: view.SAMPLES].T


def overlap(p, q):
    """How deep two convex polygons overlap, by the theorem of the separating axis; negative is a gap. Metres."""
    depth = np.inf
    for polygon in (p, q):
        edge = np.roll(polygon, -1, axis=0) - polygon
        normal = np.stack([edge[:, 1], -edge[:, 0]], axis=1) / np.linalg.norm(edge, axis=1)[:, None]
        a, b = p @ normal.T, q @ normal.T
        depth = min(depth, np.minimum(a.max(axis=0) - b.min(axis=0), b.max(axis=0) - a.min(axis=0)).min())
    return depth


def pairs_near(first, second):
    """Index pairs of polygons whose bounding boxes meet."""
    low, high = [p.min(axis=1) for p in (first, second)], [p.max(axis=1) for p in (first, second)]
    apart = np.maximum(low[0][:, None] - high[1][None], low[1][None] - high[0][:, None]).max(axis=2)
    return np.argwhere(apart < 0)


def turning(corners):
    edge = np.roll(corners, -1, axis=-2) - corners
    following = np.roll(edge, -1, axis=-2)
    return edge[..., 0] * following[..., 1] - edge[..., 1] * following[..., 0]


def street_strips(plan):
    strips = []
    for a, b in plan.edges():
        p, q = plan.junctions[a], plan.junctions[b]
        u = (q - p) / np.linalg.norm(q - p)
        n = TOTAL_HALF[plan.kind(a, b)] * np.array([-u[1], u[0]])
        strips.append([p - n, q - n, q + n, p + n])
    return np.array(strips)


def outside(buildings, points):
    """Distance of each point from the nearest building, metres; a lower bound near corners, negative inside."""
    return (np.einsum("bkc,nc->nbk", buildings["normal"], points) - buildings["offset"]).max(axis=2).min(axis=1)
