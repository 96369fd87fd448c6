"""Second-stage scores of pairs: mutual nearest local features (SelaVPR) and the cosine of descriptors (SelaVPR++)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from artifact.suppression.compiled import compiled

if TYPE_CHECKING:
    import torch  # pages that show stored results need not wait for it

_TILE_ROWS = 512  # features of a candidate that are compared at a time on the CPU


def cosines(queries: np.ndarray, query_rows: np.ndarray, images: np.ndarray, image_rows: np.ndarray) -> np.ndarray:
    """Score pairs ``(query_rows[i], image_rows[i])`` by the cosine of their descriptors, the second stage of SelaVPR++.

    Sums are in float64 and rounded to float32 at the end, so that equal images get equal scores.

    >>> unit = np.eye(3, dtype=np.float32)
    >>> cosines(unit, np.array([0, 0]), unit, np.array([0, 2])).tolist()
    [1.0, 0.0]
    """
    scores = np.empty(len(query_rows), np.float32)
    _cosines(_readable(queries), np.asarray(query_rows), _readable(images), np.asarray(image_rows), scores)
    return scores


def _readable(descriptors: np.ndarray) -> np.ndarray:
    """Return an array that compiled code reads: not a memory map by type, and not of half precision."""
    return np.asarray(descriptors, np.float32 if descriptors.dtype == np.float16 else None)


@compiled(fastmath={"reassoc", "contract"})
def _cosines(
    queries: np.ndarray, query_rows: np.ndarray, images: np.ndarray, image_rows: np.ndarray, scores: np.ndarray
) -> None:
    for pair in range(scores.size):
        query, image = queries[query_rows[pair]], images[image_rows[pair]]
        product, query_square, image_square = 0.0, 0.0, 0.0
        for column in range(query.size):
            one, other = np.float64(query[column]), np.float64(image[column])
            product += one * other
            query_square += one * one
            image_square += other * other
        scores[pair] = product / np.sqrt(query_square * image_square)


@dataclass(frozen=True)
class LocalMatcher:
    """Second-stage scores of SelaVPR: mutual nearest neighbours among the local features of two images.

    The score is the number of pairs of features that are each other's nearest, where exactly one counts as none, as in
    the authors' code. ``memory`` is in bytes, for features and similarities together: each image is read once for each
    group of queries that fits. Features are compared in float32 whatever they are stored as.
    """

    memory: int = 2**30
    device: Any = None

    def __call__(self, queries: Any, query_rows: np.ndarray, images: Any, image_rows: np.ndarray) -> np.ndarray:
        """Return ``(p,)`` float32 scores of pairs of images with local features ``(n, ..., c)`` of unit length."""
        scores = np.empty(len(query_rows), np.float32)
        load, match = self._backend()
        image_bytes = 4 * max(math.prod(queries.shape[1:]), math.prod(images.shape[1:]))
        group = max(1, self.memory // (4 * image_bytes))
        for query_group in _groups(query_rows, group):
            among = np.flatnonzero(np.isin(query_rows, query_group))
            loaded_queries = load(queries, query_group)
            for image_group in _groups(image_rows[among], group):
                chosen = among[np.isin(image_rows[among], image_group)]
                loaded = load(images, image_group)
                places = np.searchsorted(image_group, image_rows[chosen])
                owners = np.searchsorted(query_group, query_rows[chosen])
                for owner in np.unique(owners):
                    mine = owners == owner
                    scores[chosen[mine]] = match(loaded_queries[owner], loaded, places[mine])
        return scores

    def _backend(self) -> tuple[Callable[..., Any], Callable[..., np.ndarray]]:
        """Return how features are loaded, and how one query is matched with several of the loaded images."""
        import torch

        if str(self.device) == "cpu" or (self.device is None and not torch.cuda.is_available()):
            return _features, _match_on_cpu
        device = torch.device("cuda" if self.device is None else self.device)

        def load(images: Any, rows: np.ndarray) -> torch.Tensor:
            values = torch.from_numpy(np.asarray(images[rows])).to(device).float()
            return values.reshape(len(rows), -1, values.shape[-1])

        def match(query: torch.Tensor, images: torch.Tensor, places: np.ndarray) -> np.ndarray:
            block = max(1, self.memory // (16 * len(query) * images.shape[1]))
            with torch.inference_mode():
                candidates = images[torch.from_numpy(places).to(device)]
                return match_count(query, candidates, block=block).cpu().numpy()

        return load, match


def _groups(rows: np.ndarray, size: int) -> list[np.ndarray]:
    """Split the distinct indices into ascending groups."""
    distinct = np.unique(rows)
    return [distinct[start : start + size] for start in range(0, len(distinct), size)]


def _features(images: Any, rows: np.ndarray) -> np.ndarray:
    """Load local features as ``(k, n, c)`` float32."""
    values = np.asarray(images[rows], np.float32)
    return values.reshape(len(rows), -1, values.shape[-1])


def _match_on_cpu(query: np.ndarray, images: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Count mutual nearest neighbours of one query and several images, a tile of similarities at a time."""
    counts = np.empty(len(places), np.int64)
    n_query, n_image = len(query), images.shape[1]
    tile = np.empty((min(_TILE_ROWS, n_image), n_query), np.float32)
    for slot, place in enumerate(places):
        nearest_of_image = np.zeros(n_image, np.int64)
        nearest_of_query, closest = np.zeros(n_query, np.int64), np.full(n_query, -np.inf, np.float32)
        for start in range(0, n_image, _TILE_ROWS):
            part = images[place, start : start + _TILE_ROWS]
            np.matmul(part, query.T, out=tile[: len(part)])
            _nearest(tile[: len(part)], start, nearest_of_image, nearest_of_query, closest)
        count = int((nearest_of_image[nearest_of_query] == np.arange(n_query)).sum())
        counts[slot] = 0 if count == 1 else count
    return counts


@compiled(fastmath={"nnan", "nsz"})
def _nearest(
    tile: np.ndarray, first: int, nearest_of_row: np.ndarray, nearest_of_column: np.ndarray, closest: np.ndarray
) -> None:
    """Find the nearest column of each row, and go on with the nearest row of each column; ties: the first."""
    columns = tile.shape[1]
    for row in range(tile.shape[0]):
        values = tile[row]
        largest = values[0]
        for column in range(columns):
            largest = values[column] if values[column] > largest else largest
        for column in range(columns):
            if values[column] == largest:
                nearest_of_row[first + row] = column
                break
        for column in range(columns):
            nearer = values[column] > closest[column]
            closest[column] = values[column] if nearer else closest[column]
            nearest_of_column[column] = first + row if nearer else nearest_of_column[column]


def match_count(query: torch.Tensor, candidates: torch.Tensor, *, block: int = 1) -> torch.Tensor:
    """Count the mutual nearest neighbours of a query's and each candidate's local features: SelaVPR's second stage.

    There is no threshold and no geometry; like the authors' code it gives 0 where there is exactly one match. Features
    are of unit length, ``(rows, columns, c)`` or ``(m, c)``, those of k candidates with k leading, of which ``block``
    are compared at a time; each takes m · n similarities (55 MB in float32 for 61 × 61 features).

    Examples
    --------
    >>> import torch
    >>> features = torch.eye(5)
    >>> match_count(features[:4], torch.stack([features, features.flip(0)]))
    tensor([4, 4])
    """
    import torch

    if query.ndim < 2 or candidates.ndim < 3 or query.shape[-1] != candidates.shape[-1]:
        raise ValueError(
            "match_count takes query features (rows, columns, c) or (m, c) and candidates' features with one "
            f"more leading axis and the same c; found {tuple(query.shape)} and {tuple(candidates.shape)}."
        )
    if block < 1:
        raise ValueError(f"match_count takes a block of at least 1 candidate; found {block}.")
    query = query.flatten(0, -2)
    scores = [_mutual(query, some) for some in torch.split(candidates.flatten(1, -2), block)]
    return torch.cat(scores) if scores else torch.zeros(0, dtype=torch.int64, device=query.device)


def _mutual(query: torch.Tensor, candidates: torch.Tensor) -> torch.Tensor:
    import torch

    similarities = candidates @ query.T  # (k, n, m)
    of_query = similarities.argmax(dim=1)
    of_candidates = similarities.argmax(dim=2)
    there_and_back = of_candidates.gather(1, of_query)
    counts = (there_and_back == torch.arange(len(query), device=query.device)).sum(dim=1)
    return torch.where(counts == 1, 0, counts)
