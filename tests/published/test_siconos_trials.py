"""Trials that another program computed (examples/two-balls-by-siconos.csv): a fit finds its law and what was put in."""

from pathlib import Path

import numpy as np
import pytest

from impact_xval.experiments.fit.fitting import fit
from impact_xval.experiments.fit.laws import LAWS
from impact_xval.experiments.fit.trials import read_trials, trials_of
from tests.model import compiled_only

FILE = Path(__file__).parents[2] / "examples" / "two-balls-by-siconos.csv"
PLANTED = [np.log10(2.5), 0.85, 0.7]


def test_its_velocities_are_those_of_the_law():
    t = trials_of(read_trials(FILE))
    v1, v2 = LAWS["liu-zhao-brogliato"].velocities(np.array(PLANTED), t.mass_ratio)
    assert np.abs([v1 - t.v1, v2 - t.v2]).max() < 1e-5  # of its steps in impulse


@compiled_only
def test_the_fit_finds_the_law_and_its_parameters():
    found = fit(FILE, ["liu-zhao-brogliato", "state-transition", "poisson"], leave_out=False)
    assert found.best.law.name == "liu-zhao-brogliato"
    assert found.best.best == pytest.approx(PLANTED, abs=1e-4)
    assert found.fitted[1].evidence.aic > found.best.evidence.aic + 100
