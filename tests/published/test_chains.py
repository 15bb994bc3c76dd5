"""Chains that others have computed or measured, compared to the precision of their numbers.

docs/chains.md, section 5, names the sources.
"""

import itertools
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from impact_xval.compliant_baselines import Settings, get_solver
from impact_xval.model import Collision, solve
from tests.compliant_baselines.reference_cells import make_chain
from tests.model.chain_reference import JME, LZB
from tests.model.chains import solved

SICONOS = json.loads(Path(__file__).with_name("siconos_chains.json").read_text(encoding="utf-8"))


def by_siconos(name):
    """Yield the chains of a data set computed by Siconos, each with its row; the law is Liu, Zhao and Brogliato's."""
    fields = ("masses", "stiffnesses", "restitutions", "velocities", "table")
    for row in SICONOS[name]:
        yield Collision(*(row[field] for field in fields), exponent=row["exponent"]), row


@pytest.mark.parametrize("name", ["standing", "chains"])
def test_chains_have_the_velocities_of_siconos(name):
    for collision, row in by_siconos(name):
        assert solve(collision, law=LZB).velocities == pytest.approx(
            row["result"], abs=row["bears"], rel=0
        ), row


def test_where_no_compression_is_repeated_the_two_laws_are_one():
    for collision, row in by_siconos("standing"):
        if "repeats" in row:
            here, there = (solve(collision, law=law).velocities for law in (JME, LZB))
            assert (here == there) == (not row["repeats"]), row
            assert not row["repeats"] or np.abs(np.subtract(here, row["result"])).max() > row["bears"]


@pytest.mark.parametrize(
    ("balls", "struck", "velocities", "bears"),
    [
        # An integration in time (DOP853), accurate to 1e-8.
        (3, 1, (0.07095235, -0.07640304, -0.99454931), 1e-8),
        (5, 1, (0.07108502, 0.03027376, 0.01446363, -0.12704499, -0.98877742), 1e-8),
        # Alciatore, three billiard balls, technical proof B.29, divided by the striker's speed, to the printed digits.
        (3, 1, (0.071, -0.076, -0.995), 6e-4),
        # Two balls that strike three: velocities of the two balls at the far end, to the printed digits.
        (5, 2, (np.nan, np.nan, np.nan, -0.80, -1.14), 1e-2),
        # MonodisperseChainOfBalls.ref of siconos-tutorials, commit b6c9bfd, accurate to 5e-4.
        (10, 1, (0.0710593, *(8 * [np.nan]), -0.9859561), 5e-4),
    ],
)
def test_elastic_hertz_chains(balls, struck, velocities, bears):
    outcome = solved(make_chain(*struck * [-1], *(balls - struck) * [0]), exponent=1.5)
    assert np.nanmax(np.abs(np.subtract(outcome.velocities, velocities))) < bears


#: Duration of the collision of elastic cradles of 2 to 8 balls, of which one strikes, divided by the duration for two
#: balls; by exponent p of the contact force.
OVERALL = {
    1.5: (1, 1.530, 2.036, 2.533, 3.025, 3.516, 4.005),
    1.0: (1, 1.543, 2.057, 2.558, 3.051, 3.539, 4.023),
}


def overall_time(balls, exponent, solver="bistiffness"):
    """Return the time in s from the first touch to the last of an elastic cradle with m = k = 1, struck at 1 m/s."""
    collision = replace(make_chain(-1, *(balls - 1) * [0]), exponent=exponent)
    (outcome,) = get_solver(solver).solve_many([collision], Settings(scenario="impact"))
    assert outcome.status == "ok"
    return outcome.diagnostics["duration"]


@pytest.mark.parametrize(
    "law", ["bistiffness", "kelvin-voigt", "compression-dashpot", "linear-dashpot", "hunt-crossley"]
)
@pytest.mark.parametrize("exponent", OVERALL)
def test_each_further_ball_of_a_cradle_adds_half_the_time_of_the_first_collision(exponent, law):
    """Each ball beyond the second adds half the duration for two balls, to 0.05.

    This was measured by Lovett, Moulding and Anketell-Jones, Eur. J. Phys. 9, 323 (1988), abstract. The durations are
    also compared with the table above, to its three decimals.
    """
    times = [overall_time(balls, exponent, law) for balls in range(2, 9)]
    # the table has three decimals
    assert np.divide(times, times[0]) == pytest.approx(OVERALL[exponent], abs=5.1e-4, rel=0)
    added = [(later - time) / times[0] for time, later in itertools.pairwise(times)]
    # separate collisions, one after the other, would add 1 each
    assert added == pytest.approx([0.5] * 6, abs=0.05, rel=0)


@pytest.mark.parametrize(("engine", "within"), [("mujoco", 0.005), ("pybullet", 0.013)])
def test_engines_of_springs_have_the_durations_of_elastic_cradles(engine, within):
    if (reason := get_solver(engine).unavailable()) is not None:
        pytest.skip(reason)
    times = [overall_time(balls, 1.0, engine) for balls in range(2, 9)]
    assert np.divide(times, times[0]) == pytest.approx(OVERALL[1.0], abs=within + 5e-4, rel=0)


@pytest.mark.parametrize("exponent", OVERALL)
def test_the_time_of_two_balls_is_that_of_hertz(exponent):
    """The contact time of two balls is the closed form for a force k d^p (Hertz 1881 for p = 1.5), to 1e-9.

    The closed form is 2 d/u times the integral of (1 - x^(p+1))^(-1/2), with the largest depth d and the speed u.
    """
    reduced, q = 0.5, 1 / (exponent + 1)
    deepest = (reduced / (2 * q)) ** q
    expected = 2 * deepest * math.sqrt(math.pi) * math.gamma(1 + q) / math.gamma(0.5 + q)
    assert overall_time(2, exponent) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("balls", [3, 8])
@pytest.mark.parametrize("exponent", OVERALL)
def test_an_integration_in_time_has_the_duration_of_an_elastic_cradle(balls, exponent):
    def rates(_, y):
        # force of contact i, between balls i and i + 1
        forces = np.maximum(-np.diff(y[:balls]), 0) ** exponent
        return np.concatenate([y[balls:], -np.diff(forces, prepend=0, append=0)])

    def opening(contact):
        def depth(_, y):
            return y[contact] - y[contact + 1]

        depth.__dict__["direction"] = -1  # the attribute that `solve_ivp` reads
        return depth

    events = [opening(contact) for contact in range(balls - 1)]
    start = np.zeros(2 * balls)
    start[balls] = 1  # ball 1 moves towards the others
    went = solve_ivp(rates, (0, 20), start, "DOP853", events=events, rtol=1e-11, atol=1e-13)
    last = max(times[-1] for times in went.t_events)
    assert overall_time(balls, exponent) == pytest.approx(last, rel=1e-7)
