"""`solve_column`: one column by the state transition model, with its states and path; `solve_columns`: many of them."""

from __future__ import annotations

from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_xval.model.chain.kernel import (
    COLLAPSE,
    PLASTIC,
    RUNAWAY,
    TOO_MANY_EVENTS,
    Followed,
    collide_all,
)
from impact_xval.model.chain.laws import LIU_ZHAO_BROGLIATO, STATE_TRANSITION
from impact_xval.model.chain.power_law import TOLERANCE
from impact_xval.model.collision import RESULT_STATUSES
from impact_xval.model.columns.column import Column, ColumnOutcome, ColumnPath
from impact_xval.model.inputs import EXPONENT, GRAZING_THRESHOLD, MASS_PRECISION
from impact_xval.model.pair.grazing import MARKS, mark_codes
from impact_xval.model.pair.law import INACTIVE, ImpactLaw
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
        ``jia-mason-erdmann``, the model's own, or ``liu-zhao-brogliato`` (`pair.law`).
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
    velocities, went = follow(*problem, max_events, points, log)
    outcome = _outcome(column, velocities, went, units, rules, grazing_threshold, max_events)
    if outcome.status not in RESULT_STATUSES:
        return outcome
    if went.rows > LOG_ROWS:
        points, rows = fitting(points, went.rows, log.shape[1])
        log = np.empty((rows, log.shape[1]))
        velocities, went = follow(*problem, max_events, points, log)
    log = log[: went.rows]
    trail = path_of(column, log, units) if path else None
    return replace(outcome, states=states_of(column, log), path=trail)


def fitting(points: int, rows: int, width: int) -> tuple[int, int]:
    """Points in each piece of a segment, fewer where a log of so many rows is too large, and the rows they make."""
    pieces = (rows - 1) // points
    points = max(1, min(points, LOG_NUMBERS // (pieces * width + 1)))
    return points, pieces * points + 1


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
    for column in columns:
        _check_touching(column)

    def solved(column: Column) -> ColumnOutcome:
        scaled, units = scaled_column(column, p)
        nothing, no_log = np.zeros(len(column.stiffnesses)), np.empty((0, 0))
        problem = scaled, p, _code(rules), nothing, True, nothing, TOLERANCE
        velocities, went = follow(*problem, max_events, 1, no_log)
        return _outcome(column, velocities, went, units, rules, grazing_threshold, max_events)

    with ThreadPoolExecutor() as threads:
        return list(threads.map(solved, columns))


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


def follow(
    scaled: tuple[Any, ...],
    p: float,
    law: int,
    dampings: NDArray[np.float64],
    frozen: bool,
    gaps: NDArray[np.float64],
    tolerance: float,
    max_pieces: int,
    points: int,
    log: NDArray[np.float64],
) -> tuple[NDArray[np.float64], Followed]:
    """Follow a column of `scaled_column`, as `chain.kernel` does: its velocities, and how it went."""
    masses, stiffnesses, restitutions, rates, drift = scaled
    velocities, numbers, sequence = np.empty((1, masses.size)), np.empty((1, 11)), np.zeros(1, np.uint64)
    contacts = [each[None] for each in (stiffnesses, restitutions, dampings, rates)]
    arguments: list[Any] = [
        law,
        p,
        frozen,
        masses[None],
        *contacts,
        np.array([drift]),
        gaps[None],
        np.zeros(1),
    ]
    arguments += [tolerance, max_pieces, points, log, velocities, numbers, sequence]
    collide_all(*arguments)
    return velocities[0], followed(numbers, sequence)


def followed(numbers: NDArray[np.float64], sequence: NDArray[np.uint64]) -> Followed:
    """How the only chain of arrays went."""
    whole = {"n", "code", "end", "events", "pieces", "rows", "n_states"}
    values = dict(zip(Followed._fields, numbers[0].tolist(), strict=False))
    return Followed(**{k: int(v) if k in whole else v for k, v in values.items()}, sequence=int(sequence[0]))


def _outcome(
    column: Column,
    velocities: NDArray[np.float64],
    went: Followed,
    units: Units,
    law: ImpactLaw,
    threshold: float,
    max_events: int,
) -> ColumnOutcome:
    """Outcome of a column that was followed, without states and path."""
    if reason := beyond_precision(column):
        return ColumnOutcome.failure(NAME, column, "unrepresentable", reason)
    if went.code & TOO_MANY_EVENTS:
        return ColumnOutcome.failure(
            NAME, column, "unconverged", f"not over within {max_events} pieces of segments"
        )
    velocities = velocities * units.speed
    margin = float(nearest_jump(went.margin, law))
    return ColumnOutcome(
        solver=NAME,
        velocities=tuple(velocities.tolist()),
        impulses=tuple(impulses_of(column, velocities).tolist()),
        status="limit" if went.code else "ok",
        reason="; ".join(text for bit, text in _REASONS.items() if went.code & bit),
        grazing_margin=margin,
        marked=MARKS[int(mark_codes(margin, 0.0, threshold))],
        n_events=went.events,
        diagnostics={"energy_residual": 1 - went.loss},
    )


def impulses_of(column: Column, velocities: NDArray[np.float64]) -> NDArray[np.float64]:
    """Impulses of the contacts that have given the balls these velocities: arrays of shape (..., N) to (..., C)."""
    changes = np.array(column.masses) * (velocities - np.array(column.velocities))
    return np.cumsum(changes, axis=-1)[..., : len(column.stiffnesses)]


def states_of(column: Column, log: NDArray[np.float64]) -> tuple[tuple[int, ...], ...]:
    """List the sets of acting contacts of a complete log, and the empty one of the end."""
    acting = log[:-1, 1 + 2 * len(column.masses) :] != INACTIVE
    sets = [tuple((np.flatnonzero(row) + 1).tolist()) for row in acting]
    return tuple(states for states, _ in groupby([*sets, ()]))


def path_of(column: Column, log: NDArray[np.float64], units: Units) -> ColumnPath:
    """Path of a complete log."""
    balls, masses = len(column.masses), np.array(column.masses)
    velocities = log[:, 1 : 1 + balls] * units.speed
    acting = log[:, 1 + 2 * balls :] != INACTIVE
    forces = np.cumsum(masses * log[:, 1 + balls : 1 + 2 * balls], axis=-1) * (units.speed / units.time)
    acting[-1] = False
    return ColumnPath(
        time=log[:, 0] * units.time,
        velocities=velocities,
        impulses=impulses_of(column, velocities),
        forces=forces[:, : acting.shape[1]],
        acting=acting,
    )
