"""Houses, villas and churches, drawn at random within the character of their street."""

from dataclasses import replace

import numpy as np

from artifact_city import palette
from artifact_city.buildings import Building, Gable, Ground, Material, Windows, rectangle
from artifact_city.palette import choose

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
    """Return the same town some generations earlier: other shops everywhere, and some houses not yet rebuilt.

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
