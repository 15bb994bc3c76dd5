"""What a run says of how it ended, and that every caller goes by it."""

import math
from importlib.metadata import version

import numpy as np
import pytest

from impact_xval.compliant_baselines.calibration.calibration import ContactRequest, try_contacts
from impact_xval.compliant_baselines.calibration.pair import Pair, drops
from impact_xval.compliant_baselines.contact.column import column_of
from impact_xval.compliant_baselines.contract.solver import Settings, SolverError
from impact_xval.compliant_baselines.engines.engine import EngineSolver
from impact_xval.compliant_baselines.engines.recording import Recorder
from impact_xval.model import Collision

CELL = Collision(m1=1.0, m2=1.0, k1=1e6, k2=1e6, e1=0.9, e2=0.7)
RISING, FALLING, BROKEN = (1.0, 0.5), (-1.0, -0.5), (math.nan, 0.0)


class TwoSteps(EngineSolver):
    """An engine that takes two steps, after each of which the velocities are those given."""

    name = "two-steps"
    distribution = "pytest"

    def __init__(self, v=FALLING, failure=""):
        self.v, self.failure = v, failure

    def run_columns(self, columns, max_steps, record_path=False):
        runs = []
        for column in columns:
            recorder = Recorder(column, 1.0, 1.0, column.contact2.k, max_steps, record_path)
            recorder.feed(np.array([self.v] * 2), np.ones((2, 2)))
            runs.append(recorder.finish(self.failure))
        return runs


@pytest.mark.parametrize(
    ("engine", "status"),
    [
        (TwoSteps(RISING), "ok"),
        (TwoSteps(FALLING), "timeout"),
        (TwoSteps(BROKEN), "crashed"),
        (TwoSteps(FALLING, "on fire"), "crashed"),
        (TwoSteps(RISING, "on fire"), "crashed"),
    ],
)
def test_a_run_an_outcome_and_a_contact_have_one_status(engine, status):
    settings = Settings(step_fraction=0.1)
    (run,) = engine.run_columns([column_of(CELL, settings)], 1)
    assert run.status == status
    assert (run.problem() == "") == (status == "ok")
    (outcome,) = engine.solve_many([CELL], settings)
    assert outcome.status in (status, "unconverged" if status == "ok" else status)
    assert ("a smaller step may help" in outcome.reason) == (status == "crashed")
    (contact,) = try_contacts(engine, [ContactRequest("ball-ball", 0.5)])
    assert getattr(contact, "status", "ok") == status
    pair = Pair((1.0, 1.0), 0.5, stiffness=1e6)
    if status != "ok":
        with pytest.raises(SolverError) as refused:
            drops(engine, pair, 1e-5, [0.0])
        assert refused.value.status == status
        assert ("on fire" in refused.value.reason) == bool(engine.failure)


def test_the_version_of_an_engine_is_that_of_its_distribution():
    assert TwoSteps().version() == version("pytest")
    missing = TwoSteps()
    missing.distribution = "no-such-engine"
    assert missing.version() == ""
