"""Traversals that were prepared from published files: a folder of images with its index and its sidecar.

The index ``images.csv`` lists the images in order with their positions and what they were called in the published files.
The sidecar ``prepared.json`` records the sources and parameters that made them, and digests of index and images. A folder
gets its name only when both are in it and everything was checked, so a folder with a sidecar is complete.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from artifact import store
from artifact.datasets.positions import names_in_csv, positions_from_csv
from artifact.datasets.traversal import DatasetError

INDEX_FILE = "images.csv"
SIDECAR_FILE = "prepared.json"


def is_prepared(folder: Path) -> bool:
    """Whether a folder is a prepared traversal."""
    return (folder / SIDECAR_FILE).is_file()


def read_sidecar(folder: Path) -> dict[str, Any]:
    """Return what the sidecar of a prepared traversal records; raise ``DatasetError`` if it is none."""
    try:
        record = store.read_json(folder / SIDECAR_FILE)
        return {**record, **{key: record[key] for key in ("images", "index", "parameters", "sources", "found")}}
    except (store.StoreError, KeyError, TypeError):
        raise _changed(folder, f"{SIDECAR_FILE} is damaged") from None


def listed(folder: Path) -> tuple[list[str], np.ndarray, str]:
    """Return image names, positions and their unit as the index of a prepared traversal has them.

    Raises ``DatasetError`` if the index is not the one that was written.
    """
    index = folder / INDEX_FILE
    if not index.is_file() or store.digest_of_file(index) != read_sidecar(folder)["index"]:
        raise _changed(folder, f"{INDEX_FILE} is missing or was changed")
    names = names_in_csv(index)
    return names, *positions_from_csv(index, names)


def unchanged(folder: Path, digest: str) -> dict[str, Any]:
    """Return the sidecar of a prepared traversal, or raise ``DatasetError`` if its images have another digest by now."""
    sidecar = read_sidecar(folder)
    if sidecar["images"] != digest:
        raise _changed(folder, "images were changed")
    return sidecar


def digests_of_images(folder: Path, names: list[str], cache: Path | None = None) -> list[str]:
    """Return the SHA-256 of each listed image, or raise ``DatasetError`` if one is missing."""
    try:
        return store.digest_of_files([f"{folder}/{name}" for name in names], cache)
    except FileNotFoundError as error:
        raise _changed(folder, f"{Path(str(error.filename)).name} is missing") from None


def _changed(folder: Path, what: str) -> DatasetError:
    return DatasetError(
        f"{folder}: {what} since the traversal was prepared; delete the folder and run `make data DATASET=…` for it again"
    )
