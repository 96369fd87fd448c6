"""Every choice that the paper leaves open, our default for it, and how much the cheap ones matter."""

from __future__ import annotations

from collections.abc import Iterable
from importlib.resources import files
from itertools import product

import numpy as np
import pandas as pd

from artifact.manifest import Manifest
from artifact.studies import evaluated
from artifact.studies.common import PERCENT, Study


def decisions() -> pd.DataFrame:
    """Return every choice that the paper leaves open: its ``topic``, what the ``paper`` says, and ``ours``, what we do."""
    with (files("artifact.studies") / "protocol.csv").open(encoding="utf-8", newline="") as stream:
        return pd.read_csv(stream, dtype=str, keep_default_na=False)


def sensitivity(
    manifest: Manifest, names: Iterable[str], methods: Iterable[str], *, k: int = 1, seed: int = 0
) -> Study:
    """Measure what the open choices change, without a second pass.

    One row per dataset and method: ``R`` and ``DAR`` in percent under the defaults, and their change in percentage
    points: ``ties_R``, ``ties_DAR`` (ties against the query), ``excluded_R``, ``excluded_DAR`` (excluded queries in the
    denominator), ``beyond_DAR`` (only distractors beyond twice the threshold; NaN where the threshold is 0).
    """
    rows, inputs = [], []
    for name, method in product(names, methods):
        measured = evaluated.evaluation(manifest, name, method, seed=seed)
        result = measured.evaluation
        recall, dar = result.recall(k), result.dar(k)
        kept = result.n_queries / (result.n_queries + result.excluded_queries)
        beyond = result.dar_by_distance([2 * result.threshold], k)[0] - dar if result.threshold else np.nan
        shares = {
            "R": recall,
            "DAR": dar,
            "ties_R": result.recall(k, ties="against") - recall,
            "ties_DAR": result.dar(k, ties="against") - dar,
            "excluded_R": recall * (kept - 1),
            "excluded_DAR": dar * (kept - 1),
            "beyond_DAR": beyond,
        }
        row = {"dataset": name, "title": manifest.dataset(name).title, "method": method}
        rows.append(row | {column: PERCENT * share for column, share in shares.items()})
        inputs += measured.inputs
    return Study(pd.DataFrame(rows), tuple(inputs))
