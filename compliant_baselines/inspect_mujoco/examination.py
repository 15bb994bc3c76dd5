"""Measuring the contacts of a MuJoCo scene, and looking for traps."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from impact_xval.compliant_baselines.engines.mujoco import Mujoco
from impact_xval.compliant_baselines.inspect_mujoco.drops import MeasuredContact, measure_contact
from impact_xval.compliant_baselines.inspect_mujoco.proposals import propose_change
from impact_xval.compliant_baselines.inspect_mujoco.scene_contacts import Bodies, read_contacts
from impact_xval.compliant_baselines.inspect_mujoco.traps import (
    Finding,
    Trap,
    gather_findings,
    traps_in_parameters,
)

mujoco: Any = import_module("mujoco")  # the names of the compiled module are invisible to a type checker

#: Most combinations of parameters and masses that are measured.
MOST_ROWS = 50

#: How far restitution may exceed 1, or change with the solver's tolerance (and the duration relatively): at 30 steps
#: in a contact an elastic one is up to 1.1e-3 off.
NEGLIGIBLE = 1.5e-3


def examine(speed: float, scene: Path) -> tuple[list[MeasuredContact], list[Finding]] | str:
    """Measure the contacts of a file, .mjb or MJCF, and look for traps; or say why MuJoCo does not take it."""
    load = mujoco.MjModel.from_binary_path if scene.suffix == ".mjb" else mujoco.MjModel.from_xml_path
    try:
        model = load(str(scene))
        return examine_model(model, speed)
    except Exception as error:  # the engine may raise anything on a scene that it does not expect
        return f"{scene}: MuJoCo does not compile it: {error}"


def examine_model(model: Any, speed: float = 1.0) -> tuple[list[MeasuredContact], list[Finding]]:
    """Measure the contacts of a compiled mujoco.MjModel, and look for traps in parameters and in measurements."""
    examined = _examine_contacts(model, speed)
    measured_traps = gather_findings([(row.names, traps) for row, traps in examined])
    return [row for row, _ in examined], [*inspect_model(model), *measured_traps]


def inspect_model(model: Any) -> list[Finding]:
    """Look for traps in the parameters of a compiled mujoco.MjModel."""
    contacts = read_contacts(model).items()
    return gather_findings([(names, traps_in_parameters(model.opt, bodies)) for bodies, names in contacts])


def measure_model(model: Any, speed: float = 1.0) -> list[MeasuredContact]:
    """Measure the contacts of a compiled mujoco.MjModel, one of each combination of parameters and masses.

    The speed at which bodies meet, in m/s, matters to contacts whose impedance depends on the depth.
    """
    return [row for row, _ in _examine_contacts(model, speed)]


def abbreviate_names(names: list[str]) -> str:
    """Name contacts that have something in common shortly: the first, and the number of others."""
    return names[0] + (f" and {len(names) - 1} more" if len(names) > 1 else "")


def _examine_contacts(model: Any, speed: float) -> list[tuple[MeasuredContact, list[Trap]]]:
    """Measure the contacts of a model; give with each the traps that its measurement shows."""
    examined: list[tuple[MeasuredContact, list[Trap]]] = []
    gravity = float(np.linalg.norm(model.opt.gravity))
    with Mujoco().running():  # without its warnings
        for bodies, names in list(read_contacts(model).items())[:MOST_ROWS]:
            row, unkept = MeasuredContact(names, bodies.masses, note=_note_on_joints(bodies)), ""
            try:
                measured = measure_contact(bodies, model.opt, model.opt.timestep, speed, gravity)
                row = measured._replace(names=names, note=row.note)
                change, unkept = propose_change(bodies, model.opt, speed, row)
                row = row._replace(change=change)
            except Exception as error:  # the engine may raise anything on numbers that it does not take
                row = row._replace(reason=str(error))
            examined.append((row, list(_traps_in_measurement(bodies, model.opt, speed, row, unkept))))
    return examined


def _note_on_joints(bodies: Bodies) -> str:
    """Say what the numbers contain of the joints; empty if there is nothing."""
    damping = sum(losses.damping for losses in bodies.losses)
    friction = sum(losses.friction for losses in bodies.losses)
    if not (damping or friction):
        return ""
    return (
        f"with the joints' damping of {damping:.4g} N s/m and dry friction of {friction:.4g} N along the normal "
        "(damping and frictionloss), while the lighter body moves and the other is met at rest"
    )


def _traps_in_measurement(
    bodies: Bodies, option: Any, speed: float, row: MeasuredContact, unkept: str
) -> Iterator[Trap]:
    """Yield the traps that the measurement of a contact shows; `unkept` is as of `Proposal`."""
    if lost := _lost_to_tolerance(bodies, option, speed, row):
        yield Trap("tolerance", lost)
    highest = max(row.restitution_range or (0.0,))
    if highest > 1 + NEGLIGIBLE:
        yield Trap(
            "gains-energy",
            f"it gives back more than it took, e up to {highest:.6g}: shorten the step, or see the other traps",
        )
    if unkept:
        yield Trap("unkept", unkept)


def _lost_to_tolerance(bodies: Bodies, option: Any, speed: float, row: MeasuredContact) -> str:
    """Say what the solver's tolerance takes from a contact; empty if it takes nothing."""
    if option.tolerance <= 0:
        return ""
    try:
        exact = measure_contact(bodies, option, option.timestep, speed, exact=True)
    except RuntimeError:
        return ""
    if row.restitution_range and exact.restitution_range and row.duration and exact.duration:
        e_change = np.abs(np.subtract(row.restitution_range, exact.restitution_range)).max()
        if e_change <= NEGLIGIBLE and abs(row.duration / exact.duration - 1) <= NEGLIGIBLE:
            return ""
    contact = "is not over"
    if row.restitution is not None:
        contact = f"has e = {row.restitution:.4g} in {row.duration:.3g} s"
    return (
        f"the solver stops at {option.tolerance:g} of an absolute measure, over the inertia of the bodies: this "
        f"contact {contact}, and with tolerance 0 e = {exact.restitution:.4g} in {exact.duration:.3g} s; use "
        "tolerance 0"
    )
