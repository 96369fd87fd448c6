"""From a traversal to its images: what is around, the passes of the renderer, and the folder, whole or not at all."""

import csv
import io
import os
import shutil
import tempfile
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, as_completed
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image

from artifact_city.conditions import CONDITIONS, Condition, make_light
from artifact_city.develop import SENSOR, add_halos, bloom, develop, mirror_ground, soften, tone_curve
from artifact_city.facade import paint_walls
from artifact_city.fragments import FRAGMENT, N_KINDS, gather
from artifact_city.ground import paint_ground
from artifact_city.kernel import record
from artifact_city.lighting import light_fragments, paint_sky, trace_shadows
from artifact_city.models import N_CARS, models
from artifact_city.rods import MOST_RODS, PLACED_ROD, collect_thing_rods, collect_tree_rods, draw_rods, sort_keys
from artifact_city.surfaces import paint_leaves, paint_roofs, paint_things
from artifact_city.town import Town, make_town, shade_map
from artifact_city.trace import trace_columns, trace_crowns, trace_things
from artifact_city.traffic import Crowd, moving, standing
from artifact_city.traversal import CityTraversal, path_of, poses, positions
from artifact_city.trees import tree_shapes
from artifact_city.view import CAMERAS, HEIGHT, SAMPLES, WIDTH, make_view

JPEG_QUALITY = 90
_THING_REACH = 170.0  # metres
_SCRATCH = threading.local()


class Traced(NamedTuple):
    """What every sample of a frame sees; arrays are (columns, rows) of samples."""

    view: np.ndarray
    surface: np.ndarray
    depth: np.ndarray
    blocked: np.ndarray
    things: np.ndarray


def town_of(traversal: CityTraversal) -> Town:
    """Return the town of a traversal as it is in the era of its condition."""
    return make_town(traversal.town, CONDITIONS[traversal.condition].era)


@lru_cache(maxsize=8)
def light_of(traversal: CityTraversal) -> np.ndarray:
    """Return the light of a traversal; see :func:`conditions.make_light`."""
    beams = CAMERAS[traversal.camera].lateral == "lane"
    return make_light(CONDITIONS[traversal.condition], traversal.town * 1000 + traversal.seed, beams=beams)


def _crowd(traversal: CityTraversal) -> Crowd:
    c = CONDITIONS[traversal.condition]
    bad, past = bool(c.dark or c.wet), c.era == "past"
    quiet = 0.45 if bad else 0.75 if c.snow else 1.0
    return Crowd(0.0 if past else 0.3, 0.13 * quiet, 0.0 if past else 2.0 * quiet, bad or c.snow > 0, past)


@lru_cache(maxsize=4)
def things_of(traversal: CityTraversal) -> np.ndarray:
    """Return all things that stay where they are for a whole traversal, parked cars and people included."""
    furniture = town_of(traversal).furniture
    met = standing(furniture.parking, furniture.pavements, _crowd(traversal), traversal.seed)
    return np.concatenate([furniture.things, met])


def trace_frame(traversal: CityTraversal, index: int) -> Traced:
    """Trace one frame: ground, buildings, crowns, things, and the shadows that things cast on the ground."""
    if not 0 <= index < traversal.frames:
        raise IndexError(f"frame {index} of a traversal of {traversal.frames} frames (they count from 0)")
    made, travelled = poses(traversal)
    pose, camera, things = made[index], CAMERAS[traversal.camera], things_of(traversal)
    distance = np.hypot(things["x"] - pose.x, things["y"] - pose.y)
    # A car that stands where the camera drives would hide everything: it has moved on. A photographer waits longer.
    in_the_way = (distance < (6.5 if camera.lateral == "free" else 2.6)) & (things["model"] < N_CARS)
    things = things[(distance < _THING_REACH) & ~in_the_way]
    path = path_of(traversal)
    if path is not None and camera.lateral == "lane":
        things = np.concatenate([things, moving(path, travelled[index], _crowd(traversal), traversal.seed)])
    scene, light, shapes, library = town_of(traversal).scene, light_of(traversal), tree_shapes(), models()
    view = make_view(camera, pose)
    columns, rows = WIDTH * SAMPLES, HEIGHT * SAMPLES
    surface, depth = np.empty((columns, rows), np.int32), np.empty((columns, rows), np.float32)
    trace_columns(view, scene.world, scene.buildings, scene.building_table, surface, depth)
    trace_crowns(view, scene.trees, shapes.shapes, shapes.blobs, float(light["foliage"][0]), surface, depth)
    trace_things(view, things, library.models, library.faces, surface, depth)
    blocked = np.zeros((columns, rows, 2), np.uint8)
    trace_shadows(view, light, things, library.models, surface, depth, blocked)
    return Traced(view, surface, depth, blocked, things)


def _scratch() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Memory for fragments, their index, and rods, kept by each thread: new pages for every frame cost time."""
    if not hasattr(_SCRATCH, "arrays"):
        most = WIDTH * HEIGHT * SAMPLES * SAMPLES
        _SCRATCH.arrays = np.empty(most, FRAGMENT), np.empty((N_KINDS, most), np.int32), np.empty(MOST_RODS, PLACED_ROD)
    return _SCRATCH.arrays


def shade(town: Town, condition: Condition, light: np.ndarray, traced: Traced) -> np.ndarray:
    """Turn a traced frame into linear radiance, float32 (rows, columns, 3)."""
    scene, shapes, library, (fragments, index, rods) = town.scene, tree_shapes(), models(), _scratch()
    view, surface, depth, blocked, things = traced
    sun = shade_map(town.plan.seed, condition.era, condition.sun.azimuth, condition.sun.elevation)
    counts = np.zeros(N_KINDS, np.int64)
    image, mirror = np.zeros((HEIGHT, WIDTH, 3), np.float32), np.zeros((HEIGHT, WIDTH), np.float32)
    gather(view, surface, depth, blocked, HEIGHT, WIDTH, fragments, index, counts)
    made = fragments, index, counts
    paint_ground(view, light, scene.world, scene.streets, scene.street_table, scene.zone, *made, mirror)
    paint_walls(view, light, scene.buildings, *made)
    paint_roofs(view, light, scene.buildings, *made)
    paint_leaves(view, light, scene.trees, shapes.shapes, shapes.blobs, *made)
    paint_things(light, things, library.models, library.faces, *made)
    paint_sky(light, scene.world, *made, image)
    light_fragments(view, light, scene.world, sun, scene.lamps, scene.lamp_table, *made, image)
    count = collect_tree_rods(view, light, scene.trees, shapes.shapes, shapes.limbs, rods, 0)
    count = collect_thing_rods(view, things, library.models, library.rods, rods, count)
    keys = np.empty(count)
    sort_keys(view, rods, count, keys)
    order = np.argsort(keys, kind="stable")
    draw_rods(view, light, scene.world, sun, scene.lamps, scene.lamp_table, rods, order, depth, image)
    if mirror.any():
        mirror_ground(view, depth, mirror, image)
    if condition.dark or condition.wet:
        add_halos(view, light, scene.lamps, things, depth, image)
    return image


def render_frame(traversal: CityTraversal, index: int) -> np.ndarray:
    """Render one image of a traversal.

    The result depends on the traversal and the index only, not on what was rendered before or in which thread.

    Returns
    -------
    ndarray, uint8 (240, 320, 3)
        sRGB.
    """
    condition = CONDITIONS[traversal.condition]
    image = shade(town_of(traversal), condition, light_of(traversal), trace_frame(traversal, index))
    whole, sensor = np.random.default_rng([traversal.town, traversal.seed, 41]), condition.sensor
    drift = np.sin(index * 0.11 + whole.uniform(0, 6)) + np.sin(index * 0.043 + whole.uniform(0, 6))
    gain = sensor.exposure * float(np.exp(whole.normal(0, 0.06) + 0.05 * drift))
    warmth = sensor.warmth * float(np.exp(whole.normal(0, 0.02)))
    if condition.dark:
        bloom(image, 0.55)
    if sensor.blur > 0:
        image = soften(image, sensor.blur)
    rendering = {
        "gain": (gain * warmth, gain, gain / warmth),
        "saturation": sensor.saturation,
        "noise": sensor.noise,
        "mono": sensor.tint is not None,
        "tint": sensor.tint or (1.0, 1.0, 1.0),
        "vignette": sensor.vignette,
        "seed": traversal.seed * 100_003 + index,
    }
    out = np.empty((HEIGHT, WIDTH, 3), np.uint8)
    develop(image, record(SENSOR, rendering), tone_curve(sensor.contrast), out)
    return out


def render(
    traversal: CityTraversal,
    folder: str | os.PathLike[str],
    *,
    workers: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> None:
    """Render all images of a traversal to ``folder``: ``000000.jpg`` ... and ``positions.csv``.

    Works in a temporary folder beside the target and renames it at the end, so that a run that is stopped leaves
    nothing that looks complete. The bytes do not depend on the number of workers.

    Parameters
    ----------
    traversal : CityTraversal
    folder : path
        Must not exist yet.
    workers : int, optional
        Threads; default: one per processor.
    progress : callable, optional
        Called with the number of images done, after each one.

    Raises
    ------
    FileExistsError
        If ``folder`` exists.
    ValueError
        If the route has no room for the frames.
    """
    folder = Path(folder)
    if folder.exists():
        raise FileExistsError(f"{folder} exists already; delete it to render it anew")
    if workers is not None and workers < 1:
        raise ValueError(f"workers must be at least 1, not {workers!r}")
    where = positions(traversal)
    folder.parent.mkdir(parents=True, exist_ok=True)
    temporary = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", suffix=".partial", dir=folder.parent))
    try:
        render_frame(traversal, 0)  # builds and compiles what all frames share before several threads want it at once
        names = [f"{index:06d}.jpg" for index in range(traversal.frames)]
        with ThreadPoolExecutor(workers or os.cpu_count() or 1) as pool:
            jobs = [pool.submit(_write_frame, traversal, k, temporary / name) for k, name in enumerate(names)]
            try:
                for done, job in enumerate(as_completed(jobs), start=1):
                    job.result()
                    if progress is not None:
                        progress(done)
            except BaseException:
                pool.shutdown(cancel_futures=True)
                raise
        _write_positions(temporary / "positions.csv", names, where, traversal.positions)
        temporary.chmod(0o755)
        temporary.rename(folder)
    except BaseException:
        shutil.rmtree(temporary, ignore_errors=True)
        raise


def _write_frame(traversal: CityTraversal, index: int, path: Path) -> None:
    encoded = io.BytesIO()
    Image.fromarray(render_frame(traversal, index)).save(encoded, "JPEG", quality=JPEG_QUALITY, subsampling=1)
    path.write_bytes(encoded.getvalue())  # Pillow itself does not notice that a full disk took but a part


def _write_positions(path: Path, names: list[str], where: np.ndarray, unit: str) -> None:
    header = ["image", "index"] if unit == "frames" else ["image", "x", "y"]
    rows = ([int(x)] if unit == "frames" else [f"{x:.3f}", f"{y:.3f}"] for x, y in where)
    with path.open("w", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream, lineterminator="\n")
        table.writerow(header)
        table.writerows([name, *row] for name, row in zip(names, rows, strict=True))


def compile_all() -> None:
    """Compile every inner loop and keep the machine code on disk, by rendering one frame; about a minute."""
    render_frame(CityTraversal(town=1, route="A2-D2", condition="rain", frames=1), 0)
