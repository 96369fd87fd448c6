"""What the preparation of all datasets shares: from published files to a folder with index and sidecar, or nothing.

The files are written into a working folder beside the traversal's own, whose name holds the key of sources and
parameters. A run that was killed goes on there; the folder gets the traversal's name when everything in it was checked.
"""

from __future__ import annotations

import csv
import io
import os
import shutil
from collections.abc import Callable, Iterable, Mapping
from datetime import UTC, datetime
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
from PIL import Image
from pydantic import BaseModel, ValidationError
from tqdm import tqdm

from artifact import store
from artifact.datasets.folder import natural_order
from artifact.datasets.images import UnreadableImageError, evenly_spaced, modes_and_sizes, read_image
from artifact.datasets.positions import names_in_csv
from artifact.datasets.prepared import INDEX_FILE, SIDECAR_FILE, digests_of_images
from artifact.datasets.published.archives import members, require_room
from artifact.datasets.traversal import DatasetError
from artifact.manifest.entries import DatasetEntry

_REVISION = 1  # of all recipes; raised when what they write changes
_DECODED = 25  # images of a traversal that are decoded wholly to check them


Position = tuple[float, ...]
"""x and y in metres, or one index."""


class Parameters(BaseModel, extra="forbid", frozen=True):
    """Parameters of a recipe; the fields are those that the manifest and ``SET=…`` may name."""


class Kept(NamedTuple):
    """An image of a prepared traversal: file name, what it is called in the published files, position, content.

    ``content`` is asked for at once, before the next image is made.
    """

    name: str
    original: str
    position: Position
    content: Callable[[], bytes]


class Sources(NamedTuple):
    """What a recipe works with: the traversal, its published files by name, parameters, and a folder for large files."""

    entry: DatasetEntry
    traversal: str
    paths: Mapping[str, Path]
    parameters: Any
    scratch: Path = Path()

    def named(self, *endings: str) -> list[Path]:
        """Return the published files whose names end so, in order."""
        return [path for name, path in sorted(self.paths.items()) if name.endswith(endings)]


class Plan(NamedTuple):
    """The images that a recipe will make: about how many and how many bytes, and what it found, by name.

    ``found`` may be added to while the images are made.
    """

    images: Iterable[Kept]
    number: int
    size: int
    found: dict[str, Any]


def as_published(path: Path, sizes: dict[str, int], wanted: dict[str, tuple[str, Position]], **found: Any) -> Plan:
    """Plan to keep images of an archive as they are.

    ``sizes`` has the bytes of its files by name, ``wanted`` the new name and the position of each image.
    """
    kept = (Kept(wanted[m.name][0], m.name, wanted[m.name][1], m.read) for m in members(path) if m.name in wanted)
    return Plan(kept, len(wanted), sum(sizes[name] for name in wanted), found)


def recipe_of(entry: DatasetEntry) -> ModuleType:
    """Return the module of a dataset's recipe: it has ``plan``, and ``Parameters`` if there are any."""
    return import_module(f"artifact.datasets.published.{entry.preparation.recipe}")


def parameters_of(dataset: str, entry: DatasetEntry, given: Mapping[str, Any]) -> Any:
    """Return the parameters of a dataset's recipe: its own, then the manifest's, then those given.

    Raises ``DatasetError`` with the allowed ones if one is unknown or has a value that is not allowed.
    """
    model = getattr(recipe_of(entry), "Parameters", Parameters)
    try:
        return model(**{**entry.preparation.parameters, **given})
    except ValidationError as error:
        fault = error.errors()[0]
        name = ".".join(map(str, fault["loc"]))
        raise DatasetError(
            f"{dataset}: preparation parameter {name}: found {fault['input']!r}; {fault['msg'][0].lower()}{fault['msg'][1:]}; "
            f"the parameters are {', '.join(model.model_fields) or 'none'}"
        ) from None


def prepare(folder: Path, label: str, sources: Sources, digests: list[dict[str, Any]]) -> dict[str, Any]:
    """Write a traversal into ``folder``, replacing what was prepared there before; return its sidecar.

    ``digests`` describe the published files. Raises ``DatasetError`` if they are not what they should be, or the disk is
    full; ``folder`` is then as it was, and what is written already serves the next call.
    """
    inputs = {
        "dataset": label.partition("/")[0],
        "traversal": sources.traversal,
        "recipe": sources.entry.preparation.recipe,
        "revision": _REVISION,
        "parameters": sources.parameters.model_dump(),
        "sources": digests,
    }
    work = folder.with_name(f".{folder.name}.{store.key(**inputs)[:12]}.preparing")
    try:
        sources = sources._replace(scratch=work.with_name(f"{work.name}.scratch"))
        for left in folder.parent.glob(f".{folder.name}.*.preparing*"):  # of other files or parameters
            if left not in (work, sources.scratch):
                shutil.rmtree(left, ignore_errors=True)
        for made in (work, sources.scratch):
            made.mkdir(parents=True, exist_ok=True)
        plan = recipe_of(sources.entry).plan(sources)
        _write(work, label, plan, sources)
        names = _check_images(work, label)
        sidecar = {
            **inputs,
            "found": plan.found,
            "images": store.key(images=list(zip(names, digests_of_images(work, names), strict=True))),
            "index": store.digest_of_file(work / INDEX_FILE),
            "number": len(names),
            "date": f"{datetime.now(UTC):%Y-%m-%d}",
            "versions": {name: version(name) for name in ("artifact", "numpy", "pillow")},
        }
        store.write_json(work / SIDECAR_FILE, sidecar)
        _put_in_place(work, folder)
    except OSError as error:
        where = error.filename or work
        raise DatasetError(
            f"cannot write {where} ({error.strerror or error}); free some room or make it writable and run the same command "
            f"again: it goes on from what is there"
        ) from None
    shutil.rmtree(sources.scratch, ignore_errors=True)
    return sidecar


def _write(work: Path, label: str, plan: Plan, sources: Sources) -> None:
    """Write the images that are not there yet, then the index."""
    require_room(work, plan.size - sum(path.stat().st_size for path in work.iterdir()))
    rows: dict[str, tuple[str, Position]] = {}
    bar = tqdm(plan.images, total=plan.number, unit="image", desc=f"prepare {label}", leave=False, disable=None)
    for image in bar:
        if image.name in rows:
            raise DatasetError(f"{label}: two images {image.name!r} ({rows[image.name][0]}, {image.original})")
        rows[image.name] = image.original, image.position
        if not (work / image.name).exists():
            _write_whole(work / image.name, image.content())
    if not rows:
        raise DatasetError(f"{label}: no image is left{in_words(plan.found)}")
    condition = sources.entry.traversals[sources.traversal].condition
    axes = ("x", "y") if len(next(iter(rows.values()))[1]) > 1 else ("index",)
    with store.replacing(work / INDEX_FILE) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(["image", *axes, "condition", "traversal", "original"])
        for name in sorted(rows, key=natural_order):
            original, position = rows[name]
            writer.writerow([name, *position, condition, sources.traversal, original])


def _write_whole(path: Path, content: bytes) -> None:
    partial = path.with_name(f".{path.name}.part")
    partial.write_bytes(content)
    partial.replace(path)


def _check_images(work: Path, label: str) -> list[str]:
    """Return the names in the index after checking each image: all headers, and some images wholly."""
    names = names_in_csv(work / INDEX_FILE)
    for left in {path.name for path in work.iterdir()} - {*names, INDEX_FILE}:
        (work / left).unlink()  # of a run that was killed
    try:
        modes_and_sizes([work / name for name in names])
        for index in evenly_spaced(len(names), _DECODED):
            read_image(work / names[index])
    except UnreadableImageError as error:
        shutil.rmtree(work)  # if it is a machine that went down, and no published image, the next run makes it right
        raise DatasetError(
            f"{label}: an image of the published files cannot be used: {error}; run again, and if that does not help get the "
            f"files again"
        ) from None
    return names


def _put_in_place(work: Path, folder: Path) -> None:
    """Give a complete folder its name; one that was prepared before makes room for it."""
    if hasattr(os, "sync"):
        os.sync()
    earlier = folder.with_name(f".{folder.name}.earlier")
    shutil.rmtree(earlier, ignore_errors=True)
    if folder.exists():
        folder.rename(earlier)
    work.rename(folder)
    shutil.rmtree(earlier, ignore_errors=True)


def as_png(pixels: np.ndarray) -> bytes:
    """Return an RGB image ``(h, w, 3)`` uint8 as the bytes of a PNG file."""
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, "PNG", compress_level=3)
    return stream.getvalue()


def optional(module: str, package: str) -> Any:
    """Import a module of the extra ``datasets``, or raise ``DatasetError`` that says how to install it."""
    try:
        return import_module(module)
    except ImportError as error:
        raise DatasetError(
            f"this dataset is prepared with the Python package {package} ({error}); install it: "
            f"python -m pip install 'artifact[datasets]'"
        ) from None


def in_words(found: Mapping[str, Any]) -> str:
    """Write what a recipe found for people, with a comma before each.

    Examples
    --------
    >>> in_words({"frames": 3, "frames_without_pose": 1})
    ', frames: 3, frames without pose: 1'
    """
    return "".join(f", {name.replace('_', ' ')}: {value}" for name, value in found.items())
