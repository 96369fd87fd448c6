"""The similarity that decides ranks: a real number, never a rounded one.

**Definition.** Stored descriptors are float32 or float16 and a fitted transform ``r(x) = x - L (R' x - o)`` is float64:
all are taken as the real numbers that they are. With ``q`` and ``c`` a query and an image (as the view's transform maps
them), the similarity is ``q·c / (|q| |c|)`` (``cosine``; 0 where a transform leaves nothing of an image), ``q·c``
(``dot``) or ``-|q - c|²`` (``l2``), evaluated without rounding. Which of two images is more similar to a query, and
whether they are equally similar, is then the same on every machine, for every block size, thread count, BLAS and device.
What is stored of a similarity is the float32 next to it; in a view, whose transform is itself the rounded result of a
fit, the float32 next to its float64 value.

**Three looks** decide it, each only where the one before cannot:

1. a fast matrix product with a bound on its error (:mod:`artifact.ranking.products`);
2. float64, pair by pair. The product of two float32 values is exact in float64, so only sums round. A sum of ``n`` terms
   in any order, with or without fused multiply-add, is off by at most ``γ_n Σ|terms|``, ``γ_n = n u / (1 - n u)``,
   ``u = 2⁻⁵³`` (Higham, *Accuracy and Stability of Numerical Algorithms*, 2nd ed. 2002, eq. 3.5), and
   ``Σ|q_i c_i| <= |q| |c|`` by Cauchy and Schwarz. A sum of sums over blocks of ``b`` rounds no term more than
   ``b + d / b`` times, which takes the place of ``n``;
3. whole numbers of any length, from products of pieces of 18 bits that float64 adds without rounding.

Of an image of which a transform leaves no more than float64 can tell from rounding, it leaves nothing: a zero vector.

The low-rank form of a view, with ``a = R'x - o``, ``u = L'x``, ``G = L'L``, is
``r(q)·r(c) = q·c - a_q·u_c - (u_q - G a_q)·a_c``. Each projection is a sum of ``d`` products, so that, in units of ``γ``,
``|δa| <= |R| |x| + |o|``, ``|δu| <= |L| |x|`` (Frobenius norms) and ``|δ(u - G a)| <= |δu| + |G|₂ |δa| + 2 |L|² |a|``;
the error of the inner product follows by Cauchy and Schwarz term by term, and is doubled for what is of second order.

Images of equal bytes are equally similar without any look. Values that are small whole multiples of one power of two (as
codes of -1 and 1) make the second look exact.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from math import frexp, ldexp
from typing import Literal, Protocol

import numpy as np

from artifact.ranking.arithmetic import STEP, WIDENED, Dots, exact_products, nearest_float32, root, squares
from artifact.suppression.compiled import compiled

Similarity = Literal["cosine", "dot", "l2"]

_UNIT = 2.0**-53
_PAIRS = 2**16  # pairs that are looked at together


class LowRank(Protocol):
    """A transform ``r(x) = x - left @ (right.T @ x - offset)`` that can be evaluated as a view."""

    def low_rank(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]: ...  # noqa: D102


@dataclass(frozen=True)
class Rows:
    """Descriptors ``(n, d)`` and what is known of each row: squared length, its class of equal rows, and coarseness.

    ``squared`` is float64; rows of one ``identity`` have equal bytes (in all sets that :func:`described` got together);
    the values of ``coarse`` rows are whole multiples of 2⁻¹² of the power of two above the largest.
    """

    descriptors: np.ndarray
    squared: np.ndarray
    identity: np.ndarray
    coarse: np.ndarray

    def __len__(self) -> int:
        return len(self.squared)


def described(sets: Sequence[np.ndarray], executor: Executor) -> list[Rows]:
    """Look once through sets of descriptors."""
    facts = [_facts(descriptors, executor) for descriptors in sets]
    digests, starts = np.concatenate([found[1] for found in facts]), np.cumsum([0, *map(len, sets)])
    _, first, identity = np.unique(digests, return_index=True, return_inverse=True)

    def row(place: int) -> np.ndarray:
        number = int(np.searchsorted(starts, place, side="right")) - 1
        return sets[number][place - starts[number]]

    for place in np.flatnonzero(first[identity] != np.arange(len(digests))).tolist():
        if not np.array_equal(row(place), row(first[identity[place]])):
            identity[place] = len(digests) + place  # equal digests of different rows
    parts = np.split(identity, starts[1:-1])
    return [Rows(s, found[0], part, found[2]) for s, found, part in zip(sets, facts, parts, strict=True)]


def squared_norms(descriptors: np.ndarray) -> np.ndarray:
    """Return ``(n,)`` float64 squared lengths, a block of rows at a time."""
    squared = np.empty(len(descriptors))
    step = max(1, WIDENED // descriptors.shape[1])
    for start in range(0, len(descriptors), step):
        rows = slice(start, start + step)
        squares(np.ascontiguousarray(descriptors[rows], np.float32), squared[rows])
    return squared


def _facts(descriptors: np.ndarray, executor: Executor) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return squared lengths, digests of the bytes, and which rows are coarse."""
    n, d = descriptors.shape
    squared, digests, coarse = np.empty(n), np.empty(n, np.uint64), np.empty(n, np.bool_)

    def look(start: int) -> None:
        rows = slice(start, start + step)
        block = np.ascontiguousarray(descriptors[rows], np.float32)
        squares(block, squared[rows])
        _digests(block, block.view(np.uint32), digests[rows], coarse[rows])

    step = max(1, WIDENED // d)
    list(executor.map(look, range(0, n, step)))
    return squared, digests, coarse


@compiled()
def _digests(block: np.ndarray, bits: np.ndarray, digests: np.ndarray, coarse: np.ndarray) -> None:
    for row in range(block.shape[0]):
        digest, largest = np.uint64(0), np.float32(0)
        for column in range(block.shape[1]):
            digest += np.uint64(bits[row, column]) * (np.uint64(0x9E3779B97F4A7C15) * np.uint64(2 * column + 1))
            largest = max(largest, abs(block[row, column]))
        digests[row] = digest
        scale = ldexp(1.0, 12 - frexp(np.float64(largest))[1])
        fine = 0
        for column in range(block.shape[1]):
            scaled = np.float64(block[row, column]) * scale
            fine += scaled != np.floor(scaled)
        coarse[row] = fine == 0


class Transform:
    """A low-rank map in float64, with the constants of its error bounds, and in exact numbers when asked."""

    def __init__(self, left: np.ndarray, right: np.ndarray, offset: np.ndarray) -> None:
        self.left, self.right, self.offset = (np.asarray(part, np.float64) for part in (left, right, offset))
        self.gram = _product(self.left.T, self.left)
        spectral = np.linalg.norm(self.gram, 2) if self.gram.size else 0.0
        self.norms = *(float(np.linalg.norm(part)) for part in (self.left, self.right, self.offset)), float(spectral)

    @cached_property
    def exact_gram(self) -> np.ndarray:
        """Return ``left' left`` as rational numbers."""
        return exact_products(self.left.T, self.left.T)

    def exact(self, row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return ``R'x - o`` and ``L'x`` as rational numbers."""
        right, left = exact_products(row[None], self.right.T)[0], exact_products(row[None], self.left.T)[0]
        return right - np.array([Fraction(value) for value in self.offset.tolist()], object), left


@dataclass(frozen=True)
class View:
    """Images as a transform shows them; ``a``, ``u`` and ``remainder`` ``(n, k)`` as in the notes of this module.

    ``squared`` is ``|r(x)|²``, wrong by at most ``doubt``. With ``q`` and ``c`` of this view,
    ``unit * (as_query[q] @ as_image[c])`` bounds the error of their inner product.
    """

    rows: Rows
    transform: Transform | None
    a: np.ndarray
    u: np.ndarray
    remainder: np.ndarray
    squared: np.ndarray
    doubt: np.ndarray
    as_query: np.ndarray
    as_image: np.ndarray
    unit: float

    @cached_property
    def known(self) -> np.ndarray:
        """Tell which images have a length that float64 tells from rounding; of others a transform leaves nothing."""
        return self.squared > 4 * self.doubt

    @cached_property
    def nothing(self) -> np.ndarray:
        """Tell of which images the transform leaves no more than float64 rounds: they count as zero."""
        return np.zeros(len(self.rows), bool) if self.transform is None else ~self.known

    def over_length(self, value: np.ndarray, doubt: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Divide values by the lengths of rows; the bound on the error is infinite where the length is not known."""
        known, wrong = self.known[rows], self.doubt[rows]
        length = np.sqrt(self.squared[rows], out=np.ones(len(rows)), where=known)
        value = np.where(known, value / length, 0.0)
        doubt = doubt / length + np.abs(value) * (wrong / length / length + 4 * _UNIT)
        return value, np.where(known, doubt, np.inf)


def views_of(rows: Rows, transforms: Mapping[str, Transform | None]) -> dict[str, View]:
    """Project images once for all views."""
    n, d = rows.descriptors.shape
    x = np.sqrt(rows.squared)
    sums = STEP + -(-d // STEP)
    found = {}
    project = _projector(rows.descriptors, [t for t in transforms.values() if t])
    for name, transform in transforms.items():
        if transform is None:
            none, unit = np.zeros((n, 0)), 2 * (sums + 2) * _UNIT
            doubt = np.where(rows.coarse, 0.0, unit * rows.squared)
            found[name] = View(rows, None, none, none, none, rows.squared, doubt, x[:, None], x[:, None], unit)
            continue
        unit = 4 * (sums + 2 * len(transform.offset) + 8) * _UNIT
        u, a = project(transform.left), project(transform.right) - transform.offset
        remainder = u - a @ transform.gram
        squared = rows.squared - np.einsum("nk,nk->n", a, u) - np.einsum("nk,nk->n", remainder, a)
        A, U, M = (np.sqrt(np.einsum("nk,nk->n", part, part)) for part in (a, u, remainder))
        left, right, offset, gram = transform.norms
        error_a, error_u = right * x + offset, left * x
        error_m = error_u + gram * error_a + 2 * left**2 * A
        as_query = np.stack([x, A + error_a, A, M + error_m, M], axis=1)
        as_image = np.stack([x, U, error_u, A, error_a], axis=1)
        doubt = unit * np.einsum("nt,nt->n", as_query, as_image)
        nothing = squared <= 4 * doubt
        squared[nothing] = doubt[nothing] = 0.0
        found[name] = View(rows, transform, a, u, remainder, squared, doubt, as_query, as_image, unit)
    return found


def _projector(descriptors: np.ndarray, transforms: list[Transform]) -> Callable[[np.ndarray], np.ndarray]:
    """Multiply descriptors once with all directions that differ: INLP's views share theirs."""
    places: dict[bytes, int] = {}
    seen: dict[tuple[int, ...], int] = {}  # many are the same piece of memory, which needs no second comparison

    def place(column: np.ndarray) -> int:
        key = column.__array_interface__["data"][0], *column.strides
        if key not in seen:
            seen[key] = places.setdefault(column.tobytes(), len(places))
        return seen[key]

    bases = [basis for transform in transforms for basis in (transform.left, transform.right)]
    columns = {id(basis): [place(column) for column in basis.T] for basis in bases}
    directions = np.array([np.frombuffer(column) for column in places]).reshape(len(places), descriptors.shape[1])
    out = np.empty((len(descriptors), len(places)))
    step = max(1, WIDENED // descriptors.shape[1])
    for start in range(0, len(descriptors) if places else 0, step):
        out[start : start + step] = _product(descriptors[start : start + step], directions.T)
    return lambda basis: out[:, columns[id(basis)]]


def _product(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return a matrix product in float64 that sums blocks of columns by themselves."""
    out, wide = np.zeros((left.shape[0], right.shape[1])), np.empty((left.shape[0], min(STEP, left.shape[1])))
    for start in range(0, left.shape[1], STEP):
        some = left[:, start : start + STEP]
        wide[:, : some.shape[1]] = some
        out += wide[:, : some.shape[1]] @ right[start : start + STEP]
    return out


class Looks:
    """The second and third look at pairs of queries and images of one set, in one view.

    A *level* is what orders images for a query: ``q·c / |c|``, ``q·c``, or ``q·c - |c|² / 2`` for ``l2``.
    """

    def __init__(self, queries: View, images: View, kind: Similarity, dots: Dots) -> None:
        self.queries, self.images, self.kind, self._dots = queries, images, kind, dots
        self._exact_keys: dict[tuple[int, int], Fraction] = {}  # few, but for many duplicates

    def identities(self, j: np.ndarray) -> np.ndarray:
        """Return the classes of equal rows of some images."""
        return self.images.rows.identity[j]

    def table(self, rows: slice) -> np.ndarray:
        """Return the float32 next to all similarities of some queries, ``(rows, images)``, in the original view."""
        number, n = np.arange(len(self.queries.rows))[rows], len(self.images.rows)
        i, j = np.repeat(number, n), np.tile(np.arange(n), len(number))
        products = _product(self.queries.rows.descriptors[rows], self._widened.T)
        return self.rounded(i, j, *self._levels(i, j, products.ravel())).reshape(products.shape)

    @cached_property
    def _widened(self) -> np.ndarray:
        return self.images.rows.descriptors.astype(np.float64)

    def levels(self, i: np.ndarray, j: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the ``(m,)`` float64 levels of pairs, and a bound on the error of each, infinite if nothing is known."""
        parts = [self._levels(i[s : s + _PAIRS], j[s : s + _PAIRS]) for s in range(0, max(1, len(i)), _PAIRS)]
        return np.concatenate([level for level, _ in parts]), np.concatenate([doubt for _, doubt in parts])

    def _levels(self, i: np.ndarray, j: np.ndarray, value: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        queries, images = self.queries, self.images
        if value is None:
            value = self._dots(i, j)
        value -= np.einsum("nk,nk->n", queries.a[i], images.u[j])
        value -= np.einsum("nk,nk->n", queries.remainder[i], images.a[j])
        doubt = queries.unit * np.einsum("nt,nt->n", queries.as_query[i], images.as_image[j])
        if images.transform is None:
            doubt[queries.rows.coarse[i] & images.rows.coarse[j]] = 0.0
        zero = queries.nothing[i] | images.nothing[j]
        value[zero] = doubt[zero] = 0.0
        if self.kind == "cosine":
            value, doubt = images.over_length(value, doubt, j)
            doubt[zero] = 0.0
        elif self.kind == "l2":
            value = value - images.squared[j] / 2
            doubt = doubt + images.doubt[j] / 2 + 2 * _UNIT * np.abs(value)
        return value, 1.01 * doubt

    def exact(self, i: int, j: int) -> Fraction:
        """Return what orders images as their levels do, exactly: for cosine the square of the level, with its sign."""
        pair = int(self.queries.rows.identity[i]), int(self.images.rows.identity[j])
        if pair not in self._exact_keys:
            self._exact_keys[pair] = self._key(i, j)
        return self._exact_keys[pair]

    def _key(self, i: int, j: int) -> Fraction:
        value, squared = self._exact(self.queries, i, self.images, j), self._exact(self.images, j, self.images, j)
        if self.kind == "cosine":
            return value * abs(value) / squared if squared else Fraction(0)
        return value - squared / 2 if self.kind == "l2" else value

    @staticmethod
    def _exact(left: View, i: int, right: View, j: int) -> Fraction:
        """Return the inner product of two images of a view as a rational number."""
        if left.nothing[i] or right.nothing[j]:
            return Fraction(0)
        q, c = left.rows.descriptors[i], right.rows.descriptors[j]
        if left.rows.coarse[i] and right.rows.coarse[j]:
            value = Fraction(float(q.astype(np.float64) @ c.astype(np.float64)))
        else:
            value = exact_products(q[None], c[None])[0, 0]
        if left.transform is not None and left.transform.offset.size:
            (aq, uq), (ac, uc) = left.transform.exact(q), left.transform.exact(c)
            value = value - aq @ uc - ac @ uq + aq @ (left.transform.exact_gram @ ac)
        return value

    def signs(self, i: np.ndarray, j: np.ndarray, best: Best, positives: Looks) -> tuple[np.ndarray, int]:
        """Tell whether images are above (1), equal to (0) or below (-1) the best positives; and how often exactly."""
        level, doubt = self.levels(i, j)
        difference = level - best.level[i]
        signs = np.sign(difference).astype(np.int8)
        both = doubt + best.doubt[i]
        undecided = np.flatnonzero(~((np.abs(difference) > both) | (both == 0)))
        for pair in undecided:
            query, image = int(i[pair]), int(j[pair])
            equal = self.images.rows.identity[image] == best.identity[query]
            difference_exact = 0 if equal else self.exact(query, image) - positives.exact(query, int(best.index[query]))
            signs[pair] = (difference_exact > 0) - (difference_exact < 0)
        return signs, len(undecided)

    def rounded(self, i: np.ndarray, j: np.ndarray, level: np.ndarray, doubt: np.ndarray) -> np.ndarray:
        """Return the float32 next to each similarity of known level: whatever machine computes it, but for views."""
        if self.kind == "cosine":
            level, doubt = self.queries.over_length(level, doubt, i)
        elif self.kind == "l2":
            level = 2 * level - self.queries.squared[i]
            doubt = 2 * doubt + self.queries.doubt[i] + 2 * _UNIT * np.abs(level)
        out = level.astype(np.float32)
        if self.queries.transform is None:
            low, high = level - 1.01 * doubt, level + 1.01 * doubt
            for pair in np.flatnonzero(~(low.astype(np.float32) == high.astype(np.float32))):
                out[pair] = self._rounded(int(i[pair]), int(j[pair]))
        return out + np.float32(0)  # zero has no sign

    def _rounded(self, i: int, j: int) -> np.float32:
        key, squared = self.exact(i, j), self._exact(self.queries, i, self.queries, i)
        if self.kind == "cosine":
            return nearest_float32(root(key / squared) if squared else Fraction(0))
        return nearest_float32(2 * key - squared if self.kind == "l2" else key)


@dataclass(frozen=True)
class Best:
    """Each query's best positive: its ``index`` (the first of equal ones), ``identity``, ``level``, and its ``doubt``."""

    index: np.ndarray
    identity: np.ndarray
    level: np.ndarray
    doubt: np.ndarray

    @classmethod
    def empty(cls, n: int) -> Best:
        """Return places for ``n`` queries."""
        return cls(np.full(n, -1, np.int64), np.full(n, -1, np.int64), np.zeros(n), np.zeros(n))

    def find(self, i: np.ndarray, j: np.ndarray, looks: Looks) -> None:
        """Choose among candidates ``j`` of queries ``i``, sorted by both."""
        level, doubt = looks.levels(i, j)
        start = np.flatnonzero(np.r_[True, i[1:] != i[:-1]])
        sure = np.repeat(np.maximum.reduceat(level - doubt, start), np.diff(np.r_[start, len(i)]))
        kept = np.flatnonzero(~(level + doubt < sure))
        # The first of equal rows stands for all of them.
        identity = looks.identities(j[kept])
        kept = np.sort(kept[np.unique(i[kept] * (identity.max(initial=0) + 1) + identity, return_index=True)[1]])
        queries, first, count = np.unique(i[kept], return_index=True, return_counts=True)
        chosen = kept[first]
        for place in np.flatnonzero(count > 1):
            rivals = kept[first[place] : first[place] + count[place]]
            chosen[place] = max(rivals, key=lambda r: (looks.exact(int(i[r]), int(j[r])), -j[r]))
        self.index[queries], self.identity[queries] = j[chosen], looks.identities(j[chosen])
        self.level[queries], self.doubt[queries] = level[chosen], doubt[chosen]
