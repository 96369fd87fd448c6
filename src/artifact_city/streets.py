"""The plan of the town: junctions, streets of several kinds, the blocks between them, and the railway around it."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from artifact_city.kernel import layout, records

N_COLUMNS, N_ROWS = 7, 6
COLUMN_NAMES = "ABCDEFG"

OUTER_DEPTH = 30.0  # metres of houses and gardens outside the outermost streets
RAILWAY_DISTANCE = 66.0  # metres from the outermost streets to the track
MARGIN = 150.0  # metres of country around the outermost streets


class Kind(IntEnum):
    """Kinds of street; the values index the tables of widths below."""

    LANE = 0
    STREET = 1
    AVENUE = 2
    CANAL = 3
    RAILWAY = 4
    PATH = 5


# Metres from the axis to the kerb, to the house fronts, and to the water's edge (canals only).
ROAD_HALF = np.array([2.7, 5.2, 7.0, 11.0, 2.3, 1.5])
TOTAL_HALF = np.array([4.6, 8.4, 12.0, 13.6, 2.6, 1.9])
WATER_HALF = np.array([0.0, 0.0, 0.0, 5.6, 0.0, 0.0])
# Metres right of the axis at which cars drive and people walk.
DRIVE_OFFSET = np.array([0.3, 1.6, 3.2, 9.0, 0.0, 0.0])
WALK_OFFSET = np.array([3.6, 6.9, 9.8, 12.4, 0.0, 0.0])

STREET_CAP = 4.0  # metres by which a street reaches past its end junctions


# One straight piece of a street as compiled code reads it: its start, unit direction and length; the distance along the
# whole line at its start; half widths; the half widths of the streets crossed at both ends; the reach beyond both ends.
STREET_PIECE = layout("x y ux uy length start road total water mouth_start mouth_end cap kind:i seed")


@dataclass(frozen=True)
class Block:
    """A convex quadrilateral between streets, corners counter-clockwise, side ``k`` from corner k to k + 1."""

    corners: np.ndarray
    place: tuple[int, int]
    outer: bool = False


@dataclass(frozen=True)
class Plan:
    """Junctions, kinds of street, and what follows from them."""

    seed: int
    junctions: np.ndarray  # (7, 6, 2): metres east and north; junction ``B3`` is ``junctions[1, 2]``
    column_kinds: tuple[Kind, ...]  # of the street along each column (A-G)
    row_kinds: tuple[Kind, ...]  # and along each row (1-6)

    def kind(self, a: tuple[int, int], b: tuple[int, int]) -> Kind:
        """Kind of the street between two neighbouring junctions."""
        return self.column_kinds[a[0]] if a[0] == b[0] else self.row_kinds[a[1]]

    def crossed(self, a: tuple[int, int], b: tuple[int, int]) -> tuple[Kind, Kind]:
        """Kinds of the streets that cross the street between two junctions at its ends."""
        along_row = a[1] == b[1]
        kinds, axis = (self.column_kinds, 0) if along_row else (self.row_kinds, 1)
        return kinds[a[axis]], kinds[b[axis]]

    def axis(self, a: tuple[int, int], b: tuple[int, int]) -> tuple[np.ndarray, float, np.ndarray, np.ndarray]:
        """Start of the street between two junctions, its length, its unit direction, and that to its left."""
        start, delta = self.junctions[a], self.junctions[b] - self.junctions[a]
        length = float(np.linalg.norm(delta))
        along = delta / length
        return start, length, along, np.array([-along[1], along[0]])

    def edges(self) -> list[tuple[tuple[int, int], tuple[int, int]]]:
        """All pairs of neighbouring junctions, rows first, each in the direction of growing coordinates."""
        rows = [((i, j), (i + 1, j)) for j in range(N_ROWS) for i in range(N_COLUMNS - 1)]
        columns = [((i, j), (i, j + 1)) for i in range(N_COLUMNS) for j in range(N_ROWS - 1)]
        return rows + columns


def make_plan(seed: int) -> Plan:
    """Draw the plan of town ``seed``.

    Each town has the same topology, a grid of 7 by 6 streets, so that a route such as ``A2-D2-D4`` exists in every
    one; distances, bends and kinds of street are its own.
    """
    rng = np.random.default_rng([seed, 1])
    x = np.concatenate([[0.0], np.cumsum(rng.uniform(72, 112, N_COLUMNS - 1))])
    y = np.concatenate([[0.0], np.cumsum(rng.uniform(66, 98, N_ROWS - 1))])
    junctions = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
    junctions += np.clip(rng.normal(0, 6.5, junctions.shape), -12, 12)
    inner_columns = rng.permutation([Kind.STREET, Kind.AVENUE, Kind.LANE, Kind.CANAL, Kind.STREET])
    inner_rows = rng.permutation([Kind.STREET, Kind.AVENUE, Kind.LANE, Kind.STREET])
    return Plan(
        seed,
        junctions,
        (Kind.STREET, *map(Kind, inner_columns), Kind.STREET),
        (Kind.STREET, *map(Kind, inner_rows), Kind.STREET),
    )


def street_pieces(plan: Plan, track: np.ndarray, paths: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """List every street piece, the pieces of the railway and the paths of the parks, as records ``STREET_PIECE``."""
    rows = []
    for a, b in plan.edges():
        mouths = ROAD_HALF[list(plan.crossed(a, b))]
        line = 8 * a[0] + a[1] + (100 if a[1] == b[1] else 200)
        rows.append((plan.junctions[a], plan.junctions[b], plan.kind(a, b), 0.0, *mouths, STREET_CAP, line))
    travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(track, axis=0), axis=1))])
    rows += [(track[k], track[k + 1], Kind.RAILWAY, travelled[k], 0.0, 0.0, 0.15, 99) for k in range(len(track) - 1)]
    rows += [(a, b, Kind.PATH, 0.0, 0.0, 0.0, 0.0, 60) for a, b in paths]
    first, last, kind, start, mouth_start, mouth_end, cap, line = (np.array(c) for c in zip(*rows, strict=True))
    length = np.linalg.norm(last - first, axis=1)
    (x, y), (ux, uy) = first.T, (last - first).T / length
    seed, road, total, water = line + 1000 * plan.seed, ROAD_HALF[kind], TOTAL_HALF[kind], WATER_HALF[kind]
    columns = x, y, ux, uy, length, start, road, total, water, mouth_start, mouth_end, cap, kind, seed
    return records(STREET_PIECE, dict(zip(STREET_PIECE.names, columns, strict=True)))


def meet(p: np.ndarray, u: np.ndarray, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Point where the line through ``p`` along ``u`` meets the line through ``q`` along ``v``.

    >>> import numpy as np
    >>> meet(np.array([0.0, 1.0]), np.array([1.0, 0.0]), np.array([3.0, 0.0]), np.array([0.0, 1.0]))
    array([3., 1.])
    """
    cross = u[0] * v[1] - u[1] * v[0]
    w = q - p
    return p + u * ((w[0] * v[1] - w[1] * v[0]) / cross)


def sides(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lengths, unit directions and outward normals of the sides of counter-clockwise polygons, (..., n, 2)."""
    direction = np.roll(corners, -1, axis=-2) - corners
    length = np.linalg.norm(direction, axis=-1)
    unit = direction / length[..., None]
    return length, unit, np.stack([unit[..., 1], -unit[..., 0]], axis=-1)


def inset(corners: np.ndarray, distances: tuple[float, ...] | np.ndarray) -> np.ndarray:
    """Move each side of a counter-clockwise convex polygon inwards by its own distance; a negative one is outwards.

    >>> import numpy as np
    >>> inset(np.array([[0.0, 0], [4, 0], [4, 3], [0, 3]]), (1, 0, 1, 0)).tolist()
    [[0.0, 1.0], [4.0, 1.0], [4.0, 2.0], [0.0, 2.0]]
    """
    _, unit, outward = sides(corners)
    moved = corners - outward * np.asarray(distances, dtype=float)[:, None]
    return np.array([meet(moved[k - 1], unit[k - 1], moved[k], unit[k]) for k in range(len(corners))])


def blocks(plan: Plan) -> list[Block]:
    """Return the blocks between the streets, then the strips of houses outside the outermost streets."""
    found = []
    for i in range(N_COLUMNS - 1):
        for j in range(N_ROWS - 1):
            ring = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)]
            sides = tuple(plan.kind(ring[k], ring[(k + 1) % 4]) for k in range(4))
            corners = np.array([plan.junctions[c] for c in ring])
            found.append(Block(inset(corners, TOTAL_HALF[list(sides)]), (i, j)))
    return found + _outer_blocks(plan)


def _outer_blocks(plan: Plan) -> list[Block]:
    last_column, last_row = N_COLUMNS - 1, N_ROWS - 1
    # In this order the outside lies to the right of a -> b, so that b -> a is a block's front side.
    outline = [((i, 0), (i + 1, 0)) for i in range(last_column)]
    outline += [((last_column, j), (last_column, j + 1)) for j in range(last_row)]
    outline += [((i + 1, last_row), (i, last_row)) for i in reversed(range(last_column))]
    outline += [((0, j + 1), (0, j)) for j in reversed(range(last_row))]
    found = []
    for a, b in outline:
        start, length, along, left = plan.axis(a, b)
        near = -TOTAL_HALF[Kind.STREET] * left
        far = near - OUTER_DEPTH * left
        # A trim at both ends keeps neighbouring strips apart where the outline bends outwards or inwards.
        p, q = start + 3.0 * along, start + (length - 3.0) * along
        corners = np.array([q + near, p + near, p + far, q + far])
        found.append(Block(corners, a, outer=True))
    return found


def railway(plan: Plan, spacing: float) -> np.ndarray:
    """Return the closed track around the town as points ``spacing`` metres apart, shape (n, 2), counter-clockwise.

    A rounded rectangle with slow bends, so that no two stretches of line look into the same distance.
    """
    low = plan.junctions.reshape(-1, 2).min(axis=0) - RAILWAY_DISTANCE
    high = plan.junctions.reshape(-1, 2).max(axis=0) + RAILWAY_DISTANCE
    radius = 95.0
    (x0, y0), (x1, y1) = low + radius, high - radius
    points = []
    for x, y, turn in ((x1, y0, -0.25), (x1, y1, 0.0), (x0, y1, 0.25), (x0, y0, 0.5)):
        angle = 2 * np.pi * np.linspace(turn, turn + 0.25, 40)
        points.append(np.stack([x + radius * np.cos(angle), y + radius * np.sin(angle)], axis=1))
    ring = resample(np.concatenate([*points, points[0][:1]]), 2.0)
    phase = np.random.default_rng([plan.seed, 2]).uniform(0, 2 * np.pi, 3)
    turn = np.linspace(0, 2 * np.pi, len(ring))
    tangent = np.gradient(ring, axis=0)
    normal = np.stack([tangent[:, 1], -tangent[:, 0]], axis=1) / np.linalg.norm(tangent, axis=1)[:, None]
    wave = 5.0 * np.sin(5 * turn + phase[0]) + 3.0 * np.sin(9 * turn + phase[1]) + 4.0 * np.sin(3 * turn + phase[2])
    wave -= np.linspace(0, 1, len(ring)) * (wave[-1] - wave[0])
    return resample(ring + wave[:, None] * normal, spacing)


def resample(points: np.ndarray, spacing: float) -> np.ndarray:
    """Return points at equal distances along a polyline, from its first point to its last.

    >>> import numpy as np
    >>> resample(np.array([[0.0, 0], [1, 0], [1, 1]]), 0.5).tolist()
    [[0.0, 0.0], [0.5, 0.0], [1.0, 0.0], [1.0, 0.5], [1.0, 1.0]]
    """
    travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    count = max(1, round(travelled[-1] / spacing)) + 1
    at = np.linspace(0, travelled[-1], count)
    return np.stack([np.interp(at, travelled, points[:, k]) for k in range(2)], axis=1)
