"""``artifact data add``: folders of images to a described dataset, after a look at them."""

from __future__ import annotations

import argparse
import os
import re
from collections.abc import Iterator
from dataclasses import replace
from itertools import cycle
from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError

from artifact import pages, store, studies
from artifact.datasets import DatasetError
from artifact.datasets.arrays import read_threshold
from artifact.manifest import Manifest
from artifact.manifest.entries import DatasetEntry
from artifact.manifest.layout import DESCRIPTION, POSITIONS_FILE, has_index, positions_source
from artifact.pages import galleries
from artifact.studies.preview import Preview

PREVIEW = "preview.html"


def run(manifest: Manifest, options: argparse.Namespace) -> Iterator[str]:
    """Describe a dataset in ``NAME/dataset.yaml``, look at it, and yield what is found, one line at a time.

    Nothing is written with ``--dry-run``, and nothing if the dataset cannot be used.

    Raises
    ------
    DatasetError
        If folders or positions do not fit, or ``NAME`` holds another description already.
    """
    folder = Path(options.name).expanduser().resolve()
    description = describe(folder, options)
    traversals = {name: _relative_to(folder, part) for name, part in description["traversals"].items()}
    text = yaml.safe_dump({**description, "traversals": traversals}, sort_keys=False, allow_unicode=True)
    target = folder / DESCRIPTION
    if target.is_file() and target.read_text(encoding="utf-8") != text:
        raise DatasetError(f"{target}: is there already and says something else; delete it or choose another name")
    try:
        entry = DatasetEntry.model_validate({**description, "root": str(folder)})
    except ValidationError as error:
        raise DatasetError(f"{options.name}: {error.errors()[0]['msg']}") from None
    known = replace(manifest, datasets={**manifest.datasets, options.name: entry})
    preview = studies.preview.look_at(known, options.name)
    yield from preview.lines()
    if not preview.facts["evaluated"]:
        raise DatasetError(f"{options.name}: no query has a positive; check the positions and --threshold")
    if options.dry_run:
        yield "nothing was written (--dry-run)"
        return
    for name, content in ((DESCRIPTION, text), (PREVIEW, _page(preview))):
        with store.replacing(folder / name) as temporary:
            temporary.write_text(content, encoding="utf-8")
    here = Path.cwd()
    shown = folder.relative_to(here) if folder.is_relative_to(here) else folder
    yield f"{shown}/{DESCRIPTION} and {shown}/{PREVIEW} written; next:"
    yield f'  make reproduce SET=\'datasets=["{shown}"] dataset="{shown}"\''
    yield f"  .venv/bin/python -m artifact evaluate --datasets {shown}"


def describe(folder: Path, options: argparse.Namespace) -> dict[str, Any]:
    """Return the description of a dataset: the keys of a manifest entry, with absolute paths."""
    parts = _parts(options)
    query, database, *further = parts
    sources = _sources(parts, options)
    threshold = read_threshold(options.threshold) if options.threshold else _default_threshold(parts, sources)
    traversals = {}
    for name, images in parts.items():
        source, file = sources[name]
        traversals[name] = {"condition": images.name, "images": str(images), "positions": source}
        if file is not None:
            traversals[name]["positions_file"] = str(file)
    description = {
        "title": folder.name,
        "kind": "folder",
        "threshold": {"value": threshold.value, "unit": threshold.unit},
        "query": query,
        "database": database,
        "shift": f"{query}→{database}",
        "traversals": traversals,
    }
    return description | ({"distractor_traversals": further} if further else {})


def _relative_to(folder: Path, part: dict[str, str]) -> dict[str, str]:
    """A traversal with paths relative to the folder of the description, so that all may move together."""
    return {key: os.path.relpath(value, folder) if Path(value).is_absolute() else value for key, value in part.items()}


def _parts(options: argparse.Namespace) -> dict[str, Path]:
    """Folders of images by traversal: the query, the database, then the others."""
    asked = [("query", options.query), ("database", options.database)]
    asked += [("traversal", text) for text in options.traversal]
    names, folders = [], []
    for role, text in asked:
        name, equals, path = text.partition("=")
        images = Path(path if equals else text).expanduser().resolve()
        if not images.is_dir():
            raise DatasetError(f"--{role} {text}: no folder {images}")
        if role == "traversal" and not equals:
            raise DatasetError(f"--traversal {text}: allowed: NAME=DIR, for example rain=photos/rain")
        names.append(re.sub(r"[^A-Za-z0-9_.,+-]+", "_", name if equals else images.name).lstrip("_.,+-"))
        folders.append(images)
    if names[0] == names[1] or not all(names[:2]):
        names[:2] = ["query", "database"]
    if len(set(names)) != len(names) or not all(names):
        raise DatasetError(f"the traversals are named {', '.join(names)}; every name must be there once")
    return dict(zip(names, folders, strict=True))


def _sources(parts: dict[str, Path], options: argparse.Namespace) -> dict[str, tuple[str, Path | None]]:
    """Where the positions of each traversal come from, and the file if it is not in the folder."""
    if options.positions:
        files = [Path(file).expanduser().resolve() for file in options.positions]
        missing = next((file for file in files if not file.is_file()), None)
        if missing or len(files) not in (1, len(parts)):
            fault = f"no file {missing}" if missing else f"{len(files)} files for {len(parts)} traversals"
            raise DatasetError(f"--positions: {fault}; allowed: one CSV for all, or one for each in their order")
        return {name: ("csv", file) for name, file in zip(parts, cycle(files), strict=False)}
    if options.names or options.order:
        return dict.fromkeys(parts, ("names" if options.names else "order", None))
    return {name: (positions_source(images), None) for name, images in parts.items()}


def _default_threshold(parts: dict[str, Path], sources: dict[str, tuple[str, Path | None]]) -> Any:
    """25 m where positions are in metres, one frame where they are indices."""
    name, images = next(iter(parts.items()))
    source, file = sources[name]
    frames = source == "order" or (source == "csv" and has_index(file or images / POSITIONS_FILE))
    return read_threshold("1frame" if frames else "25m")


def _page(preview: Preview) -> str:
    """The preview as one HTML file that needs nothing else."""
    dataset = preview.dataset
    pages.style.use_style()
    parts = [
        pages.preview.facts(preview.facts, preview.remarks),
        pages.preview.traversals_table(preview.traversals, dataset.unit),
        pages.preview.positions_figure(dataset),
        galleries.contact_sheet(dataset),
    ]
    head = pages.common.markup(
        "<!doctype html><html lang=en><meta charset=utf-8><meta name=viewport content='width=device-width'>"
        "<title>{}</title><style>body{{font-family:sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem}}"
        "</style>{}<h1>{}</h1>",
        *(dataset.title, pages.style.page_style(), dataset.title),
    )
    return pages.common.join([head, *parts]).data
