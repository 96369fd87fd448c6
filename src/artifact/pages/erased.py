"""Beyond the paper: what suppression erases."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from IPython.display import HTML

from artifact.pages.common import number, table
from artifact.pages.style import drawing, embed, legend_below, percent_axis, tell_values
from artifact.studies.common import PERCENT
from artifact.studies.erased import KINDS, Erased

_KINDS = dict(zip(KINDS, (("#2e8b57", "-"), ("#0000ff", "--"), ("#ffa500", "-.")), strict=True))


def erased_table(erased: Erased) -> HTML:
    """Show R@1 and DAR@1 of the original and the suppressed descriptors, and what happens to queries taken."""
    rows = []
    for view, result in erased.evaluations.items():
        taken, recovered = map(len, erased.lost_and_recovered(view))
        shares = {"R": result.recall(1), "DAR": result.dar(1), "RSR": result.rsr(1)}
        row = {"Descriptors": view} | {f"{name}@1 %": number(PERCENT * share) for name, share in shares.items()}
        rows.append(row | {"given back": f"{recovered} of {taken}" if view != "original" else "–"})
    fit, n = erased.split, erased.evaluations["original"].n_queries
    fitted = f"fitted on {len(fit.fit_queries)} queries and {len(fit.fit_database)} database images"
    return table(rows, text=1, caption=f"{n} queries evaluated; {fitted}.")


def erased_similarities(erased: Erased) -> str:
    """Say in words how far a distractor's similarity lies above a positive's, before and after."""
    positive, distractor, _ = KINDS
    parts = []
    for view, found in erased.similarities.items():
        spread = np.sqrt((found[positive].var() + found[distractor].var()) / 2)
        gap = (found[positive].mean() - found[distractor].mean()) / spread
        parts.append(f"{view} {gap:+.2f}")
    return (
        "Mean similarity of positives minus that of distractors, in units of their pooled standard deviation: "
        f"{', '.join(parts)}. The larger, the easier it is for a positive to win."
    )


def iterations(table: pd.DataFrame) -> HTML:
    """R@1 and DAR@1 after each INLP iteration, and how well the next classifier still tells the conditions."""
    figure, axes = drawing((7.2, 3.1))
    curves = {
        "R": ("R@1", "#2e8b57", "o"),
        "DAR": ("DAR@1", "#1f77b4", "s"),
        "accuracy": ("classifier, training accuracy", "0.55", "^"),
    }
    for column, (label, colour, marker) in curves.items():
        axes.plot(table["iteration"], table[column], color=colour, marker=marker, markersize=3.5, label=label)
        texts = [f"{label} {v:.2f} % after {i}" for i, v in zip(table["iteration"], table[column], strict=True)]
        tell_values(axes, table[["iteration", column]], texts, size=25)
    axes.axhline(50, linestyle=":", color="0.55", linewidth=0.9)
    axes.set_xlabel("INLP iterations")
    percent_axis(axes, "percent")
    legend_below(figure)
    return embed(figure, "R@1, DAR@1 and training accuracy after each INLP iteration")


def similarities(found: Mapping[str, Mapping[str, np.ndarray]], views: Sequence[str]) -> HTML:
    """Distributions of the cosine for the three kinds of pairs, one panel per view."""
    figure, (panels,) = drawing((3.1 * len(views) + 0.4, 2.9), columns=len(views), squeeze=False)
    for axes, view in zip(panels, views, strict=True):
        pooled = np.concatenate(list(found[view].values()))
        edges = np.linspace(*np.quantile(pooled, [0.001, 0.999]), 60)
        centres = (edges[1:] + edges[:-1]) / 2
        for kind, values in found[view].items():
            height = np.histogram(values, edges)[0] / max(1, len(values))
            colour, line = _KINDS[kind]
            axes.fill_between(centres, height, color=colour, alpha=0.25, linewidth=0)
            axes.plot(centres, height, color=colour, linestyle=line, linewidth=1.2, label=kind)
            axes.axvline(np.median(values), color=colour, linewidth=0.9, linestyle=":")
        axes.set(title=view, yticks=[], ylim=(0, None), xlabel="cosine similarity")
    panels[0].set_ylabel("share of pairs")
    legend_below(figure)
    return embed(figure, f"Distributions of the cosine for {len(KINDS)} kinds of pairs: {', '.join(views)}")
