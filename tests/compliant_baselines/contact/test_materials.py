"""Hertz contacts and the linear springs in their place: against printed formulas, quadrature and integration."""

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp

from impact_xval.compliant_baselines.contact.materials import (
    HERTZ_DURATION,
    MATERIALS,
    RESTITUTIONS,
    Body,
    Material,
    hertz_contact,
    linearised,
    measured_restitution,
)

STEEL, GLASS, RUBBER = (MATERIALS[name] for name in ("steel", "glass", "rubber"))


def _integrated(mass, force, speed):
    """Integrate M delta'' = -F(delta) from touch to the end: duration, penetration and largest force."""

    def apart(t, y):
        return y[0] if t > 0 else 1.0

    def turns(t, y):
        return y[1]

    apart.terminal, apart.direction = True, -1
    rough = math.sqrt(mass / force(1.0))  # some time to begin with
    run = solve_ivp(
        lambda t, y: [y[1], -force(max(y[0], 0.0)) / mass],
        (0, 1e6 * rough),
        [0.0, speed],
        method="DOP853",
        rtol=1e-12,
        atol=1e-18,
        events=[apart, turns],
    )
    deepest = run.y_events[1][0][0]
    return run.t_events[0][0], deepest, force(deepest)


def test_the_constant_of_the_duration_is_the_integral_and_that_of_the_books():
    # x = sin(u)^(4/5) takes the root at x = 1 away: 1 - x^(5/2) = cos(u)^2.
    integral, _ = quad(lambda u: 0.8 * math.sin(u) ** (-0.2), 0, math.pi / 2, epsabs=1e-13, epsrel=1e-13)
    assert pytest.approx(2 * integral, rel=1e-8) == HERTZ_DURATION
    assert round(HERTZ_DURATION, 2) == 2.94


@pytest.mark.parametrize(
    ("one", "other", "speed"),
    [
        (Body(STEEL, 0.01), Body(STEEL, 0.01), 1.0),
        (Body(STEEL, 0.005), Body(GLASS, 0.02), 0.1),
        (Body(RUBBER, 0.02), Body(STEEL, math.inf), 3.0),
    ],
)
def test_a_contact_is_that_of_the_printed_formulas(one, other, speed):
    # Johnson, Contact Mechanics: F = (4/3) E* R*^(1/2) delta^(3/2); section 11.4 for the penetration and duration.
    c = hertz_contact(one, other, speed)
    a, b = one.material, other.material
    modulus = 1 / ((1 - a.poisson**2) / a.young + (1 - b.poisson**2) / b.young)
    radius = (
        one.radius if math.isinf(other.radius) else one.radius * other.radius / (one.radius + other.radius)
    )
    m1 = 4 / 3 * math.pi * one.radius**3 * a.density
    m2 = 4 / 3 * math.pi * other.radius**3 * b.density
    mass = m1 if math.isinf(m2) else m1 * m2 / (m1 + m2)
    assert c.mass == pytest.approx(mass, rel=1e-13)
    assert c.stiffness == pytest.approx(4 / 3 * modulus * radius**0.5, rel=1e-13)
    printed = (15 * mass * speed**2 / (16 * radius**0.5 * modulus)) ** 0.4
    assert c.penetration == pytest.approx(printed, rel=1e-13)
    assert c.duration == pytest.approx(2.87 * (mass**2 / (radius * modulus**2 * speed)) ** 0.2, rel=2e-3)


@pytest.mark.parametrize("speed", [0.03, 1.0, 20.0])
def test_hertz_and_the_spring_in_its_place_are_those_of_an_integration(speed):
    c = hertz_contact(Body(STEEL, 0.004), Body(GLASS, 0.01), speed)
    duration, depth, force = _integrated(c.mass, lambda d: c.stiffness * d**1.5, speed)
    assert (c.duration, c.penetration, c.force) == pytest.approx((duration, depth, force), rel=1e-8)
    duration, depth, force = _integrated(c.mass, lambda d: c.linear_stiffness * d, speed)
    linear = (c.duration, c.linear_penetration, c.linear_force)
    assert linear == pytest.approx((duration, depth, force), rel=1e-8)


def test_the_spring_is_off_by_what_is_stated_whatever_meets_at_whatever_speed():
    for one, other, speed in (
        (Body(STEEL, 0.01), Body(STEEL, 0.01), 1.0),
        (Body(RUBBER, 1.0), Body(GLASS, math.inf), 1e-3),
    ):
        c = hertz_contact(one, other, speed)
        assert c.linear_force / c.force == pytest.approx(1 - 0.146, abs=5e-4)
        assert c.linear_penetration / c.penetration == pytest.approx(1 - 0.063, abs=5e-4)
        assert c.linear_stiffness == pytest.approx(0.9114 * c.stiffness * c.penetration**0.5, rel=1e-4)
        # The spring of the same penetration, of which the module speaks.
        same = c.mass * speed**2 / c.penetration**2
        assert same / c.linear_stiffness == pytest.approx(0.8777, abs=5e-5)
        assert math.pi * math.sqrt(c.mass / same) / c.duration == pytest.approx(1.067, abs=5e-4)
        assert same * c.penetration / c.force == pytest.approx(0.8, rel=1e-12)


def test_the_stiffness_grows_with_the_speed_to_the_power_of_two_fifths():
    slow, fast = (
        hertz_contact(Body(STEEL, 0.01), Body(GLASS, math.inf), v).linear_stiffness for v in (1, 32)
    )
    assert fast / slow == pytest.approx(4, rel=1e-12)


def test_two_hertz_balls_on_a_table_end_as_an_integration_of_positions_says():
    # Elastic, and no contact returns: then the model's frozen positions are no assumption.
    upper, lower, table = Body(STEEL, 0.005), Body(STEEL, 0.01), Body(STEEL, math.inf)
    found = linearised(upper, lower, table, 1.0, 1.0, 1.0)
    m1, m2 = upper.mass, lower.mass
    contacts = hertz_contact(upper, lower, 1.0), hertz_contact(lower, table, 1.0)
    stiffnesses = {
        1.5: [c.stiffness for c in contacts],
        1.0: [c.linear_stiffness for c in contacts],
    }
    for p, outcome in ((1.5, found.hertz), (1.0, found.linear)):
        k1, k2 = stiffnesses[p]
        unit = contacts[0].duration  # times in durations, lengths in what is crossed in one

        def rates(t, y, k1=k1, k2=k2, p=p, unit=unit):
            f1 = k1 * max((y[1] - y[0]) * unit, 0.0) ** p
            f2 = k2 * max(-y[1] * unit, 0.0) ** p
            return [y[2], y[3], unit * f1 / m1, unit * (f2 - f1) / m2]

        run = solve_ivp(rates, (0, 6), [0, 0, -1, 0], method="DOP853", rtol=1e-11, atol=1e-13, max_step=0.01)
        assert run.y[0, -1] > run.y[1, -1] > 0
        assert outcome.velocities == pytest.approx(run.y[2:, -1], abs=1e-6)
    dv = np.subtract(found.hertz.velocities, found.linear.velocities)
    assert found.divergence == pytest.approx(
        math.sqrt(m1 * dv[0] ** 2 + m2 * dv[1] ** 2) / math.sqrt(m1), rel=1e-12
    )
    assert found.divergence == pytest.approx(0.0327, abs=5e-5)  # docs/materials.md


def test_what_linearising_changes_does_not_depend_on_the_speed():
    bodies = Body(STEEL, 0.01), Body(GLASS, 0.01), Body(STEEL, math.inf)
    slow, fast = (linearised(*bodies, speed, 0.9, 0.7) for speed in (0.01, 10.0))
    assert fast.collision.stiffness_ratio == pytest.approx(slow.collision.stiffness_ratio, rel=1e-12)
    assert fast.divergence == pytest.approx(slow.divergence, rel=1e-7)


def test_restitutions_are_found_in_either_order_and_say_where_they_are_from():
    assert measured_restitution("steel", "ping-pong") == measured_restitution("ping-pong", "steel")
    assert measured_restitution("steel", "brass") is None
    for each in RESTITUTIONS:
        assert list(each.materials) == sorted(each.materials)
        assert set(each.materials) <= set(MATERIALS)
        assert 0 < each.low <= each.middle <= each.high <= 1
        assert each.source
    for material in MATERIALS.values():
        assert material.source
        assert material.young is not None or material.mass is not None
    # ITTF: from 305 mm back to 240 to 260.
    bounce = measured_restitution("ping-pong", "steel")
    assert (305 * bounce.low**2, 305 * bounce.high**2) == pytest.approx((240, 260))
    assert bounce.speed**2 / (2 * 9.81) == pytest.approx(0.305)


@pytest.mark.parametrize(
    ("act", "says"),
    [
        (lambda: Body(STEEL, 0.0), "radius = 0.0; legal: greater than 0 (m); inf for a flat, fixed body"),
        (lambda: Body(STEEL, 1e300), "radius = 1e+300: a mass beyond double precision"),
        (lambda: Body(STEEL, 1e-150), "radius = 1e-150: a mass beyond double precision"),
        (lambda: Body(MATERIALS["ping-pong"], 0.02), "material = 'ping-pong': a thin shell"),
        (
            lambda: hertz_contact(Body(STEEL, math.inf), Body(GLASS, math.inf), 1.0),
            "two fixed bodies do not collide",
        ),
        (
            lambda: hertz_contact(Body(STEEL, 1.0), Body(GLASS, 1.0), -1.0),
            "speed = -1.0; legal: greater than 0",
        ),
        (
            lambda: hertz_contact(Body(STEEL, 1.0), Body(GLASS, 1.0), 1e-300),
            "a contact beyond double precision",
        ),
        (
            lambda: linearised(Body(STEEL, 1.0), Body(STEEL, 1.0), Body(STEEL, 1.0), 1.0, 1.0, 1.0),
            "legal for two balls on a table: finite, finite, inf",
        ),
    ],
)
def test_what_has_no_contact_is_refused_by_name(act, says):
    with pytest.raises(ValueError, match=" ") as error:
        act()
    assert says in str(error.value)


def test_a_material_of_ones_own():
    ice = Material("ice", young=9e9, poisson=0.33, density=917.0, radius=None, source="one's own")
    assert hertz_contact(Body(ice, 0.01), Body(ice, math.inf), 0.1).mass == pytest.approx(
        917 * 4e-6 / 3 * math.pi
    )


def test_the_table_of_the_page_is_what_the_model_gives():
    text = (Path(__file__).parents[3] / "docs/materials.md").read_text(encoding="utf-8")
    rows = text.split("<!-- linearised -->\n")[1].split("\n\n")[0].splitlines()[2:]
    assert len(rows) == 7
    for row in rows:
        names, radii, ratio, *printed = (cell.strip() for cell in row.strip("|").split("|"))
        radii = [*(float(r) / 100 for r in radii.split(", ")), math.inf]
        bodies = [Body(MATERIALS[name], r) for name, r in zip(names.split(", "), radii, strict=True)]
        for e, shown in zip((1.0, 0.9, 0.7), printed, strict=True):
            found = linearised(*bodies, 1.0, e, e)
            assert f"{found.divergence:.4f}" == shown, (row, e)
            assert found.collision.stiffness_ratio == pytest.approx(float(ratio), rel=2e-3)
