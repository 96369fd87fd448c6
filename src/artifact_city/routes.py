"""Where cameras go: drives along named junctions, the railway, every street of the town, or scattered places."""

import itertools
import re
from dataclasses import dataclass

import numpy as np

from artifact_city.buildings import roof_at
from artifact_city.streets import (
    COLUMN_NAMES,
    DRIVE_OFFSET,
    N_COLUMNS,
    N_ROWS,
    ROAD_HALF,
    TOTAL_HALF,
    WALK_OFFSET,
    Kind,
    Plan,
    meet,
    resample,
)
from artifact_city.view import Pose

RAILWAY, STREETS, PLACES = "railway", "all streets", "places"
_STEP = 0.25  # metres between the points of a path


@dataclass(frozen=True)
class Path:
    """A smooth line to drive along, as points a quarter of a metre apart."""

    points: np.ndarray
    headings: np.ndarray
    kinds: np.ndarray

    @property
    def length(self) -> float:
        """Metres from start to end."""
        return (len(self.points) - 1) * self.step

    @property
    def step(self) -> float:
        """Metres between points."""
        return float(np.linalg.norm(np.diff(self.points, axis=0), axis=1).mean())

    def at(self, distance: float) -> tuple[float, float, float, Kind]:
        """Position, heading and kind of street after a distance in metres; the ends continue straight."""
        place = min(max(distance / self.step, 0.0), len(self.points) - 1.001)
        k, part = int(place), place - int(place)
        x, y = self.points[k] + part * (self.points[k + 1] - self.points[k])
        heading = self.headings[k] + part * (self.headings[k + 1] - self.headings[k])
        return float(x), float(y), float(heading), Kind(self.kinds[k])


def junctions_of(route: str) -> list[tuple[int, int]]:
    """Read a route such as ``A2-D2-D4`` and list every junction on it.

    Raises
    ------
    ValueError
        If the route is not a chain of junctions, or a leg does not follow a street or turns round in it.

    Examples
    --------
    >>> junctions_of("A2-C2-C1")
    [(0, 1), (1, 1), (2, 1), (2, 0)]
    """
    names = route.split("-")
    if len(names) < 2 or not all(re.fullmatch(rf"[A-{COLUMN_NAMES[-1]}][1-{N_ROWS}]", name) for name in names):
        raise ValueError(
            f"route {route!r} is not known; write junctions from A1 to {COLUMN_NAMES[N_COLUMNS - 1]}{N_ROWS} such as "
            f"'A2-D2-D4', or one of {RAILWAY!r}, {STREETS!r}, {PLACES!r}"
        )
    stops = [(COLUMN_NAMES.index(name[0]), int(name[1]) - 1) for name in names]
    found = [stops[0]]
    for name, a, b in zip(names[1:], stops, stops[1:], strict=False):
        if a == b or (a[0] != b[0] and a[1] != b[1]):
            raise ValueError(
                f"route {route!r}: the leg to {name} does not follow a street (same letter or same number)"
            )
        if len(found) > 1 and _towards(a, b) == _towards(a, found[-2]):
            raise ValueError(f"route {route!r}: the leg to {name} turns round in the street")
        while found[-1] != b:
            step = _towards(found[-1], b)
            found.append((found[-1][0] + step[0], found[-1][1] + step[1]))
    return found


def _towards(a: tuple[int, int], b: tuple[int, int]) -> tuple[int, int]:
    """Direction from one junction to another, each coordinate -1, 0 or 1."""
    return int(np.sign(b[0] - a[0])), int(np.sign(b[1] - a[1]))


def drive_path(plan: Plan, route: str, lateral: str) -> Path:
    """Lay a path along a route: in the right ``lane`` or on the right ``pavement``; cars swing wide round corners."""
    stops = junctions_of(route)
    offsets, radius = (DRIVE_OFFSET, 8.0) if lateral == "lane" else (WALK_OFFSET, 1.2)
    kinds, lines = [plan.kind(a, b) for a, b in itertools.pairwise(stops)], []
    for (a, b), kind in zip(itertools.pairwise(stops), kinds, strict=True):
        p, length, u, left = plan.axis(a, b)
        start = p - offsets[kind] * left
        lines.append((start, start + length * u, u))
    vertices = [lines[0][0]]
    for (_, end, u), (start, _, v) in itertools.pairwise(lines):
        straight = abs(u[0] * v[1] - u[1] * v[0]) < 0.02
        vertices.append((end + start) / 2 if straight else meet(end, u, start, v))
    vertices.append(lines[-1][1])
    pieces, of_piece = [vertices[0][None]], [np.array([kinds[0]])]
    for k in range(1, len(vertices) - 1):
        before, here, after = vertices[k - 1 : k + 2]
        r = min(radius, 0.4 * float(np.linalg.norm(here - before)), 0.4 * float(np.linalg.norm(after - here)))
        a = here + r * (before - here) / np.linalg.norm(before - here)
        b = here + r * (after - here) / np.linalg.norm(after - here)
        t = np.linspace(0, 1, 24)[:, None]
        curve = (1 - t) ** 2 * a + 2 * t * (1 - t) * here + t**2 * b
        pieces.append(curve)
        of_piece.append(np.repeat([kinds[k - 1], kinds[k]], 12))
    pieces.append(vertices[-1][None])
    of_piece.append(np.array([kinds[-1]]))
    return _smooth_path(np.concatenate(pieces), np.concatenate(of_piece), 10 if lateral == "lane" else 14)


def _smooth_path(points: np.ndarray, kinds: np.ndarray, reach: int) -> Path:
    fine = resample(points, _STEP)
    travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    at = np.linspace(0, travelled[-1], len(fine))
    kind = kinds[np.clip(np.searchsorted(travelled, at, side="right") - 1, 0, len(kinds) - 1)]
    turn = np.unwrap(np.arctan2(*np.diff(fine, axis=0).T[::-1]))
    turn = np.concatenate([turn, turn[-1:]])
    window = np.hanning(2 * reach + 3)[1:-1]
    padded = np.concatenate([np.full(reach, turn[0]), turn, np.full(reach, turn[-1])])
    return Path(fine, np.convolve(padded, window / window.sum(), mode="valid"), kind)


def railway_path(track: np.ndarray) -> Path:
    """Lay a path along the track."""
    return _smooth_path(track, np.full(len(track), Kind.RAILWAY), 16)


def street_poses(plan: Plan, spacing: float) -> list[Pose]:
    """Stand in the right lane of every street of the town, every ``spacing`` metres, once in each direction.

    The order follows the streets, first all rows, then all columns; each place is seen forwards, then backwards.
    """
    poses = []
    for a, b in plan.edges():
        p, length, u, left = plan.axis(a, b)
        heading = float(np.arctan2(u[1], u[0]))
        across = -DRIVE_OFFSET[plan.kind(a, b)] * left
        for s in np.arange(spacing / 2, length, spacing):
            for turned in (1.0, -1.0):
                x, y = p + s * u + turned * across
                poses.append(Pose(float(x), float(y), heading if turned > 0 else heading + np.pi))
    return poses


def place_poses(plan: Plan, buildings: np.ndarray, count: int) -> list[Pose]:
    """Choose places all over the town, and a view worth a photograph at each.

    Each pose stands on a pavement or a quay and looks obliquely across its street; it keeps its distance from walls,
    and from the other places unless it looks another way.
    """
    rng = np.random.default_rng([plan.seed, 21])
    corners = buildings["corners"]
    centre = corners.mean(axis=1)
    reach = np.linalg.norm(corners - centre[:, None], axis=2).max(axis=1)
    edges = plan.edges()
    found: list[Pose] = []
    for _ in range(60 * count):
        if len(found) == count:
            return found
        a, b = edges[int(rng.integers(len(edges)))]
        kind = plan.kind(a, b)
        p, length, u, left = plan.axis(a, b)
        normal = left if rng.random() < 0.5 else -left
        away = rng.uniform(ROAD_HALF[kind] - 0.5, TOTAL_HALF[kind] - 1.0) if kind != Kind.CANAL else 12.5
        at = p + rng.uniform(0.04, 0.96) * length * u + away * normal
        tilt = np.radians(rng.uniform(18, 72)) * (1 if rng.random() < 0.5 else -1)
        heading = float(np.arctan2(-normal[1], -normal[0]) + tilt)
        if any(np.hypot(o.x - at[0], o.y - at[1]) < 24 and np.cos(o.heading - heading) > 0.0 for o in found):
            continue
        near = np.flatnonzero(np.linalg.norm(centre - at, axis=1) < reach + 9.0)
        ahead = at + np.array([np.cos(heading), np.sin(heading)]) * np.arange(-1.5, 8.0, 0.75)[:, None]
        around = at + 2.6 * np.stack([np.cos(np.arange(8) * 0.785), np.sin(np.arange(8) * 0.785)], axis=1)
        spots = np.concatenate([ahead, around])
        if any(roof_at(buildings[k], x, y) > 0 for k in near for x, y in spots):
            continue
        found.append(Pose(float(at[0]), float(at[1]), heading))
    raise ValueError(f"town {plan.seed} has room for {len(found)} places only; ask for at most that many frames")
