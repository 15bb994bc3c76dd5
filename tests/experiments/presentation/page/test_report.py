"""The page of a run in a browser: it asks for nothing, complains of nothing, and what is to move moves."""

import html
import json
import re

import numpy as np
import pandas as pd
import pytest

from tests.browser import opened, violations
from tests.experiments.conftest import HOSTILE

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def page(engine_run):
    """The page of the run in one browser; that it asked for nothing and had no error is held when it is closed."""
    with opened((engine_run / "report.html").as_uri()) as page:
        page.wait_for_selector("html[data-ready]", state="attached")
        yield page


def test_it_is_small(engine_run):
    assert (engine_run / "report.html").stat().st_size < 3e6


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


def test_without_scripts_the_words_and_pictures_are_there(engine_run):
    page = (engine_run / "report.html").read_text(encoding="utf-8")
    bare = re.sub(r"<script.*?</script>|<style.*?</style>", "", page, flags=re.DOTALL)
    captions = json.loads((engine_run / "figures/captions.json").read_text())
    assert bare.count('<img src="data:image/svg+xml;base64,') == len(captions) > 5
    assert "How far are they from the model?" in html.unescape(bare)
    words = re.sub(r'"data:[^"]*"', "", bare).partition('id="provenance"')[0]
    assert not re.search(r"\b(nan|None|undefined)\b", words)


def test_every_number_in_a_sentence_is_a_value_of_the_tables(engine_run):
    """Each is read back by the key that the page shows of it."""
    page = (engine_run / "report.html").read_text(encoding="utf-8")
    found = re.findall(r'<data value="([^"]+)" title="([^"]+)">([^<]+)</data>', page)
    assert len(found) > 30
    for value, key, shown in found:
        scale = 0.01 if shown.endswith(" %") else 1.0
        assert float(shown.removesuffix(" %")) * scale == pytest.approx(
            float(value), rel=6e-3, abs=6e-4 * scale
        ), key
        assert float(value) == pytest.approx(
            of_tables(engine_run, html.unescape(key)), rel=1e-9, abs=1e-12
        ), key


def of_tables(root, key):
    """Compute what a key of the page names from the tables of a run."""
    cells = pd.read_parquet(root / "cells.parquet")
    cells = cells[cells.status.isin(["ok", "limit"])]
    solver, *words = key.split(" ")
    if words[0] == "from":
        other, cut = words[1:]
        pair = [
            cells[(cells.solver == name) & cells.marked.isna()].set_index("cell") for name in (solver, other)
        ]
        a, b = (each.loc[pair[0].index.intersection(pair[1].index)] for each in pair)
        d = np.sqrt(a.m1 * (a.v1 - b.v1) ** 2 + a.m2 * (a.v2 - b.v2) ** 2) / np.sqrt(a.m1 * a.v0**2)
        return getattr(d, cut)()
    if words[0] in ("step", "steps"):
        rows = cells[cells.solver == solver]
        error = np.abs(rows[["v1", "v2"]].to_numpy() / 2 - rows[["v1_limit", "v2_limit"]].to_numpy()).max(
            axis=1
        )
        median, p95 = np.quantile(error, [0.5, 0.95])
        steps = 1000 * (p95 / 0.01) ** (1 / rows.order.median())
        return {"step median": median, "step p95": p95, "steps a period": steps}[" ".join(words)]
    if words[-2:] in (["ladders", "n"], ["the", "ladders"]):
        rows = pd.read_parquet(root / "ladder.parquet")
        rows = rows[(rows.solver == solver) & (rows.status == "ok") & rows.marked.isna()]
        return len(rows) if words[-1] == "n" else rows.velocity_divergence.mean()
    measure, statistic, *where = words
    axis, _, at = where[0].partition("=") if where else ("all", "", "")
    rows = pd.read_csv(root / "summary.csv")
    rows = rows[
        (rows.solver == solver) & (rows.measure == measure) & (rows.axis == axis) & (rows.cells == "regular")
    ]
    (row,) = (rows[rows.value == float(at)] if at else rows).to_dict("records")
    return row[statistic]
