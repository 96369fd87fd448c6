"""Inner products of float32 rows: in float64, pair by pair, and in whole numbers of any length."""

from __future__ import annotations

from concurrent.futures import Executor
from fractions import Fraction
from math import isqrt

import numpy as np

from artifact.suppression.compiled import compiled

STEP = 512  # columns that are summed by themselves
WIDENED = 2**21  # values of half-precision rows, or of a block of rows, that are widened at a time
ANY_ORDER = {"reassoc", "contract"}  # the bound holds for every order of summation
_LIMB = 18  # bits: products of two, summed over 2¹⁷ columns, stay below 2⁵³
_KEPT = 2**21  # inner products


class Dots:
    """Inner products of queries and images in float64, each computed once: views ask for many of the same pairs."""

    def __init__(self, queries: np.ndarray, images: np.ndarray, executor: Executor) -> None:
        self._queries, self._images, self._executor = queries, images, executor
        self._pairs, self._values = np.zeros(0, np.int64), np.zeros(0)

    def __call__(self, i: np.ndarray, j: np.ndarray) -> np.ndarray:
        """Return the inner products of queries ``i`` and images ``j``."""
        asked, inverse = np.unique(i * len(self._images) + j, return_inverse=True)
        place = np.searchsorted(self._pairs, asked)
        known = np.append(self._pairs, -1)[place] == asked
        values, missing = np.empty(len(asked)), asked[~known]
        values[known] = self._values[place[known]]
        new = np.divmod(missing, len(self._images))
        values[~known] = dots(self._queries, new[0], self._images, new[1], self._executor)
        if len(self._pairs) + len(missing) <= _KEPT:
            self._pairs = np.insert(self._pairs, place[~known], missing)
            self._values = np.insert(self._values, place[~known], values[~known])
        return values[inverse]


def dots(X: np.ndarray, i: np.ndarray, Y: np.ndarray, j: np.ndarray, executor: Executor) -> np.ndarray:
    """Return the inner products ``X[i] · Y[j]`` in float64."""
    out = np.empty(len(i))
    plain = X.dtype == Y.dtype == np.float32 and X.flags.c_contiguous and Y.flags.c_contiguous
    step = max(1, min(2048, -(-len(i) // 8)) if plain else WIDENED // X.shape[1])

    def part(start: int) -> None:
        some = slice(start, start + step)
        if plain:
            _dots(X, i[some], Y, j[some], out[some])
        else:
            left, right = (np.ascontiguousarray(Z[k[some]], np.float32) for Z, k in ((X, i), (Y, j)))
            every = np.arange(len(left))
            _dots(left, every, right, every, out[some])

    list(executor.map(part, range(0, len(i), step)))
    return out


@compiled(fastmath=ANY_ORDER)
def _dots(X: np.ndarray, i: np.ndarray, Y: np.ndarray, j: np.ndarray, out: np.ndarray) -> None:
    for pair in range(i.size):
        out[pair] = _inner(X[i[pair]], Y[j[pair]])


@compiled(fastmath=ANY_ORDER)
def _inner(left: np.ndarray, right: np.ndarray) -> float:
    total = 0.0
    for begin in range(0, left.size, STEP):
        # Slices: only so does the compiler use vectors.
        some, others, part = left[begin : begin + STEP], right[begin : begin + STEP], 0.0
        for column in range(some.size):
            part += np.float64(some[column]) * np.float64(others[column])
        total += part
    return total


@compiled(fastmath=ANY_ORDER)
def squares(block: np.ndarray, out: np.ndarray) -> None:
    """Write the inner products of rows with themselves."""
    for row in range(block.shape[0]):
        out[row] = _inner(block[row], block[row])


def exact_products(X: np.ndarray, Y: np.ndarray) -> np.ndarray:
    """Return ``X @ Y.T`` as an array of :class:`fractions.Fraction`."""
    (left, top_left), (right, top_right) = _limbs(X), _limbs(Y)
    whole = np.einsum("lnd,mkd->lmnk", left, right, optimize=True).astype(np.int64).astype(object)
    total = np.zeros(whole.shape[2:], object)
    last = len(left) + len(right) - 2
    for high, parts in enumerate(whole):
        for low, part in enumerate(parts):
            total = total + part * 2 ** (_LIMB * (last - high - low))
    exponent = top_left + top_right - _LIMB * (last + 2)
    scale = Fraction(2) ** exponent
    return np.array([scale * int(value) for value in total.ravel()], object).reshape(total.shape)


def _limbs(X: np.ndarray) -> tuple[np.ndarray, int]:
    """Cut values into whole numbers of few bits: ``X = Σ limbs[l] 2^(top - 18 (l + 1))``."""
    rest = X.astype(np.float64)
    top = int(np.frexp(np.abs(rest).max(initial=0.0))[1])
    rest, limbs = np.ldexp(rest, -top), list[np.ndarray]()
    while rest.any() or not limbs:
        rest = np.ldexp(rest, _LIMB)
        limbs.append(np.trunc(rest))
        rest = rest - limbs[-1]
    return np.stack(limbs), top


def root(value: Fraction) -> Fraction:
    """Return the square root of the absolute value with the sign, good to 2⁻²⁵⁶ of it or exact."""
    size = abs(value)
    shift = 512 + 2 * max(0, size.denominator.bit_length() - size.numerator.bit_length())
    root = Fraction(isqrt((size.numerator << shift) * size.denominator), size.denominator << (shift // 2))
    return root if value > 0 else -root


def nearest_float32(value: Fraction) -> np.float32:
    """Round to float32, to even in the middle of two."""
    near = float(value)  # the float64 next to it, which may be the middle of two float32 without the value being it
    if Fraction(near) != value and np.float64(near).view(np.int64) & (2**29 - 1) == 2**28:
        near = float(np.nextafter(near, np.inf if value > Fraction(near) else -np.inf))
    return np.float32(near)
