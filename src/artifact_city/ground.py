"""The ground: roads, markings, pavements, water, tracks, yards, grass, and snow and rain on them."""

import numpy as np

from artifact_city.fragments import K_GROUND
from artifact_city.grids import STREET_CELL
from artifact_city.kernel import kernel
from artifact_city.noise import cloud_noise, cover, hash3, noise2, smooth, stripes
from artifact_city.view import SAMPLES


@kernel
def _stones(x, y, size, foot, seed):
    """Brightness of small paving stones in broken courses, about 1."""
    visible = 1.0 - smooth(0.35 * size, 1.2 * size, foot)
    if visible <= 0.0:
        return 1.0
    row = np.floor(y / size)
    shift = hash3(row, seed, 1.0)
    tone = hash3(np.floor(x / size * 0.8 + shift), row, seed)
    joint = max(stripes(y, size, 0.12 * size, foot), stripes(x * 0.8 + shift * size, size, 0.12 * size, foot))
    return 1.0 + visible * (0.35 * (tone - 0.5) - 0.4 * joint)


@kernel
def _slabs(s, d, size, fs, fd, seed):
    """Brightness of pavement slabs, about 1."""
    visible = 1.0 - smooth(0.5 * size, 1.6 * size, max(fs, fd))
    if visible <= 0.0:
        return 0.97
    row = np.floor(d / size)
    tone = hash3(np.floor(s / size + 0.5 * row), row, seed)
    joint = max(stripes(d, size, 0.05, fd), stripes(s + 0.5 * row * size, size, 0.05, fs))
    return 1.0 + visible * (0.16 * (tone - 0.5) - 0.3 * joint)


@kernel
def _asphalt(x, y, s, d, half, foot, seed):
    """Brightness of asphalt: wheel tracks, patches, cracks, about 1."""
    value = 0.91 + 0.18 * cloud_noise(x * 0.11, y * 0.11, 5.0 + seed, 2.0)
    value *= 1.0 + 0.07 * np.cos(d * 3.6) * smooth(half, half - 1.0, abs(d))
    if foot < 0.3:
        value *= 1.0 + (0.45 - 1.5 * foot) * (noise2(x * 14.0, y * 14.0, 8.0) - 0.5)
    patch = np.floor(s / 7.0)
    draw = hash3(patch, seed, 21.0)
    if draw < 0.35:
        along, across = s - patch * 7.0, d - (draw * 12.0 - 2.1)
        value *= 1.0 - 0.2 * cover(along - 2.5, 1.0 + 3.0 * draw, 0.3) * cover(across, 0.7, 0.2)
    seam = abs(d - 1.2 * (noise2(s * 0.15, seed, 3.0) - 0.5))
    return value * (1.0 - 0.3 * cover(seam, 0.04, foot) * smooth(0.6, 0.2, foot))


@kernel
def _markings(piece, s, d, half, foot_s, foot_d, light):
    """Share of white paint at a point of the road of street piece ``piece``."""
    kind = piece.kind
    if light.past or kind not in (1, 2):
        return 0.0
    worn = 0.75 + 0.25 * noise2(s * 1.3, d * 1.3, 9.0)
    paint = 0.0
    from_start, from_end = s - piece.mouth_start, piece.length - s - piece.mouth_end
    gap = min(from_start, from_end)
    if 0.9 < gap < 4.1 and hash3(piece.seed, 1.0 if s > 0.5 * piece.length else 0.0, 7.0) < 0.7:
        zebra = stripes(d + 0.25, 1.0, 0.5, foot_d) * cover(gap - 2.5, 1.5, foot_s)
        paint = max(paint, zebra * smooth(half, half - 0.3, abs(d)))
    if gap > 5.2:
        if kind == 1:
            paint = max(paint, cover(d, 0.07, foot_d) * stripes(s, 6.0, 3.0, foot_s))
        else:
            paint = max(paint, cover(abs(d) - 0.12, 0.06, foot_d))
            paint = max(paint, cover(abs(d) - 2.9, 0.07, foot_d) * stripes(s, 6.0, 3.0, foot_s))
        bay = half - 2.05
        paint = max(paint, 0.8 * cover(abs(d) - bay, 0.05, foot_d) * stripes(s, 1.2, 0.7, foot_s))
    elif gap > 4.6:
        right = d < 0.0 if from_end < from_start else d > 0.0
        if right and abs(d) < half - 2.0:
            paint = max(paint, cover(gap - 4.9, 0.22, foot_s))
    return paint * worn


@kernel
def _track(s, d, foot_s, foot_d, x, y, light):
    """Colour of ballast, sleepers and rails, and the share of bare rail."""
    grain = 0.75 + 0.5 * noise2(x * 9.0, y * 9.0, 3.0) if foot_s < 0.4 else 1.0
    r, g, b = 0.18 * grain, 0.165 * grain, 0.15 * grain
    worn = 0.3 * smooth(0.9, 0.2, abs(d)) * noise2(x * 0.5, y * 0.5, 13.0)
    r, g, b = r * (1.0 - worn), g * (1.0 - 1.1 * worn), b * (1.0 - 1.2 * worn)
    sleeper = stripes(s, 0.65, 0.25, foot_s) * cover(d, 1.3, foot_d)
    r, g, b = r + sleeper * (0.075 - r), g + sleeper * (0.062 - g), b + sleeper * (0.05 - b)
    cleared = 0.45 * smooth(1.3, 0.5, abs(d)) + 0.25 * sleeper + 0.5 * (1.0 - light.snow)
    white = (
        0.93 * smooth(0.25, 0.5, cloud_noise(x * 1.3, y * 1.3, 14.0, 2.0) + 0.3 - cleared) if light.snow > 0.0 else 0.0
    )
    r, g, b = r + white * (0.72 - r), g + white * (0.75 - g), b + white * (0.8 - b)
    shade = cover(abs(d) - 0.75, 0.1, foot_d)
    r, g, b = r * (1 - 0.5 * shade), g * (1 - 0.5 * shade), b * (1 - 0.5 * shade)
    rail = cover(abs(d) - 0.75, 0.045, foot_d)
    return r + rail * (0.42 - r), g + rail * (0.40 - g), b + rail * (0.38 - b)


@kernel
def _yard(zone, x, y, foot, light, seed):
    """Colour of the ground between the streets."""
    coarse = cloud_noise(x * 0.06, y * 0.06, seed + 2, 3.0)
    if zone in (2, 3):
        value = (_slabs(x, y, 0.8, foot, foot, seed) if zone == 3 else 1.0) * (0.8 + 0.4 * coarse)
        border = stripes(x, 8.0, 0.35, foot) + stripes(y, 8.0, 0.35, foot) if zone == 3 else 0.0
        value *= 1.0 - 0.25 * min(1.0, border)
        return 0.30 * value, 0.275 * value, 0.235 * value
    tufts = cloud_noise(x * 1.7, y * 1.7, seed, 3.0) if foot < 1.2 else 0.5
    value = (0.55 + 0.5 * tufts + 0.4 * coarse) * 1.05
    r, g, b = 0.072 * value * light.grass[0], 0.118 * value * light.grass[1], 0.028 * value * light.grass[2]
    if zone == 0:  # fields: strips of different crops and meadows
        angle = 0.35 + 0.1 * np.sin(seed)
        p, q = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
        crop = hash3(np.floor(p / 58.0), np.floor(q / 43.0), seed)
        if crop < 0.28:
            stubble = 1.0 - 0.45 * light.snow
            r, g, b = 0.26 * value * stubble, 0.2 * value * stubble, 0.07 * value
        elif crop < 0.42:
            rows = 0.75 + 0.5 * stripes(q, 0.9, 0.45, foot)
            r, g, b = 0.12 * value * rows, 0.085 * value * rows, 0.05 * value * rows
        elif crop < 0.55:
            flowers = smooth(0.62, 0.75, noise2(x * 2.3, y * 2.3, seed)) * (1 - smooth(0.4, 1.5, foot)) * light.foliage
            r, g, b = r + flowers * (0.5 - r), g + flowers * (0.42 - g), b + flowers * (0.12 - b)
    return r, g, b


@kernel
def _yard_snow(zone, brightness, x, y, light):
    """Share of the ground between the streets that snow covers; furrows and tufts show where it has drifted away."""
    drift = 0.75 * cloud_noise(x * 0.28, y * 0.28, 12.0, 3.0) + 0.25 * noise2(x * 2.6, y * 2.6, 18.0)
    bare = 1.0 - light.snow
    return smooth(bare, bare + 0.14, drift + 0.6 * brightness - 0.12) * (0.75 if zone in (2, 3) else 1.0)


@kernel
def _pavement(piece, s, d, fs, fd, x, y):
    """Colour of a pavement of slabs or clinker, or of the gravel of a park's path."""
    seed = piece.seed
    tone = 0.85 + 0.3 * hash3(seed, 1.0, 2.0)
    value = tone * (0.84 + 0.32 * cloud_noise(x * 0.35, y * 0.35, 3.0, 3.0))
    if piece.kind == 5:
        return 0.34 * value, 0.29 * value, 0.21 * value
    paved = _slabs(s, d, 0.6 if hash3(seed, 4.0, 4.0) < 0.6 else 0.4, fs, fd, seed)
    if hash3(seed, 6.0, 6.0) < 0.3:  # clinker
        return 0.26 * value * paved, 0.17 * value * paved, 0.13 * value * paved
    return 0.27 * value * paved, 0.255 * value * paved, 0.23 * value * paved


@kernel
def _road(piece, s, d, fs, fd, x, y, crossing, light):
    """Colour of a road with its markings, and the brightness that its kerbs share."""
    if piece.kind in (0, 3) or (light.past and piece.kind != 5):  # cobbles
        tone = _stones(s, d, 0.16, max(fs, fd), piece.seed) * (0.8 + 0.4 * cloud_noise(x * 0.3, y * 0.3, 5.0, 3.0))
        return 0.175 * tone, 0.16 * tone, 0.145 * tone, tone
    tone = _asphalt(x, y, s, d, piece.road, max(fs, fd), piece.seed)
    r, g, b = 0.105 * tone, 0.105 * tone, 0.108 * tone
    if crossing > 1.2:
        paint = _markings(piece, s, d, piece.road, fs, fd, light)
        r, g, b = r + paint * (0.62 - r), g + paint * (0.61 - g), b + paint * (0.57 - b)
    return r, g, b, tone


@kernel
def _road_snow(piece, s, d, x, y, crossing):
    """Share of a road that snow covers: wheels clear two tracks in each lane, slush lies between and beside them."""
    lane = abs(d) - 1.65
    track = smooth(0.55, 0.2, abs(abs(lane) - 0.75)) if crossing > 0.5 else 0.75
    drift = 0.6 * cloud_noise(s * 0.22, d * 1.1, 16.0 + piece.seed, 3.0) + 0.4 * noise2(x * 1.9, y * 1.9, 17.0)
    kerbside = smooth(2.6, 1.2, piece.road - abs(d)) * (1.0 if crossing > 1.0 else 0.3)
    return smooth(0.42, 0.62, drift + 0.10 - 0.34 * track + 0.25 * kerbside)


@kernel
def _locate(world, streets, table, x, y):
    """Find where a point lies in the streets.

    Returns the street piece whose road is nearest (-1: none), the position along and across it, the signed distances
    (negative inside) to road, to street and to water, and the distance to the nearest other road.
    """
    i = np.int64(np.floor((x - world.west) / STREET_CELL))
    j = np.int64(np.floor((y - world.south) / STREET_CELL))
    best, along, across, road, total, water, crossing, deck = -1, 0.0, 0.0, 1e9, 1e9, 1e9, 1e9, 1e9
    if i < 0 or j < 0 or i >= table.shape[1] or j >= table.shape[0]:
        return best, along, across, road, total, water, crossing
    for q in range(table.shape[2]):
        k = table[j, i, q]
        if k < 0:
            break
        piece = streets[k]
        dx, dy = x - piece.x, y - piece.y
        s = dx * piece.ux + dy * piece.uy
        d = piece.ux * dy - piece.uy * dx
        beyond = abs(s - 0.5 * piece.length) - 0.5 * piece.length - piece.cap
        to_road, to_edge = max(abs(d) - piece.road, beyond), max(abs(d) - piece.total, beyond)
        total = min(total, to_edge)
        if piece.kind == 3:
            water = min(water, max(abs(d) - piece.water, beyond + piece.cap))
        elif piece.kind < 3:
            deck = min(deck, to_edge)
        if to_road < road:
            crossing, road = road, to_road
            best, along, across = k, s, d
        else:
            crossing = min(crossing, to_road)
    if road > 0.0 and crossing < 6.0 and streets[best].kind < 4:
        # Kerbs are rounded where two roads meet.
        h = max(0.0, 1.0 - abs(road - crossing) / 5.0)
        road -= 1.25 * h * h
    return best, along, across, road, total, (1e9 if deck < 0.4 else water), crossing


@kernel
def _ground(world, streets, table, zones, light, x, y, toward_x, toward_y, long, wide):
    """Look of a point of the ground.

    Parameters
    ----------
    toward_x, toward_y : float
        Horizontal unit direction in which the camera looks at it.
    long, wide : float
        Size of the image sample on the ground along and across that direction, metres.

    Returns
    -------
    tuple of 4 floats
        Reflectance (r, g, b), and the share of light that is mirrored (water and wet ground).
    """
    best, s, d, road, total, water, crossing = _locate(world, streets, table, x, y)
    foot = np.sqrt(long * wide)
    zone = 0
    i, j = np.int64(x - world.west), np.int64(y - world.south)
    if 0 <= i < zones.shape[1] and 0 <= j < zones.shape[0]:
        zone = zones[j, i]
    mirror = 0.0
    if water < 0.0:
        ripple = 0.85 + 0.3 * noise2(x * 0.9, y * 0.9, 4.0)
        ice = light.snow * smooth(0.35, 0.6, cloud_noise(x * 0.12, y * 0.12, 6.0, 3.0))
        return (
            0.018 * ripple + 0.6 * ice, 0.026 * ripple + 0.62 * ice, 0.024 * ripple + 0.66 * ice, 0.72 * (1.0 - ice)
        )  # fmt: skip
    if best < 0 or (total > 0.0 and road > 0.0):
        r, g, b = _yard(zone, x, y, foot, light, world.seed)
        settle = _yard_snow(zone, r + g + b, x, y, light) if light.snow > 0.0 else 0.0
        if zone in (2, 3):
            mirror = light.wet * 0.5
        return *_covered(r, g, b, settle, mirror, x, y, light), mirror
    piece = streets[best]
    kind, ux, uy = piece.kind, piece.ux, piece.uy
    cos, sin = abs(ux * toward_x + uy * toward_y), abs(ux * toward_y - uy * toward_x)
    fs, fd = cos * long + sin * wide, sin * long + cos * wide
    if kind == 4:
        r, g, b = _track(s + piece.start, d, fs, fd, x, y, light)
        return r, g, b, 0.15 * light.wet
    foot_edge = max(0.02, fs if crossing < 0.5 else fd)
    on_road = smooth(0.5 * foot_edge, -0.5 * foot_edge, road) if kind != 5 else 0.0
    r, g, b = _pavement(piece, s, d, fs, fd, x, y) if on_road < 1.0 else (0.0, 0.0, 0.0)
    rr, rg, rb, tone = _road(piece, s, d, fs, fd, x, y, crossing, light)
    r, g, b = r + on_road * (rr - r), g + on_road * (rg - g), b + on_road * (rb - b)
    settle = 0.0
    if light.snow > 0.0:
        lying = smooth(0.42, 0.62, cloud_noise(x * 0.7, y * 0.7, 15.0, 3.0) + 0.10)
        settle = lying + on_road * (_road_snow(piece, s, d, x, y, crossing) * 0.85 - lying)
    if kind not in (0, 5):
        kerb = cover(road - 0.09, 0.09, foot_edge)
        r, g, b = r + kerb * (0.36 * tone - r), g + kerb * (0.355 * tone - g), b + kerb * (0.34 * tone - b)
        gutter = 1.0 - 0.5 * cover(road + 0.06, 0.08, foot_edge)
        r, g, b = r * gutter, g * gutter, b * gutter
    mirror = light.wet * (0.34 + 0.3 * on_road)
    return *_covered(r, g, b, settle, mirror, x, y, light), mirror


@kernel
def _covered(r, g, b, settle, mirror, x, y, light):
    """Colour of the ground under snow or water."""
    if light.snow > 0.0:
        white = min(1.0, 1.3 * light.snow) * settle
        slush = 0.82 + 0.18 * noise2(x * 1.5, y * 1.5, 19.0)
        r, g, b = r * 0.8, g * 0.8, b * 0.8
        r, g, b = r + white * (0.76 * slush - r), g + white * (0.79 * slush - g), b + white * (0.84 * slush - b)
    dark = 1.0 - 0.75 * mirror
    return r * dark, g * dark, b * dark


@kernel
def paint_ground(view_record, light_record, world_record, streets, table, zones, fragments, index, counts, mirror):
    """Paint all fragments of ground; ``mirror``, float32 (rows, columns), receives the share of light they mirror."""
    view, light, world = view_record[0], light_record[0], world_record[0]
    for n in range(counts[K_GROUND]):
        f = fragments[index[K_GROUND, n]]
        reach = np.sqrt(np.float64(f.ray_x * f.ray_x + f.ray_y * f.ray_y))
        wide = SAMPLES * f.depth / view.focal
        long = wide * reach * f.depth / view.z
        r, g, b, shine = _ground(
            world,
            streets,
            table,
            zones,
            light,
            np.float64(f.x),
            np.float64(f.y),
            f.ray_x / reach,
            f.ray_y / reach,
            long,
            wide,
        )
        f.red, f.green, f.blue, f.nz = r, g, b, 1.0
        mirror[f.row, f.column] += f.share * shine
