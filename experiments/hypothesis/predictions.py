"""Where else a compliant solver goes, predicted from its law alone: closed forms, and one hybrid motion.

In real time a contact acts while its bodies overlap. So, whatever becomes infinitely stiff:

* **k2/k1 -> 0.** The balls collide as if free, and a gap opens that grows with the *soft* contact's motion
  (`cases.after_first_impact`). B2 turns around on the table. Where v11 >= 0 it leaves the table before it can catch up
  with B1, and what follows is the third impact of a sequence of single ones:
  u1 = v11, u2 = -e2 v21, and, if u2 > u1, u1 and u2 collide with e1. Where v11 < 0, B1 lands on B2 while the table
  contact is loaded: `rigid_on_soft`.
* **k2/k1 -> infinity.** B1 alone meets a wall: v1 = the restitution of contact 1 against m1, v2 = 0.
* **e1 -> 0 by a dashpot.** An infinite dashpot joins the balls at first touch, not at the end of a compression:
  one body of mass m1 + m2 and velocity -m1/(m1 + m2) meets the table contact.
* **e2 -> 0 by a dashpot.** B2 never moves: as k2/k1 -> infinity.

What restitution a contact then shows depends on its law. A linear dashpot mapped with the mass M and working against
m has the damping ratio zeta sqrt(M/m) (Schwager and Poeschel, Granular Matter 9:465, 2007); Hunt and Crossley's
restitution is independent of the mass and depends on the speed; the bistiffness law returns e, always.

**A rigid ball-ball contact above a compliant table contact** (`rigid_on_soft`), in units m1 = 1, k2 = 1, v0 = -1: the
ball-ball contact is an instantaneous impact with restitution e1 whenever its gap is closed and its bodies approach.
Between impacts B1 flies, and B2 is free or moves on contact 2,

    m2 p'' + c p' + k p = 0,    p = -x2,    F2 = k p + c p' >= 0,

a damped sinusoid or, from a damping ratio of 1 on (a dashpot's e2 <= exp(-2)), two decays, both in closed form. An end
of compression of the bistiffness law (c = 0) takes p to e2^2 p and k to k/e2^2. While F2 > 0 the gap is a concave
function of time (x1 is linear and x2'' = F2/m2), so it closes at most once in a segment: its sign at the end of the
segment says whether, and a bracketed root when. Impacts under load come ever faster (for e1 < 1 infinitely many in a
finite time). Once one parts the balls by less than `TOGETHER` while F2 presses them together, they are one body of
mass m1 + m2 until F2 ends: then neither pulls.

Nothing here is shared with the compiled references, which are compared with it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import brentq

from impact_xval.compliant_baselines.mapping import damping_ratio, restitution, textbook_damping_ratio
from impact_xval.compliant_baselines.restitution import hunt_crossley_coefficients
from impact_xval.experiments.hypothesis.cases import Case, Point, after_first_impact

#: Families with a law to predict from.
FAMILIES = (
    "bistiffness",
    "kelvin-voigt",
    "kelvin-voigt-anchored",
    "kelvin-voigt-textbook",
    "hunt-crossley",
)

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
class Prediction:
    """Where a solver should go: v1 and v2 per abs(v0), and in a few words what that rests on."""

    v1: float
    v2: float
    form: str


@dataclass(frozen=True, slots=True)
class TableContact:
    """Contact 2: a dashpot of ratio zeta for m2 alone, or (zeta = 0) a spring that keeps e^2 of its energy."""

    zeta: float
    e: float


def dashpot_restitution(zeta: float, mapped: float, against: float) -> float:
    """Restitution of a linear dashpot of ratio zeta for the mass it was mapped with, working against another."""
    return restitution(zeta * math.sqrt(mapped / against))


def hunt_crossley_restitution(a: float, speed: float) -> float:
    """Restitution of F = k p (1 + a p') at a speed of approach: `restitution_laws` (*), solved for e."""
    A = a * speed
    if A == 0:
        return 1.0
    # A (1 + e) - ln((1 + A)/(1 - e A)) = 0 has the root e = -1 too; it is positive at e = 0 and negative at
    # e -> 1/A and beyond the root.
    high = min(1.0, (1 - 1e-15) / A)

    def excess(e: float) -> float:
        return A * (1 + e) - math.log1p(A) + math.log1p(-e * A)

    if excess(high) >= 0:
        return 1.0
    root: Any = brentq(excess, 0.0, high, xtol=1e-15)
    return float(root)


@dataclass(frozen=True, slots=True)
class Contacts:
    """The contacts of a family at a point, with e_i > 0 (or NaN where it goes to 0 and plays no part).

    Attributes
    ----------
    family : str
    mass_ratio, e1, e2 : float
    """

    family: str
    mass_ratio: float
    e1: float
    e2: float

    def _zeta(self, e: float) -> float:
        return textbook_damping_ratio(e) if self.family.endswith("textbook") else damping_ratio(e)

    def _restitution(self, e: float, mapped: float, against: float, speed: float) -> float:
        if self.family == "bistiffness":
            return e
        if self.family == "hunt-crossley":
            return hunt_crossley_restitution(float(hunt_crossley_coefficients(np.array([e]))[0]), speed)
        return dashpot_restitution(self._zeta(e), mapped, against)

    def ball_ball(self, against: float, speed: float) -> float:
        """Restitution of contact 1 against a mass (m1 = 1) at a speed of approach."""
        pair = self.mass_ratio / (1 + self.mass_ratio)
        return self._restitution(self.e1, 1.0 if self.family.endswith("anchored") else pair, against, speed)

    def ball_table(self, against: float, speed: float) -> float:
        """Restitution of contact 2 against a mass at a speed of approach."""
        return self._restitution(self.e2, self.mass_ratio, against, speed)

    def table(self) -> TableContact | None:
        """Contact 2 for a motion in time; None where it is not linear."""
        if self.family == "bistiffness":
            return TableContact(0.0, self.e2)
        return None if self.family == "hunt-crossley" else TableContact(self._zeta(self.e2), 1.0)


def predict(case: Case, point: Point, family: str) -> Prediction | None:
    """Predict the limit of a compliant solver; None where its family or the limit has no closed form here."""
    if family not in FAMILIES:
        return None
    mu = point.mass_ratio
    contacts = Contacts(family, mu, point.e1, point.e2)
    if case.variable == "k1/k2":
        return _soft_table(mu, contacts)
    # The impact law is the model's own where nothing returns; the textbook's zeta goes to 1, not to infinity.
    if case.plastic and family in ("bistiffness", "kelvin-voigt-textbook"):
        return None
    if case.stiff == 1:
        speed = 1 / (1 + mu)
        v = contacts.ball_table(1 + mu, speed) * speed
        return Prediction(v, v, "one body of both masses from the first touch")
    return Prediction(contacts.ball_ball(1.0, 1.0), 0.0, "contact 1 against m1 alone")


def _soft_table(mu: float, contacts: Contacts) -> Prediction | None:
    pair = mu / (1 + mu)
    e1 = contacts.ball_ball(pair, 1.0)
    v11, v21 = after_first_impact(mu, e1)
    u2 = -contacts.ball_table(mu, -v21) * v21
    if v11 >= 0:
        if u2 <= v11:
            return Prediction(v11, u2, "one impact of each contact")
        impulse = pair * (1 + contacts.ball_ball(pair, u2 - v11)) * (u2 - v11)
        return Prediction(v11 + impulse, u2 - impulse / mu, "a sequence of three single impacts")
    table = contacts.table()
    if table is None:
        return None
    v1, v2 = rigid_on_soft(mu, e1, v11, v21, table)
    return Prediction(v1, v2, "a rigid ball-ball contact that can open, on the soft table contact")


@dataclass(frozen=True, slots=True)
class _Oscillator:
    """p'' + 2 b p' + w^2 p = 0 from p0, u0: position and rate in closed form.

    For b < w with s = sqrt(w^2 - b^2) it swings as exp(-b t) cos(st) and sin(st). Else, with s = sqrt(b^2 - w^2), the
    characteristic roots are -(b - s) = -w^2/(b + s) and -(b + s), and cos(st) and sin(st)/s become cosh(st) and
    sinh(st)/s, at s = 0 1 and t.
    """

    p0: float
    u0: float
    b: float
    w: float

    @property
    def _swings(self) -> bool:
        return self.b < self.w * (1 - NEARLY)

    @property
    def _s(self) -> float:
        return math.sqrt(max((self.w - self.b) * (self.w + self.b) * (1 if self._swings else -1), 0.0))

    def moved(self, t: float) -> tuple[float, float]:
        """Return p - p0, without cancellation for short times, and p', at a time."""
        s, unit, grown = self._s, 1.0, math.expm1(-self.b * t)
        if self._swings:
            unit, cosine, sine, risen = s, math.cos(s * t), math.sin(s * t), -2 * math.sin(0.5 * s * t) ** 2
        else:
            cosine, sine = math.cosh(s * t), math.sinh(s * t) / s if s > 0 else t
            risen = 2 * math.sinh(0.5 * s * t) ** 2
        decay = 1 + grown
        first = (self.u0 + self.b * self.p0) / unit
        moved = decay * first * sine + self.p0 * (grown * cosine + risen)
        rate = decay * (self.u0 * cosine - (self.w**2 * self.p0 + self.b * self.u0) / unit * sine)
        return moved, rate

    def _parts(self, alpha: float, beta: float) -> tuple[float, float]:
        """Return C and S of alpha p + beta p' = exp(-b t) (C cos st + S sin st), or (C cosh st + S sinh(st)/s)."""
        unit = self._s if self._swings else 1.0
        S = (
            alpha * (self.u0 + self.b * self.p0) / unit
            - beta * (self.w**2 * self.p0 + self.b * self.u0) / unit
        )
        return alpha * self.p0 + beta * self.u0, S

    def most(self, alpha: float, beta: float) -> float:
        """Return a number that alpha p + beta p' does not exceed at t >= 0."""
        C, S = self._parts(alpha, beta)
        if self._swings:
            return math.hypot(C, S)
        # exp(-b t) sinh(st)/s <= t exp(-(b - s) t), which is largest at t = 1/(b - s).
        slow = self.w**2 / (self.b + self._s)
        return max(C, 0.0) + max(S, 0.0) / (math.e * slow)

    def zero_of(self, alpha: float, beta: float) -> float:
        """Return the first t > 0 at which alpha p + beta p' falls through zero; it is positive, or zero, at 0.

        A contact force k p + c p' that is positive at a p >= 0 does so also without a swing. There p' > -(w^2/2b) p,
        so that the part of p that decays as exp(-(b - s) t) is positive. It outlives the other, and its own force is
        (b - s)^2 times the mass towards the table.
        """
        s, (C, S) = self._s, self._parts(alpha, beta)
        if not self._swings:
            return math.atanh(-s * C / S) / s if s > 0 else -C / S  # tanh(st)/s = -C/S
        # R cos(st - phase) falls through zero at st = phase + pi/2.
        angle = (math.atan2(S, C) + 0.5 * math.pi) % (2 * math.pi)
        return (angle if angle > 1e-14 else 2 * math.pi) / s


def _gap_after(t: float, spring: _Oscillator, gap: float, v1: float) -> float:
    return gap + v1 * t + spring.moved(t)[0]


@dataclass(slots=True)
class _Balls:
    """Both balls after their first impact: the state of the hybrid motion, and its three kinds of segments."""

    mu: float
    e1: float
    v1: float
    v2: float
    table: TableContact
    k: float = 1.0
    p: float = 0.0
    gap: float = 0.0
    one_body: bool = False
    compressing: bool = True
    loaded: bool = True

    @property
    def c(self) -> float:
        return 2 * self.table.zeta * math.sqrt(self.mu)

    def fly(self) -> bool:
        """Move to the next touch of B2 and the table, or of the balls; whether it is of the balls."""
        # Where p < 0, -p is the height of B2 above the table.
        touch = self.p / self.v2 if self.p < 0 and self.v2 < 0 else math.inf
        meet = self.gap / (self.v2 - self.v1) if self.v2 > self.v1 else math.inf
        t = min(touch, meet)
        self.gap, self.p = self.gap + (self.v1 - self.v2) * t, self.p - self.v2 * t
        if touch < meet:
            self.p, self.compressing, self.loaded = 0.0, True, True
        return not touch < meet

    def press(self) -> bool:
        """Move while the table presses, to an impact of the balls, or to the end of compression or of the force."""
        k, c, mass = self.k, self.c, 1 + self.mu if self.one_body else self.mu
        spring = _Oscillator(self.p, -self.v2, 0.5 * c / mass, math.sqrt(k / mass))
        loses = self.table.zeta == 0 and self.compressing
        t = spring.zero_of(0.0, 1.0) if loses else spring.zero_of(k, c)
        impact = not self.one_body and _gap_after(t, spring, self.gap, self.v1) < 0
        if impact:
            # From a closed gap, a distance of (v1 - v2) t - (F2/m2) t^2/2 or more lies between the balls.
            start = 0.0 if self.gap > 0 else (self.v1 - self.v2) * self.mu / spring.most(k, c)
            root: Any = brentq(_gap_after, start, t, args=(spring, self.gap, self.v1), xtol=1e-300, rtol=RTOL)
            t = float(root)
        moved, rate = spring.moved(t)
        self.gap = 0.0 if impact or self.one_body else _gap_after(t, spring, self.gap, self.v1)
        self.p, self.v2 = self.p + moved, -rate
        if not impact and loses:
            e = self.table.e
            self.p, self.k, self.v2, self.compressing = e**2 * self.p, k / e**2, 0.0, False
        elif not impact:
            self.p, self.loaded = (max(self.p, 0.0) if c > 0 else 0.0), False
        self.v1 = self.v2 if self.one_body else self.v1
        return impact

    def collide(self) -> None:
        """Let the balls collide; they are one body from then on if they hardly part."""
        mu, closing = self.mu, self.v2 - self.v1
        mean = (self.v1 + mu * self.v2) / (1 + mu)
        self.v1, self.v2 = mean + self.e1 * closing * mu / (1 + mu), mean - self.e1 * closing / (1 + mu)
        self.gap, self.compressing = 0.0, self.compressing or self.v2 < 0
        force = self.k * self.p - self.c * self.v2
        self.loaded = (self.p > 0 and force > 0) or (self.p == 0 and self.v2 < 0)
        if self.loaded and self.v1 - self.v2 < TOGETHER:
            self.one_body, self.v1, self.v2 = True, mean, mean


def rigid_on_soft(
    mass_ratio: float, e1: float, v1: float, v2: float, table: TableContact
) -> tuple[float, float]:
    """Follow both balls from the instant after their first impact, at which B2 touches the table.

    Parameters
    ----------
    mass_ratio : float
        m2/m1.
    e1 : float
        Restitution of the ball-ball contact, in [0, 1].
    v1, v2 : float
        Velocities after the first impact, per abs(v0).
    table : TableContact
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
    balls = _Balls(mass_ratio, e1, v1, v2, table)
    for _ in range(MOST_EVENTS):
        if not balls.loaded and (balls.one_body or balls.v1 >= balls.v2 >= 0):
            return balls.v1, balls.v2
        if balls.press() if balls.loaded else balls.fly():
            balls.collide()
    raise RuntimeError(f"not over after {MOST_EVENTS} events")
