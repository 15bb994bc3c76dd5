"""Dashpots that act in compression only.

The exact law is compared with an integration without events, and the engine Newton with the exact law."""

import math
import subprocess
import sys

import numpy as np
import pytest
from scipy.optimize import brentq

from impact_xval.compliant_baselines import Settings, SolverError, get_solver
from impact_xval.compliant_baselines.conformance import checks, problems
from impact_xval.compliant_baselines.engines.engine import version_of
from impact_xval.model import Collision
from tests.compliant_baselines.reference_cells import in_time, make_chain
from tests.compliant_baselines.references.test_chains import by_force_alone, with_gaps
from tests.model.test_chains import random_chain

LAW = "compression-dashpot"

#: Solvers of the engine Newton that have this law.
COMPLIANT = ("newton", "newton:featherstone")

installed = pytest.mark.skipif(not version_of("newton"), reason="newton is not installed")


def dashpots(chain, exponent):
    """Return c of each contact, found from the depth at which a damped oscillation with this restitution turns around.

    An oscillation with the damping ratio z turns at exp(-z t) of the depth without damping, where sin(w t) = w.
    """
    inverse = 1 / np.array([*chain.masses, *([np.inf] if chain.table else [])])
    ratios = [
        brentq(lambda z, e=e: np.exp(-z * np.arccos(z) / np.sqrt(1 - z * z)) - e, 0, 0.999)
        for e in chain.restitutions
    ]
    k = np.array(chain.stiffnesses)
    return 2 * np.array(ratios) * np.sqrt(0.5 * (exponent + 1) * k / (inverse[1:] + inverse[:-1]))


@pytest.mark.parametrize("exponent", [1.0, 1.5])
def test_the_exact_law_ends_as_its_forces_alone_do(exponent):
    rng = np.random.default_rng(8)
    for balls in (2, 3, 5):
        chain = with_gaps(rng, random_chain(rng, balls, least=0.4))
        ours = in_time(chain, LAW, exponent=exponent)
        duration = 1.01 * ours.diagnostics["duration"] + 0.1
        theirs = by_force_alone(chain, LAW, exponent, dashpots(chain, exponent), duration)
        assert ours.velocities == pytest.approx(theirs, abs=1e-7), chain
        assert np.abs(np.subtract(theirs, in_time(chain, exponent=exponent).velocities)).max() > 1e-3


@installed
@pytest.mark.parametrize(
    ("scenario", "collision", "velocities", "tolerance"),
    [
        ("impact", Collision.two_balls(1, 2, 1e6, 1e6, 1, 1), (0.72412, 0.48767), 2e-5),
        ("impact", Collision.two_balls(1, 2, 1e6, 1e4, 1, 1), (0.77732, 0.44485), 2e-5),
        ("impact", Collision.two_balls(1, 2, 1e6, 1e8, 1, 1), (0.99998, 0.00448), 2e-5),
        ("impact", make_chain(-1, 0, 0), (0.13026, -0.15023, -0.98003), 2e-5),
        ("impact", make_chain(-1, 0, 0, gap=1e-3, e=0.6), (0.01543, -0.30804, -0.70739), 5e-4),
        ("impact", Collision.two_balls(1, 2, 1e6, 1e6, 0.7, 0.7), (0.42411, 0.36326), 5e-4),
        ("drop", Collision.two_balls(1, 2, 1e6, 1e6, 0.7, 0.7), (0.43427, 0.34709), 5e-4),
    ],
)
@pytest.mark.parametrize("name", COMPLIANT)
def test_newton_ends_as_the_exact_law(name, scenario, collision, velocities, tolerance):
    settings = Settings(scenario=scenario)
    exact, outcome = (get_solver(solver).solve(collision, settings) for solver in (LAW, name))
    assert exact.velocities == pytest.approx(velocities, abs=1e-5)
    assert outcome.velocities == pytest.approx(velocities, abs=tolerance)
    assert (outcome.states, outcome.differences) == (exact.states, "")


@installed
@pytest.mark.parametrize("name", COMPLIANT)
def test_newton_conforms_without_a_word_of_warp_and_refuses_what_it_has_no_digits_for(name):
    command = [sys.executable, "-m", "impact_xval", "solvers", name]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    # On a busy machine another library may print that something takes long. This message is not from Warp.
    assert [line for line in done.stderr.splitlines() if "has taken" not in line] == []
    assert [line.split()[0] for line in done.stdout.splitlines()] == ["passed"] * len(checks(LAW))
    (outcome,) = get_solver(name).solve_many([Collision.two_balls(1, 2, 1, 1e9, 1, 1)], Settings())
    assert (outcome.status, "single precision" in outcome.reason) == ("unrepresentable", True)


@installed
def test_newton_as_it_ships_damps_compression_by_its_own_numbers():
    """Newton's default contact has k = 2,500 N/m and c = 100 N s/m in compression only, whatever contact is requested.

    Its restitution is e = exp(-phi zeta/sqrt(1 - zeta^2)) with cos phi = zeta. The velocity is compared to 1 %.
    """
    for mass, zeta in ((4.0, 0.5), (16.0, 0.25)):
        phi = math.acos(zeta)
        e = math.exp(-phi * zeta / math.sqrt(1 - zeta**2))
        found = get_solver("newton:default").solve(Collision((mass,), (1e6,), (0.9,), (-1.0,), table=True))
        assert found.velocities[0] == pytest.approx(e, abs=0.01)  # with a step of 1/600 s
        assert found.effective["stiffness"] == (2500.0,)


@pytest.mark.parametrize("name", ["newton:featherstone", "newton:xpbd"])
def test_without_newton_its_solvers_say_how_to_get_it(name, monkeypatch):
    monkeypatch.setitem(sys.modules, "newton", None)
    (outcome,) = get_solver(name).solve_many([make_chain(-1.0, 0.0)], Settings())
    assert outcome.status == "unavailable"
    assert "pip install 'impact-xval[newton]'" in outcome.reason


@installed
def test_featherstone_takes_masses_and_contacts_of_each_scene():
    """Featherstone stores masses itself. Each scene must get its own masses and not those of the scene before."""
    solver = get_solver("newton:featherstone")
    for masses, e, speed in (((1.0, 3.0), 0.5, 1.0), ((5.0, 1.0), 0.8, 10.0), ((1.0, 3.0), 0.5, 0.1)):
        v1, v2 = solver.solve(make_chain(-speed, 0.0, e=e, masses=masses)).velocities
        assert v1 - v2 == pytest.approx(e * speed, abs=1e-3 * speed)
        assert masses[0] * v1 + masses[1] * v2 == pytest.approx(-masses[0] * speed, rel=1e-5)


@installed
def test_xpbd_returns_the_restitution_of_one_contact():
    solver = get_solver("newton:xpbd")
    for e in (0.0, 0.5, 1.0):
        for v in (1e-3, 1.0, 1000.0):
            for masses in ((1.0, 1.0), (1.0, 100.0), (100.0, 1.0), (1.0,)):
                table = len(masses) == 1
                o = solver.solve(make_chain(*(-v, 0.0)[: len(masses)], e=e, masses=masses, table=table))
                returned = (o.velocities[0] - (0 if table else o.velocities[1])) / v
                assert returned == pytest.approx(e, abs=1e-6), (v, masses)
                assert o.effective["restitution"] == pytest.approx((e,), abs=1e-15)


@installed
def test_xpbd_conforms_and_refuses_drops_and_other_mappings():
    solver = get_solver("newton:xpbd")
    assert problems(solver, "none") == {}
    pair = Collision.two_balls(1, 1, 1, 1, 0.5, 0.5)
    with pytest.raises(SolverError, match=r"gravity = 9\.81 m/s\^2: rigid engines are run without"):
        solver.solve(pair, Settings(scenario="drop", gravity=9.81))
    with pytest.raises(
        SolverError, match=r"mapping = 'naive': Newton has only one mapping; legal: 'calibrated'"
    ):
        solver.solve(pair, Settings(mapping="naive"))


@installed
def test_xpbd_loses_momentum_where_a_ball_touches_two():
    """XPBD loses momentum: a ball with two contacts gets only the mean of the two impulses.

    A ball with one contact gets the whole impulse.
    """
    v = get_solver("newton:xpbd").solve(make_chain(-1.0, 0.0, 0.0)).velocities
    assert v == pytest.approx((0.5, -0.5, -0.5), abs=1e-5)  # total momentum is -0.5 kg m/s instead of -1
