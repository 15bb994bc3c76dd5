"""Solvers under test: statuses and reasons as they are, whichever step they come from."""

import numpy as np

from impact_xval.compliant_baselines.contract.solver import Settings
from impact_xval.experiments.hypothesis.solvers import at_no_step
from impact_xval.model import Outcome
from tests.experiments.fakes import Shifted


class Stumbling(Shifted):
    """Cannot do a heavy B2 at the longest step."""

    def solve_many(self, collisions, settings):
        outcomes = super().solve_many(collisions, settings)
        failed = Outcome.failure(self.name, "unconverged", "the step is too long")
        return [
            failed if settings.step_fraction == 0.01 and c.m2 > 2 else outcome
            for c, outcome in zip(collisions, outcomes, strict=True)
        ]


def stumbling(name):
    return Stumbling()


def test_what_fails_at_one_step_has_the_status_and_the_reason_of_that_step():
    ratios = np.array([[1.0, 1.0], [1.0, 3.0], [0.9, 0.9], [0.7, 0.7]])
    found = at_no_step(stumbling, "mujoco", Settings(step_fraction=0.01), *ratios)
    assert found.status.tolist() == ["ok", "unconverged"]
    assert found.reason.tolist() == ["", "the step is too long"]
    assert np.isfinite(found.v1).tolist() == [True, False]
