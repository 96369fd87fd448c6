"""Figs. 1 to 3 and 9: mixed databases on the map, embeddings before and after, and what a distractor is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from artifact.extraction.described import Described, describe
from artifact.manifest import Manifest
from artifact.manifest.entries import ManifestError
from artifact.metrics.evaluate import evaluate
from artifact.metrics.evaluation import Evaluation
from artifact.metrics.stored import stored
from artifact.ranking.one_pass import ORIGINAL
from artifact.studies import fitted, reported
from artifact.studies.common import PERCENT, is_reported, percent_interval, require_single_stage
from artifact.studies.fitted import key_of
from artifact.suppression.inlp import INLP
from artifact.suppression.lowrank import LowRankMap

MIXED_SHARE = 0.05
"""Share of the frames of a traversal with the query's kind of condition that joins the database (paper Figs. 2, 9)."""


@dataclass(frozen=True)
class MixedDatabase:
    """Top-1 retrieval from a mixed-condition database.

    Attributes
    ----------
    described
        The dataset's descriptors, the added traversal among them.
    added
        Indices of the frames of the added traversal that joined the database.
    evaluations
        By what was evaluated: ``single`` and ``mixed`` for Fig. 2, ``original`` and ``INLP`` for Fig. 9.
    queries, database
        Indices of the queries and of the database images that took part.
    fitted_queries
        Indices of the queries of the fitting region; empty without one.
    """

    described: Described
    added: np.ndarray
    evaluations: dict[str, Evaluation]
    queries: np.ndarray
    database: np.ndarray
    fitted_queries: np.ndarray

    @property
    def inputs(self) -> tuple[dict[str, Any], ...]:
        """One record per traversal, for provenance."""
        return self.described.inputs


def mixed_database(
    manifest: Manifest, dataset: str, method: str, *, share: float = MIXED_SHARE, seed: int = 0
) -> MixedDatabase:
    """Fig. 2: R@1 with the database of the other condition alone, and with a few frames of the query's kind added."""
    described, added = _with_added(manifest, dataset, method, share, seed)
    loaded = described.dataset
    everything = np.arange(len(loaded.query)), np.arange(len(loaded.database))
    key = key_of("mixed", [described], [share, seed])

    def compute() -> dict[str, Any]:
        alone = _retrieve(described, *everything, added[:0])
        return {"single": alone, "mixed": _retrieve(described, *everything, added)}

    found = stored(manifest, key, compute, {"dataset": dataset, "method": method, "stage": "mixed database"})
    return MixedDatabase(described, added, found, *everything, np.zeros(0, int))


def mixed_database_suppressed(
    manifest: Manifest,
    dataset: str,
    method: str,
    *,
    share: float = MIXED_SHARE,
    fraction: float = 0.1,
    iterations: int = 35,
    seed: int = 0,
) -> MixedDatabase:
    """Fig. 9: the mixed database before and after INLP, fitted on a slice from the edge of the map."""
    described, added = _with_added(manifest, dataset, method, share, seed)
    region = fitted.split_of(described.dataset, fraction, where="edge")
    places = described.dataset.traversals[_same_condition(manifest, dataset)].positions[added]
    fitting_places = described.dataset.query.positions[region.fit_queries]
    apart = np.linalg.norm(places[:, None] - fitting_places[None], axis=2).min(axis=1) > described.dataset.threshold
    rows = region.evaluation_queries, region.evaluation_database
    key = key_of("mixed suppressed", [described], [share, fraction, iterations, seed])

    def compute() -> dict[str, Any]:
        inlp = INLP(iterations, seed=seed).fit(*fitted.fitting_data(described, region))
        return {"views": _retrieve(described, *rows, added[apart], {"INLP": LowRankMap(*inlp.low_rank())})}

    found = stored(manifest, key, compute, {"dataset": dataset, "method": method, "stage": "mixed database"})["views"]
    return MixedDatabase(described, added[apart], {n: found[n] for n in (ORIGINAL, "INLP")}, *rows, region.fit_queries)


def _same_condition(manifest: Manifest, dataset: str) -> str:
    entry = manifest.dataset(dataset)
    if entry.same_condition_traversal is None:
        raise ManifestError(
            f"dataset {dataset!r} names no same_condition_traversal in the manifest: a traversal with the query's kind of "
            f"condition, some of whose frames join the database"
        )
    return entry.same_condition_traversal


def _with_added(manifest: Manifest, dataset: str, method: str, share: float, seed: int) -> tuple[Described, np.ndarray]:
    require_single_stage(manifest, method)
    name = _same_condition(manifest, dataset)
    described = describe(manifest, dataset, method, [name])
    n = len(described.dataset.traversals[name])
    chosen = np.random.default_rng(seed).choice(n, max(1, round(share * n)), replace=False)
    return described, np.sort(chosen)


def _retrieve(
    described: Described, queries: np.ndarray, database: np.ndarray, added: np.ndarray, views: Any = None
) -> Evaluation:
    """Evaluate against the database with the added frames; any database image within the threshold is right."""
    loaded = described.dataset
    extra = next(name for name in loaded.traversals if name not in (loaded.query_name, loaded.database_name))
    descriptors = [described.database.values[database], described.descriptors[extra].values[added]]
    positions = [loaded.database.positions[database], loaded.traversals[extra].positions[added]]
    return evaluate(
        described.query.values[queries],
        np.concatenate(descriptors),
        loaded.query.positions[queries],
        np.concatenate(positions),
        loaded.threshold,
        views=views,
        retrieve=1,
    )


def mixed_table(found: Mapping[str, MixedDatabase]) -> pd.DataFrame:
    """Return one row per method, evaluation and query: where it is, what it retrieves, and whether that is right.

    Columns: ``method``, ``evaluation``, ``query`` (index in the query traversal), ``retrieved`` (index; the added
    frames follow the database images), ``right``.
    """
    frames = []
    for method, one in found.items():
        for name, result in one.evaluations.items():
            frames.append(
                pd.DataFrame(
                    {
                        "method": method,
                        "evaluation": name,
                        "query": one.queries[result.evaluated],
                        "retrieved": result.retrieved(1, distractors=False)[0][:, 0],
                        "right": result.hits(1, distractors=False),
                    }
                )
            )
    return pd.concat(frames, ignore_index=True)


def mixed_recall(
    manifest: Manifest, dataset: str, found: Mapping[str, MixedDatabase], figure: str, *, seed: int = 0
) -> pd.DataFrame:
    """Return R@1 of each method and panel with its 95 % interval, and what the paper prints in the corner of its map.

    Parameters
    ----------
    found
        By method, as from :func:`mixed_database` (``figure="fig02"``) or :func:`mixed_database_suppressed` (``"fig09"``).

    Returns
    -------
    pandas.DataFrame
        Columns ``method``, ``evaluation``, ``R``, ``low``, ``high`` (percent), ``queries``, ``reported``.
    """
    expected: dict[tuple[str, str], float] = {}
    if is_reported(manifest, dataset, "robotcar"):
        rows = reported.table(figure).itertuples(index=False, name=None)
        panels = {"single-condition": "single", "mixed-condition": "mixed", "original": ORIGINAL, "suppressed": "INLP"}
        expected = {(method, panels[panel]): percent for method, panel, percent in rows}
    table = []
    for method, one in found.items():
        for name, result in one.evaluations.items():
            hits = result.hits(1, distractors=False)
            low, high = percent_interval(hits[:, None], result, seed=seed)
            row = {"method": method, "evaluation": name, "R": PERCENT * hits.mean(), "low": low[0], "high": high[0]}
            table.append(row | {"queries": len(hits), "reported": expected.get((method, name), np.nan)})
    return pd.DataFrame(table)
