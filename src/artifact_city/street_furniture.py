"""Lamps, benches, signs, stalls, fountains and the other small things of streets and squares."""

import numpy as np

from artifact_city.polyhedra import Model, Surface


def street_lamp() -> Model:
    """Build a tall lamp whose arm reaches over the road, along x."""
    model = Model()
    model.rod((0, 0, 0), (0, 0, 6.6), 0.09, 0.055, Surface.STEEL)
    model.rod((0, 0, 6.5), (1.25, 0, 6.85), 0.05, 0.04, Surface.STEEL)
    model.box((0.95, -0.13, 6.78), (1.6, 0.13, 6.9), Surface.STEEL)
    model.face(Surface.LANTERN, (1.0, 0.11, 6.77), (1.55, 0.11, 6.77), (1.55, -0.11, 6.77), (1.0, -0.11, 6.77))
    return model


def lantern() -> Model:
    """Build a low lantern on a post."""
    model = Model()
    model.rod((0, 0, 0), (0, 0, 0.8), 0.1, 0.08, Surface.DARK)
    model.rod((0, 0, 0.8), (0, 0, 3.5), 0.055, 0.045, Surface.DARK)
    model.rod((0, -0.3, 3.2), (0, 0.3, 3.2), 0.025, 0.025, Surface.DARK)
    model.drum(0, 0, 3.5, 4.0, 0.13, 0.24, Surface.LANTERN)
    model.drum(0, 0, 4.0, 4.28, 0.27, 0.03, Surface.DARK)
    return model


def bench() -> Model:
    """Build a bench that faces along y."""
    model = Model()
    model.box((-0.85, -0.22, 0.4), (0.85, 0.2, 0.46), Surface.WOOD)
    model.face(Surface.WOOD, (0.85, -0.24, 0.5), (-0.85, -0.24, 0.5), (-0.85, -0.3, 0.88), (0.85, -0.3, 0.88))
    model.face(Surface.WOOD, (-0.85, -0.24, 0.5), (0.85, -0.24, 0.5), (0.85, -0.3, 0.88), (-0.85, -0.3, 0.88))
    for x in (-0.7, 0.7):
        model.rod((x, 0.15, 0), (x, 0.15, 0.42), 0.03, 0.03, Surface.DARK)
        model.rod((x, -0.22, 0), (x, -0.3, 0.88), 0.03, 0.03, Surface.DARK)
    return model


def bollard() -> Model:
    """Build a bollard."""
    model = Model()
    model.rod((0, 0, 0), (0, 0, 0.85), 0.07, 0.06, Surface.DARK)
    return model


def litter_bin() -> Model:
    """Build a litter bin."""
    model = Model()
    model.drum(0, 0, 0.15, 0.85, 0.2, 0.26, Surface.PAINT)
    model.drum(0, 0, 0.0, 0.15, 0.06, 0.06, Surface.DARK)
    return model


def planter() -> Model:
    """Build a trough with three plants."""
    model = Model()
    model.box((-0.75, -0.3, 0.0), (0.75, 0.3, 0.5), Surface.PAINT)
    for k, x in enumerate((-0.5, 0.0, 0.5)):
        model.drum(x, 0.0, 0.5, 0.85 + 0.12 * (k % 2), 0.28, 0.16, Surface.PLANT)
    return model


def traffic_sign() -> Model:
    """Build a round traffic sign that faces along x."""
    model = Model()
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


def traffic_light() -> Model:
    """Build a traffic light that faces along x; it always shows red."""
    model = Model()
    model.rod((0, 0, 0), (0, 0, 3.4), 0.06, 0.06, Surface.DARK)
    model.box((-0.12, -0.17, 2.5), (0.12, 0.17, 3.5), Surface.DARK)
    model.face(Surface.TAILLIGHT, (0.13, -0.1, 3.2), (0.13, 0.1, 3.2), (0.13, 0.1, 3.4), (0.13, -0.1, 3.4))
    return model


def billboard() -> Model:
    """Build a poster wall on two posts."""
    model = Model()
    for y in (-1.2, 1.2):
        model.rod((0, y, 0), (0, y, 1.2), 0.06, 0.06, Surface.STEEL)
    for x, sign in ((0.06, 1), (-0.06, -1)):
        corners = [(x, -1.7, 1.1), (x, 1.7, 1.1), (x, 1.7, 3.2), (x, -1.7, 3.2)]
        model.face(Surface.POSTER, *(corners if sign > 0 else corners[::-1]))
    return model


def shelter() -> Model:
    """Build a shelter of a bus stop."""
    model = Model()
    model.box((-2.0, 0.5, 2.3), (2.0, -0.9, 2.42), Surface.STEEL)
    for x in (-1.9, 1.9):
        model.rod((x, -0.8, 0), (x, -0.8, 2.35), 0.05, 0.05, Surface.STEEL)
        model.rod((x, 0.4, 0), (x, 0.4, 2.35), 0.04, 0.04, Surface.STEEL)
    model.face(Surface.POSTER, (2.02, -0.8, 0.3), (2.02, 0.3, 0.3), (2.02, 0.3, 2.0), (2.02, -0.8, 2.0))
    model.face(Surface.POSTER, (1.98, 0.3, 0.3), (1.98, -0.8, 0.3), (1.98, -0.8, 2.0), (1.98, 0.3, 2.0))
    model.box((-1.6, -0.75, 0.42), (1.2, -0.4, 0.5), Surface.WOOD)
    return model


def clock() -> Model:
    """Build a clock on a post."""
    model = Model()
    model.rod((0, 0, 0), (0, 0, 3.2), 0.09, 0.06, Surface.DARK)
    turn = 2 * np.pi * np.arange(8) / 8
    for x, sign in ((0.13, 1), (-0.13, -1)):
        for radius, shift, surface in ((0.5, 0.0, Surface.DARK), (0.42, 0.012, Surface.TRIM)):
            ring = [(x + sign * shift, radius * np.cos(t), 3.6 + radius * np.sin(t)) for t in turn]
            ring = ring if sign > 0 else ring[::-1]
            for k in (1, 3, 5):
                model.face(surface, ring[0], ring[k], ring[k + 1], ring[(k + 2) % 8])
    return model


def post_box() -> Model:
    """Build a post box."""
    model = Model()
    model.drum(0, 0, 0.0, 1.25, 0.22, 0.22, Surface.PAINT)
    model.drum(0, 0, 1.25, 1.42, 0.26, 0.1, Surface.PAINT)
    return model


def booth() -> Model:
    """Build a telephone booth."""
    model = Model()
    model.box((-0.45, -0.45, 0.0), (0.45, 0.45, 2.3), Surface.PAINT)
    for k in range(4):
        c, s = (1, 0, -1, 0)[k], (0, 1, 0, -1)[k]
        corners = ((0.47, -0.34, 0.5), (0.47, 0.34, 0.5), (0.47, 0.34, 2.0), (0.47, -0.34, 2.0))
        model.face(Surface.WINDOW, *((c * x - s * y, s * x + c * y, z) for x, y, z in corners))
    return model


def pillar() -> Model:
    """Build a round pillar with posters."""
    model = Model()
    model.drum(0, 0, 0, 0.3, 0.72, 0.68, Surface.STONE)
    model.drum(0, 0, 0.3, 2.7, 0.62, 0.62, Surface.POSTER)
    model.drum(0, 0, 2.7, 2.85, 0.74, 0.74, Surface.TRIM)
    model.drum(0, 0, 2.85, 3.35, 0.66, 0.0, Surface.DARK)
    return model


def kiosk() -> Model:
    """Build a kiosk with a pointed roof."""
    model = Model()
    model.box((-1.1, -1.1, 0.0), (1.1, 1.1, 2.4), Surface.PAINT)
    model.face(Surface.POSTER, (1.12, -0.9, 0.9), (1.12, 0.9, 0.9), (1.12, 0.9, 2.0), (1.12, -0.9, 2.0))
    model.face(Surface.POSTER, (-0.9, -1.12, 0.3), (0.9, -1.12, 0.3), (0.9, -1.12, 2.1), (-0.9, -1.12, 2.1))
    model.drum(0, 0, 2.4, 3.1, 1.75, 0.05, Surface.SIGN)
    return model


def stall() -> Model:
    """Build a market stall under canvas."""
    model = Model()
    model.box((-1.5, -0.9, 0.0), (1.5, 0.0, 0.85), Surface.WOOD)
    for x in (-1.5, 1.5):
        for y, z in ((-1.2, 2.1), (0.9, 2.4)):
            model.rod((x, y, 0), (x, y, z), 0.03, 0.03, Surface.STEEL)
    model.face(Surface.CANVAS, (-1.7, -1.5, 2.0), (1.7, -1.5, 2.0), (1.7, 0.0, 2.7), (-1.7, 0.0, 2.7))
    model.face(Surface.CANVAS, (1.7, 1.2, 2.2), (-1.7, 1.2, 2.2), (-1.7, 0.0, 2.7), (1.7, 0.0, 2.7))
    model.face(Surface.CANVAS, (1.7, -1.5, 2.0), (-1.7, -1.5, 2.0), (-1.7, 0.0, 2.69), (1.7, 0.0, 2.69))
    model.face(Surface.CANVAS, (-1.7, 1.2, 2.2), (1.7, 1.2, 2.2), (1.7, 0.0, 2.69), (-1.7, 0.0, 2.69))
    return model


def parasol() -> Model:
    """Build a parasol over a table with three stools."""
    model = Model()
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


def fountain() -> Model:
    """Build a round fountain."""
    model = Model()
    model.drum(0, 0, 0, 0.6, 2.9, 2.9, Surface.STONE)
    model.drum(0, 0, 0.6, 2.0, 0.45, 0.3, Surface.STONE)
    model.drum(0, 0, 2.0, 2.25, 0.9, 1.2, Surface.STONE)
    model.drum(0, 0, 2.25, 3.4, 0.22, 0.1, Surface.STONE)
    return model


def statue() -> Model:
    """Build a statue on a plinth."""
    model = Model()
    model.box((-1.1, -1.1, 0), (1.1, 1.1, 0.5), Surface.STONE)
    model.box((-0.7, -0.7, 0.5), (0.7, 0.7, 2.6), Surface.STONE)
    model.rod((0, 0.14, 2.6), (0, 0.12, 3.6), 0.14, 0.2, Surface.DARK)
    model.rod((0.1, -0.14, 2.6), (0, -0.12, 3.6), 0.14, 0.2, Surface.DARK)
    model.rod((0, 0, 3.5), (0, 0, 4.4), 0.34, 0.32, Surface.DARK)
    model.rod((0, 0.36, 4.35), (0.5, 0.6, 4.9), 0.12, 0.08, Surface.DARK)
    model.rod((0, -0.36, 4.35), (0.05, -0.5, 3.6), 0.12, 0.09, Surface.DARK)
    model.rod((0, 0, 4.75), (0, 0, 4.9), 0.18, 0.17, Surface.DARK)
    return model
