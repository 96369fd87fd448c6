"""Figs. 2 and 9: retrievals from a mixed database on the map."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from IPython.display import HTML
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D

from artifact.datasets import Traversal
from artifact.metrics.evaluation import Evaluation
from artifact.pages import style
from artifact.pages.common import NO_LOSS_PP, Answer, Titles, change, claimed, in_unit, number, table
from artifact.pages.galleries import spread, tiles
from artifact.pages.style import bare, colour_handle, drawing, embed, in_the_plane, legend_below, tell_values
from artifact.studies import reported
from artifact.studies.common import PERCENT
from artifact.studies.judging import all_above, some_above
from artifact.studies.mixed_database import DRAWS, MixedDatabase

_MATCHES = 500  # most that are drawn, as in the paper's Fig. 9
_TOLD = 120  # most queries of a map that show their match on hover: their images are in the page


def mixed_database(
    found: Mapping[str, MixedDatabase], panels: Mapping[str, str], conditions: Sequence[str], titles: Titles
) -> HTML:
    """Figs. 2 and 9: each query joined with its top-1 retrieval, green within the threshold, red otherwise.

    A row of panels for each method, a column for each evaluation with its title. ``conditions`` are those of the query,
    the database and the added images, for the legend.
    """
    size = 3.9 * len(panels) + 0.3, 3.7 * len(found)
    figure, axes = drawing(size, len(found), len(panels), squeeze=False)
    shares: list[str] = []
    shown: dict[tuple[str, int], tuple[int, Traversal, int]] = {}
    for row, (method, one) in zip(axes, found.items(), strict=True):
        for panel, (name, title) in zip(row, panels.items(), strict=True):
            result = one.evaluations[name]
            share = f"{PERCENT * result.recall(1):.1f} %"
            _draw_map(panel, one, result, with_added=name != "single")
            panel.set_title(f"{titles[method]}, {title}\nR@1 {share}", fontsize=9.5)
            _tell_matches(panel, one, result, shown)
            shares.append(f"{titles[method]} {title} {share}")
    query, database, added = conditions
    with_fit = any(len(one.fitted_queries) for one in found.values())
    handles = [colour_handle(style.FITTING_COLOUR, "fitting region", "D")] if with_fit else []
    handles += [
        colour_handle(style.QUERY_COLOUR, f"query ({query})", "o"),
        colour_handle(style.DATABASE_COLOUR, f"database ({database})"),
        colour_handle(style.DISTRACTOR_COLOUR, f"added to the database ({added})", "^"),
        Line2D([], [], color=style.RIGHT_COLOUR, linewidth=2.6, label="right (thick)"),
        Line2D([], [], color=style.WRONG_COLOUR, linewidth=0.9, label="wrong (thin)"),
    ]
    legend_below(figure, handles)
    text = f"Maps of top-1 retrievals; R@1: {', '.join(shares)}"
    return embed(figure, text, width=390 * len(panels), below=tiles([one[1:] for one in shown.values()]))


def _draw_map(axes: Axes, one: MixedDatabase, result: Evaluation, *, with_added: bool) -> None:
    data = one.described.dataset
    added = one.added_traversal.positions[one.added]
    places, starts = data.database.positions[one.database], result.query_positions
    ends = (np.concatenate([places, added]) if with_added else places)[result.retrieved(1, distractors=False)[0][:, 0]]
    right = np.linalg.norm(ends - starts, axis=1) <= data.threshold
    origin = places.mean(axis=0)
    shown = spread(len(starts), _MATCHES)
    begin, end = in_the_plane(starts, origin), in_the_plane(ends, origin)
    wrong_and_right = (style.WRONG_COLOUR, ~right, 0.7, 2), (style.RIGHT_COLOUR, right, 2.6, 6)
    for colour, so, width, order in wrong_and_right:
        chosen = shown[so[shown]]
        lines = np.stack([begin[chosen], end[chosen]], axis=1)
        axes.add_collection(LineCollection(lines, colors=colour, linewidths=width, alpha=0.75, zorder=order))
    axes.scatter(*in_the_plane(places, origin).T, s=14, color=style.DATABASE_COLOUR, marker="s", zorder=4, linewidths=0)
    axes.scatter(*begin.T, s=5, color=style.QUERY_COLOUR, zorder=5, linewidths=0)
    if len(one.fitted_queries):
        fitted = in_the_plane(data.query.positions[one.fitted_queries], origin)
        axes.scatter(*fitted.T, s=16, color=style.FITTING_COLOUR, marker="D", zorder=7, linewidths=0)
    if with_added and len(added):
        dots = {"color": style.DISTRACTOR_COLOUR, "marker": "^", "edgecolors": "white", "linewidths": 0.4}
        axes.scatter(*in_the_plane(added, origin).T, s=26, zorder=8, **dots)
    axes.autoscale()
    axes.set_aspect("equal", adjustable="datalim")
    bare(axes, "0.7")


def _tell_matches(
    axes: Axes, one: MixedDatabase, result: Evaluation, shown: dict[tuple[str, int], tuple[int, Traversal, int]]
) -> None:
    """Give some queries of a map their match and the two images on hover; ``shown`` gathers the images of all maps."""
    data, extra = one.described.dataset, one.added_traversal
    query, database = data.query, data.database
    chosen = spread(result.n_queries, _TOLD)
    retrieved, texts = result.retrieved(1, distractors=False)[0][chosen, 0], []
    for i, found in zip(one.queries[result.evaluated[chosen]].tolist(), retrieved.tolist(), strict=True):
        added = found - len(one.database)
        match, j = (database, int(one.database[found])) if added < 0 else (extra, int(one.added[added]))
        away = in_unit(np.linalg.norm(match.positions[j] - query.positions[i]), data.unit)
        text = f"query {i}, match {j} of {match.name}, {away} away"
        if query.has_images and match.has_images:
            pair = (query, i), (match, j)
            numbers = [shown.setdefault((part.name, k), (len(shown), part, k))[0] for part, k in pair]
            text += f" ⧉{numbers[0]} {numbers[1]}"
        texts.append(text)
    origin = database.positions[one.database].mean(axis=0)
    tell_values(axes, in_the_plane(result.query_positions[chosen], origin), texts, size=40)


def mixed_table(found: Mapping[str, MixedDatabase], panels: Mapping[str, str], titles: Titles) -> HTML:
    """Show R@1 of each of two panels, an evaluation and its heading, and the change between them."""
    rows = []
    for method, one in found.items():
        recalls = {heading: float(one.recalls(name).mean()) for name, heading in panels.items()}
        row = _before_and_after(titles[method], recalls)
        row["Spread over choices"] = _range(one.recalls(list(panels)[-1]))
        row["Queries"] = next(iter(one.evaluations.values())).n_queries
        rows.append(row | {"Database": len(one.database), "Added": len(one.added)})
    return table(rows, text=1, caption=f"Measured in this run: means over {DRAWS} choices of the added images.")


def reported_mixed_table(name: str) -> HTML:
    """Show the values that the paper prints in Fig. 2 (``"fig02"``) or Fig. 9 (``"fig09"``)."""
    frame = reported.table(name)
    (column,) = set(frame) - {"method", "recall_percent"}
    wide = frame.pivot_table(index="method", columns=column, values="recall_percent", sort=False)
    titles = reported.method_titles()
    rows = [_before_and_after(titles[method], recalls) for method, recalls in wide.to_dict("index").items()]
    return table(rows, text=1, caption="Reported by the paper for RobotCar, not from this run.")


def _before_and_after(title: str, recalls: Mapping[str, float]) -> dict[str, object]:
    """One row: the method, R@1 under two headings, and the change."""
    before, after = recalls.values()
    shown = {f"R@1 %, {heading}": number(value) for heading, value in recalls.items()}
    return {"Method": title, **shown, "Change (pp)": change(after - before)}


@claimed
def few_images_lower_recall(found: Mapping[str, MixedDatabase], titles: Titles, seed: int = 0) -> Answer:
    """A few images of the query's condition in the database lower R@1 (Fig. 2)."""
    loss, sample = _steps(found, "single", "mixed", seed)
    judged, certain = some_above(-loss, -sample, NO_LOSS_PP)
    words = _in_words(found, "single", "mixed", titles)
    return f"R@1 falls beyond chance for {certain.sum()} of {len(found)} methods; {words}", judged


@claimed
def suppression_helps_mixed_database(found: Mapping[str, MixedDatabase], titles: Titles, seed: int = 0) -> Answer:
    """INLP raises R@1 on a mixed database, with a fit on another part of the map (Fig. 9)."""
    gain, sample = _steps(found, "original", "INLP", seed)
    text = f"R@1 rises for {(gain > 0).sum()} of {len(gain)} methods; {_in_words(found, 'original', 'INLP', titles)}"
    return text, all_above(gain, sample, 0)


def _steps(found: Mapping[str, MixedDatabase], before: str, after: str, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Changes of R@1 ``(methods,)`` in pp, and their replicates."""
    values = [one.recalls(after).mean() - one.recalls(before).mean() for one in found.values()]
    drawn = [one.replicates(seed) for one in found.values()]
    return np.array(values), np.stack([one[after] - one[before] for one in drawn])


def _in_words(found: Mapping[str, MixedDatabase], before: str, after: str, titles: Titles) -> str:
    parts = [
        f"{titles[method]} {one.recalls(before).mean():.1f} % to {one.recalls(after).mean():.1f} % "
        f"({_range(one.recalls(after))})"
        for method, one in found.items()
    ]
    draws = max(one.hits[after].shape[1] for one in found.values())
    return f"means over {draws} choices of the added images, in brackets their spread: {', '.join(parts)}"


def _range(draws: np.ndarray) -> str:
    return f"{draws.min():.1f} to {draws.max():.1f}"
