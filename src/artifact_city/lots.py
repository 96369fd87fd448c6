"""From blocks to lots to houses: which buildings stand where."""

import itertools
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np

from artifact_city import palette
from artifact_city.buildings import (
    CHARACTERS,
    Building,
    Ground,
    Material,
    Windows,
    church,
    rectangle,
    town_house,
    villa,
    wall_between,
)
from artifact_city.palette import choose
from artifact_city.streets import N_COLUMNS, N_ROWS, TOTAL_HALF, WATER_HALF, Block, Kind, Plan, blocks, inset, meet

HEDGE = {"material": Material.HEDGE, "wall": (0.035, 0.06, 0.02), "roof": (0.04, 0.07, 0.02)}


class Zone(IntEnum):
    """What the ground is between the streets; the compiled ground code knows the values."""

    FIELD = 0
    GARDEN = 1
    COURT = 2
    SQUARE = 3
    PARK = 4


@dataclass(frozen=True)
class Site:
    """A block with what it has become."""

    block: Block
    zone: Zone
    buildings: tuple[Building, ...]


def build_sites(plan: Plan) -> list[Site]:
    """Decide what each block of a plan becomes, and build it."""
    found = blocks(plan)
    rng = np.random.default_rng([plan.seed, 3])
    inner = [b for b in found if not b.outer]
    roomy = sorted((b for b in inner if _is_central(b)), key=lambda b: -_shortest_side(b))
    square = roomy[int(rng.integers(2))]
    park = next(b for b in roomy if _apart(b, square) >= 2)
    sites = []
    for index, block in enumerate(found):
        rng = np.random.default_rng([plan.seed, 4, index])
        if block is square:
            sites.append(Site(block, Zone.SQUARE, tuple(_square(block, rng))))
        elif block is park:
            sites.append(Site(block, Zone.PARK, tuple(_park(block, rng))))
        elif block.outer:
            sites.append(Site(block, Zone.GARDEN, tuple(_villas(block, rng, sides=(0,)))))
        else:
            character = _character(block, square, rng)
            zone = Zone.COURT if rng.random() < 0.5 and character != "villas" else Zone.GARDEN
            houses = _villas(block, rng) if character == "villas" else _perimeter(block, character, rng)
            sites.append(Site(block, zone, tuple(houses)))
    return sites


def _is_central(block: Block) -> bool:
    i, j = block.place
    return 1 <= i <= N_COLUMNS - 3 and 1 <= j <= N_ROWS - 3


def _apart(a: Block, b: Block) -> int:
    return abs(a.place[0] - b.place[0]) + abs(a.place[1] - b.place[1])


def _shortest_side(block: Block) -> float:
    return float(np.linalg.norm(np.roll(block.corners, -1, axis=0) - block.corners, axis=1).min())


def _character(block: Block, square: Block, rng: np.random.Generator) -> str:
    at_edge = block.place[0] in (0, N_COLUMNS - 2) or block.place[1] in (0, N_ROWS - 2)
    if _apart(block, square) == 1:
        return "old" if rng.random() < 0.7 else "tenement"
    if at_edge:
        return str(rng.choice(["villas", "terrace", "tenement", "modern"], p=[0.5, 0.3, 0.1, 0.1]))
    return str(rng.choice(CHARACTERS, p=[0.3, 0.25, 0.3, 0.15]))


_WIDTHS = {"old": (5.2, 9.0), "terrace": (5.5, 7.5), "tenement": (11.0, 18.0), "modern": (14.0, 26.0)}
_DEPTHS = {"old": 10.5, "terrace": 9.5, "tenement": 12.5, "modern": 13.0}


def _cuts(length: float, low: float, high: float, rng: np.random.Generator) -> np.ndarray:
    """Cut [0, 1] into lots whose widths lie roughly between ``low`` and ``high`` metres."""
    count = max(1, round(length / rng.uniform(low, high)))
    widths = rng.uniform(low, high, count)
    return np.concatenate([[0.0], np.cumsum(widths) / widths.sum()])


def _strips(corners: np.ndarray, depth: float) -> list[tuple[np.ndarray, bool, bool]]:
    """Divide the rim of a block into four strips that do not overlap.

    Each is (front start, front end, back end, back start) with whether its ends face a street too: the two
    longer opposite sides run through, the others fit between them.
    """
    inner = inset(corners, (depth,) * 4)
    length = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    through = (0, 2) if length[0] + length[2] >= length[1] + length[3] else (1, 3)
    strips = []
    for k in range(4):
        a, b, before, after = k, (k + 1) % 4, k - 1, (k + 2) % 4
        u, v = corners[b] - corners[a], inner[b] - inner[a]
        if k in through:
            before_side, after_side = corners[a] - corners[before], corners[after] - corners[b]
            back = meet(inner[a], v, corners[b], after_side), meet(inner[a], v, corners[a], before_side)
            strips.append((np.array([corners[a], corners[b], *back]), True, True))
        else:
            start = meet(corners[a], u, inner[a], inner[a] - inner[before])
            end = meet(corners[a], u, inner[b], inner[after] - inner[b])
            strips.append((np.array([start, end, inner[b], inner[a]]), False, False))
    return strips


def _perimeter(block: Block, character: str, rng: np.random.Generator) -> list[Building]:
    found = []
    low, high = _WIDTHS[character]
    for strip, open_start, open_end in _strips(block.corners, _DEPTHS[character]):
        p0, p1, q1, q0 = strip
        cuts = _cuts(float(np.linalg.norm(p1 - p0)), low, high, rng)
        for k, (a, b) in enumerate(itertools.pairwise(cuts)):
            first, last = k == 0 and open_start, k == len(cuts) - 2 and open_end
            corners = np.array([p0 + a * (p1 - p0), p0 + b * (p1 - p0), q0 + b * (q1 - q0), q0 + a * (q1 - q0)])
            if not first and not last and rng.random() < 0.06:
                found.append(_yard_wall(corners, rng))
                continue
            own = character if rng.random() < 0.8 else str(rng.choice(CHARACTERS))
            house = town_house(rng, corners, own, (True, last, False, first))
            found.append(replace(house, tags=house.tags | {own}))
    return found


def _yard_wall(corners: np.ndarray, rng: np.random.Generator) -> Building:
    front = np.array([corners[0], corners[1]])
    inwards = (corners[3] - corners[0]) / np.linalg.norm(corners[3] - corners[0])
    a, b = front + 0.35 * inwards
    look = {"material": Material.BRICK, "wall": choose(rng, palette.BRICK), "accent": choose(rng, palette.DOOR)}
    if np.linalg.norm(b - a) > 5:
        look |= {"ground": Ground.GATE, "ground_height": 2.6}
    height, seed = float(rng.uniform(2.0, 2.8)), int(rng.integers(1 << 30))
    return wall_between(a, b, 0.5, height=height, seed=seed, tags=frozenset({"wall"}), **look)


def _villas(block: Block, rng: np.random.Generator, sides: tuple[int, ...] = (0, 1, 2, 3)) -> list[Building]:
    found = []
    depth = 23.0 if not block.outer else float(np.linalg.norm(block.corners[3] - block.corners[0]))
    depth = min(depth, 0.46 * _shortest_side(block)) if not block.outer else depth
    strips = _strips(block.corners, depth) if not block.outer else [(block.corners, False, False)]
    for k in sides:
        p0, p1, q1, q0 = strips[k][0]
        cuts = _cuts(float(np.linalg.norm(p1 - p0)), 14.0, 21.0, rng)
        for a, b in itertools.pairwise(cuts):
            lot = np.array([p0 + a * (p1 - p0), p0 + b * (p1 - p0), q0 + b * (q1 - q0), q0 + a * (q1 - q0)])
            found += _villa_lot(lot, rng)
    return found


def _villa_lot(lot: np.ndarray, rng: np.random.Generator) -> list[Building]:
    width, depth = float(np.linalg.norm(lot[1] - lot[0])), float(np.linalg.norm(lot[3] - lot[0]))
    setback, side = float(rng.uniform(3.0, 6.0)), rng.uniform(0.1, 0.24, 2) * width
    house_depth = min(float(rng.uniform(7.5, 10.5)), depth - setback - 3.0)
    plot = inset(lot, (setback, float(side[0]), max(2.0, depth - setback - house_depth), float(side[1])))
    found = [villa(rng, plot)]
    style = rng.random()
    if style > 0.85:
        return found
    if style < 0.3:
        thickness, fence = 0.15, {"material": Material.FENCE, "wall": choose(rng, palette.SIDING), "height": 1.0}
    elif style < 0.5:
        thickness, fence = 0.45, {"material": Material.BRICK, "wall": choose(rng, palette.BRICK), "height": 0.9}
    else:
        thickness, fence = 0.45, {**HEDGE, "height": float(rng.uniform(0.8, 1.5))}
    along, inwards = (lot[1] - lot[0]) / width, (lot[3] - lot[0]) / depth
    start, end = lot[0] + 0.3 * inwards, lot[1] + 0.3 * inwards
    gate = float(rng.uniform(0.25, 0.75)) * width
    shared = {"seed": int(rng.integers(1 << 30)), "tags": frozenset({"fence"}), **fence}
    for a, b in (
        (0.2 * along + start, start + (gate - 1.6) * along),
        (start + (gate + 1.6) * along, end - 0.2 * along),
    ):
        if (b - a) @ along > 0.6:
            found.append(wall_between(a, b, thickness, **shared))
    return found


def _square(block: Block, rng: np.random.Generator) -> list[Building]:
    length = np.linalg.norm(np.roll(block.corners, -1, axis=0) - block.corners, axis=1)
    longest = int(np.argmax(length[:2]))
    along = block.corners[longest + 1] - block.corners[longest]
    yaw = float(np.arctan2(along[1], along[0])) + np.pi * int(rng.integers(2))
    across = np.array([-np.sin(yaw), np.cos(yaw)])
    return church(rng, block.corners.mean(axis=0) + across * rng.uniform(-3, 3), yaw)


def _park(block: Block, rng: np.random.Generator) -> list[Building]:
    """Build a pavilion, and hedges around it with an entrance in the middle of each side."""
    centre = block.corners.mean(axis=0) + rng.uniform(-8, 8, 2)
    pavilion = Building(
        rectangle(centre, float(rng.uniform(0, np.pi)), 7.5, 5.5),
        3.2,
        choose(rng, palette.SIDING),
        Material.SIDING,
        slope=(float(rng.uniform(0.5, 0.8)),) * 4,
        cap=9.0,
        roof=choose(rng, palette.ROOF),
        windows=Windows.CROSS,
        ground=Ground.HOUSE,
        fronts=(True,) * 4,
        seed=int(rng.integers(1 << 30)),
        tags=frozenset({"landmark"}),
    )
    ring, hedge = inset(block.corners, (0.8,) * 4), {**HEDGE, "height": 1.1, "tags": frozenset({"fence"})}
    sides = [(ring[k], ring[(k + 1) % 4] - ring[k]) for k in range(4)]
    ends = ((0.1, 0.44), (0.56, 0.9))
    return [pavilion] + [wall_between(a + s * d, a + t * d, 0.8, **hedge) for a, d in sides for s, t in ends]


def canal_walls(plan: Plan) -> list[Building]:
    """Low walls along the water, interrupted at the bridges."""
    found = []
    for a, b in plan.edges():
        if plan.kind(a, b) is not Kind.CANAL:
            continue
        across = plan.row_kinds if a[0] == b[0] else plan.column_kinds
        axis = 1 if a[0] == b[0] else 0
        p, q = plan.junctions[a], plan.junctions[b]
        along = (q - p) / np.linalg.norm(q - p)
        left = np.array([-along[1], along[0]])
        start = p + along * (TOTAL_HALF[across[a[axis]]] + 0.4)
        end = q - along * (TOTAL_HALF[across[b[axis]]] + 0.4)
        shore = WATER_HALF[Kind.CANAL] + 0.25
        shared = {"height": 0.75, "wall": palette.STONE[2], "roof": palette.STONE[3], "material": Material.STONE}
        shared |= {"seed": plan.seed, "tags": frozenset({"wall"})}
        ends = [(start + side * shore * left, end + side * shore * left) for side in (-1, 1)]
        ends += [(x - (shore - 0.3) * left, x + (shore - 0.3) * left) for x in (start, end)]
        found += [wall_between(u, v, 0.4, **shared) for u, v in ends]
    return found
