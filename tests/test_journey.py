"""A user's journey on a tiny project: run, run again, change one thing, break one thing, read the book.

The project has the repository's own notebooks and book, a manifest of two small drives with further conditions, and
two baselines. Everything goes through the command line, as the Makefile calls it.
"""

import re
import shutil
from dataclasses import replace
from html import unescape

import nbformat
import pytest
import yaml
from conftest import DRIVE, artifact, copy_book, flip, tiny_manifest, write_images, write_manifest

from artifact import manifest
from artifact.book import build, parameters


def executed(project):
    return {path.stem: nbformat.read(path, as_version=4) for path in (project / "book" / "executed").glob("*.ipynb")}


def own(project, name):
    """The pages that were made of a notebook with other parameters than the profile's, as texts."""
    return [nbformat.writes(page) for stem, page in executed(project).items() if stem.startswith(f"{name}-")]


@pytest.fixture(autouse=True)
def own_pages_go_with_their_test(tiny):
    yield
    for path in (tiny[0] / "book" / "executed").glob("*-*"):
        path.unlink()


def counts(output):
    found = re.search(r"notebooks: (\d+) run, (\d+) unchanged", output)
    return int(found[1]), int(found[2])


def test_every_notebook_ran_and_every_page_is_there(tiny):
    project, output = tiny
    names = {path.stem for path in (project / "notebooks").glob("*.py")}
    assert counts(output) == (len(names), 0)
    assert re.search(
        r"(?m)^notebooks +\d+ s\n  rank +\d+ s of all processes\n  fit +\d+ s of all processes\nbook +\d+ s$", output
    )
    assert set(executed(project)) == names
    html = project / "book" / "_build" / "html"
    assert (html / "index.html").exists()
    for name in [*names, "status"]:
        assert (html / "executed" / f"{name}.html").exists(), name


def test_executed_notebooks_have_outputs_no_warnings_and_no_paths(tiny):
    project, _ = tiny
    for name, notebook in executed(project).items():
        outputs = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
        assert outputs, name
        assert not [o.text for o in outputs if o.output_type == "stream"], name
        assert str(project) not in nbformat.writes(notebook), name


def test_every_parameter_is_in_the_provenance_of_its_page(tiny):
    project, _ = tiny
    for name, notebook in executed(project).items():
        names = list(parameters.read(project / "notebooks" / f"{name}.py"))
        boxes = re.findall(r'<details class=\\"provenance\\">.*?</details>', nbformat.writes(notebook))
        assert len(boxes) == bool(names), name
        assert re.findall(r"<code>(\w+) = ", "".join(boxes)) == names, name


def test_pages_show_what_the_library_measures(tiny):
    """The number in the page is the number of `evaluate` on the same descriptors."""
    project, _ = tiny
    status, output = artifact(project, "evaluate", "--datasets", "drive", "--methods", "hog")
    assert status == 0
    recall, dar = re.search(r"Drive\s+hog\s+([\d.]+)\s+([\d.]+)", output).groups()
    text = nbformat.writes(executed(project)["tab03"])
    assert 0 < float(dar) < float(recall) <= 100
    for value in (float(recall), float(dar)):
        assert f"{value:.2f}" in text


def test_a_second_run_reuses_everything(tiny):
    project, output = tiny
    total = sum(counts(output))
    before = {path: path.read_bytes() for path in (project / "book" / "executed").glob("*.ipynb")}
    status, output = artifact(project, "run")
    assert (status, *counts(output)) == (0, 0, total)
    assert {path: path.read_bytes() for path in before} == before


def test_a_changed_parameter_makes_one_page_beside_the_one_with_the_defaults(tiny):
    project, output = tiny
    total = sum(counts(output))
    before = executed(project)
    status, output = artifact(project, "reproduce", "-p", "tab01.datasets=street")
    assert (status, *counts(output)) == (0, 1, total)
    after = executed(project)
    assert {name: after[name] for name in before} == before
    (page,) = own(project, "tab01")
    assert "One of your runs" in page
    assert "make reproduce SET='tab01.datasets=[\"street\"]'" in unescape(page)
    html = project / "book" / "_build" / "html" / "executed"
    name = next(html.glob("tab01-*.html")).stem
    listed = (html / "tab03.html").read_text()
    assert "Your runs" in listed
    assert f'href="{name}.html"' in listed
    status, output = artifact(project, "run")
    assert (status, *counts(output)) == (0, 0, total)


def test_a_run_of_ones_own_needs_nothing_of_the_profile(tmp_path):
    """Its data may be missing: then its page says so."""
    copy_book(tmp_path)
    write_manifest(tmp_path, tiny_manifest(avenue=DRIVE | {"obtain": "Ask the author."}))
    for part, brightness in (("queries", 0), ("database", -50)):
        write_images(tmp_path / "mine" / part, 12, seed=9, brightness=brightness)
    status, output = artifact(tmp_path, "run", "--only", "tab01", "-p", "datasets=mine")
    assert status == 0, output
    pages = executed(tmp_path)
    assert "Ask the author" in nbformat.writes(pages["tab01"])
    assert len(own(tmp_path, "tab01")) == 1


def test_changed_data_reruns_the_notebooks_that_use_it(tiny):
    project, output = tiny
    total = sum(counts(output))
    path = project / "data" / "street" / "day" / "frame3.png"
    kept = path.read_bytes()
    path.write_bytes((project / "data" / "street" / "day" / "frame9.png").read_bytes())
    try:
        # Table III uses the changed image, Fig. 4 uses no data.
        status, output = artifact(project, "run", "--only", "tab03", "fig04")
        assert (status, *counts(output)) == (0, 1, 1)
    finally:
        path.write_bytes(kept)
    status, output = artifact(project, "run")
    assert (status, *counts(output)) == (0, 0, total)


@pytest.mark.parametrize(
    ("parameter", "message"),
    [
        ("tab03.kk=5", "notebooks/tab03.py: unknown parameter 'kk'"),
        ("k=0", "k is 0; allowed: whole numbers from 1"),
        ("fig06.dataset=street2", "dataset is 'street2'; allowed: 'drive', 'street'"),
        ("tab99.k=5", "no notebook 'tab99'"),
        ("colour=5", "no notebook has a parameter 'colour'"),
    ],
)
def test_bad_parameters_stop_before_anything_runs(tiny, parameter, message):
    project, _ = tiny
    before = sorted((project / ".cache" / "notebooks").iterdir())
    status, output = artifact(project, "run", "-p", parameter)
    assert status == 1
    assert message in output
    assert "Traceback" not in output
    assert sorted((project / ".cache" / "notebooks").iterdir()) == before


def test_a_page_that_no_dataset_suits_says_so_and_fails_nothing(tiny):
    project, _ = tiny
    manifest = (project / "data_manifest.yaml").read_text()
    frames = yaml.safe_load(manifest)
    frames["profiles"]["frames"] = {"description": "frames only", "datasets": ["street"], "methods": ["hog"]}
    write_manifest(project, frames)
    kept = {path: path.read_bytes() for path in (project / "book" / "executed").glob("*.ipynb")}
    try:
        status, output = artifact(project, "run", "--profile", "frames", "--only", "fig07")
        assert status == 0, output
        page = nbformat.writes(executed(project)["fig07"])
        assert "Nothing to show in this run" in page
        assert "distractor_traversals" in page.replace("\\", "")
        status, output = artifact(project, "run", "--profile", "frames", "--only", "fig07", "-p", "dataset=street")
        assert status == 0, output
        assert "'street' is not one" in own(project, "fig07")[0]
        status, output = artifact(
            project, "run", "--profile", "frames", "--only", "fig07", "-p", "fig07.dataset=street"
        )
        assert status == 1
        assert "fig07.py" in output
        assert "distractor_traversals" in output
    finally:
        (project / "data_manifest.yaml").write_text(manifest)
        for path, content in kept.items():
            path.write_bytes(content)


def test_a_failing_notebook_fails_the_run_and_is_named(tiny):
    project, _ = tiny
    path = project / "notebooks" / "fig05.py"
    kept = path.read_text()
    pages = {page: page.read_bytes() for page in (project / "book" / "executed").glob("*.ipynb")}
    path.write_text(kept + "\n\n# %%\nraise RuntimeError('the sky fell')\n")
    try:
        status, output = artifact(project, "run", "-p", "tab03.k=2")
        assert status == 1
        assert re.search(r"error: notebooks/fig05.py: cell \d+: RuntimeError: the sky fell", output)
        now = {page: page.read_bytes() for page in (project / "book" / "executed").glob("*.ipynb")}
        assert now == pages, "the pages of the last good run stay, all of them"
        (project / "book" / "executed" / "fig05.ipynb").rename(project / "fig05.ipynb")
        status, output = artifact(project, "book")
        assert status == 1
        assert "pages are missing, first" in output
        assert "executed/fig05" in output
        (project / "fig05.ipynb").rename(project / "book" / "executed" / "fig05.ipynb")
    finally:
        path.write_text(kept)
    status, output = artifact(project, "run")
    assert status == 0
    assert counts(output)[0] == 0, "nothing of the failure was stored"


def test_a_book_without_executed_notebooks_says_how_to_make_them(tmp_path):
    loaded = replace(manifest.load(), path=tmp_path / "data_manifest.yaml")
    (tmp_path / "book").mkdir()
    (tmp_path / "book" / "_toc.yml").write_text("root: executed/opening\n")
    with pytest.raises(build.BookError, match=r"make reproduce` \(or `python -m artifact reproduce`\) first"):
        build.build(loaded)


def test_the_book_is_built_from_executed_notebooks_without_running_any(tiny):
    project, _ = tiny
    status, output = artifact(project, "book")
    assert status == 0, output
    cache = project / ".cache"
    cache.rename(project / "away")
    try:
        status, output = artifact(project, "book")
        assert (status, "unchanged" in output) == (0, True), output
        (project / "book" / "new.md").write_text((project / "book" / "new.md").read_text() + "\nOne more line.\n")
        status, output = artifact(project, "book")
        assert (status, "built in" in output) == (0, True), output
    finally:
        shutil.rmtree(cache, ignore_errors=True)
        (project / "away").rename(cache)


def test_a_fault_in_a_page_fails_the_strict_build(tiny):
    project, _ = tiny
    page = project / "book" / "new.md"
    kept = page.read_text()
    page.write_text(kept + "\nSee [nowhere](executed/nowhere.ipynb) and {cite:p}`nobody2020`.\n")
    try:
        status, output = artifact(project, "book")
        assert status == 1
        assert "nowhere.ipynb" in output
        assert "nobody2020" in output
    finally:
        page.write_text(kept)


def test_a_folder_of_ones_own_is_one_parameter_away(tiny, tmp_path):
    project, _ = tiny
    places = tmp_path / "my places"
    for part, brightness in (("queries", 0), ("database", -50)):
        write_images(places / part, 25, seed=9, brightness=brightness)
    status, output = artifact(project, "run", "--only", "tab01", "tab03", "-p", f"datasets=['{places}']")
    assert status == 0, output
    assert "my places" in own(project, "tab03")[0]
    status, output = artifact(project, "run", "--only", "tab03", "-p", f"datasets=['{tmp_path}']")
    assert status == 1
    assert "expected one folder named queries or query, found 0" in output


MEAN_COLOUR = """import torch
def build():
    return lambda images: torch.nn.functional.normalize(images.mean((2, 3)), dim=-1)
"""


def test_a_method_from_outside_is_three_lines_and_an_entry_away(tiny):
    project, _ = tiny
    path = project / "data_manifest.yaml"
    before = path.read_text()
    kept = {path: path.read_bytes() for path in (project / "book" / "executed").glob("*.*")}
    content = yaml.safe_load(before)
    content["methods"]["my_method"] = {
        "title": "Mean colour",
        "kind": "baseline",
        "backbone": "none",
        "aggregation": "mean",
        "dimension": 3,
        "builder": "my_method:build",
        "preprocessing": {"resize": "fixed", "size": [32, 32]},
    }
    (project / "my_method.py").write_text(MEAN_COLOUR)
    write_manifest(project, content)
    asked = ("run", "--only", "tab03", "-p", 'methods=["my_method","hog"]')
    try:
        assert artifact(project, *asked)[0] == 0
        assert "Mean colour" in own(project, "tab03")[0]
        assert counts(artifact(project, *asked)[1]) == (0, 2)
        (project / "my_method.py").write_text(MEAN_COLOUR.replace("mean((2, 3))", "amax((2, 3))"))
        assert counts(artifact(project, *asked)[1]) == (1, 1)
        (project / "my_method.py").unlink()
        status, output = artifact(project, *asked)
        assert status == 1
        assert "my_method:build" in output
    finally:
        path.write_text(before)
        (project / "my_method.py").unlink(missing_ok=True)
        for page, stored in kept.items():
            page.write_bytes(stored)


def test_commands_for_the_shell(tiny):
    project, _ = tiny
    for command in ("reproduce", "data", "extract", "evaluate", "verify", "bench", "status", "run", "book"):
        status, output = artifact(project, command, "--help")
        assert status == 0
        assert "usage: artifact" in output
    status, output = artifact(project, "status")
    assert status == 0
    assert "drive/day: 40 images, descriptors: thumbnail, hog" in output
    status, output = artifact(project, "data")
    assert status == 0
    assert "street/night: 30 images" in output
    status, output = artifact(project, "verify")
    assert status == 0
    assert ", 0 damaged" in output
    assert "nothing to compare with its numbers" in output


def test_verify_finds_a_damaged_result(tiny):
    project, _ = tiny
    path = next((project / ".cache" / "descriptors" / "hog").glob("*.npy"))
    kept = path.read_bytes()
    flip(path)
    try:
        status, output = artifact(project, "verify")
        assert status == 1
        assert f"DAMAGED {path}: its content differs from its record" in output
    finally:
        path.write_bytes(kept)


def test_a_damaged_page_is_not_built_and_a_damaged_book_is_built_again(tiny):
    project, _ = tiny
    for command in ("run", "book"):  # the status page lists what is there, and the book is of it
        assert artifact(project, command)[0] == 0
    page, index = project / "book" / "executed" / "tab03.ipynb", project / "book" / "_build" / "html" / "index.html"
    kept = page.read_bytes()
    flip(page)
    try:
        status, output = artifact(project, "book")
        assert status == 1
        assert f"error: {page}: its content differs from its record; `make reproduce` puts it back" in output
    finally:
        page.write_bytes(kept)
    flip(index)
    status, output = artifact(project, "book")
    assert (status, "built in" in output) == (0, True), output
    assert f"{index.parent}: its content differs from its record (index.html); the book is built again" in output


def test_missing_data_is_an_error_that_says_what_to_do(tiny, tmp_path):
    project, _ = tiny
    content = tiny_manifest(avenue=DRIVE | {"obtain": "Ask the author."})
    write_manifest(tmp_path, content)
    shutil.copytree(project / "notebooks", tmp_path / "notebooks")
    status, output = artifact(tmp_path, "run")
    assert status == 1
    assert "error: nothing was run, since this is missing:" in output
    assert "avenue" in output
    assert "Ask the author." in output
    assert "Traceback" not in output
