"""The grazing margin of a chain (docs/theory.md, section 6): turning points of compression rates, and their amplitudes.

`near_misses` updates the margin after a window. `amplitude` is the amplitude of a rate. While the set of active
contacts stays the same, a rate is a sum of sinusoids, and its amplitude is the sum of theirs. Where forces are not
linear, the motion is linearised at the turning point.

With K the diagonal of the stiffnesses and A the inverse masses of the contacts (`chain.series`), w'' = -A K w, so that
z = K^(1/2) w obeys z'' = -S z with S = K^(1/2) A K^(1/2), symmetric and tridiagonal. An eigenvector u of S with its
eigenvalue gives the amplitude

    abs(u_i)/k_i^(1/2) sqrt((u z)^2 + (u z')^2/eigenvalue).

Only the numbers u_i, u z and u z' of an eigenvector are needed. The QL method diagonalises S by rotations. The same
rotations, applied to three rows that start as unit vector i, z and z', turn these into u_i, u z and u z' for all
eigenvectors (Golub and Welsch, Math. Comp. 23:221, 1969, do so for one component).

Used by `chain.kernel`.
"""

from __future__ import annotations

from math import copysign, hypot, inf, sqrt

from impact_xval.model.chain.laws import equilibrium_depth, is_active
from impact_xval.model.chain.roots import first_root
from impact_xval.model.chain.series import slope, value
from impact_xval.model.compiled import kernel_helper
from impact_xval.model.pair.grazing import NEAR, STAKE

#: Places in the array `watched` of the workspace, which is free at that time: diagonal and subdiagonal of the matrix,
#: and the rows that become u_i, u z and u z'.
DIAGONAL, BESIDE, UNIT, RATES, SLOPES = range(5)

#: Largest number of iterations of the QL method for one eigenvalue; two or three suffice.
MOST_ITERATIONS = 60

#: Relative rounding of double precision; eigenvalues below this share of the largest one are rounding.
EPSILON = 2.0**-52


@kernel_helper
def near_misses(c, n, degree, x, h, energy, margin, work):
    """Return the grazing margin after the first part x of a window of length h, given the margin before the window.

    The chain `c` is at the end of that part; `energy` is the energy of impact.
    """
    for i in range(n):
        contact, scratch = c[i], work[i]
        if not is_active(contact) or contact.e == 1:
            continue
        # The rate has one sign in a window, so the load is largest at one of its ends.
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
    """Write the coefficients of the derivative of a polynomial."""
    for j in range(degree):
        derivative[j] = (j + 1) * coefficients[j + 1]
    derivative[degree] = 0.0


@kernel_helper
def first_turn(derivative, degree, reach):
    """Return the first root in (0, reach) of the derivative of a polynomial of degree `degree` (`first_root`)."""
    start = derivative[0]
    leading = start
    for j in range(1, degree):
        leading = derivative[j] if leading == 0 else leading
    return first_root(derivative, copysign(1.0, leading), abs(start), degree - 1, reach)


@kernel_helper
def shift(coefficients, degree, x):
    """Replace the coefficients of a polynomial in powers of t by its coefficients in powers of t - x."""
    for low in range(degree):
        for j in range(degree - 1, low - 1, -1):
            coefficients[j] += x * coefficients[j + 1]


@kernel_helper
def stiffness_at(contact, scratch, degree, x):
    """Return dF/ddelta of a contact at the place x of a window; 0 if the contact is not active."""
    if not is_active(contact):
        return 0.0
    if contact.p == 1:
        return contact.k
    return contact.p * contact.k * max(value(scratch.deltas, degree, x), 0.0) ** (contact.p - 1)


@kernel_helper
def block(c, n, i, degree, x, work):
    """Return the first and the last contact of the unbroken row of active contacts around contact i."""
    first, last = i, i
    while first > 0 and stiffness_at(c[first - 1], work[first - 1], degree, x) > 0:
        first -= 1
    while last < n - 1 and stiffness_at(c[last + 1], work[last + 1], degree, x) > 0:
        last += 1
    return first, last


@kernel_helper
def largest_amplitude(c, n, i, degree, x, h, work):
    """Return an upper bound of `amplitude` by the energy alone; infinite with gravity.

    By Cauchy's inequality the sum of the amplitudes is at most sqrt(2 E (a_i + a_{i+1})). E is the energy of the block
    of active contacts, relative to its centre of mass or to the table.
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
    """Return the amplitude of the rate of contact i at the place x of a window of length h."""
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
    """Diagonalise the tridiagonal matrix in `work`, and apply the same rotations to the three rows.

    This is the implicit QL method (Numerical Recipes, section 11.3; EISPACK's tql2).
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
