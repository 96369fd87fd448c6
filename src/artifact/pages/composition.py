"""Tables IV and V: transforms of several datasets in one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from IPython.display import HTML

from artifact.pages.common import Answer, Titles, change, claimed, markup, number, shown, table
from artifact.studies import reported
from artifact.studies.common import Study
from artifact.studies.composition import WITHIN_PP
from artifact.studies.judging import Judged, all_above, first_of, within

_NAMES = {"suppression": "Method", "iterations": "Iterations", "pair": "Condition pair"}


def equivalence_table(
    summary: pd.DataFrame, *, k: int = 1, caption: str = "Measured in this run; differences in pp."
) -> HTML:
    """Show :func:`artifact.studies.composition.summary` in the form of Tables IV and V."""
    cells = summary[[column for column in _NAMES if column in summary]].rename(columns=_NAMES)
    by = cells.columns.size
    for metric in ("DAR", "R"):
        means = [number(round(mean, 2) + 0.0, digits=2) for mean in summary[f"mean_{metric}"]]
        cells[f"Δ{metric}@{k}: mean ± std"] = means + summary[f"std_{metric}"].map(" ± {:.2f}".format)
        cells[f"Δ{metric}@{k}: within 1 pp"] = summary[f"within_{metric}"].map("{} / ".format) + summary["pairs"].map(
            str
        )
    return table(cells, text=by, caption=caption)


def reported_equivalence_table(name: str) -> HTML:
    """Show the paper's Table IV (``"tab04"``) or V (``"tab05"``)."""
    names = {"methods": "pairs", "mean_pp": "mean", "std_pp": "std", "within_1pp": "within"}
    frame = reported.table(name).rename(columns=names)
    by = [*(column for column in _NAMES if column in frame), "pairs"]
    wide = frame.pivot_table(index=by, columns="metric", values=["mean", "std", "within"], sort=False)
    wide.columns = [f"{value}_{metric.removesuffix('@1')}" for value, metric in wide.columns]
    wide = wide.astype({"within_DAR": int, "within_R": int}).reset_index()
    return equivalence_table(wide, caption="Reported by the paper, not from this run. Differences in pp.")


def fitting_order(titles: Sequence[str], frame: pd.DataFrame) -> HTML:
    """Say in which order datasets were fitted, and what a percentage point is worth on a study's numbers of queries."""
    fewest, most = frame["queries"].min(), frame["queries"].max()
    return markup(
        '<p class="origin">Fitted in this order: {}. With {} to {} queries evaluated, 1 pp is {:.1f} to {:.1f} queries.</p>',
        " → ".join(titles),
        *(fewest, most, fewest / 100, most / 100),
    )


def differences_table(frame: pd.DataFrame, titles: Titles, *, k: int = 1) -> HTML:
    """Show every row of Table IV or V: DAR and R under both transforms, or before and after erasure, and the change."""
    first, second = ("single", "multi") if "single_R" in frame else ("original", "erased")
    columns = {"Suppression": "suppression", "Dataset": "title", "Pair": "pair", "Method": ("method", titles.get)}
    for metric in ("DAR", "R"):
        columns |= {f"{metric}@{k} % {which}": (f"{which}_{metric}", number) for which in (first, second)}
        columns[f"Δ{metric}@{k} (pp)"] = (f"difference_{metric}", change)
    cells = shown(frame, columns)
    return table(cells, text=list(cells).index("Method") + 1)


def _within(study: Study, suppressor: str) -> Answer:
    """Mean differences in DAR and R with one suppression method, and whether they are within 1 pp."""
    if len(set(study.table["dataset"])) == 1:
        return "one dataset composes nothing", Judged("cannot tell", "single and multi are the same transform")
    chosen = (study.table["suppression"] == suppressor).to_numpy()
    rows, parts = study.table[chosen], []
    for metric in ("DAR", "R"):
        column = f"difference_{metric}"
        drawn = study.replicates[column][chosen].mean(axis=0)
        verdict, why = within(rows[column].mean(), drawn, WITHIN_PP, 100 / rows["queries"].sum())
        parts.append(Judged(verdict, f"mean Δ{metric}: {why}"))
    return f"of {len(rows)} pairs {_counted(rows)}", first_of(*parts)


def _unharmed(study: Study, suppressor: str) -> Answer:
    """Mean changes in DAR and R of each condition pair with one suppression method, and whether none is a loss of 1 pp."""
    table = study.table.reset_index(drop=True)
    table = table[table["suppression"] == suppressor]
    changes, samples, parts = [], [], []
    for pair, part in table.groupby("pair", sort=False):
        for metric in ("DAR", "R"):
            column = f"difference_{metric}"
            changes.append(-part[column].mean())
            samples.append(-study.replicates[column][part.index].mean(axis=0))
            parts.append(f"{metric} {change(changes[-1])} on {pair}")
    found = f"mean changes in pp: {', '.join(parts)}; of {len(table)} cases {_counted(table)}"
    return found, all_above(np.array(changes), np.stack(samples), -WITHIN_PP)


def _counted(part: pd.DataFrame) -> str:
    counts = " and ".join(f"{(part[f'difference_{m}'].abs() <= WITHIN_PP + 1e-9).sum()} in {m}" for m in ("DAR", "R"))
    fewest, most = part["queries"].min(), part["queries"].max()
    return f"{counts} stay within 1 pp, which is {fewest / 100:.1f} to {most / 100:.1f} queries"


@claimed
def one_inlp_for_all(study: Study) -> Answer:
    """The composition of all INLP transforms does as well as each dataset's own (Table IV)."""
    return _within(study, "INLP")


@claimed
def one_leace_for_all(study: Study) -> Answer:
    """The composition of all LEACE transforms does as well as each dataset's own (Table IV)."""
    return _within(study, "LEACE")


@claimed
def inlp_leaves_others_unharmed(study: Study) -> Answer:
    """The composed INLP transform does no harm to condition pairs that it was not fitted on (Table V)."""
    return _unharmed(study, "INLP")


@claimed
def leace_leaves_others_unharmed(study: Study) -> Answer:
    """The composed LEACE transform does no harm to condition pairs that it was not fitted on (Table V)."""
    return _unharmed(study, "LEACE")
