"""The result of one collision of bodies by any solver: `GraphCollisionOutcome`.

Needs `graph.collision`, `model.outcome` and `model.status`. The model's own result, with its events, is
`graph.outcome.GraphOutcome`.
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
    velocities : tuple of tuple of float
        Velocity of each body's centre of mass when the collision is over, in m/s: (x, z) in a plane, (x, y, z) in
        space. NaN only with a status that explains it.
    angular_velocities : tuple of tuple of float
        Angular velocity of each body, in rad/s; empty where no body turns.
    status, reason, mark : str
        As in `Outcome`.
    diagnostics : mapping of str to float
        Further numbers that the solver states, as in `Outcome`.
    limit_velocities : tuple of tuple of float
        Velocities in the limit of a time step of zero, in the form of `velocities`; empty where the limit is not known
        or was not asked for. ``limit_error`` of `diagnostics` is the error of the limit in m/s.
    requested, effective : mapping of str to tuple of float
        As in `Outcome`.
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
        """True where the numbers are a result."""
        return bool(IS_RESULT[STATUSES.index(self.status)])

    @property
    def differences(self) -> str:
        """Sentence about the parameters that an engine changed beyond rounding; empty if there are none."""
        return describe_differences(self.requested, self.effective)

    @classmethod
    def failure(
        cls, solver: str, collision: GraphCollision, status: Status, reason: str
    ) -> GraphCollisionOutcome:
        """Return the outcome of a solver that gave no result, with the reason."""
        unknown = tuple((math.nan,) * len(v) for v in collision.velocities)
        return cls(solver, unknown, status=status, reason=reason)
