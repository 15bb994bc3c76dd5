"""Write a MuJoCo scene in which contacts behave as a user may have meant their parameters, and measure it.

This holds for two bodies alone. If a body is in two contacts at once, the new scene behaves otherwise than the original
one, in which each contact's force was wrong (docs/mapping.md, section 9).

The parameters are a solref in the direct format, (-stiffness, -damping). They are called direct numbers below. MuJoCo
itself writes the compiled scene as one file (`mj_saveLastXML`), with includes and frames resolved and with six digits.
Then each contact with direct numbers gets a <pair> in this file. The time step becomes the longest one at which all
these contacts are good. The tolerance becomes 0 if the scene's tolerance changes a contact. Geoms of such a pair that
have no name get one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

from impact_xval.compliant_baselines.engines.mujoco import Mujoco
from impact_xval.compliant_baselines.inspect_mujoco.drops import MeasuredContact, measure_contact
from impact_xval.compliant_baselines.inspect_mujoco.examination import (
    ExaminedGroup,
    examine_groups,
    load_scene,
)
from impact_xval.compliant_baselines.inspect_mujoco.groups import ContactGroup, choose_members, group_contacts
from impact_xval.compliant_baselines.inspect_mujoco.readings import (
    Kind,
    Reading,
    is_as_meant,
    meaning_in_newton_metre,
    write_reading,
)
from impact_xval.compliant_baselines.inspect_mujoco.scene_contacts import (
    MOST_GEOMS,
    Bodies,
    SceneContact,
    find_contacts,
)
from impact_xval.compliant_baselines.mapping import KelvinVoigtContact
from impact_xval.compliant_baselines.restitution import contact_time, damping_ratio

mujoco: Any = import_module("mujoco")  # type checkers do not see the names of the compiled module

#: Attributes that a new <pair> copies from its geoms, because otherwise the scene's defaults for pairs would apply. The
#: margin is the distance at which the force begins. So the gap is 0.
KEPT_PARAMETERS = ("margin", "solreffriction", "adhesion")

#: Largest number of geoms of a scene that can be written.
MOST_GEOMS_TO_FIX = 250


class ContactToWrite(NamedTuple):
    """A contact that gets a new <pair>: the spring and dashpot that a user may have meant, and their parameters."""

    contact: SceneContact
    meant: KelvinVoigtContact
    reading: Reading


class WrittenContact(NamedTuple):
    """A contact that got a new <pair>, with its measurement in the new scene."""

    #: Names of the contacts with these bodies and parameters, in the original scene.
    names: list[str]
    masses: tuple[float, float]
    solref_before: tuple[float, float]
    reading: Reading
    measured: MeasuredContact
    #: True if the drops have the restitution and duration that were meant.
    is_kept: bool


@dataclass(frozen=True)
class FixedScene:
    """A scene that was written with new <pair>s, and the measurements of its contacts."""

    kind: Kind
    written: list[WrittenContact]
    #: Number of <pair>s that were written, and number of geoms that got a name.
    pairs: int
    named_geoms: int
    #: Time step in s in the original scene, and in the written scene.
    step_before: float
    step: float
    zero_tolerance: bool
    #: Number of contacts that got no <pair>.
    unchanged: int
    #: Greatest impedance, in the original scene, of a contact with a body that is in a second contact too; 0 if it is
    #: small, or if there is no such body.
    shared_impedance_before: float

    @property
    def is_kept(self) -> bool:
        """True if all measured contacts have the restitution and duration that were meant, with two bodies alone."""
        return all(contact.is_kept for contact in self.written)


def fix_scene(source: Path, target: Path, kind: Kind, speed: float, geom: str | None = None) -> FixedScene:
    """Write a scene whose contacts behave as a user may have meant their solref, and measure it.

    Parameters
    ----------
    source, target
        The file that is read, and the file that is written.
    kind
        How a solref of -stiffness and -damping is read: ``keep`` for the present behaviour of the contact,
        ``newton-metre`` for N/m and N s/m.
    speed
        Speed in m/s at which bodies are dropped.
    geom
        Name of a geom whose contacts alone are written.

    Raises
    ------
    ValueError
        If MuJoCo refuses the scene, if the scene is too large, or if there is nothing to write.
    """
    model = load_scene(source)
    if model.ngeom > MOST_GEOMS_TO_FIX:
        raise ValueError(f"--fix: {source} has {model.ngeom} geoms; legal: at most {MOST_GEOMS_TO_FIX}")
    examination = examine_groups(model, speed, geom=geom)
    to_write = [one for group in examination.groups for one in _contacts_to_write(model, group, kind)]
    if not to_write:
        raise ValueError(
            f"--fix: no contact of {source} has direct numbers with two readings; nothing is written"
        )
    # The engine writes the model that it compiled last. The drops have compiled other models, so the scene is loaded
    # again.
    load_scene(source)
    mujoco.mj_saveLastXML(str(target), model)
    step = min(model.opt.timestep, min(one.reading.step for one in to_write))
    examined = (contact for contact in examination.contacts)
    readings = [contact.keep if kind == "keep" else contact.newton_metre for contact in examined]
    zero_tolerance = any(reading is not None and reading.zero_tolerance for reading in readings)
    try:
        named = _write_pairs(target, source, model, to_write, step, zero_tolerance)
        written_model = load_scene(target)
    except ValueError:
        target.unlink()
        raise
    contacts = sum(len(group.group.contacts) for group in examination.groups)
    return FixedScene(
        kind=kind,
        written=_measure_written(written_model, to_write, speed),
        pairs=len(to_write),
        named_geoms=named,
        step_before=float(model.opt.timestep),
        step=step,
        zero_tolerance=zero_tolerance,
        unchanged=contacts - len(to_write),
        shared_impedance_before=examination.shared_impedance,
    )


def _contacts_to_write(model: Any, group: ExaminedGroup, kind: Kind) -> list[ContactToWrite]:
    """Return the contacts of a group that get a new <pair>.

    A contact that was not measured gets the parameters of the measured contact that is nearest in mass.
    """
    measured = [contact for contact in group.examined if not contact.row.reason]
    if not measured:
        return []
    contacts = group.group.contacts
    if model.ngeom > MOST_GEOMS:
        parameters = contacts[0].bodies.parameters
        every = group_contacts(find_contacts(model, range(model.ngeom)))
        contacts = next(each.contacts for each in every if each.contacts[0].bodies.parameters == parameters)
    to_write: list[ContactToWrite] = []
    for contact in contacts:
        nearest = min(measured, key=lambda each: abs(math.log(each.bodies.mass / contact.bodies.mass)))
        reading = nearest.keep if kind == "keep" else nearest.newton_metre
        if reading is None:
            continue
        meant = meaning_in_newton_metre(contact.bodies, model.opt, nearest.row.impedances)
        if kind == "keep":
            meant = _contact_with(reading.restitution, reading.duration, contact.bodies)
        to_write.append(ContactToWrite(contact, meant, write_reading(kind, contact.bodies, model.opt, meant)))
    return to_write


def _contact_with(restitution: float, duration: float, bodies: Bodies) -> KelvinVoigtContact:
    """Return the spring and dashpot that give two bodies a restitution and a duration in s."""
    stiffness = bodies.mass * (contact_time(damping_ratio(restitution)) / duration) ** 2
    return KelvinVoigtContact.from_restitution(stiffness, restitution, bodies.mass)


def _write_pairs(
    target: Path,
    source: Path,
    model: Any,
    to_write: Sequence[ContactToWrite],
    step: float,
    zero_tolerance: bool,
) -> int:
    """Write new <pair>s into the file that MuJoCo has saved, and return how many geoms got a name."""
    tree = ElementTree.parse(target)
    root = tree.getroot()
    world = root.find("worldbody")
    geoms = [] if world is None else _geoms_in_order(world)
    names = [model.geom(geom).name for geom in range(model.ngeom)]
    if [element.get("name", "") for element in geoms] != names:
        raise ValueError(
            f"--fix: {source}: MuJoCo writes its geoms in another order; use the <pair>s of --json"
        )
    named = 0
    for number in sorted({geom for one in to_write for geom in one.contact.geoms}):
        if not names[number]:
            names[number] = _free_name(f"geom{number}", names)
            geoms[number].set("name", names[number])
            named += 1
    section = root.find("contact")
    if section is None:
        section = ElementTree.SubElement(root, "contact")
    existing = {frozenset((pair.get("geom1"), pair.get("geom2"))): pair for pair in section.iter("pair")}
    for one in to_write:
        first, second = (names[geom] for geom in one.contact.geoms)
        pair = existing.get(frozenset((first, second)))
        if pair is None:
            numbers = dict(one.contact.bodies.pair)
            pair = ElementTree.SubElement(section, "pair", {"geom1": first, "geom2": second, "gap": "0"})
            for name in KEPT_PARAMETERS:
                if name in numbers:
                    pair.set(name, " ".join(f"{value:.12g}" for value in numbers[name]))
        pair.attrib.update(one.reading.attributes)
        pair.set("solref", " ".join(f"{value:.12g}" for value in one.reading.solref))
    option = root.find("option")
    if option is None:
        option = ElementTree.Element("option")
        root.insert(0, option)
    option.set("timestep", f"{step:.12g}")
    if zero_tolerance:
        option.set("tolerance", "0")
    if source.parent.resolve() != target.parent.resolve():
        _point_to_assets(root, source.parent)
    ElementTree.indent(tree)
    tree.write(target, encoding="unicode")
    return named


def _geoms_in_order(body: ElementTree.Element) -> list[ElementTree.Element]:
    """Return the geoms of a body and of its children in the order of MuJoCo's numbers: first those of the body."""
    geoms = body.findall("geom")
    for child in body.findall("body"):
        geoms += _geoms_in_order(child)
    return geoms


def _free_name(name: str, names: Sequence[str]) -> str:
    """Return a name that no geom has yet."""
    while name in names:
        name += "_"
    return name


def _point_to_assets(root: ElementTree.Element, folder: Path) -> None:
    """Write the full paths of the folders of meshes and textures, because the new file is in another folder."""
    compiler = root.find("compiler")
    if compiler is None:
        compiler = ElementTree.Element("compiler")
        root.insert(0, compiler)
    for key in ("meshdir", "texturedir"):
        compiler.set(key, str((folder / compiler.get(key, "")).resolve()))


def _measure_written(model: Any, to_write: Sequence[ContactToWrite], speed: float) -> list[WrittenContact]:
    """Choose contacts from each group of the original scene, and measure them in the new scene.

    The contacts of a group have equal parameters. Those that differ most in their bodies are chosen (`choose_members`).
    """
    selected = {geom for one in to_write for geom in one.contact.geoms}
    now = {contact.geoms: contact.bodies for contact in find_contacts(model, selected)}
    by_bodies = {one.contact.bodies: one for one in reversed(to_write)}
    written: list[WrittenContact] = []
    with Mujoco().running():
        for group in group_contacts([one.contact for one in to_write]):
            for bodies in choose_members(ContactGroup(group.contacts)):
                one = by_bodies[bodies]
                names = group.members[bodies]
                try:
                    row = measure_contact(now[one.contact.geoms], model.opt, model.opt.timestep, speed)
                except (RuntimeError, KeyError) as error:
                    row = MeasuredContact(names, bodies.masses, reason=f"not measured: {error}")
                written.append(
                    WrittenContact(
                        names, bodies.masses, bodies.solref, one.reading, row, is_as_meant(row, one.meant)
                    )
                )
    return written
