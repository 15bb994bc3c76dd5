"""The page of a run in a browser: it asks for nothing, complains of nothing, and what is to move moves."""

import html
import math
import re

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from impact_xval.experiments.config.configuration import parse_config
from impact_xval.experiments.presentation.report import present, write_report
from impact_xval.experiments.sweep.run import run_sweep
from impact_xval.experiments.tables.store import RunFolder
from tests.browser import opened, violations
from tests.experiments.conftest import SMALL

pytestmark = pytest.mark.slow

#: Finds what has a name in a chart of Bokeh.
CHART = "((name) => Bokeh.documents.map((each) => each.get_model_by_name(name)).find((each) => each))"

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


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [390, 1200])
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

        def click(order):
            """Sort by the column, and give it once the table is sorted: it answers the click first."""
            heads.nth(column).click()
            page.wait_for_function(
                """([column, sign]) => {
                    const cells = document.querySelectorAll(`#cells tbody tr td:nth-child(${column})`)
                    const shown = [...cells].map(cell => sign * Number(cell.innerText))
                    return shown.length > 1 && shown.every((d, i) => i === 0 || shown[i - 1] <= d)
                }""",
                arg=[column + 1, order],
            )
            return float(page.locator(f"#cells tbody tr td:nth-child({column + 1})").first.inner_text())

        assert click(1) < click(-1)
        page.locator("#cells_wrapper .dt-search input").fill('"open 11"')
        assert page.locator("#cells tbody tr").count() == 1


def test_a_keyboard_opens_a_cell(address):
    with opened(address) as page:
        ready(page)
        page.locator("[data-cell='3']").focus()
        page.keyboard.press("Enter")
        assert page.inner_text("#cell-title") == "Cell 3"


def test_another_solver_has_other_colours(address):
    with opened(address) as page:
        ready(page)
        shown = f"Array.from({CHART}('tiles').data.shown)"
        page.select_option("#solver", "bistiffness")
        before = page.evaluate(shown)
        page.select_option("#solver", "mujoco")
        assert page.evaluate(shown) != before


def put(page, place, share):
    """Move the slider of a motion; return its instant, and what it says of its two solvers: names, states, numbers."""
    slider = page.locator(f"#motion-{place} .time")
    slider.evaluate(
        "(slider, share) => { slider.value = share; slider.dispatchEvent(new Event('input')) }", share
    )
    said = page.locator(f"#motion-{place} .said").all_inner_texts()
    numbers = [[float(number) for number in re.findall(r"=\s(-?[\d.]+)", line)] for line in said]
    return page.evaluate(f"{CHART}('now {place}').location"), said, numbers


def test_its_slow_motion_is_that_of_two_springs(tmp_path):
    """Without damping: x1'' = F1, m x2'' = F2 - F1, F1 = max(x2 - x1, 0), F2 = max(-k x2, 0)."""
    stiffness, mass = 3.0, 2.0
    grid = {"stiffness_ratio": [stiffness], "mass_ratio": [mass], "e1": [1], "e2": [1]}
    run_sweep(
        parse_config({"scenario": "impact", "solvers": ["kelvin-voigt"], "grid": grid}), tmp_path / "run"
    )
    present(RunFolder(tmp_path / "run"))

    def forces(x1, x2):
        return np.maximum(x2 - x1, 0), np.maximum(-stiffness * x2, 0)

    def slope(_, state):
        f1, f2 = forces(*state[:2])
        return [*state[2:], f1, (f2 - f1) / mass]

    truth = solve_ivp(slope, (0, 20), [0, 0, -1, 0], max_step=1e-2, dense_output=True).sol
    balls = "(balls) => balls.map((ball) => Number(ball.getAttribute('cy')))"
    with opened((tmp_path / "run" / "report.html").as_uri()) as page:
        ready(page)
        put(page, "cell", 0)
        start = np.array(page.eval_on_selector_all("#motion-cell circle", balls))[2:]
        moved = []
        for share in (0.2, 0.4, 0.6, 0.8):
            now, said, (_, numbers) = put(page, "cell", share)
            x1, x2, v1, v2 = truth(now)
            f1, f2 = forces(x1, x2)
            assert numbers == pytest.approx([v1, v2, f1, f2], abs=0.02)
            state = {(True, True): 1, (False, True): 2, (True, False): 3, (False, False): 4}[f1 > 0, f2 > 0]
            assert said[1].startswith(f"kelvin-voigt: S{state}: ")
            # all heights are drawn in one scale
            drawn = start - np.array(page.eval_on_selector_all("#motion-cell circle", balls))[2:]
            moved += [*zip((x1, x2), drawn, strict=True)]
        heights, drawn = np.array(moved).T
        scale = drawn @ heights / (heights @ heights)
        assert scale > 0
        assert drawn == pytest.approx(scale * heights, abs=0.02 * np.abs(drawn).max())


def test_in_a_drop_its_slow_motion_ends_with_the_velocities_of_the_table(tmp_path):
    """Gravity ends in a first flight, and balls may meet again long after it: seen at 0.0316, 2, e1 = 1, e2 = 0.5."""
    grid = {"stiffness_ratio": [0.0316227766, 20], "mass_ratio": [0.01, 2], "e1": [1], "e2": [0.5]}
    solvers = ["kelvin-voigt", "bistiffness"]
    run_sweep(parse_config({"scenario": "drop", "solvers": solvers, "grid": grid}), tmp_path / "run")
    present(RunFolder(tmp_path / "run"))
    with opened((tmp_path / "run" / "report.html").as_uri()) as page:
        ready(page)
        for cell in range(4):
            page.locator(f"[data-cell='{cell}']").click()
            rows = page.locator("#cell-results tbody tr").all_inner_texts()
            table = {row.split("\t")[0]: [float(v) for v in row.split("\t")[2:4]] for row in rows}
            for name in solvers:
                page.select_option("#motion-cell .beside", name)
                _, said, numbers = put(page, "cell", 1)
                for line, (v1, v2, *forces) in zip(said, numbers, strict=True):
                    assert [v1, v2] == pytest.approx(table[line.split(":")[0]], abs=2e-3)
                    assert "S4" in line
                    assert forces == [0, 0]
            if cell == 1:  # a seventieth of the time, and yet seen: contacts act half-way through
                _, _, numbers = put(page, "cell", 0.5)
                assert any(force > 0.01 for each in numbers for force in each[2:])
            assert "NaN" not in page.locator("#motion-cell svg").inner_html()


def test_its_slow_motion_is_played_and_set_beside_engines(root, address):
    with opened(address) as page:
        ready(page)
        motion = page.locator("#motion-figures")
        assert motion.locator("option").all_inner_texts() == ["kelvin-voigt", "bistiffness", "mujoco"]
        assert motion.locator("select").input_value() == "mujoco"
        _, said, _ = put(page, "figures", 1)
        assert [line.split(";")[0] for line in said] == [
            "state-transition: S4: no contact acts",
            "mujoco: S4: no contact acts",
        ]
        motion.locator(".play").click()
        page.wait_for_function(
            "(([at]) => 0.05 < at && at < 1)([document.querySelector('#motion-figures .time').value])"
        )
        motion.locator(".play").click()
        assert motion.locator(".play").inner_text() == "Play"
        assert 0.05 < float(motion.locator(".time").input_value()) < 1


def test_of_a_limit_there_is_no_motion(tmp_path):
    grid = {"stiffness_ratio": [0, 1, math.inf], "mass_ratio": [1], "e1": [0.5], "e2": [0.5]}
    run_sweep(parse_config({"solvers": ["bistiffness"], "grid": grid}), tmp_path / "run")
    present(RunFolder(tmp_path / "run"))
    with opened((tmp_path / "run" / "report.html").as_uri()) as page:
        ready(page)
        for cell in (0, 1, 2):
            page.locator(f"[data-cell='{cell}']").click()
            assert page.locator("#motion-cell").is_visible() == (cell == 1)


def test_without_scripts_the_words_and_pictures_are_there(root):
    page = (root / "report.html").read_text(encoding="utf-8")
    bare = re.sub(r"<script.*?</script>|<style.*?</style>", "", page, flags=re.DOTALL)
    assert bare.count("<figure") > 9
    assert "How far are they from the model?" in html.unescape(bare)
    assert not re.search(
        r"\b(nan|None|undefined)\b", re.sub(r'"data:[^"]*"', "", bare).partition("Provenance</h2>")[0]
    )
