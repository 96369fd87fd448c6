"""Figs. 2, 8 and 9, Tables IV and V, and the tables of the pages beyond the paper."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from IPython.display import HTML
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from artifact.pages.common import Finding, change, number, table
from artifact.pages.style import SUPPRESSION_COLOURS, embed
from artifact.studies import reported
from artifact.studies.suppression import improved

# -- Figs. 2 and 9 ------------------------------------------------------------------------------------------


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


# -- beyond the paper ---------------------------------------------------------------------------------------


_QUANTITIES = {
    "change_probe": ("(a) Guardedness probe accuracy", "lower is better", "RdBu_r"),
    "change_DAR": ("(b) ΔDAR@{k}", "higher is better", "RdBu"),
    "change_R": ("(c) ΔR@{k}", "higher is better", "RdBu"),
}


def heat_maps(table: pd.DataFrame, titles: Mapping[str, str], *, k: int = 1) -> HTML:
    """Fig. 8: change of probe accuracy, DAR@K and R@K per suppression method, dataset and method.

    Parameters
    ----------
    table
        As from :func:`artifact.studies.suppression.suppression_table`.
    titles
        Method name to printed title.
    k
        K, for the headings.
    """
    datasets = dict(zip(table["dataset"], table["title"], strict=True))
    suppressors = [name for name in table["suppression"].unique() if name != "original"]
    # The shorter axis runs across, so that the numbers stay legible.
    across, down = (titles, datasets) if len(titles) < len(datasets) else (datasets, titles)
    names = ("method", "dataset") if across is titles else ("dataset", "method")
    size = (2.0 + 0.68 * len(across) * len(suppressors), 3 * (0.55 + 0.27 * len(down)) + 1.2)
    figure = Figure(figsize=size)
    axes = figure.subplots(3, len(suppressors), sharex=True, sharey=True, squeeze=False)
    for row, (column, (name, better, colours)) in zip(axes, _QUANTITIES.items(), strict=True):
        limit = max(10.0, float(np.nanmax(np.abs(table[column]))))
        for panel, suppressor in zip(row, suppressors, strict=True):
            part = table[table["suppression"] == suppressor].pivot_table(
                index=names[1], columns=names[0], values=column
            )
            _heat_map(panel, part.reindex(index=list(down), columns=list(across)).to_numpy(), limit, colours)
            panel.set_title(suppressor, fontsize=9, pad=3, loc="left")
        row[0].set_yticks(range(len(down)), list(down.values()))
        row[0].set_title(
            f"{name.format(k=k)}, change in pp ({better})\n\n{suppressors[0]}", fontsize=9, pad=3, loc="left"
        )
    for panel in axes[-1]:
        panel.set_xticks(range(len(across)), list(across.values()), rotation=40, ha="right")
    figure.tight_layout(h_pad=0.8, w_pad=0.6)
    text = f"Changes by suppression of {len(titles)} methods on {len(datasets)} datasets; the numbers are in the table"
    return embed(figure, text)


def _heat_map(axes: Axes, values: np.ndarray, limit: float, colours: str) -> None:
    """One panel with its numbers; the scale is linear up to ``limit`` and symmetric around zero."""
    # A root makes changes of a few points visible beside one of tens of points.
    shown = np.sign(values) * np.sqrt(np.abs(values) / limit)
    axes.imshow(shown, cmap=colours, vmin=-1.25, vmax=1.25, aspect="auto")
    for (row, column), value in np.ndenumerate(values):
        if np.isfinite(value):
            strong = abs(shown[row, column]) > 0.95
            axes.text(
                column, row, f"{value:+.1f}", ha="center", va="center", fontsize=7, color="white" if strong else "black"
            )
    axes.tick_params(length=0)
    for spine in axes.spines.values():
        spine.set_visible(False)


def fraction_curves(means: pd.DataFrame, *, k: int = 1) -> HTML:
    """Fig. 10: mean change of DAR@K (a) and R@K (b) against the query fitting fraction.

    Parameters
    ----------
    means
        ``suppression``, ``fraction``, ``change_DAR``, ``change_R`` in percentage points.
    k
        K, for the headings.
    """
    return embed(_fraction_curves(means, k), f"Mean change of DAR@{k} and R@{k} against the query fitting fraction")


def reported_fraction_curves() -> HTML:
    """Draw Fig. 10 from the values that the paper plots."""
    wide = reported.table("fig10").pivot_table(
        index=["suppression", "fitting_fraction"], columns="metric", values="change_pp", sort=False
    )
    means = wide.reset_index().rename(
        columns={"fitting_fraction": "fraction", "DAR@1": "change_DAR", "R@1": "change_R"}
    )
    return embed(
        _fraction_curves(means, 1), "The paper's mean change of DAR@1 and R@1 against the query fitting fraction"
    )


def _fraction_curves(means: pd.DataFrame, k: int) -> Figure:
    figure = Figure(figsize=(8.0, 3.2))
    for axes, column, title in zip(
        figure.subplots(1, 2), ("change_DAR", "change_R"), (f"(a) ΔDAR@{k} (pp)", f"(b) ΔR@{k} (pp)"), strict=True
    ):
        axes.axhline(0, linestyle="--", color="gray", linewidth=0.9)
        for suppressor, rows in means.groupby("suppression", sort=False):
            ordered = rows.sort_values("fraction")
            axes.plot(
                ordered["fraction"], ordered[column], color=SUPPRESSION_COLOURS[suppressor], marker="o", markersize=3.5,
                label=suppressor,
            )  # fmt: skip
        axes.set(title=title, xlim=(-0.01, 0.51), xticks=np.arange(0, 0.51, 0.1))
        axes.grid(visible=True)
        axes.set_xlabel("Query fitting fraction")
    figure.tight_layout(w_pad=1.4)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="upper center", bbox_to_anchor=(0.5, 0.0), ncols=3)
    return figure


NO_LOSS_PP = 1.1
"""Largest fall of R@1 that the paper still calls preserved (§V-D), in percentage points."""


def labels_less_accessible(table: pd.DataFrame) -> Finding:
    """INLP and LEACE make conditions less accessible to a linear classifier than STD does (Fig. 8a)."""
    counts = improved(table).set_index("suppression")
    return Finding(
        "fig08",
        "After INLP and LEACE a linear classifier tells the conditions apart less well; STD helps less often.",
        "probe accuracy falls for 50 (INLP), 52 (LEACE) and 27 (STD) of 54 method–dataset pairs",
        "INLP and LEACE each help more than half of the pairs, and more than STD does",
        f"probe accuracy falls for {_counted(counts, 'probe')} of {counts['pairs'].iloc[0]} pairs",
        _both_mostly(counts, "probe"),
    )


def suppression_raises_dar(table: pd.DataFrame, titles: Mapping[str, str], k: int = 1) -> Finding:
    """INLP and LEACE raise DAR for most pairs, STD for fewer (Fig. 8b)."""
    counts = improved(table).set_index("suppression")
    best = table.loc[table["change_DAR"].idxmax()]
    return Finding(
        "fig08",
        f"INLP and LEACE raise DAR@{k} for most method–dataset pairs, STD for fewer.",
        "DAR@1 rises for 46 (INLP), 47 (LEACE) and 18 (STD) of 54 pairs; most: AnyLoc on RobotCar, +37 pp with INLP",
        "INLP and LEACE each help more than half of the pairs, and more than STD does",
        f"DAR@{k} rises for {_counted(counts, 'DAR')} of {counts['pairs'].iloc[0]} pairs; most: {titles[best['method']]} on "
        f"{best['title']}, {best['change_DAR']:+.1f} pp with {best['suppression']}",
        _both_mostly(counts, "DAR"),
    )


def suppression_keeps_recall(table: pd.DataFrame, titles: Mapping[str, str], k: int = 1) -> Finding:
    """Suppression keeps R without distractors, except for STD (Fig. 8c)."""
    changed = table[table["suppression"].isin(["INLP", "LEACE"])]
    falls = changed[changed["change_R"] < -NO_LOSS_PP - 1e-9]
    worst = changed.loc[changed["change_R"].idxmin()]
    return Finding(
        "fig08",
        f"INLP and LEACE leave R@{k} without distractors intact.",
        "R@1 falls by at most 1.1 pp, except for STD with AnyLoc on StLuciaMToD (8.2 pp)",
        f"no pair loses more than {NO_LOSS_PP:g} pp",
        f"R@{k} falls by more than {NO_LOSS_PP:g} pp for {len(falls)} of {len(changed)} combinations of INLP or LEACE with a pair; "
        f"largest change down: {titles[worst['method']]} on {worst['title']}, {worst['change_R']:+.1f} pp with {worst['suppression']}",
        bool(falls.empty),
    )


def a_tenth_suffices(means: pd.DataFrame, k: int = 1) -> Finding:
    """A tenth of the queries suffices to fit without losing mean R; STD needs more data (Fig. 10)."""
    wide = means.pivot_table(index="fraction", columns="suppression", values=["change_DAR", "change_R"])
    rule = f"at 10 % no mean ΔR@{k} is negative, and the mean ΔDAR@{k} of STD is the smallest"
    tenth = wide.loc[0.1] if 0.1 in wide.index else None
    claim = f"Fitting on 10 % of the queries lowers the mean R@{k} of no suppression method; STD gains least DAR@{k}."
    reported = (
        "at 10 %, mean R@1 rises for all three; mean DAR@1 changes by +4.2 (INLP), +3.7 (LEACE) and −1.9 pp (STD)"
    )
    if tenth is None:
        return Finding("fig10", claim, reported, rule, "the fraction 0.1 is not among the parameters", None)
    recall, dar = tenth["change_R"], tenth["change_DAR"]

    def listed(values: pd.Series) -> str:
        return ", ".join(f"{name} {values[name]:+.1f}" for name in ("INLP", "LEACE", "STD"))

    return Finding(
        "fig10",
        claim,
        reported,
        rule,
        f"at 10 %, mean ΔR@{k} is {listed(recall)} pp and mean ΔDAR@{k} {listed(dar)} pp",
        bool((recall >= 0).all() and dar["STD"] == dar.min()),
    )


def _counted(counts: pd.DataFrame, column: str) -> str:
    parts = [f"{counts.loc[name, column]} ({name})" for name in counts.index]
    return f"{', '.join(parts[:-1])} and {parts[-1]}"


def _both_mostly(counts: pd.DataFrame, column: str) -> bool:
    """INLP and LEACE help more than half of the pairs, and each more than STD."""
    both = counts.loc[["INLP", "LEACE"], column]
    return bool((both > counts["pairs"].iloc[0] / 2).all() and (both > counts.loc["STD", column]).all())
