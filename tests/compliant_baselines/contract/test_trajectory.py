import math

import numpy as np
import pytest

from impact_xval.compliant_baselines.contract.trajectory import (
    ALOFT,
    BROKEN,
    FLIGHT,
    FREE,
    GOING,
    REST,
    STUCK,
    ScanParameters,
    new_memory,
    scan,
)

NO_GRAVITY = ScanParameters(h=0.01, g=0.0, m1=1.0, m2=2.0, k1=1.0, k2=1.0, x2_rest=0.0)
# omega2 = 100/s: B2 rests 1 mm deep and lifts off from 0.1 m/s.
GRAVITY = ScanParameters(h=1e-4, g=10.0, m1=1.0, m2=1.0, k1=1e4, k2=1e4, x2_rest=-1e-3)


def look(v, x, before, p, left=10**6, memory=None):
    codes = np.zeros(len(v), np.int8)
    memory = new_memory() if memory is None else memory
    steps, end = scan(np.array(v, float), np.array(x, float), np.array(before, float), p, left, codes, memory)
    return steps, end, codes[:steps].tolist()


# Impulses and states


def test_states_are_read_from_the_balance_of_momentum():
    # B1 loses speed: contact 1. B2 gets less than B1 gave: contact 2 as well.
    _, _, codes = look([(-0.9, -0.01)], [(0, 0)], (-1, 0), NO_GRAVITY)
    assert codes == [1]
    _, _, codes = look([(-0.9, -0.05)], [(0, 0)], (-1, 0), NO_GRAVITY)
    assert codes == [3]  # m2 dv2 = -m1 dv1 exactly: nothing came from the table
    _, _, codes = look([(-1, 0.1)], [(0, 0)], (-1, 0), NO_GRAVITY)
    assert codes == [2]
    _, _, codes = look([(-1, 0.1)], [(0, 0)], (-1, 0.1), NO_GRAVITY)
    assert codes == [4]


def test_gravity_is_put_back():
    fall = GRAVITY.g * GRAVITY.h
    _, _, codes = look([(-1 - fall, -fall)], [(0, 0)], (-1, 0), GRAVITY)
    assert codes == [4]  # both in free fall
    _, _, codes = look([(-1 - fall, 0)], [(0, 0)], (-1, 0), GRAVITY)
    assert codes == [2]  # B2 is carried


@pytest.mark.parametrize(("ulps", "state"), [(4, 4), (1000, 3)])
def test_rounding_is_no_force_and_a_thousand_roundings_are(ulps, state):
    v1 = -1 + ulps * 2**-53
    _, _, codes = look([(v1, -(v1 + 1) / 2)], [(0, 0)], (-1, 0), NO_GRAVITY)
    assert codes == [state]


# The end, without gravity


def test_over_at_the_first_step_without_force_and_in_order():
    v = [(0.2, 0.1), (0.5, 0.1), (0.5, 0.1), (0.5, 0.1)]
    x = [(-0.1, -0.1)] * 4
    assert look(v, x, (0, 0.1), NO_GRAVITY)[:2] == (3, FREE)


@pytest.mark.parametrize(
    ("v", "why"),
    [
        ((0.1, 0.2), "B2 is faster and will hit B1 again"),
        ((0.5, -0.1), "B2 falls on the table"),
        ((-0.1, -0.2), "both"),
    ],
)
def test_not_over_though_apart(v, why):
    assert look([v] * 5, [(2, 1)] * 5, v, NO_GRAVITY)[:2] == (5, GOING), why


def test_not_over_while_a_contact_carries_force():
    v = [(0.5 + 0.1 * i, 0.1) for i in range(5)]
    assert look(v, [(1, 1)] * 5, (0.4, 0.1), NO_GRAVITY)[1] == GOING
    v = [(2, 0.1 + 0.1 * i) for i in range(5)]
    assert look(v, [(1, -1)] * 5, (2, 0), NO_GRAVITY)[1] == GOING


# The end, with gravity: balls in free fall unless said otherwise


def flight(v1, v2, x1, x2, n=1, carried=False):
    """Steps of B1 in free flight, of B2 in flight or carried at constant velocity."""
    fall = GRAVITY.g * GRAVITY.h * np.arange(1, n + 1)
    v = np.column_stack([v1 - fall, v2 - (0 if carried else fall)])
    return v, np.tile([x1, x2], (n, 1)), (v1, v2)


def test_drop_over_when_both_gaps_are_open():
    assert look(*flight(0.5, 0.3, 0.02, 0.01), GRAVITY)[:2] == (1, FREE)


def test_drop_not_over_inside_a_contact_though_it_carries_no_force():
    assert look(*flight(0.5, 0.3, 0.01, -1e-5), GRAVITY)[1] == GOING  # B2 may sink back
    assert look(*flight(0.5, 0.3, 0.01, 0.0101), GRAVITY)[1] == GOING  # B1 has not left B2


def test_a_flight_that_is_not_the_end_is_one_without_gravity():
    # B2 is faster, or falls on the table: in flight from the first step at whose end both gaps are open
    assert look(*flight(0.3, 0.5, 0.02, 0.01), GRAVITY)[:2] == (1, FLIGHT)
    assert look(*flight(0.3, -0.5, 0.02, 0.01, n=3), GRAVITY)[:2] == (1, FLIGHT)
    v, x, before = flight(0.3, 0.5, 0.02, 0.01, n=3)
    x[:2, 1] = -1e-5  # B2 leaves the table in the third step
    assert look(v, x, before, GRAVITY)[:2] == (3, FLIGHT)
    # not where a contact carries force in that step, nor where there is no gravity to switch off
    assert look([(0.4, 0.5)], [(0.02, 0.01)], (0.3, 0.5), GRAVITY)[1] == GOING
    assert look(*flight(0.3, 0.5, 0.02, 0.01), GRAVITY._replace(g=0.0))[1] == GOING


def gaps(*states):
    """Memory after steps in which the gaps of contacts 1 and 2 are open (1) or closed (0)."""
    v = [(0.0, 0.0)] * len(states)
    x = [(1e-4 * (2 * one - 1) + 1e-5 * (2 * two - 1), 1e-5 * (2 * two - 1)) for one, two in states]
    memory = new_memory()
    for each, at in zip(v, x, strict=True):
        p = GRAVITY if memory["flight"] == -1 else GRAVITY._replace(g=0.0)
        look([each], [at], each, p, memory=memory)
    return [*memory["lead"], *memory["lead_contact"]]


def test_by_how_much_a_flight_begins_or_does_not():
    # B1 leaves, B2 leaves three steps later and flies for two until B1 is back: a flight by two steps
    assert gaps((1, 0), (1, 0), (1, 0), (1, 1), (1, 1), (0, 1)) == [2, 1]
    # B1 is back one step before B2 leaves: none, by one step
    assert gaps((1, 0), (1, 0), (0, 0), (0, 1), (1, 1)) == [-1, 1]
    # B1 leaves last, and B2 is back after a step
    assert gaps((0, 1), (0, 1), (1, 1), (1, 0)) == [1, 2]
    # nothing comes near: both have been closed from the start
    assert gaps((0, 0), (1, 0), (1, 0))[0] == math.inf


@pytest.mark.parametrize(("v2", "end"), [(0.099, REST), (0.101, GOING), (-0.099, REST), (-0.101, GOING)])
def test_at_rest_is_what_cannot_lift_off(v2, end):
    # At equilibrium all of the vibration's energy is kinetic: lift-off takes g/omega2 = 0.1 m/s.
    assert look(*flight(0.5, v2, 0.02, GRAVITY.x2_rest, carried=True), GRAVITY)[1] == end


def test_lift_off_threshold_is_that_of_the_ball_on_its_spring():
    """A B2 vibrating with a little more than the threshold leaves the table, with a little less not."""
    omega, rest = 100.0, 1e-3
    for factor, leaves in ((0.999, False), (1.001, True)):
        amplitude = factor * GRAVITY.g / omega
        t = np.linspace(0, 2 * math.pi / omega, 10_001)
        assert (np.max(-rest + amplitude / omega * np.sin(omega * t)) > 0) == leaves
        assert (look(*flight(0.5, amplitude, 0.02, -rest, carried=True), GRAVITY)[1] == REST) != leaves


def test_not_at_rest_when_displaced_though_slow():
    # 2 mm below equilibrium: 0.2 m/s a quarter of a period later
    assert look(*flight(0.5, 0.0, 0.02, -3e-3, carried=True), GRAVITY)[1] == GOING


@pytest.mark.parametrize(("v1", "x1"), [(-0.01, 0.02), (0.5, -2e-3)])
def test_b2_at_rest_ends_nothing_while_b1_falls_or_touches(v1, x1):
    assert look(*flight(v1, -0.05, x1, GRAVITY.x2_rest, carried=True), GRAVITY)[1] == GOING


@pytest.mark.parametrize(("v", "end"), [(0.06, STUCK), (0.08, GOING)])
def test_stuck_is_what_cannot_part(v, end):
    # Both carried and moving together at their common equilibrium: v^2 (m1 + m2) < (m1 g)^2/k1 = 0.01 (m/s)^2
    # kg.
    rest1, rest2 = -2e-3 - 1e-3, -2e-3
    assert look([(v, v)], [(rest1, rest2)], (v, v), GRAVITY)[1] == end


@pytest.mark.parametrize(("left", "end"), [(98, ALOFT), (100, GOING)])
def test_a_flight_beyond_the_last_step_is_given_up(left, end):
    # 1 m at 1 m/s are 100 steps of 0.01 s; so is B2's fall
    for v, x in (((0.1, 1.1), (2, 1)), ((0.1, -1.0), (9, 1))):
        assert look([v], [x], v, NO_GRAVITY, left)[1] == end


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_broken_numbers_end_it(bad):
    assert look([(-0.9, 0), (bad, 0)], [(0, 0)] * 2, (-1, 0), NO_GRAVITY)[:2] == (1, BROKEN)
