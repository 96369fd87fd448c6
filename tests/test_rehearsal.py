"""The whole paper on made descriptors: every page is made, says what it is, and lands near the paper's numbers."""

import base64
import io
import re
import shutil
from html import unescape

import pandas as pd
import pytest
from conftest import REPOSITORY, artifact, copy_book

NOTICE = "Rehearsal: made descriptors. No number on this page is a result"


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    """A project in which the rehearsal has run."""
    project = tmp_path_factory.mktemp("rehearsal")
    copy_book(project)
    shutil.copy(REPOSITORY / "data_manifest.yaml", project)
    status, output = artifact(project, "reproduce", "--profile", "rehearsal", "--jobs", "2")
    assert status == 0, output
    return project


@pytest.fixture(scope="module")
def pages(project):
    """The source of each page of the rehearsal's book."""
    executed = project / "book" / "_build" / "html" / "executed"
    return {path.stem: path.read_text() for path in executed.glob("*.html")}


def text(page):
    return re.sub(r"\s+", " ", unescape(re.sub(r"<[^>]+>", " ", page)))


def downloaded(page, start):
    """The table that a page offers under a name that begins so."""
    content = re.search(rf'download="{start}[^"]*" href="data:text/csv;base64,([^"]+)"', page)[1]
    return pd.read_csv(io.BytesIO(base64.b64decode(content)))


def test_every_page_says_that_it_is_a_rehearsal(pages):
    notebooks = {path.stem for path in (REPOSITORY / "notebooks").glob("*.py")}
    assert notebooks <= set(pages)
    assert [name for name, page in pages.items() if NOTICE not in text(page)] == []
    assert "real images" not in text(pages["tab03"])
    assert text(pages["status"]).count("made descriptors") > 12
    assert "shipped descriptors" not in text(pages["status"])


def test_the_books_tables_have_the_papers_rows(pages):
    assert (
        downloaded(pages["tab01"], "tab01")[["queries", "images"]].to_numpy().tolist()
        == [[200, "made descriptors"]] * 6
    )
    assert len(downloaded(pages["fig05"], "fig05")) == 66
    assert len(downloaded(pages["fig06"], "fig06a")) == 11 * 11
    assert len(downloaded(pages["fig06"], "fig06b")) == 11 * 7  # of the dataset that the profile names
    assert len(downloaded(pages["fig07"], "fig07")) == 11 * 5
    assert len(downloaded(pages["tab04"], "tab04")) == 2 * 54
    assert len(downloaded(pages["tab05"], "tab05")) == 2 * 2 * 9
    assert len(downloaded(pages["fig10"], "fig10")) == 3 * 54 * 4


def test_the_main_table_lands_near_the_papers(pages):
    found = re.search(r"Beside the paper: ([^.]*)\.", text(pages["tab03"]))[1]
    tally = {verdict: int(number) for number, verdict in re.findall(r"(\d+) (equal|agrees|differs|cannot tell)", found)}
    assert sum(tally.values()) == 249
    assert tally["equal"] + tally["agrees"] > 200
    assert tally.get("differs", 0) < 10


def test_pages_show_the_papers_own_choice(pages):
    assert set(downloaded(pages["fig03"], "fig03")["method"]) == {"anyloc"}
    for name in ("fig02", "fig09"):
        assert re.search(r"AnyLoc .*EigenPlaces", text(pages[name]))
        assert "RobotCar" in text(pages[name])
    assert "sun,clouds–overcast" in text(pages["tab05"])
    assert "spring–fall" in text(pages["tab05"])
    assert not re.search(r"day_left", text(pages["tab05"]))


def test_claims_have_a_verdict_each(pages):
    found = re.search(r"Of (\d+) claims (\d+) agree, (\d+) differ, (\d+) cannot be told", text(pages["opening"]))
    number, *counts = map(int, found.groups())
    assert number == len((REPOSITORY / "src/artifact/pages/claims.csv").read_text().splitlines()) - 1
    assert sum(counts) == number


def test_an_empty_clone_builds_the_same_pages_from_a_results_bundle(project, tmp_path):
    """Some pages, with two-stage methods, composed transforms and records of descriptors among them; no descriptors are made."""
    copy_book(tmp_path)
    shutil.copy(REPOSITORY / "data_manifest.yaml", tmp_path)
    status, output = artifact(project, "results", "export", str(tmp_path / "r.zip"), "--profile", "rehearsal")
    assert status == 0, output
    status, output = artifact(tmp_path, "results", "import", "r.zip")
    assert status == 0, output
    some = ["tab02", "tab03", "tab05", "fig07"]
    status, output = artifact(tmp_path, "run", "--profile", "rehearsal", "--jobs", "2", "--only", *some)
    assert status == 0, output
    assert list((tmp_path / ".cache").rglob("*.npy")) == []
    assert not {path.name for path in (tmp_path / ".cache" / "rankings").glob("*.npz")} - {
        path.name for path in (project / ".cache" / "rankings").glob("*.npz")
    }, "something was computed"
    for name in some:
        ours, theirs = ((place / "book" / "executed" / f"{name}.ipynb").read_text() for place in (tmp_path, project))
        assert re.sub(r"Run: [^<]*", "", ours) == re.sub(r"Run: [^<]*", "", theirs), name
    notices = (tmp_path / "book" / "executed" / "notice.txt").read_text().splitlines()
    assert notices[0].startswith(NOTICE)
    assert re.fullmatch(r"From the results bundle of \d{4}-\d\d-\d\d\.", notices[1])
