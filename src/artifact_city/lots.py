"""From blocks to lots to houses: which buildings stand where."""

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
from artifact_city.streets import (
    N_COLUMNS,
    N_ROWS,
    TOTAL_HALF,
    WATER_HALF,
    Block,
    Kind,
    Plan,
    blocks,
    inset,
    meet,
    sides,
)

HEDGE = {"material": Material.HEDGE, "wall": (0.035, 0.06, 0.02), "roof": (0.04, 0.07, 0.02)}


# What the ground is between the streets.
Zone = IntEnum("Zone", "FIELD GARDEN COURT SQUARE PARK", start=0)


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
    roomy = sorted((b for b in found if not b.outer and _is_central(b)), key=lambda b: -_shortest_side(b))
    square = roomy[int(rng.integers(2))]
    park = next(b for b in roomy if _apart(b, square) >= 2)
    sites = []
    for index, block in enumerate(found):
        rng, zone = np.random.default_rng([plan.seed, 4, index]), Zone.GARDEN
        if block is square:
            zone, buildings = Zone.SQUARE, _square(block, rng)
        elif block is park:
            zone, buildings = Zone.PARK, _park(block, rng)
        elif block.outer or (character := _character(block, square, rng)) == "villas":
            buildings = _villas(block, rng)
        else:
            zone = Zone.COURT if rng.random() < 0.5 else Zone.GARDEN
            buildings = _perimeter(block, character, rng)
        sites.append(Site(block, zone, tuple(buildings)))
    return sites


def _is_central(block: Block) -> bool:
    i, j = block.place
    return 1 <= i <= N_COLUMNS - 3 and 1 <= j <= N_ROWS - 3


def _apart(a: Block, b: Block) -> int:
    return abs(a.place[0] - b.place[0]) + abs(a.place[1] - b.place[1])


def _shortest_side(block: Block) -> float:
    return float(sides(block.corners)[0].min())


def _character(block: Block, square: Block, rng: np.random.Generator) -> str:
    at_edge = block.place[0] in (0, N_COLUMNS - 2) or block.place[1] in (0, N_ROWS - 2)
    if _apart(block, square) == 1:
        return "old" if rng.random() < 0.7 else "tenement"
    if at_edge:
        return str(rng.choice(["villas", "terrace", "tenement", "modern"], p=[0.5, 0.3, 0.1, 0.1]))
    return str(rng.choice(CHARACTERS, p=[0.3, 0.25, 0.3, 0.15]))


_WIDTHS = {"old": (5.2, 9.0), "terrace": (5.5, 7.5), "tenement": (11.0, 18.0), "modern": (14.0, 26.0)}
_DEPTHS = {"old": 10.5, "terrace": 9.5, "tenement": 12.5, "modern": 13.0}


def _lots(strip: np.ndarray, low: float, high: float, rng: np.random.Generator) -> list[np.ndarray]:
    """Cut a strip (front start, front end, back end, back start) into lots between ``low`` and ``high`` metres wide."""
    p0, p1, q1, q0 = strip
    count = max(1, round(float(np.linalg.norm(p1 - p0)) / rng.uniform(low, high)))
    widths = rng.uniform(low, high, count)
    cuts = np.concatenate([[0.0], np.cumsum(widths) / widths.sum()])[:, None]
    front, back = p0 + cuts * (p1 - p0), q0 + cuts * (q1 - q0)
    return [np.array([front[k], front[k + 1], back[k + 1], back[k]]) for k in range(count)]


def _strips(corners: np.ndarray, depth: float) -> list[tuple[np.ndarray, bool, bool]]:
    """Divide the rim of a block into four strips that do not overlap.

    Each is (front start, front end, back end, back start) with whether its ends face a street too: the two
    longer opposite sides run through, the others fit between them.
    """
    inner = inset(corners, (depth,) * 4)
    length = sides(corners)[0]
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
    for strip, open_start, open_end in _strips(block.corners, _DEPTHS[character]):
        lots = _lots(strip, *_WIDTHS[character], rng)
        for k, corners in enumerate(lots):
            first, last = k == 0 and open_start, k == len(lots) - 1 and open_end
            if not first and not last and rng.random() < 0.06:
                found.append(_yard_wall(corners, rng))
                continue
            own = character if rng.random() < 0.8 else str(rng.choice(CHARACTERS))
            house = town_house(rng, corners, own, (True, last, False, first))
            found.append(replace(house, tags=house.tags | {own}))
    return found


def _yard_wall(corners: np.ndarray, rng: np.random.Generator) -> Building:
    a, b = corners[:2] - 0.35 * sides(corners)[2][0]
    look = {"material": Material.BRICK, "wall": choose(rng, palette.BRICK), "accent": choose(rng, palette.DOOR)}
    if np.linalg.norm(b - a) > 5:
        look |= {"ground": Ground.GATE, "ground_height": 2.6}
    height, seed = float(rng.uniform(2.0, 2.8)), int(rng.integers(1 << 30))
    return wall_between(a, b, 0.5, height=height, seed=seed, tags=frozenset({"wall"}), **look)


def _villas(block: Block, rng: np.random.Generator) -> list[Building]:
    """Build villas in gardens: all round a block, or along an outer one."""
    strips = [(block.corners, False, False)]
    if not block.outer:
        strips = _strips(block.corners, min(23.0, 0.46 * _shortest_side(block)))
    return [b for strip, _, _ in strips for lot in _lots(strip, 14.0, 21.0, rng) for b in _villa_lot(lot, rng)]


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
    length, along, outward = sides(block.corners)
    longest = int(np.argmax(length[:2]))
    yaw = float(np.arctan2(*along[longest][::-1])) + np.pi * int(rng.integers(2))
    return church(rng, block.corners.mean(axis=0) + outward[longest] * rng.uniform(-3, 3), yaw)


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
        p, length, along, left = plan.axis(a, b)
        before, after = TOTAL_HALF[list(plan.crossed(a, b))] + 0.4
        start, end = p + before * along, p + (length - after) * along
        shore = WATER_HALF[Kind.CANAL] + 0.25
        shared = {"height": 0.75, "wall": palette.STONE[2], "roof": palette.STONE[3], "material": Material.STONE}
        shared |= {"seed": plan.seed, "tags": frozenset({"wall"})}
        ends = [(start + side * shore * left, end + side * shore * left) for side in (-1, 1)]
        ends += [(x - (shore - 0.3) * left, x + (shore - 0.3) * left) for x in (start, end)]
        found += [wall_between(u, v, 0.4, **shared) for u, v in ends]
    return found
