"""What the first look at a view compares, and how far its numbers can be trusted.

With ``x = |q|``, ``A = |a|``, ``U = |u|`` and ``M = |u - G a|`` as in :mod:`artifact.ranking.similarity`, a tile reads
``q·c - a_q·u_c - (u_q - G a_q)·a_c`` in float32 (``u = 2⁻²⁴``). Its error is at most the sum of

- the product's own, from :mod:`artifact.ranking.products`;
- ``e (x_q x_c + A_q U_c + M_q A_c)``, ``e = (3 m + 12) u``: m factors are rounded, multiplied and subtracted,
  one by one or several at a time;
- ``M_q A_c`` itself where that term is left out, as for an orthogonal projection, whose remainder is rounding;
- ``8 u (|t| scale + bias)``: rounding of what it is compared with, ``t`` the level of the best positive.

Every term is something of the query times something of the image, so that by Cauchy and Schwarz the sum is at most the
product of two lengths: the *reach* of the query and of the image.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import cached_property

import numpy as np

from artifact.ranking.counting import Groups, Lens, Target
from artifact.ranking.products import Product, TorchProduct
from artifact.ranking.similarity import Best, Looks, Rows, Similarity, View

_UNIT = 2.0**-24
_NEGLIGIBLE = 1e-6  # of a projection
_LONGEST = 2.0**60  # lengths whose products stay finite
_SAMPLED, _POSITIVES = 64, 64  # queries, and positives of each


def lens(
    queries: View,
    images: View,
    kind: Similarity,
    terms: tuple[np.ndarray, np.ndarray],
    limit: np.ndarray,
    before: Lens | None,
) -> Lens:
    """Return what the first look compares, given the product's terms of queries and images and a limit of the levels."""
    x, A, M = (queries.as_query[:, 0], _lengths(queries.a), _lengths(queries.remainder))
    left, right = [queries.a], [images.u]
    kept = bool(M.size) and M.max() > _NEGLIGIBLE * max(A.max(), 1e-300)
    if kept:
        left, right = [*left, queries.remainder], [*right, images.a]
    ours = np.concatenate(left, axis=1).astype(np.float32, order="C")
    theirs = np.concatenate(right, axis=1).T.astype(np.float32, order="C")
    root = np.sqrt((3 * len(theirs) + 12) * _UNIT)
    scale, bias, wrong = _scale_and_bias(images, kind)
    eighth = np.sqrt(8 * _UNIT)
    query_terms = [terms[0], *(root * part[:, None] for part in (x, A)), (M * (root if kept else 1 / root))[:, None]]
    query_terms += [eighth * limit[:, None], np.full((len(x), 1), eighth if kind == "l2" else 0.0)]
    image_terms = [
        terms[1],
        *(root * part[:, None] for part in (images.as_image[:, 0], _lengths(images.u), _lengths(images.a))),
    ]
    image_terms += [eighth * (scale + wrong / (8 * _UNIT))[:, None], eighth * bias[:, None]]
    reaches = []
    for sides, view in ((query_terms, queries), (image_terms, images)):
        reach = _lengths(np.hstack(sides)) * (1 + 2.0**-20)
        longest = np.max([view.as_image[:, 0], _lengths(view.u), _lengths(view.a), _lengths(view.remainder)], axis=0)
        reaches.append(np.where((longest < _LONGEST) & (reach < _LONGEST), reach, np.inf).astype(np.float32))
    return Lens(
        ours,
        theirs,
        _shared(ours, theirs, before),
        scale.astype(np.float32),
        bias.astype(np.float32),
        image_reach=reaches[1],
        query_reach=reaches[0],
        identity=images.rows.identity,
    )


def _shared(left: np.ndarray, right: np.ndarray, before: Lens | None) -> int:
    """Return how many parts the lens before subtracts, if these begin with them: each step of INLP has one more."""
    parts = before.left.shape[1] if before else 0
    same = before and np.array_equal(left[:, :parts], before.left) and np.array_equal(right[:parts], before.right)
    return parts if same else 0


def limits(queries: View, database: View, kind: Similarity) -> np.ndarray:
    """Return what the level of each query's best positive cannot exceed, in absolute value."""
    q, c = (np.sqrt(np.maximum(view.squared + view.doubt, 0.0)) for view in (queries, database))
    if kind == "cosine":
        return 1.01 * q
    return 1.01 * (q * c.max() + (c.max() ** 2 / 2 if kind == "l2" else 0.0))


def target(best: Best, limit: np.ndarray) -> Target:
    """Return the best positives as the first look compares them; one whose level is not known tells nothing."""
    known = best.doubt <= 4 * _UNIT * limit
    return Target(np.where(known, best.level, np.nan).astype(np.float32), best.identity)


def _scale_and_bias(images: View, kind: Similarity) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return scale, bias and the error of both together."""
    ones, zeros = np.ones(len(images.squared)), np.zeros(len(images.squared))
    if kind == "cosine":
        known = images.known
        length = np.sqrt(images.squared, out=zeros.copy(), where=known)
        return length, zeros, np.divide(images.doubt, length, out=np.full_like(ones, np.inf), where=known)
    return (ones, images.squared / 2, images.doubt) if kind == "l2" else (ones, zeros, zeros)


def _lengths(rows: np.ndarray) -> np.ndarray:
    return np.sqrt(np.einsum("nk,nk->n", rows, rows))


class Sample:
    """Some queries and images, to foretell how many pairs a product would leave undecided."""

    def __init__(self, queries: Rows, positives: Groups, looks: Looks, sets: Sequence[View]) -> None:
        """Take some queries, and the levels of their best positives among the images of ``looks``."""
        self._queries, self._looks, self._sets = queries, looks, sets
        self._some = np.linspace(0, len(queries) - 1, min(_SAMPLED, len(queries))).astype(int)
        bounds = positives.starts[self._some], positives.starts[self._some + 1]
        few = [np.linspace(a, b - 1, min(_POSITIVES, b - a)).astype(int) for a, b in zip(*bounds, strict=True)]
        counts = list(map(len, few))
        levels, _ = looks.levels(np.repeat(self._some, counts), positives.members[np.concatenate(few)])
        self._level = np.maximum.reduceat(levels, np.cumsum([0, *counts[:-1]]))

    @cached_property
    def pair_seconds(self) -> float:
        """Seconds of a second look."""
        i, j = np.repeat(self._some, 8), np.resize(self._others(self._looks.images), 8 * len(self._some))
        best = np.inf
        for turn in range(3):
            others = np.roll(j, turn)  # a pair is looked at only once
            start = time.perf_counter()
            self._looks.levels(i, others)
            best = min(best, time.perf_counter() - start)
        return best / len(i)

    def unsure(self, product: Product) -> float:
        """Return how many pairs of all queries and the images of all sets a product leaves undecided."""
        pairs, ours = 0.0, self._lengths_of_terms(product, self._queries, self._some)[0]
        for images, margins in zip(self._sets, self._margins, strict=True):
            theirs = self._lengths_of_terms(product, images.rows, self._others(images))[1]
            share = (margins <= ours[:, None] * theirs).mean()
            pairs += float(share) * len(self._queries) * len(images.rows)
        return pairs

    @staticmethod
    def _lengths_of_terms(product: Product, rows: Rows, some: np.ndarray) -> list[np.ndarray]:
        terms = product.terms(rows.descriptors[some], np.sqrt(rows.squared[some]))
        return [_lengths(side) for side in terms]

    @cached_property
    def _margins(self) -> list[np.ndarray]:
        """The distances of inner products from what they are compared with, of each set."""
        import torch

        found, left = [], torch.from_numpy(self._queries.descriptors[self._some].astype(np.float32))
        for images in self._sets:
            scale, bias, _ = _scale_and_bias(images, self._looks.kind)
            some = self._others(images)
            right = torch.from_numpy(images.rows.descriptors[some].astype(np.float32))
            # Not by NumPy, whose threads go on turning for a while, in the way of the first product.
            product = np.asarray(TorchProduct().multiply(left, right))
            found.append(np.abs(product - np.outer(self._level, scale[some]) - bias[some]))
        return found

    @staticmethod
    def _others(images: View) -> np.ndarray:
        n = len(images.rows)
        return np.linspace(0, n - 1, min(4 * _SAMPLED, n)).astype(int)
