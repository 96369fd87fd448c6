"""Balconies, awnings, signs, bay windows, dormers, chimneys; x points away from the wall, y along it."""

import itertools

from artifact_city.polyhedra import Model, Surface


def balcony() -> Model:
    """Build a balcony slab whose railing is drawn as bars."""
    model = Model()
    model.box((0.0, -1.0, -0.16), (0.95, 1.0, 0.0), Surface.TRIM)
    model.face(Surface.TRIM, (0.0, 1.0, -0.16), (0.95, 1.0, -0.16), (0.95, -1.0, -0.16), (0.0, -1.0, -0.16))
    model.face(Surface.RAILING, (0.93, -1.0, 0.0), (0.93, 1.0, 0.0), (0.93, 1.0, 1.0), (0.93, -1.0, 1.0))
    model.face(Surface.RAILING, (0.0, -0.98, 0.0), (0.93, -0.98, 0.0), (0.93, -0.98, 1.0), (0.0, -0.98, 1.0))
    model.face(Surface.RAILING, (0.93, 0.98, 0.0), (0.0, 0.98, 0.0), (0.0, 0.98, 1.0), (0.93, 0.98, 1.0))
    return model


def awning() -> Model:
    """Build an awning of unit width, one metre deep; scaled to its shop."""
    model = Model()
    model.face(Surface.CANVAS, (1.0, -0.5, -0.45), (1.0, 0.5, -0.45), (0.0, 0.5, 0.0), (0.0, -0.5, 0.0))
    model.face(Surface.CANVAS, (1.0, 0.5, -0.45), (1.0, -0.5, -0.45), (0.0, -0.5, -0.02), (0.0, 0.5, -0.02))
    model.face(Surface.CANVAS, (1.0, -0.5, -0.68), (1.0, 0.5, -0.68), (1.0, 0.5, -0.45), (1.0, -0.5, -0.45))
    return model


def hanging_sign() -> Model:
    """Build a sign board on a bracket, at right angles to the wall."""
    model = Model()
    model.rod((0.0, 0.0, 0.32), (0.95, 0.0, 0.32), 0.02, 0.02, Surface.DARK)
    model.box((0.2, -0.05, -0.4), (0.9, 0.05, 0.28), Surface.SIGN)
    return model


def banner() -> Model:
    """Build a banner that hangs from a bracket on a facade."""
    model = Model()
    model.rod((0.0, 0.0, 2.45), (0.9, 0.0, 2.6), 0.025, 0.02, Surface.DARK)
    for y, sign in ((0.02, 1), (-0.02, -1)):
        for z0, z1, surface in ((0.0, 0.85, Surface.PAINT), (0.85, 1.65, Surface.SIGN), (1.65, 2.5, Surface.PAINT)):
            corners = [(0.15, y, z0), (0.85, y, z0), (0.85, y, z1), (0.15, y, z1)]
            model.face(surface, *(corners[::-1] if sign > 0 else corners))
    return model


def oriel() -> Model:
    """Build a bay window, one storey high."""
    model = Model()
    w, d, h = 0.95, 0.7, 2.5
    ring = [(0.0, -w - 0.4), (d, -w), (d, w), (0.0, w + 0.4)]
    for (x0, y0), (x1, y1) in itertools.pairwise(ring):
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


def dormer() -> Model:
    """Build a dormer window; its back end disappears in the roof."""
    model = Model()
    w, h, back, top = 0.7, 1.15, -2.4, 1.65
    model.face(Surface.PAINT, (0, -w, 0), (0, w, 0), (0, w, h), (0, -w, h))
    model.face(Surface.PAINT, (0, -w, h), (0, w, h), (0, 0, top))
    model.face(Surface.WINDOW, (0.02, -0.48, 0.25), (0.02, 0.48, 0.25), (0.02, 0.48, 1.1), (0.02, -0.48, 1.1))
    model.face(Surface.PAINT, (back, -w, 0), (0, -w, 0), (0, -w, h), (back, -w, h))
    model.face(Surface.PAINT, (0, w, 0), (back, w, 0), (back, w, h), (0, w, h))
    model.face(Surface.SIGN, (back, -w - 0.1, h - 0.08), (0.12, -w - 0.1, h - 0.08), (0.12, 0, top), (back, 0, top))
    model.face(Surface.SIGN, (0.12, w + 0.1, h - 0.08), (back, w + 0.1, h - 0.08), (back, 0, top), (0.12, 0, top))
    return model


def chimney() -> Model:
    """Build a chimney with two pots; its foot disappears in the roof."""
    model = Model()
    model.box((-0.3, -0.45, -2.0), (0.3, 0.45, 1.3), Surface.PAINT)
    model.box((-0.36, -0.52, 1.3), (0.36, 0.52, 1.42), Surface.STONE)
    for y in (-0.22, 0.22):
        model.drum(0.0, y, 1.42, 1.78, 0.12, 0.1, Surface.PAINT)
    return model
