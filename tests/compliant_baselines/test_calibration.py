import math

import pytest

from compliant_baselines import SolverError
from compliant_baselines.calibration import ContactRequest, calibrate
from compliant_baselines.mapping import restitution, textbook_damping_ratio

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
