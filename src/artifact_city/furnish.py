"""Trees, lamps and the small things of the streets that do not move."""

from dataclasses import dataclass

import numpy as np

from artifact_city import palette
from artifact_city.buildings import FACADE_EDGE, Building, Ground, Windows, roof_height
from artifact_city.country import furnish_country
from artifact_city.lots import Site, Zone
from artifact_city.models import ThingList
from artifact_city.palette import choose
from artifact_city.streets import ROAD_HALF, TOTAL_HALF, Kind, Plan, inset
from artifact_city.trees import TREE, Species


@dataclass(frozen=True)
class Furniture:
    """What stands in a town of one era.

    Attributes
    ----------
    trees : ndarray of TREE
    things : ndarray of THING
        Lamps, benches, signs, balconies, awnings, chimneys, masts.
    lamps : ndarray, shape (n, 5)
        Position of the light, its power and its tone.
    parking : ndarray, shape (n, 3)
        Kerbside places: x, y, heading of a car parked there.
    pavements : ndarray, shape (n, 3)
        Places where people may walk: x, y, heading.
    """

    trees: np.ndarray
    things: np.ndarray
    lamps: np.ndarray
    parking: np.ndarray
    pavements: np.ndarray


class Collector:
    """Gathers trees, things, lamps and places while a town is furnished."""

    def __init__(self, era: str) -> None:
        self.past = era == "past"
        self.things = ThingList()
        self.trees: list[tuple] = []
        self.lamps: list[tuple] = []
        self.parking: list[tuple] = []
        self.pavements: list[tuple] = []

    def tree(self, p: np.ndarray, species: Species, size: float, rng: np.random.Generator) -> None:
        """Plant a tree, turned at random."""
        self.trees.append((p[0], p[1], size, rng.uniform(0, 2 * np.pi), int(species), int(rng.integers(1 << 30))))

    def lamp(self, p: np.ndarray, yaw: float, *, tall: bool) -> None:
        """Set up a street lamp that leans towards ``yaw``, or a lantern."""
        if tall and not self.past:
            self.things.add("lamp", p[0], p[1], yaw, colour=(0.2, 0.21, 0.22))
            self.lamps.append((p[0] + 1.25 * np.cos(yaw), p[1] + 1.25 * np.sin(yaw), 6.7, 1.0, 0.35))
        else:
            self.things.add("lantern", p[0], p[1], yaw)
            self.lamps.append((p[0], p[1], 3.75, 0.42, 0.0))


def furnish(plan: Plan, sites: list[Site], buildings: list[Building], track: np.ndarray, era: str) -> Furniture:
    """Put trees, lamps and furniture into a town.

    Trees, lamp posts and street furniture depend on the plan only, so that they are the same in both eras where both
    eras have them.
    """
    c = Collector(era)
    for index, (a, b) in enumerate(plan.edges()):
        _furnish_street(c, plan, a, b, np.random.default_rng([plan.seed, 6, index]))
    for index, site in enumerate(sites):
        _furnish_site(c, site, np.random.default_rng([plan.seed, 7, index]))
    for building in buildings:
        _furnish_house(c, building, np.random.default_rng([plan.seed, 8, building.seed]))
    furnish_country(c, plan, buildings, track)
    return Furniture(
        trees=np.array(c.trees, dtype=TREE),
        things=c.things.records(),
        lamps=np.array(c.lamps),
        parking=np.array(c.parking),
        pavements=np.array(c.pavements),
    )


def _furnish_street(c: Collector, plan: Plan, a: tuple, b: tuple, rng: np.random.Generator) -> None:
    kind = plan.kind(a, b)
    p, q = plan.junctions[a], plan.junctions[b]
    length = float(np.linalg.norm(q - p))
    u = (q - p) / length
    n = np.array([-u[1], u[0]])
    yaw = float(np.arctan2(u[1], u[0]))
    along_row = a[1] == b[1]
    across, axis = (plan.column_kinds, 0) if along_row else (plan.row_kinds, 1)
    first, last = TOTAL_HALF[across[a[axis]]] + 2.0, length - TOTAL_HALF[across[b[axis]]] - 2.0
    road = ROAD_HALF[kind]

    def spots(spacing: float, offset: float, jitter: float = 0.0) -> list[np.ndarray]:
        at = np.arange(first + offset, last, spacing)
        return [p + (s + rng.uniform(-jitter, jitter)) * u for s in at]

    line = np.random.default_rng([plan.seed, 10, int(along_row), *a])
    for side in (-1, 1):
        inwards = yaw - side * np.pi / 2
        tree = Species(line.choice([Species.LINDEN, Species.PLANE, Species.BIRCH, Species.LINDEN, Species.POPLAR]))
        if kind == Kind.AVENUE:
            kept = line.choice([0.93, 0.6, 0.0, 0.85])
            for s in spots(line.uniform(9.5, 15.0), 3.0, 0.8):
                if rng.random() < kept:
                    c.tree(s + side * (road + 1.1) * n, tree, rng.uniform(0.65, 1.05), rng)
            for s in spots(25.0, 8.2 if side > 0 else 18.0):
                c.lamp(s + side * (road + 0.6) * n, inwards, tall=True)
        elif kind == Kind.STREET:
            planted = line.random() < 0.5
            for s in spots(15.0, 6.0, 1.5):
                if planted and rng.random() < 0.8:
                    species = Species.BIRCH if tree == Species.PLANE else tree
                    c.tree(s + side * (road + 0.9) * n, species, rng.uniform(0.5, 0.75), rng)
            for s in spots(46.0, 6.0 if side > 0 else 29.0):
                c.lamp(s + side * (road + 0.5) * n, inwards, tall=True)
        elif kind == Kind.LANE:
            for s in spots(38.0, 4.0 if side > 0 else 23.0):
                c.lamp(s + side * (TOTAL_HALF[kind] - 0.45) * n, inwards, tall=False)
            for s in spots(3.5, 1.0):
                if rng.random() < 0.5:
                    c.things.add("bollard", *(s + side * (road + 0.25) * n), yaw)
        else:
            for s in spots(13.0, 4.0 if side > 0 else 9.0, 1.0):
                if rng.random() < 0.85:
                    c.tree(s + side * 6.55 * n, tree, rng.uniform(0.65, 0.95), rng)
            for s in spots(26.0, 12.0):
                c.lamp(s + side * 6.6 * n, inwards, tall=False)
        _furnish_pavement(c, kind, spots, side, n, yaw, rng)
    _furnish_corners(c, kind, p + first * u, q - (length - last) * u, n, yaw, rng)


def _furnish_pavement(
    c: Collector, kind: Kind, spots: object, side: int, n: np.ndarray, yaw: float, rng: np.random.Generator
) -> None:
    road, total = ROAD_HALF[kind], TOTAL_HALF[kind]
    heading = yaw if side < 0 else yaw + np.pi
    if kind != Kind.LANE:
        distance = 7.1 if kind == Kind.CANAL else road - 1.05
        for s in spots(6.1, 5.0, 0.25):
            c.parking.append((*(s + side * distance * n), heading))
    for s in spots(7.0, 1.0, 3.0):
        at = s + side * rng.uniform(road + 0.9, total - 0.7) * n
        c.pavements.append((*at, heading if rng.random() < 0.5 else heading + np.pi))
    for s in spots(12.0, 4.0, 4.0):
        draw, edge, wall = rng.random(), s + side * (road + 0.45) * n, s + side * (total - 0.55) * n
        if draw < 0.06:
            c.things.add("bin", *edge, yaw, colour=(0.05, 0.09, 0.06))
        elif draw < 0.12:
            second = (0.75, 0.12, 0.2) if draw < 0.09 else (0.85, 0.65, 0.1)
            c.things.add("planter", *edge, yaw, colour=choose(rng, palette.STONE), second=second)
        elif draw < 0.2 and kind != Kind.LANE:
            c.things.add("bench", *edge, yaw + (np.pi if side > 0 else 0.0))
        elif draw < 0.42:
            for k in range(int(rng.integers(1, 4))):
                at = wall - side * 0.1 * n + 0.5 * k * np.array([np.cos(yaw), np.sin(yaw)])
                c.things.add(
                    "bicycle", *at, heading + rng.normal(0, 0.2), colour=choose(rng, palette.CAR), seed=int(draw * 1e6)
                )
        elif draw < 0.46 and kind != Kind.LANE:
            name = str(rng.choice(["pillar", "kiosk", "clock"]))
            c.things.add(
                name, *(edge - side * 0.2 * n if name == "clock" else edge + side * 0.8 * n), yaw,
                colour=choose(rng, palette.SIGN), second=choose(rng, palette.AWNING), seed=int(draw * 1e6),
            )  # fmt: skip
        elif draw < 0.49:
            name = "booth" if draw < 0.475 and kind != Kind.LANE else "post_box"
            c.things.add(name, *edge, yaw, colour=palette.SIGN[int(rng.choice([0, 3, 1]))])
        elif draw < 0.54 and kind in (Kind.AVENUE, Kind.STREET) and not c.past:
            c.things.add("shelter", *(s + side * (total - 1.6) * n), yaw + (np.pi if side > 0 else 0.0))
        elif draw < 0.6 and not c.past:
            c.things.add("traffic_sign", *edge, heading + np.pi, colour=choose(rng, palette.SIGN))
        elif draw < 0.63 and kind != Kind.LANE and not c.past:
            at, toward = edge + side * 0.5 * n, heading + np.pi + side * 0.35
            c.things.add("billboard", *at, toward, seed=int(draw * 1e6))


def _furnish_corners(
    c: Collector, kind: Kind, start: np.ndarray, end: np.ndarray, n: np.ndarray, yaw: float, rng: np.random.Generator
) -> None:
    if c.past or kind not in (Kind.AVENUE, Kind.STREET):
        return
    name = "traffic_light" if kind == Kind.AVENUE else "traffic_sign"
    edge = (ROAD_HALF[kind] + 0.4) * n
    u = np.array([np.cos(yaw), np.sin(yaw)])
    c.things.add(name, *(start - 1.2 * u + edge), yaw, colour=choose(rng, palette.SIGN))
    c.things.add(name, *(end + 1.2 * u - edge), yaw + np.pi, colour=choose(rng, palette.SIGN))


def _clear_points(site: Site, count: int, margin: float, rng: np.random.Generator) -> list[np.ndarray]:
    """Draw points in a block that keep ``margin`` metres from its houses."""
    corners = inset(site.block.corners, (1.5,) * 4)
    houses = np.array([b.corners for b in site.buildings]).reshape(-1, 4, 2)
    found = []
    for _ in range(count):
        u, v = rng.random(2)
        p = (1 - v) * ((1 - u) * corners[0] + u * corners[1]) + v * ((1 - u) * corners[3] + u * corners[2])
        if (_distances(houses, p) > margin).all():
            found.append(p)
    return found


def _distances(corners: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Distances of a point from the sides of convex polygons, shape (n, k, 2); negative inside."""
    direction = np.roll(corners, -1, axis=1) - corners
    normal = np.stack([direction[..., 1], -direction[..., 0]], axis=-1) / np.linalg.norm(direction, axis=-1)[..., None]
    return ((p - corners) * normal).sum(axis=-1).max(axis=-1)


def _furnish_site(c: Collector, site: Site, rng: np.random.Generator) -> None:
    if site.zone == Zone.SQUARE:
        _furnish_square(c, site, rng)
    elif site.zone == Zone.PARK:
        middle = site.block.corners.mean(axis=0)
        paths = park_paths(site)
        for p in _clear_points(site, 75, 3.5, rng):
            if min(abs(_across(p, a, b)) for a, b in paths) > 2.6 and np.linalg.norm(p - middle) > 6:
                species = Species(
                    rng.choice([Species.PLANE, Species.LINDEN, Species.BIRCH, Species.SHRUB, Species.SPRUCE])
                )
                c.tree(p, species, rng.uniform(0.7, 1.15), rng)
        for a, b in paths:
            u = (b - a) / np.linalg.norm(b - a)
            for s in (0.12, 0.33, 0.67, 0.88):
                at = a + s * (b - a) + np.array([-u[1], u[0]]) * 2.0
                c.lamp(at, 0.0, tall=False)
                c.things.add("bench", *(at + 2.5 * u), float(np.arctan2(u[1], u[0])) + np.pi)
        c.things.add("fountain" if rng.random() < 0.5 else "statue", *middle, rng.uniform(0, 6))
    else:
        shrubs = [Species.LINDEN, Species.BIRCH, Species.SHRUB, Species.SHRUB, Species.SPRUCE]
        species = [Species.LINDEN, Species.BIRCH] if site.zone == Zone.COURT else shrubs
        for p in _clear_points(site, 14 if site.zone == Zone.COURT else 26, 2.2, rng):
            c.tree(p, Species(rng.choice(species)), rng.uniform(0.45, 0.8), rng)


def park_paths(site: Site) -> list[tuple[np.ndarray, np.ndarray]]:
    """Two paths that cross in the middle of a park, each from the middle of one side to the middle of its opposite."""
    corners = site.block.corners
    return [((corners[k] + corners[(k + 1) % 4]) / 2, (corners[k - 2] + corners[k - 1]) / 2) for k in (0, 1)]


def _across(p: np.ndarray, a: np.ndarray, b: np.ndarray) -> float:
    u = (b - a) / np.linalg.norm(b - a)
    return float(u[0] * (p - a)[1] - u[1] * (p - a)[0])


def _furnish_square(c: Collector, site: Site, rng: np.random.Generator) -> None:
    ring = inset(site.block.corners, (2.2,) * 4)
    species = Species(rng.choice([Species.PLANE, Species.LINDEN]))
    for k in range(4):
        a, b = ring[k], ring[(k + 1) % 4]
        length = float(np.linalg.norm(b - a))
        u = (b - a) / length
        for s in np.arange(2.0, length - 4, 9.0):
            if abs(s - length / 2) > 6 and rng.random() < 0.85:
                c.tree(a + s * u, species, rng.uniform(0.55, 0.8), rng)
        for s in np.arange(6.5, length - 6, 18.0):
            c.lamp(a + s * u, 0.0, tall=False)
            inwards = np.array([-u[1], u[0]])
            c.things.add("bench", *(a + (s + 4) * u + 0.8 * inwards), float(np.arctan2(u[1], u[0])))
    points = [p for p in _clear_points(site, 60, 4.0, rng) if _distances(site.block.corners[None], p)[0] < -6]
    for name, count in (("fountain", 1), ("statue", 1), ("stall", 6), ("pillar", 1)):
        for _ in range(count):
            if points:
                p = points.pop()
                points = [o for o in points if np.linalg.norm(o - p) > 4.5]
                c.things.add(
                    name, *p, rng.uniform(0, 6.28), colour=choose(rng, palette.AWNING), seed=int(rng.integers(1 << 20))
                )


def _furnish_house(c: Collector, b: Building, rng: np.random.Generator) -> None:
    if "house" not in b.tags:
        return
    p0, p1 = b.corners[0], b.corners[1]
    width = float(np.linalg.norm(p1 - p0))
    u = (p1 - p0) / width
    n = np.array([u[1], -u[0]])
    yaw = float(np.arctan2(n[1], n[0]))
    floors = int((b.height - b.ground_height) / b.floor_height + 0.05)
    bays = max(1, int((width - 2 * FACADE_EDGE) / b.bay))
    step = (width - 2 * FACADE_EDGE) / bays
    bay = [p0 + (FACADE_EDGE + (k + 0.5) * step) * u for k in range(bays)]
    villa = "villa" in b.tags
    if b.ground == Ground.SHOP:
        if rng.random() < 0.5:
            at, colour = (p0 + p1) / 2 + 0.05 * n, choose(rng, palette.AWNING)
            scale = (rng.uniform(1.1, 1.6), 0.88 * width, 1.0)
            second = (0.8, 0.78, 0.72) if rng.random() < 0.6 else colour
            c.things.add("awning", *at, yaw, z=b.ground_height - 0.85, scale=scale, colour=colour, second=second)
        if rng.random() < 0.45:
            at = p0 + (0.3 if rng.random() < 0.5 else width - 0.3) * u
            c.things.add("sign", *at, yaw, z=b.ground_height + 0.35, second=b.sign, seed=b.seed)
        elif rng.random() < 0.5:
            colour, second = choose(rng, palette.AWNING), choose(rng, palette.TRIM)
            for k in range(int(rng.integers(1, 3))):
                at = p0 + (0.3 + 0.4 * k) * width * u + 1.45 * n
                c.things.add("parasol", *at, rng.uniform(0, 1), scale=(0.85, 0.85, 1.0), colour=colour, second=second)
    if not villa and floors > 1 and rng.random() < 0.1:
        at = p0 + rng.uniform(0.2, 0.8) * width * u
        colour, second = choose(rng, palette.SIGN), choose(rng, palette.SIGN)
        c.things.add("banner", *at, yaw, z=b.ground_height + 0.8, colour=colour, second=second)
    if not villa and b.windows in (Windows.FRENCH, Windows.SASH, Windows.STRIP) and rng.random() < 0.5:
        columns = rng.random(bays) < rng.choice([0.35, 0.7, 1.0])
        for k in np.flatnonzero(columns):
            for floor in range(floors):
                z = b.ground_height + floor * b.floor_height + 0.12
                scale = (1.0, min(1.0, 0.42 * step), 1.0)
                c.things.add("balcony", *bay[k], yaw, z=z, scale=scale, colour=b.trim, second=b.accent)
    elif not villa and b.windows in (Windows.CROSS, Windows.SASH, Windows.ARCHED) and rng.random() < 0.22 and floors:
        k = int(rng.integers(bays))
        for floor in range(max(1, floors - 1)):
            z = b.ground_height + floor * b.floor_height + 0.1
            c.things.add(
                "oriel", *bay[k], yaw, z=z, scale=(1.0, 0.85, b.floor_height / 3.0), colour=b.wall * np.float64(0.95)
            )
    _furnish_roof(c, b, bay, u, n, yaw, rng)


def _furnish_roof(
    c: Collector, b: Building, bay: list, u: np.ndarray, n: np.ndarray, yaw: float, rng: np.random.Generator
) -> None:
    pitched = b.roof_cap > 0.0
    if pitched and b.roof_slopes[0] > 0 and rng.random() < 0.55:
        inset_by = 0.55 if b.roof_slopes[0] > 2 else 1.0
        rise = b.roof_slopes[0] * inset_by
        for at in bay[:: int(rng.integers(1, 3))]:
            p = at - inset_by * n
            # Not where a hip cuts the roof off, nor where the ridge is too low to hold a dormer.
            if roof_height(b, p) < b.height + rise - 0.01 or roof_height(b, p - 2.1 * n) < b.height + rise + 1.25:
                continue
            c.things.add(
                "dormer", *p, yaw, z=b.height + rise - 0.25, scale=(1.0, 0.85, 0.9),
                colour=b.wall * np.float64(0.95), second=b.roof,
            )  # fmt: skip
    if rng.random() < (0.85 if pitched else 0.4):
        width, depth = np.linalg.norm(b.corners[1] - b.corners[0]), np.linalg.norm(b.corners[3] - b.corners[0])
        hipped = b.roof_slopes[1] > 0 and b.roof_slopes[0] > 0
        for end in ((0.38, 0.66) if hipped else (0.12, 0.88))[: int(rng.integers(1, 3))]:
            p = b.corners[0] + end * width * u - depth * rng.uniform(0.42, 0.58) * n
            c.things.add("chimney", *p, yaw, z=roof_height(b, p), colour=choose(rng, palette.BRICK))
