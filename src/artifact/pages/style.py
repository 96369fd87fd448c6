"""The shared figure style: the paper's colour and marker for each method, and the parts that several figures use."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import as_file, files
from typing import Any

import numpy as np
from IPython.display import HTML
from matplotlib import style as styles
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from artifact.pages.common import markup

_DEEP_IN_THE_EARTH_M = 6e6  # no plane coordinates with a height are so far from their origin

QUERY_COLOUR = "#78a0ff"
DISTRACTOR_COLOUR = "#0000ff"
DATABASE_COLOUR = "#ffa500"
FITTING_COLOUR = "#808080"
RIGHT_COLOUR, WRONG_COLOUR = "#2e8b57", "#d1495b"
SUPPRESSION_COLOURS = {"INLP": "#1f77b4", "LEACE": "#d62728", "STD": "#2ca02c"}


@dataclass(frozen=True)
class MethodStyle:
    """Colour, marker and whether the marker is filled (methods of the paper) or open (baselines)."""

    colour: str
    marker: str
    filled: bool = True


# Colours and markers of the paper's Figs. 5 to 7.
_PAPER = {
    "anyloc": ("#1f77b4", "o"),
    "boq": ("#ff7f0e", "s"),
    "cosplace": ("#2ca02c", "^"),
    "cricavpr": ("#d62728", "D"),
    "eigenplaces": ("#9467bd", "p"),
    "megaloc": ("#8c564b", "o"),
    "mixvpr": ("#e377c2", "s"),
    "salad": ("#7f7f7f", "^"),
    "salad_cm": ("#bcbd22", "D"),
    "selavpr": ("#17becf", "p"),
    "selavprpp": ("#000000", "o"),
}
_BASELINES = {"thumbnail": ("#c1666b", "v"), "hog": ("#d4a017", "h"), "efficientnet_lite0": ("#2a6f97", "P")}
_OTHERS = [("#6a4c93", "X"), ("#3a7d44", "<"), ("#9c6644", ">"), ("#5c677d", "d")]


def method_style(method: str, others: Sequence[str] = ()) -> MethodStyle:
    """Return the style of a method; methods from outside take the free styles in the order of ``others``.

    Examples
    --------
    >>> method_style("anyloc").colour, method_style("hog").filled
    ('#1f77b4', False)
    """
    if method in _PAPER:
        return MethodStyle(*_PAPER[method])
    if method in _BASELINES:
        return MethodStyle(*_BASELINES[method], filled=False)
    outside = [name for name in others if name not in _PAPER and name not in _BASELINES]
    position = outside.index(method) if method in outside else 0
    return MethodStyle(*_OTHERS[position % len(_OTHERS)], filled=False)


def use_style() -> None:
    """Set the book's figure style for this process: called once at the top of a notebook."""
    with as_file(files("artifact.pages") / "book.mplstyle") as path:
        styles.use(path)


def marker_options(method: str, methods: Sequence[str] = ()) -> dict[str, Any]:
    """Return Matplotlib line options of a method's colour and marker."""
    style = method_style(method, methods)
    face = style.colour if style.filled else "white"
    return {"color": style.colour, "marker": style.marker, "markerfacecolor": face, "markeredgewidth": 1.3}


def legend_below(figure: Figure, handles: Sequence[Artist] | None = None, *, columns: int = 3) -> None:
    """Draw one legend below a figure: of the handles, else of what its first panel labels."""
    handles = figure.axes[0].get_legend_handles_labels()[0] if handles is None else handles
    columns = min(columns, len(handles))
    figure.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, 0.0), ncols=columns)


def method_legend(figure: Figure, titles: Mapping[str, str], *, reported: bool = False) -> None:
    """Draw one legend of all methods below a figure, with the dashed line of the paper's values if there is one."""
    names = list(titles)
    handles = [Line2D([], [], linestyle="none", label=titles[n], **marker_options(n, names)) for n in names]
    if reported:
        handles.append(Line2D([], [], linestyle=(0, (4, 2)), color="0.3", alpha=0.55, linewidth=2.6, label="the paper"))
    legend_below(figure, handles, columns=4)


def colour_handle(colour: str, label: str) -> Line2D:
    """Return the legend entry of a colour."""
    return Line2D([], [], linestyle="none", marker="s", color=colour, label=label)


def curve(axes: Axes, x: Sequence[float], y: Sequence[float], method: str, methods: Sequence[str]) -> None:
    """Draw one method's curve."""
    axes.plot(x, y, **marker_options(method, methods))


def percent_axis(axes: Axes, label: str = "", *, axis: str = "y") -> None:
    """Scale an axis from 0 to 100 % with quarter ticks and a grid."""
    axes.set(**{f"{axis}lim": (-2, 102), f"{axis}ticks": [0, 25, 50, 75, 100]})
    axes.grid(visible=True)
    if label:
        axes.set(**{f"{axis}label": label})


def bare(axes: Axes, colour: str | None = None, width: float = 0.8) -> None:
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


def embed(figure: Figure, description: str, *, form: str = "svg", width: int | None = None) -> HTML:
    """Return a figure as an image inside the page.

    Parameters
    ----------
    figure
        A Matplotlib figure.
    description
        Text alternative for readers who do not see it.
    form
        ``svg`` for drawings, ``jpeg`` for photographs.
    width
        Largest width on the page in pixels; ``None`` is the figure's own.
    """
    stream = io.BytesIO()
    # Without a fixed date equal figures would have different bytes.
    options = {"metadata": {"Date": None}} if form == "svg" else {"dpi": 150, "pil_kwargs": {"quality": 85}}
    figure.savefig(stream, format=form, **options)
    kind = {"svg": "image/svg+xml", "jpeg": "image/jpeg"}[form]
    style = markup(' style="width:100%;max-width:{}px"', width) if width else ""
    data = base64.b64encode(stream.getvalue()).decode()
    return markup('<img class="figure"{} alt="{}" src="data:{};base64,{}">', style, description, kind, data)
