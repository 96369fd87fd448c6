"""What differs between two drives through the same streets: parked and moving cars, and people."""

from dataclasses import dataclass

import numpy as np

from artifact_city import palette
from artifact_city.models import CARS, ThingList
from artifact_city.palette import choose
from artifact_city.routes import Path
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
        if draw[0] < crowd.parked:
            at, turned = np.array([x, y]) + 0.3 * (draw[3:5] - 0.5), np.pi if draw[4] < 0.07 else 0.0
            colour = palette.CAR[int(draw[2] * len(palette.CAR))]
            things.add(CARS[int(draw[1] * 3.25)], at, heading + turned + 0.03 * (draw[5] - 0.5), colour=colour)
    clothes = palette.OLD_CLOTHES if crowd.past else palette.CLOTHES
    for x, y, heading in pavements:
        draw = rng.random(4)
        if draw[0] < crowd.people:
            name = "coat" if crowd.past else ("walker", "stander", "coat", "walker")[int(draw[1] * 4)]
            size = 0.92 + 0.14 * draw[3]
            turned = heading + 0.4 * (draw[2] - 0.5)
            things.add(name, (x, y), turned, scale=(size, size, size), colour=choose(rng, clothes))
    return things.records()


def moving(path: Path, travelled: float, crowd: Crowd, seed: int) -> np.ndarray:
    """Draw the cars on the road when the camera has driven ``travelled`` metres, as records ``THING``.

    Oncoming cars drive the same path backwards on the other side; now and then a car drives ahead of the camera.
    """
    things = ThingList()
    rng = np.random.default_rng([seed, 2])
    count = int(crowd.moving * path.length / 50)
    starts, paces, draws = rng.uniform(0, 2 * path.length, count), rng.uniform(0.7, 1.2, count), rng.random((count, 3))
    for start, pace, draw in zip(starts, paces, draws, strict=True):
        s = start - pace * travelled
        if travelled + 7 < s < min(travelled + REACH, path.length):
            x, y, heading, kind = path.at(s)
            if kind in (Kind.STREET, Kind.AVENUE):
                across = 2 * DRIVE_OFFSET[kind]
                at = x - across * np.sin(heading), y + across * np.cos(heading)
                colour = palette.CAR[int(draw[1] * len(palette.CAR))]
                things.add(CARS[int(draw[0] * 4)], at, heading + np.pi, colour=colour, lit=crowd.lights)
    for start, pace, draw in zip(rng.uniform(0, path.length, count // 3 + 1), paces, draws, strict=False):
        ahead = travelled + 14 + 26 * pace * (travelled - start) / 60
        if start < travelled < start + 60 and ahead < path.length:
            x, y, heading, _ = path.at(ahead)
            colour = palette.CAR[int(draw[2] * len(palette.CAR))]
            things.add(CARS[int(draw[1] * 4)], (x, y), heading, colour=colour, lit=crowd.lights)
    return things.records()
