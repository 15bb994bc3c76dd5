"""Chains of N balls by the model.

Two balls are compared with the kernel made for two balls, and random chains with an independent integration in time.
The tests also check conservation laws, invariances, limiting cases, the path, and collisions that have no outcome.
"""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.integrate import trapezoid
from scipy.optimize import brentq

from impact_xval.model import Collision, Collisions, solve, solve_batch
from impact_xval.model.chain.following import Problem, closed_forms
from impact_xval.model.chain.record import ChainEnding
from impact_xval.model.pair.record import PairEnding
from impact_xval.model.solving import LAWS
from tests.compliant_baselines.reference_cells import random_cells
from tests.model.chains import assert_integrated, solved

JME, LZB = LAWS
GRAZING = 1e-5


def random_chain(rng, balls=None, table=None, least=0.5):
    """Draw a random row, pile or stack of 2 to 10 balls, with restitutions of at least `least`."""
    n = int(rng.integers(2, 11)) if balls is None else balls
    table = bool(rng.integers(2)) if table is None else table
    contacts = n - 1 + table
    velocities = np.zeros(n)
    velocities[: n if table and rng.integers(3) == 0 else 1] = -1
    return Collision(
        tuple(10 ** rng.uniform(-0.5, 0.5, n)),
        tuple(10 ** rng.uniform(-1, 1, contacts)),
        tuple(rng.uniform(least, 1, contacts)),
        tuple(velocities),
        table,
    )


def random_chains(seed, count, **given):
    rng = np.random.default_rng(seed)
    return [random_chain(rng, **given) for _ in range(count)]


def apart(one, other):
    return np.abs(np.subtract(one.velocities, other.velocities)).max()


@pytest.mark.parametrize("count", [1000, pytest.param(10_000, marks=pytest.mark.nightly)])
def test_two_balls_by_the_kernel_of_chains_are_those_by_their_own(count):
    cells = np.array(random_cells(count, count))
    # plastic contacts: e1 = 0, e2 = 0, or both
    cells[2:, :60] = np.repeat([(0, 0.7), (0.7, 0), (0, 0)], 20, axis=0).T
    nothing = np.zeros((count, 2))
    for law, code in LAWS.items():
        fast = solve_batch(*cells, law=law, states=True)
        slow = Problem(Collisions.from_ratios(*cells), code, nothing, True, nothing[:, 0]).follow()
        clear = fast.grazing_margin > 1e-9
        assert clear.mean() > 0.999
        np.testing.assert_allclose(slow.velocities[clear], fast.velocities[clear], atol=1e-12, rtol=0)
        ends = np.any([ending.condition for ending in closed_forms(slow.records)], axis=0)
        assert np.array_equal(ends[clear], (fast.statuses == "closed-form")[clear])
        for i in np.flatnonzero(clear & ~ends)[:200]:
            assert slow.states.names(i, True) == fast.flat.states.names(i, True)


def test_endings_of_different_kernels_have_different_numbers():
    """The endings of the two kernels share no number.

    Records hold endings as plain numbers, and members of two IntEnums with equal numbers are equal.
    """
    assert {ending.value for ending in PairEnding}.isdisjoint(ending.value for ending in ChainEnding)


@pytest.mark.parametrize(
    ("law", "exponent", "seed", "count", "balls"),
    [
        *((law, 1.0, 20, 5, None) for law in LAWS),
        *((law, 1.5, 21, 4, 3) for law in LAWS),
        pytest.param(JME, 1.0, 22, 15, None, marks=pytest.mark.nightly),
        pytest.param(LZB, 1.0, 22, 30, None, marks=pytest.mark.nightly),
        pytest.param(LZB, 1.5, 22, 40, 3, marks=pytest.mark.nightly),
    ],
)
def test_random_chains_are_those_of_the_integration(law, exponent, seed, count, balls):
    left_out = 0
    for chain in random_chains(seed, count, balls=balls):
        chain = replace(chain, exponent=exponent)
        ours = solve(chain, law=law)
        if ours.grazing_margin < GRAZING or "infinitely many" in ours.reason:
            left_out += 1
        else:
            assert_integrated(ours, chain, law)
    assert left_out <= 2


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("exponent", [1.0, 1.5])
def test_momentum_energy_and_the_order_of_balls(exponent, law):
    for chain in random_chains(4, 120 if exponent == 1 else 12):
        outcome = solved(chain, law=law, exponent=exponent)
        m, before, after = (np.array(x) for x in (chain.masses, chain.velocities, outcome.velocities))
        drift = 0.0 if chain.table else np.average(chain.velocities, weights=chain.masses)
        assert outcome.status in ("ok", "closed-form")
        assert np.all(np.diff([*after, 0.0] if chain.table else after) <= 0)
        assert m @ (after - drift) ** 2 <= m @ (before - drift) ** 2
        assert abs(outcome.diagnostics["energy_residual"]) < (1e-13 if exponent == 1 else 1e-10)
        assert all(impulse >= 0 for impulse in outcome.impulses)
        upward = outcome.impulses[-1] if chain.table else 0.0
        assert m @ (after - before) == pytest.approx(upward, abs=1e-12)


@pytest.mark.parametrize(("exponent", "count", "bound"), [(1.0, 30, 1e-11), (1.5, 6, 1e-9)])
def test_theorem_5(exponent, count, bound):
    """Outcomes depend only on ratios of masses and of stiffnesses, and velocities scale with the velocity of impact."""
    for chain in random_chains(6, count):
        scales = {"masses": 3, "stiffnesses": 700, "velocities": 0.01}
        scaled = {name: tuple(s * x for x in getattr(chain, name)) for name, s in scales.items()}
        here, there = (solved(c, exponent=exponent) for c in (chain, replace(chain, **scaled)))
        if here.grazing_margin > GRAZING:
            assert 100 * np.array(there.velocities) == pytest.approx(here.velocities, abs=bound)
            assert here.status == "closed-form" or here.states == there.states


def test_reversal_and_a_moving_observer():
    for chain in random_chains(7, 40, table=False):
        here, there = solved(chain), solved(chain.reversed())
        moving = solved(replace(chain, velocities=tuple(v + 5 for v in chain.velocities)))
        assert -np.array(there.velocities[::-1]) == pytest.approx(here.velocities, abs=1e-11)
        assert np.subtract(moving.velocities, 5) == pytest.approx(here.velocities, abs=1e-11)
        if here.status == "ok":
            n, sets = len(chain.masses), [s.split("+") for s in there.states]
            mirrored = ("+".join("-" if i == "-" else str(n - int(i)) for i in reversed(s)) for s in sets)
            assert tuple(mirrored) == here.states


def test_one_ball_two_pairs_and_a_plastic_chain():
    one = solved(Collision((2.0,), (5.0,), (0.6,), (-3.0,), table=True))
    assert (one.velocities, one.impulses) == (pytest.approx((1.8,), abs=1e-14), pytest.approx((9.6,)))
    pairs = solved(Collision((1, 1, 1, 1), (1, 1, 2), (0.8, 0.5, 0.6), (-1, 0, -9, -9)))
    assert pairs.velocities == pytest.approx((-0.1, -0.9, -9, -9), abs=1e-14)
    plastic = solved(Collision((1, 2, 3, 4), (1, 5, 0.2), (0, 0, 0), (-1, 0, 0, 0)))
    assert plastic.velocities == pytest.approx((-0.1,) * 4, abs=1e-14)


def test_a_cradle_of_ever_softer_contacts_is_a_sequence_of_single_impacts():
    """Velocities approach (0, 0, 0, -1), with an error that falls like sqrt(k2/k1) or faster."""
    errors = []
    for ratio in (1e2, 1e4, 1e6):
        outcome = solved(Collision((1,) * 4, tuple(ratio**-i for i in range(3)), (1,) * 3, (-1, 0, 0, 0)))
        errors.append(np.abs(np.subtract(outcome.velocities, (0, 0, 0, -1))).max())
    assert errors[2] < 2e-3
    assert np.log10(errors[0] / errors[2]) / 4 > 0.45


EXTREME = [
    Collision((1,) * 3, (1e12, 1, 1e-12), (0.9,) * 3, (-1,) * 3, table=True),
    Collision((1,) * 3, (1, 1e12, 1), (0.5,) * 3, (-1, 0, 0), table=True),
    Collision((1e-6, 1, 1e6), (1, 1), (0.3, 0.9), (-1, 0, 0)),
    Collision((1e6, 1, 1e-6), (1, 1, 1), (0.9, 0.9, 0.1), (-1, 0, 0), table=True),
    Collision((1,) * 5, (1,) * 5, (1e-6,) * 5, (-1,) * 5, table=True),
    Collision((1,) * 4, (1,) * 4, (0.0, 1.0, 0.0, 1.0), (-1, 0, 0, 0), table=True),
    Collision((1, 0.165), (1, 0.775), (0.4, 0.33), (-1, 0), table=True),
    Collision((1e-70, 1e70), (1, 1e-140), (0.5, 0.5), (-1, 0), table=True),
]


def test_no_chain_is_endless():
    for law, chain in product(LAWS, EXTREME):
        outcome = solved(chain, law=law, max_events=20_000)
        assert outcome.status in ("ok", "closed-form", "unconverged"), (law, chain)
        assert (outcome.status == "ok") == (outcome.reason == "")
        if outcome.status != "unconverged":
            assert np.all(np.diff(outcome.velocities) <= 0), (law, chain)


def test_a_chain_that_is_given_up_says_after_how_many_windows():
    """A contact that makes about 1e8 oscillations is given up after `max_events` windows.

    A window is the time over which one power series is valid. The reason of the outcome states how many there were. By
    default the limit is a million divided by the number of contacts less one, here 500,000.
    """
    chain = Collision((1,) * 3, (1e16, 1, 1), (1,) * 3, (-1, 0, 0), table=True)
    for given, windows in ((20, 20), (None, 500_000)):
        outcome = solved(chain, max_events=given)
        assert (outcome.status, outcome.reason) == ("unconverged", f"not over within {windows} windows")


def test_an_endless_cycle_below_a_ball_that_has_left_ends_at_rest():
    chain = Collision((5, 1, 0.165), (3, 1, 0.775), (1, 0.4, 0.33), (9, -1, 0), table=True)
    outcome = solved(chain, law=LZB)
    assert outcome.velocities == pytest.approx((9, 0, 0), abs=1e-12)
    assert outcome.status == "closed-form"
    assert "infinitely many events" in outcome.reason


@pytest.mark.parametrize("exponent", [1.0, 1.5])
def test_ratios_beyond_double_precision_are_refused_by_name(exponent):
    far = ((1e300, 1e-300), (1,)), ((1, 1, 1), (1e300, 1e-300)), ((1, 1, 1), (1e-320, 1e300))
    chains = [Collision(m, k, (0.9,) * len(k), (-1,) + (0,) * (len(m) - 1)) for m, k in far]
    chains += [Collision.from_ratios(40.0, ratio, 0.9, 0.7) for ratio in (1e-151, 1e151, 1e308)]
    for chain in chains:
        outcome = solved(chain, exponent=exponent)
        assert outcome.status == "unrepresentable", chain
        assert "where one mass or stiffness exceeds 1e+150 times another" in outcome.reason
        assert np.isnan(outcome.velocities).all()


def test_what_ends_with_more_energy_than_it_had_is_no_outcome():
    # These chains are elastic. Double precision lets them end with 1.54, 1.009 and 1.001 times their energy.
    three = Collision((1e19, 1e-8, 1e-26), (1e14, 0.1, 1e-9), (1,) * 3, (-1, 0, 0), table=True)
    four = Collision(
        (1e19, 1e-10, 1e-11, 1e-26), (1e5, 1e7, 1e-21, 1e-9), (1,) * 4, (-1, 0, 0, 0), table=True
    )
    for chain, exponent in ((three, 3.0), (three, 1.5), (four, 1.0)):
        outcome = solved(chain, exponent=exponent)
        assert outcome.status == "unrepresentable"
        assert "energy was made" in outcome.reason
        assert np.isnan(outcome.velocities).all()


def test_a_jump_has_a_margin_that_vanishes():
    """On both sides of a jump of the outcome, the grazing margin is below 1e-9 and the outcome is marked.

    The jump is found by bisection of one stiffness.
    """

    def at(k):
        return solved(Collision((1,) * 3, (1, 1, k), (0.9,) * 3, (-1,) * 3, table=True))

    low, high = at(0.705), at(0.71)
    jump = brentq(lambda k: apart(at(k), low) - apart(at(k), high), 0.705, 0.71, xtol=1e-15)
    below, above = at(jump * (1 - 1e-13)), at(jump * (1 + 1e-13))
    assert apart(below, above) > 1e-2
    for outcome in (below, above):
        assert outcome.grazing_margin < 1e-9
        assert outcome.mark.startswith("grazing")


@pytest.mark.parametrize("exponent", [1.0, 1.5])
def test_a_path_ends_in_the_outcome_and_its_forces_are_the_rates_of_its_impulses(exponent):
    chain = random_chain(np.random.default_rng(10), balls=4, table=True)
    outcome = solved(chain, exponent=exponent, path=True)
    path = outcome.path
    assert (*path.velocities[0], *path.velocities[-1]) == (*chain.velocities, *outcome.velocities)
    # error of the quintic interpolation between the ends of a step
    rounding = 1e-9 if exponent == 1 else 1e-6
    assert path.forces.min() > -rounding
    assert np.all(np.abs(path.forces[~path.active]) < rounding)
    grown = trapezoid(path.forces, path.time, axis=0)
    assert grown == pytest.approx(outcome.impulses, rel=0.02)
