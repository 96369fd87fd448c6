"""The built book in headless Chromium: every page loads from a folder, quietly and without the network."""

import os
import re
import shutil

import pytest
import yaml
from conftest import REPOSITORY

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
NEEDED = "needs Chromium; on Debian: apt install chromium"
REQUIRED = os.environ.get("ARTIFACT_REQUIRE_BROWSER")  # continuous integration must not skip these tests
pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(CHROMIUM is None and not REQUIRED, reason=NEEDED),
]


@pytest.fixture(scope="module")
def browser():
    from playwright.sync_api import sync_playwright

    if CHROMIUM is None:
        pytest.fail(NEEDED)
    with sync_playwright() as playwright:
        options = [
            "--no-sandbox",
            "--disable-gpu",
            "--disable-background-networking",
            "--disable-component-update",
            "--disable-sync",
        ]
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=options)
        yield chromium
        chromium.close()


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
        ("tab01", 2, 0),
        ("tab02", 2, 0),
        ("tab03", 3, 0),
        ("fig04", 0, 1),
        ("fig05", 0, 2),
        ("fig06", 0, 2),
        ("fig07", 0, 2),
        ("fig08", 2, 1),
        ("fig09", 2, 1),
        ("tab04", 3, 0),
        ("tab05", 3, 0),
        ("fig10", 0, 2),
        ("in_one_screen", 1, 0),
        ("within_session", 1, 2),
        ("erased", 1, 2),
        ("methods", 1, 0),
        ("protocol", 2, 0),
    ],
)
def test_result_pages_hold_their_tables_and_figures(browser, pages, name, tables, images):
    html, _ = pages
    page, _, _ = visit(browser, html / "executed" / f"{name}.html")
    assert page.locator("table.results").count() >= tables
    assert page.locator("img.figure").count() == images
    for index in range(images):
        assert page.locator("img.figure").nth(index).get_attribute("alt")
        box = page.locator("img.figure").nth(index).bounding_box()
        assert box["width"] > 200
        assert box["height"] > 150
    page.context.close()


def test_formulas_are_typeset_without_the_network(browser, pages):
    html, _ = pages
    page, _, outside = visit(browser, html / "executed" / "fig04.html")
    page.wait_for_selector("mjx-container svg", timeout=20000)
    assert page.locator("mjx-container svg").count() >= 5
    assert outside == []
    page.context.close()


def test_nothing_overflows_the_page_on_a_phone(browser, pages):
    html, names = pages
    context = browser.new_context(viewport={"width": 390, "height": 800})
    page = context.new_page()
    for name in names:
        page.goto((html / f"{name}.html").as_uri())
        wide = page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")
        assert wide <= 1, name
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
