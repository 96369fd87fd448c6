"""Beyond the paper: what suppression takes out of the descriptors, and which distractors stop winning."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from artifact.datasets.positives import positives_of
from artifact.extraction.described import Described, describe
from artifact.manifest import Manifest
from artifact.metrics.evaluate import evaluate
from artifact.metrics.evaluation import Evaluation
from artifact.metrics.stored import stored
from artifact.ranking.one_pass import ORIGINAL
from artifact.studies import fitted
from artifact.studies.common import PERCENT, require_single_stage
from artifact.suppression.regions import Split

PAIRS = 20_000
"""Most pairs of images of one kind whose similarities are kept, drawn at random."""

KINDS = ("same place, other condition", "other place, same condition", "other place, other condition")
"""Pairs of a query with: its positives, its allowed distractors, the rest of the database."""


@dataclass(frozen=True)
class Erased:
    """What changes between the original descriptors and the suppressed ones, on the evaluation region.

    Attributes
    ----------
    evaluations
        ``original``, ``LEACE`` and ``INLP``, with each query's top image.
    iterations
        One row per INLP iteration, from 0: ``iteration``, ``R``, ``DAR`` and ``accuracy`` (balanced training accuracy
        of the classifier fitted next) in percent.
    similarities
        By view and kind of pair (:data:`KINDS`): cosines of at most :data:`PAIRS` pairs.
    """

    evaluations: dict[str, Evaluation]
    iterations: pd.DataFrame
    similarities: dict[str, dict[str, np.ndarray]]
    described: Described
    split: Split

    def lost_and_recovered(self, view: str) -> tuple[np.ndarray, np.ndarray]:
        """Return places in ``evaluated`` of queries that distractors take, and of those of them that a view recovers."""
        before, after = self.evaluations[ORIGINAL], self.evaluations[view]
        lost = before.hits(1, distractors=False) & ~before.hits(1, distractors=True)
        return np.flatnonzero(lost), np.flatnonzero(lost & after.hits(1, distractors=True))


def what_is_erased(
    manifest: Manifest, dataset: str, method: str, *, fraction: float = 0.1, iterations: int = 35, seed: int = 0
) -> Erased:
    """Compare original and suppressed descriptors: similarities, every INLP iteration, each query's top image."""
    require_single_stage(manifest, method)
    described = describe(manifest, dataset, method)
    region = fitted.split_of(described.dataset, fraction)
    key = fitted.key_of("erased", [described], [fraction, iterations, seed, PAIRS])

    def compute() -> dict[str, Any]:
        X, condition = fitted.fitting_data(described, region)
        inlp, leace = fitted.fit(X, condition, fitted.LOW_RANK, iterations=iterations, seed=seed).values()
        steps = {f"INLP {i}": inlp.at(i) for i in range(1, iterations + 1)}
        # The last iteration is the fitted INLP; the ones between need no retrieval lists but share the pass.
        options = {"views": {"LEACE": leace, **steps}, "retrieve": 1, "seed": seed}
        found = evaluate(*fitted.evaluation_region(described, region), **options)
        results: dict[str, Any] = {"views": found, "accuracies": inlp.accuracies_}
        for view, transform in ((ORIGINAL, None), ("LEACE", leace), ("INLP", inlp)):
            for kind, values in _similarities(described, region, transform, seed).items():
                results[f"{view} | {kind}"] = values
        return results

    found = stored(manifest, key, compute, {"dataset": dataset, "method": method, "stage": "what is erased"})
    views = found["views"]
    accuracies = np.append(found["accuracies"], np.full(iterations + 1 - len(found["accuracies"]), np.nan))
    steps = [views, *(views[f"INLP {i}"] for i in range(1, iterations + 1))]
    table = pd.DataFrame(
        {
            "iteration": np.arange(iterations + 1),
            "R": [PERCENT * step.recall(1) for step in steps],
            "DAR": [PERCENT * step.dar(1) for step in steps],
            "accuracy": PERCENT * accuracies,
        }
    )
    evaluations = {ORIGINAL: views, "LEACE": views["LEACE"], "INLP": views[f"INLP {iterations}"]}
    similarities = {view: {kind: found[f"{view} | {kind}"] for kind in KINDS} for view in evaluations}
    return Erased(evaluations, table, similarities, described, region)


def _similarities(described: Described, region: Split, transform: Any, seed: int) -> dict[str, np.ndarray]:
    queries, database, places, other_places, threshold = fitted.evaluation_region(described, region)
    if transform is not None:
        queries, database = transform.transform(queries), transform.transform(database)
    queries, database = (part / np.linalg.norm(part, axis=1, keepdims=True) for part in (queries, database))
    generator = np.random.default_rng(seed)

    def cosines(of: np.ndarray, pairs: np.ndarray) -> np.ndarray:
        return np.einsum("nd,nd->n", queries[pairs[:, 0]], of[pairs[:, 1]]).astype(np.float32)

    def distant_pairs(others: np.ndarray) -> np.ndarray:
        n, m = len(places), len(others)
        chosen = generator.choice(n * m, min(PAIRS, n * m), replace=False)
        first, second = chosen // m, chosen % m
        away = np.linalg.norm(places[first] - others[second], axis=1) > threshold
        return np.column_stack([first, second])[away]

    across, within = distant_pairs(other_places), distant_pairs(places)
    starts, near = positives_of(places, other_places, threshold)
    positive = np.column_stack([np.repeat(np.arange(len(places)), np.diff(starts)), near])
    kept = positive[np.sort(generator.permutation(len(positive))[:PAIRS])]
    return dict(zip(KINDS, (cosines(database, kept), cosines(queries, within), cosines(database, across)), strict=True))
