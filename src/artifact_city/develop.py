"""From linear light to an 8-bit image, as a camera does it: blur, exposure, tone, noise, monochrome, old plates."""

from functools import cache

import numpy as np

from artifact_city.kernel import kernel
from artifact_city.noise import hash3, noise2, smooth
from artifact_city.records import layout

# How a sensor renders one frame.
SENSOR = layout(
    gain=("f8", (3,)),  # exposure and white balance
    saturation="f8",
    noise="f8",
    mono="f8",
    tint=("f8", (3,)),
    vignette="f8",
    scratches="f8",
    seam="f8",  # column of a panorama's stitch, or negative
    seam_shift="f8",  # rows
    seam_gain="f8",
    seed="f8",
)


@kernel
def soften(image, sigma):
    """Blur an image by a small Gaussian, in place."""
    rows, columns = image.shape[0], image.shape[1]
    a = np.exp(-0.5 / (sigma * sigma))
    b = np.exp(-2.0 / (sigma * sigma))
    norm = 1.0 / (1.0 + 2.0 * a + 2.0 * b)
    swap = np.empty_like(image)
    for r in range(rows):
        for c in range(columns):
            l1, r1, l2, r2 = max(0, c - 1), min(columns - 1, c + 1), max(0, c - 2), min(columns - 1, c + 2)
            for k in range(3):
                near, far = image[r, l1, k] + image[r, r1, k], image[r, l2, k] + image[r, r2, k]
                swap[r, c, k] = norm * (image[r, c, k] + a * near + b * far)
    for r in range(rows):
        u1, d1, u2, d2 = max(0, r - 1), min(rows - 1, r + 1), max(0, r - 2), min(rows - 1, r + 2)
        for c in range(columns):
            for k in range(3):
                near, far = swap[u1, c, k] + swap[d1, c, k], swap[u2, c, k] + swap[d2, c, k]
                image[r, c, k] = norm * (swap[r, c, k] + a * near + b * far)


_CURVE_SIZE = 2048
_CURVE_TOP = 12.0  # linear light at the end of the tone curve


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
    return curve[k] + (place - k) * (curve[k + 1] - curve[k])


@kernel
def develop(image, sensor_record, curve, out):
    """Render a linear image as 8-bit sRGB.

    Parameters
    ----------
    image : ndarray, float32 (rows, columns, 3)
    sensor_record : ndarray of SENSOR, one record
    curve : ndarray
        See :func:`tone_curve`.
    out : ndarray, uint8 (rows, columns, 3)
        Filled.
    """
    sensor = sensor_record[0]
    rows, columns = out.shape[0], out.shape[1]
    for r in range(rows):
        for c in range(columns):
            gain, row = 1.0, r
            if sensor.seam >= 0.0 and c > sensor.seam:
                gain = sensor.seam_gain
                row = min(rows - 1, max(0, r + np.int64(sensor.seam_shift)))
            dx, dy = (c + 0.5) / columns - 0.5, (r + 0.5) / rows - 0.5
            gain *= 1.0 - sensor.vignette * 2.2 * (dx * dx + dy * dy) * (0.6 + 0.8 * (dx * dx + dy * dy))
            red = image[row, c, 0] * sensor.gain[0] * gain
            green = image[row, c, 1] * sensor.gain[1] * gain
            blue = image[row, c, 2] * sensor.gain[2] * gain
            if sensor.mono > 0.0:
                # Old plates and sensors at night see blue better than the eye does.
                red = 0.24 * red + 0.42 * green + 0.34 * blue
                green = blue = red
            red, green, blue = _tone(red, curve), _tone(green, curve), _tone(blue, curve)
            grey = 0.3 * red + 0.59 * green + 0.11 * blue
            red = grey + sensor.saturation * (red - grey)
            green = grey + sensor.saturation * (green - grey)
            blue = grey + sensor.saturation * (blue - grey)
            if sensor.noise > 0.0:
                key = float(r * columns + c)
                strength = sensor.noise * (0.6 + 2.6 * grey * (1.0 - grey) * (1.0 - 0.7 * grey))
                a, b, d = hash3(key, sensor.seed, 1.0), hash3(key, sensor.seed, 2.0), hash3(key, sensor.seed, 3.0)
                shared = 1.6 * (a + b + d - 1.5)
                own = 0.0 if sensor.mono > 0.0 else 1.2
                red += strength * (shared + own * (a - b))
                green += strength * (shared + own * (b - d))
                blue += strength * (shared + own * (d - a))
            if sensor.mono > 0.0:
                damage = _damage(sensor, r, c, rows, columns) if sensor.scratches > 0.0 else 0.0
                red = red + damage
                faded = sensor.scratches
                red = red * (1.0 - 0.16 * faded) + 0.07 * faded
                red, green, blue = red * sensor.tint[0], red * sensor.tint[1], red * sensor.tint[2]
            out[r, c, 0] = np.uint8(min(255.0, max(0.0, 255.0 * red + 0.5)))
            out[r, c, 1] = np.uint8(min(255.0, max(0.0, 255.0 * green + 0.5)))
            out[r, c, 2] = np.uint8(min(255.0, max(0.0, 255.0 * blue + 0.5)))


@kernel
def _damage(sensor, r, c, rows, columns):
    """Scratches, spots and stains of an old plate: what to add to the grey value."""
    value = 0.10 * (noise2(c * 0.013, r * 0.013, sensor.seed) - 0.5)
    for k in range(3):
        x = hash3(sensor.seed, float(k), 21.0) * columns + 3.0 * (noise2(r * 0.02, float(k), sensor.seed) - 0.5)
        if abs(c + 0.5 - x) < 0.6:
            start = hash3(sensor.seed, float(k), 22.0) * rows
            length = 0.2 + 0.6 * hash3(sensor.seed, float(k), 23.0)
            if start < r < start + length * rows:
                value += 0.22 * (0.4 + hash3(float(r // 3), float(k), sensor.seed))
    for k in range(9):
        x, y = hash3(sensor.seed, float(k), 31.0) * columns, hash3(sensor.seed, float(k), 32.0) * rows
        size = 0.5 + 1.4 * hash3(sensor.seed, float(k), 33.0) ** 2
        near = (c + 0.5 - x) ** 2 + (r + 0.5 - y) ** 2
        if near < 4.0 * size * size:
            mark = smooth(2.0 * size, 0.6 * size, np.sqrt(near))
            value += mark * (0.4 if hash3(sensor.seed, float(k), 34.0) < 0.7 else -0.35)
    return sensor.scratches * value
