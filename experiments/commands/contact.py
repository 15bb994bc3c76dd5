"""What ``impact-xval contact`` does: one contact, as an engine wants it, and what the engine makes of it."""

from __future__ import annotations

import json
import math
from typing import Any

from impact_xval.compliant_baselines import SolverError, get_solver
from impact_xval.compliant_baselines.calibration.pair import (
    Drops,
    Pair,
    drops,
    durations_taken,
    largest_step,
)
from impact_xval.compliant_baselines.calibration.scene_text import ENGINES, paste
from impact_xval.compliant_baselines.engines.engine import EngineSolver
from impact_xval.experiments.commands.options import number
from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.presentation.terminal import (
    error_line,
    make_console,
    print_line,
    print_table,
)
from impact_xval.experiments.tables.document import Table

#: What is tried; beyond, the positions or velocities of a drop drown in rounding, or its end is never reached.
LEAST_MASS, LARGEST_MASS, LARGEST_RATIO = 1e-15, 1e15, 1e12
LEAST_RESTITUTION = 1e-4
SLOWEST, FASTEST = 1e-9, 1e9
LONGEST = 1e6


def contact(engine: str, values: dict[str, Any], *, tolerance: str, gravity: str, as_json: bool) -> None:
    """Print what to paste for a contact, the largest step, and what the engine gave.

    Parameters
    ----------
    engine : str
        One of `ENGINES`.
    values : dict
        Of `Pair`, as text.
    tolerance, gravity : str
        Allowed relative error; m/s^2.
    as_json : bool
        Whether to print a JSON object.

    Raises
    ------
    UserError
        If the request is illegal, impossible, or the engine cannot do it.
    """
    if engine not in ENGINES:
        raise UserError(f"--engine = {engine!r:.60}; legal: {', '.join(ENGINES)}")
    allowed, g = number("--tolerance", tolerance), number("--gravity", gravity)
    if not 0 <= g < math.inf:
        raise UserError(f"--gravity = {gravity!r:.60}; legal: a finite number >= 0 (m/s^2)")
    if not 0 < allowed <= 0.5:
        raise UserError(f"--tolerance = {tolerance!r:.60}; legal: greater than 0, at most 0.5")
    pair = _pair(values)
    if g and not pair.fixed:
        raise UserError(f"--gravity = {gravity!r:.60}; legal: 0 for two free bodies, which fall alike")
    solver = get_solver(engine)
    assert isinstance(solver, EngineSolver)
    if not as_json:
        error_line(f"trying steps in {engine} ...")
    try:
        found = largest_step(solver, pair, allowed)
        parameters, text = paste(engine, pair.contact, found.step)
        fine = drops(solver, pair, found.step / 10, [0.0])
    except SolverError as error:
        raise UserError(_why(solver, pair, error)) from None
    heavy = _under_gravity(solver, pair, found.step, g) if g else None
    if as_json:
        print(
            json.dumps(
                _object(solver, pair, allowed, parameters, text, found, fine, heavy, g),
                indent=2,
                allow_nan=False,
            )
        )
        return
    _show(solver, pair, allowed, text, found, fine, heavy, g)


def _pair(values: dict[str, Any]) -> Pair:
    numbers: dict[str, Any] = {"masses": tuple(number("--masses", text) for text in values["masses"])}
    for name in ("restitution", "stiffness", "duration", "speed"):
        if values[name] is not None:
            numbers[name] = number(f"--{name}", values[name])
    try:
        pair = Pair(**numbers)
    except ValueError as error:
        raise UserError(f"--{error}") from None
    problem = _beyond(pair)
    if problem:
        raise UserError(problem)
    return pair


def _beyond(pair: Pair) -> str | None:
    """Say that a pair is a contact, and none that can be tried, or return None."""
    light, heavy = sorted(pair.masses)
    if not LEAST_MASS <= light <= LARGEST_MASS or LARGEST_MASS < heavy < math.inf:
        return (
            f"--masses = {' '.join(map(repr, pair.masses))}; legal: from {LEAST_MASS:g} to {LARGEST_MASS:g} (kg), one "
            "of them inf for a fixed body"
        )
    if LARGEST_RATIO < heavy / light < math.inf:
        return (
            f"--masses = {' '.join(map(repr, pair.masses))}: one is {heavy / light:.3g} times the other; legal: at "
            f"most {LARGEST_RATIO:g} times, or inf for a fixed body"
        )
    if pair.restitution < LEAST_RESTITUTION:
        return f"--restitution = {pair.restitution!r}; legal: from {LEAST_RESTITUTION:g} to 1"
    if not SLOWEST <= pair.speed <= FASTEST:
        return f"--speed = {pair.speed!r}; legal: from {SLOWEST:g} to {FASTEST:g} (m/s)"
    if pair.contact.duration > LONGEST:
        name = "duration" if pair.stiffness is None else "stiffness"
        return (
            f"--{name} = {getattr(pair, name)!r}: a contact of {pair.contact.duration:.3g} s; legal: at most "
            f"{LONGEST:g} s"
        )
    return None


def _why(solver: EngineSolver, pair: Pair, error: SolverError) -> str:
    """Say why an engine does not do a pair; a duration out of its range with the range."""
    said = f"--engine {solver.name}: {error.status}: {error.reason}"
    if error.status != "unrepresentable":
        return said
    taken = durations_taken(solver, pair)
    asked = "--duration" if pair.duration is not None else "--stiffness"
    value = pair.duration if pair.duration is not None else pair.stiffness
    if taken is None:
        return f"{asked} = {value!r}: {said}"
    short = pair.contact.duration < taken[0]
    limit = f"at least {taken[0]:.3g}" if short else f"at most {taken[1]:.3g}"
    return (
        f"{asked} = {value!r}: a contact of {pair.contact.duration:.3g} s: {said}; legal for these masses, "
        f"restitution and speed: a duration of {limit} s"
    )


def _under_gravity(solver: EngineSolver, pair: Pair, step: float, g: float) -> Drops | str:
    try:
        return drops(solver, pair, step, [0.0], g)
    except SolverError as error:
        return f"{error.status}: {error.reason}; the body may never leave: its weight sets it at rest"


def _object(
    solver: EngineSolver,
    pair: Pair,
    tolerance: float,
    parameters: Any,
    text: str,
    found: Drops,
    fine: Drops,
    heavy: Drops | str | None,
    g: float,
) -> dict[str, Any]:
    c = pair.contact
    got = {"restitution": list(found.restitution), "duration": list(found.duration), "drops": found.n}
    result: dict[str, Any] = {
        "engine": solver.name,
        "version": solver.version(),
        "request": {
            # JSON knows no infinity.
            "masses": ["inf" if math.isinf(m) else m for m in pair.masses],
            "restitution": pair.restitution,
            "stiffness": pair.stiffness,
            "duration": pair.duration,
            "speed": pair.speed,
        },
        "contact": {
            "reduced_mass": c.mass,
            "stiffness": c.k,
            "damping": c.c,
            "damping_ratio": c.c / (2 * c.mass * c.omega),
            "restitution": pair.restitution,
            "duration": c.duration,
            "penetration": pair.penetration,
        },
        "parameters": parameters,
        "paste": text,
        "tolerance": tolerance,
        "largest_step": found.step,
        "verified": got,
        "verified_at_a_tenth": {"restitution": fine.restitution[0], "duration": fine.duration[0]},
    }
    if isinstance(heavy, Drops):
        result["under_gravity"] = {
            "gravity": g,
            "restitution": heavy.restitution[0],
            "duration": heavy.duration[0],
        }
    elif heavy is not None:
        result["under_gravity"] = {"gravity": g, "reason": heavy}
    return result


def _show(
    solver: EngineSolver,
    pair: Pair,
    tolerance: float,
    text: str,
    found: Drops,
    fine: Drops,
    heavy: Drops | str | None,
    g: float,
) -> None:
    console, c = make_console(), pair.contact
    print_line(
        console,
        f"k = {c.k:.6g} N/m, c = {c.c:.6g} N s/m (zeta = {c.c / (2 * c.mass * c.omega):.4g}) between bodies of "
        f"reduced mass {c.mass:.6g} kg",
    )
    print_line(
        console,
        f"at {pair.speed:g} m/s they go {pair.penetration:.3g} m into each other: bodies much larger than that",
    )
    print_line(console, "")
    print_line(console, text.rstrip("\n"))
    beside = (f"at {found.step:g} s", f"at {found.step / 10:g} s", *(["with gravity"] if g else []))
    rows = []
    heavier = heavy if isinstance(heavy, Drops) else None
    for name, unit, asked in (("restitution", "", pair.restitution), ("duration", " s", c.duration)):
        low, high = getattr(found, name)
        row = [
            name,
            f"{asked:.6g}{unit}",
            f"{low:.6g} to {high:.6g}{unit}",
            f"{getattr(fine, name)[0]:.6g}{unit}",
        ]
        if g:
            row.append(f"{getattr(heavier, name)[0]:.6g}{unit}" if heavier else "-")
        rows.append(row)
    print_table(console, Table(f"Drops in {solver.name}, by its time step", ("", "asked", *beside), rows))
    print_line(console, "")
    print_line(
        console,
        f"{found.step:g} s is the largest step (two digits) at which {solver.name} {solver.version()} keeps both "
        f"within {tolerance:.3g} of what was asked, wherever within a step the bodies touch ({found.n} drops), and "
        f"at the shorter steps tried too: {c.duration / found.step:.0f} steps in a contact",
    )
    if isinstance(heavy, str):
        print_line(console, f"with gravity: {heavy}")
    elif heavy is not None:
        print_line(
            console,
            f"with gravity {g:g} m/s^2, which no contact's parameters know of: g/(v omega) = "
            f"{g / (pair.speed * c.omega):.2g}",
        )
