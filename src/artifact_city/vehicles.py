"""Cars, carts, bicycles, wagons and people as models; x forwards."""

import itertools
from collections.abc import Callable

import numpy as np

from artifact_city.polyhedra import Model, Surface


def _car(profile: list[tuple[float, float]], glass: list[bool], belt: float, half: float, wheels: tuple) -> Model:
    """Extrude a side outline, from the front bumper over the roof to the rear bumper.

    Above the belt line the cabin leans inwards; ``glass[k]`` says whether the strip from point k to k + 1 is a window.
    """
    model = Model()
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
        for p, q in itertools.pairwise(outline):
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


def _cabin_side(model: Model, cabin: list, side: Callable, sign: int) -> None:
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


def _wheel(model: Model, x: float, y: float, sign: int) -> None:
    turn = 2 * np.pi * np.arange(8) / 8
    for radius, shift, surface in ((0.34, 0.0, Surface.RUBBER), (0.19, 0.01, Surface.STEEL)):
        ring = [(x + radius * np.cos(t), y + sign * shift, 0.34 + radius * np.sin(t)) for t in turn]
        for k in (1, 3, 5):
            model.outward(surface, ring[0], ring[k], ring[k + 1], ring[(k + 2) % 8])


def _car_ends(model: Model, profile: list, half: float) -> None:
    front, rear = max(p[0] for p in profile) + 0.02, min(p[0] for p in profile) - 0.02
    lights = ((front, Surface.HEADLIGHT, 0.58, 0.74), (rear, Surface.TAILLIGHT, 0.72, 0.92))
    for x, surface, z0, z1 in lights:
        for y in (half - 0.32, -half + 0.32):
            model.outward(surface, (x, y - 0.2, z0), (x, y + 0.2, z0), (x, y + 0.2, z1), (x, y - 0.2, z1))
    for x in (front, rear):
        model.outward(Surface.TRIM, (x, -0.26, 0.42), (x, 0.26, 0.42), (x, 0.26, 0.53), (x, -0.26, 0.53))
        model.outward(Surface.DARK, (x, -0.75, 0.2), (x, 0.75, 0.2), (x, 0.75, 0.36), (x, -0.75, 0.36))


def hatchback() -> Model:
    """Build a small car with a sloping tail."""
    outline = [(1.95, 0.25), (2.02, 0.62), (1.75, 0.86), (0.98, 0.98), (0.3, 1.44), (-1.15, 1.46), (-1.78, 1.0)]
    outline += [(-1.98, 0.85), (-1.98, 0.28)]
    return _car(outline, [False, False, False, True, False, True, False, False], 0.98, 0.86, (1.25, -1.25))


def saloon() -> Model:
    """Build a car with a separate boot."""
    outline = [(2.2, 0.25), (2.28, 0.62), (2.0, 0.84), (0.95, 0.95), (0.25, 1.4), (-1.0, 1.41), (-1.7, 0.98)]
    outline += [(-2.2, 0.94), (-2.28, 0.62), (-2.25, 0.28)]
    return _car(outline, [False, False, False, True, False, True, False, False, False], 0.95, 0.88, (1.4, -1.4))


def estate() -> Model:
    """Build a long car with an upright tail."""
    outline = [(2.2, 0.3), (2.26, 0.72), (2.0, 0.98), (1.1, 1.08), (0.45, 1.62), (-1.9, 1.64), (-2.2, 1.08)]
    outline += [(-2.26, 0.8), (-2.24, 0.3)]
    return _car(outline, [False, False, False, True, False, True, False, False], 1.08, 0.92, (1.4, -1.35))


def van() -> Model:
    """Build a delivery van, closed at the back."""
    outline = [(2.5, 0.3), (2.55, 0.95), (2.2, 1.2), (1.55, 1.95), (1.2, 2.15), (-2.5, 2.2), (-2.55, 0.35)]
    model = _car(outline, [False, False, True, False, False, False], 3.0, 0.98, (1.65, -1.6))
    for y in (0.995, -0.995):
        model.outward(Surface.GLASS, (2.05, y, 1.22), (1.5, y, 1.82), (0.75, y, 1.82), (0.75, y, 1.22))
    return model


def cart() -> Model:
    """Build a hand cart with sacks, for streets of the past."""
    model = Model()
    model.box((-1.1, -0.55, 0.75), (1.0, 0.55, 1.15), Surface.WOOD)
    model.rod((1.0, 0.4, 0.85), (2.6, 0.3, 0.9), 0.04, 0.03, Surface.WOOD)
    model.rod((1.0, -0.4, 0.85), (2.6, -0.3, 0.9), 0.04, 0.03, Surface.WOOD)
    for y in (-0.66, 0.66):
        turn = 2 * np.pi * np.arange(13) / 12
        ring = [(-0.1 + 0.62 * np.cos(t), y, 0.62 + 0.62 * np.sin(t)) for t in turn]
        for a, b in itertools.pairwise(ring):
            model.rod(a, b, 0.035, 0.035, Surface.DARK)
        for k in range(0, 12, 2):
            model.rod((-0.1, y, 0.62), ring[k], 0.025, 0.02, Surface.WOOD)
    for k, z in enumerate((1.2, 1.35, 1.3)):
        model.drum(-0.7 + 0.6 * k, 0.0, 1.15, z + 0.35, 0.27, 0.22, Surface.PAINT)
    return model


def person(step: float, coat: bool, hat: bool) -> Model:
    """Build a walking or standing person, ``step`` metres from the middle to each foot."""
    model = Model()
    model.rod((step, 0.09, 0.05), (0.0, 0.08, 0.85), 0.065, 0.1, Surface.DARK)
    model.rod((-step, -0.09, 0.05), (0.0, -0.08, 0.85), 0.065, 0.1, Surface.DARK)
    model.rod((0.0, 0.0, 0.55 if coat else 0.9), (0.0, 0.0, 1.3), 0.22 if coat else 0.17, 0.2, Surface.PAINT)
    model.rod((0.0, 0.21, 1.36), (-0.8 * step, 0.27, 0.85), 0.065, 0.05, Surface.PAINT)
    model.rod((0.0, -0.21, 1.36), (0.8 * step, -0.27, 0.85), 0.065, 0.05, Surface.PAINT)
    model.rod((0.0, 0.0, 1.56), (0.02, 0.0, 1.64), 0.105, 0.105, Surface.SKIN)
    model.rod((-0.02, 0.0, 1.7), (-0.02, 0.0, 1.76 if hat else 1.71), 0.12 if hat else 0.1, 0.1, Surface.DARK)
    return model


def bicycle() -> Model:
    """Build a bicycle leaning on nothing."""
    model = Model()
    for x in (-0.5, 0.5):
        turn = 2 * np.pi * np.arange(11) / 10
        ring = [(x + 0.33 * np.cos(t), 0.0, 0.35 + 0.33 * np.sin(t)) for t in turn]
        for a, b in itertools.pairwise(ring):
            model.rod(a, b, 0.02, 0.02, Surface.DARK)
    for a, b in (((-0.5, 0.35), (-0.15, 0.85)), ((-0.5, 0.35), (-0.05, 0.35)), ((-0.05, 0.35), (0.38, 0.82)),
                 ((-0.12, 0.8), (0.38, 0.8)), ((0.5, 0.35), (0.36, 0.98)), ((-0.05, 0.35), (-0.16, 0.92))):  # fmt: skip
        model.rod((a[0], 0, a[1]), (b[0], 0, b[1]), 0.022, 0.022, Surface.PAINT)
    model.rod((0.36, 0.28, 0.98), (0.36, -0.28, 0.98), 0.02, 0.02, Surface.DARK)
    model.rod((-0.28, 0.0, 0.95), (-0.05, 0.0, 0.95), 0.05, 0.03, Surface.DARK)
    return model


def wagon() -> Model:
    """Build a goods wagon on its own short rails."""
    model = Model()
    model.box((-5.0, -1.35, 0.95), (5.0, 1.35, 3.5), Surface.PAINT)
    model.box((-5.1, -1.4, 3.5), (5.1, 1.4, 3.65), Surface.STEEL)
    model.box((-5.2, -1.1, 0.3), (5.2, 1.1, 0.95), Surface.DARK)
    for y, sign in ((1.37, 1), (-1.37, -1)):
        corners = [(1.2, y, 1.05), (-1.2, y, 1.05), (-1.2, y, 3.3), (1.2, y, 3.3)]
        model.face(Surface.SIGN, *(corners if sign > 0 else corners[::-1]))
    for y in (-0.75, 0.75):
        model.rod((-7.0, y, 0.1), (7.0, y, 0.1), 0.05, 0.05, Surface.STEEL)
    return model
