"""Walls: what a point of a facade looks like. Materials, windows and so on are numbered as in ``buildings``."""

import numpy as np

from artifact_city.buildings import FACADE_EDGE
from artifact_city.fragments import K_WALL
from artifact_city.kernel import kernel
from artifact_city.noise import cloud_noise, cover, hash3, noise2, smooth, stripes
from artifact_city.openings import arcade, door, mix, shop, window
from artifact_city.trace import BUILDING
from artifact_city.view import SAMPLES

# What is at a point of a wall: nothing, a window of kind 1 to 8 (see buildings.Windows), or one of these.
DOOR, SHOP, ARCADE, GATE = 20, 21, 22, 23

# Further bits of a building's ornament; the lower ones are documented there.
BANDS, TILES, IVY, PILASTERS, MURAL = 32, 64, 128, 256, 512


@kernel
def wall_texture(material, u, z, fu, fz, seed):
    """Factor by which a wall's colour varies with its material, about 1."""
    stains = cloud_noise(u * 0.45 + seed % 97.0, z * 0.35, seed, 3.0)
    streaks = noise2(u * 1.9, z * 0.22, seed + 3)
    value = 0.80 + 0.30 * stains + 0.10 * streaks
    if material == 0:  # brick
        visible = 1.0 - smooth(0.03, 0.11, fz)
        if visible > 0.0:
            row = np.floor(z / 0.1)
            shift = 0.5 * (np.int64(row) & 1)
            tone = hash3(np.floor(u / 0.3 + shift), row, seed)
            joint = max(cover(z - (row + 0.5) * 0.1, 0.042, fz), 0.0)
            upright = 1.0 - stripes(u / 0.3 + shift, 1.0, 0.06, fu / 0.3)
            value *= 1.0 + visible * (0.28 * (tone - 0.5) - 0.25 * (1.0 - joint * upright))
    elif material == 2:  # stone blocks
        visible = 1.0 - smooth(0.08, 0.3, max(fz, 0.4 * fu))
        if visible > 0.0:
            row = np.floor(z / 0.42)
            shift = 0.5 * (np.int64(row) & 1)
            tone = hash3(np.floor(u / 0.9 + shift), row, seed)
            joint = stripes(z, 0.42, 0.035, fz) + stripes(u + 0.9 * shift, 0.9, 0.035, fu)
            value *= 1.0 + visible * (0.2 * (tone - 0.5) - 0.4 * min(1.0, joint))
    elif material == 3:  # concrete, with rain streaks
        value = 0.86 + 0.12 * stains + 0.16 * (noise2(u * 2.6, z * 0.09, seed) - 0.3)
    elif material == 5:  # boards
        visible = 1.0 - smooth(0.06, 0.2, fz)
        value = 0.9 + 0.14 * stains - 0.3 * visible * stripes(z, 0.2, 0.035, fz) - 0.05 * (1 - visible)
    return value * (0.80 + 0.20 * smooth(0.0, 1.1, z + 0.4 * stains))


@kernel
def _beams(u, z, fu, fz, step, floor_height, ground_height, seed):
    """Share of a timber frame's beams at a point."""
    s, t = u - FACADE_EDGE, z - ground_height
    floor = np.floor(t / floor_height)
    column = np.floor(s / step)
    share = stripes(s + 0.08, step, 0.18, fu) + stripes(t + 0.1, floor_height, 0.22, fz)
    share += 0.7 * stripes(t - 0.5 * floor_height, floor_height, 0.14, fz)
    if hash3(floor, column, seed) < 0.4:
        x, y = (s - column * step) / step, (t - floor * floor_height) / floor_height
        if hash3(floor, column, seed + 1) < 0.5:
            x = 1.0 - x
        share += cover((y - x) * 0.7 * floor_height, 0.09, max(fu, fz))
    return min(1.0, share)


@kernel
def _pattern(house, u, z, fu, fz, length):
    """Share of the trim's colour in bands of brick, glazed tiles or pilasters."""
    share = 0.0
    if house.ornament & BANDS:
        share = 0.75 * stripes(z, 0.85, 0.2, fz)
    if house.ornament & TILES:
        x, y = u / 0.9 - np.floor(u / 0.9) - 0.5, z / 0.9 - np.floor(z / 0.9) - 0.5
        far = smooth(0.25, 0.6, max(fu, fz))
        diamond = smooth(0.34, 0.26, abs(abs(x) + abs(y) - 0.25) * 1.6)
        share = max(share, 0.6 * (diamond * (1.0 - far) + 0.35 * far))
    if house.ornament & PILASTERS:
        step = (length - 2 * FACADE_EDGE) / max(1, np.int64((length - 2 * FACADE_EDGE) / house.bay))
        share = max(share, 0.8 * stripes(u - FACADE_EDGE + 0.17, step, 0.34, fu))
    return share


@kernel
def _mural(house, u, z, length, r, g, b):
    """Paint large coloured discs and beams on a blind wall."""
    for k in range(5):
        a = hash3(house.seed, float(k), 81.0)
        x, y = (
            u - hash3(house.seed, float(k), 82.0) * length,
            z - (0.25 + 0.65 * hash3(house.seed, float(k), 83.0)) * house.height,
        )
        inside = x * x + y * y < (1.0 + 2.6 * a) ** 2 if k < 3 else abs(x + (a - 0.5) * 2.0 * y) < 0.5
        if inside:
            hue = hash3(house.seed, float(k), 84.0)
            r, g, b = 0.08 + 0.6 * hue, 0.1 + 0.5 * abs(hue - 0.5), 0.6 - 0.5 * hue
    return r, g, b


@kernel
def opening_at(house, side, u, z):
    """Find the opening whose bay a point of a wall lies in.

    Returns what it is, the position in it (from its centre, from its foot), its half width, its height, a number that
    identifies it, and the width of its bay.
    """
    length, kind, seed = house.length[side], house.windows, house.seed
    bays = max(1, np.int64((length - 2 * FACADE_EDGE) / house.bay))
    step = (length - 2 * FACADE_EDGE) / bays
    column = min(bays - 1, max(0, np.int64((u - FACADE_EDGE) / step)))
    x = u - FACADE_EDGE - (column + 0.5) * step
    if z <= house.ground_height:
        if not house.fronts[side] or house.ground == 0:
            return 0, 0.0, 0.0, 0.0, 0.0, 0.0, step
        if house.ground == 2:
            return SHOP, u, z, 0.0, 0.0, 0.0, step
        if house.ground == 4 and (side == 0 or kind == 0):
            return GATE, u - 0.5 * length, z, min(1.5, 0.36 * length), min(2.7, 0.8 * house.ground_height), 0.0, step
        if house.ground == 3:
            return ARCADE, x, z, 0.5 * step - 0.28, house.ground_height - 0.5, float(column), step
        if column == np.int64(hash3(seed, float(side), 13.0) * bays) and (
            side == 0 or hash3(seed, float(side), 19.0) < 0.5
        ):
            return DOOR, x, z, 0.52, 2.25, float(column), step
        tall = min(house.window_height, house.ground_height - 1.5)
        sill = max(0.95, house.ground_height - 0.8 - tall)
        half = 0.5 * min(house.window_width, step - 0.5)
        return 1 if kind in (6, 8) else kind, x, z - sill, half, tall, 1009.0 * side + column, step
    if kind == 0:
        return 0, 0.0, 0.0, 0.0, 0.0, 0.0, step
    k = np.int64(np.floor((z - house.ground_height) / house.floor_height))
    floors = np.int64((house.height - house.ground_height) / house.floor_height + 0.05)
    if k >= (max(1, floors) if kind == 7 else floors):
        if side != 0 or house.slope[1] <= 0.0 or house.slope[0] > 0.0 or kind == 7:
            return 0, 0.0, 0.0, 0.0, 0.0, 0.0, step
        # One small window in the gable.
        return min(kind, 3), u - 0.5 * length, z - house.height - 0.35, 0.36, 0.95, 99_991.0, 8.0
    key = 1009.0 * side + 101.0 * (k + 1) + column
    if not house.fronts[side] and hash3(key, seed, 71.0) > 0.28:
        return 0, 0.0, 0.0, 0.0, 0.0, 0.0, step
    y = z - house.ground_height - k * house.floor_height - house.sill
    half, tall = 0.5 * min(house.window_width, step - 0.35), min(house.window_height, house.floor_height - 1.0)
    if kind == 4:
        half, tall = 0.5 * step - 0.12, min(1.5, house.floor_height - 1.1)
    elif kind == 6:
        y, tall = y + house.sill - 0.12, min(2.25, house.floor_height - 0.55)
    elif kind == 7:
        tall = house.window_height
    elif kind == 8:
        y, half, tall = y + house.sill, 0.5 * step - 0.03, house.floor_height - 0.75
    return kind, x, y, half, tall, key, step


@kernel
def _opening(house, side, u, z, fu, fz, light, r, g, b):
    """Paint the opening at a point over the wall's colour. Returns colour, emission, share of glass."""
    what, x, y, half, tall, key, step = opening_at(house, side, u, z)
    er, eg, eb, glass = 0.0, 0.0, 0.0, 0.0
    if 0 < what < 20:
        # Where one footprint spans whole bays, only the mean of wall and window remains.
        far = smooth(0.35 * step, 0.95 * step, fu)
        share = 2.0 * half / step * cover(y - 0.5 * tall, 0.5 * tall, fz)
        mr, mg, mb = r + share * (0.10 - r), g + share * (0.10 - g), b + share * (0.11 - b)
        r, g, b, er, eg, eb, glass = window(house, what, x, y, half, tall, key, min(fu, step), fz, light, r, g, b)
        glow = share * light.lit * 0.5 * light.dark
        r, g, b = r + far * (mr - r), g + far * (mg - g), b + far * (mb - b)
        er, eg, eb = er + far * (glow - er), eg + far * (0.75 * glow - eg), eb + far * (0.42 * glow - eb)
        glass += far * (0.8 * share - glass)
    elif what == SHOP:
        r, g, b, er, eg, eb, glass = shop(
            house, side, u, z, house.length[side], house.ground_height, fu, fz, light, r, g, b
        )
    elif what == ARCADE:
        r, g, b, er, eg, eb = arcade(house, x, z, half, tall, key, fu, fz, light, r, g, b)
    elif what >= DOOR:
        r, g, b, er, eg, eb, glass = door(house, x, z, half, tall, what == GATE, fu, fz, light, r, g, b)
    return r, g, b, er, eg, eb, glass


@kernel
def facade(house, side, u, z, fu, fz, light):
    """Look of a point of a wall.

    Parameters
    ----------
    u, z : float
        Metres along side ``side`` from its first corner, and above the ground.
    fu, fz : float
        Size of the image sample on the wall, metres.

    Returns
    -------
    tuple of 7 floats
        Reflectance (r, g, b), emitted light (r, g, b), and the share of the sample that is window glass.
    """
    seed, ornament, front, ground_height = house.seed, house.ornament, house.fronts[side], house.ground_height
    length, height = house.length[side], house.height
    value = wall_texture(house.material, u, z, fu, fz, seed + side)
    r, g, b = house.wall[0] * value, house.wall[1] * value, house.wall[2] * value
    upper = z > ground_height
    timber, trim = 0.0, 0.0
    if house.material == 4 and upper:
        step = (length - 2 * FACADE_EDGE) / max(1, np.int64((length - 2 * FACADE_EDGE) / house.bay))
        timber = _beams(u, z, fu, fz, step, house.floor_height, ground_height, seed)
        timber *= 1.0 - 0.5 * smooth(0.3 * step, step, fu)
    r, g, b = r + timber * (0.055 - r), g + timber * (0.036 - g), b + timber * (0.024 - b)
    if ornament & 16 and not upper and front and house.ground != 2:
        trim = 0.7
    if front and upper and ornament & (BANDS | TILES | PILASTERS):
        trim = max(trim, _pattern(house, u, z, fu, fz, length))
    if ornament & 2:
        reach = 0.36 if (np.int64(z / 0.45) & 1) == 0 else 0.6
        edge = smooth(reach + 0.5 * fu, reach - 0.5 * fu, min(u, length - u))
        trim = max(trim, edge * (0.85 - 0.3 * stripes(z, 0.45, 0.04, fz)))
    r, g, b = mix(r, g, b, house.trim, trim)
    if ornament & IVY and front:
        cover_share = smooth(
            0.52, 0.60, cloud_noise(u * 0.32 + seed % 89.0, z * 0.28, seed, 3.0) + 0.30 * (0.45 - z / height)
        )
        leaves = (0.35 + 1.3 * noise2(u * 6.0, z * 6.0, seed)) if fu < 0.4 else 1.0
        bare = 1.0 - light.foliage
        cover_share *= 1.0 - 0.6 * bare
        r += cover_share * ((0.05 + 0.05 * bare) * leaves * light.leaf[0] - r)
        g += cover_share * ((0.10 - 0.02 * bare) * leaves * light.leaf[1] - g)
        b += cover_share * ((0.02 + 0.03 * bare) * leaves * light.leaf[2] - b)
    if ornament & MURAL and upper and not front:
        r, g, b = _mural(house, u, z, length, r, g, b)
    r, g, b, er, eg, eb, glass = _opening(house, side, u, z, fu, fz, light, r, g, b)
    band, dark = 0.0, 1.0
    if front and ornament & 1:
        band = cover(z - ground_height - 0.02, 0.13, fz)
        dark -= 0.4 * cover(z - ground_height + 0.2, 0.08, fz)
    if front and ornament & 4:
        band = max(band, cover(z - height + 0.22, 0.2, fz))
        dark -= 0.45 * cover(z - height + 0.5, 0.07, fz)
    if front and house.cap > 0.0 and house.slope[side] > 0.0:
        dark *= 1.0 - 0.5 * smooth(height - 0.75, height - 0.1, z)
    if not front or hash3(seed, 3.0, 3.0) < 0.5:
        dark *= 1.0 - 0.6 * cover(u - 0.16, 0.05, fu)
    r, g, b = mix(r, g, b, house.trim, band)
    return r * dark, g * dark, b * dark, er, eg, eb, glass


@kernel
def _garden_wall(house, u, z, fu, fz, light):
    """Reflectance of hedges, fences and plain walls."""
    wall, material, height, seed = house.wall, house.material, house.height, house.seed
    if material == 6:
        leaves = cloud_noise(u * 3.1, z * 3.1, seed, 3.0) if fu < 0.5 else 0.5
        value = (0.45 + 1.1 * leaves) * (0.6 + 0.4 * smooth(0.0, height, z))
        brown = 0.55 * (1.0 - light.foliage)
        r, g, b_ = wall[0] * value * light.leaf[0], wall[1] * value * light.leaf[1], wall[2] * value * light.leaf[2]
        white = 0.8 * light.snow * smooth(0.5, 0.8, 0.35 * leaves + 0.65 * z / height)
        r, g, b_ = r + brown * (0.06 * value - r), g + brown * (0.045 * value - g), b_ + brown * (0.028 * value - b_)
        return r + white * (0.75 - r), g + white * (0.78 - g), b_ + white * (0.83 - b_)
    if material == 7:
        slat = stripes(u, 0.16, 0.11, fu)
        rail = min(1.0, cover(z - 0.3, 0.05, fz) + cover(z - height + 0.25, 0.05, fz))
        value = max(slat, rail)
        return wall[0] * (0.12 + 0.88 * value), wall[1] * (0.12 + 0.88 * value), wall[2] * (0.12 + 0.88 * value)
    value = 0.85 + 0.25 * cloud_noise(u, z, seed, 3.0)
    return wall[0] * value, wall[1] * value, wall[2] * value


@kernel
def paint_walls(view_record, light_record, buildings, fragments, index, counts):
    """Paint all fragments of walls."""
    view, light = view_record[0], light_record[0]
    for n in range(counts[K_WALL]):
        f = fragments[index[K_WALL, n]]
        house, side = buildings[(f.code - BUILDING) >> 4], (f.code - BUILDING) & 15
        f.nx, f.ny = house.normal[side, 0], house.normal[side, 1]
        x, y, z = np.float64(f.x), np.float64(f.y), np.float64(f.z)
        u = (y - house.corners[side, 1]) * house.normal[side, 0] - (x - house.corners[side, 0]) * house.normal[side, 1]
        reach = np.sqrt(np.float64(f.ray_x * f.ray_x + f.ray_y * f.ray_y))
        size = SAMPLES * f.depth / view.focal
        fu, fz = size * reach / max(0.04, -(f.nx * f.ray_x + f.ny * f.ray_y) / reach), size
        if house.material >= 6:
            f.red, f.green, f.blue = _garden_wall(house, u, z, fu, fz, light)
        else:
            f.red, f.green, f.blue, f.glow_red, f.glow_green, f.glow_blue, glass = facade(
                house, side, u, z, fu, fz, light
            )
            f.gloss = glass
        f.contact = 0.72 + 0.28 * smooth(0.0, 1.6, z)
