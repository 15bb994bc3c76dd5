"""``impact-xval materials``: from materials, radii and a speed to stiffnesses."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Any

import typer

from impact_xval.experiments.commands.options import JsonObject, number
from impact_xval.experiments.config.errors import UserError

if TYPE_CHECKING:
    from impact_xval.compliant_baselines.contact.materials import Body, HertzContact, Linearised

#: Two bodies are a contact, three the basic collision: ball, ball and table.
_CONTACT, _COLLISION = 2, 3


def materials(
    bodies: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="MATERIAL:RADIUS ...",
            help="Two bodies, or ball, ball and table, such as steel:0.01 steel:0.02 glass:inf; m, inf for a flat one.",
        ),
    ] = None,
    speed: Annotated[str, typer.Option(metavar="M/S", help="Speed of the first body.")] = "1",
    restitution: Annotated[
        list[str] | None,
        typer.Option(
            metavar="E",
            help="From 0 to 1; once a contact, ball on ball first. Else what is known of the materials, or 1.",
        ),
    ] = None,
    json: JsonObject = False,
) -> None:
    """Print stiffnesses by Hertz's law, the linear springs that last as long, and what linearising changes.

    Without bodies: the materials that are known, and who says so.
    """
    from json import dumps

    from impact_xval.compliant_baselines.contact import materials as known
    from impact_xval.experiments.presentation.pages import render
    from impact_xval.experiments.presentation.terminal import make_console, show

    if not bodies:
        facts: dict[str, Any] = {"materials": known.MATERIALS.values(), "restitutions": known.RESTITUTIONS}
        if json:
            print(dumps(_known(**facts), indent=2, allow_nan=False))
        else:
            show(make_console(), render("materials_known.md.j2", **facts))
        return
    if len(bodies) not in (_CONTACT, _COLLISION):
        raise UserError(f"MATERIAL:RADIUS: {len(bodies)} bodies; legal: two, or ball, ball and table")
    found = [_body(text) for text in bodies]
    v = number("--speed", speed)
    try:
        contacts = [known.hertz_contact(a, b, v) for a, b in pairwise(found)]
    except ValueError as error:
        raise UserError(f"{' '.join(bodies)!r:.100}: {error}") from None
    e, sources = _restitutions(found, restitution or [])
    collision = None
    if len(found) == _COLLISION:
        try:
            collision = known.linearised(found[0], found[1], found[2], v, *e)
        except ValueError as error:
            raise UserError(f"{' '.join(bodies)!r:.100}: {error}") from None
    if json:
        print(dumps(_answer(found, contacts, e, sources, collision), indent=2, allow_nan=False))
    else:
        page = render(
            "materials.md.j2",
            bodies=found,
            contacts=contacts,
            e=e,
            sources=sources,
            collision=collision,
            speed=v,
        )
        show(make_console(), page)


def _body(text: str) -> Body:
    from impact_xval.compliant_baselines.contact.materials import MATERIALS, Body

    name, _, radius = text.partition(":")
    if name not in MATERIALS:
        raise UserError(f"MATERIAL = {name!r:.60}; legal: {', '.join(MATERIALS)}")
    usual = MATERIALS[name].radius
    if not radius and usual is None:
        raise UserError(f"RADIUS of {name!r}: none given; legal: such as {name}:0.01 (m), or {name}:inf")
    value = number(f"RADIUS of {name!r}", radius) if radius else usual
    assert value is not None
    try:
        return Body(MATERIALS[name], value)
    except ValueError as error:
        raise UserError(f"{text!r:.60}: {error}") from None


def _restitutions(bodies: list[Body], given: list[str]) -> tuple[list[float], list[str]]:
    """Give the restitution of each contact, and where it is from."""
    from impact_xval.compliant_baselines.contact.materials import measured_restitution

    count = len(bodies) - 1
    if given and len(given) != count:
        raise UserError(f"--restitution: given {len(given)} times; legal: {count}, once a contact")
    values, sources = [], []
    for i in range(count):
        measured = measured_restitution(bodies[i].material.name, bodies[i + 1].material.name)
        if given:
            values.append(number("--restitution", given[i]))
            if not 0 <= values[i] <= 1:
                raise UserError(f"--restitution = {given[i]!r:.60}; legal: from 0 to 1")
            sources.append("given")
        elif measured is not None:
            values.append(measured.middle)
            sources.append(f"{measured.low:.3g} to {measured.high:.3g}, {measured.source}")
        else:
            values.append(1.0)
            sources.append("not known: elastic")
    return values, sources


def _known(materials: Any, restitutions: Any) -> dict[str, Any]:
    from dataclasses import asdict

    return {
        "materials": [asdict(each) for each in materials],
        "restitutions": [asdict(each) for each in restitutions],
    }


def _answer(
    bodies: list[Body],
    contacts: list[HertzContact],
    e: list[float],
    sources: list[str],
    collision: Linearised | None,
) -> dict[str, Any]:
    def finite(value: float) -> float | str:
        return "inf" if math.isinf(value) else value  # JSON knows no infinity

    answer: dict[str, Any] = {
        "bodies": [
            {"material": each.material.name, "radius": finite(each.radius), "mass": finite(each.mass)}
            for each in bodies
        ],
        "contacts": [
            {
                "hertz_stiffness": each.stiffness,
                "reduced_mass": each.mass,
                "duration": each.duration,
                "penetration": each.penetration,
                "force": each.force,
                "linear_stiffness": each.linear_stiffness,
                "linear_penetration": each.linear_penetration,
                "linear_force": each.linear_force,
                "restitution": restitution,
                "restitution_source": source,
            }
            for each, restitution, source in zip(contacts, e, sources, strict=True)
        ],
    }
    if collision is not None:
        c = collision.collision
        answer["collision"] = {
            "stiffness_ratio": c.stiffness_ratio,
            "mass_ratio": c.mass_ratio,
            "hertz_velocities": collision.hertz.velocities,
            "linear_velocities": collision.linear.velocities,
            "divergence": collision.divergence,
        }
    return answer
