"""The explorer: what an address asks for, how it is served, and how it looks and moves in a browser."""

import math
import re
import signal
import socket
import subprocess
import sys
from contextlib import contextmanager

import pytest

from impact_xval import Collision, solve
from impact_xval.experiments.cells.asked import asked
from impact_xval.experiments.config.errors import UserError
from tests.browser import opened, violations


@contextmanager
def served():
    """Serve the explorer at a free port; gives the process, interrupted in the end, and its address."""
    command = [sys.executable, "-m", "impact_xval", "explore", "--no-browser", "--port", "0"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, bufsize=1)
    try:
        line = process.stdout.readline()
        found = re.match(r"(http://\S+:\d+/) ", line)
        assert found, (line, process.stderr.read() if process.poll() is not None else "")
        yield process, found[1]
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            process.communicate(timeout=300)


@contextmanager
def explored(query="", **look):
    """Open the page of a query; gives it once its cell is drawn."""
    with served() as (_, address), opened(address + query, offline=False, **look) as page:
        wait_for(page, "models !== null && models.answer.data.query[0] === query()")
        yield page


def wait_for(page, what):
    """Wait until an expression of JavaScript holds."""
    page.wait_for_function(f"() => typeof models !== 'undefined' && ({what})")


def test_an_address_names_two_balls_or_a_column():
    cell = asked("stiffness_ratio=inf&mass_ratio=2&e1=0&e2=1").problem
    assert isinstance(cell, Collision)
    assert (cell.stiffness_ratio, cell.mass_ratio, cell.e1, cell.e2) == (math.inf, 2.0, 0.0, 1.0)
    assert asked("e1=0.5").problem.stiffness_ratio == 40

    cell = asked("kind=column&balls=3&strike=2&e=0.5&mass_taper=2").problem
    assert cell == Collision((1, 2, 4), (1e8, 1e8), (0.5, 0.5), (-1, -1, 0))
    assert asked("kind=column&arrangement=stack&balls=2&strike=7").problem.table


def test_what_is_illegal_in_an_address_is_named():
    for query, says in (
        ("kind=cube", "kind = 'cube'; legal: 'collision', 'column'"),
        ("e3=1", "'e3' is no parameter of a collision; legal: stiffness_ratio, mass_ratio, e1, e2"),
        ("e1=2", "e1 = 2.0; legal: from 0 to 1"),
        ("e1=<b>", "e1 = '<b>'; legal: a number"),
        ("mass_ratio=", "mass_ratio = ''; legal: a number"),
        ("kind=column&balls=51", "balls = 51; legal here: at most 50"),
        ("kind=column&balls=3&strike=3", "strike = 3; legal: a whole number from 1 to 2"),
    ):
        with pytest.raises(UserError) as error:
            asked(query)
        assert str(error.value).startswith(says)


def test_a_port_in_use_is_one_line_and_2():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        command = [sys.executable, "-m", "impact_xval", "explore", "--no-browser", "--port", port]
        done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1), done
    assert "Address already in use; legal:" in done.stderr


def test_it_listens_on_this_machine_alone_and_ctrl_c_ends_it():
    with served() as (process, address):
        assert address.startswith("http://127.0.0.1:")
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=300)
    assert (process.returncode, said) == (1, "impact-xval: interrupted\n")


@pytest.mark.slow
def test_a_move_shows_the_cell_of_its_address_and_the_button_adds_the_engines():
    with explored("?stiffness_ratio=40&mass_ratio=1.5&e1=0.9&e2=0.7") as page:
        page.fill("#stiffness_ratio", "3")
        wait_for(page, "models.answer.data.query[0] === query() && location.search.includes('ratio=3&')")
        expected = solve(Collision.from_ratios(3, 1.5, 0.9, 0.7))
        assert f"{expected.v1:.6f}" in page.inner_text("#results")
        assert " ".join(expected.states) in page.inner_text("#results")
        x = page.evaluate("Array.from(found('ends_data').data.x)")
        assert x[0] == pytest.approx(expected.impulse1, rel=1e-9)
        page.fill("#e1", "<b>2")
        wait_for(page, "models.answer.data.problem[0]")
        assert page.inner_text("#problem") == "e1 = '<b>2'; legal: a number"
        page.fill("#e1", "0.9")
        page.click("#engines")
        wait_for(page, "document.getElementById('results').textContent.includes('mujoco')")
        assert "mujoco" in page.inner_text("#legend")


@pytest.mark.slow
def test_the_page_fits_and_is_accessible():
    with explored("?e1=0.8", width=390, scheme="dark") as page:
        for width, scheme in ((390, "dark"), (1200, "light")):
            page.set_viewport_size({"width": width, "height": 900})
            page.emulate_media(color_scheme=scheme)
            assert page.evaluate("document.documentElement.scrollWidth") <= width
            assert violations(page) == []
