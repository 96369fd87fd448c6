"""Tables I to III, the protocol, and what each page says of itself."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd
from IPython.display import HTML

from artifact.manifest import Manifest
from artifact.notebook import Page
from artifact.report.common import interval, marks, number, table
from artifact.studies import reported
from artifact.studies.catalogue import input_in_words
from artifact.studies.common import METRICS
from artifact.studies.protocol import Decision
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


def scope_notice(page: Page) -> HTML:
    """Say in a box what this build was measured on, and that it is not the paper's data where it is not."""
    kinds = {page.manifest.method(name).kind for name in page.methods}
    reported = [n for n in page.datasets if page.manifest.datasets.get(n) and page.manifest.datasets[n].reported_as]
    comparable = "paper" in kinds and reported
    note = (
        "Numbers are compared with the paper's where dataset and method are the same."
        if comparable
        else "None of these numbers can be compared with the paper's one by one: no method of the paper is among them. "
        "They show whether its claims hold elsewhere."
    )
    return HTML(
        f'<div class="admonition note"><p class="admonition-title">What this build shows</p><p>{html.escape(page.label)} {note}</p></div>'
    )


def headline(frame: pd.DataFrame, titles: Mapping[str, str]) -> HTML:
    """Show the clearest real case of the run in one sentence with its numbers."""
    candidates = frame[frame["origin"].str.startswith("real")]
    chosen = candidates if len(candidates) else frame
    row = chosen.loc[(chosen["R"] - chosen["DAR"]).idxmax()]
    return HTML(
        f'<p class="headline"><span class="big">{number(row["R"])} % → {number(row["DAR"])} %</span> '
        f"R@1 → DAR@1 of {html.escape(titles[row['method']])} on {html.escape(row['title'])} ({html.escape(row['origin'])}, "
        f"{row['queries']} queries): of {row['hits_R']} queries that find their place among the database images alone, "
        f"{row['hits_DAR']} still find it once images of other places under their own condition are added.</p>"
    )


def protocol_table(decisions: Sequence[Decision]) -> HTML:
    """Show the protocol: topic, what the paper says, what this artifact does."""
    rows = [{"Topic": d.topic, "The paper": d.paper, "This artifact": d.ours} for d in decisions]
    return table(pd.DataFrame(rows), classes="findings")


def sensitivity_table(frame: pd.DataFrame, titles: Mapping[str, str], *, k: int = 1) -> HTML:
    """Show the changes that open choices make, in percentage points."""

    def change(value: float) -> str:
        return "–" if pd.isna(value) else f"{value + 0.0:+.2f}" if abs(value) > 1e-9 else "0"

    shown = pd.DataFrame(
        {
            "Dataset": frame["title"],
            "Method": frame["method"].map(titles),
            f"R@{k} %": frame["R"].map(lambda v: number(v, digits=2)),
            f"DAR@{k} %": frame["DAR"].map(lambda v: number(v, digits=2)),
            "Ties: ΔR": frame["ties_R"].map(change),
            "Ties: ΔDAR": frame["ties_DAR"].map(change),
            "Excluded: ΔR": frame["excluded_R"].map(change),
            "Excluded: ΔDAR": frame["excluded_DAR"].map(change),
            "Threshold ×2: ΔDAR": frame["beyond_DAR"].map(change),
        }
    )
    return table(shown, numeric=list(shown.columns[2:]), caption="Changes in percentage points.")


def datasets_table(frame: pd.DataFrame) -> HTML:
    """Show Table I for the datasets of this run."""
    shown = pd.DataFrame(
        {
            "Dataset": frame["title"],
            "Query": frame["query"],
            "Database": frame["database"],
            "#Query": frame["queries"].map("{:,}".format),
            "evaluated": frame["evaluated"].map("{:,}".format),
            "#Database": frame["database_images"].map("{:,}".format),
            "Threshold": frame["threshold"],
            "Positives": frame["positives"].map("{:g}".format),
            "Condition shift": frame["shift"],
            "Images": frame["images"],
            "Mirrors": frame["mirrors"].replace("", "–"),
        }
    )
    return table(shown, numeric=["#Query", "evaluated", "#Database", "Positives"], caption="Datasets of this run.")


def reported_datasets_table() -> HTML:
    """Show the paper's Table I."""
    frame = reported.table("tab01")
    shown = pd.DataFrame(
        {
            "Dataset": frame["title"],
            "Query": frame["query"],
            "Database": frame["database"],
            "#Query": frame["queries"].map("{:,}".format),
            "#Database": frame["database_images"].map("{:,}".format),
            "Threshold": frame["threshold"],
            "Condition shift": frame["shift"],
        }
    )
    return table(shown, numeric=["#Query", "#Database"], caption="Reported by the paper.")


def methods_table(frame: pd.DataFrame) -> HTML:
    """Show Table II for the methods of this run."""
    shown = pd.DataFrame(
        {
            "Method": frame["title"],
            "Kind": frame["kind"].map({"baseline": "baseline", "paper": "method of the paper"}),
            "Backbone": frame["backbone"],
            "Aggregation": frame["aggregation"],
            "Dim": frame["dimension"],
            "Train data": frame["train_data"],
            "Re-rank": frame["rerank"],
            "Input": frame["input"],
            "Batch": frame["batch_size"],
            "Images per second": frame["images_per_second"].map(lambda v: number(v, digits=0)),
            "Busy %": frame["busy"].map(lambda v: number(v, digits=0)),
            "Device": frame["device"],
            "Licence": frame["licence"],
        }
    )
    return table(shown, numeric=["Dim", "Batch", "Images per second", "Busy %"], caption="Methods of this run.")


def reported_methods_table(manifest: Manifest, catalogue: pd.DataFrame) -> HTML:
    """Show the paper's Table II, and what this artifact adds to it.

    Parameters
    ----------
    manifest
        Input size, batch and licence of each method.
    catalogue
        As from :func:`artifact.studies.catalogue.methods_of_the_paper`: parameters, and whether the weights are here.
    """
    frame = reported.table("tab02")
    entries = [manifest.methods.get(name) for name in frame["method"]]
    ours = catalogue.set_index("method").reindex(frame["method"])
    shown = pd.DataFrame(
        {
            "Method": frame["title"],
            "Backbone": frame["backbone"],
            "Aggregation": frame["aggregation"],
            "Dim": frame["dimension"],
            "Train data": frame["train_data"],
            "Re-rank": frame["rerank"],
            "Input": [input_in_words(e.preprocessing) if e else "–" for e in entries],
            "Batch": [f"{e.batch_size}{' ‡' if e.batch_dependent else ''}" if e else "–" for e in entries],
            "Parameters (M)": ["–" if pd.isna(n) else f"{n / 1e6:.0f}" for n in ours["parameters"]],
            "Seconds an image": ["–" if pd.isna(n) else f"{n:.3g}" for n in ours["seconds"]],
            "Licence": ours["code_licence"].fillna("–").tolist(),
            "Weights here": ours["weights"].fillna("–").tolist(),
        }
    )
    how = "" if ours["seconds"].notna().any() else ": not measured yet, make bench METHODS=all does it"
    note = (
        "Reported by the paper up to re-ranking; the columns after it are this artifact's. ‡ descriptors depend on the batch. "
        f"Seconds an image: of the model on this machine, for a photograph of 480 × 640 pixels{how}."
    )
    return table(shown, numeric=["Dim", "Batch", "Parameters (M)", "Seconds an image"], caption=note)


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
