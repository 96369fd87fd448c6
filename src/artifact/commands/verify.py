"""``artifact verify``: stored results against their records, measurements against the paper; and their repair."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from artifact import datasets, store
from artifact.book import notebooks
from artifact.book.build import executed_folder, source_folder
from artifact.datasets import shipped
from artifact.manifest import Manifest
from artifact.methods import weights
from artifact.methods.weights import lock
from artifact.studies import reported, verdicts

_ENDINGS = (".npy", ".npz", ".csv", ".ipynb", ".md")  # of stored files that have a record
_STAGES = ("city", "rehearsal", "appearance", "descriptors", "local_features", "rankings", "notebooks")


class Damaged(NamedTuple):
    """A damaged file or folder, the reason, and its record as far as that is readable."""

    path: Path
    reason: str
    record: dict[str, Any]


def verify(manifest: Manifest, profile: str) -> tuple[list[str], int]:
    """Check what is stored, and compare what the profile measures with what the paper reports.

    Parameters
    ----------
    manifest, profile
        The profile's datasets and methods are compared where the paper has them; missing datasets are named.

    Returns
    -------
    lines
        What was checked, for the user.
    faults
        Number of damaged files, of changed images and weights and of measurements that differ from the paper's.
    """
    lines, faults = [], 0
    for folder in (manifest.cache, *_pages(manifest), shipped.folder()):
        checked, damaged = look_at(folder)
        lines.append(f"{folder}: {checked} stored results, {len(damaged)} damaged")
        lines += [f"DAMAGED {one.reason}" for one in damaged]
        faults += len(damaged)
    if faults:
        anew = "makes what is damaged anew, and all that was made from it"
        lines.append(f"make verify REPAIR=1 (or the option --repair) {anew}")
    changed = changed_files(manifest, manifest.profile(profile).datasets)
    weighed, heavier = _verify_weights(manifest, profile)
    compared, different = _against_the_paper(manifest, profile)
    return [*lines, *changed, *weighed, *compared], faults + len(changed) + heavier + different


def _pages(manifest: Manifest) -> list[Path]:
    """Folders of the pages, where there are any outside the cache."""
    with contextlib.suppress(OSError):
        folders = [executed_folder(manifest), source_folder(manifest) / "_build" / "html"]
        return [folder for folder in folders if folder.is_dir() and not folder.is_relative_to(manifest.cache)]
    return []


def look_at(folder: Path) -> tuple[int, list[Damaged]]:
    """Read everything below a folder that has a record or a checksum; return how many results, and the damaged ones."""
    results, damaged = 0, []
    for place, found in _records([folder]):
        results += len(found)
        for path in found:
            try:
                store.check(path)
            except store.StoreError as error:
                damaged.append(Damaged(path, str(error), _record(place)))
        if not found:
            try:
                store.read_json(place)
            except store.StoreError as error:
                damaged.append(Damaged(place, str(error), {}))
    return results, damaged


def _records(folders: Iterable[Path]) -> Iterator[tuple[Path, list[Path]]]:
    """Yield every JSON file below some folders, with the folder or the files that it is the record of, if any.

    Hidden files and folders are what is being written, or what a killed run left of it: no result.
    """
    for folder in folders:
        for place in sorted(folder.rglob("[!.]*.json")):
            if any(part.startswith(".") for part in place.relative_to(folder).parts):
                continue
            beside = [path for ending in _ENDINGS if (path := place.with_suffix(ending)).exists()]
            yield place, [place.parent] if place == store.record_path(place.parent) else beside


def _record(place: Path) -> dict[str, Any]:
    with contextlib.suppress(store.StoreError):
        record = store.read_json(place)
        return record if isinstance(record, dict) else {}
    return {}


def changed_files(manifest: Manifest, names: Iterable[str]) -> list[str]:
    """Read all images and given descriptors of some datasets; return a line for each that changed without being written.

    Their digests are forgotten: from now on they count as they are, and rendered ones are rendered again.
    """
    lines = []
    for name in names:
        if datasets.describe_missing(manifest, name):
            continue
        for traversal in notebooks.load_all(manifest, name):
            given = [*traversal.descriptors.values(), *traversal.second_stage.values()]
            files = [one.path for one in given if one.path is not None]
            if traversal.has_images:
                files = traversal.image_paths()
            for path in store.changed_in_silence(files, manifest.cache):
                lines.append(f"CHANGED   {path}: its content is not what it was, though it was not written since")
    return lines


def repair(manifest: Manifest, profile: str, run: Callable[[], object]) -> Iterator[str]:
    """Delete what is damaged and all that was made from it, run the profile again, and yield what changed.

    Whatever follows in the order of the stages and shares dataset and method counts as made from it.
    """
    folders = [manifest.cache, *_pages(manifest)]
    damaged = [one for folder in folders for one in look_at(folder)[1]]
    yield from changed_files(manifest, manifest.profile(profile).datasets)
    before = {one.path: one.record.get("sha256") for one in damaged}
    for path in [path for _, found in _records(folders) for path in found]:
        if any(_is_made_from(path, one, manifest.cache) for one in damaged):
            before.setdefault(path, _record(store.record_path(path)).get("sha256"))
    for path in before:
        yield f"DELETED   {path}"
        store.remove(path)
    run()
    for path, known in before.items():
        now = _record(store.record_path(path)).get("sha256") if path.exists() else None
        yield f"{'NOT NEEDED' if now is None else 'AS BEFORE ' if now == known else 'CHANGED   '} {path}"


def _stage(path: Path, cache: Path) -> int:
    """Place of a file of the cache in the order of the stages; others come after all of them."""
    folder = path.relative_to(cache).parts[0] if path.is_relative_to(cache) else ""
    return _STAGES.index(folder) if folder in _STAGES else len(_STAGES)


def _is_made_from(path: Path, damaged: Damaged, cache: Path) -> bool:
    if not _stage(damaged.path, cache) < _stage(path, cache) < len(_STAGES):
        return False
    record = _record(store.record_path(path))
    return all(
        not (_named(record, what) and _named(damaged.record, what))
        or _named(record, what) & _named(damaged.record, what)
        for what in ("dataset", "method")
    )


def _named(record: dict[str, Any], what: str) -> set[str]:
    return {*record.get(f"{what}s", []), *filter(None, [record.get(what)])}


def _verify_weights(manifest: Manifest, profile: str) -> tuple[list[str], int]:
    """Recompute the digest of the profile's weights, whatever their modification time says."""
    checked, faults = 0, []
    for name in manifest.profile(profile).methods:
        entry = manifest.method(name).weights
        for path in [weights.path_of(entry, file) for file in entry.files] if entry else []:
            if path.exists() and lock.path_of(path).exists():
                checked += 1
                if store.digest_of_file(path) != lock.read(path)["sha256"]:
                    faults.append(f"CHANGED   {path}: its content differs from its lock file; fetch it anew")
    return [f"{checked} files of weights, {len(faults)} changed", *faults] if checked else [], len(faults)


def _against_the_paper(manifest: Manifest, profile: str) -> tuple[list[str], int]:
    """Print the verdict on every number of the paper that the profile measures."""
    entry = manifest.profile(profile)
    comparable = [name for name in entry.datasets if manifest.dataset(name).reported_as]
    methods = [name for name in entry.methods if name in reported.method_titles()]
    if not comparable or not methods:
        what = "dataset" if not comparable else "method"
        return [f"profile {profile!r} has no {what} of the paper: nothing to compare with its numbers"], 0
    lines, ready = [], []
    for name in comparable:
        if missing := datasets.describe_missing(manifest, name):
            lines.append(f"MISSING   {name}: {missing.splitlines()[0]}")
        else:
            ready.append(name)
    found = verdicts.of_profile(manifest, ready, methods)
    for row in found.to_dict("records"):
        what = " · ".join(str(row[column]) for column in ("where", "dataset", "method", "quantity"))
        numbers = f"{row['measured']:.2f}, paper {row['reported']} ({row['why']})"
        lines.append(f"{row['verdict'].upper():<11} {what}: {numbers}")
    counts = verdicts.tally([found])
    lines.append(", ".join(f"{number} {verdict}" for verdict, number in counts.items()))
    return lines, counts["differs"]
