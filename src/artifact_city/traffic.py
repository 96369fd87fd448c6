"""What differs between two drives through the same streets: parked and moving cars, and people."""

from dataclasses import dataclass

import numpy as np

from artifact_city import palette
from artifact_city.models import CARS, ThingList
from artifact_city.palette import choose
from artifact_city.streets import DRIVE_OFFSET, Kind

REACH = 110.0  # metres around the camera


@dataclass(frozen=True)
class Crowd:
    """How busy a traversal is: shares of parking places taken and of pavement places with a person."""

    parked: float
    people: float
    moving: float  # cars met per 100 m
    lights: bool
    past: bool


def standing(parking: np.ndarray, pavements: np.ndarray, crowd: Crowd, seed: int) -> np.ndarray:
    """Draw the parked cars and the people of one traversal, as records ``THING``; they stay for the whole drive."""
    rng = np.random.default_rng([seed, 1])
    things = ThingList()
    for x, y, heading in parking:
        draw = rng.random(6)
        if draw[0] > crowd.parked:
            continue
        if crowd.past:
            if draw[1] < 0.12:
                things.add("cart", x, y, heading + 0.3 * draw[2], colour=palette.DOOR[int(draw[3] * len(palette.DOOR))])
            continue
        name = CARS[min(3, int(draw[1] * 3.25))]
        colour = palette.CAR[int(draw[2] * len(palette.CAR))] if name != "van" or draw[3] < 0.4 else palette.CAR[1]
        turned = heading + (np.pi if draw[4] < 0.07 else 0.0) + 0.03 * (draw[5] - 0.5)
        things.add(
            name, x + 0.3 * (draw[3] - 0.5), y + 0.3 * (draw[4] - 0.5), turned, colour=colour, seed=int(1e6 * draw[5])
        )
    clothes = palette.OLD_CLOTHES if crowd.past else palette.CLOTHES
    for x, y, heading in pavements:
        draw = rng.random(4)
        if draw[0] > crowd.people:
            continue
        modern = ("walker", "stander", "coat", "walker")
        name = ("hat", "hat", "coat", "hat")[int(draw[1] * 4)] if crowd.past else modern[int(draw[1] * 4)]
        size = 0.92 + 0.14 * draw[3]
        things.add(name, x, y, heading + 0.4 * (draw[2] - 0.5), scale=(size, size, size), colour=choose(rng, clothes))
    return things.records()


def moving(path: object, travelled: float, crowd: Crowd, seed: int) -> np.ndarray:
    """Draw the cars on the road when the camera has driven ``travelled`` metres, as records ``THING``.

    Oncoming cars drive the same path backwards on the other side; now and then a car drives ahead of the camera.
    """
    things = ThingList()
    rng = np.random.default_rng([seed, 2])
    length = path.length
    count = int(crowd.moving * length / 50)
    starts, paces, draws = rng.uniform(0, 2 * length, count), rng.uniform(0.7, 1.2, count), rng.random((count, 3))
    for start, pace, draw in zip(starts, paces, draws, strict=True):
        s = start - pace * travelled
        if not travelled + 7 < s < min(travelled + REACH, length):
            continue
        x, y, heading, kind = path.at(s)
        if kind not in (Kind.STREET, Kind.AVENUE):
            continue
        across = 2 * DRIVE_OFFSET[kind]
        colour = palette.CAR[int(draw[1] * len(palette.CAR))]
        x, y = x - across * np.sin(heading), y + across * np.cos(heading)
        things.add(CARS[int(draw[0] * 4)], x, y, heading + np.pi, colour=colour, lit=crowd.lights)
    for start, pace, draw in zip(rng.uniform(0, length, count // 3 + 1), paces, draws, strict=False):
        if start < travelled < start + 60:
            gap = 14 + 26 * pace * (travelled - start) / 60
            if travelled + gap < length:
                x, y, heading, _ = path.at(travelled + gap)
                colour = palette.CAR[int(draw[2] * len(palette.CAR))]
                things.add(CARS[int(draw[1] * 4)], x, y, heading, colour=colour, lit=crowd.lights)
    return things.records()
