"""MuJoCo at its default step of 2 ms: as it is shipped, and by the two formats of solref that it documents.

The scene is what a user writes: spheres on free joints above a plane, Euler, nothing else set (friction apart, which
is 0: contacts of `condim` 1). Where contacts are not the default ones they are `<pair>`s, which carry their own
numbers. The formats (MuJoCo documentation, "Solver parameters"), for a contact of stiffness k, damping ratio zeta and
reduced mass M, omega = sqrt(k/M):

* default: solref = (0.02, 1), critically damped, whatever is asked for;
* (timeconst, dampratio) = (1/(zeta omega), zeta); no dampratio means elastic, since timeconst then has no bound. The
  engine replaces a timeconst below two steps by two steps (`refsafe`), and says nothing;
* direct: (-k/M, -c/M), accelerations per length and per velocity.

All under the default solimp, (0.9, 0.95, 0.001, 0.5, 2), whose impedance is not that of a spring.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from itertools import pairwise
from typing import Any

from impact_xval.compliant_baselines.contact.mapping import Contact
from impact_xval.compliant_baselines.contract.registry import KELVIN_VOIGT
from impact_xval.compliant_baselines.engines.mujoco_engine import MujocoSolver, warnings_kept
from impact_xval.compliant_baselines.practical.practice import (
    RADIUS,
    Arrangement,
    Practice,
    World,
    springs,
    without_spring,
)
from impact_xval.model.columns.column import Column

SCENE = """
<mujoco>
  <option timestep="{step!r}" gravity="0 0 0"/>
  <default><geom condim="1"/><pair condim="1"/></default>
  <worldbody>{bodies}
  </worldbody>
  <contact>{pairs}
  </contact>
</mujoco>
"""

BALL = """
    <body name="B{i}" pos="0 0 {height!r}">
      <freejoint/>
      <geom name="B{i}" type="sphere" size="{radius!r}" mass="{mass!r}"/>
    </body>"""

TABLE = """
    <geom name="table" type="plane" pos="0 0 {height!r}" size="0 0 1"/>"""

PAIR = """
    <pair geom1="{upper}" geom2="{lower}" solref="{first!r} {second!r}"/>"""

#: solref of a contact; None: the engine's default.
Solref = tuple[float, float] | None


class _Mujoco(Practice):
    engine = "MuJoCo"
    distribution = "mujoco"
    module = "mujoco"
    default_step = 2e-3

    def unavailable(self) -> str | None:
        """As of the calibrated adapter."""
        return MujocoSolver().unavailable()

    def load(self) -> object:
        """Import it."""
        return import_module("mujoco")

    @abstractmethod
    def solrefs(self, column: Column) -> list[Solref]:
        """Give solref of each contact."""

    @contextmanager
    def world(self, column: Column, arrangement: Arrangement) -> Iterator[World]:
        """Make the column."""
        with warnings_kept():
            yield MujocoWorld(column, arrangement, self.solrefs(column))


class MujocoDefault(_Mujoco):
    """MuJoCo as it is shipped."""

    name = "mujoco-default"
    settings = "default solref and solimp, whatever contact is asked for"
    takes = ()
    law = ""

    def solrefs(self, column: Column) -> list[Solref]:
        """Nothing is given."""
        return [None] * len(column.stiffnesses)


class MujocoDocumented(_Mujoco):
    """MuJoCo with (timeconst, dampratio) of the contact asked for."""

    name = "mujoco-documented"
    settings = "solref = (timeconst, dampratio) of the contact asked for, default solimp"
    takes = ("restitution", "stiffness")
    law = KELVIN_VOIGT

    def refuses(self, column: Column) -> str | None:
        """Refuse elastic contacts, which have no timeconst, and perfectly plastic ones."""
        for i, e in enumerate(column.restitutions, 1):
            if e == 1:
                return (
                    f"restitutions[{i}] = 1.0: dampratio = 0 leaves timeconst = 1/(dampratio omega) without a value; "
                    "legal: greater than 0, less than 1 (the direct format of solref has elastic contacts)"
                )
        return without_spring(column)

    def solrefs(self, column: Column) -> list[Solref]:
        """Time constant in s, and damping ratio."""
        return [(1 / (contact.zeta * contact.omega), contact.zeta) for contact in springs(column).contacts]


class MujocoDirect(_Mujoco):
    """MuJoCo with the direct format of the contact asked for, under the default solimp."""

    name = "mujoco-direct"
    settings = "solref = (-k/M, -c/M) of the contact asked for, default solimp"
    takes = ("restitution", "stiffness")
    law = KELVIN_VOIGT

    def refuses(self, column: Column) -> str | None:
        """No dashpot is perfectly plastic."""
        return without_spring(column)

    def solrefs(self, column: Column) -> list[Solref]:
        """Stiffness and damping per mass, in 1/s^2 and 1/s."""

        def direct(contact: Contact) -> Solref:
            return -contact.k / contact.mass, -contact.c / contact.mass

        return [direct(contact) for contact in springs(column).contacts]


def scene(column: Column, arrangement: Arrangement, solrefs: Sequence[Solref]) -> str:
    """Write the scene of a column."""
    heights, balls = arrangement.heights(column), len(column.masses)
    bodies = ""
    for i in arrangement.order(column):
        if i == balls:
            bodies += TABLE.format(height=arrangement.floor())
        else:
            bodies += BALL.format(i=i + 1, height=heights[i], radius=RADIUS, mass=column.masses[i])
    names = [*(f"B{i + 1}" for i in range(balls)), *(["table"] if column.table else [])]
    pairs = "".join(
        PAIR.format(upper=upper, lower=lower, first=solref[0], second=solref[1])
        for solref, (upper, lower) in zip(solrefs, pairwise(names), strict=True)
        if solref is not None
    )
    return SCENE.format(step=arrangement.step, bodies=bodies, pairs=pairs)


class MujocoWorld:
    """A column inside MuJoCo."""

    def __init__(self, column: Column, arrangement: Arrangement, solrefs: Sequence[Solref]) -> None:
        self._mujoco: Any = import_module("mujoco")
        self._model = self._mujoco.MjModel.from_xml_string(scene(column, arrangement, solrefs))
        self._data = self._mujoco.MjData(self._model)
        joints = [self._model.body(f"B{i + 1}").dofadr[0] for i in range(len(column.masses))]
        self._upwards = [int(joint) + 2 for joint in joints]
        self._data.qvel[self._upwards] = column.velocities

    def step(self) -> None:
        """Take a step."""
        self._mujoco.mj_step(self._model, self._data)

    def velocities(self) -> Sequence[float]:
        """Velocities along the line in m/s."""
        return self._data.qvel[self._upwards].tolist()
