"""Rigid impacts in rational numbers: every set of contacts is tried, matrices are dense, no code is that of the laws.

Inputs are `Fraction`s, in arrays of objects: masses, restitutions e, and relative velocities u, negative while bodies
approach.
"""

from fractions import Fraction
from itertools import combinations

import numpy as np


def solved(a, b):
    """Eliminate without pivoting: principal parts of a positive definite matrix have none that is zero."""
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
        # Row i of H: u_i = v_i - v_{i+1}, the last one on a table v_N.
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
        """Solve 0 <= P, q + G P >= 0, complementary, by trying every set of contacts that push."""
        n, found = len(q), []
        for some in (list(some) for size in range(n + 1) for some in combinations(range(n), size)):
            impulse = np.full(n, Fraction(0))
            if some:
                impulse[some] = solved(self.g[np.ix_(some, some)], -q[some])
            if min(impulse) >= 0 and min(q + self.g @ impulse) >= 0:
                found.append(impulse)
        assert all((each == found[0]).all() for each in found)  # G is positive definite: one solution
        return found[0]

    def newton(self):
        while min(self.u) < 0:
            self.push(self.complementary((1 + self.e) * self.u))

    def poisson(self):
        self.push((1 + self.e) * self.complementary(self.u))
        self.push(self.complementary(self.u))

    def first(self):
        """Resolve the topmost of the contacts that approach, one after the other."""
        self.last(place=0)

    def last(self, place=-1):
        """The lowest, or that of a place among them."""
        while min(self.u) < 0:
            i = np.flatnonzero(self.u < 0)[place]
            self.push_one(i, -(1 + self.e[i]) * self.u[i] / self.g[i, i])

    def plastic(self):
        """Stop, then push contacts apart one by one: those between balls by turns, then the one at the table."""
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
