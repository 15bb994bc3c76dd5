r"""Rigid impact laws for N balls in a line, exact: an impact takes no time, and a contact is a restitution e alone.

Contact i has the relative velocity u_i = v_i - v_{i+1} (v_N at the table, a body of inverse mass 0), which is negative
while its bodies approach, and the impulse P_i >= 0: u+ = u- + G P, with the tridiagonal G = H M^-1 H^T, H v = u. An
impact is that of all touching contacts at once, with no positions in it. The laws:

* **newton-restitution**: 0 <= P, u+ + e u- >= 0, complementary. (Moreau, in Nonsmooth Mechanics and Applications, CISM
  302, 1988; Glocker and Pfeiffer, Nonlinear Dynamics 7:471, 1995.) With unequal e it may create energy.
* **poisson-restitution**: compression, 0 <= C, u- + G C >= 0, complementary; then 0 <= P - (1 + e) C, u+ >= 0,
  complementary: e times the impulse of compression comes back, and more where bodies would pass through each other.
  (Glocker and Pfeiffer, 1995; Anitescu and Potra, Nonlinear Dynamics 14:231, 1997.)
* **sequential-top**, **sequential-bottom**: single impacts of two bodies, P_i = -(1 + e_i) u_i/G_ii; of the contacts
  that touch and approach, always the topmost (lowest) is next. Engines that sweep have other orders where several
  approach. A sequence of infinitely many impacts is followed until no rate of approach exceeds `TINY` of the largest
  speed; what is left of a geometric sequence is of that size.
* **generalised-reflection** (Smith, Kaufman, Vouga, Tamstorf and Grinspun, "Reflections on Simultaneous Impact", ACM
  Trans. Graphics 31(4):106, 2012): while any approach, P += 2 C, with C the compression of the approaching contacts
  alone. For e < 1 we take (1 - e) times the compression of all touching contacts and e times that elastic impulse, as
  the authors' own program does (github.com/breannansmith/scisim, GRROperator.cpp). It has one e for all contacts.
* **plastic-then-restitution**: the compression C of all touching contacts; then one sweep over those that approached
  before it, in which each impulse is changed to u+ + e u- = 0, or 0 if it would pull: first the odd contacts between
  balls, then the even ones, then the table. In what follows at the same instant, e = 0 unless e = 1: a contact that
  still touches is at rest. (The program of Rapier: is_bouncy in its contact_pair.rs; the order of the parts is that of
  Catto's soft step, box2d.org/posts/2024/02/solver2d, and that of the sweep the colours of its contact graph. No paper
  of it is known to us.)

After an impact bodies may approach again, at once (by Newton's law, where a contact parted before the impact) or after
a flight: impacts follow one another until no contact approaches. Contacts whose gaps close at the same instant, within
`TINY_GAP` of the largest gap, are one impact.

G is a Stieltjes matrix (its entries off the diagonal are not positive), for which the complementarity problem has one
solution, found in at most as many linear systems as there are contacts: Chandrasekaran, Opsearch 7:263, 1970; Cottle,
Pang and Stone, The Linear Complementarity Problem, 1992, section 4.7.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from importlib.metadata import version

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded
from scipy.optimize import isotonic_regression

from impact_xval.compliant_baselines.solver import OneByOne, Settings
from impact_xval.model.collision import Collision, Floats, Outcome, Path, name_of_set

Bools = NDArray[np.bool_]

#: Relative velocity, over the largest speed at the start, below which bodies move together.
TINY = 1e-14

#: Gap, over the largest at the start, below which bodies touch.
TINY_GAP = 1e-12

#: Rate of approach over the largest speed from which on a sequence of impacts counts as one without end: single impacts
#: of a finite sequence are not that slow.
ENDLESS = 1e-9


class TooManyImpactsError(RuntimeError):
    """A collision was given up; the message says after how many impacts."""


class Line:
    """Balls in a line, between impacts, in SI units; arrays of balls have the shape (N,), of contacts (C,)."""

    def __init__(self, c: Collision, most: int) -> None:
        given = (np.array(each) for each in (c.masses, c.velocities, c.restitutions, c.gaps))
        self.mass, self.v, self.e, self.gaps = given
        self.table, self.most, contacts = c.table, most, self.e.size
        #: Relative velocity, and gap, that count as none.
        self.tiny, self.smallest = TINY * max(map(abs, c.velocities)), TINY_GAP * self.gaps.max()
        self.touching, self.impulse, self.time = self.gaps <= self.smallest, np.zeros(contacts), 0.0
        #: How many so far, whether there has been none at this instant, and their lowest rate of approach.
        self.impacts, self.fresh, self.slowest = 0, True, np.inf
        below = np.append(1 / self.mass, 0.0)
        self.diagonal, self.off = (below[:-1] + below[1:])[:contacts], -below[1:contacts]
        # Time, velocities, impulses and acting contacts at the start and after each impact.
        self.points = [(0.0, self.v, self.impulse, self.touching)]

    @property
    def u(self) -> Floats:
        """Relative velocities in m/s, shape (C,)."""
        return -np.diff(self.v, append=0.0) if self.table else -np.diff(self.v)

    def after(self, impulse: Floats) -> Floats:
        """Give the change of relative velocities in m/s that impulses in N s make: G P."""
        change = self.diagonal * impulse
        change[:-1] += self.off * impulse[1:]
        change[1:] += self.off * impulse[:-1]
        return change

    def complementary(self, q: Floats, contacts: Bools) -> Floats:
        """Solve 0 <= P, q + G P >= 0, complementary, of some contacts; P of the others is 0."""
        among, impulse = np.zeros(q.size, bool), np.zeros(q.size)
        while (new := contacts & ~among & (q + self.after(impulse) < 0)).any():
            among |= new
            # One row more than there are contacts: LAPACK's ptsv is not to be had for a single one.
            band = np.array([np.zeros(q.size + 1), np.ones(q.size + 1)])
            band[0, 1:-1] = np.where(among[1:] & among[:-1], self.off, 0.0)
            band[1, :-1][among] = self.diagonal[among]
            right = np.append(np.where(among, -q, 0.0), 0.0)
            impulse = solveh_banded(band, right, check_finite=False)[:-1]
        return np.maximum(impulse, 0.0)

    def approaching(self) -> Bools:
        """Tell which contacts touch and approach."""
        return self.touching & (self.u < -self.tiny)

    def strike(self, impulse: Floats) -> None:
        """Apply impulses in N s."""
        if self.impacts == self.most:
            raise TooManyImpactsError(f"not over after {self.impacts} impacts")
        rates = -self.u[impulse > 0]
        self.slowest = min(self.slowest, rates[rates > self.tiny].min(initial=np.inf))
        self.impulse = self.impulse + impulse
        above = np.append(impulse, [] if self.table else [0.0])
        self.v = self.v + (above - np.append(0.0, above[:-1])) / self.mass
        self.impacts, self.fresh = self.impacts + 1, False
        self.points.append((self.time, self.v, self.impulse, impulse > 0))

    def fly(self) -> bool:
        """Move freely until the next contact closes; False if none will."""
        u = self.u
        meet = ~self.touching & (u < -self.tiny)
        if not meet.any():
            return False
        times = np.divide(self.gaps, -u, out=np.full(u.size, np.inf), where=meet)
        first = int(times.argmin())
        self.time += times[first]
        self.gaps = self.gaps + u * times[first]
        self.gaps[first], self.fresh = 0.0, True
        self.touching = self.gaps <= self.smallest
        return True

    def unite(self) -> None:
        """Give one velocity to bodies that touch and move together but for rounding: that of their centre of mass."""
        together = self.touching & (np.abs(self.u) <= self.tiny)
        apart = np.flatnonzero(~together[: self.mass.size - 1]) + 1
        groups = zip(np.split(self.v, apart), np.split(self.mass, apart), strict=True)
        v = [np.full(m.size, np.average(v, weights=m)) if m.size > 1 else v for v, m in groups]
        if self.table and together[-1]:
            v[-1] = np.zeros_like(v[-1])
        # Rounding may leave bodies that approach by less than `tiny`: take the nearest ordered velocities.
        self.v = isotonic_regression(np.concatenate(v), weights=self.mass, increasing=False).x
        if self.table:
            self.v = np.maximum(self.v, 0.0)


def newton(line: Line) -> None:
    """Apply Newton's restitution at all touching contacts."""
    line.strike(line.complementary((1 + line.e) * line.u, line.touching))


def poisson(line: Line) -> None:
    """Apply Poisson's restitution at all touching contacts."""
    back = (1 + line.e) * line.complementary(line.u, line.touching)
    line.strike(back + line.complementary(line.u + line.after(back), line.touching))


def reflection(line: Line) -> None:
    """Apply generalised reflections, blended with the plastic impact of all touching contacts."""
    plastic, e = line.complementary(line.u, line.touching), line.e[0]
    elastic, u = np.zeros(line.e.size), line.u
    left = line.most - line.impacts
    for _ in range(left):
        approaching = line.touching & (u < -line.tiny)
        if not approaching.any():
            break
        elastic += 2 * line.complementary(u, approaching)
        u = line.u + line.after(elastic)
    else:
        raise TooManyImpactsError(f"not over after {left} reflections")
    line.strike((1 - e) * plastic + e * elastic)


def plastic_first(line: Line) -> None:
    """Apply the plastic impact of all touching contacts, then the restitution of those that approached."""
    before, among, between = line.u, line.approaching(), line.mass.size - 1
    e = line.e if line.fresh else np.where(line.e < 1, 0.0, line.e)
    impulse = line.complementary(before, line.touching)
    for i in (*range(0, between, 2), *range(1, between, 2), *range(between, line.e.size)):
        if among[i]:
            goal = (1 + e[i]) * before[i] + line.after(impulse)[i]
            impulse[i] = max(impulse[i] - goal / line.diagonal[i], 0.0)
    line.strike(impulse)


def single(line: Line, place: int) -> None:
    """Apply the single impact of a contact that approaches, the topmost (place 0) or the lowest (-1) of them."""
    i = np.flatnonzero(line.approaching())[place]
    impulse = np.zeros(line.e.size)
    impulse[i] = -(1 + line.e[i]) * line.u[i] / line.diagonal[i]
    line.strike(impulse)


LAWS: dict[str, Callable[[Line], None]] = {
    "newton-restitution": newton,
    "poisson-restitution": poisson,
    "sequential-top": partial(single, place=0),
    "sequential-bottom": partial(single, place=-1),
    "generalised-reflection": reflection,
    "plastic-then-restitution": plastic_first,
}


def follow(collision: Collision, law: str, most: int = 100_000) -> Line:
    """Follow balls by a rigid law until no contact approaches; stiffnesses play no part.

    Velocities and impulses at the end are exact to rounding. A ValueError says that the law has one restitution for all
    contacts and is given several; a TooManyImpactsError that it was not over after `most` impacts.
    """
    if law == "generalised-reflection" and len(set(collision.restitutions)) > 1:
        raise ValueError(f"restitutions = {collision.restitutions}: {law} has one e for all contacts")
    line, going = Line(collision, most), True
    while going:
        while line.approaching().any():
            LAWS[law](line)
        going = line.fly()
    line.unite()
    # Impulses of the balance of momentum, so that they go with the velocities to the last bit.
    line.impulse = np.cumsum(line.mass * (line.v - collision.velocities))[: line.e.size]
    return line


class RigidLaw(OneByOne):
    """One of `LAWS` as a solver, by its name: to rigid engines what Kelvin-Voigt contacts are to compliant ones.

    Stiffnesses, exponents and steps do not concern it. Impacts take no time: the states are the contacts that touch at
    first, and none. `n_events` is the number of impacts, ``duration`` the time of the last one in s; status ``limit``
    where a sequence of infinitely many impacts was ended (`ENDLESS`).
    """

    kind = "reference"

    def version(self) -> str:
        """Version of this project: what is exact is its own."""
        return version("impact-xval")

    def solve_one(self, collision: Collision, settings: Settings) -> Outcome:
        """Answer one collision."""
        c = collision
        if settings.scenario != "impact":
            reason = f"scenario = {settings.scenario!r}: rigid laws are without gravity; legal: 'impact'"
            return Outcome.failure(self.name, c, "unrepresentable", reason)
        try:
            line = follow(c, self.name, min(settings.max_steps, 100_000))
        except TooManyImpactsError as error:
            return Outcome.failure(self.name, c, "timeout", str(error))
        except ValueError as error:
            return Outcome.failure(self.name, c, "unrepresentable", str(error))
        endless = line.slowest < ENDLESS / TINY * line.tiny
        touching = sum(1 << int(i) for i in np.flatnonzero(line.points[0][3]))
        paper = c.table and len(c.masses) == 2
        return Outcome(
            self.name,
            tuple(line.v.tolist()),
            tuple(line.impulse.tolist()),
            (name_of_set(touching, paper), name_of_set(0, paper))[not touching :],
            "limit" if endless else "ok",
            "bodies come to rest together after infinitely many impacts" if endless else "",
            n_events=line.impacts,
            diagnostics={"duration": line.time},
            path=_path_of(line) if settings.record_path else None,
        )


def _path_of(line: Line) -> Path:
    """Give the path of a line that is over; velocities at the end as they are reported."""
    time, velocities, impulses, acting = (np.array(each) for each in zip(*line.points, strict=True))
    velocities[-1], acting[-1] = line.v, False
    return Path(time, velocities, impulses, np.zeros_like(impulses), acting)
