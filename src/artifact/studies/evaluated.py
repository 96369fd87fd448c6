"""Dataset × method → :class:`~artifact.metrics.evaluation.Evaluation`, stored under the key of its inputs.

The studies call :func:`evaluation`; it loads the traversals, gets their descriptors and ranks them, or reads the
stored ranking when every input is the same.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from artifact import datasets, store
from artifact.datasets import Dataset, positives
from artifact.extraction import extract
from artifact.extraction.described import describe
from artifact.manifest import Manifest
from artifact.manifest.entries import ManifestError
from artifact.metrics import two_stage, two_stage_sweeps
from artifact.metrics.evaluate import evaluate
from artifact.metrics.evaluation import Evaluation
from artifact.metrics.result import Result
from artifact.metrics.stored import stored
from artifact.ranking import matching, one_pass
from artifact.ranking.candidates import Images

# Each draw of the sweep over the number of distractors asks for local features of more pairs: few, unless asked for.
_MOST_DRAWS_BY_LOCAL_FEATURES = 3


@dataclass(frozen=True)
class Measured:
    """An evaluation with the record of what it was made from.

    Attributes
    ----------
    evaluation
        The metrics.
    dataset
        The dataset with its loaded traversals.
    method
        Name of the method.
    inputs
        One record per traversal used: names, number of images, descriptor key and source.
    score
        What the last stage ranks by, as the values of retrieval lists: ``"cosine"`` or ``"matches"`` of local features.
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
    draws: int = 10,
    seed: int = 0,
    device: Any = None,
) -> Measured:
    """Evaluate a method on a dataset; a method that re-ranks gives a :class:`~artifact.metrics.two_stage.TwoStageEvaluation`.

    Parameters
    ----------
    manifest
        The manifest.
    dataset, method
        Names in the manifest; ``dataset`` may be a folder.
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
        return _two_stage(manifest, dataset, method, names, pool_size, retrieve, draws, seed, device)
    described = describe(manifest, dataset, method, names, device=device)
    loaded = described.dataset
    options = {"retrieve": retrieve, "seed": seed, "similarity": similarity, "draws": draws}
    key = store.key(
        stage="ranking",
        revision=one_pass.REVISION,
        inputs=described.key_inputs(),
        options=options,
        pools=names,
        pool_size=pool_size,
    )

    def compute() -> dict[str, Evaluation]:
        chosen = {name: _pool_rows(loaded, name, pool_size, seed) for name in names}
        result = evaluate(
            described.query.values,
            described.database.values,
            loaded.query.positions,
            loaded.database.positions,
            loaded.threshold,
            {name: described.descriptors[name].values[rows] for name, rows in chosen.items()} or None,
            {name: loaded.traversals[name].positions[rows] for name, rows in chosen.items()} or None,
            device=device,
            **options,
        )
        return {"evaluation": result}

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


def _two_stage(
    manifest: Manifest,
    dataset: str,
    method: str,
    names: list[str],
    pool_size: int | None,
    retrieve: int,
    most_draws: int,
    seed: int,
    device: Any,
) -> Measured:
    entry = manifest.method(method)
    if entry.local_features is None and entry.code_bits is None:
        raise ManifestError(
            f"{manifest.path}: methods.{method} re-ranks {entry.rerank} candidates, but does not say by what; add "
            f"local_features (with shape) or code_bits"
        )
    loaded = datasets.load(manifest, dataset, names)
    extract.check_disk(manifest, loaded.traversals.values(), [method])
    described = describe(manifest, dataset, method, names, device=device)
    shared = {
        "revision": two_stage.REVISION,
        "inputs": described.key_inputs(),
        "candidates": entry.rerank,
        "seed": seed,
        "second": {name: extract.second_stage_key(t, method, entry) for name, t in loaded.traversals.items()},
        "pools": names,
        "pool_size": pool_size,
    }
    record = {"dataset": dataset, "method": method}
    draws = most_draws if entry.local_features is None else min(most_draws, _MOST_DRAWS_BY_LOCAL_FEATURES)
    scores = matching.cosines if entry.local_features is None else matching.LocalMatcher(device=device)

    @functools.cache
    def images(name: str) -> Images:
        values = described.descriptors[name].values
        second = extract.second_stage(manifest, loaded.traversals[name], method, device=device)
        positions = loaded.traversals[name].positions
        if entry.local_features is None:
            return Images.of(second[np.arange(len(second))], values, positions)
        return Images.of(values, second, positions)

    @functools.cache
    def pool(name: str) -> Images | None:
        return images(name).take(_pool_rows(loaded, name, pool_size, seed)) if name in names else None

    def compute() -> dict[str, np.ndarray]:
        return two_stage.evaluate_two_stage(
            images(loaded.query_name),
            images(loaded.database_name),
            loaded.threshold,
            scores,
            {name: pool(name) for name in names},
            candidates=entry.rerank,
            retrieve=retrieve,
            seed=seed,
        ).arrays()

    @functools.cache
    def sweep_of(name: str) -> two_stage_sweeps.Sweep:
        def compute_sweep() -> dict[str, np.ndarray]:
            return two_stage_sweeps.sweep(
                images(loaded.query_name),
                images(loaded.database_name),
                loaded.threshold,
                scores,
                pool(name),
                candidates=entry.rerank,
                draws=draws,
                seed=seed,
            ).arrays()

        key = store.key(stage="two-stage sweep", pool=name, draws=draws, **shared)
        return two_stage_sweeps.Sweep.from_arrays(
            stored(manifest, key, compute_sweep, {**record, "stage": "two-stage sweep"})
        )

    key = store.key(stage="two-stage ranking", retrieve=retrieve, **shared)
    arrays = stored(manifest, key, compute, {**record, "stage": "two-stage ranking"})
    result = two_stage.TwoStageEvaluation.from_arrays(arrays, sweep_of)
    score: Literal["cosine", "matches"] = "cosine" if entry.local_features is None else "matches"
    return Measured(result, loaded, method, described.inputs, score)
