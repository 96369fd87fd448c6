"""The shared figure style: the paper's colour and marker for each method, and the parts that several figures use."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from IPython.display import HTML
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

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
    "anyloc": ("#1f77b4", "o"), "boq": ("#ff7f0e", "s"), "cosplace": ("#2ca02c", "^"), "cricavpr": ("#d62728", "D"),
    "eigenplaces": ("#9467bd", "p"), "megaloc": ("#8c564b", "o"), "mixvpr": ("#e377c2", "s"), "salad": ("#7f7f7f", "^"),
    "salad_cm": ("#bcbd22", "D"), "selavpr": ("#17becf", "p"), "selavprpp": ("#000000", "o"),
}  # fmt: skip
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
    mpl.rcParams.update(
        {
            "figure.dpi": 110, "savefig.dpi": 110, "svg.fonttype": "path", "svg.hashsalt": "artifact",
            "figure.facecolor": "white", "savefig.facecolor": "white", "savefig.bbox": "tight",
            "font.size": 9.5, "font.family": "DejaVu Sans", "axes.titlesize": 10, "axes.labelsize": 9.5,
            "xtick.labelsize": 8.5, "ytick.labelsize": 8.5, "legend.fontsize": 8.5, "legend.frameon": False,
            "axes.spines.top": False, "axes.spines.right": False, "axes.axisbelow": True,
            "grid.color": "0.88", "grid.linewidth": 0.6, "lines.linewidth": 1.4, "lines.markersize": 5.5,
        }
    )  # fmt: skip


def marker_options(method: str, methods: Sequence[str] = ()) -> dict[str, object]:
    """Return Matplotlib line options of a method's colour and marker."""
    style = method_style(method, methods)
    face = style.colour if style.filled else "white"
    return {"color": style.colour, "marker": style.marker, "markerfacecolor": face, "markeredgewidth": 1.3}


def method_legend(figure: Figure, titles: dict[str, str], *, columns: int = 4, y: float = 0.0) -> None:
    """Draw one legend of all methods below a figure.

    Parameters
    ----------
    figure
        The figure.
    titles
        Method name to printed title, in order.
    columns
        Columns of the legend.
    y
        Its top, in figure fractions.
    """
    handles = [
        Line2D([], [], linestyle="none", label=title, **marker_options(name, list(titles)))
        for name, title in titles.items()
    ]
    figure.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, y), ncols=min(columns, len(handles)))


def curve(
    axes: Axes, x: Sequence[float], y: Sequence[float], method: str, methods: Sequence[str], *, reported: bool = False
) -> None:  # fmt: skip
    """Draw one method's curve; reported curves are dashed and faint."""
    if reported:
        axes.plot(x, y, linestyle=(0, (3, 2)), alpha=0.45, linewidth=1.1, color=method_style(method, methods).colour)
    else:
        axes.plot(x, y, **marker_options(method, methods))


def percent_axis(axes: Axes, label: str | None = None, *, axis: str = "y") -> None:
    """Scale an axis from 0 to 100 % with quarter ticks and a grid."""
    bounds, ticks, name = (
        (axes.set_ylim, axes.set_yticks, axes.set_ylabel)
        if axis == "y"
        else (axes.set_xlim, axes.set_xticks, axes.set_xlabel)
    )
    bounds(-2, 102)
    ticks([0, 25, 50, 75, 100])
    axes.grid(visible=True)
    if label:
        name(label)


def image_row(
    images: Iterable[np.ndarray], titles: Iterable[str] = (), *, height: float = 1.5, frames: Iterable[str | None] = ()
) -> Figure:  # fmt: skip
    """Show images side by side with captions and coloured frames.

    Parameters
    ----------
    images
        ``(h, w, 3)`` uint8 arrays.
    titles
        Captions above them.
    height
        Height of the row in inches.
    frames
        Frame colours; ``None`` for no frame.
    """
    pictures = list(images)
    captions, colours = list(titles) or [""] * len(pictures), list(frames) or [None] * len(pictures)
    widths = [picture.shape[1] / picture.shape[0] for picture in pictures]
    figure, panels = plt.subplots(
        1,
        len(pictures),
        figsize=(height * sum(widths) * 1.04, height * 1.16),
        squeeze=False,
        width_ratios=widths,
    )
    for axes, picture, caption, colour in zip(panels[0], pictures, captions, colours, strict=True):
        show_image(axes, picture, colour)
        axes.set_title(caption, fontsize=8, pad=3)
    figure.subplots_adjust(left=0, right=1, top=0.88, bottom=0, wspace=0.04)
    return figure


def show_image(axes: Axes, image: np.ndarray, frame: str | None = None) -> None:
    """Show one image without axes, with a coloured frame if one is given."""
    axes.imshow(image, interpolation="antialiased")
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_visible(frame is not None)
        if frame is not None:
            spine.set_edgecolor(frame)
            spine.set_linewidth(3)


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
    data = base64.b64encode(stream.getvalue()).decode()
    style = f' style="width:100%;max-width:{width}px"' if width else ""
    return HTML(f'<img class="figure"{style} alt="{html.escape(description)}" src="data:{kind};base64,{data}">')
