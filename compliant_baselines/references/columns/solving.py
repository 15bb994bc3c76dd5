"""`solve_column`: one column of N balls by a contact law in time."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from impact_xval.compliant_baselines.contact.restitution_laws import (
    damping_ratios,
    hunt_crossley_coefficients,
    textbook_damping_ratios,
)
from impact_xval.model.chain.kernel import RUNAWAY, TOO_MANY_EVENTS
from impact_xval.model.chain.laws import HUNT_CROSSLEY, KELVIN_VOIGT
from impact_xval.model.chain.laws import STATE_TRANSITION as BISTIFFNESS
from impact_xval.model.chain.power_law import TOLERANCE
from impact_xval.model.columns.column import Column, ColumnOutcome
from impact_xval.model.columns.solving import (
    LOG_ROWS,
    POINTS,
    beyond_precision,
    fitting,
    follow,
    impulses_of,
    path_of,
    scaled_column,
    states_of,
)
from impact_xval.model.inputs import EXPONENT

#: Laws by name, as codes of the driver.
LAWS = {
    "bistiffness": BISTIFFNESS,
    "kelvin-voigt": KELVIN_VOIGT,
    "kelvin-voigt-textbook": KELVIN_VOIGT,
    "hunt-crossley": HUNT_CROSSLEY,
}

#: Pieces of segments after which a column is given up, some seconds for five balls.
MAX_STEPS = 1_000_000

#: Times `TOLERANCE`, the tolerance of the second run from which the error of the first is known.
LOOSER = 100.0


def solve_column(
    column: Column,
    law: str = "kelvin-voigt",
    *,
    exponent: float = 1.0,
    path: bool = False,
    frozen: bool = False,
    max_steps: int = MAX_STEPS,
) -> ColumnOutcome:
    r"""Solve one column by a contact law in time, with positions, without gravity.

    Parameters
    ----------
    column : Column
        With its gaps, if any.
    law : str
        One of `LAWS`:

        * ``bistiffness``, the model's law with positions: a contact that has opened returns when its gap has closed;
        * ``kelvin-voigt``, F = max(0, k delta^p + c delta^((p - 1)/2) delta'), c = 2 zeta sqrt((p + 1)/2 k M), M of the
          two bodies of the contact alone and zeta from e (docs/theory.md, section 7). Linear for p = 1; for Hertz
          contacts the law of Tsuji, Tanaka and Ishida (Powder Technology 71:239, 1992). In xi = delta^((p + 1)/2) it is
          the linear contact, u du/dxi = -2 (k xi + c u)/(M (p + 1)): it has the same e for every p, at any speed;
        * ``kelvin-voigt-textbook``, the same with the zeta of a contact that may pull;
        * ``hunt-crossley``, F = max(0, k delta^p (1 + a delta')), a = A(e)/u with u the largest rate of compression at
          first touch (`contact.restitution_laws`: the same A for every p).
    exponent : float
        p, from 1 to 3; 1.5 are Hertz contacts.
    path : bool
        Whether the outcome carries `path`. Of a contact that is open its acceleration is not zero.
    frozen : bool
        Whether positions are frozen, as in the model: a contact that has opened returns where its bodies begin to
        approach. Such a column has no gaps.
    max_steps : int
        Pieces of segments after which the column is given up, with the status ``timeout``.

    Returns
    -------
    ColumnOutcome
        Status ``ok``, ``limit`` (only bistiffness: bodies were united by a closed form), ``timeout``, or
        ``unrepresentable`` for e_i = 0, or masses or stiffnesses too far apart. Exact to rounding where the forces are
        linear; else ``diagnostics`` hold ``velocity_error``, an estimate of the error of the velocities in m/s: by how
        much a run at 100 times the tolerance differs. ``duration`` is in s.

    Raises
    ------
    ValueError
        For an unknown law, an illegal exponent, or gaps where positions are frozen.
    """
    if law not in LAWS:
        raise ValueError(f"law = {law!r}; legal: {', '.join(LAWS)}")
    if frozen and any(column.gaps):
        raise ValueError(f"gaps = {column.gaps!r}; legal where positions are frozen: none")
    p = EXPONENT.number(exponent)
    for i, e in enumerate(column.restitutions, 1):
        if e == 0:
            reason = (
                f"restitutions[{i}] = 0.0: no finite stiffness or damping in time makes a contact perfectly plastic; "
                f"take a small positive one, or the state-transition model; legal for {law}: greater than 0, at most 1"
            )
            return ColumnOutcome.failure(law, column, "unrepresentable", reason)
    if reason := beyond_precision(column):
        return ColumnOutcome.failure(law, column, "unrepresentable", reason)
    scaled, units = scaled_column(column, p)
    length = units.speed * units.time
    b = coefficients_of(column, law, p)
    if LAWS[law] == HUNT_CROSSLEY:
        b = b * units.speed
    else:
        b = b / math.sqrt(column.masses[0]) / math.sqrt(column.stiffnesses[0])
    problem = scaled, p, LAWS[law], b, frozen, np.array(column.gaps) / length
    balls, contacts = len(column.masses), len(column.stiffnesses)
    points = POINTS if path else 1
    log = np.empty((LOG_ROWS, 1 + 2 * balls + contacts))
    velocities, went = follow(*problem, TOLERANCE, max_steps, points, log)
    code = went.code
    if code & TOO_MANY_EVENTS:
        return ColumnOutcome.failure(
            law, column, "timeout", f"not over within max_steps = {max_steps} pieces of segments"
        )
    if went.rows > LOG_ROWS:
        points, rows = fitting(points, went.rows, log.shape[1])
        log = np.empty((rows, log.shape[1]))
        follow(*problem, TOLERANCE, max_steps, points, log)
    log = log[: went.rows]
    diagnostics = {"duration": went.time * units.time}
    if p != 1:
        looser, again = follow(*problem, LOOSER * TOLERANCE, max_steps, 1, np.empty((0, log.shape[1])))
        moved = math.nan if again.code & TOO_MANY_EVENTS else float(np.abs(looser - velocities).max())
        diagnostics["velocity_error"] = moved * units.speed
    velocities = velocities * units.speed
    return ColumnOutcome(
        solver=law,
        velocities=tuple(velocities.tolist()),
        impulses=tuple(impulses_of(column, velocities).tolist()),
        states=states_of(column, log),
        status="limit" if code & RUNAWAY else "ok",
        reason="a contact became rigid: its bodies are one from there on" if code & RUNAWAY else "",
        grazing_margin=float(went.margin) if law == "bistiffness" else None,
        n_events=went.events,
        diagnostics=diagnostics,
        path=path_of(column, log, units) if path else None,
    )


def coefficients_of(column: Column, law: str, p: float) -> NDArray[np.float64]:
    """Give c or a of each contact of a column under a law of exponent p, in SI units; 0 where the law has none."""
    e, rates = np.array(column.restitutions), np.array(column.compression_rates)
    if LAWS[law] == BISTIFFNESS:
        return np.zeros(e.size)
    if LAWS[law] == HUNT_CROSSLEY:
        return hunt_crossley_coefficients(e) / rates.max()
    zeta = textbook_damping_ratios(e) if law == "kelvin-voigt-textbook" else damping_ratios(e)
    inverse = 1 / np.array([*column.masses, *([math.inf] if column.table else [])])
    mass = 1 / (inverse[1:] + inverse[:-1])
    return 2 * zeta * math.sqrt(0.5 * (p + 1)) * np.sqrt(column.stiffnesses) * np.sqrt(mass)
