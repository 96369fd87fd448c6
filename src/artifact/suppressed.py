"""Original against suppressed descriptors, fitted and evaluated on regions that share no place.

One pass evaluates the original and every low-rank transform as views; per-condition standardisation rescales columns
and gets a pass of its own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from artifact import probe, ranking, store, suppression
from artifact.archive import stored
from artifact.lowrank import LowRankMap, compose
from artifact.manifest import Manifest
from artifact.metrics import Evaluation, evaluate
from artifact.pipeline import Described, describe
from artifact.ranking import ORIGINAL
from artifact.splits import Split, Where, split
from artifact.suppression import INLP, LEACE, STD

QUERY, DATABASE = 0, 1  # the condition labels of the paper: query against database
LOW_RANK = ("INLP", "LEACE")
METHODS = (*LOW_RANK, "STD")
"""The paper's three suppression methods."""


@dataclass(frozen=True)
class Suppressed:
    """The outcome of one fit: evaluations and probe accuracies on the same evaluation region.

    Attributes
    ----------
    evaluations
        By suppression method, ``"original"`` first.
    accuracies
        Test accuracy of the guardedness probe by suppression method, as a fraction; empty if it was not asked for.
    inlp_accuracies
        Balanced training accuracy of each INLP classifier.
    described, split
        What was evaluated, and where it was fitted.
    """

    evaluations: dict[str, Evaluation]
    accuracies: dict[str, float]
    inlp_accuracies: np.ndarray
    described: Described
    split: Split

    def change(self, name: str, metric: str, k: int = 1) -> float:
        """Return suppressed minus original, ``"R"`` or ``"DAR"`` at K, as a fraction."""
        after, before = self.evaluations[name], self.evaluations[ORIGINAL]
        return after.recall(k) - before.recall(k) if metric == "R" else after.dar(k) - before.dar(k)


def fitting_data(described: Described, where: Split) -> tuple[np.ndarray, np.ndarray]:
    """Return the descriptors of the fitting region and their conditions (query or database)."""
    queries = described.query.values[where.fit_queries]
    database = described.database.values[where.fit_database]
    return np.concatenate([queries, database]), np.repeat([QUERY, DATABASE], [len(queries), len(database)])


def fit(X: np.ndarray, condition: np.ndarray, *, iterations: int = 35, seed: int = 0) -> dict[str, Any]:
    """Fit the paper's three suppression methods on the same data."""
    return {
        "INLP": INLP(iterations, seed=seed).fit(X, condition),
        "LEACE": LEACE().fit(X, condition),
        "STD": STD().fit(X, condition),
    }


def split_of(
    described: Described, fraction: float, evaluation_fraction: float | None = None, where: Where = "centre"
) -> Split:  # fmt: skip
    """Split a described dataset by its positions."""
    data = described.dataset
    return split(
        data.query.positions, data.database.positions, data.threshold, fraction,
        evaluation_fraction=evaluation_fraction, where=where,
    )  # fmt: skip


def evaluate_region(
    described: Described, where: Split, views: Mapping[str, Any], *, standardise: STD | None = None, **options: Any
) -> dict[str, Evaluation]:  # fmt: skip
    """Evaluate the original and every view on the evaluation region, and STD if given.

    Distractors are the evaluation queries; under STD they carry the query condition.
    """
    data = described.dataset
    queries = described.query.values[where.evaluation_queries]
    database = described.database.values[where.evaluation_database]
    places = (
        data.query.positions[where.evaluation_queries], data.database.positions[where.evaluation_database], data.threshold,
    )  # fmt: skip
    result = evaluate(queries, database, *places, views=views, **options)
    found = {name: result[name] for name in (ORIGINAL, *views)}
    if standardise is not None:
        rescaled = standardise.transform(queries, QUERY), standardise.transform(database, DATABASE)
        found["STD"] = evaluate(*rescaled, *places, **options)
    return found


def compare(
    manifest: Manifest,
    dataset: str,
    method: str,
    *,
    fraction: float = 0.1,
    evaluation_fraction: float | None = None,
    where: Where = "centre",
    iterations: int = 35,
    seed: int = 0,
    retrieve: int = 0,
    probed: bool = True,
) -> Suppressed:
    """Fit INLP, LEACE and STD on one region and evaluate them beside the original on the other (paper Fig. 8).

    Parameters
    ----------
    manifest, dataset, method
        What to evaluate.
    fraction, evaluation_fraction, where
        As in :func:`artifact.splits.split`.
    iterations
        INLP iterations.
    seed
        Seed of INLP and of the probe.
    retrieve
        Length of the retrieval lists.
    probed
        Whether to measure how well a linear classifier still tells the condition.
    """
    described = describe(manifest, dataset, method)
    region = split_of(described, fraction, evaluation_fraction, where)
    settings = [fraction, evaluation_fraction, where, iterations, seed, retrieve, probed]
    key = _key("compare", [described], settings)

    def compute() -> dict[str, Any]:
        fitted = fit(*fitting_data(described, region), iterations=iterations, seed=seed)
        views = {name: fitted[name] for name in LOW_RANK}
        found = evaluate_region(described, region, views, standardise=fitted["STD"], retrieve=retrieve, seed=seed)
        results: dict[str, Any] = {"views": found[ORIGINAL], "STD": found["STD"]}
        results["inlp_accuracies"] = fitted["INLP"].accuracies_
        if probed:
            results["accuracies"] = _probe_all(described, region, fitted, seed)
        return results

    results = stored(manifest, key, compute, {"dataset": dataset, "method": method, "stage": "suppression"})
    evaluations = {name: results["views"][name] for name in (ORIGINAL, *LOW_RANK)} | {"STD": results["STD"]}
    accuracies = dict(zip((ORIGINAL, *METHODS), results["accuracies"].tolist(), strict=True)) if probed else {}
    return Suppressed(evaluations, accuracies, results["inlp_accuracies"], described, region)


def _probe_all(described: Described, region: Split, fitted: Mapping[str, Any], seed: int) -> np.ndarray:
    """Probe accuracies of the original and the suppressed descriptors of the evaluation region."""
    data = described.dataset
    queries = described.query.values[region.evaluation_queries]
    database = described.database.values[region.evaluation_database]
    rows = probe.probe_split(
        data.query.positions[region.evaluation_queries], data.database.positions[region.evaluation_database], seed
    )
    pairs = [(queries, database), *((fitted[n].transform(queries), fitted[n].transform(database)) for n in LOW_RANK)]
    pairs.append((fitted["STD"].transform(queries, QUERY), fitted["STD"].transform(database, DATABASE)))
    return np.array([probe.probe_accuracy(*pair, rows, seed) for pair in pairs])


def by_fraction(
    manifest: Manifest, dataset: str, method: str, fractions: Sequence[float], *, iterations: int = 35, seed: int = 0
) -> tuple[dict[tuple[str, float], Evaluation], Described]:
    """Fit on growing regions and evaluate all of them on the same outer half (paper Fig. 10).

    Parameters
    ----------
    fractions
        Query fitting fractions in (0, 0.5].

    Returns
    -------
    evaluations
        By suppression method and fraction; ``("original", 0.0)`` is without suppression. A fraction whose region has
        fewer than two images of a condition is left out.
    described
        What was evaluated.
    """
    described = describe(manifest, dataset, method)
    regions = {fraction: split_of(described, fraction, 0.5) for fraction in fractions}
    usable = {f: r for f, r in regions.items() if min(len(r.fit_queries), len(r.fit_database)) >= 2}
    key = _key("fractions", [described], [list(usable), iterations, seed])

    def compute() -> dict[str, Any]:
        views, standardised = {}, {}
        for fraction, region in usable.items():
            fitted = fit(*fitting_data(described, region), iterations=iterations, seed=seed)
            views |= {f"{name} {fraction!r}": fitted[name] for name in LOW_RANK}
            standardised[fraction] = fitted["STD"]
        region = next(iter(usable.values()))
        results: dict[str, Any] = {"views": evaluate_region(described, region, views, seed=seed)[ORIGINAL]}
        for fraction, transform in standardised.items():
            found = evaluate_region(described, region, {}, standardise=transform, seed=seed)
            results[f"STD {fraction!r}"] = found["STD"]
        return results

    results = stored(manifest, key, compute, {"dataset": dataset, "method": method, "stage": "fractions"})
    found = {(ORIGINAL, 0.0): results["views"]}
    for fraction in usable:
        found |= {(name, fraction): results["views"][f"{name} {fraction!r}"] for name in LOW_RANK}
        found["STD", fraction] = results[f"STD {fraction!r}"]
    return found, described


@dataclass(frozen=True)
class Erasure:
    """One suppression method fitted on several datasets in turn, and composed (paper §V-E).

    Attributes
    ----------
    composed
        The transform of all datasets in one map.
    single
        The transform fitted on each dataset alone.
    """

    composed: LowRankMap
    single: dict[str, LowRankMap]


def sequential(
    manifest: Manifest,
    names: Sequence[str],
    method: str,
    suppressor: str,
    *,
    fraction: float = 0.1,
    iterations: int = 35,
    seed: int = 0,
) -> tuple[Erasure, dict[str, Described]]:
    """Fit one suppression method on dataset after dataset, each on descriptors already erased by the earlier ones.

    Parameters
    ----------
    names
        Datasets in the order of fitting.
    suppressor
        ``"INLP"`` or ``"LEACE"``.

    Returns
    -------
    erasure
        The composed transform and the single ones.
    described
        The datasets' descriptors.
    """
    described = {name: describe(manifest, name, method) for name in names}
    key = _key("sequential", list(described.values()), [suppressor, fraction, iterations, seed])

    def compute() -> dict[str, Any]:
        composed, arrays = None, {}
        for number, one in enumerate(described.values()):
            X, condition = fitting_data(one, split_of(one, fraction))
            single = _fitted(suppressor, X, condition, iterations, seed)
            arrays |= _parts(f"single {number}", single)
            if composed is None:
                composed = single
            else:
                composed = compose(composed, _fitted(suppressor, composed.transform(X), condition, iterations, seed))
        return arrays | _parts("composed", composed)

    arrays = stored(manifest, key, compute, {"datasets": list(names), "method": method, "stage": "sequential"})

    def read(prefix: str) -> LowRankMap:
        return LowRankMap(*(arrays[f"{prefix} {part}"] for part in ("left", "right", "offset")))

    return Erasure(read("composed"), {name: read(f"single {n}") for n, name in enumerate(names)}), described


def _fitted(suppressor: str, X: np.ndarray, condition: np.ndarray, iterations: int, seed: int) -> LowRankMap:
    estimator = INLP(iterations, seed=seed) if suppressor == "INLP" else LEACE()
    return LowRankMap(*estimator.fit(X, condition).low_rank())


def _parts(prefix: str, transform: LowRankMap) -> dict[str, np.ndarray]:
    return {
        f"{prefix} {name}": part for name, part in zip(("left", "right", "offset"), transform.low_rank(), strict=True)
    }


def _key(stage: str, described: Sequence[Described], settings: Sequence[Any]) -> str:
    return store.key(
        stage=stage, revisions=[ranking.REVISION, suppression.REVISION],
        inputs=[one.key_inputs() for one in described], settings=list(settings),
    )  # fmt: skip
