"""The end of a drop: ball B1 falls with gravity on ball B2, which has settled on the table.

`drop_ending` returns whether a drop is over, and how it ended. `in_flight` returns whether no ball touches another
body; from then on gravity is off. `fall_time` returns the length of a window without forces. `over_within` finds the
time within a window at which a drop is over. docs/theory.md, section 8, has the definitions.

A drop can become over in two ways:

* A contact opens, or B1 and B2 reach the same velocity. A window ends at each of these times.
* The energy about equilibrium falls to the energy that is needed to unload the contacts. This energy never rises while
  the same contacts are active. So its value at the end of a window shows whether the drop became over within the
  window. Bisection finds the time.

**Settling.** While both contacts are loaded, the motion is linear. About its equilibrium it is a sum of four terms
a_j v_j exp(lambda_j t), none of which grows. These terms add a force to the weight that a contact carries. The added
force never exceeds the sum of the present magnitudes of its terms. Once this sum is below m1 g in contact 1 and below
(m1 + m2) g in contact 2, both contacts stay loaded for ever, and the drop is over. The test by energy may need far
longer: if the damped contact of two balls is far stiffer than the elastic contact, they oscillate for millions of
periods.

Near critical damping the eigenvectors are nearly parallel and the sums are large. The test then succeeds only after the
motion has died down. The test is also valid for contacts that may pull: while k delta + c delta' stays positive, delta
stays positive.

Units: m1 = 1, and 1/a[1] is m2.

Used by `chain.kernel`.
"""

from __future__ import annotations

from math import inf, sqrt

from impact_xval.model.chain.laws import Law, equilibrium_depth, is_active
from impact_xval.model.chain.record import ChainEnding
from impact_xval.model.chain.series import place
from impact_xval.model.compiled import kernel_helper
from impact_xval.model.pair.law import Phase

#: `settles` is called whenever this number of windows has passed without an event.
QUIET = 6

#: Rounding error of a bound of `modal_bounds`, as a share of the bound.
_ROUNDING = 1e-9

#: Largest number of iterations of `quartic_roots`; about 30 are needed.
_MOST_STEPS = 400


@kernel_helper
def excess_energy_on_table(last):
    """Return twice the energy that the last body has beyond the energy that it needs to lift off the table.

    The energy is counted from equilibrium. The body has settled if the result is not positive.
    """
    weight = last.g / last.a
    kinetic = last.w * last.w / last.a
    return kinetic + last.k * last.delta * last.delta - weight * weight / last.k


@kernel_helper
def excess_energy_of_both(upper, lower):
    """Return twice the energy that both balls have beyond the least energy that can unload one of their contacts.

    The energy is counted from equilibrium. Both balls have settled if the result is not positive.
    """
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
    """Return how a drop has ended, as far as its present state shows it; `UNFINISHED` if the state shows no end."""
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
    """Return how a drop has ended, or `UNFINISHED`.

    If `settling_is_due` is true, a drop is also over if `settles` shows that its contacts will stay loaded for ever.
    """
    ending = ending_in_state(c, n)
    is_linear = n == 2 and (c[0].law == Law.KELVIN_VOIGT or c[0].law == Law.LINEAR_DASHPOT)
    if not settling_is_due or not is_linear or ending != ChainEnding.UNFINISHED:
        return ending
    both_loaded = is_active(c[0]) and is_active(c[1])
    return ChainEnding.BOTH_SETTLED if both_loaded and settles(c[0], c[1]) else ending


@kernel_helper
def in_flight(c, n):
    """Return whether all contacts of a drop are open, and no rigid contact holds a ball on the table."""
    for i in range(n):
        if c[i].phase != Phase.INACTIVE:
            return False
    return c[n].balls == 0


@kernel_helper
def fall_time(c, n):
    """Return the length of a window without forces; infinite if no event will come.

    An event is the closing of a gap, or the end of an overlap of bodies. The window is 1.5 times as long as the time to
    the first event, so that the event lies well inside the window.
    """
    first, last = inf, c[n - 1]
    g = last.g
    if n > 1 and c[0].delta * c[0].w < 0:
        first = -c[0].delta / c[0].w
    height, v = -last.delta - equilibrium_depth(last), -last.w
    square, second = v * v + 2 * g * height, inf
    if height < 0 and v > 0:
        # The ball rises while it overlaps the table. The window lasts until it reaches the surface, or the top of its
        # flight if that is below the surface.
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
    """Move the chain to the place x of its window, and return twice its excess of energy at that place.

    The excess is the difference between its energy and the energy at which the drop is over.
    """
    place(c, n, x, work)
    return excess_energy_of_both(c[0], c[1]) if is_active(c[0]) else excess_energy_on_table(c[n - 1])


@kernel_helper
def over_within(c, n, x, work):
    """Return the first place of a window, before x, at which the energy shows that the drop is over; else x.

    At the returned place the energy is already at or below its bound.
    """
    may_end = is_active(c[1])
    if not is_active(c[0]):
        # B1 must be clear of B2 and must not approach it. Each condition is true throughout a window or not at all,
        # and B1's own velocity only falls.
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

    Aberth's iteration finds all four roots together (Mathematics of Computation 27:339, 1973).
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
    """Return upper bounds, for all later times, of the forces that the motion adds to the weights in both contacts.

    `roots` are the eigenvalues of the motion. The compressions u beyond equilibrium obey M u" + C u' + K u = 0, with
    M = ((1, 1), (1, 1 + m2)) and diagonal matrices C and K. All three matrices are symmetric, so each eigenvector is a
    left eigenvector too. A product with a left eigenvector gives the share that its mode has in the present state.
    """
    mu, k1, k2, c1, c2, g = 1 / lower.a, upper.k, lower.k, upper.b, lower.b, lower.g
    u1, u2, d1, d2 = upper.delta - g / k1, lower.delta - g / k2, upper.w, lower.w
    bound1, bound2 = 0.0, 0.0
    for z in roots:
        square = z * z
        row1, row2 = square + c1 * z + k1, (1 + mu) * square + c2 * z + k2
        size1 = abs(square) + abs(c1 * z) + k1
        size2 = (1 + mu) * abs(square) + abs(c2 * z) + k2
        # The eigenvector is computed from the row of the matrix that loses fewer digits.
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
    """Return whether both contacts of two balls on a table, which are loaded now, certainly stay loaded for ever."""
    mu, k1, k2, c1, c2, g = 1 / lower.a, upper.k, lower.k, upper.b, lower.b, lower.g
    u1, u2 = upper.delta - g / k1, lower.delta - g / k2
    weight1, weight2 = g, (1 + mu) * g
    if not (abs(k1 * u1 + c1 * upper.w) < weight1 and abs(k2 * u2 + c2 * lower.w) < weight2):
        return False
    roots = quartic_roots(k1 * k2, c1 * k2 + c2 * k1, k2 + c1 * c2 + (1 + mu) * k1, c2 + (1 + mu) * c1, mu)
    bound1, bound2 = modal_bounds(roots, upper, lower)
    return bound1 < (1 - _ROUNDING) * weight1 and bound2 < (1 - _ROUNDING) * weight2
