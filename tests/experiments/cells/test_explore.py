"""The explorer: what an address asks for, how it is served, and how it moves in a browser."""

import json
import re
import signal
import socket
import subprocess
import sys
from contextlib import ExitStack, contextmanager
from urllib.parse import quote

import pytest

from impact_xval import Collision, solve
from impact_xval.experiments.cells.explorer import Cells
from impact_xval.experiments.commands.options import asked_by_address
from tests.browser import opened, violations

COMMAND = [sys.executable, "-m", "impact_xval", "explore", "--no-browser", "--port"]


@pytest.fixture(scope="module")
def cells():
    with ExitStack() as ending:
        yield Cells(asked_by_address, ending)


@contextmanager
def served():
    """Serve the explorer at a free port; gives the process, interrupted in the end, and its address."""
    process = subprocess.Popen([*COMMAND, "0"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        line = process.stdout.readline()
        found = re.match(r"(http://127.0.0.1:\d+/) ", line)
        assert found, (line, process.stderr.read() if process.poll() is not None else "")
        yield process, found[1]
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            process.communicate(timeout=300)


def wait_for(page, what):
    """Wait until what is shown is of the address, and an expression of JavaScript holds."""
    page.wait_for_function(
        f"() => `?${{document.documentElement.dataset.shown}}` === location.search && ({what})"
    )


def test_an_address_has_its_table_and_curves_that_end_where_the_model_does(cells):
    answer = cells.answer("stiffness_ratio=3&mass_ratio=1.5&e1=0.9&e2=0.7&solver=mujoco")
    expected = solve(Collision.from_ratios(3, 1.5, 0.9, 0.7))
    for shown in (f"{expected.v1:.6f}", " ".join(expected.states), "kelvin-voigt", "mujoco"):
        assert shown in answer["results"]
    end = answer["data"]["end state-transition"]
    assert (*end["x"], *end["y"]) == pytest.approx(expected.impulses, abs=1e-4)
    assert answer["data"]["curve mujoco"]["x"]
    assert answer["data"]["curve pybullet"] == {"x": [], "y": []}
    json.dumps(answer, allow_nan=False)


def test_an_address_may_hold_a_column(cells):
    answer = cells.answer("balls=3&arrangement=cradle&strike=2&e=0.5&mass_taper=2")
    column = Collision((1, 2, 4), (1e8, 1e8), (0.5, 0.5), (-1, -1, 0))
    assert answer["data"]["balls state-transition"]["y"] == pytest.approx(solve(column).velocities, abs=1e-12)
    assert "A cradle of 3 balls, 2 striking" in answer["results"]


def test_what_is_illegal_in_an_address_is_one_line(cells):
    pair = "stiffness_ratio=3&mass_ratio=1&e2=1"
    for query, says in (
        (f"{pair}&e3=1", "'e3' is no parameter; legal: stiffness_ratio, mass_ratio, e1, e2"),
        (f"{pair}&e1=2", "--e1 = 2.0; legal: from 0 to 1"),
        (f"{pair}&e1={quote('<b>')}", "--e1 = '<b>'; legal: from 0 to 1"),
        (pair, "--e1 missing; legal: "),
        ("balls=3&e=1&arrangement=cube", "--arrangement = 'cube'; legal: 'chain', "),
    ):
        ((kind, said),) = cells.answer(query).items()
        assert (kind, said[: len(says)], said.count("\n")) == ("problem", says, 0)


def test_a_port_in_use_and_ctrl_c_while_a_cell_is_solved_are_one_line():
    with served() as (process, address):
        host, port = re.search(r"//(.+):(\d+)/", address).groups()
        done = subprocess.run([*COMMAND, port], capture_output=True, text=True, timeout=300)
        assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1), done
        assert "Address already in use; legal:" in done.stderr
        with socket.create_connection((host, int(port))) as page:
            page.sendall(b"GET /solved?stiffness_ratio=3&mass_ratio=1&e1=1&e2=1 HTTP/1.0\r\n\r\n")
            process.send_signal(signal.SIGINT)
            _, said = process.communicate(timeout=300)
    assert (process.returncode, said) == (1, "impact-xval: interrupted\n")


@pytest.mark.slow
def test_the_page_fits_a_move_is_solved_the_button_adds_engines_and_the_address_opens_the_same_cell_again():
    with served() as (_, address), opened(address, offline=False) as page:
        wait_for(page, "true")
        for width, scheme in ((390, "dark"), (1200, "light")):
            page.set_viewport_size({"width": width, "height": 900})
            page.emulate_media(color_scheme=scheme)
            assert page.evaluate("document.documentElement.scrollWidth") <= width
            assert violations(page) == []
        page.fill("#stiffness_ratio", "3")
        wait_for(page, "location.search.includes('ratio=3&')")
        assert f"{solve(Collision.from_ratios(3, 1.1547, 0.9, 0.7)).v1:.6f}" in page.inner_text("#results")
        page.fill("#e1", "<b>2")
        wait_for(page, "document.getElementById('problem').textContent")
        assert page.inner_text("#problem") == "--e1 = '<b>2'; legal: from 0 to 1"
        page.fill("#e1", "0.9")
        page.focus("#balls ~ [type=range]")
        page.keyboard.press("ArrowRight")
        wait_for(page, "location.search.includes('balls=3')")
        page.click("button")
        wait_for(page, "document.getElementById('results').textContent.includes('mujoco')")
        shown = page.inner_text("#results table")
        page.reload()
        wait_for(page, "document.getElementById('results').textContent.includes('v3')")
        assert page.inner_text("#results table").splitlines()[3].split()[1] in shown
        assert page.input_value("#balls") == "3"
