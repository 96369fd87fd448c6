"""Traversals that an imported results bundle records: names, positions and digests of descriptors, without any values.

``<cache>/imported/<profile>/`` holds ``bundle.json``, the :class:`Bundle`, and ``traversals/<dataset>/<traversal>.json``, a
:class:`TraversalRecord` each. While they are there, what a bundle records is not computed anew; deleting the folder ends that.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from artifact import store
from artifact.datasets.traversal import Given, Traversal
from artifact.manifest import Manifest
from artifact.manifest.entries import Name

FORMAT = 1  # raise when a bundle of this code could not be read by an earlier one
FOLDER = "imported"

Digest = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
_Line = Annotated[str, Field(max_length=500, pattern=r"^[^\x00-\x1f\x7f]*$")]
_Number = Annotated[float, Field(allow_inf_nan=False)]


class _Record(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Sidecar(_Record):
    """What is kept of the record beside descriptors: number and width, and what made them in which time."""

    shape: tuple[int, int]
    device: _Line = "–"
    torch: _Line = "–"
    machine: _Line = "–"
    seconds: _Number = 0.0
    forward_seconds: _Number = 0.0


class DescriptorRecord(_Record):
    """Descriptors of a traversal by a method; ``second`` is the content key of local features or codes."""

    key: Digest
    sha256: Digest
    source: Literal["images", "shipped descriptors", "given descriptors"]
    sidecar: Sidecar
    second: Digest | None = None


class TraversalRecord(_Record):
    """A :class:`~artifact.datasets.Traversal` with the descriptors of each method, as they are recorded."""

    kind: Literal["folder", "city", "made"]
    condition: _Line
    digest: Digest
    image_names: list[_Line]
    positions: list[list[_Number]]
    descriptors: dict[Name, DescriptorRecord]


class File(_Record):
    """Size in bytes and SHA-256 of a file of a bundle."""

    size: int = Field(ge=0)
    sha256: Digest


class Bundle(_Record):
    """What a results bundle is: its date, profile, the code that made it, and its files.

    ``revisions`` are those of all code stages and of the libraries that decide a result, ``weights`` the digests of the files
    of weights of each method.
    """

    format: int
    date: str = Field(pattern=r"^\d{4}-\d\d-\d\d$")
    profile: Name
    code: _Line
    revisions: dict[_Line, int | _Line]
    datasets: list[Name]
    weights: dict[Name, list[Digest | None]]
    files: dict[_Line, File]


def folder_of(manifest: Manifest, profile: str) -> Path:
    """Return the folder of what was imported for a profile."""
    return manifest.cache / FOLDER / profile


def read_record(path: Path, kind: type[BaseModel]) -> Any:
    """Read a record, or raise ``StoreError`` that names the file, the first fault and its place."""
    try:
        return kind.model_validate_json(path.read_bytes())
    except OSError as error:
        raise store.StoreError(f"{path}: cannot be read ({error})") from None
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        raise store.StoreError(f"{path}: {where or 'the file'}: {first['msg']}") from None


def bundles(manifest: Manifest) -> Iterator[Bundle]:
    """Yield the imported bundles."""
    for path in sorted((manifest.cache / FOLDER).glob("[!.]*/bundle.json")):
        yield read_record(path, Bundle)


def traversal(manifest: Manifest, dataset: str, name: str) -> Traversal | None:
    """Return a traversal as imported bundles record it, all of its methods together; ``None`` if none does."""
    if dataset not in manifest.datasets:
        return None
    entry, found = manifest.datasets[dataset], []
    for bundle in sorted((manifest.cache / FOLDER).glob("[!.]*/bundle.json")):
        path = bundle.parent / "traversals" / dataset / f"{name}.json"
        if path.exists():
            record = read_record(path, TraversalRecord)
            same = (record.kind, record.condition) == (entry.kind, entry.traversals[name].condition)
            if same and (not found or found[0].digest == record.digest):
                found.append(record)
    if not found:
        return None
    recorded = [described for record in found for described in record.descriptors.items()]
    return Traversal(
        dataset,
        name,
        found[-1].condition,
        tuple(found[-1].image_names),
        np.array(found[-1].positions, np.float64),
        found[-1].digest,
        descriptors={method: Given(None, one.sha256, one.model_dump()) for method, one in recorded},
        second_stage={method: Given(None, one.second) for method, one in recorded if one.second},
    )
