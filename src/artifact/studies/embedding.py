"""Fig. 3: descriptors in the plane, before and after suppression."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from artifact.extraction.described import Described, describe
from artifact.manifest import Manifest
from artifact.metrics.stored import stored
from artifact.studies import fitted
from artifact.studies.common import NothingToShowError, require_single_stage
from artifact.suppression.inlp import INLP

_FEWEST = 6  # images that UMAP can place


@dataclass(frozen=True)
class Embedding:
    """Embeddings ``(n, 2)`` of query and database descriptors, queries first, before and after suppression.

    ``partners`` are geometrical mutual nearest neighbours ``(m, 2)``: query row, database row. ``positions`` are those of the
    queries and of the database images, ``images`` the indices of the points in their traversals.
    """

    before: np.ndarray
    after: np.ndarray
    n_queries: int
    partners: np.ndarray
    positions: tuple[np.ndarray, np.ndarray]
    images: np.ndarray
    described: Described


def embedding(
    manifest: Manifest, dataset: str, method: str, *, fraction: float = 0.1, iterations: int = 35, seed: int = 0
) -> Embedding:
    """Fig. 3: UMAP of the evaluation region's descriptors before and after INLP.

    Raises
    ------
    NothingToShowError
        If the fitting region has fewer than two images of a condition, or the rest is too small for a map.
    """
    require_single_stage(manifest, method)
    described = describe(manifest, dataset, method)
    region = fitted.split_of(described.dataset, fraction)
    sizes = len(region.fit_queries), len(region.fit_database)
    rest = len(region.evaluation_queries) + len(region.evaluation_database)
    if min(sizes) < 2 or rest < _FEWEST:
        raise NothingToShowError(
            f"{described.dataset.title} has too few images for a map: {sizes[0]} queries and {sizes[1]} database images to fit on "
            f"(2 of each are needed), {rest} images to show ({_FEWEST} are needed)"
        )
    key = fitted.key_of("umap", [described], [fraction, iterations, seed], umap=version("umap-learn"))

    def compute() -> dict[str, Any]:
        inlp = INLP(iterations, seed=seed).fit(*fitted.fitting_data(described, region))
        rows = np.concatenate(fitted.evaluation_region(described, region)[:2])
        return {"before": _umap(rows, seed), "after": _umap(inlp.transform(rows), seed)}

    found = stored(manifest, key, compute, {"dataset": dataset, "method": method, "stage": "umap"})
    query, database, n = described.dataset.query, described.dataset.database, len(region.evaluation_queries)
    rows = region.evaluation_queries, region.evaluation_database
    positions = query.positions[rows[0]], database.positions[rows[1]]
    partners = mutual_neighbours(*positions)
    partners[:, 1] += n
    return Embedding(found["before"], found["after"], n, partners, positions, np.concatenate(rows), described)


def embedding_table(one: Embedding) -> pd.DataFrame:
    """Return one row per point: ``dataset``, ``method``, ``condition`` (query or database), its place before and after."""
    condition = np.where(np.arange(len(one.before)) < one.n_queries, "query", "database")
    places = np.concatenate([one.before, one.after], axis=1)
    table = pd.DataFrame(places, columns=["before_x", "before_y", "after_x", "after_y"])
    return table.assign(dataset=one.described.dataset.name, method=one.described.method, condition=condition)


def mixed(points: np.ndarray, one: Embedding) -> np.ndarray:
    """Tell for each query ``(n,)`` whether its nearest neighbour in the plane has the other condition."""
    return cKDTree(points).query(points[: one.n_queries], 2)[1][:, 1] >= one.n_queries


def aligned(points: np.ndarray, one: Embedding) -> np.ndarray:
    """Tell for each query ``(n,)`` whether the nearest database image in the plane is of its place."""
    nearest = cKDTree(points[one.n_queries :]).query(points[: one.n_queries])[1]
    queries, database = one.positions
    return np.linalg.norm(queries - database[nearest], axis=1) <= one.described.dataset.threshold


def nearest_share(points: np.ndarray, one: Embedding) -> float:
    """Return the share of points whose nearest neighbour in the plane has the other condition."""
    nearest = cKDTree(points).query(points, 2)[1][:, 1]
    is_query = np.arange(len(points)) < one.n_queries
    return float((is_query != is_query[nearest]).mean())


def mutual_neighbours(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the pairs of rows that are each other's nearest neighbour, ``(m, 2)``.

    Examples
    --------
    >>> mutual_neighbours(np.array([[0.0], [7.0]]), np.array([[1.0], [9.0]])).tolist()
    [[0, 0], [1, 1]]
    """
    there = cKDTree(second).query(first)[1]
    back = cKDTree(first).query(second)[1]
    rows = np.arange(len(first))
    mutual = back[there] == rows
    return np.column_stack([rows[mutual], there[mutual]])


def _umap(rows: np.ndarray, seed: int) -> np.ndarray:
    with warnings.catch_warnings():
        # It warns about optional parts that are not used here: progress bars for notebooks, a neural variant.
        warnings.simplefilter("ignore")
        import umap

    neighbours = min(15, len(rows) - 1)
    # A fixed seed makes UMAP run in one thread; asking for one thread says so without a warning.
    model = umap.UMAP(metric="cosine", n_neighbors=neighbours, random_state=seed, n_jobs=1)
    return model.fit_transform(rows.astype(np.float32))
