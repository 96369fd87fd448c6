"""The library of models, and the list of where they are placed. Metres; x forwards, y left, z up."""

from functools import cache
from typing import NamedTuple

import numpy as np

from artifact_city import house_parts, lineside, street_furniture, vehicles
from artifact_city.records import RGB, layout, records

# Models and placed things as compiled code reads them.
FACE = layout(corners=("f8", (4, 3)), normal=("f8", (3,)), surface="i8")
ROD = layout(start=("f8", (3,)), end=("f8", (3,)), r0="f8", r1="f8", surface="i8")
MODEL_RECORD = layout(first_face="i8", last_face="i8", first_rod="i8", last_rod="i8", radius="f8", top="f8")
THING = layout(
    x="f8", y="f8", z="f8", yaw="f8", scale=("f8", (3,)), colour=RGB, second=RGB, lit="f8", model="i8", seed="f8"
)


class Models(NamedTuple):
    """All models: which faces and rods belong to each, the faces, the rods."""

    models: np.ndarray
    faces: np.ndarray
    rods: np.ndarray


# Cars come first and then the cart: compiled code tells them by their number.
CARS = ("hatchback", "saloon", "estate", "van")
N_CARS = len(CARS)
_MAKERS = {
    "hatchback": vehicles.hatchback,
    "saloon": vehicles.saloon,
    "estate": vehicles.estate,
    "van": vehicles.van,
    "cart": vehicles.cart,
    "walker": lambda: vehicles.person(0.26, coat=False, hat=False),
    "stander": lambda: vehicles.person(0.06, coat=False, hat=False),
    "coat": lambda: vehicles.person(0.2, coat=True, hat=False),
    "hat": lambda: vehicles.person(0.18, coat=True, hat=True),
    "bicycle": vehicles.bicycle,
    "lamp": street_furniture.street_lamp,
    "lantern": street_furniture.lantern,
    "bench": street_furniture.bench,
    "balcony": house_parts.balcony,
    "awning": house_parts.awning,
    "sign": house_parts.hanging_sign,
    "oriel": house_parts.oriel,
    "dormer": house_parts.dormer,
    "chimney": house_parts.chimney,
    "stall": street_furniture.stall,
    "pillar": street_furniture.pillar,
    "fountain": street_furniture.fountain,
    "statue": street_furniture.statue,
    "mast": lineside.mast,
    "signal": lineside.signal,
    "shelter": street_furniture.shelter,
    "traffic_sign": street_furniture.traffic_sign,
    "traffic_light": street_furniture.traffic_light,
    "bin": street_furniture.litter_bin,
    "bollard": street_furniture.bollard,
    "silo": lineside.silo,
    "water_tower": lineside.water_tower,
    "stack": lineside.stack,
    "wire": lineside.wire,
    "parasol": street_furniture.parasol,
    "banner": house_parts.banner,
    "planter": street_furniture.planter,
    "kiosk": street_furniture.kiosk,
    "post_box": street_furniture.post_box,
    "booth": street_furniture.booth,
    "billboard": street_furniture.billboard,
    "clock": street_furniture.clock,
    "deck": lineside.deck,
    "wagon": vehicles.wagon,
    "hut": lineside.hut,
    "pole": lineside.pole,
}

MODEL = {name: index for index, name in enumerate(_MAKERS)}


@cache
def models() -> Models:
    """Build all models once."""
    made = [make() for make in _MAKERS.values()]
    corners = np.array([[m.vertices[k] for k in f] for m in made for f in m.faces], dtype=np.float64)
    a, b, c, d = (corners[:, k] for k in range(4))
    normal = np.cross(c - a, d - b) + np.cross(b - a, c - a)  # a triangle repeats its last corner
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    rods = np.array([r for m in made for r in m.rods], dtype=np.float64)
    first_face = np.cumsum([0] + [len(m.faces) for m in made])
    first_rod = np.cumsum([0] + [len(m.rods) for m in made])
    extent = [np.array(m.vertices + [r[k : k + 3] for r in m.rods for k in (0, 3)]) for m in made]
    return Models(
        records(
            MODEL_RECORD,
            {
                "first_face": first_face[:-1],
                "last_face": first_face[1:],
                "first_rod": first_rod[:-1],
                "last_rod": first_rod[1:],
                "radius": [np.hypot(e[:, 0], e[:, 1]).max() for e in extent],
                "top": [e[:, 2].max() for e in extent],
            },
        ),
        records(FACE, {"corners": corners, "normal": normal, "surface": [s for m in made for s in m.surfaces]}),
        records(
            ROD,
            {
                "start": rods[:, :3],
                "end": rods[:, 3:6],
                "r0": rods[:, 6],
                "r1": rods[:, 7],
                "surface": [s for m in made for s in m.rod_surfaces],
            },
        ),
    )


class ThingList:
    """Collects placed models while a town or a traversal is furnished."""

    def __init__(self) -> None:
        self._rows: list[tuple] = []

    def __len__(self) -> int:
        return len(self._rows)

    def add(
        self,
        name: str,
        x: float,
        y: float,
        yaw: float,
        *,
        z: float = 0.0,
        scale: tuple[float, float, float] = (1.0, 1.0, 1.0),
        colour: object = (0.3, 0.3, 0.3),
        second: object = (0.7, 0.7, 0.65),
        lit: bool = False,
        seed: int = 0,
    ) -> None:
        """Place one model at ``(x, y, z)`` with its front towards ``yaw`` (radians)."""
        self._rows.append((x, y, z, yaw, scale, tuple(colour), tuple(second), float(lit), MODEL[name], seed))

    def records(self) -> np.ndarray:
        """Return everything placed so far, as records ``THING``."""
        return np.array(self._rows, dtype=THING)
