"""Motion between events as Taylor polynomials.

Between events a column of two contacts obeys linear equations (docs/theory.md, section 1), here with dashpots
and gravity:

    p1' = d1     d1' = F2/m2 - F1/M          F1 = k1 p1 + c1 d1
    p2' = -v2    v2' = (F2 - F1)/m2 - g      F2 = k2 p2 - c2 v2

p_i is the compression of contact i, d1 = v2 - v1 the rate of the first, -v2 that of the second, 1/M = 1/m1
+ 1/m2, and a contact that carries no force has k_i = c_i = 0. Closed forms by modes exist, but with
dashpots the modes are complex and, next to critical damping, nearly parallel: their amplitudes then cancel
each other. A Taylor series has no such special cases, and its remainder is known beforehand.

**Remainder.** In the norm of energy the equations are y' = (S - C) y, S skew with the norm omega, the
highest natural frequency, and C >= 0 with the norm gamma, the highest eigenvalue of m^-1/2 c m^-1/2. So the
n-th term over a time h is at most (Lambda h)^n/n! of the state, Lambda = omega + gamma, and what a
polynomial of degree `ORDER` leaves out over h = `RADIUS`/Lambda is at most RADIUS^(ORDER + 1)/(ORDER + 1)!
of it, up to a factor 1.1: 3e-16.

Units: m1 = 1, v0 = -1, k1 = 1 initially; hence mu = m2/m1, velocities per |v0|, times per sqrt(m1/k1).
"""

from __future__ import annotations

from math import inf, sqrt

from numba import njit

#: Degree of the polynomials.
ORDER = 22

#: Length of a segment times Lambda.
RADIUS = 2.0

#: Rows of a table of coefficients.
P1, D1, Q2, V2 = 0, 1, 2, 3


@njit(cache=True, error_model="numpy", inline="always")
def _highest(a, b, product):
    """Higher eigenvalue of a symmetric 2x2 matrix: diagonal (a, b), off-diagonal squared `product`."""
    return 0.5 * (a + b + sqrt((a - b) * (a - b) + 4 * product))


@njit(cache=True, error_model="numpy")
def longest_step(mu, k1, k2, c1, c2):
    """Time over which the polynomials hold to rounding; infinite if no contact carries force.

    Parameters
    ----------
    mu : float
        m2/m1.
    k1, k2, c1, c2 : float
        Stiffness and damping of the contacts; zero for one that carries no force.
    """
    rate = sqrt(_highest(k1, (k1 + k2) / mu, k1 * k1 / mu)) + _highest(c1, (c1 + c2) / mu, c1 * c1 / mu)
    return RADIUS / rate if rate > 0 else inf


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def expand(table, degree, h, mu, k1, k2, c1, c2, push1, push2):
    """Fill in the Taylor coefficients of p1, d1, q2, v2 over a time h, scaled to the unit interval.

    Parameters
    ----------
    table : ndarray, shape (4, n > degree)
        Coefficients; column 0 holds the state at the start.
    degree : int
        Highest degree to fill in.
    h : float
        Duration of the segment.
    mu, k1, k2, c1, c2 : float
        As in `longest_step`.
    push1, push2 : float
        Constant parts of d1' and v2' (gravity, if any).
    """
    mobility1, mobility2 = 1 + 1 / mu, 1 / mu
    a1, b1, a2, b2 = k1 * mobility1, c1 * mobility1, k2 * mobility2, c2 * mobility2
    a3, b3 = k1 * mobility2, c1 * mobility2
    p1, d1, q2, v2 = table[0, 0], table[1, 0], table[2, 0], table[3, 0]
    for n in range(degree):
        s = h / (n + 1)
        # (F2/m2 - F1/M, (F2 - F1)/m2), in the order that waits least for the coefficients before it
        rate1 = (a2 * q2 - a1 * p1) - (b2 * v2 + b1 * d1)
        rate2 = (a2 * q2 - a3 * p1) - (b2 * v2 + b3 * d1)
        if n == 0:
            rate1, rate2 = rate1 + push1, rate2 + push2
        p1, q2 = s * d1, -s * v2
        d1, v2 = s * rate1, s * rate2
        table[0, n + 1], table[1, n + 1], table[2, n + 1], table[3, n + 1] = p1, d1, q2, v2


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def evaluate(table, degree, x):
    """State (p1, d1, q2, v2) at x in [0, 1] of a segment."""
    p1, d1, q2, v2 = table[0, degree], table[1, degree], table[2, degree], table[3, degree]
    for n in range(degree - 1, -1, -1):
        p1 = p1 * x + table[0, n]
        d1 = d1 * x + table[1, n]
        q2 = q2 * x + table[2, n]
        v2 = v2 * x + table[3, n]
    return p1, d1, q2, v2


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def expand_product(table, degree, h, mu, k1, k2, a1, a2, r2, push1, push2):
    """As `expand`, for the forces F1 = k1 p1 (1 + a1 d1), F2 = k2 (p2 - r2) - k2 p2 a2 v2 with p2 = q2 + r2.

    Products of series are Cauchy products. No bound of the remainder is known beforehand: see `trusted`.
    """
    mobility1, mobility2 = 1 + 1 / mu, 1 / mu
    rest = table[2, 0]
    table[2, 0] = rest + r2
    for n in range(degree):
        s = h / (n + 1)
        product1, product2 = 0.0, 0.0
        for j in range(n + 1):
            product1 += table[0, j] * table[1, n - j]
            product2 += table[2, j] * table[3, n - j]
        F1 = k1 * (table[0, n] + a1 * product1)
        F2 = k2 * ((rest if n == 0 else table[2, n]) - a2 * product2)
        table[0, n + 1], table[2, n + 1] = s * table[1, n], -s * table[3, n]
        table[1, n + 1] = s * (mobility2 * F2 - mobility1 * F1 + (push1 if n == 0 else 0.0))
        table[3, n + 1] = s * (mobility2 * (F2 - F1) + (push2 if n == 0 else 0.0))
    table[2, 0] = rest


@njit(cache=True, error_model="numpy")
def trusted(table, degree):
    """Part of the unit interval on which the last two terms of every series stay below rounding (at most 1).

    The usual step of a Taylor integrator (Jorba and Zou, Experimental Mathematics 14:99, 2005): the terms
    fall geometrically, so that what follows the last two is of their size.
    """
    longest = 1.0
    for i in range(4):
        size = 0.0
        for n in range(7):  # contact 2 starts from zeros up to third order
            size = max(size, abs(table[i, n]))
        for n in (degree - 1, degree):
            term = abs(table[i, n])
            if term > 0:
                longest = min(longest, (2.0**-54 * size / term) ** (1 / n))
    return longest
