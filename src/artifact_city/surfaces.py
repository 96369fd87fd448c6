"""What roofs, leaves and small things look like."""

import numpy as np

from artifact_city.fragments import K_LEAF, K_ROOF, K_THING
from artifact_city.kernel import kernel
from artifact_city.models import N_CARS
from artifact_city.noise import cloud_noise, hash3, noise2, noise3, smooth, stripes
from artifact_city.trace import BUILDING, LEAF, THING
from artifact_city.view import SAMPLES

LEAF_GREEN = np.array(
    [
        [0.075, 0.130, 0.022],
        [0.088, 0.132, 0.030],
        [0.070, 0.118, 0.024],
        [0.022, 0.055, 0.020],
        [0.105, 0.155, 0.030],
        [0.058, 0.105, 0.022],
    ]
)
HEDGE = 6


@kernel
def paint_roofs(view_record, light_record, buildings, fragments, index, counts):
    """Paint all fragments of roofs: tiles in courses, flat roofs, hedge tops, snow."""
    view, light = view_record[0], light_record[0]
    for n in range(counts[K_ROOF]):
        f = fragments[index[K_ROOF, n]]
        house, plane = buildings[(f.code - BUILDING) >> 4], ((f.code - BUILDING) & 15) - 4
        x, y, seed = np.float64(f.x), np.float64(f.y), house.seed
        f.nx, f.ny, f.nz, settle = 0.0, 0.0, 1.0, 1.0
        value = 0.8 + 0.4 * cloud_noise(x, y, seed, 2.0)
        hedge = house.material == HEDGE
        if hedge:
            value *= 0.6 + 0.8 * noise2(x * 4.0, y * 4.0, seed)
        if plane < 4:
            pitch = house.slope[plane]
            scale = 1.0 / np.sqrt(1.0 + pitch * pitch)
            ex, ey = house.normal[plane, 0], house.normal[plane, 1]
            f.nx, f.ny, f.nz = ex * pitch * scale, ey * pitch * scale, scale
            up, along = (house.offset[plane] - ex * x - ey * y) / scale, y * ex - x * ey
            stains = cloud_noise(along * 0.6, up * 0.6, seed, 3.0)
            value = 0.78 + 0.4 * stains
            fine = 1.0 - smooth(0.1, 0.35, SAMPLES * f.depth / view.focal)
            if fine > 0.0:
                course = np.floor(up / 0.33)
                tone = hash3(np.floor(along / 0.25 + 0.5 * course), course, seed)
                joint = stripes(up, 0.33, 0.06, SAMPLES * f.depth / view.focal)
                value *= 1.0 + fine * (0.3 * (tone - 0.5) - 0.3 * joint)
            settle = smooth(2.4, 0.9, pitch) * smooth(0.12, 0.3, stains)
        r, g, b = house.roof[0] * value, house.roof[1] * value, house.roof[2] * value
        if hedge:
            r, g, b = r * light.leaf[0], g * light.leaf[1], b * light.leaf[2]
        white = min(0.95, 1.55 * light.snow) * settle
        f.red, f.green, f.blue = r + white * (0.82 - r), g + white * (0.85 - g), b + white * (0.9 - b)
        shine = light.wet * 0.12 * (1.0 - white)
        f.glow_red, f.glow_green = shine * light.sky_low[0], shine * light.sky_low[1]
        f.glow_blue = shine * light.sky_low[2]


@kernel
def paint_leaves(view_record, light_record, trees, shapes, blobs, fragments, index, counts):
    """Paint all fragments of leaves: clumps, light and dark sides, light that shines through, snow on spruces."""
    view, light = view_record[0], light_record[0]
    for n in range(counts[K_LEAF]):
        f = fragments[index[K_LEAF, n]]
        tree = trees[(f.code - LEAF) >> 4]
        shape = shapes[tree.species]
        blob = blobs[shape.first_blob + ((f.code - LEAF) & 15)]
        x, y, z, seed, size = np.float64(f.x), np.float64(f.y), np.float64(f.z), tree.seed, tree.size
        cos, sin = np.cos(tree.yaw) * size, np.sin(tree.yaw) * size
        nx = (x - tree.x - cos * blob.x + sin * blob.y) / (blob.radius * size)
        ny = (y - tree.y - sin * blob.x - cos * blob.y) / (blob.radius * size)
        nz = (z - blob.z * size) / (blob.half * size)
        fine = max(0.13, 1.6 * SAMPLES * f.depth / view.focal)
        clump = noise3(x / 0.55, y / 0.55, z / 0.55, seed)
        leaf = noise3(x / fine, y / fine, z / fine, seed + 1)
        top = min(1.0, max(0.0, (z / (shape.top * size) - 0.25) / 0.75))
        vary = hash3(seed, 1.0, 1.0)
        detail = (0.6 + 0.8 * leaf) * (0.75 + 0.5 * clump)
        r = LEAF_GREEN[tree.species, 0] * (0.85 + 0.5 * vary) * light.leaf[0] * detail
        g = LEAF_GREEN[tree.species, 1] * (0.92 + 0.2 * vary) * light.leaf[1] * detail
        b = LEAF_GREEN[tree.species, 2] * light.leaf[2] * detail
        white = min(1.0, 1.3 * light.snow) * smooth(0.25, 0.8, 0.55 * nz + 0.8 * leaf)
        open_air = (0.36 + 0.64 * smooth(-0.9, 0.8, nz)) * (0.6 + 0.4 * top)
        f.red, f.green, f.blue = r + white * (0.75 - r), g + white * (0.79 - g), b + white * (0.85 - b)
        facing = nx * light.sun_x + ny * light.sun_y + nz * light.sun_z
        direct = smooth(-0.4, 0.95, facing) * (0.45 + 0.55 * smooth(0.15, 0.75, leaf * 0.6 + clump * 0.4))
        # The light of the sky fades into the crown, that of the sun does not: hence the division.
        f.contact = open_air
        f.leaf = (direct + 0.22 * smooth(0.2, -0.8, facing)) / open_air
        f.nx, f.ny, f.nz = 0.5 * nx, 0.5 * ny, 0.5 * nz


@kernel
def paint_things(light_record, things, models, faces, fragments, index, counts):
    """Paint all fragments of placed models, by the surface of the polygon they belong to."""
    light = light_record[0]
    for n in range(counts[K_THING]):
        f = fragments[index[K_THING, n]]
        thing = things[(f.code - THING) >> 7]
        face = faces[models[thing.model].first_face + ((f.code - THING) & 127)]
        cos, sin = np.cos(thing.yaw), np.sin(thing.yaw)
        ax, ay, nz = face.normal[0] / thing.scale[0], face.normal[1] / thing.scale[1], face.normal[2] / thing.scale[2]
        norm = 1.0 / np.sqrt(ax * ax + ay * ay + nz * nz)
        f.nx, f.ny, f.nz = (cos * ax - sin * ay) * norm, (sin * ax + cos * ay) * norm, nz * norm
        dx, dy, z = f.x - thing.x, f.y - thing.y, np.float64(f.z)
        r, g, b, glow_r, glow_g, glow_b, gloss, snowy = _thing_look(
            thing, face.surface, light, cos * dx + sin * dy, cos * dy - sin * dx, z - thing.z, np.float64(f.nz)
        )
        grain = noise2(dx * 5.0 + dy * 3.0, z * 5.0, 7.0)
        white = min(1.0, 1.55 * light.snow) * snowy * smooth(0.55, 0.85, np.float64(f.nz) + 0.25 * (grain - 0.5))
        f.red, f.green, f.blue = r + white * (0.8 - r), g + white * (0.83 - g), b + white * (0.88 - b)
        f.glow_red, f.glow_green, f.glow_blue = glow_r, glow_g, glow_b
        f.gloss = gloss * (1.0 - white)
        if thing.model < N_CARS:
            f.contact = 0.35 + 0.65 * smooth(0.1, 0.75, z)


@kernel
def _thing_look(thing, surface, light, x, y, z, nz):
    """Reflectance, emission, gloss and readiness to carry snow at a point in a thing's own frame."""
    grain = noise2(3.0 * x + 2.0 * y + thing.x, 3.0 * z + thing.y, 5.0)
    r, g, b = thing.colour[0], thing.colour[1], thing.colour[2]
    if surface == 0:  # paint
        if thing.model < N_CARS:
            return r, g, b, 0.0, 0.0, 0.0, 0.6, 1.0
        value = 0.88 + 0.2 * grain
        return r * value, g * value, b * value, 0.0, 0.0, 0.0, 0.0, 1.0
    if surface == 1:  # glass
        return 0.02, 0.022, 0.025, 0.0, 0.0, 0.0, 1.2, 0.3
    if surface == 2:  # rubber
        return 0.016, 0.016, 0.017, 0.0, 0.0, 0.0, 0.0, 0.0
    if surface == 3:  # steel
        return 0.27, 0.28, 0.29, 0.0, 0.0, 0.0, 0.25, 1.0
    if surface == 4:  # headlight
        return 0.75, 0.75, 0.72, 3.5 * thing.lit, 3.2 * thing.lit, 2.7 * thing.lit, 0.4, 0.0
    if surface == 5:  # tail light
        return 0.30, 0.015, 0.012, 0.9 * thing.lit, 0.045 * thing.lit, 0.03 * thing.lit, 0.2, 0.0
    if surface == 6:  # lantern
        return 0.75, 0.72, 0.62, 5.0 * light.dark, 4.0 * light.dark, 2.5 * light.dark, 0.0, 0.0
    if surface == 7:  # wood
        value = 0.7 + 0.5 * noise2(9.0 * x, 9.0 * (y + z), 6.0)
        return 0.17 * value, 0.105 * value, 0.055 * value, 0.0, 0.0, 0.0, 0.0, 1.0
    if surface == 8:  # stone
        value = 0.8 + 0.35 * grain
        return 0.36 * value, 0.34 * value, 0.29 * value, 0.0, 0.0, 0.0, 0.0, 1.0
    if surface == 9:  # canvas
        stripe = stripes(y, 0.62, 0.31, 0.05) if thing.scale[1] > 1.01 else stripes(x, 0.62, 0.31, 0.05)
        r += stripe * (thing.second[0] - r)
        g += stripe * (thing.second[1] - g)
        b += stripe * (thing.second[2] - b)
        return r, g, b, 0.0, 0.0, 0.0, 0.0, 1.0
    if surface == 10:  # railing
        return 0.03, 0.03, 0.032, 0.0, 0.0, 0.0, 0.0, 0.0
    if surface == 11:  # trim
        return 0.6, 0.58, 0.52, 0.0, 0.0, 0.0, 0.0, 1.0
    if surface == 13:  # posters
        key = 7.0 * np.floor(1.6 * np.arctan2(y, x + 0.7)) + np.floor(z / 1.2)
        hue = hash3(key, thing.seed, 3.0)
        mark = 0.35 + 0.65 * hash3(np.floor(z / 0.3) + 17.0 * np.floor(y / 0.4), key, thing.seed)
        r, g, b = (0.2 + 0.6 * hue) * mark, (0.2 + 0.5 * abs(hue - 0.5)) * mark, (0.75 - 0.55 * hue) * mark
        return r, g, b, 0.5 * light.dark * r, 0.5 * light.dark * g, 0.5 * light.dark * b, 0.0, 0.0
    if surface == 14:  # window of an oriel or a dormer
        bars = 0.6 * min(1.0, stripes(y + 0.02, 0.48, 0.05, 0.02) + stripes(z - 1.6, 0.6, 0.05, 0.02))
        key = np.floor(10.0 * (thing.x + thing.y + thing.z))
        glow = (1.0 - bars) * (0.35 + 0.45 * light.dark) if hash3(key, 3.0, light.lit_seed) < light.lit else 0.0
        return 0.05 + bars, 0.05 + bars, 0.055 + bars, glow, 0.7 * glow, 0.36 * glow, 0.9, 0.0
    if surface == 15:  # sign, or the roof of a dormer
        r, g, b = thing.second[0], thing.second[1], thing.second[2]
        glow = 0.5 * light.dark if abs(nz) < 0.3 else 0.0
        return r, g, b, glow * (r + 0.08), glow * (g + 0.08), glow * (b + 0.08), 0.0, 1.0
    if surface == 17:  # plants
        value = 0.5 + 1.0 * noise2(14.0 * x, 14.0 * (y + z), 8.0)
        bloom = 1.0 if noise2(9.0 * x + thing.x, 9.0 * (y + 0.7 * z), 9.0) > 0.66 else 0.0
        bloom *= light.foliage
        r, g, b = 0.06 * value * light.leaf[0], 0.11 * value * light.leaf[1], 0.025 * value * light.leaf[2]
        r, g, b = (
            r + bloom * (thing.second[0] - r),
            g + bloom * (thing.second[1] - g),
            b + bloom * (thing.second[2] - b),
        )
        return r, g, b, 0.0, 0.0, 0.0, 0.0, 1.0
    return 0.028, 0.028, 0.03, 0.0, 0.0, 0.0, 0.0, 0.6
