"""Figs. 8 and 10: what condition suppression changes, and how much fitting data it needs."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from IPython.display import HTML
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from artifact.pages.common import change, claim, number, table
from artifact.pages.style import SUPPRESSION_COLOURS, embed, legend_below
from artifact.studies import reported
from artifact.studies.suppression import improved

NO_LOSS_PP = 1.1
"""Largest fall of R@1 that the paper still calls preserved (§V-D), in percentage points."""

_QUANTITIES = {
    "change_probe": ("(a) Guardedness probe accuracy", "lower is better", "RdBu_r"),
    "change_DAR": ("(b) ΔDAR@K", "higher is better", "RdBu"),
    "change_R": ("(c) ΔR@K", "higher is better", "RdBu"),
}


def improved_table(frame: pd.DataFrame, *, k: int = 1) -> HTML:
    """Show how many method–dataset pairs improve, measured and reported."""
    counts = improved(frame).set_index("suppression")
    expected = reported.table("fig08").set_index(["quantity", "suppression"])
    columns = {
        "probe": ("probe accuracy", "Probe accuracy falls"),
        "DAR": ("DAR@1", f"DAR@{k} rises"),
        "R": ("R@1", f"R@{k} rises"),
    }
    rows = []
    for suppressor, row in counts.iterrows():
        cells = {"Method": suppressor}
        for column, (quantity, heading) in columns.items():
            cells[f"{heading}, measured"] = f"{row[column]} / {row['pairs']}"
            if (quantity, suppressor) in expected.index:
                paper = expected.loc[(quantity, suppressor)]
                cells[f"{heading}, paper"] = f"{paper['improved']} / {paper['pairs']}"
        rows.append(cells)
    known = frame[frame["reported_as"].notna() & frame["method"].isin(reported.method_titles())]
    both = len(known.drop_duplicates(["dataset", "method"]))
    caption = f"Method–dataset pairs that improve. Of the paper's 54 pairs, {both or 'none'} were measured here."
    return table(rows, text=1, caption=caption)


def suppression_table(frame: pd.DataFrame, titles: Mapping[str, str], *, k: int = 1) -> HTML:
    """Show R, DAR and probe accuracy of the original, and their changes, one line per dataset and method."""
    suppressors = [name for name in frame["suppression"].unique() if name != "original"]
    rows = []
    for (_, method), part in frame.groupby(["dataset", "method"], sort=False):
        by_name = part.set_index("suppression")
        original = by_name.loc["original"]
        row = {
            "Dataset": original["title"],
            "Method": titles[method],
            "Fitted on": f"{original['fitted_queries']} + {original['fitted_database']}",
            "Queries": original["queries"],
        }
        for metric, heading in (("probe", "Probe"), ("DAR", f"DAR@{k}"), ("R", f"R@{k}")):
            row[f"{heading} %"] = number(original[metric])
            row |= {f"{heading} {name}": change(by_name.loc[name, f"change_{metric}"]) for name in suppressors}
        rows.append(row)
    caption = (
        "Original descriptors in percent, changes in percentage points. Fitted on: queries + database images of the "
        "fitting region."
    )
    unconverged = int(frame["probe_unconverged"].sum())
    if unconverged:
        caption += f" Of {len(frame)} probes, {unconverged} did not converge within scikit-learn's default of 1,000 iterations."
    return table(rows, text=2, caption=caption)


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
    titles = {method: titles[method] for method in table["method"].unique()}
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
            part = table[table["suppression"] == suppressor].pivot(index=names[1], columns=names[0], values=column)
            _heat_map(panel, part.reindex(index=list(down), columns=list(across)).to_numpy(), limit, colours)
            panel.set_title(suppressor, fontsize=9, pad=3, loc="left")
        row[0].set_yticks(range(len(down)), list(down.values()))
        heading = f"{name.replace('R@K', f'R@{k}')}, change in pp ({better})"
        row[0].set_title(f"{heading}\n\n{suppressors[0]}", fontsize=9, pad=3, loc="left")
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
            ink = "white" if abs(shown[row, column]) > 0.95 else "black"
            axes.text(column, row, f"{value:+.1f}", ha="center", va="center", fontsize=7, color=ink)
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)


def fraction_curves(means: pd.DataFrame, *, k: int = 1, source: str = "measured in this run") -> HTML:
    """Fig. 10: mean change of DAR@K (a) and R@K (b) against the query fitting fraction.

    Parameters
    ----------
    means
        ``suppression``, ``fraction``, ``change_DAR``, ``change_R`` in percentage points.
    k
        K, for the headings.
    source
        Says where the values are from, for the text alternative.
    """
    figure = Figure(figsize=(8.0, 3.2))
    panels = {"change_DAR": f"(a) ΔDAR@{k} (pp)", "change_R": f"(b) ΔR@{k} (pp)"}
    for axes, (column, title) in zip(figure.subplots(1, 2), panels.items(), strict=True):
        axes.axhline(0, linestyle="--", color="gray", linewidth=0.9)
        for name, rows in means.sort_values("fraction", kind="stable").groupby("suppression", sort=False):
            dots = {"color": SUPPRESSION_COLOURS[name], "marker": "o", "markersize": 3.5}
            axes.plot(rows["fraction"], rows[column], label=name, **dots)
        axes.set(title=title, xlim=(-0.01, 0.51), xticks=np.arange(0, 0.51, 0.1), xlabel="Query fitting fraction")
        axes.grid(visible=True)
    figure.tight_layout(w_pad=1.4)
    legend_below(figure)
    return embed(figure, f"Mean change of DAR@{k} and R@{k} against the query fitting fraction, {source}")


def reported_fraction_curves() -> HTML:
    """Draw Fig. 10 from the values that the paper plots."""
    wide = reported.table("fig10").pivot_table(
        index=["suppression", "fitting_fraction"], columns="metric", values="change_pp", sort=False
    )
    names = {"fitting_fraction": "fraction", "DAR@1": "change_DAR", "R@1": "change_R"}
    return fraction_curves(wide.reset_index().rename(columns=names), source="reported by the paper")


@claim(
    "fig08",
    "After INLP and LEACE a linear classifier tells the conditions apart less well; STD helps less often.",
    paper="probe accuracy falls for 50 (INLP), 52 (LEACE) and 27 (STD) of 54 method–dataset pairs",
    rule="INLP and LEACE each help more than half of the pairs, and more than STD does",
)
def labels_less_accessible(table: pd.DataFrame) -> tuple[str, bool | None]:
    """INLP and LEACE make conditions less accessible to a linear classifier than STD does (Fig. 8a)."""
    counts = improved(table).set_index("suppression")
    return f"probe accuracy falls for {_counted(counts, 'probe')}", _both_mostly(counts, "probe")


@claim(
    "fig08",
    "INLP and LEACE raise DAR@K for most method–dataset pairs, STD for fewer.",
    paper="DAR@1 rises for 46 (INLP), 47 (LEACE) and 18 (STD) of 54 pairs; most: AnyLoc on RobotCar, +37 pp with INLP",
    rule="INLP and LEACE each help more than half of the pairs, and more than STD does",
)
def suppression_raises_dar(table: pd.DataFrame, titles: Mapping[str, str], k: int = 1) -> tuple[str, bool | None]:
    """INLP and LEACE raise DAR for most pairs, STD for fewer (Fig. 8b)."""
    counts = improved(table).set_index("suppression")
    most = _extreme(table.loc[table["change_DAR"].idxmax()], "change_DAR", titles)
    return f"DAR@{k} rises for {_counted(counts, 'DAR')}; most: {most}", _both_mostly(counts, "DAR")


@claim(
    "fig08",
    "INLP and LEACE leave R@K without distractors intact.",
    paper="R@1 falls by at most 1.1 pp, except for STD with AnyLoc on StLuciaMToD (8.2 pp)",
    rule=f"no pair loses more than {NO_LOSS_PP:g} pp",
)
def suppression_keeps_recall(table: pd.DataFrame, titles: Mapping[str, str], k: int = 1) -> tuple[str, bool | None]:
    """Suppression keeps R without distractors, except for STD (Fig. 8c)."""
    changed = table[table["suppression"].isin(["INLP", "LEACE"])]
    falls = changed[changed["change_R"] < -NO_LOSS_PP - 1e-9]
    worst = _extreme(changed.loc[changed["change_R"].idxmin()], "change_R", titles)
    found = (
        f"R@{k} falls by more than {NO_LOSS_PP:g} pp for {len(falls)} of {len(changed)} combinations of INLP or LEACE with a "
        f"pair; largest change down: {worst}"
    )
    return found, falls.empty


@claim(
    "fig10",
    "Fitting on 10 % of the queries lowers the mean R@K of no suppression method; STD gains least DAR@K.",
    paper="at 10 %, mean R@1 rises for all three; mean DAR@1 changes by +4.2 (INLP), +3.7 (LEACE) and −1.9 pp (STD)",
    rule="at 10 % no mean ΔR@K is negative, and the mean ΔDAR@K of STD is the smallest",
)
def a_tenth_suffices(means: pd.DataFrame, k: int = 1) -> tuple[str, bool | None]:
    """A tenth of the queries suffices to fit without losing mean R; STD needs more data (Fig. 10)."""
    tenth = means[means["fraction"] == 0.1].set_index("suppression")
    if tenth.empty:
        return "the fraction 0.1 is not among the parameters", None
    recall, dar = (
        ", ".join(f"{name} {tenth.loc[name, column]:+.1f}" for name in ("INLP", "LEACE", "STD"))
        for column in ("change_R", "change_DAR")
    )
    agrees = (tenth["change_R"] >= 0).all() and tenth.loc["STD", "change_DAR"] == tenth["change_DAR"].min()
    return f"at 10 %, mean ΔR@{k} is {recall} pp and mean ΔDAR@{k} {dar} pp", bool(agrees)


def _extreme(row: pd.Series, column: str, titles: Mapping[str, str]) -> str:
    """A combination and its change, in words."""
    return f"{titles[row['method']]} on {row['title']}, {row[column]:+.1f} pp with {row['suppression']}"


def _counted(counts: pd.DataFrame, column: str) -> str:
    parts = [f"{counts.loc[name, column]} ({name})" for name in counts.index]
    return f"{', '.join(parts[:-1])} and {parts[-1]} of {counts['pairs'].iloc[0]} pairs"


def _both_mostly(counts: pd.DataFrame, column: str) -> bool:
    """INLP and LEACE help more than half of the pairs, and each more than STD."""
    both = counts.loc[["INLP", "LEACE"], column]
    return bool((both > counts["pairs"].iloc[0] / 2).all() and (both > counts.loc["STD", column]).all())
