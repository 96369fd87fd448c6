"""Released weights: the files that a method needs, whether they are here and unchanged, and how they come here.

They lie in one folder, ``weights`` below the data root unless the manifest says otherwise. Beside each file its lock
file ``NAME.lock.json`` records what was found when the file was first accepted: address, size, SHA-256, digest of the
tensors, date. Any later difference is an error. A file is accepted only if its content fits the method's model.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from artifact import store
from artifact.datasets import download
from artifact.datasets.disk import free_bytes, in_words
from artifact.manifest.entries import MethodEntry, WeightsEntry, WeightsFile
from artifact.methods.weights import lock
from artifact.methods.weights.lock import WeightsError

Status = Literal["not needed", "present", "not checked yet", "missing", "changed"]

Check = Callable[[WeightsFile, Path], str]
"""Returns the digest of the tensors of a file, which may have another name for now, or raises :class:`WeightsError`."""

_REMEDY = (
    "run `make data PROFILE=paper` (or `python -m artifact data --profile paper`): it shows licences and terms, "
    "downloads what it can, and checks files put there by hand"
)
_WORST_LAST: tuple[Status, ...] = ("present", "not checked yet", "missing", "changed")


@dataclass(frozen=True)
class State:
    """Where a method's weights stand: a line on the method, and several on its files and what to do about them.

    ``status`` is ``"not needed"`` (the model has none, or its builder brings them), ``"present"`` (accepted and
    unchanged), ``"not checked yet"`` (there, but never loaded), ``"missing"`` or ``"changed"``.
    """

    status: Status
    summary: str
    detail: str


def path_of(entry: WeightsEntry, file: WeightsFile) -> Path:
    """Return where a file of weights lies, or would lie."""
    return Path(entry.folder) / file.file


def is_required(entry: MethodEntry) -> bool:
    """Whether a method must not run without files of weights: all methods of the paper, and all that name files."""
    return entry.weights is not None or (entry.kind == "paper" and entry.builder is None)


def state(name: str, entry: MethodEntry) -> State:
    """Return where the weights of a method of the manifest stand; reads no file that is as its lock file left it."""
    if entry.weights is None:
        if not is_required(entry):
            return State("not needed", f"{name}: no files of weights needed", "")
        why = "the manifest names no files of weights for this method of the paper; add the key 'weights'"
        return State("missing", f"{name}: missing, {why}", f"{name}: {why}")
    found = [_state_of_file(name, entry.weights, file) for file in entry.weights.files]
    status = max((status for status, _ in found), key=_WORST_LAST.index)
    files = ", ".join(f"{file.file} ({_size(file, path_of(entry.weights, file))})" for file in entry.weights.files)
    return State(status, f"{name}: {status}, {files}", "\n".join(detail for _, detail in found))


def _state_of_file(name: str, entry: WeightsEntry, file: WeightsFile) -> tuple[Status, str]:
    path = path_of(entry, file)
    if not path.exists():
        return "missing", _how_to_get(name, entry, file)
    if not lock.path_of(path).exists():
        return "not checked yet", f"{name}: {path} is there and will be checked when it is first used"
    try:
        return "present", f"{name}: {path}, SHA-256 {lock.compare(file, path)}"
    except WeightsError as error:
        return "changed", str(error)


def require(entries: Mapping[str, MethodEntry]) -> None:
    """Raise one :class:`WeightsError` with all that these methods miss or find changed, before hours of work begin."""
    states = [state(name, entry) for name, entry in entries.items()]
    faults = [found.detail for found in states if found.status in ("missing", "changed")]
    if any(found.status == "missing" for found in states):
        faults.append(_REMEDY)
    if faults:
        raise WeightsError("\n".join(faults))


def digests(entry: WeightsEntry) -> list[str | None]:
    """Return the SHA-256 of each file of weights: what a method's descriptors depend on.

    A file that was accepted once may be deleted afterwards: its lock file, or the manifest, still knows the digest;
    ``None`` if neither does. Raises :class:`WeightsError` if a file is not what its lock file says, or cannot be read.
    """

    def digest(file: WeightsFile, path: Path) -> str | None:
        if lock.path_of(path).exists():
            return lock.compare(file, path) if path.exists() else lock.read(path)["sha256"]
        return lock.sha256(path) if path.exists() else file.sha256

    return [digest(file, path_of(entry, file)) for file in entry.files]


def verified(name: str, entry: WeightsEntry, file: WeightsFile, check: Check) -> Path:
    """Return the path of a file of weights that is what it should be; the first time, examine it and lock it.

    Raises :class:`WeightsError` if the file is missing (with how to get it), differs from its lock file or from what
    the manifest says of it, does not fit the model, or holds the same weights as another file.
    """
    path = path_of(entry, file)
    if not path.exists():
        raise WeightsError(_how_to_get(name, entry, file))
    if lock.path_of(path).exists():
        lock.compare(file, path)
        return path
    try:
        tensors = _examine(file, path, path, check)
    except WeightsError as error:
        raise WeightsError(f"{name}: {path} is refused\n  {error}\n{_by_hand(entry, file)}") from None
    lock.write(path, url="put there by hand", method=name, tensors=tensors)
    return path


def announcement(entries: Mapping[str, MethodEntry]) -> str:
    """Return licence, terms, size and origin of all missing files, to show before a download; empty if none is."""
    lines, total, folders = [], 0.0, set()
    for name, entry in entries.items():
        weights = entry.weights
        missing = [file for file in weights.files if not path_of(weights, file).exists()] if weights else []
        if not (weights and missing):
            continue
        lines += [f"weights of {entry.title} ({name})", f"  licence: {weights.licence}"]
        lines += [f"  terms: {weights.terms.strip()}"] if weights.terms else []
        for file in missing:
            lines.append(f"  {file.file}, {_size(file)}, from {file.urls[0] if file.urls else 'its owners'}")
            total += file.n_bytes
        folders.add(weights.folder)
    lines += [
        f"{in_words(total)} in all, {in_words(free_bytes(Path(folder)))} free at {folder}" for folder in sorted(folders)
    ]
    return "".join(f"{line}\n" for line in lines)


def fetch(name: str, entry: WeightsEntry, check: Check, *, progress: bool = True) -> None:
    """Make all files of a method's weights ready: download what is missing, examine and lock what is not locked yet.

    Show :func:`announcement` first. An interrupted download goes on where it was, and no file gets its name before
    ``check`` has accepted it. Raises :class:`WeightsError` that lists all files which cannot be had, or are not what
    they should be, with what to do by hand.
    """
    faults = []
    for file in entry.files:
        try:
            if not path_of(entry, file).exists():
                _download(name, entry, file, check, progress=progress)
            verified(name, entry, file, check)
        except WeightsError as error:
            faults.append(str(error))
    if faults:
        raise WeightsError("\n".join(faults))


def _download(name: str, entry: WeightsEntry, file: WeightsFile, check: Check, *, progress: bool) -> None:
    path, accepted = path_of(entry, file), []

    def accept(partial: Path) -> None:
        try:
            accepted.append(_examine(file, partial, path, check))
        except WeightsError as error:
            raise download.DownloadError(str(error)) from None

    with lock.writing(path), store.lock(path):
        if path.exists():  # another process was faster
            return
        try:
            url = download.retrieve(file.urls, path, sha256=file.sha256, accept=accept, progress=progress)
        except download.DownloadError as error:
            reasons = str(error) if file.urls else "  no address is known"
            failed = f"{name}: {file.file} could not be downloaded"
            raise WeightsError(f"{failed}\n{reasons}\n{_by_hand(entry, file)}") from None
        lock.write(path, url=url, method=name, tensors=accepted[-1])


def _examine(file: WeightsFile, found: Path, path: Path, check: Check) -> str:
    """Return the digest of a file's tensors, or refuse the file; its bytes lie at ``found``, it belongs at ``path``."""
    digest = lock.check_against_manifest(file, found)
    lock.refuse_change(path, digest)
    tensors = check(file, found)
    lock.refuse_twin(path, digest, tensors)
    return tensors


def _how_to_get(name: str, entry: WeightsEntry, file: WeightsFile) -> str:
    origins = [f"  {'or' if number else 'from'} {url}" for number, url in enumerate(file.urls)]
    missing = f"{name}: the weights {path_of(entry, file)} are missing ({_size(file)})"
    return "\n".join([missing, *origins, *_obtain(entry)])


def _by_hand(entry: WeightsEntry, file: WeightsFile) -> str:
    browser = [f"  by hand: open {url} in a browser and download the file ({_size(file)})" for url in file.urls[:1]]
    save = f"  save it as {path_of(entry, file)} and run the same command again, which checks it"
    return "\n".join([*browser, *_obtain(entry), save])


def _obtain(entry: WeightsEntry) -> list[str]:
    return [f"  {entry.obtain.strip()}"] if entry.obtain else []


def _size(file: WeightsFile, path: Path | None = None) -> str:
    size = path.stat().st_size if path and path.exists() else file.size
    return in_words(size) if size is not None or not file.megabytes else f"about {in_words(file.n_bytes)}"
