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
  approach.
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
a flight: impacts follow one another until no contact approaches. A contact touches where its gap is 0, and no sooner;
contacts whose gaps close at the same instant (`SAME_INSTANT`) are one impact. A single impact is the same by all laws.

Infinitely many impacts may follow one another at one instant, or in a finite time, in which gaps and rates of approach
both vanish: a collapse. Its bodies then touch, and move with the velocity of their centre of mass, or not at all if the
table is among them. `rigid.collapse` tells it from a sequence that ends.

G is a Stieltjes matrix (its entries off the diagonal are not positive), for which the complementarity problem has one
solution, found in at most as many linear systems as there are contacts: Chandrasekaran, Opsearch 7:263, 1970; Cottle,
Pang and Stone, The Linear Complementarity Problem, 1992, section 4.7.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from importlib.metadata import version

import numpy as np
from scipy.linalg import solveh_banded

from impact_xval.compliant_baselines.rigid.collapse import VANISHED_GAP, VANISHED_SPEED, Bools, Watch
from impact_xval.compliant_baselines.solver import OneByOne, Settings
from impact_xval.model.arrays import Floats
from impact_xval.model.collision import Collision
from impact_xval.model.outcome import Outcome
from impact_xval.model.path import Path
from impact_xval.model.states import name_of_set

#: Rounding of a sum, over the sum of the absolute values of its terms: what is smaller is 0.
ROUNDING = 2.0**-46

#: Relative difference of the times at which gaps close up to which they close at the same instant.
SAME_INSTANT = 1e-12

#: Number of impacts, over that at which a cycle is awaited, from which on its next state is awaited: there are as many
#: impacts in it at last as the longest cycle needs.
LATER = 1.5

#: Relative velocity, over the largest speed at the start, that may be rounding where bodies are far apart.
TINY = 1e-14


class TooManyImpactsError(RuntimeError):
    """A collision was given up; the message says after how many impacts."""


class Line:
    """Balls in a line, between impacts, in SI units; arrays of balls have the shape (N,), of contacts (C,).

    Relative velocities and gaps are kept, not velocities and positions: each is known to rounding of its own size,
    however small it becomes.
    """

    def __init__(self, c: Collision, most: int) -> None:
        self.mass, self.e, self.gaps = (np.array(each) for each in (c.masses, c.restitutions, c.gaps))
        self.start, self.table, self.most = np.array(c.velocities), c.table, most
        contacts, below = self.e.size, np.append(1 / self.mass, 0.0)
        self.diagonal, self.off = (below[:-1] + below[1:])[:contacts], -below[1:contacts]
        self.weight = self.mass / self.mass.max()
        #: Relative velocities in m/s, negative where bodies approach; whether they touch; s since first touch.
        self.u = -np.diff(self.start, append=0.0) if c.table else -np.diff(self.start)
        self.touching, self.time = self.gaps == 0, 0.0
        #: Number of impacts so far, whether there was none yet at this instant, whether some sequence had no end.
        self.impacts, self.fresh, self.endless = 0, True, False
        speed = np.abs(self.start).max()
        self.tiny = TINY * speed
        self.vanished = float(VANISHED_SPEED * speed), float(VANISHED_GAP * self.gaps.max())
        #: Time in s after which bodies that approach by less than `tiny` are not awaited any more.
        self.horizon = self.gaps.max() / self.tiny
        #: Of impacts, of collapses of their cycles, of collapses of cycles of such collapses, and so on.
        self.watches = [self.new_watch()]
        # Time, relative velocities and acting contacts at the start and after each impact.
        self.points = [(0.0, self.u, self.touching)]

    def velocities(self, u: Floats) -> Floats:
        """Give velocities in m/s of relative ones. Balls with u >= 0 are apart, and with u = 0 together, to the bit."""
        over_lowest = np.cumsum(u[::-1])[::-1]
        if self.table:
            return over_lowest
        over_lowest = np.append(over_lowest, 0.0)
        return over_lowest + self.weight @ (self.start - over_lowest) / self.weight.sum()

    def impulses(self, v: Floats) -> Floats:
        """Give the impulses in N s that have made velocities: by the balance of momentum, to its last bit."""
        return np.cumsum(self.mass * (v - self.start))[: self.e.size]

    v = property(lambda self: self.velocities(self.u), doc="Velocities in m/s, shape (N,).")

    def after(self, u: Floats, impulse: Floats) -> Floats:
        """Give the relative velocities in m/s after impulses in N s, u + G P; 0 where nothing is left but rounding."""
        own, others = self.diagonal * impulse, np.zeros(u.size)
        others[:-1] += self.off * impulse[1:]
        others[1:] += self.off * impulse[:-1]
        new = u + own + others
        new[np.abs(new) <= ROUNDING * (np.abs(u) + own - others)] = 0.0
        return new

    def complementary(self, q: Floats, contacts: Bools) -> Floats:
        """Solve 0 <= P, q + G P >= 0, complementary, of some contacts; P of the others is 0."""
        among, impulse = np.zeros(q.size, bool), np.zeros(q.size)
        while (new := contacts & ~among & (self.after(q, impulse) < 0)).any():
            among |= new
            # One row more than there are contacts: LAPACK's ptsv is not to be had for a single one.
            band = np.array([np.zeros(q.size + 1), np.ones(q.size + 1)])
            band[0, 1:-1] = np.where(among[1:] & among[:-1], self.off, 0.0)
            band[1, :-1][among] = self.diagonal[among]
            right = np.append(np.where(among, -q, 0.0), 0.0)
            impulse = np.maximum(solveh_banded(band, right, check_finite=False)[:-1], 0.0)
        return impulse

    def approaching(self) -> Bools:
        """Tell which contacts touch and approach."""
        return self.touching & (self.u < 0)

    def lone(self) -> int | None:
        """Give the only contact that touches, if it approaches; None if there are several, or none."""
        touching = np.flatnonzero(self.touching)
        return int(touching[0]) if touching.size == 1 and self.u[touching[0]] < 0 else None

    def strike(self, impulse: Floats) -> None:
        """Apply impulses in N s."""
        self.go_on(self.after(self.u, impulse), impulse > 0)

    def bounce(self, i: int) -> None:
        """Apply the impact of contact i alone."""
        u, struck = self.u.copy(), np.zeros(self.e.size, bool)
        impulse = -(1 + self.e[i]) * u[i] / self.diagonal[i]
        u[i], struck[i] = -self.e[i] * u[i], True
        for beside in (i - 1, i + 1):
            if 0 <= beside < u.size:
                change = self.off[min(i, beside)] * impulse
                left = u[beside] + change
                u[beside] = left if abs(left) > ROUNDING * (abs(u[beside]) - change) else 0.0
        self.go_on(u, struck)

    def go_on(self, u: Floats, struck: Bools) -> None:
        """Go on with the relative velocities after an impact in the contacts `struck`."""
        if self.impacts == self.most:
            raise TooManyImpactsError(f"not over after {self.impacts} impacts")
        self.u, self.impacts, self.fresh = u, self.impacts + 1, False
        self.points.append((self.time, u, struck))
        for watch in self.watches:
            watch.note(u, struck)
        self.look_for_collapse(struck)

    def look_for_collapse(self, struck: Bools) -> None:
        """Move on to the end of infinitely many impacts, if the last one, in the contacts `struck`, tells of them."""
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
        """Begin to watch for cycles; the state now does not follow an impact."""
        return Watch(0, self.u, self.gaps, self.touching, np.zeros(self.e.size, bool))

    def collapse(self, active: Bools, time: float) -> None:
        """Move on to when some contacts are closed and at rest, after infinitely many impacts in a time in s."""
        self.u, self.gaps = (self.together(each, active) for each in (self.u, self.gaps))
        self.gaps = self.gaps + self.u * time
        self.touching = active | self.touching & (self.u == 0) if time else active | self.touching
        self.time, self.endless = self.time + time, True
        for watch in self.watches:
            watch.elapsed += time
        self.points.append((self.time, self.u, active))

    def together(self, u: Floats, closed: Bools) -> Floats:
        """Give relative velocities (gaps) with all bodies between closed contacts at their centre of mass: 0 there."""
        bodies = u.size + 1
        change = np.zeros(bodies)
        for group in np.split(np.arange(bodies), np.flatnonzero(~closed) + 1):
            over_lowest = np.append(np.cumsum(u[group[:-1]][::-1])[::-1], 0.0)
            on_table = self.table and group[-1] == bodies - 1
            mean = 0.0 if on_table else np.average(over_lowest, weights=self.weight[group])
            change[group] = mean - over_lowest
        return np.where(closed, 0.0, u - np.diff(change))

    def fly(self) -> bool:
        """Move freely until the next contact closes; False if none will."""
        u, closing = self.u, ~self.touching & (self.u < 0)
        times = np.divide(self.gaps, -u, out=np.full(u.size, np.inf), where=closing)
        times[(u > -self.tiny) & (times > self.horizon)] = np.inf
        first = times.min()
        if first == np.inf:
            return False
        closed = times * (1 - SAME_INSTANT) <= first
        self.gaps = np.where(closed, 0.0, self.gaps + u * first)
        # What touches and neither parts nor approaches still touches.
        self.touching, self.fresh = closed | self.touching & (u == 0), True
        self.time += first
        for watch in self.watches:
            watch.elapsed += first
        return True


def newton(line: Line) -> None:
    """Apply Newton's restitution at all touching contacts."""
    line.strike(line.complementary((1 + line.e) * line.u, line.touching))


def poisson(line: Line) -> None:
    """Apply Poisson's restitution at all touching contacts."""
    back = (1 + line.e) * line.complementary(line.u, line.touching)
    line.strike(back + line.complementary(line.after(line.u, back), line.touching))


def reflection(line: Line) -> None:
    """Apply generalised reflections, blended with the plastic impact of all touching contacts."""
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


def plastic_first(line: Line) -> None:
    """Apply the plastic impact of all touching contacts, then the restitution of those that approached."""
    before, among, between = line.u, line.approaching(), line.mass.size - 1
    e = line.e if line.fresh else np.where(line.e < 1, 0.0, line.e)
    impulse = line.complementary(before, line.touching)
    for i in (*range(0, between, 2), *range(1, between, 2), *range(between, line.e.size)):
        if among[i]:
            excess = e[i] * before[i] + line.after(before, impulse)[i]
            impulse[i] = max(impulse[i] - excess / line.diagonal[i], 0.0)
    line.strike(impulse)


def single(line: Line, place: int) -> None:
    """Apply the single impact of a contact that approaches, the topmost (place 0) or the lowest (-1) of them."""
    line.bounce(int(np.flatnonzero(line.approaching())[place]))


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
            alone = line.lone()
            if alone is None:
                LAWS[law](line)
            else:
                line.bounce(alone)
        going = line.fly()
    # What still approaches is rounding (`Line.fly`).
    line.u = np.maximum(line.u, 0.0)
    return line


class RigidLaw(OneByOne):
    """One of `LAWS` as a solver, by its name: to rigid engines what Kelvin-Voigt contacts are to compliant ones.

    Stiffnesses, exponents and steps do not concern it. Impacts take no time: the states are the contacts that touch at
    first, and none. `n_events` is the number of impacts, ``duration`` the time of the last one in s; status ``limit``
    where a sequence had infinitely many impacts, of which the first ones are counted and in the path.
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
        touching = sum(1 << int(i) for i in np.flatnonzero(line.points[0][2]))
        paper = c.table and len(c.masses) == 2
        return Outcome(
            self.name,
            tuple(line.v.tolist()),
            tuple(line.impulses(line.v).tolist()),
            (name_of_set(touching, paper), name_of_set(0, paper))[not touching :],
            "limit" if line.endless else "ok",
            "bodies come to rest together after infinitely many impacts" if line.endless else "",
            n_events=line.impacts,
            diagnostics={"duration": line.time},
            path=_path_of(line) if settings.record_path else None,
        )


def _path_of(line: Line) -> Path:
    """Give the path of a line that is over; velocities at the end as they are reported."""
    time, u, acting = (np.array(each) for each in zip(*line.points, strict=True))
    u[-1], acting[-1] = line.u, False
    velocities = np.array([line.velocities(each) for each in u])
    impulses = np.array([line.impulses(v) for v in velocities])
    return Path(time, velocities, impulses, np.zeros_like(impulses), acting)
