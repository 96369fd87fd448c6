"""One frame of a traversal: pose, things around, and the passes of the renderer."""

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from artifact_city.conditions import CONDITIONS, Condition, make_light
from artifact_city.develop import SENSOR, develop, soften, tone_curve
from artifact_city.facade import paint_walls
from artifact_city.fragments import FRAGMENT, N_KINDS, gather
from artifact_city.ground import paint_ground
from artifact_city.lighting import light_fragments
from artifact_city.models import models
from artifact_city.optics import add_halos, bloom, mirror_ground, rain_on_lens, trace_shadows
from artifact_city.raster import trace_crowns, trace_things
from artifact_city.records import record
from artifact_city.rods import MOST_RODS, PLACED_ROD, collect_thing_rods, collect_tree_rods, draw_rods, sort_keys
from artifact_city.sky import paint_sky
from artifact_city.surfaces import paint_leaves, paint_roofs, paint_things
from artifact_city.town import Scene, Town, shade_map
from artifact_city.trace import trace_columns
from artifact_city.trees import tree_shapes
from artifact_city.view import HEIGHT, SAMPLES, WIDTH, Camera, Pose, make_view

_THING_REACH = 170.0  # metres


class Traced(NamedTuple):
    """What every sample of a frame sees; arrays are (columns, rows) of samples."""

    view: np.ndarray
    surface: np.ndarray
    depth: np.ndarray
    blocked: np.ndarray
    things: np.ndarray


def trace(town: Town, camera: Camera, pose: Pose, light: np.ndarray, things: np.ndarray) -> Traced:
    """Find what a camera sees: ground, buildings, crowns, things, and the shadows that things cast on the ground."""
    scene, shapes, library = town.scene, tree_shapes(), models()
    view = make_view(camera, pose)
    columns, rows = WIDTH * SAMPLES, HEIGHT * SAMPLES
    surface, depth = np.empty((columns, rows), np.int32), np.empty((columns, rows), np.float32)
    trace_columns(view, scene.world, scene.buildings, scene.building_table, surface, depth)
    foliage = float(light["foliage"][0])
    trace_crowns(view, scene.trees, shapes.shapes, shapes.blobs, foliage, surface, depth)
    trace_things(view, things, library.models, library.faces, surface, depth)
    blocked = np.zeros((columns, rows, 2), np.uint8)
    trace_shadows(view, light, things, library.models, surface, depth, blocked)
    return Traced(view, surface, depth, blocked, things)


def near_things(things: np.ndarray, pose: Pose) -> np.ndarray:
    """Things close enough to be seen; large ones are kept at any distance."""
    distance = np.hypot(things["x"] - pose.x, things["y"] - pose.y)
    return things[(distance < _THING_REACH) | (models().models["top"][things["model"]] > 15)]


def shade(town: Town, condition: Condition, light: np.ndarray, traced: Traced) -> np.ndarray:
    """Turn a traced frame into linear radiance, float32 (rows, columns, 3)."""
    scene, view, depth = town.scene, traced.view, traced.depth
    sun = shade_map(town.plan.seed, condition.era, condition.sun_azimuth, condition.sun_elevation)
    image, mirror = paint(scene, sun, light, traced)
    overlay(scene, sun, light, traced, image)
    if mirror.any():
        mirror_ground(view, depth, mirror, image)
    if condition.dark or condition.rain:
        add_halos(view, light, scene.lamps, traced.things, depth, image)
    return image


def paint(scene: Scene, sun: np.ndarray, light: np.ndarray, traced: Traced) -> tuple[np.ndarray, np.ndarray]:
    """Paint and light all surfaces.

    Returns
    -------
    image : ndarray, float32 (rows, columns, 3)
        Linear radiance.
    mirror : ndarray, float32 (rows, columns)
        Share of light that the ground mirrors.
    """
    shapes, library = tree_shapes(), models()
    view, surface, depth, blocked, things = traced
    fragments = np.empty(WIDTH * HEIGHT * SAMPLES * SAMPLES, FRAGMENT)
    index, counts = np.empty((N_KINDS, len(fragments)), np.int32), np.zeros(N_KINDS, np.int64)
    image, mirror = np.zeros((HEIGHT, WIDTH, 3), np.float32), np.zeros((HEIGHT, WIDTH), np.float32)
    gather(view, surface, depth, blocked, HEIGHT, WIDTH, fragments, index, counts)
    paint_ground(
        view, light, scene.world, scene.streets, scene.street_table, scene.zone, fragments, index, counts, mirror
    )
    paint_walls(view, light, scene.buildings, fragments, index, counts)
    paint_roofs(view, light, scene.buildings, fragments, index, counts)
    paint_leaves(view, light, scene.trees, shapes.shapes, shapes.blobs, fragments, index, counts)
    paint_things(light, things, library.models, library.faces, fragments, index, counts)
    paint_sky(light, scene.world, fragments, index, counts, image)
    light_fragments(view, light, scene.world, sun, scene.lamps, scene.lamp_table, fragments, index, counts, image)
    return image, mirror


def overlay(scene: Scene, sun: np.ndarray, light: np.ndarray, traced: Traced, image: np.ndarray) -> None:
    """Draw trunks, branches, poles and people over an image, the farthest first."""
    shapes, library = tree_shapes(), models()
    view, _, depth, _, things = traced
    rods = np.empty(MOST_RODS, PLACED_ROD)
    count = collect_tree_rods(view, light, scene.trees, shapes.shapes, shapes.limbs, rods, 0)
    count = collect_thing_rods(view, things, library.models, library.rods, rods, count)
    keys = np.empty(count)
    sort_keys(view, rods, count, keys)
    order = np.argsort(keys, kind="stable")
    draw_rods(view, light, scene.world, sun, scene.lamps, scene.lamp_table, rods, order, depth, image)


@dataclass(frozen=True)
class Mood:
    """How one frame differs from the ideal of its condition: brightness, white balance, and its own random number."""

    gain: float
    warmth: float
    seed: int


def expose(image: np.ndarray, condition: Condition, camera: Camera, mood: Mood) -> np.ndarray:
    """Develop a linear image as the condition's sensor does, uint8 (rows, columns, 3)."""
    bloom(image, 0.55 if condition.dark else 0.16)
    if condition.rain:
        rain_on_lens(image, condition.rain, float(mood.seed))
    if condition.blur > 0:
        soften(image, condition.blur)
    warmth = condition.warmth * mood.warmth
    gain = condition.exposure * mood.gain
    rng = np.random.default_rng([mood.seed, 3])
    seam = float(rng.integers(40, WIDTH - 40)) if camera.panorama and rng.random() < 0.6 else -1.0
    sensor = record(
        SENSOR,
        {
            "gain": (gain * warmth, gain, gain / warmth),
            "saturation": condition.saturation,
            "noise": condition.noise,
            "mono": condition.tint is not None,
            "tint": condition.tint or (1.0, 1.0, 1.0),
            "vignette": condition.vignette,
            "scratches": condition.scratches,
            "seam": seam,
            "seam_shift": float(rng.integers(-2, 3)),
            "seam_gain": float(rng.uniform(0.9, 1.08)),
            "seed": float(mood.seed),
        },
    )
    out = np.empty((HEIGHT, WIDTH, 3), np.uint8)
    develop(image, sensor, tone_curve(condition.contrast), out)
    return out


@lru_cache(maxsize=8)
def light_of(condition: str, seed: int, beams: bool) -> np.ndarray:
    """Light of a traversal; see :func:`conditions.make_light`."""
    return make_light(CONDITIONS[condition], seed, beams=beams)
