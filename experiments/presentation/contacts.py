"""Contacts in words and tables: one contact for an engine, and the contacts of a MuJoCo scene."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from impact_xval.compliant_baselines.engines.engine import Engine
from impact_xval.compliant_baselines.paste import paste
from impact_xval.compliant_baselines.single_contact import DROP, TOLERANCE, Drops, Pair
from impact_xval.experiments.presentation.document import Block, Table
from impact_xval.experiments.tables.numbers import number
from impact_xval.model.materials import MaterialContact

if TYPE_CHECKING:  # it imports MuJoCo
    from impact_xval.compliant_baselines.inspect_mujoco import Finding, MeasuredContact


def contact_blocks(
    engine: Engine, pair: Pair, touch: MaterialContact | None, largest: Drops, fine: Drops
) -> list[Block]:
    """Lay out a contact, the lines to paste, and the results of drops at a step and at a tenth of it.

    `touch` is what the pair was made of, if of materials. A SolverError says why the engine does not take it.
    """
    c, name, rows = pair.contact, engine.name, []
    for quantity, unit, request in (("restitution", "", pair.restitution), ("duration", " s", c.duration)):
        at_tenth = f"{getattr(fine, quantity)[0]:.6g}{unit}"
        rows.append(
            (
                quantity,
                f"{request:.6g}{unit}",
                f"{round_outward(*getattr(largest, quantity))}{unit}",
                at_tenth,
            )
        )
    where = "by the lines above alone" if name in DROP else "by the adapter's scene"
    header = ("", "asked", f"at {largest.step:.6g} s", f"at {largest.step / 10:.6g} s")
    return [
        f"k = {c.k:.6g} N/m, c = {c.c:.6g} N s/m (zeta = {c.zeta:.4g}) between bodies of reduced mass {c.mass:.6g} kg",
        f"at {pair.speed:.6g} m/s the penetration is {pair.penetration:.3g} m: the bodies must be much larger",
        *([] if touch is None else [_describe_linearised(touch, pair.speed)]),
        f"\n{paste(name, c, largest.step).rstrip()}",
        Table(header, rows, f"Drops in {name} {where}"),
        f"{largest.step:.6g} s is the largest step tried (ten a decade) at which {name} {engine.version()} keeps both "
        f"within {TOLERANCE:g} of the request, wherever within a step the bodies touch ({largest.n} drops), and at the "
        f"four shorter steps too: {c.duration / largest.step:.0f} steps in a contact",
    ]


def round_outward(low: float, high: float) -> str:
    """Write an interval that contains both numbers, wider by at most 2e-4 of its width and 2e-12 of the numbers.

    Rounded to the nearest digit an interval would leave out what was measured.
    """
    resolution = max(1e-4 * (high - low), 1e-12 * max(abs(low), abs(high)))
    exponent = math.floor(math.log10(resolution)) if resolution > 0 else 0
    unit = 10.0**exponent
    # What is a multiple of the unit stays one: a thousandth of it may be the rounding of the quotient.
    ends = math.floor(low / unit + 1e-3), math.ceil(high / unit - 1e-3)
    return " to ".join(f"{float(f'{end}e{exponent}'):.15g}" for end in ends)


def _describe_linearised(touch: MaterialContact, speed: float) -> str:
    """Say which force of materials a linear contact stands for, and how the two differ."""
    names = " on ".join(
        f"{body.material.name} "
        + ("flat" if math.isinf(body.radius) else f"ball of {body.radius:g} m radius")
        for body in (touch.upper, touch.lower)
    )
    p, duration = touch.exponent, touch.duration(speed)
    longer = math.pi * touch.compression(speed) / speed / duration - 1
    return (
        f"in place of {touch.stiffness:.4g} delta^{p:g} N, {names}, elastic: of the same greatest compression and "
        f"energy at this speed; it lasts {longer:.1%} longer than {duration:.4g} s, its peak force is "
        f"{2 / (p + 1) - 1:+.0%}"
    )


def scene_blocks(
    contacts: list[MeasuredContact], traps: list[Finding], scene: str, speed: float, version: str
) -> list[Block]:
    """Lay out the contacts that MuJoCo makes of a scene dropped at a speed, advice on them, and the traps."""
    from impact_xval.compliant_baselines.inspect_mujoco import MOST_ROWS, abbreviate_names

    header = ("contact", "masses, kg", "e", "k, N/m", "c, N s/m", "duration, s", "steps", "at rest, m")
    rows, lines = [], []
    for contact in contacts:
        where, masses = abbreviate_names(contact.names), " ".join(f"{mass:.4g}" for mass in contact.masses)
        low, high = (number(e) for e in contact.restitution_range or (None, None))
        values = (contact.stiffness, contact.damping, contact.duration, contact.steps, contact.penetration)
        rows.append((where, masses, low if low == high else f"{low} to {high}", *map(number, values)))
        lines += [f"{where}: {remark}" for remark in (contact.reason, contact.note, contact.change) if remark]
    caption = (
        f"Dropped at {speed:g} m/s by MuJoCo {version}, and loaded with the weight of the lighter body, each two "
        "bodies alone"
    )
    if len(rows) == MOST_ROWS:
        caption += f"; the first {MOST_ROWS} combinations of parameters and masses"
    measured = [Table(header, rows, caption, text=2), *lines, ""] if rows else ["no two geoms can touch"]
    findings = [f"{trap}: {abbreviate_names(where)}: {says}" for trap, where, says in traps]
    return [*measured, *findings, f"{scene}: {len(traps) or 'no'} trap{'s' if len(traps) != 1 else ''} found"]
