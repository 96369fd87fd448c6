"""The paper's definitions, word for word and slowly: what every fast path must equal."""

from dataclasses import dataclass
from math import dist

import numpy as np


@dataclass(frozen=True)
class Case:
    queries: np.ndarray
    database: np.ndarray
    query_positions: np.ndarray
    database_positions: np.ndarray
    threshold: float
    pool: np.ndarray | None = None
    pool_positions: np.ndarray | None = None


def similarity(kind, query, images):
    """Similarity of one query to many images in float64."""
    query, images = query.astype(np.float64), images.astype(np.float64)
    if kind == "cosine":
        return images @ query / (np.linalg.norm(query) * np.linalg.norm(images, axis=1))
    if kind == "dot":
        return images @ query
    return -((images - query) ** 2).sum(axis=1)


def distance(a, b):
    return dist(a, b)


def evaluated_queries(case):
    """Queries with a positive in the database."""
    database = case.database_positions.tolist()
    return [
        i
        for i, where in enumerate(case.query_positions.tolist())
        if any(distance(where, y) <= case.threshold for y in database)
    ]


def ranks(case, kind="cosine", *, beyond=None, members=None, ties="for", with_distractors=True):
    """Rank of the best positive of each evaluated query: build the database A_i, sort it, look.

    `beyond` keeps only distractors farther than it; `members` only those pool images.
    """
    kept = evaluated_queries(case)
    pool = case.queries[kept] if case.pool is None else case.pool
    pool_positions = (case.query_positions[kept] if case.pool is None else case.pool_positions).tolist()
    database_positions, query_positions = case.database_positions.tolist(), case.query_positions.tolist()
    result = []
    for i in kept:
        where = query_positions[i]
        is_positive = [distance(where, y) <= case.threshold for y in database_positions]
        entries = list(zip(similarity(kind, case.queries[i], case.database).tolist(), is_positive, strict=True))
        if with_distractors:
            scores = similarity(kind, case.queries[i], pool).tolist()
            for index, (score, y) in enumerate(zip(scores, pool_positions, strict=True)):
                far = distance(where, y) > max(case.threshold, -1 if beyond is None else beyond)
                if far and (members is None or index in members):
                    entries.append((score, False))
        # Rounding in float64 must not split exact ties of the integer descriptors used in these tests.
        favoured = ties == "for"
        entries.sort(key=lambda entry: (-round(entry[0], 12), entry[1] != favoured))
        result.append(1 + next(place for place, entry in enumerate(entries) if entry[1]))
    return np.array(result)


def share(rank_list, k):
    return float(np.mean([rank <= k for rank in rank_list]))
