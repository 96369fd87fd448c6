"""Trees, lamps and the small things of the streets that do not move."""

from dataclasses import dataclass

import numpy as np

from artifact_city import palette
from artifact_city.buildings import FACADE_EDGE, Building, Ground, Windows, roof_at
from artifact_city.country import furnish_country
from artifact_city.lots import Site, Zone
from artifact_city.models import Collector, ThingList
from artifact_city.palette import choose
from artifact_city.streets import ROAD_HALF, TOTAL_HALF, Kind, Plan, inset, sides
from artifact_city.trees import TREE, Species


@dataclass(frozen=True)
class Furniture:
    """What stands in a town of one era."""

    trees: np.ndarray  # TREE
    things: np.ndarray  # THING
    lamps: np.ndarray  # (n, 5): position of the light, its power and its tone
    parking: np.ndarray  # (n, 3): x, y, heading of a kerbside place where a car may stand
    pavements: np.ndarray  # (n, 3): the same of a place where people may walk


def furnish(
    plan: Plan, sites: list[Site], buildings: list[Building], prisms: np.ndarray, track: np.ndarray, era: str
) -> Furniture:
    """Put trees, lamps and furniture into a town; ``prisms`` are the records of its buildings.

    Trees, lamp posts and street furniture depend on the plan only, so that they are the same in both eras where both
    eras have them.
    """
    c = Collector(era)
    for index, (a, b) in enumerate(plan.edges()):
        _furnish_street(c, plan, a, b, np.random.default_rng([plan.seed, 6, index]))
    for index, site in enumerate(sites):
        _furnish_site(c, site, np.random.default_rng([plan.seed, 7, index]))
    for building, prism in zip(buildings, prisms, strict=True):
        if "house" in building.tags:
            _furnish_house(c.things, building, prism, np.random.default_rng([plan.seed, 8, building.seed]))
    furnish_country(c, plan, buildings, track)
    lamps, parking, pavements = (np.array(rows) for rows in (c.lamps, c.parking, c.pavements))
    return Furniture(np.array(c.trees, dtype=TREE), c.things.records(), lamps, parking, pavements)


def _furnish_street(c: Collector, plan: Plan, a: tuple, b: tuple, rng: np.random.Generator) -> None:
    kind = plan.kind(a, b)
    p, length, u, n = plan.axis(a, b)
    yaw = float(np.arctan2(u[1], u[0]))
    before, after = TOTAL_HALF[list(plan.crossed(a, b))] + 2.0
    road, total = ROAD_HALF[kind], TOTAL_HALF[kind]

    def spots(spacing: float, offset: float, jitter: float = 0.0) -> list[np.ndarray]:
        at = np.arange(before + offset, length - after, spacing)
        return [p + (s + rng.uniform(-jitter, jitter)) * u for s in at]

    line = np.random.default_rng([plan.seed, 10, int(a[1] == b[1]), *a])
    # For each kind: spacing of trees and lamps, metres outside the kerb, share of trees kept, range of their sizes.
    tree_step, tree_out, shares, sizes, lamp_step, lamp_out = {
        Kind.LANE: (30.0, 0.0, (0.0,), (0.5, 0.5), 38.0, total - 0.45 - road),
        Kind.STREET: (15.0, 0.9, (0.0, 0.8), (0.5, 0.75), 46.0, 0.5),
        Kind.AVENUE: (float(line.uniform(9.5, 15.0)), 1.1, (0.93, 0.6, 0.0, 0.85), (0.65, 1.05), 25.0, 0.6),
        Kind.CANAL: (13.0, 6.55 - road, (0.85,), (0.65, 0.95), 26.0, 6.6 - road),
    }[kind]
    for side in (-1, 1):
        tree, kept = Species(line.choice([Species.LINDEN, Species.POPLAR], p=[0.8, 0.2])), line.choice(shares)
        for s in spots(tree_step, 4.0, 1.0):
            if rng.random() < kept:
                c.tree(s + side * (road + tree_out) * n, tree, rng.uniform(*sizes), rng)
        for s in spots(lamp_step, (0.2 if side > 0 else 0.65) * lamp_step):
            at = s + side * (road + lamp_out) * n
            c.lamp(at, yaw - side * np.pi / 2, tall=kind in (Kind.STREET, Kind.AVENUE))
        heading = yaw if side < 0 else yaw + np.pi
        if kind != Kind.LANE:
            distance = 7.1 if kind == Kind.CANAL else road - 1.05
            c.parking += [(*(s + side * distance * n), heading) for s in spots(6.1, 5.0, 0.25)]
        for s in spots(7.0, 1.0, 3.0):
            at = s + side * rng.uniform(road + 0.9, total - 0.7) * n
            c.pavements.append((*at, heading if rng.random() < 0.5 else heading + np.pi))
        for s in spots(12.0, 4.0, 4.0):
            draw, edge = rng.random(), s + side * (road + 0.45) * n
            if draw < 0.15 and kind != Kind.LANE:
                c.things.add("bench", edge, yaw + (np.pi if side > 0 else 0.0))
            elif draw > 0.9 and not c.past:
                c.things.add("traffic_sign", edge, heading + np.pi, colour=choose(rng, palette.SIGN))


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
    return ((p - corners) * sides(corners)[2]).sum(axis=-1).max(axis=-1)


def _furnish_site(c: Collector, site: Site, rng: np.random.Generator) -> None:
    if site.zone == Zone.SQUARE:
        _furnish_square(c, site, rng)
    elif site.zone == Zone.PARK:
        middle, paths = site.block.corners.mean(axis=0), park_paths(site)
        for p in _clear_points(site, 75, 3.5, rng):
            if min(abs(_across(p, a, b)) for a, b in paths) > 2.6 and np.linalg.norm(p - middle) > 6:
                species = rng.choice([Species.LINDEN, Species.LINDEN, Species.SHRUB, Species.SPRUCE])
                c.tree(p, Species(species), rng.uniform(0.7, 1.3), rng)
        for a, b in paths:
            u = (b - a) / np.linalg.norm(b - a)
            for s in (0.12, 0.33, 0.67, 0.88):
                at = a + s * (b - a) + np.array([-u[1], u[0]]) * 2.0
                c.lamp(at, 0.0, tall=False)
                c.things.add("bench", at + 2.5 * u, float(np.arctan2(u[1], u[0])) + np.pi)
        c.things.add("fountain", middle, 0.0)
    else:
        court = site.zone == Zone.COURT
        species = [Species.LINDEN] if court else [Species.LINDEN, Species.LINDEN, Species.SHRUB, Species.SPRUCE]
        for p in _clear_points(site, 14 if court else 26, 2.2, rng):
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
    for a, length, u, outward in zip(ring, *sides(ring), strict=True):
        for s in np.arange(2.0, length - 4, 9.0):
            if abs(s - length / 2) > 6 and rng.random() < 0.85:
                c.tree(a + s * u, Species.LINDEN, rng.uniform(0.55, 0.8), rng)
        for s in np.arange(6.5, length - 6, 18.0):
            c.lamp(a + s * u, 0.0, tall=False)
            c.things.add("bench", a + (s + 4) * u - 0.8 * outward, float(np.arctan2(u[1], u[0])))
    points = [p for p in _clear_points(site, 60, 4.0, rng) if _distances(site.block.corners[None], p)[0] < -6]
    for p in points[-1:]:
        c.things.add("fountain", p, 0.0)


def _furnish_house(things: ThingList, b: Building, prism: np.void, rng: np.random.Generator) -> None:
    p0, (lengths, units, outward) = b.corners[0], sides(b.corners)
    (width, depth), u, n = lengths[[0, 3]], units[0], outward[0]
    yaw = float(np.arctan2(n[1], n[0]))
    floors = int((b.height - b.ground_height) / b.floor_height + 0.05)
    bays = max(1, int((width - 2 * FACADE_EDGE) / b.bay))
    step = (width - 2 * FACADE_EDGE) / bays
    bay = [p0 + (FACADE_EDGE + (k + 0.5) * step) * u for k in range(bays)]
    storeys = b.ground_height + b.floor_height * np.arange(floors)
    pale = 0.95 * np.array(b.wall)
    if b.ground == Ground.SHOP:
        if rng.random() < 0.5:
            at, colour = p0 + 0.5 * width * u + 0.05 * n, choose(rng, palette.AWNING)
            scale = (rng.uniform(1.1, 1.6), 0.88 * width, 1.0)
            second = (0.8, 0.78, 0.72) if rng.random() < 0.6 else colour
            things.add("awning", at, yaw, z=b.ground_height - 0.85, scale=scale, colour=colour, second=second)
        if rng.random() < 0.45:
            at = p0 + (0.3 if rng.random() < 0.5 else width - 0.3) * u
            things.add("sign", at, yaw, z=b.ground_height + 0.35, second=b.sign)
    balconies = b.windows in (Windows.FRENCH, Windows.SASH, Windows.STRIP)
    if "villa" not in b.tags and balconies and rng.random() < 0.5:
        scale = (1.0, min(1.0, 0.42 * step), 1.0)
        for k in np.flatnonzero(rng.random(bays) < rng.choice([0.35, 0.7, 1.0])):
            for z in storeys + 0.12:
                things.add("balcony", bay[k], yaw, z=z, scale=scale, colour=b.trim)
    elif "villa" not in b.tags and not balconies and rng.random() < 0.22:
        k, scale = int(rng.integers(bays)), (1.0, 0.85, b.floor_height / 3.0)
        for z in storeys[: max(1, floors - 1)] + 0.1:
            things.add("oriel", bay[k], yaw, z=z, scale=scale, colour=pale)
    if b.slope[0] > 0 and rng.random() < 0.55:
        inwards = 0.55 if b.slope[0] > 2 else 1.0
        eaves = b.height + b.slope[0] * inwards
        for at in bay[:: int(rng.integers(1, 3))]:
            p = at - inwards * n
            # Not where a hip cuts the roof off, nor where the ridge is too low to hold a dormer.
            if roof_at(prism, *p) > eaves - 0.01 and roof_at(prism, *(p - 2.1 * n)) > eaves + 1.25:
                things.add("dormer", p, yaw, z=eaves - 0.25, scale=(1.0, 0.85, 0.9), colour=pale, second=b.roof)
    if rng.random() < (0.85 if b.cap > 0 else 0.4):
        hipped = b.slope[1] > 0 and b.slope[0] > 0
        for end in ((0.38, 0.66) if hipped else (0.12, 0.88))[: int(rng.integers(1, 3))]:
            p = p0 + end * width * u - depth * rng.uniform(0.42, 0.58) * n
            things.add("chimney", p, yaw, z=roof_at(prism, *p), colour=choose(rng, palette.BRICK))
