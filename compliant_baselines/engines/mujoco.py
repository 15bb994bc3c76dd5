"""MuJoCo: balls on joints along which they slide; docs/mapping.md, section 2, gives the reason for each setting.

`mujoco.rollout` takes many steps in C++ and records each of them; all versions from 3.2.7 on have it. A model is
compiled once for each arrangement of balls. The parameters of each collision are then written into the model's arrays.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np

from impact_xval.compliant_baselines.engines.arrangement import Arrangement, in_space
from impact_xval.compliant_baselines.engines.engine import BEYOND, Engine
from impact_xval.compliant_baselines.engines.scene import Floats, Scene, World, radius_of, reduced_masses
from impact_xval.compliant_baselines.mapping import (
    MUJOCO_DEFAULT_SOLIMP,
    MUJOCO_DEFAULT_SOLREF,
    MUJOCO_IMPEDANCE,
    MujocoContact,
    mujoco_contact,
)
from impact_xval.model.arrays import Integers

#: Largest position, velocity and acceleration that MuJoCo accepts, in SI units (mjMAXVAL in mjtype.h).
LARGEST_VALUE = 1e10

#: Template of an MJCF file. Computations of the engine that have no effect in such a scene are switched off, because
#: they would take 6 % of the time of a step.
SCENE = """
<mujoco model="column">
  <option integrator="Euler" solver="Newton" iterations="100" gravity="0 0 0">
    <flag autoreset="disable" island="disable" equality="disable" frictionloss="disable" limit="disable"
      actuation="disable" sensor="disable"/>
  </option>
  <worldbody>
{planes}{bodies}
  </worldbody>
  <contact>{pairs}
  </contact>
</mujoco>
"""
PLANE = """
    <geom name="{name}" type="plane" size="0 0 1"{place} contype="0" conaffinity="0"/>"""
BODY = """
    <body name="{name}" pos="{place}">{joints}
      <geom name="{name}" type="sphere" size="1" mass="1" contype="0" conaffinity="0"/>
    </body>"""
JOINT = """
      <joint name="{name}" type="slide" axis="{axis}"/>"""
PAIR = """
    <pair name="{i}" geom1="{upper}" geom2="{lower}" condim="1" solref="-1 -0"/>"""


#: Joints of a ball, by the number of axes along which it moves: suffix of the joint's name, and direction.
JOINTS = {1: {"": "0 0 1"}, 2: {"x": "1 0 0", "z": "0 0 1"}}


def mjcf(arrangement: Arrangement) -> str:
    """Return an MJCF file with balls of 1 kg and a radius of 1 m; `MujocoWorld` replaces these values.

    The name of a pair is the number of its contact. The first plane is the table, which exists even if nothing touches
    it. Each further contact with a fixed body has its own plane.
    """
    names = [f"B{i}" for i in range(1, len(arrangement.centres) + 1)]
    places = in_space(np.ravel(arrangement.centres), arrangement.axes)
    bodies = [
        BODY.format(
            name=name,
            place=_numbers(place),
            joints="".join(
                JOINT.format(name=name + joint, axis=axis) for joint, axis in JOINTS[arrangement.axes].items()
            ),
        )
        for name, place in zip(names, places.tolist(), strict=True)
    ]
    planes: list[str] = []
    pairs: list[str] = []
    for i, touch in enumerate(arrangement.touches, 1):
        lower = names[touch.second] if touch.second is not None else plane_name(arrangement, i)
        if touch.second is None:
            (point,) = in_space(arrangement.surface(i - 1), arrangement.axes).tolist()
            (normal,) = in_space(np.array(touch.normal), arrangement.axes).tolist()
            moved = [f' pos="{_numbers(point)}"' if any(point) else ""]
            moved += [f' zaxis="{_numbers(normal)}"' if normal != [0, 0, 1] else ""]
            planes.append("".join(moved))
        pairs.append(PAIR.format(i=i, upper=names[touch.first], lower=lower))
    geoms = [
        PLANE.format(name=f"table{i}" if i > 1 else "table", place=place)
        for i, place in enumerate(planes or [""], 1)
    ]
    return SCENE.format(planes="".join(geoms).lstrip("\n"), bodies="".join(bodies), pairs="".join(pairs))


def plane_name(arrangement: Arrangement, contact: int) -> str:
    """Return the name of the plane of a contact; contacts are counted from 1."""
    number = sum(touch.second is None for touch in arrangement.touches[:contact])
    return f"table{number}" if number > 1 else "table"


def _numbers(values: Sequence[float]) -> str:
    """Return numbers as the text of an XML attribute; whole numbers have no decimal point."""
    return " ".join(repr(int(value)) if value == int(value) else repr(value) for value in values)


class MjOption(Protocol):
    """The members of `mujoco.MjOption` that the adapter reads and writes."""

    timestep: float
    tolerance: float
    gravity: Floats


class MjNamed(Protocol):
    """The member that the adapter reads of a body, geom or pair of a model."""

    id: int


class MjModel(Protocol):
    """The members of `mujoco.MjModel` that the adapter reads and writes."""

    opt: MjOption
    #: Number of positions.
    nq: int
    geom_size: Floats
    geom_rbound: Floats
    geom_pos: Floats
    body_pos: Floats
    body_mass: Floats
    body_invweight0: Floats
    pair_solref: Floats
    pair_solimp: Floats

    def body(self, name: str | None, /) -> MjNamed:
        """Return a body by its name; the engine refuses the name None."""
        ...

    def geom(self, name: str | None, /) -> MjNamed:
        """Return a geom by its name."""
        ...

    def pair(self, name: str | None, /) -> MjNamed:
        """Return a contact pair by its name."""
        ...


class MjWarnings(Protocol):
    """The member that the adapter reads of the warnings in `MjData`."""

    #: Number of times that each kind of warning was raised.
    number: Integers


class MjData(Protocol):
    """The members of `mujoco.MjData` that the adapter reads and writes."""

    qpos: Floats
    qvel: Floats
    qacc_warmstart: Floats
    warning: MjWarnings


class _Compiled:
    """A compiled model of an arrangement of balls. The parameters of a scene are written into it later.

    Attributes
    ----------
    model
        `MjModel`.
    data
        `MjData` of the model.
    pairs
        Indices of the contact pairs in the order of the contacts, because the engine sorts pairs by their geoms.
    planes, balls
        Indices of the geoms of planes, and of the geoms of balls.
    """

    def __init__(self, arrangement: Arrangement) -> None:
        mujoco = import_module("mujoco")
        self.model: MjModel = mujoco.MjModel.from_xml_string(mjcf(arrangement))
        self.data: MjData = mujoco.MjData(self.model)
        contacts = len(arrangement.touches)
        self.pairs = [self.model.pair(str(i)).id for i in range(1, contacts + 1)]
        planes = max(1, sum(touch.second is None for touch in arrangement.touches))
        self.planes, self.balls = slice(0, planes), slice(planes, planes + len(arrangement.centres))
        self.plane_points = np.array(self.model.geom_pos[self.planes])
        # The engine's indices of the two bodies of each contact; body 0 does not move.
        self.bodies = [
            (touch.first + 1, 0 if touch.second is None else touch.second + 1)
            for touch in arrangement.touches
        ]


@lru_cache(maxsize=1)
def _clock() -> ctypes.c_void_p:
    """Return MuJoCo's pointer to the clock of its profiler, `mjcb_time` of its C interface.

    Reading the clock takes a third of the time of a step with two balls. The engine's Python module sets the pointer
    and has no function to unset it.
    """
    folder = Path(import_module("mujoco").__file__ or "").parent
    libraries = [*folder.glob("libmujoco.*"), *folder.glob("mujoco.dll")]
    if not libraries:
        return ctypes.c_void_p()
    return ctypes.c_void_p.in_dll(ctypes.CDLL(str(libraries[0])), "mjcb_time")


def take_steps(model: MjModel, data: MjData, n: int) -> tuple[Floats, Floats]:
    """Take n steps of bodies on sliding joints, from the state in `data`; the steps are recorded in C++.

    The function returns positions in m and velocities in m/s after each step, shape (n, bodies) each. A RuntimeError
    says that velocities or positions became too large for the engine.
    """
    mujoco = import_module("mujoco")
    full = mujoco.mjtState.mjSTATE_FULLPHYSICS.value
    state = np.empty(mujoco.mj_stateSize(model, full))
    mujoco.mj_getState(model, data, state, full)
    # By default each call of `rollout` begins without a warm start. Results would then depend on how many steps a call
    # takes.
    warm_start = np.array(data.qacc_warmstart)
    (states,), _ = import_module("mujoco.rollout").rollout(
        model, data, state, nstep=n, initial_warmstart=warm_start
    )
    if data.warning.number.any():
        raise RuntimeError(f"MuJoCo found positions, velocities or accelerations beyond {LARGEST_VALUE:.0e}")
    # A recorded state consists of the time, the positions and the velocities.
    return states[:, 1 : 1 + model.nq], states[:, 1 + model.nq :]


class Mujoco(Engine):
    """MuJoCo 3.2.7 or later, in one thread; callers distribute collisions over processes."""

    name = distribution = "mujoco"
    title, module, way_out = "MuJoCo", "mujoco.rollout", "run pip install 'mujoco>=3.2.7'"
    oldest = "3.2.7"  # in older versions `rollout` takes other arguments
    regularisation_probe = 10.0
    knows_planes = True
    shipped_step = 0.002

    def refusal(self, scene: Scene) -> str | None:
        """Return a sentence that says why MuJoCo cannot take a scene, or None.

        MuJoCo refuses accelerations that are too large. With the documented mapping it refuses e = 1, which no damping
        ratio and time constant have.
        """
        if scene.mapping == "documented" and 1 in scene.restitutions:
            contact = scene.restitutions.index(1) + 1
            return f"e{contact} = 1: no time constant and damping ratio are undamped; legal: below 1"
        mapped = map_scene(scene)
        if mapped.acceleration <= LARGEST_VALUE:
            return None if mapped.depth > 0 else BEYOND
        return (
            f"accelerations about |v0| sqrt(k/M) = {mapped.acceleration:.3g} m/s^2: "
            f"MuJoCo accepts {LARGEST_VALUE:.0e}; scale stiffnesses, masses or v0 (Theorem 5)"
        )

    def radius(self, scene: Scene) -> float:
        """Return the radius in m of the balls."""
        return radius_of(map_scene(scene).depth, scene.axes)

    def world(self, scene: Scene) -> MujocoWorld:
        """Set up a scene in the compiled model of its arrangement."""
        return MujocoWorld(scene, self._compiled(scene.arrangement))

    @contextmanager
    def running(self) -> Generator[None]:
        """Switch off the clock of the engine's profiler, and its warnings on the terminal and in its log file.

        `MjData` still holds the number of warnings.
        """
        mujoco = import_module("mujoco")
        warn, clock = mujoco.get_mju_user_warning(), _clock()
        read_clock = clock.value

        def ignore(_message: str) -> None:
            pass

        mujoco.set_mju_user_warning(ignore)
        clock.value = None
        self._compiled = lru_cache(_Compiled)
        try:
            yield
        finally:
            clock.value = read_clock
            mujoco.set_mju_user_warning(warn)


class MujocoWorld(World):
    """A scene in a compiled model; a world that was made before from the same model can no longer be used."""

    def __init__(self, scene: Scene, compiled: _Compiled) -> None:
        mujoco = import_module("mujoco")
        model, contacts = compiled.model, compiled.pairs
        self.model, self._data = model, compiled.data
        balls = slice(1, 1 + len(scene.masses))  # number 0 is the body that does not move
        pairs, depth, acceleration = map_scene(scene)
        super().__init__(scene, radius_of(depth, scene.axes), pairs[-1].equilibrium_depth(scene.gravity))
        model.geom_size[compiled.balls, 0] = self.radius
        model.geom_rbound[compiled.balls] = self.radius
        model.geom_pos[compiled.planes] = self.radius * compiled.plane_points
        model.body_pos[balls] = in_space(self.places, scene.axes)
        model.body_mass[balls] = scene.masses
        model.opt.timestep = scene.step
        # The engine compares an acceleration and also its square with the same tolerance. With a smaller tolerance
        # Newton's method stops after two iterations.
        model.opt.tolerance = 1e-14 * min(acceleration, acceleration**2)
        model.opt.gravity[2] = -scene.gravity
        model.pair_solref[contacts] = [pair.solref for pair in pairs]
        model.pair_solimp[contacts] = [pair.solimp for pair in pairs]
        mujoco.mj_setConst(model, self._data)  # computes the inverse weights from the new masses
        mujoco.mj_resetData(model, self._data)
        self._data.qpos[:], self._data.qvel[:] = self.heights, scene.velocities
        self.effective = _read_back(model, contacts, compiled.bodies)

    def advance(self, n: int) -> tuple[Floats, Floats]:
        """Take n steps in C++, and return the recorded velocities in m/s and heights in m."""
        heights, velocities = take_steps(self.model, self._data, n)
        return velocities, heights

    def weightless(self, velocities: Floats, heights: Floats) -> None:
        """Continue without gravity from the given velocities in m/s and heights in m."""
        self._data.qpos[:], self._data.qvel[:] = heights, velocities
        self.model.opt.gravity[2] = 0.0


def _read_back(
    model: MjModel, contacts: list[int], bodies: Sequence[tuple[int, int]]
) -> dict[str, tuple[float, ...]]:
    """Return the parameters that the engine uses for each contact of two bodies alone, as in `World.effective`."""
    # The reduced masses that the engine uses. The inverse weight of body 0, which does not move, is 0.
    masses = 1 / model.body_invweight0[np.array(bodies), 0].sum(axis=1)
    solref, solimp = model.pair_solref[contacts], model.pair_solimp[contacts]
    share = solimp[:, 0] / solimp[:, 1]
    is_time_constant = solref[:, 0] > 0
    shortest = 2 * model.opt.timestep  # shorter time constants are lengthened to this time (refsafe)
    solref[is_time_constant, 0] = np.maximum(solref[is_time_constant, 0], shortest)
    pairs = [MujocoContact(tuple(ref), tuple(imp)) for ref, imp in zip(solref, solimp, strict=True)]
    direct = -np.array([pair.direct for pair in pairs])
    return {
        "stiffness": tuple((direct[:, 0] * masses * share**2).tolist()),
        "damping": tuple((direct[:, 1] * masses * share).tolist()),
        "step": (float(model.opt.timestep),),
    }


class MappedScene(NamedTuple):
    """The contacts of a scene in MuJoCo's parameters, with bounds on depth and acceleration."""

    contacts: list[MujocoContact]
    #: Bound on the depth of the contacts in m.
    depth: float
    #: Bound on accelerations in m/s^2.
    acceleration: float


def map_scene(scene: Scene) -> MappedScene:
    """Return MuJoCo's parameters for the contacts of a scene, and bounds on depth and acceleration."""
    impedance = scene.regularisation * MUJOCO_IMPEDANCE
    if scene.mapping == "shipped":
        pairs = [MujocoContact(MUJOCO_DEFAULT_SOLREF, MUJOCO_DEFAULT_SOLIMP)] * len(scene.stiffnesses)
    else:
        pairs = [mujoco_contact(contact, scene.mapping, impedance) for contact in scene.contacts]
    masses = reduced_masses(scene)
    depth = scene.depth([pair.stiffness(mass) for pair, mass in zip(pairs, masses, strict=True)])
    largest_stiffness = max(-pair.direct[0] for pair in pairs)
    acceleration = scene.fastest * math.sqrt(largest_stiffness) + scene.gravity
    return MappedScene(pairs, depth, acceleration)
