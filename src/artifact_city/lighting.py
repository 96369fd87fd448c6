"""Light: the sky with its clouds and hills; sun, lamps and headlights on surfaces; mirror images in glass; haze."""

import numpy as np

from artifact_city.fragments import K_LEAF, K_SKY
from artifact_city.grids import LAMP_CELL, look_up
from artifact_city.kernel import kernel
from artifact_city.noise import cloud_noise, noise2, smooth
from artifact_city.palette import accumulate, added, filtered, mixed, scaled
from artifact_city.trace import GROUND
from artifact_city.view import column_range, horizon_at, ray_of

_WARM, _WHITE, _BEAM = (1.0, 0.60, 0.26), (1.0, 0.88, 0.68), (1.0, 0.95, 0.85)
_LAMP_REACH_2 = 576.0  # square metres


@kernel
def _sky(light, dx, dy, slope):
    """Radiance of the sky in the direction with this horizontal unit vector and rise per horizontal distance."""
    level = 1.0 / np.sqrt(1.0 + slope * slope)
    up = slope * level
    near_sun = max(0.0, level * (dx * light.sun_x + dy * light.sun_y) + up * light.sun_z)
    c = mixed(light.sky_low, light.sky_top, smooth(0.0, 0.62, up) ** 0.75 if up > 0 else 0.0)
    c = added(c, light.sun, 0.10 * near_sun**6 + 0.30 * near_sun**40)
    stretch = 1.1 / (max(0.0, up) + 0.09)
    px, py = dx * stretch, dy * stretch
    puffs = cloud_noise(px, py, light.cloud_seed, 4.0)
    edge = 0.74 - 0.44 * light.cloudiness
    share = smooth(edge, edge + 0.16 + 0.1 * light.cloudiness, puffs) * smooth(-0.01, 0.10, up) * 0.92
    bright = 1.0 - smooth(edge + 0.05, edge + 0.42, puffs)
    return mixed(c, mixed(light.cloud_shade, light.cloud, bright), share)


@kernel
def _hill(seed, dx, dy):
    """Slope up to which distant hills hide the sky in a horizontal direction, at most 0.095."""
    near = noise2(dx * 7.0 + 40.0, dy * 7.0, seed)
    fine = noise2(dx * 60.0 + 9.0, dy * 60.0, seed + 5)
    return 0.012 + 0.075 * near * near + 0.008 * fine


@kernel
def paint_sky(light_record, world_record, fragments, index, counts, image):
    """Add all fragments of sky, and of the hills before it, to ``image``."""
    light, world = light_record[0], world_record[0]
    far = 0.55 + 0.35 * smooth(0.0, 0.006, light.haze)
    for n in range(counts[K_SKY]):
        f = fragments[index[K_SKY, n]]
        flat = np.sqrt(np.float64(f.ray_x * f.ray_x + f.ray_y * f.ray_y))
        dx, dy, slope = f.ray_x / flat, f.ray_y / flat, f.slope / flat
        share = smooth(0.004, -0.004, slope - _hill(world.seed, dx, dy)) if slope < 0.1 else 0.0
        c = _sky(light, dx, dy, slope) if share < 1.0 else (0.0, 0.0, 0.0)
        if share > 0.0:
            tone = 0.75 + 0.4 * noise2(np.arctan2(dy, dx) * 60.0, slope * 160.0, 4.0)
            green = scaled(added((0.10, 0.125, 0.09), (0.55, 0.5, 0.55), light.snow), tone)
            c = mixed(c, mixed(filtered(green, light.above), light.haze_colour, far), share)
        accumulate(image[f.row, f.column], c, f.share)


@kernel
def trace_shadows(view_record, light_record, things, models, surface, depth, blocked):
    """Mark ground that cars and other low things keep the sky and the sun from.

    ``blocked``, uint8 (columns, rows, 2): the share of the sky (contact shadow) and of the sun (cast shadow), of 255.
    """
    view, light = view_record[0], light_record[0]
    day = light.sun[0] > 0.3
    for i in range(len(things)):
        thing = things[i]
        model = models[thing.model]
        distance = np.sqrt((thing.x - view.x) ** 2 + (thing.y - view.y) ** 2)
        if thing.z > 0.01 or model.top > 3.2 or distance > 70.0:
            continue
        half_x, half_y, top = 0.95 * model.half_x, 0.95 * model.half_y, 0.85 * model.top
        cast = 0.5 * top / max(0.2, light.sun_z) if day else 0.0
        cx, cy = thing.x - cast * light.sun_x, thing.y - cast * light.sun_y
        reach = half_x + 1.2 + cast
        first, last = column_range(view, cx, cy, reach)
        away = np.sqrt((cx - view.x) ** 2 + (cy - view.y) ** 2)
        low = view.z * view.focal / (away + reach)
        high = view.z * view.focal / max(0.5, (away - reach) * 0.6)
        cos, sin = np.cos(thing.yaw), np.sin(thing.yaw)
        sx, sy = cos * light.sun_x + sin * light.sun_y, cos * light.sun_y - sin * light.sun_x
        for column in range(first, last + 1):
            horizon = horizon_at(view, column + 0.5)
            ray_x, ray_y = ray_of(view, column + 0.5)
            for row in range(np.int64(max(0.0, horizon + low)), np.int64(min(view.rows - 1.0, horizon + high)) + 1):
                if surface[column, row] != GROUND:
                    continue
                far = depth[column, row]
                dx, dy = view.x + far * ray_x - thing.x, view.y + far * ray_y - thing.y
                x, y = cos * dx + sin * dy, cos * dy - sin * dx
                out_x, out_y = max(0.0, abs(x) - half_x + 0.25), max(0.0, abs(y) - half_y + 0.2)
                near = max(0.0, 1.0 - np.sqrt(out_x * out_x + out_y * out_y) / 0.75)
                blocked[column, row, 0] = max(blocked[column, row, 0], np.uint8(225.0 * near * near))
                if day and _in_shadow(x, y, sx, sy, light.sun_z, half_x, half_y, top):
                    blocked[column, row, 1] = 255


@kernel
def _in_shadow(x, y, sx, sy, sz, half_x, half_y, top):
    """Whether the ray from a ground point to the sun meets a thing's box."""
    t0, t1 = 0.0, top / max(sz, 1e-3)
    for axis in range(2):
        p, s, h = (x, sx, half_x) if axis == 0 else (y, sy, half_y)
        s = s if abs(s) > 1e-9 else 1e-9
        a, b = (-h - p) / s, (h - p) / s
        t0, t1 = max(t0, min(a, b)), min(t1, max(a, b))
    return t0 < t1


@kernel
def lamp_light(world, lamps, table, light, x, y, z, nx, ny, nz):
    """Light of the street lamps on a surface, linear RGB."""
    i, j = np.int64((x - world.west) / LAMP_CELL), np.int64((y - world.south) / LAMP_CELL)
    if i < 0 or j < 0 or i >= table.shape[1] or j >= table.shape[0]:
        return 0.0, 0.0, 0.0
    warm, white = 0.0, 0.0
    for q in range(table.shape[2]):
        k = table[j, i, q]
        if k < 0:
            break
        lamp = lamps[k]
        dx, dy, dz = lamp.x - x, lamp.y - y, lamp.z - z
        d2 = dx * dx + dy * dy + dz * dz
        if d2 > _LAMP_REACH_2:
            continue
        d = np.sqrt(d2) + 1e-3
        facing = 0.12 + 0.88 * max(0.0, (nx * dx + ny * dy + nz * dz) / d)
        downwards = 0.06 + 0.94 * smooth(-0.15, 0.45, dz / d)
        amount = lamp.power * facing * downwards * (1.0 - d2 / _LAMP_REACH_2) / (d2 + 2.0)
        warm += amount * (1.0 - lamp.tone)
        white += amount * lamp.tone
    return scaled(added(scaled(_WARM, warm), _WHITE, white), 58.0 * light.dark)


@kernel
def beam_light(view, light, x, y, z, nx, ny, nz):
    """Light of the camera car's own headlights on a surface, linear RGB."""
    dx, dy = x - view.x, y - view.y
    ahead = dx * view.forward_x + dy * view.forward_y
    if ahead < 1.0 or light.beams <= 0.0:
        return 0.0, 0.0, 0.0
    side = (dx * view.right_x + dy * view.right_y) / ahead
    rise = (z - 0.7) / ahead
    beam = np.exp(-9.0 * (side + 0.04) ** 2) * smooth(0.05, -0.02, rise)
    d = np.sqrt(ahead * ahead + (0.7 - z) ** 2)
    facing = max(0.05, -(nx * dx + ny * dy + nz * (z - 0.7)) / d)
    return scaled(_BEAM, light.beams * 30.0 * beam * facing / (d * d * 0.25 + 30.0) * smooth(1.0, 5.0, ahead))


@kernel
def _mirrored(light, slope):
    """Look up what a window or a car mirrors: sky above, the dim other side of the street below."""
    rise = max(slope, 0.12)
    clear = mixed(light.sky_low, light.sky_top, smooth(0.0, 0.62, rise / np.sqrt(1.0 + rise * rise)))
    clouded = mixed(clear, mixed(light.cloud, light.cloud_shade, 0.5), 0.7 * light.cloudiness)
    return scaled(clouded, 0.16 + 0.84 * smooth(0.0, 0.42, slope))


@kernel
def _glossy(light, f, flat, x, y, z, nx, ny, nz, shining, c):
    """Blend the mirror image of the sky over a glossy surface, and add that of the sun if it is ``shining`` on it."""
    length = np.sqrt(flat * flat + f.slope * f.slope)
    vx, vy, vz = f.ray_x / length, f.ray_y / length, f.slope / length
    along = nx * vx + ny * vy + nz * vz
    mx, my, mz = vx - 2.0 * along * nx, vy - 2.0 * along * ny, vz - 2.0 * along * nz
    level = np.sqrt(mx * mx + my * my) + 1e-6
    wobble = 0.1 * (noise2(x * 0.8 + y * 0.8, z * 0.8, 51.0) - 0.5)
    share = min(1.0, f.gloss * (0.10 + 0.75 * (1.0 - min(1.0, abs(along))) ** 3))
    c = mixed(c, _mirrored(light, mz / level + wobble), share)
    if shining:
        c = added(c, light.sun, f.gloss * max(0.0, mx * light.sun_x + my * light.sun_y + mz * light.sun_z) ** 60)
    return c


@kernel
def light_fragments(view_record, light_record, world_record, shade, lamps, table, fragments, index, counts, image):
    """Light all fragments but the sky's and add them to ``image``, float32 (rows, columns, 3) of linear radiance.

    Walls look up shadows a little in front of themselves, so that they do not shade themselves.
    """
    view, light, world = view_record[0], light_record[0], world_record[0]
    day = light.sun[0] > 0.0
    for kind in range(len(counts)):
        if kind == K_SKY:
            continue
        for n in range(counts[kind]):
            f = fragments[index[kind, n]]
            x, y, z = np.float64(f.x), np.float64(f.y), np.float64(f.z)
            nx, ny, nz = np.float64(f.normal[0]), np.float64(f.normal[1]), np.float64(f.normal[2])
            reach = 0.8 * (1.0 - abs(nz)) if kind != K_LEAF else 0.0
            px, py = x + reach * nx, y + reach * ny
            roof, crown, seen = look_up(shade, world.west, world.south, px, py)
            seen += (1.0 - seen) * smooth(0.0, 14.0, z)
            sky_part, ground_part = (1.0, 0.0) if kind == K_LEAF else (seen * (0.64 + 0.36 * nz), 0.52 - 0.4 * nz)
            c = added(scaled(light.above, sky_part), light.below, ground_part)
            facing = nx * light.sun_x + ny * light.sun_y + nz * light.sun_z
            if day and kind == K_LEAF:
                c = added(c, light.sun, smooth(-1.0, 1.0, z - roof) * f.leaf)
            elif day and facing > 0.0:
                lift = 0.05 if abs(nz) < 0.05 or nz > 0.999 else 0.3
                lit = smooth(-0.3, 0.3, z + lift - roof) * facing * (1.0 - f.blocked)
                if lit > 0.0 and crown > z:
                    dapple = smooth(0.35, 0.75, noise2((px + z) * 2.2, (py - z) * 2.2, 31.0))
                    lit *= 1.0 - smooth(0.0, 0.8, crown - z) * (0.92 - 0.6 * dapple) * light.foliage
                c = added(c, light.sun, lit)
            if light.dark > 0.0:
                c = added(c, lamp_light(world, lamps, table, light, x, y, z, nx, ny, nz), 1.0)
                c = added(c, beam_light(view, light, x, y, z, nx, ny, nz), 1.0)
            c = added(filtered(scaled(c, f.contact * (1.0 - 0.85 * f.hidden)), f.colour), f.glow, 1.0)
            flat = np.sqrt(np.float64(f.ray_x * f.ray_x + f.ray_y * f.ray_y))
            if f.gloss > 0.0:
                c = _glossy(light, f, flat, x, y, z, nx, ny, nz, day and facing > 0.0 and roof < z, c)
            veil = 1.0 - np.exp(-light.haze * f.depth * flat)
            accumulate(image[f.row, f.column], mixed(c, light.haze_colour, veil), f.share)
