"""Taking many steps a call loses nothing: the same bits as reading every step."""

import numpy as np
import pytest

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.engines import stepping
from impact_xval.compliant_baselines.engines.scene import Scene
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.model.collision import Collision
from tests.model.test_columns import random_columns

pytest.importorskip("pybullet")

SCENES = [
    ("impact", 1e8, 1e-3),
    ("impact", 1e8, 1e-2),
    ("drop", 1e8, 1e-3),
    ("drop", 1e5, 2e-3),  # gravity matters: B2 comes to rest, balls stick
    ("drop", 1e3, 5e-3),
]


def scenes(scenario, k1, step_fraction, n, seed):
    rng, settings = np.random.default_rng(seed), Settings(scenario=scenario, step_fraction=step_fraction)
    masses, ratios = 10 ** rng.uniform(-0.5, 0.5, n), 10 ** rng.uniform(-2, 2, n)
    cells = zip(masses, k1 * ratios, *rng.choice([0.2, 0.5, 0.8, 1.0], (2, n)), strict=True)
    return [Scene.of(Collision.two_balls(1.0, m2, k1, k2, e1, e2), settings) for m2, k2, e1, e2 in cells]


def everything(run):
    ends = (run.end, *run.velocities.tolist(), run.n_steps, run.starts)
    return repr((*ends, run.raw.start.tolist(), run.raw.state.tolist()))


def test_many_steps_a_call_are_single_steps_to_the_bit(monkeypatch):
    engine = get_solver("pybullet")
    columns = random_columns(12, 6, table=True)
    lines = [Scene.of(column, Settings(step_fraction=2e-3)) for column in columns]
    for some in (*(scenes(*scene, n=12, seed=11) for scene in SCENES), lines):
        found = []
        for record_path, shortest in ((False, 10**9), (False, 8), (True, 8)):
            monkeypatch.setattr(stepping, "SHORTEST_LEAP", shortest)
            found.append([everything(run) for run in engine.run(some, 30_000, record_path)])
        assert found[0] == found[1] == found[2]
