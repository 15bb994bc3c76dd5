"""One contact alone: whether an engine returns the restitution and the duration it was asked for.

The column of a collision is used as it is, so that what is tested is what is run. The other contact is kept
out of the way by how the balls start:

* **ball-table**: B2 meets the table at v0 while B1 leaves upwards at twice the speed;
* **ball-ball**: a free pair. B1 meets B2 at relative velocity v0, in a frame that rises at twice the speed,
  high above the table: whatever the masses, B2 is not driven below rest.

Without gravity, always: the zero-force formulas of the mapping are those of a contact in free fall.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from compliant_baselines.column import Column
from compliant_baselines.contract import MappingName, SolverError
from compliant_baselines.engine import EngineSolver
from compliant_baselines.mapping import Contact
from compliant_baselines.recording import Run
from compliant_baselines.trajectory import ALOFT, BROKEN, GOING


@dataclass(frozen=True, slots=True)
class ContactRequest:
    """A contact to ask an engine for.

    Attributes
    ----------
    contact : {"ball-table", "ball-ball"}
        Which of the column's contacts.
    e : float
        Coefficient of restitution in (0, 1].
    k : float
        Stiffness in N/m.
    m1, m2 : float
        Masses of the balls in kg; ball-table takes m2 only.
    v0 : float
        Relative velocity at touch in m/s, negative.
    step_fraction : float
        Time step over the period of the contact.
    mapping : str
        How the contact becomes the engine's parameters.
    """

    contact: Literal["ball-table", "ball-ball"]
    e: float
    k: float = 1e8
    m1: float = 1.0
    m2: float = 1.0
    v0: float = -1.0
    step_fraction: float = 1e-3
    mapping: MappingName = "calibrated"

    def asked(self) -> Contact:
        """Give the contact as it is meant, whatever the mapping makes of it."""
        mass = self.m2 if self.contact == "ball-table" else 1 / (1 / self.m1 + 1 / self.m2)
        return Contact.from_restitution(self.k, self.e, mass)

    def column(self) -> Column:
        """Set up the column that shows this contact alone."""
        asked = self.asked()
        given = Contact.from_restitution(self.k, self.e, asked.mass, self.mapping)
        speed = abs(self.v0)
        # Out of reach for the contact's whole duration, with room to spare.
        far = 10 * speed * asked.period
        table = self.contact == "ball-table"
        return Column(
            m1=self.m2 if table else self.m1,
            m2=self.m2,
            contact1=given,
            contact2=given,
            mapping=self.mapping,
            gravity=0.0,
            settled=False,
            x1=far,
            x2=0.0 if table else far,
            v1=2 * speed if table else speed,
            v2=-speed if table else 2 * speed,
            step=self.step_fraction * asked.period,
        )


@dataclass(frozen=True, slots=True)
class ContactResult:
    """What an engine made of a request.

    Attributes
    ----------
    request : ContactRequest
        What was asked.
    restitution : float
        Relative velocity after over that before.
    duration : float
        From touch to the end of the last step with force, in s.
    duration_asked : float
        What the zero-force formula says, in s.
    """

    request: ContactRequest
    restitution: float
    duration: float
    duration_asked: float


def calibrate(
    solver: EngineSolver, requests: Sequence[ContactRequest], max_steps: int = 10_000_000
) -> list[ContactResult]:
    """Ask an engine for single contacts, one ball against the table or one free pair each.

    Parameters
    ----------
    solver : EngineSolver
        For example `get_solver("mujoco")`.
    requests : sequence of ContactRequest
        What to ask.
    max_steps : int
        Steps after which a contact that is not over is given up.

    Raises
    ------
    SolverError
        If the engine is not installed, refuses a request, or does not finish one.
    ValueError
        For a restitution outside (0, 1].
    """
    reason = solver.unavailable()
    if reason is not None:
        raise SolverError(solver.name, "unavailable", reason)
    columns = [request.column() for request in requests]
    for column in columns:
        refused = solver.refusal(column)
        if refused is not None:
            raise SolverError(solver.name, "unrepresentable", refused)
    runs = solver.run_columns(columns, max_steps)
    return [_result(solver.name, request, run) for request, run in zip(requests, runs, strict=True)]


def _result(name: str, request: ContactRequest, run: Run) -> ContactResult:
    if run.end in (GOING, ALOFT):
        raise SolverError(name, "timeout", f"{request} is not over after {run.raw.n_steps} steps")
    if run.end == BROKEN:
        raise SolverError(name, "crashed", f"{request}: {run.failure or 'velocities are no longer finite'}")
    table = request.contact == "ball-table"
    after = run.v2 if table else run.v1 - run.v2
    loaded = np.flatnonzero(np.isin(run.raw.state, (1, 2) if table else (1, 3)))
    ends = np.append(run.raw.start[1:], run.raw.n_steps)
    steps = int(ends[loaded[-1]]) if loaded.size else 0
    return ContactResult(
        request=request,
        restitution=after / abs(request.v0),
        duration=steps * run.column.step,
        duration_asked=request.asked().duration,
    )
