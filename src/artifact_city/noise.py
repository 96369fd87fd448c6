"""Hashes and smooth noise: every irregularity of the town that is not stored is a function of these."""

import numpy as np

from artifact_city.kernel import kernel

_A = np.uint64(0x9E3779B97F4A7C15)
_B = np.uint64(0xC2B2AE3D27D4EB4F)
_C = np.uint64(0x165667B19E3779F9)
_D = np.uint64(0xFF51AFD7ED558CCD)
_S1 = np.uint64(32)
_S2 = np.uint64(29)
_S3 = np.uint64(40)
_UNIT = 1.0 / (1 << 24)


@kernel
def hash3(i, j, k):
    """Map three whole numbers to a number in [0, 1) that looks independent of its neighbours.

    They are passed as floats, here and as the seeds below, so that one compiled version serves every caller.
    """
    h = np.uint64(np.int64(i)) * _A + np.uint64(np.int64(j)) * _B + np.uint64(np.int64(k)) * _C
    h = (h ^ (h >> _S1)) * _D
    h = (h ^ (h >> _S2)) * _A
    return np.float64((h ^ (h >> _S1)) >> _S3) * _UNIT


@kernel
def smooth(edge0, edge1, x):
    """Rise smoothly from 0 at ``edge0`` to 1 at ``edge1``; the edges may be in either order."""
    t = min(1.0, max(0.0, (x - edge0) / (edge1 - edge0)))
    return t * t * (3.0 - 2.0 * t)


@kernel
def noise2(x, y, seed):
    """Smooth noise in [0, 1) over the plane, with features of about one unit."""
    i, j = np.floor(x), np.floor(y)
    u, v = x - i, y - j
    u, v = u * u * (3.0 - 2.0 * u), v * v * (3.0 - 2.0 * v)
    low = hash3(i, j, seed) * (1.0 - u) + hash3(i + 1.0, j, seed) * u
    high = hash3(i, j + 1.0, seed) * (1.0 - u) + hash3(i + 1.0, j + 1.0, seed) * u
    return low * (1.0 - v) + high * v


@kernel
def noise3(x, y, z, seed):
    """Smooth noise in [0, 1) over space, with features of about one unit."""
    k = np.floor(z)
    w = z - k
    w = w * w * (3.0 - 2.0 * w)
    layer = seed + 7919.0 * k
    return noise2(x, y, layer) * (1.0 - w) + noise2(x, y, layer + 7919.0) * w


@kernel
def cloud_noise(x, y, seed, octaves):
    """Sum of halving octaves of :func:`noise2`, in [0, 1); each octave is turned so that no lattice shows."""
    total, weight, amplitude = 0.0, 0.0, 1.0
    for octave in range(np.int64(octaves)):
        total += amplitude * noise2(x, y, seed + 101.0 * octave)
        weight += amplitude
        amplitude *= 0.5
        x, y = 1.6 * x - 1.2 * y + 17.3, 1.2 * x + 1.6 * y - 9.1
    return total / weight


@kernel
def cover(x, half, foot):
    """Share of a footprint of width ``foot`` around ``x`` that lies in [-half, half].

    The exact box filter of a bar: the renderer's edges are smoothed with it instead of with more samples.
    """
    f = max(foot, 1e-6)
    return min(1.0, max(0.0, (min(x + 0.5 * f, half) - max(x - 0.5 * f, -half)) / f))


@kernel
def stripes(x, period, width, foot):
    """Box-filtered share of bars of ``width`` that start at each multiple of ``period``.

    Exact for any footprint: it is the difference of the bars' running integral.
    """
    a, b = (x - 0.5 * foot) / period, (x + 0.5 * foot) / period
    share = width / period
    fa, fb = np.floor(a), np.floor(b)
    area = fb * share + min(b - fb, share) - fa * share - min(a - fa, share)
    return min(1.0, max(0.0, area / max((b - a), 1e-9)))
