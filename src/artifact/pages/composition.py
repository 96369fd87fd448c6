"""Tables IV and V: transforms of several datasets in one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import pandas as pd
from IPython.display import HTML

from artifact.pages.common import change, claim, markup, number, shown, table
from artifact.studies import reported

_NAMES = {"suppression": "Method", "pair": "Condition pair"}
MOSTLY = 0.8
"""Share of pairs within 1 percentage point that counts as "preserved"; the paper's own shares are 46/54 to 9/9."""


def equivalence_table(
    summary: pd.DataFrame, *, k: int = 1, caption: str = "Measured in this run; differences in pp."
) -> HTML:
    """Show Tables IV and V in the paper's form: mean ± standard deviation, and pairs within 1 pp.

    Parameters
    ----------
    summary
        As from :func:`artifact.studies.composition.summary`.
    k
        K, for the headings.
    caption
        Says where the values are from.
    """
    by = [column for column in _NAMES if column in summary]
    rows = []
    for row in summary.to_dict("records"):
        cells = {_NAMES[column]: row[column] for column in by}
        for metric in ("DAR", "R"):
            cells[f"Δ{metric}@{k}: mean ± std"] = f"{row[f'mean_{metric}'] + 0.0:.2f} ± {row[f'std_{metric}']:.2f}"
            cells[f"Δ{metric}@{k}: within 1 pp"] = f"{row[f'within_{metric}']} / {row['pairs']}"
        rows.append(cells)
    return table(rows, text=len(by), caption=caption)


def reported_equivalence_table(name: str) -> HTML:
    """Show the paper's Table IV (``"tab04"``) or V (``"tab05"``)."""
    frame = reported.table(name).rename(
        columns={"methods": "pairs", "mean_pp": "mean", "std_pp": "std", "within_1pp": "within"}
    )
    by = [*(column for column in _NAMES if column in frame), "pairs"]
    wide = frame.replace({"metric": {"DAR@1": "DAR", "R@1": "R"}}).pivot_table(
        index=by, columns="metric", values=["mean", "std", "within"], sort=False
    )
    wide.columns = ["_".join(column) for column in wide.columns]
    whole = dict.fromkeys(("within_DAR", "within_R"), int)
    return equivalence_table(
        wide.astype(whole).reset_index(), caption="Reported by the paper, not from this run. Differences in pp."
    )


def fitting_order(titles: Sequence[str], frame: pd.DataFrame) -> HTML:
    """Say in which order the transforms were fitted, and what a percentage point is worth on data of this size.

    Parameters
    ----------
    titles
        Of the datasets, in the order of fitting.
    frame
        The study's table, with ``queries``.
    """
    fewest, most = frame["queries"].min(), frame["queries"].max()
    return markup(
        '<p class="origin">Fitted in this order: {}. With {} to {} queries evaluated, 1 pp is {:.1f} to {:.1f} queries.</p>',
        " → ".join(titles),
        *(fewest, most, fewest / 100, most / 100),
    )


def differences_table(frame: pd.DataFrame, titles: Mapping[str, str], *, k: int = 1) -> HTML:
    """Show every row of Table IV or V: DAR and R under both transforms, or before and after erasure, and the change."""
    first, second = ("single", "multi") if "single_R" in frame else ("original", "erased")
    columns = {"Suppression": "suppression", "Dataset": "title", "Pair": "pair", "Method": ("method", titles.get)}
    for metric in ("DAR", "R"):
        columns |= {f"{metric}@{k} % {which}": (f"{which}_{metric}", number) for which in (first, second)}
        columns[f"Δ{metric}@{k} (pp)"] = (f"difference_{metric}", change)
    cells = shown(frame, columns)
    return table(cells, text=list(cells).index("Method") + 1)


@claim(
    "tab04",
    "One composed transform does as well as a transform for each dataset.",
    paper="46 to 52 of 54 pairs stay within 1 pp; mean differences are at most 0.25 pp",
    rule=f"at least {MOSTLY:.0%} of the pairs stay within 1 pp, in DAR and R, with INLP and LEACE",
)
def one_transform_for_all(summary: pd.DataFrame) -> tuple[str, bool | None]:
    """The composition of all transforms does as well as each dataset's own (Table IV)."""
    return _within(summary), _mostly_within(summary)


@claim(
    "tab05",
    "The composed transform does no harm to condition pairs that it was not fitted on.",
    paper="8 or 9 of 9 methods stay within 1 pp on two pairs; mean differences are at most 0.34 pp",
    rule=f"at least {MOSTLY:.0%} of the methods stay within 1 pp on every pair, in DAR and R, with INLP and LEACE",
)
def irrelevant_conditions_unharmed(summary: pd.DataFrame) -> tuple[str, bool | None]:
    """The composed transform does no harm to condition pairs that it was not fitted on (Table V)."""
    lost = summary[["mean_DAR", "mean_R"]].max().max()
    return f"{_within(summary)}; largest mean loss {max(lost, 0):.1f} pp", _mostly_within(summary)


def _mostly_within(summary: pd.DataFrame) -> bool:
    shares = summary[["within_DAR", "within_R"]].div(summary["pairs"], axis=0)
    return bool((shares >= MOSTLY).to_numpy().all())


def _within(summary: pd.DataFrame) -> str:
    rows = [
        f"{' '.join(row[column] for column in _NAMES if column in row)}: DAR@1 {row['within_DAR']}, R@1 {row['within_R']} "
        f"of {row['pairs']}"
        for row in summary.to_dict("records")
    ]
    return f"within 1 pp: {'; '.join(rows)}"
