"""The contacts of a MuJoCo scene measured: two bodies that can touch are dropped and loaded in a scene of their own.

Dropped, without gravity, at several places of the touch within a step, a contact has a mean restitution and duration.
Its stiffness and damping are those of F = max(0, k delta + c delta') with the same two (`restitution`); the
engine's own law may be another. Loaded, it is at the depth where the engine has no acceleration under the weight of the
lighter body, in the gravity of the scene.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from importlib import import_module
from itertools import islice
from typing import Any, NamedTuple

import numpy as np

from impact_xval.compliant_baselines.contacts_mujoco import Bodies, alone, called, contacts
from impact_xval.compliant_baselines.engines.mujoco import Mujoco
from impact_xval.compliant_baselines.inspect_mujoco import FORCE_LEVEL
from impact_xval.compliant_baselines.mapping import Contact, contact_time, damping_ratio, mujoco_contact

#: Places of the touch within a step, the first two far apart; two are enough for a contact of `LONG` steps.
PLACES = tuple((18 * i % 32 + 1) / 32 for i in range(16))
LONG = 250

#: Contacts that are measured, at most, and steps after which a drop is given up.
MOST_ROWS, MOST_STEPS = 50, 20_000

#: Relative change of a rate that is rounding, and steps without another change after which a contact is over.
ROUNDING, QUIET = 1e-12, 3

#: How far a contact may be from what was meant, in restitution and relatively in stiffness.
NEAR_E, NEAR_K = 0.02, 0.05

#: Restitution of a contact that is not to rebound: no finite damping gives 0.
NO_REBOUND = 0.01

#: Options that decide no contact.
_NO_CONTACTS = ("gravity", "wind", "magnetic", "density", "viscosity", "timestep")


@dataclass(frozen=True, slots=True)
class Measured:
    """A contact in SI units, masses in kg (inf: fixed); None where `reason` says why, penetration without gravity too.

    `change` says what to write for what was probably meant, and what that was measured to give; empty if it is there.
    """

    where: str
    masses: tuple[float, float]
    restitution: float | None = None
    restitution_range: tuple[float, float] | None = None
    duration: float | None = None
    steps: float | None = None
    stiffness: float | None = None
    damping: float | None = None
    penetration: float | None = None
    change: str = ""
    reason: str = ""


def measure_model(model: Any, speed: float = 1.0) -> list[Measured]:
    """Measure the contacts of a compiled model (mujoco.MjModel), one of each combination of parameters and masses.

    The speed at which bodies meet, in m/s, matters to contacts whose impedance depends on the depth.
    """
    rows, gravity = [], float(np.linalg.norm(model.opt.gravity))
    with Mujoco().running():  # without its warnings
        for pair, where in islice(contacts(model).items(), MOST_ROWS):
            row = Measured(called(where), pair.masses)
            try:
                world = _World(pair, model.opt, model.opt.timestep, speed)
                row = replace(row, **world.dropped(), penetration=world.rest(pair.masses[0] * gravity))
                rows.append(replace(row, change=_change(world, row, model.opt)))
            except Exception as error:  # of an engine that takes other numbers than these
                rows.append(replace(row, reason=str(error)))
    return rows


class _World:
    """Two bodies in MuJoCo; heights are those of the gap between them, the lighter one above."""

    def __init__(self, bodies: Bodies, option: Any, step: float, speed: float) -> None:
        self._mujoco: Any = import_module("mujoco")
        self.bodies, self.step, self.speed = bodies, step, speed
        self._deepest = speed * step * MOST_STEPS  # of a drop that is over in time; the radius of the spheres
        self._model = model = alone(bodies, self._deepest)
        for name in (name for name in dir(option) if not name.startswith("_") and name not in _NO_CONTACTS):
            setattr(model.opt, name, getattr(option, name))
        model.opt.timestep, model.opt.gravity = step, np.zeros(3)
        # A run that goes wrong does not start again, and a slow body does not sleep.
        model.opt.disableflags |= int(self._mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        model.opt.enableflags &= ~int(self._mujoco.mjtEnableBit.mjENBL_SLEEP)
        self._data = data = self._mujoco.MjData(model)
        data.qpos[0] = -0.5 * self._deepest
        self._mujoco.mj_forward(model, data)
        if not data.ncon:
            raise RuntimeError("the engine makes no contact of two spheres with these parameters")
        contact = data.contact[0]  # as the engine has combined it
        self.solref, self.solimp = tuple(contact.solref.tolist()), tuple(contact.solimp.tolist())
        self._touch = float(contact.includemargin)

    def _rate(self, values: Any) -> float:
        return float(values[0] - values[1] if self._model.nv == 2 else values[0])

    def dropped(self) -> dict[str, Any]:
        """Drop them, for the fields of `Measured`."""
        drops: list[tuple[float, int]] = []
        while len(drops) < len(PLACES) and not (len(drops) == 2 and min(drops[0][1], drops[1][1]) >= LONG):
            drops.append(self._drop(PLACES[len(drops)]))
        e, steps = np.mean(drops, axis=0).tolist()
        found = {"restitution": e, "restitution_range": (min(drops)[0], max(drops)[0])}
        found |= {"duration": steps * self.step, "steps": steps}
        if e > 0:
            zeta, mass = damping_ratio(min(e, 1.0)), self.bodies.mass
            k = mass * (contact_time(zeta) / found["duration"]) ** 2
            found |= {"stiffness": k, "damping": 2 * zeta * math.sqrt(k * mass)}
        return found

    def _drop(self, place: float) -> tuple[float, int]:
        """Restitution, and steps from the first to the last change of the rate; a place from 0 to 1 within a step."""
        model, data, mj_step = self._model, self._data, self._mujoco.mj_step
        self._mujoco.mj_resetData(model, data)
        data.qpos[0], data.qvel[0] = self._touch + place * self.speed * self.step, -self.speed
        before, first, last, rounding = -self.speed, 0, 0, ROUNDING * self.speed
        for n in range(1, MOST_STEPS + 1):
            mj_step(model, data)
            rate = self._rate(data.qvel)
            if abs(rate - before) > rounding:
                first, last = first or n, n
            elif first and n - last >= QUIET and rate >= -rounding:
                return max(rate, 0.0) / self.speed, last - first + 1
            before = rate
        raise RuntimeError(f"{'not over' if first else 'no force'} within {MOST_STEPS} steps")

    def rest(self, load: float) -> float | None:
        """Depth in m at which a load in N is carried; None if none is, or there is no load."""

        def carried(depth: float) -> bool:
            self._mujoco.mj_resetData(self._model, self._data)
            self._data.qpos[0] = self._touch - depth
            self._data.qfrc_applied[:] = (-load, load)[: self._model.nv]
            self._mujoco.mj_forward(self._model, self._data)
            return self._rate(self._data.qacc) > 0

        low, high = 0.0, self._deepest
        if not load or not carried(high):
            return None
        while low < (middle := 0.5 * (low + high)) < high:
            low, high = (low, middle) if carried(middle) else (middle, high)
        return high - self._touch


class _Meant(NamedTuple):
    """What was probably meant by a solref, whether that was direct, and the numbers that give it in a <pair>."""

    contact: Contact
    direct: bool
    solref: tuple[float, float]
    solimp: tuple[float, ...]

    def __str__(self) -> str:
        c = self.contact
        asked = f"{c.k:.4g} N/m and {c.c:.4g} N s/m" if self.direct else f"e = {c.restitution:.2g}"
        if c.restitution < 1.01 * NO_REBOUND and not self.direct:
            asked = f"no rebound ({asked})"
        words = (" ".join(f"{number:.6g}" for number in numbers) for numbers in (self.solref, self.solimp))
        return 'for {}: <pair condim="1" solref="{}" solimp="{}"/>'.format(asked, *words)


def _meant(solref: tuple[float, float], solimp: tuple[float, ...], bodies: Bodies) -> _Meant | None:
    """Guess what was meant: direct numbers in N/m and N s/m, or a damping ratio as in textbooks; None if neither.

    Direct numbers at the level of forces are taken for what they are. A textbook's contact may pull, and has no rebound
    from a ratio of 1 on.
    """
    first, second = map(abs, solref)
    if solref[0] < 0:
        forces = solimp[0] <= FORCE_LEVEL and solref[1] <= 0
        weight = bodies.inverse_weight if forces else 1.0
        contact = Contact(first / weight, second / weight, bodies.mass)
        own = mujoco_contact(replace(contact, mass=1 / bodies.inverse_weight))
        return _Meant(contact, True, own.solref, own.solimp)
    if not first or not second:
        return None
    e = math.exp(-math.pi * second / math.sqrt(1 - second**2)) if second < 1 else 0.0
    contact = Contact.from_restitution(bodies.mass / (first * second) ** 2, max(e, NO_REBOUND), bodies.mass)
    return _Meant(contact, False, (1 / (contact.zeta * contact.omega), contact.zeta), solimp)


def _change(world: _World, row: Measured, option: Any) -> str:
    """Say what to write for what was probably meant, and what that does; nothing where the contact is near it."""
    wanted = _meant(world.solref, world.solimp, world.bodies)
    if wanted is None or row.restitution_range is None:
        return ""
    off = max(abs(e - wanted.contact.restitution) for e in row.restitution_range)
    soft = row.stiffness is None or abs(row.stiffness / wanted.contact.k - 1) > NEAR_K
    if off <= NEAR_E and not (wanted.direct and soft):
        return ""
    # A hundredth of the contact, and short enough for refsafe to leave a time constant as it is.
    safe = math.inf if wanted.direct else wanted.solref[0] / 2.2
    step = min(world.step, float(f"{min(wanted.contact.duration / 100, safe):.2g}"))
    pair = ("solref", wanted.solref), ("solimp", wanted.solimp), ("condim", 1)
    try:
        then = _World(world.bodies._replace(pair=pair), option, step, world.speed).dropped()
    except RuntimeError as error:
        return f"{wanted} and a step of {step:g} s, which was not measured: {error}"
    k = then.get("stiffness", math.nan)
    return f"{wanted} and a step of {step:g} s, which gives e = {then['restitution']:.3g} and {k:.4g} N/m"
