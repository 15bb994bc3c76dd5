"""Kelvin-Voigt and its named alternatives."""

import math

import numpy as np
import pytest

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.restitution import hunt_crossley_coefficients
from impact_xval.model import Collision
from tests.compliant_baselines.reference_cells import BATCHES

MU = 2 / math.sqrt(3)


def test_known_numbers():
    for ratio, v1, v2 in (
        (1, 0.65159996, 0.31646952),
        (40, 0.92582208, 0.02569387),
        (1 / 40, 0.63441945, 0.10156776),
    ):
        outcome = get_solver("kelvin-voigt").solve(Collision.from_ratios(ratio, MU, 0.9, 0.7))
        assert (outcome.v1, outcome.v2) == pytest.approx((v1, v2), abs=6e-9)
        assert outcome.status == "ok"
    elastic = BATCHES["kelvin-voigt"](1.0, MU, 1.0, 1.0)
    assert (elastic.v1, elastic.v2) == pytest.approx((0.954509, 0.277489), abs=6e-7)


def test_hunt_crossley_is_its_first_term_as_restitution_goes_to_one():
    loss = 10.0 ** np.arange(-9, -2)
    a = hunt_crossley_coefficients(1 - loss)
    # A = 3 (1 - e)/2 + O((1 - e)^2)
    np.testing.assert_allclose(a / (1.5 * loss), 1 + loss, atol=1e-6, rtol=0.5e-1 * loss.max())
    assert hunt_crossley_coefficients(np.array([1.0]))[0] == 0


def test_a_pair_that_is_alone_gets_its_restitution():
    for law in set(BATCHES) - {"bistiffness"}:
        # B2 a million times as heavy stays where it is: contact 1 alone
        batch = BATCHES[law](1.0, 1e12, 0.6, 1.0)
        expected = 0.6
        if law == "kelvin-voigt-textbook":
            zeta = -math.log(0.6) / math.hypot(math.pi, math.log(0.6))
            w = math.sqrt(1 - zeta**2)
            expected = math.exp(-zeta / w * math.atan2(2 * zeta * w, 2 * zeta**2 - 1))
            assert abs(expected - 0.6) > 0.01
        assert batch.v1 == pytest.approx(expected, abs=1e-6), law


def test_anchored_is_exact_where_the_lower_ball_is_pressed_on_the_table():
    # A light B2 on a hard support: B1 against the table. Half the mass ratio off for the pair's own mass.
    assert BATCHES["kelvin-voigt-anchored"](1e5, 1.0, 0.6, 0.6).v1 == pytest.approx(0.6, abs=0.01)
    assert BATCHES["kelvin-voigt"](1e5, 1.0, 0.6, 0.6).v1 > 0.68


def test_batch_says_unrepresentable_and_timeout_in_the_cell():
    batch = BATCHES["kelvin-voigt"]([1, 0, np.inf, 1, 1e9], 1.0, [0.5, 0.5, 0.5, 0, 1], 0.5, max_steps=50)
    assert list(batch.statuses) == ["ok", *3 * ["unrepresentable"], "timeout"]
    assert list(np.isnan(batch.v1)) == [False, True, True, True, True]
