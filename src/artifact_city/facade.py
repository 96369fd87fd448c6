"""Walls: what a point of a facade looks like, and its windows, doors and shops. Numbers are those of ``buildings``."""

import numpy as np

from artifact_city.buildings import FACADE_EDGE, Ground, Material, Windows
from artifact_city.fragments import K_WALL
from artifact_city.kernel import kernel
from artifact_city.noise import cloud_noise, cover, hash3, noise2, smooth, stripes
from artifact_city.palette import added, filtered, mixed, put, scaled
from artifact_city.trace import BUILDING
from artifact_city.view import SAMPLES

# What is at a point of a wall: nothing (0), a window of kind 1 to 6, or one of these.
DOOR, SHOP, GATE = 20, 21, 22

_BLACK = (0.0, 0.0, 0.0)
_WARM, _PALE, _COLD = (1.0, 0.66, 0.32), (1.0, 0.80, 0.52), (0.75, 0.85, 1.0)  # light behind windows


@kernel
def _courses(u, z, long, high, joint, fu, fz, seed):
    """Deviation of tone, and joints, of a wall of blocks in courses whose uprights are staggered."""
    row = np.floor(z / high)
    shift = 0.5 * (np.int64(row) & 1)
    tone = hash3(np.floor(u / long + shift), row, seed) - 0.5
    return tone, min(1.0, stripes(z, high, joint, fz) + stripes(u + long * shift, long, joint, fu))


@kernel
def _wall_texture(material, u, z, fu, fz, seed):
    """Factor by which a wall's colour varies with its material, about 1."""
    stains = cloud_noise(u * 0.45 + seed % 97.0, z * 0.35, seed, 3.0)
    value = 0.80 + 0.30 * stains + 0.10 * noise2(u * 1.9, z * 0.22, seed + 3)
    if material == Material.BRICK:
        visible = 1.0 - smooth(0.03, 0.11, fz)
        if visible > 0.0:
            tone, joint = _courses(u, z, 0.3, 0.1, 0.017, fu, fz, seed)
            value *= 1.0 + visible * (0.28 * tone - 0.25 * joint)
    elif material == Material.STONE:
        visible = 1.0 - smooth(0.08, 0.3, max(fz, 0.4 * fu))
        if visible > 0.0:
            tone, joint = _courses(u, z, 0.9, 0.42, 0.035, fu, fz, seed)
            value *= 1.0 + visible * (0.2 * tone - 0.4 * joint)
    elif material == Material.CONCRETE:
        value = 0.86 + 0.12 * stains + 0.16 * (noise2(u * 2.6, z * 0.09, seed) - 0.3)
    elif material == Material.SIDING:
        visible = 1.0 - smooth(0.06, 0.2, fz)
        value = 0.9 + 0.14 * stains - 0.3 * visible * stripes(z, 0.2, 0.035, fz) - 0.05 * (1 - visible)
    return value * (0.80 + 0.20 * smooth(0.0, 1.1, z + 0.4 * stains))


@kernel
def _beams(u, z, fu, fz, step, floor_height, ground_height, seed):
    """Share of a timber frame's beams at a point."""
    s, t = u - FACADE_EDGE, z - ground_height
    floor, column = np.floor(t / floor_height), np.floor(s / step)
    share = stripes(s + 0.08, step, 0.18, fu) + stripes(t + 0.1, floor_height, 0.22, fz)
    share += 0.7 * stripes(t - 0.5 * floor_height, floor_height, 0.14, fz)
    if hash3(floor, column, seed) < 0.4:  # a diagonal
        x, y = (s - column * step) / step, (t - floor * floor_height) / floor_height
        if hash3(floor, column, seed + 1) < 0.5:
            x = 1.0 - x
        share += cover((y - x) * 0.7 * floor_height, 0.09, max(fu, fz))
    return min(1.0, share) * (1.0 - 0.5 * smooth(0.3 * step, step, fu))


@kernel
def _bays(house, side):
    """Number of bays of a side, and their width."""
    room = house.length[side] - 2 * FACADE_EDGE
    bays = max(1, np.int64(room / house.bay))
    return bays, room / bays


@kernel
def opening_at(house, side, u, z):
    """Find the opening whose bay a point of a wall lies in.

    Returns what it is, the position in it (from its centre, from its foot), its half width, its height, and a number
    that identifies it.
    """
    kind, seed, length = house.windows, house.seed, house.length[side]
    bays, step = _bays(house, side)
    column = min(bays - 1, max(0, np.int64((u - FACADE_EDGE) / step)))
    x = u - FACADE_EDGE - (column + 0.5) * step
    if z <= house.ground_height:
        if not house.fronts[side] or house.ground == Ground.NONE:
            return 0, 0.0, 0.0, 0.0, 0.0, 0.0
        if house.ground == Ground.SHOP:
            return SHOP, u, z, 0.0, 0.0, 0.0
        if house.ground == Ground.GATE and (side == 0 or kind == Windows.NONE):
            return GATE, u - 0.5 * length, z, min(1.5, 0.36 * length), min(2.7, 0.8 * house.ground_height), 0.0
        if column == np.int64(hash3(seed, float(side), 13.0) * bays) and (
            side == 0 or hash3(seed, float(side), 19.0) < 0.5
        ):
            return DOOR, x, z, 0.52, 2.25, float(column)
        tall = min(house.window_height, house.ground_height - 1.5)
        sill = max(0.95, house.ground_height - 0.8 - tall)
        half = 0.5 * min(house.window_width, step - 0.5)
        return 1 if kind == Windows.FRENCH else kind, x, z - sill, half, tall, 1009.0 * side + column
    k = np.int64(np.floor((z - house.ground_height) / house.floor_height))
    floors = np.int64((house.height - house.ground_height) / house.floor_height + 0.05)
    key = 1009.0 * side + 101.0 * (k + 1) + column
    if kind == Windows.NONE or (not house.fronts[side] and hash3(key, seed, 71.0) > 0.28):
        return 0, 0.0, 0.0, 0.0, 0.0, 0.0
    if k >= floors:
        if side != 0 or house.slope[1] <= 0.0 or house.slope[0] > 0.0:
            return 0, 0.0, 0.0, 0.0, 0.0, 0.0
        return min(kind, 3), u - 0.5 * length, z - house.height - 0.35, 0.36, 0.95, 99_991.0  # one in the gable
    y = z - house.ground_height - k * house.floor_height - house.sill
    half, tall = 0.5 * min(house.window_width, step - 0.35), min(house.window_height, house.floor_height - 1.0)
    if kind == Windows.STRIP:
        half, tall = 0.5 * step - 0.12, min(1.5, house.floor_height - 1.1)
    elif kind == Windows.FRENCH:
        y, tall = y + house.sill - 0.12, min(2.25, house.floor_height - 0.55)
    return kind, x, y, half, tall, key


@kernel
def _cloth(x, y, half, height, draw, foot):
    """Share of curtain or blind at a point of a window; x from its centre, y from its foot."""
    if draw < 0.3:
        return 0.0
    if draw < 0.58:
        return 1.0 - cover(x, (0.35 + 0.45 * ((draw * 37.0) % 1.0)) * half, foot)
    if draw < 0.8:
        return smooth(0.0, foot + 0.03, y - height * (0.25 + 0.6 * ((draw * 53.0) % 1.0)))
    return 0.55


@kernel
def _pane(x, y, half, height, arched, border, fu, fz):
    """Share of a footprint inside a window outline, drawn in by ``border``; arched tops are half circles."""
    w, h = half - border, height - 2.0 * border
    y -= border
    if arched and y > h - w:
        rise = y - (h - w)
        w *= np.sqrt(max(0.0, 1.0 - (rise / w) ** 2)) if rise < w else 0.0
    return cover(x, w, fu) * cover(y - 0.5 * h, 0.5 * h, fz)


@kernel
def _mullions(kind, x, y, half, height, fu, fz):
    """Share of the bars that divide a window."""
    if kind == Windows.STRIP:
        return cover(x - half * (0.0 if half < 1.0 else 0.34), 0.035, fu)
    if kind == Windows.SASH:
        return min(1.0, cover(y - 0.5 * height, 0.045, fz) + 0.6 * cover(abs(x) - 0.33 * half, 0.02, fu))
    crossbar = height - half if kind == Windows.ARCHED else (0.8 if kind == Windows.FRENCH else 0.66) * height
    return min(1.0, cover(x, 0.035, fu) + cover(y - crossbar, 0.035, fz))


@kernel
def _window(house, kind, x, y, half, height, key, fu, fz, light, c):
    """Paint one window over a wall colour. Returns colour, emission, share of glass."""
    trim, accent, arched, strip = house.trim, house.accent, kind == Windows.ARCHED, kind == Windows.STRIP
    if house.ornament & 8:
        c = mixed(c, trim, _pane(x, y + 0.14, half + 0.15, height + 0.3, arched, 0.0, fu, fz))
    if kind == Windows.SHUTTERS:
        wing = cover(abs(x) - half - 0.26, 0.25, fu) * cover(y - 0.5 * height, 0.5 * height + 0.03, fz)
        c = mixed(c, scaled(accent, 0.75 + 0.25 * stripes(y, 0.12, 0.07, fz)), wing)
    if kind != Windows.FRENCH:
        sill = cover(x, half + 0.1, fu)
        c = scaled(c, 1.0 - 0.35 * sill * cover(y + 0.19, 0.07, fz))
        c = mixed(c, mixed(trim, (0.85, 0.87, 0.9), min(0.8, 1.3 * light.snow)), sill * cover(y + 0.06, 0.06, fz))
    frame = _pane(x, y, half, height, arched, 0.0, fu, fz)
    if frame <= 0.0:
        return c, _BLACK, 0.0
    tone = scaled(trim, 0.12 if strip else 0.9)
    if hash3(house.seed, 5.0, 1.0) < 0.35 and not strip:
        tone = scaled(accent, 0.9)
    c = mixed(c, tone, frame)
    pane = _pane(x, y, half, height, arched, 0.04 if strip else 0.075, fu, fz)
    pane *= 1.0 - 0.9 * _mullions(kind, x, y, half, height, fu, fz)
    reveal = 1.0 - 0.55 * smooth(0.22, 0.0, height - y) - 0.25 * smooth(0.16, 0.0, half - abs(x))
    cloth = _cloth(x, y, half, height, hash3(key, house.seed, 11.0), fu)
    inner = (0.035 + 0.05 * hash3(key, 3.0, house.seed)) * reveal
    c = mixed(c, added((inner, inner, 1.1 * inner), (1.0, 0.97, 0.9), 0.38 * cloth * reveal), pane)
    if hash3(key, house.seed, light.lit_seed) >= light.lit:
        return c, _BLACK, pane
    draw = hash3(key, house.seed, 29.0)
    power = (0.45 + 0.9 * hash3(key, house.seed, 31.0)) * (0.55 + 0.45 * y / height) * (1.0 - 0.45 * cloth)
    room = 0.75 + 0.5 * noise2(x * 2.3 + key, y * 1.7, 41.0)
    power *= reveal * pane * room * (0.35 + 0.65 * light.dark)
    return c, scaled(_WARM if draw < 0.6 else (_PALE if draw < 0.9 else _COLD), power), pane


@kernel
def _shop(house, side, u, z, fu, fz, light, c):
    """Paint a shop front: a sign, and panes with a door in one of them. Returns colour, emission, share of glass."""
    length, height, sign, glow = house.length[side], house.ground_height, house.sign, _BLACK
    seed = house.seed + 7 * side + (5003 if light.past else 0)
    front = cover(u - 0.5 * length, 0.5 * length - 0.18, fu) * smooth(height + 0.02, height - 0.02, z)
    c = mixed(c, house.accent, 0.9 * front)
    opened = light.lit > 0.0 and hash3(seed, light.lit_seed, 3.0) < 0.45 + 0.25 * light.dark
    low, high = height - 0.95, height - 0.3
    band = front * cover(z - 0.5 * (low + high), 0.5 * (high - low), fz)
    c = mixed(c, sign, band)
    if opened and light.dark > 0.0:
        glow = scaled(added(sign, (0.25, 0.2, 0.15), 1.0), 0.5 * band)
    c = mixed(c, house.trim, front * cover(z - height + 0.12, 0.14, fz))
    count = max(1, np.int64((length - 0.5) / 2.3))
    step = (length - 0.5) / count
    k = min(count - 1, max(0, np.int64((u - 0.25) / step)))
    x = u - 0.25 - (k + 0.5) * step
    door = k == np.int64(hash3(seed, 1.0, 1.0) * count)
    foot = 0.08 if door else 0.5
    pane = cover(x, 0.5 * step - 0.12, fu) * cover(z - 0.5 * (foot + low - 0.12), 0.5 * (low - 0.12 - foot), fz)
    if door:
        pane *= (1.0 - cover(abs(x) - 0.52, 0.06, fu)) * (1.0 - cover(z - 2.15, 0.05, fz))
    if pane > 0.0:
        shelf = np.floor(z / 0.55)
        item = np.floor(u / 0.42 + 0.5 * shelf)
        goods = 0.10 + 0.35 * hash3(item, shelf, seed) if z < 1.9 and not door else 0.07
        goods += smooth(0.5, 1.2, fu) * (0.16 - goods)
        hue = hash3(item, shelf, seed + 1)
        shown = scaled((0.6 + 0.8 * hue, 1.15 - 0.5 * abs(hue - 0.5), 1.3 - 0.8 * hue), goods)
        c = mixed(c, scaled(shown, 0.4), pane)
        if opened:
            power = pane * (0.25 + 1.15 * light.dark) * (0.6 + 0.5 * z / height)
            glow = added(glow, added((0.55, 0.45, 0.28), shown, 1.0), power)
    return scaled(c, 1.0 - 0.3 * smooth(0.5, 0.0, low - z) if z < low else 1.0), glow, pane


@kernel
def _door(house, x, z, half, height, gate, fu, fz, light, c):
    """Paint a door with a fanlight, or a gate of planks. Returns colour, emission, share of glass."""
    c = mixed(c, house.trim, cover(x, half + 0.14, fu) * cover(z - 0.5 * height, 0.5 * height + 0.14, fz))
    if gate:
        tone = 1.0 - 0.35 * stripes(x + half, 0.24, 0.04, fu) - 0.3 * cover(x, 0.03, fu)
    else:
        tone = 0.8 + 0.35 * cover(abs(x) - 0.5 * half, 0.3 * half, fu) * stripes(z - 0.25, 0.9, 0.65, fz)
    leaf = cover(x, half, fu) * cover(z - 0.5 * height, 0.5 * height, fz)
    c = mixed(c, scaled(house.accent, tone * (smooth(0.0, 0.3, z) * 0.3 + 0.7)), leaf)
    c = mixed(c, (0.35, 0.34, 0.32), cover(x, half + 0.2, fu) * cover(z - 0.05, 0.08, fz))
    if gate or house.ground_height < 2.95:
        return c, _BLACK, 0.0
    over = _pane(x, z - height - 0.05, half, min(0.55, house.ground_height - 2.75), False, 0.04, fu, fz)
    lit = 0.8 * over * light.dark if hash3(house.seed, light.lit_seed, 5.0) < 1.3 * light.lit else 0.0
    return mixed(c, (0.05, 0.05, 0.055), over), scaled((1.0, 0.7, 0.38), lit), over


@kernel
def _opening(house, side, u, z, fu, fz, step, light, c):
    """Paint the opening at a point over the wall's colour. Returns colour, emission, share of glass."""
    what, x, y, half, tall, key = opening_at(house, side, u, z)
    if what == 0:
        return c, _BLACK, 0.0
    if what == SHOP:
        return _shop(house, side, u, z, fu, fz, light, c)
    if what >= DOOR:
        return _door(house, x, y, half, tall, what == GATE, fu, fz, light, c)
    near, glow, glass = _window(house, what, x, y, half, tall, key, min(fu, step), fz, light, c)
    # Where one footprint spans whole bays, only the mean of wall and window remains.
    far = smooth(0.35 * step, 0.95 * step, fu)
    share = 2.0 * half / step * cover(y - 0.5 * tall, 0.5 * tall, fz)
    glow = mixed(glow, scaled((1.0, 0.75, 0.42), share * light.lit * 0.5 * light.dark), far)
    return mixed(near, mixed(c, (0.10, 0.10, 0.11), share), far), glow, glass + far * (0.8 * share - glass)


@kernel
def _facade(house, side, u, z, fu, fz, light):
    """Reflectance, emitted light, and share of glass at a point of a wall with a footprint of ``fu`` by ``fz``."""
    ornament, front, ground_height, height = house.ornament, house.fronts[side], house.ground_height, house.height
    step, upper, trim = _bays(house, side)[1], z > ground_height, 0.0
    c = scaled(house.wall, _wall_texture(house.material, u, z, fu, fz, house.seed + side))
    if house.material == Material.TIMBER and upper:
        beams = _beams(u, z, fu, fz, step, house.floor_height, ground_height, house.seed)
        c = mixed(c, (0.055, 0.036, 0.024), beams)
    if ornament & 16 and not upper and front and house.ground != Ground.SHOP:
        trim = 0.7
    if ornament & 2:
        reach = 0.36 if (np.int64(z / 0.45) & 1) == 0 else 0.6
        edge = smooth(reach + 0.5 * fu, reach - 0.5 * fu, min(u, house.length[side] - u))
        trim = max(trim, edge * (0.85 - 0.3 * stripes(z, 0.45, 0.04, fz)))
    c, glow, glass = _opening(house, side, u, z, fu, fz, step, light, mixed(c, house.trim, trim))
    band, dark = 0.0, 1.0
    if front and ornament & 1:
        band = cover(z - ground_height - 0.02, 0.13, fz)
        dark -= 0.4 * cover(z - ground_height + 0.2, 0.08, fz)
    if front and ornament & 4:
        band = max(band, cover(z - height + 0.22, 0.2, fz))
        dark -= 0.45 * cover(z - height + 0.5, 0.07, fz)
    if front and house.cap > 0.0 and house.slope[side] > 0.0:
        dark *= 1.0 - 0.5 * smooth(height - 0.75, height - 0.1, z)
    if not front or hash3(house.seed, 3.0, 3.0) < 0.5:
        dark *= 1.0 - 0.6 * cover(u - 0.16, 0.05, fu)
    return scaled(mixed(c, house.trim, band), dark), glow, glass


@kernel
def _garden_wall(house, u, z, fu, fz, light):
    """Reflectance of hedges, fences and plain walls."""
    if house.material == Material.HEDGE:
        leaves = cloud_noise(u * 3.1, z * 3.1, house.seed, 3.0) if fu < 0.5 else 0.5
        value = (0.45 + 1.1 * leaves) * (0.6 + 0.4 * smooth(0.0, house.height, z))
        green = filtered(scaled(house.wall, value), light.leaf)
        white = 0.8 * light.snow * smooth(0.5, 0.8, 0.35 * leaves + 0.65 * z / house.height)
        brown = mixed(green, scaled((0.06, 0.045, 0.028), value), 0.55 * (1.0 - light.foliage))
        return mixed(brown, (0.75, 0.78, 0.83), white)
    if house.material == Material.FENCE:
        rail = min(1.0, cover(z - 0.3, 0.05, fz) + cover(z - house.height + 0.25, 0.05, fz))
        return scaled(house.wall, 0.12 + 0.88 * max(stripes(u, 0.16, 0.11, fu), rail))
    return scaled(house.wall, 0.85 + 0.25 * cloud_noise(u, z, house.seed, 3.0))


@kernel
def paint_walls(view_record, light_record, buildings, fragments, index, counts):
    """Paint all fragments of walls."""
    view, light = view_record[0], light_record[0]
    for n in range(counts[K_WALL]):
        f = fragments[index[K_WALL, n]]
        house, side = buildings[(f.code - BUILDING) >> 4], (f.code - BUILDING) & 15
        nx, ny = house.normal[side, 0], house.normal[side, 1]
        z = np.float64(f.z)
        u = (f.y - house.corners[side, 1]) * nx - (f.x - house.corners[side, 0]) * ny
        reach = np.sqrt(np.float64(f.ray_x * f.ray_x + f.ray_y * f.ray_y))
        fz = SAMPLES * f.depth / view.focal
        fu = fz * reach / max(0.04, -(nx * f.ray_x + ny * f.ray_y) / reach)
        put(f.normal, (nx, ny, 0.0))
        if house.material >= Material.HEDGE:
            put(f.colour, _garden_wall(house, u, z, fu, fz, light))
        else:
            colour, glow, f.gloss = _facade(house, side, u, z, fu, fz, light)
            put(f.colour, colour)
            put(f.glow, glow)
        f.contact = 0.72 + 0.28 * smooth(0.0, 1.6, z)
