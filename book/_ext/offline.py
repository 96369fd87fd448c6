"""Make the built pages work from a folder, with no server and no network.

Formulas: the one MathJax file that the pages use is served from the book itself. Fonts: the theme asks browsers to
preload its icon fonts with a cross-origin request, which browsers refuse for pages opened from a folder; the fonts
load without it.
"""

import re
import shutil
from importlib.metadata import files
from pathlib import Path

SCRIPT = "tex-svg.js"
FONT_PRELOAD = re.compile(r'<link rel="preload" as="font"[^>]*>\s*')


def finish(app, exception):
    """Copy MathJax and drop the font preloads once the pages are written."""
    if exception is not None or app.builder.format != "html":
        return
    output = Path(app.outdir)
    source = next(entry for entry in files("sphinx-mathjax-offline") if entry.name == SCRIPT)
    target = output / "_static" / "mathjax" / SCRIPT
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(source.locate(), target)
    for page in output.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        slim = FONT_PRELOAD.sub("", text)
        if slim != text:
            page.write_text(slim, encoding="utf-8")


def setup(app):
    """Register with Sphinx."""
    app.connect("build-finished", finish)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
