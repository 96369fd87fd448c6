"""``artifact bench``: the ranking pass against a bare matrix product, extraction against the model alone."""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from artifact.commands.probes import synthetic
from artifact.datasets import Traversal
from artifact.extraction import forward, reading, shards, timing
from artifact.extraction.timing import best_of, peak_memory
from artifact.manifest import Manifest
from artifact.metrics.evaluate import evaluate
from artifact.suppression.lowrank import LowRankMap

N_QUERIES, N_DATABASE = 6000, 7500
_BLOCK = 1024
_PHOTOGRAPHS = 32


def run(manifest: Manifest) -> Iterator[str]:
    """Yield the measured lines, one experiment at a time."""
    yield from ranking_lines(N_QUERIES, N_DATABASE, 4096)
    yield from view_lines(N_QUERIES // 2, N_DATABASE // 2, 8448, 20)
    yield from extraction_lines(manifest, "efficientnet_lite0", 40)
    yield from extraction_lines(manifest, "mixvpr", 10)


def bare_product(queries: np.ndarray, database: np.ndarray) -> None:
    """Multiply the queries with the database and with themselves, in blocks, and keep nothing."""
    out = np.empty((_BLOCK, max(len(queries), len(database))), np.float32)
    for right in (database, queries):
        for start in range(0, len(queries), _BLOCK):
            block = queries[start : start + _BLOCK]
            np.matmul(block, right.T, out=out[: len(block), : len(right)])


def ranking_lines(n_queries: int, n_database: int, dimension: int) -> Iterator[str]:
    """Time :func:`artifact.evaluate` on the CPU against the bare product over the same pairs."""
    queries, database, where, database_where = synthetic(n_queries, n_database, dimension)
    evaluate(queries[:64], database[:64], where[:64], database_where[:64], 25.0, device="cpu")  # compiles the kernels
    before = peak_memory()
    bare = best_of(lambda: bare_product(queries, database))
    results = []
    pass_seconds = best_of(
        lambda: results.append(evaluate(queries, database, where, database_where, 25.0, device="cpu"))
    )
    extra = (peak_memory() - before) / 2**20
    yield (
        f"ranking {n_queries} queries, {n_database} database images, d = {dimension}: {pass_seconds:.2f} s, bare "
        f"product {bare:.2f} s, ratio {pass_seconds / bare:.2f}; extra memory {extra:.0f} MiB; "
        f"R@1 {results[0].recall():.3f}, DAR@1 {results[0].dar():.3f}, "
        f"{results[0].distractor_counts.outranking.mean():.0f} distractors above the best positive on average"
    )


def view_lines(n_queries: int, n_database: int, dimension: int, n_views: int) -> Iterator[str]:
    """Time a pass with low-rank views against the pass without."""
    queries, database, where, database_where = synthetic(n_queries, n_database, dimension)
    basis = np.linalg.qr(np.random.default_rng(1).standard_normal((dimension, 35)))[0]
    views = {}
    for number in range(n_views):
        k = 1 + number * 34 // max(1, n_views - 1)
        views[str(k)] = LowRankMap(basis[:, :k], basis[:, :k], np.zeros(k))
    args = (queries, database, where, database_where, 25.0)
    single = best_of(lambda: evaluate(*args, device="cpu"))
    several = best_of(lambda: evaluate(*args, device="cpu", views=views))
    yield (
        f"views: {n_views} INLP views of {n_queries} queries, {n_database} database images, d = {dimension}: "
        f"{several:.2f} s, without views {single:.2f} s, ratio {several / single:.2f}"
    )


def extraction_lines(manifest: Manifest, method: str, n_batches: int, device: str | None = None) -> Iterator[str]:
    """Time extraction from JPEG files against the model's own forward rate on the same batches.

    Both rates are taken on warm processes, the model with untrained weights. On the CPU, reading and model share the
    cores: the line also states what share of its rate the model has left if it keeps all cores busy by itself and
    nothing but reading is added.
    """
    entry = manifest.method(method)
    (where,) = forward.devices(device)
    with tempfile.TemporaryDirectory() as name:
        traversal = _photograph_traversal(Path(name), n_batches * entry.batch_size)
        paths = traversal.image_paths()[: entry.batch_size]
        model = timing.untrained(method, entry, where)
        batch, _ = reading.prepare_batch(paths, entry.preprocessing)

        def seconds_alone() -> float:
            repeats = n_batches // 2
            seconds = best_of(lambda: [model(batch)[0].cpu() for _ in range(repeats)], 1)
            return seconds / (repeats * entry.batch_size)

        model(batch)[0].cpu()
        before = seconds_alone()
        moments = [
            (time.perf_counter(), rows.stop)
            for rows, _ in shards.describe(traversal, entry, model, shards.batches(len(traversal), entry.batch_size))
        ]
        alone = (before + seconds_alone()) / 2  # before and after: other work on the machine slows both rates alike
        read = timing.reading_seconds(paths, entry)
    (begun, first), (ended, last) = moments[1], moments[-1]
    rate = (last - first) / (ended - begun)
    cores = os.cpu_count() or 1
    share = f", which alone leaves the model {100 * alone / (alone + read / cores):.0f} % of {cores} busy cores"
    yield (
        f"extraction of {len(traversal)} images with {entry.title} on {where}: {rate:.1f} images/s, the model alone "
        f"{1 / alone:.1f} images/s, {100 * rate * alone:.0f} %; to read an image takes a core {1000 * read:.1f} ms"
        f"{share if where.type == 'cpu' else ''}"
    )


def _photograph_traversal(folder: Path, n: int) -> Traversal:
    names = tuple(f"{index:04d}.jpg" for index in range(n))
    for index, name in enumerate(names):
        if index < _PHOTOGRAPHS:
            timing.photograph(*timing.PHOTOGRAPH, seed=index).save(folder / name, quality=90)
        else:
            shutil.copyfile(folder / names[index % _PHOTOGRAPHS], folder / name)
    return Traversal("bench", "photographs", "none", names, np.arange(n, dtype=np.float64)[:, None], "none", folder)
