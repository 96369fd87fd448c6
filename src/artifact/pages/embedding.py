"""Fig. 3: descriptors in the plane."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from IPython.display import HTML
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from artifact.pages.style import bare, colour_handle, embed, legend_below
from artifact.studies.embedding import Embedding

_COLOURS = ("#1f77b4", "#ff7f0e")


def embedding(found: Embedding, conditions: Sequence[str], title: str) -> HTML:
    """Fig. 3: UMAP before and after suppression; gray lines join geometrical mutual nearest neighbours.

    Parameters
    ----------
    found
        Both embeddings.
    conditions
        Names of the query and the database condition, for the legend.
    title
        Printed title of the method.
    """
    figure = Figure(figsize=(7.6, 3.6))
    before, after = figure.subplots(1, 2)
    for axes, points, name in ((before, found.before, "original"), (after, found.after, "suppressed with INLP")):
        joined = np.stack([points[found.partners[:, 0]], points[found.partners[:, 1]]], axis=1)
        axes.add_collection(LineCollection(joined, colors="0.6", linewidths=0.5, alpha=0.6, zorder=1))
        for part, colour in zip((points[: found.n_queries], points[found.n_queries :]), _COLOURS, strict=True):
            axes.scatter(*part.T, s=9, color=colour, linewidths=0, zorder=2)
        axes.set_title(f"{title}, {name}", fontsize=9.5)
        bare(axes, "black")
    figure.tight_layout()
    names = (f"query ({conditions[0]})", f"database ({conditions[1]})")
    legend_below(figure, [colour_handle(*pair) for pair in zip(_COLOURS, names, strict=True)])
    return embed(figure, "UMAP of query and database descriptors before and after condition suppression")
