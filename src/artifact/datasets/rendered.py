"""Rendered traversals in the cache: made once for each content of their description."""

from __future__ import annotations

import shutil
from dataclasses import fields
from pathlib import Path
from typing import Any

from tqdm import tqdm

from artifact import store
from artifact.datasets.traversal import DatasetError


def render(description: dict[str, Any], cache: Path, label: str) -> dict[str, str]:
    """Render a traversal if its images and positions are not in the cache; return the SHA-256 of each of its files.

    ``description`` is the key ``render`` of the manifest: the fields of :class:`artifact_city.CityTraversal`; ``label``
    is for messages. Raises ``DatasetError`` if it has unknown or impossible values.
    """
    import artifact_city

    traversal, folder = _described(description, label), rendered_folder(description, cache, label)
    with store.lock(folder):
        record = store.find(folder, cache=cache)
        if record is None:
            unfinished = folder.with_suffix(".unfinished")
            shutil.rmtree(unfinished, ignore_errors=True)
            with tqdm(total=traversal.frames, unit="image", desc=f"render {label}", disable=None, leave=False) as bar:
                try:
                    with store.stage("render"), store.writing(folder):
                        artifact_city.render(traversal, unfinished, progress=lambda done: bar.update(done - bar.n))
                except ValueError as error:
                    raise DatasetError(f"{label}: {error}") from None
            record = store.seal(unfinished, {"dataset": label.partition("/")[0], "traversal": label.partition("/")[2]})
            shutil.rmtree(folder, ignore_errors=True)  # one without a record
            unfinished.replace(folder)
    return record["sha256"]


def rendered_folder(description: dict[str, Any], cache: Path, label: str) -> Path:
    """Return the folder that holds the images of a rendered traversal once they are all there."""
    from artifact_city import CITY_REVISION

    described = _described(description, label)
    return cache / "city" / store.key(stage="city", revision=CITY_REVISION, traversal=described)[:24]


def _described(description: dict[str, Any], label: str) -> Any:
    from artifact_city import CityTraversal

    allowed = [field.name for field in fields(CityTraversal)]
    unknown = [name for name in description if name not in allowed]
    if unknown:
        raise DatasetError(f"{label}: unknown key {unknown[0]!r} of render; allowed: {', '.join(allowed)}")
    try:
        return CityTraversal(**description)
    except (TypeError, ValueError) as error:
        raise DatasetError(f"{label}: render: {error}") from None
