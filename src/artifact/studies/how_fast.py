"""What ranking costs, beside a bare matrix product over the same pairs and beside faiss, in one run."""

from __future__ import annotations

import platform
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from artifact.datasets import shipped
from artifact.extraction import timing
from artifact.metrics.evaluate import evaluate
from artifact.ranking import products
from artifact.ranking.one_pass import Work
from artifact.suppression.lowrank import LowRankMap

Made = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]

_BLOCK = 1024
_THRESHOLD = 25.0
_TOP = 100
_NOISE = 0.1  # length of what is added to a real descriptor, whose length is 1
COUNTS, LISTS, NO_DISTRACTORS = "counts and both sweeps", "with retrieval lists of 10", "without distractors"


def synthetic(n_queries: int, n_database: int, dimension: int) -> Made:
    """Return unit descriptors and positions of a drive of about a metre a frame, with some condition in them.

    Queries share a direction, so that part of the distractors beat the positives, as real distractors do.
    """
    rng = np.random.default_rng(0)
    database = _unit(rng.standard_normal((n_database, dimension), dtype=np.float32))
    along_queries, along_database = np.arange(n_queries) * 1.0, np.linspace(0, n_queries, n_database)
    nearest = np.searchsorted(along_database, along_queries).clip(max=n_database - 1)
    noise = _unit(rng.standard_normal((n_queries, dimension), dtype=np.float32))
    condition = _unit(rng.standard_normal((1, dimension), dtype=np.float32))
    strength = rng.uniform(0.05, 0.5, (n_queries, 1)).astype(np.float32)
    queries = _unit(noise + 0.08 * database[nearest] + strength * condition)
    places = [np.column_stack([along, np.zeros_like(along)]) for along in (along_queries, along_database)]
    return queries, database, places[0], places[1]


def tiled(n_queries: int, n_database: int) -> Made:
    """Return the real descriptors of Gardens Point that ship, day and night, again and again with some noise."""
    rng = np.random.default_rng(0)

    def rows(name: str, n: int) -> np.ndarray:
        stored = np.load(shipped.folder() / "gardens_point" / f"{name}-efficientnet_lite0_vlad.npy", allow_pickle=False)
        d = stored.shape[1]
        noise = rng.standard_normal((n, d), dtype=np.float32) * np.float32(_NOISE / d**0.5)
        return _unit(np.resize(stored, (n, d)).astype(np.float32) + noise)

    places = [_THRESHOLD / 2 * np.column_stack([np.arange(n) % 200, np.zeros(n)]) for n in (n_queries, n_database)]
    return rows("day_right", n_queries), rows("night_right", n_database), places[0], places[1]


def ranking_times(made: Made, *, n_views: int = 0, repeats: int = 3) -> pd.DataFrame:
    """Time an evaluation on the CPU and what it can be compared with, in turns; the least of some repeats.

    Parameters
    ----------
    made
        Descriptors of queries and database and their positions; the distractors are the queries.
    n_views
        Also evaluate with so many INLP views of up to 35 directions.

    Returns
    -------
    pandas.DataFrame
        A row for each ``work``: ``seconds``, and ``share`` of the bare product: the faster one of NumPy's and PyTorch's own.
        Evaluations have the ``pairs`` of all views, how many of them had a ``second`` and a ``third`` look, and the
        ``product`` that made the first. All rows have the ``processor`` and the sizes.
    """
    import torch

    queries, database, *where = made
    dimension = queries.shape[1]
    basis = np.linalg.qr(np.random.default_rng(1).standard_normal((dimension, 35)))[0]
    ranks = [1 + number * 34 // max(1, n_views - 1) for number in range(n_views)]
    views = {str(k): LowRankMap(basis[:, :k], basis[:, :k], np.zeros(k)) for k in ranks}

    def evaluation(*pool: Any, **options: Any) -> Callable[[], Any]:
        return lambda: evaluate(queries, database, *where, _THRESHOLD, *pool, device="cpu", **options).ranking.work

    tensors = [torch.from_numpy(rows) for rows in (queries, database)]
    works = {
        "bare product, NumPy": lambda: _bare(queries, database, lambda a, b: np.matmul(a, b.T)),
        "bare product, PyTorch": lambda: _bare(*tensors, lambda a, b: a @ b.T),
    }
    if products.OneDnnProduct.available():
        one = products.OneDnnProduct()
        works["bare product, oneDNN"] = lambda: _bare(
            *tensors, lambda a, b: one.multiply(one.prepared(a), one.prepared(b))
        )
    works |= {COUNTS: evaluation(), NO_DISTRACTORS: evaluation({}), LISTS: evaluation(retrieve=10)}
    if views:
        works |= {f"with {n_views} INLP views": evaluation(views=views)}
    if (index := _faiss(queries, database)) is not None:
        works["faiss IndexFlatIP, top 100 of the augmented database"] = lambda: index.search(queries, _TOP)
    _compile(dimension)
    least, found = dict.fromkeys(works, np.inf), {}
    for _ in range(repeats):
        for name, work in works.items():
            start = time.perf_counter()
            found[name] = work()
            least[name] = min(least[name], time.perf_counter() - start)
    frame = pd.DataFrame({"work": list(works), "seconds": list(least.values())})
    frame["share"] = frame["seconds"] / frame["seconds"].iloc[:2].min()
    looked = [found[name] if isinstance(found[name], Work) else None for name in works]
    frame["pairs"] = [work and work.pairs for work in looked]
    frame["second"] = [work and work.second_looks for work in looked]
    frame["third"] = [work and work.third_looks for work in looked]
    frame["product"] = [work and work.product for work in looked]
    sizes = {"queries": len(queries), "database": len(database), "dimension": dimension}
    return frame.assign(processor=processor(), **sizes)


def growth(sizes: list[int], dimension: int) -> pd.DataFrame:
    """Time evaluations of as many queries as database images: ``images``, ``pairs``, ``seconds``."""
    rows = []
    _compile(dimension)
    for n in sizes:
        made, start = synthetic(n, n, dimension), time.perf_counter()
        evaluate(*made, _THRESHOLD, device="cpu")
        rows.append({"images": n, "pairs": 2 * n * n, "seconds": time.perf_counter() - start})
    return pd.DataFrame(rows).assign(dimension=dimension, processor=processor())


def memory_beyond_inputs(n: int, dimension: int) -> float:
    """Return the bytes that an evaluation of ``n`` queries and as many database images takes beyond their descriptors."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "made.npz"
        np.savez(path, *synthetic(n, n, dimension))
        return float(timing.in_own_process(_grown, path))


def _grown(path: Path) -> float:
    """Evaluate what a file holds, in a process that has done nothing before; return by how many bytes its peak grew."""
    _compile(64)
    with np.load(path) as file:
        made = [file[name] for name in file.files]
    timing.forget_peak()
    before = timing.peak_memory()
    evaluate(*made, _THRESHOLD, device="cpu")
    return timing.peak_memory() - before


def _unit(rows: np.ndarray) -> np.ndarray:
    return (rows / np.linalg.norm(rows, axis=1, keepdims=True)).astype(np.float32)


def _compile(dimension: int) -> None:
    """Do once what a process does once: compile, and time the products to choose from."""
    products.seconds()
    evaluate(*synthetic(64, 64, dimension), _THRESHOLD, device="cpu")


def symmetry_limit(n_queries: int, n_database: int) -> float:
    """Return the share of all pairs that symmetry leaves to multiply when the distractors are the queries."""
    return (n_database + n_queries / 2) / (n_database + n_queries)


def processor() -> str:
    """Return the name of the processor."""
    listed = Path("/proc/cpuinfo")
    lines = listed.read_text(encoding="utf-8").splitlines() if listed.exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def _bare(queries: Any, database: Any, multiply: Callable[[Any, Any], Any]) -> None:
    """Multiply the queries with the database and with themselves, in blocks, and keep nothing."""
    for right in (database, queries):
        for start in range(0, len(queries), _BLOCK):
            multiply(queries[start : start + _BLOCK], right)


def _faiss(queries: np.ndarray, database: np.ndarray) -> Any:
    try:
        import faiss
    except ImportError:
        return None
    index = faiss.IndexFlatIP(queries.shape[1])
    index.add(database)
    index.add(queries)
    return index
