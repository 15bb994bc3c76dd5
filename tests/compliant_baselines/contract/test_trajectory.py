import math

import numpy as np

from impact_xval.compliant_baselines.contract.trajectory import (
    ALOFT,
    FLIGHT,
    FREE,
    GOING,
    REST,
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
    # gravity is put back
    fall = GRAVITY.g * GRAVITY.h
    _, _, codes = look([(-1 - fall, -fall)], [(0, 0)], (-1, 0), GRAVITY)
    assert codes == [4]  # both in free fall
    _, _, codes = look([(-1 - fall, 0)], [(0, 0)], (-1, 0), GRAVITY)
    assert codes == [2]  # B2 is carried


def test_rounding_is_no_force_and_a_thousand_roundings_are():
    for ulps, state in ((4, 4), (1000, 3)):
        v1 = -1 + ulps * 2**-53
        _, _, codes = look([(v1, -(v1 + 1) / 2)], [(0, 0)], (-1, 0), NO_GRAVITY)
        assert codes == [state]


# The end, without gravity


def test_over_at_the_first_step_without_force_and_in_order():
    v = [(0.2, 0.1), (0.5, 0.1), (0.5, 0.1), (0.5, 0.1)]
    x = [(-0.1, -0.1)] * 4
    assert look(v, x, (0, 0.1), NO_GRAVITY)[:2] == (3, FREE)


def test_not_over_while_balls_that_are_apart_will_meet_or_a_contact_carries_force():
    # B2 is faster and will hit B1 again, B2 falls on the table, both
    for v in ((0.1, 0.2), (0.5, -0.1), (-0.1, -0.2)):
        assert look([v] * 5, [(2, 1)] * 5, v, NO_GRAVITY)[:2] == (5, GOING), v
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


def test_drop_over_when_both_gaps_are_open_and_not_inside_a_contact_though_it_carries_no_force():
    assert look(*flight(0.5, 0.3, 0.02, 0.01), GRAVITY)[:2] == (1, FREE)
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


def test_at_rest_is_what_cannot_lift_off():
    # At equilibrium all of the vibration's energy is kinetic: lift-off takes g/omega2 = 0.1 m/s.
    omega, rest = 100.0, 1e-3
    t = np.linspace(0, 2 * math.pi / omega, 10_001)
    for factor in (0.99, 0.999, 1.001, 1.01):
        v = factor * GRAVITY.g / omega
        leaves = np.max(-rest + v / omega * np.sin(omega * t)) > 0  # the ball on its spring
        assert leaves == (factor > 1)
        for v2 in (v, -v):
            end = look(*flight(0.5, v2, 0.02, -rest, carried=True), GRAVITY)[1]
            assert end == (GOING if leaves else REST), v2
    # slow, and 2 mm below equilibrium: 0.2 m/s a quarter of a period later
    assert look(*flight(0.5, 0.0, 0.02, -3e-3, carried=True), GRAVITY)[1] == GOING
    # and it ends nothing while B1 falls or touches
    for v1, x1 in ((-0.01, 0.02), (0.5, -2e-3)):
        assert look(*flight(v1, -0.05, x1, GRAVITY.x2_rest, carried=True), GRAVITY)[1] == GOING


def test_a_flight_beyond_the_last_step_is_given_up():
    # 1 m at 1 m/s are 100 steps of 0.01 s; so is B2's fall
    for left, end in ((98, ALOFT), (100, GOING)):
        for v, x in (((0.1, 1.1), (2, 1)), ((0.1, -1.0), (9, 1))):
            assert look([v], [x], v, NO_GRAVITY, left)[1] == end
