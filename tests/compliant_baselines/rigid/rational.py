"""Rigid impacts in rational numbers: every set of contacts is tried, matrices are dense, no code is that of the laws.

Inputs are `Fraction`s: masses, restitutions e, and relative velocities u that are negative while bodies approach.
"""

from fractions import Fraction
from itertools import combinations


def solved(a, b):
    """Solve a linear system by elimination."""
    rows = [[*row, value] for row, value in zip(a, b, strict=True)]
    for i in range(len(rows)):
        pivot = next(j for j in range(i, len(rows)) if rows[j][i])
        rows[i], rows[pivot] = rows[pivot], rows[i]
        rows[i] = [x / rows[i][i] for x in rows[i]]
        for j in range(len(rows)):
            if j != i:
                rows[j] = [x - rows[j][i] * y for x, y in zip(rows[j], rows[i], strict=True)]
    return [row[-1] for row in rows]


def times(matrix, vector):
    return [sum(a * x for a, x in zip(row, vector, strict=True)) for row in matrix]


class Balls:
    """Balls that all touch."""

    def __init__(self, masses, e, v, table):
        self.m, self.e, self.v, self.table = masses, e, list(v), table
        n = len(masses)
        # Row i of H: u_i = v_i - v_{i+1}, the last one on a table v_N.
        self.h = [[Fraction((j == i) - (j == i + 1)) for j in range(n)] for i in range(n - 1 + table)]
        self.g = [
            [sum(a * b / m for a, b, m in zip(x, y, masses, strict=True)) for y in self.h] for x in self.h
        ]

    @property
    def u(self):
        return times(self.h, self.v)

    def push(self, impulse):
        for j, m in enumerate(self.m):
            self.v[j] += sum(row[j] * p for row, p in zip(self.h, impulse, strict=True)) / m

    def complementary(self, q):
        """Solve 0 <= P, q + G P >= 0, complementary, by trying every set of contacts that push."""
        n, found = len(q), []
        for size in range(n + 1):
            for some in combinations(range(n), size):
                part = solved([[self.g[i][j] for j in some] for i in some], [-q[i] for i in some])
                impulse = [Fraction(0)] * n
                for i, p in zip(some, part, strict=True):
                    impulse[i] = p
                w = [a + b for a, b in zip(q, times(self.g, impulse), strict=True)]
                if min(impulse, default=0) >= 0 and min(w, default=0) >= 0:
                    found.append(impulse)
        assert all(each == found[0] for each in found)  # G is positive definite: one solution
        return found[0]

    def newton(self):
        while min(self.u) < 0:
            self.push(self.complementary([(1 + e) * u for e, u in zip(self.e, self.u, strict=True)]))

    def poisson(self):
        self.push([(1 + e) * p for e, p in zip(self.e, self.complementary(self.u), strict=True)])
        self.push(self.complementary(self.u))

    def first(self):
        """Resolve the topmost of the contacts that approach, one after the other."""
        self.last(place=0)

    def last(self, place=-1):
        """The lowest, or that of a place among them."""
        while min(self.u) < 0:
            i = [i for i, u in enumerate(self.u) if u < 0][place]
            self.push(
                [-(1 + self.e[i]) * self.u[i] / self.g[i][i] if j == i else 0 for j in range(len(self.u))]
            )

    def plastic(self):
        """Stop, then push contacts apart one by one: those between balls by turns, then the one at the table."""
        order = sorted(range(len(self.u)), key=lambda i: (i == len(self.m) - 1, i % 2, i))
        restitutions = self.e
        while min(self.u) < 0:
            before, total = self.u, self.complementary(self.u)
            self.push(total)
            for i in order:
                if before[i] < 0:
                    more = max((-restitutions[i] * before[i] - self.u[i]) / self.g[i][i], -total[i])
                    self.push([more if j == i else 0 for j in range(len(total))])
            restitutions = [int(e == 1) for e in self.e]
