"""The manifest: one typed, strict file that names every dataset, traversal, method and profile.

Everything that changes a number is data in ``data_manifest.yaml``, written once. A wrong key, type, path or
unit raises :class:`ManifestError`, which names the file, the line, the key path, the value found and the
values allowed.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

from artifact.manifest.entries import (
    DatasetEntry,
    Document,
    ManifestError,
    MethodEntry,
    ProfileEntry,
    TraversalEntry,
    quoted,
)
from artifact.manifest.faults import read
from artifact.manifest.layout import entry_of_folder

_Entry = TypeVar("_Entry")

DATA_ROOT_VARIABLE = "ARTIFACT_DATA_ROOT"
TYPED_IN = "ARTIFACT_TYPED_IN"
"""Environment variable with the folder that a command was typed in, for the notebooks that it runs."""

CACHE_VARIABLE = "ARTIFACT_CACHE"


@dataclass(frozen=True)
class Manifest:
    """A checked manifest: its entries by name, in the order of the file ``path``.

    Attributes
    ----------
    data_root
        Folder of the datasets: ``$ARTIFACT_DATA_ROOT``, else the manifest's ``data_root`` (relative to the manifest).
    relative_to
        Folder that paths of own datasets are relative to: the one that a command was typed in.
    results
        Stored results that were read or made with this manifest, in order: files in the cache, relative to it.
    """

    path: Path
    data_root: Path
    datasets: dict[str, DatasetEntry]
    methods: dict[str, MethodEntry]
    profiles: dict[str, ProfileEntry]
    relative_to: Path = field(default_factory=Path.cwd)
    results: list[str] = field(default_factory=list, compare=False, repr=False)

    @property
    def cache(self) -> Path:
        """Folder of stored results: ``$ARTIFACT_CACHE``, else ``.cache`` beside the manifest."""
        chosen = os.environ.get(CACHE_VARIABLE)
        return Path(chosen).expanduser().resolve() if chosen else self.path.parent / ".cache"

    def dataset(self, name: str) -> DatasetEntry:
        """Return the entry of a dataset that the manifest names, or that is a folder below ``relative_to``.

        Raises :class:`ManifestError` if it is neither, or as :func:`artifact.manifest.layout.entry_of_folder`.
        """
        if name in self.datasets:
            return self.datasets[name]
        folder = self.relative_to / Path(name).expanduser()
        if not folder.is_dir():
            raise ManifestError(
                f"{self.path}: no dataset {name!r}; the datasets are {quoted(self.datasets)}, "
                f"and {name!r} is no folder in {self.relative_to} either"
            )
        return entry_of_folder(folder)

    def method(self, name: str) -> MethodEntry:
        """Return one method entry, or raise :class:`ManifestError` with the names that exist."""
        return _lookup(self.methods, name, "method", self.path)

    def profile(self, name: str) -> ProfileEntry:
        """Return one profile entry, or raise :class:`ManifestError` with the names that exist."""
        return _lookup(self.profiles, name, "profile", self.path)

    def for_profile(self, name: str) -> Manifest:
        """Return the manifest as a profile sees it: with made descriptors in the place of images if it asks so."""
        profile = self.profile(name)
        if not profile.made:
            return self
        root = self.cache / "rehearsal"
        methods = {method: self.methods[method] for method in profile.methods}
        made = {dataset: _made(self.datasets[dataset], root / dataset, methods) for dataset in profile.datasets}
        return replace(self, datasets={**self.datasets, **made})


def _made(entry: DatasetEntry, root: Path, methods: dict[str, MethodEntry]) -> DatasetEntry:
    second = [name for name, method in methods.items() if method.rerank is not None]
    traversals = {
        name: TraversalEntry(
            condition=traversal.condition,
            positions_file=f"{name}.csv",
            descriptors={method: f"{name}-{method}.npy" for method in methods},
            second_stage={method: f"{name}-{method}-second.npy" for method in second},
        )
        for name, traversal in entry.traversals.items()
    }
    return entry.model_copy(update={"kind": "made", "root": str(root), "traversals": traversals})


def load(path: str | os.PathLike[str] | None = None) -> Manifest:
    """Read and check a manifest, by default the one that :func:`find` returns.

    Raises :class:`ManifestError` if the file is missing, is not YAML, repeats a key, or holds a key, type, value or name that
    is not allowed. All faults are listed at once.
    """
    path = find() if path is None else Path(path)
    if not path.is_file():
        raise ManifestError(f"{path}: no such file; the manifest is data_manifest.yaml at the top of the repository")
    document = read(path, Document)
    path, chosen = path.resolve(), os.environ.get(DATA_ROOT_VARIABLE)
    data_root = Path(chosen) if chosen else path.parent / Path(document.data_root).expanduser()
    data_root = data_root.expanduser().resolve()
    methods = {name: _with_folder(entry, data_root) for name, entry in document.methods.items()}
    return Manifest(path, data_root, document.datasets, methods, document.profiles)


def _with_folder(entry: MethodEntry, data_root: Path) -> MethodEntry:
    if entry.weights is None:
        return entry
    folder = data_root / Path(entry.weights.folder).expanduser()
    return entry.model_copy(update={"weights": entry.weights.model_copy(update={"folder": str(folder)})})


def find() -> Path:
    """Return the nearest ``data_manifest.yaml`` in the working folder or above, else the installed repository's.

    Raises :class:`ManifestError` if there is none.
    """
    folder = Path.cwd().resolve()
    repository = Path(__file__).resolve().parents[3]
    for candidate in (folder, *folder.parents, repository):
        if (candidate / "data_manifest.yaml").is_file():
            return candidate / "data_manifest.yaml"
    raise ManifestError(f"no data_manifest.yaml in {folder} or above it; run from inside the repository")


def refuse_code_from_elsewhere(manifest: Manifest) -> None:
    """Raise :class:`ManifestError` if a manifest names builders, which are code, and does not belong to this project.

    Those in the folder of the manifest that :func:`find` returns, or below it, belong to it.
    """
    builders = [f"methods.{name}: {entry.builder}" for name, entry in manifest.methods.items() if entry.builder]
    own = find().resolve().parent if builders else None
    if own is not None and not manifest.path.is_relative_to(own):
        raise ManifestError(
            f"{manifest.path}: names code that a run would execute ({', '.join(builders)}), and is not of the project in "
            f"{own}; read that code, then add --trust to run it"
        )


def _lookup(entries: dict[str, _Entry], name: str, kind: str, path: Path) -> _Entry:
    if name not in entries:
        raise ManifestError(f"{path}: no {kind} {name!r}; the {kind}s are {quoted(entries)}")
    return entries[name]
