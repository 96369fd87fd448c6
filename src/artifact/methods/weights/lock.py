"""The lock file beside a file of weights: what the file was when it was first accepted.

Most released weights come without a checksum. The first file that fits its model is therefore recorded, and every later
use is compared with the record: by size and modification time, and only where these differ by content.
"""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from artifact import store
from artifact.datasets import lock_file
from artifact.datasets.lock_file import ENDING, path_of
from artifact.manifest.entries import WeightsFile

_KEYS = ("url", "size", "sha256", "tensors", "date")


class WeightsError(RuntimeError):
    """Weights that are missing, changed, or not those of the method; the message names the file and what to do."""


def read(path: Path) -> dict[str, Any]:
    """Return what the lock file of a file of weights records; raise :class:`WeightsError` if it is no lock file."""
    return lock_file.read(path, _KEYS, WeightsError)


def write(path: Path, *, url: str, method: str, tensors: str) -> None:
    """Record a file that was just accepted: where it came from, the method that it fits, the digest of its tensors."""
    now, record = store.stamp(path), {"file": path.name, "method": method, "url": url, "tensors": tensors}
    record |= {"sha256": sha256(path), "size": now[0], "stamp": now}
    with writing(path):
        lock_file.write(path, record)


@contextlib.contextmanager
def writing(path: Path) -> Iterator[None]:
    """Say in terms of a file of weights that its folder cannot be written."""
    try:
        yield
    except OSError as error:
        raise WeightsError(
            f"{path}: cannot write beside it ({error.strerror}), but its lock file {path_of(path).name} must be "
            f"written once; make the folder writable"
        ) from None


def compare(file: WeightsFile, path: Path) -> str:
    """Return the SHA-256 of a locked file of weights, after comparing the file with its lock file.

    Raises :class:`WeightsError` with both digests if the content differs from the record, or that from the manifest.
    """
    record, now = read(path), [*store.stamp(path)]
    if file.sha256 not in (None, record["sha256"]):
        raise WeightsError(
            f"{path}: the manifest says SHA-256 {file.sha256}, its lock file of {record['date']} says "
            f"{record['sha256']}; if the manifest is right, delete {path.name} and {path_of(path).name} and get it anew"
        )
    if record.get("stamp") != now:
        refuse_change(path, sha256(path))
        with contextlib.suppress(OSError):  # a folder that others own is read as it is
            store.write_json(path_of(path), {**record, "stamp": now})
    return str(record["sha256"])


def refuse_change(path: Path, digest: str) -> None:
    """Raise :class:`WeightsError` if a file of weights was locked with another SHA-256 than ``digest``."""
    record = read(path) if path_of(path).exists() else {"sha256": digest}
    if digest != record["sha256"]:
        raise WeightsError(
            f"{path}: its SHA-256 is {digest}, but {record['sha256']} was recorded on {record['date']} "
            f"({record['url']}). Descriptors made with the one do not fit the other: bring the earlier file back, or, "
            f"if the change is meant, delete {path_of(path).name}"
        )


def refuse_twin(path: Path, digest: str, tensors: str) -> None:
    """Raise :class:`WeightsError` if another locked file has the same content, or the same tensors in other packing.

    Two methods never have equal weights: one of the two files is under a wrong name.
    """
    for lock in sorted(path.parent.glob(f"*{ENDING}")):
        twin = lock.with_name(lock.name.removesuffix(ENDING))
        record = read(twin) if twin != path and twin.exists() else {}
        if record and (digest == record["sha256"] or tensors == record["tensors"]):
            raise WeightsError(
                f"{path.name} holds the same weights as {twin.name} of {record.get('method', 'another method')}, so "
                f"one of the two is not what its name says; delete that one and its lock file (NAME{ENDING})"
            )


def check_against_manifest(file: WeightsFile, found: Path) -> str:
    """Return the SHA-256 of a file that agrees with all that the manifest says of it, or raise `WeightsError`."""
    digest = sha256(found)
    for what, expected, measure in (
        ("bytes", file.size, lambda: found.stat().st_size),
        ("SHA-256", file.sha256, lambda: digest),
        ("git blob", file.git_blob, lambda: _git_blob(found)),
    ):
        if expected is not None and (actual := measure()) != expected:
            raise WeightsError(f"not the released {file.file}: {what} {actual}, the manifest says {expected}")
    return digest


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file; a file that was not written in between is read once per process."""
    try:
        return store.digest_of_file(path)
    except OSError as error:
        raise WeightsError(f"{path}: cannot be read ({error.strerror}); a file that you may read is needed") from None


def _git_blob(path: Path) -> str:
    header = f"blob {path.stat().st_size}\0".encode()
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, lambda: hashlib.sha1(header, usedforsecurity=False)).hexdigest()
