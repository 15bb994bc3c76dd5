"""The grazing margin of a chain: how near the collision is to a jump of its outcome (docs/theory.md, section 6).

The outcome jumps where the rate of compression of an active contact touches zero without crossing it. The margin is the
smallest relative size of such a rate at a turning point: its magnitude, divided by its amplitude. `near_misses` updates
the margin after a window, and `amplitude` returns the amplitude. While the set of active contacts stays the same, a
rate is a sum of sinusoids; its amplitude is the sum of their amplitudes. If forces are not linear, the motion is
linearised at the turning point.

Let K be the diagonal matrix of the stiffnesses, and A the tridiagonal matrix of inverse masses (`chain.series`). Then
w'' = -A K w, and z = K^(1/2) w obeys z'' = -S z with the symmetric tridiagonal matrix S = K^(1/2) A K^(1/2). A unit
eigenvector u of S adds to the rate w_i a sinusoid of the amplitude

    abs(u_i)/k_i^(1/2) sqrt((u z)^2 + (u z')^2/eigenvalue).

Of each eigenvector only the numbers u_i, u z and u z' are needed. The QL method diagonalises S by rotations. The same
rotations are applied to three rows, which start as the unit vector i, z and z'. This turns the rows into u_i, u z and
u z' for all eigenvectors. (Golub and Welsch, Math. Comp. 23:221, 1969, do the same for one component.)

Used by `chain.kernel`.
"""

from __future__ import annotations

from math import copysign, hypot, inf, sqrt

from impact_xval.model.chain.laws import equilibrium_depth, is_active
from impact_xval.model.chain.roots import first_root
from impact_xval.model.chain.series import slope, value
from impact_xval.model.compiled import kernel_helper
from impact_xval.model.pair.grazing import NEAR, STAKE

#: Indices into the array `watched` of the workspace, which is not used otherwise at that time. They hold the diagonal
#: and the subdiagonal of S, and the three rows that become u_i, u z and u z'.
DIAGONAL, BESIDE, UNIT, RATES, SLOPES = range(5)

#: Largest number of iterations of the QL method for one eigenvalue; two or three are enough.
MOST_ITERATIONS = 60

#: Relative rounding of double precision. An eigenvalue below this share of the largest eigenvalue is only rounding.
EPSILON = 2.0**-52


@kernel_helper
def near_misses(c, n, degree, x, h, energy, margin, work):
    """Return the smaller one of `margin`, the grazing margin so far, and the smallest quotient within a window.

    The window has the length h, and is searched from its start to the time x h, at which the chain is. `energy` is the
    energy of impact.
    """
    for i in range(n):
        contact, scratch = c[i], work[i]
        if not is_active(contact) or contact.e == 1:
            continue
        # Up to x the rate of this contact has one sign, so its load is largest at the start or at x.
        load = max(scratch.deltas[0] + equilibrium_depth(contact), contact.delta + equilibrium_depth(contact))
        least = STAKE * energy / (1 - contact.e * contact.e)
        if contact.k * max(load, 0.0) ** (contact.p + 1) / (contact.p + 1) <= least:
            continue
        write_slope(scratch.rates, degree, scratch.watched)
        at = 0.0
        while True:
            to_turn = first_turn(scratch.watched, degree, x - at)
            if not 0 < to_turn < x - at:
                break
            at += to_turn
            pressed = max(value(scratch.deltas, degree, at) + equilibrium_depth(contact), 0.0)
            if contact.k * pressed ** (contact.p + 1) / (contact.p + 1) > least:
                rate = abs(value(scratch.rates, degree, at))
                if rate < min(margin, NEAR) * largest_amplitude(c, n, i, degree, at, h, work):
                    share = rate / amplitude(c, n, i, degree, at, h, work)
                    margin = share if share < min(margin, NEAR) else margin
                    write_slope(scratch.rates, degree, scratch.watched)
                    to_turn = at
            shift(scratch.watched, degree - 1, to_turn)
            scratch.watched[0] = 0.0
    return margin


@kernel_helper
def write_slope(coefficients, degree, derivative):
    """Write the coefficients of the derivative of a polynomial into the array `derivative`."""
    for j in range(degree):
        derivative[j] = (j + 1) * coefficients[j + 1]
    derivative[degree] = 0.0


@kernel_helper
def first_turn(derivative, degree, reach):
    """Return the first turning point of a polynomial in (0, reach), given its derivative; infinity if there is none.

    `degree` is the degree of the polynomial, not of the derivative.
    """
    start = derivative[0]
    leading = start
    for j in range(1, degree):
        leading = derivative[j] if leading == 0 else leading
    return first_root(derivative, copysign(1.0, leading), abs(start), degree - 1, reach)


@kernel_helper
def shift(coefficients, degree, x):
    """Replace the coefficients of a polynomial in powers of t by the coefficients in powers of t - x, in place."""
    for low in range(degree):
        for j in range(degree - 1, low - 1, -1):
            coefficients[j] += x * coefficients[j + 1]


@kernel_helper
def stiffness_at(contact, scratch, degree, x):
    """Return the stiffness dF/ddelta of a contact at the place x of a window; 0 if the contact is not active."""
    if not is_active(contact):
        return 0.0
    if contact.p == 1:
        return contact.k
    return contact.p * contact.k * max(value(scratch.deltas, degree, x), 0.0) ** (contact.p - 1)


@kernel_helper
def block(c, n, i, degree, x, work):
    """Return the first and the last contact of the row of neighbouring active contacts to which contact i belongs."""
    first, last = i, i
    while first > 0 and stiffness_at(c[first - 1], work[first - 1], degree, x) > 0:
        first -= 1
    while last < n - 1 and stiffness_at(c[last + 1], work[last + 1], degree, x) > 0:
        last += 1
    return first, last


@kernel_helper
def largest_amplitude(c, n, i, degree, x, h, work):
    """Return an upper bound of `amplitude` that needs only energies; infinite with gravity.

    By Cauchy's inequality the sum of the amplitudes is at most sqrt(2 E (a_i + a_{i+1})), where a_i and a_{i+1} are the
    inverse masses of the bodies of contact i. E is the energy of the row of active contacts around contact i, relative
    to its centre of mass or to the table.
    """
    if c[n - 1].g > 0:
        return inf
    first, last = block(c, n, i, degree, x, work)
    twice, mass, moment = 0.0, 0.0, 0.0
    for j in range(first, last + 1):
        contact, scratch = c[j], work[j]
        k = stiffness_at(contact, scratch, degree, x)
        force = contact.k * max(value(scratch.deltas, degree, x), 0.0) ** contact.p
        mass += 1 / contact.a
        moment += mass * value(scratch.rates, degree, x)
        twice += force * force / k + (moment / mass) ** 2 / (1 / mass + c[j + 1].a)
    return sqrt(twice * (c[i].a + c[i + 1].a))


@kernel_helper
def amplitude(c, n, i, degree, x, h, work):
    """Return the amplitude of the rate of contact i: the sum of the amplitudes of its sinusoids at the time x h."""
    first, last = block(c, n, i, degree, x, work)
    for j in range(first, last + 1):
        table, root = work[j].watched, sqrt(stiffness_at(c[j], work[j], degree, x))
        table[RATES] = root * value(work[j].rates, degree, x)
        table[SLOPES] = root * slope(work[j].rates, degree, x) / h
        table[UNIT] = 1.0 if j == i else 0.0
        table[DIAGONAL] = (c[j].a + c[j + 1].a) * root * root
        table[BESIDE] = -c[j + 1].a * root if j < last else 0.0
        if j > first:
            work[j - 1].watched[BESIDE] *= root
    diagonalise(first, last, work)
    highest, total = 0.0, 0.0
    for j in range(first, last + 1):
        highest = max(highest, work[j].watched[DIAGONAL])
    for j in range(first, last + 1):
        table = work[j].watched
        turned = table[SLOPES] / sqrt(max(table[DIAGONAL], EPSILON * highest))
        total += abs(table[UNIT]) * hypot(table[RATES], turned)
    return total / sqrt(stiffness_at(c[i], work[i], degree, x))


@kernel_helper
def diagonalise(first, last, work):
    """Diagonalise the tridiagonal matrix S that is stored in `work`, and apply the same rotations to three rows.

    The docstring of the module describes the rows. The method is the implicit QL method (Numerical Recipes, section
    11.3; EISPACK's tql2).
    """
    for low in range(first, last + 1):
        for _ in range(MOST_ITERATIONS):
            high = low
            while high < last:
                scale = abs(work[high].watched[DIAGONAL]) + abs(work[high + 1].watched[DIAGONAL])
                if abs(work[high].watched[BESIDE]) <= EPSILON * scale:
                    break
                high += 1
            if high == low:
                break
            diagonal, beside = work[low].watched[DIAGONAL], work[low].watched[BESIDE]
            g = (work[low + 1].watched[DIAGONAL] - diagonal) / (2 * beside)
            g = work[high].watched[DIAGONAL] - diagonal + beside / (g + copysign(hypot(g, 1.0), g))
            s, t, p, j = 1.0, 1.0, 0.0, high - 1
            while j >= low:
                table, after = work[j].watched, work[j + 1].watched
                f, b = s * table[BESIDE], t * table[BESIDE]
                r = hypot(f, g)
                after[BESIDE] = r
                if r == 0:
                    after[DIAGONAL] -= p
                    break
                s, t = f / r, g / r
                g = after[DIAGONAL] - p
                r = (table[DIAGONAL] - g) * s + 2 * t * b
                p = s * r
                after[DIAGONAL] = g + p
                g = t * r - b
                for row in (UNIT, RATES, SLOPES):
                    upper, lower = table[row], after[row]
                    after[row] = s * upper + t * lower
                    table[row] = t * upper - s * lower
                j -= 1
            if j < low:
                work[low].watched[DIAGONAL] -= p
                work[low].watched[BESIDE] = g
            work[high].watched[BESIDE] = 0.0
