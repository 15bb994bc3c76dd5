"""The contacts of a MuJoCo scene measured: two bodies that can touch are dropped and loaded in a scene of their own.

Its two bodies are spheres on vertical slides; a fixed one is a plane. What decides a contact is that of the user's scene:
attributes of the geoms, which the engine combines here as there, or of the <pair>; masses, inverse weights and options.
A sphere has one contact, where a box that lands on a face shares its load among four. A body on joints counts with its
mass in the direction in which it moves most easily.

Dropped, without gravity, at several places of the touch within a step, a contact has a restitution and a duration, their
means. Its stiffness and damping are those of F = max(0, k delta + c delta') with the same two (`restitution`); the
engine's own law may be another one. Loaded, it is at the depth where the engine has no acceleration under the weight of
the lighter body, in the gravity of the scene.
"""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass, replace
from importlib import import_module
from itertools import islice
from typing import Any

import numpy as np

from impact_xval.compliant_baselines.contacts_mujoco import Bodies, bodies
from impact_xval.compliant_baselines.inspect_mujoco import FORCE_LEVEL
from impact_xval.compliant_baselines.mapping import Contact, contact_time, damping_ratio, mujoco_contact

#: Places of the touch within a step, the first two far apart; two are enough for a contact of `LONG` steps.
PLACES = tuple((18 * i % 32 + 1) / 32 for i in range(16))
LONG = 250

#: Contacts that are measured, at most, and steps after which a drop is given up.
MOST_ROWS, MOST_STEPS = 50, 20_000

#: Relative change of a rate that is rounding, and steps without another change after which a contact is over.
ROUNDING, QUIET = 1e-12, 3

#: How far a contact may be from what was meant, in e and of k; the e of a contact that is not to rebound.
NEAR_E, NEAR_K, NO_REBOUND = 0.02, 0.05, 0.01

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


class _LostError(Exception):
    """A contact that cannot be measured."""


def measure_model(model: Any, speed: float = 1.0) -> list[Measured]:
    """Measure the contacts of a compiled model (mujoco.MjModel), one of each combination of parameters and masses.

    The speed at which bodies meet, in m/s, matters to contacts whose impedance depends on the depth.
    """
    alike: dict[Bodies, list[str]] = {}
    for where, pair in bodies(model):
        alike.setdefault(pair, []).append(where)
    rows, gravity = [], float(np.linalg.norm(model.opt.gravity))
    for pair, (first, *others) in islice(alike.items(), MOST_ROWS):
        row = Measured(first + (f" and {len(others)} more" if others else ""), pair.masses)
        try:
            world = _World(pair, model.opt, model.opt.timestep, speed)
            row = replace(row, **world.dropped(), penetration=world.rest(pair.masses[0] * gravity))
            rows.append(replace(row, change=_change(world, row, model.opt)))
        except _LostError as error:
            rows.append(replace(row, reason=str(error)))
    return rows


class _World:
    """Two bodies in MuJoCo; heights are those of the gap between them, the lighter one above."""

    def __init__(self, bodies: Bodies, option: Any, step: float, speed: float) -> None:
        self._mujoco: Any = import_module("mujoco")
        self.bodies, self.step, self.speed = bodies, step, speed
        self._deepest = speed * step * MOST_STEPS  # of a drop that is over in time; the radius of the spheres
        self._model = model = self._compiled()
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
            raise _LostError("the engine makes no contact of two spheres with these parameters")
        self.solref, self.solimp = (tuple(each.tolist()) for each in (data.contact[0].solref, data.contact[0].solimp))
        self._touch = float(data.contact[0].includemargin)

    def _compiled(self) -> Any:
        spec, kinds, slide = self._mujoco.MjSpec(), self._mujoco.mjtGeom, self._mujoco.mjtJoint.mjJNT_SLIDE
        radius, (masses, weights, geoms, pair) = self._deepest, self.bodies
        for name, mass, height, attributes in zip("AB", masses, (radius, -radius), geoms, strict=True):
            body, shape = spec.worldbody, {"type": kinds.mjGEOM_PLANE, "size": (0, 0, 1)}
            if math.isfinite(mass):
                inertial = {"mass": mass, "inertia": (mass, mass, mass), "explicitinertial": True}
                body = spec.worldbody.add_body(name=name, pos=(0, 0, height), **inertial)
                body.add_joint(type=slide, axis=(0, 0, 1))
                shape = {"type": kinds.mjGEOM_SPHERE, "size": (radius, 0, 0)}
            meets = 0 if pair else 1
            body.add_geom(name=name, contype=meets, conaffinity=meets, **shape, **dict(attributes))
        if pair:
            spec.add_pair(geomname1="A", geomname2="B", **dict(pair))
        model = spec.compile()
        model.body_invweight0[1:] = weights[: model.nbody - 1]
        return model

    def _rate(self, values: Any) -> float:
        return float(values[0] - values[1] if self._model.nv == 2 else values[0])

    def dropped(self) -> dict[str, Any]:
        """Drop them, for the fields of `Measured`."""
        drops: list[tuple[float, int]] = []
        while len(drops) < len(PLACES) and not (len(drops) == 2 and min(drops[0][1], drops[1][1]) >= LONG):
            drops.append(self._drop(PLACES[len(drops)]))
        (e, steps), all_e = np.mean(drops, axis=0).tolist(), [e for e, _ in drops]
        duration, found = steps * self.step, {}
        if e > 0:
            zeta, mass = damping_ratio(min(e, 1.0)), self.bodies.mass
            k = mass * (contact_time(zeta) / duration) ** 2
            found = {"stiffness": k, "damping": 2 * zeta * math.sqrt(k * mass)}
        return found | dict(restitution=e, restitution_range=(min(all_e), max(all_e)), duration=duration, steps=steps)

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
        raise _LostError(f"{'not over' if first else 'no force'} within {MOST_STEPS} steps")

    def rest(self, load: float) -> float | None:
        """Depth in m at which a load in N is carried; None if none is, or there is no load."""

        def carried(depth: float) -> bool:
            self._mujoco.mj_resetData(self._model, self._data)
            self._data.qpos[0], self._data.qfrc_applied[:] = self._touch - depth, (-load, load)[: self._model.nv]
            self._mujoco.mj_forward(self._model, self._data)
            return self._rate(self._data.qacc) > 0

        low, high = 0.0, self._deepest
        if not load or not carried(high):
            return None
        while low < (middle := 0.5 * (low + high)) < high:
            low, high = (low, middle) if carried(middle) else (middle, high)
        return high - self._touch


def _change(world: _World, row: Measured, option: Any) -> str:
    """Say what to write where direct numbers were meant in N/m and N s/m, or a damping ratio as a textbook's."""
    (first, second), solimp, pair = world.solref, world.solimp, world.bodies
    first, second, direct, mixed = abs(first), abs(second), first < 0, (first > 0) != (second > 0)
    if not first or not (direct or second) or row.restitution is None:
        return ""
    if direct:
        weight = pair.inverse_weight if solimp[0] <= FORCE_LEVEL and not mixed else 1.0
        meant = Contact(first / weight, second / weight, pair.mass)
        solref, solimp = astuple(mujoco_contact(replace(meant, mass=1 / pair.inverse_weight)))
        asked, longest = f"{meant.k:.4g} N/m and {meant.c:.4g} N s/m", meant.duration / 100
    else:
        e = math.exp(-math.pi * second / math.sqrt(1 - second**2)) if second < 1 else 0.0
        meant = Contact.from_restitution(pair.mass / (first * second) ** 2, max(e, NO_REBOUND), pair.mass)
        solref = 1 / (meant.zeta * meant.omega), meant.zeta
        asked, longest = f"e = {meant.restitution:.2g}", min(meant.duration / 100, solref[0] / 2.2)  # no refsafe
    far = row.stiffness is None or abs(row.stiffness / meant.k - 1) > NEAR_K
    if abs(row.restitution - meant.restitution) <= NEAR_E and not (direct and far):
        return ""
    step = min(world.step, float(f"{longest:.2g}"))
    words = [" ".join(f"{number:.6g}" for number in numbers) for numbers in (solref, solimp)]
    says = f'for {asked}: <pair condim="1" solref="{words[0]}" solimp="{words[1]}"/> and a step of {step:g} s'
    changed = pair._replace(pair=(("solref", solref), ("solimp", solimp), ("condim", 1)))
    try:
        then = _World(changed, option, step, world.speed).dropped()
    except _LostError as error:
        return f"{says}, which was not measured: {error}"
    return f"{says}, which gives e = {then['restitution']:.3g}" + (f" and {then['stiffness']:.4g} N/m" if direct else "")
