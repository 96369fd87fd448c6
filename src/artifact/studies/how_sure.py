"""How sure the order of the methods is: the chance of each rank, and who can be told from whom."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.stats import rankdata

from artifact.metrics.statistics import ends, holm, p_values
from artifact.studies.common import PERCENT, Study, shares
from artifact.studies.judging import CERTAIN
from artifact.studies.recall import mean_replicates, with_means


def rank_chances(study: Study, metric: str) -> pd.DataFrame:
    """Return the share in percent of bootstrap replicates in which each method has each rank by a mean over datasets.

    ``study`` is a :func:`artifact.studies.recall.recall_table`, ``metric`` ``"R"`` or ``"DAR"``. Columns: ``method``, ``mean``
    with its 95 % interval ``low`` and ``high``, then ``1`` (best), ``2``, ... Methods that tie share the better rank.
    """
    means, sample = with_means(study.table), mean_replicates(study)[metric]
    ranks = rankdata(-sample.round(9), method="min", axis=0)
    low, high = shares(sample)
    table = pd.DataFrame({"method": means["method"], "mean": means[metric], "low": low, "high": high})
    return table.assign(**{str(rank): PERCENT * (ranks == rank).mean(axis=1) for rank in range(1, len(means) + 1)})


def separable(study: Study, metric: str) -> pd.DataFrame:
    """Return the difference of each pair of methods in a mean over datasets, and whether it is beyond chance.

    Columns: ``better`` and ``worse`` (methods), ``difference`` in pp with its 95 % interval ``low`` and ``high``, ``p`` (adjusted
    for all pairs, Holm), ``certain``.
    """
    means, sample = with_means(study.table), mean_replicates(study)[metric]
    names, values = means["method"].to_numpy(), means[metric].to_numpy()
    i, j = np.triu_indices(len(values), 1)
    better, worse = np.where(values[i] >= values[j], (i, j), (j, i))
    difference, drawn = values[better] - values[worse], sample[better] - sample[worse]
    low, high = ends(drawn)
    table = pd.DataFrame(
        {"better": names[better], "worse": names[worse], "difference": difference, "low": low, "high": high}
    )
    table["p"] = holm(p_values(difference, drawn))
    return table.assign(certain=table["p"] < CERTAIN)
