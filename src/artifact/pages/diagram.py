"""Fig. 4: recall and DAR as a diagram."""

from __future__ import annotations

from IPython.display import HTML
from matplotlib.axes import Axes
from matplotlib.patches import Circle, FancyBboxPatch, Rectangle

from artifact.pages.style import DATABASE_COLOUR, DISTRACTOR_COLOUR, drawing, embed

_CROSS = [(-3.9, 2.3), (1.5, -3.7), (4.4, 0.3), (-4.2, -1.1)]
_DISTRACTORS = [(4.0, 1.8), (3.6, -2.4), (-2.7, -3.3)]
_POSITIVES = [(1.5, 1.6), (-1.7, 1.3), (-0.9, -1.9)]


def retrieval_diagram() -> HTML:
    """Fig. 4: what is in the database for recall (a) and for DAR (b); drawn, not measured."""
    figure, panels = drawing((7.2, 3.9), columns=2)
    for axes, title, extra in zip(panels, ("(a) Recall", "(b) DAR"), ([], _DISTRACTORS), strict=True):
        axes.add_patch(Circle((0, 0), 2.8, facecolor="#e7f5e9", edgecolor="#2e7d32", linestyle="--", linewidth=1.4))
        sets = (_CROSS, 0.6, DATABASE_COLOUR), (_POSITIVES, 0.66, DATABASE_COLOUR), (extra, 0.6, DISTRACTOR_COLOUR)
        for places, size, colour in sets:
            for place in places:
                axes.add_patch(_place(*place, size, colour))
        _robot(axes)
        axes.text(0, -2.45, "threshold", ha="center", va="center", fontsize=7.5, color="#2e7d32")
        axes.set(xlim=(-5.1, 5.3), ylim=(-4.4, 3.6), aspect="equal", title=title)
        axes.set_axis_off()
        corners = "round,pad=0,rounding_size=0.2"
        axes.add_patch(FancyBboxPatch((-5.0, -4.3), 10.2, 7.8, corners, fill=False, linewidth=0.8))
    handles = [_place(0, 0, 1, colour) for colour in (DATABASE_COLOUR, DISTRACTOR_COLOUR)]
    figure.legend(handles, ["Cross-condition database", "Distractors (query's condition)"], loc="lower center", ncols=2)
    figure.tight_layout(rect=(0, 0.07, 1, 1))
    return embed(
        figure,
        "A robot at the query pose. Left, recall: all database images are of the other condition. Right, DAR: images of the "
        "query's own condition are added outside the threshold circle.",
        width=720,
    )


def _place(x: float, y: float, size: float, colour: str) -> Rectangle:
    """An image of the database around a place."""
    corner = x - size / 2, y - 0.36 * size
    return Rectangle(corner, size, 0.74 * size, facecolor=colour, edgecolor="black", linewidth=0.7)


def _robot(axes: Axes) -> None:
    """A small robot at the query pose."""
    blue, dark = "#bfc8ff", "#28349b"
    axes.add_patch(Rectangle((-0.56, -0.44), 1.12, 0.8, facecolor=blue, edgecolor=dark, linewidth=1.2))
    axes.add_patch(Rectangle((-0.36, 0.36), 0.72, 0.36, facecolor="#9daaf5", edgecolor=dark, linewidth=1.2))
    for x in (-0.16, 0.16):
        axes.add_patch(Circle((x, 0.54), 0.06, color=dark))
    axes.plot([0, 0], [0.72, 0.98], color=dark, linewidth=1.2)
    axes.add_patch(Circle((0, 1.0), 0.09, color=dark))
    for x in (-0.4, 0.4):
        axes.add_patch(Circle((x, -0.56), 0.12, color="black"))
