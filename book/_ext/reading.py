"""Make pages read in the order of a reader: the result first, the code below it, its functions one click away.

Cells that only hold parameters or code stand in the order in which they run; on the page they follow the result. The functions
that computed a page are linked in its provenance box: their modules become pages of highlighted source. Searching shows
excerpts from a text of all pages, since a browser reads no other file of a folder.
"""

import ast
import base64
import html
import json
import re
import shutil
from importlib.util import find_spec
from pathlib import Path

from docutils import nodes

LIBRARY = Path(find_spec("artifact").submodule_search_locations[0])
LINKED = re.compile(r"code/(artifact\.[\w.]+)\.html")
DRAWING = re.compile(r'<img alt="" (style="[^"]*" )src="data:image/svg\+xml;base64,([^"]*)">')
STYLE = '<style class="artifact">'


def order(app, doctree):
    """Move hidden code below the result, name its toggles, and drop the style that each notebook carries."""
    for output in [n for n in doctree.findall(nodes.container) if n.get("nb_element") == "mime_bundle"]:
        if any(raw.astext().startswith(STYLE) for raw in output.findall(nodes.raw)):
            output.parent.remove(output)
    cells = [n for n in doctree.findall(nodes.container) if n.get("nb_element") == "cell_code"]
    hidden = [cell for cell in cells if cell.get("hide_mode") == "input"]
    for cell in hidden:
        for output in [n for n in cell.children if n.get("nb_element") == "cell_code_output" and not n.children]:
            cell.remove(output)
        name = "Parameters" if "tag_parameters" in cell["classes"] else "Code"
        cell["prompt_show"] = cell["prompt_hide"] = name
        if cell is not cells[-1] and len(cell.children) == 1:
            cell.parent.remove(cell)
            cells[-1].parent.insert(cells[-1].parent.index(cells[-1]), cell)


def inline(app, pagename, templatename, context, doctree):
    """Put drawings into the page: their text is searched and selected, their colours are those of the page.

    A bibliography is no list to a screen reader, since links stand between its entries.
    """

    def drawing(match):
        svg = base64.b64decode(match[2]).decode("utf-8")
        return svg.replace("<svg ", f'<svg aria-hidden="true" {match[1]}', 1)

    if "body" in context:
        body = context["body"].replace('<div role="list" class="citation-list">', '<div class="citation-list">')
        context["body"] = DRAWING.sub(drawing, body)


def sources(app):
    """Yield a page of highlighted source for every module that a provenance box links to."""
    written = [page.read_text(encoding="utf-8") for page in (Path(app.outdir) / "executed").glob("*.html")]
    for module in sorted({name for text in written for name in LINKED.findall(text)}):
        path = LIBRARY.parent.joinpath(*module.split(".")).with_suffix(".py")
        code = path.read_text(encoding="utf-8")
        lines = app.builder.highlighter.highlight_block(code, "python").splitlines()
        for node in ast.parse(code).body:
            if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
                lines[node.lineno - 1] = f'<span id="{node.name}">{lines[node.lineno - 1]}</span>'
        where = html.escape(f"src/{path.relative_to(LIBRARY.parent)}")
        body = f"<h1>{html.escape(module)}</h1><p><code>{where}</code></p>" + "\n".join(lines)
        yield f"code/{module}", {"title": module, "body": body, "parents": []}, "page.html"


def finish(app, exception):
    """Write the style of the library and the texts that search shows excerpts from."""
    if exception is not None or app.builder.format != "html":
        return
    output = Path(app.outdir)
    shutil.copyfile(LIBRARY / "pages" / "results.css", output / "_static" / "results.css")
    texts = {}
    for page in output.glob("**/*.html"):
        article = re.search(r"<article[^>]*>(.*?)</article>", page.read_text(encoding="utf-8"), re.DOTALL)
        shown = re.sub(r"<(script|style|svg)\b.*?</\1>|<[^>]+>", " ", article[1] if article else "", flags=re.DOTALL)
        texts[page.relative_to(output).as_posix()] = " ".join(html.unescape(shown).split())
    script = output / "search_texts.js"
    script.write_text(f"const TEXTS = {json.dumps(texts, ensure_ascii=False)};\n{READ_TEXTS}", encoding="utf-8")
    page = output / "search.html"
    text = page.read_text(encoding="utf-8")
    page.write_text(text.replace("</head>", '<script src="search_texts.js"></script></head>', 1), encoding="utf-8")


READ_TEXTS = """\
// The search of Sphinx fetches each page for an excerpt, which a browser refuses for pages opened from a folder.
window.fetch = (address) => {
  const name = decodeURIComponent(new URL(address, location).pathname);
  const found = Object.keys(TEXTS).find((page) => name.endsWith("/" + page)) ?? "";
  const main = document.createElement("div");
  main.setAttribute("role", "main");
  main.textContent = TEXTS[found] ?? "";
  return Promise.resolve({ ok: true, text: async () => main.outerHTML });
};
"""


def setup(app):
    """Register with Sphinx."""
    app.add_css_file("results.css", priority=300)
    app.connect("doctree-read", order)
    app.connect("html-page-context", inline)
    app.connect("html-collect-pages", sources)
    app.connect("build-finished", finish)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
