"""``data``: what of datasets and weights is here, what is missing, and how to get it, as tables for people."""

from __future__ import annotations

import textwrap
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import zip_longest
from typing import TYPE_CHECKING

from artifact import datasets
from artifact.datasets import DatasetError, published
from artifact.datasets.disk import in_words
from artifact.manifest import Manifest

if TYPE_CHECKING:
    from artifact.book.notebooks import Task

_WIDTHS = (13, 12, 15, 16, 30, 58)  # characters of the columns
_HEAD = ("dataset", "state", "images", "files", "licence", "how to get it")
_HEAD_MISSING = ("what", "state", "size", "licence", "how to get it")
_NOW = (
    ("make reproduce", "the demo: rendered pairs and real Gardens Point, with three baselines"),
    ("make rehearsal", "every page of the paper on made descriptors: no number is a result"),
    ("make results-import BUNDLE=paper.zip", "this very run, from somebody's results bundle"),
)


def status_lines(manifest: Manifest) -> Iterator[str]:
    """Yield the table of all datasets that are prepared from published files, and what is wrong with folders."""
    found = {name: published.states(manifest, name) for name, entry in manifest.datasets.items() if entry.preparation}
    yield f"data root {manifest.data_root}"
    yield from _table([_HEAD, *(_row(manifest, name, states) for name, states in found.items())])
    for name, states in found.items():
        yield from (f"{name}/{state.traversal}: {state.detail}" for state in states if state.status == "changed")


def _row(manifest: Manifest, name: str, states: Sequence[published.State]) -> tuple[str, ...]:
    counts = Counter(state.status for state in states)
    found = [status for status in ("verified", "present", "missing", "changed") if counts[status]]
    state = found[0] if len(found) == 1 else ", ".join(f"{counts[status]} {status}" for status in found)
    numbers = [f"{s.images:,}" if s.images is not None else "–" for s in states]
    images = ", ".join(numbers) if set(numbers) != {"–"} else "–"
    files = list({file.path: file for one in states for file in one.originals}.values())
    here = sum(file.path.exists() for file in files)
    how = "" if counts["verified"] == len(states) else how_to_get(manifest, name)
    size = in_words(sum(file.entry.n_bytes for file in files) or None)
    return name, state, images, f"{here} of {len(files)}, {size}", manifest.dataset(name).licence, how


def how_to_get(manifest: Manifest, dataset: str) -> str:
    """Say in a line how a dataset is obtained."""
    entry = manifest.dataset(dataset)
    if entry.preparation is None:
        steps = [*(source.url for source in entry.sources[:1]), entry.obtain or ""]
        return ": ".join(step.strip() for step in steps if step) or "see its folder in the manifest"
    command = f"make data DATASET={dataset}"
    if all(file.urls for file in entry.preparation.files):
        return command
    return f"by hand from {entry.sources[0].url} (which files: {command})" if entry.sources else command


def require(manifest: Manifest, tasks: Sequence[Task]) -> None:
    """Raise ``DatasetError`` with one table of all that is missing, and what can run now, if a dataset of a run is missing."""
    from artifact.methods import weights

    names = dict.fromkeys(name for task in tasks for name in task.datasets)
    of_files = [name for name in names if manifest.dataset(name).kind == "folder"]
    faults = {name: fault for name in of_files if (fault := datasets.describe_missing(manifest, name))}
    if not any(": no folder " in fault for fault in faults.values()):
        return  # what is wrong with a folder that is there is said when it is loaded
    rows = [_row_of_missing(manifest, name, fault) for name, fault in faults.items()]
    for method in dict.fromkeys(method for task in tasks for method in task.methods):
        entry = manifest.method(method)
        state = weights.state(method, entry)
        if state.status in ("missing", "changed") and entry.weights:
            size = in_words(sum(file.n_bytes for file in entry.weights.files) or None)
            rows.append((method, f"{state.status} weights", size, entry.weights.licence, "make data PROFILE=paper"))
    here = [name for name in of_files if name not in faults]
    lines = ["nothing was run, since this is missing:", *_table([_HEAD_MISSING, *rows]), *_now(here)]
    raise DatasetError("\n".join(lines))


def _row_of_missing(manifest: Manifest, name: str, fault: str) -> tuple[str, ...]:
    entry = manifest.dataset(name)
    states = published.states(manifest, name) if entry.preparation else []
    pair = {
        file.path: file.entry for s in states if s.traversal in (entry.query, entry.database) for file in s.originals
    }
    size = in_words(sum(entry.n_bytes for entry in pair.values()) or None)
    state = "missing" if ": no folder " in fault else "cannot be used"
    return name, state, size, entry.licence, how_to_get(manifest, name)


def _now(here: Sequence[str]) -> Iterator[str]:
    yield "what can run now:"
    width = max(len(command) for command, _ in _NOW)
    yield from (f"  {command.ljust(width)}  {what}" for command, what in _NOW)
    for name in here:
        yield f'  {name} is here: make reproduce SET=\'datasets=["{name}"] dataset="{name}"\''


def _table(rows: Sequence[tuple[str, ...]]) -> Iterator[str]:
    """Lines of a table with a head; long cells run on in lines of their own."""
    widths = (_WIDTHS[0], *_WIDTHS[7 - len(rows[0]) :])
    for number, row in enumerate(rows):
        cells = [
            textwrap.wrap(text, width, break_long_words=False, break_on_hyphens=False) or [""]
            for text, width in zip(row, widths, strict=True)
        ]
        for line in zip_longest(*cells, fillvalue=""):
            yield "  ".join(text.ljust(width) for text, width in zip(line, widths, strict=True)).rstrip()
        if number == 0:
            yield "  ".join("-" * width for width in widths)
