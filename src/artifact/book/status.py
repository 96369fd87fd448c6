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
from artifact.book.notebooks import Task, datasets_of, load_all, pairs_of
from artifact.book.runner import Outcome
from artifact.datasets import imported
from artifact.extraction import extract
from artifact.manifest import Manifest
from artifact.pages.common import plain
from artifact.pages.scope import MADE

_COMPUTING = ("numpy", "scipy", "torch", "scikit-learn", "pandas", "matplotlib", "numba", "pillow")
_PUBLISHING = ("papermill", "jupytext", "jupyter-book", "sphinx")


def record_run(
    manifest: Manifest, profile: str, tasks: Sequence[Task], outcomes: Sequence[Outcome], stages: Sequence[str]
) -> None:
    """Write the status page: times, reuse, versions, machine and inputs of the run behind the book."""
    used = {task.page: task for task in tasks}
    notebooks = []
    for one in outcomes:
        state, task = "reused" if one.cached else "run", used[one.name]
        counts = len(task.datasets), len(task.methods)
        notebooks.append([f"[{one.name}]({one.name}.ipynb)", f"{one.seconds:.1f}", state, *counts, f"`{one.key[:12]}`"])
    memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 2**30
    machine = {
        "Machine": f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores, {memory:.0f} GiB",
        "Python": platform.python_version(),
        **{name: version(name) for name in (*_COMPUTING, *_PUBLISHING)},
    }
    when, reused = f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC", sum(one.cached for one in outcomes)
    spent = ["What this run took before the book was built:", "\n".join(["```text", *stages, "```"])] if stages else []
    paragraphs = [
        "# Status of this build",
        f"Profile **{profile}**, {when}, {pages.provenance.code_revision()}.\n"
        f"{reused} of {len(outcomes)} notebooks were reused because nothing they depend on changed.",
        *spent,
        "## Notebooks",
        _markdown_table(["Notebook", "Seconds", "This run", "Datasets", "Methods", "Key"], notebooks),
        "Seconds are those of the run that made the page, also where it is reused.",
        "## Data",
        _markdown_table(["Dataset", "Traversal", "Images", "State", "Content"], _data_rows(manifest, tasks)),
        "## Machine and versions",
        _markdown_table(["What", "Value"], list(machine.items())),
    ]
    _write_notice(manifest, profile, tasks)
    page = executed_folder(manifest) / "status.md"
    with store.replacing(page) as temporary:
        temporary.write_text("\n\n".join(paragraphs) + "\n", encoding="utf-8")
    store.seal(page, {"profile": profile})


def _write_notice(manifest: Manifest, profile: str, tasks: Sequence[Task]) -> None:
    """Put notices above every page of the book, a line each: where its numbers are no results, and where not of this machine.

    See ``book/_ext/offline.py``.
    """
    lines = [MADE] if manifest.profile(profile).made else []
    lines += [f"From the results bundle of {date}." for date in _bundles(manifest, tasks)]
    path = executed_folder(manifest) / "notice.txt"
    if lines:
        with store.replacing(path) as temporary:
            temporary.write_text("\n".join(lines), encoding="utf-8")
    else:
        path.unlink(missing_ok=True)


def _bundles(manifest: Manifest, tasks: Sequence[Task]) -> list[str]:
    """Dates of the imported bundles that descriptors of these pages are recorded in, where their values are not here."""
    loaded = {name: load_all(manifest, name) for name in datasets_of(tasks)}
    absent = {d for d, m in pairs_of(tasks) if not all(extract.is_at_hand(manifest, t, m) for t in loaded[d])}
    return [bundle.date for bundle in imported.bundles(manifest) if absent & {*bundle.datasets}]


def _data_rows(manifest: Manifest, tasks: Sequence[Task]) -> list[list[Any]]:
    rows = []
    for name in datasets_of(tasks):
        kind = manifest.dataset(name).kind
        for traversal in load_all(manifest, name):
            if kind == "made":
                state = "made descriptors"
            elif traversal.has_images:
                state = "rendered" if kind == "city" else "prepared images" if traversal.preparation else "images"
            elif any(given.path is None for given in traversal.descriptors.values()):
                state = "results bundle"
            else:
                state = "given descriptors" if traversal.descriptors else "shipped descriptors"
            rows.append([plain(name), plain(traversal.name), len(traversal), state, f"`{traversal.digest[:12]}`"])
    return rows


def _markdown_table(head: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return "\n".join(lines + ["| " + " | ".join(map(str, row)) + " |" for row in rows])


def status_lines(manifest: Manifest, profile: str) -> list[str]:
    """Return what is ready and what is missing, without making anything."""
    lines = [f"manifest  {manifest.path}", f"data root {manifest.data_root}", f"cache     {manifest.cache}"]
    entry = manifest.profile(profile)
    for name in entry.datasets:
        if missing := datasets.describe_missing(manifest, name):
            lines.append(missing.splitlines()[0])
            continue
        for traversal in datasets.load(manifest, name).traversals.values():
            ready = [method for method in entry.methods if extract.is_ready(manifest, traversal, method)]
            lines.append(f"{name}/{traversal.name}: {len(traversal)} images, descriptors: {', '.join(ready) or 'none'}")
    for bundle in imported.bundles(manifest):
        where = imported.folder_of(manifest, bundle.profile)
        lines.append(f"bundle    results of {bundle.date}, profile {bundle.profile}, in {where}")
    index = source_folder(manifest) / "_build" / "html" / "index.html"
    lines.append(f"book      {index if index.exists() else 'not built'}")
    return lines
