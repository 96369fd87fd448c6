"""Where what is extracted from a traversal by a method is stored, and under which keys."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from artifact import methods, store
from artifact.datasets.traversal import Traversal
from artifact.extraction import local_features
from artifact.extraction.parts import Parts, rows_each
from artifact.extraction.reading import ExtractionError
from artifact.manifest import Manifest
from artifact.manifest.entries import MethodEntry

PRECISIONS = ("float32", "bfloat16", "float16")
REVISION = 2  # raise when the same model and images would give other descriptors


def descriptor_key(images: str, method: str, entry: MethodEntry, precision: str = "float32") -> str:
    """Return the content key of descriptors: digest of the images in order, model, preprocessing, precision and revisions.

    Raises
    ------
    ExtractionError
        If the precision is none of :data:`PRECISIONS`.
    """
    if precision not in PRECISIONS:
        raise ExtractionError(f"precision {precision!r}: allowed are {', '.join(PRECISIONS)}")
    mixed = {} if precision == "float32" else {"precision": precision}
    return key_of_descriptors(images, methods.fingerprint(method, entry), **mixed)


def key_of_descriptors(images: str, model: Mapping[str, Any], **mixed: str) -> str:
    """Return the content key of descriptors from the digest of the images and the fingerprint of the model."""
    return store.key(stage="descriptors", revision=REVISION, images=images, model=model, **mixed)


def second_stage_key(traversal: Traversal, method: str, entry: MethodEntry, precision: str = "float32") -> str:
    """Return the content key of a traversal's local features or codes."""
    if method in traversal.second_stage:
        return traversal.second_stage[method].sha256
    return key_of_second_stage(descriptor_key(traversal.digest, method, entry, precision), entry)


def key_of_second_stage(descriptors: str, entry: MethodEntry) -> str:
    """Return the content key of local features or codes from that of the descriptors that they are made with."""
    layout = local_features.layout_of(entry)
    return store.key(
        stage="local features",
        revision=local_features.REVISION,
        descriptors=descriptors,
        layout=layout,
        # Once the images of a file: results that were made under these keys keep them.
        images_each=None if layout is None else max(1, min(1024, 2**28 // layout.image_bytes)),
    )


def stored_path(manifest: Manifest, method: str, key: str) -> Path:
    """Return the file that holds, or would hold, the descriptors of a key."""
    return manifest.cache / "descriptors" / method / f"{key[:24]}.npy"


@dataclass(frozen=True)
class Stored:
    """Where the outputs of one extraction are, or will be.

    Attributes
    ----------
    path, key
        The ``.npy`` file of all descriptors, which its sidecar ``.json`` completes, and their content key.
    parts
        The descriptors until all of them are there; gone afterwards.
    second
        Local features or codes of a two-stage method; else ``None``.
    """

    path: Path
    key: str
    parts: Parts
    second: Parts | None = None

    @property
    def is_complete(self) -> bool:
        """Whether all descriptors are there, in one file."""
        return self.path.exists() and self.path.with_suffix(".json").exists()

    @property
    def parts_folder(self) -> Path:
        """Folder of the parts of the descriptors, whatever batches they were made in."""
        return self.path.with_suffix(".parts")


def images_of_a_part(entry: MethodEntry, batch_size: int | None = None) -> int:
    """Return the images of a part of a method's descriptors, in batches of the method's own size or another."""
    layout = local_features.layout_of(entry)
    return rows_each(
        batch_size or entry.batch_size, 4 * entry.dimension + (0 if layout is None else layout.image_bytes)
    )


def stored(manifest: Manifest, traversal: Traversal, method: str, precision: str = "float32") -> Stored:
    """Return where the descriptors of a traversal by a method are stored, and its local features or codes.

    Parts hold whole batches, so another batch size gives other parts. Local features or codes that are complete in parts of
    another batch size are as good: they are returned then.
    """
    entry, layout = manifest.method(method), local_features.layout_of(manifest.method(method))

    def parts(folder: Path, key: str, batch_size: int, shape: tuple[int, ...], dtype: str) -> Parts:
        each = images_of_a_part(entry, batch_size)
        own = store.key(stage="parts", of=key, batch_size=batch_size, images_each=each)
        return Parts(folder / str(batch_size), own, each, len(traversal), shape, dtype)

    key = descriptor_key(traversal.digest, method, entry, precision)
    path = stored_path(manifest, method, key)
    found = Stored(path, key, parts(path.with_suffix(".parts"), key, entry.batch_size, (entry.dimension,), "float32"))
    if layout is None:
        return found
    second_key = second_stage_key(traversal, method, entry, precision)
    folder = manifest.cache / "local_features" / method / second_key[:24]
    sizes = [entry.batch_size, *(int(place.name) for place in sorted(folder.glob("*")) if place.name.isdigit())]
    sets = [parts(folder, second_key, size, layout.shape, layout.dtype) for size in sizes]
    return replace(found, second=next((one for one in sets if not one.missing()), sets[0]))
