"""Examination of a MuJoCo scene: it measures contacts, and finds traps in their parameters and measurements."""

from __future__ import annotations

import difflib
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from impact_xval.compliant_baselines.engines.mujoco import Mujoco
from impact_xval.compliant_baselines.inspect_mujoco.drops import MeasuredContact, measure_contact
from impact_xval.compliant_baselines.inspect_mujoco.groups import ContactGroup, choose_members, group_contacts
from impact_xval.compliant_baselines.inspect_mujoco.readings import (
    NEAR_E,
    NEAR_K,
    RatioAdvice,
    Reading,
    advise_on_ratio,
    describe_ratio,
    read_direct_numbers,
    round_down,
)
from impact_xval.compliant_baselines.inspect_mujoco.scene_contacts import (
    MOST_GEOMS,
    Bodies,
    MujocoOption,
    SceneContact,
    find_contacts,
    name_of_geom,
    select_geoms,
)
from impact_xval.compliant_baselines.inspect_mujoco.traps import (
    FORCE_LEVEL,
    GOOD_STEPS,
    Finding,
    Trap,
    find_long_step,
    format_extremes,
    gather_findings,
    is_lengthened,
    traps_in_parameters,
    traps_of_mixing,
)

mujoco: Any = import_module("mujoco")  # type checkers do not see the names of the compiled module

#: Largest number of combinations of parameters and bodies that are measured.
MOST_ROWS = 50

#: Time in s after which no further contact is measured.
MOST_SECONDS = 60.0

#: Changes of at most this number are ignored: the excess of a restitution over 1, and the change of a restitution, or
#: the relative change of a duration, by the solver's tolerance. At 30 steps in a contact the restitution of an elastic
#: contact is wrong by at most 1.1e-3.
NEGLIGIBLE = 1.5e-3


class ExaminedContact(NamedTuple):
    """Measurement of contacts with equal parameters and bodies.

    The record also holds the readings of the parameters: which contact a user may have meant by them.
    """

    bodies: Bodies
    row: MeasuredContact
    keep: Reading | None = None
    newton_metre: Reading | None = None
    advice: RatioAdvice | None = None


@dataclass(frozen=True)
class ExaminedGroup:
    """Contacts with the same parameters, and the measurements of some of them."""

    group: ContactGroup
    examined: list[ExaminedContact]

    @property
    def restitution_range(self) -> tuple[float, float] | None:
        """Least and greatest restitution of all drops; None if no contact was measured."""
        ends = [e for contact in self.examined for e in contact.row.restitution_range or ()]
        return (min(ends), max(ends)) if ends else None


@dataclass(frozen=True)
class Examination:
    """Result of the examination of a scene."""

    groups: list[ExaminedGroup]
    findings: list[Finding]
    #: Number of geoms in the scene, and number of geoms whose contacts were examined.
    geoms: int
    geoms_looked_at: int
    #: Time step in s, and name of the integrator.
    step: float
    integrator: str
    #: Phrases that name effects of the scene which are missing in the drops.
    omissions: list[str] = field(default_factory=list[str])
    #: Greatest impedance d of a contact with a body that is in a second contact too; 0 if it is small, or if there is
    #: no such body. If two contacts of a body are hit at once, the force of one is wrong by up to d times the force of
    #: the other.
    shared_impedance: float = 0.0

    @property
    def contacts(self) -> list[ExaminedContact]:
        """All contacts with a measurement, or with the reason why there is none."""
        return [contact for group in self.groups for contact in group.examined]


def load_scene(scene: Path) -> Any:
    """Load a .mjb or MJCF file in which something can move.

    If MuJoCo refuses the file, a ValueError has MuJoCo's own message. A ValueError is also raised for a scene without
    joints, and for masses or inertias that overflow.
    """
    load = mujoco.MjModel.from_binary_path if scene.suffix == ".mjb" else mujoco.MjModel.from_xml_path
    try:
        model = load(str(scene))
    except Exception as error:  # the engine can raise any exception on a scene that it does not expect
        raise ValueError(f"{scene}: MuJoCo does not compile it: {error}") from None
    if model.nv == 0:
        raise ValueError(f"{scene}: no body can move; legal: a scene with a joint")
    is_finite = np.isfinite(model.body_mass) & np.isfinite(model.body_inertia).all(axis=1)
    if not is_finite.all():
        body = int(is_finite.argmin())
        name, inertia = model.body(body).name or f"#{body}", model.body_inertia[body].tolist()
        raise ValueError(
            f"{scene}: body {name} has the mass {model.body_mass[body]:g} kg and the inertia {inertia} kg m^2 in "
            "MuJoCo; legal: finite numbers"
        )
    return model


def examine(speed: float, scene: Path) -> tuple[list[MeasuredContact], list[Finding]] | str:
    """Measure the contacts of a .mjb or MJCF file and find traps; or return the reason why MuJoCo refuses the file."""
    try:
        return examine_model(load_scene(scene), speed)
    except Exception as error:  # the engine can raise any exception on a scene that it does not expect
        return str(error)


def examine_model(model: Any, speed: float = 1.0) -> tuple[list[MeasuredContact], list[Finding]]:
    """Measure the contacts of a compiled mujoco.MjModel, and find traps in parameters and in measurements."""
    examination = examine_groups(model, speed, every=True)
    return [contact.row for contact in examination.contacts], examination.findings


def inspect_model(model: Any) -> list[Finding]:
    """Find traps in the parameters of a compiled mujoco.MjModel, without measuring contacts."""
    groups = group_contacts(find_contacts(model))
    return gather_findings(
        [
            (
                group.names,
                [*traps_of_mixing(group.contacts), *traps_in_parameters(model.opt, list(group.members))],
            )
            for group in groups
        ]
    )


def measure_model(model: Any, speed: float = 1.0) -> list[MeasuredContact]:
    """Measure the contacts of a compiled mujoco.MjModel, one for each combination of parameters and bodies.

    Bodies meet at `speed` in m/s. The speed matters if the impedance of a contact depends on the depth.
    """
    return [contact.row for contact in examine_groups(model, speed, every=True).contacts]


def abbreviate_names(names: list[str]) -> str:
    """Return a short name for several contacts: the first name, and the number of the others."""
    return names[0] + (f" and {len(names) - 1} more" if len(names) > 1 else "")


def examine_groups(
    model: Any, speed: float = 1.0, *, every: bool = False, geom: str | None = None
) -> Examination:
    """Measure some contacts of each group with the same parameters in a compiled mujoco.MjModel, and find traps.

    Parameters
    ----------
    model, speed
        The scene, and the speed in m/s at which bodies meet.
    every
        True to measure every combination of parameters and bodies, but at most `MOST_ROWS`. False to measure only the
        contacts of a group that differ most.
    geom
        Name of a geom, or its number after a "#": only contacts of this geom are examined.

    Raises
    ------
    ValueError
        If no geom has this name or number.
    """
    selected = select_geoms(model)
    contacts = find_contacts(model, selected)
    if geom is not None:
        number = number_of_geom(model, geom)
        if number not in selected:
            selected = [*selected, number]
            contacts = find_contacts(model, selected)
        contacts = [contact for contact in contacts if number in contact.geoms]
    groups = group_contacts(contacts)
    deadline, rows_left = time.perf_counter() + MOST_SECONDS, MOST_ROWS
    examined_groups: list[ExaminedGroup] = []
    traps: list[tuple[list[str], list[Trap]]] = []
    measured_traps: list[tuple[list[str], list[Trap]]] = []
    with Mujoco().running():  # keeps the engine's warnings off the terminal
        for group in groups:
            members = list(group.members) if every else choose_members(group)
            examined, of_rows = _examine_group(model, speed, group, members[:rows_left], deadline)
            rows_left -= len(examined)
            examined_groups.append(ExaminedGroup(group, examined))
            measured_traps += of_rows
            rows = [contact.row for contact in examined]
            of_group = [
                *traps_of_mixing(group.contacts),
                *traps_in_parameters(model.opt, list(group.members), rows),
            ]
            if time.perf_counter() < deadline:
                # Contacts that the solver's tolerance changes are left out, because their behaviour says nothing about
                # the step.
                changed = [
                    names for names, of_row in of_rows if any(trap.name == "tolerance" for trap in of_row)
                ]
                kept = [contact for contact in examined if contact.row.names not in changed]
                of_group += _trap_of_long_step(kept, model.opt, speed)
            traps.append((group.names, of_group))
    return Examination(
        groups=examined_groups,
        findings=[*gather_findings(traps), *gather_findings(measured_traps)],
        geoms=int(model.ngeom),
        geoms_looked_at=len(selected) if model.ngeom > MOST_GEOMS else int(model.ngeom),
        step=float(model.opt.timestep),
        integrator=mujoco.mjtIntegrator(model.opt.integrator).name.removeprefix("mjINT_"),
        omissions=list_omissions(model),
        shared_impedance=find_shared_impedance(model, contacts),
    )


def number_of_geom(model: Any, name: str) -> int:
    """Return the number of a geom from its name, or from its number after a "#"; a ValueError if there is none."""
    names = [name_of_geom(model, geom) for geom in range(model.ngeom)]
    if name in names:
        return names.index(name)
    if name.startswith("#") and name[1:].isdecimal() and int(name[1:]) < model.ngeom:
        return int(name[1:])
    near = difflib.get_close_matches(name, names) or names[:3]
    raise ValueError(
        f"--geom = {name!r}: the scene has no such geom; legal: a name such as {', '.join(near)}"
    )


def find_shared_impedance(model: Any, contacts: Sequence[SceneContact]) -> float:
    """Return the greatest impedance of the contacts with a moving body that is in two or more of the contacts.

    The impedance is the larger end of the solimp. The result is 0 if no moving body is in two contacts, or if the
    impedance is at most `FORCE_LEVEL`.
    """
    # Bodies without a joint between them are one body. Number 0 is the fixed world.
    bodies_of_geoms = model.body_weldid[model.geom_bodyid].tolist()
    bodies = [{bodies_of_geoms[geom] for geom in contact.geoms} - {0} for contact in contacts]
    counts = Counter(body for pair in bodies for body in pair)
    shared = [
        max(contact.bodies.solimp[:2])
        for contact, pair in zip(contacts, bodies, strict=True)
        if any(counts[body] > 1 for body in pair)
    ]
    greatest = max(shared, default=0.0)
    return greatest if greatest > FORCE_LEVEL else 0.0


def list_omissions(model: Any) -> list[str]:
    """Return phrases that name the effects of a scene which are missing in the drops."""
    counts = [
        (model.nflex, "the contacts of {} flex (soft body)", "the contacts of {} flexes (soft bodies)"),
        (model.nu, "the force of {} actuator", "the forces of {} actuators"),
        (np.count_nonzero(model.jnt_stiffness), "the spring of {} joint", "the springs of {} joints"),
        (np.count_nonzero(model.jnt_limited), "the limits of {} joint", "the limits of {} joints"),
        (model.ntendon, "{} tendon", "{} tendons"),
        (model.neq, "{} equality constraint", "{} equality constraints"),
    ]
    return [(one if count == 1 else more).format(count) for count, one, more in counts if count]


def _examine_group(
    model: Any, speed: float, group: ContactGroup, members: list[Bodies], deadline: float
) -> tuple[list[ExaminedContact], list[tuple[list[str], list[Trap]]]]:
    """Measure some contacts of a group. Return the measurements, and their traps with the names of contacts."""
    gravity = float(np.linalg.norm(model.opt.gravity))
    names = group.members
    rows: list[tuple[Bodies, MeasuredContact]] = []
    for bodies in members:
        row = MeasuredContact(names[bodies], bodies.masses, note=_note_on_joints(bodies))
        if time.perf_counter() > deadline:
            reason = f"not measured: {MOST_SECONDS:g} s have passed; --geom examines one geom only"
            rows.append((bodies, row._replace(reason=reason)))
            continue
        try:
            measured = measure_contact(bodies, model.opt, model.opt.timestep, speed, gravity)
            notes = (measured.note, row.note)
            row = measured._replace(names=row.names, note="; ".join(note for note in notes if note))
        except Exception as error:  # the engine can raise any exception on numbers that it does not take
            row = row._replace(reason=str(error))
        rows.append((bodies, row))
    common = _common_measurement([row for _, row in rows])
    examined: list[ExaminedContact] = []
    traps: list[tuple[list[str], list[Trap]]] = []
    for number, (bodies, row) in enumerate(rows):
        contact = ExaminedContact(bodies, row)
        if not row.reason and time.perf_counter() < deadline:
            try:
                contact = _add_readings(contact, model.opt, speed, common or row, is_first=number == 0)
            except Exception as error:  # the engine can raise any exception on numbers that it does not take
                contact = contact._replace(row=row._replace(reason=str(error)))
            traps.append((row.names, list(_traps_in_measurement(contact, model.opt, speed))))
        elif not row.reason.startswith("not measured"):
            traps.append((row.names, list(_traps_in_measurement(contact, model.opt, speed))))
        examined.append(contact)
    return examined, traps


def _common_measurement(rows: list[MeasuredContact]) -> MeasuredContact | None:
    """Return one of the rows with the mean restitution and duration of all; None if a row is not near the means."""
    numbers = [
        (row.restitution, row.duration) for row in rows if row.restitution is not None and row.duration
    ]
    if not numbers:
        return None
    e, duration = np.mean(numbers, axis=0).tolist()
    if any(abs(each - e) > NEAR_E / 2 or abs(time / duration - 1) > NEAR_K / 2 for each, time in numbers):
        return None
    return rows[0]._replace(restitution=e, duration=duration)


def _add_readings(
    contact: ExaminedContact, option: MujocoOption, speed: float, kept: MeasuredContact, is_first: bool
) -> ExaminedContact:
    """Return a contact with proposals for its parameters: readings of its solref, or advice on its damping ratio.

    `kept` is the measurement of its present behaviour. The advice is the same for all contacts of a group, so only the
    first contact gets it.
    """
    bodies, row = contact.bodies, contact.row
    if min(bodies.solref) > 0:
        if not is_first:
            return contact
        advice = advise_on_ratio(bodies, option, speed, row)
        change = "" if advice is None else describe_ratio(advice, row)
        return contact._replace(advice=advice, row=row._replace(change=change))
    keep, newton_metre = read_direct_numbers(bodies, option, speed, row, kept)
    change = "; or ".join(reading.text for reading in (keep, newton_metre) if reading)
    return contact._replace(keep=keep, newton_metre=newton_metre, row=row._replace(change=change))


def _note_on_joints(bodies: Bodies) -> str:
    """Return a note on how joints change the measured values; ``""`` if they do not."""
    damping = sum(losses.damping for losses in bodies.losses)
    friction = sum(losses.friction for losses in bodies.losses)
    if not (damping or friction):
        return ""
    return (
        f"with the joints' damping of {damping:.4g} N s/m and dry friction of {friction:.4g} N along the normal; the "
        "lighter body moves, and the other one is at rest"
    )


def _traps_in_measurement(contact: ExaminedContact, option: MujocoOption, speed: float) -> Iterator[Trap]:
    """Yield the traps that the measurement of a contact shows."""
    row = contact.row
    if lost := _lost_to_tolerance(contact.bodies, option, speed, row):
        yield Trap("tolerance", lost)
    highest = max(row.restitution_range or (0.0,))
    if highest > 1 + NEGLIGIBLE:
        yield Trap(
            "gains-energy",
            f"the contact gives back more than it took, e is up to {highest:.6g}. Shorten the step, or see the other "
            "traps",
        )
    for reading in (contact.keep, contact.newton_metre):
        if reading is not None and not reading.is_kept:
            yield Trap("unkept", f"{reading.kind}: {reading.problem}")
    if contact.advice is not None and contact.advice.problem:
        yield Trap("unkept", contact.advice.problem)


def _trap_of_long_step(examined: list[ExaminedContact], option: MujocoOption, speed: float) -> list[Trap]:
    """Return the trap of the contact that is shortest for the time step, with drops at a shorter step.

    The list is empty if the step is short enough for all contacts.
    """
    long = find_long_step([contact.row for contact in examined], option.timestep)
    if long is None:
        return []
    bodies = next(contact.bodies for contact in examined if contact.row is long.row)
    steps = format_extremes([long.time / option.timestep])
    depends = (
        f"{long.what} takes {steps} step{'' if steps == '1' else 's'} in the drops. So e depends on where in a step "
        f"the bodies touch: {format_extremes(long.row.restitution_range or ())}"
    )
    step = round_down(long.time / GOOD_STEPS)
    if 0 < bodies.solref[0] < 2 * step and is_lengthened(bodies.solref, option):
        says = f"The time constant is two steps at a step of {step:g} s too (refsafe): write a longer one"
        return [Trap("long-step", f"{depends}. {says}")]
    try:
        row = measure_contact(bodies, option, step, speed)
        says = f"give {format_extremes(row.restitution_range or ())}"
    except RuntimeError as error:
        says = f"were {error}"
    return [Trap("long-step", f"{depends}. At a step of {step:g} s drops {says}")]


def _lost_to_tolerance(bodies: Bodies, option: MujocoOption, speed: float, row: MeasuredContact) -> str:
    """Return a sentence on how the solver's tolerance changes a contact; ``""`` if it does not."""
    if option.tolerance <= 0:
        return ""
    try:
        exact = measure_contact(bodies, option, option.timestep, speed, exact=True)
    except RuntimeError:
        return ""
    if row.restitution_range and exact.restitution_range:
        e_change = np.abs(np.subtract(row.restitution_range, exact.restitution_range)).max()
        is_as_long = row.stays_in_contact and exact.stays_in_contact
        if row.duration and exact.duration:
            is_as_long = abs(row.duration / exact.duration - 1) <= NEGLIGIBLE
        if e_change <= NEGLIGIBLE and is_as_long:
            return ""
    return (
        f"the solver's tolerance of {option.tolerance:g} drops a part of the force: {row.outcome}, but with tolerance "
        f"0 {exact.outcome}. Use tolerance 0"
    )
