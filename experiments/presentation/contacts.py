"""Contacts in words and tables: one contact for an engine, and the contacts of a MuJoCo scene."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from impact_xval.compliant_baselines.asked_contact import GRAVITY
from impact_xval.compliant_baselines.engines.engine import Engine
from impact_xval.compliant_baselines.mapping import MujocoContact
from impact_xval.compliant_baselines.paste import paste
from impact_xval.compliant_baselines.registry import title_of
from impact_xval.compliant_baselines.single_contact import DROP, TOLERANCE, Pair, VerifiedContact
from impact_xval.compliant_baselines.solref import is_linear
from impact_xval.compliant_baselines.three_bodies import MODEL, Strike, paste_both
from impact_xval.experiments.presentation.document import Block, Table
from impact_xval.experiments.tables.numbers import number
from impact_xval.model.kinetic import kinetic_norm
from impact_xval.model.materials import MaterialContact

if TYPE_CHECKING:  # it imports MuJoCo
    from impact_xval.compliant_baselines.inspect_mujoco import Finding, MeasuredContact


#: Names of the bodies from the top down, as the text to paste calls them.
_BODIES = "ABC"


def contact_blocks(
    engine: Engine,
    verified: Sequence[VerifiedContact],
    touch: MaterialContact | None = None,
    tolerance: float = TOLERANCE,
    given_step: float | None = None,
) -> list[Block]:
    """Lay out one contact, or two of three bodies: numbers, lines to paste, and the results of drops.

    Parameters
    ----------
    engine
        The engine.
    verified
        The contacts, all of them dropped at one step.
    touch
        What the pair was made of, if of materials.
    tolerance
        Allowed relative error of restitution and duration.
    given_step
        The time step in s, if it was given and the stiffness was looked for.

    Raises
    ------
    SolverError
        If the engine does not take a contact.
    """
    pairs, step = [contact.pair for contact in verified], verified[0].drops.step
    blocks: list[Block] = []
    for i, pair in enumerate(pairs):
        blocks += _describe_numbers(pair, f"{_name_of_contact(i)}: " if len(pairs) > 1 else "")
    if touch is not None:
        blocks.append(_describe_linearised(touch, pairs[0].speed))
    if len(pairs) == 1:
        text = paste(engine.name, pairs[0].contact, step, pairs[0].solref)
    else:
        text = paste_both(engine.name, pairs, step)
    return [*blocks, f"\n{text.rstrip()}", *_drop_blocks(engine, verified, tolerance, given_step)]


def _name_of_contact(i: int) -> str:
    """Name contact i, from 0, by its bodies."""
    return f"{_BODIES[i]} on {_BODIES[i + 1]}"


def _describe_numbers(pair: Pair, prefix: str) -> list[str]:
    """Say what contact a pair has, and how deep it goes."""
    c, lines = pair.contact, []
    if pair.solref is not None:
        solref, solimp = (" ".join(f"{value:g}" for value in values) for values in pair.solref)
        lines.append(f"solref {solref} with solimp {solimp}, as the engine reads it, is for these masses:")
    return [
        *lines,
        f"{prefix}k = {c.k:.6g} N/m, c = {c.c:.6g} N s/m (zeta = {c.zeta:.4g}) between bodies of reduced mass "
        f"{c.mass:.6g} kg",
        *([] if pair.solref is None else _describe_solref(pair.solref, pair)),
        f"at {pair.speed:.6g} m/s the penetration is {pair.penetration:.3g} m: the bodies must be much larger",
        f"at rest it is {pair.depth_at_rest:.4g} m under the weight of {pair.carried:.6g} kg at {GRAVITY:g} m/s^2",
    ]


def _describe_solref(written: MujocoContact, pair: Pair) -> list[str]:
    """Say what the numbers of a solref are not."""
    lines: list[str] = []
    if not is_linear(written):
        lines.append(
            f"This is the spring and dashpot of the same restitution and duration at {pair.speed:.6g} m/s. The "
            "impedance changes with the depth: another speed makes another contact of it."
        )
    if written.solref[0] > 0:
        lines.append(
            f"The second number of solref is a damping ratio, not a restitution: {written.solref[1]:g} rebounds with "
            f"{pair.motion.restitution:.4g}."
        )
    return lines


def _drop_blocks(
    engine: Engine, verified: Sequence[VerifiedContact], tolerance: float, given_step: float | None
) -> list[Block]:
    """Lay out what drops gave at a step and at a tenth of it, and what the step is."""
    name, step = engine.name, verified[0].drops.step
    rows: list[tuple[str, ...]] = []
    for i, (pair, drops, fine) in enumerate(verified):
        for quantity, unit in (("restitution", ""), ("duration", " s")):
            label = quantity if len(verified) == 1 else f"{quantity}, {_name_of_contact(i)}"
            rows.append(
                (
                    label,
                    f"{getattr(pair.motion, quantity):.6g}{unit}",
                    f"{round_outward(*getattr(drops, quantity))}{unit}",
                    f"{getattr(fine, quantity)[0]:.6g}{unit}",
                )
            )
    where = "by the lines above alone" if name in DROP else "by the adapter's scene"
    is_asked = all(pair.restitution is not None for pair, _, _ in verified)
    header = ("", "asked" if is_asked else "exact", f"at {step:.6g} s", f"at {step / 10:.6g} s")
    caption = f"Drops in {name} {where}"
    if len(verified) > 1:
        caption += ", each contact alone"
    counts = " and ".join(str(contact.drops.n) for contact in verified)
    steps = " and ".join(f"{contact.pair.motion.duration / step:.0f}" for contact in verified)
    kept = (
        f"at which {name} {engine.version()} keeps both within {tolerance:g} of the request, wherever within a step "
        f"the bodies touch ({counts} drops), and at the four shorter steps too: {steps} steps in a contact"
    )
    if given_step is None:
        says = f"{step:.6g} s is the largest step tried (ten a decade) {kept}"
    else:
        stiffest = "this is the stiffest contact" if len(verified) == 1 else "these are the stiffest contacts"
        says = (
            f"{stiffest} tried (forty durations a decade) for {step:.6g} s {kept}; a larger --tolerance lets a stiffer "
            "one pass"
        )
    return [Table(header, rows, caption), says]


def impact_blocks(
    engine: str,
    masses: Sequence[float],
    pairs: Sequence[Pair],
    exact: Mapping[str, list[float] | str],
    runs: Sequence[Strike | str],
) -> list[Block]:
    """Lay out the impact of three bodies at once.

    `exact` has the velocities in m/s by solver, and `runs` those of the engine's runs, or else the reason why there are
    none.
    """
    moving = [body for body, mass in zip(_BODIES, masses, strict=True) if not math.isinf(mass)]
    weights = [mass for mass in masses if not math.isinf(mass)]
    model = exact[MODEL]
    rows: list[tuple[str, ...]] = []
    notes: list[str] = []

    def divergence(velocities: Sequence[float]) -> str:
        if isinstance(model, str):
            return "-"
        difference = np.subtract(velocities, model)
        start = [-pairs[0].speed, *[0.0] * (len(moving) - 1)]
        return f"{kinetic_norm(weights, difference) / kinetic_norm(weights, start):.3f}"

    for solver, velocities in exact.items():
        label = f"{title_of(solver)} ({solver})"
        if isinstance(velocities, str):
            notes.append(f"{label}: {velocities}")
            continue
        rows.append((label, *(f"{velocity:.6f}" for velocity in velocities), divergence(velocities)))
    for run in runs:
        if isinstance(run, str):
            notes.append(f"{engine}: {run}")
            continue
        ranges = (round_outward(*ends) if run.n > 1 else f"{ends[0]:.6f}" for ends in run.velocities)
        middle = [0.5 * (low + high) for low, high in run.velocities]
        rows.append((f"{engine}, the lines above at {run.step:.6g} s", *ranges, divergence(middle)))
    floor = "is fixed" if len(moving) == 2 else "is at rest"
    caption = (
        f"The impact of all three: A strikes B at {pairs[0].speed:.6g} m/s while B touches C, which {floor}; no "
        "gravity; velocities in m/s, positive away from C"
    )
    return [
        Table(("", *(f"v of {body}" for body in moving), "D"), rows, caption),
        *notes,
        "D is the difference from the model (docs/theory.md, section 9). The restitution of a contact is not kept "
        "where a third body pushes too.",
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
