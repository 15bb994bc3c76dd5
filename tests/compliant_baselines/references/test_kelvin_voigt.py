"""Kelvin-Voigt and its named alternatives."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from impact_xval.compliant_baselines import SolverError, get_solver
from impact_xval.compliant_baselines.contact.mapping import contacts, damping_ratio
from impact_xval.compliant_baselines.contact.restitution_laws import (
    damping_ratios,
    hunt_crossley_coefficients,
)
from impact_xval.compliant_baselines.contract.solver import Settings
from impact_xval.compliant_baselines.references.kelvin_voigt import DAMPINGS, dampings, kelvin_voigt_batch
from impact_xval.model import Collision
from tests.compliant_baselines.reference import kelvin_voigt as impact_reference

MU = 2 / math.sqrt(3)


@pytest.mark.parametrize(
    ("ratio", "v1", "v2"),
    [(1, 0.65159996, 0.31646952), (40, 0.92582208, 0.02569387), (1 / 40, 0.63441945, 0.10156776)],
)
def test_known_numbers(ratio, v1, v2):
    outcome = get_solver("kelvin-voigt").solve(Collision.from_ratios(ratio, MU, 0.9, 0.7))
    assert outcome.v1 == pytest.approx(v1, abs=6e-9)
    assert outcome.v2 == pytest.approx(v2, abs=6e-9)
    assert outcome.status == "ok"


def test_known_elastic_numbers():
    batch = kelvin_voigt_batch(1.0, MU, 1.0, 1.0)
    assert (batch.v1, batch.v2) == (pytest.approx(0.954509, abs=6e-7), pytest.approx(0.277489, abs=6e-7))


def test_agrees_with_the_reference_of_the_engine_tests():
    c = Collision(m1=0.3, m2=1.1, k1=2e4, k2=9e4, e1=0.8, e2=0.6, v0=-2.5)
    first, second = contacts(c)
    answer = impact_reference(c.m1, c.m2, c.k1, c.k2, first.c, second.c, c.v0)
    outcome = get_solver("kelvin-voigt").solve(c)
    for name in ("v1", "v2", "impulse1", "impulse2"):
        assert getattr(outcome, name) == pytest.approx(getattr(answer, name), rel=1e-9)
    assert outcome.states == answer.states


def test_damping_ratios_are_those_of_the_mapping():
    e = np.concatenate([10.0 ** np.linspace(-6, -0.01, 200), 1 - 10.0 ** np.linspace(-12, -1, 50), [1.0]])
    np.testing.assert_allclose(damping_ratios(e), [damping_ratio(x) for x in e], rtol=1e-12)


@pytest.mark.parametrize("e", [0.02, 0.3, 0.5, 0.9, 0.999])
def test_hunt_crossley_gives_the_restitution_it_was_asked_for(e):
    a = hunt_crossley_coefficients(np.array([e]))[0]

    def leave(_t, y):
        return y[0]

    leave.terminal, leave.direction = True, -1
    run = solve_ivp(
        lambda _t, y: [y[1], -max(0.0, y[0] * (1 + a * y[1]))],
        (0, 1e3),
        [0.0, 1.0],
        method="DOP853",
        rtol=1e-12,
        atol=1e-15,
        events=[leave],
        first_step=1e-6,
    )
    assert -run.y[1, -1] == pytest.approx(e, rel=2e-11)


def test_hunt_crossley_is_its_first_term_as_restitution_goes_to_one():
    loss = 10.0 ** np.arange(-9, -2)
    a = hunt_crossley_coefficients(1 - loss)
    # A = 3 (1 - e)/2 + O((1 - e)^2)
    np.testing.assert_allclose(a / (1.5 * loss), 1 + loss, atol=1e-6, rtol=0.5e-1 * loss.max())
    assert hunt_crossley_coefficients(np.array([1.0]))[0] == 0


@pytest.mark.parametrize("damping", DAMPINGS)
def test_a_pair_that_is_alone_gets_its_restitution(damping):
    # B2 a million times as heavy stays where it is: contact 1 alone
    batch = kelvin_voigt_batch(1.0, 1e12, 0.6, 1.0, damping=damping)
    expected = 0.6
    if damping == "textbook":
        zeta = -math.log(0.6) / math.hypot(math.pi, math.log(0.6))
        w = math.sqrt(1 - zeta**2)
        expected = math.exp(-zeta / w * math.atan2(2 * zeta * w, 2 * zeta**2 - 1))
        assert abs(expected - 0.6) > 0.01
    assert batch.v1 == pytest.approx(expected, abs=1e-6)


def test_anchored_is_exact_where_the_lower_ball_is_pressed_on_the_table():
    # A light B2 on a hard support: B1 against the table. Half the mass ratio off for the pair's own mass.
    stiff = {d: kelvin_voigt_batch(1e5, 1.0, 0.6, 0.6, damping=d).v1 for d in ("pair", "anchored")}
    assert stiff["anchored"] == pytest.approx(0.6, abs=0.01)
    assert stiff["pair"] > 0.68


def test_the_dampings_differ_as_they_say():
    one = [np.array([x]) for x in (4.0, 3.0, 0.8, 0.7)]
    c = {d: dampings(d, *one) for d in DAMPINGS}
    assert c["anchored"][1][0] / c["pair"][1][0] == pytest.approx(math.sqrt(1 / 0.75))
    assert c["anchored"][2][0] == c["pair"][2][0]
    assert c["textbook"][2][0] / c["pair"][2][0] == pytest.approx(0.1128 / 0.1222, abs=1e-3)
    with pytest.raises(ValueError, match=r"damping = 'none'; legal: pair, anchored"):
        dampings("none", *one)


@pytest.mark.parametrize("name", ["kelvin-voigt", "kelvin-voigt-anchored", "hunt-crossley", "bistiffness"])
@pytest.mark.parametrize(
    ("collision", "what"),
    [
        (Collision.from_ratios(2, 1, 0, 0.5), "e1 = 0"),
        (Collision.from_ratios(2, 1, 0.5, 0), "e2 = 0"),
        (Collision.from_ratios(0, 1, 0.5, 0.5), "k2 = 0"),
        (Collision.from_ratios(math.inf, 1, 0.5, 0.5), "k2 = inf"),
    ],
)
def test_refuses_by_name(name, collision, what):
    with pytest.raises(SolverError, match=what):
        get_solver(name).solve(collision)


def test_batch_says_unrepresentable_and_timeout_in_the_cell():
    batch = kelvin_voigt_batch(
        [1.0, 0.0, np.inf, 1.0, 1.0, 1e9], 1.0, [0.5, 0.5, 0.5, 0.0, 0.5, 1.0], 0.5, max_steps=50
    )
    assert list(batch.status) == [
        "ok",
        "unrepresentable",
        "unrepresentable",
        "unrepresentable",
        "ok",
        "timeout",
    ]
    assert list(np.isnan(batch.v1)) == [False, True, True, True, False, True]


@pytest.mark.parametrize(
    ("argument", "value"),
    [("stiffness_ratio", -1), ("mass_ratio", 0), ("e1", 1.5), ("e2", np.nan), ("gravity_number", -1e-3)],
)
def test_batch_names_an_illegal_value(argument, value):
    arguments = {"stiffness_ratio": 1.0, "mass_ratio": 1.0, "e1": 0.5, "e2": 0.5, "gravity_number": 0.0}
    with pytest.raises(ValueError, match=f"{argument} = .*legal"):
        kelvin_voigt_batch(**(arguments | {argument: [0.5, value]}))


def test_a_slack_contact_is_loaded_again_without_opening():
    # The spent dashpot of contact 1 lets go while the balls still overlap by 0.18; B2 comes back from the table.
    c = Collision.from_ratios(0.4082560357, 1.8824229592, 0.3276377521, 0.9236459750)
    outcome = get_solver("kelvin-voigt").solve(c, Settings(record_path=True))
    path = outcome.path
    ended, returned = (
        next(e for e in outcome.events if (e.kind, e.contact) == (kind, 1))
        for kind in ("end-of-restitution", "return")
    )
    assert returned.time - ended.time > 1
    rate = path.v2 - path.v1
    overlap = np.concatenate([[0], np.cumsum(0.5 * np.diff(path.time) * (rate[1:] + rate[:-1]))])
    between = (path.time >= ended.time) & (path.time <= returned.time)
    assert overlap[between].min() > 0.005
    # and it is loaded from a force of zero on: a dashpot that met its body anew would push at once
    after = np.searchsorted(path.time, returned.time + 1e-9)
    slope = np.diff(path.impulse1)[after] / np.diff(path.time)[after]
    assert 0 < slope < 0.05
