"""The page of a run in a browser: it asks for nothing, complains of nothing, and what is to move moves."""

import html
import json
import re

import pytest

from impact_xval.experiments.presentation.report import write_report
from impact_xval.experiments.tables.folder import RunFolder
from tests.browser import opened, violations
from tests.experiments.conftest import HOSTILE
from tests.waiting import wait_until

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def page(engine_run):
    """The page of the run in one browser; that it asked for nothing and had no error is held when it is closed."""
    with opened((engine_run / "report.html").as_uri()) as page:
        page.wait_for_selector("html[data-ready]", state="attached")
        yield page


def test_it_is_small_and_the_same_each_time(engine_run):
    page = (engine_run / "report.html").read_bytes()
    assert len(page) < 10e6
    write_report(RunFolder(engine_run))
    assert (engine_run / "report.html").read_bytes() == page


@pytest.mark.smoke
def test_it_is_within_reach_of_everyone(page):
    for width, scheme in ((390, "dark"), (1200, "light")):
        page.set_viewport_size({"width": width, "height": 900})
        page.emulate_media(color_scheme=scheme)
        page.reload()
        page.wait_for_selector("html[data-ready]", state="attached")
        assert violations(page) == []
        assert page.evaluate("document.documentElement.scrollWidth") == width
        assert page.evaluate("[...document.images].every((image) => image.naturalWidth > 0)")
        dark = page.evaluate("getComputedStyle(document.body).backgroundColor") != "rgb(255, 255, 255)"
        assert dark == (scheme == "dark")


def test_text_of_a_user_stays_text(engine_run, page):
    assert HOSTILE not in (engine_run / "report.html").read_text(encoding="utf-8")
    assert page.title() == f"impact-xval: {HOSTILE}"
    assert HOSTILE in page.inner_text("h1")


def test_a_tile_opens_its_cell(page):
    tiles = page.locator("#map canvas").first
    tiles.scroll_into_view_if_needed()
    box = tiles.bounding_box()
    cells = {page.inner_text("#cell-title")}
    for across in (0.25, 0.45, 0.65):
        for above in (0.15, 0.35, 0.5):
            page.mouse.click(box["x"] + across * box["width"], box["y"] + above * box["height"])
            cells.add(page.inner_text("#cell-title"))
    assert len(cells) > 4


def test_the_list_opens_cells(page):
    page.locator("[data-cell='3']").focus()
    page.keyboard.press("Enter")
    assert page.inner_text("#cell-title") == "Cell 3"
    page.locator("[data-cell='7']").click()
    assert page.inner_text("#cell-title") == "Cell 7"
    assert page.locator("#cell-results tbody tr").count() == 4
    page.locator("#cells_wrapper .dt-search input").fill('"open 11"')
    wait_until(lambda: page.locator("#cells tbody tr").count() == 1)


def test_without_scripts_the_words_and_pictures_are_there(engine_run):
    page = (engine_run / "report.html").read_text(encoding="utf-8")
    bare = re.sub(r"<script.*?</script>|<style.*?</style>", "", page, flags=re.DOTALL)
    captions = json.loads((engine_run / "figures/captions.json").read_text())
    assert bare.count('<img src="data:image/png;base64,') == len(captions) > 5
    assert "How far are they from the model?" in html.unescape(bare)
    words = re.sub(r'"data:[^"]*"', "", bare).partition("Provenance</h2>")[0]
    assert not re.search(r"\b(nan|None|undefined)\b", words)
