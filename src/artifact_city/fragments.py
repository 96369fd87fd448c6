"""Fragments: the parts of pixels that one surface covers, between tracing and lighting."""

import numpy as np

from artifact_city.kernel import kernel, layout
from artifact_city.trace import BUILDING, GROUND, LEAF, SKY, THING
from artifact_city.view import SAMPLES, horizon_at, ray_of

# One surface in one pixel: where it is, and after painting what it looks like. ``share`` is that of the pixel; ``ray`` and
# ``slope`` are displacements per unit of depth; ``hidden`` and ``blocked`` the shares of sky and sun that some thing keeps
# away; ``gloss`` is the strength of the mirror image of the sky, ``contact`` a factor on all light (corners and
# undersides), ``leaf`` the share of direct light that a leaf takes up.
FRAGMENT = layout(
    "row:i column:i code:i share depth x y z ray_x ray_y slope hidden blocked normal:3 colour:3 glow:3 gloss contact leaf",
    real="f4",
    whole="i4",
)

# Kinds of surface, in the order of the rows of ``index`` below.
K_SKY, K_GROUND, K_WALL, K_ROOF, K_LEAF, K_THING = range(6)
N_KINDS = 6


@kernel
def gather(view_record, surface, depth, blocked, rows, columns, fragments, index, counts):
    """Turn samples into fragments; count those of each kind in ``counts`` and list them in ``index`` (kinds, fragments).

    Samples of one pixel that see the same surface become one fragment at their mean position: textures are filtered
    analytically, so only the outlines of surfaces need several samples. ``blocked``, uint8 (columns, rows, 2), has the
    shares of sky and sun kept away by small things, of 255.
    """
    view = view_record[0]
    n = SAMPLES * SAMPLES
    codes, seen, sums = np.empty(n, np.int64), np.empty(n, np.int64), np.empty((n, 5))
    for kind in range(N_KINDS):
        counts[kind] = 0
    total = 0
    for row in range(rows):
        for column in range(columns):
            kinds = 0
            for k in range(n):
                c, r = SAMPLES * column + k // SAMPLES, SAMPLES * row + k % SAMPLES
                code = np.int64(surface[c, r])
                at = 0
                while at < kinds and codes[at] != code:
                    at += 1
                if at == kinds:
                    codes[at], seen[at] = code, 0
                    for m in range(5):
                        sums[at, m] = 0.0
                    kinds += 1
                seen[at] += 1
                sums[at, 0] += c + 0.5
                sums[at, 1] += r + 0.5
                sums[at, 2] += 1.0 / depth[c, r]
                sums[at, 3] += blocked[c, r, 0] * (1.0 / 255.0)
                sums[at, 4] += blocked[c, r, 1] * (1.0 / 255.0)
            for at in range(kinds):
                code, m = codes[at], seen[at]
                kind = K_THING
                if code == SKY:
                    kind = K_SKY
                elif code == GROUND:
                    kind = K_GROUND
                elif code < LEAF:
                    kind = K_WALL if ((code - BUILDING) & 15) < 4 else K_ROOF
                elif code < THING:
                    kind = K_LEAF
                x, y, far = sums[at, 0] / m, sums[at, 1] / m, m / sums[at, 2]
                ray_x, ray_y = ray_of(view, x)
                slope = (horizon_at(view, x) - y) / view.focal
                f = fragments[total]
                f.row, f.column, f.code, f.share, f.depth = row, column, code, m / n, far
                f.x, f.y, f.z = view.x + far * ray_x, view.y + far * ray_y, view.z + far * slope
                f.ray_x, f.ray_y, f.slope = ray_x, ray_y, slope
                f.hidden, f.blocked = sums[at, 3] / m, sums[at, 4] / m
                for k in range(3):
                    f.normal[k], f.glow[k] = 0.0, 0.0
                f.gloss, f.contact, f.leaf = 0.0, 1.0, 0.0
                index[kind, counts[kind]] = total
                counts[kind] += 1
                total += 1
