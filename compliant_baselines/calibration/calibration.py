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
from numpy.typing import NDArray

from impact_xval.compliant_baselines.contact.column import Column
from impact_xval.compliant_baselines.contact.mapping import Contact
from impact_xval.compliant_baselines.contract.solver import MappingName, SolverError
from impact_xval.compliant_baselines.engines.convergence import extrapolated, fitted_order
from impact_xval.compliant_baselines.engines.engine import EngineSolver
from impact_xval.compliant_baselines.engines.recording import Run


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
        From touch to where the force comes to zero, in s; to a fraction of a step (`trajectory.scan`).
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
    answers = try_contacts(solver, requests, max_steps)
    for answer in answers:
        if isinstance(answer, SolverError):
            raise answer
    return [answer for answer in answers if isinstance(answer, ContactResult)]


def try_contacts(
    solver: EngineSolver, requests: Sequence[ContactRequest], max_steps: int = 10_000_000
) -> list[ContactResult | SolverError]:
    """Ask for single contacts as `calibrate` does; what fails is an error in its place."""
    reason = solver.unavailable()
    if reason is not None:
        return [SolverError(solver.name, "unavailable", reason)] * len(requests)
    columns = [request.column() for request in requests]
    answers: list[ContactResult | SolverError | None] = []
    for column in columns:
        refused = solver.refusal(column)
        answers.append(SolverError(solver.name, "unrepresentable", refused) if refused else None)
    accepted = [i for i, answer in enumerate(answers) if answer is None]
    for i, run in zip(accepted, solver.run_columns([columns[i] for i in accepted], max_steps), strict=True):
        try:
            answers[i] = _result(solver.name, requests[i], run)
        except SolverError as error:
            answers[i] = error
    return [answer for answer in answers if answer is not None]


def _result(name: str, request: ContactRequest, run: Run) -> ContactResult:
    if not run.over:
        raise SolverError(name, run.status, f"{request}: {run.problem()}")
    table = request.contact == "ball-table"
    after = run.v2 if table else run.v1 - run.v2
    return ContactResult(
        request=request,
        restitution=after / abs(request.v0),
        duration=run.unloaded[1 if table else 0],
        duration_asked=request.asked().duration,
    )


@dataclass(frozen=True, slots=True)
class ContactLimit:
    """What a contact tends to as the step goes to zero.

    Attributes
    ----------
    restitution : float
        Extrapolated coefficient of restitution.
    duration : float
        Extrapolated duration over the one asked for.
    orders : tuple of float
        Fitted orders in the step of the differences from what was asked for: of the restitution, of the
        duration, and of both together (their root of squares). Where the first-order term of one of them
        changes sign with e, or is missing (MuJoCo at e = 1), its own order is another.
    """

    restitution: float
    duration: float
    orders: tuple[float, float, float]


def contact_limit(
    e: float, restitution: NDArray[np.float64], duration_ratio: NDArray[np.float64]
) -> ContactLimit:
    """Extrapolate one contact, requested at steps each half of the one before, to a step of zero.

    The errors of a single contact are smooth in the step: it is met at the beginning of the first one.

    Parameters
    ----------
    e : float
        Restitution asked for.
    restitution, duration_ratio : ndarray, shape (n,)
        Restitution, and duration over the one asked for, at three steps or more, the longest first.
    """
    off1, off2 = restitution - e, duration_ratio - 1
    return ContactLimit(
        restitution=float(extrapolated(restitution)[-1]),
        duration=float(extrapolated(duration_ratio)[-1]),
        orders=(fitted_order(np.abs(off1)), fitted_order(np.abs(off2)), fitted_order(np.hypot(off1, off2))),
    )
