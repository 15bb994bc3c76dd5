r"""Exact rigid impact laws for N balls in a line: an impact takes no time, and a contact has only a restitution e.

Contact i has the relative velocity u_i = v_i - v_{i+1}, which is negative while its bodies approach. The table is a
body of velocity 0 and inverse mass 0. With the impulses P_i >= 0 an impact changes u- to u+ = u- + G P. Here G = H M^-1
H^T is a tridiagonal matrix, M is the diagonal matrix of the masses, and H v = u. An impact involves all touching
contacts at once, and does not depend on positions. "Complementary" says that of two numbers at a contact at least one
is 0. The laws:

* **newton-restitution**: 0 <= P, u+ + e u- >= 0, complementary. (Moreau, in Nonsmooth Mechanics and Applications, CISM
  302, 1988; Glocker and Pfeiffer, Nonlinear Dynamics 7:471, 1995.) With unequal e it may create energy.
* **poisson-restitution**: compression, 0 <= C, u- + G C >= 0, complementary; then 0 <= P - (1 + e) C, u+ >= 0,
  complementary. So the impulse of restitution is e times the impulse of compression, or more where bodies would pass
  through each other. (Glocker and Pfeiffer, 1995; Anitescu and Potra, Nonlinear Dynamics 14:231, 1997.)
* **sequential-top**, **sequential-bottom**: single impacts of two bodies, P_i = -(1 + e_i) u_i/G_ii. The topmost
  (lowest) of the contacts that touch and approach is always next. Engines that sweep over contacts have other orders.
* **generalised-reflection** (Smith, Kaufman, Vouga, Tamstorf and Grinspun, "Reflections on Simultaneous Impact", ACM
  Trans. Graphics 31(4):106, 2012): while any contact approaches, P += 2 C, with C the compression of only the
  approaching contacts. The result is the elastic impulse. For e < 1 the impulse is (1 - e) times the compression of all
  touching contacts plus e times the elastic impulse, as in the authors' own program (github.com/breannansmith/scisim,
  GRROperator.cpp). The law has one e for all contacts.
* **plastic-then-restitution**: the compression C of all touching contacts; then one sweep over the contacts that
  approached before. The sweep changes each impulse so that u+ + e u- = 0, or to 0 if it would pull: first the odd
  contacts between balls, then the even ones, then the table. In later impacts at the same instant every e below 1 is
  replaced by 0, because a contact that still touches is at rest. This is the law of Rapier's program (is_bouncy in its
  contact_pair.rs). Compression comes before restitution as in Catto's soft step (box2d.org/posts/2024/02/solver2d), and
  the sweep follows the colours of its contact graph. We know no paper on this law.

**Sequences.** After an impact bodies may approach again: at once (by Newton's law, where a contact parted before the
impact) or after a flight. Impacts follow one another until no contact approaches. A contact touches only when its gap
is 0. If gaps close at the same instant (`SAME_INSTANT`), their contacts have one impact. All laws agree on the impact
of a single contact.

**Collapses.** Infinitely many impacts may follow one another at one instant, or in a finite time, while gaps and rates
of approach vanish. The bodies then touch, and move with the velocity of their centre of mass, or not at all if the
table is among them. `rigid.collapse` distinguishes a collapse from a sequence that ends.

**Solutions.** G is a Stieltjes matrix: its entries off the diagonal are not positive. Its complementarity problem has
one solution, found in at most as many linear systems as there are contacts: Chandrasekaran, Opsearch 7:263, 1970;
Cottle, Pang and Stone, The Linear Complementarity Problem, 1992, section 4.7.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.linalg import solveh_banded  # pyright: ignore[reportMissingTypeStubs, reportUnknownVariableType]

from impact_xval.compliant_baselines.rigid.collapse import VANISHED_GAP, VANISHED_SPEED, Bools, Watch
from impact_xval.model.arrays import Floats
from impact_xval.model.collision import Collision

#: Largest sum, over the sum of the absolute values of its terms, that is taken for rounding and set to 0.
ROUNDING = 2.0**-46

#: Largest relative difference of two times that are taken for the same instant.
SAME_INSTANT = 1e-12

#: Factor by which the number of impacts grows until a new state is recorded for comparison (`Watch`). So in the end a
#: recorded state is kept for as many impacts as the longest cycle has.
LATER = 1.5

#: Largest relative velocity of distant bodies that may be rounding, over the largest speed at the start.
TINY = 1e-14


class TooManyImpactsError(RuntimeError):
    """Error of a collision that is not over after the largest number of impacts; the message states this number."""


class PathPoint(NamedTuple):
    """A state of a line at the start or after an impact."""

    #: Time in s.
    time: float
    #: Relative velocities in m/s, shape (C,).
    u: Floats
    #: Mask of the contacts that touch at the start or have an impact here, shape (C,).
    acting: Bools


class Line:
    """Balls in a line between impacts, in SI units; arrays of balls have the shape (N,), arrays of contacts (C,).

    The state consists of relative velocities and gaps, not of velocities and positions. So each number keeps its
    relative precision, however small it becomes.
    """

    def __init__(self, c: Collision, most: int) -> None:
        self.mass, self.e, self.gaps = np.array(c.masses), np.array(c.restitutions), np.array(c.gaps)
        self.start, self.table, self.most = np.array(c.velocities), c.table, most
        contacts, below = self.e.size, np.append(1 / self.mass, 0.0)
        self.diagonal, self.off = (below[:-1] + below[1:])[:contacts], -below[1:contacts]
        self.weight = self.mass / self.mass.max()
        #: Relative velocities in m/s, negative where bodies approach; mask of contacts that touch; time in s since the
        #: start.
        self.u = -np.diff(self.start, append=0.0) if c.table else -np.diff(self.start)
        self.touching, self.time = self.gaps == 0, 0.0
        #: Number of impacts so far; True until the first impact at the present instant; True if a collapse has
        #: happened.
        self.impacts, self.fresh, self.endless = 0, True, False
        speed = np.abs(self.start).max()
        self.tiny = TINY * speed
        self.vanished = float(VANISHED_SPEED * speed), float(VANISHED_GAP * self.gaps.max())
        #: Time in s within which bodies must meet if they approach at less than `tiny`; later meetings are ignored.
        self.horizon = self.gaps.max() / self.tiny
        #: The first watch looks for cycles of impacts. Each further watch looks for cycles of the collapses that the
        #: watch before it has found.
        self.watches = [self.new_watch()]
        #: States at the start and after each impact.
        self.points = [PathPoint(0.0, self.u, self.touching)]

    def velocities(self, u: Floats) -> Floats:
        """Return velocities in m/s from relative velocities; if u is 0 at a contact, its balls have equal bits."""
        over_lowest = np.cumsum(u[::-1])[::-1]
        if self.table:
            return over_lowest
        over_lowest = np.append(over_lowest, 0.0)
        return over_lowest + self.weight @ (self.start - over_lowest) / self.weight.sum()

    def impulses(self, v: Floats) -> Floats:
        """Return the impulses in N s that have led to the velocities v in m/s, by the balance of momentum."""
        return np.cumsum(self.mass * (v - self.start))[: self.e.size]

    v = property(lambda self: self.velocities(self.u), doc="Velocities in m/s, shape (N,).")

    def after(self, u: Floats, impulse: Floats) -> Floats:
        """Return u + G P, the relative velocities in m/s after impulses P in N s; 0 where only rounding is left."""
        by_contact, by_neighbours = self.diagonal * impulse, np.zeros(u.size)
        by_neighbours[:-1] += self.off * impulse[1:]
        by_neighbours[1:] += self.off * impulse[:-1]
        new = u + by_contact + by_neighbours
        new[np.abs(new) <= ROUNDING * (np.abs(u) + by_contact - by_neighbours)] = 0.0
        return new

    def complementary(self, q: Floats, contacts: Bools) -> Floats:
        """Return impulses P with 0 <= P, q + G P >= 0, at least one of both 0, for some contacts.

        P is 0 at all others.
        """
        pushing, impulse = np.zeros(q.size, bool), np.zeros(q.size)
        while (new := contacts & ~pushing & (self.after(q, impulse) < 0)).any():
            pushing |= new
            # The matrix has one additional row, because LAPACK's ptsv refuses a matrix with a single row.
            band = np.array([np.zeros(q.size + 1), np.ones(q.size + 1)])
            band[0, 1:-1] = np.where(pushing[1:] & pushing[:-1], self.off, 0.0)
            band[1, :-1][pushing] = self.diagonal[pushing]
            right = np.append(np.where(pushing, -q, 0.0), 0.0)
            impulse = np.maximum(solveh_banded(band, right, check_finite=False)[:-1], 0.0)
        return impulse

    def approaching(self) -> Bools:
        """Return the mask of contacts that touch and approach."""
        return self.touching & (self.u < 0)

    def only_contact(self) -> int | None:
        """Return the contact that touches if it is the only one and approaches; else None."""
        touching = np.flatnonzero(self.touching)
        if touching.size == 1 and self.u[touching[0]] < 0:
            return int(touching[0])
        return None

    def strike(self, impulse: Floats) -> None:
        """Apply impulses in N s at the contacts."""
        self.go_on(self.after(self.u, impulse), impulse > 0)

    def bounce(self, contact: int) -> None:
        """Apply the impact of a single contact."""
        u, struck = self.u.copy(), np.zeros(self.e.size, bool)
        impulse = -(1 + self.e[contact]) * u[contact] / self.diagonal[contact]
        u[contact] = -self.e[contact] * u[contact]
        struck[contact] = True
        for neighbour in (contact - 1, contact + 1):
            if 0 <= neighbour < u.size:
                change = self.off[min(contact, neighbour)] * impulse
                new, rounding = u[neighbour] + change, ROUNDING * (abs(u[neighbour]) - change)
                u[neighbour] = new if abs(new) > rounding else 0.0
        self.go_on(u, struck)

    def go_on(self, u: Floats, struck: Bools) -> None:
        """Continue with relative velocities u in m/s after an impact in the contacts `struck`."""
        if self.impacts == self.most:
            raise TooManyImpactsError(f"not over after {self.impacts} impacts")
        self.u, self.impacts, self.fresh = u, self.impacts + 1, False
        self.points.append(PathPoint(self.time, u, struck))
        for watch in self.watches:
            watch.note(u, struck)
        self.look_for_collapse(struck)

    def look_for_collapse(self, struck: Bools) -> None:
        """Move on to the end of a collapse if the last impact, in the contacts `struck`, shows that there is one."""
        for level, watch in enumerate(self.watches):
            state = self.u, self.gaps, self.touching, struck
            time = watch.time_to_collapse(*state, self.vanished)
            watch.events += 1
            if time is None:
                if watch.events >= LATER * watch.begun:
                    self.watches[level] = Watch(watch.events, *state)
                return
            struck = watch.active
            self.collapse(struck, time)
            self.watches[level] = self.new_watch()
        self.watches.append(Watch(1, self.u, self.gaps, self.touching, struck))

    def new_watch(self) -> Watch:
        """Return a new watch that records the present state, before any impact."""
        return Watch(0, self.u, self.gaps, self.touching, np.zeros(self.e.size, bool))

    def collapse(self, active: Bools, time: float) -> None:
        """Move on by a time in s to the end of a collapse, where the active contacts are closed and at rest."""
        self.u, self.gaps = self.together(self.u, active), self.together(self.gaps, active)
        self.gaps = self.gaps + self.u * time
        if time:
            # A contact that touched before still touches if its bodies do not part.
            self.touching = active | (self.touching & (self.u == 0))
        else:
            self.touching = active | self.touching
        self.time, self.endless = self.time + time, True
        for watch in self.watches:
            watch.elapsed += time
        self.points.append(PathPoint(self.time, self.u, active))

    def together(self, u: Floats, closed: Bools) -> Floats:
        """Return relative velocities or gaps after bodies joined by closed contacts have moved to their centre of mass.

        The results are 0 at the closed contacts.
        """
        bodies = u.size + 1
        change = np.zeros(bodies)
        for group in np.split(np.arange(bodies), np.flatnonzero(~closed) + 1):
            over_lowest = np.append(np.cumsum(u[group[:-1]][::-1])[::-1], 0.0)
            on_table = self.table and group[-1] == bodies - 1
            mean = 0.0 if on_table else np.average(over_lowest, weights=self.weight[group])
            change[group] = mean - over_lowest
        return np.where(closed, 0.0, u - np.diff(change))

    def fly(self) -> bool:
        """Move freely until the next contact closes. Return False if no contact will close."""
        u, closing = self.u, ~self.touching & (self.u < 0)
        times = np.divide(self.gaps, -u, out=np.full(u.size, np.inf), where=closing)
        times[(u > -self.tiny) & (times > self.horizon)] = np.inf
        first = times.min()
        if first == np.inf:
            return False
        closed = times * (1 - SAME_INSTANT) <= first
        self.gaps = np.where(closed, 0.0, self.gaps + u * first)
        # A contact that touched before still touches if its bodies neither part nor approach.
        self.touching = closed | (self.touching & (u == 0))
        self.fresh = True
        self.time += first
        for watch in self.watches:
            watch.elapsed += first
        return True


def apply_newton(line: Line) -> None:
    """Apply Newton's restitution at all touching contacts."""
    line.strike(line.complementary((1 + line.e) * line.u, line.touching))


def apply_poisson(line: Line) -> None:
    """Apply Poisson's restitution at all touching contacts."""
    back = (1 + line.e) * line.complementary(line.u, line.touching)
    line.strike(back + line.complementary(line.after(line.u, back), line.touching))


def apply_reflections(line: Line) -> None:
    """Apply generalised reflections: a weighted sum of the elastic and the plastic impulse of all touching contacts."""
    plastic, e = line.complementary(line.u, line.touching), line.e[0]
    elastic, u = np.zeros(line.e.size), line.u
    left = line.most - line.impacts
    for _ in range(left):
        approaching = line.touching & (u < 0)
        if not approaching.any():
            break
        reflected = 2 * line.complementary(u, approaching)
        elastic, u = elastic + reflected, line.after(u, reflected)
    else:
        raise TooManyImpactsError(f"not over after {left} reflections")
    line.strike((1 - e) * plastic + e * elastic)


def apply_plastic_then_restitution(line: Line) -> None:
    """Apply the plastic impact of all touching contacts, then the restitution of the contacts that approached."""
    before, approached, between_balls = line.u, line.approaching(), line.mass.size - 1
    e = line.e if line.fresh else np.where(line.e < 1, 0.0, line.e)
    impulse = line.complementary(before, line.touching)
    odd, even = range(0, between_balls, 2), range(1, between_balls, 2)
    table = range(between_balls, line.e.size)
    for i in (*odd, *even, *table):
        if approached[i]:
            excess = e[i] * before[i] + line.after(before, impulse)[i]
            impulse[i] = max(impulse[i] - excess / line.diagonal[i], 0.0)
    line.strike(impulse)


def apply_topmost(line: Line) -> None:
    """Apply the single impact of the topmost contact that approaches."""
    line.bounce(int(np.flatnonzero(line.approaching())[0]))


def apply_lowest(line: Line) -> None:
    """Apply the single impact of the lowest contact that approaches."""
    line.bounce(int(np.flatnonzero(line.approaching())[-1]))


#: Functions that apply the impact of several touching contacts, by the name of the law. A contact that touches alone
#: rebounds in the same way by every law (`follow_impacts`). For a law with other single impacts, change
#: `follow_impacts` too. CONTRIBUTING.md lists what else a new law needs.
LAWS: dict[str, Callable[[Line], None]] = {
    "newton-restitution": apply_newton,
    "poisson-restitution": apply_poisson,
    "sequential-top": apply_topmost,
    "sequential-bottom": apply_lowest,
    "generalised-reflection": apply_reflections,
    "plastic-then-restitution": apply_plastic_then_restitution,
}


def follow_impacts(collision: Collision, law: str, most: int = 100_000) -> Line:
    """Follow balls in a line by a rigid law until no contact approaches; stiffnesses have no effect.

    Velocities and impulses at the end are exact to rounding.

    Raises
    ------
    ValueError
        If the law needs the same restitution at all contacts, and the restitutions differ.
    TooManyImpactsError
        If the collision is not over after `most` impacts.
    """
    if law == "generalised-reflection" and len(set(collision.restitutions)) > 1:
        raise ValueError(f"restitutions = {collision.restitutions}: {law} has one e for all contacts")
    line, going = Line(collision, most), True
    while going:
        while line.approaching().any():
            contact = line.only_contact()
            # All laws agree on the impact of a single contact.
            if contact is None:
                LAWS[law](line)
            else:
                line.bounce(contact)
        going = line.fly()
    # The rates of approach that are left are rounding (`Line.fly`).
    line.u = np.maximum(line.u, 0.0)
    return line
