"""MuJoCo: balls on vertical slides; docs/mapping.md, section 2, gives the reason of each setting.

`mujoco.rollout` takes many steps in C++ and records each of them; it is in all versions from 3.2.7 on. A scene is
compiled once for each number of balls, and the numbers of a collision are written into the arrays of that model.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from impact_xval.compliant_baselines.engines.engine import BEYOND, Engine
from impact_xval.compliant_baselines.engines.scene import Floats, Scene, World, radius_of, reduced_masses
from impact_xval.compliant_baselines.mapping import (
    MUJOCO_DEFAULT_SOLIMP,
    MUJOCO_DEFAULT_SOLREF,
    MUJOCO_IMPEDANCE,
    MujocoContact,
    mujoco_contact,
)

#: Largest position, velocity and acceleration the engine accepts, in SI units (mjMAXVAL of mjtype.h).
LARGEST_VALUE = 1e10

#: Stages that have nothing to do in such a scene are off: they take 6 % of a step.
SCENE = """
<mujoco model="column">
  <option integrator="Euler" solver="Newton" iterations="100" gravity="0 0 0">
    <flag autoreset="disable" island="disable" equality="disable" frictionloss="disable" limit="disable"
      actuation="disable" sensor="disable"/>
  </option>
  <worldbody>
    <geom name="table" type="plane" size="0 0 1" contype="0" conaffinity="0"/>{bodies}
  </worldbody>
  <contact>{pairs}
  </contact>
</mujoco>
"""
BODY = """
    <body name="{name}" pos="0 0 {z}">
      <joint name="{name}" type="slide" axis="0 0 1"/>
      <geom name="{name}" type="sphere" size="1" mass="1" contype="0" conaffinity="0"/>
    </body>"""
PAIR = """
    <pair name="{i}" geom1="{upper}" geom2="{lower}" condim="1" solref="-1 -0"/>"""


def mjcf(balls: int, table: bool) -> str:
    """Write the scene of N balls of 1 kg and 1 m, numbers to be replaced by those of a `Scene`; contacts by number."""
    names = [f"B{i}" for i in range(1, balls + 1)]
    bodies = (BODY.format(name=name, z=2 * (balls - i) - 1) for i, name in enumerate(names))
    met = enumerate(pairwise([*names, "table"] if table else names), 1)
    pairs = (PAIR.format(i=i, upper=upper, lower=lower) for i, (upper, lower) in met)
    return SCENE.format(bodies="".join(bodies), pairs="".join(pairs))


class _Compiled:
    """Balls that MuJoCo has compiled, their numbers still to be written.

    Attributes
    ----------
    model
        `MjModel`.
    data
        `MjData` of the model.
    pairs
        Indices of the contacts from the top down; the engine sorts pairs by their geoms.
    """

    def __init__(self, balls: int, table: bool) -> None:
        mujoco: Any = import_module("mujoco")  # a type checker does not see the names of the compiled module
        self.model = mujoco.MjModel.from_xml_string(mjcf(balls, table))
        self.data = mujoco.MjData(self.model)
        self.pairs = [self.model.pair(str(i)).id for i in range(1, balls + table)]


@lru_cache(maxsize=1)
def _clock() -> ctypes.c_void_p:
    """Return MuJoCo's pointer to the clock of its profiler, `mjcb_time` of its C interface.

    Reading it takes a third of a step of two balls, and the engine's Python module, which sets it, has no way to
    unset it.
    """
    folder = Path(import_module("mujoco").__file__ or "").parent
    found = [*folder.glob("libmujoco.*"), *folder.glob("mujoco.dll")]
    return ctypes.c_void_p.in_dll(ctypes.CDLL(str(found[0])), "mjcb_time") if found else ctypes.c_void_p()


def rolled_out(model: Any, data: Any, n: int) -> tuple[Floats, Floats]:
    """Take n steps from the state of an `MjData`, recorded in C++; a RuntimeError says that the engine broke.

    Returns positions in m and velocities in m/s after each step, shape (n, bodies) each, of bodies on slides, whose
    state is the time, the positions and the velocities.
    """
    mujoco: Any = import_module("mujoco")
    full = mujoco.mjtState.mjSTATE_FULLPHYSICS.value
    state = np.empty(mujoco.mj_stateSize(model, full))
    mujoco.mj_getState(model, data, state, full)
    # Without a warm start of its own `rollout` begins each call from none, and windows of steps would show.
    warm = np.array(data.qacc_warmstart)
    (states,), _ = import_module("mujoco.rollout").rollout(
        model, data, state, nstep=n, initial_warmstart=warm
    )
    if data.warning.number.any():
        raise RuntimeError(f"MuJoCo found positions, velocities or accelerations beyond {LARGEST_VALUE:.0e}")
    return states[:, 1 : 1 + model.nq], states[:, 1 + model.nq :]


class Mujoco(Engine):
    """MuJoCo 3.2.7 or later, in one thread: collisions are shared out to processes further up."""

    name = distribution = "mujoco"
    title, module, way_out = "MuJoCo", "mujoco.rollout", "run pip install 'mujoco>=3.2.7'"
    oldest = "3.2.7"  # `rollout` took other arguments before
    regularisation_probe = 10.0
    shipped_step = 0.002

    def refusal(self, scene: Scene) -> str | None:
        """Why MuJoCo cannot take a scene: accelerations beyond what it accepts, no damping where it takes a ratio."""
        if scene.mapping == "documented" and 1 in scene.restitutions:
            where = scene.restitutions.index(1) + 1
            return f"e{where} = 1: no time constant and damping ratio are undamped; legal: below 1"
        _, depth, acceleration = mapped(scene)
        if acceleration <= LARGEST_VALUE:
            return None if depth > 0 else BEYOND
        return (
            f"accelerations about |v0| sqrt(k/M) = {acceleration:.3g} m/s^2: "
            f"MuJoCo accepts {LARGEST_VALUE:.0e}; scale stiffnesses, masses or v0 (Theorem 5)"
        )

    def radius(self, scene: Scene) -> float:
        """As `Engine.radius`."""
        return radius_of(mapped(scene)[1])

    def world(self, scene: Scene) -> MujocoWorld:
        """Set a scene up."""
        return MujocoWorld(scene, self._compiled(len(scene.masses), scene.table))

    @contextmanager
    def running(self) -> Iterator[None]:
        """Keep warnings from the terminal and the engine's log file, and the clock from its profiler.

        `MjData` counts warnings all the same.
        """
        mujoco: Any = import_module("mujoco")
        before, clock = mujoco.get_mju_user_warning(), _clock()
        mujoco.set_mju_user_warning(lambda _message: None)
        ticking, clock.value = clock.value, None
        self._compiled = lru_cache(_Compiled)
        try:
            yield
        finally:
            clock.value = ticking
            mujoco.set_mju_user_warning(before)


class MujocoWorld(World):
    """A scene in a compiled model, which the world before it has left."""

    def __init__(self, scene: Scene, compiled: _Compiled) -> None:
        mujoco: Any = import_module("mujoco")
        model, contacts = compiled.model, compiled.pairs
        self.model, self._data = model, compiled.data
        balls, (pairs, depth, acceleration) = slice(1, 1 + len(scene.masses)), mapped(scene)
        super().__init__(scene, radius_of(depth), pairs[-1].rest_penetration(scene.gravity))
        model.geom_size[balls, 0] = self.radius
        model.geom_rbound[balls] = self.radius
        model.body_pos[balls, 2] = self.places
        model.body_mass[balls] = scene.masses
        model.opt.timestep = scene.step
        # Of two measures, an acceleration and its square, the smaller: stops at the second Newton iteration.
        model.opt.tolerance = 1e-14 * min(acceleration, acceleration**2)
        model.opt.gravity[2] = -scene.gravity
        model.pair_solref[contacts] = [pair.solref for pair in pairs]
        model.pair_solimp[contacts] = [pair.solimp for pair in pairs]
        mujoco.mj_setConst(model, self._data)  # the inverse weights follow the masses
        mujoco.mj_resetData(model, self._data)
        self._data.qpos[:], self._data.qvel[:] = self.heights, scene.velocities
        # A pair alone, by the engine's own inverse weights (docs/mapping.md); that of the table, body 0, is 0.
        inverse = model.body_invweight0[[*range(1, balls.stop), 0], 0]
        solref, solimp = model.pair_solref[contacts], model.pair_solimp[contacts]
        share, masses = solimp[:, 0] / solimp[:, 1], 1 / (inverse[1:] + inverse[:-1])[: len(contacts)]
        times = solref[:, 0] > 0
        solref[times, 0] = np.maximum(solref[times, 0], 2 * scene.step)  # refsafe
        own = (MujocoContact(tuple(r), tuple(d)) for r, d in zip(solref, solimp, strict=True))
        direct = -np.array([pair.direct for pair in own])
        self.effective = {
            "stiffness": tuple((direct[:, 0] * masses * share**2).tolist()),
            "damping": tuple((direct[:, 1] * masses * share).tolist()),
            "step": (float(model.opt.timestep),),
        }

    def advance(self, n: int) -> tuple[Floats, Floats]:
        """Take n steps, recorded in C++."""
        heights, velocities = rolled_out(self.model, self._data, n)
        return velocities, heights

    def weightless(self, velocities: Floats, heights: Floats) -> None:
        """Go on from a state without gravity."""
        self._data.qpos[:], self._data.qvel[:] = heights, velocities
        self.model.opt.gravity[2] = 0.0


def mapped(scene: Scene) -> tuple[list[MujocoContact], float, float]:
    """Map the contacts; how deep they go in m, and the largest acceleration in m/s^2, of a pair that meets alone."""
    impedance = scene.regularisation * MUJOCO_IMPEDANCE
    if scene.mapping == "shipped":
        pairs = [MujocoContact(MUJOCO_DEFAULT_SOLREF, MUJOCO_DEFAULT_SOLIMP)] * len(scene.stiffnesses)
    else:
        pairs = [mujoco_contact(contact, scene.mapping, impedance) for contact in scene.contacts]
    alone = zip(pairs, reduced_masses(scene), strict=True)
    depth = scene.depth([pair.stiffness(mass) for pair, mass in alone])
    return pairs, depth, scene.fastest * math.sqrt(max(-pair.direct[0] for pair in pairs)) + scene.gravity
