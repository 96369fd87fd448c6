"""Dataset × method → :class:`~artifact.metrics.evaluation.Evaluation`, stored under the key of its inputs.

The studies call :func:`evaluation`; it loads the traversals, gets their descriptors and ranks them, or reads the
stored ranking when every input is the same.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from artifact import datasets, store
from artifact.datasets import Dataset, positives
from artifact.extraction import extract
from artifact.extraction.described import Described, describe
from artifact.extraction.stored import second_stage_key
from artifact.manifest import Manifest
from artifact.manifest.entries import ManifestError, MethodEntry
from artifact.metrics import two_stage, two_stage_sweeps
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
    method: str
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
        both = TwoStage.of(manifest, dataset, method, names, pool_size, seed=seed, device=device)

        @functools.cache
        def sweep_of(pool: str) -> two_stage_sweeps.Sweep:
            return two_stage_sweeps.Sweep.from_arrays(both.sweep(pool, draws))

        result = two_stage.TwoStageEvaluation.from_arrays(both.ranking(retrieve), sweep_of)
        score: Literal["cosine", "matches"] = "matches" if both.by_local_features else "cosine"
        return Measured(result, both.described.dataset, method, both.described.inputs, score)
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
    return Measured(result["evaluation"], loaded, method, described.inputs)


def _pool_rows(dataset: Dataset, name: str, size: int | None, seed: int) -> np.ndarray | slice:
    """Which images of a traversal are a distractor pool; of the query traversal, the evaluated queries."""
    positions = dataset.traversals[name].positions
    rows: np.ndarray | slice = slice(None)
    if name == dataset.query_name:
        starts, _ = positives.positives_of(positions, dataset.database.positions, dataset.threshold)
        rows = np.flatnonzero(np.diff(starts))
    if size is None:
        return rows
    members = np.arange(len(positions))[rows]
    if size > len(members):
        raise ValueError(f"{dataset.name}/{name} has {len(members)} images for a pool of {size}; ask for at most that")
    return members[np.sort(np.random.default_rng(seed).choice(len(members), size, replace=False))]


# -- two-stage methods --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class TwoStage:
    """A method that ranks again, on a dataset with its pools of distractors: what is ranked is stored, whole and in parts.

    A part has :data:`QUERIES_EACH` of the evaluated queries, if they are ranked by local features: that can take ten seconds
    for each query. Parts are made wherever it suits, and in any order.
    """

    manifest: Manifest
    described: Described
    names: tuple[str, ...]
    pool_size: int | None
    seed: int
    device: Any = None
    _read: dict[str, Images] = field(default_factory=dict, repr=False)

    @classmethod
    def of(
        cls,
        manifest: Manifest,
        dataset: str,
        method: str,
        names: Iterable[str] = (),
        pool_size: int | None = None,
        *,
        seed: int = 0,
        device: Any = None,
    ) -> TwoStage:
        """Load the dataset and its descriptors; parameters and errors are those of :func:`evaluation`."""
        entry, names = manifest.method(method), tuple(names)
        if entry.local_features is None and entry.code_bits is None:
            raise ManifestError(
                f"{manifest.path}: methods.{method} re-ranks {entry.rerank} candidates, but does not say by what; add "
                f"local_features (with shape) or code_bits"
            )
        loaded = datasets.load(manifest, dataset, names)
        extract.check_disk(manifest, loaded.traversals.values(), [method])
        return cls(manifest, describe(manifest, dataset, method, names, device=device), names, pool_size, seed, device)

    @property
    def parts(self) -> list[slice]:
        """The rows of the evaluated queries of each part."""
        data = self.described.dataset
        starts, _ = positives.positives_of(data.query.positions, data.database.positions, data.threshold)
        return parts_of(self.manifest.method(self.described.method), int((np.diff(starts) > 0).sum()))

    def ranking(self, retrieve: int = 0) -> dict[str, np.ndarray]:
        """Return the arrays of the evaluation, with retrieval lists of a length."""
        return self._whole("two-stage ranking", self._ranking(retrieve), two_stage.joined, retrieve=retrieve)

    def make_ranking(self, number: int, retrieve: int = 0) -> None:
        """Rank the queries of one part, if there is one of that number and the whole is not stored."""
        self._part("two-stage ranking", self._ranking(retrieve), number, retrieve=retrieve)

    def sweep(self, pool: str, draws: int) -> dict[str, np.ndarray]:
        """Return the arrays of the sweeps over a pool, with at most so many random draws."""
        options = {"pool": pool, "draws": self._draws(draws)}
        return self._whole("two-stage sweep", self._sweep(**options), two_stage_sweeps.joined, **options)

    def make_sweep(self, number: int, pool: str, draws: int) -> None:
        """Rank the queries of one part for the sweeps; as :meth:`make_ranking`."""
        options = {"pool": pool, "draws": self._draws(draws)}
        self._part("two-stage sweep", self._sweep(**options), number, **options)

    @property
    def by_local_features(self) -> bool:
        """Whether local features rank again, and not descriptors."""
        return self.manifest.method(self.described.method).local_features is not None

    def _draws(self, most: int) -> int:
        return min(most, _MOST_DRAWS_BY_LOCAL_FEATURES) if self.by_local_features else most

    def _ranking(self, retrieve: int) -> Callable[[slice], dict[str, np.ndarray]]:
        def rank(rows: slice) -> dict[str, np.ndarray]:
            pools = {name: self._pool(name) for name in self.names}
            return self._ranked(two_stage.evaluate_two_stage, pools, rows=rows, retrieve=retrieve)

        return rank

    def _sweep(self, pool: str, draws: int) -> Callable[[slice], dict[str, np.ndarray]]:
        def rank(rows: slice) -> dict[str, np.ndarray]:
            return self._ranked(two_stage_sweeps.sweep, self._pool(pool), rows=rows, draws=draws)

        return rank

    def _ranked(self, rank: Callable[..., Any], pools: Any, **options: Any) -> dict[str, np.ndarray]:
        data, entry = self.described.dataset, self.manifest.method(self.described.method)
        scores = matching.LocalMatcher(device=self.device) if self.by_local_features else matching.cosines
        pair = self._images(data.query_name), self._images(data.database_name), data.threshold
        return rank(*pair, scores, pools, candidates=entry.rerank, seed=self.seed, **options).arrays()

    def _images(self, name: str) -> Images:
        if name not in self._read:
            self._read[name] = self._load(name)
        return self._read[name]

    def _load(self, name: str) -> Images:
        traversal, values = self.described.dataset.traversals[name], self.described.descriptors[name].values
        second = extract.second_stage(self.manifest, traversal, self.described.method, device=self.device)
        first, second = (values, second) if self.by_local_features else (second[np.arange(len(second))], values)
        return Images.of(first, second, traversal.positions)

    def _pool(self, name: str) -> Images | None:
        if name not in self.names:
            return None
        return self._images(name).take(_pool_rows(self.described.dataset, name, self.pool_size, self.seed))

    def _whole(
        self,
        stage: str,
        rank: Callable[[slice], dict[str, np.ndarray]],
        joined: Callable[[Sequence[Mapping[str, np.ndarray]]], dict[str, np.ndarray]],
        **options: Any,
    ) -> dict[str, np.ndarray]:
        def compute() -> dict[str, np.ndarray]:
            parts = self.parts
            if len(parts) == 1:
                return rank(parts[0])
            return joined([self._stored_part(stage, rank, rows, **options) for rows in parts])

        return stored(self.manifest, self._key(stage, **options), compute, self._record(stage))

    def _part(self, stage: str, rank: Callable[[slice], dict[str, np.ndarray]], number: int, **options: Any) -> None:
        parts = self.parts
        if number < len(parts) > 1 and not is_stored(self.manifest, self._key(stage, **options)):
            self._stored_part(stage, rank, parts[number], **options)

    def _stored_part(
        self, stage: str, rank: Callable[[slice], dict[str, np.ndarray]], rows: slice, **options: Any
    ) -> dict[str, np.ndarray]:
        key = self._key(f"{stage}, part", rows=[rows.start, rows.stop], **options)
        return stored(self.manifest, key, lambda: rank(rows), self._record(f"{stage}, part"))

    def _record(self, stage: str) -> dict[str, Any]:
        return {"dataset": self.described.dataset.name, "method": self.described.method, "stage": stage}

    def _key(self, stage: str, **options: Any) -> str:
        method, loaded = self.described.method, self.described.dataset
        entry = self.manifest.method(method)
        return store.key(
            stage=stage,
            **options,
            revision=two_stage.REVISION,
            inputs=self.described.key_inputs(),
            candidates=entry.rerank,
            seed=self.seed,
            second={name: second_stage_key(t, method, entry) for name, t in loaded.traversals.items()},
            pools=list(self.names),
            pool_size=self.pool_size,
        )


def parts_of(entry: MethodEntry, queries: int) -> list[slice]:
    """Return the rows of each part that a number of evaluated queries is ranked in."""
    each = QUERIES_EACH if entry.local_features is not None else max(1, queries)
    return [slice(start, min(start + each, queries)) for start in range(0, max(1, queries), each)]
