"""The published files of a dataset: which are needed, whether they are here and unchanged, and how they come here.

They lie in ``downloads/<dataset>`` below the data root, where a download or a person puts them. Nobody publishes their
checksums, so the lock file ``NAME.lock.json`` beside each records size and SHA-256 when a traversal was first prepared
from it; any later difference is an error.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby, product
from pathlib import Path
from typing import Any, NamedTuple

from artifact import store
from artifact.datasets import download, lock_file
from artifact.datasets.disk import in_words
from artifact.datasets.published import archives
from artifact.datasets.traversal import DatasetError
from artifact.manifest import Manifest
from artifact.manifest.entries import PublishedFile


class MissingFilesError(DatasetError):
    """Published files that are not here; the message names them and says how to get them."""


class Original(NamedTuple):
    """A published file, and where it lies or would lie."""

    path: Path
    entry: PublishedFile


def downloads(manifest: Manifest, dataset: str) -> Path:
    """Return the folder that holds, or would hold, the published files of a dataset."""
    return manifest.data_root / "downloads" / (manifest.dataset(dataset).root or dataset)


def needed(manifest: Manifest, dataset: str, traversals: Sequence[str], parameters: dict[str, Any]) -> list[Original]:
    """Return the published files that traversals are prepared from with these parameters, each once."""
    entry, folder = manifest.dataset(dataset), downloads(manifest, dataset)
    found: dict[str, Original] = {}
    for traversal, file in product(traversals, entry.preparation.files):
        serves = all(parameters.get(name) in allowed for name, allowed in file.when.items())
        if serves and traversal in (file.traversals or entry.traversals):
            for part in range(1, (file.parts or 1) + 1):
                name = file.file.format(traversal=traversal, part=part)
                found.setdefault(name, Original(folder / name, file))
    return list(found.values())


def fetch(files: Sequence[Original], label: str) -> None:
    """Download the published files that are not here, going on from what has arrived.

    Raises :class:`MissingFilesError` if some have no address, or none that gives a whole file; it says how to do it by hand.
    """
    missing = [file for file in files if not file.path.exists()]
    faults = []
    if by_hand := [file for file in missing if not file.entry.urls]:
        names = ", ".join(_names(by_hand))
        size = in_words(sum(file.entry.n_bytes for file in by_hand) or None)
        folder = by_hand[0].path.parent
        faults.append(f"{label}: {len(by_hand)} of {len(files)} published files are not in {folder} ({size}): {names}")
    for file in missing:
        if file.entry.urls:
            try:
                _download(file)
            except download.DownloadError as error:
                size = in_words(file.entry.n_bytes or None)
                faults.append(
                    f"{label}: {file.path.name} could not be downloaded\n{error}\n  by hand: open {file.entry.urls[0]} in a "
                    f"browser, save the file ({size}) as {file.path} and run the same command again"
                )
    if faults:
        raise MissingFilesError("\n".join(faults))


def _names(files: Sequence[Original]) -> Iterator[str]:
    """Names of files; parts that follow each other as the first and the last."""
    for _, group in groupby(files, key=lambda file: id(file.entry)):
        same = list(group)
        whole = len(same) > 2 and same[0].entry.parts == len(same)
        yield from [f"{same[0].path.name} to {same[-1].path.name}"] if whole else (file.path.name for file in same)


def _download(file: Original) -> None:
    path, entry = file

    def accept(partial: Path) -> None:
        try:
            if path.suffix in (".zip", ".tar", ".gz"):
                next(archives.members(partial), None)
        except DatasetError as error:
            raise download.DownloadError(str(error)) from None

    sha256 = entry.sha256 or _locked(path).get("sha256")
    with store.lock(path):
        download.retrieve(entry.urls, path, sha256=sha256, size=entry.size, accept=accept)


def digest(original: Original, cache: Path | None) -> dict[str, Any]:
    """Return name, size and SHA-256 of a published file that is here and unchanged.

    Raises ``DatasetError`` if it is not what the manifest or its lock file says.
    """
    path, entry = original
    found = {"file": path.name, "size": path.stat().st_size, "sha256": store.digest_of_files([path], cache)[0]}
    for key, expected in (("size", entry.size), ("sha256", entry.sha256)):
        if expected not in (None, found[key]):
            raise DatasetError(
                f"{path}: its {key} is {found[key]}, that of the published file {expected}; delete it and get it again"
            )
    locked = _locked(path)
    if locked and locked["sha256"] != found["sha256"]:
        raise DatasetError(
            f"{path}: its SHA-256 is {found['sha256']}, but {locked['sha256']} was recorded on {locked['date']}; bring the "
            f"earlier file back or, if the change is meant, delete {lock_file.path_of(path).name}"
        )
    return found


def write_lock(original: Original, found: Mapping[str, Any]) -> None:
    """Record a published file that a traversal was prepared from, if it is not recorded yet."""
    if not lock_file.path_of(original.path).exists():
        lock_file.write(original.path, found)


def _locked(path: Path) -> dict[str, Any]:
    """Return what the lock file of a published file records, nothing if there is none."""
    there = lock_file.path_of(path).exists()
    return lock_file.read(path, ("size", "sha256", "date"), DatasetError) if there else {}
