"""The ground: roads, markings, pavements, water, tracks, yards, grass, and snow and rain on them."""

import numpy as np

from artifact_city.fragments import K_GROUND
from artifact_city.grids import STREET_CELL
from artifact_city.kernel import kernel
from artifact_city.lots import Zone
from artifact_city.noise import cloud_noise, cover, hash3, noise2, smooth, stripes
from artifact_city.palette import filtered, mixed, put, scaled
from artifact_city.streets import Kind
from artifact_city.view import SAMPLES


@kernel
def _paving(x, y, size, fx, fy, joint, contrast, seed):
    """Brightness of stones or slabs in staggered rows, about 1."""
    visible = 1.0 - smooth(0.4 * size, 1.4 * size, max(fx, fy))
    if visible <= 0.0:
        return 0.98
    row = np.floor(y / size)
    tone = hash3(np.floor(x / size + 0.5 * row), row, seed)
    seams = max(stripes(y, size, joint, fy), stripes(x + 0.5 * row * size, size, joint, fx))
    return 1.0 + visible * contrast * (tone - 0.5 - 1.4 * seams)


@kernel
def _asphalt(x, y, d, half, foot, seed):
    """Brightness of asphalt with wheel tracks, about 1."""
    value = 0.91 + 0.18 * cloud_noise(x * 0.11, y * 0.11, 5.0 + seed, 2.0)
    value *= 1.0 + 0.07 * np.cos(d * 3.6) * smooth(half, half - 1.0, abs(d))
    if foot < 0.3:
        value *= 1.0 + (0.45 - 1.5 * foot) * (noise2(x * 14.0, y * 14.0, 8.0) - 0.5)
    return value


@kernel
def _markings(piece, s, d, fs, fd):
    """Share of white paint on the road of a street or an avenue: crossings, middle lines, parking bays."""
    gap = min(s - piece.mouth_start, piece.length - s - piece.mouth_end)
    paint = 0.0
    if 0.9 < gap < 4.1 and hash3(piece.seed, 1.0 if s > 0.5 * piece.length else 0.0, 7.0) < 0.7:
        zebra = stripes(d + 0.25, 1.0, 0.5, fd) * cover(gap - 2.5, 1.5, fs)
        paint = zebra * smooth(piece.road, piece.road - 0.3, abs(d))
    elif gap > 5.2:
        dashes = stripes(s, 6.0, 3.0, fs)
        if piece.kind == Kind.STREET:
            paint = cover(d, 0.07, fd) * dashes
        else:
            paint = max(cover(abs(d) - 0.12, 0.06, fd), cover(abs(d) - 2.9, 0.07, fd) * dashes)
        paint = max(paint, 0.8 * cover(abs(d) - piece.road + 2.05, 0.05, fd) * stripes(s, 1.2, 0.7, fs))
    return paint * (0.75 + 0.25 * noise2(s * 1.3, d * 1.3, 9.0))


@kernel
def _track(s, d, fs, fd, x, y, light):
    """Colour of ballast, sleepers and rails."""
    sleeper = stripes(s, 0.65, 0.25, fs) * cover(d, 1.3, fd)
    c = scaled((0.18, 0.165, 0.15), 0.75 + 0.5 * noise2(x * 9.0, y * 9.0, 3.0) if fs < 0.4 else 1.0)
    c = mixed(c, (0.075, 0.062, 0.05), sleeper)
    if light.snow > 0.0:
        cleared = 0.45 * smooth(1.3, 0.5, abs(d)) + 0.25 * sleeper + 0.5 * (1.0 - light.snow)
        lying = 0.93 * smooth(0.25, 0.5, cloud_noise(x * 1.3, y * 1.3, 14.0, 2.0) + 0.3 - cleared)
        c = mixed(c, (0.72, 0.75, 0.8), lying)
    c = scaled(c, 1.0 - 0.5 * cover(abs(d) - 0.75, 0.1, fd))
    return mixed(c, (0.42, 0.40, 0.38), cover(abs(d) - 0.75, 0.045, fd))


@kernel
def _yard(zone, x, y, foot, light, seed):
    """Colour of the ground between the streets."""
    coarse = cloud_noise(x * 0.06, y * 0.06, seed + 2, 3.0)
    if zone == Zone.COURT:
        return scaled((0.30, 0.275, 0.235), 0.8 + 0.4 * coarse)
    if zone == Zone.SQUARE:
        border = 0.25 * min(1.0, stripes(x, 8.0, 0.35, foot) + stripes(y, 8.0, 0.35, foot))
        slabs = _paving(x, y, 0.8, foot, foot, 0.05, 0.2, seed)
        return scaled((0.30, 0.275, 0.235), slabs * (0.8 + 0.4 * coarse) * (1.0 - border))
    value = 0.58 + 0.42 * coarse + 0.52 * (cloud_noise(x * 1.7, y * 1.7, seed, 3.0) if foot < 1.2 else 0.5)
    if zone == Zone.FIELD:  # strips of stubble, earth and meadows
        p, q = 0.94 * x + 0.34 * y, 0.94 * y - 0.34 * x
        crop = hash3(np.floor(p / 58.0), np.floor(q / 43.0), seed)
        if crop < 0.28:
            stubble = value * (1.0 - 0.45 * light.snow)
            return 0.26 * stubble, 0.2 * stubble, 0.07 * value
        if crop < 0.42:
            return scaled((0.12, 0.085, 0.05), value * (0.75 + 0.5 * stripes(q, 0.9, 0.45, foot)))
    return filtered(scaled((0.072, 0.118, 0.028), value), light.grass)


@kernel
def _yard_snow(paved, brightness, x, y, light):
    """Share of the ground between the streets that snow covers; furrows and tufts show where it has drifted away."""
    drift = 0.75 * cloud_noise(x * 0.28, y * 0.28, 12.0, 3.0) + 0.25 * noise2(x * 2.6, y * 2.6, 18.0)
    bare = 1.0 - light.snow
    return smooth(bare, bare + 0.14, drift + 0.6 * brightness - 0.12) * (0.75 if paved else 1.0)


@kernel
def _pavement(piece, s, d, fs, fd, x, y):
    """Colour of a pavement of slabs, or of the gravel of a park's path."""
    seed = piece.seed
    value = (0.85 + 0.3 * hash3(seed, 1.0, 2.0)) * (0.84 + 0.32 * cloud_noise(x * 0.35, y * 0.35, 3.0, 3.0))
    if piece.kind == Kind.PATH:
        return scaled((0.34, 0.29, 0.21), value)
    size = 0.6 if hash3(seed, 4.0, 4.0) < 0.6 else 0.4
    return scaled((0.27, 0.255, 0.23), value * _paving(s, d, size, fs, fd, 0.05, 0.2, seed))


@kernel
def _road(piece, s, d, fs, fd, x, y, crossing, light):
    """Colour of a road with its markings, and the brightness that its kerbs share."""
    if piece.kind in (Kind.LANE, Kind.CANAL) or (light.past and piece.kind != Kind.PATH):  # cobbles
        patches = 0.8 + 0.4 * cloud_noise(x * 0.3, y * 0.3, 5.0, 3.0)
        tone = _paving(s, d, 0.16, fs, fd, 0.02, 0.35, piece.seed) * patches
        return scaled((0.175, 0.16, 0.145), tone), tone
    tone = _asphalt(x, y, d, piece.road, max(fs, fd), piece.seed)
    paint = _markings(piece, s, d, fs, fd) if crossing > 1.2 and piece.kind in (Kind.STREET, Kind.AVENUE) else 0.0
    return mixed(scaled((0.105, 0.105, 0.108), tone), (0.62, 0.61, 0.57), paint), tone


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
        if piece.kind == Kind.CANAL:
            water = min(water, max(abs(d) - piece.water, beyond + piece.cap))
        elif piece.kind < Kind.CANAL:
            deck = min(deck, to_edge)
        if to_road < road:
            crossing, road = road, to_road
            best, along, across = k, s, d
        else:
            crossing = min(crossing, to_road)
    if road > 0.0 and crossing < 6.0 and streets[best].kind < Kind.RAILWAY:
        # Kerbs are rounded where two roads meet.
        h = max(0.0, 1.0 - abs(road - crossing) / 5.0)
        road -= 1.25 * h * h
    return best, along, across, road, total, (1e9 if deck < 0.4 else water), crossing


@kernel
def _ground(world, streets, table, zones, light, x, y, toward_x, toward_y, long, wide):
    """Reflectance of a point of the ground, and the share of light that it mirrors.

    The footprint of the image sample is ``long`` metres in the direction ``toward`` which the camera looks, and ``wide``
    across it.
    """
    best, s, d, road, total, water, crossing = _locate(world, streets, table, x, y)
    if water < 0.0:
        ripple = 0.85 + 0.3 * noise2(x * 0.9, y * 0.9, 4.0)
        ice = light.snow * smooth(0.35, 0.6, cloud_noise(x * 0.12, y * 0.12, 6.0, 3.0))
        return mixed(scaled((0.018, 0.026, 0.024), ripple), (0.62, 0.64, 0.68), ice), 0.72 * (1.0 - ice)
    if best < 0 or (total > 0.0 and road > 0.0):
        i, j = np.int64(x - world.west), np.int64(y - world.south)
        zone = zones[j, i] if 0 <= i < zones.shape[1] and 0 <= j < zones.shape[0] else 0
        paved = zone in (Zone.COURT, Zone.SQUARE)
        c, mirror = _yard(zone, x, y, np.sqrt(long * wide), light, world.seed), 0.5 * light.wet if paved else 0.0
        settle = _yard_snow(paved, c[0] + c[1] + c[2], x, y, light) if light.snow > 0.0 else 0.0
        return _covered(c, settle, mirror, x, y, light), mirror
    piece = streets[best]
    kind, ux, uy = piece.kind, piece.ux, piece.uy
    cos, sin = abs(ux * toward_x + uy * toward_y), abs(ux * toward_y - uy * toward_x)
    fs, fd = cos * long + sin * wide, sin * long + cos * wide
    if kind == Kind.RAILWAY:
        return _track(s + piece.start, d, fs, fd, x, y, light), 0.15 * light.wet
    foot_edge = max(0.02, fs if crossing < 0.5 else fd)
    on_road = smooth(0.5 * foot_edge, -0.5 * foot_edge, road) if kind != Kind.PATH else 0.0
    c, tone = (0.0, 0.0, 0.0), 1.0
    if on_road < 1.0:
        c = _pavement(piece, s, d, fs, fd, x, y)
    if on_road > 0.0 or road < 0.3:
        asphalt, tone = _road(piece, s, d, fs, fd, x, y, crossing, light)
        c = mixed(c, asphalt, on_road)
    settle = 0.0
    if light.snow > 0.0:
        lying = smooth(0.42, 0.62, cloud_noise(x * 0.7, y * 0.7, 15.0, 3.0) + 0.10)
        settle = lying + on_road * (_road_snow(piece, s, d, x, y, crossing) * 0.85 - lying)
    if kind not in (Kind.LANE, Kind.PATH):
        c = mixed(c, scaled((0.36, 0.355, 0.34), tone), cover(road - 0.09, 0.09, foot_edge))
        c = scaled(c, 1.0 - 0.5 * cover(road + 0.06, 0.08, foot_edge))
    mirror = light.wet * (0.34 + 0.3 * on_road)
    return _covered(c, settle, mirror, x, y, light), mirror


@kernel
def _covered(c, settle, mirror, x, y, light):
    """Colour of the ground under snow or water."""
    if light.snow > 0.0:
        slush = 0.82 + 0.18 * noise2(x * 1.5, y * 1.5, 19.0)
        c = mixed(scaled(c, 0.8), scaled((0.76, 0.79, 0.84), slush), min(1.0, 1.3 * light.snow) * settle)
    return scaled(c, 1.0 - 0.75 * mirror)


@kernel
def paint_ground(view_record, light_record, world_record, streets, table, zones, fragments, index, counts, mirror):
    """Paint all fragments of ground; ``mirror``, float32 (rows, columns), receives the share of light they mirror."""
    view, light, world = view_record[0], light_record[0], world_record[0]
    for n in range(counts[K_GROUND]):
        f = fragments[index[K_GROUND, n]]
        x, y, reach = np.float64(f.x), np.float64(f.y), np.sqrt(np.float64(f.ray_x * f.ray_x + f.ray_y * f.ray_y))
        toward_x, toward_y, wide = f.ray_x / reach, f.ray_y / reach, SAMPLES * f.depth / view.focal
        long = wide * reach * f.depth / view.z
        colour, shine = _ground(world, streets, table, zones, light, x, y, toward_x, toward_y, long, wide)
        put(f.colour, colour)
        f.normal[2] = 1.0
        mirror[f.row, f.column] += f.share * shine
