"""Rigid engines: the restitution of one contact, and chains compared with the exact law of each engine."""

import numpy as np
import pytest

from impact_xval.compliant_baselines import SolverError
from impact_xval.compliant_baselines.conformance import problems
from impact_xval.compliant_baselines.rigid.dart import FASTEST, SLOWEST
from impact_xval.compliant_baselines.rigid.laws import follow_impacts
from impact_xval.compliant_baselines.solver import Convergence, Settings
from impact_xval.model.collision import Collision
from tests.compliant_baselines.conftest import installed
from tests.compliant_baselines.reference_cells import make_chain

NEWTON, PLASTIC = "newton-restitution", "plastic-then-restitution"

#: For each engine: the law it follows, the largest D of its chains of up to five balls from this law, and the largest
#: error of e for one contact.
ENGINES = {
    "pymunk": (NEWTON, 1e-11, 1e-15),
    "dart": (NEWTON, 2e-3, 2.1e-5),
    "pybullet-restitution": (NEWTON, 1e-11, 1e-15),
    "sapien": (NEWTON, 1e-5, 2e-5),
    "rapier": (PLASTIC, 1e-6, 3e-7),
}

pytestmark = pytest.mark.parametrize("name", ENGINES)


@pytest.fixture(autouse=True)
def engine(name):
    return installed(name)


@pytest.mark.smoke
@pytest.mark.parametrize("fraction", [1e-2, 1e-3])
@pytest.mark.parametrize("e", [0.0, 0.5, 0.9, 1.0])
def test_one_contact_returns_its_restitution(name, engine, e, fraction):
    for v in (1e-3, 0.3, 1.0, 50.0, 1000.0):
        for masses in ((1.0, 1.0), (1.0, 100.0), (100.0, 1.0), (1.0,)):
            table = len(masses) == 1
            c = make_chain(*(-v, 0.0)[: len(masses)], e=e, masses=masses, table=table)
            if name == "dart" and e and not SLOWEST < e * v <= FASTEST:
                with pytest.raises(SolverError, match=r"unrepresentable: contact 1 would rebound at .* DART"):
                    engine.solve(c, Settings(step_fraction=fraction))
                continue
            o = engine.solve(c, Settings(step_fraction=fraction))
            returned = (o.velocities[0] - (0 if table else o.velocities[1])) / v
            assert returned == pytest.approx(e, abs=ENGINES[name][2]), (v, masses)
            assert o.effective["restitution"] == pytest.approx((e,), abs=1e-15)


def test_thresholds_are_where_the_adapter_says(name, engine, monkeypatch):
    if name != "dart":
        # an engine without a threshold
        assert engine.solve(make_chain(-1.0, 0.0)).effective.get("threshold", (0.0,)) == (0.0,)
        return
    monkeypatch.setattr(type(engine), "refusal", lambda self, scene: None)
    for rebound, got in ((0.999 * SLOWEST, 0.0), (1.001 * SLOWEST, 1.001 * SLOWEST), (2 * FASTEST, FASTEST)):
        outcome = engine.solve(make_chain(-2 * rebound, e=0.5, table=True))
        assert outcome.velocities == pytest.approx((got,), rel=1e-4)
        assert f"threshold is {SLOWEST:.6g}, 0 was asked for" in outcome.differences


def test_chains_are_those_of_the_law(name, engine):
    law, near, _ = ENGINES[name]
    rng = np.random.default_rng(3)
    for _ in range(60):
        balls, table = int(rng.integers(2, 6)), bool(rng.integers(2))
        contacts = balls - 1 + table
        rates = np.where(rng.random(contacts) < 0.5, 0.0, rng.uniform(1, 20, contacts))
        rates[0] = 10.0  # the other contacts are at rest or approach, too
        v = tuple((-np.cumsum([*([] if table else [0.0]), *rates])[::-1]).tolist())
        m, e = np.exp(rng.uniform(-1.2, 1.2, balls)), rng.uniform(0.3, 1.0, contacts)
        c = Collision(tuple(m.tolist()), (1.0,) * contacts, tuple(e.tolist()), v, table)
        (o,) = engine.solve_many([c], Settings())
        # unconverged, because Newton's law can gain energy
        assert o.status in ("ok", "unconverged"), o.reason
        off = o.velocities - follow_impacts(c, law).v
        assert m @ off**2 <= near**2 * (m @ np.square(v)), c


def test_targets_that_are_apart_are_struck_one_after_the_other(name, engine):
    # The gaps are 1e-3 of the balls' radius of 4 m. If the balls touched, the striker would reverse (Donahue's two
    # signs).
    v = engine.solve(make_chain(-1.0, 0.0, 0.0, gap=4e-3), Settings(step_fraction=1e-3)).velocities
    assert v == pytest.approx([0, 0, -1], abs=3e-5)


@pytest.mark.parametrize("e", [1.0, 0.7])
def test_impacts_across_gaps_are_whole_at_any_step(name, engine, e):
    """A ball strikes a ball in front of a wall: an impulse acts in a single step, wherever in the step bodies meet."""
    wall = make_chain(-20.0, 0.0, e=e, gap=30.0, table=True)  # fast enough that DART keeps the restitution
    exact = follow_impacts(wall, "sequential-top").v
    assert e < 1 or exact.tolist() == [20, 0]
    outcome = engine.solve(wall, Settings(convergence=Convergence()))
    numbers = outcome.diagnostics
    assert numbers["limit_error"] < 2e-2
    assert [numbers["v1_limit"], numbers["v2_limit"]] == pytest.approx(exact, abs=3 * numbers["limit_error"])
    assert numbers["finest_step"] == numbers["step"]  # no shorter step is needed


def test_restitution_that_is_dropped_in_a_later_impact_is_an_error_of_the_limit(name, engine):
    # The light ball rebounds at 0.5 m/s from the heavy one. The heavy one would rebound at 0.07 m/s from the table,
    # which DART takes for too slow.
    wall = make_chain(-1.0, 0.0, e=0.5, masses=(1.0, 10.0), gap=0.3, table=True)
    outcome = engine.solve_many([wall], Settings(convergence=Convergence()))[0]
    limit = [outcome.diagnostics[f"v{i}_limit"] for i in (1, 2)]
    off = np.abs(limit - follow_impacts(wall, "sequential-top").v).max()
    assert off < 3 * outcome.diagnostics["limit_error"]
    if name == "dart":
        assert off > 0.01
        assert outcome.status == "unconverged"
        assert "the engine gives slow impacts no restitution" in outcome.reason


def test_impacts_that_fall_into_one_step_are_not_taken_for_known(name, engine):
    # The middle ball is struck from both sides within a thousandth of a step. Two impacts one after the other have
    # another outcome than two at once.
    c = Collision((1, 2, 1), (1, 1), (0.5, 0.5), (-1, 0, 1), gaps=(3.0, 3.0 + 1e-6))
    (outcome,) = engine.solve_many([c], Settings(convergence=Convergence(halvings=1)))
    limit = [outcome.diagnostics[f"v{i}_limit"] for i in (1, 2, 3)]
    off = np.abs(limit - follow_impacts(c, "sequential-top").v).max()
    assert off > 0.01
    assert outcome.status == "unconverged"
    assert off < 3 * outcome.diagnostics["limit_error"]


@pytest.mark.smoke
def test_the_solver_keeps_the_contract(name, engine, capfd):
    assert problems(engine, "none") == {}
    with pytest.raises(SolverError, match=r"unrepresentable: gravity = 9\.81 m/s\^2: .*legal: 0"):
        engine.solve(Collision.two_balls(1, 1, 1, 1, 0.5, 0.5), Settings(scenario="drop", gravity=9.81))
    assert capfd.readouterr() == ("", "")


def test_numbers_beyond_single_precision_are_refused_or_told(name, engine):
    with pytest.raises(SolverError, match="unrepresentable: masses, velocities or a step beyond 1e"):
        engine.solve(make_chain(-1.0, 0.0, masses=(1e-40, 1.0)))
    if name == "rapier":  # Rapier sets bodies of a size of some km to rest without a warning
        with pytest.raises(SolverError, match=r"crashed: .*quarantine"):
            engine.solve(make_chain(-1e6, 0.0, table=True))
