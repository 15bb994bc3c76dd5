"""Rigid impacts in rational numbers, as an independent reference for the rigid laws.

Every set of contacts is tried, matrices are dense, and no code of the laws is used. Inputs are `Fraction`s in arrays of
objects: masses, restitutions e, and relative velocities u, which are negative while bodies approach.
"""

from decimal import MAX_EMAX, MIN_EMIN, Context, Decimal, localcontext
from fractions import Fraction
from itertools import combinations, pairwise

import numpy as np


def solved(a, b):
    """Solve a linear system by elimination without pivoting, which a positive definite matrix does not need."""
    rows = np.column_stack([a, b])
    for i in range(len(rows)):
        rows[i] /= rows[i, i]
        for j in range(len(rows)):
            if j != i:
                rows[j] -= rows[j, i] * rows[i]
    return rows[:, -1]


class Balls:
    def __init__(self, masses, e, v, table):
        self.m, self.e, self.v = (np.array(x, object) for x in (masses, e, v))
        n = len(masses)
        # Row i of H gives u_i = v_i - v_{i+1}; on a table the last row gives v_N.
        self.h = (np.eye(n, dtype=int) - np.eye(n, k=1, dtype=int)).astype(object)[: n - 1 + table]
        self.g = self.h / self.m @ self.h.T

    @property
    def u(self):
        return self.h @ self.v

    def push(self, impulse):
        self.v += impulse @ self.h / self.m

    def push_one(self, i, impulse):
        self.v += impulse * self.h[i] / self.m

    def complementary(self, q):
        """Find impulses P with P >= 0, q + G P >= 0 and P (q + G P) = 0, by trying every set of contacts that push."""
        n, found = len(q), []
        for some in (list(some) for size in range(n + 1) for some in combinations(range(n), size)):
            impulse = np.full(n, Fraction(0))
            if some:
                impulse[some] = solved(self.g[np.ix_(some, some)], -q[some])
            if min(impulse) >= 0 and min(q + self.g @ impulse) >= 0:
                found.append(impulse)
        # G is positive definite, so that there is only one solution
        assert all((each == found[0]).all() for each in found)
        return found[0]

    def newton(self):
        while min(self.u) < 0:
            self.push(self.complementary((1 + self.e) * self.u))

    def poisson(self):
        self.push((1 + self.e) * self.complementary(self.u))
        self.push(self.complementary(self.u))

    def first(self):
        """Resolve single impacts, always of the topmost contact that approaches, until no contact approaches."""
        self.last(place=0)

    def last(self, place=-1):
        """Resolve single impacts, by default of the lowest contact that approaches, until no contact approaches."""
        while min(self.u) < 0:
            i = np.flatnonzero(self.u < 0)[place]
            self.push_one(i, -(1 + self.e[i]) * self.u[i] / self.g[i, i])

    def plastic(self):
        """Apply a plastic impact, then separate the contacts one by one by their restitution.

        Contacts between balls come first, the odd ones before the even ones, and the contact with the table last.
        """
        order = sorted(range(len(self.u)), key=lambda i: (i == len(self.m) - 1, i % 2, i))
        restitutions = self.e
        while min(self.u) < 0:
            before, total = self.u, self.complementary(self.u)
            self.push(total)
            for i in order:
                if before[i] < 0:
                    self.push_one(
                        i, max((-restitutions[i] * before[i] - self.u[i]) / self.g[i, i], -total[i])
                    )
            restitutions = [int(e == 1) for e in self.e]


def single_impacts(c, most=20_000):
    """Follow separate balls by single impacts, in decimals of 80 digits and with any exponent.

    Return the velocities at the end. Return None if contacts close at the same time, if other impacts follow after
    infinitely many, or if `most` impacts are not enough. A sequence counts as infinite after 300 impacts whose contacts
    are slower than 1e-20 of the largest initial speed, while all other contacts separate 1e9 times as fast.
    """
    with localcontext(Context(prec=80, Emax=MAX_EMAX, Emin=MIN_EMIN)):
        m, e, v, gaps = ([Decimal(x) for x in xs] for xs in (c.masses, c.restitutions, c.velocities, c.gaps))
        slow, contacts, momentum = Decimal("1e-20") * max(map(abs, v)), range(len(e)), np.dot(m, v)
        inverse = [1 / x for x in m] + [Decimal(0)]
        u = [a - b for a, b in pairwise(v + [Decimal(0)] * c.table)]
        last = [-most] * len(e)
        for impact in range(most):
            times = [gaps[i] / -u[i] if u[i] < 0 else Decimal("inf") for i in contacts]
            first = min(times)
            active = [impact - last[i] < 300 for i in contacts]
            over = first == Decimal("inf")
            if not over and impact > 300 and all(abs(x) < slow for x, a in zip(u, active, strict=True) if a):
                over = all(x > 10**9 * slow for x, a in zip(u, active, strict=True) if not a)
                if not over:
                    return None
            if over:
                below = np.array([sum(u[i:], Decimal(0)) for i in range(len(m))])
                return [
                    float(x) for x in (below if c.table else below + (momentum - np.dot(m, below)) / sum(m))
                ]
            if sum(time == first for time in times) > 1 or (impact == 0 and 0 in gaps):
                return None
            i = times.index(first)
            gaps = [gap + rate * first for gap, rate in zip(gaps, u, strict=True)]
            gaps[i], last[i] = Decimal(0), impact
            push = -(1 + e[i]) * u[i] / (inverse[i] + inverse[i + 1])
            u[i] *= -e[i]
            if i > 0:
                u[i - 1] -= inverse[i] * push
            if i < len(e) - 1:
                u[i + 1] -= inverse[i + 1] * push
        return None
