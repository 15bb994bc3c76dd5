"""Text and tables about contacts: one contact for an engine, and the contacts of a MuJoCo scene.

The functions here need contacts that `single_contact`, `three_bodies` or `inspect_mujoco` has measured. The commands
`contact` and `inspect` call them.
"""

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
from impact_xval.compliant_baselines.single_contact import DROP, TOLERANCE, SingleImpact, VerifiedContact
from impact_xval.compliant_baselines.solref import is_linear
from impact_xval.compliant_baselines.three_bodies import MODEL, Strike, paste_both
from impact_xval.experiments.presentation.document import Block, Table
from impact_xval.experiments.tables.numbers import number
from impact_xval.model.kinetic import kinetic_norm
from impact_xval.model.materials import Material, MaterialContact

if TYPE_CHECKING:  # the imported package needs MuJoCo
    from impact_xval.compliant_baselines.inspect_mujoco import (
        Examination,
        ExaminedContact,
        ExaminedGroup,
        MeasuredContact,
    )
    from impact_xval.compliant_baselines.inspect_mujoco.fixing import FixedScene
    from impact_xval.compliant_baselines.inspect_mujoco.readings import RatioAdvice, Reading


#: Names of the bodies from the top down, as in the text to paste.
_BODIES = "ABC"


def contact_blocks(
    engine: Engine,
    verified: Sequence[VerifiedContact],
    touch: MaterialContact | None = None,
    tolerance: float = TOLERANCE,
    given_step: float | None = None,
) -> list[Block]:
    """Return text and tables about one contact, or about the two contacts of three bodies.

    The blocks show the numbers of the contacts, the lines to paste into a scene of the engine, and the results of
    drops.

    Parameters
    ----------
    engine
        The engine.
    verified
        The contacts, whose drops all have the same time step.
    touch
        The contact of two materials for which the pair stands, or None if the user gave no materials.
    tolerance
        Allowed relative error of restitution and duration.
    given_step
        The time step in s, if the user gave the step and the stiffness was searched for it.

    Raises
    ------
    SolverError
        If the engine cannot represent a contact.
    """
    pairs, step = [contact.pair for contact in verified], verified[0].drops.step
    blocks: list[Block] = []
    for i, pair in enumerate(pairs):
        blocks += _describe_numbers(pair, f"{_name_of_contact(i)}: " if len(pairs) > 1 else "")
    if touch is not None:
        blocks += describe_linearised(touch, pairs[0].speed)
    if len(pairs) == 1:
        text = paste(engine.name, pairs[0].contact, step, pairs[0].solref)
    else:
        text = paste_both(engine.name, pairs, step)
    return [*blocks, f"\n{text.rstrip()}", *_drop_blocks(engine, verified, tolerance, given_step)]


def _name_of_contact(i: int) -> str:
    """Return the name of contact i, which counts from 0, such as ``A on B``."""
    return f"{_BODIES[i]} on {_BODIES[i + 1]}"


def _describe_numbers(pair: SingleImpact, prefix: str) -> list[str]:
    """Return lines with the numbers of the contact of a pair of bodies, and with the depths of the contact."""
    c, lines = pair.contact, []
    if pair.solref is not None:
        solref, solimp = (" ".join(f"{value:g}" for value in values) for values in pair.solref)
        lines.append(f"The engine reads solref {solref} and solimp {solimp}. For these masses they mean:")
    return [
        *lines,
        f"{prefix}k = {c.k:.6g} N/m, c = {c.c:.6g} N s/m, damping ratio {c.zeta:.4g}, reduced mass {c.mass:.6g} kg",
        *([] if pair.solref is None else _describe_solref(pair.solref, pair)),
        f"{prefix}greatest depth {pair.penetration:.3g} m at {pair.speed:.6g} m/s; the bodies must be much larger "
        "than this depth",
        f"{prefix}depth at rest {pair.depth_at_rest:.4g} m, under the weight of {pair.carried:.6g} kg at "
        f"{GRAVITY:g} m/s^2",
    ]


def _describe_solref(written: MujocoContact, pair: SingleImpact) -> list[str]:
    """Return warnings about a solref whose numbers can be misread; empty if no warning is needed."""
    lines: list[str] = []
    if not is_linear(written):
        lines.append(
            f"This spring and dashpot has the same restitution and duration as the contact at {pair.speed:.6g} m/s. At "
            "another speed its numbers are different, because the impedance changes with the depth."
        )
    if written.solref[0] > 0:
        lines.append(
            f"The second number of solref is a damping ratio, not a restitution. With {written.solref[1]:g} the "
            f"restitution is {pair.motion.restitution:.4g}."
        )
    return lines


def _drop_blocks(
    engine: Engine, verified: Sequence[VerifiedContact], tolerance: float, given_step: float | None
) -> list[Block]:
    """Return the table of the results of drops, at the time step and at a tenth of it, and lines about the step."""
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
    where = "with the lines above and nothing else" if name in DROP else "in the adapter's scene"
    is_asked = all(pair.restitution is not None for pair, _, _ in verified)
    first = "asked" if is_asked else "exact"
    header = ("", first, f"at a step of {step:.6g} s", f"at {step / 10:.6g} s")
    caption = f"Drops in {name} {engine.version()} {where}"
    if len(verified) > 1:
        caption += ", one contact at a time"
    counts = " and ".join(str(contact.drops.n) for contact in verified)
    steps = " and ".join(f"{contact.pair.motion.duration / step:.0f}" for contact in verified)
    kept = f"restitution and duration within a relative error of {tolerance:g} of the {first} numbers"
    if given_step is None:
        says = [f"{step:.6g} s is the largest step tried that keeps {kept}. Ten steps per decade were tried."]
    else:
        stiffest = "this is the stiffest contact" if len(verified) == 1 else "these are the stiffest contacts"
        keep = "keeps" if len(verified) == 1 else "keep"
        says = [
            f"At a step of {step:.6g} s {stiffest} tried that {keep} {kept}.",
            "Forty durations per decade were tried. A larger --tolerance allows a stiffer contact.",
        ]
    takes = "The contact takes" if len(verified) == 1 else "The contacts take"
    return [
        Table(header, rows, caption),
        *says,
        f"The drops ({counts}) touch at different instants within a step. Drops with four shorter steps are within "
        f"this error too. {takes} {steps} steps.",
    ]


def impact_blocks(
    engine: str,
    masses: Sequence[float],
    pairs: Sequence[SingleImpact],
    exact: Mapping[str, list[float] | str],
    runs: Sequence[Strike | str],
) -> list[Block]:
    """Return the table of velocities after an impact in which three bodies meet at the same time, with notes.

    `exact` has the velocities in m/s by solver. `runs` has the results of the engine. A text in place of velocities
    says why there are none.
    """
    moving = [body for body, mass in zip(_BODIES, masses, strict=True) if not math.isinf(mass)]
    weights = [mass for mass in masses if not math.isinf(mass)]
    model = exact[MODEL]
    rows: list[tuple[str, ...]] = []
    notes: list[str] = []

    def divergence(velocities: Sequence[float]) -> str:
        """Return the divergence D of velocities from the model as text; a dash if the model has no velocities."""
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
        f"All three bodies at the same time: A strikes B at {pairs[0].speed:.6g} m/s, B touches C, and C {floor}. "
        "There is no gravity.\nVelocities after the impact in m/s, positive away from C:"
    )
    return [
        Table(("", *(f"v of {body}" for body in moving), "D"), rows, caption),
        *notes,
        "D is the difference from the model (docs/theory.md, section 9).",
        "The restitution of a contact differs here from that of two bodies alone, because a third body pushes too.",
    ]


def round_outward(low: float, high: float) -> str:
    """Return the text of a rounded interval that contains both numbers.

    The rounded interval is wider than the exact interval, by at most 2e-4 of the width plus 2e-12 of the numbers. The
    ends are not rounded to the nearest digit, because the interval could then leave out measured numbers.
    """
    resolution = max(1e-4 * (high - low), 1e-12 * max(abs(low), abs(high)))
    exponent = math.floor(math.log10(resolution)) if resolution > 0 else 0
    unit = 10.0**exponent
    # An end that is a multiple of the unit keeps its value. Rounding may change the quotient by less than a thousandth.
    ends = math.floor(low / unit + 1e-3), math.ceil(high / unit - 1e-3)
    return " to ".join(f"{float(f'{end}e{exponent}'):.15g}" for end in ends)


def describe_linearised(touch: MaterialContact, speed: float) -> list[str]:
    """Return lines about a linear contact that stands for two materials.

    They tell the force of the materials, and how it differs from the force of the linear contact.
    """
    names = " on ".join(
        f"{body.material.name} "
        + ("flat" if math.isinf(body.radius) else f"ball of {body.radius:g} m radius")
        for body in (touch.upper, touch.lower)
    )
    materials = dict.fromkeys(body.material for body in (touch.upper, touch.lower))
    p, duration = touch.exponent, touch.duration(speed)
    longer = math.pi * touch.compression(speed) / speed / duration - 1
    return [
        f"The materials are {names}. Their elastic force is {touch.stiffness:.4g} delta^{p:g} N at a depth delta in m. "
        f"Their contact lasts {duration:.4g} s.",
        "The linear contact has the same greatest depth and energy at this speed. Compared with the contact of the "
        f"materials it lasts {longer:.1%} longer, and its peak force is {1 - 2 / (p + 1):.0%} lower.",
        f"Numbers used: {'; '.join(map(_describe_material, materials))}.",
    ]


def _describe_material(material: Material) -> str:
    """Return the numbers of a material that a contact is computed from; `model.materials` has their sources."""
    wall = "" if material.wall is None else f", wall of {material.wall:g} m"
    return (
        f"{material.name} with Young's modulus {material.young:g} Pa, Poisson's ratio {material.poisson:g}, "
        f"density {material.density:g} kg/m^3{wall}"
    )


#: Largest numbers of lines about a scene on one screen: all lines together, then lines for groups, for remarks, and for
#: traps.
_MOST_LINES, _MOST_GROUPS, _MOST_REMARKS, _MOST_TRAPS = 40, 8, 3, 7

#: Largest number of contacts that are shown for a scene that was written.
_MOST_WRITTEN = 12

#: Warning about contacts whose numbers are forces. In a scene, such contacts may differ from the drops, in which bodies
#: touch in one point at their centres. Contacts whose numbers are accelerations depend little on the points of contact.
_ONE_POINT = (
    "These numbers are for one point of contact, in line with the centres of mass. A box that lands on a face has four "
    "points of contact and is four times as stiff. A body that is hit off its centre acts like a lighter body: its "
    "rebound is earlier and lower."
)

#: Largest number of letters of the name of a contact in a table.
_NAME_WIDTH = 44


def scene_blocks(
    examination: Examination, scene: str, speed: float, version: str, *, everything: bool = False
) -> list[Block]:
    """Return text and tables about the contacts of a MuJoCo scene, which drops at a speed in m/s have measured.

    The tables show the parameters, the measured numbers, what to write for another contact, and the traps (known
    problems). By default each table shows only its first rows, so that all tables fit on one screen. With `everything`
    the tables show all rows, and one row for every measured contact.
    """
    groups = examination.groups
    shown = groups if everything else groups[:_MOST_GROUPS]
    head = _describe_examination(examination, scene, version)
    traps = _describe_traps(examination, scene, everything)
    if not groups:
        return [head, "no two geoms can touch", *traps]
    header = ("group", "first contact", "contacts", "from", "condim", "solref", "solimp")
    rows = [_parameter_row(n, group) for n, group in enumerate(shown, 1)]
    caption = (
        f"Measured with two bodies alone: drops at {speed:g} m/s that touch at several instants within a step, and the "
        "depth at rest under the lighter body"
    )
    measured_header = ("group", "masses, kg", "e", "k, N/m", "c, N s/m", "duration, s", "steps", "at rest, m")
    measured_rows = [row for n, group in enumerate(shown, 1) for row in _measured_rows(n, group, everything)]
    remarks = [line for n, group in enumerate(shown, 1) for line in _describe_remarks(n, group)]
    if len(groups) > len(shown):
        remarks.insert(0, f"{len(groups) - len(shown)} more groups are not shown; --all shows them")
    advice = _advice_rows(shown)
    to_write = sorted([*_reading_rows(shown, everything), *advice], key=lambda row: _first_number(row[0]))
    has_readings = len(to_write) > len(advice)
    places = _places_of_advice(shown)
    notes = [_describe_pairs(shown), _ONE_POINT] if has_readings else []
    if examination.shared_impedance:
        notes.append(_describe_two_contacts(examination.shared_impedance))
    if not everything:
        remarks = _keep_first(remarks, _MOST_REMARKS, "remarks")
        # 11 lines are not rows of tables. They are the first line, three lines for each of three tables (an empty line,
        # a caption and a header), and an empty line after the tables.
        lines_left = _MOST_LINES - 11 - sum(map(len, (rows, measured_rows, remarks, notes, traps)))
        if len(to_write) > lines_left:
            kept = max(lines_left - 1, 0)
            notes.insert(
                0, f"{len(to_write) - kept} more rows of what to write are not shown; --all shows them"
            )
            to_write = to_write[:kept]
    return [
        head,
        Table(header, rows, "Parameters as the engine combines them", text=4),
        Table(measured_header, measured_rows, caption, text=2),
        Table(_TO_WRITE, to_write, _caption_of_what_to_write(has_readings, places), text=2),
        *remarks,
        *notes,
        *traps,
    ]


#: Header of the table that says what to write into a scene for the contact that its author may have meant.
_TO_WRITE = ("group", "contact", "e", "duration, s", "solref", "condim", "friction", "step, s", "e of drops")


def _caption_of_what_to_write(has_readings: bool, places: str) -> str:
    """Return the caption of the table that says what to write.

    The caption says whether the rows of the table propose a <pair>, a solref, or both. `places` says where to write a
    solref; it is empty if no row proposes one.
    """
    pair = f'<pair geom1="A" geom2="B" solimp="{_FORCE_LEVEL}" .../>'
    what = "What to write for another contact, which has the e of its row if two bodies collide alone"
    if has_readings and places:
        return f"{what}. Rows with a condim: a {pair}. Rows without a condim: this solref {places}"
    return f"{what}: {pair if has_readings else f'this solref {places}'}"


#: Places in a scene where a solref is written, by the rule by which MuJoCo finds the parameters of a contact.
_PLACES_OF_SOLREF = {
    "pair": "in the <pair>",
    "override": "as o_solref in <option>",
    "priority": "in the geom of priority",
    "same": "in both geoms",
    "mixed": "in both geoms",
}


def _places_of_advice(groups: list[ExaminedGroup]) -> str:
    """Return where to write the proposed solrefs, such as ``in both geoms``; empty if no solref is proposed.

    If the places of groups differ, each place has the numbers of its groups.
    """
    groups_of_places: dict[str, list[int]] = {}
    for n, group in enumerate(groups, 1):
        if any(contact.advice for contact in group.examined):
            place = _PLACES_OF_SOLREF[group.group.contacts[0].bodies.rule]
            groups_of_places.setdefault(place, []).append(n)
    if len(groups_of_places) == 1:
        return next(iter(groups_of_places))
    return ", ".join(
        f"{place} ({'group' if len(numbers) == 1 else 'groups'} {_format_groups(numbers)})"
        for place, numbers in groups_of_places.items()
    )


#: The solimp of every <pair> that is proposed.
_FORCE_LEVEL = "0.0001 0.0001 0.001 0.5 1"


def _first_number(numbers: str) -> int:
    """Return the first number in a text that lists numbers of groups, such as ``2, 5``."""
    return int(numbers.partition(",")[0])


def _keep_first(lines: list[str], most: int, what: str) -> list[str]:
    """Return the first lines, and one more line that says how many lines are left out."""
    if len(lines) <= most:
        return lines
    return [*lines[: most - 1], f"{len(lines) - most + 1} more {what} are not shown; --all shows them"]


def _describe_examination(examination: Examination, scene: str, version: str) -> str:
    """Return a line that says what was examined, by which engine, and which contacts are left out."""
    contacts = sum(len(group.group.contacts) for group in examination.groups)
    looked = ""
    if examination.geoms_looked_at < examination.geoms:
        looked = f" (examined: {examination.geoms_looked_at}, which stand for all others of their kinds)"
    head = (
        f"MuJoCo {version}, {scene}: {_count(examination.geoms, 'geom')}{looked}, {_count(contacts, 'contact')} in "
        f"{_count(len(examination.groups), 'group')} of equal parameters, step {examination.step:g} s, integrator "
        f"{examination.integrator}"
    )
    if examination.omissions:
        head += f". The drops leave out: {', '.join(examination.omissions)}"
    return head


def _count(number: int, thing: str) -> str:
    """Return a number of things as text, such as ``1 trap`` or ``3 traps``."""
    return f"{number} {thing}{'' if number == 1 else 's'}"


def _parameter_row(n: int, group: ExaminedGroup) -> tuple[str, ...]:
    """Return the row of a group in the table of parameters."""
    contacts = group.group.contacts
    bodies = contacts[0].bodies
    solref, solimp = (
        " ".join(f"{value:.6g}" for value in values) for values in (bodies.solref, bodies.solimp)
    )
    condim = int(dict(bodies.pair)["dim"][0])
    return (
        str(n),
        _shorten(contacts[0].name),
        str(len(contacts)),
        _RULE_WORDS[bodies.rule],
        "1, frictionless" if condim == 1 else str(condim),
        solref,
        solimp,
    )


#: Words for a table that name the rule by which MuJoCo finds the parameters of a contact.
_RULE_WORDS = {
    "pair": "<pair>",
    "override": "flag override",
    "priority": "geom of priority",
    "same": "both geoms",
    "mixed": "mixed by solmix",
}


def _shorten(name: str) -> str:
    """Return the name of a contact, shortened to `_NAME_WIDTH` letters."""
    return name if len(name) <= _NAME_WIDTH else f"{name[: _NAME_WIDTH - 3]}..."


def fixed_scene_blocks(fixed: FixedScene, scene: str, target: str, version: str) -> list[Block]:
    """Return text and a table about a scene that was written.

    They say what was changed in the scene, and how its contacts behave.
    """
    reading = (
        "behave as before if two bodies collide alone"
        if fixed.kind == "keep"
        else "have their numbers in N/m and N s/m"
    )
    changes = [f"{fixed.pairs} <pair>s", f"the step, from {fixed.step_before:g} to {fixed.step:g} s"]
    changes += ["the solver's tolerance, which is now 0"] if fixed.zero_tolerance else []
    changes += [f"names of {fixed.named_geoms} geoms"] if fixed.named_geoms else []
    rows: list[tuple[str, ...]] = []
    for contact in fixed.written[:_MOST_WRITTEN]:
        meant, measured = contact.reading, contact.measured
        before, now = (
            " ".join(f"{value:.6g}" for value in solref) for solref in (contact.solref_before, meant.solref)
        )
        row = (_abbreviate(contact.names), _format_masses([contact.masses]), before, now)
        numbers = (number(meant.restitution), _format_values(measured.restitution_range or ()))
        durations = (number(meant.duration), number(measured.duration))
        rows.append((*row, *numbers, *durations, "yes" if contact.is_kept else measured.reason or "no"))
    measured_header = ("e meant", "e", "duration meant, s", "duration, s", "kept")
    header = ("contact", "masses, kg", "solref before", "solref now", *measured_header)
    caption = f"{target}, measured by MuJoCo {version}"
    if len(fixed.written) > _MOST_WRITTEN:
        caption += f"; the first {_MOST_WRITTEN} of {len(fixed.written)} measured contacts"
    missed = sum(not contact.is_kept for contact in fixed.written)
    end = (
        f"{missed} of {len(fixed.written)} measured contacts do not behave as meant"
        if missed
        else "all measured contacts behave as meant, measured with two bodies alone"
    )
    notes = [_ONE_POINT]
    if fixed.shared_impedance_before:
        notes.append(
            f"Bodies that are hit in two contacts at once behave otherwise than in {scene}. There MuJoCo's force in "
            f"each contact was wrong by up to d = {fixed.shared_impedance_before:g} times the force in the other. The "
            "new <pair>s have d = 1e-4."
        )
    return [
        f"{target} is {scene} with contacts that {reading}. Changed: {', '.join(changes)}",
        Table(header, rows, caption, text=4),
        *notes,
        f"Other contacts, which keep their parameters at the new step: {fixed.unchanged}",
        end,
    ]


def _measured_rows(n: int, group: ExaminedGroup, everything: bool) -> list[tuple[str, ...]]:
    """Return the rows of the table of measured numbers.

    There is one row per group of contacts, or with `everything` one row per measured contact.
    """
    if everything:
        return [
            (
                f"{n}  {_abbreviate(contact.row.names)}",
                _format_masses([contact.row.masses]),
                *_measured_columns([contact]),
            )
            for contact in group.examined
        ]
    masses = [contact.bodies.masses for contact in group.group.contacts]
    return [(str(n), _format_masses(masses), *_measured_columns(group.examined))]


def _measured_columns(contacts: list[ExaminedContact]) -> list[str]:
    """Return the measured numbers of contacts as text, as ranges if contacts differ."""
    rows = [contact.row for contact in contacts]
    ends = [e for row in rows for e in row.restitution_range or ()]
    columns = [[row.stiffness for row in rows], [row.damping for row in rows], [row.duration for row in rows]]
    columns += [[row.steps for row in rows]]
    return [*(_format_values(values) for values in [ends, *columns]), _format_rest(rows)]


def _format_rest(rows: Sequence[MeasuredContact]) -> str:
    """Return the depths at rest as text.

    If several points of contact carry a body, the text also tells their number.
    """
    text = _format_values([row.penetration for row in rows])
    points = sorted({row.points for row in rows if row.penetration is not None})
    if not points or points == [1]:
        return text
    return f"{text} ({' or '.join(map(str, points))} points)"


def _format_values(values: Sequence[float | None]) -> str:
    """Return the range of numbers as text; missing numbers are ignored, and a dash stands for no number at all."""
    numbers = sorted(value for value in values if value is not None)
    if not numbers:
        return "-"
    low, high = number(numbers[0]), number(numbers[-1])
    return low if low == high else f"{low} to {high}"


def _format_masses(masses: Sequence[tuple[float, float]]) -> str:
    """Return the masses of the lighter and of the heavier bodies as text, such as ``1 to 2 on fixed``."""
    light, heavy = (sorted(values) for values in zip(*masses, strict=True))
    finite = [mass for mass in heavy if mass < math.inf]
    others = [_format_mass_range(finite)] if finite else []
    others += ["fixed"] if len(finite) < len(heavy) else []
    return f"{_format_mass_range(light)} on {' or '.join(others)}"


def _format_mass_range(masses: Sequence[float]) -> str:
    """Return the range of sorted masses as text."""
    low, high = f"{masses[0]:.4g}", f"{masses[-1]:.4g}"
    return low if low == high else f"{low} to {high}"


def _abbreviate(names: list[str]) -> str:
    """Return the name of the first contact, and the number of other contacts."""
    return _shorten(names[0]) + (f" and {len(names) - 1} more" if len(names) > 1 else "")


def _describe_remarks(n: int, group: ExaminedGroup) -> list[str]:
    """Return a line with the first remark on a group of contacts; empty if there is no remark.

    A remark says, for example, why contacts of the group were not measured.
    """
    remarks = dict.fromkeys(
        remark for contact in group.examined for remark in (contact.row.reason, contact.row.note) if remark
    )
    first, *others = remarks or [""]
    more = f" (and {len(others)} other remarks: --json)" if others else ""
    return [f"group {n}: {first}{more}"] if first else []


def _reading_rows(groups: list[ExaminedGroup], everything: bool) -> list[tuple[str, ...]]:
    """Return the rows that propose a <pair> for contacts whose solref has negative (direct) numbers.

    Direct numbers can be interpreted in two ways, which are called readings. There is one row for each group, each
    reading, and each text to write.
    """
    rows: list[tuple[str, ...]] = []
    for n, group in enumerate(groups, 1):
        for kind in ("keep", "newton_metre"):
            # With a pyramidal friction cone the solref also depends on the friction.
            by_text: dict[tuple[str, str], list[tuple[ExaminedContact, Reading]]] = {}
            for contact in group.examined:
                reading: Reading | None = getattr(contact, kind)
                if reading is not None:
                    text = reading.attributes["solref"], reading.attributes.get("friction", "")
                    by_text.setdefault(text, []).append((contact, reading))
            every = list(by_text.values())
            for readings in every if everything else every[:_MOST_SOLREFS]:
                rows.append(_reading_row(n, readings, is_only=len(every) == 1))
    return rows


#: Largest number of rows on one screen for one reading of a group, which is one way to interpret the numbers of its
#: solref. A reading has several rows if the solref to write depends on the masses of bodies.
_MOST_SOLREFS = 2


def _reading_row(
    n: int, readings: list[tuple[ExaminedContact, Reading]], *, is_only: bool
) -> tuple[str, ...]:
    """Return a row of the table that says what to write for the contacts of a group with the number `n`.

    `readings` are contacts of the group for which the same text is written, each with one interpretation of its
    numbers. `is_only` is true if this text is written for all contacts of the group.
    """
    _, first = readings[0]
    bodies = [contact.bodies for contact, _ in readings]
    if first.kind == "keep":
        is_free = all(math.isclose(each.mass, each.scale, rel_tol=1e-6) for each in bodies)
        meant = "as now, for any mass" if is_free and is_only else "as now"
    else:
        numbers = _format_values([reading.stiffness for _, reading in readings])
        dampings = _format_values([reading.damping for _, reading in readings])
        meant = f"{numbers} N/m, {dampings} N s/m"
    if not is_only:
        meant += f" ({_format_masses([each.masses for each in bodies])} kg)"
    ends = [e for _, reading in readings for e in reading.measured_range or ()]
    tolerance = ', tolerance="0"' if any(reading.zero_tolerance for _, reading in readings) else ""
    return (
        str(n),
        meant,
        _format_values([reading.restitution for _, reading in readings]),
        _format_values([reading.duration for _, reading in readings]),
        first.attributes["solref"],
        str(first.condim),
        first.attributes.get("friction", ""),
        f"{min(reading.step for _, reading in readings):g}{tolerance}",
        _flag_miss(ends, [reading.restitution for _, reading in readings]),
    )


#: Largest relative error of a restitution without a warning, in the table that says what to write.
_WITHOUT_A_WORD = 0.01


def _flag_miss(measured: Sequence[float], meant: Sequence[float]) -> str:
    """Return the measured restitution as text, with its relative error if the error is above `_WITHOUT_A_WORD`."""
    if not measured:
        return "not measured"
    miss = max(abs(ends / e - 1) for ends, e in ((min(measured), min(meant)), (max(measured), max(meant))))
    text = _format_values(measured)
    return text if round(miss, 4) <= _WITHOUT_A_WORD else f"{text}, off {100 * miss:.0f} %"


def _advice_rows(groups: list[ExaminedGroup]) -> list[tuple[str, ...]]:
    """Return the rows that propose damping ratios for other restitutions: two rows for each solref."""
    by_solref: dict[tuple[float, float], list[tuple[int, ExaminedContact, RatioAdvice]]] = {}
    for n, group in enumerate(groups, 1):
        for contact in group.examined:
            if contact.advice:
                by_solref.setdefault(contact.advice.solref, []).append((n, contact, contact.advice))
    rows: list[tuple[str, ...]] = []
    for (_, ratio), contacts in by_solref.items():
        _, _, advice = contacts[0]
        duration = _format_values([contact.row.duration for _, contact, _ in contacts])
        for (e, solref), measured in zip(advice.choices, advice.measured, strict=True):
            rows.append(
                (
                    ", ".join(dict.fromkeys(str(n) for n, _, _ in contacts)),
                    f"damping ratio {solref[1]:.3g}, not {ratio:g}",
                    f"{e:g}",
                    duration,
                    " ".join(f"{value:.3g}" for value in solref),
                    "",
                    "",
                    f"{advice.step:g}",
                    _flag_miss([] if measured is None else [measured], [e]),
                )
            )
    return rows


def _describe_two_contacts(impedance: float) -> str:
    """Return a warning about bodies in two contacts at once; `impedance` is the greatest one of their contacts."""
    return (
        "If a body is hit in two contacts at once, MuJoCo's force in each contact is wrong by up to d times the force "
        f"in the other contact; d, the impedance in solimp, is up to {impedance:g} here. To avoid this write <pair>s "
        f'with solimp="{_FORCE_LEVEL}" (d = 1e-4). impact-xval contact --engine mujoco --masses A B C prints such '
        "<pair>s and tests all three bodies."
    )


def _describe_pairs(groups: list[ExaminedGroup]) -> str:
    """Return a note on how to write the proposed pairs into a scene, with a warning if they have friction."""
    has_friction = any(
        reading is not None and reading.condim > 1
        for group in groups
        for contact in group.examined
        for reading in (contact.keep, contact.newton_metre)
    )
    creep = (
        " The friction of these pairs acts like a weak dashpot, so bodies creep on a slope."
        if has_friction
        else ""
    )
    return (
        f"A and B are two geoms. --fix FILE with --keep or --newton-metre writes all of these pairs.{creep}"
    )


def _describe_traps(examination: Examination, scene: str, everything: bool) -> list[str]:
    """Return lines about the traps (known problems) of a scene, and a last line with their number.

    If `everything` is false, there is one line for each kind of trap, which lists the groups of contacts with this
    trap.
    """
    findings = examination.findings
    if everything:
        lines = [f"{trap}: {_abbreviate(where)}: {says}" for trap, where, says in findings]
    else:
        group_of = {name: n for n, group in enumerate(examination.groups, 1) for name in group.group.names}
        lines = []
        for trap in dict.fromkeys(finding.trap for finding in findings):
            same = [finding for finding in findings if finding.trap == trap]
            groups = sorted({group_of[name] for finding in same for name in finding.contacts})
            first = group_of[same[0].contacts[0]]
            where = f"group {first}" if len(groups) == 1 else f"groups {_format_groups(groups)}"
            of_first = "" if len(groups) == 1 else f"in group {first} "
            lines.append(f"{trap}, {where}: {of_first}{same[0].message}")
        if len(lines) > _MOST_TRAPS:
            lines = [
                *lines[:_MOST_TRAPS],
                f"{len(lines) - _MOST_TRAPS} more kinds of traps are not shown; --all shows them",
            ]
    count = len(findings)
    more = "" if everything or count <= len(lines) else "; --all shows all"
    return [*lines, f"{scene}: {count or 'no'} trap{'s' if count != 1 else ''} found{more}"]


def _format_groups(groups: list[int]) -> str:
    """Return numbers of groups as text, such as ``1 to 4, 7``, with at most `_MOST_GROUPS` ranges."""
    ranges: list[list[int]] = []
    for n in groups:
        if ranges and n == ranges[-1][-1] + 1:
            ranges[-1].append(n)
        else:
            ranges.append([n])
    texts = [f"{each[0]} to {each[-1]}" if len(each) > 2 else ", ".join(map(str, each)) for each in ranges]
    more = f" and {len(texts) - _MOST_GROUPS} more" if len(texts) > _MOST_GROUPS else ""
    return ", ".join(texts[:_MOST_GROUPS]) + more
