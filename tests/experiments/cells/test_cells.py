"""One cell solved by several solvers: the comparison, its view in a notebook, and the explorer in a browser."""

import json
import re
import signal
import socket
import subprocess
import sys
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from importlib.metadata import version

import numpy as np
import pytest
from markupsafe import escape

from impact_xval import Collision, compare, solve
from impact_xval.experiments.cells.compared import SolverComparison
from impact_xval.experiments.cells.explorer import ExplorerCells
from impact_xval.model import Outcome
from tests.browser import opened, violations

COMMAND = [sys.executable, "-m", "impact_xval", "explore", "--no-browser", "--port"]
HOSTILE = "<script>alert('&')</script> | **bold** <img src=x onerror=alert(1)>"
PLAIN = Collision.from_ratios(1.0, 1.0, 0.9, 0.9)
PAIR = Collision.two_balls(m1=2.0, m2=3.0, k1=1e8, k2=4e9, e1=0.9, e2=0.7, v0=-4.0)
CHAIN = Collision((1.0, 2.0, 1.0), (1e8, 2e8), (0.9, 0.8), (-3.0, 0.0, 0.0))


@pytest.mark.parametrize("problem", [PAIR, CHAIN, replace(CHAIN, exponent=1.5)])
def test_the_model_is_added_and_d_is_what_a_hand_computation_gives(problem):
    law = "kelvin-voigt" if problem.exponent == 1 else "hunt-crossley"
    compared = compare(problem, [law])
    model, other = compared.outcomes.values()
    alone = solve(problem)
    assert (model.velocities, model.states) == (alone.velocities, alone.states)
    assert model.path.velocities[-1] == pytest.approx(model.velocities)
    away = np.square([np.subtract(model.velocities, other.velocities), problem.velocities])
    by_hand = np.sqrt(np.divide(*(away @ problem.masses)))
    assert by_hand > 0.01
    assert compared.divergences == {"state-transition": 0, law: pytest.approx(by_hand, rel=1e-12)}
    shown = compared._repr_html_()
    assert shown.count("<table") == shown.count("<img") == shown.count("image/png;base64,iVBORw0KGgo") == 1
    assert {law, f"{other.v1 / -problem.velocities[0]:.6f}"} <= {*re.findall(">([^<]*)</td>", shown)}
    assert f"v{len(problem.masses)}" in str(compared)


def test_hostile_names_and_reasons_stay_text_and_without_a_path_there_is_no_picture():
    failed = Outcome.failure(HOSTILE, PLAIN, "crashed", HOSTILE)
    answered = Outcome(HOSTILE + "2", (0.5, 0.25), (1.5, 1.75), ("S1", "S4"))
    compared = SolverComparison(
        PLAIN, {"state-transition": solve(PLAIN), HOSTILE: failed, answered.solver: answered}
    )
    assert np.isnan(compared.divergences[HOSTILE])
    shown = compared._repr_html_()
    assert not {"script", "strong", "img"} & {*re.findall(r"<([a-z]+)", shown)}
    assert re.search(rf">{re.escape(escape(HOSTILE))}</t[dh]>", shown)
    assert HOSTILE in str(compared)
    # if an engine used other parameters than requested, the printed comparison says so
    assert "mujoco-naive: damping 1 is " in str(compare(PLAIN, ["mujoco-naive"]))
    with pytest.raises(ValueError, match="no solver has a path to draw"):
        compared.plot()


def test_versions_of_engines_are_said():
    plain = solve(PLAIN)
    compared = SolverComparison(
        PLAIN,
        {"state-transition": plain, "mujoco": plain},
        versions={"state-transition": "1", "mujoco": "3.2.7"},
    )
    assert (
        str(compared).rstrip().endswith(f"Versions: impact-xval {version('impact-xval')} and mujoco 3.2.7.")
    )
    assert [each["version"] for each in compared.objects()] == ["1", "3.2.7"]
    assert "Versions" not in str(SolverComparison(PLAIN, {"state-transition": plain}))


def test_solvers_without_a_result_share_no_law():
    outcomes = {
        name: replace(solve(PLAIN), solver=name) for name in ("state-transition", "mujoco", "pybullet")
    }
    outcomes["drake"] = Outcome.failure("drake", PLAIN, "unavailable", "not here")
    shown = str(SolverComparison(PLAIN, outcomes))
    assert "MuJoCo and PyBullet were asked for the same contact law" in shown


def test_the_note_below_a_chain_explains_states_and_the_direction():
    for problem, direction in (
        (CHAIN, "the direction from the last ball to ball 1 is positive."),
        (
            replace(CHAIN, stiffnesses=(1e8, 2e8, 1e8), restitutions=(0.9, 0.8, 0.7), gaps=(), table=True),
            "up is positive.",
        ),
    ):
        shown = str(SolverComparison(problem, {"state-transition": solve(problem)}))
        assert f"velocities per |v0|, {direction}" in shown
        assert "states: number of sets of active contacts" in shown


def test_d_between_every_two_solvers_is_what_a_hand_computation_gives():
    velocities = {"mujoco": (0.5, 0.25), "pybullet": (0.75, 0.5), "state-transition": (0.25, 0.0)}
    outcomes = {name: Outcome(name, v, (1.5, 1.75), ("S1", "S4")) for name, v in velocities.items()}
    heavy = Collision.two_balls(m1=1.0, m2=3.0, k1=1e8, k2=1e8, e1=0.9, e2=0.7, v0=-2.0)
    lost = {"drake": Outcome.failure("drake", heavy, "unavailable", "not here")}
    compared = SolverComparison(heavy, outcomes | lost)
    # sqrt((0.25^2 + 3 0.25^2)/(1 2^2)) = 0.25, and twice this between PyBullet and the model
    expected = {("mujoco", "pybullet"): 0.25, ("mujoco", "state-transition"): 0.25}
    assert compared.between == expected | {("pybullet", "state-transition"): 0.5}
    lines = [line.split() for line in str(compared).partition("D between every two solvers")[2].splitlines()]
    assert [line for line in lines if line][:3] == [
        ["solver", "mujoco", "pybullet"],
        ["pybullet", "0.25"],
        ["state-transition", "0.25", "0.5"],
    ]
    known = {row["solver"]: row["D_from"] for row in compared.objects()}
    assert known["pybullet"] == {"mujoco": 0.25, "state-transition": 0.5}
    assert known["drake"] == {}
    two = SolverComparison(heavy, {name: outcomes[name] for name in ("mujoco", "state-transition")})
    # Two solvers have only one D (the divergence between them), which stands in the table of divergences.
    assert "D between" not in str(two)


def test_what_is_illegal_is_named():
    for options, says in (({"solvers": ["bullet"]}, "is not a solver"), ({"timeout": 0}, "greater than 0")):
        with pytest.raises(ValueError, match=says):
            compare(PLAIN, **options)


@pytest.fixture(scope="module")
def cells():
    with ExitStack() as ending:
        yield ExplorerCells(ending)


@contextmanager
def served():
    """Start the explorer at a free port; yield its process, which is interrupted at the end, and the port."""
    process = subprocess.Popen([*COMMAND, "0"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        found = re.match(r"http://127.0.0.1:(\d+)/ ", line := process.stdout.readline())
        assert found, line or process.stderr.read()
        yield process, found[1]
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=300)


def wait_for(page, what):
    """Wait until the page shows the cell of its address and a JavaScript expression is true."""
    page.wait_for_function(f"`?${{document.documentElement.dataset.shown}}` === location.search && ({what})")


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


def test_an_address_may_hold_a_chain(cells):
    answer = cells.answer("balls=3&arrangement=cradle&strike=2&e=0.5&mass_taper=2")
    chain = Collision((1, 2, 4), (1e8, 1e8), (0.5, 0.5), (-1, -1, 0))
    assert answer["data"]["balls state-transition"]["y"] == pytest.approx(solve(chain).velocities, abs=1e-12)
    assert "A cradle of 3 balls, 2 striking" in answer["results"]


def test_what_is_illegal_in_an_address_is_one_line(cells):
    for query, says in (
        ("e1=0.5&e3=1", "'e3' is no parameter; legal: stiffness_ratio, mass_ratio, e1, e2"),
        ("stiffness_ratio=3&mass_ratio=1&e1=%3Cb%3E&e2=1", "--e1 = '<b>'; legal: from 0 to 1"),
        ("stiffness_ratio=3&mass_ratio=1&e2=1", "--e1 missing; legal: "),
        ("balls=3&e=1&arrangement=cube", "--arrangement = 'cube'; legal: 'row', "),
    ):
        ((kind, said),) = cells.answer(query).items()
        assert (kind, said[: len(says)], said.count("\n")) == ("problem", says, 0)


def test_a_port_in_use_is_one_line_and_ctrl_c_while_a_cell_is_solved_the_end():
    with served() as (process, port):
        done = subprocess.run([*COMMAND, port], capture_output=True, text=True, timeout=300)
        assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1), done
        assert "Address already in use; legal:" in done.stderr
        with socket.create_connection(("127.0.0.1", int(port))) as page:
            page.sendall(b"GET /solved?stiffness_ratio=3&mass_ratio=1&e1=1&e2=1 HTTP/1.0\r\n\r\n")
            process.send_signal(signal.SIGINT)
            _, said = process.communicate(timeout=300)
    assert (process.returncode, said) == (0, "")


@pytest.mark.nightly
def test_the_page_fits_a_move_is_solved_the_button_adds_engines_and_the_address_opens_the_same_cell_again():
    with served() as (_, port), opened(f"http://127.0.0.1:{port}/", offline=False) as page:
        wait_for(page, "true")
        for width, scheme in ((390, "dark"), (1200, "light")):
            page.set_viewport_size({"width": width, "height": 900})
            page.emulate_media(color_scheme=scheme)
            # charts become as narrow as the window
            page.wait_for_function(f"document.documentElement.scrollWidth <= {width}")
            assert violations(page) == []
        page.fill("#stiffness_ratio", "3")
        wait_for(page, "location.search.includes('ratio=3&')")
        assert f"{solve(Collision.from_ratios(3, 1.1547, 0.9, 0.7)).v1:.6f}" in page.inner_text("#results")
        page.fill("#e1", "<b>2")
        wait_for(page, "document.getElementById('problem').textContent")
        assert page.inner_text("#problem") == "--e1 = '<b>2'; legal: from 0 to 1"
        page.fill("#e1", "0.9")
        page.press("#balls ~ [type=range]", "ArrowRight")
        wait_for(page, "location.search.includes('balls=3')")
        page.click("button")
        wait_for(page, "document.getElementById('results').textContent.includes('mujoco')")
        shown = page.inner_text("#results table")
        page.reload()
        wait_for(page, "document.getElementById('results').textContent.includes('v3')")
        assert page.inner_text("#results table").splitlines()[3].split()[1] in shown
        assert page.input_value("#balls") == "3"
