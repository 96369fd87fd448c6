"""A Matplotlib figure as an image inside the page."""

from __future__ import annotations

import base64
import html
import io

from IPython.display import HTML
from matplotlib.figure import Figure


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
