"""The paper's datasets from the files that their owners publish: obtain, prepare, verify.

Each dataset has a module of its own that reads its published form, a *recipe*; :mod:`.preparation` is what they share.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from tqdm import tqdm

from artifact import datasets, store
from artifact.datasets import prepared
from artifact.datasets.published import originals, preparation
from artifact.datasets.published.originals import MissingFilesError, Original
from artifact.datasets.published.preparation import Sources
from artifact.datasets.traversal import DatasetError
from artifact.manifest import Manifest
from artifact.manifest.entries import DatasetEntry, ManifestError, quoted


@dataclass(frozen=True)
class State:
    """Where a traversal of a published dataset stands.

    ``status`` is ``"verified"`` (prepared, and its images and index are as they were written), ``"present"`` (a folder made
    by hand), ``"missing"`` or ``"changed"``; ``detail`` says in words why it cannot be used. ``originals`` are the published
    files that it is prepared from.
    """

    traversal: str
    status: Literal["verified", "present", "missing", "changed"]
    images: int | None
    detail: str
    originals: tuple[Original, ...]


def entry_of(manifest: Manifest, dataset: str) -> DatasetEntry:
    """Return the entry of a dataset that is prepared from published files, or raise ``ManifestError`` if it is not."""
    entry = manifest.dataset(dataset)
    if entry.preparation is None:
        known = quoted(name for name, one in manifest.datasets.items() if one.preparation)
        raise ManifestError(f"{dataset}: is not prepared from published files; those that are: {known}")
    return entry


def states(manifest: Manifest, dataset: str) -> list[State]:
    """Return where each traversal of a published dataset stands; unless a cache remembers them, all images are read."""
    entry = entry_of(manifest, dataset)
    parameters = preparation.parameters_of(dataset, entry, {}).model_dump()
    return [_state(manifest, dataset, name, parameters) for name in entry.traversals]


def _state(manifest: Manifest, dataset: str, name: str, parameters: Mapping[str, Any]) -> State:
    files = tuple(originals.needed(manifest, dataset, [name], parameters))
    folder = datasets.image_folder(manifest, dataset, name)
    if not folder.is_dir():
        return State(name, "missing", None, "", files)
    try:
        images = len(datasets.load_traversal(manifest, dataset, name))
    except (DatasetError, ManifestError) as error:
        return State(name, "changed", None, str(error), files)
    return State(name, "verified" if prepared.is_prepared(folder) else "present", images, "", files)


def obtain(
    manifest: Manifest,
    dataset: str,
    traversals: Sequence[str] = (),
    given: Mapping[str, Any] | None = None,
) -> Iterator[str]:
    """Make traversals of a published dataset ready, by default all; yield a line on each step.

    What is prepared and unchanged stays, unless ``given`` names parameters that differ from those it was prepared with.
    Published files that are not here are downloaded where they have an address. Raises ``DatasetError`` after everything
    that could be done, with all that is missing or wrong, and what to do about each.
    """
    entry, given = entry_of(manifest, dataset), given or {}
    if unknown := [name for name in traversals if name not in entry.traversals]:
        raise ManifestError(f"{dataset}: no traversal {unknown[0]!r}; the traversals are {quoted(entry.traversals)}")
    parameters = preparation.parameters_of(dataset, entry, given)
    yield f"{entry.title}: licence: {entry.licence}{f'; cite {entry.citation}' if entry.citation else ''}"
    faults: list[DatasetError] = []
    for name in traversals or entry.traversals:
        try:
            yield from _obtain_one(manifest, dataset, name, parameters, given)
        except DatasetError as error:
            faults.append(error)
    if faults:
        how = how_to_obtain(manifest, dataset) if any(isinstance(one, MissingFilesError) for one in faults) else []
        raise DatasetError("\n".join([*map(str, faults), *how]))


def how_to_obtain(manifest: Manifest, dataset: str) -> list[str]:
    """Return the steps that bring the published files of a dataset, a line each."""
    entry, folder = entry_of(manifest, dataset), originals.downloads(manifest, dataset)
    parameters = preparation.parameters_of(dataset, entry, {}).model_dump()
    names = {file.path.name for file in originals.needed(manifest, dataset, list(entry.traversals), parameters)}
    there = {path.name for path in folder.glob("[!.]*")}
    others = sorted(name for name in there - names if not name.endswith(".lock.json"))
    return [
        f"how to get {entry.title}:",
        *(f"  from {source.url} {source.note}".rstrip() for source in entry.sources),
        *([f"  {entry.obtain.strip()}"] if entry.obtain else []),
        f"  put the files as they are into {folder}",
        *([f"  it holds {', '.join(others)} too: if one of these is meant, give it its name"] if others else []),
        f"  then: make data DATASET={dataset}",
    ]


def _obtain_one(
    manifest: Manifest, dataset: str, name: str, parameters: Any, given: Mapping[str, Any]
) -> Iterator[str]:
    label, folder = f"{dataset}/{name}", datasets.image_folder(manifest, dataset, name)

    def is_ready() -> bool:
        """Whether the folder is there, and was not prepared with other parameters than those asked for."""
        if not (given and prepared.is_prepared(folder)):
            return folder.is_dir()
        made, asked = prepared.read_sidecar(folder)["parameters"], parameters.model_dump(mode="json")
        return all(made.get(key) == asked[key] for key in given)

    if is_ready():
        found = datasets.load_traversal(manifest, dataset, name)
        how = "prepared, verified" if prepared.is_prepared(folder) else "a folder made by hand, used as it is"
        yield f"{label}: {len(found):,} images, {how}: {folder}"
        return
    files = originals.needed(manifest, dataset, [name], parameters.model_dump())
    with store.lock(folder):
        if is_ready():  # another process was faster
            yield f"{label}: prepared meanwhile: {folder}"
            return
        originals.fetch(files, label)
        bar = tqdm(files, unit="file", desc=f"check {label}", leave=False, disable=None)
        digests = [originals.digest(file, manifest.cache) for file in bar]
        paths = {file.path.name: file.path for file in files}
        sources = Sources(manifest.dataset(dataset), name, paths, parameters)
        record = preparation.prepare(folder, label, sources, digests)
        for file, found in zip(files, digests, strict=True):
            originals.write_lock(file, found)
    yield f"{label}: {record['number']:,} images prepared{preparation.in_words(record['found'])}: {folder}"
