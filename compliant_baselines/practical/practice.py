"""An engine as people run it: what it is asked, how it is stepped, when it is done.

A `Practice` is an engine with settings that somebody would choose: as it is shipped, as its documentation says, or
calibrated at a step that people use. It is asked for one `Column` in an `Arrangement`. Balls have the radius `RADIUS`,
there is no gravity and no friction: what is compared is the simultaneous impact itself, and nothing has to settle.

**The end.** An impact is over after `QUIET_STEPS` steps in a row in which no velocity changes and after which no bodies
approach, both to the rounding of the engine (`ROUNDING`): nothing pushes, and nothing is going to meet. That is the
rule of `contract.trajectory` without gravity, for engines whose contact forces nobody can see.

**Failures are values.** What an engine cannot take is refused by name (`unrepresentable`); velocities that are not
finite or an exception of the engine are `crashed`, an impact that outlasts `Arrangement.max_steps` is `timeout`.
An engine that takes the process with it, or never returns, is the concern of the caller, who has processes for that.
"""

from __future__ import annotations

import math
import os
import sys
import warnings
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from time import perf_counter
from typing import ClassVar, Literal, Protocol

from impact_xval.compliant_baselines.contact.line import Line, line_of, unrepresentable_column
from impact_xval.compliant_baselines.contract.solver import Settings
from impact_xval.compliant_baselines.engines.packages import version_of, why_not
from impact_xval.model.collision import Status
from impact_xval.model.columns.column import Column

Precision = Literal["float32", "float64"]
Takes = Literal["restitution", "stiffness"]

#: Radius of the balls, in m: a power of two, so that balls that touch do so to the last bit, also a metre higher and in
#: single precision. A gap of 6e-17 m that rounding leaves would decide what some engines answer.
RADIUS = 0.125

#: Changes of velocities and rates of approach that are rounding, over the largest speed before. Some ten units in the
#: last place: engines of single precision keep a pair at rest no better than that.
ROUNDING: dict[Precision, float] = {"float32": 2e-6, "float64": 1e-12}

#: Steps in which nothing happens, until it is believed.
QUIET_STEPS = 3


@dataclass(frozen=True, slots=True)
class Arrangement:
    """How a column is laid out for an engine, and stepped.

    Parameters
    ----------
    step : float
        In s; positive.
    gap : float
        At every contact at first, in radii; negative overlaps. From -0.5 to 0.5. Gaps of the column itself are added.
    reversed_insertion : bool
        Whether the bodies are made from below (table, ball N, ..., ball 1) instead of from above.
    translation : float
        By how much everything is moved along the line, in m.
    max_steps : int
        Steps after which the impact is given up.

    Raises
    ------
    ValueError
        For an illegal value; the message names the field, the value and the legal range.
    """

    step: float
    gap: float = 0.0
    reversed_insertion: bool = False
    translation: float = 0.0
    max_steps: int = 100_000

    def __post_init__(self) -> None:
        for name, legal, legal_range in (
            ("step", 0 < self.step < math.inf, "a finite number > 0 (s)"),
            ("gap", -0.5 <= self.gap <= 0.5, "from -0.5 to 0.5 (radii; negative overlaps)"),
            ("reversed_insertion", isinstance(self.reversed_insertion, bool), "True or False"),
            ("translation", math.isfinite(self.translation), "a finite number (m)"),
            ("max_steps", self.max_steps >= 1, "a whole number >= 1"),
        ):
            if not legal:
                raise ValueError(f"{name} = {getattr(self, name)!r}; legal: {legal_range}")

    def floor(self) -> float:
        """Height of the surface of the table, in m; without one, of where it would be."""
        return self.translation

    def heights(self, column: Column) -> tuple[float, ...]:
        """Heights of the centres of the balls at first, in m, ball 1 first."""
        below = (*column.gaps, *(() if column.table else (0.0,)))
        height, found = self.floor() - RADIUS, []
        for gap in reversed(below):
            height += 2 * RADIUS + gap + self.gap * RADIUS
            found.append(height)
        return tuple(reversed(found))

    def order(self, column: Column) -> tuple[int, ...]:
        """Bodies in the order in which they are made: balls from 0, the table as the number of balls."""
        bodies = range(len(column.masses) + column.table)
        return tuple(reversed(bodies) if self.reversed_insertion else bodies)


@dataclass(frozen=True, slots=True)
class Simulated:
    """What an engine made of a column.

    Attributes
    ----------
    practice : str
        Name of the practice.
    velocities : tuple of float, length N
        At the end, in m/s, ball 1 first; NaN unless the status is ``ok``.
    steps : int
        Steps taken.
    seconds : float
        Wall time within the engine's stepping.
    status : str
        ``ok``, ``timeout``, ``crashed``, ``unrepresentable`` or ``unavailable``.
    reason : str
        In one sentence; empty for ``ok``.
    """

    practice: str
    velocities: tuple[float, ...]
    steps: int = 0
    seconds: float = 0.0
    status: Status = "ok"
    reason: str = ""


class World(Protocol):
    """A column inside an engine."""

    def step(self) -> None:
        """Take one step of `Arrangement.step`."""
        ...

    def velocities(self) -> Sequence[float]:
        """Velocities along the line in m/s, ball 1 first."""
        ...


class Practice(ABC):
    """An engine with settings; a subclass says how a column is made inside it.

    Attributes
    ----------
    name : str
        By which it is found.
    settings : str
        What is set, in a line.
    engine : str
        Where it comes from: practices of one engine are modes of it.
    distribution, module : str
        Its package, as distributed and as imported.
    way_out : str
        What to run where it is missing.
    precision : str
        Of its velocities.
    takes : tuple of str
        What of a column's contacts reaches the engine: ``"restitution"``, ``"stiffness"``, both or none.
    law : str
        Name of the exact solver of what it is asked for; empty where nothing of a contact reaches it.
    default_step : float
        Step in s that it ships or that its examples use.
    """

    name: str
    settings: str
    engine: str
    distribution: str
    module: str
    way_out: ClassVar[str] = "run pip install 'impact-xval[engines]'"
    precision: ClassVar[Precision] = "float64"
    takes: tuple[Takes, ...] = ("restitution",)
    law: str = "newton"
    default_step: float

    def version(self) -> str:
        """Version of the engine's package, or ``""`` if it is not installed."""
        return version_of(self.distribution)

    def unavailable(self) -> str | None:
        """Why the engine cannot run here and the way out, in one sentence; None if it can."""
        if find_spec(self.module) is None:
            return f"{self.distribution} is not installed: {self.way_out}"
        with silent():
            return why_not(self.engine, self.distribution, self.load, self.way_out)

    @abstractmethod
    def load(self) -> object:
        """Import the engine.

        Raises
        ------
        ImportError
            If it cannot be.
        """

    def usual_step(self, column: Column) -> float:
        """Step in s at which a column is run as people run it."""
        return self.default_step

    def usual(self, column: Column) -> Arrangement:
        """Arrangement in which bodies touch, at the usual step."""
        return Arrangement(self.usual_step(column))

    def refuses(self, column: Column) -> str | None:
        """Why the engine cannot be set to this column, in one sentence that names the field; None if it can."""
        return None

    def refuses_arrangement(self, arrangement: Arrangement) -> str | None:
        """Why the engine cannot take this arrangement, as `refuses`."""
        return None

    @abstractmethod
    def world(self, column: Column, arrangement: Arrangement) -> AbstractContextManager[World]:
        """Make the column inside the engine; what it holds is let go of at the end of the context."""

    def simulate(self, column: Column, arrangement: Arrangement | None = None) -> Simulated:
        """Run a column to the end of its impact; what goes wrong is a status.

        Parameters
        ----------
        column : Column
        arrangement : Arrangement, optional
            That of `usual` by default.
        """
        unknown = (math.nan,) * len(column.masses)
        missing = self.unavailable()
        if missing:
            return Simulated(self.name, unknown, status="unavailable", reason=missing)
        refused = self.refuses(column)
        if not refused:
            arrangement = arrangement or self.usual(column)
            refused = self.refuses_arrangement(arrangement)
        if refused or arrangement is None:
            return Simulated(self.name, unknown, status="unrepresentable", reason=refused or "")
        try:
            with silent():
                return self.run(column, arrangement)
        except Exception as error:  # an engine may raise anything
            said = " ".join(str(error).split()) or type(error).__name__
            return Simulated(self.name, unknown, status="crashed", reason=f"{self.engine}: {said}")

    def run(self, column: Column, arrangement: Arrangement) -> Simulated:
        """Run what was not refused."""
        with self.world(column, arrangement) as world:
            return self._follow(world, column, arrangement)

    def _follow(self, world: World, column: Column, arrangement: Arrangement) -> Simulated:
        """Step until the impact is over."""
        nothing = ROUNDING[self.precision] * max(map(abs, column.velocities))
        unknown = (math.nan,) * len(column.masses)
        before, seconds, quiet = column.velocities, 0.0, 0
        for taken in range(1, arrangement.max_steps + 1):
            begun = perf_counter()
            world.step()
            seconds += perf_counter() - begun
            after = tuple(map(float, world.velocities()))
            if not all(map(math.isfinite, after)):
                reason = f"{self.engine} gave velocities {after} m/s after {taken} steps"
                return Simulated(self.name, unknown, taken, seconds, "crashed", reason)
            below = (*after, 0.0) if column.table else after
            moved = max(abs(b - a) for a, b in zip(before, after, strict=True))
            approach = max((lower - upper for upper, lower in pairwise(below)), default=0.0)
            quiet = quiet + 1 if moved <= nothing and approach <= nothing else 0
            if quiet == QUIET_STEPS:
                return Simulated(self.name, after, taken, seconds)
            before = after
        reason = f"not over after max_steps = {arrangement.max_steps} steps of {arrangement.step:g} s"
        return Simulated(self.name, unknown, arrangement.max_steps, seconds, "timeout", reason)


@dataclass(frozen=True, slots=True)
class SingleContact:
    """What a practice makes of one contact: a ball on the table, or on another one in space.

    Attributes
    ----------
    asked : float
        Restitution that was asked for.
    returned : float
        Relative speed after over before; NaN unless the status of `simulated` is ``ok``.
    speed, step : float
        Of impact in m/s, and in s.
    simulated : Simulated
    """

    asked: float
    returned: float
    speed: float
    step: float
    simulated: Simulated


#: Stiffness in N/m of a single contact, for engines that take one: with 1 kg, 31 ms and a hundredth of a metre deep
#: at 1 m/s, which is what usual steps can see.
STIFFNESS = 1e4


def single_contact(
    practice: Practice,
    e: float,
    speed: float = 1.0,
    step: float | None = None,
    *,
    table: bool = True,
    stiffness: float = STIFFNESS,
) -> SingleContact:
    """Run one contact: a ball of 1 kg on the table, or on another such ball that is at rest.

    Parameters
    ----------
    practice : Practice
    e : float
        Restitution asked for.
    speed : float
        Of impact, in m/s.
    step : float, optional
        In s; the usual one by default.
    table : bool
        On the table, or on another ball.
    stiffness : float
        In N/m, for engines that take one.

    Raises
    ------
    ValueError
        For illegal values, as of `Column` and `Arrangement`.
    """
    balls = ((1.0,), (-speed,)) if table else ((1.0, 1.0), (-speed, 0.0))
    column = Column(balls[0], (stiffness,), (e,), balls[1], table)
    step = practice.usual_step(column) if step is None else step
    simulated = practice.simulate(column, Arrangement(step))
    after = (*simulated.velocities, 0.0)
    return SingleContact(e, (after[0] - after[1]) / speed, speed, step, simulated)


def reduced_masses(column: Column) -> tuple[float, ...]:
    """Reduced mass of the two bodies of each contact, in kg."""
    inverse = [*(1 / m for m in column.masses), *([0.0] if column.table else [])]
    return tuple(1 / (upper + lower) for upper, lower in pairwise(inverse))


def shortest_period(column: Column) -> float:
    """Shortest of the periods 2 pi sqrt(M/k) of the contacts, in s."""
    pairs = zip(reduced_masses(column), column.stiffnesses, strict=True)
    return 2 * math.pi * min(math.sqrt(m) / math.sqrt(k) for m, k in pairs)


def springs(column: Column, step: float = 1.0) -> Line:
    """Contacts of spring and dashpot that a column asks for, each with the damping of its own two bodies."""
    line = line_of(column, Settings(mark=False))
    return Line(line.masses, line.contacts, line.velocities, line.gaps, line.table, line.mapping, step)


def without_spring(column: Column) -> str | None:
    """Why no spring and dashpot are this column, in one sentence; None if some are."""
    return unrepresentable_column(column, 1.0)


@contextmanager
def silent() -> Iterator[None]:
    """Keep what is written to standard output and error from the terminal, by Python or by an engine's own code."""
    with ExitStack() as stack:
        stack.enter_context(warnings.catch_warnings())
        warnings.simplefilter("ignore")
        nowhere = stack.enter_context(Path(os.devnull).open("w"))
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        for descriptor in (1, 2):
            try:
                kept = os.dup(descriptor)
            except OSError:  # closed: there is nothing to keep clean
                continue
            stack.callback(os.close, kept)
            stack.callback(os.dup2, kept, descriptor)
            os.dup2(nowhere.fileno(), descriptor)
        stack.enter_context(redirect_stdout(nowhere))
        stack.enter_context(redirect_stderr(nowhere))
        yield
