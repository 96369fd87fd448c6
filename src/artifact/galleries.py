"""Pictures of places: contact sheets of traversals, and strips that show which image a query retrieves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from IPython.display import HTML
from matplotlib.figure import Figure

from artifact.datasets import Dataset, Traversal
from artifact.figures import embed
from artifact.images import read_image
from artifact.pipeline import Measured
from artifact.plotting import QUERY_COLOUR, RIGHT_COLOUR, WRONG_COLOUR, show_image

_WIDTH = 320  # pixels of a picture in a sheet


def contact_sheet(dataset: Dataset, n: int = 5, names: Sequence[str] | None = None) -> HTML:
    """Show the same places in every traversal: a row per traversal, a column per place.

    Parameters
    ----------
    dataset
        With the traversals to show loaded.
    n
        Places, evenly spaced along the query traversal.
    names
        Traversals; default all that are loaded and have images, the query first.
    """
    rows = [t for name, t in dataset.traversals.items() if (names is None or name in names) and t.has_images]
    if not rows:
        return HTML(f"<p>The images of {dataset.title} are not on this machine.</p>")
    places = np.linspace(0, len(dataset.query) - 1, n + 2).round().astype(int)[1:-1]
    figure = Figure(figsize=(2.15 * n, 1.72 * len(rows)))
    axes = figure.subplots(len(rows), n, squeeze=False)
    for row, traversal in zip(axes, rows, strict=True):
        for panel, place in zip(row, places, strict=True):
            index = nearest(traversal, dataset.query.positions[place])
            show_image(panel, picture(traversal, index))
        row[0].set_ylabel(
            f"{traversal.name}\n{traversal.condition}" if traversal.name != traversal.condition else traversal.name,
            fontsize=8,
        )
    figure.subplots_adjust(left=0.05, right=1, top=1, bottom=0, wspace=0.02, hspace=0.03)
    return embed(
        figure,
        f"{n} places of {dataset.title} in the traversals {', '.join(t.name for t in rows)}",
        form="jpeg",
    )


def nearest(traversal: Traversal, position: np.ndarray) -> int:
    """Return the index of the image nearest to a position."""
    return int(np.linalg.norm(traversal.positions - position, axis=1).argmin())


def picture(traversal: Traversal, index: int) -> np.ndarray:
    """Return one image as ``(h, w, 3)`` uint8, at most 320 pixels wide."""
    image = read_image(traversal.folder / traversal.image_names[index])
    image.thumbnail((_WIDTH, _WIDTH))
    return np.asarray(image)


def retrieval_strips(measured: Measured, n: int = 4) -> HTML:
    """Show queries that lose their place to a distractor: query, best positive, and what is retrieved instead.

    The queries shown are spread evenly over all that are hits at 1 without distractors and misses with them.
    The evaluation must hold retrieval lists of the query pool.
    """
    result, dataset = measured.evaluation, measured.dataset
    if not (dataset.query.has_images and dataset.database.has_images):
        return HTML(f"<p>The images of {dataset.title} are not on this machine.</p>")
    lost = np.flatnonzero(result.hits(1, distractors=False) & ~result.hits(1, distractors=True))
    if not len(lost):
        return HTML("<p>No query of this evaluation loses its place to a distractor.</p>")
    chosen = lost[np.linspace(0, len(lost) - 1, min(n, len(lost))).round().astype(int)]
    alone, _ = result.retrieved(1, distractors=False)
    augmented, _ = result.retrieved(1, distractors=True)
    figure = Figure(figsize=(6.6, 1.62 * len(chosen) + 0.3))
    axes = figure.subplots(len(chosen), 3, squeeze=False)
    for row, query in zip(axes, chosen, strict=True):
        distractor = int(augmented[query, 0]) - result.ranking.n_database
        away = np.linalg.norm(result.query_positions[query] - result.pool_positions[result.pool_name][distractor])
        shown = [
            (dataset.query, int(result.evaluated[query]), QUERY_COLOUR),
            (dataset.database, int(alone[query, 0]), RIGHT_COLOUR),
            (dataset.query, int(result.evaluated[distractor]), WRONG_COLOUR),
        ]
        for panel, (traversal, index, colour) in zip(row, shown, strict=True):
            show_image(panel, picture(traversal, index), colour)
        unit = {"metres": "m", "frames": "frames", "pairs": "pairs"}[dataset.unit]
        row[2].set_xlabel(f"{away:.0f} {unit} away", fontsize=8, labelpad=2)
    for panel, title in zip(axes[0], ("Query", "Top 1 of the database", "Top 1 with distractors"), strict=True):
        panel.set_title(title, fontsize=9, pad=4)
    figure.subplots_adjust(
        left=0, right=1, top=1 - 0.25 / figure.get_figheight(), bottom=0.06, wspace=0.03, hspace=0.16
    )
    text = f"{len(chosen)} queries of {dataset.title} that retrieve the right place until distractors are added"
    return embed(figure, text, form="jpeg", width=680)
