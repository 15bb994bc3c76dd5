"""Taking many steps a call loses nothing: the same bits as reading every step."""

import numpy as np
import pytest

from impact_xval.compliant_baselines.engines.column import column_of
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.model.collision import Collision

pw = pytest.importorskip("impact_xval.compliant_baselines.engines.pybullet_engine")
pytest.importorskip("pybullet")

SCENES = [
    ("impact", 1e8, 1e-3),
    ("impact", 1e8, 1e-2),
    ("drop", 1e8, 1e-3),
    ("drop", 1e5, 2e-3),  # gravity matters: B2 comes to rest, balls stick
    ("drop", 1e3, 5e-3),
]


def columns(scenario, k1, step_fraction, n, seed):
    rng, settings = np.random.default_rng(seed), Settings(scenario=scenario, step_fraction=step_fraction)
    masses, ratios = 10 ** rng.uniform(-0.5, 0.5, n), 10 ** rng.uniform(-2, 2, n)
    cells = zip(masses, k1 * ratios, *rng.choice([0.2, 0.5, 0.8, 1.0], (2, n)), strict=True)
    return [column_of(Collision.two_balls(1.0, m2, k1, k2, e1, e2), settings) for m2, k2, e1, e2 in cells]


def runs(some, record_path, monkeypatch, least):
    monkeypatch.setattr(pw, "LEAST_STRIDE", least)
    with pw.connected() as client:
        world = pw.World(client)
        return [pw.run(world, column, 30_000, record_path) for column in some]


def everything(run):
    ends = (run.end, run.v1, run.v2, run.raw.n_steps, run.starts)
    return (*ends, run.raw.start.tolist(), run.raw.state.tolist())


def test_many_steps_a_call_are_single_steps_to_the_bit(monkeypatch):
    for scene in SCENES:
        some = columns(*scene, n=12, seed=11)
        singly, together, traced = (
            [repr(everything(run)) for run in runs(some, record, monkeypatch, least)]
            for record, least in ((False, 10**9), (False, 8), (True, 8))
        )
        assert together == singly, scene
        assert traced == singly, scene
