"""Drake's adapters for pairs and chains.

In discrete time Drake is compared with PyBullet and Kelvin-Voigt contacts, in continuous time with elastic and
Hunt-Crossley contacts.
"""

import importlib.util
import math
from dataclasses import replace

import numpy as np
import pytest

from impact_xval.compliant_baselines import Settings, SolverError, get_solver
from impact_xval.compliant_baselines.engines.scene import Scene
from impact_xval.model import Collision
from tests.compliant_baselines.conftest import installed
from tests.compliant_baselines.engines.test_convergence import DROP, FOUR
from tests.compliant_baselines.reference_cells import two_balls

pytestmark = pytest.mark.skipif(importlib.util.find_spec("pydrake") is None, reason="Drake is not installed")
MU = 2 / 3**0.5
ELASTIC = [(ratio, MU, 1.0, 1.0) for ratio in (1.0, 40.0, 1 / 40)]
CELLS = [(ratio, MU, 0.9, 0.7) for ratio in (1.0, 40.0, 1 / 40)]


def gap(a, b, v0=-1.0):
    return math.hypot(a.v1 - b.v1, a.v2 - b.v2) / abs(v0)


@pytest.mark.parametrize("scenario", ["impact", "drop"])
def test_discrete_drake_and_pybullet_solve_the_same_equations(scenario):
    bullet = installed("pybullet")
    settings = Settings(scenario=scenario, step_fraction=5e-3)
    apart = []
    for cell in CELLS + ELASTIC:
        c = two_balls(*cell, k1=1e6)
        ours, theirs = get_solver("drake").solve(c, settings), bullet.solve(c, settings)
        apart.append(gap(ours, theirs))
    # Drake's solver has a relative tolerance of 1e-6. In some collisions it converges no further, and the velocities
    # agree to about this tolerance. In the others they agree to about eight digits.
    assert np.median(apart) < 2e-8
    assert max(apart) < 5e-6


def test_continuous_drake_reproduces_the_exact_reference_of_its_law():
    settings = Settings(step_fraction=0.01)
    dashpots, exact, drake = (get_solver(n) for n in ("kelvin-voigt", "hunt-crossley", "drake-hunt-crossley"))
    for cell in ELASTIC + CELLS:
        c, law = two_balls(*cell, k1=1e6), dashpots if cell in ELASTIC else exact
        assert gap(drake.solve(c, settings), law.solve(c)) < 2e-9, cell
    for k1, v0 in ((1.0, -1.0), (1e-4, -10.0), (1e10, -1e-3)):
        c = two_balls(*CELLS[0], k1=k1, v0=v0)
        assert gap(drake.solve(c, settings), exact.solve(c), v0) < 5e-9, c


def test_a_drop_differs_by_what_gravity_does_between_two_samples():
    c = two_balls(*ELASTIC[0], k1=1e6)
    errors = []
    for fraction in (4e-3, 2e-3, 1e-3):
        settings = Settings(scenario="drop", step_fraction=fraction)
        drake, exact = (get_solver(n).solve(c, settings) for n in ("drake-hunt-crossley", "kelvin-voigt"))
        errors.append(gap(drake, exact))
        # A collision ends after the first interval without force. Both balls are then up to two intervals late.
        assert errors[-1] <= 2**0.5 * 2 * 9.81 * drake.diagnostics["step"]
    assert errors[-1] < errors[0]


def test_the_naive_mapping_is_that_of_two_balls_in_discrete_time():
    naive = Settings(mapping="naive")
    with pytest.raises(SolverError, match=r"unrepresentable: mapping = 'naive': .* legal: 'calibrated'"):
        get_solver("drake-hunt-crossley").solve(two_balls(*ELASTIC[0], k1=1e6), naive)
    for name in ("drake", "drake-hunt-crossley"):
        with pytest.raises(SolverError, match=r"mapping = 'naive': Drake has it only for two balls"):
            get_solver(name).solve(FOUR, naive)


@pytest.mark.parametrize("chain", [FOUR, replace(DROP, velocities=(-1, 0, -3, 0))], ids=["chain", "drop"])
def test_four_balls_in_continuous_time_are_those_of_hunt_crossley(chain):
    """Four balls in continuous time move as by the exact Hunt-Crossley law, to 2e-9 of the largest speed.

    The damping coefficient depends on the largest rate of compression at first touch, here 1 m/s and 3 m/s.
    """
    exact = get_solver("hunt-crossley").solve(chain)
    outcome = get_solver("drake-hunt-crossley").solve(chain, Settings(step_fraction=5e-3))
    assert outcome.velocities == pytest.approx(exact.velocities, abs=2e-9 * max(np.abs(chain.velocities)))


def test_a_step_too_short_is_refused_and_not_run():
    settings = Settings(step_fraction=1e-6)
    with pytest.raises(SolverError, match=r"impulses below 1e-06 of the momentum, .* is needed"):
        get_solver("drake").solve(FOUR, settings)
    scene = Scene.of(FOUR, settings)
    (run,) = get_solver("drake").run([scene], 100)
    assert (run.status, run.n_steps) == ("crashed", 0)
    assert "impulses below 1e-06 of the momentum" in run.problem()
    assert get_solver("drake-hunt-crossley").refusal(scene) is None
    # impulses are neglected relative to the momentum of all bodies, not of the bodies that meet
    drifting = Scene.of(Collision((1, 1), (1e4,), (1,), (-1001, -1000)), Settings())
    assert "impulses below 1e-06" in get_solver("drake").refusal(drifting)
    assert get_solver("drake").refusal(replace(drifting, velocities=(-1.0, 0.0))) is None


@pytest.mark.parametrize("name", ["drake:lagged", "drake:similar"])
def test_the_contacts_that_drake_ships_approach_hunt_and_crossleys_as_the_step_shrinks(name):
    """The error of Drake's own contacts halves with the step, because backward Euler is of first order."""
    exact = get_solver("hunt-crossley")
    for cell in CELLS:
        c = two_balls(*cell, k1=1e6)
        errors = [
            gap(get_solver(name).solve(c, Settings(step_fraction=fraction)), exact.solve(c))
            for fraction in (2e-3, 1e-3, 5e-4)
        ]
        assert errors[0] / errors[1] == pytest.approx(2, abs=0.1)
        assert errors[1] / errors[2] == pytest.approx(2, abs=0.1)
