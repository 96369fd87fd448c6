"""Results bundles: what the pages of a profile need and nothing else, in one file that travels between machines.

A bundle is a zip file: ``bundle.json`` (:class:`~artifact.datasets.imported.Bundle`), the stored results that the executed
notebooks read, and a record of each traversal. It holds no images, no descriptors, no path, user or host. Nothing in one is
trusted: all of it is checked before anything gets a name in the cache.
"""

from __future__ import annotations

import contextlib
import hashlib
import math
import os
import re
import shutil
import stat
import tempfile
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

import numpy as np
from pydantic import BaseModel

from artifact import methods, store, suppression
from artifact.book import notebooks, runner
from artifact.datasets import Traversal, appearance, imported
from artifact.datasets.disk import free_bytes, in_words
from artifact.datasets.imported import Bundle, DescriptorRecord, Digest, File, Sidecar, TraversalRecord, read_record
from artifact.extraction import extract, local_features, made
from artifact.extraction import stored as extraction_stored
from artifact.manifest import Manifest
from artifact.metrics import stored, two_stage
from artifact.pages.provenance import code_revision
from artifact.ranking import one_pass
from artifact.studies import fitted

_CONTENTS, _TIMINGS = "bundle.json", "timings.json"
_BLOCK = 2**20  # bytes that are copied at a time
_STAMP = (1980, 1, 1, 0, 0, 0)  # of every file: equal results give equal bundles
_NAME = r"[A-Za-z0-9][A-Za-z0-9_.,+-]{0,99}"
_RESULT = r"(rankings|appearance)/[0-9a-f]{24}\.(npz|json)"
_ALLOWED = re.compile(rf"{_RESULT}|traversals/{_NAME}/{_NAME}\.json|timings\.json")
_MOST_FILES = 50_000
_LARGEST_RECORD, _LARGEST_RESULT, _LARGEST = 64 * 2**20, 2 * 2**30, 32 * 2**30  # bytes, unpacked


class _ResultRecord(BaseModel, frozen=True):
    """The record beside a stored result; what else it says of a machine is left out."""

    key: Digest
    sha256: Digest
    dataset: str = ""
    datasets: list[str] = []
    traversal: str = ""
    method: str = ""
    stage: str = ""


class _Time(BaseModel, extra="forbid", frozen=True):
    """Time of a method for Table II, as :func:`artifact.extraction.timing.store_times` keeps it."""

    seconds: float | None
    note: str
    device: str
    cores: int | None


class _Times(BaseModel, extra="forbid", frozen=True):
    """Times of methods, by name."""

    times: dict[str, _Time]


def revisions() -> dict[str, int | str]:
    """Return the revisions of all that decides a stored result, the libraries among it."""
    return {
        "appearance": appearance.REVISION,
        "descriptors": extraction_stored.REVISION,
        "local features": local_features.REVISION,
        "made descriptors": made.REVISION,
        "ranking": one_pass.REVISION,
        "studies": fitted.REVISION,
        "suppression": suppression.REVISION,
        "two-stage ranking": two_stage.REVISION,
        **{name: version(name) for name in ("scikit-learn", "umap-learn")},
    }


# -- export -------------------------------------------------------------------------------------------------


def export(manifest: Manifest, profile: str, target: Path) -> Iterator[str]:
    """Write the results bundle of a profile whose pages have run; yield lines for the user, an estimate of its size first.

    Raises
    ------
    NotebookError
        If a page has not run since something it depends on changed.
    StoreError
        If a stored result is damaged or gone, or the file cannot be written.
    """
    tasks = notebooks.plan(manifest, profile)
    results = runner.results_read(manifest, tasks)
    pairs, names = notebooks.pairs_of(tasks), notebooks.datasets_of(tasks)
    traversals = {name: notebooks.load_all(manifest, name) for name in names}
    keys = [appearance.appearance_key(traversal) for loaded in traversals.values() for traversal in loaded]
    paths = [appearance.stored_path(manifest.cache, key) for key in keys]
    measured = [path.relative_to(manifest.cache).as_posix() for path in paths if path.exists()]
    arrays = {name: manifest.cache / name for name in dict.fromkeys([*results, *measured])}
    sizes = [path.stat().st_size for path in arrays.values() if path.exists()]
    about = f"{len(arrays)} results of {len(tasks)} pages, at most {in_words(sum(sizes))}"
    yield f"{target}: {about}; no images, no descriptors"
    written: dict[str, bytes] = {}
    for name, path in arrays.items():
        record = read_record(path.with_suffix(".json"), _ResultRecord)
        if store.digest_of_file(path) != record.sha256:
            raise store.StoreError(f"{path}: its content differs from its record; delete both and run again")
        written[Path(name).with_suffix(".json").as_posix()] = _as_bytes(record)
    for name, loaded in traversals.items():
        used = [method for dataset, method in pairs if dataset == name]
        for traversal in loaded:
            record = _record_of(manifest, name, traversal, used)
            written[f"traversals/{name}/{traversal.name}.json"] = _as_bytes(record)
    if (times := manifest.cache / _TIMINGS).exists():
        written[_TIMINGS] = _as_bytes(_Times(times=store.read_json(times)))
    files = {name: File(size=path.stat().st_size, sha256=store.digest_of_file(path)) for name, path in arrays.items()}
    files |= {name: File(size=len(data), sha256=hashlib.sha256(data).hexdigest()) for name, data in written.items()}
    weighed = {method: manifest.method(method).weights for _, method in pairs}
    bundle = Bundle(
        format=imported.FORMAT,
        date=f"{datetime.now(UTC):%Y-%m-%d}",
        profile=profile,
        code=code_revision(),
        revisions=revisions(),
        datasets=names,
        weights={method: methods.weights.digests(entry) if entry else [] for method, entry in weighed.items()},
        files=dict(sorted(files.items())),
    )
    written[_CONTENTS] = _as_bytes(bundle)
    with _told(target), store.replacing(target) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        for name in (_CONTENTS, *bundle.files):
            info = zipfile.ZipInfo(name, _STAMP)
            info.compress_type, info.external_attr = zipfile.ZIP_DEFLATED, (stat.S_IFREG | 0o644) << 16
            with archive.open(info, "w") as stream:
                if name in written:
                    stream.write(written[name])
                else:
                    with arrays[name].open("rb") as source:
                        shutil.copyfileobj(source, stream, _BLOCK)
    yield f"{target}: {in_words(target.stat().st_size)}; `python -m artifact results import {target.name}` reads it"


def _record_of(manifest: Manifest, dataset: str, traversal: Traversal, names: list[str]) -> TraversalRecord:
    found = {}
    for method in names:
        one, entry = extract.descriptors(manifest, traversal, method), manifest.method(method)
        second = None
        if local_features.layout_of(entry) is not None:
            second = extraction_stored.second_stage_key(traversal, method, entry)
        kept = {name: one.sidecar[name] for name in Sidecar.model_fields if name in one.sidecar}
        found[method] = DescriptorRecord(
            key=one.key, sha256=one.sha256, source=one.source, sidecar=Sidecar(**kept), second=second
        )
    return TraversalRecord(
        kind=manifest.dataset(dataset).kind,
        condition=traversal.condition,
        digest=traversal.digest,
        image_names=list(traversal.image_names),
        positions=traversal.positions.tolist(),
        descriptors=found,
    )


def _as_bytes(record: BaseModel) -> bytes:
    return (record.model_dump_json(indent=1, exclude_defaults=True) + "\n").encode()


@contextlib.contextmanager
def _told(path: Path) -> Iterator[None]:
    """Say in one line what is wrong with a bundle."""
    try:
        yield
    except zipfile.BadZipFile as error:
        raise store.StoreError(f"{path}: is no results bundle, or is damaged ({error})") from None
    except (zlib.error, EOFError, NotImplementedError, OSError) as error:
        raise store.StoreError(f"{path}: cannot be read or written ({error})") from None


# -- import -------------------------------------------------------------------------------------------------


def read(manifest: Manifest, source: Path) -> Iterator[str]:
    """Import a results bundle, whole or not at all; yield lines for the user.

    Results that are there already stay.

    Raises
    ------
    StoreError
        If the file is no results bundle, was made by other code, does not fit the manifest, or anything in it differs from
        its digest, is of another kind than it should be, or is too large.
    """
    with _told(source), contextlib.ExitStack() as stack:
        archive = stack.enter_context(zipfile.ZipFile(source))
        listed = _listed(archive, source)
        folder = manifest.cache / imported.FOLDER
        folder.mkdir(parents=True, exist_ok=True)
        aside = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix=".", suffix=".partial", dir=folder)))
        _unpack(archive, listed[_CONTENTS], aside / _CONTENTS, File(size=listed[_CONTENTS].file_size, sha256="0" * 64))
        bundle: Bundle = read_record(aside / _CONTENTS, Bundle)
        _check_code(manifest, bundle, source)
        _check_sizes(manifest, bundle, listed, source)
        results = [name for name in bundle.files if name.endswith(".npz")]
        yield (
            f"{source}: bundle of {bundle.date} by {bundle.code}, profile {bundle.profile}: {len(results)} results, "
            f"{in_words(sum(file.size for file in bundle.files.values()))}"
        )
        for name, file in bundle.files.items():
            _unpack(archive, listed[name], aside / name, file)
        for name in results:
            _check_result(aside / name)
        _check_traversals(manifest.for_profile(bundle.profile), bundle, aside)
        new = sum(_keep(aside / name, manifest.cache / name) for name in results)
        if _TIMINGS in bundle.files:
            times: _Times = read_record(aside / _TIMINGS, _Times)
            if not (manifest.cache / _TIMINGS).exists():
                store.write_json(manifest.cache / _TIMINGS, times.model_dump()["times"])
        target = imported.folder_of(manifest, bundle.profile)
        if target.exists():
            target.replace(aside / ".before")
        (aside / "kept").mkdir()
        for name in (_CONTENTS, "traversals"):
            (aside / name).replace(aside / "kept" / name)
        (aside / "kept").replace(target)
    yield (
        f"imported: {new} results are new; `make reproduce PROFILE={bundle.profile}` builds the book from them, and deleting "
        f"{target} ends that"
    )


def _listed(archive: zipfile.ZipFile, source: Path) -> dict[str, zipfile.ZipInfo]:
    """Return the files of an archive by name, if all of them have names and kinds that a bundle may hold."""
    infos = archive.infolist()
    found = {info.filename: info for info in infos}
    fault = None
    if _CONTENTS not in found:
        fault = f"is no results bundle: it has no {_CONTENTS}"
    elif len(infos) > _MOST_FILES:
        fault = f"holds {len(infos)} files; allowed: {_MOST_FILES}"
    elif len(found) < len(infos):
        fault = "holds two files of one name"
    else:
        for name, info in found.items():
            kind = stat.S_IFMT(info.external_attr >> 16)
            if not (name == _CONTENTS or _ALLOWED.fullmatch(name)):
                fault = f"holds a file {name[:100]!r}, which no results bundle has"
            elif kind not in (0, stat.S_IFREG) or info.flag_bits & 1:
                fault = f"{name} is a link or encrypted; allowed: plain files"
            elif info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                fault = f"{name} is compressed in a way that no results bundle is"
            elif info.file_size > (_LARGEST_RECORD if name.endswith(".json") else _LARGEST_RESULT):
                fault = f"{name} takes {in_words(info.file_size)}; no result is as large"
            if fault:
                break
    if fault:
        raise store.StoreError(f"{source}: {fault}")
    return found


def _check_code(manifest: Manifest, bundle: Bundle, source: Path) -> None:
    """Refuse a bundle of another format, other code, or a profile that is another one here."""
    if bundle.format != imported.FORMAT:
        raise store.StoreError(f"{source}: is of format {bundle.format}; this code reads format {imported.FORMAT}")
    ours = revisions()
    for name in [*ours, *bundle.revisions]:
        here, theirs = ours.get(name), bundle.revisions.get(name)
        if here != theirs:
            made = f"was made with {name} {theirs}, here is {here}"
            raise store.StoreError(f"{source}: {made}; import it with the code that made it: {bundle.code}")
    profile = manifest.profile(bundle.profile)
    odd_datasets, odd_methods = {*bundle.datasets} ^ {*profile.datasets}, {*bundle.weights} ^ {*profile.methods}
    for what, odd in (("datasets", odd_datasets), ("methods", odd_methods)):
        if odd:
            listed = ", ".join(sorted(odd))
            raise store.StoreError(f"{source}: profile {bundle.profile} has other {what} here: {listed}")


def _check_sizes(manifest: Manifest, bundle: Bundle, listed: Mapping[str, zipfile.ZipInfo], source: Path) -> None:
    """Check that the contents are those listed, and that they fit the disk."""
    odd = sorted({*listed} ^ {_CONTENTS, *bundle.files})
    if odd:
        raise store.StoreError(f"{source}: {odd[0]!r} is listed or there, but not both")
    for name, file in bundle.files.items():
        if listed[name].file_size != file.size:
            raise store.StoreError(f"{source}: {name} has {listed[name].file_size} bytes, {_CONTENTS} says {file.size}")
        if name.endswith(".npz") and Path(name).with_suffix(".json").as_posix() not in bundle.files:
            raise store.StoreError(f"{source}: {name} has no record")
    total, room = sum(file.size for file in bundle.files.values()), free_bytes(manifest.cache)
    if total > min(_LARGEST, room):
        allowed = f"allowed are {in_words(_LARGEST)}, and {in_words(room)} are free"
        raise store.StoreError(f"{source}: takes {in_words(total)}; {allowed}")


def _unpack(archive: zipfile.ZipFile, info: zipfile.ZipInfo, target: Path, expected: File) -> None:
    """Unpack one file, at most as many bytes as expected, and compare its digest; that of the contents is not known."""
    target.parent.mkdir(parents=True, exist_ok=True)
    digest, left = hashlib.sha256(), expected.size
    with archive.open(info) as source, target.open("xb") as out:
        while block := source.read(min(_BLOCK, left + 1)):
            left -= len(block)
            if left < 0:
                break
            digest.update(block)
            out.write(block)
        out.flush()
        os.fsync(out.fileno())
    if left or (info.filename != _CONTENTS and digest.hexdigest() != expected.sha256):
        raise store.StoreError(f"{archive.filename}: {info.filename} differs from its digest; the bundle is damaged")


def _check_result(path: Path) -> None:
    """Check that a stored result is what its record says, and plain arrays that can be read back."""
    record: _ResultRecord = read_record(path.with_suffix(".json"), _ResultRecord)
    name = f"{path.parent.name}/{path.name}"
    if record.key[:24] != path.stem or store.digest_of_file(path) != record.sha256:
        raise store.StoreError(f"{name}: does not fit its record")
    try:
        _check_arrays(path)
        arrays = store.load_arrays(path, record.key) or {}
        if path.parent.name == "rankings":
            stored.read(arrays)
    except (zipfile.BadZipFile, ValueError, KeyError, IndexError, TypeError, EOFError, OverflowError) as error:
        raise store.StoreError(f"{name}: holds no result ({error})") from None


def _check_arrays(path: Path) -> None:
    """Check the headers of all arrays in a ``.npz`` file, before any of them is read: no objects, no more than is there."""
    with zipfile.ZipFile(path) as inner:
        for info in inner.infolist():
            if info.compress_type != zipfile.ZIP_STORED or info.file_size != info.compress_size:
                raise ValueError(f"{info.filename} is compressed")
            with inner.open(info) as stream:
                major, _ = np.lib.format.read_magic(stream)
                header = {1: np.lib.format.read_array_header_1_0, 2: np.lib.format.read_array_header_2_0}.get(major)
                if header is None:
                    raise ValueError(f"{info.filename} is an array of format {major}")
                shape, _, dtype = header(stream)
                if dtype.hasobject or dtype.kind not in "biufU":
                    raise ValueError(f"{info.filename} holds values of type {dtype}")
                if math.prod(shape) * dtype.itemsize != info.file_size - stream.tell():
                    raise ValueError(f"{info.filename} has another size than its header says")


def _check_traversals(manifest: Manifest, bundle: Bundle, folder: Path) -> None:
    """Check that each traversal is one of the manifest, and that the keys of its descriptors are those of this code."""
    for dataset in bundle.datasets:
        entry = manifest.dataset(dataset)
        needed = {f"traversals/{dataset}/{name}.json" for name in (entry.query, entry.database)}
        if missing := needed - {*bundle.files}:
            raise store.StoreError(f"{missing.pop()}: is not in the bundle")
    for name in (name for name in bundle.files if name.startswith("traversals/")):
        record: TraversalRecord = read_record(folder / name, TraversalRecord)
        _, dataset, file = name.split("/")
        if fault := _fault(manifest, bundle, dataset, file.removesuffix(".json"), record):
            raise store.StoreError(f"{name}: {fault}")


def _fault(manifest: Manifest, bundle: Bundle, dataset: str, name: str, record: TraversalRecord) -> str | None:
    entry = manifest.dataset(dataset) if dataset in bundle.datasets else None
    if entry is None or name not in entry.traversals:
        return "the manifest has no such traversal"
    condition = entry.traversals[name].condition
    if (record.kind, record.condition) != (entry.kind, condition):
        return f"is {record.kind}, {record.condition}; the manifest says {entry.kind}, {condition}"
    n, widths = len(record.image_names), {len(place) for place in record.positions}
    if not n or len(record.positions) != n or len(widths) != 1 or not 1 <= min(widths) <= 3:
        return f"has {n} images and positions {len(record.positions)} × {sorted(widths)}"
    if record.kind == "made" and _digest_of_given(record) != record.digest:
        return "its digest is not that of its names and descriptors"
    for method, one in record.descriptors.items():
        if method not in bundle.weights:
            return f"has descriptors of {method}, which the profile lacks"
        if one.sidecar.shape[0] != n:
            return f"descriptors of {method} are of {one.sidecar.shape[0]} images, not {n}"
        keys = _expected_keys(manifest, bundle, record, method)
        if keys is not None and (one.key, one.second) != keys:
            return f"descriptors of {method} have another key than this manifest, its weights and this code give"
    return None


def _digest_of_given(record: TraversalRecord) -> str:
    descriptors = {method: one.sha256 for method, one in record.descriptors.items()}
    second = {method: one.second for method, one in record.descriptors.items() if one.second}
    return store.key(names=record.image_names, given=[descriptors, second])


def _expected_keys(
    manifest: Manifest, bundle: Bundle, record: TraversalRecord, method: str
) -> tuple[str, str | None] | None:
    """Content keys of descriptors and second stage as this code makes them, with the bundle's weights; ``None`` if given."""
    entry = manifest.method(method)
    if record.descriptors[method].source == "given descriptors":
        return None
    model = methods.fingerprint(method, entry)
    if entry.weights is not None:
        both = zip(model["weights"], bundle.weights[method], strict=False)
        model["weights"] = [theirs if here is None else here for here, theirs in both]
    key = extraction_stored.key_of_descriptors(record.digest, model)
    second = extraction_stored.key_of_second_stage(key, entry) if local_features.layout_of(entry) else None
    return key, second


def _keep(path: Path, target: Path) -> bool:
    """Give a checked result its name in the cache, its record last; whether there was none."""
    if target.with_suffix(".json").exists():
        return False
    target.parent.mkdir(parents=True, exist_ok=True)
    for suffix in (".npz", ".json"):
        path.with_suffix(suffix).replace(target.with_suffix(suffix))
    return True
