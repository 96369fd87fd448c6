"""Trunks, branches, poles and people: rods with analytic coverage, blended over the shaded image."""

import numpy as np

from artifact_city.grids import look_up
from artifact_city.kernel import kernel, layout
from artifact_city.lighting import beam_light, lamp_light
from artifact_city.noise import cover, hash3, smooth
from artifact_city.palette import added, blend, filtered, mixed, scaled
from artifact_city.solids import Surface
from artifact_city.trees import Species
from artifact_city.view import SAMPLES, column_range, project

# One rod as it is drawn: both ends and their radii, its colour, and how readily it carries snow.
PLACED_ROD = layout("x0 y0 z0 x1 y1 z1 r0 r1 colour:3 snow")

MOST_RODS = 24_000
_BARK = np.array([[0.085, 0.07, 0.052], [0.10, 0.085, 0.06], [0.06, 0.045, 0.03], [0.07, 0.055, 0.04]])
_LOOKS = np.full((len(Surface), 3), 0.03)  # reflectance of rods that have not their thing's own colour
_LOOKS[Surface.STEEL], _LOOKS[Surface.WOOD], _LOOKS[Surface.SKIN] = 0.21, (0.16, 0.10, 0.05), (0.45, 0.28, 0.2)
_THING_REACH = 70.0  # metres
_NEAR = 0.35


@kernel
def collect_tree_rods(view_record, light_record, trees, shapes, limbs, rods, count):
    """List the wood of all trees in view: under leaves only the trunk and the thick branches. Returns the new count."""
    view, light = view_record[0], light_record[0]
    for t in range(len(trees)):
        tree = trees[t]
        shape = shapes[tree.species]
        distance = np.sqrt((tree.x - view.x) ** 2 + (tree.y - view.y) ** 2)
        if distance > 240.0:
            continue
        first, last = column_range(view, tree.x, tree.y, shape.reach * tree.size)
        if last < first:
            continue
        leafy = light.foliage > 0.3 or tree.species == Species.SPRUCE
        finest = 1.5 if leafy else (5.5 if distance < 45.0 else (4.5 if distance < 90.0 else 3.5))
        thicker = tree.size * (1.0 if distance < 60.0 else 1.0 + (distance - 60.0) / 90.0)
        cos, sin = np.cos(tree.yaw) * tree.size, np.sin(tree.yaw) * tree.size
        tone = 0.8 + 0.4 * hash3(tree.seed, 2.0, 2.0)
        for q in range(shape.first_limb, shape.last_limb):
            limb = limbs[q]
            if limb.order > finest or count >= len(rods):
                continue
            rod = rods[count]
            rod.x0, rod.y0 = tree.x + cos * limb.x0 - sin * limb.y0, tree.y + sin * limb.x0 + cos * limb.y0
            rod.x1, rod.y1 = tree.x + cos * limb.x1 - sin * limb.y1, tree.y + sin * limb.x1 + cos * limb.y1
            rod.z0, rod.z1, rod.r0, rod.r1 = (
                limb.z0 * tree.size,
                limb.z1 * tree.size,
                limb.r0 * thicker,
                limb.r1 * thicker,
            )
            rod.snow = 0.0 if leafy else 1.0
            for k in range(3):
                rod.colour[k] = _BARK[tree.species, k] * tone
            count += 1
    return count


@kernel
def collect_thing_rods(view_record, things, models, model_rods, rods, count):
    """List the rods of all placed models in view. Returns the new count."""
    view = view_record[0]
    for i in range(len(things)):
        thing = things[i]
        model = models[thing.model]
        if model.last_rod == model.first_rod:
            continue
        distance = np.sqrt((thing.x - view.x) ** 2 + (thing.y - view.y) ** 2)
        reach = model.radius * max(thing.scale[0], thing.scale[1])
        first, last = column_range(view, thing.x, thing.y, reach)
        if last < first or distance > _THING_REACH + 30.0 * max(reach, 0.5 * model.top):
            continue
        cos, sin = np.cos(thing.yaw), np.sin(thing.yaw)
        for q in range(model.first_rod, min(model.last_rod, model.first_rod + len(rods) - count)):
            part, rod = model_rods[q], rods[count]
            ax, ay = part.start[0] * thing.scale[0], part.start[1] * thing.scale[1]
            bx, by = part.end[0] * thing.scale[0], part.end[1] * thing.scale[1]
            rod.x0, rod.y0 = thing.x + cos * ax - sin * ay, thing.y + sin * ax + cos * ay
            rod.x1, rod.y1 = thing.x + cos * bx - sin * by, thing.y + sin * bx + cos * by
            rod.z0, rod.z1 = thing.z + part.start[2] * thing.scale[2], thing.z + part.end[2] * thing.scale[2]
            rod.r0, rod.r1, rod.snow = part.r0, part.r1, 0.0
            for k in range(3):
                rod.colour[k] = thing.colour[k] if part.surface == Surface.PAINT else _LOOKS[part.surface, k]
            count += 1
    return count


@kernel
def sort_keys(view_record, rods, count, keys):
    """Write the negative depth of each rod's middle to ``keys``, so that sorting puts the farthest first."""
    view = view_record[0]
    for k in range(count):
        rod = rods[k]
        dx, dy = 0.5 * (rod.x0 + rod.x1) - view.x, 0.5 * (rod.y0 + rod.y1) - view.y
        keys[k] = -np.sqrt(dx * dx + dy * dy)


@kernel
def _lit(view, light, world, shade, lamps, table, x, y, z):
    """Light on an upright rod from all around, and how much of the sun reaches it."""
    roof, crown, seen = look_up(shade, world.west, world.south, x, y)
    seen += (1.0 - seen) * smooth(0.0, 14.0, z)
    c = added(scaled(light.above, 0.62 * seen), light.below, 0.35)
    sun = smooth(-0.3, 0.3, z + 0.1 - roof)
    if crown > z:
        sun *= 1.0 - 0.75 * light.foliage
    if light.dark > 0.0:
        c = added(c, lamp_light(world, lamps, table, light, x, y, z, 0.0, 0.0, 0.35), 1.0)
        c = added(c, beam_light(view, light, x, y, z, -view.forward_x, -view.forward_y, 0.0), 1.0)
    return c, sun


@kernel
def draw_rods(view_record, light_record, world_record, shade, lamps, table, rods, order, depth, image):
    """Blend rods over ``image``, float32 (rows, columns, 3) in pixels, in the given order (farthest first).

    A rod covers a pixel by the share of its width that falls in it, and shows in as many of the pixel's samples as lie
    behind it, so that hair-thin twigs and wires neither flicker nor break.
    """
    view, light, world = view_record[0], light_record[0], world_record[0]
    rows, columns = image.shape[0], image.shape[1]
    for n in range(len(order)):
        rod = rods[order[n]]
        x0, y0, z0, x1, y1, z1, r0, r1 = rod.x0, rod.y0, rod.z0, rod.x1, rod.y1, rod.z1, rod.r0, rod.r1
        d0 = (x0 - view.x) * view.forward_x + (y0 - view.y) * view.forward_y
        d1 = (x1 - view.x) * view.forward_x + (y1 - view.y) * view.forward_y
        if d0 < _NEAR and d1 < _NEAR:
            continue
        if d0 < _NEAR or d1 < _NEAR:
            s = (_NEAR - d0) / (d1 - d0)
            xc, yc, zc, rc = x0 + s * (x1 - x0), y0 + s * (y1 - y0), z0 + s * (z1 - z0), r0 + s * (r1 - r0)
            if d0 < _NEAR:
                x0, y0, z0, r0 = xc, yc, zc, rc
            else:
                x1, y1, z1, r1 = xc, yc, zc, rc
        u0, v0, d0 = project(view, x0, y0, z0)
        u1, v1, d1 = project(view, x1, y1, z1)
        if d0 <= 0.0 or d1 <= 0.0:
            continue
        u0, v0, u1, v1 = u0 / SAMPLES, v0 / SAMPLES, u1 / SAMPLES, v1 / SAMPLES
        w0, w1 = r0 * view.focal / d0 / SAMPLES, r1 * view.focal / d1 / SAMPLES
        widest = max(w0, w1) + 1.0
        if max(u0, u1) < -widest or min(u0, u1) > columns + widest:
            continue
        if max(v0, v1) < -widest or min(v0, v1) > rows + widest:
            continue
        around, sun = _lit(view, light, world, shade, lamps, table, 0.5 * (x0 + x1), 0.5 * (y0 + y1), 0.5 * (z0 + z1))
        _draw_rod(view, light, rod, u0, v0, w0, d0, u1, v1, w1, d1, around, sun, depth, image)


@kernel
def _draw_rod(view, light, rod, u0, v0, w0, d0, u1, v1, w1, d1, around, sun, depth, image):
    """Blend one projected rod: ends (column, row), half widths in pixels, depths."""
    rows, columns = image.shape[0], image.shape[1]
    upright = abs(v1 - v0) >= abs(u1 - u0)
    a0, a1, c0, c1 = (v0, v1, u0, u1) if upright else (u0, u1, v0, v1)
    if a0 > a1:
        a0, a1, c0, c1, w0, w1, d0, d1 = a1, a0, c1, c0, w1, w0, d1, d0
    length = max(a1 - a0, 1e-3)
    tilt = np.sqrt(1.0 + ((c1 - c0) / length) ** 2)
    limit, across = (rows, columns) if upright else (columns, rows)
    side_sun = light.sun_x * view.right_x + light.sun_y * view.right_y
    front_sun = -(light.sun_x * view.forward_x + light.sun_y * view.forward_y)
    veil = 1.0 - np.exp(-light.haze * 0.5 * (d0 + d1))
    snowy = rod.snow * light.snow
    for p in range(max(0, np.int64(np.floor(a0))), min(limit - 1, np.int64(np.floor(a1))) + 1):
        along = min(p + 1.0, a1) - max(float(p), a0)
        s = min(1.0, max(0.0, (p + 0.5 - a0) / length))
        centre, half = c0 + s * (c1 - c0), (w0 + s * (w1 - w0)) * tilt
        far = 1.0 / (1.0 / d0 + s * (1.0 / d1 - 1.0 / d0))
        first, last = np.int64(np.floor(centre - half)), np.int64(np.floor(centre + half))
        for q in range(max(0, first), min(across - 1, last) + 1):
            share = cover(q + 0.5 - centre, half, 1.0) * along
            if share <= 0.002:
                continue
            row, column = (p, q) if upright else (q, p)
            seen = 0
            for k in range(SAMPLES * SAMPLES):
                seen += far < depth[SAMPLES * column + k // SAMPLES, SAMPLES * row + k % SAMPLES]
            if seen == 0:
                continue
            turn = min(1.0, max(-1.0, (q + 0.5 - centre) / max(half, 0.5)))
            lean = turn * side_sun if upright else -turn * light.sun_z
            direct = max(0.0, lean + np.sqrt(1.0 - turn * turn) * front_sun) * sun
            white = snowy * (0.25 if upright else smooth(0.3, -0.6, turn))
            lights = added(scaled(around, 1.0 - 0.35 * turn * turn), light.sun, direct)
            c = filtered(mixed(rod.colour, (0.8, 0.83, 0.88), white), lights)
            blend(image[row, column], mixed(c, light.haze_colour, veil), share * seen / (SAMPLES * SAMPLES))
