"""One file over HTTP, resumable at any moment.

What has arrived lies in a partial file; a journal beside it records the address, and how the server names this version
of the file (``ETag`` or ``Last-Modified``). A later call asks for the rest of the same version; if the server has
another one by then, the file is fetched anew. Nothing here judges the content: see :mod:`artifact.methods.weights`.
"""

from __future__ import annotations

import contextlib
import errno
import http.client
import os
import re
import shutil
import socket
import time
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

from tqdm import tqdm

from artifact import store

TIMEOUT = 30.0
"""Seconds without an answer after which an attempt is given up."""

PAUSE = 2.0
"""Seconds before the second attempt; each further pause is twice as long."""

ATTEMPTS = 5
"""Attempts in a row that bring nothing new, after which a download is given up."""

_CHUNK = 1 << 18
_HEAD = 512
_PASSING = {408, 425, 429, 500, 502, 503, 504}
_SPARE = 64 << 20  # bytes that a download leaves free on the disk

_DRIVE_PAGE = re.compile(r"https://drive\.google\.com/file/d/([\w-]+)")
_DRIVE_FILE = "https://drive.usercontent.google.com/download?id={}&export=download&confirm=t"


class DownloadError(RuntimeError):
    """A file that could not be fetched; what has arrived is kept, and the next call goes on from there."""


class _Interrupted(Exception):  # noqa: N818 - never leaves this module
    """An attempt that ended early; the next one may succeed."""


def is_drive(url: str) -> bool:
    """Whether an address is the page of a file on Google Drive, which only a browser can be sure to get.

    Examples
    --------
    >>> is_drive("https://drive.google.com/file/d/1B06ysb/view"), is_drive("https://example.org/a.pth")
    (True, False)
    """
    return _DRIVE_PAGE.match(url) is not None


def looks_like_page(head: bytes) -> bool:
    """Whether the first bytes of a file are those of a web page.

    Examples
    --------
    >>> looks_like_page(b"<!DOCTYPE html><title>Sign in"), looks_like_page(b"PK")
    (True, False)
    """
    return head.lstrip(b"\xef\xbb\xbf \t\r\n").lower().startswith((b"<!doctype html", b"<html", b"<?xml"))


def fetch(url: str, partial: Path, *, label: str, progress: bool = True) -> None:
    """Bring the file at an address into ``partial``, whole, going on from what is there.

    Parameters
    ----------
    url
        ``http://`` or ``https://``; the page of a Google Drive file stands for that file.
    partial
        The partial file; ``partial`` with ``.json`` added is its journal. Both stay until :func:`forget`.
    label
        Title of the progress bar.
    progress
        Whether to show a progress bar, where the output is a terminal.

    Raises
    ------
    DownloadError
        If the server refuses, sends a web page in place of the file, keeps ending early, or the disk has no room.
    """
    partial.parent.mkdir(parents=True, exist_ok=True)
    idle, farthest, reason = 0, _size(partial), ""
    with tqdm(
        unit="B", unit_scale=True, unit_divisor=1024, desc=label, leave=False, disable=None if progress else True
    ) as bar:
        while idle < ATTEMPTS:
            if idle:
                time.sleep(PAUSE * 2 ** (idle - 1))
            try:
                _attempt(url, partial, bar)
                return
            except _Interrupted as interruption:
                reason = str(interruption)
            idle = 0 if _size(partial) > farthest else idle + 1
            farthest = max(farthest, _size(partial))
    kept = _size(partial) if _known(url, partial).get("version") else 0
    more = f"; {kept:,} bytes are kept, run the same command again to go on" if kept else ""
    raise DownloadError(f"{reason}, in {ATTEMPTS} attempts{more}")


def forget(partial: Path) -> None:
    """Delete a partial file and its journal."""
    for path in (partial, _journal(partial)):
        path.unlink(missing_ok=True)


def _journal(partial: Path) -> Path:
    return partial.with_name(f"{partial.name}.json")


def _size(path: Path) -> int:
    return path.stat().st_size if path.exists() else 0


# -- one attempt -----------------------------------------------------------------------------------------------------


def _attempt(url: str, partial: Path, bar: tqdm) -> None:
    known = _known(url, partial)
    start = _size(partial) if known.get("version") else 0
    if start and start == known["total"]:
        return
    with _response(url, start, known, partial) as response:
        start, total = _range(response, start, known, partial)
        first = response.read(_HEAD)
        _refuse_page(url, response, b"" if start else first)
        _check_room(partial.parent, total, start)
        with _on_disk(partial):
            store.write_json(_journal(partial), {"url": url, "version": _version(response), "total": total})
        bar.reset(total)
        bar.update(start)
        received = start + _receive(response, first, partial, bar, append=start > 0)
    if total is not None and received != total:
        raise _Interrupted(f"the server ended after {received:,} of {total:,} bytes")


def _known(url: str, partial: Path) -> dict[str, Any]:
    """Return the journal of what has arrived from this address, empty if there is none."""
    with contextlib.suppress(store.StoreError):
        known = store.read_json(_journal(partial)) if _journal(partial).exists() else {}
        if isinstance(known, dict) and known.get("url") == url and partial.exists():
            return known
    return {}


@contextlib.contextmanager
def _response(url: str, start: int, known: dict[str, Any], partial: Path) -> Iterator[http.client.HTTPResponse]:
    drive = _DRIVE_PAGE.match(url)
    headers = {"User-Agent": f"artifact/{version('artifact')}", "Accept-Encoding": "identity"}
    if start:
        headers["Range"] = f"bytes={start}-"
        if not known["version"].startswith("W/"):
            headers["If-Range"] = known["version"]
    request = urllib.request.Request(_DRIVE_FILE.format(drive[1]) if drive else url, headers=headers)
    try:
        with urllib.request.urlopen(request, timeout=TIMEOUT) as response:
            yield response
    except urllib.error.HTTPError as error:
        error.close()
        if start and error.code == 416:  # the server's file is shorter than what we have: not the same any more
            forget(partial)
            raise _Interrupted("the file on the server has changed") from None
        if error.code in _PASSING:
            raise _Interrupted(f"the server answered {error.code} ({error.reason})") from None
        raise DownloadError(f"the server answered {error.code} ({error.reason})") from None
    except (urllib.error.URLError, http.client.HTTPException, OSError) as error:
        reason = getattr(error, "reason", error)
        if isinstance(reason, socket.gaierror):
            host = urllib.parse.urlsplit(request.full_url).hostname
            raise DownloadError(f"the address of {host} cannot be found; is there a network?") from None
        raise _Interrupted(f"the connection failed ({reason or type(error).__name__})") from None


def _range(
    response: http.client.HTTPResponse, start: int, known: dict[str, Any], partial: Path
) -> tuple[int, int | None]:
    """Return where the answer's bytes belong and how long the whole file is, if the server says so."""
    length = response.headers.get("Content-Length")
    if response.status != http.client.PARTIAL_CONTENT:
        return 0, int(length) if length and length.isdecimal() else None
    found = re.fullmatch(r"bytes (\d+)-\d+/(\d+)", response.headers.get("Content-Range", ""))
    same = (
        found and int(found[1]) == start and int(found[2]) == known["total"] and _version(response) == known["version"]
    )
    if not same:
        forget(partial)
        raise _Interrupted("the file on the server has changed")
    return start, known["total"]


def _version(response: http.client.HTTPResponse) -> str | None:
    return response.headers.get("ETag") or response.headers.get("Last-Modified")


def _receive(response: http.client.HTTPResponse, first: bytes, partial: Path, bar: tqdm, *, append: bool) -> int:
    """Write an answer to the partial file; what was written stays there however this ends."""
    with _on_disk(partial):
        stream = partial.open("ab" if append else "wb", buffering=0)
    received, chunk = 0, first
    with stream:
        while chunk:
            with _on_disk(partial):
                received += (written := stream.write(chunk) or 0)
            bar.update(written)
            chunk = chunk[written:] or response.read1(_CHUNK)
        with _on_disk(partial):
            os.fsync(stream.fileno())
    return received


@contextlib.contextmanager
def _on_disk(partial: Path) -> Iterator[None]:
    """Tell a fault of the disk from one of the connection: both are an ``OSError``."""
    try:
        yield
    except OSError as error:
        full = error.errno in (errno.ENOSPC, errno.EDQUOT)
        remedy = "free some room" if full else "make it writable"
        raise DownloadError(
            f"cannot write {partial} ({error.strerror}); {remedy} and run again: it goes on from what has arrived"
        ) from None


def _refuse_page(url: str, response: http.client.HTTPResponse, head: bytes) -> None:
    if response.headers.get_content_type() in ("text/html", "application/xhtml+xml") or looks_like_page(head):
        why = "; Google Drive does so when a file is asked for too often" if is_drive(url) else ""
        raise DownloadError(f"the server sent a web page in place of the file{why}")


def _check_room(folder: Path, total: int | None, start: int) -> None:
    needed, free = (total or 0) - start, shutil.disk_usage(folder).free
    if needed + _SPARE > free:
        raise DownloadError(
            f"{folder} has {free / 1e6:,.0f} MB free, the download needs {(needed + _SPARE) / 1e6:,.0f} MB; "
            f"free some room and run again"
        )
