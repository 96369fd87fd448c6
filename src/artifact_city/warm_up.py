"""Compile the renderer with two processes, once on each machine.

The compiler lets only one thread of a process work at a time. A second process therefore compiles what paints surfaces
while this one compiles the rest; they find each other's machine code on disk.
"""

import contextlib
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from artifact_city.buildings import PRISM
from artifact_city.conditions import CONDITIONS
from artifact_city.frame import Mood, Traced, expose, light_of, overlay, paint
from artifact_city.lighting import light_fragments
from artifact_city.models import THING
from artifact_city.optics import add_halos, mirror_ground
from artifact_city.records import record
from artifact_city.streets import STREET_PIECE
from artifact_city.town import LAMP, WORLD, Scene
from artifact_city.trace import SKY
from artifact_city.trees import TREE
from artifact_city.view import CAMERAS, HEIGHT, SAMPLES, WIDTH, Pose, make_view


def empty_scene() -> Scene:
    """Return a world without anything in it, with the types of a real one: what compiled code asks for."""
    table, heights = np.full((1, 1, 1), -1, np.int32), np.zeros((1, 1), np.float32)
    return Scene(
        world=record(WORLD, {"west": 0.0, "south": 0.0, "seed": 0.0}),
        streets=np.zeros(0, STREET_PIECE),
        buildings=np.zeros(0, PRISM),
        trees=np.zeros(0, TREE),
        lamps=np.zeros(0, LAMP),
        street_table=table,
        building_table=table,
        lamp_table=table,
        zone=np.zeros((1, 1), np.uint8),
        roof_height=heights,
        crown_height=heights,
        openness=heights,
    )


def empty_frame() -> tuple[Scene, np.ndarray, np.ndarray, Traced]:
    """Return an empty scene with its shade map, a light, and a traced frame of nothing but sky."""
    samples = (WIDTH * SAMPLES, HEIGHT * SAMPLES)
    surface, depth = np.full(samples, SKY, np.int32), np.full(samples, 1e9, np.float32)
    view = make_view(CAMERAS["car"], Pose(0.0, 0.0, 0.0))
    traced = Traced(view, surface, depth, np.zeros((*samples, 2), np.uint8), np.zeros(0, THING))
    return empty_scene(), np.zeros((2, 2, 3), np.float32), light_of("rain", 0, False), traced


def compile_painting() -> None:
    """Compile what paints and lights surfaces, by painting an empty frame."""
    paint(*empty_frame())


def compile_finishing() -> None:
    """Compile what follows painting, by finishing an empty frame; rain on the lens and halos too."""
    scene, sun, light, traced = empty_frame()
    image = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    overlay(scene, sun, light, traced, image)
    mirror_ground(traced.view, traced.depth, np.zeros((HEIGHT, WIDTH), np.float32), image)
    add_halos(traced.view, light, scene.lamps, traced.things, traced.depth, image)
    expose(image, CONDITIONS["rain"], CAMERAS["car"], Mood(1.0, 1.0, 0))


def is_compiled() -> bool:
    """Whether the last of the painting functions is in the compiler's cache on disk."""
    return any(Path(light_fragments.stats.cache_path).glob("lighting.light_fragments-*.nbi"))


@contextlib.contextmanager
def second_compiler() -> Iterator[None]:
    """Have another process compile the painting while the block runs; then wait for it.

    Does nothing where that is compiled already or cannot be kept. If the other process fails, what it should have
    compiled is compiled here later.
    """
    if light_fragments.stats.cache_path is None or not sys.executable or is_compiled():
        yield
        return
    task = f"from {__name__} import compile_painting; compile_painting()"
    with subprocess.Popen(
        [sys.executable, "-c", task], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    ) as process:
        try:
            yield
            process.wait()
        finally:
            process.kill()
