"""The shared figure style: the paper's colour and marker for each method, and the parts that several figures use."""

from __future__ import annotations

import base64
import hashlib
import io
import re
from collections.abc import Iterable, Sequence
from importlib.resources import as_file, files
from itertools import cycle
from typing import Any

import numpy as np
from IPython.display import HTML
from matplotlib import style as styles
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import TABLEAU_COLORS
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.text import Text
from numpy.typing import ArrayLike

from artifact.pages.common import Titles, join, markup
from artifact.studies import reported

_DEEP_IN_THE_EARTH_M = 6e6  # no plane coordinates with a height are so far from their origin

QUERY_COLOUR = "#78a0ff"
DISTRACTOR_COLOUR = "#0000ff"
DATABASE_COLOUR = "#ffa500"
FITTING_COLOUR = "#808080"
RIGHT_COLOUR, WRONG_COLOUR = "#2e8b57", "#d1495b"
SUPPRESSION_COLOURS = {"INLP": "#1f77b4", "LEACE": "#d62728", "STD": "#2ca02c"}
SUPPRESSION_MARKERS = {"INLP": "o", "LEACE": "s", "STD": "^"}

REPORTED_LINE = {"linestyle": (0, (4, 2)), "alpha": 0.55, "linewidth": 2.6}
"""What the paper reports, dashed and without markers."""

_CLEAR = (0, 0, 0, 0.001)  # not to be seen, but found by a pointer: Matplotlib leaves out what is fully clear

# What Matplotlib writes, and what a page takes: light and dark pages have their own black, white and blue.
_IN_A_PAGE = (
    (r"^.*?(?=<svg )|<metadata>.*?</metadata>|<style[^>]*>.*?</style>| transform=\"rotate\(-0 [^\"]*\"", ""),
    (r'<a xlink:href="([^"]*?)(?:\s*⧉([\d ]+))?"[^>]*>', r'<g class="value" data-tiles="\2"><title>\1</title>'),
    (r' data-tiles=""', ""),
    (r"</a>", "</g>"),
    (r'<g id="[^"]*"', "<g"),
    (r"#000000", "currentColor"),
    (r"#ffffff", "var(--pst-color-background, #fff)"),
    (r"#0000ff", "var(--distractor, #0000ff)"),
    (r"#e0e0e0", "var(--grid, #e0e0e0)"),
    (r"'DejaVu Sans'", "'DejaVu Sans', Verdana, sans-serif"),
    (r"\s*\n\s*", " "),
    (r"(\d\.\d\d)\d{3,4}\b", r"\1"),
)

# The paper's Figs. 5 to 7 take Matplotlib's own colours and black, and five markers in turn, in the order of its tables.
_PAPER = dict(
    zip(reported.method_titles(), zip([*TABLEAU_COLORS.values(), "#000000"], cycle("os^Dp"), strict=False), strict=True)
)
_BASELINES = {"thumbnail": ("#c1666b", "v"), "hog": ("#d4a017", "h"), "efficientnet_lite0": ("#2a6f97", "P")}
_OTHERS = [("#6a4c93", "X"), ("#3a7d44", "<"), ("#9c6644", ">"), ("#5c677d", "d")]


def marker_options(method: str, methods: Iterable[str] = ()) -> dict[str, Any]:
    """Return Matplotlib line options of a method's colour and marker, filled for those of the paper, open for others.

    Methods from outside take the free styles in the order of ``methods``.

    Examples
    --------
    >>> marker_options("anyloc")["color"], marker_options("hog")["markerfacecolor"]
    ('#1f77b4', 'white')
    """
    known = _PAPER | _BASELINES
    outside = [name for name in methods if name not in known]
    position = outside.index(method) if method in outside else 0
    colour, marker = known.get(method, _OTHERS[position % len(_OTHERS)])
    face = colour if method in _PAPER else "white"
    return {"color": colour, "marker": marker, "markerfacecolor": face, "markeredgewidth": 1.3}


def use_style() -> None:
    """Set the book's figure style for this process."""
    with as_file(files("artifact.pages") / "book.mplstyle") as path:
        styles.use(path)


def page_style() -> HTML:
    """Return the style of tables, verdicts and figures, which travels with every notebook and page."""
    text = (files("artifact.pages") / "results.css").read_text(encoding="utf-8")
    return HTML(f'<style class="artifact">{text}</style>')


def drawing(size: tuple[float, float], rows: int = 1, columns: int = 1, **options: Any) -> tuple[Figure, Any]:
    """Return an empty figure of so many inches and its panels, as :meth:`matplotlib.figure.Figure.subplots` does."""
    figure = Figure(figsize=size)
    return figure, figure.subplots(rows, columns, **options)


def legend_below(
    figure: Figure, handles: Sequence[Artist] | None = None, *, columns: int = 3, gap: float | None = None
) -> None:
    """Lay out a figure's panels, ``gap`` apart, and draw one legend below: of the handles, else of the first panel."""
    figure.tight_layout(w_pad=gap)
    handles = figure.axes[0].get_legend_handles_labels()[0] if handles is None else handles
    columns = min(columns, len(handles))
    figure.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, 0.0), ncols=columns)


def method_legend(figure: Figure, titles: Titles, *, lines: bool = True, reported: bool = False, **gap: float) -> None:
    """Draw a :func:`legend_below` of all methods, with the dashed line of the paper's values if there is one."""
    line = "-" if lines else "none"
    handles = [Line2D([], [], label=t, linestyle=line, **marker_options(name, titles)) for name, t in titles.items()]
    if reported:
        handles.append(Line2D([], [], color="0.3", label="the paper", **REPORTED_LINE))
    legend_below(figure, handles, columns=4, **gap)


def colour_handle(colour: str, label: str, marker: str = "s") -> Line2D:
    """Return the legend entry of a colour."""
    return Line2D([], [], linestyle="none", marker=marker, color=colour, label=label)


def percent_axis(axes: Axes, label: str = "", *, axis: str = "y") -> None:
    """Scale an axis from 0 to 100 % with quarter ticks and a grid."""
    axes.set(**{f"{axis}lim": (-2, 102), f"{axis}ticks": [0, 25, 50, 75, 100], f"{axis}label": label})
    axes.grid(visible=True)


def bare(axes: Axes, colour: str | None, width: float = 0.8) -> None:
    """Take the ticks off a panel, and its frame too unless that has a colour."""
    axes.set(xticks=[], yticks=[])
    axes.spines[:].set(visible=colour is not None, edgecolor=colour, linewidth=width)


def in_the_plane(positions: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """Return positions ``(n, p)`` as points ``(n, 2)`` of a map: east and north.

    Those along one axis lie on a line; earth-centred ones are seen from above ``origin``.
    """
    if positions.shape[1] == 3 and np.linalg.norm(origin) > _DEEP_IN_THE_EARTH_M:
        up = origin / np.linalg.norm(origin)
        east = np.array([-up[1], up[0], 0.0]) / np.hypot(up[0], up[1])
        return (positions - origin) @ np.column_stack([east, np.cross(up, east)])
    return np.column_stack([positions, np.zeros(len(positions))])[:, :2]


def show_image(axes: Axes, image: np.ndarray, frame: str | None = None) -> None:
    """Show one image without axes, with a coloured frame if one is given."""
    axes.imshow(image, interpolation="antialiased")
    bare(axes, frame, 3)


def tell_values(axes: Axes, points: ArrayLike, texts: Iterable[str], size: float = 70) -> None:
    """Give points ``(n, 2)`` of a panel a text each, which the page shows on hover; points without coordinates have none.

    A text may end in ``⧉`` and the numbers of images of :func:`artifact.pages.galleries.tiles` to show with it.
    """
    points, texts = np.asarray(points, float), np.asarray(list(texts), object)
    known = np.isfinite(points).all(axis=1)
    urls = [*texts[known], ""]  # one more than points: Matplotlib drops the address of a collection that has but one
    axes.scatter(*points[known].T, s=size, color=[_CLEAR], linewidths=0, zorder=20, clip_on=False, urls=urls)


def embed(
    figure: Figure, description: str, *, form: str = "svg", width: int | None = None, below: HTML | str = ""
) -> HTML:
    """Return a figure as it stands in the page: a drawing panel by panel, so that a narrow page stacks them.

    Parameters
    ----------
    description
        Text alternative for readers who do not see it.
    form
        ``svg`` for drawings, ``jpeg`` for photographs.
    width
        Largest width on the page in pixels; ``None`` is the figure's own.
    below
        Printed under a drawing.
    """
    style = markup(' style="width:100%;max-width:{}px"', width) if width else ""
    if form == "jpeg":
        stream = io.BytesIO()
        figure.savefig(stream, format="jpeg", dpi=150, facecolor="white", pil_kwargs={"quality": 85})
        data = base64.b64encode(stream.getvalue()).decode()
        return markup('<img class="figure"{} alt="{}" src="data:image/jpeg;base64,{}">', style, description, data)
    keys = [key for legend in figure.legends for key in zip(legend.legend_handles, legend.get_texts(), strict=True)]
    for legend in figure.legends:
        legend.set_visible(False)
    panels = []
    for shown in [axes for axes in figure.axes if axes.axison or axes.has_data() or axes.patches]:
        for axes in figure.axes:
            axes.set_visible(axes is shown)
        panels.append(_svg(figure))
    return markup(
        '<figure class="figure" role="group" aria-label="{}"{}><div class="panels">{}</div>{}{}</figure>',
        *(description, style, join(panels)),
        markup('<ul class="keys">{}</ul>', join(_key(*key) for key in keys)) if keys else "",
        below,
    )


def _key(handle: Artist, words: Text) -> HTML:
    """Draw one entry of a legend: line or patch, and its words."""
    swatch = Figure(figsize=(0.34, 0.2))
    mark = Line2D([0, 0.5, 1], [0.5] * 3) if isinstance(handle, Line2D) else Rectangle((0.2, 0.1), 0.6, 0.8)
    mark.update_from(handle)
    if isinstance(mark, Line2D):
        mark.set(markevery=[1], solid_capstyle="butt")
    mark.set_transform(swatch.transFigure)
    swatch.add_artist(mark)
    return markup("<li>{} {}</li>", _svg(swatch), words.get_text())


def _svg(figure: Figure) -> HTML:
    """Draw what is visible of a figure: text as text, black and white as the page has them, values as titles.

    It stands in a notebook as an image, which no viewer of notebooks takes out; the book puts its content in the page.
    """
    stream = io.StringIO()
    nothing = dict.fromkeys(("Date", "Creator", "Format", "Type"))
    figure.savefig(stream, format="svg", transparent=True, metadata=nothing)
    text = stream.getvalue()
    for pattern, replacement in _IN_A_PAGE:
        text = re.sub(pattern, replacement, text, flags=re.DOTALL)
    width = float(re.search(r'viewBox="0 0 ([\d.]+)', text)[1]) / 72 * 96
    prefix = f"f{hashlib.sha256(text.encode()).hexdigest()[:10]}-"  # identifiers are unique in a page
    text = re.sub(r'(\bid="|xlink:href="#|url\(#)', rf"\g<1>{prefix}", text)
    size = f"flex:1 1 {0.7 * width:.0f}px;max-width:{1.05 * width:.0f}px"
    text = text.replace("<svg ", '<svg fill="currentColor" ', 1)
    data = base64.b64encode(text.encode()).decode()
    return markup('<img alt="" style="{}" src="data:image/svg+xml;base64,{}">', size, data)
