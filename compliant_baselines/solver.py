"""The base classes of solvers, and the rules that every solver follows.

1. A solver is a class derived from `Solver`. A solver that answers one collision at a time is derived from `OneByOne`.
   Its constructor takes no arguments and is cheap: an engine is imported when it shall run, never at module level.
2. `solve_many` answers every collision, in order, with one `Outcome` each. A collision that the solver cannot solve (N
   balls, gravity, e = 0) is refused with the reason: `Outcome.failure` with the status ``unrepresentable``. A solver
   never replaces a parameter silently.
3. `law` names the exact solver of this package to which the solver converges as its step goes to zero. For
   ``kelvin-voigt`` contact i is F = max(0, k_i delta + c_i delta'), with c_i from `mapping`. None says that no exact
   solver of this package has the solver's law.
4. An outcome depends only on the collision and the settings. A call leaves no global state that a later call could see,
   and there is no hidden seed. An outcome has the same bits whatever other collisions are in the call.
5. Velocities are in m/s, impulses in N s, times in s. They belong to the collision as given and are never rescaled.
6. The collision is over when the balls are apart, the lowest ball is off the table or at rest on it, and no ball will
   meet another ball again.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, TypeVar, get_args

import numpy as np
from numpy.typing import NDArray

from impact_xval.compliant_baselines.states import SHORTEST_STATE
from impact_xval.errors import ImpactXvalError
from impact_xval.model.collision import Collision
from impact_xval.model.collisions import Collisions
from impact_xval.model.graph.collision_outcome import GraphCollisionOutcome
from impact_xval.model.inputs import GRAZING_THRESHOLD, LEGAL_CUTOFF, Cutoff, legal_cutoff
from impact_xval.model.outcome import Outcome
from impact_xval.model.status import RESULT_STATUSES, Status

if TYPE_CHECKING:
    from impact_xval.model.graph.collision import GraphCollision

Scenario = Literal["impact", "drop"]
MappingName = Literal["calibrated", "naive", "documented", "shipped"]

#: Kinds of solvers. ``model``: impulses without positions. ``reference``: contacts in time, solved exactly.
#: ``compliant`` and ``rigid``: an engine with compliant or rigid contacts.
Kind = Literal["model", "reference", "compliant", "rigid"]

#: The law that engines with compliant contacts are asked for, unless their adapters state another law.
KELVIN_VOIGT = "kelvin-voigt"


class SolverError(ImpactXvalError, ValueError):
    """Error of a solver that has no result; its fields are the solver's name, the outcome's status, and the reason."""

    def __init__(self, solver: str, status: Status, reason: str) -> None:
        super().__init__(f"{solver}: {status}: {reason}")
        self.solver = solver
        self.status: Status = status
        self.reason = reason


@dataclass(frozen=True, slots=True)
class Convergence:
    """Accuracy that is asked of an engine's limit dt -> 0 (`engines.convergence`).

    Raises
    ------
    ValueError
        If a value is illegal; the message names the field, the value and the legal range.
    """

    #: Largest error of a velocity, over abs(v0), with which the limit is accepted.
    tolerance: float = 1e-3
    #: Largest number of times that the length of the requested time step is halved.
    halvings: int = 4

    def __post_init__(self) -> None:
        if not 0 < self.tolerance <= 1:
            raise ValueError(f"tolerance = {self.tolerance!r}; legal: greater than 0, at most 1")
        if not 0 <= self.halvings <= 10:
            raise ValueError(f"halvings = {self.halvings!r}; legal: a whole number from 0 to 10")


@dataclass(frozen=True, slots=True)
class Settings:
    """The settings of a solver for one call; a solver ignores settings that do not concern it.

    `experiments.config.experiment.Config` states defaults and legal ranges once more, for the files of experiments.
    Change both together.

    Raises
    ------
    ValueError
        If a value is illegal; the message names the field, the value and the legal range.
    """

    #: ``impact``: no gravity. ``drop``: gravity acts, the lower ball B2 has settled on the table, and the upper ball B1
    #: touches it at t = 0 with v0.
    scenario: Scenario = "impact"
    #: Gravity g > 0 in m/s^2; only ``drop`` uses it.
    gravity: float = 9.81
    #: Time step over the period 2 pi sqrt(M_i/k_i) of the faster contact; in (0, 0.2]. The default of `shortest_state`
    #: is two and a half of the default steps.
    step_fraction: float = 1e-3
    #: Largest number of steps. A collision that is not over then has the status ``timeout``.
    max_steps: int = 2_000_000
    #: Name of the mapping from the stiffness and restitution of a contact to the engine's own parameters (`mapping`).
    mapping: MappingName = "calibrated"
    #: Shortest duration with which a state is kept, over the shorter contact period; in [0, 0.1]. A state that lasts
    #: less is merged with the state before it (`states`).
    shortest_state: float = SHORTEST_STATE
    #: True if outcomes shall contain the path: times, velocities and impulses during the collision.
    record_path: bool = False
    #: Only for the state-transition model: the stiffness ratio from which the stiffer contact is taken for rigid, or
    #: "exact" (`model.solve`).
    stiffness_ratio_cutoff: Cutoff = "exact"
    #: Only for the state-transition model: the grazing margin, from 0 to 1, below which an outcome gets a mark.
    grazing_threshold: float = GRAZING_THRESHOLD
    #: True if references and engines shall add a sentence of warning, a mark, to outcomes next to a jump of their exact
    #: law (`marks`).
    mark: bool = True
    #: Accuracy of the limit dt -> 0 that engines compute from runs at several steps; None: no limit is computed.
    convergence: Convergence | None = None
    #: Only for rigid engines that multiply the restitutions of two bodies: the restitution of the lower body of a
    #: contact, from 0 to 1. The upper body has the restitution e of the contact. So by default the product is e.
    partner_restitution: float = 1.0

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
            ("partner_restitution", 0 <= self.partner_restitution <= 1, "from 0 to 1"),
        ):
            if not legal:
                raise ValueError(f"{name} = {getattr(self, name)!r}; legal: {legal_range}")


class Solver(ABC):
    """Base class of all solvers; a solver finds the outcomes of collisions."""

    #: Name by which `get_solver` finds the solver.
    name: str
    kind: Kind = "compliant"
    #: Name of the exact solver of the law that the solver obeys or is asked for (rule 3 of the module's docstring).
    law: str | None = KELVIN_VOIGT
    #: Largest decrease of an impulse along a path, over m1 |v0|, that is taken for rounding.
    rounding: float = 1e-9

    @abstractmethod
    def version(self) -> str:
        """Return the version of the engine or program that solves; ``""`` if it is not installed."""

    def unavailable(self) -> str | None:
        """Return None if the solver can run on this machine; else one sentence with the reason and the remedy."""
        return None

    @abstractmethod
    def solve_many(self, collisions: Sequence[Collision], settings: Settings) -> Sequence[Outcome]:
        """Solve many collisions, which may have different numbers of balls.

        Parameters
        ----------
        collisions
            The collisions.
        settings
            Settings of the solver.

        Returns
        -------
        Sequence[Outcome]
            One outcome for every collision, in order. A collision without a result has an outcome whose status gives
            the reason.
        """

    def solve_graphs(
        self, collisions: Sequence[GraphCollision], settings: Settings
    ) -> Sequence[GraphCollisionOutcome]:
        """Solve contact graphs: collisions of bodies that touch in any number of contacts.

        This method refuses every graph. A solver for balls in a line alone inherits it.

        Parameters
        ----------
        collisions
            The contact graphs.
        settings
            Settings of the solver.

        Returns
        -------
        Sequence[GraphCollisionOutcome]
            One outcome for every graph, in order. A graph without a result has an outcome whose status gives the
            reason.
        """
        reason = f"{self.name} solves balls in a line alone, no contact graphs"
        return [
            GraphCollisionOutcome.failure(self.name, collision, "unrepresentable", reason)
            for collision in collisions
        ]

    def solve(self, collision: Collision, settings: Settings | None = None) -> Outcome:
        """Solve one collision.

        Parameters
        ----------
        collision
            The collision.
        settings
            Settings of the solver; None: the defaults.

        Returns
        -------
        Outcome
            The outcome, whose status is ``ok`` or ``closed-form``.

        Raises
        ------
        SolverError
            If the outcome's status is neither ``ok`` nor ``closed-form``.
        """
        outcome = self.solve_many([collision], settings or Settings())[0]
        if outcome.status not in RESULT_STATUSES:
            raise SolverError(self.name, outcome.status, outcome.reason)
        return outcome


class OneByOne(Solver):
    """Base class of solvers that solve one collision at a time."""

    @abstractmethod
    def solve_one(self, collision: Collision, settings: Settings) -> Outcome:
        """Solve one collision. If there is no result, the outcome's status gives the reason."""

    def solve_many(self, collisions: Sequence[Collision], settings: Settings) -> Sequence[Outcome]:
        """Solve every collision, and return the outcomes in order."""
        return [self.solve_one(collision, settings) for collision in collisions]


_Answer = TypeVar("_Answer")


def group_by_layout(collisions: Sequence[Collision]) -> list[tuple[NDArray[np.intp], Collisions]]:
    """Group collisions that can be solved together as arrays. Return the positions and the collisions of each group.

    The collisions of a group have the same layout: the same number of balls and the same exponent. They also agree in
    whether there is a table, whether there are gaps, and whether all balls below the first are at rest.
    """
    if isinstance(collisions, Collisions):
        properties = collisions.falls_on_resting, collisions.gaps.any(axis=1)
        if all(values.all() or not values.any() for values in properties):
            return [(np.arange(len(collisions)), collisions)]
    positions: dict[tuple[object, ...], list[int]] = {}
    for position, c in enumerate(collisions):
        layout = len(c.masses), c.table, c.exponent, c.falls_on_resting, any(c.gaps)
        positions.setdefault(layout, []).append(position)
    return [(np.array(group), Collisions.of(collisions[i] for i in group)) for group in positions.values()]


def solve_in_groups(
    collisions: Sequence[Collision], solve: Callable[[Collisions], Sequence[_Answer]]
) -> Sequence[_Answer]:
    """Solve collisions group by group (`group_by_layout`), and return the answers in the order of the collisions."""
    groups = group_by_layout(collisions)
    if len(groups) == 1:
        return solve(groups[0][1])
    answers: dict[int, _Answer] = {}
    for positions, group in groups:
        answers |= zip(positions.tolist(), solve(group), strict=True)
    return [answers[position] for position in range(len(collisions))]
