"""A dataset at a glance: its traversals, where their images are, and how many positives a query has."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from IPython.display import HTML

from artifact.datasets import Dataset
from artifact.datasets.positives import positives_of
from artifact.pages.common import join, markup, number, or_dash, paragraph, shown, table, two_decimals
from artifact.pages.style import DATABASE_COLOUR, QUERY_COLOUR, drawing, embed, in_the_plane
from artifact.studies.preview import in_words

_MANY = 1500  # points from which on a plot is stored as an image: as drawings they would make a page slow


def traversals_table(frame: pd.DataFrame, unit: str) -> HTML:
    """Show the traversals of a dataset; ``unit`` is that of their spacing."""
    columns = {"Traversal": "traversal", "Condition": "condition", "Use": "use", "Images": "images"}
    columns[f"Spacing ({unit})"] = ("spacing", number)
    caption = "Spacing: median between neighbours."
    if frame["size"].notna().any():
        columns |= {"Size": ("size", or_dash), "Other sizes": "other_sizes", "Modes": ("modes", or_dash)}
        columns["Brightness"] = ("brightness", two_decimals)
        caption += " Size, modes and brightness (0 to 1): of at most 25 images of each."
    return table(shown(frame, columns), text=3, caption=caption)


def facts(found: Mapping[str, Any], remarks: Sequence[str] = ()) -> HTML:
    """Say how many queries can be evaluated and how many positives they have, and what may be wrong with the dataset."""
    warnings = [markup("<p><b>Warning:</b> {}.</p>", remark) for remark in remarks]
    return join([paragraph(f"{in_words(dict(found))}."), *warnings])


def positions_figure(dataset: Dataset) -> HTML:
    """Draw where query and database images are, and how many positives each query has.

    Positions in metres are drawn as a map; frames and pairs as a line each, query above database.
    """
    figure, (where, positives) = drawing((8.0, 3.2), columns=2)
    origin = dataset.database.positions.mean(axis=0)
    for part, colour, height in ((dataset.database, DATABASE_COLOUR, 0.0), (dataset.query, QUERY_COLOUR, 1.0)):
        x, y = in_the_plane(part.positions, origin).T
        y = y + height if part.positions.shape[1] == 1 else y
        many = len(part) > _MANY
        where.plot(x, y, ".", color=colour, markersize=2.5, label=f"{part.name} ({len(part)})", rasterized=many)
    if dataset.query.positions.shape[1] > 1:
        where.set_aspect("equal", adjustable="datalim")
        where.set(xlabel="x (m)", ylabel="y (m)")
    else:
        where.set(xlabel=f"index ({dataset.unit})", yticks=[], ylim=(-1, 2))
    where.legend(loc="best", fontsize=8)
    counts = np.diff(positives_of(dataset.query.positions, dataset.database.positions, dataset.threshold)[0])
    positives.plot(counts, color=QUERY_COLOUR, linewidth=0.9, rasterized=len(counts) > _MANY)
    positives.set(xlabel="query", ylabel="positives", ylim=(0, None))
    positives.grid(visible=True)
    figure.tight_layout(w_pad=1.4)
    return embed(figure, f"Positions of {dataset.title}, and the number of positives of each query")
