"""Cameras, and the projection that the compiled code uses."""

from dataclasses import dataclass

import numpy as np

from artifact_city.kernel import kernel, layout, record

WIDTH, HEIGHT = 320, 240  # pixels of every image
SAMPLES = 2  # samples per pixel along each axis


@dataclass(frozen=True)
class Camera:
    """A camera and how it is carried."""

    height: float  # metres above the ground
    field_of_view: float  # horizontal, degrees
    horizon: float  # where it lies, as a share of the image height from the top
    lateral: str  # where it goes: in its "lane", on the "pavement", on the "track", or "free"
    panorama: bool = False  # columns are equally spaced in angle, as in a crop from a stitched panorama
    wander: float = 0.0  # typical slow deviation from the ideal path, metres
    sway: float = 0.0  # and from its heading, degrees


CAMERAS = {
    "car": Camera(1.5, 76.0, 0.62, "lane", wander=0.35, sway=1.6),
    "walker": Camera(1.65, 68.0, 0.52, "pavement", wander=0.45, sway=4.0),
    "train": Camera(2.7, 58.0, 0.6, "track"),
    "street_view": Camera(2.5, 92.0, 0.54, "lane", panorama=True, wander=0.3, sway=1.0),
    "handheld": Camera(1.65, 66.0, 0.68, "free"),
    "plate": Camera(1.5, 60.0, 0.7, "free"),
}


# One pose of one camera as compiled code reads it. Columns and rows count samples, not pixels; ``centre`` is the column of
# the optical axis, ``horizon`` its row of the horizon, ``roll`` rows of horizon per column.
VIEW = layout("x y z forward_x forward_y right_x right_y focal centre horizon roll panorama:i columns:i rows:i")


@dataclass(frozen=True)
class Pose:
    """Where a camera is and how it is held; metres and radians."""

    x: float
    y: float
    heading: float
    pitch: float = 0.0
    roll: float = 0.0
    zoom: float = 1.0
    raised: float = 0.0


def make_view(camera: Camera, pose: Pose) -> np.ndarray:
    """Set up the projection of a camera at a pose, as one record ``VIEW``.

    Small pitch and roll are shifts and shears of the horizon, so that upright lines stay upright.
    """
    columns, rows = WIDTH * SAMPLES, HEIGHT * SAMPLES
    half = np.radians(camera.field_of_view) / 2
    focal = pose.zoom * (columns / 2) / (half if camera.panorama else np.tan(half))
    cos, sin, z = np.cos(pose.heading), np.sin(pose.heading), camera.height + pose.raised
    horizon, roll = camera.horizon * rows + focal * np.tan(pose.pitch), np.tan(pose.roll)
    values = pose.x, pose.y, z, cos, sin, sin, -cos, focal, columns / 2, horizon, roll, camera.panorama, columns, rows
    return record(VIEW, dict(zip(VIEW.names, values, strict=True)))


@kernel
def ray_of(view, column):
    """Horizontal displacement per unit of depth along the ray of a (fractional) column."""
    offset = (column - view.centre) / view.focal
    along, across = (np.cos(offset), np.sin(offset)) if view.panorama else (1.0, offset)
    return along * view.forward_x + across * view.right_x, along * view.forward_y + across * view.right_y


@kernel
def horizon_at(view, column):
    """Row of the horizon at a (fractional) column."""
    return view.horizon + view.roll * (column - view.centre)


@kernel
def project(view, x, y, z):
    """Return column, row and depth of a point; the depth is not positive behind the camera."""
    dx, dy = x - view.x, y - view.y
    ahead = dx * view.forward_x + dy * view.forward_y
    right = dx * view.right_x + dy * view.right_y
    if ahead <= 1e-3 and (not view.panorama or abs(right) < -2.0 * ahead):
        return 0.0, 0.0, -1.0
    if view.panorama:
        depth = np.sqrt(dx * dx + dy * dy)
        column = view.centre + view.focal * np.arctan2(right, ahead)
    else:
        depth = ahead
        column = view.centre + view.focal * right / depth
    return column, horizon_at(view, column) - view.focal * (z - view.z) / depth, depth


@kernel
def column_range(view, x, y, radius):
    """First and last column that an upright cylinder may touch; the last is less than the first if none."""
    dx, dy = x - view.x, y - view.y
    ahead = dx * view.forward_x + dy * view.forward_y
    right = dx * view.right_x + dy * view.right_y
    distance = np.sqrt(dx * dx + dy * dy)
    if distance <= radius:
        return 0, view.columns - 1
    angle, half = np.arctan2(right, ahead), np.arcsin(radius / distance)
    low, high = max(angle - half, -1.45), min(angle + half, 1.45)
    if low >= high:
        return 0, -1
    if not view.panorama:
        low, high = np.tan(low), np.tan(high)
    first = max(0.0, np.floor(view.centre + view.focal * low))
    last = min(view.columns - 1.0, np.ceil(view.centre + view.focal * high))
    return np.int64(first), np.int64(last)
