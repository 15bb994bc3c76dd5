"""The scoreboard under docs is that of this code: exact laws, and engines of the versions that it names."""

import json
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.contract.solver import Settings
from impact_xval.compliant_baselines.practical.practices import get_practice, practice_names
from impact_xval.experiments.scoreboard.board import MEANINGS, VELOCITIES
from impact_xval.experiments.scoreboard.cases import MOST_STEPS, USUAL, VARIATIONS, cases
from impact_xval.experiments.scoreboard.judging import read_answers
from impact_xval.experiments.scoreboard.playing import LAWS

FOLDER = Path(__file__).parents[3] / "docs/scoreboard"
ANSWERS = read_answers(FOLDER)

#: Engines that compile for long.
_COMPILED = ("newton", "mjx")


def published(name, case):
    rows = ANSWERS[
        (ANSWERS.solver == name)
        & (ANSWERS.case == case.name)
        & (ANSWERS.e == case.e)
        & (ANSWERS.arrangement == USUAL)
    ]
    return rows[VELOCITIES].to_numpy()[0][: len(case.column.masses)].tolist()


@pytest.mark.parametrize("law", LAWS)
def test_exact_laws(law):
    asked = list(cases())
    outcomes = get_solver(law).solve_columns([case.column for case in asked], Settings())
    for case, outcome in zip(asked, outcomes, strict=True):
        assert published(law, case) == pytest.approx(list(outcome.velocities), abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in practice_names() if not name.startswith(_COMPILED)])
def test_engines_of_the_same_version(name):
    practice = get_practice(name)
    board = pd.read_csv(FOLDER / "board.csv", dtype={"version": str})
    version = board[board.solver == name].version.iloc[0]
    if practice.unavailable() or practice.version() != version:
        pytest.skip(f"{name} {version} is not here")
    for case in cases():
        usual = replace(practice.usual(case.column), max_steps=MOST_STEPS)
        found = practice.simulate(case.column, usual)
        if found.status == "ok":
            assert published(name, case) == pytest.approx(list(found.velocities), abs=1e-4)


def test_it_has_every_setting_case_and_arrangement():
    assert set(ANSWERS.solver) == {*LAWS, *practice_names()}
    assert len(ANSWERS) == 27 * (len(LAWS) + len(VARIATIONS) * len(practice_names()))
    described = json.loads((FOLDER / "scoreboard.json").read_text("utf-8"))
    assert described["columns"] == MEANINGS
    assert described["missing"] == {}
    assert len(described["engines"]) >= 7
