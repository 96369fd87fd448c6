"""From linear light to an 8-bit image, as a camera does it: mirror images, halos, bloom, blur, exposure, tone, noise."""

from functools import cache

import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter

from artifact_city.kernel import kernel, layout
from artifact_city.noise import hash3, noise2
from artifact_city.palette import accumulate, added, blend, filtered, mixed, scaled
from artifact_city.view import SAMPLES, horizon_at, project, ray_of

# How a sensor renders one frame; ``gain`` is exposure and white balance.
SENSOR = layout("gain:3 saturation noise mono tint:3 vignette seed")

_CURVE_SIZE = 2048
_CURVE_TOP = 12.0  # linear light at the end of the tone curve


@kernel
def mirror_ground(view_record, depth, mirror, image):
    """Add mirror images to wet ground and water, in place.

    The ground is level, so what a ground point at row r mirrors lies in its own column: at the row as far above the
    horizon, lowered by the parallax of twice the camera's height at the mirrored point's depth.
    """
    view = view_record[0]
    rows, columns = mirror.shape
    focal = view.focal / SAMPLES
    source = image.copy()
    for column in range(columns):
        horizon = horizon_at(view, SAMPLES * (column + 0.5)) / SAMPLES
        ray_x, ray_y = ray_of(view, SAMPLES * (column + 0.5))
        for row in range(rows):
            share = mirror[row, column]
            below = row + 0.5 - horizon
            if share <= 0.01 or below <= 0.5:
                continue
            far = view.z * focal / below
            ripple = noise2(column * 0.9 + 3.0 * view.x, 90.0 / below + far * 1.7, 5.0) - 0.5
            target = horizon - below
            for _ in range(2):
                at = min(rows - 1, max(0, np.int64(target)))
                beyond = max(depth[SAMPLES * column, SAMPLES * at], far)
                target = horizon - below + 2.0 * focal * view.z / beyond
            target += ripple * (2.0 + 0.12 * below)
            side = min(columns - 1, max(0, np.int64(column + 1.5 * ripple)))
            total, weight = (0.0, 0.0, 0.0), 0.0
            for k in range(-2, 3):
                at = max(0, np.int64(target + k * (0.6 + 0.05 * below)))
                if at < row:
                    total, weight = added(total, source[at, side], 3.0 - abs(k)), weight + 3.0 - abs(k)
            if weight == 0.0:
                continue
            grazing = 1.0 - view.z / np.sqrt(view.z * view.z + far * far)
            puddle = 0.45 + 0.55 * noise2((view.x + far * ray_x) * 0.45, (view.y + far * ray_y) * 0.45, 6.0)
            strength = share * (0.10 + 0.90 * grazing**3) * (puddle if share < 0.7 else 1.0)
            kept = scaled(image[row, column], 0.4)
            blend(image[row, column], added(kept, total, 1.0 / weight), strength)


@kernel
def _halo(view, x, y, z, power, colour, depth, image):
    """Add a round halo at a point, by how many of the samples around it see as far."""
    column, row, far = project(view, x, y, z)
    if far < 1.0 or far > 140.0:
        return
    seen = 0.0
    for i in range(-2, 3):
        for j in range(-2, 3):
            c, r = np.int64(column + 1.5 * i), np.int64(row + 1.5 * j)
            if 0 <= c < view.columns and 0 <= r < view.rows and depth[c, r] > far - 0.6:
                seen += power / 25.0
    core = max(0.55, 0.10 * view.focal / SAMPLES / far)
    column, row, reach = column / SAMPLES, row / SAMPLES, np.int64(min(70.0, 9.0 + 26.0 * core)) if seen > 0.0 else 0
    for r in range(max(0, np.int64(row) - reach), min(image.shape[0] - 1, np.int64(row) + reach) + 1):
        for c in range(max(0, np.int64(column) - reach), min(image.shape[1] - 1, np.int64(column) + reach) + 1):
            d2 = (r + 0.5 - row) ** 2 + (c + 0.5 - column) ** 2
            edge, d2 = max(0.0, 1.0 - d2 / (reach * reach + 1.0)), d2 / (core * core)
            accumulate(image[r, c], colour, seen * edge * (1.6 / (1.0 + d2) ** 1.5 + 0.045 / (1.0 + 0.02 * d2)))


@kernel
def add_halos(view_record, light_record, lamps, things, depth, image):
    """Add the halos of street lamps at night, and of the lights of cars that have them on."""
    view, light = view_record[0], light_record[0]
    for k in range(len(lamps) if light.dark > 0.0 else 0):
        lamp = lamps[k]
        colour = (1.0, 0.62 + 0.26 * lamp.tone, 0.28 + 0.4 * lamp.tone)
        _halo(view, lamp.x, lamp.y, lamp.z, 1.1 + 1.6 * lamp.power, colour, depth, image)
    for i in range(len(things)):
        thing = things[i]
        if thing.lit <= 0.0:
            continue
        cos, sin = np.cos(thing.yaw), np.sin(thing.yaw)
        dx, dy = view.x - thing.x, view.y - thing.y
        facing = (cos * dx + sin * dy) / (np.sqrt(dx * dx + dy * dy) + 1e-3)
        z, power, colour = 0.66, (0.5 + 1.1 * light.dark) * facing * facing, (1.0, 0.95, 0.85)
        if facing < 0.0:
            z, power, colour = 0.82, 0.25 + 0.6 * light.dark, (1.0, 0.06, 0.04)
        ahead = 2.25 if facing > 0.0 else -2.3
        for across in (-0.6, 0.6):
            x, y = thing.x + ahead * cos - across * sin, thing.y + ahead * sin + across * cos
            _halo(view, x, y, z, power if abs(facing) > 0.2 else 0.0, colour, depth, image)


def bloom(image: np.ndarray, strength: float) -> None:
    """Let bright parts glow: a quarter-size blur of what exceeds white is added, in place."""
    size = image.shape[1], image.shape[0]
    for channel in np.moveaxis(image, 2, 0):
        bright = Image.fromarray(np.clip(channel - 0.7, 0, 6)).reduce(4)
        glow = Image.fromarray(gaussian_filter(np.asarray(bright), 2.4)).resize(size, Image.Resampling.BILINEAR)
        channel += strength * np.asarray(glow)


def soften(image: np.ndarray, sigma: float) -> np.ndarray:
    """Blur an image by a small Gaussian."""
    return gaussian_filter(image, (sigma, sigma, 0))


@cache
def tone_curve(contrast: float) -> np.ndarray:
    """Tabulate the curve from linear light to display light, float32, over the square root of the light.

    Filmic, with a soft shoulder, then the sRGB transfer function, then contrast about middle grey.
    """
    x = _CURVE_TOP * np.linspace(0, 1, _CURVE_SIZE + 1) ** 2
    y = np.clip(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14), 0, 1)
    y = np.where(y < 0.0031308, 12.92 * y, 1.055 * y ** (1 / 2.4) - 0.055)
    return np.clip(0.5 + contrast * (y - 0.5), 0, 1).astype(np.float32)


@kernel
def _tone(x, curve):
    place = np.sqrt(min(1.0, max(0.0, x) * (1.0 / _CURVE_TOP))) * _CURVE_SIZE
    k = min(_CURVE_SIZE - 1, np.int64(place))
    return float(curve[k] + (place - k) * (curve[k + 1] - curve[k]))


@kernel
def develop(image, sensor_record, curve, out):
    """Render a linear image, float32 (rows, columns, 3), as 8-bit sRGB in ``out``; see :func:`tone_curve`."""
    sensor = sensor_record[0]
    rows, columns = out.shape[0], out.shape[1]
    for r in range(rows):
        for c in range(columns):
            dx, dy = (c + 0.5) / columns - 0.5, (r + 0.5) / rows - 0.5
            edge = dx * dx + dy * dy
            colour = scaled(filtered(image[r, c], sensor.gain), 1.0 - sensor.vignette * 2.2 * edge * (0.6 + 0.8 * edge))
            if sensor.mono > 0.0:
                # Old plates and sensors at night see blue better than the eye does.
                level = 0.24 * colour[0] + 0.42 * colour[1] + 0.34 * colour[2]
                colour = (level, level, level)
            colour = (_tone(colour[0], curve), _tone(colour[1], curve), _tone(colour[2], curve))
            grey = 0.3 * colour[0] + 0.59 * colour[1] + 0.11 * colour[2]
            key = float(r * columns + c)
            a, b, d = hash3(key, sensor.seed, 1.0), hash3(key, sensor.seed, 2.0), hash3(key, sensor.seed, 3.0)
            shared, own = 1.6 * (a + b + d - 1.5), 1.2 * (1.0 - sensor.mono)
            grain = (shared + own * (a - b), shared + own * (b - d), shared + own * (d - a))
            strength = sensor.noise * (0.6 + 2.6 * grey * (1.0 - grey) * (1.0 - 0.7 * grey))
            colour = added(mixed((grey, grey, grey), colour, sensor.saturation), grain, strength)
            colour = filtered(colour, sensor.tint)
            for k in range(3):
                out[r, c, k] = np.uint8(min(255.0, max(0.0, 255.0 * colour[k] + 0.5)))
