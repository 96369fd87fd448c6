"""What an executed notebook gets before it is a page: no traces of its run, the way to make it again, a note if it is yours."""

from __future__ import annotations

import ast
import json
import re
import shlex
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import jupytext
import nbformat

from artifact.pages.common import join, markup, plain
from artifact.pages.provenance import MADE_BY


def finish(path: Path, name: str, profile: str, changed: Mapping[str, Any]) -> list[str]:
    """Finish an executed notebook in place; return the stored results that it read, which its provenance box names.

    Times, paths and identifiers go, as they differ between equal runs, and papermill's own cell is hidden: its values stand
    in the provenance box. That box gets the command that makes the page and links to the functions that computed it. A page
    with ``changed`` parameters says so at its top.
    """
    results: list[str] = []
    notebook = nbformat.read(path, as_version=4)
    notebook.metadata.pop("papermill", None)
    made_by = made_with(notebook.cells, name, profile, changed)
    for number, cell in enumerate(notebook.cells):
        if "injected-parameters" in cell.metadata.get("tags", []):
            cell.metadata["tags"] = [*cell.metadata["tags"], "remove-cell"]
        cell.metadata.pop("papermill", None)
        cell.metadata.pop("execution", None)
        cell["id"] = f"cell-{number}"
        for output in cell.get("outputs", []):
            results += output.get("metadata", {}).get("text/html", {}).pop("results", [])
            if MADE_BY in (text := output.get("data", {}).get("text/html", "")):
                output["data"]["text/html"] = text.replace(MADE_BY, made_by)
    if changed:
        _note_changes(notebook, name, changed)
    nbformat.write(notebook, path)
    return results


def write_empty_page(source: Path, stored: Path, reason: str) -> None:
    """Put a page that says why there is nothing to show in the place of a notebook."""
    first = next(cell for cell in jupytext.read(source).cells if cell.cell_type == "markdown")
    note = nbformat.v4.new_markdown_cell(f":::{{admonition}} Nothing to show in this run\n{plain(reason)}\n:::")
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_markdown_cell(first.source), note])
    nbformat.write(notebook, stored)


def made_with(cells: Sequence[Any], name: str, profile: str, changed: Mapping[str, Any]) -> str:
    """Return the command that makes a page and the functions that computed it, as HTML."""
    command = "make reproduce" + (f" PROFILE={profile}" if profile != "demo" else "")
    if changed:
        asked = " ".join(f"{name}.{key}={json.dumps(value, ensure_ascii=False)}" for key, value in changed.items())
        command += f" SET='{asked}'" if "'" not in asked else f" SET={shlex.quote(asked)}"
    links = [
        markup('<li><a href="../code/{}.html#{}"><code>{}.{}</code></a></li>', module, function, module, function)
        for module, function in functions(cells)
    ]
    return markup(
        '<p>Made by <code>{}</code><button type="button" class="copy">copy</button></p><p>Computed and shown by</p><ul>{}</ul>',
        command,
        join(links),
    ).data


def functions(cells: Sequence[Any]) -> list[tuple[str, str]]:
    """Return modules and functions of the studies and pages that the code of a notebook calls, each once, in order."""
    names, found = {"artifact": "artifact"}, []
    for tree in (ast.parse(cell.source) for cell in cells if cell.cell_type == "code"):
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom):
                names |= {alias.asname or alias.name: f"{node.module}.{alias.name}" for alias in node.names}
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
                head, *rest = ast.unparse(node.func).split(".")
                module, _, function = ".".join([names.get(head, ""), *rest]).rpartition(".")
                if re.fullmatch(r"artifact\.(studies|pages)\.(?!common|provenance)\w+", module) and find_spec(module):
                    found.append((module, function))
    return list(dict.fromkeys(found))


def _note_changes(notebook: Any, name: str, changed: Mapping[str, Any]) -> None:
    """Say in the title and below it which parameters are not the default's."""
    values = [f"{key} = {json.dumps(value, ensure_ascii=False)}" for key, value in changed.items()]
    first = next(cell for cell in notebook.cells if cell.cell_type == "markdown")
    title, _, rest = first.source.partition("\n")
    note = f":::{{admonition}} One of your runs\nMade with {plain(', '.join(values))}. [The page with the defaults]({name}.ipynb)\n:::"
    first.source = f"{title}, {plain(', '.join(values))}\n\n{note}\n{rest}"
