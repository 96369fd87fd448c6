"""Dataset × method → :class:`~artifact.metrics.evaluation.Evaluation`, stored under the key of its inputs.

The studies call :func:`evaluation`; it loads the traversals, gets their descriptors and ranks them, or reads the
stored ranking when every input is the same.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from artifact import datasets, store
from artifact.datasets import Dataset, positives
from artifact.extraction import extract
from artifact.extraction.described import Described, describe
from artifact.extraction.stored import second_stage_key
from artifact.manifest import Manifest
from artifact.manifest.entries import ManifestError, MethodEntry
from artifact.metrics import two_stage
from artifact.metrics.evaluate import evaluate
from artifact.metrics.evaluation import Evaluation
from artifact.metrics.result import Result
from artifact.metrics.stored import is_stored, stored
from artifact.ranking import matching, one_pass
from artifact.ranking.candidates import Images

# Each draw of the sweep over the number of distractors asks for local features of more pairs: few, unless asked for.
_MOST_DRAWS_BY_LOCAL_FEATURES = 3

QUERIES_EACH = 512
"""Queries that are ranked again by local features in one part: an hour or two without a GPU."""


@dataclass(frozen=True)
class Measured:
    """An evaluation with what it was made from: ``inputs`` has one record per traversal used.

    ``score`` is what the last stage ranks by, as the values of retrieval lists: cosines, or matches of local features.
    """

    evaluation: Result
    dataset: Dataset
    inputs: tuple[dict[str, Any], ...]
    score: Literal["cosine", "matches"] = "cosine"


def evaluation(
    manifest: Manifest,
    dataset: str,
    method: str,
    *,
    distractors: Iterable[str] = (),
    pool_size: int | None = None,
    retrieve: int = 0,
    similarity: str = "cosine",
    draws: int = 20,
    seed: int = 0,
    device: Any = None,
) -> Measured:
    """Evaluate a method on a dataset; a method that re-ranks gives a :class:`~artifact.metrics.two_stage.TwoStageEvaluation`.

    Parameters
    ----------
    dataset
        A name in the manifest, or a folder.
    distractors
        Traversals that serve as distractor pools, one pool each; none takes the evaluated queries (the paper's
        main setting). The query traversal may be among them and then also means the evaluated queries.
    pool_size
        Cut every pool to this many images, chosen by ``seed`` (paper Fig. 7: the number is held constant).
    retrieve
        Length of the retrieval lists.
    draws
        Random draws of the sweep over the number of distractors; a method that re-ranks by local features makes
        three of them at most, since each takes as long as the evaluation itself.
    similarity, seed, device
        As in :func:`artifact.evaluate`.
    """
    names = list(distractors)
    if manifest.method(method).rerank is not None:
        if similarity != "cosine":
            raise ValueError(f"similarity is {similarity!r}; the two stages of {method} compare in their own ways")
        both = TwoStage(manifest, dataset, method, names, pool_size, seed, device)

        @functools.cache
        def sweep_of(pool: str) -> two_stage.Sweep:
            return two_stage.Sweep.from_arrays(both.sweep(pool, draws))

        result = two_stage.TwoStageEvaluation.from_arrays(both.ranking(retrieve), sweep_of)
        score: Literal["cosine", "matches"] = "matches" if both.by_local_features else "cosine"
        return Measured(result, both.described.dataset, both.described.inputs, score)
    described = describe(manifest, dataset, method, names, device=device)
    loaded = described.dataset
    options = {"retrieve": retrieve, "seed": seed, "similarity": similarity, "draws": draws}
    inputs = {"inputs": described.key_inputs(), "options": options, "pools": names, "pool_size": pool_size}
    key = store.key(stage="ranking", revision=one_pass.REVISION, **inputs)

    def compute() -> dict[str, Evaluation]:
        chosen = {name: _pool_rows(loaded, name, pool_size, seed) for name in names}
        pools = {name: described.descriptors[name].values[rows] for name, rows in chosen.items()}
        where = {name: loaded.traversals[name].positions[rows] for name, rows in chosen.items()}
        values = described.query.values, described.database.values
        places = loaded.query.positions, loaded.database.positions, loaded.threshold
        return {"evaluation": evaluate(*values, *places, pools or None, where or None, device=device, **options)}

    result = stored(manifest, key, compute, {"dataset": dataset, "method": method, "stage": "ranking"})
    return Measured(result["evaluation"], loaded, described.inputs)


def with_positives(dataset: Dataset) -> np.ndarray:
    """Return which queries are evaluated, ``(n,)``: those with a positive in the database."""
    starts, _ = positives.positives_of(dataset.query.positions, dataset.database.positions, dataset.threshold)
    return np.flatnonzero(np.diff(starts))


def _pool_rows(dataset: Dataset, name: str, size: int | None, seed: int) -> np.ndarray | slice:
    """Which images of a traversal are a distractor pool; of the query traversal, the evaluated queries."""
    rows = with_positives(dataset) if name == dataset.query_name else slice(None)
    if size is None:
        return rows
    members = np.arange(len(dataset.traversals[name]))[rows]
    if size > len(members):
        raise ValueError(f"{dataset.name}/{name} has {len(members)} images for a pool of {size}; ask for at most that")
    return members[np.sort(np.random.default_rng(seed).choice(len(members), size, replace=False))]


# -- two-stage methods --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class TwoStage:
    """A method that ranks again, on a dataset with its pools of distractors: what is ranked is stored, whole and in parts.

    Parameters and errors are those of :func:`evaluation`, ``names`` its ``distractors``. A part has :data:`QUERIES_EACH` of
    the evaluated queries, if they are ranked by local features: that can take ten seconds for each query. Parts are made
    wherever it suits, and in any order.
    """

    manifest: Manifest
    dataset: str
    method: str
    names: Sequence[str] = ()
    pool_size: int | None = None
    seed: int = 0
    device: Any = None

    def ranking(self, retrieve: int = 0) -> dict[str, np.ndarray]:
        """Return the arrays of the evaluation, with retrieval lists of a length."""
        return self._whole("two-stage ranking", retrieve=retrieve)

    def make_ranking(self, number: int) -> None:
        """Rank the queries of one part, if there is one of that number and the whole is not stored."""
        self._make("two-stage ranking", number, retrieve=0)

    def sweep(self, pool: str, draws: int) -> dict[str, np.ndarray]:
        """Return the arrays of the sweeps over a pool, with at most so many random draws."""
        return self._whole("two-stage sweep", pool=pool, draws=self._draws(draws))

    def make_sweep(self, number: int, pool: str, draws: int) -> None:
        """Rank the queries of one part for the sweeps; as :meth:`make_ranking`."""
        self._make("two-stage sweep", number, pool=pool, draws=self._draws(draws))

    @functools.cached_property
    def described(self) -> Described:
        """The dataset and its descriptors, once the disk is known to have room for what is made with them."""
        entry = self._entry
        if entry.local_features is None and entry.code_bits is None:
            raise ManifestError(
                f"{self.manifest.path}: methods.{self.method} re-ranks {entry.rerank} candidates, but does not say by what; "
                f"add local_features (with shape) or code_bits"
            )
        loaded = datasets.load(self.manifest, self.dataset, self.names)
        extract.check_disk(self.manifest, loaded.traversals.values(), [self.method])
        return describe(self.manifest, self.dataset, self.method, self.names, device=self.device)

    @property
    def by_local_features(self) -> bool:
        """Whether local features rank again, and not descriptors."""
        return self._entry.local_features is not None

    @property
    def _entry(self) -> MethodEntry:
        return self.manifest.method(self.method)

    def _draws(self, most: int) -> int:
        return min(most, _MOST_DRAWS_BY_LOCAL_FEATURES) if self.by_local_features else most

    @functools.cached_property
    def _images(self) -> dict[str, Images]:
        """What both stages know of each traversal."""
        found = {}
        for name, traversal in self.described.dataset.traversals.items():
            values = self.described.descriptors[name].values
            second = extract.second_stage(self.manifest, traversal, self.method, device=self.device)
            stages = (values, second) if self.by_local_features else (second[np.arange(len(second))], values)
            found[name] = Images.of(*stages, traversal.positions)
        return found

    def _pool(self, name: str) -> Images | None:
        if name not in self.names:
            return None
        return self._images[name].take(_pool_rows(self.described.dataset, name, self.pool_size, self.seed))

    def _rank(self, rows: slice, **options: Any) -> dict[str, np.ndarray]:
        """Rank some of the evaluated queries: for the sweeps if a pool is named, else for the evaluation."""
        data = self.described.dataset
        pair = self._images[data.query_name], self._images[data.database_name], data.threshold
        scores = matching.LocalMatcher(device=self.device) if self.by_local_features else matching.cosines
        options |= {"candidates": self._entry.rerank, "seed": self.seed, "rows": rows}
        if "pool" in options:
            pool = self._pool(options.pop("pool"))
            return two_stage.sweep(*pair, scores, pool, **options).arrays()
        pools = {name: self._pool(name) for name in self.names}
        return two_stage.evaluate_two_stage(*pair, scores, pools, **options).arrays()

    def _parts(self) -> list[slice]:
        return parts_of(self._entry, len(with_positives(self.described.dataset)))

    def _whole(self, stage: str, **options: Any) -> dict[str, np.ndarray]:
        def compute() -> dict[str, np.ndarray]:
            parts = self._parts()
            if len(parts) == 1:
                return self._rank(parts[0], **options)
            return two_stage.joined([self._part(stage, rows, **options) for rows in parts])

        return self._stored(stage, compute, **options)

    def _make(self, stage: str, number: int, **options: Any) -> None:
        parts = self._parts()
        if number < len(parts) > 1 and not is_stored(self.manifest, self._key(stage, **options)):
            self._part(stage, parts[number], **options)

    def _part(self, stage: str, rows: slice, **options: Any) -> dict[str, np.ndarray]:
        bounds = [rows.start, rows.stop]
        return self._stored(f"{stage}, part", lambda: self._rank(rows, **options), rows=bounds, **options)

    def _stored(
        self, stage: str, compute: Callable[[], dict[str, np.ndarray]], **options: Any
    ) -> dict[str, np.ndarray]:
        record = {"dataset": self.described.dataset.name, "method": self.method, "stage": stage}
        return stored(self.manifest, self._key(stage, **options), compute, record)

    def _key(self, stage: str, **options: Any) -> str:
        traversals = self.described.dataset.traversals.items()
        return store.key(
            stage=stage,
            **options,
            revision=two_stage.REVISION,
            inputs=self.described.key_inputs(),
            candidates=self._entry.rerank,
            seed=self.seed,
            second={name: second_stage_key(one, self.method, self._entry) for name, one in traversals},
            pools=list(self.names),
            pool_size=self.pool_size,
        )


def parts_of(entry: MethodEntry, queries: int) -> list[slice]:
    """Return the rows of each part that a number of evaluated queries is ranked in."""
    each = QUERIES_EACH if entry.local_features is not None else max(1, queries)
    return [slice(start, min(start + each, queries)) for start in range(0, max(1, queries), each)]
