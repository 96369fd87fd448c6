"""The library of models, and the list of where they are placed. Metres; x forwards, y left, z up."""

import itertools
from collections.abc import Callable
from functools import cache, partial

import numpy as np

from artifact_city.kernel import layout
from artifact_city.solids import Model, Models, Surface, pack
from artifact_city.trees import Species

THING = layout("x y z yaw scale:3 colour:3 second:3 lit model:i")

# Side outlines of cars, x and z in turn, from the front bumper over the roof to the rear bumper.
_OUTLINES = {
    "hatchback": "1.95 .25 2.02 .62 1.75 .86 .98 .98 .3 1.44 -1.15 1.46 -1.78 1 -1.98 .85 -1.98 .28",
    "saloon": "2.2 .25 2.28 .62 2 .84 .95 .95 .25 1.4 -1 1.41 -1.7 .98 -2.2 .94 -2.28 .62 -2.25 .28",
    "estate": "2.2 .3 2.26 .72 2 .98 1.1 1.08 .45 1.62 -1.9 1.64 -2.2 1.08 -2.26 .8 -2.24 .3",
    "van": "2.5 .3 2.55 .95 2.2 1.2 1.55 1.95 1.2 2.15 -2.5 2.2 -2.55 .35",
}
# For each car the strips of its outline that are windows, the height of its belt line, half its width, and its axles.
_CARS = {
    "hatchback": ((3, 5), 0.98, 0.86, (1.25, -1.25)),
    "saloon": ((3, 5), 0.95, 0.88, (1.4, -1.4)),
    "estate": ((3, 5), 1.08, 0.92, (1.4, -1.35)),
    "van": ((2,), 3.0, 0.98, (1.65, -1.6)),
}
# Cars come first among the models: compiled code tells them by their number.
CARS = tuple(_CARS)
N_CARS = len(CARS)


def _car(name: str, windows: tuple, belt: float, half: float, axles: tuple) -> Model:
    """Extrude a side outline; above the belt line the cabin leans inwards."""
    model, profile = Model(), np.array(_OUTLINES[name].split(), dtype=float).reshape(-1, 2)
    roof = profile[:, 1].max()

    def side(point: np.ndarray, sign: int) -> tuple[float, float, float]:
        lean = 0.17 * (point[1] - belt) / (roof - belt) if point[1] > belt else 0.0
        return point[0], sign * (half - lean), point[1]

    for k, (a, b) in enumerate(itertools.pairwise(profile)):
        surface = Surface.GLASS if k in windows else Surface.PAINT
        model.outward(surface, side(a, 1), side(a, -1), side(b, -1), side(b, 1))
    cabin = [p for p in profile if p[1] >= belt]
    body = [p for p in profile if p[1] < belt]
    around = [p for p in body if p[0] > 0] + cabin[:1] + cabin[-1:] + [p for p in body if p[0] <= 0]
    middle = ((profile[0, 0] + profile[-1, 0]) / 2, profile[0, 1])
    for sign in (1, -1):
        for p, q in itertools.pairwise(around):
            model.outward(Surface.PAINT, side(middle, sign), side(p, sign), side(q, sign))
        _cabin_side(model, cabin, side, sign)
        for x in axles:
            model.disc(Surface.RUBBER, (x, sign * (half + 0.01), 0.34), 0.34, "y")
            model.disc(Surface.STEEL, (x, sign * (half + 0.02), 0.34), 0.19, "y")
    for x, surface, z in (
        (profile[:, 0].max(), Surface.HEADLIGHT, 0.58),
        (profile[:, 0].min(), Surface.TAILLIGHT, 0.72),
    ):
        x *= 1.01
        for y in (half - 0.32, 0.32 - half):
            model.outward(surface, (x, y - 0.2, z), (x, y + 0.2, z), (x, y + 0.2, z + 0.18), (x, y - 0.2, z + 0.18))
        model.outward(Surface.DARK, (x, -0.75, 0.2), (x, 0.75, 0.2), (x, 0.75, 0.36), (x, -0.75, 0.36))
    return model


def _cabin_side(model: Model, cabin: list, side: Callable, sign: int) -> None:
    """Add the side of a cabin with two windows; a van has one behind its front wheels."""
    if len(cabin) < 4:
        windows = ([(2.05, 1.22), (1.5, 1.82), (0.75, 1.82), (0.75, 1.22)],)
    else:
        front, front_up, rear_up, rear = cabin
        model.outward(Surface.PAINT, *(side(p, sign) for p in cabin))
        middle, z0, z1 = (front_up[0] + rear_up[0]) / 2, max(front[1], rear[1]) + 0.03, front_up[1] - 0.07
        windows = (
            [(front[0] - 0.12, z0), (front_up[0] - 0.06, z1), (middle + 0.05, z1), (middle + 0.05, z0)],
            [(middle - 0.05, z0), (middle - 0.05, z1), (rear_up[0] + 0.1, z1), (rear[0] + 0.16, z0)],
        )
    for window in windows:
        corners = (side(p, sign) for p in window)
        model.outward(Surface.GLASS, *((x, y + sign * 0.015, z) for x, y, z in corners))


def _person(step: float, *, coat: bool) -> Model:
    """Build a walking or standing person, ``step`` metres from the middle to each foot."""
    model = Model().rod((step, 0.09, 0.05), (0.0, 0.08, 0.85), 0.065, 0.1, Surface.DARK)
    model.rod((-step, -0.09, 0.05), (0.0, -0.08, 0.85), 0.065, 0.1, Surface.DARK)
    model.rod((0.0, 0.0, 0.55 if coat else 0.9), (0.0, 0.0, 1.3), 0.22 if coat else 0.17, 0.2, Surface.PAINT)
    model.rod((0.0, 0.21, 1.36), (-0.8 * step, 0.27, 0.85), 0.065, 0.05, Surface.PAINT)
    model.rod((0.0, -0.21, 1.36), (0.8 * step, -0.27, 0.85), 0.065, 0.05, Surface.PAINT)
    model.rod((0.0, 0.0, 1.56), (0.02, 0.0, 1.64), 0.105, 0.105, Surface.SKIN)
    return model.rod((-0.02, 0.0, 1.7), (-0.02, 0.0, 1.71), 0.1, 0.1, Surface.DARK)


def _lamp() -> Model:
    """Build a tall lamp whose arm reaches over the road, along x."""
    model = Model().rod((0, 0, 0), (0, 0, 6.6), 0.09, 0.055, Surface.STEEL)
    model.rod((0, 0, 6.5), (1.25, 0, 6.85), 0.05, 0.04, Surface.STEEL)
    model.box((0.95, -0.13, 6.78), (1.6, 0.13, 6.9), Surface.STEEL)
    return model.face(Surface.LANTERN, (1.0, 0.11, 6.77), (1.55, 0.11, 6.77), (1.55, -0.11, 6.77), (1.0, -0.11, 6.77))


def _lantern() -> Model:
    model = Model().rod((0, 0, 0), (0, 0, 3.5), 0.08, 0.045, Surface.DARK)
    return model.drum(0, 3.5, 4.0, 0.13, 0.24, Surface.LANTERN).drum(0, 4.0, 4.28, 0.27, 0.03, Surface.DARK)


def _bench() -> Model:
    """Build a bench that faces along y."""
    model = Model().box((-0.85, -0.22, 0.4), (0.85, 0.2, 0.46), Surface.WOOD)
    back = (0.85, -0.24, 0.5), (-0.85, -0.24, 0.5), (-0.85, -0.3, 0.88), (0.85, -0.3, 0.88)
    model.face(Surface.WOOD, *back, both=True)
    for x in (-0.7, 0.7):
        model.rod((x, 0.15, 0), (x, 0.15, 0.42), 0.03, 0.03, Surface.DARK)
        model.rod((x, -0.22, 0), (x, -0.3, 0.88), 0.03, 0.03, Surface.DARK)
    return model


def _traffic_sign() -> Model:
    """Build a round traffic sign that faces along x."""
    model = Model().rod((0, 0, 0), (0, 0, 2.5), 0.035, 0.035, Surface.STEEL)
    model.disc(Surface.PAINT, (0.05, 0, 2.45), 0.3, "+x").disc(Surface.TRIM, (0.06, 0, 2.45), 0.2, "+x")
    return model.disc(Surface.DARK, (-0.05, 0, 2.45), 0.3, "-x")


def _fountain() -> Model:
    model = Model().drum(0, 0, 0.6, 2.9, 2.9, Surface.STONE).drum(0, 0.6, 2.0, 0.45, 0.3, Surface.STONE)
    return model.drum(0, 2.0, 2.25, 0.9, 1.2, Surface.STONE).drum(0, 2.25, 3.4, 0.22, 0.1, Surface.STONE)


def _mast() -> Model:
    """Build a mast beside a track; its arm reaches over it."""
    model = Model().rod((0, 0, 0), (0, 0, 7.4), 0.13, 0.1, Surface.STEEL)
    model.rod((0, 0, 6.9), (3.3, 0, 6.4), 0.04, 0.04, Surface.STEEL)
    return model.rod((0, 0, 5.6), (3.3, 0, 6.4), 0.04, 0.03, Surface.STEEL)


def _deck() -> Model:
    """Build a unit slab with parapets, scaled to the bridge it carries; its underside shows."""
    model = Model().box((-0.5, -0.5, 0.0), (0.5, 0.5, 0.9), Surface.PAINT)
    model.face(Surface.PAINT, (-0.5, 0.5, 0.0), (0.5, 0.5, 0.0), (0.5, -0.5, 0.0), (-0.5, -0.5, 0.0))
    for y in (-0.5, 0.46):
        model.box((-0.5, y, 0.9), (0.5, y + 0.04, 1.9), Surface.STONE)
    return model


# What follows is fixed to houses: x points away from the wall, y along it.


def _balcony() -> Model:
    """Build a balcony slab whose railing is drawn as bars."""
    model = Model().box((0.0, -1.0, -0.16), (0.95, 1.0, 0.0), Surface.TRIM)
    model.face(Surface.TRIM, (0.0, 1.0, -0.16), (0.95, 1.0, -0.16), (0.95, -1.0, -0.16), (0.0, -1.0, -0.16))
    model.face(Surface.RAILING, (0.93, -1.0, 0.0), (0.93, 1.0, 0.0), (0.93, 1.0, 1.0), (0.93, -1.0, 1.0))
    model.face(Surface.RAILING, (0.0, -0.98, 0.0), (0.93, -0.98, 0.0), (0.93, -0.98, 1.0), (0.0, -0.98, 1.0))
    return model.face(Surface.RAILING, (0.93, 0.98, 0.0), (0.0, 0.98, 0.0), (0.0, 0.98, 1.0), (0.93, 0.98, 1.0))


def _awning() -> Model:
    """Build an awning of unit width, one metre deep; scaled to its shop."""
    model = Model().face(Surface.CANVAS, (1, -0.5, -0.45), (1, 0.5, -0.45), (0, 0.5, 0), (0, -0.5, 0), both=True)
    return model.face(Surface.CANVAS, (1, -0.5, -0.68), (1, 0.5, -0.68), (1, 0.5, -0.45), (1, -0.5, -0.45))


def _sign() -> Model:
    """Build a sign board on a bracket, at right angles to the wall."""
    model = Model().rod((0.0, 0.0, 0.32), (0.95, 0.0, 0.32), 0.02, 0.02, Surface.DARK)
    return model.box((0.2, -0.05, -0.4), (0.9, 0.05, 0.28), Surface.SIGN)


def _oriel() -> Model:
    """Build a bay window, one storey high."""
    model, height = Model(), 2.5
    for (x0, y0), (x1, y1) in itertools.pairwise([(0.0, -1.35), (0.7, -0.95), (0.7, 0.95), (0.0, 1.35)]):
        model.face(Surface.PAINT, (x0, y0, 0), (x1, y1, 0), (x1, y1, height), (x0, y0, height))
        xa, ya, xb, yb = (p + s * (q - p) for s in (0.14, 0.86) for p, q in ((x0 + 0.02, x1 + 0.02), (y0, y1)))
        model.face(Surface.WINDOW, (xa, ya, 0.7), (xb, yb, 0.7), (xb, yb, 2.2), (xa, ya, 2.2))
        model.face(Surface.TRIM, (x0 * 1.1, y0, height), (x1 * 1.1, y1, height), (0, 0, height + 0.35))
        model.face(Surface.TRIM, (x1, y1, 0), (x0, y0, 0), (0, 0, -0.4))
    return model


def _dormer() -> Model:
    """Build a dormer window; its back end disappears in the roof."""
    w, h, back, top = 0.7, 1.15, -2.4, 1.65
    model = Model().face(Surface.PAINT, (0, -w, 0), (0, w, 0), (0, w, h), (0, -w, h))
    model.face(Surface.PAINT, (0, -w, h), (0, w, h), (0, 0, top))
    model.face(Surface.WINDOW, (0.02, -0.48, 0.25), (0.02, 0.48, 0.25), (0.02, 0.48, 1.1), (0.02, -0.48, 1.1))
    model.face(Surface.PAINT, (back, -w, 0), (0, -w, 0), (0, -w, h), (back, -w, h))
    model.face(Surface.PAINT, (0, w, 0), (back, w, 0), (back, w, h), (0, w, h))
    model.face(Surface.SIGN, (back, -w - 0.1, h - 0.08), (0.12, -w - 0.1, h - 0.08), (0.12, 0, top), (back, 0, top))
    return model.face(
        Surface.SIGN, (0.12, w + 0.1, h - 0.08), (back, w + 0.1, h - 0.08), (back, 0, top), (0.12, 0, top)
    )


def _chimney() -> Model:
    """Build a chimney with two pots; its foot disappears in the roof."""
    model = Model().box((-0.3, -0.45, -2.0), (0.3, 0.45, 1.3), Surface.PAINT)
    model.box((-0.36, -0.52, 1.3), (0.36, 0.52, 1.42), Surface.STONE)
    for y in (-0.22, 0.22):
        model.drum(y, 1.42, 1.78, 0.12, 0.1, Surface.PAINT)
    return model


_MAKERS = {
    **{name: partial(_car, name, *car) for name, car in _CARS.items()},
    "walker": partial(_person, 0.26, coat=False),
    "stander": partial(_person, 0.06, coat=False),
    "coat": partial(_person, 0.2, coat=True),
    "lamp": _lamp,
    "lantern": _lantern,
    "bench": _bench,
    "traffic_sign": _traffic_sign,
    "fountain": _fountain,
    "mast": _mast,
    "wire": lambda: Model().rod((0, 0, 0), (1, 0, 0), 0.014, 0.014, Surface.DARK),  # scaled to its span
    "deck": _deck,
    "balcony": _balcony,
    "awning": _awning,
    "sign": _sign,
    "oriel": _oriel,
    "dormer": _dormer,
    "chimney": _chimney,
}

NUMBER = {name: index for index, name in enumerate(_MAKERS)}


@cache
def models() -> Models:
    """Build all models once."""
    return pack([make() for make in _MAKERS.values()])


class ThingList:
    """Collects placed models while a town or a traversal is furnished."""

    def __init__(self) -> None:
        self._rows: list[tuple] = []

    def add(
        self,
        name: str,
        at: np.ndarray,
        yaw: float,
        *,
        z: float = 0.0,
        scale: tuple[float, float, float] = (1.0, 1.0, 1.0),
        colour: object = (0.3, 0.3, 0.3),
        second: object = (0.7, 0.7, 0.65),
        lit: bool = False,
    ) -> None:
        """Place one model on the point ``at``, ``z`` metres up, with its front towards ``yaw`` (radians)."""
        self._rows.append((at[0], at[1], z, yaw, scale, tuple(colour), tuple(second), float(lit), NUMBER[name]))

    def records(self) -> np.ndarray:
        """Return everything placed so far, as records ``THING``."""
        return np.array(self._rows, dtype=THING)


class Collector:
    """Gathers trees, things, lamps and places while a town is furnished."""

    def __init__(self, era: str) -> None:
        self.past = era == "past"
        self.things = ThingList()
        self.trees: list[tuple] = []
        self.lamps: list[tuple] = []
        self.parking: list[tuple] = []
        self.pavements: list[tuple] = []

    def tree(self, p: np.ndarray, species: Species, size: float, rng: np.random.Generator) -> None:
        """Plant a tree, turned at random."""
        self.trees.append((p[0], p[1], size, rng.uniform(0, 2 * np.pi), int(species), int(rng.integers(1 << 30))))

    def lamp(self, p: np.ndarray, yaw: float, *, tall: bool) -> None:
        """Set up a street lamp that leans towards ``yaw``, or a lantern."""
        if tall and not self.past:
            self.things.add("lamp", p, yaw, colour=(0.2, 0.21, 0.22))
            self.lamps.append((p[0] + 1.25 * np.cos(yaw), p[1] + 1.25 * np.sin(yaw), 6.7, 1.0, 0.35))
        else:
            self.things.add("lantern", p, yaw)
            self.lamps.append((p[0], p[1], 3.75, 0.42, 0.0))
