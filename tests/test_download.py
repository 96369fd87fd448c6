"""Downloads: the right bytes, whatever server, network and disk do."""

from __future__ import annotations

import resource
import types

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from released import names_in, running

from artifact.methods.weights import download
from artifact.methods.weights.download import DownloadError


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
        None, "bytes=10000-", "bytes=10000-", "bytes=30000-", "bytes=30000-",
    ]  # fmt: skip
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
)  # fmt: skip
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
    monkeypatch.setattr(download.shutil, "disk_usage", lambda _: free)
    url = server.serve("a", content)
    with pytest.raises(DownloadError, match=r"67 MB free, the download needs 67 MB; free some room"):
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
