import math

import numpy as np
import pytest

from impact_xval.compliant_baselines import SolverError
from impact_xval.compliant_baselines.calibration.calibration import (
    ContactRequest,
    calibrate,
    contact_limit,
    try_contacts,
)
from impact_xval.compliant_baselines.contact.mapping import restitution, textbook_damping_ratio

RESTITUTIONS = (0.3, 0.5, 0.7, 0.9, 1.0)


@pytest.mark.parametrize("contact", ["ball-table", "ball-ball"])
@pytest.mark.parametrize(("k", "m1", "m2"), [(1e8, 1.0, 1.0), (10.0, 0.2, 3.0), (1e5, 3.0, 0.2)])
def test_an_engine_returns_what_it_was_asked_for(engine, contact, k, m1, m2):
    requests = [ContactRequest(contact, e, k, m1, m2, step_fraction=2e-4) for e in RESTITUTIONS]
    for result in calibrate(engine, requests):
        assert result.restitution == pytest.approx(result.request.e, rel=0.01)
        assert result.duration == pytest.approx(result.duration_asked, rel=0.01)


def test_duration_asked_is_half_a_period_for_an_elastic_contact(engine):
    (result,) = calibrate(engine, [ContactRequest("ball-ball", 1.0, k=1e6, m1=1.0, m2=3.0)])
    assert result.duration_asked == pytest.approx(math.pi * math.sqrt(0.75 / 1e6))


@pytest.mark.parametrize("contact", ["ball-table", "ball-ball"])
def test_the_error_is_of_first_order_in_the_step(engine, contact):
    fractions = (4e-3, 2e-3, 1e-3)
    results = calibrate(engine, [ContactRequest(contact, 0.6, step_fraction=f) for f in fractions])
    errors = [abs(r.restitution - 0.6) for r in results]
    assert errors[0] / errors[1] == pytest.approx(2, abs=0.2)
    assert errors[1] / errors[2] == pytest.approx(2, abs=0.2)


def test_the_naive_mapping_costs_what_it_costs(engine):
    results = calibrate(engine, [ContactRequest("ball-table", 0.7, m2=0.2, mapping="naive")])
    off = results[0].restitution - 0.7
    if engine.name == "pybullet":
        # half the stiffness at twice the damping is twice the (textbook) zeta times sqrt(2)
        expected = restitution(2 * 2**0.5 * textbook_damping_ratio(0.7))
        assert results[0].restitution == pytest.approx(expected, abs=0.01)
    assert abs(off) > 0.1


def test_requests_that_cannot_be_are_refused(engine):
    with pytest.raises(ValueError, match="e = 0; legal"):
        calibrate(engine, [ContactRequest("ball-table", 0)])
    with pytest.raises(SolverError, match="unrepresentable"):
        calibrate(engine, [ContactRequest("ball-table", 0.5, k=1e32)])
    with pytest.raises(SolverError, match=r"timeout: .* not over after max_steps = 10 steps"):
        calibrate(engine, [ContactRequest("ball-table", 0.5)], max_steps=10)


FRACTIONS = (1e-3, 5e-4, 2.5e-4, 1.25e-4)


def check_limits(engine, contact, restitutions, stiffnesses):
    for e in restitutions:
        for k in stiffnesses:
            requests = [ContactRequest(contact, e, k, 1.0, 2 / 3**0.5, step_fraction=f) for f in FRACTIONS]
            results = calibrate(engine, requests)
            restitution = np.array([result.restitution for result in results])
            ratio = np.array([result.duration / result.duration_asked for result in results])
            limit = contact_limit(e, restitution, ratio)
            assert limit.restitution == pytest.approx(e, abs=1e-3)
            assert limit.duration == pytest.approx(1, abs=1e-3)
            # and, stated more sharply than anybody asks, since nothing but the second order is left
            assert (limit.restitution, limit.duration) == (
                pytest.approx(e, abs=5e-6),
                pytest.approx(1, abs=5e-6),
            )
            of_e, _, of_both = limit.orders
            assert of_both == pytest.approx(1, abs=0.1)
            if engine.name == "mujoco" and e == 1:
                assert of_e > 1.9  # a symplectic step loses no energy of a spring
            else:
                assert of_e == pytest.approx(1, abs=0.1)


@pytest.mark.parametrize("contact", ["ball-table", "ball-ball"])
def test_single_contacts_converge_to_what_was_asked_for(engine, contact):
    check_limits(engine, contact, (0.2, 0.6, 1.0), (1e2, 1e8))


@pytest.mark.slow
@pytest.mark.parametrize("contact", ["ball-table", "ball-ball"])
def test_single_contacts_converge_over_six_decades(engine, contact):
    check_limits(
        engine, contact, (0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0), [10.0**n for n in range(2, 9)]
    )


def test_what_fails_is_an_error_in_its_place(engine):
    good = ContactRequest("ball-table", 0.5)
    answers = try_contacts(engine, [good, ContactRequest("ball-table", 0.5, k=1e32), good])
    assert answers[0] == answers[2]
    assert isinstance(answers[1], SolverError)
    assert answers[1].status == "unrepresentable"


def test_the_duration_does_not_jump_with_the_step(engine):
    # To a fraction of a step: over a small range of steps it is a straight line.
    fractions = [1e-2 * (1 + 0.01 * i) for i in range(12)]
    results = calibrate(engine, [ContactRequest("ball-table", 0.6, step_fraction=f) for f in fractions])
    ratios = [r.duration / r.duration_asked for r in results]
    line = np.polyval(np.polyfit(fractions, ratios, 1), fractions)
    asked = results[0].request.asked()
    step = fractions[0] * asked.period / asked.duration  # in the units of the ratios: 0.024
    assert np.abs(ratios - line).max() < 0.02 * step
