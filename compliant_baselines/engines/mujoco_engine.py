"""MuJoCo: the column as two balls on vertical slides, many columns at a time.

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
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache, lru_cache
from importlib import import_module
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from impact_xval.compliant_baselines.engines.column import BEYOND, Column, radius_of
from impact_xval.compliant_baselines.engines.engine import EngineSolver
from impact_xval.compliant_baselines.engines.line import Line
from impact_xval.compliant_baselines.engines.lines import LineRecorder, LineRun
from impact_xval.compliant_baselines.engines.packages import why_not
from impact_xval.compliant_baselines.engines.recording import Recorder, Run
from impact_xval.compliant_baselines.engines.trajectory import FLIGHT, GOING
from impact_xval.compliant_baselines.mapping import MUJOCO_IMPEDANCE, MujocoContact, mujoco_contact

if TYPE_CHECKING:
    from mujoco.batch import Batch

#: Largest position, velocity and acceleration the engine accepts, in SI units (mjMAXVAL of mjtype.h).
LARGEST_VALUE = 1e10

#: Simulations in one batch: enough to make a call's cost small, few enough for a window to stay in the cache.
CHUNK = 64

#: Steps between two looks at which simulations are over.
WINDOW = 256

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
    <pair name="{name}" geom1="{upper}" geom2="{lower}" condim="1" solref="-1 -0"/>"""

#: The contacts of two balls above a table.
PAIRS = ("ball-ball", "ball-table")


def scene(balls: int = 2, table: bool = True, names: Sequence[str] = PAIRS) -> str:
    """Write the scene of a column, its contacts so named; by default that of two balls above a table."""
    geoms = [*(f"B{i}" for i in range(1, balls + 1)), *(["table"] if table else [])]
    bodies = "".join(BODY.format(i=i, z=2 * (balls - i) + 1) for i in range(1, balls + 1))
    pairs = "".join(
        PAIR.format(name=name, upper=upper, lower=lower)
        for name, (upper, lower) in zip(names, pairwise(geoms), strict=True)
    )
    return SCENE.format(bodies=bodies, pairs=pairs)


@cache
def scene_model() -> Any:
    """Give the scene of two balls above a table as the engine compiles it."""
    # The names of the compiled module are invisible to a type checker, here and below.
    mujoco: Any = import_module("mujoco")
    return mujoco.MjModel.from_xml_string(scene())


@lru_cache(maxsize=16)
def line_model(balls: int, table: bool) -> Any:
    """Give the scene of N balls as the engine compiles it."""
    mujoco: Any = import_module("mujoco")
    return mujoco.MjModel.from_xml_string(scene(balls, table, [str(i) for i in range(1, balls + table)]))


class MujocoSolver(EngineSolver):
    """MuJoCo 4.0 or later, in one thread: collisions are shared out to processes further up."""

    name = "mujoco"
    distribution = "mujoco"
    regularisation_probe = 10.0

    def unavailable(self) -> str | None:
        """Why MuJoCo cannot run here and the way out; None if it can."""
        way_out = "run pip install 'mujoco>=4.0'"
        return why_not("MuJoCo", self.distribution, lambda: import_module("mujoco.batch"), way_out)

    def own_refusal(self, column: Column | Line) -> str | None:
        """Why MuJoCo cannot take a column: accelerations beyond what it accepts."""
        largest = _acceleration(column)
        if largest > LARGEST_VALUE:
            return (
                f"accelerations about |v0| sqrt(k/M) = {largest:.3g} m/s^2: "
                f"MuJoCo accepts {LARGEST_VALUE:.0e}; scale stiffnesses, masses or v0 (Theorem 5)"
            )
        return None if _depth(column) > 0 else BEYOND  # by the stiffness of its own pair

    def run_columns(self, columns: Sequence[Column], max_steps: int, record_path: bool = False) -> list[Run]:
        """Run every column until its collision is over or `max_steps` steps are taken; in order."""
        runs = []
        with _warnings_kept():
            for first in range(0, len(columns), CHUNK):
                runs += self._run_chunk(columns[first : first + CHUNK], max_steps, record_path)
        return runs

    def _run_chunk(self, columns: Sequence[Column], max_steps: int, record_path: bool) -> list[Run]:
        from mujoco.batch import Batch

        batch = Batch(scene_model(), len(columns), 1)
        return self._follow(batch, load(batch, columns, max_steps, record_path), max_steps)

    def line_refusal(self, line: Line) -> str | None:
        """Why MuJoCo cannot take a line: as for two balls."""
        return self.own_refusal(line)

    def run_lines(self, lines: Sequence[Line], max_steps: int, record_path: bool = False) -> list[LineRun]:
        """Run every line of N balls until its collision is over or `max_steps` steps are taken; in order."""
        from mujoco.batch import Batch

        runs: dict[int, LineRun] = {}
        # One compiled model serves all lines of as many balls.
        sizes = {(len(line.masses), line.table) for line in lines}
        with _warnings_kept():
            for balls, table in sorted(sizes):
                alike = [i for i, c in enumerate(lines) if (len(c.masses), c.table) == (balls, table)]
                for first in range(0, len(alike), CHUNK):
                    chunk = alike[first : first + CHUNK]
                    batch = Batch(line_model(balls, table), len(chunk), 1)
                    recorders = load_lines(batch, [lines[i] for i in chunk], max_steps, record_path)
                    runs |= zip(chunk, self._follow(batch, recorders, max_steps), strict=True)
        return [runs[i] for i in range(len(lines))]

    @staticmethod
    def _follow(batch: Batch, recorders: Any, max_steps: int) -> list[Any]:
        """Step simulations until all are over."""
        failures: Any = [""] * len(recorders)
        going = np.arange(len(recorders))
        while going.size:
            n = min(WINDOW, max_steps - max(recorders[i].n_steps for i in going))
            record = batch.rollout(n, record=("qvel", "qpos"), ids=going)
            warned = batch.warning[going, :, 1].any(axis=1)  # (simulation, kind, (last info, count))
            left = []
            for row, i in enumerate(going):
                end = recorders[i].feed(record["qvel"][row], record["qpos"][row])
                if end == FLIGHT:
                    batch.qpos[i], batch.qvel[i] = recorders[i].state
                    batch.expand("opt.gravity")[i] = 0.0
                elif warned[row] and end == GOING:
                    failures[i] = (
                        f"MuJoCo found positions, velocities or accelerations beyond {LARGEST_VALUE:.0e}"
                    )
                    continue
                if end in (GOING, FLIGHT) and recorders[i].n_steps < max_steps:
                    left.append(i)
            going = np.array(left, dtype=np.intp)
        return [recorder.finish(failure) for recorder, failure in zip(recorders, failures, strict=True)]


class NaiveMujocoSolver(MujocoSolver):
    """MuJoCo with k and c written into a direct-format solref as N/m and N s/m, under the default solimp.

    It breaks Theorem 5: the default solimp has a width in metres, and k in N/m is read as 1/s^2, so that the outcome
    depends on the scale of k and m.
    """

    name = "mujoco-naive"


@contextmanager
def _warnings_kept() -> Iterator[None]:
    """Keep the engine's warnings from the terminal and its log file; the batch counts them all the same."""
    mujoco: Any = import_module("mujoco")
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda _message: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)


def _pairs(column: Column | Line) -> list[MujocoContact]:
    """Map the contacts to the engine's parameters."""
    impedance = column.regularisation * MUJOCO_IMPEDANCE
    return [mujoco_contact(contact, column.mapping, impedance) for contact in column.contacts]


def _depth(column: Column | Line) -> float:
    """How deep the contacts go in m, at most."""
    pairs = zip(_pairs(column), column.contacts, strict=True)
    return column.depth(*(pair.stiffness(contact.mass) for pair, contact in pairs))


def _acceleration(column: Column | Line) -> float:
    """Scale of the accelerations of a column in m/s^2: of each contact when its pair meets at full speed."""
    omega = math.sqrt(max(-pair.solref[0] for pair in _pairs(column)))
    return column.fastest * omega + column.gravity


def _tolerance(column: Column | Line) -> float:
    """Tolerance at which the solver's forces are converged to rounding.

    The engine holds one number against two measures: the decrease of its cost, a squared acceleration, and
    the gradient, an acceleration (per mean inertia, both). 1e-14 of the smaller of the two scales stops at
    the second Newton iteration, whose step is exact; tolerance 0 gives the same velocities to 6e-15 at twice
    the cost.
    """
    acceleration = _acceleration(column)
    return 1e-14 * min(acceleration, acceleration**2)


def _write(
    batch: Batch, columns: Sequence[Column] | Sequence[Line], pair_names: Sequence[str]
) -> list[float]:
    """Write the columns' parameters into a batch; the radius of the balls of each, in m."""
    model, balls = batch.model, range(1, len(columns[0].masses) + 1)
    bodies = [model.body(f"B{i}").id for i in balls]
    geoms = [model.geom(f"B{i}").id for i in balls]
    radius = np.array([radius_of(_depth(c)) for c in columns])
    batch.expand("geom_size")[:, geoms, 0] = radius[:, None]
    batch.expand("geom_rbound")[:, geoms] = radius[:, None]
    for i, body in enumerate(reversed(bodies)):
        batch.expand("body_pos")[:, body, 2] = (2 * i + 1) * radius
    batch.expand("body_mass")[:, bodies] = [c.masses for c in columns]
    batch.expand("opt.timestep")[:] = [c.step for c in columns]
    batch.expand("opt.tolerance")[:] = [_tolerance(c) for c in columns]
    batch.expand("opt.gravity")[:, 2] = [-c.gravity for c in columns]
    pairs = [_pairs(c) for c in columns]
    for which, name in enumerate(pair_names):
        pair = model.pair(name).id
        batch.expand("pair_solref")[:, pair] = [p[which].solref for p in pairs]
        batch.expand("pair_solimp")[:, pair] = [p[which].solimp for p in pairs]
    batch.set_const()  # the inverse weights follow the masses
    return radius.tolist()


def load(batch: Batch, columns: Sequence[Column], max_steps: int, record_path: bool) -> list[Recorder]:
    """Write the columns' parameters and initial states into a batch; give what will follow each."""
    recorders = []
    for i, (c, radius) in enumerate(zip(columns, _write(batch, columns, PAIRS), strict=True)):
        table = _pairs(c)[1]
        rest = table.rest_penetration(c.gravity) if c.settled else 0.0
        x1, x2 = c.start(rest, radius)
        batch.qpos[i], batch.qvel[i] = (x1, x2), (c.v1, c.v2)
        k2 = c.m2 * c.gravity / rest if rest else c.contact2.k
        recorders.append(Recorder(c, x1, x2, k2, max_steps, record_path))
    return recorders


def load_lines(batch: Batch, lines: Sequence[Line], max_steps: int, record_path: bool) -> list[LineRecorder]:
    """Write the parameters and initial states of lines into a batch; give what will follow each."""
    names = [str(i) for i in range(1, len(lines[0].contacts) + 1)]
    for i, (line, radius) in enumerate(zip(lines, _write(batch, lines, names), strict=True)):
        batch.qpos[i], batch.qvel[i] = line.heights(radius), line.velocities
    return [LineRecorder(line, max_steps, record_path) for line in lines]
