"""Buildings and everything else that is a prism with a roof: what they are, and how compiled code sees them."""

from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np

from artifact_city.records import RGB as RGB_FIELD
from artifact_city.records import layout, records

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
    """One prism over a convex quadrilateral, with its facade and roof. Lengths in metres, colours in linear light.

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


FACADE_EDGE = 0.45  # metres between a house's corner and its first bay

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


def rectangle(centre: np.ndarray, yaw: float, length: float, width: float) -> np.ndarray:
    """Return the corners of a rectangle, counter-clockwise from its rear right corner, shape (4, 2).

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
    """Height of a building's roof above a point inside its walls, metres.

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
