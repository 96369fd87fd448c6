"""Buildings and everything else that is a prism with a roof: what they are, and houses drawn at random."""

from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np

from artifact_city import palette
from artifact_city.kernel import kernel, layout, records
from artifact_city.palette import choose
from artifact_city.streets import sides

RGB = tuple[float, float, float] | np.ndarray


# What a wall is made of, how its windows look, and what is on the ground floor of a front.
Material = IntEnum("Material", "BRICK PLASTER STONE CONCRETE TIMBER SIDING HEDGE FENCE PLAIN", start=0)
Windows = IntEnum("Windows", "NONE CROSS SASH ARCHED STRIP SHUTTERS FRENCH", start=0)
Ground = IntEnum("Ground", "NONE HOUSE SHOP GATE", start=0)


@dataclass(frozen=True)
class Building:
    """One prism over a convex quadrilateral, with its facade and roof. Lengths in metres, colours in linear light.

    Corners run counter-clockwise; side 0 (corner 0 to 1) is the front. The roof is the lowest of the planes that rise
    from the sides with ``slope`` (0: no plane), cut off at ``cap`` above the eaves. Bits of ``ornament``: 1 string
    course, 2 quoins, 4 cornice, 8 window surrounds, 16 coloured ground floor.
    """

    corners: np.ndarray
    height: float
    wall: RGB
    material: Material = Material.PLAIN
    slope: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    cap: float = 0.0
    roof: RGB = (0.1, 0.1, 0.1)
    trim: RGB = (0.6, 0.6, 0.55)
    accent: RGB = (0.1, 0.1, 0.1)
    sign: RGB = (0.3, 0.05, 0.05)
    windows: Windows = Windows.NONE
    ground: Ground = Ground.NONE
    floor_height: float = 3.1
    ground_height: float = 3.6
    bay: float = 2.4
    window_width: float = 1.1
    window_height: float = 1.7
    sill: float = 0.8
    fronts: tuple[bool, bool, bool, bool] = (True, False, False, False)
    ornament: int = 0
    seed: int = 0
    tags: frozenset[str] = frozenset()


FACADE_EDGE = 0.45  # metres between a house's corner and its first bay

# A building as compiled code reads it. Normals point outwards; a point p is inside side k where normal . p < offset.
PRISM = layout(
    "corners:4x2 normal:4x2 offset:4 length:4 slope:4 fronts:4 height cap floor_height ground_height bay window_width "
    "window_height sill wall:3 roof:3 trim:3 accent:3 sign:3 material:i windows:i ground:i ornament:i seed"
)


def as_records(buildings: list[Building]) -> np.ndarray:
    """Pack buildings into records ``PRISM``."""
    corners = np.array([b.corners for b in buildings], dtype=np.float64)
    length, _, normal = sides(corners)
    derived = {"normal": normal, "offset": (normal * corners).sum(axis=2), "length": length}
    plain = {name: [getattr(b, name) for b in buildings] for name in PRISM.names if name not in derived}
    return records(PRISM, {**plain, **derived})


@kernel
def roof_at(house, x, y):
    """Height of a building's roof above a point; negative outside its walls."""
    rise = house.cap
    for k in range(4):
        inside = house.offset[k] - house.normal[k, 0] * x - house.normal[k, 1] * y
        if inside < 0.0:
            return -1.0
        if house.slope[k] > 0.0:
            rise = min(rise, house.slope[k] * inside)
    return house.height + rise


def rectangle(centre: np.ndarray, yaw: float, length: float, width: float) -> np.ndarray:
    """Return the corners of a rectangle, counter-clockwise from its rear right corner, shape (4, 2).

    >>> import numpy as np
    >>> rectangle(np.array([0.0, 0.0]), 0.0, 4.0, 2.0).tolist()
    [[-2.0, -1.0], [2.0, -1.0], [2.0, 1.0], [-2.0, 1.0]]
    """
    along = np.array([np.cos(yaw), np.sin(yaw)]) * length / 2
    across = np.array([-np.sin(yaw), np.cos(yaw)]) * width / 2
    return centre + np.array([-along - across, along - across, along + across, across - along])


def wall_between(a: np.ndarray, b: np.ndarray, thickness: float, **properties: object) -> Building:
    """Build a long thin prism (garden wall, hedge, parapet) centred on the line from ``a`` to ``b``."""
    delta = b - a
    corners = rectangle((a + b) / 2, float(np.arctan2(delta[1], delta[0])), float(np.linalg.norm(delta)), thickness)
    return Building(corners=corners, **properties)


_WALLS = {
    Material.BRICK: palette.BRICK,
    Material.PLASTER: palette.PLASTER,
    Material.STONE: palette.STONE,
    Material.CONCRETE: palette.CONCRETE,
    Material.TIMBER: palette.TIMBER,
    Material.SIDING: palette.SIDING,
}

# For each character of a block: materials, floors (low, high), share of shops, bay width in metres.
_CHARACTERS = {
    "old": ((Material.BRICK, Material.PLASTER, Material.TIMBER, Material.PLASTER), (2, 4), 0.45, 2.2),
    "terrace": ((Material.BRICK, Material.BRICK, Material.PLASTER), (2, 3), 0.12, 2.6),
    "tenement": ((Material.PLASTER, Material.STONE, Material.BRICK, Material.PLASTER), (4, 5), 0.5, 2.5),
    "modern": ((Material.CONCRETE, Material.CONCRETE, Material.BRICK, Material.PLASTER), (3, 6), 0.4, 3.0),
}
CHARACTERS = tuple(_CHARACTERS)
_ALL_ROUND = (True, True, True, True)


def town_house(
    rng: np.random.Generator, corners: np.ndarray, character: str, fronts: tuple[bool, bool, bool, bool]
) -> Building:
    """Draw a house of a closed street front: material, floors, windows, ground floor, roof and ornaments."""
    materials, (low, high), shops, bay = _CHARACTERS[character]
    material = materials[rng.integers(len(materials))]
    floor_height = float(rng.uniform(2.8, 3.5))
    ground_height = floor_height + float(rng.uniform(0.2, 0.9))
    upper_floors = int(rng.integers(low, high + 1)) - 1
    width = float(np.linalg.norm(corners[1] - corners[0]))
    modern = character == "modern"
    if modern:
        styles = [Windows.STRIP, Windows.STRIP, Windows.SASH, Windows.FRENCH]
    elif material == Material.TIMBER:
        styles = [Windows.CROSS]
    else:
        styles = [Windows.CROSS, Windows.SASH, Windows.ARCHED, Windows.SHUTTERS, Windows.FRENCH, Windows.SASH]
    ground = Ground.HOUSE
    if rng.random() < shops:
        ground = Ground.SHOP
    elif width > 9 and rng.random() < 0.25:
        ground = Ground.GATE
    slope, cap = _town_roof(rng, width, corner=fronts[1] or fronts[3]) if not modern else ((0.0,) * 4, 0.0)
    return Building(
        corners=corners,
        height=ground_height + upper_floors * floor_height + float(rng.uniform(0.3, 1.0)),
        wall=choose(rng, _WALLS[material]),
        material=material,
        slope=slope,
        cap=cap,
        roof=choose(rng, palette.ROOF) if not modern else (0.16, 0.16, 0.17),
        trim=choose(rng, palette.TRIM),
        accent=choose(rng, palette.DOOR),
        sign=choose(rng, palette.SIGN),
        windows=Windows(rng.choice(styles)),
        ground=ground,
        floor_height=floor_height,
        ground_height=ground_height,
        bay=bay * float(rng.uniform(0.85, 1.2)),
        window_width=float(rng.uniform(0.9, 1.35)),
        window_height=float(rng.uniform(1.4, 2.0)),
        sill=float(rng.uniform(0.55, 0.9)),
        fronts=fronts,
        ornament=int(rng.integers(2) * 16 if modern else rng.integers(32)),
        seed=int(rng.integers(1 << 30)),
        tags=frozenset({"house"}),
    )


def _town_roof(rng: np.random.Generator, width: float, corner: bool) -> tuple[tuple, float]:
    """Slopes and cap of a roof: gabled to the street, saddle or hipped, mansard, or flat."""
    slope, style = float(rng.uniform(0.7, 1.15)), rng.random()
    if width < 9.5 and not corner and style < 0.42:
        return (0.0, slope * 1.15, 0.0, slope * 1.15), 30.0
    if style < 0.8:
        return (slope, slope * corner, slope, slope * corner), 30.0
    if style < 0.93:
        return (2.6, 2.6 * corner, 2.6, 2.6 * corner), 3.0
    return (0.0,) * 4, 0.0


def villa(rng: np.random.Generator, corners: np.ndarray) -> Building:
    """Draw a detached house, seen from all sides."""
    material = Material(rng.choice([Material.BRICK, Material.PLASTER, Material.SIDING, Material.SIDING]))
    floor_height = float(rng.uniform(2.6, 3.0))
    floors = int(rng.choice([1, 2, 3], p=[0.45, 0.5, 0.05]))
    slope = float(rng.uniform(0.5, 1.0))
    hip = slope if rng.random() < 0.4 else 0.0
    return Building(
        corners=corners,
        height=floors * floor_height + 0.4,
        wall=choose(rng, _WALLS[material]),
        material=material,
        slope=(slope, hip, slope, hip) if rng.random() < 0.6 else (hip, slope, hip, slope),
        cap=30.0,
        roof=choose(rng, palette.ROOF),
        trim=choose(rng, palette.TRIM),
        accent=choose(rng, palette.DOOR),
        windows=Windows(rng.choice([Windows.CROSS, Windows.SASH, Windows.SHUTTERS, Windows.STRIP])),
        ground=Ground.HOUSE,
        floor_height=floor_height,
        ground_height=floor_height,
        bay=float(rng.uniform(2.3, 3.3)),
        window_width=float(rng.uniform(1.0, 1.6)),
        window_height=float(rng.uniform(1.1, 1.5)),
        sill=0.85,
        fronts=_ALL_ROUND,
        ornament=int(rng.choice([0, 1, 8, 9])),
        seed=int(rng.integers(1 << 30)),
        tags=frozenset({"house", "villa"}),
    )


def church(rng: np.random.Generator, centre: np.ndarray, yaw: float) -> list[Building]:
    """Draw a church: a nave with a steep roof, and a tower with a spire at its west end."""
    material = Material.STONE if rng.random() < 0.6 else Material.BRICK
    nave = Building(
        corners=rectangle(centre, yaw, 22, 10),
        height=8.5,
        wall=choose(rng, _WALLS[material]),
        material=material,
        slope=(1.4, 0, 1.4, 0),
        cap=30.0,
        roof=palette.ROOF[2] if rng.random() < 0.5 else np.array([0.16, 0.33, 0.27]),
        trim=palette.STONE[3],
        windows=Windows.ARCHED,
        fronts=_ALL_ROUND,
        floor_height=7.0,
        ground_height=1.2,
        bay=3.6,
        window_width=1.2,
        window_height=4.6,
        ornament=2 | 4,
        seed=int(rng.integers(1 << 30)),
        tags=frozenset({"landmark"}),
    )
    tower = replace(
        nave,
        corners=rectangle(centre - 14.05 * np.array([np.cos(yaw), np.sin(yaw)]), yaw, 6, 6),
        height=float(rng.uniform(18, 25)),
        slope=(float(rng.uniform(3.2, 5.2)),) * 4,
        cap=40.0,
        floor_height=6.5,
        bay=3.0,
        window_height=2.2,
    )
    return [nave, tower]


def historical(rng: np.random.Generator, buildings: list[Building], share: float) -> list[Building]:
    """Return the same town some generations earlier: other shops everywhere, and some houses not yet rebuilt.

    Those are all modern ones, and ``share`` of the others. A rebuilt house keeps its lot, so that streets stay where
    they are.
    """
    earlier = []
    for b in buildings:
        if "house" not in b.tags:
            earlier.append(b)
        elif "modern" in b.tags or ("villa" not in b.tags and rng.random() < share):
            earlier.append(town_house(rng, b.corners, str(rng.choice(["old", "terrace"])), b.fronts))
        else:
            ground = b.ground
            if ground in (Ground.SHOP, Ground.HOUSE) and rng.random() < 0.15 and "villa" not in b.tags:
                ground = Ground.HOUSE if ground == Ground.SHOP else Ground.SHOP
            earlier.append(replace(b, sign=choose(rng, palette.SIGN), accent=choose(rng, palette.DOOR), ground=ground))
    return earlier
