"""A server with all the habits of real ones, and a small model with weights to serve: for the tests of released weights."""

from __future__ import annotations

import contextlib
import http.server
import re
import threading
import time
from dataclasses import dataclass, field

import pytest
import torch
from conftest import THUMBNAIL
from torch import nn

from artifact.datasets import download
from artifact.manifest.entries import MethodEntry
from artifact.methods import weights


@dataclass
class Page:
    """One file of the server, and how it is served."""

    content: bytes
    etag: str | None = '"one"'
    modified: str | None = None
    kind: str = "application/octet-stream"
    ranges: bool = True
    heeds_if_range: bool = True
    says_length: bool = True
    statuses: list[int] = field(default_factory=list)  # answered first, one by one
    ends_after: list[int] = field(default_factory=list)  # bytes after which each of the next answers breaks off
    moved_to: str | None = None
    slow: float = 0.0
    asked: list[dict[str, str]] = field(default_factory=list)


class Handler(http.server.BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.0"

    def do_GET(self):
        page = self.server.pages.get(self.path)
        if page is None:
            self.send_error(404)
            return
        page.asked.append(dict(self.headers))
        if page.statuses:
            self.send_error(page.statuses.pop(0))
            return
        if page.moved_to:
            self.send_response(302)
            self.send_header("Location", page.moved_to)
            self.end_headers()
            return
        self._send(page)

    def _send(self, page):
        start, asked, condition = 0, self.headers.get("Range"), self.headers.get("If-Range")
        current = condition in (None, page.etag, page.modified) or not page.heeds_if_range
        if asked and page.ranges and current:
            start = int(re.fullmatch(r"bytes=(\d+)-", asked)[1])
            if start >= len(page.content):
                self.send_error(416)
                return
            self.send_response(206)
            self.send_header("Content-Range", f"bytes {start}-{len(page.content) - 1}/{len(page.content)}")
        else:
            self.send_response(200)
        body = page.content[start:]
        self.send_header("Content-Type", page.kind)
        if page.says_length:
            self.send_header("Content-Length", str(len(body)))
        for name, value in (("ETag", page.etag), ("Last-Modified", page.modified)):
            if value:
                self.send_header(name, value)
        self.end_headers()
        body = body[: page.ends_after.pop(0)] if page.ends_after else body
        for at in range(0, len(body), 4096):
            self.wfile.write(body[at : at + 4096])
            time.sleep(page.slow)

    def log_message(self, *_):
        pass


class Server(http.server.ThreadingHTTPServer):
    daemon_threads = True

    def __init__(self):
        super().__init__(("127.0.0.1", 0), Handler)
        self.pages = {}

    def handle_error(self, *_):  # a client that went away
        pass

    def serve(self, path, content, **habits):
        self.pages[f"/{path}"] = Page(content, **habits)
        return f"http://127.0.0.1:{self.server_port}/{path}"

    def requests(self, path):
        return self.pages[f"/{path}"].asked


@contextlib.contextmanager
def running():
    """A server that runs for a while, with no pauses between attempts and no proxy in between."""
    with Server() as server, pytest.MonkeyPatch.context() as patch:
        patch.setattr(download, "PAUSE", 0.0)
        patch.setenv("no_proxy", "*")
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        try:
            yield server
        finally:
            server.shutdown()
            thread.join()


class Tiny(nn.Module):
    """Sixteen grey values to three: enough of a descriptor to run."""

    def __init__(self):
        super().__init__()
        self.head = nn.Linear(16, 3)
        self.norm = nn.BatchNorm1d(3)

    def forward(self, batch):
        return nn.functional.normalize(self.norm(self.head(batch.flatten(1)[:, :16])), dim=1)


def tiny():
    return Tiny()


class Aggregated(Tiny):
    def __init__(self):
        super().__init__()
        self.c_centers = nn.Parameter(torch.zeros(2, 5))


def aggregated():
    return Aggregated()


def state_of(seed=0, build=Tiny):
    generator = torch.Generator().manual_seed(seed)
    state = build().state_dict()
    return {k: torch.rand(t.shape, generator=generator) + 0.1 if t.is_floating_point() else t for k, t in state.items()}


def packed(content, folder, *, legacy=False):
    path = folder / "packed"
    torch.save(content, path, _use_new_zipfile_serialization=not legacy)
    return path.read_bytes()


def entry_of(folder, *files, builder="released:tiny", kind="paper", **keys):
    """A method whose weights are these files, each a mapping of manifest keys, in a folder of their own."""
    files = [{"file": "tiny.pth"} | file for file in files or [{}]]
    content = THUMBNAIL | {
        "title": "Tiny",
        "kind": kind,
        "dimension": 3,
        "weights": {"files": files, "licence": "MIT"} | keys,
    }
    content |= {"builder": builder} if builder else {}
    content["weights"] |= {"folder": str(folder / "weights")}
    return MethodEntry.model_validate(content)


def put(entry, content, number=0):
    path = weights.path_of(entry.weights, entry.weights.files[number])
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    return path


def names_in(folder):
    """Files of a folder, but for the locks between processes, which are empty."""
    return {path.name for path in folder.iterdir() if path.stat().st_size} if folder.is_dir() else set()


def equal(state, other):
    return state.keys() == other.keys() and all(torch.equal(state[key], other[key]) for key in state)
