"""Small solids of polygons and rods: what models are built from. Metres; x forwards, y left, z up."""

from enum import IntEnum
from typing import NamedTuple

import numpy as np

from artifact_city.kernel import layout, records

# Models and their parts as compiled code reads them. The box of a model is upright and symmetric about its axis.
FACE = layout("corners:4x3 normal:3 surface:i")
ROD = layout("start:3 end:3 r0 r1 surface:i")
MODEL = layout("first_face:i last_face:i first_rod:i last_rod:i radius half_x half_y top")


# What a polygon or rod is made of; paint has the thing's own colour, a sign its second one.
Surface = IntEnum(
    "Surface",
    "PAINT GLASS RUBBER STEEL HEADLIGHT TAILLIGHT LANTERN WOOD STONE CANVAS RAILING TRIM SKIN WINDOW SIGN DARK",
    start=0,
)


class Model:
    """A thing under construction; every method adds to it and returns it."""

    def __init__(self) -> None:
        self.faces: list[tuple] = []
        self.rods: list[tuple] = []

    def face(self, surface: Surface, *corners: tuple[float, float, float], both: bool = False) -> "Model":
        """Add a polygon of three or four corners, counter-clockwise seen from outside, or seen from both sides."""
        self.faces.append(((corners + corners[-1:])[:4], surface))
        return self.face(surface, *corners[::-1]) if both else self

    def outward(self, surface: Surface, *corners: tuple[float, float, float]) -> "Model":
        """Add a polygon, in whichever order of its corners faces away from the middle of a car."""
        p = np.array(corners)
        facing = np.cross(p[1] - p[0], p[2] - p[0]) @ (p.mean(axis=0) - (0.0, 0.0, 0.75))
        return self.face(surface, *(corners if facing > 0 else corners[::-1]))

    def disc(self, surface: Surface, centre: tuple[float, float, float], radius: float, side: str) -> "Model":
        """Add an octagon that faces ``+x``, ``-x``, or ``y``: then outwards from the middle of a car."""
        (x, y, z), turn = centre, 2 * np.pi * np.arange(8) / 8
        across, up = radius * np.cos(turn), z + radius * np.sin(turn)
        ring = [(x + a, y, b) if side == "y" else (x, y + a, b) for a, b in zip(across, up, strict=True)]
        for k in (1, 3, 5):
            corners = ring[0], ring[k], ring[k + 1], ring[(k + 2) % 8]
            if side == "y":
                self.outward(surface, *corners)
            else:
                self.face(surface, *(corners if side == "+x" else corners[::-1]))
        return self

    def box(self, low: tuple, high: tuple, surface: Surface) -> "Model":
        """Add an upright box without its underside."""
        (x0, y0, z0), (x1, y1, z1) = low, high
        self.face(surface, (x0, y1, z0), (x0, y0, z0), (x0, y0, z1), (x0, y1, z1))
        self.face(surface, (x1, y0, z0), (x1, y1, z0), (x1, y1, z1), (x1, y0, z1))
        self.face(surface, (x0, y0, z0), (x1, y0, z0), (x1, y0, z1), (x0, y0, z1))
        self.face(surface, (x1, y1, z0), (x0, y1, z0), (x0, y1, z1), (x1, y1, z1))
        return self.face(surface, (x0, y0, z1), (x1, y0, z1), (x1, y1, z1), (x0, y1, z1))

    def drum(self, y: float, z0: float, z1: float, r0: float, r1: float, surface: Surface) -> "Model":
        """Add an upright eight-sided drum or cone above ``(0, y, z0)`` without its underside."""
        turn = 2 * np.pi * np.arange(9) / 8
        low, high = ([(r * np.cos(t), y + r * np.sin(t), z) for t in turn] for r, z in ((r0, z0), (r1, z1)))
        for k in range(8):
            self.face(surface, low[k], low[k + 1], high[k + 1], high[k])
            self.face(surface, (0.0, y, z1), high[k], high[k + 1])
        return self

    def rod(self, a: tuple, b: tuple, ra: float, rb: float, surface: Surface) -> "Model":
        """Add a round rod from ``a`` to ``b`` whose radius goes from ``ra`` to ``rb``."""
        self.rods.append((a, b, ra, rb, surface))
        return self


class Models(NamedTuple):
    """A library of models: which faces and rods belong to each, the faces, the rods."""

    models: np.ndarray
    faces: np.ndarray
    rods: np.ndarray


def pack(made: list[Model]) -> Models:
    """Hand models to compiled code."""
    corners, surface = (np.array(c) for c in zip(*(f for m in made for f in m.faces), strict=True))
    a, b, c, d = corners.transpose(1, 0, 2)
    normal = np.cross(c - a, d - b) + np.cross(b - a, c - a)  # a triangle repeats its last corner
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    rods = np.array([r for m in made for r in m.rods], dtype=ROD)
    first_face, first_rod = (np.cumsum([0, *map(len, of)]) for of in ([m.faces for m in made], [m.rods for m in made]))
    points = [np.array([p for f in m.faces for p in f[0]] + [p for r in m.rods for p in r[:2]]) for m in made]
    half = np.array([np.abs(p).max(axis=0) for p in points])
    columns = {
        "first_face": first_face[:-1],
        "last_face": first_face[1:],
        "first_rod": first_rod[:-1],
        "last_rod": first_rod[1:],
        "radius": [np.hypot(*p[:, :2].T).max() for p in points],
        "half_x": half[:, 0],
        "half_y": half[:, 1],
        "top": [p[:, 2].max() for p in points],
    }
    return Models(
        records(MODEL, columns), records(FACE, {"corners": corners, "normal": normal, "surface": surface}), rods
    )
