"""An independent integration of the column, for either contact law, with or without gravity.

Shares nothing with the package but the parameters. The unknowns are penetrations and velocities of the balls,
the integrator is DOP853, events are found by sign changes on its dense output between steps too short to
hold two. Penetrations, not heights: of a contact that a hundred ends of compression made 1e9 times as stiff, a height
above the first touch would keep no digit of the force, and the integrator would chase the rounding.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

OPEN, LOADED, SLACK, COMPRESSION, RESTITUTION = "open", "loaded", "slack", "compression", "restitution"


class Answer(NamedTuple):
    v1: float
    v2: float
    end: str
    duration: float
    pushes: tuple[tuple[bool, bool], ...]  # which contacts carried force, in order


class Column(ABC):
    """Units m1 = 1, k1 = 1, v0 = -1; y = (p1, p2, v1, v2), p_i the penetration from the present surface.

    `frozen`: a contact without force keeps p = 0 and has one again as soon as its bodies approach.
    """

    def __init__(self, kappa, mu, g, finer=1, frozen=False):
        self.frozen = frozen
        self.finer = finer  # steps this many times shorter: the usual ones can step over a pair of events
        self.mu, self.g, self.k = mu, g, [1.0, kappa]
        self.y = np.array([0.0, mu * g / kappa, -1.0, 0.0])
        self.t = 0.0

    def depth(self, i, y):
        return y[i]

    def rate(self, i, y):
        return y[3] - y[2] if i == 0 else -y[3]

    def fastest(self):
        return math.sqrt((self.k[0] + self.k[1]) / self.mu + self.k[0])

    def pace(self):
        """Highest frequency of the contacts that push: with the others open nothing moves faster."""
        first, second = (k if on else 0.0 for k, on in zip(self.k, self.pushes(), strict=True))
        return math.sqrt((first + second) / self.mu + first)

    # what a law has to say
    @abstractmethod
    def force(self, i, y): ...

    @abstractmethod
    def pushes(self): ...

    @abstractmethod
    def watched(self):
        """Pairs of a name and a function that falls through zero."""

    @abstractmethod
    def apply(self, name): ...

    def back(self, i):
        """What falls through zero where an open contact returns."""
        return (lambda y: -self.rate(i, y)) if self.frozen else (lambda y: -self.depth(i, y))

    # the end, by the rule of engines.stepping
    def rest_energy(self, y):
        weight, k = self.mu * self.g, self.k[1]
        return self.mu * y[3] ** 2 + k * (self.depth(1, y) - weight / k) ** 2 - weight**2 / k

    def stuck_energy(self, y):
        (k1, k2), g, total = self.k, self.g, 1 + self.mu
        a = self.depth(0, y) - g / k1
        b = self.depth(1, y) - total * g / k2
        energy = y[2] ** 2 + self.mu * y[3] ** 2 + k1 * a * a + k2 * b * b
        return energy - min(g * g / k1, (total * g) ** 2 / k2)

    def over(self):
        first, second = self.pushes()
        y, g = self.y, self.g
        clear1 = not first and (g == 0 or self.depth(0, y) <= 1e-14)
        clear2 = not second and (g == 0 or self.depth(1, y) <= 1e-14)
        parting = y[2] >= y[3] - 1e-14
        if clear1 and clear2 and parting and y[3] >= -1e-14:
            return "free"
        if g > 0 and clear1 and parting and y[2] >= 0 and self.rest_energy(y) <= 1e-14:
            return "rest"
        if g > 0 and first and second and self.stuck_energy(y) <= 1e-14:
            return "stuck"
        return ""

    def segment(self):
        first, second = self.pushes()
        watched = list(self.watched())
        if self.g > 0 and not first:
            # With B1 off, a push of the table only lifts the rate of contact 1: from zero it goes up.
            sign = -1 if self.rate(0, self.y) < -1e-13 else 1
            if second and not self.frozen:
                watched.append(("level", lambda y, sign=sign: sign * self.rate(0, y)))
            if self.depth(0, self.y) <= 1e-14 and sign < 0 <= self.y[2] and self.rest_energy(self.y) > 0:
                watched.append(("rest", self.rest_energy))
        if self.g > 0 and first and second and self.stuck_energy(self.y) > 0:
            watched.append(("stuck", self.stuck_energy))

        def rhs(_t, y):
            f1, f2 = self.force(0, y) if first else 0.0, self.force(1, y) if second else 0.0
            moves = [first or not self.frozen, second or not self.frozen]
            return [moves[0] * (y[3] - y[2]), moves[1] * -y[3], f1 - self.g, (f2 - f1) / self.mu - self.g]

        events = []
        for _, f in watched:

            def event(_t, y, f=f):
                return f(y)

            event.terminal, event.direction = True, -1
            events.append(event)
        flying = not (first or second)
        apart = flying and max(self.depth(0, self.y), self.depth(1, self.y)) <= 0
        w = self.fastest()
        run = solve_ivp(
            rhs,
            (0, 1e6),
            self.y,
            method="DOP853",
            rtol=1e-12,
            atol=1e-15 * np.array([1 / w, 1 / w, 1, 1]),
            events=events,
            max_step=np.inf
            if flying and self.g == 0
            else 0.3
            if apart
            else 0.15 / (self.pace() or w) / self.finer,
            first_step=1e-4 / w,
        )
        assert run.status == 1, run.message
        self.y, self.t = run.y[:, -1].copy(), self.t + run.t[-1]
        return next(name for (name, _), t in zip(watched, run.t_events, strict=True) if t.size)

    def run(self):
        pushes = [self.pushes()]
        for _ in range(5000):
            end = self.over()
            if end:
                v1, v2 = self.y[2], self.y[3]
                if end != "free":
                    v1, v2 = (0.0 if end == "stuck" else v1), 0.0
                return Answer(v1, v2, end, self.t, tuple(pushes))
            if (
                self.g > 0
                and not any(self.pushes())
                and max(self.depth(0, self.y), self.depth(1, self.y)) <= 1e-14
            ):
                self.g = 0.0  # the first flight: from here on the bodies no longer fall
            name = self.segment()
            if name == "level":
                self.y[2] = self.y[3]
            elif name not in ("rest", "stuck"):
                self.apply(name)
            if self.pushes() != pushes[-1]:
                pushes.append(self.pushes())
        raise AssertionError("too many segments")


class Dashpots(Column):
    """F = max(0, k delta + c delta') or, `product`, max(0, k delta (1 + c delta')), while delta > 0."""

    def __init__(self, kappa, mu, c1, c2, g=0.0, product=False, finer=1, frozen=False):
        super().__init__(kappa, mu, g, finer, frozen)
        self.c, self.product, self.mode = (c1, c2), product, [LOADED, LOADED]

    def force(self, i, y):
        if self.product:
            return self.k[i] * self.depth(i, y) * (1 + self.c[i] * self.rate(i, y))
        return self.k[i] * self.depth(i, y) + self.c[i] * self.rate(i, y)

    def sign(self, i, y):
        return 1 + self.c[i] * self.rate(i, y) if self.product else self.force(i, y)

    def pushes(self):
        return self.mode[0] == LOADED, self.mode[1] == LOADED

    def watched(self):
        for i in (0, 1):
            if self.mode[i] == LOADED:
                yield f"slack{i}", lambda y, i=i: self.sign(i, y)
                if self.product:
                    yield f"open{i}", lambda y, i=i: self.depth(i, y)
            elif self.mode[i] == SLACK:
                yield f"load{i}", lambda y, i=i: -self.sign(i, y)
                yield f"open{i}", lambda y, i=i: self.depth(i, y)
            else:
                yield f"load{i}", self.back(i)

    def apply(self, name):
        i = int(name[-1])
        mode = {"slack": SLACK, "load": LOADED, "open": OPEN}[name[:-1]]
        if mode == SLACK and (self.frozen or (not self.product and self.c[i] == 0)):
            mode = OPEN
        self.mode[i] = mode
        if self.frozen and mode == OPEN:
            self.y[i] = 0.0


class Bistiffness(Column):
    """Loading along k, unloading along k/e^2, the surface where the force is zero."""

    rigid = 1e9

    def __init__(self, kappa, mu, e1, e2, g=0.0, finer=1, frozen=False):
        super().__init__(kappa, mu, g, finer, frozen)
        self.e, self.phase = (e1, e2), [COMPRESSION, COMPRESSION]

    def force(self, i, y):
        return self.k[i] * self.depth(i, y)

    def pushes(self):
        return self.phase[0] != OPEN, self.phase[1] != OPEN

    def watched(self):
        for i in (0, 1):
            if self.phase[i] == COMPRESSION:
                yield f"end{i}", lambda y, i=i: self.rate(i, y)
            elif self.phase[i] == RESTITUTION:
                yield f"restart{i}", lambda y, i=i: -self.rate(i, y)
                yield f"spent{i}", lambda y, i=i: self.depth(i, y)
            else:
                yield f"return{i}", self.back(i)

    def apply(self, name):
        i = int(name[-1])
        y = self.y
        if name.startswith(("end", "restart")):  # equal velocities, to the last digit
            if i == 0:
                y[2] = y[3]
            else:
                y[3] = 0.0
        if name.startswith("end"):
            force = self.force(i, y)
            self.k[i] /= self.e[i] ** 2
            y[i] = force / self.k[i]  # the surface stays behind
            self.phase[i] = RESTITUTION
            other = 1 - i
            push = self.force(other, y) if self.phase[other] != OPEN else 0.0
            push = push / (1 + self.mu) if i == 0 else push + self.mu * self.g
            if self.k[i] * push**2 > self.rigid * self.k[other] * force**2:
                raise RigidError(i)
        elif name.startswith("restart"):
            self.phase[i] = COMPRESSION
        elif name.startswith("spent"):
            self.phase[i] = OPEN
            y[i] = 0.0 if self.frozen else y[i]
        else:
            self.phase[i] = COMPRESSION


class RigidError(Exception):
    """A contact of the bistiffness law became rigid; `args[0]` says which."""


def single(m, y, v, k, e, compressing, g):
    """One ball on one bistiff spring: integrated until it leaves (velocity), or held down (0)."""
    while True:

        def rhs(_t, z, k=k):
            return [-z[1], k * z[0] / m - g]

        def turn(_t, z, sign=-1 if compressing else 1):
            return sign * z[1]

        def leave(_t, z):
            return z[0]

        for event in (turn, leave):
            event.terminal, event.direction = True, -1
        w = math.sqrt(k / m)
        run = solve_ivp(
            rhs, (0, 100 / w), [y, v], method="DOP853", rtol=1e-12, atol=[1e-16 / w, 1e-16],
            events=[turn, leave], max_step=0.2 / w, first_step=1e-5 / w,
        )  # fmt: skip
        assert run.status == 1
        y, v = run.y[:, -1]
        if run.t_events[1].size:
            return v
        if not compressing:
            return 0.0  # it came to a standstill before it left
        y, k, compressing, v = y * e * e, k / (e * e), False, 0.0
        if m * g > 0 and k * y <= 2 * m * g:
            return 0.0


def dashpots(*args, **kwargs):
    return Dashpots(*args, **kwargs).run()


def bistiffness(*args, **kwargs):
    """Outcome; its end is "limit" where a contact became rigid."""
    column = Bistiffness(*args, **kwargs)
    try:
        return column.run()
    except RigidError as rigid:
        y, mu, g = column.y, column.mu, column.g
        over = column.over()
        if over:
            v1, v2 = y[2], y[3]
            v1, v2 = 0.0 if over == "stuck" else v1, v2 if over == "free" else 0.0
            return Answer(v1, v2, over, column.t, ())
        if rigid.args[0] == 0:
            phase = column.phase[1] == COMPRESSION
            v = single(1 + mu, column.depth(1, y), y[3], column.k[1], column.e[1], phase, g)
            return Answer(v, v, "limit", column.t, ())
        depth, v1, compressing = column.depth(0, y), y[2], column.phase[0] == COMPRESSION
        if column.phase[0] == OPEN:
            depth, v1, compressing = 0.0, -math.sqrt(v1 * v1 - 2 * g * depth), True
        v = single(1.0, depth, v1, column.k[0], column.e[0], compressing, g)
        return Answer(v, 0.0, "limit", column.t, ())
