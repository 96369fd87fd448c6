"""The status page: what was run, on what, and how long it took."""

from __future__ import annotations

import os
import platform
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any

from artifact import datasets, pages, store
from artifact.book.build import executed_folder, source_folder
from artifact.book.runner import Outcome, Task
from artifact.manifest import Manifest
from artifact.pages.scope import MADE

_SHOWN_VERSIONS = (
    "numpy",
    "scipy",
    "torch",
    "scikit-learn",
    "pandas",
    "matplotlib",
    "numba",
    "pillow",
    "papermill",
    "jupytext",
    "jupyter-book",
    "sphinx",
)


_STATUS = "status.md"


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
    _write_notice(manifest, profile)
    target = executed_folder(manifest) / _STATUS
    with store.replacing(target) as temporary:
        temporary.write_text("\n".join(lines), encoding="utf-8")


def _write_notice(manifest: Manifest, profile: str) -> None:
    """Put a notice above every page of the book where its numbers are not results; see ``book/_ext/offline.py``."""
    path = executed_folder(manifest) / "notice.txt"
    if manifest.profile(profile).made:
        with store.replacing(path) as temporary:
            temporary.write_text(MADE, encoding="utf-8")
    else:
        path.unlink(missing_ok=True)


def _data_rows(manifest: Manifest, tasks: Sequence[Task]) -> list[list[str]]:
    from artifact.book.runner import load_all

    rows = []
    for name in dict.fromkeys(name for task in tasks for name in task.datasets):
        kind = manifest.dataset(name).kind
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

    cache = manifest.cache
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
