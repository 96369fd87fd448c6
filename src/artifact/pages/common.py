"""The parts that all pages share: claims with verdicts, plain tables, numbers, downloads.

Text that comes from a manifest, a folder or a run is escaped in one place, :func:`markup`.
"""

from __future__ import annotations

import base64
import csv
import functools
import gzip
import inspect
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any, ParamSpec

import pandas as pd
from IPython.display import HTML
from markupsafe import Markup

from artifact.studies.judging import Judged, Verdict, printed_digits

CLEARLY_PP = 10.0
"""Difference in percentage points that counts as "well below" or "large"; the paper gives no number."""

SIMILAR_PP = 5.0
"""Difference in R@1 in percentage points up to which two methods count as similar."""

NO_LOSS_PP = 1.1
"""Largest fall of R@1 that the paper still calls preserved (§V-D), in percentage points."""

PAGES = {
    **{f"fig{number:02}": f"Fig. {number}" for number in (2, 3)},
    "tab03": "Table III",
    **{f"fig{number:02}": f"Fig. {number}" for number in (5, 6, 7, 8, 9)},
    "tab04": "Table IV",
    "tab05": "Table V",
    "fig10": "Fig. 10",
}
"""Notebooks that show a finding, with their printed titles, in the order of the paper."""

Titles = Mapping[str, str]
"""Printed title of each method shown, by its name."""

Answer = tuple[str, Judged]
"""What a run measured, in words, and whether that agrees with a claim and why."""

NOTHING_TO_COMPARE = Judged("cannot tell", "there is nothing to compare")

_SHORT = 24  # characters that a table cell keeps on one line
_TALL = 30  # rows from which on a table scrolls in a box of its own
_NOTHING = ("", "–")
_MANY = 20  # rows from which on a table sorts and filters
_FEW_COLUMNS, _MANY_COLUMNS = 3, 11  # with more, rows become cards on a phone; with many more, they are set smaller
_VERDICT_STYLES = {"equal": "agrees", "agrees": "agrees", "differs": "disagrees"}


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
    """A claim of the paper and its evidence there, each in one line, and the :data:`Answer` of a run.

    The ``rule`` by which the two agree is ours, since the paper states its claims in words; ``page`` is the notebook.
    """

    page: str
    claim: str
    paper: str
    rule: str
    found: str
    verdict: Verdict
    why: str


_P = ParamSpec("_P")


def claim(page: str, text: str, *, paper: str, rule: str) -> Callable[[Callable[_P, Answer]], Callable[_P, Finding]]:
    """Make a :class:`Finding` of a function that returns an :data:`Answer`.

    ``R@K`` and ``DAR@K`` in claim and rule become those of the function's parameter ``k``, by default 1.
    """

    def decorate(measure: Callable[_P, Answer]) -> Callable[_P, Finding]:
        @functools.wraps(measure)
        def finding(*args: _P.args, **options: _P.kwargs) -> Finding:
            at = f"R@{inspect.signature(measure).bind(*args, **options).arguments.get('k', 1)}"
            found, judged = measure(*args, **options)
            return Finding(page, text.replace("R@K", at), paper, rule.replace("R@K", at), found, *judged)

        return finding

    return decorate


def claimed(measure: Callable[_P, Answer]) -> Callable[_P, Finding]:
    """Make a :func:`claim` of a function that answers the one of its name in ``claims.csv``."""
    with (files("artifact.pages") / "claims.csv").open(encoding="utf-8", newline="") as stream:
        row = {row["name"]: row for row in csv.DictReader(stream)}[measure.__name__]
    text, rule = (
        row[part].format(clearly=CLEARLY_PP, similar=SIMILAR_PP, no_loss=NO_LOSS_PP) for part in ("claim", "rule")
    )
    return claim(row["page"], text, paper=row["paper"], rule=rule)(measure)


def findings(*found: Finding) -> HTML:
    """Show claims of the paper, what this run measured, and whether they agree."""
    line = '<div class="line"><b class="tag">{}</b> <span>{}</span></div>'
    return join(
        markup(
            f'<div class="claim">{5 * line}</div>',
            *("Claim", one.claim, "Paper", typeset(one.paper), "Agrees if", typeset(one.rule)),
            *("This run", markup("{} {}", typeset(one.found), verdict(one.verdict)), "Why", typeset(one.why)),
        )
        for one in found
    )


def verdict(text: str, why: str = "") -> HTML:
    """Show a verdict in its colour, with the reason for it on hover."""
    reason = markup(' title="{}"', why) if why else ""
    return markup('<span class="verdict {}"{}>{}</span>', _VERDICT_STYLES.get(text, "open"), reason, text)


def findings_table(found: Sequence[Finding]) -> HTML:
    """Show all findings as one table with links to their pages."""
    rows = []
    for one in found:
        row = {"Claim": one.claim, "The paper": typeset(one.paper), "This run": typeset(one.found)}
        link = markup('<a href="{}.html">{}</a>', one.page, PAGES[one.page])
        rows.append(row | {"Verdict": verdict(one.verdict), "Why": typeset(one.why), "Page": link})
    return table(rows, classes="findings")


def tally(found: Sequence[Finding]) -> str:
    """Count the verdicts on claims, in words.

    Examples
    --------
    >>> tally([])
    'Of 0 claims 0 agree, 0 differ, 0 cannot be told.'
    """
    n = Counter(one.verdict for one in found)
    return f"Of {len(found)} claims {n['agrees']} agree, {n['differs']} differ, {n['cannot tell']} cannot be told."


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
    return minus(f"{value:.{printed_digits(value) if digits is None else digits}f}")


def whole(value: float) -> str:
    """Print a number without decimals.

    Examples
    --------
    >>> whole(36_000_000), whole(float("nan"))
    ('36,000,000', '–')
    """
    return "–" if pd.isna(value) else minus(f"{value:,.0f}")


def two_decimals(value: float) -> str:
    """Print a number with two decimals."""
    return number(value, digits=2)


def change(value: float, *, digits: int = 1) -> str:
    """Print a difference in percentage points with its sign.

    Examples
    --------
    >>> change(1.24), change(-0.04), change(float("nan"))
    ('+1.2', '0.0', '–')
    >>> change(-2)
    '−2.0'
    """
    if pd.isna(value):
        return "–"
    rounded = round(value, digits)
    return minus(f"{rounded:+.{digits}f}") if rounded else f"{0:.{digits}f}"


def minus(text: str) -> str:
    """Print negative numbers of a text with the sign minus in place of the hyphen.

    Examples
    --------
    >>> minus("-1.5 pp (p = 2e-05) since 2015-10-29, interval [-2, -1]")
    '−1.5 pp (p = 2e-05) since 2015-10-29, interval [−2, −1]'
    """
    return re.sub(r"(?<![\w−-])-(?=\.?\d)", "−", text)


def typeset(text: str) -> str:
    r"""Print a sentence: minus signs, and no line break between a number and its unit.

    Examples
    --------
    >>> typeset("falls from 62.5 % by -1.5 pp")
    'falls from 62.5\xa0% by −1.5\xa0pp'
    """
    return re.sub(r"(?<=\d) (?=%|pp\b|m\b)", "\u00a0", minus(text))


def in_unit(distance: float, unit: str) -> str:
    """Print a distance in the unit of a dataset's threshold: metres, frames or pairs."""
    return f"{distance:.0f} {'m' if unit == 'metres' else unit}"


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
    """Show rows, a frame or one mapping by heading each, as a plain table; columns that hold nothing are left out.

    Parameters
    ----------
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
    frame = frame[[column for column in frame if not frame[column].isin(_NOTHING).all()]] if len(frame) else frame
    right = set(numeric if text is None else frame.columns[text:])
    short = {column for column in frame if frame[column].astype(str).str.len().max() <= _SHORT}
    styles = ["right" if column in right else "short" if column in short else "" for column in frame.columns]
    head = join(markup('<th class="{}">{}</th>', *pair) for pair in zip(styles, frame.columns, strict=True))
    cell = '<td class="{}" data-label="{}">{}</td>'
    body = join(
        markup("<tr>{}</tr>", join(markup(cell, *part) for part in zip(styles, frame.columns, row, strict=True)))
        for row in frame.itertuples(index=False)
    )
    wide = "" if (n := len(frame.columns)) <= _FEW_COLUMNS else " cards dense" if n > _MANY_COLUMNS else " cards"
    tools = f"{' many' if len(frame) > _MANY else ''}{wide}"
    return markup(
        '<div class="scroll{}" tabindex="0"><table class="results{} {}">{}<thead><tr>{}</tr></thead><tbody>{}</tbody></table></div>',
        " tall" if len(frame) > _TALL else "",
        *(tools, classes),
        markup("<caption>{}</caption>", caption) if caption else "",
        head,
        body,
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
    named = {levels[1]: "second", levels[-1]: "worst", levels[0]: "best"}
    return [named.get(value, "") for value in values]


# -- lines of text ------------------------------------------------------------------------------------------


def label(text: str) -> HTML:
    """Show the line that says what the numbers are from."""
    return markup('<p class="origin">{}</p>', text)


def paragraph(text: str) -> HTML:
    """Show a sentence that holds names and titles, which may hold anything."""
    return markup("<p>{}</p>", text)


def plain(text: str) -> str:
    r"""Return text that Markdown shows as it is.

    Examples
    --------
    >>> print(plain("<b> *my* town_2"))
    \<b\> \*my\* town\_2
    """
    return re.sub(r"([\\`*_{}\[\]()<>#+\-!|$&~^:=@])", r"\\\1", text)


def download(
    frame: pd.DataFrame, name: str, what: str = "the data behind this page", *, compressed: bool = False
) -> HTML:
    """Offer a frame as a CSV file that is embedded in the page, ``compressed`` by gzip where it has many rows."""
    content, file, kind = frame.to_csv(index=False).encode(), f"{name}.csv", "text/csv"
    if compressed:
        content, file, kind = gzip.compress(content, mtime=0), f"{file}.gz", "application/gzip"
    return markup(
        '<p class="download"><a download="{file}" href="data:{kind};base64,{data}">Download {what}</a> '
        "({file}, {rows} rows)</p>",
        what=what,
        file=file,
        kind=kind,
        data=base64.b64encode(content).decode(),
        rows=len(frame),
    )
