"""Rigid laws compared with closed forms and with rational arithmetic that tries every set of contacts.

The tests also check invariances and sequences of infinitely many impacts.
"""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, reject, settings
from hypothesis import strategies as st

from impact_xval.compliant_baselines import SolverError, get_solver
from impact_xval.compliant_baselines.conformance import problems
from impact_xval.compliant_baselines.rigid.laws import LAWS, TooManyImpactsError, follow_impacts
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.model.collision import Collision
from tests.compliant_baselines.reference_cells import make_chain
from tests.compliant_baselines.rigid.rational import Balls, single_impacts

SINGLE = ("sequential-top", "sequential-bottom", "generalised-reflection")
AT_ONCE = ("newton-restitution", "poisson-restitution")
PLASTIC = "plastic-then-restitution"


def velocities(law, collision):
    return follow_impacts(collision, law).v


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("e", [0.0, 0.3, 1.0])
def test_one_contact_returns_its_restitution(law, e):
    v = velocities(law, make_chain(-1.0, 0.5, e=e, masses=(1.0, 3.0)))
    mean = (-1.0 + 1.5) / 4
    # Textbook formula with the velocity V of the centre of mass and the velocities v1 and v2 before the impact: ball 1
    # ends with V - e m2/(m1 + m2) (v1 - v2), ball 2 with V + e m1/(m1 + m2) (v1 - v2).
    assert v == pytest.approx([mean + e * 0.75 * 1.5, mean - e * 0.25 * 1.5], abs=1e-15)
    assert velocities(law, make_chain(-2.0, e=e, table=True)) == pytest.approx([2 * e], abs=1e-15)


@pytest.mark.parametrize("gap", [0.0, 1e-3])
@pytest.mark.parametrize("law", LAWS)
def test_newtons_cradle(law, gap):
    v = velocities(law, make_chain(-1.0, 0.0, 0.0, 0.0, 0.0, gap=gap))
    if law == PLASTIC and not gap:
        # The plastic impact transmits 3/5 N s at the second contact, which are kept. So 2 P1 - 1 - 3/5 = 1 and P1 =
        # 13/10. Then ball 2 is faster than the three below it by 1/2 m/s, and the same happens from ball to ball.
        assert v == pytest.approx([3 / 10, -3 / 40, -17 / 60, -49 / 120, -8 / 15], abs=1e-15)
    elif law in AT_ONCE and not gap:
        # the velocity -1 is reflected at the mean velocity -1/5
        assert v == pytest.approx([3 / 5] + [-2 / 5] * 4, abs=1e-15)
    else:
        assert v == pytest.approx([0, 0, 0, 0, -1], abs=1e-15)
    # If contacts are apart or impacts are single, two balls that strike make two balls leave.
    two = velocities(law, make_chain(-1.0, -1.0, 0.0, 0.0, 0.0, gap=gap))
    if gap or law in SINGLE:
        assert two == pytest.approx([0, 0, 0, -1, -1], abs=1e-15)


@st.composite
def chains(draw):
    table = draw(st.booleans())
    n = draw(st.integers(2 - table, 4))

    def drawn(low, high, finest, size):
        return draw(st.lists(st.fractions(low, high, max_denominator=finest), min_size=size, max_size=size))

    masses, e, v = drawn(Fraction(1, 5), 5, 5, n), drawn(0, 1, 9, n - 1 + table), drawn(-2, 2, 4, n)
    try:
        c = Collision(*(tuple(map(float, each)) for each in (masses, [1] * len(e), e, v)), table=table)
    except ValueError:
        reject()  # no bodies approach: skip this example
    return c, masses, e, v


@given(chains())
@settings(max_examples=150, deadline=None)
def test_laws_in_rational_numbers_that_try_every_set_of_contacts(drawn):
    c, masses, e, v = drawn
    for law, solve, abs_ in (
        ("newton-restitution", Balls.newton, 1e-13),
        ("poisson-restitution", Balls.poisson, 1e-13),
        (PLASTIC, Balls.plastic, 1e-13),
        ("sequential-top", Balls.first, 1e-12),
        ("sequential-bottom", Balls.last, 1e-12),
    ):
        single = law in SINGLE  # single impacts may go on without end unless e = 1
        if single and len(masses) > 3:
            continue
        exact = Balls(masses, [Fraction(1)] * len(e) if single else e, v, c.table)
        solve(exact)
        asked = replace(c, restitutions=(1.0,) * len(e)) if single else c
        assert velocities(law, asked) == pytest.approx([float(x) for x in exact.v], abs=abs_), law


@given(chains())
@settings(max_examples=150, deadline=None)
def test_invariances(drawn):
    c, _, e, _ = drawn
    c = replace(c, restitutions=(float(e[0]),) * len(e))
    m, before = np.array(c.masses), np.array(c.velocities)
    for law in LAWS:
        try:
            after = follow_impacts(c, law, most=5_000).v
        except TooManyImpactsError:  # heavy balls may come to rest on light ones only after very many impacts
            assert law in SINGLE
            continue
        between = -np.diff([*after, 0.0] if c.table else after)
        assert (between >= 0).all(), law
        assert m @ after**2 <= m @ before**2 * (1 + 1e-12), law  # all contacts have the same e
        elastic = replace(c, restitutions=(1.0,) * len(e))
        if law in SINGLE:
            assert m @ velocities(law, elastic) ** 2 == pytest.approx(m @ before**2, rel=1e-11), law
        if not c.table:
            assert m @ after == pytest.approx(m @ before, abs=1e-12), law
            moved = replace(c, velocities=tuple(before + 0.75))
            assert velocities(law, moved) == pytest.approx(after + 0.75, abs=1e-12), law
            if law == PLASTIC:  # this law sweeps from the top and is not symmetric
                continue
            other = {"sequential-top": "sequential-bottom", "sequential-bottom": "sequential-top"}
            mirrored = velocities(other.get(law, law), c.reversed())
            assert -mirrored[::-1] == pytest.approx(after, abs=1e-12), law


@pytest.mark.parametrize("restitutions", [(0.5, 0.0, 0.0, 0.0), (0.5,) * 4])
@pytest.mark.parametrize("law", [law for law in LAWS if law != "generalised-reflection"])
def test_balls_end_apart_to_the_bit(law, restitutions):
    # Rounding in `sequential-top` once left v1 - v2 = -1.9e-16 here.
    c = Collision((1.5, 5.0, 14 / 3, 1.5), (1.0,) * 4, restitutions, (-2.0, -0.5, 0.0, -1.0), table=True)
    assert (np.diff([*velocities(law, c), 0.0]) <= 0).all()


def test_newton_creates_energy_where_restitutions_differ():
    # A heavy ball rests on a light one (e1 = 0). The light one falls on the table at 1 m/s (e2 = 1). Newton's law
    # requires u2 = 1 and u1 >= 0.
    c = Collision((10.0, 0.1), (1.0, 1.0), (0.0, 1.0), (0.0, -1.0), table=True)
    # the energy is 101 times the initial one
    assert velocities("newton-restitution", c) == pytest.approx([1, 1], abs=1e-13)
    # By Poisson's law compression stops the light ball with 0.1 N s. The same impulse is returned and lifts both balls.
    assert velocities("poisson-restitution", c) == pytest.approx([0.1 / 10.1] * 2, abs=1e-13)


def test_infinitely_many_impacts_end_at_their_limit():
    solve = get_solver("sequential-top").solve
    # two balls that collapse on the table
    o = solve(Collision.two_balls(1.0, 1.0, 1.0, 1.0, 0.1, 0.1))
    assert (o.status, o.velocities, o.impulse1) == ("closed-form", (0.0, 0.0), pytest.approx(1, abs=1e-14))
    # Three balls in flight with e < 7 - 4 sqrt(3) (McNamara and Young, 1992) collapse in a finite time and keep
    # momentum.
    for e, status in ((0.05, "closed-form"), (0.09, "ok")):
        o = solve(Collision((1.0,) * 3, (1.0,) * 2, (e, e), (-1.0, 0.0, 1.0), gaps=(1.0, 1.3)))
        assert (o.status, sum(o.velocities)) == (status, pytest.approx(0, abs=1e-14)), e


@pytest.mark.parametrize("law", LAWS)
def test_a_gap_that_shrinks_without_end_is_a_collapse_and_no_touch(law):
    # In decimals of 700 digits there are 10,232 impacts, and the last gaps are 1e-600.
    c = Collision((1.0, 0.01, 1.0), (1.0, 1.0), (0.15, 0.15), (-1.0, 0.0, 0.0), gaps=(1.0, 0.001))
    o = get_solver(law).solve(c)
    assert (o.status, o.velocities) == ("closed-form", pytest.approx([-1 / 2.01] * 3, abs=1e-15))
    # Ball 1 meets ball 2 after 1 s. Ball 2 meets ball 3 when it has moved 1 mm at 1.15/1.01 m/s. The collapse ends
    # before ball 2 would arrive there at the common final velocity.
    assert 1 + 0.001 / 1.15 * 1.01 < o.diagnostics["duration"] < 1 + 0.001 * 2.01


@pytest.mark.parametrize("law", LAWS)
def test_bodies_touch_where_their_gap_is_zero_and_no_sooner(law):
    v = velocities(law, Collision((1.0,) * 3, (1.0,) * 2, (1.0,) * 2, (-1.0, 0.0, 0.0), gaps=(1.0, 1e-15)))
    assert v == pytest.approx([0, 0, -1], abs=1e-15)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("sign", [-1, 1])
def test_three_balls_collapse_up_to_the_restitution_of_theory(law, sign):
    # McNamara and Young (1992), for balls of any masses: there are infinitely many impacts if m1 m3/((m1 + m2)(m2 +
    # m3)) (1 + e)^2 >= 4 e.
    for masses in ((1.0, 1.0, 1.0), (2.0, 0.3, 5.0), (50.0, 0.1, 8.0)):
        m1, m2, m3 = masses
        q = m1 * m3 / ((m1 + m2) * (m2 + m3))
        e = (2 - q - 2 * (1 - q) ** 0.5) / q
        c = Collision(masses, (1.0,) * 2, (e * (1 + sign * 1e-3),) * 2, (-1.0, 0.0, 1.0), gaps=(1.0, 1.3))
        o = get_solver(law).solve(c)
        assert o.status == ("closed-form" if sign < 0 else "ok"), masses
        assert np.dot(masses, o.velocities) == pytest.approx(m3 - m1, abs=1e-12)
        mean = (m3 - m1) / sum(masses)
        # a finite sequence of dozens of impacts leaves about e^n of a speed
        assert o.velocities == pytest.approx([mean] * 3, abs=1e-9), masses


@pytest.mark.parametrize("law", AT_ONCE)
def test_bodies_that_have_collapsed_are_struck_as_one_that_touches(law):
    # Balls 2 to 4 collapse and move down at 1/3 m/s. Ball 1 arrives later, with u = (-1 + 1/3, 0, 0): an impact of 1 kg
    # on 3 kg.
    c = Collision((1.0,) * 4, (1.0,) * 3, (0.05,) * 3, (-1.0, -1.0, 0.0, 0.0), gaps=(30.0, 1.0, 0.3))
    o = get_solver(law).solve(c)
    mean, u = -1 / 2, 2 / 3
    apart = [mean + 0.05 * 3 / 4 * u] + [mean - 0.05 / 4 * u] * 3
    assert (o.status, o.velocities) == ("closed-form", pytest.approx(apart, abs=1e-14))


def test_balls_with_gaps_against_single_impacts_in_decimals_of_eighty_digits():
    rng, known, answered = np.random.default_rng(5), 0, 0
    for _ in range(36):
        n, table = int(rng.integers(2, 6)), bool(rng.integers(2))
        contacts = n - 1 + table
        m, gaps = 10 ** rng.uniform(-2, 2, n), 10 ** rng.uniform(-3, 0, contacts)
        e = np.full(contacts, rng.uniform(0, rng.choice([0.1, 0.4, 1.0])))
        v = (-1.0, *rng.uniform(-0.5, 0.5, n - 1).tolist())
        c = Collision(*(tuple(x.tolist()) for x in (m, np.ones(contacts), e)), v, table, tuple(gaps.tolist()))
        exact = single_impacts(c, most=2_000)
        for law in LAWS if exact else ():
            try:
                line = follow_impacts(c, law, most=5_000)
            except TooManyImpactsError:
                continue
            finally:
                known += 1
            answered += 1
            assert line.v == pytest.approx(exact, abs=1e-11), (c, law)
    assert known > 80
    assert answered > 0.95 * known


def test_balls_that_fall_together_leave_after_one_impact():
    # Only the contact with the table approaches. The others are at rest and stay so or open, so that nothing approaches
    # after the first impact.
    rng = np.random.default_rng(6)
    for case in range(60):
        n = int(rng.integers(2, 5))
        m, e = 10 ** rng.uniform(-2, 2, n), rng.uniform(0, 1, n)
        c = Collision(*(tuple(x.tolist()) for x in (m, np.ones(n), e)), (-1.0,) * n, table=True)
        if not case:
            c = Collision((2.0, 3.0, 0.1), (1.0,) * 3, (0.5,) * 3, (-1.0,) * 3, table=True)
        for law, solve in (("newton-restitution", Balls.newton), ("poisson-restitution", Balls.poisson)):
            exact = Balls(
                *([Fraction(x) for x in xs] for xs in (c.masses, c.restitutions, c.velocities)), True
            )
            solve(exact)
            line = follow_impacts(c, law)
            assert (line.impacts, line.endless) == (1, False), (c, law)
            assert line.v == pytest.approx([float(x) for x in exact.v], abs=1e-12), (c, law)


def test_collapses_may_follow_one_another_without_an_end():
    # Whenever balls 2 to 4 meet, they collapse on the table before the contact of ball 1 is next. Ball 1 then bounces
    # off ball 2 of 5 kg.
    c = Collision(
        (1.5, 5.0, 14 / 3, 1.5), (1.0,) * 4, (0.5, 0.0, 0.0, 0.0), (-2.0, -0.5, 0.0, -1.0), table=True
    )
    o = get_solver("sequential-bottom").solve(c)
    assert (o.status, o.velocities) == ("closed-form", pytest.approx([4 / 13, 0, 0, 0], abs=1e-15))
    assert o.n_events < 1_000


@pytest.mark.parametrize("law", LAWS)
def test_the_solver_keeps_the_contract(law):
    solver = get_solver(law)
    with pytest.raises(SolverError, match="unrepresentable: scenario = 'drop'"):
        solver.solve(Collision.two_balls(1, 1, 1, 1, 0.5, 0.5), Settings(scenario="drop"))
    if law == "generalised-reflection":
        with pytest.raises(SolverError, match=r"unrepresentable: restitutions = .* one e for all"):
            solver.solve(Collision.two_balls(1, 1, 1, 1, 0.5, 0.6))
    else:
        assert problems(solver, law) == {}
