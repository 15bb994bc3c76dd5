"""``impact-xval contact``: one contact, as an engine wants it, and what the engine makes of it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from impact_xval.experiments.commands.options import number, option
from impact_xval.experiments.config.errors import UserError

if TYPE_CHECKING:
    from impact_xval.compliant_baselines.engines.engine import Engine
    from impact_xval.compliant_baselines.single_contact import Drops, Pair
    from impact_xval.experiments.presentation.document import Block
    from impact_xval.model.materials import Touch


def contact(
    engine: str = option("NAME", "'mujoco', 'pybullet' or 'drake'.", default=...),
    masses: tuple[float, float] | None = option(
        "KG KG", "Of the two bodies, 1e-15 to 1e15; inf for a fixed one.", number
    ),
    restitution: float | None = option("E", "From 1e-4 to 1; by default that of the materials.", number),
    stiffness: float | None = option("N/M", "Of the contact.", number),
    duration: float | None = option("S", "Of the contact; instead of a stiffness.", number),
    material: list[str] | None = option(
        "NAME", "Instead of masses and stiffness: steel, glass, brass, rubber or ping-pong; twice for two."
    ),
    radius: list[float] | None = option(
        "M", "Of a ball of the material; twice for two balls, else the other is a flat.", number
    ),
    speed: float = option("M/S", "Speed of approach, 1e-9 to 1e9.", number, 1.0),
) -> None:
    """Print what to paste into a scene for a contact.

    And the largest step at which it means what it says. Beside what was asked stands what verifying drops gave.

    Example: impact-xval contact --engine mujoco --masses 1 inf --restitution 0.7 --duration 1e-3

    Or, a steel ball on a steel flat: impact-xval contact --engine mujoco --material steel --radius 0.02 --speed 1
    """
    from impact_xval.compliant_baselines import SolverError, get_solver
    from impact_xval.compliant_baselines.engines.engine import Engine
    from impact_xval.compliant_baselines.paste import ENGINES, paste
    from impact_xval.compliant_baselines.single_contact import drops, largest_step
    from impact_xval.experiments.presentation.terminal import at_work, error_line, make_console, show

    if engine not in ENGINES:
        raise UserError(f"--engine = {engine!r:.60}; legal: {', '.join(ENGINES)}")
    given = dict(masses=masses, restitution=restitution, stiffness=stiffness, duration=duration, speed=speed)
    try:
        touch = _touch(material, radius) if material or radius else None
        pair = _pair({name: value for name, value in given.items() if value is not None}, touch)
    except ValueError as error:
        raise UserError(f"--{error}") from None
    solver = get_solver(engine)
    assert isinstance(solver, Engine)
    error_line(f"trying steps in {engine} ...")
    try:
        with at_work(f"trying steps in {engine}"):
            found = largest_step(solver, pair)
            text = paste(engine, pair.contact, found.step)
            fine = drops(solver, pair, found.step / 10, [0.0])
    except SolverError as error:
        raise UserError(f"--engine {engine}: {error.status}: {error.reason}") from None
    show(make_console(), _blocks(solver, pair, touch, text, found, fine))


def _touch(materials: list[str] | None, radii: list[float] | None) -> Touch:
    """Make the contact of two materials; one name is that of both bodies, a radius left out is a flat's."""
    from impact_xval.model.materials import MATERIALS, Body, Touch

    materials, radii = materials or [], radii or []
    for name, given in (("material", materials), ("radius", radii)):
        if not 1 <= len(given) <= 2:
            legal = "once or twice, beside the other of the two"
            raise ValueError(f"{name}: given {len(given)} times; legal: {legal}")
    for name in materials:
        if name not in MATERIALS:
            raise ValueError(f"material = {name!r:.60}; legal: {', '.join(MATERIALS)}")
    upper = Body(MATERIALS[materials[0]], radii[0])
    return Touch(upper, Body(MATERIALS[materials[-1]], *radii[1:]))


def _pair(given: dict[str, Any], touch: Touch | None) -> Pair:
    """Make a pair of what is given; a contact of two materials is linearised at the speed."""
    from impact_xval.compliant_baselines.single_contact import Pair

    if touch is not None:
        for name in ("masses", "stiffness", "duration"):
            if name in given:
                raise ValueError(f"{name}: given beside --material, which decides it; legal: one of the two")
        given |= {"masses": (touch.one.mass, touch.two.mass), "stiffness": touch.linear(given["speed"])}
        if "restitution" not in given:  # else it need not be known of the materials
            given["restitution"] = touch.restitution
    for name in ("masses", "restitution"):
        if name not in given:
            raise ValueError(f"{name}: not given; legal: a value, or --material and --radius instead")
    return Pair(**given)


def _blocks(
    solver: Engine, pair: Pair, touch: Touch | None, text: str, found: Drops, fine: Drops
) -> list[Block]:
    """Lay out what was asked for, what to paste, and what verifying drops gave at a step and at a tenth of it."""
    from impact_xval.compliant_baselines.single_contact import TOLERANCE
    from impact_xval.experiments.presentation.document import Table

    c, name = pair.contact, solver.name
    rows = []
    for what, unit, asked in (("restitution", "", pair.restitution), ("duration", " s", c.duration)):
        low, high = getattr(found, what)
        at_tenth = f"{getattr(fine, what)[0]:.6g}{unit}"
        rows.append((what, f"{asked:.6g}{unit}", f"{low:.6g} to {high:.6g}{unit}", at_tenth))
    header = ("", "asked", f"at {found.step:.6g} s", f"at {found.step / 10:.6g} s")
    return [
        f"k = {c.k:.6g} N/m, c = {c.c:.6g} N s/m (zeta = {c.zeta:.4g}) between bodies of reduced mass {c.mass:.6g} kg",
        f"at {pair.speed:.6g} m/s the penetration is {pair.penetration:.3g} m: the bodies must be much larger",
        *([] if touch is None else [_linearised(touch, pair.speed)]),
        f"\n{text.rstrip()}",
        Table(header, rows, f"Drops in {name}, by its time step"),
        f"{found.step:.6g} s is the largest step tried (ten a decade) at which {name} {solver.version()} keeps both "
        f"within {TOLERANCE:g} of the request, wherever within a step the bodies touch ({found.n} drops), and at the "
        f"four shorter steps too: {c.duration / found.step:.0f} steps in a contact",
    ]


def _linearised(touch: Touch, speed: float) -> str:
    """Say in place of what force this contact is, and how it differs."""
    names = " on ".join(
        f"{body.material.name} "
        + ("flat" if math.isinf(body.radius) else f"ball of {body.radius:g} m radius")
        for body in (touch.one, touch.two)
    )
    p, duration = touch.exponent, touch.duration(speed)
    longer = math.pi * touch.compression(speed) / speed / duration - 1
    return (
        f"in place of {touch.stiffness:.4g} delta^{p:g} N, {names}, elastic: of the same greatest compression and "
        f"energy at this speed; it lasts {longer:.1%} longer than {duration:.4g} s, its peak force is "
        f"{2 / (p + 1) - 1:+.0%}"
    )
