"""The references for N balls.

Random chains are compared with an independent integration in time, single contacts with their restitution, and long
rows with an integration without events. The tests also check invariances, gaps, marks and refusals.
"""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from impact_xval.compliant_baselines import Settings, SolverError, get_solver
from impact_xval.compliant_baselines.references import LAWS
from impact_xval.model import Collision, solve
from tests.compliant_baselines.reference_cells import coefficients_of, in_time, make_chain
from tests.model.chain_reference import integrate
from tests.model.test_chains import random_chain

COLUMN_LAWS = [law for law in LAWS if law != "kelvin-voigt-anchored"]


def with_gaps(rng, chain):
    contacts = len(chain.stiffnesses)
    return replace(chain, gaps=tuple(10 ** rng.uniform(-4, 0, contacts) * rng.integers(2, size=contacts)))


@pytest.mark.parametrize(
    ("law", "exponent", "count", "most", "frozen"),
    [
        ("kelvin-voigt", 1, 8, 7, False),
        pytest.param("kelvin-voigt", 1, 6, 10, False, marks=pytest.mark.slow),
        ("kelvin-voigt", 1.5, 3, 4, False),
        pytest.param("kelvin-voigt", 1.5, 4, 10, False, marks=pytest.mark.slow),
        ("hunt-crossley", 1, 3, 4, False),
        ("hunt-crossley", 1.5, 3, 4, False),
        ("linear-dashpot", 1, 6, 5, False),
        ("linear-dashpot", 1.5, 2, 4, False),
        ("bistiffness", 1, 4, 4, False),
        ("bistiffness", 1.5, 2, 3, False),
        ("kelvin-voigt", 1, 4, 6, True),
        ("kelvin-voigt", 1.5, 4, 6, True),
        ("hunt-crossley", 1, 4, 6, True),
        ("linear-dashpot", 1, 4, 5, True),
    ],
)
def test_an_integration_in_time_agrees(law, exponent, count, most, frozen):
    rng = np.random.default_rng(2)
    compared = 0
    while compared < count:
        chain = random_chain(rng, int(rng.integers(2, most + 1)), least=0.6)
        chain = with_gaps(rng, chain) if not frozen and rng.integers(2) else chain
        ours = in_time(chain, law, exponent=exponent, frozen=frozen)
        if (ours.grazing_margin or 1) < 1e-3:
            continue  # collisions beside a jump are not compared
        compared += 1
        b = coefficients_of(chain, law, exponent)
        theirs = integrate(replace(chain, exponent=exponent), law, b, frozen=frozen)
        assert ours.velocities == pytest.approx(theirs.velocities, abs=1e-8, rel=0), chain
        assert ours.diagnostics.get("velocity_error", 0) < 1e-8


@pytest.mark.parametrize("law", COLUMN_LAWS)
def test_momentum_energy_order_reversal_and_a_moving_observer(law):
    rng = np.random.default_rng(4)
    for exponent in [1] * 4 + [1.5] * 4:
        chain = with_gaps(rng, random_chain(rng, 4))
        outcome = in_time(chain, law, exponent=exponent)
        masses, v = np.array(chain.masses), np.array(outcome.velocities)
        assert (np.diff(v) <= 1e-12).all()
        assert masses @ v**2 <= masses @ np.square(chain.velocities) * (1 + 1e-12)
        if chain.table:
            assert v[-1] >= -1e-12
            continue
        assert masses @ v == pytest.approx(masses @ chain.velocities, abs=1e-12)
        back = in_time(chain.reversed(), law, exponent=exponent)
        assert back.velocities == pytest.approx(-v[::-1], abs=1e-9)
        moving = in_time(replace(chain, velocities=np.array(chain.velocities) + 3), law, exponent=exponent)
        assert moving.velocities == pytest.approx(v + 3, abs=1e-9)


def test_a_pair_alone_has_its_restitution_at_any_speed():
    laws = "bistiffness", "kelvin-voigt", "hunt-crossley", "compression-dashpot", "linear-dashpot"
    for law, speed, exponent, e in product(laws, (0.01, 100), (1, 1.5, 2), (0.02, 0.3, 0.9, 0.999, 1)):
        pair = Collision((2, 3), (1e3,), (e,), (-speed, 0))
        v1, v2 = in_time(pair, law, exponent=exponent).velocities
        assert (v1 - v2) / speed == pytest.approx(e, abs=1e-10), (law, speed, exponent)


def test_gaps_make_another_collision():
    """Small gaps change the outcome, and large gaps turn the collision into single impacts.

    For steel balls a gap of a hundred-thousandth of the diameter is enough. Gaps of the depth of a contact or more make
    single impacts.
    """
    mass, stiffness, diameter = 0.0638, 1.2165e10, 0.025  # Hertz contacts of steel balls with this diameter
    velocities = []
    for gap in (0, 1e-5 * diameter, 1e-2 * diameter):
        chain = Collision((mass,) * 5, (stiffness,) * 4, (1,) * 4, (-1, 0, 0, 0, 0), gaps=(gap,) * 4)
        velocities.append(in_time(chain, exponent=1.5).velocities)
    touching, close, apart = np.array(velocities)
    assert np.abs(touching - close).max() > 3e-3
    assert apart == pytest.approx([0, 0, 0, 0, -1], abs=1e-9)
    outcomes = [
        in_time(make_chain(-1, *n * [0], gap=gap), "bistiffness")
        for n in range(2, 8)
        for gap in (0.1, 10.0, 1e3)
    ]
    # The slow motion that rounding leaves to elastic bodies must not be taken for a collapse.
    assert {o.status for o in outcomes} == {"ok"}


def by_force_alone(chain, law, exponent, b, duration):
    """Return final velocities by integrating forces that depend on positions and rates only, without events."""
    n, table = len(chain.masses), [0.0] if chain.table else []
    inverse, k = 1 / np.array(chain.masses), np.array(chain.stiffnesses)

    def motion(_time, state):
        depth = np.diff([*state[:n], *table]) - chain.gaps
        rate, over = np.diff([*state[n:], *table]), np.maximum(depth, 0)
        if law == "compression-dashpot":
            rate = np.maximum(rate, 0)
        dashpot = k * over**exponent if law == "hunt-crossley" else over ** ((exponent - 1) / 2)
        force = np.maximum(k * over**exponent + b * rate * dashpot, 0) * (depth > 0)
        return np.concatenate([state[n:], inverse * np.diff([0, *force, 0])[:n]])

    start = np.concatenate([np.zeros(n), chain.velocities])
    done = solve_ivp(motion, (0, duration), start, method="DOP853", rtol=1e-13, atol=1e-16, max_step=0.1)
    assert done.success
    return done.y[n:, -1]


def test_a_row_of_hertz_contacts_ends_as_in_time_without_events():
    # The last contacts wait for the wave. Far ahead of the wave their load is so small that it underflows.
    for law, balls, e in (
        ("kelvin-voigt", 18, 0.8),
        ("kelvin-voigt", 30, 0.99),
        ("kelvin-voigt", 30, 1),
        ("kelvin-voigt-textbook", 20, 0.95),
        ("hunt-crossley", 18, 0.95),
    ):
        chain = make_chain(-1, *(balls - 1) * [0], e=e)
        outcome = in_time(chain, law, exponent=1.5, max_steps=5000)
        assert outcome.status == "ok"
        assert outcome.diagnostics["velocity_error"] < 1e-9
        duration = outcome.diagnostics["duration"] + 1
        expected = by_force_alone(chain, law, 1.5, coefficients_of(chain, law, 1.5), duration)
        assert outcome.velocities == pytest.approx(expected, abs=1e-9, rel=0), (law, balls, e)


@pytest.mark.parametrize("law", COLUMN_LAWS)
def test_long_rows_end_at_every_exponent(law):
    # With a higher exponent a load grows faster from nothing. Cubics through the ends of a step are then far off.
    for exponent, (balls, e) in product((1.5, 2, 3), ((24, 0.95), (18, 0.05))):
        if law == "bistiffness":
            e = 1.0  # with e = 1 no contact becomes rigid
        outcome = in_time(
            make_chain(-1, -1, *(balls - 2) * [0], e=e), law, exponent=exponent, max_steps=20_000
        )
        assert outcome.status == "ok", (exponent, balls)
        v = np.array(outcome.velocities)
        assert v.sum() == pytest.approx(-2, abs=1e-11)
        assert (np.diff(v) <= 1e-9).all()
        assert v @ v <= 2 * (1 + 1e-9)


def test_ratios_beyond_double_precision_end_with_a_status():
    far = Collision((1e74, 1, 1e-75), (1, 1), (0.9, 0.9), (-1, 0, 0))
    for law in COLUMN_LAWS:
        outcome = in_time(far, law, exponent=1.5, max_steps=1000)
        if law == "bistiffness":
            # the last ball and the ball before it move as one body, and ball 1 strikes them like a wall
            assert outcome.status == "closed-form"
            assert outcome.velocities == pytest.approx((-1, -1.9, -1.9), abs=1e-12)
        else:
            assert outcome.status == "timeout"
        refused = in_time(Collision((1e300, 1e-300), (1,), (0.9,), (-1, 0)), law, exponent=1.5)
        assert refused.status == "unrepresentable"
        assert "where one mass or stiffness exceeds 1e+150 times another" in refused.reason


def test_what_is_refused():
    chain = make_chain(-1, 0, 0)
    with pytest.raises(ValueError, match=r"law = 'hertz'; legal: bistiffness, kelvin-voigt"):
        in_time(chain, "hertz")
    with pytest.raises(ValueError, match=r"gaps of up to 0\.1 m: the model has no positions; legal: 0"):
        solve(make_chain(-1, 0, 0, gap=0.1))
    with pytest.raises(ValueError, match=r"gaps: 0\.1; legal where positions are frozen: none"):
        in_time(make_chain(-1, 0, 0, gap=0.1), frozen=True)
    plastic = in_time(replace(chain, restitutions=(1, 0)))
    assert (plastic.status, plastic.reason[:24]) == ("unrepresentable", "a restitution is 0: no f")
    assert in_time(chain, max_steps=1).status == "timeout"


def test_a_solver_refuses_by_name_what_it_cannot_represent():
    for solver, settings, exponent, says in (
        ("kelvin-voigt-anchored", Settings(), 1, "kelvin-voigt-anchored is a law of two balls on a table"),
        ("bistiffness", Settings(scenario="drop"), 1, "scenario = 'drop'"),
        ("mujoco", Settings(), 1.5, "exponent = 1.5: the contacts of an engine are linear"),
    ):
        with pytest.raises(SolverError, match=says):
            get_solver(solver).solve(replace(make_chain(-1, 0, 0), exponent=exponent), settings)


#: Eight elastic balls that fall together, with 585 events. `TRUTH` holds the velocities by Taylor series in 40 and in
#: 60 digits, which agree in all digits given here.
STACK = Collision(
    tuple(0.5**i for i in range(8)), tuple(3.0**i for i in range(8)), (1.0,) * 8, (-1.0,) * 8, table=True
)
TRUTH = (1.09328, 1.05188, 0.81421, 0.65294, 0.59658, 0.23538, 0.21022, 0.03787)


def test_what_rounding_decides_is_marked():
    for solver in ("bistiffness", "kelvin-voigt", "mujoco"):
        (outcome,) = get_solver(solver).solve_many([STACK], Settings(step_fraction=0.05))
        assert outcome.status == "ok", outcome.reason
        # the outcome has a mark (a warning) because its error is so large
        assert np.abs(np.subtract(outcome.velocities, TRUTH)).max() > 0.1
        assert outcome.mark.startswith("a change of 1e-06 in masses and stiffnesses moves the exact outcome")


def test_an_error_that_is_stated_marks_too():
    (outcome,) = get_solver("hunt-crossley").solve_many([replace(STACK, exponent=1.5)], Settings())
    assert outcome.diagnostics["velocity_error"] > 1e-3
    assert outcome.mark.startswith("its own error moves")
