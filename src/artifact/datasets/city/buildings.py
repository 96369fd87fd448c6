"""Buildings and everything else that is a prism with a roof: houses, churches, walls, hedges."""

from dataclasses import dataclass, field, replace
from enum import IntEnum

import numpy as np

from . import palette
from .records import RGB as RGB_FIELD
from .records import layout, records

RGB = tuple[float, float, float] | np.ndarray


class Material(IntEnum):
    """What a wall is made of; the compiled facade code knows the values."""

    BRICK = 0
    PLASTER = 1
    STONE = 2
    CONCRETE = 3
    TIMBER = 4
    SIDING = 5
    HEDGE = 6
    FENCE = 7
    PLAIN = 8


class Windows(IntEnum):
    """How the windows of a facade look."""

    NONE = 0
    CROSS = 1
    SASH = 2
    ARCHED = 3
    STRIP = 4
    SHUTTERS = 5
    FRENCH = 6
    CHURCH = 7
    CURTAIN = 8


class Ground(IntEnum):
    """What is on the ground floor of a front."""

    NONE = 0
    HOUSE = 1
    SHOP = 2
    ARCADE = 3
    GATE = 4


class Gable(IntEnum):
    """Outline of a front that rises above the eaves."""

    NONE = 0
    STEPPED = 1
    BELL = 2
    PEDIMENT = 3


@dataclass(frozen=True)
class Building:
    """
    One prism over a convex quadrilateral, with its facade and roof. Lengths in metres, colours in linear light.

    Corners run counter-clockwise; side 0 (corner 0 to 1) is the front. The roof is the lowest of the planes that rise
    from the sides with ``roof_slopes`` (0: no plane), cut off at ``roof_cap`` above the eaves.
    """

    corners: np.ndarray
    height: float
    wall: RGB
    material: Material = Material.PLAIN
    roof_slopes: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    roof_cap: float = 0.0
    roof: RGB = (0.1, 0.1, 0.1)
    trim: RGB = (0.6, 0.6, 0.55)
    accent: RGB = (0.1, 0.1, 0.1)
    sign: RGB = (0.3, 0.05, 0.05)
    windows: Windows = Windows.NONE
    ground: Ground = Ground.NONE
    gable: Gable = Gable.NONE
    gable_height: float = 0.0
    floor_height: float = 3.1
    ground_height: float = 3.6
    bay: float = 2.4
    window_width: float = 1.1
    window_height: float = 1.7
    sill: float = 0.8
    fronts: tuple[bool, bool, bool, bool] = (True, False, False, False)
    # Bits: 1 string course, 2 quoins, 4 cornice, 8 window surrounds, 16 coloured ground floor, 32 bands, 64 tiles,
    # 128 ivy, 256 pilasters, 512 mural on blind walls.
    ornament: int = 0
    seed: int = 0
    tags: frozenset[str] = field(default_factory=frozenset)


# A building as compiled code reads it; see Building.
PRISM = layout(
    corners=("f8", (4, 2)),
    normal=("f8", (4, 2)),  # outward
    offset=("f8", (4,)),  # a point p lies inside side k where normal . p < offset
    length=("f8", (4,)),
    slope=("f8", (4,)),
    height="f8",
    cap="f8",
    gable_height="f8",
    floor_height="f8",
    ground_height="f8",
    bay="f8",
    window_width="f8",
    window_height="f8",
    sill="f8",
    wall=RGB_FIELD,
    roof=RGB_FIELD,
    trim=RGB_FIELD,
    accent=RGB_FIELD,
    sign=RGB_FIELD,
    gable="i8",
    material="i8",
    windows="i8",
    ground="i8",
    ornament="i8",
    seed="f8",
    fronts=("i8", (4,)),
)


def as_records(buildings: list[Building]) -> np.ndarray:
    """Pack buildings into records ``PRISM``."""
    corners = np.array([b.corners for b in buildings], dtype=np.float64)
    direction = np.roll(corners, -1, axis=1) - corners
    length = np.linalg.norm(direction, axis=2)
    unit = direction / length[..., None]
    normal = np.stack([unit[..., 1], -unit[..., 0]], axis=2)
    derived = {
        "normal": normal,
        "offset": (normal * corners).sum(axis=2),
        "length": length,
        "slope": [b.roof_slopes for b in buildings],
        "cap": [b.roof_cap for b in buildings],
    }
    plain = {name: [getattr(b, name) for b in buildings] for name in PRISM.names if name not in derived}
    return records(PRISM, {**plain, **derived})


_WALLS = {
    Material.BRICK: palette.BRICK,
    Material.PLASTER: palette.PLASTER,
    Material.STONE: palette.STONE,
    Material.CONCRETE: palette.CONCRETE,
    Material.TIMBER: palette.TIMBER,
    Material.SIDING: palette.SIDING,
}

# For each character of a block: materials, floors (low, high), share of shops, roofs, bay width in metres.
_CHARACTERS = {
    "old": ((Material.BRICK, Material.PLASTER, Material.TIMBER, Material.PLASTER), (2, 4), 0.45, 2.2),
    "terrace": ((Material.BRICK, Material.BRICK, Material.PLASTER), (2, 3), 0.12, 2.6),
    "tenement": ((Material.PLASTER, Material.STONE, Material.BRICK, Material.PLASTER), (4, 5), 0.5, 2.5),
    "modern": ((Material.CONCRETE, Material.CONCRETE, Material.BRICK, Material.PLASTER), (3, 6), 0.4, 3.0),
}

CHARACTERS = tuple(_CHARACTERS)


def choose(rng: np.random.Generator, table: np.ndarray) -> np.ndarray:
    """Draw one row of a colour table and vary its brightness a little."""
    return np.clip(table[rng.integers(len(table))] * rng.uniform(0.85, 1.12), 0.0, 0.95)


def town_house(
    rng: np.random.Generator, corners: np.ndarray, character: str, fronts: tuple[bool, bool, bool, bool]
) -> Building:
    """Draw a house of a closed street front: material, floors, windows, ground floor, roof and ornaments."""
    materials, (low, high), shops, bay = _CHARACTERS[character]
    material = materials[rng.integers(len(materials))]
    floor_height = float(rng.uniform(2.8, 3.5))
    ground_height = floor_height + float(rng.uniform(0.2, 0.9))
    floors = int(rng.integers(low, high + 1))
    height = ground_height + (floors - 1) * floor_height + float(rng.uniform(0.3, 1.0))
    width = float(np.linalg.norm(corners[1] - corners[0]))
    modern = character == "modern"
    if modern:
        windows = Windows(rng.choice([Windows.STRIP, Windows.CURTAIN, Windows.SASH, Windows.FRENCH]))
    elif material == Material.TIMBER:
        windows = Windows.CROSS
    else:
        windows = Windows(
            rng.choice([Windows.CROSS, Windows.SASH, Windows.ARCHED, Windows.SHUTTERS, Windows.FRENCH, Windows.SASH])
        )
    ground = Ground.HOUSE
    if rng.random() < shops:
        ground = Ground.SHOP
    elif width > 9 and rng.random() < 0.25:
        ground = Ground(rng.choice([Ground.ARCADE, Ground.GATE]))
    house = Building(
        corners=corners,
        height=height,
        wall=choose(rng, _WALLS[material]),
        material=material,
        roof=choose(rng, palette.ROOF),
        trim=choose(rng, palette.TRIM),
        accent=choose(rng, palette.DOOR),
        sign=choose(rng, palette.SIGN),
        windows=windows,
        ground=ground,
        floor_height=floor_height,
        ground_height=ground_height,
        bay=bay * float(rng.uniform(0.85, 1.2)),
        window_width=float(rng.uniform(0.9, 1.35)),
        window_height=float(rng.uniform(1.4, 2.0)),
        sill=float(rng.uniform(0.55, 0.9)),
        fronts=fronts,
        ornament=_ornament(rng, modern, material),
        seed=int(rng.integers(1 << 30)),
        tags=frozenset({"house"}),
    )
    return _roofed(rng, house, width, modern)


def _ornament(rng: np.random.Generator, modern: bool, material: Material) -> int:
    bits = int(rng.integers(2) * 16) if modern else int(rng.integers(32))
    rare = ((32, 0.3 if material == Material.BRICK else 0.08), (64, 0.12 if material == Material.PLASTER else 0.0),
            (128, 0.0 if modern else 0.12), (256, 0.2 if material == Material.STONE else 0.07), (512, 0.5))  # fmt: skip
    return bits | sum(bit for bit, chance in rare if rng.random() < chance)


def _roofed(rng: np.random.Generator, house: Building, width: float, modern: bool) -> Building:
    slope = float(rng.uniform(0.7, 1.15))
    if modern:
        return replace(house, roof=(0.16, 0.16, 0.17))
    corner = house.fronts[1] or house.fronts[3]
    style = rng.random()
    if width < 9.5 and not corner and style < 0.42:
        # Gable to the street: the planes rise from the party walls.
        house = replace(house, roof_slopes=(0.0, slope * 1.15, 0.0, slope * 1.15), roof_cap=30.0)
        if rng.random() < 0.6:
            kind = Gable(rng.choice([Gable.STEPPED, Gable.BELL, Gable.PEDIMENT]))
            rise = 0.5 * width * slope * 1.15 if kind is not Gable.PEDIMENT else 0.28 * width
            house = replace(house, gable=kind, gable_height=float(rise * rng.uniform(0.85, 1.05)))
        return house
    if style < 0.8:
        side = slope if corner else 0.0
        return replace(house, roof_slopes=(slope, side, slope, side), roof_cap=30.0)
    if style < 0.93:
        return replace(house, roof_slopes=(2.6, 2.6 if corner else 0.0, 2.6, 2.6 if corner else 0.0), roof_cap=3.0)
    return house


def villa(rng: np.random.Generator, corners: np.ndarray) -> Building:
    """Draw a detached house, seen from all sides."""
    material = Material(rng.choice([Material.BRICK, Material.PLASTER, Material.SIDING, Material.SIDING]))
    floor_height = float(rng.uniform(2.6, 3.0))
    floors = int(rng.choice([1, 1, 2, 2, 3], p=[0.25, 0.2, 0.25, 0.25, 0.05]))
    slope = float(rng.uniform(0.5, 1.0))
    hip = slope if rng.random() < 0.4 else 0.0
    slopes = (slope, hip, slope, hip) if rng.random() < 0.6 else (hip, slope, hip, slope)
    windows = Windows(rng.choice([Windows.CROSS, Windows.SASH, Windows.SHUTTERS, Windows.STRIP]))
    return Building(
        corners=corners,
        height=floors * floor_height + 0.4,
        wall=choose(rng, _WALLS[material]),
        material=material,
        roof_slopes=slopes,
        roof_cap=30.0,
        roof=choose(rng, palette.ROOF),
        trim=choose(rng, palette.TRIM),
        accent=choose(rng, palette.DOOR),
        windows=windows,
        ground=Ground.HOUSE,
        floor_height=floor_height,
        ground_height=floor_height,
        bay=float(rng.uniform(2.3, 3.3)),
        window_width=float(rng.uniform(1.0, 1.6)),
        window_height=float(rng.uniform(1.1, 1.5)),
        sill=0.85,
        fronts=(True, True, True, True),
        ornament=int(rng.choice([0, 1, 8, 9, 128, 8 | 32])),
        seed=int(rng.integers(1 << 30)),
        tags=frozenset({"house", "villa"}),
    )


def rectangle(centre: np.ndarray, yaw: float, length: float, width: float) -> np.ndarray:
    """
    Return the corners of a rectangle, counter-clockwise from its rear right corner, shape (4, 2).

    >>> import numpy as np
    >>> rectangle(np.array([0.0, 0.0]), 0.0, 4.0, 2.0).tolist()
    [[-2.0, -1.0], [2.0, -1.0], [2.0, 1.0], [-2.0, 1.0]]
    """
    along = np.array([np.cos(yaw), np.sin(yaw)]) * length / 2
    across = np.array([-np.sin(yaw), np.cos(yaw)]) * width / 2
    return np.array(
        [centre - along - across, centre + along - across, centre + along + across, centre - along + across]
    )


def wall_between(a: np.ndarray, b: np.ndarray, thickness: float, **properties: object) -> Building:
    """Build a long thin prism (garden wall, hedge, parapet) centred on the line from ``a`` to ``b``."""
    delta = b - a
    corners = rectangle((a + b) / 2, float(np.arctan2(delta[1], delta[0])), float(np.linalg.norm(delta)), thickness)
    return Building(corners=corners, **properties)


def roof_height(building: Building, point: np.ndarray) -> float:
    """
    Height of a building's roof above a point inside its walls, metres.

    >>> import numpy as np
    >>> corners = rectangle(np.zeros(2), 0.0, 8.0, 4.0)
    >>> roof_height(Building(corners, 6.0, (1, 1, 1), roof_slopes=(1.0, 0, 1.0, 0), roof_cap=9.0), np.array([1.0, 0.5]))
    7.5
    """
    direction = np.roll(building.corners, -1, axis=0) - building.corners
    normal = np.stack([-direction[:, 1], direction[:, 0]], axis=1) / np.linalg.norm(direction, axis=1)[:, None]
    inside = ((point - building.corners) * normal).sum(axis=1)
    planes = [slope * d for slope, d in zip(building.roof_slopes, inside, strict=True) if slope > 0]
    return float(building.height + min([building.roof_cap, *planes]))


def church(rng: np.random.Generator, centre: np.ndarray, yaw: float) -> list[Building]:
    """Draw a church: a nave with a steep roof, a tower with a spire at its west end, and a low choir."""
    along = np.array([np.cos(yaw), np.sin(yaw)])
    material = Material.STONE if rng.random() < 0.6 else Material.BRICK
    shared = {
        "wall": choose(rng, _WALLS[material]),
        "material": material,
        "roof": palette.ROOF[2] if rng.random() < 0.5 else np.array([0.16, 0.33, 0.27]),
        "trim": palette.STONE[3],
        "accent": palette.DOOR[1],
        "windows": Windows.CHURCH,
        "fronts": (True, True, True, True),
        "floor_height": 40.0,
        "ground_height": 1.2,
        "bay": 3.6,
        "window_width": 1.2,
        "window_height": 4.6,
        "sill": 0.8,
        "ornament": 2 | 4,
        "seed": int(rng.integers(1 << 30)),
        "tags": frozenset({"landmark"}),
    }
    tower_height = float(rng.uniform(18, 25))
    return [
        Building(rectangle(centre, yaw, 22, 10), 8.5, roof_slopes=(1.4, 0, 1.4, 0), roof_cap=30.0, **shared),
        Building(
            rectangle(centre - 14.05 * along, yaw, 6, 6),
            tower_height,
            roof_slopes=(float(rng.uniform(3.2, 5.2)),) * 4,
            roof_cap=40.0,
            **{**shared, "bay": 3.0, "window_height": 2.2, "floor_height": 6.5},
        ),
        Building(
            rectangle(centre + 13.55 * along, yaw, 5, 7),
            6.0,
            roof_slopes=(1.2, 1.2, 1.2, 0),
            roof_cap=30.0,
            **{**shared, "window_height": 3.0},
        ),
    ]


def historical(rng: np.random.Generator, buildings: list[Building], share: float) -> list[Building]:
    """
    Return the same town some generations earlier: other shops everywhere, and some houses not yet rebuilt.

    Those are all modern ones, and ``share`` of the others.

    A rebuilt house keeps its lot, so that streets stay where they are.
    """
    earlier = []
    for b in buildings:
        if "house" not in b.tags:
            earlier.append(b)
        elif "modern" in b.tags or ("villa" not in b.tags and rng.random() < share):
            house = town_house(rng, b.corners, str(rng.choice(["old", "terrace"])), b.fronts)
            earlier.append(house)
        else:
            ground = b.ground
            if ground in (Ground.SHOP, Ground.HOUSE) and rng.random() < 0.15 and "villa" not in b.tags:
                ground = Ground.HOUSE if ground == Ground.SHOP else Ground.SHOP
            earlier.append(replace(b, sign=choose(rng, palette.SIGN), accent=choose(rng, palette.DOOR), ground=ground))
    return earlier
