"""``impact-xval calibrate``: whether an engine, contact by contact, does what it is asked.

Each engine is asked for one contact at a time, ball on table and ball on ball in free fall, over restitution,
stiffness and step, by the calibrated mapping and by the naive one.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from impact_xval.compliant_baselines import SolverError, get_solver
from impact_xval.compliant_baselines.calibration.calibration import (
    ContactRequest,
    ContactResult,
    contact_limit,
    try_contacts,
)
from impact_xval.compliant_baselines.contract.registry import engine_names
from impact_xval.compliant_baselines.contract.solver import MappingName
from impact_xval.compliant_baselines.engines.engine import EngineSolver
from impact_xval.experiments.config.errors import UserError

#: A pandas DataFrame; its annotations are too wide to check code against.
Frame = Any

RESTITUTIONS = (0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
STIFFNESSES = tuple(float(f"1e{power}") for power in range(2, 9))
STEP_FRACTIONS = tuple(1e-3 / 2**n for n in range(4))
CONTACTS = ("ball-table", "ball-ball")
MAPPINGS: tuple[MappingName, ...] = ("calibrated", "naive")
#: Masses of B1 and B2 in kg; 2/sqrt(3) is that of the paper's example.
M1, M2 = 1.0, 2 / 3**0.5
V0 = -1.0

#: What identifies one contact asked for, at whatever step.
CONTACT = ["engine", "mapping", "contact", "e", "k"]

#: Name, unit and meaning of the columns of ``calibration.csv``, a row a contact and step.
COLUMNS = {
    "engine": ("-", "name of the engine"),
    "version": ("-", "its version"),
    "mapping": ("-", "how (k, e) became the engine's parameters"),
    "contact": ("-", "ball-table or ball-ball"),
    "e": ("-", "restitution asked for"),
    "k": ("N/m", "stiffness asked for"),
    "mass": ("kg", "reduced mass of the pair"),
    "step_fraction": ("-", "time step over the period of the undamped contact"),
    "status": ("-", "ok, or why there is no result"),
    "reason": ("-", "one sentence where the status is not ok"),
    "restitution": ("-", "restitution obtained"),
    "duration": ("s", "duration obtained"),
    "duration_asked": ("s", "duration asked for, by the formula of the contact that ends at zero force"),
}


@dataclass(frozen=True, slots=True)
class Calibration:
    """What came of it.

    Attributes
    ----------
    steps : DataFrame
        A row a contact and step, columns `COLUMNS`.
    limits : DataFrame
        A row a contact: `CONTACT`, then ``restitution, duration_ratio`` in the limit of small steps,
        ``restitution_order, duration_order, order`` (of both errors together), and
        ``restitution_at_step, duration_ratio_at_step`` at the longest step; NaN where a step has no result.
    versions : dict
        Version by engine; why not, for one that is unavailable.
    """

    steps: Frame
    limits: Frame
    versions: dict[str, str]

    @property
    def engines(self) -> list[str]:
        """The engines that were asked, in their order."""
        return list(self.versions)

    def limits_of(self, engine: str, mapping: str) -> Frame:
        """Rows of `limits` of one engine by one mapping."""
        table = self.limits
        return table[(table.engine == engine) & (table.mapping == mapping)]


def engines_of(names: Sequence[str] | None) -> list[EngineSolver]:
    """Find engines by their names; all of them for none.

    Raises
    ------
    UserError
        If one is unknown, no engine, or named twice.
    """
    known = engine_names(on_request=True)
    for name in names or ():
        if name not in known:
            raise UserError(f"--engine = {name!r}; legal: {', '.join(known)}")
        if list(names or ()).count(name) > 1:
            raise UserError(f"--engine {name!r} is given more than once; legal: each engine once")
    solvers = [get_solver(name) for name in names or known]
    return [solver for solver in solvers if isinstance(solver, EngineSolver)]


def requests_of(
    mapping: MappingName,
    restitutions: Sequence[float] = RESTITUTIONS,
    stiffnesses: Sequence[float] = STIFFNESSES,
    fractions: Sequence[float] = STEP_FRACTIONS,
) -> list[ContactRequest]:
    """List the contacts to ask for; the step varies fastest, from the longest."""
    return [
        ContactRequest(contact, e, k, M1, M2, V0, fraction, mapping)
        for contact, e, k, fraction in itertools.product(CONTACTS, restitutions, stiffnesses, fractions)
    ]


def calibrate_engine(solver: EngineSolver, requests: Sequence[ContactRequest]) -> list[dict[str, Any]]:
    """Ask one engine; rows of `Calibration.steps`."""
    unavailable = solver.unavailable()
    version = solver.version() if unavailable is None else ""
    return [
        _row(solver.name, version, request, answer)
        for request, answer in zip(requests, try_contacts(solver, requests), strict=True)
    ]


def _row(
    name: str, version: str, request: ContactRequest, answer: ContactResult | SolverError
) -> dict[str, Any]:
    row: dict[str, Any] = {
        "engine": name,
        "version": version,
        "mapping": request.mapping,
        "contact": request.contact,
        "e": request.e,
        "k": request.k,
        "mass": request.asked().mass,
        "step_fraction": request.step_fraction,
        "duration_asked": request.asked().duration,
    }
    if isinstance(answer, SolverError):
        return row | {"status": answer.status, "reason": answer.reason}
    return row | {"status": "ok", "restitution": answer.restitution, "duration": answer.duration}


def calibration_of(rows: Sequence[dict[str, Any]], engines: Sequence[EngineSolver]) -> Calibration:
    """Arrange the rows of all engines, and extrapolate each contact to a step of zero."""
    steps = pd.DataFrame(rows, columns=list(COLUMNS))
    limits = [_limit(key, group) for key, group in steps.groupby(CONTACT, sort=False)]
    versions = {s.name: s.unavailable() or s.version() for s in engines}
    return Calibration(steps, pd.DataFrame(limits), versions)


def _limit(key: Any, group: Frame) -> dict[str, Any]:
    row: dict[str, Any] = dict(zip(CONTACT, key, strict=True))
    names = ("restitution", "duration_ratio", "restitution_order", "duration_order", "order")
    longest = group.iloc[0]
    row |= {
        "restitution_at_step": longest.restitution,
        "duration_ratio_at_step": longest.duration / longest.duration_asked,
    }
    if not (group.status == "ok").all():
        return row | dict.fromkeys(names, np.nan)
    request = ContactRequest(row["contact"], row["e"], row["k"], M1, M2, V0, mapping=row["mapping"])
    results = [
        ContactResult(
            replace(request, step_fraction=s.step_fraction), s.restitution, s.duration, s.duration_asked
        )
        for s in group.itertuples()
    ]
    limit = contact_limit(results)
    values = (limit.restitution, limit.duration, *limit.orders)
    return row | dict(zip(names, values, strict=True))
