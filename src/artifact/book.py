"""Executed notebooks → the built book, and the record of the run behind it."""

from __future__ import annotations

import contextlib
import os
import platform
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import yaml

from artifact import datasets, pages, store
from artifact.manifest import Manifest
from artifact.runner import Outcome, Task

_SHOWN_VERSIONS = (
    "numpy", "scipy", "torch", "scikit-learn", "pandas", "matplotlib", "numba", "pillow", "papermill", "jupytext",
    "jupyter-book", "sphinx",
)  # fmt: skip
_STATUS = "status.md"


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
    command = [
        program,
        "build",
        str(source),
        "--all",
        "-W",
        "-n",
        "--keep-going",
        "-q",
    ]
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


def record_run(
    manifest: Manifest, profile: str, tasks: Sequence[Task], outcomes: Sequence[Outcome], preparation: float
) -> None:
    """Write the status page: times, reuse, versions, machine and inputs of the run behind the book."""
    used = {task.name: task for task in tasks}
    lines = [
        "# Status of this build",
        "",
        f"Profile **{profile}**, {datetime.now(UTC):%Y-%m-%d %H:%M} UTC, {pages.provenance.code_revision()}.",
        f"Preparing data and descriptors took {preparation:.0f} s in this run; "
        f"{sum(o.cached for o in outcomes)} of {len(outcomes)} notebooks were reused because nothing they depend on changed.",
        "",
        "## Notebooks",
        "",
        _markdown_table(
            ["Notebook", "Seconds", "This run", "Datasets", "Methods", "Key"],
            [
                [
                    f"[{o.name}]({o.name}.ipynb)",
                    f"{o.seconds:.1f}",
                    "reused" if o.cached else "run",
                    str(len(used[o.name].datasets)),
                    str(len(used[o.name].methods)),
                    f"`{o.key[:12]}`",
                ]
                for o in outcomes
            ],
        ),
        "",
        "Seconds are those of the run that made the page, also where it is reused.",
        "",
        "## Data",
        "",
        _markdown_table(["Dataset", "Traversal", "Images", "State", "Content"], _data_rows(manifest, tasks)),
        "",
        "## Machine and versions",
        "",
        _markdown_table(
            ["What", "Value"],
            [
                ["Machine", f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores, {_memory()}"],
                ["Python", platform.python_version()],
                *[[name, version(name)] for name in _SHOWN_VERSIONS],
            ],
        ),
        "",
    ]
    target = executed_folder(manifest) / _STATUS
    with store.replacing(target) as temporary:
        temporary.write_text("\n".join(lines), encoding="utf-8")


def _data_rows(manifest: Manifest, tasks: Sequence[Task]) -> list[list[str]]:
    from artifact.runner import load_all

    rows = []
    for name in dict.fromkeys(name for task in tasks for name in task.datasets):
        kind = datasets.entry_of(manifest, name).kind
        for traversal in load_all(manifest, name):
            state = "rendered" if kind == "city" else "images" if traversal.has_images else "shipped descriptors"
            rows.append([name, traversal.name, str(len(traversal)), state, f"`{traversal.digest[:12]}`"])
    return rows


def _memory() -> str:
    if not hasattr(os, "sysconf") or "SC_PHYS_PAGES" not in os.sysconf_names:
        return "memory unknown"
    return f"{os.sysconf('SC_PHYS_PAGES') * os.sysconf('SC_PAGE_SIZE') / 2**30:.0f} GiB"


def _markdown_table(head: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return "\n".join(lines + ["| " + " | ".join(map(str, row)) + " |" for row in rows])


def status_lines(manifest: Manifest, profile: str) -> list[str]:
    """Return what is ready and what is missing, without making anything."""
    from artifact.extraction import extract

    cache = store.cache_folder(manifest.path.parent)
    lines = [f"manifest  {manifest.path}", f"data root {manifest.data_root}", f"cache     {cache}"]
    entry = manifest.profile(profile)
    for name in entry.datasets:
        missing = datasets.describe_missing(manifest, name)
        if missing:
            lines.append(missing.splitlines()[0])
            continue
        for traversal in datasets.load(manifest, name).traversals.values():
            ready = [method for method in entry.methods if extract.is_ready(manifest, traversal, method)]
            lines.append(f"{name}/{traversal.name}: {len(traversal)} images, descriptors: {', '.join(ready) or 'none'}")
    index = source_folder(manifest) / "_build" / "html" / "index.html"
    lines.append(f"book      {index if index.exists() else 'not built'}")
    return lines
