"""The result of one collision of bodies by any solver: `GraphCollisionOutcome`.

`graph.outcome.GraphOutcome` is the result of the model alone; it also has events and impulses.

Needs `graph.collision`, `model.outcome` and `model.status`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from impact_xval.model.outcome import describe_differences
from impact_xval.model.status import IS_RESULT, STATUSES, Status

if TYPE_CHECKING:
    from impact_xval.model.graph.collision import GraphCollision


@dataclass(frozen=True, slots=True)
class GraphCollisionOutcome:
    """Result of one collision of bodies by any solver.

    Attributes
    ----------
    solver : str
        Name of the solver.
    velocities : tuple of tuple of float
        Velocity of each body's centre of mass when the collision is over, in m/s: (x, z) in a plane, (x, y, z) in
        space. NaN if there is no result, for which `status` gives the reason.
    angular_velocities : tuple of tuple of float
        Angular velocity of each body, in rad/s; empty where no body turns.
    status : str
        ``"ok"``, ``"closed-form"``, or a status that says why there is no result.
    reason : str
        One sentence that explains the status.
    mark : str
        One sentence that warns of the outcome if a tiny change of the input would make it jump to another outcome of
        the solver's law; else empty.
    diagnostics : mapping of str to float
        Further numbers of the solver, by name, such as residuals and errors.
    limit_velocities : tuple of tuple of float
        Velocities extrapolated to a time step of zero, in the same form as `velocities`. Empty if the limit is not
        known, or was not asked for. ``diagnostics["limit_error"]`` is its error in m/s.
    requested, effective : mapping of str to tuple of float
        Parameters that an engine was given, and the values that it reports to use, by name.
    """

    solver: str
    velocities: tuple[tuple[float, ...], ...]
    angular_velocities: tuple[tuple[float, ...], ...] = ()
    status: Status = "ok"
    reason: str = ""
    mark: str = ""
    diagnostics: Mapping[str, float] = field(default_factory=dict[str, float])
    limit_velocities: tuple[tuple[float, ...], ...] = ()
    requested: Mapping[str, tuple[float, ...]] = field(default_factory=dict[str, tuple[float, ...]])
    effective: Mapping[str, tuple[float, ...]] = field(default_factory=dict[str, tuple[float, ...]])

    @property
    def has_result(self) -> bool:
        """Whether the velocities are a result of the solver."""
        return bool(IS_RESULT[STATUSES.index(self.status)])

    @property
    def differences(self) -> str:
        """Sentence that names the parameters that an engine changed by more than rounding; empty if it changed none."""
        return describe_differences(self.requested, self.effective)

    @classmethod
    def failure(
        cls, solver: str, collision: GraphCollision, status: Status, reason: str
    ) -> GraphCollisionOutcome:
        """Return the outcome of a solver that gave no result, with the reason."""
        unknown = tuple((math.nan,) * len(v) for v in collision.velocities)
        return cls(solver, unknown, status=status, reason=reason)
