"""Light on surfaces: sun and shadow, sky, lamps, headlights; then mirror images and haze."""

import numpy as np

from artifact_city.fragments import K_LEAF, K_SKY
from artifact_city.grids import LAMP_CELL, look_up
from artifact_city.kernel import kernel
from artifact_city.noise import noise2, smooth
from artifact_city.sky import sky_gradient

WARM = (1.0, 0.60, 0.26)
WHITE = (1.0, 0.88, 0.68)


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
        if d2 > 576.0:
            continue
        d = np.sqrt(d2) + 1e-3
        facing = 0.12 + 0.88 * max(0.0, (nx * dx + ny * dy + nz * dz) / d)
        downwards = 0.06 + 0.94 * smooth(-0.15, 0.45, dz / d)
        amount = lamp.power * facing * downwards * (1.0 - d2 / 576.0) / (d2 + 2.0)
        warm += amount * (1.0 - lamp.tone)
        white += amount * lamp.tone
    gain = 58.0 * light.dark
    return (
        gain * (WARM[0] * warm + WHITE[0] * white),
        gain * (WARM[1] * warm + WHITE[1] * white),
        gain * (WARM[2] * warm + WHITE[2] * white),
    )


@kernel
def beam_light(view, light, x, y, z, nx, ny, nz):
    """Light of the camera car's own headlights on a surface (one value; they are white)."""
    dx, dy = x - view.x, y - view.y
    ahead = dx * view.forward_x + dy * view.forward_y
    if ahead < 1.0:
        return 0.0
    side = (dx * view.right_x + dy * view.right_y) / ahead
    rise = (z - 0.7) / ahead
    beam = np.exp(-9.0 * (side + 0.04) ** 2) * smooth(0.05, -0.02, rise)
    d = np.sqrt(ahead * ahead + (0.7 - z) ** 2)
    facing = max(0.05, -(nx * dx + ny * dy + nz * (z - 0.7)) / d)
    return light.beams * 30.0 * beam * facing / (d * d * 0.25 + 30.0) * smooth(1.0, 5.0, ahead)


@kernel
def _mirrored(light, slope):
    """Look up what a window or a car mirrors: sky above, the dim other side of the street below."""
    r, g, b = sky_gradient(light, max(slope, 0.12))
    share = 0.16 + 0.84 * smooth(0.0, 0.42, slope)
    return r * share, g * share, b * share


@kernel
def _glossy(light, f, flat, x, y, z, nx, ny, nz, shining, r, g, b):
    """Blend the mirror image of the sky over a glossy surface, and add that of the sun if it is ``shining`` on it."""
    length = np.sqrt(flat * flat + f.slope * f.slope)
    vx, vy, vz = f.ray_x / length, f.ray_y / length, f.slope / length
    along = nx * vx + ny * vy + nz * vz
    mx, my, mz = vx - 2.0 * along * nx, vy - 2.0 * along * ny, vz - 2.0 * along * nz
    level = np.sqrt(mx * mx + my * my) + 1e-6
    wobble = 0.1 * (noise2(x * 0.8 + y * 0.8, z * 0.8, 51.0) - 0.5)
    mr, mg, mb = _mirrored(light, mz / level + wobble)
    share = min(1.0, f.gloss * (0.10 + 0.75 * (1.0 - min(1.0, abs(along))) ** 3))
    r, g, b = r + share * (mr - r), g + share * (mg - g), b + share * (mb - b)
    if shining:
        shine = f.gloss * max(0.0, mx * light.sun_x + my * light.sun_y + mz * light.sun_z) ** 60
        r, g, b = r + shine * light.sun[0], g + shine * light.sun[1], b + shine * light.sun[2]
    return r, g, b


@kernel
def light_fragments(view_record, light_record, world_record, shade, lamps, table, fragments, index, counts, image):
    """Light all fragments but the sky's and add them to ``image``, float32 (rows, columns, 3) of linear radiance.

    Walls look up shadows a little in front of themselves, so that they do not shade themselves.
    """
    view, light, world = view_record[0], light_record[0], world_record[0]
    sun_x, sun_y, sun_z, day = light.sun_x, light.sun_y, light.sun_z, light.sun[0] > 0.0
    for kind in range(len(counts)):
        if kind == K_SKY:
            continue
        for n in range(counts[kind]):
            f = fragments[index[kind, n]]
            x, y, z = np.float64(f.x), np.float64(f.y), np.float64(f.z)
            nx, ny, nz = np.float64(f.nx), np.float64(f.ny), np.float64(f.nz)
            reach = 0.8 * (1.0 - abs(nz)) if kind != K_LEAF else 0.0
            px, py = x + reach * nx, y + reach * ny
            roof, crown, seen = look_up(shade, world.west, world.south, px, py)
            seen += (1.0 - seen) * smooth(0.0, 14.0, z)
            contact = f.contact * (1.0 - 0.85 * f.hidden)
            if kind == K_LEAF:
                sky_part, ground_part = 1.0, 0.0
            else:
                sky_part, ground_part = seen * (0.64 + 0.36 * nz), 0.52 - 0.4 * nz
            r = light.above[0] * sky_part + light.below[0] * ground_part
            g = light.above[1] * sky_part + light.below[1] * ground_part
            b = light.above[2] * sky_part + light.below[2] * ground_part
            facing = nx * sun_x + ny * sun_y + nz * sun_z
            if day and (facing > 0.0 or kind == K_LEAF):
                lift = 0.05 if abs(nz) < 0.05 or nz > 0.999 else 0.3
                lit = smooth(-0.3, 0.3, z + lift - roof)
                if kind == K_LEAF:
                    lit = smooth(-1.0, 1.0, z - roof) * f.leaf
                else:
                    lit *= facing * (1.0 - f.blocked)
                    if lit > 0.0 and crown > z:
                        dapple = smooth(0.35, 0.75, noise2((px + z) * 2.2, (py - z) * 2.2, 31.0))
                        lit *= 1.0 - smooth(0.0, 0.8, crown - z) * (0.92 - 0.6 * dapple) * light.foliage
                r, g, b = r + lit * light.sun[0], g + lit * light.sun[1], b + lit * light.sun[2]
            if light.dark > 0.0:
                lr, lg, lb = lamp_light(world, lamps, table, light, x, y, z, nx, ny, nz)
                own = beam_light(view, light, x, y, z, nx, ny, nz) if light.beams > 0.0 else 0.0
                r, g, b = r + lr + own, g + lg + 0.95 * own, b + lb + 0.85 * own
            r = r * contact * f.red + f.glow_red
            g = g * contact * f.green + f.glow_green
            b = b * contact * f.blue + f.glow_blue
            flat = np.sqrt(np.float64(f.ray_x * f.ray_x + f.ray_y * f.ray_y))
            if f.gloss > 0.0:
                shining = day and facing > 0.0 and roof < z
                r, g, b = _glossy(light, f, flat, x, y, z, nx, ny, nz, shining, r, g, b)
            veil = 1.0 - np.exp(-light.haze * f.depth * flat)
            pixel = image[f.row, f.column]
            pixel[0] += f.share * (r + veil * (light.haze_colour[0] - r))
            pixel[1] += f.share * (g + veil * (light.haze_colour[1] - g))
            pixel[2] += f.share * (b + veil * (light.haze_colour[2] - b))
