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

CONTACTS = ("ball-table", "ball-ball")


def test_an_engine_returns_what_it_was_asked_for(engine):
    requests = [
        ContactRequest(contact, e, k, m1, m2, step_fraction=2e-4)
        for contact in CONTACTS
        for k, m1, m2 in ((1e8, 1.0, 1.0), (10.0, 0.2, 3.0), (1e5, 3.0, 0.2))
        for e in (0.3, 0.7, 1.0)
    ]
    for result in calibrate(engine, requests):
        asked = result.request
        assert result.restitution == pytest.approx(asked.e, rel=0.01), asked
        assert result.duration == pytest.approx(result.duration_asked, rel=0.01), asked
        if asked.e == 1 and asked.contact == "ball-ball":  # half a period
            mass = asked.m1 * asked.m2 / (asked.m1 + asked.m2)
            assert result.duration_asked == pytest.approx(math.pi * math.sqrt(mass / asked.k))


def test_the_naive_mapping_costs_what_it_costs(engine):
    results = calibrate(engine, [ContactRequest("ball-table", 0.7, m2=0.2, mapping="naive")])
    off = results[0].restitution - 0.7
    if engine.name == "pybullet":
        # half the stiffness at twice the damping is twice the (textbook) zeta times sqrt(2)
        expected = restitution(2 * 2**0.5 * textbook_damping_ratio(0.7))
        assert results[0].restitution == pytest.approx(expected, abs=0.01)
    assert abs(off) > 0.1


def test_requests_that_cannot_be_are_refused_and_in_a_list_each_in_its_place(engine):
    good, refused = ContactRequest("ball-table", 0.5), ContactRequest("ball-table", 0.5, k=1e32)
    with pytest.raises(ValueError, match="e = 0; legal"):
        calibrate(engine, [ContactRequest("ball-table", 0)])
    with pytest.raises(SolverError, match="unrepresentable"):
        calibrate(engine, [refused])
    with pytest.raises(SolverError, match=r"timeout: .* not over after max_steps = 10 steps"):
        calibrate(engine, [good], max_steps=10)
    answers = try_contacts(engine, [good, refused, good])
    assert answers[0] == answers[2]
    assert isinstance(answers[1], SolverError)
    assert answers[1].status == "unrepresentable"


FRACTIONS = (1e-3, 5e-4, 2.5e-4, 1.25e-4)


def check_limits(engine, restitutions, stiffnesses):
    for contact, e, k in ((c, e, k) for c in CONTACTS for e in restitutions for k in stiffnesses):
        requests = [ContactRequest(contact, e, k, 1.0, 2 / 3**0.5, step_fraction=f) for f in FRACTIONS]
        results = calibrate(engine, requests)
        restitution = np.array([result.restitution for result in results])
        ratio = np.array([result.duration / result.duration_asked for result in results])
        limit = contact_limit(e, restitution, ratio)
        # sharper than anybody asks, since nothing but the second order is left
        assert (limit.restitution, limit.duration) == (
            pytest.approx(e, abs=5e-6),
            pytest.approx(1, abs=5e-6),
        ), requests[0]
        of_e, _, of_both = limit.orders
        assert of_both == pytest.approx(1, abs=0.1), requests[0]
        if engine.name == "mujoco" and e == 1:
            assert of_e > 1.9  # a symplectic step loses no energy of a spring
        else:
            assert of_e == pytest.approx(1, abs=0.1), requests[0]


def test_single_contacts_converge_to_what_was_asked_for_at_first_order(engine):
    check_limits(engine, (0.2, 0.6, 1.0), (1e2, 1e8))


@pytest.mark.nightly
def test_single_contacts_converge_over_six_decades(engine):
    check_limits(engine, (0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0), [10.0**n for n in range(2, 9)])


def test_the_duration_does_not_jump_with_the_step(engine):
    # To a fraction of a step: over a small range of steps it is a straight line.
    fractions = [1e-2 * (1 + 0.01 * i) for i in range(12)]
    results = calibrate(engine, [ContactRequest("ball-table", 0.6, step_fraction=f) for f in fractions])
    ratios = [r.duration / r.duration_asked for r in results]
    line = np.polyval(np.polyfit(fractions, ratios, 1), fractions)
    asked = results[0].request.asked()
    step = fractions[0] * asked.period / asked.duration  # in the units of the ratios: 0.024
    assert np.abs(ratios - line).max() < 0.02 * step
