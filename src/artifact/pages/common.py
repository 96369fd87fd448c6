"""The parts that all pages share: claims with verdicts, plain tables, numbers, downloads."""

from __future__ import annotations

import base64
import html
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import pandas as pd
from IPython.display import HTML

CLEARLY_PP = 10.0
"""Difference in percentage points that counts as "well below" or "large"; the paper gives no number."""

SIMILAR_PP = 5.0
"""Difference in R@1 in percentage points up to which two methods count as similar."""

PAGES = {
    "fig02": "Fig. 2",
    "tab03": "Table III",
    "fig05": "Fig. 5",
    "fig06": "Fig. 6",
    "fig07": "Fig. 7",
    "fig08": "Fig. 8",
    "fig09": "Fig. 9",
    "tab04": "Table IV",
    "tab05": "Table V",
    "fig10": "Fig. 10",
}
"""Notebooks that show a finding, with their printed titles."""

_SHORT = 24  # characters that a table cell keeps on one line
_TALL = 30  # rows from which on a table scrolls in a box of its own


@dataclass(frozen=True)
class Finding:
    """A claim of the paper and what a run says about it.

    Attributes
    ----------
    page
        Notebook that shows it.
    claim
        The claim, in one line.
    paper
        The paper's evidence, in one line.
    rule
        When the two agree; ours, since the paper states its claims in words.
    found
        What this run measured.
    agrees
        ``None`` if this run cannot tell.
    """

    page: str
    claim: str
    paper: str
    rule: str
    found: str
    agrees: bool | None


def finding(*findings: Finding) -> HTML:
    """Show claims of the paper, what this run measured, and whether they agree."""
    return HTML("".join(_one_finding(item) for item in findings))


def _one_finding(item: Finding) -> str:
    rows = {
        "Claim": html.escape(item.claim),
        "Paper": html.escape(item.paper),
        "Agrees if": html.escape(item.rule),
        "This run": f"{html.escape(item.found)} {_agreement(item.agrees)}",
    }
    listed = "".join(
        f'<div class="line"><span class="tag">{tag}</span><span>{text}</span></div>' for tag, text in rows.items()
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
    styles = {column: "right" if column in right else _text_style(frame[column]) for column in frame.columns}
    head = "".join(f'<th class="{styles[c]}">{html.escape(str(c))}</th>' for c in frame.columns)
    body = "".join(
        "<tr>"
        + "".join(
            f'<td class="{styles[column]}">{html.escape(str(value)) if escape else value}</td>'
            for column, value in zip(frame.columns, row, strict=True)
        )
        + "</tr>"
        for row in frame.itertuples(index=False)
    )
    text = f"<caption>{caption}</caption>" if caption else ""
    inner = f"{text}<thead><tr>{head}</tr></thead><tbody>{body}</tbody>"
    tall = " tall" if len(frame) > _TALL else ""
    return HTML(f'<div class="scroll{tall}"><table class="results {classes}">{inner}</table></div>')


def _text_style(column: pd.Series) -> str:
    """Keep short texts on one line."""
    return "short" if column.astype(str).str.len().max() <= _SHORT else ""


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


def label(text: str) -> HTML:
    """Show the line that says what the numbers are from."""
    return HTML(f'<p class="origin">{html.escape(text)}</p>')


def download(frame: pd.DataFrame, name: str) -> HTML:
    """Offer a frame as a CSV file that is embedded in the page."""
    text = base64.b64encode(frame.to_csv(index=False).encode()).decode()
    return HTML(
        f'<p class="download"><a download="{name}.csv" href="data:text/csv;base64,{text}">Download the data behind '
        f"this page</a> ({name}.csv, {len(frame)} rows)</p>"
    )


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
