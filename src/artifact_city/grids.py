"""Grids over the town: which streets, buildings and lamps are near, how high things are, how much sky is seen."""

from typing import NamedTuple

import numpy as np

from artifact_city.buildings import roof_at
from artifact_city.kernel import kernel
from artifact_city.streets import sides

HEIGHT_CELL = 0.5  # metres; heights and shadows
OPEN_CELL = 2.0  # metres; share of the sky seen
STREET_CELL = 4.0
BUILDING_CELL = 8.0
LAMP_CELL = 8.0


class Extent(NamedTuple):
    """The rectangle of land that a town covers, in metres."""

    west: float
    south: float
    width: float
    depth: float

    def shape(self, cell: float) -> tuple[int, int]:
        """Rows and columns of a grid with square cells of this size."""
        return int(np.ceil(self.depth / cell)), int(np.ceil(self.width / cell))


def _box_cells(low: np.ndarray, high: np.ndarray, extent: Extent, cell: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the numbers (row by row) and the centres of the cells that a box touches."""
    rows, columns = extent.shape(cell)
    origin = np.array([extent.west, extent.south])
    i0, j0 = np.clip(np.floor((low - origin) / cell).astype(int), 0, [columns - 1, rows - 1])
    i1, j1 = np.clip(np.floor((high - origin) / cell).astype(int), 0, [columns - 1, rows - 1])
    i, j = np.meshgrid(np.arange(i0, i1 + 1), np.arange(j0, j1 + 1))
    centres = origin + (np.stack([i.ravel(), j.ravel()], axis=1) + 0.5) * cell
    return (j * columns + i).ravel(), centres


def _table(cells: list[np.ndarray], extent: Extent, cell: float) -> np.ndarray:
    """Turn a list of cells per item into a table of items per cell, int32 (rows, columns, most), padded with -1."""
    rows, columns = extent.shape(cell)
    number = np.concatenate([*cells, np.zeros(0, np.int64)])
    item = np.concatenate([np.full(len(c), k, np.int32) for k, c in enumerate(cells)] + [np.zeros(0, np.int32)])
    order = np.argsort(number, kind="stable")
    number, item = number[order], item[order]
    place = np.arange(len(number)) - np.searchsorted(number, number)
    table = np.full((rows * columns, int(place.max(initial=0)) + 1), -1, dtype=np.int32)
    table[number, place] = item
    return table.reshape(rows, columns, -1)


def polygon_table(corners: np.ndarray, extent: Extent, cell: float) -> np.ndarray:
    """Table of the polygons whose bounding box touches each cell; see :func:`_table` for its form."""
    cells = [_box_cells(c.min(axis=0), c.max(axis=0), extent, cell)[0] for c in corners]
    return _table(cells, extent, cell)


def lamp_table(points: np.ndarray, reach: float, extent: Extent, cell: float) -> np.ndarray:
    """Table of the points within ``reach`` metres of each cell."""
    cells = []
    for p in points:
        number, centres = _box_cells(p - reach - cell, p + reach + cell, extent, cell)
        cells.append(number[np.hypot(*(centres - p).T) < reach + 0.71 * cell])
    return _table(cells, extent, cell)


def street_table(streets: np.ndarray, reach: float, extent: Extent, cell: float) -> np.ndarray:
    """Table of the street pieces whose surface comes within ``reach`` metres of each cell."""
    found = []
    for piece in streets:
        start = np.array([piece["x"], piece["y"]])
        along = np.array([piece["ux"], piece["uy"]])
        end = start + along * piece["length"]
        margin = piece["total"] + piece["cap"] + reach + cell
        cells, centres = _box_cells(np.minimum(start, end) - margin, np.maximum(start, end) + margin, extent, cell)
        offset = centres - start
        s, d = offset @ along, np.abs(offset @ np.array([-along[1], along[0]]))
        beyond = np.maximum(np.abs(s - piece["length"] / 2) - piece["length"] / 2 - piece["cap"], 0)
        found.append(cells[np.hypot(np.maximum(d - piece["total"], 0), beyond) < reach + 0.71 * cell])
    return _table(found, extent, cell)


def zone_map(polygons: list[tuple[np.ndarray, int]], extent: Extent) -> np.ndarray:
    """Paint convex polygons, each with its zone, on a map with one cell per metre; the rest is 0."""
    zones = np.zeros(extent.shape(1.0), dtype=np.uint8)
    for corners, zone in polygons:
        cells, centres = _box_cells(corners.min(axis=0), corners.max(axis=0), extent, 1.0)
        inside = ((centres[:, None] - corners) * sides(corners)[2]).sum(axis=2).max(axis=1) < 1e-9
        zones.reshape(-1)[cells[inside]] = zone
    return zones


@kernel
def raise_buildings(buildings, west, south, rows, columns):
    """Heights of all buildings on the fine grid, float32 (rows, columns)."""
    heights = np.zeros((rows, columns), dtype=np.float32)
    for b in range(len(buildings)):
        house = buildings[b]
        x0, x1, y0, y1 = 1e30, -1e30, 1e30, -1e30
        for k in range(4):
            x0, x1 = min(x0, house.corners[k, 0]), max(x1, house.corners[k, 0])
            y0, y1 = min(y0, house.corners[k, 1]), max(y1, house.corners[k, 1])
        for j in range(max(0, int((y0 - south) / HEIGHT_CELL)), min(rows - 1, int((y1 - south) / HEIGHT_CELL)) + 1):
            for i in range(
                max(0, int((x0 - west) / HEIGHT_CELL)), min(columns - 1, int((x1 - west) / HEIGHT_CELL)) + 1
            ):
                z = roof_at(house, west + (i + 0.5) * HEIGHT_CELL, south + (j + 0.5) * HEIGHT_CELL)
                heights[j, i] = max(heights[j, i], z)
    return heights


@kernel
def raise_trees(trees, shapes, blobs, west, south, rows, columns):
    """Heights of all crowns on the fine grid, float32 (rows, columns)."""
    heights = np.zeros((rows, columns), dtype=np.float32)
    for t in range(len(trees)):
        tree = trees[t]
        shape = shapes[tree.species]
        cos, sin = np.cos(tree.yaw) * tree.size, np.sin(tree.yaw) * tree.size
        for q in range(shape.first_blob, shape.last_blob):
            blob = blobs[q]
            x, y = tree.x + cos * blob.x - sin * blob.y, tree.y + sin * blob.x + cos * blob.y
            z, r, v = blob.z * tree.size, blob.radius * tree.size, blob.half * tree.size
            i0, i1 = int((x - r - west) / HEIGHT_CELL), int((x + r - west) / HEIGHT_CELL)
            j0, j1 = int((y - r - south) / HEIGHT_CELL), int((y + r - south) / HEIGHT_CELL)
            for j in range(max(0, j0), min(rows - 1, j1) + 1):
                for i in range(max(0, i0), min(columns - 1, i1) + 1):
                    dx = west + (i + 0.5) * HEIGHT_CELL - x
                    dy = south + (j + 0.5) * HEIGHT_CELL - y
                    inside = 1.0 - (dx * dx + dy * dy) / (r * r)
                    if inside > 0.0 and z + v * np.sqrt(inside) > heights[j, i]:
                        heights[j, i] = z + v * np.sqrt(inside)
    return heights


@kernel
def sky_seen(heights):
    """Share of the sky seen from the ground, on a grid of two metres, from eight horizon lines per point."""
    rows, columns = heights.shape
    step = np.int64(OPEN_CELL / HEIGHT_CELL)
    seen = np.zeros((rows // step + 1, columns // step + 1), dtype=np.float32)
    for j in range(seen.shape[0]):
        for i in range(seen.shape[1]):
            ci, cj = min(columns - 1, i * step + step // 2), min(rows - 1, j * step + step // 2)
            total = 0.0
            for k in range(8):
                dx, dy = np.cos(k * np.pi / 4 + 0.2), np.sin(k * np.pi / 4 + 0.2)
                tangent, reach = 0.0, 2.0
                while reach < 60.0:
                    a, b = ci + np.int64(reach * dx), cj + np.int64(reach * dy)
                    if a < 0 or b < 0 or a >= columns or b >= rows:
                        break
                    tangent = max(tangent, heights[b, a] / (reach * HEIGHT_CELL))
                    reach *= 1.35
                total += 1.0 / (1.0 + tangent * tangent)
            seen[j, i] = total / 8.0
    return seen


@kernel
def cast_shadows(heights, azimuth, elevation, shadow):
    """Fill ``shadow``, float32 like ``heights``, with the height below which a point lies in the sun's shadow.

    One sweep away from the sun: the shadow over a cell is the higher of its neighbour's roof and its neighbour's
    shadow, lowered by the sun's slope. The cell's own roof does not count.
    """
    rows, columns = heights.shape
    sx, sy = np.cos(azimuth), np.sin(azimuth)
    steep = abs(sy) > abs(sx)
    major, minor = (sy, sx) if steep else (sx, sy)
    drop = HEIGHT_CELL / abs(major) * np.tan(elevation)
    shift = minor / abs(major)
    n, m = (rows, columns) if steep else (columns, rows)
    sign = 1 if major > 0 else -1
    for step in range(n):
        line = n - 1 - step if sign > 0 else step
        behind = line + sign
        for q in range(m):
            best = 0.0
            base = np.int64(np.floor(q + shift))
            part = q + shift - base
            for side in range(2):
                p = base + side
                if step == 0 or p < 0 or p >= m:
                    continue
                z = max(heights[behind, p], shadow[behind, p]) if steep else max(heights[p, behind], shadow[p, behind])
                best += (part if side == 1 else 1.0 - part) * z
            if steep:
                shadow[line, q] = max(0.0, best - drop)
            else:
                shadow[q, line] = max(0.0, best - drop)


@kernel
def look_up(shade, west, south, x, y):
    """Interpolate the shade map at a point: shadow height of roofs, of crowns, and share of the sky seen."""
    rows, columns = shade.shape[0], shade.shape[1]
    u = min(columns - 1.001, max(0.0, (x - west) / HEIGHT_CELL - 0.5))
    v = min(rows - 1.001, max(0.0, (y - south) / HEIGHT_CELL - 0.5))
    i, j = np.int64(u), np.int64(v)
    a, b = u - i, v - j
    p, q, r, s = (1.0 - a) * (1.0 - b), a * (1.0 - b), (1.0 - a) * b, a * b
    return (
        p * shade[j, i, 0] + q * shade[j, i + 1, 0] + r * shade[j + 1, i, 0] + s * shade[j + 1, i + 1, 0],
        p * shade[j, i, 1] + q * shade[j, i + 1, 1] + r * shade[j + 1, i, 1] + s * shade[j + 1, i + 1, 1],
        p * shade[j, i, 2] + q * shade[j, i + 1, 2] + r * shade[j + 1, i, 2] + s * shade[j + 1, i + 1, 2],
    )
