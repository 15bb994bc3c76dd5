"""When a drop is over, and when it is in flight: two balls on a table, the lower one settled, with gravity.

`drop_ending` tells how a drop is over, `in_flight` whether gravity ends, `fall_time` how long a window without forces
may be, `over_within` when inside a window a drop is over.

docs/theory.md, section 8, defines over, settled and in flight. A drop becomes over

* where a contact opens, or B1 and B2 reach the same velocity; both are ends of windows; or
* where the energy about equilibrium falls to the energy that unloads the contacts. While the same contacts are active
  that energy only falls, so its value at the end of a window tells, and bisection finds the instant.

**Settling.** With both contacts loaded the motion is linear. About its equilibrium it is a sum of four terms
a_j v_j exp(lambda_j t), none of which grows. The force that they add to the weight that a contact carries stays below
the sum of their magnitudes now. While these sums are below m1 g and (m1 + m2) g, no contact lets go, and the drop is
over however slowly its energy falls: two balls whose damped contact is far stiffer than the elastic one ring on for
millions of periods. Next to critical damping eigenvectors are nearly parallel, and nothing is certified until the
motion has died down. Nor does a contact let go that may pull: where k delta + c delta' > 0 from now on, delta > 0 too.

Units: m1 = 1, and 1/a[1] is m2. Used by `chain.kernel`.
"""

from __future__ import annotations

from math import inf, sqrt

from impact_xval.model.chain.laws import Law, equilibrium_depth, is_active
from impact_xval.model.chain.record import ChainEnding
from impact_xval.model.chain.series import place
from impact_xval.model.compiled import kernel_helper
from impact_xval.model.pair.law import Phase

#: Number of windows without an event after which `settles` is asked, and again after as many more.
QUIET = 6

#: Share of a bound that rounding may make.
_ROUNDING = 1e-9

#: Most steps to the four eigenvalues; some 30 are needed.
_MOST_STEPS = 400


@kernel_helper
def excess_energy_on_table(last):
    """Return twice the last body's energy about its equilibrium, less what unloads its contact; settled if <= 0."""
    weight = last.g / last.a
    kinetic = last.w * last.w / last.a
    return kinetic + last.k * last.delta * last.delta - weight * weight / last.k


@kernel_helper
def excess_energy_of_both(upper, lower):
    """Return twice the energy of both balls about their equilibrium, less what unloads a contact; settled if <= 0."""
    g, mass = lower.g, 1 / lower.a
    u1 = upper.delta - g / (upper.a * upper.k)
    u2 = lower.delta - g / (upper.a * lower.k)
    v2 = -lower.w
    v1 = v2 - upper.w
    energy = v1 * v1 / upper.a + mass * v2 * v2 + upper.k * u1 * u1 + lower.k * u2 * u2
    total = 1 / upper.a + mass
    return energy - g * g * min(1 / (upper.a * upper.a * upper.k), total * total / lower.k)


@kernel_helper
def ending_in_state(c, n):
    """Return how a drop is over in the state that it is in, or `UNFINISHED`."""
    if n == 0:
        return ChainEnding.BOTH_SETTLED
    upper, lower = c[0], c[1]
    if n == 1:
        if is_active(upper):
            return ChainEnding.BOTH_SETTLED if excess_energy_on_table(upper) <= 0 else ChainEnding.UNFINISHED
        if upper.w > 0:
            return ChainEnding.UNFINISHED
        b2_is_part_of_table = lower.balls > 0
        return ChainEnding.LOWER_SETTLED if b2_is_part_of_table else ChainEnding.FREE
    if is_active(upper):
        both_settled = is_active(lower) and excess_energy_of_both(upper, lower) <= 0
        return ChainEnding.BOTH_SETTLED if both_settled else ChainEnding.UNFINISHED
    if upper.w <= 0 and upper.delta <= 0:
        v2 = -lower.w
        if not is_active(lower) and v2 >= 0 and lower.delta + equilibrium_depth(lower) <= 0:
            return ChainEnding.FREE
        if v2 - upper.w >= 0 and excess_energy_on_table(lower) <= 0:
            return ChainEnding.LOWER_SETTLED
    return ChainEnding.UNFINISHED


@kernel_helper
def drop_ending(c, n, settling_is_due):
    """Return how a drop is over, or `UNFINISHED`; `settling_is_due` asks whether it only settles from here on."""
    ending = ending_in_state(c, n)
    is_linear = n == 2 and (c[0].law == Law.KELVIN_VOIGT or c[0].law == Law.LINEAR_DASHPOT)
    if not settling_is_due or not is_linear or ending != ChainEnding.UNFINISHED:
        return ending
    both_loaded = is_active(c[0]) and is_active(c[1])
    return ChainEnding.BOTH_SETTLED if both_loaded and settles(c[0], c[1]) else ending


@kernel_helper
def in_flight(c, n):
    """Return whether all contacts of a drop are open, and no ball is part of the table."""
    for i in range(n):
        if c[i].phase != Phase.INACTIVE:
            return False
    return c[n].balls == 0


@kernel_helper
def fall_time(c, n):
    """Return a time after which, without forces, a gap has closed or a penetration is gone; infinite without any.

    It is half as long again as the time until then, so that the event lies well inside the window.
    """
    first, last = inf, c[n - 1]
    g = last.g
    if n > 1 and c[0].delta * c[0].w < 0:
        first = -c[0].delta / c[0].w
    height, v = -last.delta - equilibrium_depth(last), -last.w
    square, second = v * v + 2 * g * height, inf
    if height < 0 and v > 0:
        # Out of the table: at the surface, or at the top of a flight that never gets there.
        second = -2 * height / (v + sqrt(square)) if square > 0 else v / g
    elif height >= 0:
        root = sqrt(square)
        if v > 0:
            second = (v + root) / g
        elif height > 0:
            second = 2 * height / (root - v)
        else:
            second = 0.0
    return 1.5 * min(first, second)


@kernel_helper
def excess_energy_at(c, n, x, work):
    """Move the chain to x of its window, and return twice the energy there beyond the energy that ends the drop."""
    place(c, n, x, work)
    return excess_energy_of_both(c[0], c[1]) if is_active(c[0]) else excess_energy_on_table(c[n - 1])


@kernel_helper
def over_within(c, n, x, work):
    """Return when before x of a window the energy falls to the energy that ends the drop; x if it does not.

    At the instant that is returned the energy has fallen.
    """
    may_end = is_active(c[1])
    if not is_active(c[0]):
        # B1 must be clear of B2 and not approach. Neither changes within a window, and B1's own velocity only falls.
        rates, deltas = work[0].rates, work[0].deltas
        may_end = deltas[0] <= 0 and (rates[0] < 0 or (rates[0] == 0 and rates[1] <= 0))
    if not may_end or excess_energy_at(c, n, 0.0, work) <= 0 or excess_energy_at(c, n, x, work) > 0:
        return x
    low, high = 0.0, x
    for _ in range(60):
        middle = 0.5 * (low + high)
        if excess_energy_at(c, n, middle, work) > 0:
            low = middle
        else:
            high = middle
        if high - low <= 2.0**-52 * high:
            break
    place(c, n, high, work)
    return high if ending_in_state(c, n) != ChainEnding.UNFINISHED else x


@kernel_helper
def quartic_roots(p0, p1, p2, p3, p4):
    """Return the four complex roots of p0 + p1 z + p2 z^2 + p3 z^3 + p4 z^4, for positive coefficients.

    All are found together (Aberth, Mathematics of Computation 27:339, 1973).
    """
    size, converged = (p0 / p4) ** 0.25, 0
    z0, z1 = size * complex(0.8, 0.6), size * complex(-0.6, 0.8)
    z2, z3 = size * complex(-0.8, -0.6), size * complex(0.6, -0.8)
    for _ in range(_MOST_STEPS):
        z = z0
        f = (((p4 * z + p3) * z + p2) * z + p1) * z + p0
        rise = ((4 * p4 * z + 3 * p3) * z + 2 * p2) * z + p1
        step = f / (rise - f * (1 / (z - z1) + 1 / (z - z2) + 1 / (z - z3)))
        z0, z1, z2, z3 = z1, z2, z3, z - step
        converged = converged + 1 if abs(step) <= 1e-14 * abs(z) else 0
        if converged == 4:
            break
    return z0, z1, z2, z3


@kernel_helper
def modal_bounds(roots, upper, lower):
    """Return bounds of what both forces add to the weights that they carry, from now on, by the eigenvalues `roots`.

    In the compressions u beyond equilibrium the motion is M u" + C u' + K u = 0, with M = ((1, 1), (1, 1 + m2)) and
    diagonal C and K. All three are symmetric, so an eigenvector is a left eigenvector too, which gives its share of the
    state at once.
    """
    mu, k1, k2, c1, c2, g = 1 / lower.a, upper.k, lower.k, upper.b, lower.b, lower.g
    u1, u2, d1, d2 = upper.delta - g / k1, lower.delta - g / k2, upper.w, lower.w
    bound1, bound2 = 0.0, 0.0
    for z in roots:
        square = z * z
        row1, row2 = square + c1 * z + k1, (1 + mu) * square + c2 * z + k2
        size1 = abs(square) + abs(c1 * z) + k1
        size2 = (1 + mu) * abs(square) + abs(c2 * z) + k2
        # The eigenvector comes from the row that loses fewer digits. Its share by those of the other roots is 0.
        from_row1 = abs(row1) * size2 > abs(row2) * size1
        x1, x2 = (-square, row1) if from_row1 else (row2, -square)
        share = x1 * (z * (u1 + u2) + c1 * u1 + d1 + d2) + x2 * (
            z * (u1 + (1 + mu) * u2) + c2 * u2 + d1 + (1 + mu) * d2
        )
        share /= x1 * (2 * z * (x1 + x2) + c1 * x1) + x2 * (2 * z * (x1 + (1 + mu) * x2) + c2 * x2)
        bound1 += abs(share * (k1 + c1 * z) * x1)
        bound2 += abs(share * (k2 + c2 * z) * x2)
    return bound1, bound2


@kernel_helper
def settles(upper, lower):
    """Return whether neither contact of two balls on a table, both loaded now, will ever let go."""
    mu, k1, k2, c1, c2, g = 1 / lower.a, upper.k, lower.k, upper.b, lower.b, lower.g
    u1, u2 = upper.delta - g / k1, lower.delta - g / k2
    weight1, weight2 = g, (1 + mu) * g
    if not (abs(k1 * u1 + c1 * upper.w) < weight1 and abs(k2 * u2 + c2 * lower.w) < weight2):
        return False
    roots = quartic_roots(k1 * k2, c1 * k2 + c2 * k1, k2 + c1 * c2 + (1 + mu) * k1, c2 + (1 + mu) * c1, mu)
    bound1, bound2 = modal_bounds(roots, upper, lower)
    return bound1 < (1 - _ROUNDING) * weight1 and bound2 < (1 - _ROUNDING) * weight2
