"""Columns on which rounding decides are marked; those on which it does not are not."""

import numpy as np
import pytest

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.contract.solver import Settings
from impact_xval.compliant_baselines.references.columns.rounding import MOVED, changed, mark_columns
from impact_xval.compliant_baselines.references.columns.solving import solve_column
from impact_xval.model import Column

#: All of 8 balls fall together, elastic: 585 events. By Taylor series in 40 and in 60 digits, which agree in these ten.
STACK = Column(
    tuple(0.5**i for i in range(8)), tuple(3.0**i for i in range(8)), (1.0,) * 8, (-1.0,) * 8, table=True
)
TRUTH = (1.09328, 1.05188, 0.81421, 0.65294, 0.59658, 0.23538, 0.21022, 0.03787)

TAME = Column((1.0, 0.5, 0.25), (1e5, 2e5, 4e5), (0.9, 0.8, 1.0), (-1.0, -1.0, -1.0), table=True)


def test_what_rounding_decides_is_marked():
    for law in ("bistiffness", "kelvin-voigt"):
        (outcome,) = get_solver(law).solve_columns([STACK], Settings(scenario="impact"))
        assert outcome.status == "ok"
        assert np.abs(np.subtract(outcome.velocities, TRUTH)).max() > 0.1  # which is why
        assert outcome.marked.startswith(
            "a change of 1e-06 in masses and stiffnesses moves the exact outcome"
        )


def test_what_it_does_not_decide_is_not():
    for law in ("bistiffness", "kelvin-voigt", "kelvin-voigt-textbook", "hunt-crossley"):
        (outcome,) = get_solver(law).solve_columns([TAME], Settings(scenario="impact"))
        assert (outcome.status, outcome.marked) == ("ok", ""), law
        for other in changed(TAME):
            assert other.velocities == TAME.velocities
            away = np.abs(np.subtract(solve_column(other, law).velocities, outcome.velocities)).max()
            assert away < MOVED, law


def test_an_error_that_is_stated_marks_too():
    outcome = solve_column(STACK, "hunt-crossley")
    assert outcome.diagnostics["velocity_error"] > 1e-3
    (marked,) = mark_columns([outcome], [STACK], "hunt-crossley")
    assert marked.marked.startswith("its own error moves")


@pytest.mark.slow
def test_an_engine_is_marked_where_its_exact_law_is():
    column = Column(STACK.masses[:6], STACK.stiffnesses[:6], (1.0,) * 6, STACK.velocities[:6], table=True)
    settings = Settings(scenario="impact", step_fraction=0.05)
    (exact,) = get_solver("kelvin-voigt").solve_columns([column], settings)
    (engine,) = get_solver("mujoco").solve_columns([column], settings)
    (tame,) = get_solver("mujoco").solve_columns([TAME], settings)
    assert engine.marked == exact.marked != ""
    assert tame.marked == ""
