"""Independent integration of chains in time, for any law: event-driven, by scipy.

The model and the references of laws are compared with `integrate`. The integration uses nothing of the package but the
parameters of a chain.

The unknowns are the velocities of the balls and the deformations of the contacts. A deformation is measured from the
present surface of its contact, not from the first touch. A contact that restitution has made 1e9 times as stiff is
deformed so little that a height above the first touch would hold no digit of its force.

The integrator is DOP853. Events are sign changes on its dense output. The steps are so short that two sign changes of
one function within a step are unlikely.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

#: A contact is treated as rigid if it is stiffer than its loaded neighbours by this factor.
RIGID = 1e11
#: Rates and energies up to this value count as zero, because rounding alone can produce them.
ZERO = 1e-14

JME, LZB = "jia-mason-erdmann", "liu-zhao-brogliato"
OPEN, LOADED, SLACK, COMPRESSION, RESTITUTION = "", "loaded", "slack", "compression", "restitution"


class Answer(NamedTuple):
    velocities: tuple[float, ...]
    states: tuple[tuple[int, ...], ...]
    limit: bool  # True if a contact became rigid
    end: str  # "free"; in a drop also "rest" (lower ball at rest) or "stuck" (both balls at rest)
    duration: float


class _Run:
    """A chain during its integration: bodies and the contacts between them.

    A body is a ball, a group of united balls, or the table, which has infinite mass. With frozen positions, a contact
    that has no force starts again from zero depth as soon as its bodies approach.
    """

    def __init__(self, chain, law, b, gravity, frozen):
        self.law, self.p, self.g, self.t = law, chain.exponent, gravity, 0.0
        self.frozen = frozen or law in (JME, LZB)
        self.dashpots = law in ("kelvin-voigt", "hunt-crossley", "linear-dashpot")
        self.inverse = [1 / m for m in chain.masses] + [0.0] * chain.table
        self.v = [*chain.velocities] + [0.0] * chain.table
        self.k, self.k0 = list(chain.stiffnesses), list(chain.stiffnesses)
        self.e = list(chain.restitutions)
        self.b = list(b if self.dashpots else [0.0] * len(self.k))
        self.delta = [-gap for gap in chain.gaps]
        if gravity:  # at the start of a drop the lower ball rests on the table, at its equilibrium depth
            self.delta[-1] = chain.masses[-1] * gravity / self.k[-1]
        self.number = list(range(1, len(self.k) + 1))
        self.body = list(range(len(chain.masses)))
        self.rigid = set()
        self.phase = [OPEN] * len(self.k)
        self.begins = LOADED if self.dashpots else COMPRESSION
        for i in (*range(len(self.k)), *reversed(range(len(self.k)))):
            pressed = any(self.phase[max(i - 1, 0) : i + 2])
            if self.delta[i] >= 0 and (self.rate(i) > 0 or (self.rate(i) == 0 and pressed)):
                self.phase[i] = self.begins

    def rate(self, i):
        return self.v[i + 1] - self.v[i]

    def acts(self, i):
        return self.phase[i] not in (OPEN, SLACK)

    def force(self, i):
        """Return the force of a contact's spring; 0 if the contact is inactive or does not exist. Only for springs."""
        inside = 0 <= i < len(self.k) and self.acts(i)
        return self.k[i] * max(self.delta[i], 0.0) ** self.p if inside else 0.0

    def acting(self):
        return tuple(sorted({self.number[i] for i in range(len(self.k)) if self.acts(i)} | self.rigid))

    def rhs(self):
        n, p = len(self.k), self.p
        on = np.array([float(self.acts(i)) for i in range(n)])
        k, b, moves = on * self.k, on * self.b, on if self.frozen else np.ones(n)
        inverse = np.array(self.inverse)
        falls, forces = -self.g * (inverse > 0), np.zeros(n + 2)

        def f(_, y):
            delta, rate = y[n + 1 :], y[1 : n + 1] - y[:n]
            depth = np.maximum(delta, 0.0) if p != 1 else delta
            forces[1:-1] = k * depth**p
            if self.law in ("kelvin-voigt", "linear-dashpot"):
                forces[1:-1] += b * depth ** (0.5 * (p - 1)) * rate
            elif self.law == "hunt-crossley":
                forces[1:-1] *= 1 + b * rate
            return np.concatenate([inverse * (forces[1:] - forces[:-1]) + falls, moves * rate])

        return f

    def pushes(self, i, depth, rate):
        """Return a number that has the same sign as the force of a contact's spring and dashpot."""
        if self.law == "hunt-crossley":
            return 1 + self.b[i] * rate
        return self.k[i] * max(depth, 0.0) ** (0.5 * (self.p + 1)) + self.b[i] * rate if self.b[i] else depth

    def ends(self, i):
        """List functions of depth and rate that fall through zero at the end of a phase, with the next phase."""
        spent, pushes = (lambda d, w: d, OPEN), lambda d, w: self.pushes(i, d, w)
        ends = {
            OPEN: [(lambda d, w: -w if self.frozen else -d, self.begins)],
            LOADED: {
                "kelvin-voigt": [(pushes, SLACK)],
                "hunt-crossley": [(pushes, SLACK), spent],
                "linear-dashpot": [spent],
            }.get(self.law, []),
            SLACK: [(lambda d, w: -pushes(d, w), LOADED), spent],
            COMPRESSION: [(lambda d, w: w, RESTITUTION)],
            RESTITUTION: [(lambda d, w: -w, COMPRESSION), spent],
        }
        return ends[self.phase[i]]

    def watched(self):
        """List the functions of time and state that fall through zero at an event, with contact and next phase."""
        n, found = len(self.k), []
        for i, phase in enumerate(self.phase):
            # A contact that its neighbours have hardly loaded has a rate and a force whose signs are those of rounding.
            unloaded = 1e-14 * self.largest(i) if phase in (LOADED, COMPRESSION) else -math.inf
            for f, after in self.ends(i):

                def event(_, y, i=i, f=f, unloaded=unloaded):
                    return f(y[n + 1 + i], y[i + 1] - y[i]) + 1e-13 * (y[n + 1 + i] < unloaded)

                found.append((event, i, after))
        if self.g and not self.acts(0) and self.acts(n - 1) and self.rate(0) < -1e-13:
            # The table lifts the lower ball, so the rate at which the balls separate can only fall.
            found.append((lambda _, y: y[0] - y[1], 0, "level"))
        for j in range(0 if all(map(self.acts, range(n))) else 1, n) if self.g else ():
            if self.energy_to_unload(j, np.array([*self.v, *self.delta])) > ZERO:
                found.append((lambda _, y, j=j: self.energy_to_unload(j, y), j, "rest"))
        for event, _, _ in found:
            event.terminal, event.direction = True, -1
        return found

    def energy_to_unload(self, j, y):
        """Return twice the surplus energy of body j and the bodies below.

        The surplus is their energy minus the least energy that can unload one of their contacts.
        """
        n = len(self.k)
        m, k = 1 / np.array(self.inverse[j:n]), np.array(self.k[j:])
        carried = self.g * np.cumsum(m) / k
        energies = m * y[j:n] ** 2 + k * (y[n + 1 + j :] - carried) ** 2
        return energies.sum() - (k * carried**2).min()

    def over(self):
        n, y = len(self.k), np.array([*self.v, *self.delta])
        clear = [not self.acts(i) and (self.g == 0 or self.delta[i] <= ZERO) for i in range(n)]
        part = [clear[i] and self.rate(i) <= ZERO for i in range(n)]
        if all(part):
            return "free"
        for j in range(n) if self.g else ():
            alone = all(part[:j]) and self.v[0] >= 0 if j else all(map(self.acts, range(n)))
            if alone and self.energy_to_unload(j, y) <= ZERO:
                self.v[j:] = [0.0] * (n + 1 - j)
                return "rest" if j else "stuck"
        return ""

    def frequency(self):
        """Return 1.5 times the highest angular frequency of the contacts that are not open."""
        squares = (
            (self.inverse[i] + self.inverse[i + 1]) * self.stiffness(i, max(self.delta[i], self.largest(i)))
            for i in range(len(self.k))
            if self.phase[i]
        )
        return 1.5 * math.sqrt(max(squares, default=0.0))

    def largest(self, i):
        """Estimate the deformation of a contact that takes up all the energy of a relative motion at unit speed."""
        inverse = self.inverse[i] + self.inverse[i + 1]
        return ((self.p + 1) / (2 * inverse * self.k[i])) ** (1 / (self.p + 1))

    def apply(self, i, after):
        """Change a contact to its next phase by the law, and return whether its bodies were united."""
        e, p, before = self.e[i], self.p, self.phase[i]
        if after == "level" or (after in (COMPRESSION, RESTITUTION) and (before or self.frozen)):
            self.v[i] = self.v[i + 1] = self.mean(i)
        if after in ("level", "rest"):
            return False
        if after == SLACK and (self.frozen or self.delta[i] <= 1e-12):
            after = OPEN
        self.phase[i] = after
        if OPEN in (before, after):
            self.delta[i] = 0.0
        if before == RESTITUTION and after == COMPRESSION and self.law == LZB:
            self.delta[i] /= e**2
        if after == COMPRESSION and self.law == LZB:
            self.k[i] = self.k0[i]
        if after == RESTITUTION:
            if e > 0:
                self.k[i], self.delta[i] = self.k[i] / e ** (2 * p), self.delta[i] * e**2
            if e == 0 or (self.law != LZB and e < 1 and self.is_rigid(i)):
                self.unite(i)
                return True
        return False

    def mean(self, i):
        a, b = self.inverse[i], self.inverse[i + 1]
        return (b * self.v[i] + a * self.v[i + 1]) / (a + b)

    def stiffness(self, i, depth):
        return self.k[i] * self.p * depth ** (self.p - 1)

    def is_rigid(self, i):
        a, b = self.inverse[i], self.inverse[i + 1]
        static = (a * self.force(i - 1) + b * self.force(i + 1) + self.g * (b == 0)) / (a + b)
        beside = [j for j in (i - 1, i + 1) if 0 <= j < len(self.k) and (self.force(j) > 0 or self.g)]
        own, *others = (self.stiffness(j, self.delta[j]) for j in (i, *beside))
        return bool(beside) and self.force(i) < 3 * static and own > RIGID * max(others)

    def unite(self, i):
        self.rigid.add(self.number[i])
        a, b = self.inverse[i], self.inverse[i + 1]
        self.v[i + 1] = self.mean(i)
        self.inverse[i + 1] = 1 / (1 / a + 1 / b) if a and b else 0.0
        del self.v[i], self.inverse[i]
        for values in (self.k, self.k0, self.e, self.b, self.delta, self.phase, self.number):
            del values[i]
        self.body = [body - (body > i) for body in self.body]


def integrate(
    chain, law=JME, b=(), *, gravity=0.0, frozen=False, resolution=0.1, rtol=1e-12, most=5000, least=0.0
):
    """Follow a chain whose speeds are about 1 to its end, or until all speeds and depths are below `least`.

    `b` holds the damping parameter of each contact in SI units: c of a linear dashpot, or a of Hunt and Crossley's.
    Gravity is only for two balls on a table, in units in which m1 = k1 = |v0| = 1.
    """
    run = _Run(chain, law, b, gravity, frozen)
    states, limit = [run.acting()], False
    for _ in range(most):
        end = run.over()
        if end or np.abs([*run.v, *run.delta]).max() < least:
            ended = [*states, ()] if end == "free" and states[-1] else states
            return Answer(tuple(run.v[b] for b in run.body), tuple(ended), limit, end, run.t)
        n = len(run.k)
        if run.g and not any(map(run.acts, range(n))) and max(run.delta) <= ZERO:
            run.g = 0.0  # the first flight: from now on gravity is off
        watched, fastest = run.watched(), run.frequency()
        step = resolution / fastest if fastest else 0.3 if run.g else 1.0
        done = solve_ivp(
            run.rhs(),
            (0, 1e4 * step),
            np.array([*run.v, *run.delta]),
            method="DOP853",
            rtol=rtol,
            atol=1e-15 * np.array([1.0] * (n + 1) + [run.largest(i) for i in range(n)]),
            events=[event for event, _, _ in watched],
            max_step=step if fastest or run.g else np.inf,
            first_step=1e-3 * step,
        )
        assert done.success, done.message
        run.v, run.delta = list(done.y[: n + 1, -1]), list(done.y[n + 1 :, -1])
        run.t += done.t[-1]
        hit = [(t[0], *which) for t, (_, *which) in zip(done.t_events, watched, strict=True) if t.size]
        if hit:
            limit |= run.apply(*min(hit)[1:])
        if run.acting() != states[-1]:
            states.append(run.acting())
    raise AssertionError(f"not over after {most} events")
