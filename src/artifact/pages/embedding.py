"""Fig. 3: descriptors in the plane."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from IPython.display import HTML
from matplotlib.collections import LineCollection

from artifact.metrics.statistics import replicates
from artifact.pages.common import Answer, claimed
from artifact.pages.galleries import spread, tiles
from artifact.pages.style import bare, colour_handle, drawing, embed, legend_below, tell_values
from artifact.studies.common import PERCENT
from artifact.studies.embedding import Embedding, aligned, mixed
from artifact.studies.judging import above

_COLOURS, _MARKERS = ("#1f77b4", "#ff7f0e"), ("o", "^")
_TOLD = 300  # points that show their image on hover


def embedding(found: Embedding, conditions: Sequence[str], title: str) -> HTML:
    """Fig. 3: UMAP before and after suppression; gray lines join geometrical mutual nearest neighbours.

    For the legend: the query and the database condition, and the printed title of the method.
    """
    data = found.described.dataset
    told = spread(len(found.before), _TOLD)
    images = [(data.query if row < found.n_queries else data.database, int(found.images[row])) for row in told]
    with_images = all(part.has_images for part, _ in images)
    texts = [f"{part.condition}, image {i}{f' ⧉{n}' if with_images else ''}" for n, (part, i) in enumerate(images)]
    figure, panels = drawing((8.4, 4.0), columns=2)
    shown = {"original": found.before, "suppressed with INLP": found.after}
    for axes, (name, points) in zip(panels, shown.items(), strict=True):
        axes.add_collection(LineCollection(points[found.partners], colors="0.6", linewidths=0.5, alpha=0.6, zorder=1))
        parts = points[: found.n_queries], points[found.n_queries :]
        for part, colour, marker in zip(parts, _COLOURS, _MARKERS, strict=True):
            axes.scatter(*part.T, s=12, color=colour, marker=marker, linewidths=0, zorder=2)
        tell_values(axes, points[told], texts, size=30)
        axes.set_title(f"{title}, {name}", fontsize=9.5)
        bare(axes, "black")
    names = (f"query ({conditions[0]})", f"database ({conditions[1]})")
    legend_below(figure, [colour_handle(*key) for key in zip(_COLOURS, names, _MARKERS, strict=True)])
    text = "UMAP of query and database descriptors before and after condition suppression"
    return embed(figure, text, below=tiles(images if with_images else []))


@claimed
def suppression_mixes_conditions(one: Embedding, seed: int = 0) -> Answer:
    """INLP reduces the separation by condition (Fig. 3)."""
    return _rises(mixed(one.before, one), mixed(one.after, one), one, seed, "has the other condition")


@claimed
def suppression_aligns_places(one: Embedding, seed: int = 0) -> Answer:
    """INLP improves the alignment by place (Fig. 3)."""
    return _rises(aligned(one.before, one), aligned(one.after, one), one, seed, "among database images is of its place")


def _rises(before: np.ndarray, after: np.ndarray, one: Embedding, seed: int, what: str) -> Answer:
    """Shares of queries before and after suppression, and whether the second is larger."""
    gain, data = after.astype(float) - before, one.described.dataset
    sample = PERCENT * replicates(gain, one.positions[0], data.threshold, seed=seed, stream=data.name)[0]
    shares = f"{PERCENT * before.mean():.1f} % of {len(gain)} queries before and {PERCENT * after.mean():.1f} % after"
    return f"the nearest neighbour in the plane {what} for {shares}", above(PERCENT * gain.mean(), sample, 0)
