"""What roofs, leaves and small things look like."""

import numpy as np

from artifact_city.buildings import Material
from artifact_city.fragments import K_LEAF, K_ROOF, K_THING
from artifact_city.kernel import kernel
from artifact_city.models import N_CARS
from artifact_city.noise import cloud_noise, hash3, noise2, noise3, smooth, stripes
from artifact_city.palette import filtered, mixed, put, scaled
from artifact_city.solids import Surface
from artifact_city.trace import BUILDING, LEAF, THING
from artifact_city.view import SAMPLES

_LEAF_GREEN = np.array([[0.075, 0.130, 0.022], [0.070, 0.118, 0.024], [0.022, 0.055, 0.020], [0.058, 0.105, 0.022]])
_NO_LIGHT = (0.0, 0.0, 0.0)


@kernel
def paint_roofs(view_record, light_record, buildings, fragments, index, counts):
    """Paint all fragments of roofs: tiles in courses, flat roofs, hedge tops, snow."""
    view, light = view_record[0], light_record[0]
    for n in range(counts[K_ROOF]):
        f = fragments[index[K_ROOF, n]]
        house, plane = buildings[(f.code - BUILDING) >> 4], ((f.code - BUILDING) & 15) - 4
        x, y, seed = np.float64(f.x), np.float64(f.y), house.seed
        nx, ny, nz, settle = 0.0, 0.0, 1.0, 1.0
        value = 0.8 + 0.4 * cloud_noise(x, y, seed, 2.0)
        if plane < 4:
            pitch = house.slope[plane]
            nz = 1.0 / np.sqrt(1.0 + pitch * pitch)
            ex, ey = house.normal[plane, 0], house.normal[plane, 1]
            nx, ny = ex * pitch * nz, ey * pitch * nz
            up, along = (house.offset[plane] - ex * x - ey * y) / nz, y * ex - x * ey
            stains = cloud_noise(along * 0.6, up * 0.6, seed, 3.0)
            value = 0.78 + 0.4 * stains
            foot = SAMPLES * f.depth / view.focal
            fine = 1.0 - smooth(0.1, 0.35, foot)
            if fine > 0.0:
                course = np.floor(up / 0.33)
                tone = hash3(np.floor(along / 0.25 + 0.5 * course), course, seed)
                value *= 1.0 + fine * 0.3 * (tone - 0.5 - stripes(up, 0.33, 0.06, foot))
            settle = smooth(2.4, 0.9, pitch) * smooth(0.12, 0.3, stains)
        c = scaled(house.roof, value)
        if house.material == Material.HEDGE:
            c = filtered(scaled(c, 0.6 + 0.8 * noise2(x * 4.0, y * 4.0, seed)), light.leaf)
        white = min(0.95, 1.55 * light.snow) * settle
        put(f.normal, (nx, ny, nz))
        put(f.colour, mixed(c, (0.82, 0.85, 0.9), white))
        put(f.glow, scaled(light.sky_low, light.wet * 0.12 * (1.0 - white)))


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
        vary = hash3(seed, 1.0, 1.0)
        tint = scaled((0.85 + 0.5 * vary, 0.92 + 0.2 * vary, 1.0), (0.6 + 0.8 * leaf) * (0.75 + 0.5 * clump))
        white = min(1.0, 1.3 * light.snow) * smooth(0.25, 0.8, 0.55 * nz + 0.8 * leaf)
        top = min(1.0, max(0.0, (z / (shape.top * size) - 0.25) / 0.75))
        facing = nx * light.sun_x + ny * light.sun_y + nz * light.sun_z
        direct = smooth(-0.4, 0.95, facing) * (0.45 + 0.55 * smooth(0.15, 0.75, leaf * 0.6 + clump * 0.4))
        # The light of the sky fades into the crown, that of the sun does not: hence the division.
        f.contact = (0.36 + 0.64 * smooth(-0.9, 0.8, nz)) * (0.6 + 0.4 * top)
        f.leaf = (direct + 0.22 * smooth(0.2, -0.8, facing)) / f.contact
        put(f.colour, mixed(filtered(filtered(tint, _LEAF_GREEN[tree.species]), light.leaf), (0.75, 0.79, 0.85), white))
        put(f.normal, scaled((nx, ny, nz), 0.5))


@kernel
def paint_things(light_record, things, models, faces, fragments, index, counts):
    """Paint all fragments of placed models, by the surface of the polygon they belong to."""
    light = light_record[0]
    for n in range(counts[K_THING]):
        f = fragments[index[K_THING, n]]
        thing = things[(f.code - THING) >> 7]
        face = faces[models[thing.model].first_face + ((f.code - THING) & 127)]
        cos, sin = np.cos(thing.yaw), np.sin(thing.yaw)
        ax, ay, az = face.normal[0] / thing.scale[0], face.normal[1] / thing.scale[1], face.normal[2] / thing.scale[2]
        normal = scaled((cos * ax - sin * ay, sin * ax + cos * ay, az), 1.0 / np.sqrt(ax * ax + ay * ay + az * az))
        dx, dy, z = f.x - thing.x, f.y - thing.y, np.float64(f.z)
        x, y = cos * dx + sin * dy, cos * dy - sin * dx
        colour, glow, gloss, snowy = _thing_look(thing, face.surface, light, x, y, z - thing.z, normal[2])
        grain = noise2(dx * 5.0 + dy * 3.0, z * 5.0, 7.0)
        white = min(1.0, 1.55 * light.snow) * snowy * smooth(0.55, 0.85, normal[2] + 0.25 * (grain - 0.5))
        put(f.normal, normal)
        put(f.colour, mixed(colour, (0.8, 0.83, 0.88), white))
        put(f.glow, glow)
        f.gloss = gloss * (1.0 - white)
        if thing.model < N_CARS:
            f.contact = 0.35 + 0.65 * smooth(0.1, 0.75, z)


@kernel
def _thing_look(thing, surface, light, x, y, z, nz):
    """Reflectance, emission, gloss and readiness to carry snow at a point in a thing's own frame."""
    grain = 0.85 + 0.25 * noise2(3.0 * x + 2.0 * y + thing.x, 3.0 * z + thing.y, 5.0)
    if surface == Surface.PAINT:
        car = thing.model < N_CARS
        return scaled(thing.colour, 1.0 if car else grain), _NO_LIGHT, 0.6 if car else 0.0, 1.0
    if surface == Surface.GLASS:
        return (0.02, 0.022, 0.025), _NO_LIGHT, 1.2, 0.3
    if surface == Surface.RUBBER:
        return (0.016, 0.016, 0.017), _NO_LIGHT, 0.0, 0.0
    if surface == Surface.STEEL:
        return (0.27, 0.28, 0.29), _NO_LIGHT, 0.25, 1.0
    if surface == Surface.HEADLIGHT:
        return (0.75, 0.75, 0.72), scaled((3.5, 3.2, 2.7), thing.lit), 0.4, 0.0
    if surface == Surface.TAILLIGHT:
        return (0.30, 0.015, 0.012), scaled((0.9, 0.045, 0.03), thing.lit), 0.2, 0.0
    if surface == Surface.LANTERN:
        return (0.75, 0.72, 0.62), scaled((5.0, 4.0, 2.5), light.dark), 0.0, 0.0
    if surface == Surface.WOOD:
        return scaled((0.17, 0.105, 0.055), grain), _NO_LIGHT, 0.0, 1.0
    if surface == Surface.STONE:
        return scaled((0.36, 0.34, 0.29), grain), _NO_LIGHT, 0.0, 1.0
    if surface == Surface.CANVAS:
        return mixed(thing.colour, thing.second, stripes(y, 0.62, 0.31, 0.05)), _NO_LIGHT, 0.0, 1.0
    if surface == Surface.TRIM:
        return (0.6, 0.58, 0.52), _NO_LIGHT, 0.0, 1.0
    if surface == Surface.WINDOW:  # window of an oriel or a dormer
        bars = 0.6 * min(1.0, stripes(y + 0.02, 0.48, 0.05, 0.02) + stripes(z - 1.6, 0.6, 0.05, 0.02))
        lit = hash3(np.floor(10.0 * (thing.x + thing.y + thing.z)), 3.0, light.lit_seed) < light.lit
        glow = (1.0 - bars) * (0.35 + 0.45 * light.dark) if lit else 0.0
        return (0.05 + bars, 0.05 + bars, 0.055 + bars), scaled((1.0, 0.7, 0.36), glow), 0.9, 0.0
    if surface == Surface.SIGN:  # sign, or the roof of a dormer
        glow = 0.5 * light.dark if abs(nz) < 0.3 else 0.0
        return scaled(thing.second, 1.0), scaled(thing.second, glow), 0.0, 1.0
    return (0.028, 0.028, 0.03), _NO_LIGHT, 0.0, 0.6
