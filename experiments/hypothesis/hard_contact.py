"""A rigid ball-ball contact above a compliant ball-table contact: the limit k2/k1 -> 0 of motion in time.

Units: m1 = 1, k2 = 1, v0 = -1; the ball-ball contact is an instantaneous impact with restitution e1 whenever its gap
is closed and its bodies approach. Between impacts B1 flies, and B2 is free or moves on contact 2,

    m2 p'' + c p' + k p = 0,    p = -x2,    F2 = k p + c p' >= 0,

a damped sinusoid or, from a damping ratio of 1 on (a dashpot's e2 <= exp(-2)), two decays, both in closed form. An end
of compression of the bistiffness law (c = 0) takes p to e2^2 p and k to k/e2^2. While F2 > 0 the gap is a concave
function of time (x1 is linear and x2'' = F2/m2), so it closes at most once in a stretch: its sign at the end of the
stretch says whether, and a bracketed root when.

Impacts under load come ever faster (for e1 < 1 infinitely many in a finite time). Once one parts the balls by less
than `TOGETHER` while F2 presses them together, they are one body of mass m1 + m2 until F2 ends: then neither pulls.

Nothing here is shared with the compiled references; it is what they are compared with.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from scipy.optimize import brentq

#: Relative velocity, per abs(v0), below which balls that are pressed together are one body.
TOGETHER = 1e-8

#: Relative tolerance of the instants of impacts.
RTOL: Any = 1e-14

#: Damping ratios that are less than 1 by no more than this are taken as 1: nearer, the period is so long that an
#: instant read from a phase loses more digits than that.
NEARLY = 1e-10

#: Events after which the motion is given up.
MOST_EVENTS = 100_000


@dataclass(frozen=True, slots=True)
class Table:
    """Contact 2: a dashpot of ratio zeta for m2 alone, or (zeta = 0) a spring that keeps e^2 of its energy."""

    zeta: float
    e: float


@dataclass(frozen=True, slots=True)
class _Spring:
    """p'' + 2 b p' + w^2 p = 0 from p0, u0 (b < w): position and rate in closed form."""

    p0: float
    u0: float
    b: float
    w: float

    @property
    def _damped(self) -> float:
        return math.sqrt((self.w - self.b) * (self.w + self.b))

    def moved(self, t: float) -> tuple[float, float]:
        """Return p - p0, without cancellation for short times, and p', at a time."""
        s, grown = self._damped, math.expm1(-self.b * t)
        decay = 1 + grown
        cosine, sine = math.cos(s * t), math.sin(s * t)
        first = (self.u0 + self.b * self.p0) / s
        moved = decay * first * sine + self.p0 * (grown * cosine - 2 * math.sin(0.5 * s * t) ** 2)
        rate = decay * (self.u0 * cosine - (self.w**2 * self.p0 + self.b * self.u0) / s * sine)
        return moved, rate

    def _phasor(self, alpha: float, beta: float) -> tuple[float, float]:
        """Return C and S of alpha p + beta p' = exp(-b t) (C cos st + S sin st)."""
        s = self._damped
        S = alpha * (self.u0 + self.b * self.p0) / s - beta * (self.w**2 * self.p0 + self.b * self.u0) / s
        return alpha * self.p0 + beta * self.u0, S

    def most(self, alpha: float, beta: float) -> float:
        """Return a number that alpha p + beta p' does not exceed at t >= 0."""
        return math.hypot(*self._phasor(alpha, beta))

    def zero_of(self, alpha: float, beta: float) -> float:
        """Return the first t > 0 at which alpha p + beta p' falls through zero; it is positive, or zero, at 0."""
        C, S = self._phasor(alpha, beta)
        # R cos(st - phase) falls through zero at st = phase + pi/2.
        angle = (math.atan2(S, C) + 0.5 * math.pi) % (2 * math.pi)
        return (angle if angle > 1e-14 else 2 * math.pi) / self._damped


@dataclass(frozen=True, slots=True)
class _Creep:
    """The same motion for b >= w, where it does not swing.

    With r = sqrt(b^2 - w^2) the characteristic roots are -(b - r) = -w^2/(b + r) and -(b + r). So cos(st) and sin(st)/s
    of the damped sinusoid become cosh(rt) and sinh(rt)/r, and at r = 0 they are 1 and t; all else stays.
    """

    p0: float
    u0: float
    b: float
    w: float

    @property
    def _r(self) -> float:
        return math.sqrt(max((self.b - self.w) * (self.b + self.w), 0.0))

    def moved(self, t: float) -> tuple[float, float]:
        """Return p - p0, without cancellation for short times, and p', at a time."""
        r, grown = self._r, math.expm1(-self.b * t)
        decay = 1 + grown
        cosine, sine = math.cosh(r * t), math.sinh(r * t) / r if r > 0 else t
        first = self.u0 + self.b * self.p0
        moved = decay * first * sine + self.p0 * (grown * cosine + 2 * math.sinh(0.5 * r * t) ** 2)
        rate = decay * (self.u0 * cosine - (self.w**2 * self.p0 + self.b * self.u0) * sine)
        return moved, rate

    def _parts(self, alpha: float, beta: float) -> tuple[float, float]:
        """Return C and S of alpha p + beta p' = exp(-b t) (C cosh rt + S sinh(rt)/r)."""
        S = alpha * (self.u0 + self.b * self.p0) - beta * (self.w**2 * self.p0 + self.b * self.u0)
        return alpha * self.p0 + beta * self.u0, S

    def most(self, alpha: float, beta: float) -> float:
        """Return a number that alpha p + beta p' does not exceed at t >= 0."""
        C, S = self._parts(alpha, beta)
        # exp(-b t) sinh(rt)/r <= t exp(-(b - r) t), which is largest at t = 1/(b - r).
        slow = self.w**2 / (self.b + self._r)
        return max(C, 0.0) + max(S, 0.0) / (math.e * slow)

    def zero_of(self, alpha: float, beta: float) -> float:
        """Return the t > 0 at which alpha p + beta p' falls through zero; it is positive at 0.

        A contact force k p + c p' that is positive at a p >= 0 does so. There p' > -(w^2/2b) p, so that the part
        of p that decays as exp(-(b - r) t) is positive. It outlives the other, and its own force is (b - r)^2 times
        the mass towards the table.
        """
        C, S = self._parts(alpha, beta)
        r = self._r
        # tanh(rt)/r = -C/S
        return math.atanh(-r * C / S) / r if r > 0 else -C / S


def _contact(p0: float, u0: float, b: float, w: float) -> _Spring | _Creep:
    return (_Spring if b < w * (1 - NEARLY) else _Creep)(p0, u0, b, w)


def _gap_after(t: float, spring: _Spring | _Creep, gap: float, v1: float) -> float:
    return gap + v1 * t + spring.moved(t)[0]


def hard_ball_ball(mass_ratio: float, e1: float, v1: float, v2: float, table: Table) -> tuple[float, float]:
    """Follow both balls from the instant after their first impact, at which B2 touches the table.

    Parameters
    ----------
    mass_ratio : float
        m2/m1.
    e1 : float
        Restitution of the ball-ball contact, in [0, 1].
    v1, v2 : float
        Velocities after the first impact, per abs(v0).
    table : Table
        Contact 2.

    Returns
    -------
    v1, v2 : float
        Velocities when the balls part for good.

    Raises
    ------
    RuntimeError
        After `MOST_EVENTS`.
    """
    mu = mass_ratio
    c = 2 * table.zeta * math.sqrt(mu)
    k, p, gap, one, compressing, loaded = 1.0, 0.0, 0.0, False, True, True
    for _ in range(MOST_EVENTS):
        if not loaded:
            # B2 flies, or slides out of a contact whose force has ended.
            if one or (v1 >= v2 >= 0):
                return v1, v2
            touch = p / v2 if p < 0 and v2 < 0 else math.inf  # -p is its height above the table
            meet = gap / (v2 - v1) if v2 > v1 else math.inf
            t = min(touch, meet)
            gap, p = gap + (v1 - v2) * t, p - v2 * t
            if touch < meet:
                p, compressing, loaded = 0.0, True, True
                continue
            impact = True
        else:
            mass = 1 + mu if one else mu
            spring = _contact(p, -v2, 0.5 * c / mass, math.sqrt(k / mass))
            loses = table.zeta == 0 and compressing
            t = spring.zero_of(0.0, 1.0) if loses else spring.zero_of(k, c)
            impact = not one and _gap_after(t, spring, gap, v1) < 0
            if impact:
                # From a closed gap, a distance of (v1 - v2) t - (F2/m2) t^2/2 or more lies between the balls.
                start = 0.0 if gap > 0 else (v1 - v2) * mu / spring.most(k, c)
                root: Any = brentq(_gap_after, start, t, args=(spring, gap, v1), xtol=1e-300, rtol=RTOL)
                t = float(root)
            moved, rate = spring.moved(t)
            gap, p, v2 = 0.0 if impact or one else _gap_after(t, spring, gap, v1), p + moved, -rate
            v1 = v2 if one else v1
            if not impact and loses:
                p, k, v2, compressing = table.e**2 * p, k / table.e**2, 0.0, False
                v1 = 0.0 if one else v1
            elif not impact:
                p, loaded = (max(p, 0.0) if c > 0 else 0.0), False
        if impact:
            closing, mean = v2 - v1, (v1 + mu * v2) / (1 + mu)
            v1, v2 = mean + e1 * closing * mu / (1 + mu), mean - e1 * closing / (1 + mu)
            gap, compressing = 0.0, compressing or v2 < 0
            loaded = (p > 0 and k * p - c * v2 > 0) or (p == 0 and v2 < 0)
            if loaded and v1 - v2 < TOGETHER:
                one, v1, v2 = True, mean, mean
    raise RuntimeError(f"not over after {MOST_EVENTS} events")
