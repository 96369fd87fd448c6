"""Short measured probes of what follows extraction: made descriptors of small size, in a process of their own each.

A rate is seconds for one unit of the known complexity, for example for a pair of images and a dimension. At full size
caches and threads behave a little differently: a prediction is good to a factor of about three.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from artifact.extraction import timing
from artifact.extraction.timing import Trials, best_of
from artifact.studies.how_fast import synthetic

INLP_ITERATIONS = 35

_REVISION = 3  # raise when a probe measures something else: kept rates are measured anew then


def rates(trials: Trials, shapes: Sequence[tuple[int, ...]] = ()) -> dict[str, float | None]:
    """Return seconds for one unit of each kind of work, measured or kept from an earlier plan on this machine.

    Parameters
    ----------
    trials
        Where measurements are kept.
    shapes
        Shapes of the local features whose matching is asked for.

    Returns
    -------
    dict
        ``product`` (a pair of images and a dimension), ``pair``, ``view`` (a pair), ``gram`` (n²·d), ``eigen`` (n³),
        ``inlp`` (n·d and iteration), ``scale`` (n·d), ``probe_dual`` and ``probe_primal`` (n·d, for all four probes),
        ``umap`` (a row and an epoch), ``cosine`` (a pair and a dimension), and ``match`` with each shape (a pair).
        ``None`` where a probe failed.
    """
    found: dict[str, float | None] = {}
    for names, measure, arguments in (
        (("product", "pair", "view"), ranking_rates, ()),
        (("gram", "eigen", "inlp", "scale"), fitting_rates, ()),
        (("probe_dual", "probe_primal"), probing_rates, ()),
        (("umap",), embedding_rate, ()),
        (("cosine",), cosine_rate, ()),
        *(((f"match {shape}",), matching_rate, (shape,)) for shape in shapes),
    ):
        measured = trials(
            partial(_apart, measure, *arguments),
            lambda result: result is None,
            probe=measure.__name__,
            arguments=arguments,
            revision=_REVISION,
        )
        found |= dict(zip(names, measured or [None] * len(names), strict=True))
    return found


def _apart(measure: Any, *arguments: Any) -> list[float] | None:
    try:
        return timing.in_own_process(measure, *arguments, limit=60.0)
    except (TimeoutError, RuntimeError):
        return None


def ranking_rates() -> list[float]:
    """Measure the pass of a ranking: for a pair and dimension, for a pair, and for a pair and view."""
    from artifact.metrics.evaluate import evaluate
    from artifact.suppression.lowrank import LowRankMap

    n, small, large, n_views = 3000, 256, 2048, 4
    pairs = 1.5 * n * n
    basis = np.linalg.qr(np.random.default_rng(1).standard_normal((small, INLP_ITERATIONS)))[0]
    views = {str(view): LowRankMap(basis, basis, np.zeros(INLP_ITERATIONS)) for view in range(n_views)}

    def seconds(dimension: int, views: dict[str, LowRankMap] | None = None) -> float:
        arguments = synthetic(n, n, dimension)
        evaluate(*(values[:64] for values in arguments), 25.0, views=views, device="cpu")  # compiles the kernels
        return best_of(lambda: evaluate(*arguments, 25.0, views=views, device="cpu"), 2)

    plain, wide, viewed = seconds(small), seconds(large), seconds(small, views)
    product = max(0.0, wide - plain) / (pairs * (large - small))
    return [product, max(0.0, plain / pairs - product * small), max(0.0, viewed - plain) / pairs / n_views]


def fitting_rates() -> list[float]:
    """Measure Gram matrix, eigenvectors, the classifiers of INLP, and standardisation."""
    from artifact.suppression.inlp import INLP
    from artifact.suppression.samples import gram_matrix, spectrum
    from artifact.suppression.std import STD

    n, d = 1500, 4096
    X = np.concatenate(synthetic(n // 2, n // 2, d)[:2])
    condition = np.repeat([0, 1], n // 2)
    gram = best_of(lambda: gram_matrix(X, np.zeros(d), None), 2)
    matrix = gram_matrix(X, np.zeros(d), None)
    eigen = best_of(lambda: spectrum(matrix.copy()), 2)
    standard = STD().fit(X, condition)
    scale = best_of(lambda: standard.transform(X, condition))
    few = np.ascontiguousarray(X[:, :512])  # fewer columns than rows: no Gram matrix
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        inlp = best_of(lambda: INLP(INLP_ITERATIONS).fit(few, condition), 1)
    return [gram / n**2 / d, eigen / n**3, inlp / few.size / INLP_ITERATIONS, scale / X.size]


def probing_rates() -> list[float]:
    """Measure the four guardedness probes, with fewer rows than columns and with more: once easy, three times guarded."""
    from artifact.suppression.leace import LEACE
    from artifact.suppression.probe import probe

    found = []
    for n, d in ((1000, 2048), (2000, 512)):  # rows to train on, columns
        queries, database, *places = synthetic(n, n, d)
        few = n // 10  # as many as the paper fits on: what is left of the condition elsewhere is the slow case
        erase = LEACE().fit(np.concatenate([queries[:few], database[:few]]), np.repeat([0, 1], few)).transform
        guarded = erase(queries), erase(database)
        easy = best_of(partial(probe, queries, database, *places, 25.0), 1)
        hard = best_of(partial(probe, *guarded, *places, 25.0), 1)
        found.append((easy + 3 * hard) / (n * d))
    return found


def embedding_rate() -> list[float]:
    """Measure UMAP for a row and an epoch; the first call compiles."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import umap

        rows = np.concatenate(synthetic(750, 750, 128)[:2])
        options = {"metric": "cosine", "random_state": 0, "n_jobs": 1}
        umap.UMAP(n_epochs=10, **options).fit_transform(rows[:200])
        seconds = best_of(lambda: umap.UMAP(n_epochs=200, **options).fit_transform(rows), 1)
    return [seconds / (len(rows) * 200)]


def cosine_rate() -> list[float]:
    """Measure the second stage by descriptors: for a pair and a dimension."""
    from artifact.ranking.matching import cosines

    values, pairs = synthetic(256, 256, 4096)[0], np.repeat(np.arange(256), 64)
    cosines(values, pairs[:1], values, pairs[:1])
    return [best_of(lambda: cosines(values, pairs, values, pairs[::-1])) / (len(pairs) * 4096)]


def matching_rate(shape: tuple[int, ...]) -> list[float]:
    """Measure the second stage by local features of a shape, for a pair of images."""
    from artifact.ranking.matching import LocalMatcher

    features = np.random.default_rng(0).standard_normal((8, *shape), dtype=np.float32)
    features /= np.linalg.norm(features, axis=-1, keepdims=True)
    ones, others = np.repeat([0, 1], 4), np.tile(np.arange(4, 8), 2)
    match = LocalMatcher()
    match(features, ones[:1], features, others[:1])
    return [best_of(lambda: match(features, ones, features, others), 2) / len(ones)]
