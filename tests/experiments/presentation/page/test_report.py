"""The page of a run in a browser: it asks for nothing, complains of nothing, and what is to move moves."""

import html
import re

import pytest

from impact_xval.experiments.config.configuration import parse_config
from impact_xval.experiments.presentation.report import present, write_report
from impact_xval.experiments.sweep.run import run_sweep
from impact_xval.experiments.tables.store import RunFolder
from tests.browser import opened, violations
from tests.experiments.conftest import SMALL
from tests.waiting import wait_until

pytestmark = pytest.mark.slow

HOSTILE = "</script><script>document.title = 'taken'</script><img src=x onerror=\"document.title='taken'\">"


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    root = tmp_path_factory.mktemp("page") / "run"
    solvers = ["kelvin-voigt", "bistiffness", "mujoco"]
    run_sweep(parse_config(SMALL | {"solvers": solvers, "name": HOSTILE}), root)
    present(RunFolder(root))
    return root


@pytest.fixture
def address(root):
    return (root / "report.html").as_uri()


def ready(page):
    page.wait_for_selector("html[data-ready]", state="attached")
    return page


def test_it_is_small_and_the_same_each_time(root):
    page = (root / "report.html").read_bytes()
    assert len(page) < 10e6
    write_report(RunFolder(root))
    assert (root / "report.html").read_bytes() == page


def test_text_of_a_user_stays_text(root, address):
    page = (root / "report.html").read_text(encoding="utf-8")
    assert HOSTILE not in page
    with opened(address) as shown:
        ready(shown)
        assert shown.title() == f"impact-xval: {HOSTILE}"
        assert HOSTILE in shown.inner_text("h1")


@pytest.mark.smoke
@pytest.mark.parametrize(("width", "scheme"), [(390, "dark"), (1200, "light")])
def test_it_is_within_reach_of_everyone(address, width, scheme):
    with opened(address, width, scheme) as page:
        ready(page)
        assert violations(page) == []
        assert page.evaluate("document.documentElement.scrollWidth") == width
        assert page.evaluate("[...document.images].every((image) => image.naturalWidth > 0)")
        dark = page.evaluate("getComputedStyle(document.body).backgroundColor") != "rgb(255, 255, 255)"
        assert dark == (scheme == "dark")


def test_first_things_come_first(address):
    with opened(address) as page:
        ready(page)
        assert page.eval_on_selector("#sketch", "element => element.getBoundingClientRect().top") < 400
        assert page.eval_on_selector("figure img", "element => element.getBoundingClientRect().top") < 1300
        assert page.locator(".numbers p").count() == 3
        for link in page.locator("nav a").all():
            assert page.locator(f"[id='{link.get_attribute('href')[1:]}']").count() == 1


def test_a_tile_opens_its_cell(address):
    with opened(address) as page:
        ready(page)
        first = page.inner_text("#cell-title")
        tiles = page.locator("#map canvas").first
        tiles.scroll_into_view_if_needed()
        box = tiles.bounding_box()
        opened_cells = {first}
        for across in (0.25, 0.45, 0.65):
            for above in (0.15, 0.35, 0.5):
                page.mouse.click(box["x"] + across * box["width"], box["y"] + above * box["height"])
                opened_cells.add(page.inner_text("#cell-title"))
        assert len(opened_cells) > 4


def test_the_list_opens_sorts_and_filters(address):
    with opened(address) as page:
        ready(page)
        page.locator("[data-cell='7']").click()
        assert page.inner_text("#cell-title") == "Cell 7"
        assert page.locator("#cell-results tbody tr").count() == 4
        assert "impact-xval ladder run --cell 7" in page.inner_text("#cell-commands")
        assert page.locator("#cell-scene").is_visible()
        heads = page.locator("#cells thead th")
        column = [head.strip() for head in heads.all_inner_texts()].index("D of mujoco")

        def shown():
            cells = page.locator(f"#cells tbody tr td:nth-child({column + 1})")
            return [float(text) for text in cells.all_inner_texts()]

        heads.nth(column).click()
        wait_until(lambda: shown() == sorted(shown()))
        rising = shown()
        assert len(rising) > 1
        heads.nth(column).click()
        wait_until(lambda: shown()[0] > rising[0])
        page.locator("#cells_wrapper .dt-search input").fill('"open 11"')
        wait_until(lambda: page.locator("#cells tbody tr").count() == 1)


def test_a_keyboard_opens_a_cell(address):
    with opened(address) as page:
        ready(page)
        page.locator("[data-cell='3']").focus()
        page.keyboard.press("Enter")
        assert page.inner_text("#cell-title") == "Cell 3"


def test_another_solver_has_other_colours(address):
    with opened(address) as page:
        ready(page)
        shown = "Array.from(Bokeh.documents[0].get_model_by_name('tiles').data.shown)"
        page.select_option("#solver", "bistiffness")
        before = page.evaluate(shown)
        page.select_option("#solver", "mujoco")
        assert page.evaluate(shown) != before


def test_without_scripts_the_words_and_pictures_are_there(root):
    page = (root / "report.html").read_text(encoding="utf-8")
    bare = re.sub(r"<script.*?</script>|<style.*?</style>", "", page, flags=re.DOTALL)
    assert bare.count("<figure") > 9
    assert "How far are they from the model?" in html.unescape(bare)
    assert not re.search(
        r"\b(nan|None|undefined)\b", re.sub(r'"data:[^"]*"', "", bare).partition("Provenance</h2>")[0]
    )
