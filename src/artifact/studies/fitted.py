"""Original against suppressed descriptors, fitted and evaluated on regions that share no place.

One pass evaluates the original and every low-rank transform as views; per-condition standardisation rescales columns
and gets a pass of its own.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import astuple, dataclass
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
from artifact.suppression.regions import Split, split
from artifact.suppression.std import STD

REVISION = 2  # raise when a study of suppression gives another number from the same fits
QUERY, DATABASE = 0, 1  # the condition labels of the paper: query against database
LOW_RANK = ("INLP", "LEACE")
METHODS = (*LOW_RANK, "STD")
"""The paper's three suppression methods."""

_PARTS = ("left", "right", "offset")  # of a low-rank map


@dataclass(frozen=True)
class Fitting:
    """How suppression is fitted: share of the queries to fit on, INLP's iterations, seed of INLP and the probe."""

    fraction: float = 0.1
    iterations: int = 35
    seed: int = 0


@dataclass(frozen=True)
class Suppressed:
    """Evaluations and probes on the same evaluation region, by suppression method, ``"original"`` first."""

    evaluations: dict[str, Evaluation]
    probes: dict[str, Guardedness]
    described: Described
    split: Split


def evaluation_region(
    described: Described, where: Split
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, float]:
    """Return the evaluation region of a split as :func:`artifact.evaluate` takes it: descriptors, positions, threshold."""
    queries, database, data = where.evaluation_queries, where.evaluation_database, described.dataset
    values = described.query.values[queries], described.database.values[database]
    return *values, data.query.positions[queries], data.database.positions[database], data.threshold


def fitting_data(described: Described, where: Split) -> tuple[np.ndarray, np.ndarray]:
    """Return the descriptors of the fitting region and their conditions (query or database)."""
    queries = described.query.values[where.fit_queries]
    database = described.database.values[where.fit_database]
    return np.concatenate([queries, database]), np.repeat([QUERY, DATABASE], [len(queries), len(database)])


def fit(
    X: np.ndarray, condition: np.ndarray, names: Iterable[str] = METHODS, *, iterations: int = 35, seed: int = 0
) -> dict[str, Any]:
    """Fit some of the paper's three suppression methods on the same data, in the order of ``names``."""
    estimators = {"INLP": INLP(iterations, seed=seed), "LEACE": LEACE(), "STD": STD()}
    with store.stage("fit"):
        return {name: estimators[name].fit(X, condition) for name in names}


def split_of(dataset: Dataset, fraction: float, **options: Any) -> Split:
    """Split the pair of a dataset by its positions, with the options of :func:`artifact.split`."""
    return split(dataset.query.positions, dataset.database.positions, dataset.threshold, fraction, **options)


def evaluate_standardised(described: Described, where: Split, standardise: STD, **options: Any) -> Evaluation:
    """Evaluate the evaluation region under STD; distractors carry the query condition."""
    # Copies, which may be changed in place: they can be as large as the memory allows.
    queries, database, *places = evaluation_region(described, where)
    rescaled = standardise.transform(queries, QUERY, copy=False), standardise.transform(database, DATABASE, copy=False)
    return evaluate(*rescaled, *places, **options)


def compare(manifest: Manifest, dataset: str, method: str, **fitting: Any) -> Suppressed:
    """Fit INLP, LEACE and STD as :class:`Fitting` says, evaluate them beside the original elsewhere (paper Fig. 8)."""
    how = Fitting(**fitting)
    described = describe(manifest, dataset, method)
    where = split_of(described.dataset, how.fraction)

    def compute() -> dict[str, Any]:
        fitted = fit(*fitting_data(described, where), iterations=how.iterations, seed=how.seed)
        standardised = evaluate_standardised(described, where, fitted["STD"], seed=how.seed)
        region = evaluation_region(described, where)
        views = evaluate(*region, views={name: fitted[name] for name in LOW_RANK}, seed=how.seed)
        with store.stage("fit"):
            probes = [probe(*region, transform=fitted.get(name), seed=how.seed) for name in (ORIGINAL, *METHODS)]
        return {"views": views, "STD": standardised, "probes": np.array(probes, np.float64)}

    key = key_of("compare", [described], astuple(how))
    results = stored(manifest, key, compute, {"dataset": dataset, "method": method, "stage": "suppression"})
    evaluations = {name: results["views"][name] for name in (ORIGINAL, *LOW_RANK)} | {"STD": results["STD"]}
    found = [Guardedness(accuracy, bool(converged)) for accuracy, converged in results["probes"].tolist()]
    return Suppressed(evaluations, dict(zip(evaluations, found, strict=True)), described, where)


def by_fraction(
    manifest: Manifest, dataset: str, method: str, fractions: Sequence[float], *, iterations: int = 35, seed: int = 0
) -> tuple[dict[tuple[str, float], Evaluation], Described]:
    """Fit on growing regions, fractions in (0, 0.5], and evaluate all of them on the same outer half (paper Fig. 10).

    Evaluations are by suppression method and fraction; ``("original", 0.0)`` is without suppression. A fraction whose
    region has fewer than two images of a condition is left out.
    """
    described = describe(manifest, dataset, method)
    regions = {fraction: split_of(described.dataset, fraction, evaluation_fraction=0.5) for fraction in fractions}
    usable = {f: r for f, r in regions.items() if min(len(r.fit_queries), len(r.fit_database)) >= 2}
    key = key_of("fractions", [described], [list(usable), iterations, seed])

    def compute() -> dict[str, Any]:
        views, standardised = {}, {}
        for fraction, region in usable.items():
            fitted = fit(*fitting_data(described, region), iterations=iterations, seed=seed)
            views |= {f"{name} {fraction!r}": fitted[name] for name in LOW_RANK}
            evaluation = evaluate_standardised(described, region, fitted["STD"], seed=seed)
            standardised[f"STD {fraction!r}"] = evaluation
        half = evaluation_region(described, next(iter(regions.values())))  # of every fraction
        return {"views": evaluate(*half, views=views, seed=seed)} | standardised

    results = stored(manifest, key, compute, {"dataset": dataset, "method": method, "stage": "fractions"})
    found = {(ORIGINAL, 0.0): results["views"]}
    for fraction in usable:
        found |= {(name, fraction): results["views"][f"{name} {fraction!r}"] for name in LOW_RANK}
        found["STD", fraction] = results[f"STD {fraction!r}"]
    return found, described


@dataclass(frozen=True)
class Erasure:
    """One suppression method fitted on several datasets in turn and composed (paper §V-E), and on each alone."""

    composed: LowRankMap
    single: dict[str, LowRankMap]


def sequential(
    manifest: Manifest, described: Mapping[str, Described], method: str, suppressor: str, how: Fitting
) -> Erasure:
    """Fit ``"INLP"`` or ``"LEACE"`` on dataset after dataset, each on descriptors already erased by the earlier ones.

    ``described`` are the datasets by name, in the order of fitting.
    """
    key = key_of("sequential", list(described.values()), [suppressor, *astuple(how)])

    def fitted(X: np.ndarray, condition: np.ndarray) -> LowRankMap:
        return fit(X, condition, [suppressor], iterations=how.iterations, seed=how.seed)[suppressor].map_

    def compute() -> dict[str, Any]:
        maps: dict[str, LowRankMap] = {}
        for number, one in enumerate(described.values()):
            X, condition = fitting_data(one, split_of(one.dataset, how.fraction))
            maps[f"single {number}"] = single = fitted(X, condition)
            earlier = maps.get("composed")
            maps["composed"] = compose(earlier, fitted(earlier.transform(X), condition)) if earlier else single
        return {f"{name} {part}": getattr(one, part) for name, one in maps.items() for part in _PARTS}

    arrays = stored(manifest, key, compute, {"datasets": list(described), "method": method, "stage": "sequential"})

    def read(name: str) -> LowRankMap:
        return LowRankMap(*(arrays[f"{name} {part}"] for part in _PARTS))

    return Erasure(read("composed"), {name: read(f"single {n}") for n, name in enumerate(described)})


def key_of(stage: str, described: Sequence[Described], settings: Sequence[Any], **versions: Any) -> str:
    """Return the content key of what one stage makes of descriptors with fitted transforms.

    It holds the version of scikit-learn, whose classifiers decide INLP and the probe; ``versions`` are those of further
    libraries.
    """
    return store.key(
        stage=stage,
        revisions=[one_pass.REVISION, suppression.REVISION, REVISION],
        versions={"scikit-learn": version("scikit-learn"), **versions},
        inputs=[one.key_inputs() for one in described],
        settings=list(settings),
    )
