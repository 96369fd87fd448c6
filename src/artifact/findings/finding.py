"""A claim of the paper and what a run says about it."""

from __future__ import annotations

from dataclasses import dataclass

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
