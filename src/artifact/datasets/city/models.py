"""Small things as polygons and rods: cars, people, lamps, balconies. Metres; x forwards, y left, z up."""

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cache
from typing import NamedTuple

import numpy as np

from .records import RGB, layout, records


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
class _Model:
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


def _car(profile: list[tuple[float, float]], glass: list[bool], belt: float, half: float, wheels: tuple) -> _Model:
    """
    Extrude a side outline, from the front bumper over the roof to the rear bumper.

    Above the belt line the cabin leans inwards; ``glass[k]`` says whether the strip from point k to k + 1 is a window.
    """
    model = _Model()
    roof = max(z for _, z in profile)

    def side(x: float, z: float, sign: int) -> tuple[float, float, float]:
        lean = 0.17 * (z - belt) / (roof - belt) if z > belt else 0.0
        return (x, sign * (half - lean), z)

    for k in range(len(profile) - 1):
        a, b = profile[k], profile[k + 1]
        surface = Surface.GLASS if glass[k] else Surface.PAINT
        model.outward(surface, side(*a, 1), side(*a, -1), side(*b, -1), side(*b, 1))
    cabin = [p for p in profile if p[1] >= belt]
    body = [p for p in profile if p[1] < belt]
    outline = [p for p in body if p[0] > 0] + cabin[:1] + cabin[-1:] + [p for p in body if p[0] <= 0]
    middle = ((profile[0][0] + profile[-1][0]) / 2, profile[0][1])
    for sign in (1, -1):
        for p, q in zip(outline, outline[1:], strict=False):
            model.outward(Surface.PAINT, side(*middle, sign), side(*p, sign), side(*q, sign))
        low, y = profile[0][1] - 0.03, sign * (half + 0.012)
        ends = (profile[0][0] - 0.1, profile[-1][0] + 0.1)
        model.outward(
            Surface.RUBBER, (ends[0], y, low), (ends[0], y, low + 0.16), (ends[1], y, low + 0.16), (ends[1], y, low)
        )
        _cabin_side(model, cabin, side, sign)
        for x in wheels:
            _wheel(model, x, sign * (half + 0.01), sign)
    _car_ends(model, profile, half)
    return model


def _cabin_side(model: _Model, cabin: list, side: Callable, sign: int) -> None:
    if len(cabin) < 4:
        return
    front, front_up, rear_up, rear = cabin
    model.outward(Surface.PAINT, *(side(*p, sign) for p in cabin))
    middle = (front_up[0] + rear_up[0]) / 2
    z0, z1 = max(front[1], rear[1]) + 0.03, front_up[1] - 0.07
    for a, b, c, d in (
        (front[0] - 0.12, front_up[0] - 0.06, middle + 0.05, middle + 0.05),
        (middle - 0.05, middle - 0.05, rear_up[0] + 0.1, rear[0] + 0.16),
    ):
        corners = (side(*p, sign) for p in ((a, z0), (b, z1), (c, z1), (d, z0)))
        model.outward(Surface.GLASS, *((x, y + sign * 0.015, z) for x, y, z in corners))


def _wheel(model: _Model, x: float, y: float, sign: int) -> None:
    turn = 2 * np.pi * np.arange(8) / 8
    for radius, shift, surface in ((0.34, 0.0, Surface.RUBBER), (0.19, 0.01, Surface.STEEL)):
        ring = [(x + radius * np.cos(t), y + sign * shift, 0.34 + radius * np.sin(t)) for t in turn]
        for k in (1, 3, 5):
            model.outward(surface, ring[0], ring[k], ring[k + 1], ring[(k + 2) % 8])


def _car_ends(model: _Model, profile: list, half: float) -> None:
    front, rear = max(p[0] for p in profile) + 0.02, min(p[0] for p in profile) - 0.02
    lights = ((front, Surface.HEADLIGHT, 0.58, 0.74), (rear, Surface.TAILLIGHT, 0.72, 0.92))
    for x, surface, z0, z1 in lights:
        for y in (half - 0.32, -half + 0.32):
            model.outward(surface, (x, y - 0.2, z0), (x, y + 0.2, z0), (x, y + 0.2, z1), (x, y - 0.2, z1))
    for x in (front, rear):
        model.outward(Surface.TRIM, (x, -0.26, 0.42), (x, 0.26, 0.42), (x, 0.26, 0.53), (x, -0.26, 0.53))
        model.outward(Surface.DARK, (x, -0.75, 0.2), (x, 0.75, 0.2), (x, 0.75, 0.36), (x, -0.75, 0.36))


def _hatchback() -> _Model:
    outline = [(1.95, 0.25), (2.02, 0.62), (1.75, 0.86), (0.98, 0.98), (0.3, 1.44), (-1.15, 1.46), (-1.78, 1.0)]
    outline += [(-1.98, 0.85), (-1.98, 0.28)]
    return _car(outline, [False, False, False, True, False, True, False, False], 0.98, 0.86, (1.25, -1.25))


def _saloon() -> _Model:
    outline = [(2.2, 0.25), (2.28, 0.62), (2.0, 0.84), (0.95, 0.95), (0.25, 1.4), (-1.0, 1.41), (-1.7, 0.98)]
    outline += [(-2.2, 0.94), (-2.28, 0.62), (-2.25, 0.28)]
    return _car(outline, [False, False, False, True, False, True, False, False, False], 0.95, 0.88, (1.4, -1.4))


def _estate() -> _Model:
    outline = [(2.2, 0.3), (2.26, 0.72), (2.0, 0.98), (1.1, 1.08), (0.45, 1.62), (-1.9, 1.64), (-2.2, 1.08)]
    outline += [(-2.26, 0.8), (-2.24, 0.3)]
    return _car(outline, [False, False, False, True, False, True, False, False], 1.08, 0.92, (1.4, -1.35))


def _van() -> _Model:
    outline = [(2.5, 0.3), (2.55, 0.95), (2.2, 1.2), (1.55, 1.95), (1.2, 2.15), (-2.5, 2.2), (-2.55, 0.35)]
    model = _car(outline, [False, False, True, False, False, False], 3.0, 0.98, (1.65, -1.6))
    for y in (0.995, -0.995):
        model.outward(Surface.GLASS, (2.05, y, 1.22), (1.5, y, 1.82), (0.75, y, 1.82), (0.75, y, 1.22))
    return model


def _cart() -> _Model:
    model = _Model()
    model.box((-1.1, -0.55, 0.75), (1.0, 0.55, 1.15), Surface.WOOD)
    model.rod((1.0, 0.4, 0.85), (2.6, 0.3, 0.9), 0.04, 0.03, Surface.WOOD)
    model.rod((1.0, -0.4, 0.85), (2.6, -0.3, 0.9), 0.04, 0.03, Surface.WOOD)
    for y in (-0.66, 0.66):
        turn = 2 * np.pi * np.arange(13) / 12
        ring = [(-0.1 + 0.62 * np.cos(t), y, 0.62 + 0.62 * np.sin(t)) for t in turn]
        for a, b in zip(ring, ring[1:], strict=False):
            model.rod(a, b, 0.035, 0.035, Surface.DARK)
        for k in range(0, 12, 2):
            model.rod((-0.1, y, 0.62), ring[k], 0.025, 0.02, Surface.WOOD)
    for k, z in enumerate((1.2, 1.35, 1.3)):
        model.drum(-0.7 + 0.6 * k, 0.0, 1.15, z + 0.35, 0.27, 0.22, Surface.PAINT)
    return model


def _person(step: float, coat: bool, hat: bool) -> _Model:
    model = _Model()
    model.rod((step, 0.09, 0.05), (0.0, 0.08, 0.85), 0.065, 0.1, Surface.DARK)
    model.rod((-step, -0.09, 0.05), (0.0, -0.08, 0.85), 0.065, 0.1, Surface.DARK)
    model.rod((0.0, 0.0, 0.55 if coat else 0.9), (0.0, 0.0, 1.3), 0.22 if coat else 0.17, 0.2, Surface.PAINT)
    model.rod((0.0, 0.21, 1.36), (-0.8 * step, 0.27, 0.85), 0.065, 0.05, Surface.PAINT)
    model.rod((0.0, -0.21, 1.36), (0.8 * step, -0.27, 0.85), 0.065, 0.05, Surface.PAINT)
    model.rod((0.0, 0.0, 1.56), (0.02, 0.0, 1.64), 0.105, 0.105, Surface.SKIN)
    model.rod((-0.02, 0.0, 1.7), (-0.02, 0.0, 1.76 if hat else 1.71), 0.12 if hat else 0.1, 0.1, Surface.DARK)
    return model


def _bicycle() -> _Model:
    model = _Model()
    for x in (-0.5, 0.5):
        turn = 2 * np.pi * np.arange(11) / 10
        ring = [(x + 0.33 * np.cos(t), 0.0, 0.35 + 0.33 * np.sin(t)) for t in turn]
        for a, b in zip(ring, ring[1:], strict=False):
            model.rod(a, b, 0.02, 0.02, Surface.DARK)
    for a, b in (((-0.5, 0.35), (-0.15, 0.85)), ((-0.5, 0.35), (-0.05, 0.35)), ((-0.05, 0.35), (0.38, 0.82)),
                 ((-0.12, 0.8), (0.38, 0.8)), ((0.5, 0.35), (0.36, 0.98)), ((-0.05, 0.35), (-0.16, 0.92))):  # fmt: skip
        model.rod((a[0], 0, a[1]), (b[0], 0, b[1]), 0.022, 0.022, Surface.PAINT)
    model.rod((0.36, 0.28, 0.98), (0.36, -0.28, 0.98), 0.02, 0.02, Surface.DARK)
    model.rod((-0.28, 0.0, 0.95), (-0.05, 0.0, 0.95), 0.05, 0.03, Surface.DARK)
    return model


def _street_lamp() -> _Model:
    model = _Model()
    model.rod((0, 0, 0), (0, 0, 6.6), 0.09, 0.055, Surface.STEEL)
    model.rod((0, 0, 6.5), (1.25, 0, 6.85), 0.05, 0.04, Surface.STEEL)
    model.box((0.95, -0.13, 6.78), (1.6, 0.13, 6.9), Surface.STEEL)
    model.face(Surface.LANTERN, (1.0, 0.11, 6.77), (1.55, 0.11, 6.77), (1.55, -0.11, 6.77), (1.0, -0.11, 6.77))
    return model


def _lantern() -> _Model:
    model = _Model()
    model.rod((0, 0, 0), (0, 0, 0.8), 0.1, 0.08, Surface.DARK)
    model.rod((0, 0, 0.8), (0, 0, 3.5), 0.055, 0.045, Surface.DARK)
    model.rod((0, -0.3, 3.2), (0, 0.3, 3.2), 0.025, 0.025, Surface.DARK)
    model.drum(0, 0, 3.5, 4.0, 0.13, 0.24, Surface.LANTERN)
    model.drum(0, 0, 4.0, 4.28, 0.27, 0.03, Surface.DARK)
    return model


def _bench() -> _Model:
    model = _Model()
    model.box((-0.85, -0.22, 0.4), (0.85, 0.2, 0.46), Surface.WOOD)
    model.face(Surface.WOOD, (0.85, -0.24, 0.5), (-0.85, -0.24, 0.5), (-0.85, -0.3, 0.88), (0.85, -0.3, 0.88))
    model.face(Surface.WOOD, (-0.85, -0.24, 0.5), (0.85, -0.24, 0.5), (0.85, -0.3, 0.88), (-0.85, -0.3, 0.88))
    for x in (-0.7, 0.7):
        model.rod((x, 0.15, 0), (x, 0.15, 0.42), 0.03, 0.03, Surface.DARK)
        model.rod((x, -0.22, 0), (x, -0.3, 0.88), 0.03, 0.03, Surface.DARK)
    return model


def _balcony() -> _Model:
    # x outwards from the wall, y along it; the railing is drawn as bars.
    model = _Model()
    model.box((0.0, -1.0, -0.16), (0.95, 1.0, 0.0), Surface.TRIM)
    model.face(Surface.TRIM, (0.0, 1.0, -0.16), (0.95, 1.0, -0.16), (0.95, -1.0, -0.16), (0.0, -1.0, -0.16))
    model.face(Surface.RAILING, (0.93, -1.0, 0.0), (0.93, 1.0, 0.0), (0.93, 1.0, 1.0), (0.93, -1.0, 1.0))
    model.face(Surface.RAILING, (0.0, -0.98, 0.0), (0.93, -0.98, 0.0), (0.93, -0.98, 1.0), (0.0, -0.98, 1.0))
    model.face(Surface.RAILING, (0.93, 0.98, 0.0), (0.0, 0.98, 0.0), (0.0, 0.98, 1.0), (0.93, 0.98, 1.0))
    return model


def _awning() -> _Model:
    # Unit width along y, one metre deep; scaled to its shop.
    model = _Model()
    model.face(Surface.CANVAS, (1.0, -0.5, -0.45), (1.0, 0.5, -0.45), (0.0, 0.5, 0.0), (0.0, -0.5, 0.0))
    model.face(Surface.CANVAS, (1.0, 0.5, -0.45), (1.0, -0.5, -0.45), (0.0, -0.5, -0.02), (0.0, 0.5, -0.02))
    model.face(Surface.CANVAS, (1.0, -0.5, -0.68), (1.0, 0.5, -0.68), (1.0, 0.5, -0.45), (1.0, -0.5, -0.45))
    return model


def _hanging_sign() -> _Model:
    model = _Model()
    model.rod((0.0, 0.0, 0.32), (0.95, 0.0, 0.32), 0.02, 0.02, Surface.DARK)
    model.box((0.2, -0.05, -0.4), (0.9, 0.05, 0.28), Surface.SIGN)
    return model


def _oriel() -> _Model:
    # A bay window: x outwards, y along the wall, one storey high.
    model = _Model()
    w, d, h = 0.95, 0.7, 2.5
    ring = [(0.0, -w - 0.4), (d, -w), (d, w), (0.0, w + 0.4)]
    for (x0, y0), (x1, y1) in zip(ring, ring[1:], strict=False):
        model.face(Surface.PAINT, (x0, y0, 0), (x1, y1, 0), (x1, y1, h), (x0, y0, h))
        a, b = 0.14, 0.86
        low = (x0 + (x1 - x0) * a, y0 + (y1 - y0) * a), (x0 + (x1 - x0) * b, y0 + (y1 - y0) * b)
        out = 0.02
        (xa, ya), (xb, yb) = low
        model.face(Surface.WINDOW, (xa + out, ya, 0.7), (xb + out, yb, 0.7), (xb + out, yb, 2.2), (xa + out, ya, 2.2))
    for k in range(3):
        (x0, y0), (x1, y1) = ring[k], ring[k + 1]
        model.face(Surface.TRIM, (x0 * 1.1, y0, h), (x1 * 1.1, y1, h), (0, 0, h + 0.35))
        model.face(Surface.TRIM, (x1, y1, 0), (x0, y0, 0), (0, 0, -0.4))
    return model


def _dormer() -> _Model:
    # x outwards; its back end disappears in the roof.
    model = _Model()
    w, h, back, top = 0.7, 1.15, -2.4, 1.65
    model.face(Surface.PAINT, (0, -w, 0), (0, w, 0), (0, w, h), (0, -w, h))
    model.face(Surface.PAINT, (0, -w, h), (0, w, h), (0, 0, top))
    model.face(Surface.WINDOW, (0.02, -0.48, 0.25), (0.02, 0.48, 0.25), (0.02, 0.48, 1.1), (0.02, -0.48, 1.1))
    model.face(Surface.PAINT, (back, -w, 0), (0, -w, 0), (0, -w, h), (back, -w, h))
    model.face(Surface.PAINT, (0, w, 0), (back, w, 0), (back, w, h), (0, w, h))
    model.face(Surface.SIGN, (back, -w - 0.1, h - 0.08), (0.12, -w - 0.1, h - 0.08), (0.12, 0, top), (back, 0, top))
    model.face(Surface.SIGN, (0.12, w + 0.1, h - 0.08), (back, w + 0.1, h - 0.08), (back, 0, top), (0.12, 0, top))
    return model


def _chimney() -> _Model:
    model = _Model()
    model.box((-0.3, -0.45, -2.0), (0.3, 0.45, 1.3), Surface.PAINT)
    model.box((-0.36, -0.52, 1.3), (0.36, 0.52, 1.42), Surface.STONE)
    for y in (-0.22, 0.22):
        model.drum(0.0, y, 1.42, 1.78, 0.12, 0.1, Surface.PAINT)
    return model


def _stall() -> _Model:
    model = _Model()
    model.box((-1.5, -0.9, 0.0), (1.5, 0.0, 0.85), Surface.WOOD)
    for x in (-1.5, 1.5):
        for y, z in ((-1.2, 2.1), (0.9, 2.4)):
            model.rod((x, y, 0), (x, y, z), 0.03, 0.03, Surface.STEEL)
    model.face(Surface.CANVAS, (-1.7, -1.5, 2.0), (1.7, -1.5, 2.0), (1.7, 0.0, 2.7), (-1.7, 0.0, 2.7))
    model.face(Surface.CANVAS, (1.7, 1.2, 2.2), (-1.7, 1.2, 2.2), (-1.7, 0.0, 2.7), (1.7, 0.0, 2.7))
    model.face(Surface.CANVAS, (1.7, -1.5, 2.0), (-1.7, -1.5, 2.0), (-1.7, 0.0, 2.69), (1.7, 0.0, 2.69))
    model.face(Surface.CANVAS, (-1.7, 1.2, 2.2), (1.7, 1.2, 2.2), (1.7, 0.0, 2.69), (-1.7, 0.0, 2.69))
    return model


def _pillar() -> _Model:
    model = _Model()
    model.drum(0, 0, 0, 0.3, 0.72, 0.68, Surface.STONE)
    model.drum(0, 0, 0.3, 2.7, 0.62, 0.62, Surface.POSTER)
    model.drum(0, 0, 2.7, 2.85, 0.74, 0.74, Surface.TRIM)
    model.drum(0, 0, 2.85, 3.35, 0.66, 0.0, Surface.DARK)
    return model


def _fountain() -> _Model:
    model = _Model()
    model.drum(0, 0, 0, 0.6, 2.9, 2.9, Surface.STONE)
    model.drum(0, 0, 0.6, 2.0, 0.45, 0.3, Surface.STONE)
    model.drum(0, 0, 2.0, 2.25, 0.9, 1.2, Surface.STONE)
    model.drum(0, 0, 2.25, 3.4, 0.22, 0.1, Surface.STONE)
    return model


def _statue() -> _Model:
    model = _Model()
    model.box((-1.1, -1.1, 0), (1.1, 1.1, 0.5), Surface.STONE)
    model.box((-0.7, -0.7, 0.5), (0.7, 0.7, 2.6), Surface.STONE)
    model.rod((0, 0.14, 2.6), (0, 0.12, 3.6), 0.14, 0.2, Surface.DARK)
    model.rod((0.1, -0.14, 2.6), (0, -0.12, 3.6), 0.14, 0.2, Surface.DARK)
    model.rod((0, 0, 3.5), (0, 0, 4.4), 0.34, 0.32, Surface.DARK)
    model.rod((0, 0.36, 4.35), (0.5, 0.6, 4.9), 0.12, 0.08, Surface.DARK)
    model.rod((0, -0.36, 4.35), (0.05, -0.5, 3.6), 0.12, 0.09, Surface.DARK)
    model.rod((0, 0, 4.75), (0, 0, 4.9), 0.18, 0.17, Surface.DARK)
    return model


def _mast() -> _Model:
    # Beside a track: the arm reaches over it.
    model = _Model()
    model.rod((0, 0, 0), (0, 0, 7.4), 0.13, 0.1, Surface.STEEL)
    model.rod((0, 0, 6.9), (3.3, 0, 6.4), 0.04, 0.04, Surface.STEEL)
    model.rod((0, 0, 5.6), (3.3, 0, 6.4), 0.04, 0.03, Surface.STEEL)
    model.rod((2.9, 0, 6.35), (2.9, 0, 5.4), 0.025, 0.025, Surface.STEEL)
    return model


def _wire() -> _Model:
    # One metre long; scaled to its span.
    model = _Model()
    model.rod((0, 0, 0), (1, 0, 0), 0.014, 0.014, Surface.DARK)
    return model


def _deck() -> _Model:
    # A unit slab with parapets, scaled to the bridge it carries; its underside shows.
    model = _Model()
    model.box((-0.5, -0.5, 0.0), (0.5, 0.5, 0.9), Surface.PAINT)
    model.face(Surface.PAINT, (-0.5, 0.5, 0.0), (0.5, 0.5, 0.0), (0.5, -0.5, 0.0), (-0.5, -0.5, 0.0))
    for y in (-0.5, 0.46):
        model.box((-0.5, y, 0.9), (0.5, y + 0.04, 1.9), Surface.STONE)
    return model


def _wagon() -> _Model:
    model = _Model()
    model.box((-5.0, -1.35, 0.95), (5.0, 1.35, 3.5), Surface.PAINT)
    model.box((-5.1, -1.4, 3.5), (5.1, 1.4, 3.65), Surface.STEEL)
    model.box((-5.2, -1.1, 0.3), (5.2, 1.1, 0.95), Surface.DARK)
    for y, sign in ((1.37, 1), (-1.37, -1)):
        corners = [(1.2, y, 1.05), (-1.2, y, 1.05), (-1.2, y, 3.3), (1.2, y, 3.3)]
        model.face(Surface.SIGN, *(corners if sign > 0 else corners[::-1]))
    for y in (-0.75, 0.75):
        model.rod((-7.0, y, 0.1), (7.0, y, 0.1), 0.05, 0.05, Surface.STEEL)
    return model


def _hut() -> _Model:
    model = _Model()
    model.box((-1.6, -1.2, 0.0), (1.6, 1.2, 2.3), Surface.PAINT)
    model.face(Surface.SIGN, (-1.8, -1.5, 2.25), (1.8, -1.5, 2.25), (1.8, 0.0, 3.2), (-1.8, 0.0, 3.2))
    model.face(Surface.SIGN, (1.8, 1.5, 2.25), (-1.8, 1.5, 2.25), (-1.8, 0.0, 3.2), (1.8, 0.0, 3.2))
    for x, sign in ((1.6, 1), (-1.6, -1)):
        corners = [(x, -1.2, 2.3), (x, 1.2, 2.3), (x, 0.0, 3.15)]
        model.face(Surface.PAINT, *(corners if sign > 0 else corners[::-1]))
    model.face(Surface.DARK, (-1.62, 0.4, 0.0), (-1.62, -0.4, 0.0), (-1.62, -0.4, 1.9), (-1.62, 0.4, 1.9))
    return model


def _pole() -> _Model:
    model = _Model()
    model.rod((0, 0, 0), (0, 0, 6.2), 0.11, 0.08, Surface.WOOD)
    for z in (5.5, 5.95):
        model.rod((0, -0.8, z), (0, 0.8, z), 0.04, 0.04, Surface.WOOD)
    return model


def _signal() -> _Model:
    model = _Model()
    model.rod((0, 0, 0), (0, 0, 4.4), 0.08, 0.08, Surface.STEEL)
    model.box((-0.1, -0.28, 3.3), (0.1, 0.28, 4.6), Surface.DARK)
    model.drum(-0.12, 0.0, 4.2, 4.35, 0.09, 0.09, Surface.TAILLIGHT)
    return model


def _shelter() -> _Model:
    model = _Model()
    model.box((-2.0, 0.5, 2.3), (2.0, -0.9, 2.42), Surface.STEEL)
    for x in (-1.9, 1.9):
        model.rod((x, -0.8, 0), (x, -0.8, 2.35), 0.05, 0.05, Surface.STEEL)
        model.rod((x, 0.4, 0), (x, 0.4, 2.35), 0.04, 0.04, Surface.STEEL)
    model.face(Surface.POSTER, (2.02, -0.8, 0.3), (2.02, 0.3, 0.3), (2.02, 0.3, 2.0), (2.02, -0.8, 2.0))
    model.face(Surface.POSTER, (1.98, 0.3, 0.3), (1.98, -0.8, 0.3), (1.98, -0.8, 2.0), (1.98, 0.3, 2.0))
    model.box((-1.6, -0.75, 0.42), (1.2, -0.4, 0.5), Surface.WOOD)
    return model


def _traffic_sign() -> _Model:
    model = _Model()
    model.rod((0, 0, 0), (0, 0, 2.5), 0.035, 0.035, Surface.STEEL)
    turn = 2 * np.pi * np.arange(8) / 8
    for x, radius, sign, surface in (
        (0.05, 0.3, 1, Surface.PAINT), (0.06, 0.2, 1, Surface.TRIM), (-0.05, 0.3, -1, Surface.DARK)
    ):  # fmt: skip
        ring = [(x, radius * np.cos(t), 2.45 + radius * np.sin(t)) for t in turn]
        ring = ring if sign > 0 else ring[::-1]
        for k in (1, 3, 5):
            model.face(surface, ring[0], ring[k], ring[k + 1], ring[(k + 2) % 8])
    return model


def _traffic_light() -> _Model:
    model = _Model()
    model.rod((0, 0, 0), (0, 0, 3.4), 0.06, 0.06, Surface.DARK)
    model.box((-0.12, -0.17, 2.5), (0.12, 0.17, 3.5), Surface.DARK)
    model.face(Surface.TAILLIGHT, (0.13, -0.1, 3.2), (0.13, 0.1, 3.2), (0.13, 0.1, 3.4), (0.13, -0.1, 3.4))
    return model


def _bin() -> _Model:
    model = _Model()
    model.drum(0, 0, 0.15, 0.85, 0.2, 0.26, Surface.PAINT)
    model.drum(0, 0, 0.0, 0.15, 0.06, 0.06, Surface.DARK)
    return model


def _bollard() -> _Model:
    model = _Model()
    model.rod((0, 0, 0), (0, 0, 0.85), 0.07, 0.06, Surface.DARK)
    return model


def _parasol() -> _Model:
    model = _Model()
    model.rod((0, 0, 0), (0, 0, 2.6), 0.03, 0.03, Surface.WOOD)
    turn = 2 * np.pi * np.arange(9) / 8
    ring = [(1.5 * np.cos(t), 1.5 * np.sin(t), 2.15) for t in turn]
    for k in range(8):
        surface = Surface.PAINT if k % 2 else Surface.SIGN
        model.face(surface, ring[k], ring[k + 1], (0, 0, 2.75))
        model.face(surface, ring[k + 1], ring[k], (0, 0, 2.74))
    model.drum(0.0, 0.0, 0.7, 0.74, 0.42, 0.42, Surface.WOOD)
    for x, y in ((0.75, 0.2), (-0.7, -0.3), (0.1, 0.78)):
        model.box((x - 0.2, y - 0.2, 0.42), (x + 0.2, y + 0.2, 0.47), Surface.STEEL)
        for dx, dy in ((-0.17, -0.17), (0.17, -0.17), (0.17, 0.17), (-0.17, 0.17)):
            model.rod((x + dx, y + dy, 0), (x + dx, y + dy, 0.45), 0.015, 0.015, Surface.DARK)
    return model


def _banner() -> _Model:
    # Hangs from a facade; x outwards.
    model = _Model()
    model.rod((0.0, 0.0, 2.45), (0.9, 0.0, 2.6), 0.025, 0.02, Surface.DARK)
    for y, sign in ((0.02, 1), (-0.02, -1)):
        for z0, z1, surface in ((0.0, 0.85, Surface.PAINT), (0.85, 1.65, Surface.SIGN), (1.65, 2.5, Surface.PAINT)):
            corners = [(0.15, y, z0), (0.85, y, z0), (0.85, y, z1), (0.15, y, z1)]
            model.face(surface, *(corners[::-1] if sign > 0 else corners))
    return model


def _planter() -> _Model:
    model = _Model()
    model.box((-0.75, -0.3, 0.0), (0.75, 0.3, 0.5), Surface.PAINT)
    for k, x in enumerate((-0.5, 0.0, 0.5)):
        model.drum(x, 0.0, 0.5, 0.85 + 0.12 * (k % 2), 0.28, 0.16, Surface.PLANT)
    return model


def _kiosk() -> _Model:
    model = _Model()
    model.box((-1.1, -1.1, 0.0), (1.1, 1.1, 2.4), Surface.PAINT)
    model.face(Surface.POSTER, (1.12, -0.9, 0.9), (1.12, 0.9, 0.9), (1.12, 0.9, 2.0), (1.12, -0.9, 2.0))
    model.face(Surface.POSTER, (-0.9, -1.12, 0.3), (0.9, -1.12, 0.3), (0.9, -1.12, 2.1), (-0.9, -1.12, 2.1))
    model.drum(0, 0, 2.4, 3.1, 1.75, 0.05, Surface.SIGN)
    return model


def _post_box() -> _Model:
    model = _Model()
    model.drum(0, 0, 0.0, 1.25, 0.22, 0.22, Surface.PAINT)
    model.drum(0, 0, 1.25, 1.42, 0.26, 0.1, Surface.PAINT)
    return model


def _booth() -> _Model:
    model = _Model()
    model.box((-0.45, -0.45, 0.0), (0.45, 0.45, 2.3), Surface.PAINT)
    for k in range(4):
        c, s = (1, 0, -1, 0)[k], (0, 1, 0, -1)[k]
        corners = ((0.47, -0.34, 0.5), (0.47, 0.34, 0.5), (0.47, 0.34, 2.0), (0.47, -0.34, 2.0))
        model.face(Surface.WINDOW, *((c * x - s * y, s * x + c * y, z) for x, y, z in corners))
    return model


def _billboard() -> _Model:
    model = _Model()
    for y in (-1.2, 1.2):
        model.rod((0, y, 0), (0, y, 1.2), 0.06, 0.06, Surface.STEEL)
    for x, sign in ((0.06, 1), (-0.06, -1)):
        corners = [(x, -1.7, 1.1), (x, 1.7, 1.1), (x, 1.7, 3.2), (x, -1.7, 3.2)]
        model.face(Surface.POSTER, *(corners if sign > 0 else corners[::-1]))
    return model


def _clock() -> _Model:
    model = _Model()
    model.rod((0, 0, 0), (0, 0, 3.2), 0.09, 0.06, Surface.DARK)
    turn = 2 * np.pi * np.arange(8) / 8
    for x, sign in ((0.13, 1), (-0.13, -1)):
        for radius, shift, surface in ((0.5, 0.0, Surface.DARK), (0.42, 0.012, Surface.TRIM)):
            ring = [(x + sign * shift, radius * np.cos(t), 3.6 + radius * np.sin(t)) for t in turn]
            ring = ring if sign > 0 else ring[::-1]
            for k in (1, 3, 5):
                model.face(surface, ring[0], ring[k], ring[k + 1], ring[(k + 2) % 8])
    return model


def _silo() -> _Model:
    model = _Model()
    for x, height in ((0, 11.0), (4.2, 11.0)):
        model.drum(x, 0, 0, height, 1.9, 1.9, Surface.PAINT)
        model.drum(x, 0, height, height + 1.4, 1.95, 0.0, Surface.STEEL)
    return model


def _water_tower() -> _Model:
    model = _Model()
    model.drum(0, 0, 0, 19, 3.0, 2.2, Surface.PAINT)
    model.drum(0, 0, 19, 21, 2.4, 5.0, Surface.PAINT)
    model.drum(0, 0, 21, 26, 5.0, 5.0, Surface.PAINT)
    model.drum(0, 0, 26, 29, 5.3, 0.3, Surface.DARK)
    return model


def _stack() -> _Model:
    model = _Model()
    model.drum(0, 0, 0, 34, 1.9, 1.15, Surface.PAINT)
    model.drum(0, 0, 34, 35, 1.3, 1.3, Surface.DARK)
    return model


_MAKERS = {
    "hatchback": _hatchback, "saloon": _saloon, "estate": _estate, "van": _van, "cart": _cart,  # CARS and then the cart
    "walker": lambda: _person(0.26, coat=False, hat=False), "stander": lambda: _person(0.06, coat=False, hat=False),
    "coat": lambda: _person(0.2, coat=True, hat=False), "hat": lambda: _person(0.18, coat=True, hat=True),
    "bicycle": _bicycle, "lamp": _street_lamp, "lantern": _lantern, "bench": _bench, "balcony": _balcony,
    "awning": _awning, "sign": _hanging_sign, "oriel": _oriel, "dormer": _dormer, "chimney": _chimney,
    "stall": _stall, "pillar": _pillar, "fountain": _fountain, "statue": _statue, "mast": _mast, "signal": _signal,
    "shelter": _shelter, "traffic_sign": _traffic_sign, "traffic_light": _traffic_light, "bin": _bin,
    "bollard": _bollard, "silo": _silo, "water_tower": _water_tower, "stack": _stack, "wire": _wire, "parasol": _parasol, "banner": _banner, "planter": _planter,
    "kiosk": _kiosk, "post_box": _post_box, "booth": _booth, "billboard": _billboard, "clock": _clock,
    "deck": _deck, "wagon": _wagon, "hut": _hut, "pole": _pole,
}  # fmt: skip

MODEL = {name: index for index, name in enumerate(_MAKERS)}
CARS = ("hatchback", "saloon", "estate", "van")


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
