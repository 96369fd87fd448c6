"""Pictures of places: contact sheets of traversals, and strips that show which image a query retrieves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from IPython.display import HTML
from matplotlib.figure import Figure
from matplotlib.text import Annotation

from artifact.datasets import Dataset, Traversal
from artifact.datasets.images import read_image
from artifact.metrics.evaluation import Evaluation
from artifact.pages.style import QUERY_COLOUR, RIGHT_COLOUR, WRONG_COLOUR, embed, show_image
from artifact.studies.erased import Erased
from artifact.studies.evaluated import Measured

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


def distractor_story(measured: Measured) -> HTML:
    """Fig. 1: one query, the image of its place, and the distractor that outranks it, with their similarities.

    The query shown is a typical one: of all that distractors take, the one with the median margin. The evaluation must
    hold retrieval lists of the query pool.
    """
    result, dataset = measured.evaluation, measured.dataset
    missing = _missing(dataset)
    if missing:
        return missing
    lost = _lost(result)
    if not len(lost):
        return HTML("<p>No query of this evaluation loses its place to a distractor.</p>")
    top, cosine = result.retrieved(1, distractors=True)
    place, alone = result.retrieved(1, distractors=False)
    margins = cosine[lost, 0] - alone[lost, 0]
    query = lost[np.argsort(margins, kind="stable")[len(lost) // 2]]
    distractor = int(top[query, 0]) - result.ranking.n_database
    away = _away(dataset, result, query, distractor)
    figure = Figure(figsize=(7.4, 4.3))
    boxes = [(0.02, 0.24, 0.36, 0.5), (0.62, 0.53, 0.36, 0.42), (0.62, 0.03, 0.36, 0.42)]
    conditions = dataset.query.condition, dataset.database.condition
    shown = [
        (dataset.query, int(result.evaluated[query]), QUERY_COLOUR, f"query ({conditions[0]})"),
        (dataset.database, int(place[query, 0]), RIGHT_COLOUR, f"the same place ({conditions[1]})"),
        (
            dataset.query,
            int(result.evaluated[distractor]),
            WRONG_COLOUR,
            f"a distractor: {away} away ({conditions[0]})",
        ),
    ]
    for box, (traversal, index, colour, title) in zip(boxes, shown, strict=True):
        axes = figure.add_axes(box)
        show_image(axes, picture(traversal, index), colour)
        axes.set_title(title, fontsize=9.5, pad=4)
    for y, value, colour in ((0.68, alone[query, 0], RIGHT_COLOUR), (0.3, cosine[query, 0], WRONG_COLOUR)):
        arrow = {"arrowstyle": "-|>", "color": colour, "linewidth": 2 + 2 * (colour == WRONG_COLOUR)}
        figure.add_artist(
            Annotation("", (0.61, y), (0.39, 0.49), xycoords="figure fraction", arrowprops=arrow, annotation_clip=False)
        )
        figure.text(
            0.5, 0.49 + 0.62 * (y - 0.49) + (0.07 if y > 0.49 else -0.07), f"cosine {value:.3f}", ha="center",
            va="center", fontsize=10, color=colour, weight="bold",
        )  # fmt: skip
    text = (
        f"A query of {dataset.title}; the image of its place has cosine {alone[query, 0]:.3f}, a distractor {away} "
        f"away has {cosine[query, 0]:.3f}"
    )
    return embed(figure, text, form="jpeg", width=760)


def recovered_strips(erased: Erased, view: str, n: int = 4) -> HTML:
    """Show queries that a distractor takes from the original descriptors and that suppression gives back.

    Parameters
    ----------
    erased
        From :func:`artifact.studies.erased.what_is_erased`.
    view
        ``"LEACE"`` or ``"INLP"``.
    n
        Most queries shown, spread evenly over all.
    """
    dataset = erased.described.dataset
    missing = _missing(dataset)
    if missing:
        return missing
    _, recovered = erased.lost_and_recovered(view)
    if not len(recovered):
        return HTML(f"<p>{view} gives no query back.</p>")
    chosen = recovered[np.linspace(0, len(recovered) - 1, min(n, len(recovered))).round().astype(int)]
    before, after = erased.evaluations["original"], erased.evaluations[view]
    winner, winner_after = (one.retrieved(1, distractors=True)[0][:, 0] for one in (before, after))
    queries = erased.split.evaluation_queries[before.evaluated]
    figure = Figure(figsize=(6.6, 1.62 * len(chosen) + 0.3))
    axes = figure.subplots(len(chosen), 3, squeeze=False)
    for row, query in zip(axes, chosen, strict=True):
        distractor = int(winner[query]) - before.ranking.n_database
        database_image = int(erased.split.evaluation_database[winner_after[query]])
        shown = [
            (dataset.query, int(queries[query]), QUERY_COLOUR),
            (dataset.query, int(queries[distractor]), WRONG_COLOUR),
            (dataset.database, database_image, RIGHT_COLOUR),
        ]
        for panel, (traversal, index, colour) in zip(row, shown, strict=True):
            show_image(panel, picture(traversal, index), colour)
        row[1].set_xlabel(f"{_away(dataset, before, query, distractor)} away", fontsize=8, labelpad=2)
    for panel, title in zip(axes[0], ("Query", "Top 1, original", f"Top 1, {view}"), strict=True):
        panel.set_title(title, fontsize=9, pad=4)
    _tighten(figure)
    return embed(figure, f"{len(chosen)} queries of {dataset.title} that {view} recovers", form="jpeg", width=680)


def retrieval_strips(measured: Measured, n: int = 4) -> HTML:
    """Show queries that lose their place to a distractor: query, best positive, and what is retrieved instead.

    The queries shown are spread evenly over all that are hits at 1 without distractors and misses with them.
    The evaluation must hold retrieval lists of the query pool.
    """
    result, dataset = measured.evaluation, measured.dataset
    missing = _missing(dataset)
    if missing:
        return missing
    lost = _lost(result)
    if not len(lost):
        return HTML("<p>No query of this evaluation loses its place to a distractor.</p>")
    chosen = lost[np.linspace(0, len(lost) - 1, min(n, len(lost))).round().astype(int)]
    alone, _ = result.retrieved(1, distractors=False)
    augmented, _ = result.retrieved(1, distractors=True)
    figure = Figure(figsize=(6.6, 1.62 * len(chosen) + 0.3))
    axes = figure.subplots(len(chosen), 3, squeeze=False)
    for row, query in zip(axes, chosen, strict=True):
        distractor = int(augmented[query, 0]) - result.ranking.n_database
        shown = [
            (dataset.query, int(result.evaluated[query]), QUERY_COLOUR),
            (dataset.database, int(alone[query, 0]), RIGHT_COLOUR),
            (dataset.query, int(result.evaluated[distractor]), WRONG_COLOUR),
        ]
        for panel, (traversal, index, colour) in zip(row, shown, strict=True):
            show_image(panel, picture(traversal, index), colour)
        row[2].set_xlabel(f"{_away(dataset, result, query, distractor)} away", fontsize=8, labelpad=2)
    for panel, title in zip(axes[0], ("Query", "Top 1 of the database", "Top 1 with distractors"), strict=True):
        panel.set_title(title, fontsize=9, pad=4)
    _tighten(figure)
    text = f"{len(chosen)} queries of {dataset.title} that retrieve the right place until distractors are added"
    return embed(figure, text, form="jpeg", width=680)


def _missing(dataset: Dataset) -> HTML | None:
    if dataset.query.has_images and dataset.database.has_images:
        return None
    return HTML(f"<p>The images of {dataset.title} are not on this machine.</p>")


def _lost(result: Evaluation) -> np.ndarray:
    """Queries that are hits at 1 without distractors and misses with them."""
    return np.flatnonzero(result.hits(1, distractors=False) & ~result.hits(1, distractors=True))


def _away(dataset: Dataset, result: Evaluation, query: int, distractor: int) -> str:
    """How far a distractor is from a query, in words."""
    away = np.linalg.norm(result.query_positions[query] - result.pool_positions[result.pool_name][distractor])
    unit = {"metres": "m", "frames": "frames", "pairs": "pairs"}[dataset.unit]
    return f"{away:.0f} {unit}"


def _tighten(figure: Figure) -> None:
    top = 1 - 0.25 / figure.get_figheight()
    figure.subplots_adjust(left=0, right=1, top=top, bottom=0.06, wspace=0.03, hspace=0.16)
