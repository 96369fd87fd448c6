"""Which surface each sample of an image sees, and how far away: ground, walls, roofs."""

import numpy as np

from artifact_city.grids import BUILDING_CELL
from artifact_city.kernel import kernel
from artifact_city.view import horizon_at, ray_of

# Codes of surfaces. Building b: BUILDING + 16 b + side (0-3), or + 4 + side for a roof plane, or + 8 for a flat roof.
SKY = -1
GROUND = 0
BUILDING = 1
LEAF = 1 << 20  # + 16 tree + blob
THING = 1 << 26  # + 128 thing + face

FAR = 420.0  # metres
_MAX_HITS = 48


@kernel
def gable_rise(kind, rise, u, length):
    """Height of an ornamental gable above the eaves at ``u`` metres along a front of ``length`` metres."""
    t = abs(2.0 * u / length - 1.0)
    if kind == 1:  # stepped
        steps = 5.0
        return rise * (1.0 - np.floor(t * steps) / steps) if t < 0.98 else 0.0
    if kind == 2:  # bell
        if t < 0.22:
            return rise * (0.86 + 0.14 * np.sqrt(1.0 - (t / 0.22) ** 2))
        s = (t - 0.22) / 0.78
        return rise * 0.83 * (1.0 - s) ** 1.7 + 0.03 * rise
    return rise * (1.0 - t)


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
def _wall_rise(view, house, side, t0, dx, dy):
    """Height of the top of a wall above the eaves where a ray meets it."""
    x, y = view.x + t0 * dx, view.y + t0 * dy
    rise = house.cap
    for k in range(4):
        if house.slope[k] > 0.0:
            inside = house.offset[k] - house.normal[k, 0] * x - house.normal[k, 1] * y
            rise = min(rise, house.slope[k] * max(0.0, inside))
    if side == 0 and house.gable > 0:
        u = (y - house.corners[0, 1]) * house.normal[0, 0] - (x - house.corners[0, 0]) * house.normal[0, 1]
        rise = max(rise, gable_rise(house.gable, house.gable_height, u, house.length[0]))
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
            rise = _wall_rise(view, house, side, t0, dx, dy)
            top = _first_row(horizon, view.focal, (house.height + rise - view.z) / t0, filled)
            for row in range(top, filled):
                seen[row] = code + side
                distance[row] = t0
            filled = _roof(view, house, t0, depth1[h], dx, dy, horizon, min(filled, top), seen, distance, code)
