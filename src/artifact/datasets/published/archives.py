"""Reading of archives that others made: nothing in them chooses where a file is written.

Files are read one by one in the archive's order and written by the caller under names of its own. Archives with links,
devices, absolute paths or ``..``, and those that unpack to far more than photographs do, are refused as a whole.
"""

from __future__ import annotations

import contextlib
import gzip
import shutil
import stat
import tarfile
import zipfile
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path, PurePosixPath
from typing import IO

from artifact.datasets.disk import free_bytes, in_words
from artifact.datasets.download import looks_like_page
from artifact.datasets.traversal import DatasetError

_EXPANSION = 25  # times its size that an archive may unpack to; photographs and films hardly shrink
_SMALL = 64 << 20  # bytes that any archive may unpack to
_SPARE = 64 << 20  # bytes that are left free on the disk
_DAMAGE = (zipfile.BadZipFile, tarfile.TarError, gzip.BadGzipFile, zlib.error, EOFError, NotImplementedError)


@dataclass(frozen=True)
class Member:
    """A file in an archive: its ``name`` with folders, its ``size`` in bytes, and its content while its turn lasts."""

    name: str
    size: int
    _archive: Path = field(repr=False)
    _open: Callable[[], IO[bytes]] = field(repr=False)

    def read(self) -> bytes:
        """Return the content, checked against the archive's own checksums if it has any."""
        with _legible(self._archive), self._open() as stream:
            content = stream.read()
        if len(content) != self.size:
            raise _damaged(self._archive, f"{self.name} ends after {len(content):,} of {self.size:,} bytes")
        return content

    def copy_to(self, target: Path) -> None:
        """Write the content to a file, which gets its name when it is whole."""
        require_room(target.parent, self.size)
        unfinished = target.with_name(f".{target.name}.part")
        with _legible(self._archive), self._open() as stream, unfinished.open("wb") as written:
            shutil.copyfileobj(stream, written, 1 << 20)
        if unfinished.stat().st_size != self.size:
            raise _damaged(self._archive, f"{self.name} is cut short")
        unfinished.replace(target)


def members(path: Path) -> Iterator[Member]:
    """Yield the files of a ``.zip`` or a (compressed) ``.tar`` archive; each can be read until the next one is asked for.

    Hidden files and the folders ``__MACOSX`` that some archives hold are passed over. Raises ``DatasetError`` if the archive
    is missing, is a web page, is damaged or cut short, or is refused.
    """
    try:
        with path.open("rb") as stream:
            head = stream.read(512)
    except OSError as error:
        raise DatasetError(f"{path}: cannot be read ({error.strerror})") from None
    if looks_like_page(head):
        raise DatasetError(
            f"{path}: is a web page, not an archive; delete it, open its address in a browser and download the file itself"
        )
    total, limit = 0, max(_SMALL, _EXPANSION * path.stat().st_size)
    with _legible(path):
        found = _of_zip(path) if head.startswith(b"PK") else _of_tar(path)
        for member in found:
            total += member.size
            if total > limit:
                raise _refused(path, f"unpacks to more than {in_words(limit)}, which no archive of photographs does")
            if not any(part.startswith((".", "__MACOSX")) for part in PurePosixPath(member.name).parts):
                yield member


def require_room(folder: Path, size: int) -> None:
    """Raise ``DatasetError`` if the disk of a folder has no room for so many bytes."""
    needed, free = size + _SPARE, free_bytes(folder)
    if needed > free:
        raise DatasetError(
            f"{folder} has {in_words(free)} free, {in_words(needed)} are needed; free some room and run again"
        )


def _of_zip(path: Path) -> Iterator[Member]:
    with zipfile.ZipFile(path) as archive:
        for info in archive.infolist():
            if stat.S_ISLNK(info.external_attr >> 16):
                raise _refused(path, f"holds the link {info.filename!r}")
            if info.flag_bits & 1:
                raise _refused(path, f"{info.filename!r} is encrypted")
            if not info.is_dir():
                yield Member(_safe(path, info.filename), info.file_size, path, partial(archive.open, info))


def _of_tar(path: Path) -> Iterator[Member]:
    with tarfile.open(path, "r:*") as archive:
        for info in archive:
            if info.issym() or info.islnk():
                raise _refused(path, f"holds the link {info.name!r} to {info.linkname!r}")
            if info.isreg():
                yield Member(_safe(path, info.name), info.size, path, partial(archive.extractfile, info))
            elif not info.isdir():
                raise _refused(path, f"holds the device {info.name!r}")
            archive.members = []  # a list of all that was read is kept otherwise
        # Python takes an archive that ends in the middle of a header for a whole one.
        archive.fileobj.seek(archive.offset)
        if len(archive.fileobj.read(tarfile.BLOCKSIZE)) < tarfile.BLOCKSIZE:
            raise _damaged(path, "the mark of its end is missing")


def _safe(path: Path, name: str) -> str:
    """The name of a member without ``./`` before it, if it lies inside the folder that it would be unpacked in."""
    pure = PurePosixPath(name.replace("\\", "/"))
    if pure.is_absolute() or ".." in pure.parts or (pure.parts and pure.parts[0].endswith(":")):
        raise _refused(path, f"holds {name!r}, which leads out of the folder that it would be unpacked in")
    return str(pure)


@contextlib.contextmanager
def _legible(path: Path) -> Iterator[None]:
    """Say of an archive that it is damaged; faults of the disk are no damage."""
    try:
        yield
    except _DAMAGE as error:
        raise _damaged(path, (str(error) or type(error).__name__).splitlines()[0]) from None


def _damaged(path: Path, why: str) -> DatasetError:
    return DatasetError(f"{path}: damaged or cut short ({why}); delete it and get it again")


def _refused(path: Path, why: str) -> DatasetError:
    return DatasetError(f"{path}: {why}, so nothing of it is unpacked; is it the published file?")
