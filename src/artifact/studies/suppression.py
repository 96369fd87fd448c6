"""Fig. 8, Fig. 10 and Tables IV and V: what condition suppression changes, how much data it needs, whether it composes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import pandas as pd

from artifact.extraction.described import Described
from artifact.manifest import Manifest
from artifact.metrics.evaluation import Evaluation
from artifact.ranking.one_pass import ORIGINAL
from artifact.studies import fitted
from artifact.studies.common import PERCENT, Study, origin, single_stage
from artifact.studies.evaluated import Measured
from artifact.studies.fitted import METHODS


def suppression_table(
    manifest: Manifest,
    names: Iterable[str],
    methods: Iterable[str],
    *,
    fraction: float = 0.1,
    iterations: int = 35,
    k: int = 1,
    seed: int = 0,
) -> Study:
    """Fig. 8: change of the probe's accuracy, of DAR@K and of R@K under INLP, LEACE and STD.

    Returns
    -------
    Study
        One row per dataset, method and suppression method: ``dataset``, ``title``, ``method``, ``suppression``
        (``original`` among them), ``reported_as``, ``R``, ``DAR``, ``probe`` in percent, their changes ``change_R``, ``change_DAR``,
        ``change_probe`` in percentage points, ``probe_unconverged`` (1 if the probe did not converge), ``queries``, ``fitted_queries``, ``fitted_database``, ``origin``.
    """
    rows, inputs = [], []
    for name in names:
        title, reported_as = manifest.dataset(name).title, manifest.dataset(name).reported_as
        for method in single_stage(manifest, methods):
            result = fitted.compare(manifest, name, method, fraction=fraction, iterations=iterations, seed=seed)
            before = result.evaluations[ORIGINAL]
            for suppressor, after in result.evaluations.items():
                rows.append(
                    {
                        "dataset": name,
                        "reported_as": reported_as,
                        "title": title,
                        "method": method,
                        "suppression": suppressor,
                        "R": PERCENT * after.recall(k),
                        "DAR": PERCENT * after.dar(k),
                        "probe": PERCENT * result.probes[suppressor].accuracy,
                        "probe_unconverged": int(not result.probes[suppressor].converged),
                        "change_R": PERCENT * (after.recall(k) - before.recall(k)),
                        "change_DAR": PERCENT * (after.dar(k) - before.dar(k)),
                        "change_probe": PERCENT
                        * (result.probes[suppressor].accuracy - result.probes[ORIGINAL].accuracy),
                        "queries": after.n_queries,
                        "fitted_queries": len(result.split.fit_queries),
                        "fitted_database": len(result.split.fit_database),
                        "origin": origin(_measured(result.described, before)),
                    }
                )
            inputs += result.described.inputs
    return Study(pd.DataFrame(rows), tuple(inputs))


def improved(table: pd.DataFrame) -> pd.DataFrame:
    """Count the method–dataset pairs that each suppression method improves, as the paper's text does.

    Parameters
    ----------
    table
        As from :func:`suppression_table`.

    Returns
    -------
    pandas.DataFrame
        One row per suppression method: ``suppression``, ``pairs`` and the numbers of pairs whose probe accuracy falls
        (``probe``) and whose DAR and R rise (``DAR``, ``R``); ``DAR_falls``, ``R_falls`` the other way.
    """
    changed = table[table["suppression"] != ORIGINAL]
    rows = []
    for suppressor, part in changed.groupby("suppression", sort=False):
        rows.append(
            {
                "suppression": suppressor,
                "pairs": len(part),
                "probe": int((part["change_probe"] < -1e-9).sum()),
                "DAR": int((part["change_DAR"] > 1e-9).sum()),
                "R": int((part["change_R"] > 1e-9).sum()),
                "DAR_falls": int((part["change_DAR"] < -1e-9).sum()),
                "R_falls": int((part["change_R"] < -1e-9).sum()),
            }
        )
    return pd.DataFrame(rows)


def fitting_fraction(
    manifest: Manifest,
    names: Iterable[str],
    methods: Iterable[str],
    fractions: Sequence[float],
    *,
    iterations: int = 35,
    k: int = 1,
    seed: int = 0,
) -> Study:
    """Fig. 10: change of DAR@K and R@K against the query fitting fraction, on the fixed outer half.

    Returns
    -------
    Study
        One row per dataset, method, suppression method and fraction: ``dataset``, ``title``, ``method``,
        ``suppression``, ``fraction``, ``change_R``, ``change_DAR`` in percentage points. Fraction 0 is without
        suppression. Fractions with fewer than two images of a condition are left out.
    """
    positive = sorted(fraction for fraction in fractions if fraction > 0)
    rows, inputs = [], []
    for name in names:
        title, reported_as = manifest.dataset(name).title, manifest.dataset(name).reported_as
        for method in single_stage(manifest, methods):
            found, described = fitted.by_fraction(manifest, name, method, positive, iterations=iterations, seed=seed)
            before = found[ORIGINAL, 0.0]
            for suppressor in METHODS:
                for fraction in (0.0, *positive):
                    after = before if fraction == 0 else found.get((suppressor, fraction))
                    if after is None:
                        continue
                    rows.append(
                        {
                            "dataset": name,
                            "reported_as": reported_as,
                            "title": title,
                            "method": method,
                            "suppression": suppressor,
                            "fraction": fraction,
                            "change_R": PERCENT * (after.recall(k) - before.recall(k)),
                            "change_DAR": PERCENT * (after.dar(k) - before.dar(k)),
                        }
                    )
            inputs += described.inputs
    return Study(pd.DataFrame(rows), tuple(inputs))


def mean_by_fraction(table: pd.DataFrame) -> pd.DataFrame:
    """Average the changes over the method–dataset pairs that have every fraction.

    A pair that is too small for the smallest fraction would otherwise bend the curve where it enters.
    """
    wanted = table["fraction"].nunique()
    pairs = table.groupby(["dataset", "method", "suppression"])["fraction"].transform("nunique")
    whole = table[pairs == wanted]
    means = whole.groupby(["suppression", "fraction"], sort=False)[["change_DAR", "change_R"]]
    return means.mean().assign(pairs=means.size()).reset_index()


def _measured(described: Described, evaluation: Evaluation) -> Measured:
    return Measured(evaluation, described.dataset, described.method, described.inputs)
