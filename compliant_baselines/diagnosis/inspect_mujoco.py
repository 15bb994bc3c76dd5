"""The contacts of a compiled model of MuJoCo, each to be measured in a scene of its own.

The two bodies become spheres on vertical slides, a fixed one a plane, with everything that decides their contact: the
attributes of both geoms, which the engine combines here as there, or those of their <pair>; the model's options (step,
integrator, solver, cone, flags) but for gravity and fluids; and the inverse weights by which the engine scales a
contact. What moves is the mass along the normal, which a scene decides by its shapes: here it is that of the direction
in which a body moves most easily, at its centre of mass and in the initial configuration, one over the largest
eigenvalue of J M^-1 J^T. For a free body that is its mass.

Contacts of spheres along their line of centres depend on no size. Flexes are left out.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np

from impact_xval.compliant_baselines.diagnosis.bouncing import MOST_STEPS, Meeting, Place
from impact_xval.compliant_baselines.diagnosis.diagnose_mujoco import geom_name, touching_geoms
from impact_xval.compliant_baselines.diagnosis.diagnosis import sentence
from impact_xval.compliant_baselines.engines.mujoco_engine import warnings_kept

#: What two geoms bring to a contact, and what a <pair> has itself: names in MJCF and in a model.
_GEOM = ("solref", "solimp", "solmix", "priority", "margin", "gap", "friction", "condim")
_PAIR = ("solref", "solreffriction", "solimp", "margin", "gap", "friction", "condim")

#: Options that push bodies where no contact does, and the step, which is set apart.
_NOT_COPIED = ("gravity", "wind", "magnetic", "density", "viscosity", "timestep")

#: Smallest radius of the spheres in m; else it is the way that they have in a meeting's steps at full speed.
_SMALLEST = 1e-6

#: Rounding of numbers that are meant to be the same in bodies that are alike.
_DIGITS = 12

SCENE = """
<mujoco>
  <option gravity="0 0 0"/>
  <worldbody>
    {below}
    <body name="one" pos="0 0 {radius!r}">
      <joint type="slide" axis="0 0 1"/>
      <inertial pos="0 0 0" mass="{masses[0]!r}" diaginertia="{masses[0]!r} {masses[0]!r} {masses[0]!r}"/>
      <geom name="one" type="sphere" size="{radius!r}" {geoms[0]}/>
    </body>
  </worldbody>
  <contact>{pair}</contact>
</mujoco>
"""

PLANE = """<geom name="two" type="plane" size="0 0 1" {geoms[1]}/>"""

BALL = """<body name="two" pos="0 0 {depth!r}">
      <joint type="slide" axis="0 0 1"/>
      <inertial pos="0 0 0" mass="{masses[1]!r}" diaginertia="{masses[1]!r} {masses[1]!r} {masses[1]!r}"/>
      <geom name="two" type="sphere" size="{radius!r}" {geoms[1]}/>
    </body>"""

#: Names and values, as `_attributes` makes them.
_Values = tuple[tuple[str, tuple[float, ...]], ...]


@dataclass(frozen=True)
class MujocoMeeting(Meeting):
    """Two geoms.

    Attributes
    ----------
    inverse_weights : tuple of tuple
        `body_invweight0` of both bodies.
    geoms : tuple
        Attributes of both.
    pair : tuple or None
        Those of their <pair>.
    options : tuple
        Of the model.
    """

    inverse_weights: tuple[tuple[float, ...], ...]
    geoms: tuple[_Values, _Values]
    pair: _Values | None
    options: _Values

    @contextmanager
    def engine(self) -> Iterator[Place]:
        """Keep the engine quiet meanwhile."""
        with warnings_kept():
            yield partial(_World, self)


class _World:
    def __init__(self, meeting: MujocoMeeting, speed: float, step: float, place: float) -> None:
        self._mujoco: Any = import_module("mujoco")
        radius = max(_SMALLEST, speed * step * MOST_STEPS)
        # The movable one above; a geom that is not there by a pair meets all.
        order = (0, 1) if math.isfinite(meeting.masses[0]) else (1, 0)
        masses = [meeting.masses[i] for i in order]
        matching = "" if meeting.pair is None else ' contype="0" conaffinity="0"'
        geoms = [_words(meeting.geoms[i]) + matching for i in order]
        below = (BALL if math.isfinite(masses[1]) else PLANE).format(
            masses=masses, geoms=geoms, radius=radius, depth=-radius
        )
        pair = "" if meeting.pair is None else f'<pair geom1="one" geom2="two" {_words(meeting.pair)}/>'
        scene = SCENE.format(below=below, masses=masses, geoms=geoms, radius=radius, pair=pair)
        self._model = model = self._mujoco.MjModel.from_xml_string(scene)
        for name, values in meeting.options:
            _set(model.opt, name, values)
        model.opt.timestep = step
        self._data = self._mujoco.MjData(model)
        for body, i in zip(("one", "two"), order, strict=True):
            if math.isfinite(meeting.masses[i]):
                model.body_invweight0[model.body(body).id] = meeting.inverse_weights[i]
        self._one = int(model.body("one").dofadr[0])
        self._two = int(model.body("two").dofadr[0]) if math.isfinite(masses[1]) else None
        self._data.qpos[self._one] = self._touch(radius) + place * speed * step
        self._data.qvel[self._one] = -speed

    def _touch(self, radius: float) -> float:
        """Gap at which the contact begins to act, in m."""
        self._data.qpos[self._one] = -0.5 * radius
        self._mujoco.mj_forward(self._model, self._data)
        if not self._data.ncon:
            raise RuntimeError("the engine makes no contact of two spheres with these parameters")
        begins = float(self._data.contact[0].includemargin)
        self._mujoco.mj_resetData(self._model, self._data)
        return begins

    def step(self) -> None:
        self._mujoco.mj_step(self._model, self._data)

    def rate(self) -> float:
        kinds = self._mujoco.mjtWarning
        for kind in (kinds.mjWARN_BADQPOS, kinds.mjWARN_BADQVEL, kinds.mjWARN_BADQACC):
            if self._data.warning[kind].number:
                return math.nan
        below = 0.0 if self._two is None else float(self._data.qvel[self._two])
        return float(self._data.qvel[self._one]) - below


def _words(values: _Values) -> str:
    return " ".join(f'{name}="{" ".join(map(repr, numbers))}"' for name, numbers in values)


def mujoco_meetings(model: Any) -> Iterator[MujocoMeeting]:
    """List the contacts that a compiled model can have.

    Parameters
    ----------
    model : mujoco.MjModel
        The user's.

    Yields
    ------
    MujocoMeeting
        Pairs by name first, then pairs of geoms; those of two fixed bodies are none.
    """
    mujoco: Any = import_module("mujoco")
    off = mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    if model.opt.disableflags & off:
        return
    scene = _Scene(model)
    pairs = [(int(a), int(b)) for a, b in zip(model.pair_geom1, model.pair_geom2, strict=True)]
    for i, (a, b) in enumerate(pairs):
        where = f"pair {model.pair(i).name or f'{geom_name(model, a)} and {geom_name(model, b)}'}"
        yield from scene.meeting(where, (a, b), _attributes(model, "pair", i, _PAIR))
    for a, b in touching_geoms(model):
        yield from scene.meeting(f"geoms {geom_name(model, a)} and {geom_name(model, b)}", (a, b), None)


class _Body(NamedTuple):
    """Mass where it moves most easily in kg, whether elsewhere it is another, inverse weights."""

    mass: float
    on_joints: bool
    weights: tuple[float, ...]


class _Scene:
    """A compiled model in its initial configuration; what is read of it is kept."""

    def __init__(self, model: Any) -> None:
        self._mujoco: Any = import_module("mujoco")
        self._model, self._data = model, self._mujoco.MjData(model)
        # What the inertia needs: no collisions, of which a scene may have more than its memory holds.
        for stage in ("kinematics", "comPos", "tendon", "makeM", "factorM"):
            getattr(self._mujoco, f"mj_{stage}")(model, self._data)
        self._step, self._options = float(model.opt.timestep), _options(model)
        self._bodies: dict[int, _Body] = {}
        self._geoms: dict[int, _Values] = {}

    def meeting(self, where: str, geoms: tuple[int, int], pair: _Values | None) -> Iterator[MujocoMeeting]:
        """Give the meeting of two geoms; none if both are fixed."""
        one, two = (self._body(int(self._model.geom_bodyid[geom])) for geom in geoms)
        if math.isinf(min(one.mass, two.mass)):
            return
        yield MujocoMeeting(
            where,
            (one.mass, two.mass),
            self._step,
            (sentence("remarks.j2", "lightest"),) if one.on_joints or two.on_joints else (),
            (one.weights, two.weights),
            (self._geom(geoms[0]), self._geom(geoms[1])),
            pair,
            self._options,
        )

    def _geom(self, i: int) -> _Values:
        if i not in self._geoms:
            self._geoms[i] = _attributes(self._model, "geom", i, _GEOM)
        return self._geoms[i]

    def _body(self, i: int) -> _Body:
        if i not in self._bodies:
            least, most = self._inverse_masses(i)
            (mass,) = _rounded([1 / most]) if most > 0 else (math.inf,)
            weights = _rounded(self._model.body_invweight0[i])
            self._bodies[i] = _Body(mass, least < (1 - 1e-6) * most, weights)
        return self._bodies[i]

    def _inverse_masses(self, body: int) -> tuple[float, float]:
        """Least and greatest eigenvalue of J M^-1 J^T at the centre of mass, in 1/kg; zeros if it is fixed."""
        model = self._model
        if not model.nv or model.body_weldid[body] == 0:
            return 0.0, 0.0
        jacobian = np.zeros((3, model.nv))
        self._mujoco.mj_jacBodyCom(model, self._data, jacobian, None, body)
        solved = np.zeros_like(jacobian)
        self._mujoco.mj_solveM(model, self._data, solved, jacobian)
        least, _, most = np.linalg.eigvalsh(jacobian @ solved.T).tolist()
        return least, most


def _attributes(model: Any, what: str, i: int, names: tuple[str, ...]) -> _Values:
    """Read attributes of MJCF back from a model."""
    spelt = {"condim": "dim" if what == "pair" else "condim"}
    values = ((name, getattr(model, f"{what}_{spelt.get(name, name)}")[i]) for name in names)
    return tuple((name, tuple(np.ravel(value).tolist())) for name, value in values)


def _options(model: Any) -> _Values:
    mujoco: Any = import_module("mujoco")
    found = []
    for name in dir(model.opt):
        value = getattr(model.opt, name)
        if name.startswith("_") or callable(value) or name in _NOT_COPIED:
            continue
        found.append((name, tuple(np.ravel(value).tolist())))
    options = dict(found)
    # A run that goes wrong is not to begin again, and a slow body not to be put to sleep.
    flags = options["disableflags"][0] | int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    options["disableflags"] = (int(flags),)
    options["enableflags"] = (int(options["enableflags"][0] & ~int(mujoco.mjtEnableBit.mjENBL_SLEEP)),)
    return tuple(options.items())


def _set(option: Any, name: str, values: tuple[float, ...]) -> None:
    if np.ndim(getattr(option, name)):
        getattr(option, name)[:] = values
    else:
        setattr(option, name, values[0])


def _rounded(values: Any) -> tuple[float, ...]:
    return tuple(float(f"{value:.{_DIGITS}g}") for value in values)
