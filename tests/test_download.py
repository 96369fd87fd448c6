"""Downloads: the right bytes, whatever server, network and disk do."""

from __future__ import annotations

import hashlib
import resource
import shutil
import types

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from released import names_in, running

from artifact.datasets import download
from artifact.datasets.download import DownloadError


@pytest.fixture
def server():
    with running() as server:
        yield server


@pytest.fixture(scope="module")
def content():
    return bytes(range(256)) * 256


@pytest.mark.parametrize(
    "habits", [{}, {"etag": None, "modified": "Sun, 22 Nov 2026 08:00:00 GMT"}, {"etag": 'W/"weak"'}]
)
def test_an_interrupted_download_goes_on_where_it_was(tmp_path, server, monkeypatch, content, habits):
    monkeypatch.setattr(download, "ATTEMPTS", 1)
    partial, url = tmp_path / ".partial", server.serve("a", content, ends_after=[10_000, 0, 20_000, 0], **habits)
    for arrived in (10_000, 30_000):
        with pytest.raises(DownloadError, match=f"ended after {arrived:,} of 65,536 bytes.*{arrived:,} bytes are kept"):
            download.fetch(url, partial, label="a", progress=False)
        assert partial.read_bytes() == content[:arrived]
    download.fetch(url, partial, label="a", progress=False)
    assert partial.read_bytes() == content
    assert [asked.get("Range") for asked in server.requests("a")] == [
        None,
        "bytes=10000-",
        "bytes=10000-",
        "bytes=30000-",
        "bytes=30000-",
    ]
    condition = server.requests("a")[1].get("If-Range")
    assert condition == (None if "W/" in str(habits) else habits.get("modified", '"one"'))
    download.fetch(url, partial, label="a", progress=False)  # whole already: killed before it was examined, say
    assert len(server.requests("a")) == 5


@settings(max_examples=25, deadline=None, derandomize=True)
@given(ends=st.lists(st.integers(1, 70_000), max_size=8), ranges=st.booleans(), etag=st.sampled_from(['"one"', None]))
def test_however_a_server_breaks_off_the_bytes_are_right_or_there_is_an_error(
    tmp_path_factory, content, ends, ranges, etag
):
    partial = tmp_path_factory.mktemp("download") / "partial"
    with running() as server:
        url = server.serve("a", content, ends_after=list(ends), ranges=ranges, etag=etag)
        try:
            download.fetch(url, partial, label="a", progress=False)
        except DownloadError:
            assert not (ranges and etag), "whoever can go on gets there"
            assert len(server.requests("a")) >= download.ATTEMPTS
        else:
            assert partial.read_bytes() == content


@pytest.mark.parametrize(
    "habits",
    [
        pytest.param({"etag": '"two"'}, id="other version, the server notices"),
        pytest.param({"etag": '"two"', "heeds_if_range": False}, id="other version, the server does not notice"),
        pytest.param({"heeds_if_range": False, "longer": 1000}, id="other length under the same name"),
        pytest.param({"heeds_if_range": False, "longer": -60_000}, id="now shorter than what has arrived"),
        pytest.param({"ranges": False}, id="no ranges any more"),
    ],
)
def test_bytes_of_two_versions_are_never_mixed(tmp_path, server, monkeypatch, content, habits):
    partial, url = tmp_path / ".partial", server.serve("a", content, ends_after=[10_000, 0])
    with monkeypatch.context() as patch:
        patch.setattr(download, "ATTEMPTS", 1)
        with pytest.raises(DownloadError):
            download.fetch(url, partial, label="a", progress=False)
    longer = habits.pop("longer", 0)
    other = content[::-1] + bytes(longer) if longer >= 0 else content[::-1][:longer]
    server.serve("a", other, **habits)
    download.fetch(url, partial, label="a", progress=False)
    assert partial.read_bytes() == other


def test_without_a_name_for_the_version_nothing_is_resumed(tmp_path, server, content):
    url = server.serve("a", content, etag=None, ends_after=[10_000])
    download.fetch(url, tmp_path / "partial", label="a", progress=False)
    assert (tmp_path / "partial").read_bytes() == content
    assert [asked.get("Range") for asked in server.requests("a")] == [None, None]


def test_a_file_of_unknown_length_and_a_redirection(tmp_path, server, content):
    server.serve("b", content, says_length=False)
    url = server.serve("a", b"", moved_to="/b")
    download.fetch(url, tmp_path / "partial", label="a", progress=False)
    assert (tmp_path / "partial").read_bytes() == content


def test_a_redirection_to_a_local_file_is_refused(tmp_path, server):
    (tmp_path / "secret").write_bytes(b"secret")
    url = server.serve("a", b"", moved_to=(tmp_path / "secret").as_uri())
    with pytest.raises(DownloadError, match="the server answered 302"):
        download.fetch(url, tmp_path / "partial", label="a", progress=False)
    assert not (tmp_path / "partial").exists()


@pytest.mark.parametrize(("statuses", "asked"), [([503, 429, 500], 4), ([404], 1), ([403], 1), ([503] * 9, 5)])
def test_passing_faults_of_a_server_are_waited_out_and_others_reported(tmp_path, server, content, statuses, asked):
    url = server.serve("a", content, statuses=list(statuses))
    if asked == 4:
        download.fetch(url, tmp_path / "partial", label="a", progress=False)
        assert (tmp_path / "partial").read_bytes() == content
    else:
        with pytest.raises(DownloadError, match=f"the server answered {statuses[0]}"):
            download.fetch(url, tmp_path / "partial", label="a", progress=False)
        assert not (tmp_path / "partial").exists()
    assert len(server.requests("a")) == asked


def test_no_network_is_said_at_once(tmp_path, server):
    with pytest.raises(DownloadError, match=r"the address of nowhere.invalid cannot be found; is there a network\?"):
        download.fetch("http://nowhere.invalid/a", tmp_path / "partial", label="a", progress=False)
    with pytest.raises(DownloadError, match=r"the connection failed .*refused.* in 5 attempts"):
        download.fetch("http://127.0.0.1:9/a", tmp_path / "partial", label="a", progress=False)


# --- disk ---


def test_a_download_that_the_disk_cannot_hold_is_not_begun(tmp_path, server, monkeypatch, content):
    free = types.SimpleNamespace(free=download._SPARE + len(content) - 1)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: free)
    url = server.serve("a", content)
    with pytest.raises(DownloadError, match=r"67\.\d MB free, the download needs 67\.\d MB; free some room"):
        download.fetch(url, tmp_path / "partial", label="a", progress=False)
    assert names_in(tmp_path) == set()
    free.free += 1
    download.fetch(url, tmp_path / "partial", label="a", progress=False)


def test_a_disk_that_fills_up_is_named_and_the_download_goes_on_later(tmp_path, server, content):
    """The kernel refuses to let a file grow, as a full disk does."""
    url = server.serve("a", content)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (30_000, hard))
    try:
        with pytest.raises(DownloadError, match=r"cannot write .*partial \(.*\).* run again: it goes on"):
            download.fetch(url, tmp_path / "partial", label="a", progress=False)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert (tmp_path / "partial").read_bytes() == content[:30_000]
    download.fetch(url, tmp_path / "partial", label="a", progress=False)
    assert (tmp_path / "partial").read_bytes() == content
    assert server.requests("a")[-1]["Range"] == "bytes=30000-"


# --- one file from several addresses ---


def test_a_file_comes_from_the_first_mirror_that_has_the_right_one(tmp_path, server, content, capfd):
    target, known = tmp_path / "folder" / "file", hashlib.sha256(content).hexdigest()
    gone = f"{server.serve('there', b'')}/not"
    other, right = server.serve("other", b"other"), server.serve("right", content)
    unasked = server.serve("unasked", content)
    assert download.retrieve([gone, other, right, unasked], target, sha256=known, progress=False) == right
    assert target.read_bytes() == content
    assert names_in(target.parent) == {"file"}
    assert not server.requests("unasked")
    download.retrieve([right], target, sha256=known, progress=False)
    assert len(server.requests("right")) == 1
    assert "".join(capfd.readouterr()) == ""


@pytest.mark.parametrize(
    ("known", "message"),
    [
        ({"sha256": "0" * 64}, f"does not match the known hash: expected {'0' * 64}"),
        ({"size": 3}, "more than the 3 bytes that the manifest says"),
        ({"size": 70_000}, "bytes 65536, the manifest says 70000"),
        ({"accept": lambda _: (_ for _ in ()).throw(DownloadError("not this one"))}, "not this one"),
    ],
)
def test_a_file_that_is_not_the_right_one_is_not_kept(tmp_path, server, content, known, message):
    urls = [server.serve("a", content), server.serve("b", content)]
    with pytest.raises(DownloadError) as caught:
        download.retrieve(urls, tmp_path / "file", progress=False, **known)
    lines = str(caught.value).splitlines()
    assert [line.strip() for line in lines[::2]] == urls
    assert all(message in line for line in lines[1::2])
    assert names_in(tmp_path) == set()


def test_a_file_of_other_content_that_is_there_is_never_replaced(tmp_path, server, content):
    (tmp_path / "file").write_bytes(b"mine")
    with pytest.raises(DownloadError, match=r"file is there, but its SHA-256 is not 0000.*; move it away"):
        download.retrieve([server.serve("a", content)], tmp_path / "file", sha256="0" * 64, progress=False)
    assert (tmp_path / "file").read_bytes() == b"mine"


def test_a_transfer_that_broke_off_is_kept_for_the_next_call(tmp_path, server, monkeypatch, content):
    monkeypatch.setattr(download, "ATTEMPTS", 1)
    url = server.serve("a", content, ends_after=[10_000, 0])
    with pytest.raises(DownloadError, match="10,000 bytes are kept"):
        download.retrieve([url], tmp_path / "file", progress=False)
    assert not (tmp_path / "file").exists()
    download.retrieve([url], tmp_path / "file", progress=False)
    assert (tmp_path / "file").read_bytes() == content
    assert server.requests("a")[-1]["Range"] == "bytes=10000-"
    assert names_in(tmp_path) == {"file"}
