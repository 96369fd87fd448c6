"""Figs. 2, 8 and 9, Tables IV and V, and the tables of the pages beyond the paper."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from IPython.display import HTML

from artifact.report.common import number, table
from artifact.studies import reported
from artifact.studies.common import PERCENT
from artifact.studies.erased import KINDS, Erased
from artifact.studies.mixed_database import MixedDatabase
from artifact.studies.suppression import improved


def change(value: float, *, digits: int = 1) -> str:
    """Print a difference in percentage points with its sign.

    Examples
    --------
    >>> change(1.24), change(-0.04), change(float("nan"))
    ('+1.2', '0.0', '–')
    """
    if pd.isna(value):
        return "–"
    rounded = round(value, digits)
    return f"{rounded:+.{digits}f}" if rounded else f"{0:.{digits}f}"


# -- Figs. 2 and 9 ------------------------------------------------------------------------------------------


def mixed_table(found: Mapping[str, MixedDatabase], panels: Mapping[str, str], titles: Mapping[str, str]) -> HTML:
    """Show R@1 of each panel and the change between them.

    Parameters
    ----------
    found
        By method.
    panels
        Evaluation name to heading, two of them, before and after.
    titles
        Method name to printed title.
    """
    first, second = panels
    rows = []
    for method, one in found.items():
        before, after = (PERCENT * one.evaluations[name].recall(1) for name in (first, second))
        rows.append(
            {
                "Method": titles[method],
                f"R@1 %, {panels[first]}": number(before),
                f"R@1 %, {panels[second]}": number(after),
                "Change (pp)": change(after - before),
                "Queries": one.evaluations[first].n_queries,
                "Database": len(one.database),
                "Added": len(one.added),
            }
        )
    frame = pd.DataFrame(rows)
    return table(frame, numeric=list(frame.columns[1:]), caption="Measured in this run.")


def reported_mixed_table(name: str) -> HTML:
    """Show the values that the paper prints in Fig. 2 (``"fig02"``) or Fig. 9 (``"fig09"``)."""
    frame = reported.table(name)
    column = next(c for c in frame.columns if c not in ("method", "recall_percent"))
    wide = frame.pivot_table(index="method", columns=column, values="recall_percent", sort=False)
    titles = reported.method_titles()
    first, second = wide.columns
    rows = [
        {
            "Method": titles[method],
            f"R@1 %, {first}": number(row[first]),
            f"R@1 %, {second}": number(row[second]),
            "Change (pp)": change(row[second] - row[first]),
        }
        for method, row in wide.iterrows()
    ]
    shown = pd.DataFrame(rows)
    return table(
        shown, numeric=list(shown.columns[1:]), caption="Reported by the paper for RobotCar; not measured here."
    )


# -- Fig. 8 -------------------------------------------------------------------------------------------------


def improved_table(frame: pd.DataFrame, *, k: int = 1) -> HTML:
    """Show how many method–dataset pairs improve, measured and reported."""
    counts = improved(frame).set_index("suppression")
    expected = reported.table("fig08").set_index(["quantity", "suppression"])
    columns = {"probe": "probe accuracy", "DAR": "DAR@1", "R": "R@1"}
    rows = []
    for suppressor, row in counts.iterrows():
        shown = {"Method": suppressor}
        for column, quantity in columns.items():
            name = {"probe": "Probe accuracy falls", "DAR": f"DAR@{k} rises", "R": f"R@{k} rises"}[column]
            shown[f"{name}, measured"] = f"{row[column]} / {row['pairs']}"
            if (quantity, suppressor) in expected.index:
                cell = expected.loc[(quantity, suppressor)]
                shown[f"{name}, paper"] = f"{cell['improved']} / {cell['pairs']}"
        rows.append(shown)
    shown = pd.DataFrame(rows)
    caption = "Method–dataset pairs that improve. The paper's pairs are other methods on other datasets."
    return table(shown, numeric=list(shown.columns[1:]), caption=caption)


def suppression_table(frame: pd.DataFrame, titles: Mapping[str, str], *, k: int = 1) -> HTML:
    """Show R, DAR and probe accuracy of the original, and their changes, one line per dataset and method."""
    suppressors = [name for name in frame["suppression"].unique() if name != "original"]
    rows = []
    for (_, method), part in frame.groupby(["dataset", "method"], sort=False):
        by_name = part.set_index("suppression")
        original = by_name.loc["original"]
        row = {
            "Dataset": original["title"],
            "Method": titles.get(method, method),
            "Fitted on": f"{original['fitted_queries']} + {original['fitted_database']}",
            "Queries": original["queries"],
        }
        for metric, heading in (("probe", "Probe"), ("DAR", f"DAR@{k}"), ("R", f"R@{k}")):
            row[f"{heading} %"] = number(original[metric])
            row |= {f"{heading} {name}": change(by_name.loc[name, f"change_{metric}"]) for name in suppressors}
        rows.append(row)
    shown = pd.DataFrame(rows)
    caption = (
        "Original descriptors in percent, changes in percentage points. Fitted on: queries + database images of the "
        "fitting region."
    )
    return table(shown, numeric=list(shown.columns[2:]), caption=caption)


# -- Tables IV and V ----------------------------------------------------------------------------------------


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


# -- beyond the paper ---------------------------------------------------------------------------------------


def within_summary(rows: pd.DataFrame, titles: Mapping[str, str]) -> str:
    """Say in words for how many pairs a statistic takes queries beyond the control, before and after suppression."""
    parts = []
    for view in rows["view"].unique():
        part = rows[rows["view"] == view]
        beyond = part[(part["gap_low"] > 0) & (part["gap"] > part["control_high"])]
        names = [f"{titles[m]} on {t}" for m, t in zip(beyond["method"], beyond["title"], strict=True)]
        listed = (
            f" ({', '.join(names[:4])}{' and others' if len(names) > 4 else ''})"
            if names and view == "original"
            else ""
        )
        parts.append(f"{len(beyond)} of {len(part)} pairs {'on the' if view == 'original' else 'after'} {view}{listed}")
    means = rows.groupby("view", sort=False)["gap"].mean()
    mean = ", ".join(f"{view} {value:+.1f}" for view, value in means.items())
    return (
        f"The gap is beyond every control, with an interval above zero, for {'; '.join(parts)}. "
        f"Mean gap over all pairs: {mean} pp."
    )


def within_table(frame: pd.DataFrame, titles: Mapping[str, str]) -> HTML:
    """Show every gap with its interval and control."""
    shown = pd.DataFrame({"Statistic": frame["statistic"], "Dataset": frame["title"]})
    shown["Method"] = frame["method"].map(titles)
    shown["Descriptors"] = frame["view"]
    shown["R@1 %"] = frame["R"].map(number)
    shown["own side %"] = frame["own"].map(number)
    shown["other side %"] = frame["other"].map(number)
    shown["gap (pp)"] = frame["gap"].map(change)
    shown["95 % interval"] = [
        f"[{change(a)}, {change(b)}]" for a, b in zip(frame["gap_low"], frame["gap_high"], strict=True)
    ]
    shown["control, mean"] = frame["control"].map(change)
    shown["control, largest"] = frame["control_high"].map(change)
    return table(shown, numeric=list(shown.columns[4:]))


def erased_table(erased: Erased) -> HTML:
    """Show R@1 and DAR@1 of the original and the suppressed descriptors, and what happens to queries taken."""
    rows = []
    for view, result in erased.evaluations.items():
        taken, recovered = erased.lost_and_recovered(view) if view != "original" else ((), ())
        rows.append(
            {
                "Descriptors": view,
                "R@1 %": number(PERCENT * result.recall(1)),
                "DAR@1 %": number(PERCENT * result.dar(1)),
                "RSR@1 %": number(PERCENT * result.rsr(1)),
                "given back": f"{len(recovered)} of {len(taken)}" if view != "original" else "–",
            }
        )
    shown = pd.DataFrame(rows)
    fit, n = erased.split, erased.evaluations["original"].n_queries
    caption = (
        f"{n} queries evaluated; fitted on {len(fit.fit_queries)} queries and {len(fit.fit_database)} database images."
    )
    return table(shown, numeric=list(shown.columns[1:]), caption=caption)


def erased_similarities(erased: Erased) -> str:
    """Say in words how far a distractor's similarity lies above a positive's, before and after."""
    positive, distractor, _ = KINDS
    parts = []
    for view, found in erased.similarities.items():
        spread = np.sqrt((found[positive].var() + found[distractor].var()) / 2)
        gap = (found[positive].mean() - found[distractor].mean()) / spread
        parts.append(f"{view} {gap:+.2f}")
    return (
        "Mean similarity of positives minus that of distractors, in units of their pooled standard deviation: "
        f"{', '.join(parts)}. The larger, the easier it is for a positive to win."
    )
