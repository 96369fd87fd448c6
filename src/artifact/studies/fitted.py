"""Original against suppressed descriptors, fitted and evaluated on regions that share no place.

One pass evaluates the original and every low-rank transform as views; per-condition standardisation rescales columns
and gets a pass of its own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

import numpy as np

from artifact import store, suppression
from artifact.datasets import Dataset
from artifact.extraction.described import Described, describe
from artifact.manifest import Manifest
from artifact.metrics.evaluate import evaluate
from artifact.metrics.evaluation import Evaluation
from artifact.metrics.stored import stored
from artifact.ranking import one_pass
from artifact.ranking.one_pass import ORIGINAL
from artifact.suppression.inlp import INLP
from artifact.suppression.leace import LEACE
from artifact.suppression.lowrank import LowRankMap, compose
from artifact.suppression.probe import Guardedness, probe
from artifact.suppression.regions import Split, Where, split
from artifact.suppression.std import STD

REVISION = 2  # raise when a study of suppression gives another number from the same fits
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
    probes
        What the guardedness probe found, by suppression method.
    described, split
        What was evaluated, and where it was fitted.
    """

    evaluations: dict[str, Evaluation]
    probes: dict[str, Guardedness]
    described: Described
    split: Split


@dataclass(frozen=True)
class Region:
    """Descriptors and positions of an evaluation region.

    Attributes
    ----------
    queries, database
        ``(n, d)`` descriptors.
    query_positions, database_positions
        ``(n, p)`` in the unit of ``threshold``.
    threshold
        Positive threshold in metres or frames.
    """

    queries: np.ndarray
    database: np.ndarray
    query_positions: np.ndarray
    database_positions: np.ndarray
    threshold: float

    @property
    def places(self) -> tuple[np.ndarray, np.ndarray, float]:
        """Positions and threshold, as :func:`artifact.evaluate` takes them."""
        return self.query_positions, self.database_positions, self.threshold


def evaluation_region(
    described: Described, where: Split, query: str | None = None, database: str | None = None
) -> Region:
    """Return the evaluation region of a split; of another pair of traversals if they are named."""
    names = query or described.dataset.query_name, database or described.dataset.database_name
    rows = where.evaluation_queries, where.evaluation_database
    values = [described.descriptors[name].values[chosen] for name, chosen in zip(names, rows, strict=True)]
    places = [described.dataset.traversals[name].positions[chosen] for name, chosen in zip(names, rows, strict=True)]
    return Region(*values, *places, described.dataset.threshold)


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
    dataset: Dataset, fraction: float, evaluation_fraction: float | None = None, where: Where = "centre"
) -> Split:
    """Split the pair of a dataset by its positions."""
    places = dataset.query.positions, dataset.database.positions, dataset.threshold
    return split(*places, fraction, evaluation_fraction=evaluation_fraction, where=where)


def evaluate_region(described: Described, where: Split, views: Mapping[str, Any], **options: Any) -> Evaluation:
    """Evaluate the original and every view on the evaluation region; the distractors are the evaluation queries."""
    region = evaluation_region(described, where)
    return evaluate(region.queries, region.database, *region.places, views=views, **options)


def evaluate_standardised(described: Described, where: Split, standardise: STD, **options: Any) -> Evaluation:
    """Evaluate the evaluation region under STD; distractors carry the query condition."""
    region = evaluation_region(
        described, where
    )  # copies, which may be changed: they can be as large as the memory allows
    rescaled = (
        standardise.transform(region.queries, QUERY, copy=False),
        standardise.transform(region.database, DATABASE, copy=False),
    )
    return evaluate(*rescaled, *region.places, **options)


def compare(
    manifest: Manifest, dataset: str, method: str, *, fraction: float = 0.1, iterations: int = 35, seed: int = 0
) -> Suppressed:
    """Fit INLP, LEACE and STD on one region and evaluate them beside the original on the other (paper Fig. 8).

    Parameters
    ----------
    manifest, dataset, method
        What to evaluate.
    fraction
        Share of the queries to fit on.
    iterations
        INLP iterations.
    seed
        Seed of INLP and of the probe.
    """
    described = describe(manifest, dataset, method)
    where = split_of(described.dataset, fraction)
    key = key_of("compare", [described], [fraction, iterations, seed])

    def compute() -> dict[str, Any]:
        fitted = fit(*fitting_data(described, where), iterations=iterations, seed=seed)
        return {
            "views": evaluate_region(described, where, {name: fitted[name] for name in LOW_RANK}, seed=seed),
            "STD": evaluate_standardised(described, where, fitted["STD"], seed=seed),
            "probes": _probe_all(described, where, fitted, seed),
        }

    results = stored(manifest, key, compute, {"dataset": dataset, "method": method, "stage": "suppression"})
    evaluations = {name: results["views"][name] for name in (ORIGINAL, *LOW_RANK)} | {"STD": results["STD"]}
    probes = {
        name: Guardedness(accuracy, bool(converged))
        for name, (accuracy, converged) in zip((ORIGINAL, *METHODS), results["probes"].tolist(), strict=True)
    }
    return Suppressed(evaluations, probes, described, where)


def _probe_all(described: Described, where: Split, fitted: Mapping[str, Any], seed: int) -> np.ndarray:
    """Accuracy and convergence ``(4, 2)`` of the probe on the original and the suppressed descriptors."""
    region = evaluation_region(described, where)
    names = (ORIGINAL, *METHODS)
    found = [probe(region.queries, region.database, *region.places, transform=fitted.get(n), seed=seed) for n in names]
    return np.array(found, np.float64)


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
    regions = {fraction: split_of(described.dataset, fraction, 0.5) for fraction in fractions}
    usable = {f: r for f, r in regions.items() if min(len(r.fit_queries), len(r.fit_database)) >= 2}
    key = key_of("fractions", [described], [list(usable), iterations, seed])

    def compute() -> dict[str, Any]:
        views, standardised = {}, {}
        for fraction, region in usable.items():
            fitted = fit(*fitting_data(described, region), iterations=iterations, seed=seed)
            views |= {f"{name} {fraction!r}": fitted[name] for name in LOW_RANK}
            standardised[fraction] = fitted["STD"]
        region = next(iter(usable.values()))
        results: dict[str, Any] = {"views": evaluate_region(described, region, views, seed=seed)}
        for fraction, transform in standardised.items():
            results[f"STD {fraction!r}"] = evaluate_standardised(described, region, transform, seed=seed)
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
    key = key_of("sequential", list(described.values()), [suppressor, fraction, iterations, seed])

    def compute() -> dict[str, Any]:
        composed, arrays = None, {}
        for number, one in enumerate(described.values()):
            X, condition = fitting_data(one, split_of(one.dataset, fraction))
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


def key_of(stage: str, described: Sequence[Described], settings: Sequence[Any], **versions: Any) -> str:
    """Return the content key of what one stage makes of descriptors with fitted transforms.

    It holds the revisions of ranking, fits, regions, probe and studies, and the version of scikit-learn, whose
    classifiers decide INLP and the probe; ``versions`` are those of further libraries.
    """
    revisions = [one_pass.REVISION, suppression.REVISION, REVISION]
    return store.key(
        stage=stage,
        revisions=revisions,
        versions={"scikit-learn": version("scikit-learn"), **versions},
        inputs=[one.key_inputs() for one in described],
        settings=list(settings),
    )
