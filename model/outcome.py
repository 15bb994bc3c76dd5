"""The result of one collision by any solver: `Outcome`.

`model.outcomes` has many outcomes as arrays.

Needs `model.collision`, `model.status` and `model.path`. Every solver returns an `Outcome`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field

from impact_xval.model.collision import Collision
from impact_xval.model.kinetic import kinetic_norm
from impact_xval.model.path import Path
from impact_xval.model.status import RESULT_STATUSES, STATUSES, Status

#: Name of a state: one of the paper's, or the numbers of the active contacts, or ``-`` if no contact is active.
_STATE = re.compile(r"S[1-4]|[1-9]\d*(\+[1-9]\d*)*|-", re.ASCII)


@dataclass(frozen=True, slots=True)
class Outcome:
    """Result of one collision by any solver.

    Attributes
    ----------
    solver : str
        Name of the solver.
    velocities : tuple of float, length N
        Velocities when the collision is over, in m/s; NaN if there is no result, for which `status` gives the reason.
    impulses : tuple of float, one per contact
        Total impulses in N s.
    states : tuple of str
        The sets of active contacts in the order of time, such as ``("1+2", "2", "-")``. For two balls on a table they
        have the paper's names, such as ``("S1", "S3", "S1", "S2", "S4")``.
    status : str
        One of `STATUSES`: ``"ok"``; ``"closed-form"`` where a closed form was used; any other status says why there is
        no result.
    reason : str
        One sentence that explains the status; never empty unless the status is ``"ok"`` or ``"closed-form"``.
    grazing_margin : float or None
        How near the collision is to a jump of the model's outcome (docs/theory.md, section 6): the smallest rate of
        compression at a turning point, divided by the amplitude of this rate. It is infinite if no quotient is below
        `pair.grazing.NEAR`, and None if it was not computed.
    mark : str
        One sentence that warns of the outcome, or empty. An outcome gets a mark if it is very near a jump or a cut-off:
        a tiny change of the input may change the velocities a lot. Statistics leave marked outcomes out.
    n_events : int
        Number of events.
    diagnostics : mapping of str to float
        Further numbers that the solver states, such as its time step, its number of steps, or the residual of its
        energy.
    path : Path or None
        Velocities, impulses and forces during the collision, if they were recorded.
    requested, effective : mapping of str to tuple of float
        Parameters that an engine was given, and parameters that it reports to use. Each has one number per contact, or
        one number for all contacts: ``"stiffness"`` (N/m), ``"damping"`` (N s/m), ``"restitution"``, ``"step"`` (s).

    Raises
    ------
    ValueError
        For an unknown status, a state that is not named as above, a result that is not finite, a missing reason, or
        lengths that fit no line of balls; the message names the field, the value and what is legal.
    """

    solver: str
    velocities: tuple[float, ...]
    impulses: tuple[float, ...]
    states: tuple[str, ...] = ()
    status: Status = "ok"
    reason: str = ""
    grazing_margin: float | None = None
    mark: str = ""
    n_events: int = 0
    diagnostics: Mapping[str, float] = field(default_factory=dict[str, float])
    path: Path | None = None
    requested: Mapping[str, tuple[float, ...]] = field(default_factory=dict[str, tuple[float, ...]])
    effective: Mapping[str, tuple[float, ...]] = field(default_factory=dict[str, tuple[float, ...]])

    def __post_init__(self) -> None:
        balls, contacts = len(self.velocities), len(self.impulses)
        if self.status not in STATUSES:
            raise ValueError(f"status = {self.status!r}; legal: {', '.join(STATUSES)}")
        for state in set(self.states):
            if not _STATE.fullmatch(state):
                raise ValueError(f"states: {state!r:.60}; legal: S1 to S4, numbers such as '1+3', or '-'")
        if contacts not in (balls - 1, balls):
            raise ValueError(f"impulses: {contacts} values for {balls} balls; legal: {balls - 1} or {balls}")
        if self.status not in RESULT_STATUSES:
            if not self.reason:
                raise ValueError(f"reason = ''; legal with the status {self.status!r}: why, in one sentence")
            return
        for name, values in (("velocities", self.velocities), ("impulses", self.impulses)):
            for i, value in enumerate(values, 1):
                if not math.isfinite(value):
                    raise ValueError(
                        f"{name}[{i}] = {value!r}; legal with the status {self.status!r}: finite numbers"
                    )

    @property
    def marked(self) -> bool:
        """Whether the outcome has a mark, because it is very near a jump or a cut-off."""
        return bool(self.mark)

    v1 = property(lambda self: self.velocities[0], doc="Velocity of ball 1, in m/s.")
    v2 = property(lambda self: self.velocities[1], doc="Velocity of ball 2, in m/s.")
    impulse1 = property(lambda self: self.impulses[0], doc="Impulse of contact 1, in N s.")
    impulse2 = property(lambda self: self.impulses[1], doc="Impulse of contact 2, in N s.")

    @property
    def differences(self) -> str:
        """Sentence that names the parameters that an engine changed by more than rounding; empty if it changed none."""
        return describe_differences(self.requested, self.effective)

    def retained_energy(self, collision: Collision) -> float:
        """Return the kinetic energy after the collision, divided by the kinetic energy before it."""
        before = kinetic_norm(collision.masses, collision.velocities)
        after = kinetic_norm(collision.masses, self.velocities)
        return float((after / before) ** 2)

    @classmethod
    def failure(cls, solver: str, collision: Collision, status: Status, reason: str) -> Outcome:
        """Return the outcome of a solver that gave no result, with the reason."""
        unknown = (math.nan,)
        balls, contacts = len(collision.masses), len(collision.stiffnesses)
        return cls(solver, unknown * balls, unknown * contacts, status=status, reason=reason)


def describe_differences(
    requested: Mapping[str, tuple[float, ...]], effective: Mapping[str, tuple[float, ...]]
) -> str:
    """Return a sentence that names the parameters that an engine changed by more than rounding.

    The sentence is empty if it changed none.
    """
    phrases: list[str] = []
    for name in sorted(requested.keys() & effective.keys()):
        for i, (value, used) in enumerate(zip(requested[name], effective[name], strict=True), 1):
            if not math.isclose(value, used, rel_tol=1e-9):
                parameter = f"{name} {i}" if len(requested[name]) > 1 else name
                phrases.append(f"{parameter} is {used:.6g}, {value:.6g} was asked for")
    return "; ".join(phrases)
