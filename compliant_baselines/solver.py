"""What a solver is.

Implementer's rules:

1. A solver is an object with the attributes and methods of `Solver`. It is constructed without arguments and
   is cheap to construct: an engine is imported inside `unavailable` or `solve_many`, never at module level.
2. `solve_many` answers every collision, in order, one `Outcome` each. It never raises for a collision it
   cannot do: that outcome has a status, a reason, and NaN velocities (`Outcome.failure`), or, if
   ``unconverged``, the numbers it came to.
3. `solve` is for direct calls: it gives an outcome whose status is ``ok`` or ``limit``, or raises
   `SolverError`.
4. A solver refuses, by name and with the reason, what it cannot represent (status ``unrepresentable``). It
   never replaces a parameter silently.
5. Contact i is F = max(0, k_i delta + c_i delta'), c_i from `mapping`, for every solver
   whose law is Kelvin-Voigt; another law is said in the docstring of the solver's module.
6. A solver is a function of its explicit inputs: no global state that a later call could see, no hidden seed,
   the same bits whatever else was asked in the same call.
7. Velocities are in m/s, impulses in N s, times in s; all are those of the collision as given, never
   rescaled.
8. The collision is over by the rule of `engines.stepping`; so are impulses and contacts that carry
   force read from velocities, and states from those by `states`.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol, TypeVar, runtime_checkable

from impact_xval.compliant_baselines.states import SHORTEST_STATE
from impact_xval.model.collision import RESULT_STATUSES, Collision, Collisions, Outcome, Status
from impact_xval.model.inputs import GRAZING_THRESHOLD, LEGAL_CUTOFF, Cutoff, legal_cutoff

Scenario = Literal["impact", "drop"]
MappingName = Literal["calibrated", "naive"]


class SolverError(ValueError):
    """A solver could not do a collision, asked for directly.

    Attributes
    ----------
    status : str
        The status a sweep would record.
    reason : str
        Why, and what to do about it.
    """

    def __init__(self, solver: str, status: Status, reason: str) -> None:
        super().__init__(f"{solver}: {status}: {reason}")
        self.solver = solver
        self.status: Status = status
        self.reason = reason


@dataclass(frozen=True, slots=True)
class Convergence:
    """What the limit dt -> 0 of an engine must satisfy (`engines.convergence`).

    Parameters
    ----------
    tolerance : float
        Largest error of the limit, per abs(v0), at which a result counts as converged.
    halvings : int
        How often the step that is asked for may be halved.

    Raises
    ------
    ValueError
        For an illegal value.
    """

    tolerance: float = 1e-3
    halvings: int = 4

    def __post_init__(self) -> None:
        if not 0 < self.tolerance <= 1:
            raise ValueError(f"tolerance = {self.tolerance!r}; legal: greater than 0, at most 1")
        if not 0 <= self.halvings <= 10:
            raise ValueError(f"halvings = {self.halvings!r}; legal: a whole number from 0 to 10")


@dataclass(frozen=True, slots=True)
class Settings:
    """How a compliant solver runs a collision; the impulse-level models ignore what does not concern them.

    Parameters
    ----------
    scenario : {"impact", "drop"}
        ``impact``: no gravity, B1 touches B2 with v0 at t = 0. ``drop``: gravity on, B2 settled in static
        equilibrium on the table, B1 touching it at t = 0 with v0.
    gravity : float
        g > 0 in m/s^2, used by ``drop`` only.
    step_fraction : float
        Time step over the period 2 pi sqrt(M_i/k_i) of the faster contact; in (0, 0.1].
    max_steps : int
        Steps after which a collision that is not over is given up (status ``timeout``).
    mapping : {"calibrated", "naive"}
        How k_i and c_i become the engine's own parameters.
    shortest_state : float
        A state that an engine holds for less than this share of the shorter contact period takes the state before it;
        in [0, 0.1]. The states of an exact solver are all there, until they are compared
        (`states`).
    record_path : bool
        Whether outcomes carry the path.
    stiffness_ratio_cutoff : float or "exact"
        Of the state-transition model (`model.solve`): a number, infinity for none, or by default the rule that gives
        the outcome without one.
    grazing_threshold : float
        Grazing margin below which an outcome of the model is marked; from 0 to 1.
    mark : bool
        Whether references and engines mark outcomes beside a jump of their exact law (`references.jumps`).
    convergence : Convergence or None
        Whether engines are also run at shorter steps until their limit is known, and how well.

    Raises
    ------
    ValueError
        For an illegal value; the message names the field, the value and the legal range.
    """

    scenario: Scenario = "impact"
    gravity: float = 9.81
    step_fraction: float = 1e-3
    max_steps: int = 2_000_000
    mapping: MappingName = "calibrated"
    shortest_state: float = SHORTEST_STATE
    record_path: bool = False
    stiffness_ratio_cutoff: Cutoff = "exact"
    grazing_threshold: float = GRAZING_THRESHOLD
    mark: bool = True
    convergence: Convergence | None = None

    def __post_init__(self) -> None:
        for name, legal, legal_range in (
            ("scenario", self.scenario in ("impact", "drop"), "'impact' or 'drop'"),
            ("gravity", 0 < self.gravity < float("inf"), "a finite number > 0 (m/s^2)"),
            (
                "step_fraction",
                0 < self.step_fraction <= 0.1,
                "greater than 0, at most 0.1 (of a contact period)",
            ),
            ("max_steps", self.max_steps >= 1, "a whole number >= 1"),
            ("mapping", self.mapping in ("calibrated", "naive"), "'calibrated' or 'naive'"),
            (
                "shortest_state",
                0 <= self.shortest_state <= 0.1,
                "from 0 to 0.1 (of the shorter contact period)",
            ),
            ("stiffness_ratio_cutoff", legal_cutoff(self.stiffness_ratio_cutoff), LEGAL_CUTOFF),
            ("grazing_threshold", 0 <= self.grazing_threshold <= 1, "from 0 to 1"),
        ):
            if not legal:
                raise ValueError(f"{name} = {getattr(self, name)!r}; legal: {legal_range}")


@runtime_checkable
class Solver(Protocol):
    """A way to find out how a collision ends."""

    name: str

    @abstractmethod
    def version(self) -> str:
        """Version of what does the work (the engine's own), or ``""`` if it is not installed."""

    def unavailable(self) -> str | None:
        """Why the solver cannot run on this machine and the way out, in one sentence; None if it can."""

    @abstractmethod
    def solve_many(self, collisions: Sequence[Collision], settings: Settings) -> Sequence[Outcome]:
        """Answer every collision, in order; failures are outcomes with a status (rule 2)."""

    @abstractmethod
    def solve(self, collision: Collision, settings: Settings = ...) -> Outcome:
        """Answer one collision, or raise `SolverError` (rule 3)."""


class SolverBase(Solver):
    """What most solvers share: one in terms of many, columns refused, and, from `Solver`, being available."""

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

    def solve_columns(self, columns: Sequence[Collision], settings: Settings) -> Sequence[Outcome]:
        """Answer every column of N balls, in order; failures are outcomes with a status (rule 2).

        Parameters
        ----------
        columns : sequence of Collision
        settings : Settings
            References and engines know the scenario `impact` only.
        """
        return [
            Outcome.failure(self.name, column, "unrepresentable", no_columns(self.name)) for column in columns
        ]

    def solve_column(self, column: Collision, settings: Settings | None = None) -> Outcome:
        """Answer one column of N balls.

        Raises
        ------
        SolverError
            If the outcome's status is neither ``ok`` nor ``limit``.
        """
        outcome = self.solve_columns([column], settings or Settings())[0]
        if outcome.status not in RESULT_STATUSES:
            raise SolverError(self.name, outcome.status, outcome.reason)
        return outcome


_Answer = TypeVar("_Answer")


def by_kind(
    collisions: Sequence[Collision], solve: Callable[[Collisions], Sequence[_Answer]]
) -> Sequence[_Answer]:
    """Answer collisions in groups that arrays hold and that are solved alike, with or without gaps; in their order."""
    if isinstance(collisions, Collisions):
        flags = collisions.falls_on_resting, collisions.gaps.any(axis=1)
        if all(flag.all() or not flag.any() for flag in flags):
            return solve(collisions)
    kinds: dict[tuple[object, ...], list[int]] = {}
    for i, c in enumerate(collisions):
        kind = len(c.masses), c.table, c.exponent, c.falls_on_resting, any(c.gaps)
        kinds.setdefault(kind, []).append(i)
    found: dict[int, _Answer] = {}
    for places in kinds.values():
        outcomes = solve(Collisions.of(collisions[i] for i in places))
        if len(kinds) == 1:
            return outcomes
        found |= zip(places, outcomes, strict=True)
    return [found[i] for i in range(len(collisions))]


def no_columns(name: str) -> str:
    """Say that a solver solves no columns."""
    return f"{name} does not solve columns of N balls"


def no_gravity(settings: Settings) -> str | None:
    """Why columns are not solved under these settings; None if they are."""
    if settings.scenario == "impact":
        return None
    return f"scenario = {settings.scenario!r}: columns of N balls are solved without gravity; legal: 'impact'"
