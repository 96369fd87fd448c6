"""Figs. 2 and 9: top-1 retrieval from mixed databases."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from artifact.datasets import Traversal
from artifact.extraction.described import Described, describe
from artifact.manifest import Manifest
from artifact.manifest.entries import ManifestError
from artifact.metrics import statistics
from artifact.metrics.evaluate import evaluate
from artifact.metrics.evaluation import Evaluation
from artifact.metrics.stored import stored
from artifact.ranking.one_pass import ORIGINAL
from artifact.studies import fitted, reported
from artifact.studies.common import PERCENT, is_reported, require_single_stage, shares
from artifact.studies.fitted import Fitting
from artifact.suppression.inlp import INLP

MIXED_SHARE = 0.05
"""Share of the frames of a traversal with the query's kind of condition that joins the database (paper Figs. 2, 9)."""

DRAWS = 20
"""Random choices of these frames: R@1 is the mean over them, the maps show the first."""


@dataclass(frozen=True)
class MixedDatabase:
    """Top-1 retrieval from a mixed-condition database, with the indices of the images that took part.

    ``added`` are frames of the added traversal, ``fitted_queries`` those of the fitting region, if there is one.
    ``evaluations`` are ``single`` and ``mixed`` for Fig. 2, ``original`` and ``INLP`` for Fig. 9, with the frames of the first
    draw, which the maps show. ``hits`` are those of every draw, ``(n, draws)`` by the same names, of the ``scored`` queries: those
    with a positive whichever frames are added, as indices into ``queries``.
    """

    described: Described
    added_traversal: Traversal
    added: np.ndarray
    evaluations: dict[str, Evaluation]
    hits: dict[str, np.ndarray]
    scored: np.ndarray
    queries: np.ndarray
    database: np.ndarray
    fitted_queries: np.ndarray

    @property
    def inputs(self) -> tuple[dict[str, Any], ...]:
        """One record per traversal, for provenance."""
        return self.described.inputs

    def recalls(self, name: str) -> np.ndarray:
        """Return R@1 in percent of each draw; their mean is the number that a page shows."""
        return PERCENT * self.hits[name].mean(axis=0)

    def replicates(self, seed: int) -> dict[str, np.ndarray]:
        """Return replicates ``(count,)`` of R@1 in percent, mean over draws, by evaluation."""
        data = self.described.dataset
        shares = np.stack([hits.mean(axis=1) for hits in self.hits.values()], axis=1)
        where = data.query.positions[self.queries[self.scored]], data.threshold
        found = PERCENT * statistics.replicates(shares, *where, seed=seed, stream=data.name)
        return dict(zip(self.hits, found, strict=True))


def mixed_database(
    manifest: Manifest, dataset: str, method: str, *, share: float = MIXED_SHARE, seed: int = 0
) -> MixedDatabase:
    """Fig. 2: R@1 with the database of the other condition alone, and with a few frames of the query's kind added."""
    described, extra, drawn = _with_added(manifest, dataset, method, share, seed)
    everything = np.arange(len(described.dataset.query)), np.arange(len(described.dataset.database))
    key = fitted.key_of("mixed", [described], [share, seed, DRAWS])

    def compute() -> dict[str, Any]:
        frames = {"single": drawn[0][:0], "mixed": drawn[0]}
        found: dict[str, Any] = {name: _retrieve(described, *everything, extra, f) for name, f in frames.items()}
        mixed = [found["mixed"], *(_retrieve(described, *everything, extra, f, distractors={}) for f in drawn[1:])]
        scored = found["single"].evaluated
        return found | {"scored": scored, "hits": _hits(mixed, scored)}

    found = stored(manifest, key, compute, {"dataset": dataset, "method": method, "stage": "mixed database"})
    evaluations = {name: found[name] for name in ("single", "mixed")}
    hits = {"single": _hits([evaluations["single"]], found["scored"]), "mixed": found["hits"]}
    return MixedDatabase(described, extra, drawn[0], evaluations, hits, found["scored"], *everything, np.zeros(0, int))


def mixed_database_suppressed(
    manifest: Manifest, dataset: str, method: str, *, share: float = MIXED_SHARE, **fitting: Any
) -> MixedDatabase:
    """Fig. 9: the mixed database before and after INLP, fitted as :class:`Fitting` says at the edge of the map."""
    how = Fitting(**fitting)
    described, extra, drawn = _with_added(manifest, dataset, method, share, how.seed)
    region = fitted.split_of(described.dataset, how.fraction, where="edge")
    fitting_places = described.dataset.query.positions[region.fit_queries]
    away = cKDTree(fitting_places).query(extra.positions)[0] > described.dataset.threshold
    drawn = [added[away[added]] for added in drawn]
    rows = region.evaluation_queries, region.evaluation_database
    key = fitted.key_of("mixed suppressed", [described], [share, *astuple(how), DRAWS])

    def compute() -> dict[str, Any]:
        inlp = INLP(how.iterations, seed=how.seed).fit(*fitted.fitting_data(described, region))
        views = {"INLP": inlp}
        first = _retrieve(described, *rows, extra, drawn[0], views=views)
        others = [_retrieve(described, *rows, extra, f, views=views, distractors={}) for f in drawn[1:]]
        scored = functools.reduce(np.intersect1d, [one.evaluated for one in (first, *others)])
        found = {name: _hits([one[name] for one in (first, *others)], scored) for name in (ORIGINAL, "INLP")}
        return {"views": first, "scored": scored} | found

    found = stored(manifest, key, compute, {"dataset": dataset, "method": method, "stage": "mixed database"})
    views, hits = ({name: of[name] for name in (ORIGINAL, "INLP")} for of in (found["views"], found))
    return MixedDatabase(described, extra, drawn[0], views, hits, found["scored"], *rows, region.fit_queries)


def _hits(evaluations: Sequence[Evaluation], scored: np.ndarray) -> np.ndarray:
    """Hits at 1 of some of the queries in each of several evaluations, ``(n, evaluations)``."""
    hits = [one.hits(1, distractors=False)[np.isin(one.evaluated, scored)] for one in evaluations]
    return np.stack(hits, axis=1)


def _with_added(
    manifest: Manifest, dataset: str, method: str, share: float, seed: int
) -> tuple[Described, Traversal, list[np.ndarray]]:
    """Descriptors, the traversal with the query's kind of condition, and draws of those of its frames that join the database."""
    require_single_stage(manifest, method)
    name = manifest.dataset(dataset).same_condition_traversal
    if name is None:
        raise ManifestError(
            f"dataset {dataset!r} names no same_condition_traversal in the manifest: a traversal with the query's kind of "
            f"condition, some of whose frames join the database"
        )
    described = describe(manifest, dataset, method, [name])
    extra = described.dataset.traversals[name]
    generator, size = np.random.default_rng(seed), max(1, round(share * len(extra)))
    return described, extra, [np.sort(generator.choice(len(extra), size, replace=False)) for _ in range(DRAWS)]


def _retrieve(
    described: Described, queries: np.ndarray, database: np.ndarray, extra: Traversal, added: np.ndarray, **options: Any
) -> Evaluation:
    """Evaluate against the database with the added frames; any database image within the threshold is right."""
    data = described.dataset
    values = np.concatenate([described.database.values[database], described.descriptors[extra.name].values[added]])
    positions = np.concatenate([data.database.positions[database], extra.positions[added]])
    places = data.query.positions[queries], positions, data.threshold
    return evaluate(described.query.values[queries], values, *places, retrieve=1, **options)


def mixed_table(found: Mapping[str, MixedDatabase]) -> pd.DataFrame:
    """Return what every query retrieves, by method and evaluation, and whether that is right.

    Columns: ``method``, ``evaluation``, ``query`` (index in the query traversal), ``retrieved`` (index; the added
    frames follow the database images), ``right``.
    """
    frames = []
    for method, one in found.items():
        for name, result in one.evaluations.items():
            columns = {
                "query": one.queries[result.evaluated],
                "retrieved": result.retrieved(1, distractors=False)[0][:, 0],
                "right": result.hits(1, distractors=False),
            }
            frames.append(pd.DataFrame({"method": method, "evaluation": name, **columns}))
    return pd.concat(frames, ignore_index=True)


def mixed_recall(
    manifest: Manifest, dataset: str, found: Mapping[str, MixedDatabase], figure: str, *, seed: int = 0
) -> pd.DataFrame:
    """Return R@1 of each method and panel, mean over draws, with its 95 % interval, and what the paper prints in its map.

    ``found`` is by method, from :func:`mixed_database` for ``"fig02"``, from :func:`mixed_database_suppressed` for
    ``"fig09"``. Columns: ``method``, ``evaluation``, ``R``, ``low``, ``high``, ``draw_low``, ``draw_high`` (percent; the interval
    holds the draws, since the paper shows one), ``queries``, ``reported``.
    """
    expected: dict[tuple[str, str], float] = {}
    if is_reported(manifest, dataset, "robotcar"):
        printed = reported.table(figure).itertuples(index=False, name=None)
        panels = {"single-condition": "single", "mixed-condition": "mixed", "original": ORIGINAL, "suppressed": "INLP"}
        expected = {(method, panels[panel]): percent for method, panel, percent in printed}
    rows = []
    for method, one in found.items():
        for name, sample in one.replicates(seed).items():
            drawn = one.recalls(name)
            (low, high), least, most = shares(sample), drawn.min(), drawn.max()
            numbers = drawn.mean(), min(low, least), max(high, most), least, most, len(one.hits[name])
            rows.append((method, name, *numbers, expected.get((method, name), np.nan)))
    columns = ["method", "evaluation", "R", "low", "high", "draw_low", "draw_high", "queries", "reported"]
    return pd.DataFrame(rows, columns=columns)
