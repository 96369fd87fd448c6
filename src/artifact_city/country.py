"""The country along the railway: farms, walls, cuttings, bridges, a station, fields with trees."""

import itertools
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from artifact_city import palette
from artifact_city.buildings import Building, Ground, Material, Windows, rectangle, villa, wall_between
from artifact_city.lots import HEDGE
from artifact_city.models import Collector, ThingList
from artifact_city.palette import choose
from artifact_city.streets import OUTER_DEPTH, TOTAL_HALF, Kind, Plan
from artifact_city.trees import CROWN, Species


@dataclass(frozen=True)
class Line:
    """The track's points with their unit tangents and outward normals (away from the town)."""

    points: np.ndarray
    tangent: np.ndarray
    outward: np.ndarray

    def beside(self, k: int, distance: float) -> np.ndarray:
        """Point ``distance`` metres outward of track point ``k``; negative is towards the town."""
        return self.points[k] + distance * self.outward[k]

    def yaw(self, k: int) -> float:
        """Heading of the track at a point."""
        return float(np.arctan2(self.tangent[k, 1], self.tangent[k, 0]))


def line_of(track: np.ndarray) -> Line:
    """Derive directions from the points of a track that runs counter-clockwise round the town."""
    tangent = np.gradient(track, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    return Line(track, tangent, np.stack([tangent[:, 1], -tangent[:, 0]], axis=1))


def country_buildings(plan: Plan, track: np.ndarray) -> list[Building]:
    """Build farms, barns, lineside walls, cuttings, bridge abutments and a station.

    Nothing stands closer to the track than its clearance, and none of them overlap.
    """
    rng = np.random.default_rng([plan.seed, 5])
    line, last = line_of(track), len(track) - 4
    wanted = [_station(line, int(rng.integers(last // 3, last // 2)), rng)]
    wanted += [_bridge(line, int(k), rng) for k in rng.integers(8, last, 7)]
    at = 3
    while at < last:
        wanted.append([_farm(line, at, rng)])
        at += int(rng.integers(3, 9))
    for side in (-1.0, 1.0):
        at = 2
        while at < last:
            steps = int(rng.integers(3, 10))
            if rng.random() < 0.62:
                wanted.append(_lineside(line, at, min(at + steps, last), side, rng))
            at += steps + int(rng.integers(0, 6))
    found: list[Building] = []
    centres, reaches = np.zeros((0, 2)), np.zeros(0)
    for group in wanted:
        middle = np.array([b.corners.mean(axis=0) for b in group])
        reach = np.array([np.linalg.norm(b.corners - b.corners.mean(axis=0), axis=1).max() for b in group])
        gaps = np.linalg.norm(middle[:, None] - centres[None], axis=2) - reach[:, None] - reaches[None]
        if (gaps > 0).all():
            found += group
            centres, reaches = np.concatenate([centres, middle]), np.concatenate([reaches, reach])
    return found


def _farm(line: Line, k: int, rng: np.random.Generator) -> Building:
    distance = float(rng.uniform(10, 34)) if rng.random() < 0.7 else -float(rng.uniform(9.5, 14))
    yaw = line.yaw(k) + float(rng.normal(0, 0.35))
    size = float(rng.uniform(7, 13)), float(rng.uniform(6, 8))
    house = villa(rng, rectangle(line.beside(k, distance), yaw, *size))
    if rng.random() < 0.3:
        red = rng.random() < 0.6
        wall = np.array([0.22, 0.035, 0.025] if red else [0.16, 0.13, 0.1])
        barn = replace(house, wall=wall, material=Material.SIDING, ornament=0, height=4.5)
        return replace(barn, windows=Windows.NONE, ground=Ground.GATE, ground_height=3.6)
    return house


def _lineside(line: Line, start: int, stop: int, side: float, rng: np.random.Generator) -> list[Building]:
    style = rng.random()
    distance = float(rng.uniform(5.0, 7.5)) * side
    shared: dict = {"seed": int(rng.integers(1 << 30)), "tags": frozenset({"wall"})}
    thickness = 0.5
    if style < 0.3:
        shared |= {"height": float(rng.uniform(0.9, 1.8)), **HEDGE}
        thickness = 0.9
    elif style < 0.55:
        shared |= {"height": 1.15, "material": Material.FENCE, "wall": choose(rng, palette.SIDING)}
        thickness = 0.12
    elif style < 0.8:
        wall = choose(rng, palette.STONE)
        shared |= {"height": float(rng.uniform(0.8, 1.4)), "material": Material.STONE, "wall": wall}
    else:  # a retaining wall, as in a cutting
        material, table = (Material.BRICK, palette.BRICK) if rng.random() < 0.5 else (Material.STONE, palette.STONE)
        distance = float(rng.uniform(4.2, 5.2)) * side
        shared |= {"height": float(rng.uniform(2.2, 4.2)), "material": material, "wall": choose(rng, table)}
        shared |= {"roof": (0.06, 0.09, 0.03)}
        thickness = 0.8
    points = [line.beside(k, distance) for k in range(start, stop + 1)]
    # Pieces end a little short of each other where the line bends.
    return [
        wall_between(a + 0.04 * (b - a), b - 0.04 * (b - a), thickness, **shared) for a, b in itertools.pairwise(points)
    ]


def _bridge(line: Line, k: int, rng: np.random.Generator) -> list[Building]:
    """Build the two abutments of a bridge over the line; the deck is a thing."""
    look = {"wall": choose(rng, palette.BRICK if rng.random() < 0.5 else palette.STONE), "roof": (0.07, 0.1, 0.04)}
    look |= {"material": Material.STONE, "seed": k, "tags": frozenset({"wall", "bridge"})}
    return [Building(rectangle(line.beside(k, s * 6.6), line.yaw(k), 4.6, 5.2), 7.0, **look) for s in (-1.0, 1.0)]


def _station(line: Line, k: int, rng: np.random.Generator) -> list[Building]:
    """Build a platform of sixty metres with a station building behind it."""
    house = villa(rng, rectangle(line.beside(k + 5, 12.0), line.yaw(k + 5), 19.0, 8.0))
    found = [replace(house, height=7.2, ornament=1 | 8, tags=frozenset({"station"}))]
    look = {"height": 0.8, "wall": palette.STONE[2], "roof": palette.STONE[3], "material": Material.STONE}
    for step in range(10):
        a, b = line.beside(k + step, 4.4), line.beside(k + step + 1, 4.4)
        platform = wall_between(a + 0.01 * (b - a), b - 0.01 * (b - a), 3.2, tags=frozenset({"wall"}), **look)
        found.append(platform)
    return found


def furnish_country(stock: Collector, plan: Plan, buildings: list[Building], track: np.ndarray) -> None:
    """Plant the country along the line, and put up masts, wires and the decks of bridges."""
    rng = np.random.default_rng([plan.seed, 9])
    line = line_of(track)
    country = [b for b in buildings if b.tags & {"wall", "station", "villa"}]
    near_house = cKDTree(np.array([b.corners.mean(axis=0) for b in country]))
    flat = plan.junctions.reshape(-1, 2)
    edge = TOTAL_HALF[Kind.STREET] + OUTER_DEPTH + 2.0
    low, high = flat.min(axis=0) - edge, flat.max(axis=0) + edge
    on_line = cKDTree(track)

    def plant(p: np.ndarray, species: Species, size: float) -> None:
        in_town = bool((p > low).all() and (p < high).all())
        room = 3.2 if species == Species.SHRUB else 6.0
        if not in_town and on_line.query(p)[0] > 4.0 + CROWN[species] * size * 0.8 and near_house.query(p)[0] > room:
            stock.tree(p, species, size, rng)

    _plant_groves(line, plant, rng)
    _string_wires(stock.things, line)
    for b in buildings:
        if "bridge" in b.tags:
            middle, k = b.corners.mean(axis=0), b.seed
            if (middle - line.points[k]) @ line.outward[k] > 0:
                yaw = line.yaw(k) + np.pi / 2
                stock.things.add("deck", line.points[k], yaw, z=7.0, scale=(10.0, 4.6, 1.0), colour=b.wall)


def _plant_groves(line: Line, plant: object, rng: np.random.Generator) -> None:
    kinds = [Species.LINDEN, Species.LINDEN, Species.SPRUCE, Species.POPLAR, Species.SHRUB]
    for _ in range(190):  # groves and lone trees
        k = int(rng.integers(len(line.points)))
        centre = line.beside(k, float(rng.uniform(8, 50)) if rng.random() < 0.7 else -float(rng.uniform(8, 22)))
        species = Species(rng.choice(kinds))
        for _ in range(int(rng.integers(1, 12))):
            plant(centre + rng.normal(0, (8, 5)), species, float(rng.uniform(0.6, 1.15)))
    for _ in range(14):  # rows of trees that lead away from the line
        k = int(rng.integers(len(line.points)))
        species, step = Species(rng.choice(kinds)), float(rng.uniform(5, 9))
        for n in range(int(rng.integers(4, 10))):
            plant(line.beside(k, 9 + n * step), species, float(rng.uniform(0.8, 1.05)))
    for k in range(0, len(line.points) - 1, 2):  # shrubs at the foot of the embankment
        if rng.random() < 0.5:
            side = 1 if rng.random() < 0.5 else -1
            plant(line.beside(k, side * float(rng.uniform(5.5, 9))), Species.SHRUB, float(rng.uniform(0.6, 1.5)))


def _string_wires(things: ThingList, line: Line) -> None:
    for k in range(0, len(line.points) - 8, 8):
        things.add("mast", line.beside(k, 3.2), float(np.arctan2(*-line.outward[k][::-1])))
        ahead = line.points[k + 8] - line.points[k]
        length, yaw = float(np.linalg.norm(ahead)), float(np.arctan2(ahead[1], ahead[0]))
        for z in (5.4, 6.45):
            things.add("wire", line.beside(k, 0.3), yaw, z=z, scale=(length, 1, 1))
