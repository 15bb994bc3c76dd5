"""MuJoCo: balls on vertical slides, a scene a batch of one; docs/mapping.md, section 2, gives each setting's reason.

A batch (`mujoco.batch`) records every step in C++ and takes other numbers without a second compilation.
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
      spring="disable" damper="disable" actuation="disable" sensor="disable"/>
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


def _batch(balls: int, table: bool) -> tuple[Any, list[int]]:
    """Compile N balls; a batch of one, and where the engine, which sorts pairs by their geoms, has the contacts."""
    mujoco: Any = import_module("mujoco")  # the names of the compiled module are invisible to a type checker
    model = mujoco.MjModel.from_xml_string(mjcf(balls, table))
    where = [model.pair(str(i)).id for i in range(1, balls + table)]
    return import_module("mujoco.batch").Batch(model, 1, 1), where


@lru_cache(maxsize=1)
def _clock() -> ctypes.c_void_p:
    """Return MuJoCo's pointer to the clock of its profiler, `mjcb_time` of its C interface.

    Reading it takes a third of a step of two balls, and the engine's Python module, which sets it, has no way to
    unset it.
    """
    folder = Path(import_module("mujoco").__file__ or "").parent
    found = [*folder.glob("libmujoco.*"), *folder.glob("mujoco.dll")]
    return ctypes.c_void_p.in_dll(ctypes.CDLL(str(found[0])), "mjcb_time") if found else ctypes.c_void_p()


class Mujoco(Engine):
    """MuJoCo 4.0 or later, in one thread: collisions are shared out to processes further up."""

    name = distribution = "mujoco"
    title, module, way_out = "MuJoCo", "mujoco.batch", "run pip install 'mujoco>=4.0'"
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
        return MujocoWorld(scene, *self._batch(len(scene.masses), scene.table))

    @contextmanager
    def running(self) -> Iterator[None]:
        """Keep warnings from the terminal and the engine's log file, and the clock from its profiler.

        A batch counts warnings all the same.
        """
        mujoco: Any = import_module("mujoco")
        before, clock = mujoco.get_mju_user_warning(), _clock()
        mujoco.set_mju_user_warning(lambda _message: None)
        ticking, clock.value = clock.value, None
        self._batch = lru_cache(_batch)
        try:
            yield
        finally:
            clock.value = ticking
            mujoco.set_mju_user_warning(before)


class MujocoWorld(World):
    """A scene as a batch of one."""

    def __init__(self, scene: Scene, batch: Any, where: list[int]) -> None:
        self.batch = batch
        batch.reset(stage=0)  # nothing is computed before the numbers are written
        balls, (pairs, depth, acceleration) = slice(1, 1 + len(scene.masses)), mapped(scene)
        super().__init__(scene, radius_of(depth), pairs[-1].rest_penetration(scene.gravity))
        for name, at, value in (
            ("geom_size", (balls, 0), self.radius),
            ("geom_rbound", (balls,), self.radius),
            ("body_pos", (balls, 2), self.places),
            ("body_mass", (balls,), scene.masses),
            ("opt.timestep", (), scene.step),
            # Of two measures, an acceleration and its square, the smaller: stops at the second Newton iteration.
            ("opt.tolerance", (), 1e-14 * min(acceleration, acceleration**2)),
            ("opt.gravity", (2,), -scene.gravity),
            ("pair_solref", (where,), [pair.solref for pair in pairs]),
            ("pair_solimp", (where,), [pair.solimp for pair in pairs]),
        ):
            batch.expand(name)[0, *at] = value
        batch.set_const()  # the inverse weights follow the masses
        batch.qpos[0], batch.qvel[0] = self.heights, scene.velocities
        # A pair alone, by the engine's own inverse weights (docs/mapping.md); that of the table, body 0, is 0.
        inverse = batch.expand("body_invweight0")[0][[*range(1, balls.stop), 0], 0]
        solref, solimp = (batch.expand(name)[0][where] for name in ("pair_solref", "pair_solimp"))
        share, masses = solimp[:, 0] / solimp[:, 1], 1 / (inverse[1:] + inverse[:-1])[: len(where)]
        times = solref[:, 0] > 0
        solref[times, 0] = np.maximum(solref[times, 0], 2 * scene.step)  # refsafe
        own = (MujocoContact(tuple(r), tuple(d)) for r, d in zip(solref, solimp, strict=True))
        direct = -np.array([pair.direct for pair in own])
        self.effective = {
            "stiffness": tuple((direct[:, 0] * masses * share**2).tolist()),
            "damping": tuple((direct[:, 1] * masses * share).tolist()),
            "step": (float(batch.expand("opt.timestep")[0]),),
        }

    def advance(self, n: int) -> tuple[Floats, Floats]:
        """Take n steps, recorded in C++."""
        record = self.batch.rollout(n, record=("qvel", "qpos"))
        if self.batch.warning[0, :, 1].any():  # (kind, (last info, count))
            raise RuntimeError(
                f"MuJoCo found positions, velocities or accelerations beyond {LARGEST_VALUE:.0e}"
            )
        return record["qvel"][0], record["qpos"][0]

    def weightless(self, velocities: Floats, heights: Floats) -> None:
        """Go on from a state without gravity."""
        self.batch.qpos[0], self.batch.qvel[0] = heights, velocities
        self.batch.expand("opt.gravity")[0] = 0.0


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
