"""Fig. 3: descriptors in the plane."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from IPython.display import HTML
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from artifact.pages.style import (
    embed,
)
from artifact.studies.embedding import Embedding


def embeddings(found: Mapping[str, Embedding], conditions: Sequence[str], titles: Mapping[str, str]) -> HTML:
    """Fig. 3: UMAP before and after suppression; gray lines join geometrical mutual nearest neighbours.

    Parameters
    ----------
    found
        By method: one row of panels each.
    conditions
        Names of the query and the database condition, for the legend.
    titles
        Method name to printed title.
    """
    figure = Figure(figsize=(7.6, 3.6 * len(found)))
    axes = figure.subplots(len(found), 2, squeeze=False)
    for row, (method, one) in zip(axes, found.items(), strict=True):
        for panel, points, name in zip(row, (one.before, one.after), ("original", "suppressed with INLP"), strict=True):
            joined = np.stack([points[one.partners[:, 0]], points[one.partners[:, 1]]], axis=1)
            panel.add_collection(LineCollection(joined, colors="0.6", linewidths=0.5, alpha=0.6, zorder=1))
            panel.scatter(*points[: one.n_queries].T, s=9, color="#1f77b4", linewidths=0, zorder=2)
            panel.scatter(*points[one.n_queries :].T, s=9, color="#ff7f0e", linewidths=0, zorder=2)
            panel.set_title(f"{titles[method]}, {name}", fontsize=9.5)
            panel.set_xticks([])
            panel.set_yticks([])
            for spine in panel.spines.values():
                spine.set_visible(True)
    figure.tight_layout()
    handles = [
        Line2D([], [], linestyle="none", marker="s", color=colour, label=label)
        for colour, label in (("#1f77b4", f"query ({conditions[0]})"), ("#ff7f0e", f"database ({conditions[1]})"))
    ]
    figure.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, 0.0), ncols=2)
    return embed(figure, "UMAP of query and database descriptors before and after condition suppression")
