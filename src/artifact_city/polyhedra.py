"""Small solids of polygons and rods: what models are built from. Metres; x forwards, y left, z up."""

from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np


class Surface(IntEnum):
    """What a polygon or rod is made of; the compiled shading code knows the values."""

    PAINT = 0  # the thing's own colour
    GLASS = 1
    RUBBER = 2
    STEEL = 3
    HEADLIGHT = 4
    TAILLIGHT = 5
    LANTERN = 6
    WOOD = 7
    STONE = 8
    CANVAS = 9
    RAILING = 10
    TRIM = 11
    SKIN = 12
    POSTER = 13
    WINDOW = 14
    SIGN = 15
    DARK = 16
    PLANT = 17


@dataclass
class Model:
    """A thing under construction: vertices, the polygons between them, rods, and what each is made of."""

    vertices: list = field(default_factory=list)
    faces: list = field(default_factory=list)
    surfaces: list = field(default_factory=list)
    rods: list = field(default_factory=list)
    rod_surfaces: list = field(default_factory=list)

    def face(self, surface: Surface, *corners: tuple[float, float, float]) -> None:
        """Add a polygon of three or four corners, counter-clockwise seen from outside."""
        first = len(self.vertices)
        self.vertices += corners
        index = list(range(first, first + len(corners)))
        self.faces.append((index + index[-1:])[:4])
        self.surfaces.append(surface)

    def outward(self, surface: Surface, *corners: tuple[float, float, float]) -> None:
        """Add a polygon, in whichever order of its corners faces away from the middle of a car."""
        p = np.array(corners)
        facing = np.cross(p[1] - p[0], p[2] - p[0]) @ (p.mean(axis=0) - (0.0, 0.0, 0.75))
        self.face(surface, *(corners if facing > 0 else corners[::-1]))

    def box(self, low: tuple, high: tuple, surface: Surface, *, top: Surface | None = None) -> None:
        """Add an upright box without its underside."""
        (x0, y0, z0), (x1, y1, z1) = low, high
        self.face(surface, (x0, y1, z0), (x0, y0, z0), (x0, y0, z1), (x0, y1, z1))
        self.face(surface, (x1, y0, z0), (x1, y1, z0), (x1, y1, z1), (x1, y0, z1))
        self.face(surface, (x0, y0, z0), (x1, y0, z0), (x1, y0, z1), (x0, y0, z1))
        self.face(surface, (x1, y1, z0), (x0, y1, z0), (x0, y1, z1), (x1, y1, z1))
        self.face(surface if top is None else top, (x0, y0, z1), (x1, y0, z1), (x1, y1, z1), (x0, y1, z1))

    def drum(self, x: float, y: float, z0: float, z1: float, r0: float, r1: float, surface: Surface) -> None:
        """Add an upright eight-sided drum or cone without its underside."""
        turn = 2 * np.pi * np.arange(9) / 8
        low = [(x + r0 * np.cos(t), y + r0 * np.sin(t), z0) for t in turn]
        high = [(x + r1 * np.cos(t), y + r1 * np.sin(t), z1) for t in turn]
        for k in range(8):
            self.face(surface, low[k], low[k + 1], high[k + 1], high[k])
            if r1 > 0.02:
                self.face(surface, (x, y, z1), high[k], high[k + 1])

    def rod(self, a: tuple, b: tuple, ra: float, rb: float, surface: Surface) -> None:
        """Add a round rod from ``a`` to ``b`` whose radius goes from ``ra`` to ``rb``."""
        self.rods.append((*a, *b, ra, rb))
        self.rod_surfaces.append(surface)
