"""How the book shows results: tables in the paper's form, verdicts, downloads and provenance, as HTML.

Everything is plain HTML with classes that ``book/_static/artifact.css`` styles for light and dark pages. Nothing
is fetched: downloads are embedded in the page.
"""

from __future__ import annotations

import base64
import html
import os
import platform
import subprocess
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pandas as pd
from IPython.display import HTML

from artifact import paper
from artifact.findings import PAGES, Finding
from artifact.manifest import Manifest
from artifact.notebook import Page
from artifact.protocol import Decision
from artifact.studies import METRICS, Study, input_in_words, with_means


def finding(*findings: Finding) -> HTML:
    """Show claims of the paper, what this run measured, and whether they agree."""
    return HTML("".join(_one_finding(item) for item in findings))


def _one_finding(item: Finding) -> str:
    rows = {
        "Claim": item.claim,
        "Paper": item.paper,
        "This run": f"{html.escape(item.found)} {_agreement(item.agrees)}",
    }
    listed = "".join(
        f'<div class="row"><span class="tag">{tag}</span><span>{text}</span></div>' for tag, text in rows.items()
    )
    return f'<div class="claim">{listed}</div>'


def _agreement(agrees: bool | None) -> str:
    label, style = {
        True: ("agrees", "agrees"), False: ("does not agree", "disagrees"), None: ("cannot tell", "open"),
    }[agrees]  # fmt: skip
    return f'<span class="verdict {style}">{label}</span>'


def findings_table(findings: Sequence[Finding]) -> HTML:
    """Show all findings as one table with links to their pages."""
    rows = [
        {
            "Claim": html.escape(item.claim),
            "The paper": html.escape(item.paper),
            "This run": html.escape(item.found),
            "Verdict": _agreement(item.agrees),
            "Page": f'<a href="{item.page}.html">{PAGES[item.page]}</a>',
        }
        for item in findings
    ]
    return table(pd.DataFrame(rows), escape=False, classes="findings")


def number(value: float, *, digits: int | None = None) -> str:
    """Print a percentage as the paper does: three significant digits, two decimals at most.

    Examples
    --------
    >>> number(95.92), number(4.207), number(0.29), number(100.0), number(float("nan"))
    ('95.9', '4.21', '0.29', '100', '–')
    """
    if pd.isna(value):
        return "–"
    if digits is None:
        digits = 2 if abs(value) < 9.995 else 1 if abs(value) < 99.95 else 0
    return f"{value:.{digits}f}"


def interval(low: float, high: float) -> str:
    """Print an interval in percent."""
    return f"[{number(low, digits=1)}, {number(high, digits=1)}]"


def table(
    frame: pd.DataFrame, *, numeric: Iterable[str] = (), caption: str = "", classes: str = "", escape: bool = True
) -> HTML:  # fmt: skip
    """Show a frame as a plain table; columns named in ``numeric`` are set flush right."""
    right = set(numeric)
    head = "".join(f'<th class="{"right" if c in right else ""}">{html.escape(str(c))}</th>' for c in frame.columns)
    body = "".join(
        "<tr>"
        + "".join(
            f'<td class="{"right" if column in right else ""}">{html.escape(str(value)) if escape else value}</td>'
            for column, value in zip(frame.columns, row, strict=True)
        )
        + "</tr>"
        for row in frame.itertuples(index=False)
    )
    text = f"<caption>{caption}</caption>" if caption else ""
    return HTML(
        f'<div class="scroll"><table class="results {classes}">{text}<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'
    )


def marks(values: Sequence[float]) -> list[str]:
    """Return ``best``, ``second``, ``worst`` or nothing for each value of a column; equal values share a mark.

    Examples
    --------
    >>> marks([3.0, 1.0, 2.0, 3.0])
    ['best', 'worst', 'second', 'best']
    """
    levels = sorted({value for value in values if not pd.isna(value)}, reverse=True)
    if len(levels) < 2:
        return ["" for _ in values]
    named = {levels[-1]: "worst", levels[1]: "second", levels[0]: "best"}
    if len(levels) == 2:
        named[levels[1]] = "worst"
    return [named.get(value, "") for value in values]


def recall_table(frame: pd.DataFrame, titles: Mapping[str, str], *, k: int = 1, label: str) -> HTML:
    """Show Table III in the paper's form: three metrics per dataset, means with ranks, marked cells.

    Parameters
    ----------
    frame
        As from :func:`artifact.studies.recall_table`.
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
    cells = paper.reported("tab03")
    names = list(dict.fromkeys(cells["dataset"]))
    titles = paper.method_titles()
    named = paper.dataset_titles() | {"mean": "Mean"}
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
    top = "".join(f'<th colspan="3" class="group">{html.escape(head)}</th>' for head in heads)
    sub = "".join(f'<th class="right">{metric}@{k}</th>' for _ in heads for metric in METRICS)
    body = []
    for index, (method, title) in enumerate(titles.items()):
        row = f"<th>{html.escape(title)}</th>"
        for (name, metric), values in columns.items():
            rank = f"<sup>{ranks[method, metric]}</sup>" if name == "mean" else ""
            row += f'<td class="right {marked[name, metric][index]}">{number(values[index])}{rank}</td>'
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


def label(text: str) -> HTML:
    """Show the line that says what the numbers are from."""
    return HTML(f'<p class="origin">{html.escape(text)}</p>')


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
    frame = paper.reported("tab01")
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


def reported_methods_table(manifest: Manifest) -> HTML:
    """Show the paper's Table II, with the input sizes that this artifact uses where the paper states none."""
    frame = paper.reported("tab02")
    entries = [manifest.methods.get(name) for name in frame["method"]]
    shown = pd.DataFrame(
        {
            "Method": frame["title"],
            "Backbone": frame["backbone"],
            "Aggregation": frame["aggregation"],
            "Dim": frame["dimension"],
            "Train data": frame["train_data"],
            "Re-rank": frame["rerank"],
            "Input (ours)": [input_in_words(e.preprocessing) if e else "–" for e in entries],
            "Batch (ours)": [f"{e.batch_size}{' ‡' if e.batch_dependent else ''}" if e else "–" for e in entries],
            "Licence": [e.licence if e else "–" for e in entries],
        }
    )
    note = "Reported by the paper; the last three columns are this artifact's. ‡ descriptors depend on the batch."
    return table(shown, numeric=["Dim", "Batch (ours)"], caption=note)


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
    judged = paper.verdict(row[metric], reported, None if metric == "RSR" else row["queries"])
    return f'{text}<small>paper {number(reported)} <span class="verdict {judged}">{judged}</span></small>'


def download(frame: pd.DataFrame, name: str) -> HTML:
    """Offer a frame as a CSV file that is embedded in the page."""
    text = base64.b64encode(frame.to_csv(index=False).encode()).decode()
    return HTML(
        f'<p class="download"><a download="{name}.csv" href="data:text/csv;base64,{text}">Download the data behind '
        f"this page</a> ({name}.csv, {len(frame)} rows)</p>"
    )


def provenance(parameters: Mapping[str, Any], *studies: Study) -> HTML:
    """Show what made this page: parameters, inputs with their keys, code revision, machine and time."""
    inputs = pd.DataFrame([record for study in studies for record in study.inputs]).drop_duplicates()
    settings = "".join(
        f"<li><code>{html.escape(k)} = {html.escape(repr(v))}</code></li>" for k, v in parameters.items()
    )
    facts = {
        "Code": code_revision(),
        "Run": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "Machine": f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}",
    }
    listed = "".join(f"<li>{name}: {html.escape(value)}</li>" for name, value in facts.items())
    shown = table(inputs, numeric=["images"]).data if len(inputs) else "<p>No descriptors are used here.</p>"
    return HTML(
        f'<details class="provenance"><summary>Provenance: parameters, inputs, code, time</summary>'
        f"<ul>{settings}</ul><ul>{listed}</ul>{shown}</details>"
    )


def code_revision() -> str:
    """Return the package version and, in a git checkout, the commit and whether files differ from it."""
    from artifact import __version__

    folder = Path(__file__).resolve().parents[2]
    try:
        commit = _git(folder, "rev-parse", "--short=12", "HEAD")
        changed = _git(folder, "status", "--porcelain", "--untracked-files=no")
    except (OSError, subprocess.CalledProcessError):
        return f"artifact {__version__}"
    return f"artifact {__version__}, commit {commit}{' with local changes' if changed else ''}"


def _git(folder: Path, *arguments: str) -> str:
    done = subprocess.run(["git", "-C", str(folder), *arguments], check=True, capture_output=True, text=True)
    return done.stdout.strip()
