"""What leaves a solver: a legal outcome for each collision, and a process as it was."""

import dataclasses
import os
import signal
import sys
from pathlib import Path

import numpy as np
import pytest

from impact_xval.compliant_baselines import Settings, get_solver
from impact_xval.compliant_baselines.contract.answers import (
    LONGEST,
    IllegalOutcomeError,
    answer,
    answer_columns,
    one_line,
    undisturbed,
    validated,
    validated_column,
)
from impact_xval.compliant_baselines.contract.solver import SolverBase
from impact_xval.model.collision import Collision, Outcome
from impact_xval.model.columns.column import Column, ColumnOutcome

CELL = Collision(m1=1.0, m2=1.5, k1=1e6, k2=2e6, e1=0.9, e2=0.7)
SOLVERS = ("state-transition", "bistiffness", "kelvin-voigt", "hunt-crossley", "mujoco", "pybullet", "oracle")


@pytest.mark.parametrize("name", SOLVERS)
def test_the_outcomes_of_our_own_solvers_stay_what_they_are(name):
    solver = get_solver(name)
    if solver.unavailable() is not None:
        pytest.skip(str(solver.unavailable()))
    (outcome,) = solver.solve_many([CELL], Settings(record_path=True, step_fraction=1e-2))
    found = validated(outcome, CELL)
    assert repr(dataclasses.replace(found, path=None)) == repr(dataclasses.replace(outcome, path=None))
    if outcome.path is not None:
        assert found.path is not None
        for field in dataclasses.fields(outcome.path):
            before, after = (getattr(one.path, field.name) for one in (outcome, found))
            np.testing.assert_array_equal(before, after)


def test_a_number_of_numpy_becomes_one_of_python():
    outcome = Outcome("x", np.float32(0.5), np.float64(0.25), np.int64(1), 1, ("S1", "S4"))
    found = validated(outcome, CELL)
    assert [type(value) for value in (found.v1, found.v2, found.impulse1, found.impulse2)] == [float] * 4


@pytest.mark.parametrize("status", ["unconverged", "timeout", "crashed"])
def test_no_number_is_legal_without_a_result(status):
    assert validated(Outcome.failure("x", status, "too long"), CELL).reason == "too long"
    with pytest.raises(IllegalOutcomeError, match="status ok, but v1, v2, impulse1, impulse2 = "):
        validated(dataclasses.replace(Outcome.failure("x", status, ""), status="ok"), CELL)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("e1 = 0 — refused", "e1 = 0 — refused"),
        ("two\n  lines\tand more", "two lines and more"),
        ("\x1b[2Jgone\x07", "\\x1b[2Jgone\\x07"),
        ("half \ud83d", "half \\ud83d"),
        ("to the \u202eleft", "to the \\u202eleft"),
    ],
)
def test_a_text_of_a_solver_is_a_line_that_can_be_shown(text, line):
    assert one_line(text) == line
    assert one_line(1000 * text).isprintable()
    assert len(one_line(1000 * text)) <= LONGEST


class _Interrupted(SolverBase):
    name = "interrupted"

    def version(self):
        return ""

    def solve_many(self, collisions, settings):
        raise KeyboardInterrupt


def test_ctrl_c_goes_through_and_where_it_cannot_come_it_is_the_solver_s():
    with pytest.raises(KeyboardInterrupt):
        answer(_Interrupted(), [CELL], Settings())
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        (outcome,) = answer(_Interrupted(), [CELL], Settings())
    finally:
        signal.signal(signal.SIGINT, before)
    assert (outcome.status, outcome.reason) == ("crashed", "KeyboardInterrupt:")


def test_a_process_is_left_as_it_was(tmp_path):
    folder, places, modules = Path.cwd(), list(sys.path), sys.path
    streams = [os.fstat(stream) for stream in range(3)]
    with undisturbed():
        os.chdir(tmp_path)
        sys.path = []
        modules.clear()
        for stream in range(3):
            os.close(stream)
    assert (Path.cwd(), sys.path) == (folder, places)
    assert sys.path is modules
    assert [os.fstat(stream) for stream in range(3)] == streams


def test_a_forked_child_ends_where_its_parent_goes_on():
    with undisturbed():
        child = os.fork()
    assert os.waitpid(child, 0) == (child, 0)


class LyingText(str):
    """A text whose methods are the solver's own."""

    def isprintable(self):
        return True

    def __str__(self):
        return self


def test_no_method_of_a_text_of_the_solver_s_own_class_is_trusted():
    line = one_line(LyingText("half \ud800 of it"))
    assert type(line) is str
    assert line == r"half \ud800 of it"


class _Changing(SolverBase):
    """Sets e2 of what it is given to 1, before it solves that."""

    name = "changing"

    def __init__(self, also_raises):
        self.also_raises = also_raises

    def version(self):
        return "1"

    def solve_many(self, collisions, settings):
        for c in collisions:
            if c.e1 == 0.5:
                object.__setattr__(c, "e2", 1.0)
        if self.also_raises and len(collisions) > 1:
            raise ValueError
        return get_solver("state-transition").solve_many(collisions, settings)


@pytest.mark.parametrize("also_raises", [False, True])
def test_a_solver_that_changes_a_collision_changes_nobody_else_s(also_raises):
    collisions = [Collision(1.0, 1.0, 1.0, 1.0, e1, 0.7) for e1 in (0.9, 0.5)]
    before = [dataclasses.replace(c) for c in collisions]
    unchanged, changed = answer(_Changing(also_raises), collisions, Settings())
    assert collisions == before
    assert unchanged.status == "ok"
    assert changed.status == "crashed"
    assert changed.reason.startswith("it changed the collision it was given to Collision(m1=1.0, ")


COLUMN = Column((1.0, 1.0, 1.0), (1e6, 1e6), (0.9, 0.9), (-1.0, 0.0, 0.0))


@pytest.mark.parametrize("name", SOLVERS)
def test_the_outcomes_of_columns_of_our_own_solvers_stay_what_they_are(name):
    solver = get_solver(name)
    if solver.unavailable() is not None:
        pytest.skip(str(solver.unavailable()))
    settings = Settings(record_path=True, step_fraction=1e-2)
    (outcome,), (found,) = (solve([COLUMN], settings) for solve in (solver.solve_columns, _answering(solver)))
    assert repr(dataclasses.replace(found, path=None)) == repr(dataclasses.replace(outcome, path=None))
    assert (found.path is None) == (outcome.path is None) == (name == "oracle")  # which solves none
    for field in dataclasses.fields(outcome.path) if outcome.path else ():
        before, after = (getattr(one.path, field.name) for one in (outcome, found))
        np.testing.assert_array_equal(before, after)


def _answering(solver):
    return lambda columns, settings: answer_columns(solver, columns, settings)


GOOD = ColumnOutcome("x", (0.1, -0.2, -0.9), (1.0, 0.5), ((1, 2), ()))


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"velocities": (0.0, 0.0)}, "velocities; legal: a tuple of 3 numbers"),
        ({"velocities": ("fast", 0.0, 0.0)}, r"velocities\[1\] is of type str; legal: a number"),
        ({"velocities": (np.nan, 0.0, 0.0)}, "status ok, but velocities, impulses = "),
        ({"velocities": (1e308, 1e308, 1e308)}, "their energy overflows"),
        ({"impulses": None}, "impulses; legal: a tuple of 2 numbers"),
        ({"states": ((1, 3), ())}, "another contact; legal: 1 to 2"),
        ({"states": ("S1",)}, "states; legal: a tuple of sets of contacts"),
        ({"status": "fine"}, "status = 'fine'; legal: ok"),
        ({"path": 7}, "path is of type int; legal: ColumnPath or None"),
    ],
)
def test_an_outcome_of_a_column_is_what_its_class_says(changes, says):
    assert validated_column(GOOD, COLUMN) == GOOD
    with pytest.raises(IllegalOutcomeError, match=says):
        validated_column(dataclasses.replace(GOOD, **changes), COLUMN)


class _OfColumns(SolverBase):
    name = "mine"

    def __init__(self, made):
        self._made = made

    def version(self):
        return "1"

    def solve_many(self, collisions, settings):
        raise AssertionError("not asked for")

    def solve_columns(self, columns, settings, exponent=1.0):
        return self._made(columns)


@pytest.mark.parametrize(
    ("made", "says"),
    [
        (lambda columns: 1 / 0, "ZeroDivisionError: division by zero"),
        (lambda columns: columns[1:], "RuntimeError: 0 outcomes for 1 columns"),
        (lambda columns: None, "TypeError: solve_columns gave NoneType; legal: list"),
        (lambda columns: [1] * len(columns), "solve_columns gave int; legal: ColumnOutcome"),
    ],
)
def test_what_goes_wrong_with_columns_is_an_outcome_of_each(made, says):
    for outcome in answer_columns(_OfColumns(made), [COLUMN, COLUMN], Settings()):
        assert (outcome.status, outcome.reason) == ("crashed", says)
        assert len(outcome.velocities) == 3
