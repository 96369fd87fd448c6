"""Openings in facades: windows, doors, gates, arcades and shop fronts, and what shines out of them."""

import numpy as np

from artifact_city.kernel import kernel
from artifact_city.lettering import DOTS, LENGTHS
from artifact_city.noise import cover, hash3, noise2, smooth, stripes


@kernel
def mix(r, g, b, colour, share):
    """Blend a colour over another."""
    return r + share * (colour[0] - r), g + share * (colour[1] - g), b + share * (colour[2] - b)


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
def _lamp_tone(draw):
    """Colour of the light behind a lit window."""
    if draw < 0.6:
        return 1.0, 0.66, 0.32
    if draw < 0.9:
        return 1.0, 0.80, 0.52
    return 0.75, 0.85, 1.0


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
    bar = 0.035
    if kind in (1, 5):
        return min(1.0, cover(x, bar, fu) + cover(y - 0.66 * height, bar, fz))
    if kind == 2:
        return min(1.0, cover(y - 0.5 * height, bar + 0.01, fz) + 0.6 * cover(abs(x) - 0.33 * half, 0.02, fu))
    if kind == 3:
        return min(1.0, cover(x, bar, fu) + cover(y - height + half, bar, fz))
    if kind == 4:
        return cover(x - half * (0.0 if half < 1.0 else 0.34), bar, fu)
    if kind == 6:
        return min(1.0, cover(x, bar + 0.015, fu) + cover(y - 0.8 * height, bar, fz))
    if kind == 7:
        return min(1.0, stripes(x + half, 0.4, 0.05, fu) + stripes(y, 0.6, 0.04, fz))
    return cover(x, bar, fu)


@kernel
def window(house, kind, x, y, half, height, key, fu, fz, light, r, g, b_):
    """Paint one window over a wall colour.

    ``x`` from the window's centre, ``y`` from its foot, ``key`` identifies it. Returns colour, emission, glass.
    """
    trim, accent = house.trim, house.accent
    arched = kind in (3, 7)
    ornament = house.ornament
    if ornament & 8 or kind == 7:
        share = _pane(x, y + 0.14, half + 0.15, height + 0.3, arched, 0.0, fu, fz)
        r, g, b_ = mix(r, g, b_, trim, share)
    if kind == 5:  # shutters
        wing = cover(abs(x) - half - 0.26, 0.25, fu) * cover(y - 0.5 * height, 0.5 * height + 0.03, fz)
        louvre = 0.75 + 0.25 * stripes(y, 0.12, 0.07, fz)
        r += wing * (accent[0] * louvre - r)
        g += wing * (accent[1] * louvre - g)
        b_ += wing * (accent[2] * louvre - b_)
    if kind not in (6, 8):
        sill = cover(x, half + 0.1, fu) * cover(y + 0.06, 0.06, fz)
        under = cover(x, half + 0.1, fu) * cover(y + 0.19, 0.07, fz)
        r, g, b_ = r * (1 - 0.35 * under), g * (1 - 0.35 * under), b_ * (1 - 0.35 * under)
        white = min(0.8, 1.3 * light.snow)
        r += sill * (trim[0] * (1 - white) + white * 0.85 - r)
        g += sill * (trim[1] * (1 - white) + white * 0.87 - g)
        b_ += sill * (trim[2] * (1 - white) + white * 0.9 - b_)
    frame = _pane(x, y, half, height, arched, 0.0, fu, fz)
    if frame <= 0.0:
        return r, g, b_, 0.0, 0.0, 0.0, 0.0
    dark_frame = kind in (4, 8)
    tone = accent if hash3(house.seed, 5.0, 1.0) < 0.35 and not dark_frame else trim
    shade = 0.12 if dark_frame else 0.9
    r += frame * (tone[0] * shade - r)
    g += frame * (tone[1] * shade - g)
    b_ += frame * (tone[2] * shade - b_)
    border = 0.04 if dark_frame else 0.075
    pane = _pane(x, y, half, height, arched, border, fu, fz)
    pane *= 1.0 - 0.9 * _mullions(kind, x, y, half, height, fu, fz)
    reveal = 1.0 - 0.55 * smooth(0.22, 0.0, height - y) - 0.25 * smooth(0.16, 0.0, half - abs(x))
    draw = hash3(key, house.seed, 11.0)
    cloth = _cloth(x, y, half, height, draw, fu) if kind != 7 else 0.0
    inner = (0.035 + 0.05 * hash3(key, 3.0, house.seed)) * reveal
    white = 0.38 * cloth * reveal
    r += pane * (inner + white * 1.0 - r)
    g += pane * (inner + white * 0.97 - g)
    b_ += pane * (inner * 1.1 + white * 0.9 - b_)
    er, eg, eb = 0.0, 0.0, 0.0
    if light.lit > 0.0:
        share = light.lit if kind != 7 else 0.5 * light.lit
        if hash3(key, house.seed, light.lit_seed) < share:
            er, eg, eb = _lamp_tone(hash3(key, house.seed, 29.0))
            power = (0.45 + 0.9 * hash3(key, house.seed, 31.0)) * (0.55 + 0.45 * y / height)
            power *= (1.0 - 0.45 * cloth) * reveal * pane * (0.35 + 0.65 * light.dark)
            room = 0.75 + 0.5 * noise2(x * 2.3 + key, y * 1.7, 41.0)
            er, eg, eb = er * power * room, eg * power * room, eb * power * room
    return r, g, b_, er, eg, eb, pane


@kernel
def shop(house, side, u, z, length, height, fu, fz, light, r, g, b_):
    """Paint a shop front. Returns colour, emission, glass."""
    sign, accent, trim = house.sign, house.accent, house.trim
    seed = house.seed + 7 * side + (5003 if light.past else 0)
    er, eg, eb, glass = 0.0, 0.0, 0.0, 0.0
    front = cover(u - 0.5 * length, 0.5 * length - 0.18, fu) * smooth(height + 0.02, height - 0.02, z)
    r, g, b_ = mix(r, g, b_, accent, 0.9 * front)
    opened = light.lit > 0.0 and hash3(seed, light.lit_seed, 3.0) < 0.45 + 0.25 * light.dark
    # The band with the name.
    low, high = height - 0.95, height - 0.3
    band = front * cover(z - 0.5 * (low + high), 0.5 * (high - low), fz)
    letters = _letters(u - 0.5 * length, z - low, length, high - low, fu, fz, seed)
    pale = 0.85 if sign[0] + sign[1] + sign[2] < 1.1 else 0.04
    r += band * (sign[0] + letters * (pale - sign[0]) - r)
    g += band * (sign[1] + letters * (pale - sign[1]) - g)
    b_ += band * (sign[2] + letters * (pale * 0.93 - sign[2]) - b_)
    if opened and light.dark > 0.0:
        glow = band * (0.25 + 0.9 * letters)
        er, eg, eb = er + glow * (sign[0] + 0.25), eg + glow * (sign[1] + 0.2), eb + glow * (sign[2] + 0.15)
    r, g, b_ = mix(r, g, b_, trim, front * cover(z - height + 0.12, 0.14, fz))
    # Panes, with a door in one of them.
    count = max(1, np.int64((length - 0.5) / 2.3))
    step = (length - 0.5) / count
    k = min(count - 1, max(0, np.int64((u - 0.25) / step)))
    x = u - 0.25 - (k + 0.5) * step
    door = k == np.int64(hash3(seed, 1.0, 1.0) * count)
    foot = 0.08 if door else 0.5
    half = 0.5 * step - 0.12
    pane = cover(x, half, fu) * cover(z - 0.5 * (foot + low - 0.12), 0.5 * (low - 0.12 - foot), fz)
    if door:
        pane *= 1.0 - cover(abs(x) - 0.52, 0.06, fu)
        pane *= 1.0 - cover(z - 2.15, 0.05, fz)
    if pane > 0.0:
        shelf = np.floor(z / 0.55)
        item = np.floor(u / 0.42 + 0.5 * shelf)
        a = hash3(item, shelf, seed)
        goods = 0.10 + 0.35 * a if z < 1.9 and not door else 0.07
        fade = smooth(0.5, 1.2, fu)
        goods = goods * (1 - fade) + 0.16 * fade
        hue = hash3(item, shelf, seed + 1)
        gr, gg, gb = goods * (0.6 + 0.8 * hue), goods * (1.15 - 0.5 * abs(hue - 0.5)), goods * (1.3 - 0.8 * hue)
        r, g, b_ = r + pane * (0.4 * gr - r), g + pane * (0.4 * gg - g), b_ + pane * (0.4 * gb - b_)
        if opened:
            power = pane * (0.25 + 1.15 * light.dark) * (0.6 + 0.5 * z / height)
            er += power * (0.55 + gr)
            eg += power * (0.45 + gg)
            eb += power * (0.28 + gb)
        glass = pane
    shade = 1.0 - 0.3 * smooth(0.5, 0.0, low - z) if z < low else 1.0
    return r * shade, g * shade, b_ * shade, er, eg, eb, glass


@kernel
def _letters(x, y, length, height, fu, fz, seed):
    """Share of lettering at a point of a sign board, measured from its middle and its lower edge."""
    name = np.int64(hash3(seed, 4.0, 4.0) * len(LENGTHS))
    count = LENGTHS[name]
    size = min(0.62 * height, 0.85 * length / (0.95 * count))
    pitch = 0.95 * size
    half = 0.5 * pitch * count
    row = (y - 0.5 * (height - size)) / size * 5.0
    if abs(x) >= half or row < 0.0 or row >= 5.0:
        return 0.0
    place = np.int64((x + half) / pitch)
    dot = ((x + half) / pitch - place) * 6.0
    far = smooth(0.08, 0.26, max(fu, fz))
    on = 0.0
    if dot < 5.0 and (DOTS[name, place, 4 - np.int64(row)] >> (4 - np.int64(dot))) & 1:
        on = 1.0
    return on * (1.0 - far) + 0.42 * far


@kernel
def arcade(house, x, z, half, height, key, fu, fz, light, r, g, b_):
    """Paint an arch with darkness, or dim light, behind it. Returns colour and emission."""
    arch = _pane(x, z, half, height, True, 0.0, fu, fz)
    r, g, b_ = mix(r, g, b_, house.trim, _pane(x, z, half + 0.16, height + 0.16, True, 0.0, fu, fz))
    deep = 0.05 + 0.05 * z / height
    r, g, b_ = r + arch * (deep * 1.1 - r), g + arch * (deep - g), b_ + arch * (deep * 0.9 - b_)
    glow = arch * 0.5 * light.dark * hash3(key, house.seed, 61.0)
    return r, g, b_, glow, 0.7 * glow, 0.35 * glow


@kernel
def door(house, x, z, half, height, gate, fu, fz, light, r, g, b_):
    """Paint a door with a fanlight, or a gate of planks. Returns colour, emission, share of glass."""
    accent = house.accent
    around = cover(x, half + 0.14, fu) * cover(z - 0.5 * height, 0.5 * height + 0.14, fz)
    r, g, b_ = mix(r, g, b_, house.trim, around)
    leaf = cover(x, half, fu) * cover(z - 0.5 * height, 0.5 * height, fz)
    if gate:
        tone = 1.0 - 0.35 * stripes(x + half, 0.24, 0.04, fu) - 0.3 * cover(x, 0.03, fu)
    else:
        tone = 0.8 + 0.35 * cover(abs(x) - 0.5 * half, 0.3 * half, fu) * stripes(z - 0.25, 0.9, 0.65, fz)
    tone *= smooth(0.0, 0.3, z) * 0.3 + 0.7
    r, g, b_ = r + leaf * (accent[0] * tone - r), g + leaf * (accent[1] * tone - g), b_ + leaf * (accent[2] * tone - b_)
    step = cover(x, half + 0.2, fu) * cover(z - 0.05, 0.08, fz)
    r, g, b_ = r + step * (0.35 - r), g + step * (0.34 - g), b_ + step * (0.32 - b_)
    if gate or house.ground_height < 2.95:
        return r, g, b_, 0.0, 0.0, 0.0, 0.0
    over = _pane(x, z - height - 0.05, half, min(0.55, house.ground_height - 2.75), False, 0.04, fu, fz)
    r, g, b_ = r + over * (0.05 - r), g + over * (0.05 - g), b_ + over * (0.055 - b_)
    glow = 0.8 * over * light.dark if hash3(house.seed, light.lit_seed, 5.0) < 1.3 * light.lit else 0.0
    return r, g, b_, glow, 0.7 * glow, 0.38 * glow, over
