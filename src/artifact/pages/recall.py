"""Tables I to III, the protocol, and what each page says of itself."""

from __future__ import annotations

import html
from collections.abc import Mapping
from itertools import combinations
from typing import Any

import pandas as pd
from IPython.display import HTML
from matplotlib.figure import Figure

from artifact.metrics.statistics import rank_agreement
from artifact.pages.common import CLEARLY_PP, SIMILAR_PP, Finding, interval, marks, number, table
from artifact.pages.style import embed, marker_options, method_legend, percent_axis
from artifact.studies import reported
from artifact.studies.common import METRICS
from artifact.studies.recall import with_means


def recall_table(frame: pd.DataFrame, titles: Mapping[str, str], *, k: int = 1, label: str) -> HTML:
    """Show Table III in the paper's form: three metrics per dataset, means with ranks, marked cells.

    Parameters
    ----------
    frame
        As from :func:`artifact.studies.recall.recall_table`.
    titles
        Method name to printed title.
    k
        K, for the headings.
    label
        What the numbers are, printed in the caption.
    """
    means = with_means(frame).set_index("method")
    names = list(dict.fromkeys(frame["dataset"]))
    cells = frame.set_index(["dataset", "method"])
    methods = list(means.index)
    columns: dict[tuple[str, str], list[float]] = {
        (name, metric): [cells.loc[(name, method), metric] for method in methods]
        for name in names
        for metric in METRICS
    }
    columns |= {("mean", metric): means[metric].tolist() for metric in METRICS}
    marked = {column: marks([round(value, 9) for value in values]) for column, values in columns.items()}
    ranks = {(method, metric): means.loc[method, f"rank_{metric}"] for method in methods for metric in METRICS}
    heads = [cells.loc[(name, methods[0]), "title"] for name in names] + ["Mean"]
    return _recall_html(
        heads, {method: titles.get(method, method) for method in methods}, columns, marked, ranks, k, label
    )


def reported_recall_table() -> HTML:
    """Show the paper's own Table III, with its marks and ranks, labelled as reported."""
    cells = reported.table("tab03")
    names = list(dict.fromkeys(cells["dataset"]))
    titles = reported.method_titles()
    named = reported.dataset_titles() | {"mean": "Mean"}
    by_cell = cells.set_index(["dataset", "metric", "method"]).sort_index()
    columns, marked = {}, {}
    for name in names:
        for metric in METRICS:
            part = by_cell.loc[(name, f"{metric}@1")].loc[list(titles)]
            columns[name, metric] = part["percent"].tolist()
            marked[name, metric] = part["mark"].fillna("").tolist()
    ranks = {(m, metric): int(by_cell.loc[("mean", f"{metric}@1", m), "rank"]) for m in titles for metric in METRICS}
    label = "Reported by the paper (not measured here)."
    return _recall_html([named[n] for n in names], titles, columns, marked, ranks, 1, label)


def _recall_html(heads, titles, columns, marked, ranks, k, label) -> HTML:
    pinned = {metric: f" mean mean-{metric}" for metric in METRICS}  # the means stay in view while the rest scrolls
    top = "".join(
        f'<th colspan="3" class="group{" mean mean-R" if head == heads[-1] else ""}">{html.escape(head)}</th>'
        for head in heads
    )
    sub = "".join(
        f'<th class="right{pinned[metric] if head == heads[-1] else ""}">{metric}@{k}</th>'
        for head in heads
        for metric in METRICS
    )
    body = []
    for index, (method, title) in enumerate(titles.items()):
        row = f"<th>{html.escape(title)}</th>"
        for (name, metric), values in columns.items():
            rank = f"<sup>{ranks[method, metric]}</sup>" if name == "mean" else ""
            where = pinned[metric] if name == "mean" else ""
            row += f'<td class="right {marked[name, metric][index]}{where}">{number(values[index])}{rank}</td>'
        body.append(f"<tr>{row}</tr>")
    return HTML(
        f'<div class="scroll"><table class="results recall"><caption>{label}</caption><thead><tr><th></th>{top}</tr>'
        f"<tr><th>Method</th>{sub}</tr></thead><tbody>{''.join(body)}</tbody></table></div>"
    )


def beside_reported(frame: pd.DataFrame, titles: Mapping[str, str], *, k: int = 1) -> HTML:
    """Show every measured value with its interval and, where the paper has one, the reported value and the verdict."""
    rows = []
    for row in frame.to_dict("records"):
        shown = {
            "Dataset": html.escape(row["title"]),
            "Method": html.escape(titles.get(row["method"], row["method"])),
        }
        for metric in METRICS:
            shown[f"{metric}@{k} %"] = _beside(row, metric)
        shown |= {"Queries": row["queries"], "From": html.escape(row["origin"])}
        rows.append(shown)
    return table(pd.DataFrame(rows), numeric=[*(f"{metric}@{k} %" for metric in METRICS), "Queries"], escape=False)


def _beside(row: Mapping[str, Any], metric: str) -> str:
    """One cell: the measured value, its interval, and the paper's value with the verdict."""
    text = f"{number(row[metric], digits=2)}<small>{interval(row[f'{metric}_low'], row[f'{metric}_high'])}</small>"
    reported = row[f"reported_{metric}"]
    if pd.isna(reported):
        return text
    # RSR is a ratio of two counts, so it has no resolution of one query.
    judged = reported.verdict(row[metric], reported, None if metric == "RSR" else row["queries"])
    return f'{text}<small>paper {number(reported)} <span class="verdict {judged}">{judged}</span></small>'


def scatter(table: pd.DataFrame, titles: Mapping[str, str], *, k: int = 1) -> HTML:
    """Fig. 5: DAR@K against R@K, one panel per dataset, with the diagonal and the means over methods."""
    panels = {
        rows["title"].iloc[0]: rows.rename(columns={"R": "recall", "DAR": "dar"})
        for _, rows in table.groupby("dataset", sort=False)
    }
    return embed(
        _scatter(panels, titles, k),
        f"DAR@{k} against R@{k} of {len(titles)} methods on {len(panels)} datasets",
    )


def reported_scatter() -> HTML:
    """Draw Fig. 5 from the values that the paper plots."""
    points = reported.table("fig05").rename(columns={"recall_percent": "recall", "dar_percent": "dar"})
    named = reported.dataset_titles()
    panels = {named[dataset]: rows for dataset, rows in points.groupby("dataset", sort=False)}
    titles = reported.method_titles()
    return embed(_scatter(panels, titles, 1), "The paper's DAR@1 against R@1 of eleven methods on six datasets")


def _scatter(panels: Mapping[str, pd.DataFrame], titles: Mapping[str, str], k: int) -> Figure:
    columns = min(4 if len(panels) in (4, 7, 8) else 3, len(panels))
    rows = -(-len(panels) // columns)
    figure = Figure(figsize=(2.35 * columns + 0.5, 2.3 * rows + 0.5))
    axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for panel, (title, points) in zip(axes.flat, panels.items(), strict=False):
        panel.axline((0, 0), slope=1, linestyle="--", color="gray", linewidth=0.9, zorder=1)
        panel.axvline(points["recall"].mean(), linestyle=":", color="gray", linewidth=1, zorder=1)
        panel.axhline(points["dar"].mean(), linestyle=":", color="gray", linewidth=1, zorder=1)
        for point in points.to_dict("records"):
            options = marker_options(point["method"], list(titles))
            panel.plot(point["recall"], point["dar"], linestyle="none", clip_on=False, zorder=3, **options)
        percent_axis(panel)
        percent_axis(panel, axis="x")
        panel.set_title(title)
        panel.set_box_aspect(1)
    for panel in axes.flat[len(panels) :]:
        panel.set_axis_off()
    figure.supxlabel(f"R@{k} (%)", fontsize=9.5)
    figure.supylabel(f"DAR@{k} (%)", fontsize=9.5)
    figure.tight_layout(h_pad=1.4, w_pad=0.4)
    method_legend(figure, dict(titles))
    return figure


def ranking_changes(table: pd.DataFrame, titles: Mapping[str, str], k: int = 1) -> Finding:
    """Methods rank differently by mean DAR@K than by mean R@K (Table III)."""
    means = with_means(table).set_index("method")
    agrees = None
    if len(means) < 2:
        found = "one method has no ranking"
    else:
        moved = means.index[means.rank_R != means.rank_DAR]
        tau = rank_agreement(means.R.to_numpy(), means.DAR.to_numpy())
        agrees = len(moved) > 0
        moves = "; ".join(f"{titles[m]} from {means.rank_R[m]} to {means.rank_DAR[m]}" for m in moved)
        found = (
            f"{len(moved)} of {len(means)} methods change rank{f' ({moves})' if moves else ''}; Kendall's τ = {tau:.2f}"
        )
    return Finding(
        "tab03",
        f"Ranking methods by mean DAR@{k} gives another order than ranking them by mean R@{k}.",
        "SALAD-CM rises from 4th to 1st, CricaVPR falls from 5th to 7th",
        "at least one method changes its rank",
        found,
        agrees,
    )


def similar_recall_hides_differences(table: pd.DataFrame, titles: Mapping[str, str], k: int = 1) -> Finding:
    """Two methods with similar R@K can differ widely in DAR@K (Table III, Fig. 5)."""
    pairs = [
        (abs(a["DAR"] - b["DAR"]), a, b)
        for _, rows in table.groupby("dataset", sort=False)
        for a, b in combinations(rows.to_dict("records"), 2)
        if abs(a["R"] - b["R"]) <= SIMILAR_PP
    ]
    found, agrees = f"no two methods are within {SIMILAR_PP:g} pp in R@{k} on any dataset", None
    if pairs:
        gap, a, b = max(pairs, key=lambda pair: pair[0])
        agrees = gap > CLEARLY_PP
        found = (
            f"on {a['title']}, {titles[a['method']]} and {titles[b['method']]} have R@{k} {a['R']:.1f} % and {b['R']:.1f} % "
            f"but DAR@{k} {a['DAR']:.1f} % and {b['DAR']:.1f} %"
        )
    return Finding(
        "fig05",
        f"Similar R@{k} can hide large differences in DAR@{k}.",
        "RobotCar: AnyLoc and SelaVPR have R@1 95.9 % and 98.2 %, DAR@1 4.21 % and 71.2 %",
        f"two methods within {SIMILAR_PP:g} pp in R@{k} differ by more than {CLEARLY_PP:g} pp in DAR@{k} on some dataset",
        found,
        agrees,
    )


def distractors_lower_recall(table: pd.DataFrame, titles: Mapping[str, str], k: int = 1) -> Finding:
    """Distractors take successes from nearly every method on nearly every dataset (Table III)."""
    loss = table["R"] - table["DAR"]
    worst = table.loc[loss.idxmax()]
    clear = int((loss > CLEARLY_PP).sum())
    return Finding(
        "tab03",
        f"DAR@{k} is at most R@{k}, and can be far below it.",
        "AnyLoc on RobotCar falls from 95.9 % to 4.21 %",
        f"DAR@{k} never exceeds R@{k}, and some pair loses more than {CLEARLY_PP:g} pp",
        f"{clear} of {len(table)} method–dataset pairs lose more than {CLEARLY_PP:g} pp; most: {titles[worst['method']]} on "
        f"{worst['title']}, {worst['R']:.1f} % to {worst['DAR']:.1f} %",
        bool((loss >= 0).all() and clear > 0),
    )
