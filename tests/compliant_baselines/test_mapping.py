import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from impact_xval.compliant_baselines.mapping import (
    KelvinVoigtContact,
    contact_time,
    damping_ratio,
    restitution,
    textbook_damping_ratio,
)
from impact_xval.compliant_baselines.restitution import textbook_restitution


def integrated_contact(zeta):
    """Integrate a contact of unit speed and omega until its force is zero; return restitution, duration, depth."""

    def force(_t, y):
        return y[0] + 2 * zeta * y[1]

    def rate(_t, y):
        return y[1]

    force.terminal, force.direction = True, -1
    how = {"method": "DOP853", "rtol": 1e-13, "atol": 1e-15, "events": (force, rate)}
    s = solve_ivp(lambda t, y: [y[1], -force(t, y)], (0, 50), [0, 1], **how)
    return -s.y[1, -1], s.t[-1], s.y_events[1][0, 0]


def test_restitution_and_duration_are_those_of_an_integrated_contact():
    for zeta in (0.0, 1e-9, 0.05, 0.4, 0.95, 0.999, 1.0, 1.001, 2.0):
        e, duration, _ = integrated_contact(zeta)
        assert restitution(zeta) == pytest.approx(e, rel=1e-10), zeta
        assert contact_time(zeta) == pytest.approx(duration, rel=1e-10), zeta


def test_the_damping_ratio_is_the_inverse_of_restitution_to_1e_12():
    between = [1e-30, 1e-6, 0.01, 0.1, math.exp(-2), 0.2, 0.3, 0.5, 0.7, 0.9, 0.999]
    for e in (1e-300, *between, 1 - 1e-9, 1 - 2**-53, 1.0):
        assert restitution(damping_ratio(e)) == pytest.approx(e, rel=1e-12), e
        contact = KelvinVoigtContact.from_restitution(3e4, e, 0.7)
        if e >= 1e-3:
            assert contact.zeta == pytest.approx(damping_ratio(e), rel=1e-14), e
            assert contact.restitution == pytest.approx(e, rel=1e-12), e


def test_the_inverse_follows_its_series_near_elastic_and_near_plastic():
    # zeta contact_time(zeta) = pi zeta - 2 zeta^2 + O(zeta^3) equals -ln e
    for x in (1e-3, 1e-6, 1e-9, 1e-12):
        e = math.exp(math.log1p(-x))
        series = -math.log(e) / math.pi
        assert damping_ratio(e) == pytest.approx(series + 2 * series**2 / math.pi, rel=20 * x**2 + 1e-13), x
    assert damping_ratio(1e-20) == pytest.approx(0.5e10, rel=1e-12)  # e approaches 1/(4 zeta^2) as zeta grows


@pytest.mark.parametrize("function", [damping_ratio, textbook_damping_ratio])
def test_restitution_outside_its_range_is_refused(function):
    for e in (0.0, -0.1, 1.0000001, math.nan):
        with pytest.raises(ValueError, match=r"e = .*; legal: greater than 0, at most 1"):
            function(e)


@pytest.mark.parametrize("zeta", [0.0, 1e-6, 0.1, 0.6, 0.9])
def test_the_textbooks_restitution_is_that_of_half_an_oscillation(zeta):
    """x'' + 2 zeta x' + x = 0 is followed from x = 0, x' = 1 over half a period by a matrix exponential."""
    half = math.pi / math.sqrt(1 - zeta**2)
    x, v = expm(half * np.array([[0.0, 1.0], [-1.0, -2 * zeta]])) @ (0.0, 1.0)
    assert x == pytest.approx(0, abs=1e-12)
    assert textbook_restitution(zeta) == pytest.approx(-v, rel=1e-10, abs=1e-12)
    assert textbook_damping_ratio(textbook_restitution(zeta)) == pytest.approx(zeta, rel=1e-9, abs=1e-12)


def test_the_textbooks_critical_damping_has_no_rebound():
    assert textbook_restitution(1.0) == 0


def theory_restitution(zeta):
    """Return the restitution by the formulas printed in docs/theory.md, section 7."""
    if zeta == 1:
        return math.exp(-2)
    w = math.sqrt(abs(1 - zeta**2))
    if zeta < 1:
        return math.exp(-(zeta / w) * math.atan2(2 * zeta * w, 2 * zeta**2 - 1))
    return math.exp(-(zeta / w) * math.log((zeta + w) / (zeta - w)))


def test_restitution_is_that_of_the_printed_formulas():
    for zeta in (0.0, 1e-9, 0.01, 0.3, 0.7, 0.999, 1.0, 1.001, 1.5, 10.0):
        rel = 1e-13 if zeta != 0.999 else 1e-12
        assert restitution(zeta) == pytest.approx(theory_restitution(zeta), rel=rel), zeta
    for zeta in (math.nextafter(1, 0), math.nextafter(1, 2)):
        assert restitution(zeta) == pytest.approx(math.exp(-2), rel=1e-15)
