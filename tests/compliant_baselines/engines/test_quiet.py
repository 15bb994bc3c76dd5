"""Taking many steps a call loses nothing: the same bits as reading every step."""

import numpy as np
import pytest

from impact_xval.compliant_baselines.contact.column import column_of
from impact_xval.compliant_baselines.contract.solver import Settings
from impact_xval.compliant_baselines.engines.recording import states_of
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
    rng = np.random.default_rng(seed)
    settings = Settings(scenario=scenario, step_fraction=step_fraction)
    return [
        column_of(
            Collision(
                m1=1.0,
                m2=10 ** rng.uniform(-0.5, 0.5),
                k1=k1,
                k2=k1 * 10 ** rng.uniform(-2, 2),
                e1=rng.choice([0.2, 0.5, 0.8, 1.0]),
                e2=rng.choice([0.2, 0.5, 0.8, 1.0]),
            ),
            settings,
        )
        for _ in range(n)
    ]


def runs(some, record_path, monkeypatch, least):
    monkeypatch.setattr(pw, "LEAST_STRIDE", least)
    with pw.connected() as client:
        world = pw.World(client)
        return [pw.run(world, column, 30_000, record_path) for column in some]


def everything(run):
    ends = (run.end, run.v1, run.v2, run.raw.n_steps, run.unloaded, run.starts)
    return (*ends, run.raw.start.tolist(), run.raw.state.tolist())


@pytest.mark.parametrize("scene", SCENES, ids=str)
def test_many_steps_a_call_are_single_steps_to_the_bit(scene, monkeypatch):
    some = columns(*scene, n=12, seed=11)
    singly = runs(some, False, monkeypatch, least=10**9)
    together = runs(some, False, monkeypatch, least=8)
    traced = runs(some, True, monkeypatch, least=8)
    assert [repr(everything(run)) for run in together] == [repr(everything(run)) for run in singly]
    assert [repr(everything(run)) for run in traced] == [repr(everything(run)) for run in singly]


def test_most_steps_are_taken_together(monkeypatch):
    (column,) = columns("drop", 1e8, 2.5e-4, n=1, seed=3)
    taken = {"singly": 0, "together": 0}
    for name in taken:
        original = getattr(pw.World, name)

        def counted(self, n, *more, original=original, name=name):
            v, x = original(self, n, *more)
            taken[name] += len(v) if more else n
            return v, x

        monkeypatch.setattr(pw.World, name, counted)
    runs([column], False, monkeypatch, least=8)
    assert taken["together"] > 10 * taken["singly"]


def test_the_path_between_calls_is_that_of_single_steps(monkeypatch):
    # k2/k1 = 1/40: returns, and long enough for many calls.
    collision = Collision(m1=1.0, m2=2 / 3**0.5, k1=1e8, k2=2.5e6, e1=0.9, e2=0.7)
    column = column_of(collision, Settings(step_fraction=1e-3))
    (singly,), (traced,) = (runs([column], True, monkeypatch, least=least) for least in (10**9, 8))
    exact, between = (run.path(states_of(run, 2.5e-3)) for run in (singly, traced))
    for v in ("v1", "v2"):
        off = np.interp(exact.time, between.time, getattr(between, v)) - getattr(exact, v)
        # 6e-5 of the interpolation, and 2e-5 of the straight lines between points of this test.
        assert np.abs(off).max() < 8e-5


@pytest.mark.parametrize("h", [5.129e-7, 4.6e-7, 1e-3, 1 / 3, 0.1])
def test_numbers_of_sub_steps_divide_exactly(h):
    for n in range(1, 300):
        exact = pw.exact(n, h)
        assert 1 <= exact <= n
        assert exact * h / exact == h
        assert int(exact * h / h) == exact
        assert exact > n / 2  # a power of two is always among them
