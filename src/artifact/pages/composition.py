"""Tables IV and V: transforms of several datasets in one."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence

import pandas as pd
from IPython.display import HTML

from artifact.pages.common import Finding, change, number, table
from artifact.studies import reported


def equivalence_table(summary: pd.DataFrame, by: Mapping[str, str], *, k: int = 1) -> HTML:
    """Show Tables IV and V in the paper's form: mean ± standard deviation, and pairs within 1 pp.

    Parameters
    ----------
    summary
        As from :func:`artifact.studies.composition.summary`.
    by
        Columns that name a row, with their headings.
    k
        K, for the headings.
    """
    rows = []
    for row in summary.to_dict("records"):
        shown = {heading: row[column] for column, heading in by.items()}
        for metric in ("DAR", "R"):
            shown[f"Δ{metric}@{k}: mean ± std"] = f"{row[f'mean_{metric}'] + 0.0:.2f} ± {row[f'std_{metric}']:.2f}"
            shown[f"Δ{metric}@{k}: within 1 pp"] = f"{row[f'within_{metric}']} / {row['pairs']}"
        rows.append(shown)
    frame = pd.DataFrame(rows)
    return table(frame, numeric=list(frame.columns[len(by) :]), caption="Measured in this run; differences in pp.")


def reported_equivalence_table(name: str) -> HTML:
    """Show the paper's Table IV (``"tab04"``) or V (``"tab05"``)."""
    frame = reported.table(name)
    by = [column for column in ("suppression", "pair") if column in frame]
    total = "pairs" if "pairs" in frame else "methods"
    rows = []
    for keys, part in frame.groupby(by, sort=False):
        shown = dict(zip(("Method", "Condition pair"), keys, strict=False))
        for row in part.to_dict("records"):
            shown[f"Δ{row['metric']}: mean ± std"] = f"{row['mean_pp']:.2f} ± {row['std_pp']:.2f}"
            shown[f"Δ{row['metric']}: within 1 pp"] = f"{row['within_1pp']} / {row[total]}"
        rows.append(shown)
    shown = pd.DataFrame(rows)
    caption = "Reported by the paper; not measured here. Differences in pp."
    return table(shown, numeric=list(shown.columns[len(by) :]), caption=caption)


def fitting_order(order: Sequence[str], titles: Mapping[str, str], frame: pd.DataFrame) -> HTML:
    """Say in which order the transforms were fitted, and what a percentage point is worth on data of this size.

    Parameters
    ----------
    order
        Datasets in the order of fitting.
    titles
        Dataset name to printed title.
    frame
        The study's table, with ``queries``.
    """
    fewest, most = frame["queries"].min(), frame["queries"].max()
    listed = html.escape(" → ".join(titles[name] for name in order))
    return HTML(
        f'<p class="origin">Fitted in this order: {listed}. With {fewest} to {most} queries evaluated, 1 pp is '
        f"{fewest / 100:.1f} to {most / 100:.1f} queries.</p>"
    )


def single_multi_table(frame: pd.DataFrame, titles: Mapping[str, str], *, k: int = 1) -> HTML:
    """Show DAR and R of the single and of the composed transform for every pair."""
    shown = pd.DataFrame({"Suppression": frame["suppression"], "Dataset": frame["title"]})
    shown["Method"] = frame["method"].map(titles)
    for metric in ("DAR", "R"):
        for which in ("single", "multi"):
            shown[f"{metric}@{k} % {which}"] = frame[f"{which}_{metric}"].map(number)
        shown[f"Δ{metric}@{k} (pp)"] = frame[f"difference_{metric}"].map(change)
    return table(shown, numeric=list(shown.columns[3:]))


def irrelevant_table(frame: pd.DataFrame, titles: Mapping[str, str], *, k: int = 1) -> HTML:
    """Show DAR and R before and after erasure for every irrelevant pair and method."""
    shown = pd.DataFrame({"Suppression": frame["suppression"], "Dataset": frame["title"], "Pair": frame["pair"]})
    shown["Method"] = frame["method"].map(titles)
    for metric in ("DAR", "R"):
        for which in ("original", "erased"):
            shown[f"{metric}@{k} % {which}"] = frame[f"{which}_{metric}"].map(number)
        shown[f"Δ{metric}@{k} (pp)"] = frame[f"difference_{metric}"].map(change)
    return table(shown, numeric=list(shown.columns[4:]))


MOSTLY = 0.8
"""Share of pairs within 1 percentage point that counts as "preserved"; the paper's own shares are 46/54 to 9/9."""


def one_transform_for_all(summary: pd.DataFrame) -> Finding:
    """The composition of all transforms does as well as each dataset's own (Table IV)."""
    return Finding(
        "tab04",
        "One composed transform does as well as a transform for each dataset.",
        "46 to 52 of 54 pairs stay within 1 pp; mean differences are at most 0.25 pp",
        f"at least {MOSTLY:.0%} of the pairs stay within 1 pp, in DAR and R, with INLP and LEACE",
        _within(summary, ["suppression"]),
        bool((_shares(summary) >= MOSTLY).to_numpy().all()),
    )


def irrelevant_conditions_unharmed(summary: pd.DataFrame) -> Finding:
    """The composed transform does no harm to condition pairs that it was not fitted on (Table V)."""
    lost = summary[["mean_DAR", "mean_R"]].max().max()
    return Finding(
        "tab05",
        "The composed transform does no harm to condition pairs that it was not fitted on.",
        "8 or 9 of 9 methods stay within 1 pp on two pairs; mean differences are at most 0.34 pp",
        f"at least {MOSTLY:.0%} of the methods stay within 1 pp on every pair, in DAR and R, with INLP and LEACE",
        f"{_within(summary, ['suppression', 'pair'])}; largest mean loss {max(lost, 0):.1f} pp",
        bool((_shares(summary) >= MOSTLY).to_numpy().all()),
    )


def _shares(summary: pd.DataFrame) -> pd.DataFrame:
    return summary[["within_DAR", "within_R"]].div(summary["pairs"], axis=0)


def _within(summary: pd.DataFrame, by: list[str]) -> str:
    rows = [
        f"{' '.join(row[column] for column in by)}: DAR@1 {row['within_DAR']}, R@1 {row['within_R']} of {row['pairs']}"
        for row in summary.to_dict("records")
    ]
    return f"within 1 pp: {'; '.join(rows)}"
