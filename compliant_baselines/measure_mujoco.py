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
from typing import Any

import numpy as np

from impact_xval.compliant_baselines.contacts_mujoco import Bodies, alone, bodies
from impact_xval.compliant_baselines.engines.mujoco import Mujoco
from impact_xval.compliant_baselines.inspect_mujoco import meant
from impact_xval.compliant_baselines.mapping import contact_time, damping_ratio

#: Places of the touch within a step, the first two far apart; two are enough for a contact of `LONG` steps.
PLACES = tuple((18 * i % 32 + 1) / 32 for i in range(16))
LONG = 250

#: Contacts that are measured, at most, and steps after which a drop is given up.
MOST_ROWS, MOST_STEPS = 50, 20_000

#: Relative change of a rate that is rounding, and steps without another change after which a contact is over.
ROUNDING, QUIET = 1e-12, 3

#: How far a contact may be from what was meant, in restitution and relatively in stiffness.
NEAR_E, NEAR_K = 0.02, 0.05

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
    alike: dict[Bodies, list[str]] = {}
    for where, pair in bodies(model):
        alike.setdefault(pair, []).append(where)
    rows, gravity = [], float(np.linalg.norm(model.opt.gravity))
    with Mujoco().running():  # without its warnings
        for pair, (first, *others) in islice(alike.items(), MOST_ROWS):
            row = Measured(first + (f" and {len(others)} more" if others else ""), pair.masses)
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
            self._data.qpos[0], self._data.qfrc_applied[:] = (
                self._touch - depth,
                (-load, load)[: self._model.nv],
            )
            self._mujoco.mj_forward(self._model, self._data)
            return self._rate(self._data.qacc) > 0

        low, high = 0.0, self._deepest
        if not load or not carried(high):
            return None
        while low < (middle := 0.5 * (low + high)) < high:
            low, high = (low, middle) if carried(middle) else (middle, high)
        return high - self._touch


def _change(world: _World, row: Measured, option: Any) -> str:
    """Say what to write for what was probably meant, and what that does; nothing where the contact is near it."""
    wanted = meant(world.solref, world.solimp, world.bodies)
    if wanted is None or row.restitution_range is None:
        return ""
    off = max(abs(e - wanted.contact.restitution) for e in row.restitution_range)
    soft = row.stiffness is None or abs(row.stiffness / wanted.contact.k - 1) > NEAR_K
    if off <= NEAR_E and not (wanted.direct and soft):
        return ""
    step = min(world.step, wanted.longest_step)
    changed = world.bodies._replace(pair=wanted.pair)
    try:
        then = _World(changed, option, step, world.speed).dropped()
    except RuntimeError as error:
        return f"{wanted} and a step of {step:g} s, which was not measured: {error}"
    k = then.get("stiffness", math.nan)
    return f"{wanted} and a step of {step:g} s, which gives e = {then['restitution']:.3g} and {k:.4g} N/m"
