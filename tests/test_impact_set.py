"""The cases for other projects hold what the laws give today, and their checker recognises every law."""

import json
import math
import re
import subprocess
import sys
from runpy import run_path

import pytest

from benchmarks.impact_set import FILE, made
from impact_xval.compliant_baselines.registry import exact_law_names
from impact_xval.compliant_baselines.restitution import damping_ratio

SET = json.loads(FILE.read_text(encoding="utf-8"))
CHECKER = FILE.with_name("check_impact_set.py")
check = run_path(str(CHECKER))["check"]


#: A case with two balls.
TWO = "two balls, m2/m1 = 1, e = 1"


def answers(law):
    return {case["name"]: case["outcomes"].get(law) for case in SET["cases"]}


def run_checker(folder, given):
    """Run the checker in a folder that holds it, its set and the answers, and return the finished process."""
    (folder / "answers.json").write_text(json.dumps(given))
    for path in (FILE, CHECKER):
        (folder / path.name).write_bytes(path.read_bytes())
    command = [sys.executable, "check_impact_set.py", "answers.json"]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


def test_the_file_holds_the_outcomes_of_the_laws():
    assert len({case["name"] for case in SET["cases"]}) == len(SET["cases"]) == 60
    assert {word for case in SET["cases"] for word in case["known"]} == {"unique", "grazing", "endless"}
    fresh = json.loads(json.dumps(made()))
    assert {**fresh, "origin": 0, "cases": 0} == {**SET, "origin": 0, "cases": 0}
    for case, now in zip(SET["cases"], fresh["cases"], strict=True):
        assert {**case, "outcomes": 0} == {**now, "outcomes": 0}
        assert case["outcomes"].keys() == now["outcomes"].keys()
        for law, velocities in case["outcomes"].items():
            # Hunt-Crossley's contacts are integrated numerically. Beside a jump, rounding errors grow a thousandfold.
            assert velocities == pytest.approx(now["outcomes"][law], abs=1e-8), (case["name"], law)


@pytest.mark.parametrize("law", exact_law_names())
def test_the_checker_finds_the_law_of_every_exact_solver_and_no_other(law):
    first, second = check(answers(law))[:2]
    assert first[0] == law
    assert first[3] == 0.0
    assert second[1] < second[2] or second[2] < first[2]


def test_the_checker_needs_numpy_alone_and_names_what_breaks_a_law_of_conservation(tmp_path):
    given = answers("sequential-top")
    given[TWO] = [0.0, -1.2]
    finished = run_checker(tmp_path, given)
    said = finished.stdout
    assert (finished.returncode, finished.stderr) == (0, "")
    assert said.splitlines()[1].split()[:4] == ["sequential-top", "59", "of", "60"]
    assert f"{TWO}: energy is 1.440 of what it was" in said
    assert f"{TWO}: momentum is -1.200 kg m/s, and was -1.000" in said
    assert "impact_xval" not in CHECKER.read_text(encoding="utf-8")
    assert "no answer" not in said


@pytest.mark.parametrize(
    ("answer", "says"),
    [
        ([math.nan, -1.0], "[nan, -1.0] has a number that is not finite"),
        ([0.0, None], "[0.0, None] has a number that is not finite"),
        ([1.0], "[1.0] is not one velocity for each ball; balls: 2"),
        ([0.0, 0.0, -1.0], "[0.0, 0.0, -1.0] is not one velocity for each ball; balls: 2"),
        (-1.0, "-1.0 is not one velocity for each ball; balls: 2"),
        ([0.0, "fast"], "[0.0, 'fast'] is not a list of numbers"),
        ({"v": 1.0}, "{'v': 1.0} is not a list of numbers"),
    ],
)
def test_the_checker_refuses_an_answer_that_is_no_list_of_velocities(answer, says):
    with pytest.raises(ValueError, match="^" + re.escape(f"{TWO}: {says}") + "$"):
        check({**answers("newton-restitution"), TWO: answer})


def test_the_checker_names_missing_cases_and_unknown_names_in_a_line_each(tmp_path):
    given = answers("newton-restitution")
    given["two balls, m2/m1 = 1, e = 1.0"] = given.pop(TWO)
    finished = run_checker(tmp_path, given)
    assert finished.returncode == 1
    assert finished.stdout == ""
    assert finished.stderr.splitlines() == [
        f'{TWO}: missing; write null for "no answer"',
        f"{TWO}.0: the set has no case of this name",
    ]
    finished = run_checker(tmp_path, {})
    assert finished.returncode == 1
    assert [line.partition(": missing")[0] for line in finished.stderr.splitlines()] == list(answers("any"))


def test_the_checker_counts_cases_without_an_answer(tmp_path):
    finished = run_checker(tmp_path, answers("kelvin-voigt"))
    assert finished.returncode == 0
    assert finished.stdout.splitlines()[1].split() == ["kelvin-voigt", "50", "of", "50", "0"]
    assert "no answer (null): 10 of 60 cases" in finished.stdout
    with pytest.raises(ValueError, match="no case has an answer"):
        check(answers("no law"))


def test_the_damping_that_the_set_names_belongs_to_its_restitutions():
    numbers = f"For e = 0.9 zeta is {damping_ratio(0.9):.4f}, for e = 0.5 it is {damping_ratio(0.5):.4f}."
    assert numbers in CHECKER.read_text(encoding="utf-8")
    formula = "e = exp(-zeta/w atan2(2 zeta w, 2 zeta^2 - 1))"
    assert formula in SET["damping"]
    assert formula in CHECKER.read_text(encoding="utf-8")
    for e in {e for case in SET["cases"] for e in case["restitutions"]} - {0.0}:
        zeta = damping_ratio(e)
        w = math.sqrt(1 - zeta**2)
        assert math.exp(-zeta / w * math.atan2(2 * zeta * w, 2 * zeta**2 - 1)) == pytest.approx(e, rel=1e-12)
