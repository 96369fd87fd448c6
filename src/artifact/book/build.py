"""Executed notebooks → the built book, and the record of the run behind it."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import subprocess
import sys
import time
from importlib.metadata import version
from pathlib import Path
from typing import Any

import yaml

from artifact import store
from artifact.manifest import Manifest

_CONTENTS = Path("executed", ".toc.yml")
_EXCEPTION = re.compile(r"\w*(Error|Exception|Interrupt|Exit)\b: ")  # the last line of a traceback


class BookError(RuntimeError):
    """A book that cannot be built; the message holds what the strict build found."""


def source_folder(manifest: Manifest) -> Path:
    """Return the folder of the book's sources: a copy in the cache where the clone cannot be written."""
    ours = manifest.path.parent / "book"
    if os.access(ours, os.W_OK):
        return ours
    copy = manifest.cache / "book"
    for name in _contents(ours):
        target = copy / name
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(ours / name, target)
    return copy


def executed_folder(manifest: Manifest) -> Path:
    """Return the folder that receives the executed notebooks and the status page."""
    return source_folder(manifest) / "executed"


def alone(manifest: Manifest) -> contextlib.AbstractContextManager[None]:
    """Hold the pages of this clone: another run that wants to write them waits, and says so."""
    waiting = "another run is at work on the pages of this clone; waiting for it"
    return store.lock(executed_folder(manifest) / "pages", waiting)


def build(manifest: Manifest) -> tuple[Path, float | None]:
    """Build the book strictly from the executed notebooks, running none; return its first page and the build time.

    The time is ``None`` if the built book is of the same content already.

    Raises
    ------
    BookError
        If a page of the table of contents is missing or damaged, or the strict build finds any fault.
    """
    source = source_folder(manifest)
    toc = yaml.safe_load((source / "_toc.yml").read_text(encoding="utf-8"))
    chapters = (chapter["file"] for part in toc.get("parts", [toc]) for chapter in part.get("chapters", []))
    pages = [toc["root"], *chapters]
    missing = [page for page in pages if not _is_there(source, page)]
    if missing:
        raise BookError(
            f"{len(missing)} pages are missing, first {source / missing[0]}: run `make reproduce` (or `python -m "
            f"artifact reproduce`) first"
        )
    _add_own_runs(toc, source, pages)
    with store.replacing(source / _CONTENTS) as temporary:
        temporary.write_text(yaml.safe_dump(toc, sort_keys=False), encoding="utf-8")
    for page in (source / "executed").glob("[!.]*"):
        try:
            if page.suffix != ".json":
                store.check(page)
        except store.DamagedError as error:
            raise BookError(f"{error}; `make reproduce` puts it back") from None
    html = source / "_build" / "html"
    key = store.key(stage="book", files=_contents(source), sphinx=version("sphinx"), theme=version("sphinx-book-theme"))
    try:
        if store.check(html, key):
            return html / "index.html", None
    except store.DamagedError as error:
        store.say(f"{error}; the book is built again")
    store.record_path(html).unlink(missing_ok=True)
    begun = time.monotonic()
    _build_strictly(source)
    store.seal(html, {"key": key})
    return html / "index.html", time.monotonic() - begun


def tally(manifest: Manifest) -> str:
    """Return the count of verdicts that the opening page shows; empty if it has none."""
    page = executed_folder(manifest) / "opening.ipynb"
    if not page.exists():
        return ""
    cells = store.read_json(page)["cells"]
    shown = ["".join(one.get("data", {}).get("text/html", "")) for cell in cells for one in cell.get("outputs", [])]
    found = re.search('<p class="tally">(.*?)</p>', "".join(shown))
    return found.group(1) if found else ""


def _build_strictly(source: Path) -> None:
    # --all: without it a second build of the same faulty book passes.
    program = Path(sys.executable).with_name("jupyter-book")
    command = [program, "build", source, "--toc", source / _CONTENTS, "--all", "-W", "-n", "--keep-going", "-q"]
    environment = {**os.environ, "PYTHONWARNINGS": "ignore"}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    if done.returncode:
        output = (done.stdout + done.stderr).splitlines()
        faults = [line for line in output if "WARNING" in line or "ERROR" in line]
        ended = [line for line in output if _EXCEPTION.match(line)]
        shown = "\n".join(ended[-1:] or faults or output[-30:])
        raise BookError(f"the strict build of {source} failed:\n{shown}")


def _add_own_runs(toc: dict[str, Any], source: Path, pages: list[str]) -> None:
    """Add the pages that were made with other parameters to the table of contents, as a part of their own."""
    beside = tuple(f"{Path(page).name}-" for page in pages)
    names = sorted(path.stem for path in (source / "executed").glob("*.ipynb"))
    own = [{"file": f"executed/{name}"} for name in names if name.startswith(beside)]
    if own and "parts" in toc:
        toc["parts"].append({"caption": "Your runs", "chapters": own})
    elif own:
        toc["chapters"] += own


def _is_there(source: Path, page: str) -> bool:
    return any((source / f"{page}{ending}").exists() for ending in (".ipynb", ".md"))


def _contents(source: Path) -> dict[str, str]:
    passed_over = (".", "__pycache__")
    names = [path.relative_to(source) for path in sorted(source.rglob("*")) if path.is_file()]
    kept = [n for n in names if "_build" not in n.parts and not any(part.startswith(passed_over) for part in n.parts)]
    return dict(zip(map(str, kept), store.digest_of_files([source / name for name in kept]), strict=True))
