"""Rendered traversals in the cache: made once for each content of their description."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any

from tqdm import tqdm

from artifact import store
from artifact.datasets.traversal import DatasetError


def rendered(render: dict[str, Any], cache: Path, label: str, *, progress: bool = True) -> Path:
    """Return the folder with the images and positions of a rendered traversal, rendering it if it is not there.

    Parameters
    ----------
    render
        The key ``render`` of the manifest: the fields of :class:`artifact_city.CityTraversal`.
    cache
        Folder of stored results.
    label
        Name for messages and the progress bar.
    progress
        Whether to show a progress bar.

    Raises
    ------
    DatasetError
        If the description has unknown or impossible values.
    """
    import artifact_city

    traversal = _described(render, label)
    folder = _folder(traversal, cache)
    with store.lock(folder):
        if not folder.is_dir():
            with tqdm(
                total=traversal.frames,
                unit="image",
                desc=f"render {label}",
                disable=None if progress else True,
                leave=False,
            ) as bar:
                try:
                    artifact_city.render(traversal, folder, progress=lambda done: bar.update(done - bar.n))
                except ValueError as error:
                    raise DatasetError(f"{label}: {error}") from None
    return folder


def is_rendered(render: dict[str, Any], cache: Path, label: str) -> bool:
    """Whether the images are there already."""
    return _folder(_described(render, label), cache).is_dir()


def _described(render: dict[str, Any], label: str) -> Any:
    from artifact_city import CityTraversal

    allowed = [field.name for field in fields(CityTraversal)]
    unknown = [name for name in render if name not in allowed]
    if unknown:
        raise DatasetError(f"{label}: unknown key {unknown[0]!r} of render; allowed: {', '.join(allowed)}")
    try:
        return CityTraversal(**render)
    except (TypeError, ValueError) as error:
        raise DatasetError(f"{label}: render: {error}") from None


def _folder(traversal: Any, cache: Path) -> Path:
    from artifact_city import CITY_REVISION

    return cache / "city" / store.key(stage="city", revision=CITY_REVISION, traversal=traversal)[:24]
