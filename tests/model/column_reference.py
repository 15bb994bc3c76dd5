"""An independent solution of columns: plain event-driven integration in time with scipy.

Shares nothing with the package but the parameters. The unknowns are velocities of balls and deformations of contacts,
the integrator is DOP853, events are found by sign changes on its dense output.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

#: A contact that is stiffer than its neighbours by this factor, and pressed by them, is taken for rigid.
RIGID = 1e11


class Answer(NamedTuple):
    velocities: tuple[float, ...]
    states: tuple[tuple[int, ...], ...]
    limit: bool


class _Run:
    """A column under way: bodies (groups of balls, the table as one of infinite mass) and contacts between them."""

    def __init__(self, column, exponent, stiffens):
        self.p, self.stiffens = exponent, stiffens
        self.inverse = [1 / m for m in column.masses] + [0.0] * column.table
        self.v = [*column.velocities] + [0.0] * column.table
        self.k, self.k0, self.e = (
            list(column.stiffnesses),
            list(column.stiffnesses),
            list(column.restitutions),
        )
        self.number = list(range(1, len(self.k) + 1))
        self.body = list(range(len(column.masses)))
        self.delta = [0.0] * len(self.k)
        self.rigid = set()
        self.phase = ["c" if self.rate(i) > 0 else "" for i in range(len(self.k))]
        for order in (range(1, len(self.k)), range(len(self.k) - 2, -1, -1)):
            for i in order:
                beside = i - 1 if order.step > 0 else i + 1
                if self.rate(i) == 0 and self.phase[beside]:
                    self.phase[i] = "c"

    def rate(self, i):
        return self.v[i + 1] - self.v[i]

    def force(self, i):
        if not (0 <= i < len(self.k) and self.phase[i]):
            return 0.0
        return self.k[i] * max(self.delta[i], 0.0) ** self.p

    def acting(self):
        return tuple(sorted({self.number[i] for i, phase in enumerate(self.phase) if phase} | self.rigid))

    def rhs(self):
        n = len(self.k)
        k = np.array([self.k[i] if self.phase[i] else 0.0 for i in range(n)])
        on = np.array([1.0 if phase else 0.0 for phase in self.phase])
        inverse, p = np.array(self.inverse), self.p
        forces = np.zeros(n + 2)

        def f(_, y):
            forces[1:-1] = k * np.maximum(y[n + 1 :], 0.0) ** p if p != 1 else k * y[n + 1 :]
            return np.concatenate([inverse * (forces[1:] - forces[:-1]), on * (y[1 : n + 1] - y[:n])])

        return f

    def watched(self):
        n = len(self.k)
        found = []
        for i, phase in enumerate(self.phase):
            sign = 1.0 if phase == "c" else -1.0
            # A contact that its neighbours have hardly loaded yet has a rate of either sign, by rounding.
            unloaded = 1e-14 * self.largest(i) if phase == "c" else -math.inf
            found.append(
                (
                    i,
                    "rate",
                    lambda t, y, i=i, sign=sign, unloaded=unloaded: (
                        sign * (y[i + 1] - y[i]) + 1e-13 * (y[n + 1 + i] < unloaded)
                    ),
                )
            )
            if phase == "r":
                found.append((i, "spent", lambda t, y, i=i: y[n + 1 + i]))
        for _, _, f in found:
            f.terminal, f.direction = True, -1
        return found

    def frequency(self):
        most = max(
            (self.inverse[i] + self.inverse[i + 1])
            * self.k[i]
            * (self.p * max(self.delta[i], self.largest(i)) ** (self.p - 1) if self.p != 1 else 1)
            for i in range(len(self.k))
            if self.phase[i]
        )
        return 1.5 * math.sqrt(most)

    def largest(self, i):
        """Deformation that all the energy of a relative motion at unit speed would give, roughly."""
        inverse = self.inverse[i] + self.inverse[i + 1]
        return ((self.p + 1) / (2 * inverse * self.k[i])) ** (1 / (self.p + 1))

    def apply(self, i, kind):
        """Apply the law; whether the bodies were united."""
        e, p = self.e[i], self.p
        if kind == "spent":
            self.phase[i], self.delta[i] = "", 0.0
            return False
        self.v[i] = self.v[i + 1] = self.mean(i)
        if not self.phase[i]:
            self.phase[i], self.delta[i] = "c", 0.0
            self.k[i] = self.k[i] if self.stiffens else self.k0[i]
        elif self.phase[i] == "r":
            self.phase[i] = "c"
            if not self.stiffens:
                self.k[i], self.delta[i] = self.k0[i], self.delta[i] / e**2
        else:
            if e > 0:
                self.phase[i] = "r"
                self.k[i], self.delta[i] = self.k[i] / e ** (2 * p), self.delta[i] * e**2
            if e == 0 or (self.stiffens and e < 1 and self.is_rigid(i)):
                self.unite(i)
                return True
        return False

    def mean(self, i):
        a, b = self.inverse[i], self.inverse[i + 1]
        return (b * self.v[i] + a * self.v[i + 1]) / (a + b)

    def stiffness(self, i):
        return self.k[i] * (self.p * self.delta[i] ** (self.p - 1) if self.p != 1 else 1)

    def is_rigid(self, i):
        a, b = self.inverse[i], self.inverse[i + 1]
        static = (a * self.force(i - 1) + b * self.force(i + 1)) / (a + b)
        beside = [self.stiffness(j) for j in (i - 1, i + 1) if self.force(j) > 0]
        return bool(beside) and self.force(i) < 3 * static and self.stiffness(i) > RIGID * max(beside)

    def unite(self, i):
        self.rigid.add(self.number[i])
        a, b = self.inverse[i], self.inverse[i + 1]
        self.v[i + 1] = self.mean(i)
        self.inverse[i + 1] = 1 / (1 / a + 1 / b) if a and b else 0.0
        del self.v[i], self.inverse[i]
        for values in (self.k, self.k0, self.e, self.delta, self.phase, self.number):
            del values[i]
        self.body = [body - (body > i) for body in self.body]


def integrate(column, exponent=1.0, stiffens=True, resolution=0.1, most=5000, least=0.0):
    """Final velocities and acting contacts of a column whose rates are about 1, or once all are below `least`."""
    run = _Run(column, exponent, stiffens)
    states, limit = [run.acting()], False
    for _ in range(most):
        if not any(run.phase) or np.abs([*run.v, *run.delta]).max() < least:
            ended = states if not states[-1] else [*states, ()]
            return Answer(tuple(run.v[b] for b in run.body), tuple(ended), limit)
        n = len(run.k)
        watched = run.watched()
        step = resolution / run.frequency()
        scale = [1.0] * (n + 1) + [run.largest(i) for i in range(n)]
        done = solve_ivp(
            run.rhs(),
            (0, 1e4 * step),
            np.array([*run.v, *run.delta]),
            method="DOP853",
            rtol=1e-12,
            atol=1e-15 * np.array(scale),
            events=[f for _, _, f in watched],
            max_step=step,
            first_step=1e-3 * step,
        )
        assert done.success, done.message
        run.v, run.delta = list(done.y[: n + 1, -1]), list(done.y[n + 1 :, -1])
        hit = [(t[0], w) for t, w in zip(done.t_events, watched, strict=True) if t.size]
        if hit:
            _, (i, kind, _) = min(hit, key=lambda x: x[0])
            limit |= run.apply(i, kind)
        if run.acting() != states[-1]:
            states.append(run.acting())
    raise AssertionError(f"not over after {most} events")
