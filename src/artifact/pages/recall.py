"""Table III and Fig. 5: recall with and without distractors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import pandas as pd
from IPython.display import HTML
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from artifact.metrics.statistics import rank_agreement
from artifact.pages.common import (
    CLEARLY_PP,
    SIMILAR_PP,
    claim,
    interval,
    join,
    listed,
    marks,
    markup,
    number,
    table,
    verdict,
)
from artifact.pages.style import embed, marker_options, method_legend, percent_axis
from artifact.studies import reported, verdicts
from artifact.studies.common import METRICS
from artifact.studies.recall import with_means


@dataclass(frozen=True)
class _Column:
    """One metric on one dataset: per method the value, its mark, and on the mean its rank."""

    values: Sequence[float]
    marks: Sequence[str]
    ranks: Sequence[int] | None = None


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
    groups = []
    for _, rows in frame.groupby("dataset", sort=False):
        by_method = rows.set_index("method").loc[means.index]
        groups.append((rows["title"].iloc[0], [_column(by_method[metric]) for metric in METRICS]))
    last = [_column(means[metric], means[f"rank_{metric}"].tolist()) for metric in METRICS]
    return _in_the_papers_form([titles[method] for method in means.index], groups, last, k, label)


def _column(values: pd.Series, ranks: Sequence[int] | None = None) -> _Column:
    return _Column(values.tolist(), marks([round(value, 9) for value in values]), ranks)


def reported_recall_table() -> HTML:
    """Show the paper's own Table III, with its marks and ranks, labelled as reported."""
    titles, groups = reported.method_titles(), []
    for name, cells in reported.table("tab03").groupby("dataset", sort=False):
        columns = []
        for metric in METRICS:
            part = cells[cells["metric"] == f"{metric}@1"].set_index("method").loc[list(titles)]
            ranks = part["rank"].astype(int).tolist() if name == "mean" else None
            columns.append(_Column(part["percent"].tolist(), part["mark"].fillna("").tolist(), ranks))
        groups.append((reported.dataset_titles().get(name, "Mean"), columns))
    _, last = groups.pop()
    return _in_the_papers_form(list(titles.values()), groups, last, 1, "Reported by the paper, not from this run.")


def _in_the_papers_form(
    methods: Sequence[str], groups: Sequence[tuple[str, list[_Column]]], means: list[_Column], k: int, caption: str
) -> HTML:
    pinned = [f" mean mean-{metric}" for metric in METRICS]  # the means stay in view while the rest scrolls
    head = '<th colspan="3" class="group{}">{}</th>'
    top = join([*(markup(head, "", title) for title, _ in groups), markup(head, " mean mean-R", "Mean")])
    classes = [""] * len(METRICS) * len(groups) + pinned
    metrics = METRICS * (len(groups) + 1)
    sub = join(markup('<th class="right{}">{}@{}</th>', *pair, k) for pair in zip(classes, metrics, strict=True))
    columns = [*(column for _, group in groups for column in group), *means]
    body = join(
        markup("<tr><th>{}</th>{}</tr>", title, join(_cell(c, i, s) for c, s in zip(columns, classes, strict=True)))
        for i, title in enumerate(methods)
    )
    return markup(
        '<div class="scroll"><table class="results recall"><caption>{}</caption><thead><tr><th></th>{}</tr>'
        "<tr><th>Method</th>{}</tr></thead><tbody>{}</tbody></table></div>",
        *(caption, top, sub, body),
    )


def _cell(column: _Column, index: int, classes: str) -> HTML:
    rank = markup("<sup>{}</sup>", column.ranks[index]) if column.ranks else ""
    return markup('<td class="right {}{}">{}{}</td>', column.marks[index], classes, number(column.values[index]), rank)


def beside_reported(frame: pd.DataFrame, titles: Mapping[str, str], *, k: int = 1) -> HTML:
    """Show every measured value with its interval and, where the paper has one, the reported value and the verdict."""
    headings = {metric: f"{metric}@{k}\u00a0%" for metric in METRICS}
    judged = verdicts.of_recall(frame).set_index(["dataset", "method", "quantity"])["verdict"].to_dict()
    rows = [
        {"Dataset": row["title"], "Method": titles[row["method"]]}
        | {
            h: _beside(row, metric, judged.get((row["title"], row["method"], f"{metric}@{k} %")))
            for metric, h in headings.items()
        }
        | {"Queries": row["queries"], "From": row["origin"]}
        for row in frame.to_dict("records")
    ]
    return table(rows, numeric=[*headings.values(), "Queries"])


def _beside(row: Mapping[str, Any], metric: str, judged: str | None) -> HTML:
    """One cell: the measured value, its interval, and the paper's value with the verdict."""
    bounds = interval(row[f"{metric}_low"], row[f"{metric}_high"])
    cell = markup("{}<small>{}</small>", number(row[metric], digits=2), bounds)
    if judged is None:
        return cell
    return markup("{}<small>paper {} {}</small>", cell, number(row[f"reported_{metric}"]), verdict(judged))


def scatter(
    table: pd.DataFrame, titles: Mapping[str, str], *, k: int = 1, source: str = "measured in this run"
) -> HTML:
    """Fig. 5: DAR@K against R@K, one panel per dataset, with the diagonal and the means over methods."""
    panels = [rows for _, rows in table.groupby("dataset", sort=False)]
    columns = min(4 if len(panels) in (4, 7, 8) else 3, len(panels))
    rows = -(-len(panels) // columns)
    figure = Figure(figsize=(2.35 * columns + 0.5, 2.3 * rows + 0.5))
    axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for panel, points in zip(axes.flat, panels, strict=False):
        _draw_points(panel, points, list(titles))
        panel.set_title(points["title"].iloc[0])
    for panel in axes.flat[len(panels) :]:
        panel.set_axis_off()
    figure.supxlabel(f"R@{k} (%)", fontsize=9.5)
    figure.supylabel(f"DAR@{k} (%)", fontsize=9.5)
    figure.tight_layout(h_pad=1.4, w_pad=0.4)
    method_legend(figure, titles)
    return embed(figure, f"DAR@{k} against R@{k} of {len(titles)} methods on {len(panels)} datasets, {source}")


def reported_scatter() -> HTML:
    """Draw Fig. 5 from the values that the paper plots."""
    points = reported.table("fig05").rename(columns={"recall_percent": "R", "dar_percent": "DAR"})
    points["title"] = points["dataset"].map(reported.dataset_titles())
    return scatter(points, reported.method_titles(), source="reported by the paper")


def _draw_points(axes: Axes, points: pd.DataFrame, methods: Sequence[str]) -> None:
    axes.axline((0, 0), slope=1, linestyle="--", color="gray", linewidth=0.9, zorder=1)
    axes.axvline(points["R"].mean(), linestyle=":", color="gray", linewidth=1, zorder=1)
    axes.axhline(points["DAR"].mean(), linestyle=":", color="gray", linewidth=1, zorder=1)
    for point in points.to_dict("records"):
        options = marker_options(point["method"], methods)
        axes.plot(point["R"], point["DAR"], linestyle="none", clip_on=False, zorder=3, **options)
    percent_axis(axes)
    percent_axis(axes, axis="x")
    axes.set_box_aspect(1)


@claim(
    "tab03",
    "Ranking methods by mean DAR@K gives another order than ranking them by mean R@K.",
    paper="SALAD-CM rises from 4th to 1st, CricaVPR falls from 5th to 7th",
    rule="at least one method changes its rank",
)
def ranking_changes(table: pd.DataFrame, titles: Mapping[str, str], k: int = 1) -> tuple[str, bool | None]:
    """Methods rank differently by mean DAR@K than by mean R@K (Table III)."""
    means = with_means(table).set_index("method")
    if len(means) < 2:
        return "one method has no ranking", None
    moved = means[means.rank_R != means.rank_DAR]
    moves = "; ".join(f"{titles[m]} from {row.rank_R} to {row.rank_DAR}" for m, row in moved.iterrows())
    tau = rank_agreement(means.R.to_numpy(), means.DAR.to_numpy())
    found = f"{len(moved)} of {len(means)} methods change rank{listed([moves] if moves else [])}"
    return f"{found}; Kendall's τ between R@{k} and DAR@{k} is {tau:.2f}", len(moved) > 0


@claim(
    "fig05",
    "Similar R@K can hide large differences in DAR@K.",
    paper="RobotCar: AnyLoc and SelaVPR have R@1 95.9 % and 98.2 %, DAR@1 4.21 % and 71.2 %",
    rule=f"two methods within {SIMILAR_PP:g} pp in R@K differ by more than {CLEARLY_PP:g} pp in DAR@K on some dataset",
)
def similar_recall_hides_differences(
    table: pd.DataFrame, titles: Mapping[str, str], k: int = 1
) -> tuple[str, bool | None]:
    """Two methods with similar R@K can differ widely in DAR@K (Table III, Fig. 5)."""
    pairs = [
        (abs(a["DAR"] - b["DAR"]), a, b)
        for _, rows in table.groupby("dataset", sort=False)
        for a, b in combinations(rows.to_dict("records"), 2)
        if abs(a["R"] - b["R"]) <= SIMILAR_PP
    ]
    if not pairs:
        return f"no two methods are within {SIMILAR_PP:g} pp in R@{k} on any dataset", None
    gap, a, b = max(pairs, key=lambda pair: pair[0])
    found = (
        f"on {a['title']}, {titles[a['method']]} and {titles[b['method']]} have R@{k} {a['R']:.1f} % and {b['R']:.1f} % "
        f"but DAR@{k} {a['DAR']:.1f} % and {b['DAR']:.1f} %"
    )
    return found, gap > CLEARLY_PP


@claim(
    "tab03",
    "DAR@K is at most R@K, and can be far below it.",
    paper="AnyLoc on RobotCar falls from 95.9 % to 4.21 %",
    rule=f"DAR@K never exceeds R@K, and some pair loses more than {CLEARLY_PP:g} pp",
)
def distractors_lower_recall(table: pd.DataFrame, titles: Mapping[str, str], k: int = 1) -> tuple[str, bool | None]:
    """Distractors take successes from nearly every method on nearly every dataset (Table III)."""
    loss = table["R"] - table["DAR"]
    worst = table.loc[loss.idxmax()]
    clear = int((loss > CLEARLY_PP).sum())
    found = (
        f"{clear} of {len(table)} method–dataset pairs lose more than {CLEARLY_PP:g} pp; most: {titles[worst['method']]} on "
        f"{worst['title']}, {worst['R']:.1f} % to {worst['DAR']:.1f} %"
    )
    return found, bool((loss >= 0).all() and clear > 0)
