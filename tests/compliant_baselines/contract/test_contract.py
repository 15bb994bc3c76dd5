import math

import pytest

from impact_xval.compliant_baselines import Settings, SolverError, get_solver
from impact_xval.model.collision import Collision


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
