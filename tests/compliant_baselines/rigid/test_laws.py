"""The rigid laws against closed forms by hand, another way to solve them, and what each of them promises."""

import math
import re
from fractions import Fraction
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from impact_xval.compliant_baselines import Settings, get_solver
from impact_xval.model.collision import Collision
from impact_xval.model.columns.column import Column

LAWS = ("newton", "poisson", "sequential-top", "sequential-bottom", "generalised-reflection")
SEQUENTIAL = ("sequential-top", "sequential-bottom")
ORDERS = [("sequential-top", list), ("sequential-bottom", lambda contacts: contacts[::-1])]


def column(masses, e, velocities, table=False):
    contacts = len(masses) - 1 + table
    return Column(
        tuple(masses),
        (1.0,) * contacts,
        tuple(e) if isinstance(e, tuple | list | np.ndarray) else (e,) * contacts,
        tuple(velocities),
        table=table,
    )


def velocities(name, *args, **kwargs):
    return get_solver(name).solve_column(column(*args, **kwargs)).velocities


# --- an independent way: every set of contacts with an impulse tried, in exact fractions ---


def solve(rows, right):
    """Solve a small linear system in fractions, by Gauss and Jordan."""
    n = len(rows)
    a = [[*row, r] for row, r in zip(rows, right, strict=True)]
    for i in range(n):
        pivot = next(j for j in range(i, n) if a[j][i])
        a[i], a[pivot] = a[pivot], a[i]
        a[i] = [x / a[i][i] for x in a[i]]
        for j in range(n):
            if j != i:
                a[j] = [x - a[j][i] * y for x, y in zip(a[j], a[i], strict=True)]
    return [row[-1] for row in a]


def by_enumeration(G, q):
    """Find p of 0 <= p, 0 <= G p + q, one of the two 0, in fractions."""
    n = len(q)
    for active in product((False, True), repeat=n):
        on = [i for i in range(n) if active[i]]
        p = [Fraction(0)] * n
        for i, x in zip(on, solve([[G[i][j] for j in on] for i in on], [-q[i] for i in on]), strict=True):
            p[i] = x
        if min(p) >= 0 and all(x >= 0 for x in plus(q, times(G, p))):
            return p
    raise AssertionError("no solution")


def times(G, p):
    return [sum(g * x for g, x in zip(row, p, strict=True)) for row in G]


def plus(a, b):
    return [x + y for x, y in zip(a, b, strict=True)]


class Exact:
    """A column in fractions; its numbers are those of the doubles given."""

    def __init__(self, c):
        self.m, self.v = [Fraction(m) for m in c.masses], [Fraction(v) for v in c.velocities]
        self.e, self.table = [Fraction(e) for e in c.restitutions], c.table
        balls, n = len(self.m), len(self.e)
        # W: contact i parts ball i from ball i + 1.
        self.W = [[Fraction((b == i) - (b == i + 1)) for i in range(n)] for b in range(balls)]
        inner = [
            [sum(w[i] * w[j] / m for w, m in zip(self.W, self.m, strict=True)) for j in range(n)]
            for i in range(n)
        ]
        self.G = inner

    def rates(self, v):
        n = len(self.e)
        return [sum(self.W[b][i] * v[b] for b in range(len(v))) for i in range(n)]

    def moved(self, v, p):
        return [x + t / m for x, t, m in zip(v, times(self.W, p), self.m, strict=True)]

    def newton(self):
        u = self.rates(self.v)
        return self.moved(
            self.v, by_enumeration(self.G, [x + e * min(x, 0) for x, e in zip(u, self.e, strict=True)])
        )

    def poisson(self):
        compression = by_enumeration(self.G, self.rates(self.v))
        v = self.moved(self.v, compression)
        least = [e * p for e, p in zip(self.e, compression, strict=True)]
        v = self.moved(v, least)
        return self.moved(v, by_enumeration(self.G, self.rates(v)))

    def generalised_reflection(self):
        plastic = self.moved(self.v, by_enumeration(self.G, self.rates(self.v)))
        v, (e, *_) = self.v, self.e
        while any(u < 0 for u in self.rates(v)):
            near = [i for i, u in enumerate(self.rates(v)) if u < 0]
            part = by_enumeration(
                [[self.G[i][j] for j in near] for i in near], [self.rates(v)[i] for i in near]
            )
            p = [Fraction(0)] * len(self.e)
            for i, x in zip(near, part, strict=True):
                p[i] = 2 * x
            v = self.moved(v, p)
        return [e * a + (1 - e) * b for a, b in zip(v, plastic, strict=True)]

    def sequence(self, order, impacts=400):
        """Single impacts, and whether they ended."""
        v = self.v
        for _ in range(impacts):
            u = self.rates(v)
            near = [i for i in order(range(len(u))) if u[i] < 0]
            if not near:
                return v, True
            p = [Fraction(0)] * len(u)
            p[near[0]] = -(1 + self.e[near[0]]) * u[near[0]] / self.G[near[0]][near[0]]
            v = self.moved(v, p)
        return v, False


def drawn(rng, *, equal=False, receding=False, e=(0, 0.25, 0.5, 0.75, 1)):
    """A random column of 2 to 5 balls in short binary fractions, of which the method in fractions makes short ones."""
    while True:
        n, table = int(rng.integers(2, 6)), bool(rng.integers(2))
        contacts = n - 1 + table
        masses = rng.integers(1, 40, n) / 8
        back = np.full(contacts, rng.choice(e)) if equal else rng.choice(e, contacts)
        u = -rng.integers(0, 9, contacts) / 8 * rng.integers(0, 2, contacts)
        if receding:
            u = u + rng.integers(0, 9, contacts) / 8 * rng.integers(0, 2, contacts)
        v = np.cumsum(u[::-1])[::-1]
        v = v if table else np.append(v, 0.0)
        if (u < 0).any():
            return column(masses, back, v, table)


@pytest.mark.parametrize("receding", [False, True])
@pytest.mark.parametrize("name", ["newton", "poisson", "generalised-reflection"])
def test_laws_of_complementarity_are_those_found_by_trying_all_sets_of_contacts(name, receding):
    rng = np.random.default_rng(7)
    for _ in range(60):
        c = drawn(rng, equal=name == "generalised-reflection", receding=receding)
        expected = getattr(Exact(c), name.replace("-", "_"))()
        found = get_solver(name).solve_column(c)
        assert found.velocities == pytest.approx([float(v) for v in expected], abs=1e-13)


@pytest.mark.parametrize(("name", "order"), ORDERS)
def test_sequences_that_end_are_those_in_fractions(name, order):
    rng, ended = np.random.default_rng(8), 0
    for _ in range(120):
        c = drawn(rng, e=(0.5, 0.75, 1))
        expected, over = Exact(c).sequence(order, 40)
        outcome = get_solver(name).solve_column(c)
        if over:
            ended += 1
            assert outcome.status == "ok"
            assert outcome.velocities == pytest.approx([float(v) for v in expected], abs=1e-12)
    assert ended > 60


@pytest.mark.parametrize(("name", "order"), ORDERS)
def test_infinite_sequences_end_where_a_long_one_in_doubles_of_the_velocities_goes(name, order):
    """The limit is found from rates and a linear system; here velocities are followed ball by ball."""
    rng, infinite = np.random.default_rng(9), 0
    for _ in range(150):
        c = drawn(rng, e=(0, 0.25, 0.5))
        outcome = get_solver(name).solve_column(c)
        if outcome.status != "limit":
            continue
        v, m = list(c.velocities), c.masses
        for _ in range(20_000):
            u = [v[i] - (v[i + 1] if i + 1 < len(v) else 0.0) for i in range(len(c.restitutions))]
            near = next((i for i in order(range(len(u))) if u[i] < -1e-12), None)
            if near is None:
                break
            below = 1 / m[near + 1] if near + 1 < len(v) else 0.0
            p = -(1 + c.restitutions[near]) * u[near] / (1 / m[near] + below)
            v[near] += p / m[near]
            if near + 1 < len(v):
                v[near + 1] -= p * below
        else:
            continue
        infinite += 1
        assert outcome.velocities == pytest.approx(v, abs=1e-10)
    assert infinite > 40


def test_a_collapse_between_two_walls_of_balls_is_the_plastic_impact():
    # Three equal balls, e far below 7 - 4 sqrt(3), where McNamara and Young (1992) find the collapse.
    for e in (0.0, 0.05, 0.07):
        for name in SEQUENTIAL:
            o = get_solver(name).solve_column(column((1, 1, 1), e, (-1, 0, 1)))
            assert o.status == "limit"
            assert o.velocities == pytest.approx((0, 0, 0), abs=1e-15)
            assert o.states == ((1, 2), ())
            o = get_solver(name).solve_column(column((1, 1, 1), 0.15, (-1, 0, 1)))
            assert o.status == "ok"
            assert o.velocities[0] > o.velocities[1] > o.velocities[2]


@pytest.mark.parametrize("name", SEQUENTIAL)
def test_a_sequence_too_long_is_a_timeout(name):
    c = column((1.0, 1e-10), 1.0, (-1.0, 0.0), table=True)  # some pi sqrt(m1/m2) impacts
    (o,) = get_solver(name).solve_columns([c], Settings())
    assert (o.status, o.reason) == ("timeout", "not over after 100000 impacts")
    (o,) = get_solver(name).solve_columns([column((1, 1), 1.0, (-1, 0), table=True)], Settings(max_steps=2))
    assert (o.status, o.reason) == ("timeout", "not over after 2 impacts")


# --- two balls on a table, by hand ---


@pytest.mark.parametrize("e", [Fraction(1), Fraction(9, 10), Fraction(1, 2)])
def test_the_basic_collision_by_hand(e):
    # m1 = 1, m2 = 2, v0 = -1. Newton, and Poisson: B2 stays where it is, pressed, and B1 comes back with e.
    c = Collision(1.0, 2.0, 1.0, 1.0, float(e), float(e))
    for name in ("newton", "poisson"):
        o = get_solver(name).solve(c)
        assert (o.v1, o.v2) == (pytest.approx(float(e)), 0.0)
        assert (o.impulse1, o.impulse2) == pytest.approx((float(1 + e),) * 2)
    # One after another: ball on ball, B2 on the table, ball on ball; then v1 >= v2 >= 0.
    a1, a2 = (1 - 2 * e) / -3, -(1 + e) / 3
    a2 = -e * a2
    p = (1 + e) * (a2 - a1) * Fraction(2, 3)
    b1, b2 = a1 + p, a2 - p / 2
    assert b1 >= b2 >= 0
    for name in SEQUENTIAL:
        o = get_solver(name).solve(c)
        assert (o.v1, o.v2) == pytest.approx((float(b1), float(b2)), abs=1e-15)
        assert o.states == ("S1", "S2", "S3", "S4")
    # Generalised reflections: the elastic sequence, times e, on the plastic impact, after which both are at rest.
    o = get_solver("generalised-reflection").solve(c)
    assert (o.v1, o.v2) == pytest.approx((float(e * Fraction(7, 9)), float(e * Fraction(4, 9))), abs=1e-15)


def test_where_poisson_parts_from_newton():
    # A ball of e1 = 0 on a ball that the table throws back: under Newton B2 is pressed down and stays, whatever e2;
    # under Poisson the table returns e2 times what it took. m = 1, 1: p_C = 1, 1; p_E2 >= e2, p_E1 keeps them together.
    o = get_solver("newton").solve(Collision(1.0, 1.0, 1.0, 1.0, 0.0, 0.5))
    assert (o.v1, o.v2) == (0.0, 0.0)
    o = get_solver("poisson").solve(Collision(1.0, 1.0, 1.0, 1.0, 0.0, 0.5))
    assert (o.v1, o.v2) == pytest.approx((0.25, 0.25))
    assert (o.impulse1, o.impulse2) == pytest.approx((1.25, 1.5))


# --- what others say ---


@pytest.mark.parametrize(("strikers", "balls"), [(1, 3), (1, 5), (2, 5)])
def test_cradles_of_equal_elastic_balls(strikers, balls):
    first = (-1.0,) * strikers + (0.0,) * (balls - strikers)
    # As many balls leave as struck: what single impacts give, and, as Smith and others (2012) say, reflections.
    for name in (*SEQUENTIAL, "generalised-reflection"):
        assert velocities(name, (1,) * balls, 1.0, first) == pytest.approx(first[::-1])
    # All at once: the striking ones and the struck ones are two bodies, elastic between them.
    n, m = strikers, balls - strikers
    back, on = -(n - m) / balls, -2 * n / balls
    for name in ("newton", "poisson"):
        assert velocities(name, (1,) * balls, 1.0, first) == pytest.approx((back,) * n + (on,) * m)


def test_reflections_keep_the_symmetry_that_sequences_break():
    # Smith and others (2012) ask for both of one law: a middle ball that is struck from both sides stays, here.
    struck = ((1.0, 4.0, 1.0), 1.0, (-1.0, 0.0, 1.0))
    assert velocities("generalised-reflection", *struck) == pytest.approx((1.0, 0.0, -1.0))
    top, bottom = (velocities(name, *struck) for name in SEQUENTIAL)
    assert abs(top[1]) > 0.01
    assert top == pytest.approx([-v for v in bottom[::-1]])


def test_an_elastic_stack_rebounds_as_one_body_under_every_law_of_equal_balls():
    for name in LAWS:
        assert velocities(name, (1, 1, 1), 1.0, (-1,) * 3, table=True) == pytest.approx((1, 1, 1))


# --- what a law promises ---


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("e", [0.0, 0.3, 1.0])
def test_one_contact_returns_exactly_its_restitution(name, e):
    v1, v2 = velocities(name, (1.5, 4.0), e, (-2.0, 1.0))
    assert v1 - v2 == pytest.approx(3 * e, abs=1e-15)
    assert 1.5 * v1 + 4 * v2 == pytest.approx(1.0, abs=1e-15)
    assert velocities(name, (0.7,), e, (-2.0,), table=True) == pytest.approx((2 * e,), abs=1e-15)


@pytest.mark.parametrize("receding", [False, True])
@pytest.mark.parametrize("name", LAWS)
def test_energy_does_not_grow_nor_momentum_change_and_nothing_approaches(name, receding):
    rng = np.random.default_rng(10)
    for _ in range(150):
        c = drawn(rng, equal=name == "generalised-reflection", receding=receding and name != "newton")
        o = get_solver(name).solve_column(c)
        assert o.retained_energy(c) <= 1 + 1e-12
        v, p = np.array(o.velocities), np.array(o.impulses)
        assert (np.diff(v) <= 0).all()
        assert (p >= 0).all()
        kept = np.append(p, np.zeros(1 - c.table)) - np.append(0.0, p)[: len(v)]
        assert np.array(c.masses) * (v - c.velocities) == pytest.approx(kept, abs=1e-11)
        if c.table:
            assert v[-1] >= 0


def test_newtons_law_gains_energy_where_a_contact_recedes():
    # docs/rigid.md, section 3. Ball 2 recedes from ball 3 at 1/2; ball 1 would drive it into ball 3.
    c = column((1, 1, 4), (1, 0), (-2, 0, -0.5))
    o = get_solver("newton").solve_column(c)
    # u+ = (2, 0): balls 2 and 3 leave as one at v, ball 1 at v + 2; momentum 6 v + 2 = -2 - 2.
    assert o.velocities == pytest.approx((1, -1, -1))
    before, after = 4 + 4 / 4, 1 + 1 + 4
    assert o.retained_energy(c) == pytest.approx(after / before)
    # As much as a half of the impulse at the receding contact times its rate, the formula (2) of `rigid.laws`.
    assert (after - before) / 2 == pytest.approx(o.impulses[1] * 0.5 / 2)


@pytest.mark.parametrize("name", LAWS)
def test_scales_and_mirrors(name):
    rng = np.random.default_rng(11)
    other = {"sequential-top": "sequential-bottom", "sequential-bottom": "sequential-top"}.get(name, name)
    for _ in range(40):
        c = drawn(rng, equal=name == "generalised-reflection", receding=True)
        base = np.array(get_solver(name).solve_column(c).velocities)
        scaled = column(np.array(c.masses) * 3e-7, c.restitutions, np.array(c.velocities) * 7e4, c.table)
        # Where rounding decides whether bodies at one velocity approach, the impacts are of its size too.
        assert np.array(get_solver(name).solve_column(scaled).velocities) / 7e4 == pytest.approx(
            base, abs=1e-11
        )
        if not c.table:
            mirrored = get_solver(other).solve_column(c.reversed())
            assert mirrored.velocities == pytest.approx(-base[::-1], abs=1e-11)


def test_mirrored_stiffness_and_exponent_do_not_matter():
    for name in LAWS:
        one = get_solver(name).solve(Collision(1.0, 0.4, 1.0, 7.0, 0.5, 0.5))
        other = get_solver(name).solve(Collision(1.0, 0.4, 3e5, math.inf, 0.5, 0.5))
        assert (one.v1, one.v2) == (other.v1, other.v2)


def test_a_column_of_two_balls_on_a_table_is_the_collision():
    for name in LAWS:
        o = get_solver(name).solve(Collision(1.0, 0.4, 1.0, 7.0, 0.5, 0.5, v0=-3.0))
        assert velocities(name, (1, 0.4), 0.5, (-3, 0), table=True) == (o.v1, o.v2)


def test_long_chains_are_solved():
    for name in LAWS:
        v = velocities(name, (1,) * 200, 1.0, (-1,) + (0,) * 199)
        assert sum(v) == pytest.approx(-1.0)


def test_the_figures_of_the_page_are_those_of_the_solvers():
    cases = {
        "basic collision": ((1, 2), (-1, 0), True),
        "cradle 1 on 2": ((1,) * 3, (-1, 0, 0), False),
        "cradle 1 on 4": ((1,) * 5, (-1, 0, 0, 0, 0), False),
        "cradle 2 on 3": ((1,) * 5, (-1, -1, 0, 0, 0), False),
        "stack of 3": ((1,) * 3, (-1,) * 3, True),
    }
    page = (Path(__file__).parents[3] / "docs/rigid.md").read_text(encoding="utf-8")
    names = (("newton", "poisson"), *((name,) for name in LAWS[2:]))
    rows = re.findall(r"^\| (.*) \|$", page.split("<!-- figures -->")[1], re.M)[2:]
    assert len(rows) == 3 * len(cases)
    for case, e, *cells in (row.split(" | ") for row in rows):
        masses, first, table = cases[case]
        for cell, these in zip(cells, names, strict=True):
            for name in these:
                found = velocities(name, masses, float(e), first, table)
                assert found == pytest.approx([float(v) for v in cell.split()], abs=5.1e-5)
