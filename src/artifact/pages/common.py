"""The parts that all pages share: claims with verdicts, plain tables, numbers, downloads.

Text that comes from a manifest, a folder or a run is escaped in one place, :func:`markup`.
"""

from __future__ import annotations

import base64
import functools
import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ParamSpec

import pandas as pd
from IPython.display import HTML
from markupsafe import Markup

from artifact.studies.verdicts import printed_digits

CLEARLY_PP = 10.0
"""Difference in percentage points that counts as "well below" or "large"; the paper gives no number."""

SIMILAR_PP = 5.0
"""Difference in R@1 in percentage points up to which two methods count as similar."""

PAGES = {
    **{f"fig{number:02}": f"Fig. {number}" for number in (2, 5, 6, 7, 8, 9, 10)},
    "tab03": "Table III",
    "tab04": "Table IV",
    "tab05": "Table V",
}
"""Notebooks that show a finding, with their printed titles."""

_SHORT = 24  # characters that a table cell keeps on one line
_TALL = 30  # rows from which on a table scrolls in a box of its own
_VERDICTS = {True: "agrees", False: "does not agree", None: "cannot tell"}
_VERDICT_STYLES = {"equal": "agrees", "agrees": "agrees", "does not agree": "disagrees", "differs": "disagrees"}


def markup(template: str, *values: Any, **named: Any) -> HTML:
    """Fill a template of HTML; every value is escaped, but for those that are HTML already.

    Examples
    --------
    >>> markup("<b>{}</b>: {}", "a < b", markup("<i>fine</i>")).data
    '<b>a &lt; b</b>: <i>fine</i>'
    """
    safe = [Markup(value.data) if isinstance(value, HTML) else value for value in values]
    return HTML(str(Markup(template).format(*safe, **named)))


def join(parts: Iterable[HTML]) -> HTML:
    """Put pieces of HTML one after another."""
    return HTML("".join(part.data for part in parts))


# -- claims -------------------------------------------------------------------------------------------------


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


_P = ParamSpec("_P")


def claim(
    page: str, text: str, *, paper: str, rule: str
) -> Callable[[Callable[_P, tuple[str, bool | None]]], Callable[_P, Finding]]:
    """Make a :class:`Finding` of a function that returns what a run measured and whether that agrees with a claim.

    ``R@K`` and ``DAR@K`` in claim and rule become those of the function's parameter ``k``.
    """

    def decorate(measure: Callable[_P, tuple[str, bool | None]]) -> Callable[_P, Finding]:
        signature = inspect.signature(measure)

        @functools.wraps(measure)
        def finding(*args: _P.args, **options: _P.kwargs) -> Finding:
            bound = signature.bind(*args, **options)
            bound.apply_defaults()
            at = f"R@{bound.arguments.get('k', 1)}"
            return Finding(page, text.replace("R@K", at), paper, rule.replace("R@K", at), *measure(*args, **options))

        return finding

    return decorate


def findings(*found: Finding) -> HTML:
    """Show claims of the paper, what this run measured, and whether they agree."""
    line = '<div class="line"><span class="tag">{}</span><span>{}</span></div>'
    return join(
        markup(
            f'<div class="claim">{4 * line}</div>',
            *("Claim", one.claim, "Paper", one.paper, "Agrees if", one.rule),
            *("This run", markup("{} {}", one.found, verdict(_VERDICTS[one.agrees]))),
        )
        for one in found
    )


def verdict(text: str, why: str = "") -> HTML:
    """Show a verdict in its colour, with the reason for it on hover."""
    reason = markup(' title="{}"', why) if why else ""
    return markup('<span class="verdict {}"{}>{}</span>', _VERDICT_STYLES.get(text, "open"), reason, text)


def findings_table(found: Sequence[Finding]) -> HTML:
    """Show all findings as one table with links to their pages."""
    rows = [
        {
            "Claim": one.claim,
            "The paper": one.paper,
            "This run": one.found,
            "Verdict": verdict(_VERDICTS[one.agrees]),
            "Page": markup('<a href="{}.html">{}</a>', one.page, PAGES[one.page]),
        }
        for one in found
    ]
    return table(rows, classes="findings")


# -- numbers ------------------------------------------------------------------------------------------------


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
        digits = printed_digits(value)
    return f"{value:.{digits}f}"


def whole(value: float) -> str:
    """Print a number without decimals."""
    return number(value, digits=0)


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


def interval(low: float, high: float) -> str:
    """Print an interval in percent."""
    return f"[{number(low, digits=1)}, {number(high, digits=1)}]"


def listed(names: Sequence[str], before: str = "") -> str:
    """Return names in brackets after a space, or nothing if there are none.

    Examples
    --------
    >>> listed(["HOG", "SALAD"], "not "), listed([])
    (' (not HOG, SALAD)', '')
    """
    return f" ({before}{', '.join(names)})" if names else ""


def or_dash(text: str) -> str:
    """Print a dash for an empty text."""
    return text or "–"


# -- tables -------------------------------------------------------------------------------------------------

Columns = Mapping[str, str | tuple[str, Callable[[Any], str]]]
"""Headings of a shown table: each with the column of the frame, and how to print its values if not as they are."""


def shown(frame: pd.DataFrame, columns: Columns) -> pd.DataFrame:
    """Return a frame's columns as they are printed, under their headings; a column that it lacks is left out."""
    pairs = {heading: (source, str) if isinstance(source, str) else source for heading, source in columns.items()}
    return pd.DataFrame({h: frame[name].map(print_) for h, (name, print_) in pairs.items() if name in frame})


def table(
    rows: pd.DataFrame | Sequence[Mapping[str, Any]],
    *,
    text: int | None = None,
    numeric: Iterable[str] = (),
    caption: str = "",
    classes: str = "",
) -> HTML:
    """Show rows as a plain table.

    Parameters
    ----------
    rows
        A frame, or one mapping by heading for each row.
    text
        How many of the first columns hold text, if all others hold numbers, which are set flush right.
    numeric
        Else the columns of numbers by heading.
    caption
        Printed above.
    classes
        Further CSS classes.
    """
    frame = pd.DataFrame(rows)
    right = set(numeric if text is None else frame.columns[text:])
    styles = ["right" if column in right else _text_style(frame[column]) for column in frame.columns]
    head = join(markup('<th class="{}">{}</th>', *pair) for pair in zip(styles, frame.columns, strict=True))
    body = join(
        markup("<tr>{}</tr>", join(markup('<td class="{}">{}</td>', *p) for p in zip(styles, row, strict=True)))
        for row in frame.itertuples(index=False)
    )
    return markup(
        '<div class="scroll{}"><table class="results {}">{}<thead><tr>{}</tr></thead><tbody>{}</tbody></table></div>',
        " tall" if len(frame) > _TALL else "",
        classes,
        markup("<caption>{}</caption>", caption) if caption else "",
        head,
        body,
    )


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
    named = {levels[1]: "second", levels[-1]: "worst", levels[0]: "best"}
    return [named.get(value, "") for value in values]


# -- lines of text ------------------------------------------------------------------------------------------


def label(text: str) -> HTML:
    """Show the line that says what the numbers are from."""
    return markup('<p class="origin">{}</p>', text)


def download(frame: pd.DataFrame, name: str) -> HTML:
    """Offer a frame as a CSV file that is embedded in the page."""
    return markup(
        '<p class="download"><a download="{name}.csv" href="data:text/csv;base64,{data}">Download the data behind '
        "this page</a> ({name}.csv, {rows} rows)</p>",
        name=name,
        data=base64.b64encode(frame.to_csv(index=False).encode()).decode(),
        rows=len(frame),
    )
