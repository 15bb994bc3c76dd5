"""What leaves a solver, whatever it does: a legal outcome for each collision."""

import dataclasses
import math

import numpy as np
import pytest

from impact_xval.compliant_baselines import Settings, get_solver
from impact_xval.compliant_baselines.answers import (
    IllegalOutcomeError,
    answer,
    answer_columns,
    validated,
)
from impact_xval.compliant_baselines.solver import SolverBase
from impact_xval.model.collision import Collision, Outcome

CELL = Collision.two_balls(m1=1.0, m2=1.5, k1=1e6, k2=2e6, e1=0.9, e2=0.7)
COLUMN = Collision((1.0, 1.0, 1.0), (1e6, 1e6), (0.9, 0.9), (-1.0, 0.0, 0.0))
GOOD = Outcome("x", (0.1, -0.2, -0.9), (1.0, 0.5), ("1+2", "-"))


def test_no_number_is_legal_only_without_a_result():
    for status in ("unconverged", "timeout", "crashed"):
        failed = Outcome.failure("x", CELL, status, "too long")
        assert validated(failed, CELL).reason == "too long"
        with pytest.raises(IllegalOutcomeError, match="status ok, but velocities, impulses = "):
            validated(dataclasses.replace(failed, status="ok"), CELL)


def test_an_outcome_of_a_column_is_what_its_class_says():
    assert validated(GOOD, COLUMN) == GOOD
    for changes, says in (
        ({"velocities": (0.0, 0.0)}, "velocities; legal: a tuple of 3 numbers"),
        ({"velocities": (np.nan, 0.0, 0.0)}, "status ok, but velocities, impulses = "),
        ({"impulses": None}, "impulses; legal: a tuple of 2 numbers"),
        ({"states": ("1+3", "-")}, "of 1 to 2"),
        ({"status": "fine"}, "status = 'fine'; legal: ok"),
    ):
        with pytest.raises(IllegalOutcomeError, match=says):
            validated(dataclasses.replace(GOOD, **changes), COLUMN)


def test_illegal_settings_are_named_with_the_legal_range():
    for field, values, legal in (
        ("scenario", ["bounce"], "'impact' or 'drop'"),
        ("gravity", [0.0, math.inf, math.nan], "a finite number > 0"),
        ("step_fraction", [0.0, 0.2, math.nan], "greater than 0, at most 0.1"),
        ("max_steps", [0], "a whole number >= 1"),
        ("mapping", ["default"], "'calibrated' or 'naive'"),
        ("shortest_state", [-0.001, 0.2, math.nan], "from 0 to 0.1"),
        ("stiffness_ratio_cutoff", [1.0], "greater than 1, up to inf"),
    ):
        for value in values:
            with pytest.raises(ValueError, match=rf"{field} = {value!r}; legal: {legal}"):
                Settings(**{field: value})


class Mine(SolverBase):
    """A solver that does with a list what a test says."""

    name = "mine"

    def __init__(self, made):
        self.made = made

    def version(self):
        return "1"

    def solve_many(self, collisions, settings):
        return self.made(collisions)

    def solve_columns(self, columns, settings):
        return self.made(columns)


def test_what_goes_wrong_is_a_crashed_outcome_of_each():
    for made, says in (
        (lambda asked: 1 / 0, "ZeroDivisionError: division by zero"),
        (lambda asked: asked[1:], "RuntimeError: 0 outcomes for 1 collisions"),
        (lambda asked: None, "TypeError: {method} gave NoneType; legal: list or Outcomes"),
        (lambda asked: [1] * len(asked), "the outcome is of type int; legal: Outcome"),
    ):
        pairs = answer(Mine(made), [CELL, CELL], Settings())
        columns = answer_columns(Mine(made), [COLUMN, COLUMN], Settings())
        words = {"method": "solve_many"}
        assert [(o.status, o.reason) for o in pairs] == 2 * [("crashed", says.format(**words))]
        words = {"method": "solve_columns"}
        assert [(o.status, o.reason) for o in columns] == 2 * [("crashed", says.format(**words))]
        assert all(len(o.velocities) == 3 for o in columns)


def test_one_collision_that_goes_wrong_spoils_no_other():
    def made(collisions):
        if any(c.e1 == 0.5 for c in collisions):
            raise ValueError("not this one")
        return get_solver("state-transition").solve_many(collisions, Settings())

    cells = [dataclasses.replace(CELL, restitutions=(e1, 0.7)) for e1 in (0.9, 0.5, 0.8)]
    outcomes = answer(Mine(made), cells, Settings())
    assert [o.status for o in outcomes] == ["ok", "crashed", "ok"]
    assert outcomes[1].reason == "ValueError: not this one"
    exact = get_solver("state-transition").solve_many([cells[0], cells[2]], Settings())
    assert [outcomes[0].v1, outcomes[2].v1] == [o.v1 for o in exact]


def test_ctrl_c_goes_through():
    def made(collisions):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        answer(Mine(made), [CELL], Settings())
