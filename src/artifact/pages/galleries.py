"""Pictures of places: contact sheets of traversals, and strips that show which image a query retrieves."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence

import numpy as np
from IPython.display import HTML
from matplotlib.figure import Figure
from matplotlib.text import Annotation
from PIL import Image, ImageOps

from artifact.datasets import Dataset, Traversal
from artifact.datasets.images import read_image
from artifact.datasets.positives import positives_of
from artifact.metrics.evaluation import Evaluation
from artifact.pages.common import in_unit, markup, paragraph
from artifact.pages.style import QUERY_COLOUR, RIGHT_COLOUR, WRONG_COLOUR, drawing, embed, show_image
from artifact.studies.erased import Erased
from artifact.studies.evaluated import Measured

_TILE = (96, 72)  # pixels of a picture on hover; artifact.css and artifact.js have them too
_NONE_LOST = "No query of this evaluation loses its place to a distractor."

Shown = tuple[Traversal, int, str, str]
"""An image of a strip: traversal, index, colour of its frame, note under it."""


def contact_sheet(dataset: Dataset, n: int = 5) -> HTML:
    """Show the same places in every loaded traversal that has images: a row per traversal, a column per place.

    The ``n`` places are evenly spaced along the query traversal.
    """
    rows = [traversal for traversal in dataset.traversals.values() if traversal.has_images]
    if not rows:
        return _not_here(dataset)
    places = np.linspace(0, len(dataset.query) - 1, n + 2).round().astype(int)[1:-1]
    figure, axes = drawing((2.15 * n, 1.72 * len(rows)), len(rows), n, squeeze=False)
    for row, traversal in zip(axes, rows, strict=True):
        for panel, position in zip(row, dataset.query.positions[places], strict=True):
            nearest = np.linalg.norm(traversal.positions - position, axis=1).argmin()
            show_image(panel, picture(traversal, nearest))
        row[0].set_ylabel("\n".join(dict.fromkeys([traversal.name, traversal.condition])), fontsize=8)
    figure.subplots_adjust(left=0.05, right=1, top=1, bottom=0, wspace=0.02, hspace=0.03)
    text = f"{n} places of {dataset.title} in the traversals {', '.join(t.name for t in rows)}"
    return embed(figure, text, form="jpeg")


def tiles(shown: Sequence[tuple[Traversal, int]]) -> HTML:
    """Return one picture of many small ones, which figures show on hover by their number; nothing for no images."""
    if not shown:
        return HTML("")
    across = min(len(shown), 24)
    sheet = Image.new("RGB", (_TILE[0] * across, _TILE[1] * -(-len(shown) // across)))
    for number, (traversal, index) in enumerate(shown):
        image = read_image(traversal.folder / traversal.image_names[index])
        corner = _TILE[0] * (number % across), _TILE[1] * (number // across)
        sheet.paste(ImageOps.fit(image, _TILE), corner)
    text = '<div class="tiles" hidden data-across="{}" style="background-image:url(data:image/jpeg;base64,{})"></div>'
    return markup(text, across, encoded(sheet, 55))


def encoded(image: Image.Image, quality: int) -> str:
    """Return an image as JPEG in base64."""
    stream = io.BytesIO()
    image.save(stream, "jpeg", quality=quality)
    return base64.b64encode(stream.getvalue()).decode()


def picture(traversal: Traversal, index: int) -> Image.Image:
    """Return one image, at most 320 pixels wide."""
    image = read_image(traversal.folder / traversal.image_names[index])
    image.thumbnail((320, 320))
    return image


def distractor_story(measured: Measured) -> HTML:
    """Fig. 1: one query, the image of its place, and the distractor that outranks it, with what ranks them.

    The query shown is a typical one: of all that distractors take, the one with the median margin. The evaluation must
    hold retrieval lists of the query pool.
    """
    result, dataset = measured.evaluation, measured.dataset
    lost = _lost(result)
    if nothing := _nothing_to_show(dataset, lost):
        return nothing
    top, score = result.retrieved(1, distractors=True)
    place, alone = result.retrieved(1, distractors=False)
    margins = score[lost, 0] - alone[lost, 0]
    query = lost[np.argsort(margins, kind="stable")[len(lost) // 2]]
    distractor = top[query, 0] - result.n_database
    away = _away(dataset, result, query, distractor)
    by_query, by_database = dataset.query.condition, dataset.database.condition
    shown = [
        (dataset.query, result.evaluated[query], QUERY_COLOUR, f"query ({by_query})"),
        (dataset.database, place[query, 0], RIGHT_COLOUR, f"the same place ({by_database})"),
        (dataset.query, result.evaluated[distractor], WRONG_COLOUR, f"a distractor: {away} ({by_query})"),
    ]
    boxes = (0.02, 0.24, 0.36, 0.5), (0.62, 0.53, 0.36, 0.42), (0.62, 0.03, 0.36, 0.42)
    figure = Figure(figsize=(7.4, 4.3))
    for box, (traversal, index, colour, title) in zip(boxes, shown, strict=True):
        axes = figure.add_axes(box)
        show_image(axes, picture(traversal, index), colour)
        axes.set_title(title, fontsize=9.5, pad=4)
    of_place, of_distractor = (_score(measured, values[query, 0]) for values in (alone, score))
    _score_arrow(figure, 0.68, 0.6778, of_place, RIGHT_COLOUR, 2)
    _score_arrow(figure, 0.3, 0.3022, of_distractor, WRONG_COLOUR, 4)
    text = f"A query of {dataset.title}; the image of its place has {of_place}, a distractor {away} has {of_distractor}"
    return embed(figure, text, form="jpeg", width=760)


def _score(measured: Measured, value: float) -> str:
    """What an image is ranked by, in words."""
    return f"{value:.0f} matches" if measured.score == "matches" else f"cosine {value:.3f}"


def _score_arrow(figure: Figure, end: float, beside: float, score: str, colour: str, width: float) -> None:
    """Draw an arrow from the query to the height ``end``, with a score at the height ``beside``."""
    arrow = {"arrowstyle": "-|>", "color": colour, "linewidth": width}
    ends = (0.61, end), (0.39, 0.49)
    figure.add_artist(Annotation("", *ends, "figure fraction", arrowprops=arrow, annotation_clip=False))
    figure.text(0.5, beside, score, color=colour, ha="center", va="center", fontsize=10, weight="bold")


def recovered_strips(erased: Erased, view: str, n: int = 4) -> HTML:
    """Show queries that a distractor takes from the original descriptors and that ``"LEACE"`` or ``"INLP"`` gives back.

    At most ``n`` are shown, spread evenly over all.
    """
    dataset, split = erased.described.dataset, erased.split
    _, recovered = erased.lost_and_recovered(view)
    if nothing := _nothing_to_show(dataset, recovered, f"{view} gives no query back."):
        return nothing
    before, after = erased.evaluations["original"], erased.evaluations[view]
    winner, winner_after = (one.retrieved(1, distractors=True)[0][:, 0] for one in (before, after))
    queries = split.evaluation_queries[before.evaluated]
    strips: list[list[Shown]] = []
    for query in recovered[spread(len(recovered), n)]:
        distractor = winner[query] - before.n_database
        taken = dataset.query, queries[distractor], WRONG_COLOUR, _away(dataset, before, query, distractor)
        right = dataset.database, split.evaluation_database[winner_after[query]], RIGHT_COLOUR, ""
        strips.append([(dataset.query, queries[query], QUERY_COLOUR, ""), taken, right])
    text = f"{len(strips)} queries of {dataset.title} that {view} recovers"
    return _strips(strips, ("Query", "Top 1, original", f"Top 1, {view}"), text)


def retrieval_strips(measured: Measured, n: int = 4) -> HTML:
    """Show queries that lose their place to a distractor: query, best positive, and what is retrieved instead.

    The queries shown are spread evenly over all that are hits at 1 without distractors and misses with them.
    The evaluation must hold retrieval lists of the query pool.
    """
    result, dataset = measured.evaluation, measured.dataset
    lost = _lost(result)
    if nothing := _nothing_to_show(dataset, lost):
        return nothing
    alone, augmented = (result.retrieved(1, distractors=added)[0][:, 0] for added in (False, True))
    strips: list[list[Shown]] = []
    for query in lost[spread(len(lost), n)]:
        distractor = augmented[query] - result.n_database
        right = dataset.database, alone[query], RIGHT_COLOUR, ""
        taken = dataset.query, result.evaluated[distractor], WRONG_COLOUR, _away(dataset, result, query, distractor)
        strips.append([(dataset.query, result.evaluated[query], QUERY_COLOUR, ""), right, taken])
    text = f"{len(strips)} queries of {dataset.title} that retrieve the right place until distractors are added"
    return _strips(strips, ("Query", "Top 1 of the database", "Top 1 with distractors"), text)


def example_strips(dataset: Dataset, n: int = 3) -> HTML:
    """Show queries evenly spaced along the traversal, each with its nearest positive and a distractor of it.

    The distractor is the query image half a traversal on: what a pool of distractors is made of, whatever a method finds.
    """
    positions, threshold = dataset.query.positions, dataset.threshold
    starts, positives = positives_of(positions, dataset.database.positions, threshold)
    evaluated = np.flatnonzero(np.diff(starts))
    if nothing := _nothing_to_show(dataset, evaluated, "No query has a positive."):
        return nothing
    strips: list[list[Shown]] = []
    for query in evaluated[spread(len(evaluated) - 1, n)] if len(evaluated) > 1 else evaluated:
        away = np.linalg.norm(positions - positions[query], axis=1)
        far = evaluated[away[evaluated] > threshold]
        if not len(far):
            continue
        near = positives[starts[query] : starts[query + 1]]
        distances = np.linalg.norm(dataset.database.positions[near] - positions[query], axis=1)
        other = far[np.abs(far - (query + len(positions) // 2) % len(positions)).argmin()]
        beside, beyond = (f"{in_unit(one, dataset.unit)} away" for one in (distances.min(), away[other]))
        right = dataset.database, near[distances.argmin()], RIGHT_COLOUR, beside
        wrong = dataset.query, other, WRONG_COLOUR, beyond
        strips.append([(dataset.query, query, QUERY_COLOUR, ""), right, wrong])
    if not strips:
        return paragraph("No query has a distractor: all lie within the threshold of each other.")
    text = f"Examples of {dataset.title}: query, positive, distractor"
    return _strips(strips, ("Query", "Positive", "A distractor"), text)


def _strips(strips: list[list[Shown]], titles: Sequence[str], text: str) -> HTML:
    """Show rows of images with coloured frames: titles above the first row, notes under each image."""
    figure, axes = drawing((6.6, 1.62 * len(strips) + 0.3), len(strips), len(titles), squeeze=False)
    for row, strip in zip(axes, strips, strict=True):
        for panel, (traversal, index, colour, note) in zip(row, strip, strict=True):
            show_image(panel, picture(traversal, index), colour)
            panel.set_xlabel(note, fontsize=8, labelpad=2)
    for panel, title in zip(axes[0], titles, strict=True):
        panel.set_title(title, fontsize=9, pad=4)
    top = 1 - 0.25 / figure.get_figheight()
    figure.subplots_adjust(left=0, right=1, top=top, bottom=0.06, wspace=0.03, hspace=0.16)
    return embed(figure, text, form="jpeg", width=680)


def spread(n: int, most: int) -> np.ndarray:
    """Return at most so many of n indices, evenly spread."""
    return np.linspace(0, n - 1, min(most, n)).round().astype(int)


def _not_here(dataset: Dataset) -> HTML:
    return paragraph(f"The images of {dataset.title} are not on this machine.")


def _nothing_to_show(dataset: Dataset, queries: np.ndarray, none: str = _NONE_LOST) -> HTML | None:
    """Say why there is nothing to show, if so: no images, or no queries."""
    if not (dataset.query.has_images and dataset.database.has_images):
        return _not_here(dataset)
    return None if len(queries) else paragraph(none)


def _lost(result: Evaluation) -> np.ndarray:
    """Queries that are hits at 1 without distractors and misses with them."""
    return np.flatnonzero(result.hits(1, distractors=False) & ~result.hits(1, distractors=True))


def _away(dataset: Dataset, result: Evaluation, query: int, distractor: int) -> str:
    """How far a distractor is from a query, in words."""
    offset = result.query_positions[query] - result.pool_positions[result.pool_name][distractor]
    return f"{in_unit(np.linalg.norm(offset), dataset.unit)} away"
