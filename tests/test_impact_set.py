"""The cases for other projects hold what the laws give today, and their checker recognises every law."""

import json
import subprocess
import sys
from runpy import run_path

import pytest

from benchmarks.impact_set import FILE, made
from impact_xval.compliant_baselines.registry import exact_law_names

SET = json.loads(FILE.read_text(encoding="utf-8"))
CHECKER = FILE.with_name("check_impact_set.py")
check = run_path(str(CHECKER))["check"]


def answers(law):
    return {case["name"]: case["outcomes"][law] for case in SET["cases"] if law in case["outcomes"]}


def test_the_file_holds_the_outcomes_of_the_laws():
    assert len({case["name"] for case in SET["cases"]}) == len(SET["cases"]) == 60
    assert {word for case in SET["cases"] for word in case["known"]} == {"unique", "grazing", "endless"}
    for case, now in zip(SET["cases"], json.loads(json.dumps(made()))["cases"], strict=True):
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
    given["two balls, m2/m1 = 1, e = 1"] = [0.0, -1.2]
    (tmp_path / "answers.json").write_text(json.dumps(given))
    for path in (FILE, CHECKER):
        (tmp_path / path.name).write_bytes(path.read_bytes())
    command = [sys.executable, "check_impact_set.py", "answers.json"]
    said = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True).stdout
    assert said.splitlines()[1].split()[:4] == ["sequential-top", "59", "of", "60"]
    assert "two balls, m2/m1 = 1, e = 1: energy is 1.440 of what it was" in said
    assert "two balls, m2/m1 = 1, e = 1: momentum is -1.200 kg m/s, and was -1.000" in said
    assert "impact_xval" not in CHECKER.read_text(encoding="utf-8")
