"""The built book in headless Chromium: every page loads from a folder, quietly and without the network."""

import re
from pathlib import Path

import axe_playwright_python
import pypdf
import pytest
import yaml
from conftest import REPOSITORY

pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def pages(tiny):
    project, _ = tiny
    toc = yaml.safe_load((REPOSITORY / "book" / "_toc.yml").read_text())
    names = [toc["root"], *(chapter["file"] for part in toc["parts"] for chapter in part["chapters"])]
    return project / "book" / "_build" / "html", names


def visit(browser, path, scheme="light"):
    """Open a page; returns it with its console errors and every request that leaves the folder."""
    context = browser.new_context(color_scheme=scheme, viewport={"width": 1280, "height": 900})
    page = context.new_page()
    errors, outside = [], []
    page.on("console", lambda message: errors.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.on("requestfailed", lambda request: errors.append(f"failed: {request.url}"))
    page.on("request", lambda r: outside.append(r.url) if not r.url.startswith(("file:", "data:", "blob:")) else None)
    page.goto(path.as_uri())
    page.wait_for_load_state("load")
    page.wait_for_timeout(120)
    return page, errors, outside


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_every_page_loads_quietly_and_offline(browser, pages, scheme):
    html, names = pages
    for name in [*names, "genindex", "search"]:
        page, errors, outside = visit(browser, html / f"{name}.html", scheme)
        assert errors == [], name
        assert outside == [], name
        if name not in ("genindex", "search"):
            assert page.locator("h1").count() >= 1, name
        broken = page.evaluate(
            "[...document.images].filter(i => !i.complete || !i.naturalWidth).map(i => i.src.slice(0, 80))"
        )
        assert broken == [], name
        page.context.close()


def test_the_first_page_opens_from_the_index(browser, pages):
    html, _ = pages
    page, errors, _ = visit(browser, html / "index.html")
    page.wait_for_url("**/opening.html")
    assert errors == []
    assert page.locator("table.findings tbody tr").count() >= 3
    page.context.close()


@pytest.mark.parametrize(
    ("name", "tables", "images"),
    [
        ("fig01", 0, 2),
        ("fig02", 2, 1),
        ("fig03", 0, 1),
        ("tab01", 3, 4),
        ("tab02", 2, 0),
        ("tab03", 3, 0),
        ("fig04", 0, 1),
        ("fig05", 0, 2),
        ("fig06", 1, 2),
        ("fig07", 0, 2),
        ("fig08", 2, 3),
        ("fig09", 2, 1),
        ("tab04", 4, 0),
        ("tab05", 3, 0),
        ("fig10", 0, 2),
        ("full_run", 1, 0),
        ("in_one_screen", 1, 0),
        ("how_sure", 4, 0),
        ("taken", 1, 0),
        ("within_session", 1, 2),
        ("erased", 1, 2),
        ("methods", 1, 0),
        ("protocol", 2, 0),
        ("how_fast", 1, 2),
    ],
)
def test_result_pages_hold_their_tables_and_figures(browser, pages, name, tables, images):
    html, _ = pages
    page, _, _ = visit(browser, html / "executed" / f"{name}.html")
    assert page.locator("table.results").count() >= tables
    figures = page.locator(".figure")
    assert figures.count() == images
    for index in range(images):
        figure = figures.nth(index)
        assert figure.get_attribute("alt") or figure.get_attribute("aria-label")
        box = figure.bounding_box()
        assert box["width"] > 200
        assert box["height"] > 100
    page.context.close()


def test_formulas_are_typeset_without_the_network(browser, pages):
    html, _ = pages
    page, _, outside = visit(browser, html / "executed" / "fig04.html")
    page.wait_for_selector("mjx-container svg", timeout=60000)
    assert page.locator("mjx-container svg").count() >= 5
    assert outside == []
    page.context.close()


CLIPPED = """() => {
  const found = [], width = document.documentElement.clientWidth;
  const say = (what, element) => found.push(`${what}: ${element.tagName} ${element.textContent.trim().slice(0, 40)}`);
  if (document.documentElement.scrollWidth > width + 1) say("page too wide", document.body);
  for (const box of document.querySelectorAll("article :is(.scroll, .cell_output, pre, mjx-container[display])"))
    if (box.scrollWidth > box.clientWidth + 1) say("scrolls across", box);
  for (const box of document.querySelectorAll(".scroll.tall"))
    if (box.offsetHeight > window.innerHeight) say("fills more than the window", box);
  for (const element of document.querySelectorAll("article *")) {
    const text = [...element.childNodes].some((node) => node.nodeType === 3 && node.textContent.trim());
    const box = element.getBoundingClientRect();
    if (!text || !box.width || !box.height || element.closest("details:not([open]), mjx-assistive-mml")) continue;
    if (box.right > width + 1 || box.left < -1) say("outside", element);
  }
  return found;
}"""


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_no_page_hides_a_number_at_any_width(browser, pages, scheme):
    """Nothing reaches out of the window, no table, figure, formula or code is cut, from a phone to a wide screen.

    A long table scrolls in a box that leaves room to pass it by.
    """
    html, names = pages
    context = browser.new_context(color_scheme=scheme, reduced_motion="reduce")
    page = context.new_page()
    found = []
    for width in (390, 768, 1400, 1920) if scheme == "light" else (390,):
        page.set_viewport_size({"width": width, "height": 900})
        for name in names:
            page.goto((html / f"{name}.html").as_uri())
            found += [(name, width, fault) for fault in page.evaluate(CLIPPED)]
    assert found == []
    context.close()


@pytest.mark.parametrize("name", ["opening", "tab03", "fig08", "protocol", "within_session"])
def test_print_holds_every_cell_of_every_table(browser, pages, name, tmp_path):
    html, _ = pages
    page, _, _ = visit(browser, html / "executed" / f"{name}.html")
    page.evaluate(
        "document.querySelectorAll('sup').forEach((rank) => rank.remove())"
    )  # on a line of their own in a PDF
    cells = page.evaluate("[...document.querySelectorAll('article table.results td')].map((cell) => cell.textContent)")
    page.pdf(path=tmp_path / "page.pdf")
    printed = "".join(part.extract_text() for part in pypdf.PdfReader(tmp_path / "page.pdf").pages)
    squeezed = re.sub(r"\s", "", printed)
    assert len(cells) > 10
    assert [cell for cell in cells if re.sub(r"\s", "", cell) not in squeezed] == []
    page.context.close()


def test_print_repeats_the_head_of_a_table_on_every_page_that_it_reaches(browser, pages, tmp_path):
    html, _ = pages
    page, _, _ = visit(browser, html / "executed" / "opening.html")
    head, *rows = page.evaluate(
        """[...document.querySelector("article table.results").rows].map((row) =>
          (row.parentNode.tagName === "THEAD" ? row : row.cells[0]).textContent)"""
    )
    page.pdf(path=tmp_path / "page.pdf")
    printed = [re.sub(r"\s", "", part.extract_text()) for part in pypdf.PdfReader(tmp_path / "page.pdf").pages]
    reached = [text for text in printed if any(re.sub(r"\s", "", row) in text for row in rows)]
    assert len(reached) > 1
    assert all(re.sub(r"\s", "", head) in text for text in reached)
    page.context.close()


AXE = Path(axe_playwright_python.__file__).with_name("axe.min.js")


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_no_page_has_a_serious_fault_of_accessibility(browser, pages, scheme):
    html, names = pages
    dark = ("executed/opening", "executed/tab03", "executed/fig06", "executed/fig08", "executed/status", "new")
    found = []
    for name in names if scheme == "light" else dark:
        page, _, _ = visit(browser, html / f"{name}.html", scheme)
        page.evaluate("(scheme) => (document.documentElement.dataset.theme = scheme)", scheme)
        page.add_script_tag(path=AXE)
        rules = ["wcag2a", "wcag2aa", "wcag21aa"] if scheme == "light" else ["color-contrast"]
        result = page.evaluate(
            "(rules) => axe.run({ include: ['article'], exclude: ['svg'] }, { runOnly: rules })", rules
        )
        for fault in result["violations"]:
            if fault["impact"] in ("serious", "critical"):
                found.append((name, fault["id"], fault["nodes"][0]["html"][:120], len(fault["nodes"])))
        page.context.close()
    assert found == []


def test_long_tables_sort_and_filter(browser, pages):
    html, _ = pages
    page, _, _ = visit(browser, html / "executed" / "within_session.html")
    table = page.locator("table.results.many").first
    rows = table.locator("tbody tr")
    count = rows.count()
    assert count > 20
    head = table.locator("th").nth(4).locator("button")
    read = "(table) => [...table.tBodies[0].rows].map((row) => parseFloat(row.cells[4].textContent))"
    head.press("Enter")
    assert table.evaluate(read) == sorted(table.evaluate(read))
    head.press("Enter")
    assert table.evaluate(read) == sorted(table.evaluate(read), reverse=True)
    page.locator(".tools input").first.fill("street hog")
    shown = rows.filter(visible=True)
    assert 0 < shown.count() < count
    assert all("Street" in text and "HOG" in text for text in shown.all_inner_texts())
    page.context.close()


def test_figures_tell_values_and_images_on_hover_and_open_large(browser, pages):
    html, _ = pages
    page, errors, _ = visit(browser, html / "executed" / "fig02.html")
    assert page.locator("figure.figure svg text").count() > 2, "text is text"
    page.locator("svg .value").first.hover(force=True)
    assert re.search(r"query \d+, match \d+ of night, \d+ m away", page.locator(".hint").inner_text())
    assert page.locator(".hint i").count() == 2
    page.locator("figure.figure .panels > svg").first.click(position={"x": 4, "y": 4})
    assert page.locator("dialog.large svg").is_visible()
    page.keyboard.press("Escape")
    page.locator("dialog.large").wait_for(state="detached")
    assert errors == []
    page.context.close()


def test_provenance_leads_to_the_command_and_the_source_of_every_function(browser, pages):
    html, _ = pages
    page, _, _ = visit(browser, html / "executed" / "tab03.html")
    page.locator("details.provenance summary").click()
    assert "make reproduce" in page.locator("details.provenance code").first.inner_text()
    assert page.locator("button.copy").count() == 1
    page.get_by_role("link", name="artifact.studies.recall.recall_table").click()
    page.wait_for_url("**/code/artifact.studies.recall.html#recall_table")
    assert "def recall_table" in page.locator("#recall_table").inner_text()
    page.context.close()
    for written in (html / "executed").glob("*.html"):
        for target, name in re.findall(r'href="\.\./(code/[\w.]+)#(\w+)"', written.read_text()):
            assert f'id="{name}"' in (html / target).read_text(), (written.name, target)


def test_code_is_named_and_stands_below_the_result(browser, pages):
    html, _ = pages
    page, _, _ = visit(browser, html / "executed" / "tab03.html")
    toggles = page.locator("details.hide summary")
    assert [text.strip() for text in toggles.all_inner_texts()] == ["Parameters", "Code"]
    # What is folded away has a place too; and both in one look, for images that come into sight move what is below them.
    below = """() => document.querySelector("details.hide summary").getBoundingClientRect().top
        - Math.max(...[...document.querySelectorAll("table.results")].filter((t) => !t.closest("details"))
            .map((t) => t.getBoundingClientRect().bottom))"""
    assert page.evaluate(below) > 0
    page.context.close()


def test_search_shows_excerpts_from_a_folder(browser, pages):
    html, _ = pages
    context = browser.new_context()
    page = context.new_page()
    errors = []
    page.on("console", lambda message: errors.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.goto(f"{(html / 'search.html').as_uri()}?q=bootstrap")
    page.wait_for_selector("#search-results li p.context")
    assert "bootstrap" in page.locator("#search-results p.context").first.inner_text().lower()
    assert errors == []
    context.close()


def test_the_data_behind_a_page_can_be_downloaded(browser, pages):
    html, _ = pages
    page, _, _ = visit(browser, html / "executed" / "tab03.html")
    with page.expect_download() as caught:
        page.locator("p.download a").first.click()
    text = caught.value.path().read_text()
    assert re.match(r"dataset,title,method,.*\bR,R_low,R_high,DAR,", text)
    assert len(text.splitlines()) == 5
    page.context.close()


def test_dark_pages_have_light_text_on_dark_tables(browser, pages):
    html, _ = pages
    page, _, _ = visit(browser, html / "executed" / "tab03.html", "dark")
    page.evaluate("document.documentElement.dataset.theme = 'dark'")
    cell = page.locator("table.results tbody td:not(.best):not(.second):not(.worst)").first
    colour = cell.evaluate("e => getComputedStyle(e).color")
    background = page.evaluate("getComputedStyle(document.body).backgroundColor")
    level = lambda text: sum(map(float, text[text.index("(") + 1 : -1].split(",")[:3]))  # noqa: E731
    assert level(colour) > level(background) + 200
    page.context.close()
