"""A file over HTTP: from the first mirror that has it, resumable at any moment, whole and checked or not at all.

`pooch` names a file and compares its SHA-256. The transfer is done here, since that of pooch starts anew after every
interruption: a journal beside the partial file records the address and the version (``ETag`` or ``Last-Modified``), of
which a later call asks for the rest; if the server has another one by then, the file is fetched anew.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import http.client
import importlib.metadata
import os
import re
import socket
import time
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from tqdm import tqdm

from artifact import store
from artifact.datasets.disk import free_bytes, in_words

TIMEOUT = 30.0  # seconds without an answer after which an attempt is given up
PAUSE = 2.0  # seconds before the second attempt; each further pause is twice as long
ATTEMPTS = 5  # in a row that bring nothing new, after which a download is given up
_CHUNK = 1 << 18
_HEAD = 512
_PASSING = {408, 425, 429, 500, 502, 503, 504}
_SPARE = 64 << 20  # bytes that a download leaves free on the disk

_DRIVE_PAGE = re.compile(r"https://drive\.google\.com/file/d/([\w-]+)")
_DRIVE_FILE = "https://drive.usercontent.google.com/download?id={}&export=download&confirm=t"


class DownloadError(RuntimeError):
    """A file that could not be fetched, or is refused."""


class _Interrupted(Exception):  # noqa: N818 - never leaves this module
    """An attempt that ended early; the next one may succeed."""


def looks_like_page(head: bytes) -> bool:
    """Whether the first bytes of a file are those of a web page.

    Examples
    --------
    >>> looks_like_page(b"<!DOCTYPE html><title>Sign in"), looks_like_page(b"PK")
    (True, False)
    """
    return head.lstrip(b"\xef\xbb\xbf \t\r\n").lower().startswith((b"<!doctype html", b"<html", b"<?xml"))


def retrieve(
    urls: Sequence[str],
    target: Path,
    *,
    sha256: str | None = None,
    size: int | None = None,
    accept: Callable[[Path], None] | None = None,
    progress: bool = True,
) -> str:
    """Bring a file from the first of its addresses that gives the right one; return that address.

    Parameters
    ----------
    urls
        ``http://`` or ``https://``, tried in order; the page of a Google Drive file stands for that file.
    target
        Where the file belongs; it gets this name when it is whole and accepted.
    sha256, size
        What is known of the file. A target that is there already and has this SHA-256 is left as it is.
    accept
        Asked before the file gets its name; raises :class:`DownloadError` with the reason if it is not the right one.
    progress
        Whether to show progress bars, where the output is a terminal.

    Raises
    ------
    DownloadError
        If no address gives the file; the message has a line for each and its reason. What arrived is kept for the next
        call, but for a file that was refused.
    """
    import pooch  # not with the module: in a notebook without widgets, its import warns

    if target.exists() and sha256 not in (None, store.digest_of_file(target)):
        raise DownloadError(f"{target} is there, but its SHA-256 is not {sha256}; move it away and run again")

    def bring(url: str, output_file: str, _: pooch.Pooch) -> None:
        partial = target.with_name(f".{target.name}.{hashlib.sha256(url.encode()).hexdigest()[:8]}.partial")
        fetch(url, partial, label=target.name, progress=progress, size=size)
        try:
            if size not in (None, _size(partial)):
                raise DownloadError(f"not {target.name}: bytes {_size(partial)}, the manifest says {size}")
            if accept is not None:
                accept(partial)
        except DownloadError:  # whole, but not the right file: going on from it makes no sense
            forget(partial)
            raise
        partial.replace(output_file)
        forget(partial)

    pooch.get_logger().setLevel("WARNING")
    reasons = []
    for url in urls:
        registry = pooch.create(target.parent, base_url="", registry={target.name: sha256}, urls={target.name: url})
        try:
            with _on_disk(target):
                registry.fetch(target.name, downloader=bring)
        except (DownloadError, ValueError) as error:  # pooch raises ValueError for another SHA-256
            reasons.append(f"  {url}\n    {error}")
        else:
            for left in target.parent.glob(f".{target.name}.{'?' * 8}.partial*"):  # of mirrors that broke off
                left.unlink()
            return url
    raise DownloadError("\n".join(reasons) or f"no address of {target.name} is known")


def fetch(url: str, partial: Path, *, label: str, progress: bool = True, size: int | None = None) -> None:
    """Bring the file at an address into ``partial``, whole, going on from what is there; its content is not judged.

    ``partial`` with ``.json`` added is its journal; both stay until :func:`forget`. ``label`` is the title of the bar. A file
    that turns out longer than ``size``, or that no disk would hold, is given up.
    Raises :class:`DownloadError` if the server refuses, sends a web page, keeps ending early, or the disk has no room.
    """
    idle, farthest, reason = 0, _size(partial), ""
    with (
        _on_disk(partial),
        tqdm(unit="B", unit_scale=True, desc=label, leave=False, disable=None if progress else True) as bar,
    ):
        partial.parent.mkdir(parents=True, exist_ok=True)
        while idle < ATTEMPTS:
            if idle:
                time.sleep(PAUSE * 2 ** (idle - 1))
            try:
                _attempt(url, partial, bar, size)
                return
            except _Interrupted as interruption:
                reason = str(interruption)
            idle = 0 if _size(partial) > farthest else idle + 1
            farthest = max(farthest, _size(partial))
    kept = _size(partial) if _journal_of(url, partial) else 0
    more = f"; {kept:,} bytes are kept, run the same command again to go on" if kept else ""
    raise DownloadError(f"{reason}, in {ATTEMPTS} attempts{more}")


def forget(partial: Path) -> None:
    """Delete a partial file and its journal."""
    for path in (partial, _journal_path(partial)):
        path.unlink(missing_ok=True)


def _journal_path(partial: Path) -> Path:
    return partial.with_name(f"{partial.name}.json")


def _journal_of(url: str, partial: Path) -> dict[str, Any]:
    """Return the journal of what has arrived from this address; empty if nothing that another call can go on from."""
    with contextlib.suppress(store.StoreError):
        journal = store.read_json(_journal_path(partial)) if _size(partial) else {}
        if isinstance(journal, dict) and journal.get("url") == url and journal.get("version"):
            return journal
    return {}


def _size(path: Path) -> int:
    return path.stat().st_size if path.exists() else 0


def _attempt(url: str, partial: Path, bar: tqdm, size: int | None) -> None:
    journal = _journal_of(url, partial)
    start = _size(partial) if journal else 0
    if journal and start == journal["total"]:
        return
    request = _request(url, start, journal)
    with _response(request, partial) as response:
        version, total = response.headers.get("ETag") or response.headers.get("Last-Modified"), journal.get("total")
        if response.status == http.client.PARTIAL_CONTENT:
            span = re.fullmatch(r"bytes (\d+)-\d+/(\d+)", response.headers.get("Content-Range", ""))
            if not span or (int(span[1]), int(span[2]), version) != (start, total, journal.get("version")):
                raise _changed(partial)
        else:
            length = response.headers.get("Content-Length") or ""
            start, total = 0, int(length) if length.isdecimal() else None
        with _on_network(request):
            chunk = response.read(_HEAD)
        kind = response.headers.get_content_type()
        if kind in ("text/html", "application/xhtml+xml") or (not start and looks_like_page(chunk)):
            why = "; Google Drive does so when a file is asked for too often" if _DRIVE_PAGE.match(url) else ""
            raise DownloadError(f"the server sent a web page in place of the file{why}")
        needed, free = (total or 0) - start + _SPARE, free_bytes(partial.parent)
        if needed > free:
            room = f"{in_words(free)} free, the download needs {in_words(needed)}"
            raise DownloadError(f"{partial.parent} has {room}; free some room and run again")
        if not start:  # a journal must never stand beside the bytes of another version
            partial.unlink(missing_ok=True)
        store.write_json(_journal_path(partial), {"url": url, "version": version, "total": total})
        bar.reset(total)
        bar.update(start)
        with partial.open("ab" if start else "wb", buffering=0) as stream:
            while chunk:
                written = stream.write(chunk) or 0
                bar.update(written)
                _refuse_endless(partial, stream.tell(), size)
                with _on_network(request):
                    chunk = chunk[written:] or response.read1(_CHUNK)
            os.fsync(stream.fileno())
    if total not in (None, _size(partial)):
        raise _Interrupted(f"the server ended after {_size(partial):,} of {total:,} bytes")


def _refuse_endless(partial: Path, arrived: int, size: int | None) -> None:
    """Give up a file that is longer than it should be, or of unknown length and filling the disk."""
    if size is not None and arrived > size:
        forget(partial)
        raise DownloadError(f"the server sends more than the {size:,} bytes that the manifest says")
    if free_bytes(partial.parent) < _SPARE:
        forget(partial)
        raise DownloadError(f"{partial.parent} has less than {in_words(_SPARE)} left; free some room and run again")


def _request(url: str, start: int, journal: dict[str, Any]) -> urllib.request.Request:
    drive = _DRIVE_PAGE.match(url)
    request = urllib.request.Request(_DRIVE_FILE.format(drive[1]) if drive else url)
    request.add_header("User-Agent", f"artifact/{importlib.metadata.version('artifact')}")
    request.add_header("Accept-Encoding", "identity")
    if start:
        request.add_header("Range", f"bytes={start}-")
        if not journal["version"].startswith("W/"):
            request.add_header("If-Range", journal["version"])
    return request


def _response(request: urllib.request.Request, partial: Path) -> http.client.HTTPResponse:
    with _on_network(request):
        try:
            response = urllib.request.urlopen(request, timeout=TIMEOUT)
        except urllib.error.HTTPError as error:
            error.close()
            if error.code == 416 and request.has_header("Range"):  # the server's file is shorter than what we have
                raise _changed(partial) from None
            fault = _Interrupted if error.code in _PASSING else DownloadError
            raise fault(f"the server answered {error.code} ({error.reason})") from None
    if not isinstance(response, http.client.HTTPResponse):
        raise DownloadError(f"the server leads to {response.url}; only http and https are allowed")
    return response


def _changed(partial: Path) -> _Interrupted:
    forget(partial)
    return _Interrupted("the file on the server has changed")


@contextlib.contextmanager
def _on_network(request: urllib.request.Request) -> Iterator[None]:
    """Tell a fault of the connection from one of the disk: both are an ``OSError``."""
    try:
        yield
    except (OSError, http.client.HTTPException) as error:
        reason = getattr(error, "reason", error)
        if isinstance(reason, socket.gaierror):
            host = urllib.parse.urlsplit(request.full_url).hostname
            raise DownloadError(f"the address of {host} cannot be found; is there a network?") from None
        raise _Interrupted(f"the connection failed ({reason or type(error).__name__})") from None


@contextlib.contextmanager
def _on_disk(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        remedy = "free some room" if error.errno in (errno.ENOSPC, errno.EDQUOT) else "make it writable"
        raise DownloadError(
            f"cannot write {path} ({error.strerror or error}); {remedy} and run again: it goes on from what has arrived"
        ) from None
