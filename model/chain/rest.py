"""When a drop is over, and when it is in flight: two balls on a table, the lower one settled, with gravity.

docs/theory.md, section 8, says what over, at rest and in flight are. The three ways to be over become true

* where a contact opens or B1 and B2 reach the same velocity, which are borders of pieces, or
* where energy about equilibrium falls to what it takes to unload the contacts. While the same contacts carry force that
  energy only falls, so that its value at the end of a piece tells, and bisection finds the instant.

**Settling.** With both contacts loaded the motion is linear, and about its equilibrium a sum of four terms
a_j v_j exp(lambda_j t), none of which grows. What they add to a force beyond the weight that the contact carries stays
below the sum of its magnitudes now; while these are below m1 g and (m1 + m2) g no contact lets go, and how slowly the
energy falls no longer matters: two balls whose damped contact is far stiffer than the elastic one ring on for millions
of periods. Next to critical damping eigenvectors are nearly parallel, and nothing is certified until the motion has
died down.

Units: m1 = 1, and 1/a[1] is m2.
"""

from __future__ import annotations

from math import inf, sqrt

from impact_xval.model.chain.laws import KELVIN_VOIGT, carries, rest
from impact_xval.model.chain.series import place
from impact_xval.model.compiled import uncounted
from impact_xval.model.pair.law import INACTIVE

#: How a collision ended: the balls left the table, B1 left B2 at rest on it, B1 came to rest on B2; or it goes on.
GOING, FREE, REST, STUCK = 0, 1, 2, 3

#: Pieces without an event after which it is examined whether the balls of a drop only settle any more.
QUIET = 6

#: What rounding leaves of a bound.
_ROUNDING = 1e-9

#: Steps to the eigenvalues; some 30 are needed.
_MOST_STEPS = 400


@uncounted
def on_table(last):
    """Energy of the last body about its rest on the table beyond what unloads its contact, times 2; at rest if <= 0."""
    weight = last.g / last.a
    return last.w * last.w / last.a + last.k * last.delta * last.delta - weight * weight / last.k


@uncounted
def on_each_other(one, two):
    """Energy of both balls about their common rest beyond what unloads a contact, times 2; stuck if <= 0."""
    g, mass = two.g, 1 / two.a
    u1, u2 = one.delta - g / (one.a * one.k), two.delta - g / (one.a * two.k)
    v2 = -two.w
    v1 = v2 - one.w
    energy = v1 * v1 / one.a + mass * v2 * v2 + one.k * u1 * u1 + two.k * u2 * u2
    whole = 1 / one.a + mass
    return energy - g * g * min(1 / (one.a * one.a * one.k), whole * whole / two.k)


@uncounted
def how_over(c, n):
    """`FREE`, `REST` or `STUCK` if a collision with gravity is over in this state, else `GOING`."""
    if n == 0:
        return STUCK
    one, two = c[0], c[1]
    if n == 1:
        if carries(one):
            return STUCK if on_table(one) <= 0 else GOING
        return GOING if one.w > 0 else REST if two.balls > 0 else FREE
    if carries(one):
        return STUCK if carries(two) and on_each_other(one, two) <= 0 else GOING
    if one.w <= 0 and one.delta <= 0:
        v2 = -two.w
        if not carries(two) and v2 >= 0 and two.delta + rest(two) <= 0:
            return FREE
        if v2 - one.w >= 0 and on_table(two) <= 0:
            return REST
    return GOING


@uncounted
def in_flight(c, n):
    """Whether no contact of two balls on a table is closed, and none of them is part of the table."""
    for i in range(n):
        if c[i].phase != INACTIVE:
            return False
    return c[n].balls == 0


@uncounted
def fall_time(c, n):
    """Bound the time until, while no contact carries force, a gap closes or a penetration is gone.

    Half as long again as that time, so that the event itself lies well inside; infinite if there is none.
    """
    first, last = inf, c[n - 1]
    g = last.g
    if n > 1 and c[0].delta * c[0].w < 0:
        first = -c[0].delta / c[0].w
    height, v = -last.delta - rest(last), -last.w
    square, second = v * v + 2 * g * height, inf
    if height < 0 and v > 0:
        # Out of the table: at the surface, or at the top of a flight that never gets there.
        second = -2 * height / (v + sqrt(square)) if square > 0 else v / g
    elif height >= 0:
        root = sqrt(square)
        second = (v + root) / g if v > 0 else 2 * height / (root - v) if height > 0 else 0.0
    return 1.5 * min(first, second)


@uncounted
def excess(c, n, x, work):
    """Energy at x of a piece beyond what ends the collision; the chain is put there."""
    place(c, n, x, work)
    return on_each_other(c[0], c[1]) if carries(c[0]) else on_table(c[n - 1])


@uncounted
def over_within(c, n, x, work):
    """When in a piece that ends at x in (0, 1] energy falls to what ends the collision; x if it does not.

    The instant returned is one at which it has fallen.
    """
    loaded1, rates, deltas = carries(c[0]), work[0].rates, work[0].deltas
    watched = carries(c[1])
    if not loaded1:
        # B1 clear of B2, and not approaching: neither changes within a piece. Its own velocity only falls.
        watched = deltas[0] <= 0 and (rates[0] < 0 or (rates[0] == 0 and rates[1] <= 0))
    if not watched or excess(c, n, 0.0, work) <= 0 or excess(c, n, x, work) > 0:
        return x
    low, high = 0.0, x
    for _ in range(60):
        middle = 0.5 * (low + high)
        if excess(c, n, middle, work) > 0:
            low = middle
        else:
            high = middle
        if high - low <= 2.0**-52 * high:
            break
    place(c, n, high, work)
    return high if how_over(c, n) != GOING else x


@uncounted
def settled(one, two):
    """Whether neither contact of two balls on a table, both of which are loaded, will ever let go.

    In the compressions u beyond equilibrium M u" + C u' + K u = 0, with M = ((1, 1), (1, 1 + m2)) and diagonal C and K.
    All are symmetric, so that an eigenvector is a left one too, which gives its share of the state at once; the four
    eigenvalues are found together (Aberth, Mathematics of Computation 27:339, 1973).
    """
    mu, k1, k2, c1, c2, g = 1 / two.a, one.k, two.k, one.b, two.b, two.g
    u1, u2, d1, d2 = one.delta - g / k1, two.delta - g / k2, one.w, two.w
    if not (abs(k1 * u1 + c1 * d1) < g and abs(k2 * u2 + c2 * d2) < (1 + mu) * g):
        return False
    p0, p1, p2, p3 = k1 * k2, c1 * k2 + c2 * k1, k2 + c1 * c2 + (1 + mu) * k1, c2 + (1 + mu) * c1
    size, bound1, bound2, calm = (p0 / mu) ** 0.25, 0.0, 0.0, 0
    z0, z1 = size * complex(0.8, 0.6), size * complex(-0.6, 0.8)
    z2, z3 = size * complex(-0.8, -0.6), size * complex(0.6, -0.8)
    for _ in range(_MOST_STEPS):
        z = z0
        f = (((mu * z + p3) * z + p2) * z + p1) * z + p0
        rise = ((4 * mu * z + 3 * p3) * z + 2 * p2) * z + p1
        step = f / (rise - f * (1 / (z - z1) + 1 / (z - z2) + 1 / (z - z3)))
        z0, z1, z2, z3 = z1, z2, z3, z - step
        calm = calm + 1 if abs(step) <= 1e-14 * abs(z) else 0
        if calm == 4:
            break
    for z in (z0, z1, z2, z3):
        square = z * z
        row1, row2 = square + c1 * z + k1, (1 + mu) * square + c2 * z + k2
        size1, size2 = abs(square) + abs(c1 * z) + k1, (1 + mu) * abs(square) + abs(c2 * z) + k2
        # The eigenvector, of the row that loses fewer digits; its share by those of the other roots is 0.
        x1, x2 = (-square, row1) if abs(row1) * size2 > abs(row2) * size1 else (row2, -square)
        share = x1 * (z * (u1 + u2) + c1 * u1 + d1 + d2) + x2 * (
            z * (u1 + (1 + mu) * u2) + c2 * u2 + d1 + (1 + mu) * d2
        )
        share /= x1 * (2 * z * (x1 + x2) + c1 * x1) + x2 * (2 * z * (x1 + (1 + mu) * x2) + c2 * x2)
        bound1 += abs(share * (k1 + c1 * z) * x1)
        bound2 += abs(share * (k2 + c2 * z) * x2)
    return bound1 < (1 - _ROUNDING) * g and bound2 < (1 - _ROUNDING) * (1 + mu) * g


@uncounted
def how_ended(c, n, due):
    """Tell how a collision with gravity is over, or that it goes on; `due`: examine if it only settles any more."""
    end = how_over(c, n)
    if due and end == GOING and c[0].law == KELVIN_VOIGT and n == 2 and carries(c[0]) and carries(c[1]):
        return STUCK if settled(c[0], c[1]) else GOING
    return end
