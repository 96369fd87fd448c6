"""``artifact evaluate`` of descriptors in files: R@K, DAR@K and RSR@K without a manifest."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from artifact import store
from artifact.datasets import DatasetError
from artifact.datasets.arrays import read_descriptors, read_positions, read_threshold
from artifact.metrics.evaluate import evaluate
from artifact.metrics.evaluation import Evaluation
from artifact.metrics.statistics import intervals
from artifact.ranking.one_pass import ORIGINAL
from artifact.studies import fitted, preview
from artifact.studies.fitted import DATABASE, QUERY
from artifact.suppression.regions import split

LEVELS = (1, 5, 10)


class Images(NamedTuple):
    """Descriptors ``(n, d)`` with positions ``(n, p)`` in ``unit``, perhaps of a UTM zone."""

    descriptors: np.ndarray
    positions: np.ndarray
    unit: str
    zone: str | None


def run(options: argparse.Namespace) -> Iterator[str]:
    """Yield the lines of the evaluation that the options ask for.

    Raises
    ------
    DatasetError
        If a file is missing, cannot be read or does not fit the others.
    """
    if not (options.queries and options.database and options.threshold):
        raise DatasetError("--queries and --database are files of descriptors and go together with --threshold")
    queries = _images(options.queries, options.query_positions, "queries")
    database = _images(options.database, options.database_positions, "database")
    threshold = read_threshold(options.threshold)
    _check(f"--database {options.database}", database, queries)
    if (threshold.unit == "metres") != (queries.unit == "metres"):
        units = f"the threshold is in {threshold.unit}, the positions are in {queries.unit}"
        raise DatasetError(f"{units}; write 25m or 2frames")
    pools = dict(_pool(text, queries) for text in options.distractors)
    levels = options.k or LEVELS
    facts = {"threshold": str(threshold), **preview.counts(queries.positions, database.positions, threshold.value)}
    if not facts["evaluated"]:
        raise DatasetError(f"{preview.in_words(facts)}: nothing can be evaluated; is the threshold in the right unit?")
    try:
        results = _evaluated(queries, database, pools, threshold.value, options)
    except ValueError as error:
        raise DatasetError(str(error)) from None
    table = pd.DataFrame([row for name, result in results.items() for row in _rows(name, result, levels, options.seed)])
    if options.per_query:
        tables = [result.per_query().assign(what=name) for name, result in results.items()]
        with store.replacing(options.per_query) as temporary:
            pd.concat(tables).to_csv(temporary, index=False)
    if options.json:
        yield json.dumps({**facts, "results": table.to_dict("records")}, indent=1)
        return
    yield preview.in_words(facts)
    yield _shown(table)


def _images(file: Path, positions: Path | None, label: str) -> Images:
    found = read_descriptors(file)
    return Images(found.values, *read_positions(positions, found, label))


def _pool(text: str, queries: Images) -> tuple[str, Images]:
    name, equals, files = text.partition("=")
    if not equals or not name or not files:
        raise DatasetError(f"--distractors {text!r}: allowed: NAME=FILE or NAME=FILE,POSITIONS")
    file, comma, positions = files.partition(",")
    pool = _images(Path(file), Path(positions) if comma else None, f"distractors {name}")
    _check(f"--distractors {name}", pool, queries)
    return name, pool


def _check(label: str, found: Images, queries: Images) -> None:
    """Positions of a file must be of the queries' kind."""
    kinds = [f"{images.unit} ({images.positions.shape[1]} columns)" for images in (found, queries)]
    if kinds[0] != kinds[1]:
        fault = f"positions in {kinds[0]}, those of the queries in {kinds[1]}; both must be the same"
        raise DatasetError(f"{label}: {fault}")
    if found.zone and queries.zone and found.zone != queries.zone:
        fault = f"positions in the UTM zone {found.zone}, those of the queries in {queries.zone}"
        raise DatasetError(f"{label}: {fault}; give them as image,latitude,longitude in .csv files")


def _evaluated(
    queries: Images, database: Images, pools: dict[str, Images], threshold: float, options: argparse.Namespace
) -> dict[str, Evaluation]:
    """Results by what was done to the descriptors; with suppression on the evaluation region, else on everything."""
    if not options.suppress:
        return _by_pool(ORIGINAL, _ranked(queries, database, pools, threshold), pools)
    region = split(queries.positions, database.positions, threshold, options.fraction)
    parts = [queries.descriptors[region.fit_queries], database.descriptors[region.fit_database]]
    if min(map(len, parts)) < 2:
        has = f"the fitting region has {len(parts[0])} queries and {len(parts[1])} database images"
        raise DatasetError(f"{has}; 2 of each are needed: raise --fraction")
    X, condition = np.concatenate(parts).astype(np.float32), np.repeat([QUERY, DATABASE], [len(part) for part in parts])
    fits = fitted.fit(X, condition, options.suppress, seed=options.seed)
    queries = _part(queries, region.evaluation_queries)
    database = _part(database, region.evaluation_database)
    views = {name: fits[name] for name in fitted.LOW_RANK if name in fits}
    result = _ranked(queries, database, pools, threshold, views)
    results = {}
    for name in (ORIGINAL, *views):
        results |= _by_pool(name, result[name], pools)
    if std := fits.get("STD"):

        def rescaled(images: Images, condition: int) -> Images:
            return images._replace(descriptors=std.transform(images.descriptors, condition))

        others = {name: rescaled(pool, QUERY) for name, pool in pools.items()}
        result = _ranked(rescaled(queries, QUERY), rescaled(database, DATABASE), others, threshold)
        results |= _by_pool("STD", result, pools)
    return results


def _part(images: Images, rows: np.ndarray) -> Images:
    return images._replace(descriptors=images.descriptors[rows], positions=images.positions[rows])


def _ranked(queries: Images, database: Images, pools: dict[str, Images], threshold: float, views: Any = None) -> Any:
    values = {name: pool.descriptors for name, pool in pools.items()}
    places = {name: pool.positions for name, pool in pools.items()}
    pair = queries.descriptors, database.descriptors, queries.positions, database.positions
    return evaluate(*pair, threshold, values or None, places or None, views=views)


def _by_pool(name: str, result: Evaluation, pools: dict[str, Images]) -> dict[str, Evaluation]:
    return {f"{name}, {pool}": result.pool(pool) for pool in pools} if pools else {name: result}


def _rows(name: str, result: Evaluation, levels: Sequence[int], seed: int) -> Iterator[dict[str, Any]]:
    for k in levels:
        row: dict[str, Any] = {"what": name, "queries": result.n_queries, "K": k}
        for metric, interval in intervals(result, k, seed=seed).items():
            row |= {f"{metric}{end}": 100 * value for end, value in zip(("", "_low", "_high"), interval, strict=True)}
        yield row


def _shown(table: pd.DataFrame) -> str:
    shown = table[["what", "queries", "K"]].copy()
    for metric in ("R", "DAR", "RSR"):
        parts = table[[metric, f"{metric}_low", f"{metric}_high"]].to_numpy()
        shown[f"{metric}@K %"] = [f"{value:.2f} [{low:.1f}, {high:.1f}]" for value, low, high in parts]
    return shown.to_string(index=False)
