"""Leaves and small things, drawn into the traced samples where they are nearest."""

import numpy as np

from artifact_city.kernel import kernel
from artifact_city.noise import hash3, noise3
from artifact_city.trace import LEAF, THING
from artifact_city.view import column_range, horizon_at, ray_of

LEAF_REACH = 330.0  # metres
NEAR = 0.12
_EVERGREEN = 3
_RAILING = 10


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
        evergreen = tree.species == _EVERGREEN
        density = 1.0 if evergreen else foliage
        if density <= 0.0 or (tree.x - view.x) ** 2 + (tree.y - view.y) ** 2 > LEAF_REACH**2:
            continue
        first, last = column_range(view, tree.x, tree.y, shape.reach * tree.size)
        if last < first:
            continue
        cos, sin = np.cos(tree.yaw) * tree.size, np.sin(tree.yaw) * tree.size
        for q in range(shape.first_blob, shape.last_blob):
            blob = blobs[q]
            x, y = tree.x + cos * blob.x - sin * blob.y, tree.y + sin * blob.x + cos * blob.y
            code = LEAF + 16 * t + q - shape.first_blob
            _trace_blob(
                view, x, y, blob.z * tree.size, blob.radius * tree.size, blob.half * tree.size, density, evergreen,
                tree.seed, code, surface, depth,
            )  # fmt: skip


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
                grain = 0.6 * noise3(px, py, pz, seed) + 0.4 * noise3(0.35 * px, 0.35 * py, 0.35 * pz, seed + 9.0)
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
                _fill(view, clipped, count, nx, ny, nz, facing, face.surface == _RAILING, code, surface, depth)


@kernel
def _project_polygon(view, corner, clipped):
    """Clip a quadrilateral at the near plane and project it to columns and rows; returns its number of corners."""
    n = 0
    for k in range(4):
        p, q = k, (k + 1) % 4
        da = (corner[p, 0] - view.x) * view.forward_x + (corner[p, 1] - view.y) * view.forward_y - NEAR
        db = (corner[q, 0] - view.x) * view.forward_x + (corner[q, 1] - view.y) * view.forward_y - NEAR
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
        dx, dy = clipped[k, 0] - view.x, clipped[k, 1] - view.y
        ahead = dx * view.forward_x + dy * view.forward_y
        side = dx * view.right_x + dy * view.right_y
        reach = np.sqrt(dx * dx + dy * dy) if view.panorama else ahead
        column = view.centre + view.focal * (np.arctan2(side, ahead) if view.panorama else side / ahead)
        clipped[k, 1] = horizon_at(view, column) - view.focal * (clipped[k, 2] - view.z) / reach
        clipped[k, 0] = column
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
