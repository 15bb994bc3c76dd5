"""The grazing margin of a chain (docs/theory.md, section 6): turning points of compression rates, and their amplitudes.

The amplitude of a rate is the sum of those of the sinusoids that it consists of while the set of acting contacts stays;
for forces that are not linear, of the motion linearised at the turning point. With K the diagonal of the stiffnesses
and A the inverse masses of the contacts (`chain.series`), w'' = -A K w, so that z = K^(1/2) w obeys z'' = -S z with
S = K^(1/2) A K^(1/2), symmetric and tridiagonal. An eigenvector u of S with its eigenvalue gives the amplitude

    abs(u_i)/k_i^(1/2) sqrt((u z)^2 + (u z')^2/eigenvalue).

Of u only u_i, u z and u z' are needed. The QL method diagonalises S by rotations, which turn these rows as they would
the rows of the eigenvectors (Golub and Welsch, Math. Comp. 23:221, 1969, do so for one component).
"""

from __future__ import annotations

from math import copysign, hypot, inf, sqrt

from impact_xval.model.chain.laws import carries, rest
from impact_xval.model.chain.roots import first_root
from impact_xval.model.chain.series import slope, value
from impact_xval.model.compiled import uncounted
from impact_xval.model.pair.grazing import NEAR, STAKE

#: Where the tridiagonal matrix and the rows are kept in `watched` of the workspace, which holds nothing else then.
DIAGONAL, BESIDE, UNIT, RATES, SLOPES = range(5)

#: Iterations of the QL method to one eigenvalue: two or three suffice.
MOST_ITERATIONS = 60

#: Rounding of an eigenvalue, relative to the largest one.
EPSILON = 2.0**-52


@uncounted
def near_misses(c, n, degree, x, h, energy, margin, work):
    """Grazing margin after a piece of length x h at whose end `c` is, given the margin before it."""
    for i in range(n):
        one, own = c[i], work[i]
        if not carries(one) or one.e == 1:
            continue
        # The rate has one sign in a piece, so that the load is largest at an end of it.
        load = max(own.deltas[0] + rest(one), one.delta + rest(one))
        least = STAKE * energy / (1 - one.e * one.e)
        if one.k * max(load, 0.0) ** (one.p + 1) / (one.p + 1) <= least:
            continue
        for j in range(degree):
            own.watched[j] = (j + 1) * own.rates[j + 1]
        own.watched[degree], at = 0.0, 0.0
        while True:
            start = own.watched[0]
            leading = start
            for j in range(1, degree):
                leading = own.watched[j] if leading == 0 else leading
            to_turn = first_root(own.watched, copysign(1.0, leading), abs(start), degree - 1, x - at)
            if not 0 < to_turn < x - at:
                break
            at += to_turn
            pressed = max(value(own.deltas, degree, at) + rest(one), 0.0)
            if one.k * pressed ** (one.p + 1) / (one.p + 1) > least:
                rate = abs(value(own.rates, degree, at))
                if rate < min(margin, NEAR) * largest_amplitude(c, n, i, degree, at, h, work):
                    share = rate / amplitude(c, n, i, degree, at, h, work)
                    margin = share if share < min(margin, NEAR) else margin
                    for j in range(degree):
                        own.watched[j] = (j + 1) * own.rates[j + 1]
                    own.watched[degree], to_turn = 0.0, at
            shift(own.watched, degree - 1, to_turn)
            own.watched[0] = 0.0
    return margin


@uncounted
def shift(coefficients, degree, x):
    """Write the coefficients of a polynomial about x in the place of those about 0."""
    for low in range(degree):
        for j in range(degree - 1, low - 1, -1):
            coefficients[j] += x * coefficients[j + 1]


@uncounted
def stiffness_at(one, own, degree, x):
    """Return dF/ddelta of a contact at x of a piece; 0 if it does not act."""
    if not carries(one):
        return 0.0
    if one.p == 1:
        return one.k
    return one.p * one.k * max(value(own.deltas, degree, x), 0.0) ** (one.p - 1)


@uncounted
def block(c, n, i, degree, x, work):
    """First and last of the neighbouring contacts that act together with contact i."""
    first, last = i, i
    while first > 0 and stiffness_at(c[first - 1], work[first - 1], degree, x) > 0:
        first -= 1
    while last < n - 1 and stiffness_at(c[last + 1], work[last + 1], degree, x) > 0:
        last += 1
    return first, last


@uncounted
def largest_amplitude(c, n, i, degree, x, h, work):
    """Upper bound of `amplitude`, by its energy alone; infinite where there is gravity.

    By Cauchy's inequality the sum of the amplitudes is at most (a_i + a_{i+1})^(1/2) times the root of twice the energy
    that the block has relative to its centre of mass, or to the table.
    """
    if c[n - 1].g > 0:
        return inf
    first, last = block(c, n, i, degree, x, work)
    twice, mass, moment = 0.0, 0.0, 0.0
    for j in range(first, last + 1):
        one, own = c[j], work[j]
        k = stiffness_at(one, own, degree, x)
        force = one.k * max(value(own.deltas, degree, x), 0.0) ** one.p
        mass += 1 / one.a
        moment += mass * value(own.rates, degree, x)
        twice += force * force / k + (moment / mass) ** 2 / (1 / mass + c[j + 1].a)
    return sqrt(twice * (c[i].a + c[i + 1].a))


@uncounted
def amplitude(c, n, i, degree, x, h, work):
    """Sum of the amplitudes of the sinusoids of the rate of contact i, as it moves at x of a piece of length h."""
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


@uncounted
def diagonalise(first, last, work):
    """Turn the tridiagonal matrix in `work` into the diagonal one of its eigenvalues, and the rows with it.

    The implicit QL method (Numerical Recipes, section 11.3; EISPACK's tql2).
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
            here, beside = work[low].watched[DIAGONAL], work[low].watched[BESIDE]
            g = (work[low + 1].watched[DIAGONAL] - here) / (2 * beside)
            g = work[high].watched[DIAGONAL] - here + beside / (g + copysign(hypot(g, 1.0), g))
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
