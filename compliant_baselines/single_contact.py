"""Two bodies and the contact requested between them; the largest step at which an engine reproduces it.

The contact is Kelvin and Voigt's, F = max(0, k delta + c delta'), between two bodies of which nothing else acts
on either while it lasts. Then (docs/theory.md, section 7; Schwager and Poeschel, Granular Matter 9:465, 2007), with M
the reduced mass, omega = sqrt(k/M) and zeta the damping ratio that gives e,

* it lasts T = contact_time(zeta)/omega, so that k = M (contact_time(zeta)/T)^2 for a duration asked for;
* it goes in by |v| sqrt(e)/omega at most: delta peaks after exactly half of T, and decays by sqrt(e) until then.

Neither restitution nor duration depends on the speed.

In an engine they depend on the step, and on where within a step the bodies touch: the restitution, since the first
force comes late, and the duration, counted in whole steps as a user counts it. A step counts as good only if
restitution and duration are within the tolerance wherever within the step the touch falls; so do all shorter ones that
are tried.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from numbers import Real

import numpy as np

from impact_xval.compliant_baselines.engines.column import Column
from impact_xval.compliant_baselines.engines.engine import EngineSolver
from impact_xval.compliant_baselines.engines.recording import Run
from impact_xval.compliant_baselines.engines.trajectory import FREE
from impact_xval.compliant_baselines.mapping import Contact, contact_time, damping_ratio
from impact_xval.compliant_baselines.solver import SolverError

#: Places within a step at which the touch is tried: many to certify a step, few to look for one.
PHASES, FEW_PHASES = 32, 6

#: Steps in a contact: the longest step tried, and the shortest.
FEWEST, MOST = 5, 200_000

#: Shares of a step at which it is tried again.
SHORTER = (0.93, 0.83, 0.7, 0.5)

#: Ratio of a bad step to a good one at which the search between them ends.
CLOSE = 1.04


@dataclass(frozen=True, slots=True)
class Pair:
    """What is asked of one contact between two bodies.

    Parameters
    ----------
    masses : tuple of float
        Of the two bodies in kg; one of them may be infinite, a fixed body.
    restitution : float
        Coefficient of restitution, greater than 0, at most 1.
    stiffness : float, optional
        In N/m.
    duration : float, optional
        From touch to the end of the force, in s; instead of the stiffness.
    speed : float
        Speed of approach in m/s; it decides how deep the bodies go, and what an engine can take.

    Raises
    ------
    ValueError
        For an illegal value; the message names the field, the value and the legal range.
    """

    masses: tuple[float, float]
    restitution: float
    stiffness: float | None = None
    duration: float | None = None
    speed: float = 1.0

    def __post_init__(self) -> None:
        if len(self.masses) != 2:
            raise ValueError(f"masses = {self.masses!r}; legal: two")
        for mass in self.masses:
            _require("masses", mass, mass > 0, "numbers > 0 (kg), one of them inf for a fixed body")
        if all(map(math.isinf, self.masses)):
            raise ValueError("masses = inf inf: two fixed bodies do not collide; legal: at most one inf")
        e, why = self.restitution, ""
        if e == 0:
            why = " (no finite damping gives 0)"
        elif e > 1:
            why = " (a contact of spring and dashpot creates no energy)"
        _require("restitution", e, 0 < e <= 1, "greater than 0, at most 1" + why)
        _require("speed", self.speed, 0 < self.speed < math.inf, "a finite number > 0 (m/s)")
        if (self.stiffness is None) == (self.duration is None):
            given = "neither" if self.stiffness is None else "both"
            raise ValueError(
                f"stiffness, duration: {given} given; legal: one of the two, which decides the other"
            )
        name, value, unit = self.given
        _require(name, value, 0 < value < math.inf, f"a finite number > 0 ({unit})")
        contact = self.contact
        if not (0 < contact.k < math.inf and 0 < contact.omega < math.inf and contact.c < math.inf):
            raise ValueError(
                f"{name} = {value!r}: no stiffness within double precision gives it to a reduced "
                f"mass of {self.mass:.6g} kg (k = {contact.k:.6g} N/m, c = {contact.c:.6g} N s/m)"
            )

    @property
    def given(self) -> tuple[str, float, str]:
        """Name, value and unit of what decides the contact: the stiffness or the duration."""
        if self.stiffness is not None:
            return "stiffness", self.stiffness, "N/m"
        assert self.duration is not None
        return "duration", self.duration, "s"

    @property
    def fixed(self) -> bool:
        """Whether one of the bodies is fixed."""
        return any(map(math.isinf, self.masses))

    @property
    def mass(self) -> float:
        """Reduced mass in kg."""
        small, large = sorted(self.masses)
        return small / (1 + small / large)

    @property
    def contact(self) -> Contact:
        """The contact asked for."""
        name, k, _ = self.given
        if name == "duration":
            rate = contact_time(damping_ratio(self.restitution)) / k
            k = self.mass * rate * rate
            if not 0 < k < math.inf:
                return Contact(k, math.nan if k == 0 else math.inf, self.mass)
        return Contact.from_restitution(k, self.restitution, self.mass)

    @property
    def penetration(self) -> float:
        """Greatest penetration in m, at the speed of this pair."""
        return self.speed * math.sqrt(self.restitution) / self.contact.omega


def _require(name: str, value: object, legal: object, legal_range: str) -> None:
    if isinstance(value, bool) or not isinstance(value, Real) or not legal:
        raise ValueError(f"{name} = {value!r}; legal: {legal_range}")


@dataclass(frozen=True, slots=True)
class Drops:
    """What a number of drops gave, the touch at different places within a step.

    Attributes
    ----------
    step : float
        Time step in s.
    restitution, duration : tuple of float
        Least and greatest; duration in s, whole steps from the first to the last with force.
    n : int
        Number of drops.
    """

    step: float
    restitution: tuple[float, float]
    duration: tuple[float, float]
    n: int

    def error(self, pair: Pair) -> float:
        """Greatest relative error of restitution and duration."""
        asked = pair.contact.duration
        errors = [e / pair.restitution - 1 for e in self.restitution] + [T / asked - 1 for T in self.duration]
        return max(map(abs, errors))


def drops(
    solver: EngineSolver, pair: Pair, step: float, phases: Sequence[float], gravity: float = 0.0
) -> Drops:
    """Let an engine do the contact once for every place of the touch within a step.

    Parameters
    ----------
    solver : EngineSolver
        An engine.
    pair : Pair
        What is asked. A fixed body is the table, two free ones are the balls.
    step : float
        Time step in s.
    phases : sequence of float
        Where in a step the bodies touch, from 0 (at its start) to 1.
    gravity : float
        In m/s^2; only for a fixed body.

    Raises
    ------
    SolverError
        If the engine refuses, or a contact does not end.
    """
    some = columns(pair, step, phases, gravity)
    refused = solver.refusal(some[0])
    if refused is not None:
        raise SolverError(solver.name, "unrepresentable", refused)
    most = 10 * math.ceil(pair.contact.duration / step) + 100
    runs = solver.run_columns(some, most)
    measured = np.array([_measure(solver.name, pair, run) for run in runs])
    (e_low, T_low), (e_high, T_high) = measured.min(axis=0).tolist(), measured.max(axis=0).tolist()
    return Drops(step, (e_low, e_high), (T_low, T_high), len(some))


def columns(pair: Pair, step: float, phases: Sequence[float], gravity: float = 0.0) -> list[Column]:
    """Set up a column for each place of the touch within a step; only the contact of the pair takes part.

    The column of a collision is used, so that what is tested is what is run. The other contact is kept out of the way
    by how the balls start: where one body is fixed, B2 meets the table while B1 leaves upwards at twice the speed; of
    two free bodies B1 meets B2 in a frame that rises at twice the speed, high above the table.
    """
    light, heavy = pair.masses if not math.isinf(pair.masses[0]) else pair.masses[::-1]
    contact, speed = pair.contact, pair.speed
    # Out of reach for the contact's whole duration, with room to spare.
    far = 10 * speed * contact.period
    column = Column(
        m1=light,
        m2=light if pair.fixed else heavy,
        contact1=contact,
        contact2=contact,
        mapping="calibrated",
        gravity=gravity,
        settled=False,
        x1=far,
        x2=0.0 if pair.fixed else far,
        # The idle ball stays the faster one, whatever gravity takes from it meanwhile: else the run would go on.
        v1=(2 * speed if pair.fixed else speed) + 20 * gravity * contact.duration,
        v2=-speed if pair.fixed else 2 * speed,
        step=step,
    )
    which = "x2" if pair.fixed else "x1"
    return [
        replace(column, **{which: getattr(column, which) + phase * pair.speed * step}) for phase in phases
    ]


def _measure(name: str, pair: Pair, run: Run) -> tuple[float, float]:
    if run.end != FREE:
        if run.status == "crashed":
            raise SolverError(name, "crashed", run.problem())
        # A collision may be over with both bodies at rest on each other: their contact is not.
        raise SolverError(name, "timeout", f"not over after {run.raw.n_steps} steps, {run.duration:.3g} s")
    after = run.v2 if pair.fixed else run.v1 - run.v2
    loaded = np.flatnonzero(np.isin(run.raw.state, (1, 2) if pair.fixed else (1, 3)))
    if not loaded.size:
        raise SolverError(name, "unconverged", "no step with force: the bodies passed through each other")
    ends = np.append(run.raw.start[1:], run.raw.n_steps)
    steps = int(ends[loaded[-1]] - run.raw.start[loaded[0]])
    return after / pair.speed, steps * run.column.step


def largest_step(solver: EngineSolver, pair: Pair, tolerance: float = 0.01) -> Drops:
    """Find the largest step, to two digits, at which the contact is the one asked for.

    Steps are tried from the longest down until one passes, then bisected towards the last that did not, then
    named in two digits. All of it is the engine's own answers; nothing about its integrator is assumed.

    Parameters
    ----------
    solver : EngineSolver
        An engine.
    pair : Pair
        What is asked.
    tolerance : float
        Allowed relative error of restitution and duration, in (0, 0.5].

    Returns
    -------
    Drops
        At that step, `PHASES` of them.

    Raises
    ------
    SolverError
        If the engine is missing or refuses the contact, or no step does it.
    ValueError
        For a tolerance out of range.
    """
    if not 0 < tolerance <= 0.5:
        raise ValueError(f"tolerance = {tolerance!r}; legal: greater than 0, at most 0.5")
    reason = solver.unavailable()
    if reason is not None:
        raise SolverError(solver.name, "unavailable", reason)
    bad, good = _bracket(solver, pair, tolerance)
    while bad / good > CLOSE:
        middle = math.sqrt(bad * good)
        if _try(solver, pair, middle)[0] <= tolerance:
            good = middle
        else:
            bad = middle
    shortest = pair.contact.duration / MOST
    for step in _downwards(good):
        if step < shortest:
            break
        # Shorter steps must do as well: a step does not pass by luck.
        if any(_try(solver, pair, share * step)[0] > tolerance for share in SHORTER):
            continue
        try:
            found = drops(solver, pair, step, _places(PHASES))
        except SolverError:
            continue
        if found.error(pair) <= tolerance:
            return found
    raise _no_step(solver, shortest, tolerance, "it holds at none reliably")


def _bracket(solver: EngineSolver, pair: Pair, tolerance: float) -> tuple[float, float]:
    """Find a step that is too long and a shorter one that is not, from the longest down."""
    step = pair.contact.duration / FEWEST
    shortest = pair.contact.duration / MOST
    bad, why = 2 * step, ""
    while step >= shortest:
        error, why = _try(solver, pair, step)
        if error <= tolerance:
            return bad, step
        bad = step
        # An error of first order, r times too large, asks for a step r times as short: go nearly there.
        step /= min(16.0, max(1.3, 0.7 * error / tolerance)) if math.isfinite(error) else 1.5
    raise _no_step(solver, shortest, tolerance, why)


def _try(solver: EngineSolver, pair: Pair, step: float) -> tuple[float, str]:
    """Error at a step and how to say it; infinite if the engine could not do it at all."""
    try:
        error = drops(solver, pair, step, _places(FEW_PHASES)).error(pair)
    except SolverError as failed:
        if failed.status == "unrepresentable":
            raise
        return math.inf, failed.reason
    return error, f"at the last step tried one of them is off by {error:.2g}"


def _no_step(solver: EngineSolver, shortest: float, tolerance: float, why: str) -> SolverError:
    reason = (
        f"no step from a fifth of the contact down to {shortest:.2g} s gives restitution and duration within "
        f"{tolerance:g}: {why}"
    )
    return SolverError(solver.name, "unconverged", reason)


def _places(n: int) -> list[float]:
    """Places within a step: evenly spaced from its start, and just before its end."""
    return [*np.linspace(0, 1, n - 1, endpoint=False).tolist(), 0.999]


def _downwards(start: float) -> Iterator[float]:
    """Yield the numbers of two digits from `start` down."""
    exponent = math.floor(math.log10(start)) - 1
    digits = math.floor(start / 10.0**exponent * (1 + 1e-12))
    while True:
        yield float(f"{digits}e{exponent}")
        digits -= 1
        if digits < 10:
            digits, exponent = 99, exponent - 1


def durations_taken(solver: EngineSolver, pair: Pair) -> tuple[float, float] | None:
    """Shortest and longest duration in s that an engine does not refuse; None if it refuses all.

    Found by asking it, by decades and then by bisection; the masses, the restitution and the speed stay.
    """

    def taken(exponent: float) -> bool:
        try:
            asked = replace(pair, stiffness=None, duration=10.0**exponent)
        except ValueError:
            return False
        (column,) = columns(asked, 1e-3 * asked.contact.duration, [0.0])
        return solver.refusal(column) is None

    decades = [d for d in range(-100, 101) if taken(d)]
    if not decades:
        return None

    def edge(inside: float, outside: float) -> float:
        for _ in range(40):
            middle = 0.5 * (inside + outside)
            inside, outside = (middle, outside) if taken(middle) else (inside, middle)
        return 10.0**inside

    return edge(decades[0], decades[0] - 1), edge(decades[-1], decades[-1] + 1)
