"""A solver that crashes or hangs costs the collisions it does so at, with a status and a reason, and nothing else."""

import os
import time
from pathlib import Path

import numpy as np
import pytest

from impact_xval.compliant_baselines import get_solver
from impact_xval.experiments.hypothesis.config import parse
from impact_xval.experiments.hypothesis.run import run_hypothesis
from impact_xval.experiments.hypothesis.solvers import isolated, outcomes_of
from impact_xval.experiments.hypothesis.tables import mechanism_frame, outcome_frame, point_frame
from impact_xval.experiments.sweep.sandbox import Sandbox
from tests.experiments import faulty


def prepare(context):
    """Import this module, by being found in it: what a call imports counts as its time."""


def mortal(kappa, mu, e1, e2):
    """Give kappa and mu, and hang at one value of e1."""
    if faulty.HANG in e1:
        time.sleep(600)
    return outcomes_of(kappa, mu)


def dead_at_first(kappa, mu, e1, e2):
    """Die once, as of a full memory."""
    died = Path(os.environ["IMPACT_XVAL_DIED"])
    if not died.exists():
        died.touch()
        os.abort()
    return mortal(kappa, mu, e1, e2)


class Fragile(faulty.Faulty):
    """Dies of some values of e1, and of one trajectory."""

    def solve_many(self, collisions, settings):
        if settings.record_path and any(c.k2 > 5e4 * c.k1 for c in collisions):
            os.abort()
        return super().solve_many(collisions, settings)


def fragile(name):
    return Fragile() if name == "mujoco" else get_solver(name)


@pytest.fixture
def sandbox():
    made = Sandbox(None, prepare)
    yield made
    made.close()


def ratios(*e1):
    n = len(e1)
    return np.array([np.arange(1.0, n + 1), np.arange(11.0, n + 11), e1, np.full(n, 0.7)])


def test_the_collisions_at_fault_are_named_and_the_others_answered(sandbox):
    found = isolated(sandbox, mortal, ratios(0.5, faulty.HANG, 0.6), 3.0)
    assert found.status.tolist() == ["ok", "timeout", "ok"]
    assert found.reason.tolist() == ["", "no answer within 3 s; its process was ended", ""]
    assert found.v1[[0, 2]].tolist() == [1, 3]
    assert found.v2[[0, 2]].tolist() == [11, 13]
    assert np.isnan([found.v1[1], found.v2[1], found.error[1]]).all()


def test_one_death_may_have_been_anybodys(sandbox, tmp_path, monkeypatch):
    monkeypatch.setenv("IMPACT_XVAL_DIED", str(tmp_path / "died"))
    found = isolated(sandbox, dead_at_first, ratios(0.5, 0.6), 60.0)
    assert (tmp_path / "died").exists()
    assert found.status.tolist() == ["ok", "ok"]


@pytest.mark.slow
def test_a_run_survives_and_every_table_says_what_failed_and_why():
    """The range of contrasts is too short for two: one collision a point."""
    config = parse(
        {
            "points": 6,
            "solvers": ["mujoco"],
            "contrast": [10, 11],
            "plastic_contrast": [10, 11],
            "map": {"size": 4, "stiffness_ratio": [0.1, 10], "restitutions": [[0.9, 0.7]]},
            "point": [{"case": "zero-late", "mass_ratio": 2.0, "e1": faulty.SEGFAULT, "e2": 0.7}],
        },
        "test",
    )
    results = run_hypothesis(config, workers=1, resolve=fragile)
    outcomes = outcome_frame(results)
    assert len(outcomes) == 6 * 6 + 1
    lost = outcomes[~outcomes.status.isin(["ok", "limit"])]
    assert lost[["case", "e1", "status", "reason"]].to_numpy().tolist() == [
        ["zero-late", faulty.SEGFAULT, "crashed", "its process died: SIGSEGV"]
    ]
    assert lost.v1.isna().all()
    points = point_frame(results)
    said = points[points.without_result != ""]
    assert said[["case", "e1", "verdict", "without_result"]].to_numpy().tolist() == [
        ["zero-late", faulty.SEGFAULT, "undecided", "1 of 1 crashed: its process died: SIGSEGV"]
    ]
    motions = mechanism_frame(results)
    dead = motions[~motions.status.isin(["ok", "limit"])]
    assert dead[["case", "contrast", "status", "reason"]].to_numpy().tolist() == [
        ["infinity", 1e5, "crashed", "its process died: SIGABRT"]
    ]
    maps = results.maps
    assert maps.status.isin(["ok", "limit"]).all()
    assert maps.error.notna().all()
