"""The sky: gradient, sun glow, clouds, and the hills on the horizon."""

import numpy as np

from artifact_city.fragments import K_SKY
from artifact_city.kernel import kernel
from artifact_city.noise import cloud_noise, noise2, smooth


@kernel
def sky_gradient(light, slope):
    """Mean radiance of the sky at a rise per horizontal distance, clouds included."""
    up = slope / np.sqrt(1.0 + slope * slope)
    blend, share = smooth(0.0, 0.62, up), 0.7 * light.cloudiness
    r = light.sky_low[0] + (light.sky_top[0] - light.sky_low[0]) * blend
    g = light.sky_low[1] + (light.sky_top[1] - light.sky_low[1]) * blend
    b = light.sky_low[2] + (light.sky_top[2] - light.sky_low[2]) * blend
    r += share * (0.5 * (light.cloud[0] + light.cloud_shade[0]) - r)
    g += share * (0.5 * (light.cloud[1] + light.cloud_shade[1]) - g)
    b += share * (0.5 * (light.cloud[2] + light.cloud_shade[2]) - b)
    return r, g, b


@kernel
def sky(light, dx, dy, slope):
    """Radiance of the sky in the direction with this horizontal unit vector and rise per horizontal distance."""
    up = slope / np.sqrt(1.0 + slope * slope)
    blend = smooth(0.0, 0.62, up) ** 0.75 if up > 0 else 0.0
    r = light.sky_low[0] + (light.sky_top[0] - light.sky_low[0]) * blend
    g = light.sky_low[1] + (light.sky_top[1] - light.sky_low[1]) * blend
    b = light.sky_low[2] + (light.sky_top[2] - light.sky_low[2]) * blend
    level = 1.0 / np.sqrt(1.0 + slope * slope)
    near_sun = max(0.0, level * (dx * light.sun_x + dy * light.sun_y) + up * light.sun_z)
    glow = 0.10 * near_sun**6 + 0.30 * near_sun**40
    r, g, b = r + glow * light.sun[0], g + glow * light.sun[1], b + glow * light.sun[2]
    stretch = 1.0 / (max(0.0, up) + 0.09)
    px, py = dx * stretch * 1.1, dy * stretch * 1.1
    puffs = cloud_noise(px, py, light.cloud_seed, 5.0)
    edge = 0.74 - 0.44 * light.cloudiness
    share = smooth(edge, edge + 0.16 + 0.1 * light.cloudiness, puffs) * smooth(-0.01, 0.10, up) * 0.92
    bright = 1.0 - smooth(edge + 0.05, edge + 0.42, puffs + 0.25 * (noise2(px * 2.1, py * 2.1, 77.0) - 0.5))
    r += share * (light.cloud_shade[0] + bright * (light.cloud[0] - light.cloud_shade[0]) - r)
    g += share * (light.cloud_shade[1] + bright * (light.cloud[1] - light.cloud_shade[1]) - g)
    b += share * (light.cloud_shade[2] + bright * (light.cloud[2] - light.cloud_shade[2]) - b)
    return r, g, b


@kernel
def _hill(seed, dx, dy):
    """Slope up to which distant hills hide the sky in a horizontal direction."""
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
        r, g, b = sky(light, dx, dy, slope)
        share = smooth(0.004, -0.004, slope - _hill(world.seed, dx, dy))
        if share > 0.0:
            tone = 0.75 + 0.4 * noise2(np.arctan2(dy, dx) * 60.0, slope * 160.0, 4.0)
            hr = (0.10 + 0.55 * light.snow) * light.above[0] * tone
            hg = (0.125 + 0.5 * light.snow) * light.above[1] * tone
            hb = (0.09 + 0.55 * light.snow) * light.above[2] * tone
            r += share * (hr + far * (light.haze_colour[0] - hr) - r)
            g += share * (hg + far * (light.haze_colour[1] - hg) - g)
            b += share * (hb + far * (light.haze_colour[2] - hb) - b)
        pixel = image[f.row, f.column]
        pixel[0] += f.share * r
        pixel[1] += f.share * g
        pixel[2] += f.share * b
