"""Table III and Fig. 5: recall with and without distractors."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
import pandas as pd
from IPython.display import HTML
from matplotlib.axes import Axes

from artifact.metrics.statistics import ends, rank_agreement
from artifact.pages.common import (
    CLEARLY_PP,
    NOTHING_TO_COMPARE,
    SIMILAR_PP,
    Answer,
    Titles,
    claimed,
    interval,
    join,
    listed,
    marks,
    markup,
    number,
    table,
    two_decimals,
    verdict,
)
from artifact.pages.style import drawing, embed, marker_options, method_legend, percent_axis, tell_values
from artifact.studies import reported, verdicts
from artifact.studies.common import METRICS, Study
from artifact.studies.judging import changes_places, some_above
from artifact.studies.recall import mean_replicates, with_means

_MARKED = {"best": "<b>{}</b>", "second": "<u>{}</u>", "worst": "<i>{}</i>"}

_Cell = tuple[float, str, float]
"""A value, its mark, and its rank, which only means have."""


def recall_table(frame: pd.DataFrame, titles: Titles, *, k: int = 1, label: str) -> HTML:
    """Show Table III in the paper's form: three metrics per dataset, means with ranks, marked cells, a label on top."""
    means = with_means(frame).set_index("method")
    frame = frame.sort_values("origin", key=lambda origin: ~origin.str.startswith("real"), kind="stable")
    parts = [rows.set_index("method").loc[means.index] for _, rows in frame.groupby("dataset", sort=False)]
    columns = []
    for part, metric in product([*parts, means], METRICS):
        ranks = part.get(f"rank_{metric}", [np.nan] * len(part))
        columns.append(list(zip(part[metric], marks([round(value, 9) for value in part[metric]]), ranks, strict=True)))
    names = [*(part["title"].iloc[0] for part in parts), "Mean"]
    return _in_the_papers_form([titles[method] for method in means.index], names, columns, k, label)


def reported_recall_table() -> HTML:
    """Show the paper's own Table III, with its marks and ranks, labelled as reported."""
    titles, names, columns = reported.method_titles(), [], []
    for dataset, cells in reported.table("tab03").groupby("dataset", sort=False):
        names.append(reported.dataset_titles().get(dataset, "Mean"))
        for metric in METRICS:
            part = cells[cells["metric"] == f"{metric}@1"].set_index("method").loc[list(titles)]
            columns.append(list(zip(part["percent"], part["mark"].fillna(""), part["rank"], strict=True)))
    return _in_the_papers_form(list(titles.values()), names, columns, 1, "Reported by the paper, not from this run.")


def _in_the_papers_form(
    methods: Sequence[str], names: Sequence[str], columns: Sequence[Sequence[_Cell]], k: int, caption: str
) -> HTML:
    """Three columns per name, of which the last is that of the means; on a narrow page each cell has its heading."""
    first = [" mean" if n == len(columns) - len(METRICS) else "" for n in range(len(columns))]
    labels = [f"{name} {metric}@{k}" for name, metric in product(names, METRICS)]
    top = join(
        markup('<th colspan="3" scope="colgroup" class="group{}">{}</th>', *pair)
        for pair in zip(first[:: len(METRICS)], names, strict=True)
    )
    sub = join(
        markup('<th scope="col" class="right{}">{}<wbr>@{}</th>', style, metric, k)
        for style, metric in zip(first, METRICS * len(names), strict=True)
    )
    body = join(
        markup('<tr><th scope="row">{}</th>{}</tr>', title, join(map(_cell, cells, first, labels)))
        for title, *cells in zip(methods, *columns, strict=True)
    )
    return markup(
        '<div class="scroll" tabindex="0"><table class="results recall"><caption>{}</caption><thead><tr>'
        '<th scope="col" rowspan="2">Method</th>{}</tr><tr>{}</tr></thead><tbody>{}</tbody></table></div>',
        *(caption, top, sub, body),
    )


def _cell(cell: _Cell, classes: str, label: str) -> HTML:
    value, mark, rank = cell
    superscript = "" if pd.isna(rank) else markup("<sup>{}</sup>", int(rank))
    shown = markup(_MARKED.get(mark, "{}"), number(value))
    return markup('<td class="right {}{}" data-label="{}">{}{}</td>', mark, classes, label, shown, superscript)


def beside_reported(frame: pd.DataFrame, titles: Titles, *, k: int = 1) -> HTML:
    """Show every measured value with its interval and, where the paper has one, the reported value and the verdict."""
    headings = {metric: f"{metric}@{k}\u00a0%" for metric in METRICS}
    judged = verdicts.of_recall(frame).set_index(["dataset", "method", "quantity"])["verdict"].to_dict()
    rows = []
    for row in frame.to_dict("records"):
        cells = {"Dataset": row["title"], "Method": titles[row["method"]]}
        for metric, heading in headings.items():
            bounds = interval(row[f"{metric}_low"], row[f"{metric}_high"])
            cells[heading] = markup("{} <small>{}</small>", two_decimals(row[metric]), bounds)
            if found := judged.get((row["title"], row["method"], f"{metric}@{k} %")):
                beside = number(row[f"reported_{metric}"]), verdict(found)
                cells[heading] = markup("{} <small>paper {} {}</small>", cells[heading], *beside)
        rows.append(cells | {"Queries": row["queries"], "From": row["origin"]})
    return table(rows, numeric=[*headings.values(), "Queries"])


def scatter(table: pd.DataFrame, titles: Titles, *, k: int = 1, source: str = "measured in this run") -> HTML:
    """Fig. 5: DAR@K against R@K, one panel per dataset, with the diagonal and the means over methods."""
    panels = [rows for _, rows in table.groupby("dataset", sort=False)]
    columns = min(4 if len(panels) in (4, 7, 8) else 3, len(panels))
    rows = -(-len(panels) // columns)
    figure, axes = drawing((2.5 * columns, 2.5 * rows), rows, columns, squeeze=False)
    for panel, points in zip(axes.flat, panels, strict=False):
        _draw_points(panel, points, titles)
        panel.set(title=points["title"].iloc[0], xlabel=f"R@{k} (%)", ylabel=f"DAR@{k} (%)")
    for panel in axes.flat[len(panels) :]:
        panel.set_axis_off()
    method_legend(figure, titles, lines=False)
    return embed(figure, f"DAR@{k} against R@{k} of {len(titles)} methods on {len(panels)} datasets, {source}")


def reported_scatter() -> HTML:
    """Draw Fig. 5 from the values that the paper plots."""
    points = reported.table("fig05").rename(columns={"recall_percent": "R", "dar_percent": "DAR"})
    points["title"] = points["dataset"].map(reported.dataset_titles())
    return scatter(points, reported.method_titles(), source="reported by the paper")


def _draw_points(axes: Axes, points: pd.DataFrame, titles: Titles) -> None:
    axes.axline((0, 0), slope=1, linestyle="--", color="gray", linewidth=0.9, zorder=1)
    axes.axvline(points["R"].mean(), linestyle=":", color="gray", linewidth=1, zorder=1)
    axes.axhline(points["DAR"].mean(), linestyle=":", color="gray", linewidth=1, zorder=1)
    texts = []
    for method, recall, dar in points[["method", "R", "DAR"]].itertuples(index=False):
        axes.plot(recall, dar, linestyle="none", clip_on=False, zorder=3, **marker_options(method, titles))
        texts.append(f"{titles[method]}: R {recall:.2f} %, DAR {dar:.2f} %")
    percent_axis(axes)
    percent_axis(axes, axis="x")
    axes.set_box_aspect(1)
    tell_values(axes, points[["R", "DAR"]], texts)


@claimed
def ranking_changes(study: Study, titles: Titles, k: int = 1) -> Answer:
    """Methods rank differently by DAR@K than by R@K on some dataset (Table III)."""
    table, sample = study.table, study.replicates
    scores = table["R"].to_numpy(), table["DAR"].to_numpy()
    judged, certain = changes_places(*scores, (sample["R"], sample["DAR"]), table["dataset"].tolist())
    groups = list(table.groupby("dataset", sort=False).indices.items())
    if len(table) == len(groups):
        return "one method has no ranking", judged
    taus = np.array([rank_agreement(scores[0][rows], scores[1][rows]) for _, rows in groups])
    drawn = np.stack([rank_agreement(sample["R"][rows], sample["DAR"][rows]) for _, rows in groups])
    low, high = ends(np.nanmean(drawn, axis=0)) if not np.isnan(drawn).all() else (np.nan, np.nan)
    changed = [table["title"].iloc[rows[0]] for (_, rows), tau in zip(groups, taus, strict=True) if tau < 1 - 1e-9]
    beyond = {table["title"].iloc[first] for first, _ in certain}
    found = (
        f"the order changes on {len(changed)} of {len(groups)} datasets, beyond chance on {len(beyond)}"
        f"{listed(sorted(beyond))}; Kendall's τ between R@{k} and DAR@{k}, mean over datasets, is {np.nanmean(taus):.2f} "
        f"[{low:.2f}, {high:.2f}]"
    )
    return found, judged


@claimed
def mean_ranking_changes(study: Study, titles: Titles, k: int = 1) -> Answer:
    """Methods rank differently by mean DAR@K than by mean R@K (Table III)."""
    means = with_means(study.table).set_index("method")
    sample = mean_replicates(study)
    scores = means.R.to_numpy(), means.DAR.to_numpy()
    judged, certain = changes_places(*scores, (sample["R"], sample["DAR"]), [0] * len(means))
    moved = means[means.rank_R != means.rank_DAR]
    moves = "; ".join(f"{titles[m]} from {row.rank_R} to {row.rank_DAR}" for m, row in moved.iterrows())
    sure = [" and ".join(titles[means.index[row]] for row in pair) for pair in certain]
    found = f"{len(moved)} of {len(means)} methods change rank{listed([moves] if moves else [])}"
    return f"{found}; beyond chance: {', '.join(sure) or 'none'}", judged


@claimed
def similar_recall_hides_differences(study: Study, titles: Titles, k: int = 1) -> Answer:
    """Two methods with similar R@K can differ widely in DAR@K (Table III, Fig. 5)."""
    table, sample = study.table, study.replicates["DAR"]
    recall, dar, names = (table[column].to_numpy() for column in ("R", "DAR", "dataset"))
    i, j = np.triu_indices(len(table), 1)
    close = (names[i] == names[j]) & (np.abs(recall[i] - recall[j]) <= SIMILAR_PP)
    if not close.any():
        return f"no two methods are within {SIMILAR_PP:g} pp in R@{k} on any dataset", NOTHING_TO_COMPARE
    i, j = np.where(dar[i] > dar[j], (i, j), (j, i))[:, close]
    judged, _ = some_above(dar[i] - dar[j], sample[i] - sample[j], CLEARLY_PP)
    most = np.argmax(dar[i] - dar[j])
    a, b = table.iloc[i[most]], table.iloc[j[most]]
    found = (
        f"on {a['title']}, {titles[a['method']]} and {titles[b['method']]} have R@{k} {a['R']:.1f} % and {b['R']:.1f} % "
        f"but DAR@{k} {a['DAR']:.1f} % and {b['DAR']:.1f} %"
    )
    return found, judged


@claimed
def distractors_lower_recall(study: Study, titles: Titles, k: int = 1) -> Answer:
    """Distractors take successes from nearly every method on nearly every dataset (Table III)."""
    table, sample = study.table, study.replicates
    loss = table["R"] - table["DAR"]
    judged, certain = some_above(loss.to_numpy(), sample["R"] - sample["DAR"], CLEARLY_PP)
    worst = table.loc[loss.idxmax()]
    found = (
        f"{certain.sum()} of {len(table)} method–dataset pairs lose more than {CLEARLY_PP:g} pp beyond chance; most: "
        f"{titles[worst['method']]} on {worst['title']}, {worst['R']:.1f} % to {worst['DAR']:.1f} %"
    )
    return found, judged
