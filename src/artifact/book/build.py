"""Executed notebooks → the built book, and the record of the run behind it."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import yaml

from artifact import store
from artifact.manifest import Manifest


class BookError(RuntimeError):
    """A book that cannot be built; the message holds what the strict build found."""


@dataclass
class Timer:
    """Seconds that a block took."""

    seconds: float = 0.0


@contextlib.contextmanager
def timed() -> Iterator[Timer]:
    """Measure the wall time of a block."""
    timer, begun = Timer(), time.monotonic()
    try:
        yield timer
    finally:
        timer.seconds = time.monotonic() - begun


def source_folder(manifest: Manifest) -> Path:
    """Return the folder of the book's sources."""
    return manifest.path.parent / "book"


def executed_folder(manifest: Manifest) -> Path:
    """Return the folder that receives the executed notebooks and the status page."""
    return source_folder(manifest) / "executed"


def build(manifest: Manifest) -> tuple[Path, float | None]:
    """Build the book strictly from the executed notebooks, running none.

    Returns
    -------
    path
        The first page.
    seconds
        Build time, or ``None`` if the built book is of the same content already.

    Raises
    ------
    BookError
        If a page of the table of contents is missing, or the strict build finds any fault.
    """
    source = source_folder(manifest)
    pages = _pages(source)
    missing = [page for page in pages if not _page_file(source, page)]
    if missing:
        raise BookError(
            f"{len(missing)} pages are missing, first {source / missing[0]}: run `make reproduce` (or `python -m "
            f"artifact run`) first"
        )
    html = source / "_build" / "html"
    key = store.key(stage="book", files=_contents(source), sphinx=version("sphinx"), theme=version("sphinx-book-theme"))
    stamp, index = html / ".artifact-key", html / "index.html"
    if stamp.exists() and index.exists() and stamp.read_text() == key:
        return index, None
    stamp.unlink(missing_ok=True)
    with timed() as timer:
        _build_strictly(source)
    stamp.write_text(key)
    return index, timer.seconds


def _build_strictly(source: Path) -> None:
    # --all: without it a second build of the same faulty book passes.
    program = str(Path(sys.executable).with_name("jupyter-book"))
    command = [program, "build", str(source), "--all", "-W", "-n", "--keep-going", "-q"]
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, env={**os.environ, "PYTHONWARNINGS": "ignore"}
    )
    if done.returncode:
        lines = [line for line in (done.stdout + done.stderr).splitlines() if "WARNING" in line or "ERROR" in line]
        shown = "\n".join(lines) or (done.stdout + done.stderr)[-3000:]
        raise BookError(f"the strict build of {source} failed:\n{shown}")


def _pages(source: Path) -> list[str]:
    toc = yaml.safe_load((source / "_toc.yml").read_text(encoding="utf-8"))
    pages = [toc["root"]]
    for part in toc.get("parts", []):
        pages += [chapter["file"] for chapter in part["chapters"]]
    return pages


def _page_file(source: Path, page: str) -> Path | None:
    return next((f for ending in (".ipynb", ".md") if (f := source / f"{page}{ending}").exists()), None)


def _contents(source: Path) -> dict[str, str]:
    files = sorted(
        path
        for path in source.rglob("*")
        if path.is_file()
        and "_build" not in path.relative_to(source).parts
        and not any(part.startswith((".", "__pycache__")) for part in path.relative_to(source).parts)
    )
    return dict(zip((str(p.relative_to(source)) for p in files), store.digest_of_files(files), strict=True))


# -- the record of a run ------------------------------------------------------------------------------------
