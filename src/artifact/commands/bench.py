"""``artifact bench``: the ranking pass against a bare matrix product, extraction against the model alone."""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd

from artifact.datasets import Traversal
from artifact.extraction import forward, jobs, reading, timing
from artifact.extraction.timing import best_of
from artifact.manifest import Manifest
from artifact.studies.how_fast import (
    Made,
    growth,
    memory_beyond_inputs,
    ranking_times,
    symmetry_limit,
    synthetic,
    tiled,
)

N_QUERIES, N_DATABASE = 6000, 7500
_PHOTOGRAPHS = 32


def run(manifest: Manifest) -> Iterator[str]:
    """Yield the measured lines, one experiment at a time."""
    yield from ranking_lines("made descriptors", synthetic(N_QUERIES, N_DATABASE, 4096))
    yield from ranking_lines("Gardens Point, repeated with noise", tiled(N_QUERIES, N_DATABASE))
    yield from ranking_lines("made descriptors", synthetic(N_QUERIES // 2, N_DATABASE // 2, 8448), 20)
    yield from growth_lines([2000, 4000, 8000], 8448)
    yield from extraction_lines(manifest, "efficientnet_lite0", 40)
    yield from extraction_lines(manifest, "mixvpr", 10)


def ranking_lines(title: str, made: Made, n_views: int = 0) -> Iterator[str]:
    """Time rankings on the CPU against the bare product over the same pairs and against faiss, if it is installed."""
    times, (queries, database) = ranking_times(made, n_views=n_views), made[:2]
    limit = symmetry_limit(len(queries), len(database))
    sizes = f"{len(queries)} queries, {len(database)} database images, d = {queries.shape[1]}"
    yield f"ranking of {title}, {sizes}; symmetry leaves {limit:.2f} of the pairs; {times['processor'].iloc[0]}"
    for row in times.itertuples():
        looks = ""
        if not pd.isna(row.pairs):
            looks = f"; of {row.pairs:.0f} pairs {row.second:.0f} in float64, {row.third:.0f} exactly; {row.product}"
        yield f"  {row.work}: {row.seconds:.2f} s, {row.share:.2f} of the bare product{looks}"


def growth_lines(sizes: list[int], dimension: int) -> Iterator[str]:
    """Time rankings of growing size, and measure the memory that the largest takes."""
    for row in growth(sizes, dimension).itertuples():
        rate = 1e9 * row.seconds / row.pairs
        yield f"ranking {row.images} + {row.images} images, d = {dimension}: {row.seconds:.1f} s, {rate:.0f} ns a pair"
    yield f"  the last takes {memory_beyond_inputs(sizes[-1], dimension) / 2**20:.0f} MiB beyond the descriptors"


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
        batches = jobs.batches(traversal.image_paths(), entry.batch_size)
        moments = [time.perf_counter() for _ in jobs.describe(batches, model, "photographs")]
        alone = (before + seconds_alone()) / 2  # before and after: other work on the machine slows both rates alike
        read = timing.reading_seconds(paths, entry)
    rate = (len(moments) - 2) * entry.batch_size / (moments[-1] - moments[1])
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
