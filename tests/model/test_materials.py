"""Materials and the contacts made of them, compared with numbers and formulas printed in the literature."""

import math

import pytest

from impact_xval.model import Collision, solve
from impact_xval.model.kinetic import kinetic_norm
from impact_xval.model.materials import MATERIALS, Body, MaterialContact, line

STEEL, GLASS, RUBBER, PING_PONG = (MATERIALS[name] for name in ("steel", "glass", "rubber", "ping-pong"))


def test_the_two_steel_spheres_of_hertz():
    """Contact time, compression and force are those that Hertz printed.

    For spheres of 25 mm radius that meet at 10 mm/s he gives 0.38 ms, 0.13 mm and 2.47 kg (J. reine angew. Math.
    92:156, 1882).
    """
    touch = MaterialContact(Body(STEEL, 0.025), Body(STEEL, 0.025))
    compression = touch.compression(0.01)
    assert touch.duration(0.01) == pytest.approx(0.00038, abs=0.5e-5)
    assert math.sqrt(0.0125 * compression) == pytest.approx(0.13e-3, abs=0.5e-5)
    assert touch.stiffness * compression**1.5 == pytest.approx(2.47 * 9.80665, rel=0.05)


def test_the_duration_is_that_of_a_textbook():
    """The contact time is T = 2.87 (m^2/(R E*^2 v))^(1/5) (Johnson, Contact Mechanics, section 11.4), to 0.2 %."""
    touch = MaterialContact(Body(RUBBER, 0.01), Body(GLASS))
    soft = sum((1 - m.poisson**2) / m.young for m in (RUBBER, GLASS))
    assert touch.duration(0.3) == pytest.approx(
        2.87 * (touch.mass**2 * soft**2 / (0.01 * 0.3)) ** 0.2, rel=2e-3
    )


@pytest.mark.parametrize(("exponent", "longer", "force"), [(1.5, 1, 1), (1.0, math.pi / 2.9432, 0.8)])
def test_the_model_follows_hertz_s_contact_and_the_linear_one(exponent, longer, force):
    touch, v = MaterialContact(Body(STEEL, 0.02), Body(GLASS, 0.01)), 2.0
    pair = line((touch.upper, touch.lower), (-v, 0.0), exponent=exponent)
    elastic = Collision(pair.masses, pair.stiffnesses, (1.0,), pair.velocities, exponent=exponent)
    path = solve(elastic, path=True).path
    assert path.time[-1] == pytest.approx(longer * touch.duration(v), rel=1e-4)
    assert path.forces.max() == pytest.approx(force * touch.stiffness * touch.compression(v) ** 1.5, rel=1e-3)


def test_linearising_changes_where_several_contacts_take_an_impact():
    ball = Body(STEEL, 0.02)
    for bodies, apart in (([ball, ball, Body(STEEL)], 0.1487), ([ball] * 5, 0.1408), ([ball] * 2, 0.0)):
        velocities = (-1.0, *(0.0 for body in bodies[1:] if body == ball))
        hertz, linear = (solve(line(bodies, velocities, exponent=p)).velocities for p in (1.5, 1.0))
        difference = [a - b for a, b in zip(hertz, linear, strict=True)]
        assert kinetic_norm([1.0] * len(hertz), difference) == pytest.approx(apart, abs=1e-4)


def test_a_hollow_ball_is_a_linear_contact_and_the_body_that_yields_decides_the_restitution():
    ball = Body(PING_PONG, 0.02)
    touch = MaterialContact(ball, Body(STEEL))
    assert ball.mass == pytest.approx(2.7e-3, rel=1e-3)  # the rules of table tennis ask for 2.7 g
    assert touch.linear(0.5) == pytest.approx(touch.stiffness)
    assert MaterialContact(ball, ball).stiffness == pytest.approx(touch.stiffness / 2)
    assert MaterialContact(Body(RUBBER, 0.02), Body(STEEL)).restitution == pytest.approx(0.9, abs=1e-4)
    with pytest.raises(ValueError, match=r"exponent = 1.5; legal: 1, or 1.5 where all balls are solid"):
        line([ball, Body(STEEL)], (-1,), exponent=1.5)
