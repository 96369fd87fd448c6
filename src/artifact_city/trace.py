"""Which surface each sample of an image sees, and how far away: ground, walls, roofs; then leaves and things."""

import numpy as np

from artifact_city.grids import BUILDING_CELL
from artifact_city.kernel import kernel
from artifact_city.noise import hash3, noise3
from artifact_city.solids import Surface
from artifact_city.trees import Species
from artifact_city.view import column_range, horizon_at, project, ray_of

# Codes of surfaces. Building b: BUILDING + 16 b + side (0-3), or + 4 + side for a roof plane, or + 8 for a flat roof.
SKY = -1
GROUND = 0
BUILDING = 1
LEAF = 1 << 20  # + 16 tree + blob
THING = 1 << 26  # + 128 thing + face

FAR, _LEAF_REACH, _NEAR = 420.0, 330.0, 0.12  # metres
_MAX_HITS = 48


@kernel
def _enter(house, x, y, dx, dy):
    """Depths at which a ray enters and leaves a prism, and the side it enters through (-1: it misses)."""
    t0, t1, side = -1e30, 1e30, -1
    for k in range(4):
        speed = house.normal[k, 0] * dx + house.normal[k, 1] * dy
        gap = house.offset[k] - house.normal[k, 0] * x - house.normal[k, 1] * y
        if abs(speed) < 1e-12:
            if gap < 0.0:
                return 0.0, 0.0, -1
        elif speed < 0.0:
            if gap / speed > t0:
                t0, side = gap / speed, k
        else:
            t1 = min(t1, gap / speed)
    if t0 >= t1 or t0 <= 1e-3:
        return 0.0, 0.0, -1
    return t0, t1, side


@kernel
def _gather(view, world, buildings, table, column, stamp, order, depth0, depth1, sides):
    """Collect the prisms that a column's ray enters, nearest first; returns how many."""
    dx, dy = ray_of(view, column + 0.5)
    gx, gy = (view.x - world.west) / BUILDING_CELL, (view.y - world.south) / BUILDING_CELL
    i, j = np.int64(np.floor(gx)), np.int64(np.floor(gy))
    vx, vy = dx / BUILDING_CELL, dy / BUILDING_CELL
    step_i, step_j = (1 if vx > 0 else -1), (1 if vy > 0 else -1)
    wait_x, wait_y = 1.0 / max(abs(vx), 1e-12), 1.0 / max(abs(vy), 1e-12)
    next_x = ((i + 1 - gx) if vx > 0 else (gx - i)) * wait_x
    next_y = ((j + 1 - gy) if vy > 0 else (gy - j)) * wait_y
    top_slope = horizon_at(view, column + 0.5) / view.focal
    count, enough, t = 0, 1e30, 0.0
    while t < FAR and t < enough:
        if i < 0 or j < 0 or i >= table.shape[1] or j >= table.shape[0]:
            break
        for q in range(table.shape[2]):
            b = table[j, i, q]
            if b < 0:
                break
            if stamp[b] == column:
                continue
            stamp[b] = column
            house = buildings[b]
            t0, t1, side = _enter(house, view.x, view.y, dx, dy)
            if side < 0 or count == _MAX_HITS:
                continue
            place = count
            while place > 0 and depth0[place - 1] > t0:
                depth0[place], depth1[place] = depth0[place - 1], depth1[place - 1]
                order[place], sides[place] = order[place - 1], sides[place - 1]
                place -= 1
            depth0[place], depth1[place], order[place], sides[place] = t0, t1, b, side
            count += 1
            if (house.height - view.z) > top_slope * t0:
                enough = min(enough, t0)
        if next_x < next_y:
            t, next_x, i = next_x, next_x + wait_x, i + step_i
        else:
            t, next_y, j = next_y, next_y + wait_y, j + step_j
    return count


@kernel
def _first_row(horizon, focal, slope, limit):
    """First row (from the top) whose centre lies below a slope, between 0 and ``limit``."""
    return np.int64(min(max(np.ceil(horizon - focal * slope - 0.5), 0.0), float(limit)))


@kernel
def _wall_rise(view, house, t0, dx, dy):
    """Height of the top of a wall above the eaves where a ray meets it."""
    x, y = view.x + t0 * dx, view.y + t0 * dy
    rise = house.cap
    for k in range(4):
        if house.slope[k] > 0.0:
            inside = house.offset[k] - house.normal[k, 0] * x - house.normal[k, 1] * y
            rise = min(rise, house.slope[k] * max(0.0, inside))
    return rise


@kernel
def _roof_piece(view, house, t, t1, dx, dy):
    """Find the plane that is the roof just beyond depth ``t`` along a ray.

    Returns the plane (4: the flat cap), its height at depth 0, its rise per depth, and the depth where it ends.
    """
    best, rate, active = house.cap, 0.0, 4
    for k in range(4):
        slope = house.slope[k]
        if slope > 0.0:
            speed = -slope * (house.normal[k, 0] * dx + house.normal[k, 1] * dy)
            gap = house.offset[k] - house.normal[k, 0] * view.x - house.normal[k, 1] * view.y
            value = slope * gap + speed * t
            # Among equals the one that falls fastest is the lowest just beyond.
            if value < best - 1e-9 or (value < best + 1e-9 and speed < rate):
                best, rate, active = value, speed, k
    end = t1
    if rate > 1e-12:
        end = min(end, t + max(1e-6, (house.cap - best) / rate))
    for k in range(4):
        slope = house.slope[k]
        if slope > 0.0:
            speed = -slope * (house.normal[k, 0] * dx + house.normal[k, 1] * dy)
            if speed < rate - 1e-12:
                gap = house.offset[k] - house.normal[k, 0] * view.x - house.normal[k, 1] * view.y
                end = min(end, t + max(1e-6, (slope * gap + speed * t - best) / (rate - speed)))
    return active, house.height + best - rate * t, rate, end


@kernel
def _roof(view, house, t0, t1, dx, dy, horizon, filled, surface, depth, code):
    """Draw the part of a roof that rises above what is already drawn; returns the new first drawn row."""
    t = t0
    for _ in range(6):
        if t >= t1 - 1e-9 or filled == 0:
            break
        active, z0, rate, end = _roof_piece(view, house, t, t1, dx, dy)
        top = _first_row(horizon, view.focal, (z0 + rate * end - view.z) / end, filled)
        for row in range(top, filled):
            bend = (horizon - row - 0.5) / view.focal - rate
            surface[row] = code + 4 + active
            depth[row] = min(end, max(t, (z0 - view.z) / bend)) if abs(bend) > 1e-9 else end
        filled, t = min(filled, top), end
    return filled


@kernel
def trace_columns(view_record, world_record, buildings, table, surface, depth):
    """Fill ``surface`` (int32) and ``depth`` (float32), both (columns, rows), with ground, buildings and sky.

    In a column all rays lie in one vertical plane, so the prisms are met in the plane, nearest first, and each one
    covers the rows above what nearer ones have covered.
    """
    view, world = view_record[0], world_record[0]
    stamp = np.full(len(buildings), -1, dtype=np.int32)
    order, sides = np.empty(_MAX_HITS, dtype=np.int64), np.empty(_MAX_HITS, dtype=np.int64)
    depth0, depth1 = np.empty(_MAX_HITS), np.empty(_MAX_HITS)
    for column in range(view.columns):
        seen, distance = surface[column], depth[column]
        horizon = horizon_at(view, column + 0.5)
        for row in range(view.rows):
            below = row + 0.5 - horizon
            near = below * FAR > view.z * view.focal
            seen[row] = GROUND if near else SKY
            distance[row] = view.z * view.focal / below if near else 1e9
        count = _gather(view, world, buildings, table, column, stamp, order, depth0, depth1, sides)
        dx, dy = ray_of(view, column + 0.5)
        filled = view.rows
        for h in range(count):
            t0, side = depth0[h], sides[h]
            house = buildings[order[h]]
            filled = min(filled, _first_row(horizon, view.focal, -view.z / t0, view.rows))
            if filled == 0:
                break
            code = BUILDING + 16 * order[h]
            rise = _wall_rise(view, house, t0, dx, dy)
            top = _first_row(horizon, view.focal, (house.height + rise - view.z) / t0, filled)
            for row in range(top, filled):
                seen[row] = code + side
                distance[row] = t0
            filled = _roof(view, house, t0, depth1[h], dx, dy, horizon, min(filled, top), seen, distance, code)


@kernel
def trace_crowns(view_record, trees, shapes, blobs, foliage, surface, depth):
    """Draw the leaves of all trees into ``surface`` and ``depth``.

    Each crown is a cluster of ellipsoids; where a ray only grazes one, noise fixed to the tree decides whether there is
    a leaf, which makes the outline ragged. ``foliage`` below one thins the leaves of all trees but spruces.
    """
    view = view_record[0]
    for t in range(len(trees)):
        tree = trees[t]
        shape = shapes[tree.species]
        evergreen = tree.species == Species.SPRUCE
        density = 1.0 if evergreen else foliage
        if density <= 0.0 or (tree.x - view.x) ** 2 + (tree.y - view.y) ** 2 > _LEAF_REACH**2:
            continue
        first, last = column_range(view, tree.x, tree.y, shape.reach * tree.size)
        if last < first:
            continue
        cos, sin = np.cos(tree.yaw) * tree.size, np.sin(tree.yaw) * tree.size
        for q in range(shape.first_blob, shape.last_blob):
            blob = blobs[q]
            x, y = tree.x + cos * blob.x - sin * blob.y, tree.y + sin * blob.x + cos * blob.y
            z, radius, half = blob.z * tree.size, blob.radius * tree.size, blob.half * tree.size
            code = LEAF + 16 * t + q - shape.first_blob
            _trace_blob(view, x, y, z, radius, half, density, evergreen, tree.seed, code, surface, depth)


@kernel
def _trace_blob(view, x, y, z, radius, half, density, evergreen, seed, code, surface, depth):
    first, last = column_range(view, x, y, radius)
    ox, oy, oz = (view.x - x) / radius, (view.y - y) / radius, (view.z - z) / half
    outside = ox * ox + oy * oy + oz * oz - 1.0
    for column in range(first, last + 1):
        ray_x, ray_y = ray_of(view, column + 0.5)
        dx, dy = ray_x / radius, ray_y / radius
        flat, cross = dx * dx + dy * dy, ox * dx + oy * dy
        # Depths at which the vertical plane of this column meets the widest circle.
        spread = cross * cross - flat * (ox * ox + oy * oy - 1.0)
        if spread <= 0.0:
            continue
        spread = np.sqrt(spread)
        near, far = max(0.2, (-cross - spread) / flat), (-cross + spread) / flat
        if far <= 0.25:
            continue
        high, low = z + half - view.z, z - half - view.z
        horizon = horizon_at(view, column + 0.5)
        top = np.int64(max(0.0, horizon - view.focal * (high / near if high > 0 else high / far)))
        bottom = np.int64(min(view.rows - 1.0, horizon - view.focal * (low / far if low > 0 else low / near)))
        scale = 1.0 / max(0.2, 3.0 * near / view.focal)
        for row in range(top, bottom + 1):
            slope = (horizon - row - 0.5) / view.focal
            a, b = flat + (slope / half) ** 2, cross + oz * slope / half
            inside = b * b - a * outside
            if inside <= 0.0:
                continue
            root = np.sqrt(inside)
            t = (-b - root) / a
            if t < 0.25 or t >= depth[column, row]:
                continue
            chord = root / np.sqrt(a)
            if chord < 0.85:
                px, py, pz = (view.x + t * ray_x) * scale, (view.y + t * ray_y) * scale, (view.z + t * slope) * scale
                grain = noise3(0.7 * px, 0.7 * py, 0.7 * pz, seed)
                if chord < (0.1 + 0.8 * grain if evergreen else 0.05 + 1.0 * (grain - 0.08)):
                    continue
            if density < 1.0 and hash3(float(column), float(row), float(code)) > density:
                continue
            surface[column, row] = code
            depth[column, row] = t


@kernel
def trace_things(view_record, things, models, faces, surface, depth):
    """Draw the polygons of all placed models into ``surface`` and ``depth``."""
    view = view_record[0]
    corner, clipped = np.empty((4, 3)), np.empty((8, 3))
    for i in range(len(things)):
        thing = things[i]
        model = models[thing.model]
        sx, sy, sz = thing.scale[0], thing.scale[1], thing.scale[2]
        reach = model.radius * max(sx, sy)
        distance = np.sqrt((thing.x - view.x) ** 2 + (thing.y - view.y) ** 2)
        first, last = column_range(view, thing.x, thing.y, reach)
        if last < first or distance > 45.0 + 70.0 * max(model.radius, 0.5 * model.top):
            continue
        cos, sin = np.cos(thing.yaw), np.sin(thing.yaw)
        for f in range(model.first_face, model.last_face):
            face = faces[f]
            nx, ny, nz = face.normal[0] / sx, face.normal[1] / sy, face.normal[2] / sz
            nx, ny = cos * nx - sin * ny, sin * nx + cos * ny
            for k in range(4):
                lx, ly = face.corners[k, 0] * sx, face.corners[k, 1] * sy
                corner[k, 0], corner[k, 1] = thing.x + cos * lx - sin * ly, thing.y + sin * lx + cos * ly
                corner[k, 2] = thing.z + face.corners[k, 2] * sz
            facing = nx * (view.x - corner[0, 0]) + ny * (view.y - corner[0, 1]) + nz * (view.z - corner[0, 2])
            if facing <= 0.0:
                continue
            code = THING + 128 * i + f - model.first_face
            count = _project_polygon(view, corner, clipped)
            if count >= 3:
                _fill(view, clipped, count, nx, ny, nz, facing, face.surface == Surface.RAILING, code, surface, depth)


@kernel
def _project_polygon(view, corner, clipped):
    """Clip a quadrilateral at the near plane and project it to columns and rows; returns its number of corners."""
    n = 0
    for k in range(4):
        p, q = k, (k + 1) % 4
        da = (corner[p, 0] - view.x) * view.forward_x + (corner[p, 1] - view.y) * view.forward_y - _NEAR
        db = (corner[q, 0] - view.x) * view.forward_x + (corner[q, 1] - view.y) * view.forward_y - _NEAR
        if da >= 0.0:
            for c in range(3):
                clipped[n, c] = corner[p, c]
            n += 1
        if (da >= 0.0) != (db >= 0.0):
            s = da / (da - db)
            for c in range(3):
                clipped[n, c] = corner[p, c] + s * (corner[q, c] - corner[p, c])
            n += 1
    for k in range(n):
        clipped[k, 0], clipped[k, 1], _ = project(view, clipped[k, 0], clipped[k, 1], clipped[k, 2])
    return n


@kernel
def _fill(view, outline, count, nx, ny, nz, facing, railing, code, surface, depth):
    """Fill a convex outline column by column with the plane that has this normal, where nothing is nearer."""
    left, right = 1e30, -1e30
    for k in range(count):
        left, right = min(left, outline[k, 0]), max(right, outline[k, 0])
    first, last = np.int64(max(0.0, np.ceil(left - 0.5))), np.int64(min(view.columns - 1.0, np.floor(right - 0.5)))
    for column in range(first, last + 1):
        at, top, bottom = column + 0.5, 1e30, -1e30
        for k in range(count):
            m = (k + 1) % count
            if (outline[k, 0] <= at) != (outline[m, 0] <= at):
                share = (at - outline[k, 0]) / (outline[m, 0] - outline[k, 0])
                row = outline[k, 1] + share * (outline[m, 1] - outline[k, 1])
                top, bottom = min(top, row), max(bottom, row)
        if bottom < top:
            continue
        horizon = horizon_at(view, at)
        ray_x, ray_y = ray_of(view, at)
        speed = nx * ray_x + ny * ray_y
        start, stop = np.int64(max(0.0, np.ceil(top - 0.5))), np.int64(min(view.rows - 1.0, np.floor(bottom - 0.5)))
        for row in range(start, stop + 1):
            toward = -(speed + nz * (horizon - row - 0.5) / view.focal)
            if toward <= 1e-9 or facing >= depth[column, row] * toward:
                continue
            if railing and (column ^ row) & 1 and row - top > 0.12 * (bottom - top):
                continue
            surface[column, row] = code
            depth[column, row] = facing / toward
