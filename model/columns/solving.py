"""`solve_column`: one column by the state transition model, with its states and path; `solve_columns`: many of them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from impact_xval.model.chain.kernel import COLLAPSE, PLASTIC, RUNAWAY, TOO_MANY_EVENTS, collide
from impact_xval.model.chain.laws import LIU_ZHAO_BROGLIATO, STATE_TRANSITION
from impact_xval.model.chain.power_law import TOLERANCE, new_workspace
from impact_xval.model.chain.state import Chain, ball_values
from impact_xval.model.collision import RESULT_STATUSES
from impact_xval.model.columns.column import Column, ColumnOutcome, ColumnPath
from impact_xval.model.compiled import OPTIONS, compiled
from impact_xval.model.diagram import MASS_PRECISION
from impact_xval.model.grazing import MARKS, mark_codes
from impact_xval.model.inputs import EXPONENT, GRAZING_THRESHOLD
from impact_xval.model.law import INACTIVE, ImpactLaw
from impact_xval.model.solving import NAME, check_law, nearest_jump

#: Pieces of segments after which a column is given up, some seconds for five balls.
MAX_EVENTS = 1_000_000

#: Points of the path in each piece of a segment, as long as its log has no more numbers than this: 64 MB.
POINTS = 12
LOG_NUMBERS = 2**23

#: Rows of the first try at a log; a column that needs more is run once more.
LOG_ROWS = 1024

_REASONS = {
    PLASTIC: "closed form of e = 0: the bodies of a contact that ended compression are one from there on",
    RUNAWAY: "the running stiffness of a contact runs away: its bodies are one from where it is rigid to rounding",
    COLLAPSE: "bodies come to rest together after infinitely many events",
}


def solve_column(
    column: Column,
    *,
    law: str = "jia-mason-erdmann",
    exponent: float = 1.0,
    path: bool = False,
    max_events: int = MAX_EVENTS,
    grazing_threshold: float = GRAZING_THRESHOLD,
) -> ColumnOutcome:
    """Solve one column by the state transition model for N balls.

    Parameters
    ----------
    column : Column
    law : str
        ``jia-mason-erdmann``, the model's own, or ``liu-zhao-brogliato`` (`model.law`).
    exponent : float
        p of the forces F = k delta^p, from 1 (linear, exact) to 3; 1.5 are Hertz contacts. Any other than 1 is
        integrated, with an error of some 1e-12 of the velocity of impact.
    path : bool
        Whether the outcome carries `path`.
    max_events : int
        Pieces of segments after which the column is given up, with the status ``unconverged``.
    grazing_threshold : float
        Grazing margin below which the outcome is marked.

    Returns
    -------
    ColumnOutcome
        Status ``limit`` where bodies were united or brought to rest by a closed form, ``unconverged`` after
        `max_events`, ``unrepresentable`` where masses or stiffnesses lie too far apart, else ``ok``. Its
        ``diagnostics``: ``energy_residual``, of the energy balance per kinetic energy relative to the centre of mass or
        the table.

    Raises
    ------
    ValueError
        For an unknown law or an illegal exponent.
    """
    rules, p = check_law(law, "law"), EXPONENT.number(exponent)
    _check_touching(column)
    balls, contacts = len(column.masses), len(column.stiffnesses)
    scaled, units = scaled_column(column, p)
    points = POINTS if path else 1
    nothing = np.zeros(contacts)
    problem = scaled, p, _code(rules), nothing, True, nothing, TOLERANCE
    log = np.empty((LOG_ROWS, 1 + 2 * balls + contacts))
    result = solve_scaled(*problem, max_events, points, log)
    outcome = _outcome(column, result, units, rules, grazing_threshold, max_events)
    if outcome.status not in RESULT_STATUSES:
        return outcome
    if result[-1] > LOG_ROWS:
        points, rows = fitting(points, result[-1], log.shape[1])
        log = np.empty((rows, log.shape[1]))
        result = solve_scaled(*problem, max_events, points, log)
    log = log[: result[-1]]
    trail = path_of(column, log, result[0], result[5], units) if path else None
    return replace(outcome, states=states_of(column, log), path=trail)


def fitting(points: int, rows: int, width: int) -> tuple[int, int]:
    """Points in each piece of a segment, fewer where a log of so many rows is too large, and the rows they make."""
    pieces = rows // points
    points = max(1, min(points, LOG_NUMBERS // (pieces * width)))
    return points, pieces * points


def solve_columns(
    columns: Iterable[Column],
    *,
    law: str = "jia-mason-erdmann",
    exponent: float = 1.0,
    max_events: int = MAX_EVENTS,
    grazing_threshold: float = GRAZING_THRESHOLD,
) -> list[ColumnOutcome]:
    """Solve many columns at once, on all processors; they may differ in the number of balls.

    Parameters
    ----------
    columns : iterable of Column
    law, exponent, max_events, grazing_threshold
        As for `solve_column`.

    Returns
    -------
    list of ColumnOutcome
        In the order of the columns, without their states.

    Raises
    ------
    ValueError
        As from `solve_column`.
    """
    rules, p = check_law(law, "law"), EXPONENT.number(exponent)
    columns = list(columns)
    if not columns:
        return []
    for column in columns:
        _check_touching(column)
    scaled, units = zip(*(scaled_column(column, p) for column in columns), strict=True)
    *flat, drifts = (list(values) for values in zip(*scaled, strict=True))
    of_balls = np.cumsum([0, *(len(column.masses) for column in columns)])
    of_contacts = np.cumsum([0, *(len(column.stiffnesses) for column in columns)])
    masses, stiffnesses, restitutions, rates = (np.concatenate(values) for values in flat)
    velocities, numbers = _solve_all(
        of_balls,
        of_contacts,
        masses,
        stiffnesses,
        restitutions,
        rates,
        np.array(drifts),
        p,
        _code(rules),
        max_events,
    )
    outcomes = []
    for i, (column, unit) in enumerate(zip(columns, units, strict=True)):
        code, events, margin, residual = numbers[i]
        result = (velocities[of_balls[i] : of_balls[i + 1]], int(code), int(events), margin, residual, 0.0, 0)
        outcomes.append(_outcome(column, result, unit, rules, grazing_threshold, max_events))
    return outcomes


def _code(rules: ImpactLaw) -> int:
    return STATE_TRANSITION if rules.stiffens else LIU_ZHAO_BROGLIATO


def _check_touching(column: Column) -> None:
    """Refuse a gap: positions are frozen."""
    if any(column.gaps):
        raise ValueError(
            f"gaps = {column.gaps!r}: the model has no positions; legal: 0 (the references know gaps)"
        )


def beyond_precision(column: Column) -> str:
    """Say that masses or stiffnesses lie further apart than `MASS_PRECISION`, in one sentence; empty if not."""
    for name in ("masses", "stiffnesses"):
        values = getattr(column, name)
        if min(values) < max(values) / MASS_PRECISION:
            apart = f"{name} from {min(values):g} to {max(values):g}"
            return (
                f"{apart}: where one exceeds {MASS_PRECISION:g} times another, squares of velocities are lost"
            )
    return ""


class Units(NamedTuple):
    """Units in which a column has the first mass and stiffness 1, and 1 as its largest compression rate."""

    mass: float
    speed: float
    time: float


def scaled_column(column: Column, p: float) -> tuple[tuple[Any, ...], Units]:
    """Masses, stiffnesses, restitutions, compression rates and mean velocity in the column's own units (Theorem 5)."""
    masses, stiffnesses = np.array(column.masses), np.array(column.stiffnesses)
    rates = np.array(column.compression_rates)
    mass, stiffness, speed = masses[0], stiffnesses[0], np.abs(rates).max()
    drift = 0.0 if column.table else column.mean_velocity / speed
    with np.errstate(over="ignore"):  # what overflows has no result, and its outcome says so
        time = float((mass / stiffness * speed ** (1 - p)) ** (1 / (p + 1)))
        scaled = (masses / mass, stiffnesses / stiffness, np.array(column.restitutions), rates / speed, drift)
    return scaled, Units(float(mass), float(speed), time)


@compiled
def chain_of(scaled, p, law, b, frozen):
    """Chain of a column of `scaled_column`, and its kinetic energy relative to the centre of mass or the table."""
    masses, stiffnesses, restitutions, rates, drift = scaled
    balls, contacts = masses.size, stiffnesses.size
    inverse = np.zeros(contacts + 1)
    inverse[:balls] = 1 / masses
    chain = Chain(
        inverse,
        stiffnesses.copy(),
        stiffnesses.copy(),
        restitutions.copy(),
        b.copy(),
        rates.copy(),
        np.zeros(contacts),
        np.zeros(contacts, np.int64),
        np.arange(contacts),
        np.empty(contacts),
        np.zeros(contacts),
        np.arange(balls),
        p,
        law,
        frozen,
    )
    velocities = np.empty(balls)
    ball_values(chain, contacts, rates, drift, velocities)
    energy = 0.5 * (masses * (velocities - drift) ** 2).sum()
    chain.length[:] = (energy * (p + 1) / stiffnesses) ** (1 / (p + 1))
    return chain, energy


@compiled
def solve_scaled(scaled, p, law, b, frozen, gaps, tolerance, max_events, points, log):
    """Solve a column of `scaled_column`: velocities, code, events, margin, residual, time, rows of the log."""
    masses, drift = scaled[0], scaled[-1]
    chain, energy = chain_of(scaled, p, law, b, frozen)
    velocities = np.empty(masses.size)
    n, code, events, margin, loss, time, rows = collide(
        chain, new_workspace(gaps.size), energy, drift, gaps, tolerance, max_events, points, log
    )
    ball_values(chain, n, chain.w, drift, velocities)
    residual = 1 - (loss + 0.5 * (masses * (velocities - drift) ** 2).sum()) / energy
    return velocities, code, events, margin, residual, time, rows


@njit(parallel=True, **OPTIONS)
def _solve_all(of_balls, of_contacts, masses, stiffnesses, restitutions, rates, drifts, p, law, max_events):
    velocities, numbers = np.empty(masses.size), np.empty((drifts.size, 4))
    no_log = np.empty((0, 0))
    for i in prange(drifts.size):
        balls, contacts = slice(of_balls[i], of_balls[i + 1]), slice(of_contacts[i], of_contacts[i + 1])
        scaled = (masses[balls], stiffnesses[contacts], restitutions[contacts], rates[contacts], drifts[i])
        nothing = np.zeros(scaled[1].size)
        v, code, events, margin, residual, _, _ = solve_scaled(
            scaled, p, law, nothing, True, nothing, TOLERANCE, max_events, 1, no_log
        )
        velocities[balls] = v
        numbers[i, 0], numbers[i, 1], numbers[i, 2], numbers[i, 3] = code, events, margin, residual
    return velocities, numbers


def _outcome(
    column: Column, result: tuple[Any, ...], units: Units, law: ImpactLaw, threshold: float, max_events: int
) -> ColumnOutcome:
    """Outcome of a kernel's result, without states and path."""
    velocities, code, events, margin, residual, _, _ = result
    if reason := beyond_precision(column):
        return ColumnOutcome.failure(NAME, column, "unrepresentable", reason)
    if code & TOO_MANY_EVENTS:
        return ColumnOutcome.failure(
            NAME, column, "unconverged", f"not over within {max_events} pieces of segments"
        )
    velocities = velocities * units.speed
    margin = float(nearest_jump(margin, law))
    return ColumnOutcome(
        solver=NAME,
        velocities=tuple(velocities.tolist()),
        impulses=tuple(impulses_of(column, velocities).tolist()),
        status="limit" if code else "ok",
        reason="; ".join(text for bit, text in _REASONS.items() if code & bit),
        grazing_margin=margin,
        marked=MARKS[int(mark_codes(margin, 0.0, threshold))],
        n_events=events,
        diagnostics={"energy_residual": float(residual)},
    )


def impulses_of(column: Column, velocities: NDArray[np.float64]) -> NDArray[np.float64]:
    """Impulses of the contacts that have given the balls these velocities: arrays of shape (..., N) to (..., C)."""
    changes = np.array(column.masses) * (velocities - np.array(column.velocities))
    return np.cumsum(changes, axis=-1)[..., : len(column.stiffnesses)]


def states_of(column: Column, log: NDArray[np.float64]) -> tuple[tuple[int, ...], ...]:
    """List the sets of acting contacts of a complete log, the last one empty."""
    acting = log[:, 1 + 2 * len(column.masses) :] != INACTIVE
    sets = [tuple((np.flatnonzero(row) + 1).tolist()) for row in acting]
    return (*(states for states, _ in groupby(sets)), ())


def path_of(
    column: Column, log: NDArray[np.float64], velocities: NDArray[np.float64], time: float, units: Units
) -> ColumnPath:
    """Path of a complete log, and the end with its scaled velocities and time."""
    balls, masses = len(column.masses), np.array(column.masses)
    velocities = np.vstack([log[:, 1 : 1 + balls], velocities]) * units.speed
    forces = np.cumsum(masses * log[:, 1 + balls : 1 + 2 * balls], axis=-1) * (units.speed / units.time)
    acting = log[:, 1 + 2 * balls :] != INACTIVE
    contacts = acting.shape[1]
    return ColumnPath(
        time=np.append(log[:, 0], time) * units.time,
        velocities=velocities,
        impulses=impulses_of(column, velocities),
        forces=np.vstack([forces[:, :contacts], np.zeros(contacts)]),
        acting=np.vstack([acting, np.zeros(contacts, bool)]),
    )
