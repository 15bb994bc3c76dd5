"""The page of a run in a browser: it loads nothing, has no errors, and its controls work."""

import html
import json
import re

import numpy as np
import pandas as pd
import pytest

from tests.browser import HUNG, opened, violations
from tests.experiments.conftest import HOSTILE

pytestmark = pytest.mark.slow

#: Pause in ms between clicks, so that Bokeh does not take two of them for a double click (300 ms).
LONGER_THAN_A_DOUBLE_CLICK = 600


@pytest.fixture(scope="module")
def page(engine_run):
    """The page of a run in a browser. When it is closed, `opened` asserts that it loaded nothing and had no error."""
    with opened((engine_run / "report.html").as_uri()) as page:
        page.wait_for_selector("html[data-ready]", state="attached")
        yield page


@pytest.mark.smoke
def test_the_page_is_accessible_and_fits_every_width(page):
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
    # Bokeh 3.3 waits for a second click before it handles the first one, so titles are recorded whenever they appear.
    # Bokeh takes two clicks in quick succession for one double click, which opens no cell.
    page.evaluate(
        """() => {
        const title = document.querySelector("#cell-title");
        window.titles = new Set();
        new MutationObserver(() => window.titles.add(title.innerText))
            .observe(title, {childList: true, characterData: true, subtree: true});
        }"""
    )
    for across in (0.25, 0.45, 0.65):
        for above in (0.15, 0.35, 0.5):
            page.mouse.click(box["x"] + across * box["width"], box["y"] + above * box["height"])
            page.wait_for_timeout(LONGER_THAN_A_DOUBLE_CLICK)
    page.wait_for_function("window.titles.size > 3", timeout=HUNG)
    page.reload()  # no delayed click may reach the tests below
    page.wait_for_selector("html[data-ready]", state="attached")


def test_a_number_a_button_and_an_address_open_a_cell(engine_run, page):
    page.locator("#number").focus()
    page.keyboard.press("ControlOrMeta+a")
    page.keyboard.type("3")
    page.keyboard.press("Enter")
    assert page.inner_text("#cell-title") == "Cell 3"
    assert page.url.endswith("#cell=3")
    page.locator("#largest-divergences summary").press("Enter")
    button = page.locator("[data-cell]").first
    button.press("Enter")
    assert page.inner_text("#cell-title") == f"Cell {button.inner_text()}"
    assert page.locator("#cell-results tbody tr").count() == 4
    page.goto((engine_run / "report.html").as_uri() + "#cell=7")
    page.reload()
    page.wait_for_selector("html[data-ready]", state="attached")
    assert page.inner_text("#cell-title") == "Cell 7"


@pytest.mark.parametrize(
    ("run", "words"),
    [
        ("engine_run", ["How far are the solvers from the model?"]),
        ("chain_run", ["N = 2", "N = 3", "N = 4", "unrepresentable", "state-transition", "few chains"]),
    ],
)
def test_without_scripts_the_words_and_pictures_are_there(run, words, request):
    root = request.getfixturevalue(run)
    page = (root / "report.html").read_text(encoding="utf-8")
    assert len(page) < 3e6
    bare = re.sub(r"<script.*?</script>|<style.*?</style>", "", page, flags=re.DOTALL)
    captions = json.loads((root / "figures/captions.json").read_text(encoding="utf-8"))
    assert bare.count('<img src="data:image/svg+xml;base64,') == len(captions) >= 5
    bare = html.unescape(re.sub(r'"data:[^"]*"', "", bare).partition('id="provenance"')[0])
    assert not [each for each in words if each not in bare]
    assert not re.search(r"\b(nan|None|undefined)\b", bare)


@pytest.mark.parametrize(("run", "least"), [("engine_run", 30), ("chain_run", 15)])
def test_every_number_in_a_sentence_is_a_value_of_the_tables(run, least, request):
    """Every number in a sentence of the page equals the value in the tables that its key names."""
    root = request.getfixturevalue(run)
    page = (root / "report.html").read_text(encoding="utf-8")
    found = re.findall(r'<data value="([^"]+)" title="([^"]+)">([^<]+)</data>', page)
    assert len(found) > least
    for value, key, shown in found:
        value, percent = float(value), shown.endswith(" %")
        printed = float(shown.removesuffix(" %")) * (0.01 if percent else 1.0)
        rounding = {"abs": 5.1e-4} if percent else {"rel": 6e-3, "abs": 0}
        assert printed == pytest.approx(value, **rounding), key
        assert value == pytest.approx(of_tables(root, html.unescape(key)), rel=1e-9, abs=1e-12), key


def of_tables(root, key):
    """Return the number that a key of the page names, computed from the tables of the run."""
    solver, *words = key.split(" ")
    cells = pd.read_parquet(root / "cells.parquet")
    cells = cells[cells.status.isin(["ok", "closed-form"])]
    if words[0] == "from":
        regular = cells[cells.marked.isna()].set_index("cell")
        a, b = (regular[regular.solver == name] for name in (solver, words[1]))
        d = np.sqrt((a.m1 * (a.v1 - b.v1) ** 2 + a.m2 * (a.v2 - b.v2) ** 2) / (a.m1 * a.v0**2))
        return d.agg(words[2])
    if words[0] == "limit":
        return cells[cells.solver == solver].limit_distance.agg(words[-1])
    if words[0] in ("step", "steps"):
        rows = cells[cells.solver == solver]
        away = np.abs(rows[["v1", "v2"]].to_numpy() / 2 - rows[["v1_limit", "v2_limit"]].to_numpy()).max(
            axis=1
        )
        found = {"step median": np.median(away), "step p95": (p95 := np.quantile(away, 0.95))}
        found["steps a period"] = 1000 * (p95 / 0.01) ** (1 / rows.order.median())
        return found[" ".join(words)]
    ladders = pd.read_parquet(root / "ladder.parquet")
    ladders = ladders[(ladders.solver == solver) & (ladders.status == "ok") & ladders.marked.isna()]
    if "ladders" in words:
        return len(ladders) if words[-1] == "n" else ladders.velocity_divergence.mean()
    measure, statistic, *where = words
    axis, _, at = where[0].partition("=") if where else ("all", "", "")
    if measure.startswith("share_") and "balls" in ladders:  # summary.csv has no ladders of chains
        rows = ladders[ladders[axis].astype(str) == at] if at else ladders
        return np.average(rows[f"{measure.removeprefix('share_')}_share"], weights=rows.velocity_divergence)
    rows = pd.read_csv(root / "summary.csv").query("cells == 'regular'")
    rows = rows[(rows.solver == solver) & (rows.measure == measure) & (rows.axis == axis)]
    (found,) = (rows[rows.value.astype(float) == float(at)] if at else rows)[statistic]
    return found
