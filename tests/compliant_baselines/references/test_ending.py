"""How long a flight lasts and when a collision is over, against polynomials, matrix exponentials and root finders."""

import itertools
import math

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import brentq

from impact_xval.compliant_baselines.contract.trajectory import (
    FREE,
    GOING,
    REST,
    STUCK,
)
from impact_xval.compliant_baselines.references.contact_law import COMPRESSION, LOADED, OPEN, SLACK, state_of
from impact_xval.compliant_baselines.references.driver import LOG_COLUMNS, LOG_WIDTH, flight_time, write_row
from impact_xval.compliant_baselines.references.ending import excess1, excess2, how_over, over_within
from impact_xval.compliant_baselines.references.taylor import ORDER, expand, longest_step
from tests.compliant_baselines.references.test_taylor import system, table_of


def test_states_are_named_by_the_contacts_that_carry_force():
    for on, off in ((LOADED, SLACK), (COMPRESSION, OPEN)):
        assert [state_of(*modes) for modes in itertools.product((on, off), repeat=2)] == [1, 3, 2, 4]


def flight_event(p1, d1, p2, v2, g):
    """First positive root of the flight's polynomials; the top of a flight out of the table that stays in it."""
    times = [-p1 / d1] if p1 * d1 < 0 else []
    roots = np.roots([0.5 * g, -v2, p2] if g else [-v2, p2])  # of the penetration of contact 2
    real = [float(r.real) for r in roots if abs(r.imag) < 1e-12 and r.real > 0]
    if real:
        times.append(min(real))
    elif g > 0 and p2 > 0 and v2 > 0:
        times.append(v2 / g)
    return min(times, default=math.inf)


@pytest.mark.parametrize("g", [0.0, 0.01, 1.0])
def test_flight_time_is_half_as_long_again_as_to_the_first_event(g):
    rng = np.random.default_rng(6)
    infinite = 0
    for p1, d1, p2, v2 in rng.uniform(-1, 1, (500, 4)):
        expected = 1.5 * flight_event(p1, d1, p2, v2, g)
        infinite += math.isinf(expected)
        assert flight_time(p1, d1, p2, v2, g) == pytest.approx(expected, rel=1e-9)
    assert 0 < infinite < 500


def test_a_flight_that_starts_on_the_table_downwards_is_over_at_once():
    assert flight_time(-1.0, -1.0, 0.0, 0.0, 1.0) == 0
    assert flight_time(-1.0, -1.0, 0.0, 0.5, 1.0) == pytest.approx(1.5)  # thrown up at 0.5, back after 1


@pytest.mark.parametrize("loaded1", [True, False])
@pytest.mark.parametrize("loaded2", [True, False])
def test_without_gravity_it_is_over_when_nothing_pushes_and_all_part(loaded1, loaded2):
    for d1, v2 in itertools.product((-0.5, 0.0, 0.5), repeat=2):
        over = not loaded1 and not loaded2 and v2 - d1 >= v2 >= 0
        found = how_over(loaded1, loaded2, 2.0, -0.1, d1, -0.1, v2, 1.0, 3.0, 0.0)
        assert found == (FREE if over else GOING)


def oscillation(mu, k1, k2, g, state, times, loaded1):
    """Penetrations (p1, p2) of springs without dashpots that also pull, by the matrix exponential."""
    k1 = k1 if loaded1 else 0.0
    rows = system(mu, k1, k2, 0, 0, g, 0)  # contact 2 carries m2 g at q2 = 0: only B1 falls
    at = np.array([expm(rows * t) @ [*state, 1] for t in times])
    return at[:, 0], at[:, 2] + mu * g / k2


def test_b2_is_at_rest_if_and_only_if_its_vibration_never_unloads_the_table():
    rng = np.random.default_rng(7)
    seen = set()
    for _ in range(40):
        mu, k2, g = 10 ** rng.uniform(-1, 1, 3)
        rest = mu * g / k2
        q2, v2 = rest * rng.uniform(-1, 1), g * math.sqrt(mu / k2) * rng.uniform(-1, 1)
        times = np.linspace(0, 2 * math.pi * math.sqrt(mu / k2), 400)
        _, p2 = oscillation(mu, 1.0, k2, g, (-1.0, 0.0, q2, v2), times, loaded1=False)
        if abs(p2.min()) < 1e-3 * rest:
            continue  # too near to tell from samples
        # B1 above, rising faster than B2
        found = how_over(False, True, mu, -1.0, v2 - abs(v2) - 0.1, q2, v2, 1.0, k2, g)
        assert found == (REST if p2.min() > 0 else GOING)
        seen.add(found)
    assert seen == {REST, GOING}


def test_b2_at_rest_under_a_b1_that_comes_back_is_not_over():
    assert how_over(False, True, 1.0, -1.0, -0.1, 0.0, 0.0, 1.0, 1.0, 1.0) == REST
    assert how_over(False, True, 1.0, -1.0, 0.1, 0.0, 0.0, 1.0, 1.0, 1.0) == GOING
    assert how_over(False, True, 1.0, 0.1, -0.1, 0.0, 0.0, 1.0, 1.0, 1.0) == GOING  # they still overlap


def test_stuck_balls_never_unload_a_contact_and_a_little_more_energy_can():
    rng = np.random.default_rng(8)
    for _ in range(40):
        mu, k1, k2, g = 10 ** rng.uniform(-1, 1, 4)
        p1_rest, q2_rest = g / k1, g / k2  # contact 2 carries m2 g at q2 = 0, and that of B1 beside
        x = rng.normal(size=4)
        u1, u2, v1, v2 = x / np.array([math.sqrt(k1), math.sqrt(k2), 1, math.sqrt(mu)]) / np.linalg.norm(x)
        # energy of this shape is 1, times two; the least that unloads a contact stands in it alone
        least = min(p1_rest * math.sqrt(k1), (1 + mu) * g / math.sqrt(k2))

        def state(scale, u1=u1, u2=u2, v1=v1, v2=v2, p=p1_rest, q=q2_rest):
            return p + scale * u1, scale * (v2 - v1), q + scale * u2, scale * v2

        assert how_over(True, True, mu, *state(0.999 * least), k1, k2, g) == STUCK
        assert how_over(True, True, mu, *state(1.001 * least), k1, k2, g) == GOING
        assert how_over(True, True, mu, *state(0.0), k1, k2, 0.0) == GOING  # never without gravity
        times = np.linspace(0, 30 * math.sqrt((1 + mu) / min(k1, k2)), 300)
        p1, p2 = oscillation(mu, k1, k2, g, state(0.999 * least), times, loaded1=True)
        assert min(p1.min() / p1_rest, p2.min() / ((1 + mu) * g / k2)) > 0


@pytest.mark.parametrize("loaded1", [True, False])
def test_within_a_segment_the_end_is_where_the_energy_has_fallen(loaded1):
    """Damped vibrations that come to rest in mid-segment, against a root finder on the matrix exponential."""
    mu, k1, k2, c1, c2, g = 1.3, 1.0, 4.0, 0.3, 0.2, 0.5
    state = (g / k1, 0.0, g / k2, 0.0) if loaded1 else (-1.0, -2.0, 0.0, 0.0)
    kick = np.array([0.0, 0.0, 0.0, 1.0])
    on = (k1, c1) if loaded1 else (0.0, 0.0)
    column = mu, on[0], k2, on[1], c2
    h = longest_step(*column)
    rows = system(*column, g, 0.0)

    def excess(x, start):
        p1, d1, q2, v2, _ = expm(rows * (x * h)) @ [*start, 1]
        return excess2(mu, p1, d1, q2, v2, k1, k2, g) if loaded1 else excess1(mu, q2, v2, k2, g)

    # so strong a kick that the energy reaches the threshold in mid-segment
    kicked = brentq(lambda s: excess(0.6, state + s * kick), 0.1, 10)
    start = state + kicked * kick
    table = table_of(start)
    expand(table, ORDER, h, *column, g, 0.0)
    found = over_within(table, ORDER, 1.0, loaded1, True, mu, k1, k2, g)
    assert found == pytest.approx(brentq(excess, 0, 1, args=(start,), xtol=1e-15), abs=1e-12)
    assert found == pytest.approx(0.6, abs=1e-9)
    assert over_within(table, ORDER, 0.5, loaded1, True, mu, k1, k2, g) == 0.5  # not yet


def test_a_row_is_written_where_there_is_one():
    log = np.full((2, LOG_WIDTH), np.nan)
    row = 5.0, (1.0, 2.0, 3.0, 4.0), 6.0, 7.0, 8.0, 2, 0, 31, 9.0
    write_row(log, 1, *row)
    assert dict(zip(LOG_COLUMNS, log[1], strict=True)) == {
        "time": 5, "p1": 1, "d1": 2, "q2": 3, "v2": 4, "duration": 6, "k1": 7, "k2": 8,
        "mode1": 2, "mode2": 0, "event": 31, "g": 9,
    }  # fmt: skip
    write_row(log, 2, *row)
    assert np.isnan(log[0]).all()
