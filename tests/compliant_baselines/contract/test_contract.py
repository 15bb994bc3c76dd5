import math

import pytest

from impact_xval.compliant_baselines import Settings, SolverError, get_solver
from impact_xval.model.collision import Collision

CELL = Collision(m1=1.0, m2=2 / 3**0.5, k1=1.0, k2=1.0, e1=0.9, e2=0.7)


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


def test_a_failure_in_a_direct_call_carries_status_and_reason():
    with pytest.raises(SolverError) as caught:
        get_solver("mujoco").solve(Collision(1.0, 1.0, 1.0, 1.0, 0.0, 0.5))
    assert caught.value.status in ("unrepresentable", "unavailable")
    assert caught.value.reason in str(caught.value)


def test_the_model_behind_the_contract_is_the_model():
    solver = get_solver("state-transition")
    outcome = solver.solve(CELL, Settings(stiffness_ratio_cutoff=math.inf, record_path=True))
    assert outcome.solver == "state-transition"
    # docs/theory.md, section 6
    assert (outcome.v1, outcome.v2) == (
        pytest.approx(0.61394941925041, abs=1e-12),
        pytest.approx(0.20971952034697, abs=1e-12),
    )
    assert outcome.states == ("S1", "S2", "S1", "S3", "S4")
    assert outcome.path is not None
