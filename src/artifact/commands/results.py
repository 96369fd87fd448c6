"""Results bundles written: what the pages of a profile need and nothing else, in one file that travels between machines.

A bundle is a zip file: ``bundle.json`` (:class:`~artifact.datasets.imported.Bundle`), the stored results that the executed
notebooks read, and a record of each traversal. It holds no images, no descriptors, no path, user or host;
:mod:`artifact.commands.importing` reads it.
"""

from __future__ import annotations

import contextlib
import hashlib
import shutil
import stat
import zipfile
import zlib
from collections.abc import Iterator
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

from pydantic import BaseModel

from artifact import methods, store, suppression
from artifact.book import runner
from artifact.datasets import Traversal, appearance, imported
from artifact.datasets.imported import Bundle, DescriptorRecord, Digest, File, Sidecar, TraversalRecord, read_record
from artifact.extraction import extract, local_features, made
from artifact.extraction import stored as extraction_stored
from artifact.extraction.disk import in_words
from artifact.manifest import Manifest
from artifact.metrics import two_stage
from artifact.pages.provenance import code_revision
from artifact.ranking import one_pass
from artifact.studies import fitted

CONTENTS, TIMINGS = "bundle.json", "timings.json"
BLOCK = 2**20  # bytes that are copied at a time
_STAMP = (1980, 1, 1, 0, 0, 0)  # of every file: equal results give equal bundles


class ResultRecord(BaseModel, frozen=True):
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


class Times(BaseModel, extra="forbid", frozen=True):
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
    tasks = runner.plan(manifest, profile)
    results = runner.results_read(manifest, tasks)
    pairs = dict.fromkeys((name, method) for task in tasks for name in task.datasets for method in task.methods)
    names = runner.datasets_of(tasks)
    traversals = {name: runner.load_all(manifest, name) for name in names}
    measured = [
        path.relative_to(manifest.cache).as_posix()
        for loaded in traversals.values()
        for traversal in loaded
        if (path := appearance.stored_path(manifest.cache, appearance.appearance_key(traversal))).exists()
    ]
    arrays = {name: manifest.cache / name for name in dict.fromkeys([*results, *measured])}
    sizes = [path.stat().st_size for path in arrays.values() if path.exists()]
    about = f"{len(arrays)} results of {len(tasks)} pages, at most {in_words(sum(sizes))}"
    yield f"{target}: {about}; no images, no descriptors"
    written: dict[str, bytes] = {}
    for name, path in arrays.items():
        record = read_record(path.with_suffix(".json"), ResultRecord)
        if store.digest_of_file(path) != record.sha256:
            raise store.StoreError(f"{path}: its content differs from its record; delete both and run again")
        written[Path(name).with_suffix(".json").as_posix()] = _as_bytes(record)
    for name, loaded in traversals.items():
        used = [method for dataset, method in pairs if dataset == name]
        for traversal in loaded:
            record = _record_of(manifest, name, traversal, used)
            written[f"traversals/{name}/{traversal.name}.json"] = _as_bytes(record)
    if (times := manifest.cache / TIMINGS).exists():
        written[TIMINGS] = _as_bytes(Times(times=store.read_json(times)))
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
    with told(target), store.replacing(target) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        for name in (CONTENTS, *bundle.files):
            info = zipfile.ZipInfo(name, _STAMP)
            info.compress_type, info.external_attr = zipfile.ZIP_DEFLATED, (stat.S_IFREG | 0o644) << 16
            data = _as_bytes(bundle) if name == CONTENTS else written.get(name)
            with archive.open(info, "w") as stream:
                if data is not None:
                    stream.write(data)
                else:
                    with arrays[name].open("rb") as source:
                        shutil.copyfileobj(source, stream, BLOCK)
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
def told(path: Path) -> Iterator[None]:
    """Say in one line what is wrong with a bundle."""
    try:
        yield
    except zipfile.BadZipFile as error:
        raise store.StoreError(f"{path}: is no results bundle, or is damaged ({error})") from None
    except (zlib.error, EOFError, NotImplementedError, OSError) as error:
        raise store.StoreError(f"{path}: cannot be read or written ({error})") from None
