"""Rigid engines: one contact returns the e it was given; of contacts that are struck at once each follows one law."""

import numpy as np
import pytest

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.conformance import conform
from impact_xval.compliant_baselines.engines.packages import why_not
from impact_xval.compliant_baselines.rigid.laws import LAWS, follow
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.model.collision import Collision

#: The law of each engine; by how much, per |v0|, one contact and several at once may miss it.
ENGINES = {
    "pymunk": ("newton-restitution", 1e-12, 1e-12),
    "dart": ("newton-restitution", 3e-5, 3e-3),
    "pybullet-restitution": ("newton-restitution", 1e-12, 1e-12),
    "sapien": ("newton-restitution", 1e-5, 1e-5),
    "rapier": ("plastic-then-restitution", 1e-6, 1e-5),
}


def solved(name, *collisions, **settings):
    """Solve collisions by an engine, if it is installed."""
    solver = get_solver(name)
    if (reason := solver.unavailable()) is not None:
        pytest.skip(reason)
    return solver.solve_many(list(collisions), Settings(**settings))


def line(masses, velocities, e, table=False, gap=0.0, k=1.0):
    contacts = len(masses) - 1 + table
    e = e if isinstance(e, tuple) else (e,) * contacts
    return Collision(tuple(map(float, masses)), (k,) * contacts, e, velocities, table, (gap,) * contacts)


@pytest.mark.parametrize("fraction", [1e-2, 1e-3, 1e-4])
@pytest.mark.parametrize("name", ENGINES)
def test_one_contact_returns_the_restitution_it_was_given(name, fraction):
    """Textbook: the velocity of separation is e times that of approach, whatever the masses and the step."""
    tolerance = ENGINES[name][1]
    for e in (0.0, 0.3, 0.7, 1.0):
        pair, one = line((1, 3), (-1.0, 0.5), e), line((2,), (-5.0,), e, table=True)
        two, ball = solved(name, pair, one, step_fraction=fraction)
        assert (two.status, ball.status) == ("ok", "ok"), (two.reason, ball.reason)
        assert two.velocities[0] - two.velocities[1] == pytest.approx(e * 1.5, abs=1.5 * tolerance)
        assert two.velocities[0] + 3 * two.velocities[1] == pytest.approx(0.5, abs=10 * tolerance)
        assert ball.velocities[0] == pytest.approx(5 * e, abs=5 * tolerance)
        assert two.effective["restitution"] == pytest.approx((e,), abs=1e-7)
        assert two.differences == ("threshold is 0.1, 0 was asked for" if name == "dart" else "")


#: Struck at once: the paper's problem at four masses, cradles, a chain, a stack whose balls all move.
STRUCK = [
    *(
        line((1, m), (-1.0, 0.0), e, table=True)
        for m in (0.3, 2)
        for e in ((1.0, 1.0), (0.9, 0.7), (0.5, 0.9))
    ),
    line((1,) * 5, (-1.0, 0.0, 0.0, 0.0, 0.0), 1.0),
    line((1,) * 5, (-1.0, -1.0, 0.0, 0.0, 0.0), 0.9),
    line((1, 0.5, 2), (-1.0, 0.0, 0.0), 0.8),
    line((1, 1, 1), (-1.0, -1.0, -1.0), 0.8, table=True),
]


@pytest.mark.parametrize("name", ENGINES)
def test_contacts_that_are_struck_at_once_follow_the_law_of_the_engine_and_no_other(name):
    law, _, tolerance = ENGINES[name]
    outcomes = solved(name, *STRUCK)
    missed = {each: 0.0 for each in LAWS if each != "generalised-reflection"}
    for collision, outcome in zip(STRUCK, outcomes, strict=True):
        assert outcome.status == "ok", outcome.reason
        for each in missed:
            away = np.abs(np.array(outcome.velocities) - follow(collision, each).v).max()
            missed[each] = max(missed[each], float(away))
    assert missed[law] < tolerance
    assert min(away for each, away in missed.items() if each != law) > 0.1


@pytest.mark.parametrize("name", ENGINES)
def test_targets_that_touch_throw_the_striker_back_and_targets_apart_do_not(name):
    """Three equal balls: Donahue et al. (2008), abstract."""
    touching, apart = (line((1,) * 3, (-1.0, 0.0, 0.0), 1.0, gap=gap, k=1e8) for gap in (0.0, 1e-3))
    at_once, one_by_one = solved(name, touching, apart)
    assert at_once.velocities[0] > 0.1
    assert one_by_one.velocities == pytest.approx((0.0, 0.0, -1.0), abs=1e-4)


@pytest.mark.parametrize("name", ENGINES)
def test_it_refuses_by_name_what_it_cannot_take(name):
    drop = line((1, 2), (-1.0, 0.0), 0.9, table=True)
    (refused,) = solved(name, drop, scenario="drop")
    assert refused.status == "unrepresentable"
    assert "gravity" in refused.reason
    if name == "dart":
        (slow,) = solved(name, line((1, 2), (-0.1, 0.0), 0.9))
        assert slow.status == "unrepresentable"
        assert "contact 1 would rebound at 0.09 m/s" in slow.reason


@pytest.mark.parametrize("name", ENGINES)
def test_contract(name):
    solved(name)
    found = {check.__name__: problem for check, problem in conform(get_solver(name), None) if problem}
    assert found == {}


def test_an_engine_that_is_missing_says_what_installs_it():
    said = why_not("Pymunk", "pymunk", "no_such_module_here", get_solver("pymunk").way_out)
    assert said == "Pymunk is not installed: run pip install 'impact-xval[pymunk]'"
