"""What stands along a railway and in the country: masts, wires, signals, bridge decks, huts, silos, towers."""

from artifact_city.polyhedra import Model, Surface


def mast() -> Model:
    """Build a mast beside a track; its arm reaches over it."""
    model = Model()
    model.rod((0, 0, 0), (0, 0, 7.4), 0.13, 0.1, Surface.STEEL)
    model.rod((0, 0, 6.9), (3.3, 0, 6.4), 0.04, 0.04, Surface.STEEL)
    model.rod((0, 0, 5.6), (3.3, 0, 6.4), 0.04, 0.03, Surface.STEEL)
    model.rod((2.9, 0, 6.35), (2.9, 0, 5.4), 0.025, 0.025, Surface.STEEL)
    return model


def wire() -> Model:
    """Build a wire one metre long; scaled to its span."""
    model = Model()
    model.rod((0, 0, 0), (1, 0, 0), 0.014, 0.014, Surface.DARK)
    return model


def signal() -> Model:
    """Build a railway signal."""
    model = Model()
    model.rod((0, 0, 0), (0, 0, 4.4), 0.08, 0.08, Surface.STEEL)
    model.box((-0.1, -0.28, 3.3), (0.1, 0.28, 4.6), Surface.DARK)
    model.drum(-0.12, 0.0, 4.2, 4.35, 0.09, 0.09, Surface.TAILLIGHT)
    return model


def pole() -> Model:
    """Build a telegraph pole."""
    model = Model()
    model.rod((0, 0, 0), (0, 0, 6.2), 0.11, 0.08, Surface.WOOD)
    for z in (5.5, 5.95):
        model.rod((0, -0.8, z), (0, 0.8, z), 0.04, 0.04, Surface.WOOD)
    return model


def deck() -> Model:
    """Build a unit slab with parapets, scaled to the bridge it carries; its underside shows."""
    model = Model()
    model.box((-0.5, -0.5, 0.0), (0.5, 0.5, 0.9), Surface.PAINT)
    model.face(Surface.PAINT, (-0.5, 0.5, 0.0), (0.5, 0.5, 0.0), (0.5, -0.5, 0.0), (-0.5, -0.5, 0.0))
    for y in (-0.5, 0.46):
        model.box((-0.5, y, 0.9), (0.5, y + 0.04, 1.9), Surface.STONE)
    return model


def hut() -> Model:
    """Build a hut with a pitched roof."""
    model = Model()
    model.box((-1.6, -1.2, 0.0), (1.6, 1.2, 2.3), Surface.PAINT)
    model.face(Surface.SIGN, (-1.8, -1.5, 2.25), (1.8, -1.5, 2.25), (1.8, 0.0, 3.2), (-1.8, 0.0, 3.2))
    model.face(Surface.SIGN, (1.8, 1.5, 2.25), (-1.8, 1.5, 2.25), (-1.8, 0.0, 3.2), (1.8, 0.0, 3.2))
    for x, sign in ((1.6, 1), (-1.6, -1)):
        corners = [(x, -1.2, 2.3), (x, 1.2, 2.3), (x, 0.0, 3.15)]
        model.face(Surface.PAINT, *(corners if sign > 0 else corners[::-1]))
    model.face(Surface.DARK, (-1.62, 0.4, 0.0), (-1.62, -0.4, 0.0), (-1.62, -0.4, 1.9), (-1.62, 0.4, 1.9))
    return model


def silo() -> Model:
    """Build two silos."""
    model = Model()
    for x, height in ((0, 11.0), (4.2, 11.0)):
        model.drum(x, 0, 0, height, 1.9, 1.9, Surface.PAINT)
        model.drum(x, 0, height, height + 1.4, 1.95, 0.0, Surface.STEEL)
    return model


def water_tower() -> Model:
    """Build a water tower."""
    model = Model()
    model.drum(0, 0, 0, 19, 3.0, 2.2, Surface.PAINT)
    model.drum(0, 0, 19, 21, 2.4, 5.0, Surface.PAINT)
    model.drum(0, 0, 21, 26, 5.0, 5.0, Surface.PAINT)
    model.drum(0, 0, 26, 29, 5.3, 0.3, Surface.DARK)
    return model


def stack() -> Model:
    """Build a factory chimney."""
    model = Model()
    model.drum(0, 0, 0, 34, 1.9, 1.15, Surface.PAINT)
    model.drum(0, 0, 34, 35, 1.3, 1.3, Surface.DARK)
    return model
