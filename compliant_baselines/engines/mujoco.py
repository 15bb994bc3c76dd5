"""MuJoCo: balls on vertical slides.

Set-up, and why:

* Contacts are `condim="1"` **pairs**, which carry their parameters themselves; the geoms have contype =
  conaffinity = 0, so that nothing is mixed. The compiler sorts pairs by their geoms: they are found by name,
  never by their place in the file.
* Integrator Euler (semi-implicit; refsafe leaves the direct format alone under it). Forces are explicit:
  those of the heights and velocities before the step.
* The tolerance of the Newton solver goes with the collision, see `_tolerance`: the default of 1e-8 is an
  absolute number, and costs 5e-5 in velocity where accelerations are small (k = 1e-6 N/m).
* No autoreset: what the engine finds beyond its limits (mjMAXVAL, 1e10 in any of qpos, qvel, qacc) ends the
  run and becomes its status, where the default would silently start it over. The engine's warning about it is
  kept from the terminal and from the file MUJOCO_LOG.TXT that it would leave in the working directory.
* No islands: the search for independent groups of constraints costs a tenth of a step and changes no bit here.
* Everything is in SI units as asked; only the balls' radius is ours (`radius_of`), since contacts of spheres
  in one dimension do not depend on it. Mass, not inertia, is what moves on a slide.
* A batch of one (`mujoco.batch`) records every step in C++ and takes other numbers without a second compilation.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from importlib import import_module
from itertools import pairwise
from typing import Any

from impact_xval.compliant_baselines.engines.engine import Engine
from impact_xval.compliant_baselines.engines.packages import why_not
from impact_xval.compliant_baselines.engines.scene import BEYOND, Floats, Scene, radius_of, reduced_masses
from impact_xval.compliant_baselines.engines.world import World
from impact_xval.compliant_baselines.mapping import MUJOCO_IMPEDANCE, MujocoContact, mujoco_contact

#: Largest position, velocity and acceleration the engine accepts, in SI units (mjMAXVAL of mjtype.h).
LARGEST_VALUE = 1e10

#: Balls are the joints in their order, B1 first: so come velocities and heights.
SCENE = """
<mujoco model="column">
  <option integrator="Euler" solver="Newton" iterations="100" gravity="0 0 0">
    <flag autoreset="disable" island="disable"/>
  </option>
  <worldbody>
    <geom name="table" type="plane" size="0 0 1" contype="0" conaffinity="0"/>{bodies}
  </worldbody>
  <contact>{pairs}
  </contact>
</mujoco>
"""

BODY = """
    <body name="B{i}" pos="0 0 {z}">
      <joint name="B{i}" type="slide" axis="0 0 1"/>
      <geom name="B{i}" type="sphere" size="1" mass="1" contype="0" conaffinity="0"/>
    </body>"""

PAIR = """
    <pair name="{upper}-{lower}" geom1="{upper}" geom2="{lower}" condim="1" solref="-1 -0"/>"""


def mjcf(balls: int, table: bool) -> str:
    """Write the scene of N balls of 1 kg and 1 m, with numbers to be replaced by those of a `Scene`."""
    geoms = [*(f"B{i}" for i in range(1, balls + 1)), *(["table"] if table else [])]
    bodies = "".join(BODY.format(i=i, z=2 * (balls - i) + 1) for i in range(1, balls + 1))
    pairs = "".join(PAIR.format(upper=upper, lower=lower) for upper, lower in pairwise(geoms))
    return SCENE.format(bodies=bodies, pairs=pairs)


@lru_cache(maxsize=16)
def _compiled(balls: int, table: bool) -> tuple[Any, dict[str, list[int]]]:
    """Compile the scene of N balls; it, and where in its arrays balls and contacts are."""
    # The names of the compiled module are invisible to a type checker.
    mujoco: Any = import_module("mujoco")
    model = mujoco.MjModel.from_xml_string(mjcf(balls, table))
    names = [*(f"B{i}" for i in range(1, balls + 1)), *(["table"] if table else [])]
    pairs = [model.pair(f"{upper}-{lower}").id for upper, lower in pairwise(names)]
    bodies = [model.body(name).id if name != "table" else 0 for name in names]
    return model, {"pair": pairs, "body": bodies, "geom": [model.geom(name).id for name in names[:balls]]}


class Mujoco(Engine):
    """MuJoCo 4.0 or later, in one thread: collisions are shared out to processes further up."""

    name = "mujoco"
    distribution = "mujoco"
    regularisation_probe = 10.0

    def unavailable(self) -> str | None:
        """Why MuJoCo cannot run here and the way out; None if it can."""
        way_out = "run pip install 'mujoco>=4.0'"
        return why_not("MuJoCo", self.distribution, lambda: import_module("mujoco.batch"), way_out)

    def refusal(self, scene: Scene) -> str | None:
        """Why MuJoCo cannot take a scene: accelerations beyond what it accepts."""
        pairs = pairs_of(scene)
        largest = _acceleration(scene, pairs)
        if largest > LARGEST_VALUE:
            return (
                f"accelerations about |v0| sqrt(k/M) = {largest:.3g} m/s^2: "
                f"MuJoCo accepts {LARGEST_VALUE:.0e}; scale stiffnesses, masses or v0 (Theorem 5)"
            )
        return None if _depth(scene, pairs) > 0 else BEYOND

    def world(self, scene: Scene) -> MujocoWorld:
        """Set a scene up."""
        return MujocoWorld(scene)

    @contextmanager
    def running(self) -> Iterator[None]:
        """Keep the engine's warnings from the terminal and its log file; a batch counts them all the same."""
        mujoco: Any = import_module("mujoco")
        before = mujoco.get_mju_user_warning()
        mujoco.set_mju_user_warning(lambda _message: None)
        try:
            yield
        finally:
            mujoco.set_mju_user_warning(before)


class NaiveMujoco(Mujoco):
    """MuJoCo with k and c written into a direct-format solref as N/m and N s/m, under the default solimp.

    It breaks Theorem 5: the default solimp has a width in metres, and k in N/m is read as 1/s^2, so that the outcome
    depends on the scale of k and m.
    """

    name = "mujoco-naive"


class MujocoWorld(World):
    """A scene as a batch of one."""

    def __init__(self, scene: Scene) -> None:
        from mujoco.batch import Batch

        model, self._where = _compiled(len(scene.masses), scene.table)
        self.batch: Any = Batch(model, 1, 1)
        pairs = pairs_of(scene)
        radius = radius_of(_depth(scene, pairs))
        self._write(scene, pairs, radius)
        if scene.settled:
            self.rest = pairs[-1].rest_penetration(scene.gravity)
        self.heights = scene.start(radius, self.rest)
        self.batch.qpos[0], self.batch.qvel[0] = self.heights, scene.velocities
        self.effective = self._effective()

    def _write(self, scene: Scene, pairs: list[MujocoContact], radius: float) -> None:
        where, expand = self._where, self.batch.expand
        bodies = where["body"][: len(scene.masses)]
        expand("geom_size")[0, where["geom"], 0] = radius
        expand("geom_rbound")[0, where["geom"]] = radius
        expand("body_pos")[0, bodies, 2] = scene.places(radius)
        expand("body_mass")[0, bodies] = scene.masses
        expand("opt.timestep")[0] = scene.step
        expand("opt.tolerance")[0] = _tolerance(_acceleration(scene, pairs))
        expand("opt.gravity")[0, 2] = -scene.gravity
        expand("pair_solref")[0, where["pair"]] = [pair.solref for pair in pairs]
        expand("pair_solimp")[0, where["pair"]] = [pair.solimp for pair in pairs]
        self.batch.set_const()  # the inverse weights follow the masses

    def _effective(self) -> dict[str, tuple[float, ...]]:
        """Stiffness and damping of a pair alone, from the engine's own inverse weights (its "Constraint model")."""
        inverse = self.batch.expand("body_invweight0")[0, self._where["body"], 0]
        solref, solimp = (
            self.batch.expand(f"pair_{n}")[0, self._where["pair"]] for n in ("solref", "solimp")
        )
        scale = (solimp[:, 0] / solimp[:, 1]) ** 2 / (inverse[1:] + inverse[:-1])[: len(solref)]
        return {
            "stiffness": tuple((-solref[:, 0] * scale).tolist()),
            "damping": tuple((-solref[:, 1] * scale).tolist()),
            "step": (float(self.batch.expand("opt.timestep")[0]),),
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


def pairs_of(scene: Scene) -> list[MujocoContact]:
    """Map the contacts to the engine's parameters."""
    impedance = scene.regularisation * MUJOCO_IMPEDANCE
    return [mujoco_contact(contact, scene.mapping, impedance) for contact in scene.contacts]


def _depth(scene: Scene, pairs: list[MujocoContact]) -> float:
    """How deep the contacts go in m, at most."""
    masses = reduced_masses(scene)
    return scene.depth([pair.stiffness(mass) for pair, mass in zip(pairs, masses, strict=True)])


def _acceleration(scene: Scene, pairs: list[MujocoContact]) -> float:
    """Scale of the accelerations of a scene in m/s^2: of each contact when its pair meets at full speed."""
    return scene.fastest * math.sqrt(max(-pair.solref[0] for pair in pairs)) + scene.gravity


def _tolerance(acceleration: float) -> float:
    """Tolerance at which the solver's forces are converged to rounding.

    The engine holds one number against two measures: the decrease of its cost, a squared acceleration, and
    the gradient, an acceleration (per mean inertia, both). 1e-14 of the smaller of the two scales stops at
    the second Newton iteration, whose step is exact; tolerance 0 gives the same velocities to 6e-15 at twice
    the cost.
    """
    return 1e-14 * min(acceleration, acceleration**2)
