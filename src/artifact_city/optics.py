"""What happens to light before the sensor: mirror images on wet ground and water, halos, drops on the lens."""

import numpy as np

from artifact_city.kernel import kernel
from artifact_city.models import N_CARS
from artifact_city.noise import hash3, noise2
from artifact_city.view import SAMPLES, column_range, horizon_at, project, ray_of


@kernel
def trace_shadows(view_record, light_record, things, models, surface, depth, blocked):
    """Mark ground that cars and other low things keep the sky and the sun from.

    ``blocked``, uint8 (columns, rows, 2): the share of the sky (contact shadow) and of the sun (cast shadow), of 255.
    """
    view, light = view_record[0], light_record[0]
    day = light.sun[0] > 0.3
    slant = 1.0 / max(0.2, light.sun_z)
    for i in range(len(things)):
        thing = things[i]
        model = models[thing.model]
        if (
            thing.z > 0.01
            or model.top > 3.2
            or model.last_face - model.first_face + model.last_rod - model.first_rod < 4
        ):
            continue
        car = thing.model < N_CARS
        half_x, half_y, top = (2.15, 0.86, 1.2) if car else (0.3, 0.3, min(1.6, model.top))
        if not car and model.radius > 1.9:
            half_x, half_y = 0.6 * model.radius, 0.4 * model.radius
        shift_x, shift_y = -light.sun_x * slant * top, -light.sun_y * slant * top
        distance = np.sqrt((thing.x - view.x) ** 2 + (thing.y - view.y) ** 2)
        if distance > 70.0:
            continue
        reach = half_x + 1.2 + (0.5 * np.sqrt(shift_x**2 + shift_y**2) if day else 0.0)
        cx, cy = thing.x + (0.5 * shift_x if day else 0.0), thing.y + (0.5 * shift_y if day else 0.0)
        first, last = column_range(view, cx, cy, reach)
        if last < first:
            continue
        away = np.sqrt((cx - view.x) ** 2 + (cy - view.y) ** 2)
        low = view.z * view.focal / (away + reach)
        high = view.z * view.focal / max(0.5, (away - reach) * 0.6)
        cos, sin = np.cos(thing.yaw), np.sin(thing.yaw)
        sx, sy = cos * light.sun_x + sin * light.sun_y, cos * light.sun_y - sin * light.sun_x
        for column in range(first, last + 1):
            horizon = horizon_at(view, column + 0.5)
            ray_x, ray_y = ray_of(view, column + 0.5)
            for row in range(np.int64(max(0.0, horizon + low)), np.int64(min(view.rows - 1.0, horizon + high)) + 1):
                if surface[column, row] != 0:
                    continue
                far = depth[column, row]
                dx, dy = view.x + far * ray_x - thing.x, view.y + far * ray_y - thing.y
                x, y = cos * dx + sin * dy, cos * dy - sin * dx
                out_x, out_y = max(0.0, abs(x) - half_x + 0.25), max(0.0, abs(y) - half_y + 0.2)
                near = max(0.0, 1.0 - np.sqrt(out_x * out_x + out_y * out_y) / 0.75)
                blocked[column, row, 0] = max(blocked[column, row, 0], np.uint8(225.0 * near * near))
                if day and _in_shadow(x, y, sx, sy, light.sun_z, half_x, half_y, top, car):
                    blocked[column, row, 1] = 255


@kernel
def _in_shadow(x, y, sx, sy, sz, half_x, half_y, top, car):
    """Whether the ray from a ground point to the sun meets a thing's box, or a car's cabin."""
    for part in range(2 if car else 1):
        low, high = (0.2, 0.95) if car else (0.0, top)
        hx, hy, middle = half_x, half_y, 0.0
        if part == 1:
            low, high, hx, hy, middle = 0.9, 1.42, 1.15, half_y - 0.14, -0.45
        t0, t1 = low / max(sz, 1e-3), high / max(sz, 1e-3)
        for axis in range(2):
            p, s, h = (x - middle, sx, hx) if axis == 0 else (y, sy, hy)
            if abs(s) < 1e-9:
                if abs(p) > h:
                    t1 = -1.0
            else:
                a, b = (-h - p) / s, (h - p) / s
                t0, t1 = max(t0, min(a, b)), min(t1, max(a, b))
        if t0 < t1:
            return True
    return False


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
            r, g, b, weight = 0.0, 0.0, 0.0, 0.0
            spread = 0.6 + 0.05 * below
            for k in range(-2, 3):
                at = np.int64(target + k * spread)
                at = max(at, 0)
                if at < row:
                    w = 3.0 - abs(k)
                    r, g, b = r + w * source[at, side, 0], g + w * source[at, side, 1], b + w * source[at, side, 2]
                    weight += w
            if weight == 0.0:
                continue
            grazing = 1.0 - view.z / np.sqrt(view.z * view.z + far * far)
            puddle = 0.45 + 0.55 * noise2((view.x + far * ray_x) * 0.45, (view.y + far * ray_y) * 0.45, 6.0)
            strength = share * (0.10 + 0.90 * grazing**3) * (puddle if share < 0.7 else 1.0)
            image[row, column, 0] += strength * (r / weight - 0.6 * image[row, column, 0])
            image[row, column, 1] += strength * (g / weight - 0.6 * image[row, column, 1])
            image[row, column, 2] += strength * (b / weight - 0.6 * image[row, column, 2])


@kernel
def _halo(view, x, y, z, power, red, green, blue, depth, image):
    """Add a round halo at a point, if it is seen."""
    column, row, far = project(view, x, y, z)
    rows, columns = image.shape[0], image.shape[1]
    if far < 1.0 or far > 140.0:
        return
    seen, total = 0.0, 0.0
    for i in range(-2, 3):
        for j in range(-2, 3):
            c, r = np.int64(column + 1.5 * i), np.int64(row + 1.5 * j)
            if 0 <= c < view.columns and 0 <= r < view.rows:
                total += 1.0
                seen += depth[c, r] > far - 0.6
    if total < 5.0 or seen == 0.0:
        return
    amount = power * seen / 25.0
    core = max(0.55, 0.10 * view.focal / SAMPLES / far)
    reach = np.int64(min(70.0, 9.0 + 26.0 * core))
    column, row = column / SAMPLES, row / SAMPLES
    for r in range(max(0, np.int64(row) - reach), min(rows - 1, np.int64(row) + reach) + 1):
        for c in range(max(0, np.int64(column) - reach), min(columns - 1, np.int64(column) + reach) + 1):
            d2 = ((r + 0.5 - row) ** 2 + (c + 0.5 - column) ** 2) / (core * core)
            edge = 1.0 - ((r + 0.5 - row) ** 2 + (c + 0.5 - column) ** 2) / (reach * reach + 1.0)
            if edge > 0.0:
                glow = amount * edge * (1.6 / (1.0 + d2) ** 1.5 + 0.045 / (1.0 + 0.02 * d2))
                image[r, c, 0] += glow * red
                image[r, c, 1] += glow * green
                image[r, c, 2] += glow * blue


@kernel
def add_halos(view_record, light_record, lamps, things, depth, image):
    """Add the halos of street lamps at night, and of the headlights of cars that have them on."""
    view, light = view_record[0], light_record[0]
    if light.dark > 0.0:
        for k in range(len(lamps)):
            lamp = lamps[k]
            if (lamp.x - view.x) ** 2 + (lamp.y - view.y) ** 2 < 140.0**2:
                white = lamp.tone
                _halo(
                    view, lamp.x, lamp.y, lamp.z, 1.1 + 1.6 * lamp.power, 1.0, 0.62 + 0.26 * white,
                    0.28 + 0.4 * white, depth, image,
                )  # fmt: skip
    for i in range(len(things)):
        thing = things[i]
        if thing.lit <= 0.0 or thing.model >= N_CARS:
            continue
        cos, sin = np.cos(thing.yaw), np.sin(thing.yaw)
        dx, dy = view.x - thing.x, view.y - thing.y
        facing = (cos * dx + sin * dy) / (np.sqrt(dx * dx + dy * dy) + 1e-3)
        for side in range(2):
            across = 0.6 if side == 0 else -0.6
            if facing > 0.2:
                x, y = thing.x + 2.2 * cos - across * sin, thing.y + 2.2 * sin + across * cos
                power = (0.5 + 1.1 * light.dark) * facing * facing
                _halo(view, x, y, 0.66, power, 1.0, 0.95, 0.85, depth, image)
            elif facing < -0.2:
                x, y = thing.x - 2.3 * cos - across * sin, thing.y - 2.3 * sin + across * cos
                _halo(view, x, y, 0.82, 0.25 + 0.6 * light.dark, 1.0, 0.06, 0.04, depth, image)


@kernel
def bloom(image, strength):
    """Let bright parts glow: a quarter-size blur of what exceeds white is added, in place."""
    rows, columns = image.shape[0] // 4, image.shape[1] // 4
    small, swap = np.zeros((rows, columns, 3), dtype=np.float32), np.zeros((rows, columns, 3), dtype=np.float32)
    for r in range(rows):
        for c in range(columns):
            for k in range(3):
                total = 0.0
                for q in range(16):
                    total += max(0.0, image[4 * r + q // 4, 4 * c + q % 4, k] - 0.7)
                small[r, c, k] = min(6.0, total / 16.0)
    for _ in range(2):
        for r in range(rows):
            for c in range(columns):
                for k in range(3):
                    a, b = small[r, max(0, c - 1), k], small[r, min(columns - 1, c + 1), k]
                    d, e = small[r, max(0, c - 3), k], small[r, min(columns - 1, c + 3), k]
                    swap[r, c, k] = 0.34 * small[r, c, k] + 0.22 * (a + b) + 0.11 * (d + e)
        for r in range(rows):
            for c in range(columns):
                for k in range(3):
                    a, b = swap[max(0, r - 1), c, k], swap[min(rows - 1, r + 1), c, k]
                    d, e = swap[max(0, r - 3), c, k], swap[min(rows - 1, r + 3), c, k]
                    small[r, c, k] = 0.34 * swap[r, c, k] + 0.22 * (a + b) + 0.11 * (d + e)
    for r in range(image.shape[0]):
        v = min(rows - 1.001, max(0.0, (r - 1.5) / 4.0))
        j = np.int64(v)
        for c in range(image.shape[1]):
            u = min(columns - 1.001, max(0.0, (c - 1.5) / 4.0))
            i = np.int64(u)
            s, t = u - i, v - j
            for k in range(3):
                low = small[j, i, k] * (1.0 - s) + small[j, i + 1, k] * s
                high = small[j + 1, i, k] * (1.0 - s) + small[j + 1, i + 1, k] * s
                image[r, c, k] += strength * (low * (1.0 - t) + high * t)


@kernel
def rain_on_lens(image, amount, seed):
    """Draw falling rain as faint streaks, and a few drops on the lens that bend the picture, in place."""
    rows, columns = image.shape[0], image.shape[1]
    source = image.copy()
    for k in range(np.int64(170 * amount)):
        c, r = hash3(seed, float(k), 1.0) * columns, (hash3(seed, float(k), 2.0) * 1.3 - 0.2) * rows
        near = hash3(seed, float(k), 3.0)
        length, lean = 7.0 + 26.0 * near * near, 0.1 * (hash3(seed, float(k), 4.0) - 0.4)
        for q in range(np.int64(length)):
            row, column = np.int64(r + q), np.int64(c + lean * q)
            if 0 <= row < rows and 0 <= column < columns:
                for m in range(3):
                    image[row, column, m] += 0.10 * (0.4 + 0.6 * near) * (0.75 - min(0.75, image[row, column, m]))
    for k in range(np.int64(16 * amount)):
        c, r = hash3(seed, float(k), 11.0) * columns, hash3(seed, float(k), 12.0) * rows
        radius = 2.0 + 6.5 * hash3(seed, float(k), 13.0) ** 2
        for row in range(max(0, np.int64(r - radius)), min(rows - 1, np.int64(r + radius)) + 1):
            for column in range(max(0, np.int64(c - radius)), min(columns - 1, np.int64(c + radius)) + 1):
                dx, dy = (column + 0.5 - c) / radius, (row + 0.5 - r) / radius
                inside = 1.0 - dx * dx - dy * dy
                if inside <= 0.0:
                    continue
                y = min(rows - 1, max(0, np.int64(r - 7.0 * dy * radius)))
                x = min(columns - 1, max(0, np.int64(c - 7.0 * dx * radius)))
                edge = 0.72 + 0.35 * min(1.0, 2.2 * inside)
                for m in range(3):
                    bent = source[y, x, m] * edge + 0.05 * max(0.0, -dy)
                    image[row, column, m] += min(1.0, 2.5 * inside) * 0.9 * (bent - image[row, column, m])
