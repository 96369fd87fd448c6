"""Make the built pages work from a folder, with no server and no network.

Formulas: the one MathJax file that the pages use is served from the book itself. Fonts: the theme asks browsers to
preload its icon fonts with a cross-origin request, which browsers refuse for pages opened from a folder; the fonts
load without it. Live code: its scripts are in every page, can be there twice (which is an error), and need a server. The sidebar
with the contents of a page: the theme's script fails on pages that have none.
"""

import html
import re
import shutil
from importlib.metadata import files
from pathlib import Path

SCRIPT = "tex-svg.js"
SIDEBAR = 'document.querySelector("div.bd-sidebar-secondary").classList'
UNWANTED = re.compile(
    r'<link rel="preload" as="font"[^>]*>\s*'
    r"|<link [^>]*sphinx-thebe[^>]*>\s*"
    r"|<script[^>]*sphinx-thebe[^>]*></script>\s*"
    r"|<script>const THEBE_JS_URL.*?</script>\s*"
    r'|<script type="text/x-thebe-config">.*?</script>\s*',
    re.DOTALL,
)


def finish(app, exception):
    """Copy MathJax and drop what needs a server once the pages are written."""
    if exception is not None or app.builder.format != "html":
        return
    output = Path(app.outdir)
    source = next(entry for entry in files("sphinx-mathjax-offline") if entry.name == SCRIPT)
    target = output / "_static" / "mathjax" / SCRIPT
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(source.locate(), target)
    script = output / "_static" / "scripts" / "sphinx-book-theme.js"
    text = script.read_text(encoding="utf-8")
    script.write_text(text.replace(SIDEBAR, SIDEBAR.replace(".classList", "?.classList")), encoding="utf-8")
    for page in output.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        slim = UNWANTED.sub("", text)
        if slim != text:
            page.write_text(slim, encoding="utf-8")


def notice(app, pagename, templatename, context, doctree):
    """Put the notices of a run above every page: that its numbers are no results, or from a results bundle."""
    path = Path(app.srcdir) / "executed" / "notice.txt"
    if path.exists() and "body" in context:
        lines = path.read_text(encoding="utf-8").splitlines()
        notices = "".join(f'<p class="notice" role="note">{html.escape(line)}</p>' for line in lines)
        context["body"] = notices + context["body"]


def setup(app):
    """Register with Sphinx."""
    app.connect("html-page-context", notice)
    app.connect("build-finished", finish)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
