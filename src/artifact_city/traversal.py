"""A rendered traversal: its description, its path, its poses."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from artifact_city.conditions import CONDITIONS
from artifact_city.routes import (
    PLACES,
    RAILWAY,
    STREETS,
    Path,
    drive_path,
    junctions_of,
    place_poses,
    railway_path,
    street_poses,
)
from artifact_city.town import make_town
from artifact_city.view import CAMERAS, Pose


@dataclass(frozen=True)
class CityTraversal:
    """Everything that determines the images and positions of one rendered traversal.

    Attributes
    ----------
    town : int
        Which town.
    route : str
        Junctions to drive along such as ``A2-D2-D4``; or ``railway``, ``all streets`` (every street, both directions),
        or ``places`` (views scattered over the town).
    condition : str
        One of :data:`CONDITIONS`.
    camera : str
        One of :data:`CAMERAS`.
    frames : int
        Number of images.
    spacing : float
        Metres between images along the route; ignored for ``places``.
    seed : int
        What differs between two traversals with otherwise equal fields: deviations from the ideal path, exposure,
        cars, people, clouds, lit windows.
    wander : float
        Factor on the camera's deviations from its ideal path.
    positions : {"metres", "frames"}
        Whether positions are (x, y) in metres or (index, 0) with the frame's own number.

    Examples
    --------
    >>> CityTraversal(town=1, route="A2-D2-D4", condition="sun", camera="car", frames=200, spacing=2.0).seed
    0
    >>> CityTraversal(town=1, route="A2-D2", condition="snow")
    Traceback (most recent call last):
    ValueError: condition 'snow' is not known; choose one of afternoon, historical, ...
    """

    town: int
    route: str
    condition: str
    camera: str = "car"
    frames: int = 200
    spacing: float = 3.0
    seed: int = 0
    wander: float = 1.0
    positions: str = "metres"

    def __post_init__(self) -> None:
        for name, value, allowed in (
            ("condition", self.condition, CONDITIONS),
            ("camera", self.camera, CAMERAS),
            ("positions", self.positions, ("metres", "frames")),
        ):
            if value not in allowed:
                raise ValueError(f"{name} {value!r} is not known; choose one of {', '.join(sorted(allowed))}")
        for name, low in (("town", 0), ("seed", 0), ("frames", 1)):
            value = getattr(self, name)
            if not isinstance(value, int) or isinstance(value, bool) or value < low:
                raise ValueError(f"{name} must be a whole number of at least {low}, not {value!r}")
        if not self.spacing > 0 or not np.isfinite(self.spacing):
            raise ValueError(f"spacing must be a positive number of metres, not {self.spacing!r}")
        if self.wander < 0:
            raise ValueError(f"wander must not be negative, not {self.wander!r}")
        lateral = CAMERAS[self.camera].lateral
        if (self.route == RAILWAY) != (lateral == "track"):
            raise ValueError(
                f"route {RAILWAY!r} and camera 'train' go together, not {self.route!r} and {self.camera!r}"
            )
        if (self.route == PLACES) != (lateral == "free"):
            free = [name for name, camera in CAMERAS.items() if camera.lateral == "free"]
            raise ValueError(f"route {PLACES!r} goes with a camera of {free}, not {self.route!r} with {self.camera!r}")
        if self.route not in (RAILWAY, STREETS, PLACES):
            junctions_of(self.route)


def _slow_noise(count: int, reach: float, rng: np.random.Generator) -> np.ndarray:
    """Smooth random deviations with unit standard deviation that change over ``reach`` frames."""
    size = max(1, round(2 * reach))
    window = np.hanning(2 * size + 3)[1:-1]
    values = np.convolve(rng.normal(0, 1, count + len(window) - 1), window, mode="valid")
    return values / np.linalg.norm(window)


def path_of(traversal: CityTraversal) -> Path | None:
    """Return the path that a camera follows; none for scattered places and for all streets."""
    if traversal.route in (STREETS, PLACES):
        return None
    return _path(traversal.town, traversal.route, CAMERAS[traversal.camera].lateral)


@lru_cache(maxsize=8)
def _path(town: int, route: str, lateral: str) -> Path:
    made = make_town(town)
    return railway_path(made.track) if route == RAILWAY else drive_path(made.plan, route, lateral)


@lru_cache(maxsize=16)
def poses(traversal: CityTraversal) -> tuple[tuple[Pose, ...], tuple[float, ...]]:
    """Poses of all frames, and the metres travelled at each.

    Raises
    ------
    ValueError
        If the route is too short for the frames asked for; says how many fit.
    """
    camera, n = CAMERAS[traversal.camera], traversal.frames
    rng = np.random.default_rng([traversal.town, traversal.seed, 31])
    if traversal.route == PLACES:
        town = make_town(traversal.town)
        return tuple(_snapshots(place_poses(town.plan, town.scene.buildings, n), traversal.wander, rng)), (0.0,) * n
    sway = np.radians(camera.sway) * traversal.wander * _slow_noise(n, 8 / traversal.spacing, rng)
    shift = camera.wander * traversal.wander * _slow_noise(n, 30 / traversal.spacing, rng)
    pitch = np.radians(0.25 * camera.sway) * traversal.wander * rng.normal(0, 1, n)
    roll = np.radians(0.25 * camera.sway) * traversal.wander * _slow_noise(n, 4 / traversal.spacing, rng)
    if traversal.route == STREETS:
        ideal = street_poses(make_town(traversal.town).plan, traversal.spacing)
        if n > len(ideal):
            raise ValueError(f"all streets of town {traversal.town} give {len(ideal)} images at this spacing, not {n}")
        travelled, ideal = np.zeros(n), [ideal[k] for k in np.linspace(0, len(ideal) - 1, n).round().astype(int)]
    else:
        path = path_of(traversal)
        phase = rng.uniform(0, 0.999) * traversal.spacing * (camera.lateral != "track")
        travelled = phase + traversal.spacing * np.arange(n)
        if travelled[-1] > path.length:
            fit = int(path.length / traversal.spacing)
            raise ValueError(
                f"route {traversal.route!r} of town {traversal.town} is {path.length:.0f} m long: at "
                f"{traversal.spacing:g} m spacing it has room for {fit} frames, not {n}"
            )
        ideal = [Pose(*path.at(s)[:3]) for s in travelled]
    made = []
    for p, aside, turn, tip, lean in zip(ideal, shift, sway, pitch, roll, strict=True):
        x, y = p.x + aside * np.sin(p.heading), p.y - aside * np.cos(p.heading)
        made.append(Pose(x, y, p.heading + turn, pitch=tip, roll=lean))
    return tuple(made), tuple(float(s) for s in travelled)


def _snapshots(places: list[Pose], wander: float, rng: np.random.Generator) -> list[Pose]:
    """Hand-held views of places: each from a slightly different spot, direction, height and zoom."""
    found = []
    for p in places:
        along, across, turn, tip, roll, zoom, raised = rng.normal(0, wander, 7)
        dx, dy = 0.45 * np.clip(along, -2.5, 2.5), 0.45 * np.clip(across, -2.5, 2.5)
        cos, sin = np.cos(p.heading), np.sin(p.heading)
        x, y, heading = p.x + dx * cos + dy * sin, p.y + dx * sin - dy * cos, p.heading + np.radians(4.0) * turn
        found.append(
            Pose(
                x, y, heading, np.radians(1.2) * tip, np.radians(0.7) * roll, float(np.exp(0.08 * zoom)), 0.15 * raised
            )
        )
    return found


def positions(traversal: CityTraversal) -> np.ndarray:
    """Position of every image, without rendering.

    Returns
    -------
    ndarray, float64 (frames, 2)
        Metres east and north; or, for a traversal with positions in frames, the frame's number and 0.
    """
    if traversal.positions == "frames":
        return np.stack([np.arange(traversal.frames, dtype=np.float64), np.zeros(traversal.frames)], axis=1)
    return np.array([(p.x, p.y) for p in poses(traversal)[0]], dtype=np.float64)
