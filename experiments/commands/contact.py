"""``impact-xval contact``: one contact, as an engine wants it, and what the engine makes of it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Any

import typer

from impact_xval.experiments.commands.options import Json, number
from impact_xval.experiments.config.errors import UserError

if TYPE_CHECKING:
    from impact_xval.compliant_baselines.engines.engine import Engine
    from impact_xval.compliant_baselines.single_contact import Drops, Pair
    from impact_xval.experiments.presentation.document import Table
    from impact_xval.model.materials import Touch


def contact(
    engine: Annotated[str, typer.Option(metavar="NAME", help="'mujoco', 'pybullet' or 'drake'.")],
    masses: Annotated[
        tuple[str, str] | None,
        typer.Option(metavar="KG KG", help="Of the two bodies, 1e-15 to 1e15; inf for a fixed one."),
    ] = None,
    restitution: Annotated[
        str | None, typer.Option(metavar="E", help="From 1e-4 to 1; by default that of the materials.")
    ] = None,
    stiffness: Annotated[str | None, typer.Option(metavar="N/M", help="Of the contact.")] = None,
    duration: Annotated[
        str | None, typer.Option(metavar="S", help="Of the contact; instead of a stiffness.")
    ] = None,
    material: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Instead of masses and stiffness: steel, glass, brass, rubber or ping-pong; twice for two.",
        ),
    ] = None,
    radius: Annotated[
        list[str] | None,
        typer.Option(
            metavar="M", help="Of a ball of the material; twice for two balls, else the other is a flat."
        ),
    ] = None,
    speed: Annotated[str, typer.Option(metavar="M/S", help="Speed of approach, 1e-9 to 1e9.")] = "1",
    tolerance: Annotated[
        str, typer.Option(metavar="X", help="Allowed relative error of restitution and duration.")
    ] = "0.01",
    json: Json = False,
) -> None:
    """Print what to paste into a scene for a contact.

    And the largest step at which it means what it says. Beside what was asked stands what verifying drops gave.

    Example: impact-xval contact --engine mujoco --masses 1 inf --restitution 0.7 --duration 1e-3

    Or, a steel ball on a steel flat: impact-xval contact --engine mujoco --material steel --radius 0.02 --speed 1
    """
    from json import dumps

    from impact_xval.compliant_baselines import SolverError, get_solver
    from impact_xval.compliant_baselines.engines.engine import Engine
    from impact_xval.compliant_baselines.paste import ENGINES, paste
    from impact_xval.compliant_baselines.single_contact import drops, largest_step
    from impact_xval.experiments.presentation.terminal import at_work, error_line

    if engine not in ENGINES:
        raise UserError(f"--engine = {engine!r:.60}; legal: {', '.join(ENGINES)}")
    allowed = number("--tolerance", tolerance)
    if not 0 < allowed <= 0.5:
        raise UserError(f"--tolerance = {tolerance!r:.60}; legal: greater than 0, at most 0.5")
    given = {"restitution": restitution, "stiffness": stiffness, "duration": duration, "speed": speed}
    touch = _touch(material or [], radius or [])
    pair = _pair(masses, given) if touch is None else _pair_of(touch, masses, given)
    solver = get_solver(engine)
    assert isinstance(solver, Engine)
    if not json:
        error_line(f"trying steps in {engine} ...")
    try:
        with at_work(f"trying steps in {engine}"):
            found = largest_step(solver, pair, allowed)
            parameters, text = paste(engine, pair.contact, found.step)
            fine = drops(solver, pair, found.step / 10, [0.0])
    except SolverError as error:
        raise UserError(f"--engine {engine}: {error.status}: {error.reason}") from None
    if json:
        pasted = {"parameters": parameters, "paste": text, "tolerance": allowed}
        verified = _verified(found, fine)
        made_of = {} if touch is None else {"hertz": _hertz(touch, pair.speed)}
        print(dumps(_request(solver, pair) | made_of | pasted | verified, indent=2, allow_nan=False))
    else:
        _show(solver, pair, touch, allowed, text, found, fine)


def _touch(materials: list[str], radii: list[str]) -> Touch | None:
    """Read the bodies asked for by material, if any; one name is that of both, a radius left out is a flat's."""
    from impact_xval.model.materials import MATERIALS, Body, Touch

    if not materials and not radii:
        return None
    for option, given in (("--material", materials), ("--radius", radii)):
        if not 1 <= len(given) <= 2:
            raise UserError(
                f"{option}: given {len(given)} times; legal: once or twice, beside the other of the two"
            )
    for name in materials:
        if name not in MATERIALS:
            raise UserError(f"--material = {name!r:.60}; legal: {', '.join(MATERIALS)}")
    lengths = [number("--radius", text) for text in radii]
    try:
        upper = Body(MATERIALS[materials[0]], lengths[0])
        return Touch(upper, Body(MATERIALS[materials[-1]], *lengths[1:]))
    except ValueError as error:
        raise UserError(f"--{error}") from None


def _pair_of(touch: Touch, masses: tuple[str, str] | None, given: dict[str, str | None]) -> Pair:
    """Make a contact of two materials, linearised at the speed; nothing but the restitution may be given as well."""
    for name, text in {"masses": masses, **given}.items():
        if name in ("masses", "stiffness", "duration") and text is not None:
            raise UserError(f"--{name}: given beside --material, which decides it; legal: one of the two")
    numbers = {name: number(f"--{name}", text) for name, text in given.items() if text is not None}
    try:
        own = {"masses": (touch.one.mass, touch.two.mass), "stiffness": touch.linear(numbers["speed"])}
        if "restitution" not in numbers:
            own["restitution"] = touch.restitution
    except ValueError as error:
        raise UserError(f"--{error}") from None
    return _checked(numbers | own)


def _hertz(touch: Touch, speed: float) -> dict[str, float]:
    """Tell which contact is linearised, and what that changes."""
    compression, duration = touch.compression(speed), touch.duration(speed)
    return {
        "exponent": touch.exponent,
        "stiffness": touch.stiffness,
        "compression": compression,
        "duration": duration,
        "linear_over_hertz_duration": math.pi * compression / speed / duration,
        "linear_over_hertz_force": 2 / (touch.exponent + 1),
    }


def _pair(masses: tuple[str, str] | None, given: dict[str, str | None]) -> Pair:
    for name, asked in (("masses", masses), ("restitution", given["restitution"])):
        if asked is None:
            raise UserError(f"--{name}: not given; legal: a value, or --material and --radius instead")
    numbers: dict[str, Any] = {"masses": tuple(number("--masses", text) for text in masses or ())}
    numbers |= {name: number(f"--{name}", text) for name, text in given.items() if text is not None}
    return _checked(numbers)


def _checked(numbers: dict[str, Any]) -> Pair:
    from impact_xval.compliant_baselines.single_contact import Pair

    try:
        return Pair(**numbers)
    except ValueError as error:
        raise UserError(f"--{error}") from None


def _request(solver: Engine, pair: Pair) -> dict[str, Any]:
    c = pair.contact
    return {
        "engine": solver.name,
        "version": solver.version(),
        "request": {
            # JSON knows no infinity.
            "masses": ["inf" if math.isinf(m) else m for m in pair.masses],
            **{name: getattr(pair, name) for name in ("restitution", "stiffness", "duration", "speed")},
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
    }


def _verified(found: Drops, fine: Drops) -> dict[str, Any]:
    range_ = {"restitution": list(found.restitution), "duration": list(found.duration), "drops": found.n}
    at_a_tenth = {"restitution": fine.restitution[0], "duration": fine.duration[0]}
    return {"largest_step": found.step, "verified": range_, "verified_at_a_tenth": at_a_tenth}


def _show(
    solver: Engine, pair: Pair, touch: Touch | None, tolerance: float, text: str, found: Drops, fine: Drops
) -> None:
    from impact_xval.experiments.presentation.terminal import make_console, show

    c, name = pair.contact, solver.name
    zeta = c.c / (2 * c.mass * c.omega)
    blocks = [
        f"k = {c.k:.6g} N/m, c = {c.c:.6g} N s/m (zeta = {zeta:.4g}) between bodies of reduced mass {c.mass:.6g} kg",
        f"at {pair.speed:.6g} m/s the penetration is {pair.penetration:.3g} m: the bodies must be much larger",
        *([] if touch is None else [_linearised(touch, pair.speed)]),
        f"\n{text.rstrip()}",
        _drops(name, pair, found, fine),
        f"{found.step:.6g} s is the largest step tried (ten a decade) at which {name} {solver.version()} keeps both "
        f"within {tolerance:.3g} of the request, wherever within a step the bodies touch ({found.n} drops), and at the "
        f"four shorter steps too: {c.duration / found.step:.0f} steps in a contact",
    ]
    show(make_console(), blocks)


def _linearised(touch: Touch, speed: float) -> str:
    """Say in place of what force this contact is, and how it differs."""
    names = " on ".join(
        f"{body.material.name} "
        + ("flat" if math.isinf(body.radius) else f"ball of {body.radius:g} m radius")
        for body in (touch.one, touch.two)
    )
    hertz = _hertz(touch, speed)
    return (
        f"in place of {hertz['stiffness']:.4g} delta^{touch.exponent:g} N, {names}, elastic: of the same greatest "
        f"compression and energy at this speed; it lasts {hertz['linear_over_hertz_duration'] - 1:.1%} longer than "
        f"{hertz['duration']:.4g} s, its peak force is {hertz['linear_over_hertz_force'] - 1:+.0%}"
    )


def _drops(name: str, pair: Pair, found: Drops, fine: Drops) -> Table:
    """Table of what was asked for and what verifying drops gave."""
    from impact_xval.experiments.presentation.document import Table

    rows = []
    for what, unit, asked in (
        ("restitution", "", pair.restitution),
        ("duration", " s", pair.contact.duration),
    ):
        low, high = getattr(found, what)
        rest = f"{getattr(fine, what)[0]:.6g}{unit}"
        rows.append((what, f"{asked:.6g}{unit}", f"{low:.6g} to {high:.6g}{unit}", rest))
    header = ("", "asked", f"at {found.step:.6g} s", f"at {found.step / 10:.6g} s")
    return Table(header, rows, f"Drops in {name}, by its time step")
