"""Descriptors and positions in the files that other tools write: no images, no manifest."""

from __future__ import annotations

import contextlib
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load_file

from artifact.datasets.folder import natural_order
from artifact.datasets.positions import in_metres, names_in_csv, positions_from_csv, positions_from_names, zone_of
from artifact.datasets.traversal import DatasetError
from artifact.manifest.entries import Threshold
from artifact.manifest.layout import files_below

_NAMED = ("descriptors", "global_descriptor", "features")
_NAMES = ("names", "image_names", "images")
_UNITS = {"frames": "frames", "frame": "frames", "metres": "metres", "m": "metres", "": "metres"}  # by ending


class Descriptors(NamedTuple):
    """Descriptors ``(n, d)``, float32 or float16, and the image names where the file holds them."""

    values: np.ndarray
    names: list[str] | None


class Located(NamedTuple):
    """Positions ``(n, p)`` in ``unit`` (``metres`` or ``frames``), and their UTM zone where it is known."""

    positions: np.ndarray
    unit: str
    zone: str | None = None


def read_threshold(text: str) -> Threshold:
    """Return a threshold from ``25m``, ``25`` (metres), ``2frames`` or ``exact``; ``DatasetError`` for another text.

    Examples
    --------
    >>> [str(read_threshold(text)) for text in ("25m", "10", "2frames", "exact")]
    ['25 m', '10 m', '±2 frames', 'exact match']
    """
    given = text.strip().lower()
    if given == "exact":
        return Threshold(value=0.0, unit="pairs")
    for ending, unit in _UNITS.items():
        if given.endswith(ending):
            with contextlib.suppress(ValueError):
                return Threshold.model_validate({"value": float(given.removesuffix(ending)), "unit": unit})
    raise DatasetError(f"the threshold is {text!r}; allowed: metres as 25m, frames as 2frames, or exact")


def read_descriptors(path: Path) -> Descriptors:
    """Read descriptors from one file.

    ``.npy``: an array ``(n, d)``. ``.npz`` or ``.safetensors``: the array named ``descriptors``, or the only one of two
    axes; ``.npz`` may hold image names in ``names``. ``.h5``: a group for each image with the array
    ``global_descriptor``, as hloc writes it, in the order of the names. Raises ``DatasetError`` if the file is missing, of
    another kind, damaged, or its descriptors are not ``(n, d)`` floats.
    """
    path = path.expanduser()
    if not path.is_file():
        raise DatasetError(f"{path}: no such file; it should hold descriptors")
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise DatasetError(f"{path}: the ending is {path.suffix!r}; descriptors are read from {', '.join(_READERS)}")
    try:
        found = reader(path)
    except DatasetError:
        raise
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, SafetensorError) as error:
        raise DatasetError(f"{path}: cannot be read as {path.suffix} ({error})") from None
    values = found.values
    if values.ndim != 2 or values.dtype.kind != "f" or 0 in values.shape:
        found_array = f"{values.dtype} of shape {values.shape}"
        raise DatasetError(f"{path}: found {found_array}; descriptors are floats of shape (n, d)")
    if values.dtype not in (np.float16, np.float32):
        values = values.astype(np.float32)
    if found.names is not None and len(found.names) != len(values):
        raise DatasetError(f"{path}: {len(found.names)} image names for {len(values)} descriptors")
    return Descriptors(values, found.names)


def _from_npz(path: Path) -> Descriptors:
    with np.load(path, allow_pickle=False) as arrays:
        found = {name: arrays[name] for name in arrays.files}
    names = next((found[name] for name in _NAMES if name in found), None)
    return Descriptors(_chosen(path, found), None if names is None else [str(name) for name in names])


def _chosen(path: Path, arrays: Mapping[str, np.ndarray]) -> np.ndarray:
    """The array that holds descriptors."""
    named = [name for name in _NAMED if name in arrays]
    tables = named or [name for name, array in arrays.items() if array.ndim == 2 and array.dtype.kind == "f"]
    if len(tables) != 1:
        what = ", ".join(f"{name} {array.shape}" for name, array in arrays.items()) or "nothing"
        raise DatasetError(f"{path}: found {what}; name the array of descriptors 'descriptors'")
    return arrays[tables[0]]


def _from_hdf5(path: Path) -> Descriptors:
    try:
        import h5py
    except ImportError:
        raise DatasetError(f"{path}: reading HDF5 needs h5py: pip install h5py") from None
    found: dict[str, np.ndarray] = {}

    def visit(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and name.rpartition("/")[2] == "global_descriptor":
            found[name.rpartition("/")[0]] = np.ravel(item[()])

    with h5py.File(path) as file:
        file.visititems(visit)
    if not found:
        raise DatasetError(f"{path}: no group holds 'global_descriptor'; the file should have one for each image name")
    widths = sorted({len(values) for values in found.values()})
    if len(widths) > 1:
        raise DatasetError(f"{path}: descriptors have {widths[0]} and {widths[-1]} values; all must have as many")
    names = sorted(found, key=natural_order)
    return Descriptors(np.stack([found[name] for name in names]), names)


_READERS = {
    ".npy": lambda path: Descriptors(np.lib.format.open_memmap(path, mode="r"), None),
    ".npz": _from_npz,
    ".safetensors": lambda path: Descriptors(_chosen(path, load_file(path)), None),
    ".h5": _from_hdf5,
    ".hdf5": _from_hdf5,
}


def read_positions(source: Path | None, found: Descriptors, label: str) -> Located:
    """Return the positions of descriptors.

    Parameters
    ----------
    source
        A ``.csv`` with a header (``image,x,y`` or ``image,index``), matched by image name where the descriptors carry
        names, by row where they do not; a ``.npy`` of metres; a ``.txt`` with one ``@utm_east@utm_north@`` image name a
        line; a folder of images with such names, sorted by name. ``None``: the descriptors' names, or frame order.

    Raises
    ------
    DatasetError
        If the source cannot be read or does not fit the descriptors, which ``label`` names.
    """
    n = len(found.values)
    if source is None:
        if found.names and all("@" in name for name in found.names):
            return _from_names(Path(label), found.names)
        return Located(np.arange(n, dtype=np.float64)[:, None], "frames")
    source = source.expanduser()
    if not source.exists():
        raise DatasetError(f"{source}: no such file; it should hold the positions of the {label}")
    if source.suffix.lower() == ".csv":
        names = names_in_csv(source)
        if found.names is None:
            _as_many(source, len(names), n, label)
        return Located(*positions_from_csv(source, found.names or names))
    if source.suffix.lower() == ".npy":
        return Located(_from_array(source, n, label), "metres")
    if source.is_dir():
        names = sorted(files_below(source)[0])
    elif source.suffix.lower() == ".txt":
        names = [line.strip() for line in source.read_text(encoding="utf-8").splitlines() if line.strip()]
    else:
        raise DatasetError(f"{source}: positions are read from .csv, .npy, .txt or a folder of images")
    _as_many(source, len(names), n, label)
    return _from_names(source, names)


def _from_names(where: Path, names: list[str]) -> Located:
    return Located(positions_from_names(where, names), "metres", zone_of(where, names))


def _from_array(source: Path, n: int, label: str) -> np.ndarray:
    try:
        array = np.lib.format.open_memmap(source, mode="r")
    except (OSError, ValueError, EOFError) as error:
        raise DatasetError(f"{source}: cannot be read as a NumPy array ({error})") from None
    if array.ndim not in (1, 2) or array.dtype.kind not in "iuf":
        found = f"{array.dtype} of shape {array.shape}"
        raise DatasetError(f"{source}: found {found}; positions are numbers of shape (n, p)")
    _as_many(source, len(array), n, label)
    return in_metres(np.asarray(array, np.float64).reshape(n, -1), source, range(n))


def _as_many(source: Path, found: int, needed: int, label: str) -> None:
    if found != needed:
        raise DatasetError(f"{source}: {found} positions for {needed} descriptors of the {label}")
