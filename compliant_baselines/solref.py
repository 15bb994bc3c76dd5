"""The contact that a solref and a solimp of MuJoCo make between two masses.

For two bodies alone, the engine's equations (chapters "Computation", "Constraint model", and "Solver parameters") give
the relative acceleration

    a = max(0, stiffness (d/dmax)^2 r + damping (d/dmax) r').

Here r is the depth, d = d(r) is the impedance by solimp, and stiffness and damping are those of the direct format. If d
is constant, this is a Kelvin-Voigt contact with k = stiffness M and c = damping M. Otherwise the motion depends on the
speed, and is integrated.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np

from impact_xval.compliant_baselines.asked_contact import LARGEST_DAMPING_RATIO
from impact_xval.compliant_baselines.mapping import (
    MUJOCO_DEFAULT_SOLIMP,
    MUJOCO_IMPEDANCE,
    KelvinVoigtContact,
    MujocoContact,
)
from impact_xval.compliant_baselines.restitution import contact_time, damping_ratio, restitution
from impact_xval.model.arrays import Floats

integrate: Any = import_module("scipy.integrate")  # the package states no types

#: Largest impedance (mjMAXIMP) and smallest width in m (mjMINVAL) that MuJoCo accepts.
LARGEST_IMPEDANCE, LEAST_WIDTH = 0.9999, 1e-15

#: Smallest restitution of a solref that is replaced by an equivalent spring and dashpot.
LEAST_RESTITUTION = restitution(LARGEST_DAMPING_RATIO)

#: Relative error that is allowed for the integration of a contact.
ACCURACY = 1e-9


class ContactMotion(NamedTuple):
    """Restitution, duration and greatest depth of a contact between two bodies alone."""

    restitution: float
    #: Time in s from the first touch to the end of the force.
    duration: float
    #: Greatest depth in m.
    depth: float


def read_solref(solref: Sequence[float], solimp: Sequence[float] = ()) -> MujocoContact:
    """Return the parameters that MuJoCo uses for a solref and a solimp that a user has written.

    Missing numbers of solimp are set to the engine's defaults. Numbers outside the engine's limits are replaced by the
    limits. A ValueError names the field, the value and the legal range.
    """
    written = " ".join(f"{value:g}" for value in solref)
    if len(solref) != 2 or not all(map(math.isfinite, solref)):
        raise ValueError(f"solref = {written}; legal: two finite numbers")
    if (solref[0] > 0) != (solref[1] > 0):
        raise ValueError(
            f"solref = {written}: the engine replaces two signs by its default 0.02 1; legal: a time constant in s "
            "and a damping ratio, both > 0, or -stiffness and -damping, both <= 0"
        )
    if solref[0] == 0:
        raise ValueError(
            f"solref = {written}: a contact without a spring; legal: a first number other than 0"
        )
    text = " ".join(f"{value:g}" for value in solimp)
    if len(solimp) > 5 or not all(map(math.isfinite, solimp)):
        raise ValueError(f"solimp = {text}; legal: up to five finite numbers, dmin dmax width midpoint power")
    dmin, dmax, width, midpoint, power = (*solimp, *MUJOCO_DEFAULT_SOLIMP[len(solimp) :])
    return MujocoContact(
        (solref[0], solref[1]),
        (
            min(max(dmin, MUJOCO_IMPEDANCE), LARGEST_IMPEDANCE),
            min(max(dmax, MUJOCO_IMPEDANCE), LARGEST_IMPEDANCE),
            max(width, LEAST_WIDTH),
            min(max(midpoint, MUJOCO_IMPEDANCE), LARGEST_IMPEDANCE),
            max(power, 1.0),
        ),
    )


def is_linear(pair: MujocoContact) -> bool:
    """Return True if the impedance is the same at every depth. The contact is then a linear spring and dashpot."""
    return pair.solimp[0] == pair.solimp[1]


def contact_of_solref(
    pair: MujocoContact, mass: float, speed: float
) -> tuple[KelvinVoigtContact, ContactMotion]:
    """Return the spring and dashpot that are equivalent to a contact of MuJoCo, and the motion of the contact.

    `mass` is the reduced mass in kg, and `speed` the speed of approach in m/s. If the impedance changes with the depth,
    the equivalent spring and dashpot have the same restitution and duration. A ValueError says that the contact returns
    hardly any of the speed.
    """
    stiffness, damping = (-number for number in pair.direct)
    if is_linear(pair):
        contact = KelvinVoigtContact(stiffness * mass, damping * mass, mass)
        e, duration = contact.restitution, contact.duration
        depth = speed * math.sqrt(e) / contact.omega
        motion = ContactMotion(e, duration, depth)
    else:
        motion = _integrate(pair, stiffness, damping, speed)
        zeta = damping_ratio(min(max(motion.restitution, LEAST_RESTITUTION), 1.0))
        k = mass * (contact_time(zeta) / motion.duration) ** 2
        contact = KelvinVoigtContact(k, 2 * zeta * math.sqrt(k * mass), mass)
    if not motion.restitution >= LEAST_RESTITUTION * (1 - 1e-9):
        raise ValueError(
            f"solref = {pair.solref[0]:g} {pair.solref[1]:g}: the contact returns {motion.restitution:.1g} of the "
            f"speed; legal: at least {LEAST_RESTITUTION:.1g}"
        )
    if not (0 < contact.k < math.inf and contact.c < math.inf):
        raise ValueError(f"solref = {pair.solref[0]:g} {pair.solref[1]:g}: beyond double precision")
    return contact, motion


def _integrate(pair: MujocoContact, stiffness: float, damping: float, speed: float) -> ContactMotion:
    """Integrate the motion of a contact at a speed of approach in m/s. Return restitution, duration and depth."""
    dmax, omega = pair.solimp[1], math.sqrt(stiffness)
    zeta = damping / (2 * omega)

    def force(depth: float, rate: float) -> float:
        share = pair.impedance(depth * speed / omega) / dmax
        return share * (share * depth + 2 * zeta * rate)

    def slope(_: float, state: Floats) -> list[float]:
        return [state[1], -force(state[0], state[1])]

    def ends(_: float, state: Floats) -> float:
        return force(state[0], state[1])

    def turns(_: float, state: Floats) -> float:
        return float(state[1])

    # At the start the force is positive with a dashpot, and 0 without. The contact ends when the force falls to zero.
    ends.terminal, ends.direction = True, -1.0  # type: ignore[attr-defined]
    least = min(pair.solimp[:2]) / dmax
    longest = 100 * (1 + zeta) / least**2
    solution = integrate.solve_ivp(
        slope, (0.0, longest), [0.0, 1.0], "LSODA", events=(ends, turns), rtol=ACCURACY, atol=ACCURACY * 1e-3
    )
    if not solution.t_events[0].size:
        return ContactMotion(0.0, longest / omega, float(np.max(solution.y[0])) * speed / omega)
    depth = float(solution.y_events[1][0][0])
    return ContactMotion(
        restitution=-float(solution.y_events[0][0][1]),
        duration=float(solution.t_events[0][0]) / omega,
        depth=depth * speed / omega,
    )
