"""Figs. 8 and 10: what condition suppression changes, and how much data it needs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import product
from typing import Any

import pandas as pd

from artifact.manifest import Manifest
from artifact.metrics.evaluation import Evaluation
from artifact.ranking.one_pass import ORIGINAL
from artifact.studies import fitted
from artifact.studies.common import PERCENT, Study, by_metric, cell_of, origin, replicated_hits, single_stage
from artifact.studies.fitted import METHODS, Fitting


def suppression_table(
    manifest: Manifest, names: Iterable[str], methods: Iterable[str], *, k: int = 1, **fitting: Any
) -> Study:
    """Fig. 8: change of the probe's accuracy, of DAR@K and of R@K under INLP, LEACE and STD.

    ``fitting`` is that of :class:`artifact.studies.fitted.Fitting`. Columns: ``dataset``, ``reported_as``, ``title``,
    ``method``, ``suppression`` (``original`` among them), ``R``, ``DAR``, ``probe`` in percent, ``probe_unconverged``
    (1 if the probe did not converge), the changes ``change_R``, ``change_DAR``, ``change_probe`` in percentage points,
    ``queries``, ``fitted_queries``, ``fitted_database``, ``of_nordland`` (whether the dataset is Nordland or mirrors it),
    ``origin``.
    """
    rows, inputs, sample, seed = [], [], [], Fitting(**fitting).seed
    for name, method in product(names, single_stage(manifest, methods)):
        result = fitted.compare(manifest, name, method, **fitting)
        before, probe_before = result.evaluations[ORIGINAL], result.probes[ORIGINAL]
        reference, entry = replicated_hits(before, k, name, seed), manifest.dataset(name)
        for suppressor, after in result.evaluations.items():
            probe = result.probes[suppressor]
            row = cell_of(manifest, name, method) | {"suppression": suppressor}
            row |= {"R": PERCENT * after.recall(k), "DAR": PERCENT * after.dar(k)}
            row |= {"probe": PERCENT * probe.accuracy, "probe_unconverged": int(not probe.converged)}
            row |= _changes(before, after, k)
            sample.append(replicated_hits(after, k, name, seed) - reference)
            row["change_probe"] = PERCENT * (probe.accuracy - probe_before.accuracy)
            row["queries"] = after.n_queries
            row["fitted_queries"] = len(result.split.fit_queries)
            row["fitted_database"] = len(result.split.fit_database)
            row["of_nordland"] = "nordland" in (entry.reported_as, (entry.mirrors or "").lower())
            rows.append(row | {"origin": origin(result.described)})
        inputs += result.described.inputs
    return Study(pd.DataFrame(rows), tuple(inputs), by_metric(sample, "change_"))


def _changes(before: Evaluation, after: Evaluation, k: int) -> dict[str, float]:
    return {
        "change_R": PERCENT * (after.recall(k) - before.recall(k)),
        "change_DAR": PERCENT * (after.dar(k) - before.dar(k)),
    }


def improved(table: pd.DataFrame) -> pd.DataFrame:
    """Count the method–dataset pairs of a :func:`suppression_table` that each suppression method improves.

    Columns: ``suppression``, ``pairs`` and the numbers of pairs whose probe accuracy falls (``probe``) and whose DAR
    and R rise (``DAR``, ``R``).
    """
    changed = table[table["suppression"] != ORIGINAL]
    better = pd.DataFrame({"pairs": True, "probe": changed["change_probe"] < -1e-9})
    better[["DAR", "R"]] = changed[["change_DAR", "change_R"]] > 1e-9
    return better.groupby(changed["suppression"], sort=False).sum().reset_index()


def fitting_fraction(
    manifest: Manifest,
    names: Iterable[str],
    methods: Iterable[str],
    fractions: Sequence[float],
    *,
    k: int = 1,
    **fitting: Any,
) -> Study:
    """Fig. 10: change of DAR@K and R@K against the query fitting fraction, on the fixed outer half.

    ``fitting`` is ``iterations`` and ``seed`` of :func:`artifact.studies.fitted.by_fraction`. Columns: ``dataset``,
    ``reported_as``, ``title``, ``method``, ``suppression``, ``fraction``, ``change_R``, ``change_DAR`` in percentage
    points. Fraction 0 is without suppression. Fractions with fewer than two images of a condition are left out.
    """
    positive = sorted(fraction for fraction in fractions if fraction > 0)
    rows, inputs, sample, seed = [], [], [], fitting.get("seed", 0)
    for name, method in product(names, single_stage(manifest, methods)):
        found, described = fitted.by_fraction(manifest, name, method, positive, **fitting)
        before = found[ORIGINAL, 0.0]
        reference = replicated_hits(before, k, name, seed)
        for suppressor in METHODS:
            steps = [(f, found[suppressor, f]) for f in positive if (suppressor, f) in found]
            for fraction, after in [(0.0, before), *steps]:
                row = cell_of(manifest, name, method) | {"suppression": suppressor, "fraction": fraction}
                rows.append(row | _changes(before, after, k))
                sample.append(replicated_hits(after, k, name, seed) - reference)
        inputs += described.inputs
    return Study(pd.DataFrame(rows), tuple(inputs), by_metric(sample, "change_"))


def mean_by_fraction(table: pd.DataFrame) -> pd.DataFrame:
    """Average the changes over the method–dataset pairs that have every fraction.

    A pair that is too small for the smallest fraction would otherwise bend the curve where it enters.
    """
    whole = table[has_every_fraction(table)]
    means = whole.groupby(["suppression", "fraction"], sort=False)[["change_DAR", "change_R"]]
    return means.mean().assign(pairs=means.size()).reset_index()


def has_every_fraction(table: pd.DataFrame) -> pd.Series:
    """Tell which rows of a :func:`fitting_fraction` are of pairs that have every fraction."""
    counts = table.groupby(["dataset", "method", "suppression"])["fraction"].transform("nunique")
    return counts == table["fraction"].nunique()
