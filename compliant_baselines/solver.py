"""What a solver is.

Implementer's rules:

1. A solver is a class derived from `Solver` or, to answer one collision at a time, from `OneByOne`. It is constructed
   without arguments and is cheap to construct: an engine is imported where it is asked to run, never at module level.
2. `solve_many` answers every collision, in order, one `Outcome` each. One that it cannot do (N balls, gravity, e = 0)
   it refuses with the reason: `Outcome.failure` with the status ``unrepresentable``. It never replaces a parameter
   silently.
3. `law` names the exact solver of this package to which the solver converges as its step goes to zero: for
   ``kelvin-voigt`` contact i is F = max(0, k_i delta + c_i delta'), c_i from `mapping`. None is a law of its own.
4. A solver is a function of its explicit inputs: no global state that a later call could see, no hidden seed, the same
   bits whatever else was asked in the same call.
5. Velocities are in m/s, impulses in N s, times in s; all are those of the collision as given, never rescaled.
6. The collision is over when the balls are apart, the lowest one is off the table or at rest on it, and no ball will
   meet another again.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, TypeVar, get_args

import numpy as np
from numpy.typing import NDArray

from impact_xval.compliant_baselines.states import SHORTEST_STATE
from impact_xval.model.collision import Collision
from impact_xval.model.collisions import Collisions
from impact_xval.model.inputs import GRAZING_THRESHOLD, LEGAL_CUTOFF, Cutoff, legal_cutoff
from impact_xval.model.outcome import Outcome
from impact_xval.model.status import RESULT_STATUSES, Status

Scenario = Literal["impact", "drop"]
MappingName = Literal["calibrated", "naive", "documented", "shipped"]

#: Impulses alone, positions frozen; contacts in time, solved exactly; an engine of compliant or of rigid contacts.
Kind = Literal["model", "reference", "compliant", "rigid"]

#: The law engines of compliant contacts are mapped to, unless they say otherwise.
KELVIN_VOIGT = "kelvin-voigt"


class SolverError(ValueError):
    """A solver could not do a collision, asked for directly: the status a sweep would record, and why."""

    def __init__(self, solver: str, status: Status, reason: str) -> None:
        super().__init__(f"{solver}: {status}: {reason}")
        self.solver = solver
        self.status: Status = status
        self.reason = reason


@dataclass(frozen=True, slots=True)
class Convergence:
    """What the limit dt -> 0 of an engine must satisfy (`engines.convergence`); a ValueError for an illegal value."""

    #: Largest error of the limit, per abs(v0), at which a result counts as converged.
    tolerance: float = 1e-3
    #: How often the step that is asked for may be halved.
    halvings: int = 4

    def __post_init__(self) -> None:
        if not 0 < self.tolerance <= 1:
            raise ValueError(f"tolerance = {self.tolerance!r}; legal: greater than 0, at most 1")
        if not 0 <= self.halvings <= 10:
            raise ValueError(f"halvings = {self.halvings!r}; legal: a whole number from 0 to 10")


@dataclass(frozen=True, slots=True)
class Settings:
    """How a collision is solved; a solver ignores what does not concern it. A ValueError names an illegal value."""

    #: ``impact``: no gravity. ``drop``: gravity on, B2 settled in static equilibrium on the table, B1 touching it at
    #: t = 0 with v0.
    scenario: Scenario = "impact"
    #: g > 0 in m/s^2, used by ``drop`` only.
    gravity: float = 9.81
    #: Time step over the period 2 pi sqrt(M_i/k_i) of the faster contact; in (0, 0.2].
    step_fraction: float = 1e-3
    #: Steps after which a collision that is not over is given up (status ``timeout``).
    max_steps: int = 2_000_000
    #: How k_i and c_i become the engine's own parameters (`mapping`).
    mapping: MappingName = "calibrated"
    #: A state that an engine holds for less than this share of the shorter contact period takes the state before it
    #: (`states`); in [0, 0.1].
    shortest_state: float = SHORTEST_STATE
    #: Whether outcomes carry the path.
    record_path: bool = False
    #: Of the state-transition model (`model.solve`): a number or "exact", and the grazing margin, from 0 to 1, below
    #: which an outcome is marked.
    stiffness_ratio_cutoff: Cutoff = "exact"
    grazing_threshold: float = GRAZING_THRESHOLD
    #: Whether references and engines mark outcomes beside a jump of their exact law (`marks`).
    mark: bool = True
    #: Whether engines are also run at shorter steps until their limit is known, and how well.
    convergence: Convergence | None = None

    def __post_init__(self) -> None:
        for name, legal, legal_range in (
            ("scenario", self.scenario in ("impact", "drop"), "'impact' or 'drop'"),
            ("gravity", 0 < self.gravity < float("inf"), "a finite number > 0 (m/s^2)"),
            ("step_fraction", 0 < self.step_fraction <= 0.2, "greater than 0, at most 0.2 (of a period)"),
            ("max_steps", self.max_steps >= 1, "a whole number >= 1"),
            ("mapping", self.mapping in get_args(MappingName), f"one of {', '.join(get_args(MappingName))}"),
            ("shortest_state", 0 <= self.shortest_state <= 0.1, "from 0 to 0.1 (of the shorter period)"),
            ("stiffness_ratio_cutoff", legal_cutoff(self.stiffness_ratio_cutoff), LEGAL_CUTOFF),
            ("grazing_threshold", 0 <= self.grazing_threshold <= 1, "from 0 to 1"),
        ):
            if not legal:
                raise ValueError(f"{name} = {getattr(self, name)!r}; legal: {legal_range}")


class Solver(ABC):
    """A way to find out how a collision ends."""

    #: Under which it is found.
    name: str
    kind: Kind = "compliant"
    #: Name of the exact solver of the law it has or is asked for (rule 3).
    law: str | None = KELVIN_VOIGT
    #: Share of m |v0| by which an impulse along a path may fall, which is rounding of its velocities.
    rounding: float = 1e-9

    @abstractmethod
    def version(self) -> str:
        """Version of what does the work (the engine's own), or ``""`` if it is not installed."""

    def unavailable(self) -> str | None:
        """Why the solver cannot run on this machine and the way out, in one sentence; None if it can."""
        return None

    @abstractmethod
    def solve_many(self, collisions: Sequence[Collision], settings: Settings) -> Sequence[Outcome]:
        """Answer every collision, of any number of balls, in order; failures are outcomes with a status (rule 2)."""

    def solve(self, collision: Collision, settings: Settings | None = None) -> Outcome:
        """Answer one collision.

        Raises
        ------
        SolverError
            If the outcome's status is neither ``ok`` nor ``limit``.
        """
        outcome = self.solve_many([collision], settings or Settings())[0]
        if outcome.status not in RESULT_STATUSES:
            raise SolverError(self.name, outcome.status, outcome.reason)
        return outcome


class OneByOne(Solver):
    """A solver that answers one collision at a time; what `solve_one` raises costs that collision only (`answers`)."""

    @abstractmethod
    def solve_one(self, collision: Collision, settings: Settings) -> Outcome:
        """Answer one collision; a failure is an outcome with a status (rule 2)."""

    def solve_many(self, collisions: Sequence[Collision], settings: Settings) -> Sequence[Outcome]:
        """Answer every collision, in order."""
        return [self.solve_one(collision, settings) for collision in collisions]


_Answer = TypeVar("_Answer")


def kinds(collisions: Sequence[Collision]) -> list[tuple[NDArray[np.intp], Collisions]]:
    """Group collisions that are solved alike, with or without gaps: their places, and they as arrays."""
    if isinstance(collisions, Collisions):
        flags = collisions.falls_on_resting, collisions.gaps.any(axis=1)
        if all(flag.all() or not flag.any() for flag in flags):
            return [(np.arange(len(collisions)), collisions)]
    found: dict[tuple[object, ...], list[int]] = {}
    for i, c in enumerate(collisions):
        kind = len(c.masses), c.table, c.exponent, c.falls_on_resting, any(c.gaps)
        found.setdefault(kind, []).append(i)
    return [(np.array(some), Collisions.of(collisions[i] for i in some)) for some in found.values()]


def by_kind(
    collisions: Sequence[Collision], solve: Callable[[Collisions], Sequence[_Answer]]
) -> Sequence[_Answer]:
    """Answer collisions by their kinds, in their order."""
    groups = kinds(collisions)
    if len(groups) == 1:
        return solve(groups[0][1])
    found: dict[int, _Answer] = {}
    for places, some in groups:
        found |= zip(places.tolist(), solve(some), strict=True)
    return [found[i] for i in range(len(collisions))]
