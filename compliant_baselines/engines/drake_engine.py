"""Drake: the column as two spheres on prismatic joints above a half space, in discrete and in continuous time.

Set-up, and why:

* `kSap` is the contact model whose law is a spring and a linear dashpot, F = max(0, k (delta + tau delta')),
  both taken at the end of the step: backward Euler, as PyBullet. The two solve the same equations and are not
  independent votes; they differ by 2e-6 |v0| at most, often by less than 1e-9, which is where the engine's
  solver stops (relative tolerance 1e-6, out of reach from Python). `kTamsi`, `kSimilar` and `kLagged` are
  Hunt-Crossley.
* `relaxation_time` is a property of its own: `kSap` ignores the Hunt-Crossley dissipation that
  `AddContactMaterial` writes, and takes 0.1 s for a geometry that has none.
* Every geometry gets a stiffness. Without one it takes a value derived from gravity, masses and a penetration
  allowance, and combines it in series.
* `sap_near_rigid_threshold` is 0. Above 0 (the default is 1) a contact whose period comes near to the step is
  softened until it can be resolved: another stiffness than asked for, without a status.
* The solver stops where its residual is below 1e-6 of the momentum: a contact whose impulse in a step is less
  exerts no force at all. At each touch it starts late by that much, and at a step of 1e-7 of its period a body
  falls through the table. So there is a *shortest* step, and `refusal` knows it.
* The half space is exact at any depth, as PyBullet's plane.
* Steps are logged in C++ (`LogVectorOutput`, once a step); Python is entered once for `WINDOW` steps.
* Lines of N balls are `engines.drake_lines`; what both share is `engines.drake_setup`.
* Everything is in SI units as asked; only the balls' radius is ours (`radius_of`).

**In continuous time** (`DrakeHuntCrossleySolver`) contacts are Hunt and Crossley's under an integrator with error
control: F = max(0, k delta (1 + d delta')), k in series and d = d_A k_B/(k_A + k_B) + d_B k_A/(k_A + k_B) of the two
geometries (the engine's page "Modeling Dissipation"): with one of them rigid, d is the other's.

* For e = 1 the dissipation is zero and the column is that of two springs, which every reference here agrees
  on: with its own integrator, the best third-party oracle there is.
* For e < 1 it is another law than the dashpot's, to be compared with `hunt-crossley`: d = A/|v0| with A from
  equation (*) of `restitution`, both contacts for the approach speed |v0|. Not a Kelvin-Voigt engine; it
  runs where it is asked for by name.
* The integrator is the simulator's default, the error-controlled Runge-Kutta of third order. Contact onset and
  end are kinks: at the same accuracy the fifth-order scheme is off by a hundred times as much, since what it
  compares across a kink is not its error. The accuracy is a bound on absolute changes of heights in m and
  velocities in m/s: it is scaled with the larger of the two.
* The "step" is the time between two samples. It decides on the state path and on when the collision is seen to be
  over, not on the velocities.

Importing the package takes half a second: nothing here does before it is asked to run.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from importlib import import_module
from typing import Any, NamedTuple

from impact_xval.compliant_baselines.engines.column import Column, radius_of
from impact_xval.compliant_baselines.engines.drake_lines import naive_line, run_line, shortest_of_line
from impact_xval.compliant_baselines.engines.drake_setup import (
    WINDOW,
    add_ball,
    add_table,
    contact_material,
    discrete_properties,
    dissipation,
    plant_at,
    set_accuracy,
    silent,
    simulator_of,
    too_short,
)
from impact_xval.compliant_baselines.engines.engine import EngineSolver
from impact_xval.compliant_baselines.engines.line import Line
from impact_xval.compliant_baselines.engines.lines import LineRun
from impact_xval.compliant_baselines.engines.packages import why_not
from impact_xval.compliant_baselines.engines.recording import Recorder, Run
from impact_xval.compliant_baselines.engines.trajectory import FLIGHT, GOING
from impact_xval.compliant_baselines.mapping import PYBULLET_RIGID, drake_geometries


class DrakeSolver(EngineSolver):
    """Drake, discrete time."""

    name = "drake"
    distribution = "drake"

    def unavailable(self) -> str | None:
        """Why Drake cannot run here and the way out; None if it can."""
        way_out = "run pip install 'impact-xval[drake]' (Linux and macOS only)"
        return why_not("Drake", self.distribution, lambda: import_module("pydrake"), way_out)

    def own_refusal(self, column: Column) -> str | None:
        """Why a column cannot be taken: a step so short that the engine neglects a contact."""
        return too_short(column.step, min(column.contact1.omega, column.contact2.omega))

    def line_refusal(self, line: Line) -> str | None:
        """Why Drake cannot take a line: as for two balls, and the naive mapping, which is of two balls."""
        return naive_line(line) or shortest_of_line(line)

    def run_lines(self, lines: Sequence[Line], max_steps: int, record_path: bool = False) -> list[LineRun]:
        """Run every line of N balls until its collision is over or `max_steps` steps are taken; in order.

        A line at too short a step is not run, as in `run_columns`.
        """
        with silent():
            return [run_line(line, max_steps, record_path, discrete=True) for line in lines]

    def run_columns(self, columns: Sequence[Column], max_steps: int, record_path: bool = False) -> list[Run]:
        """Run every column until its collision is over or `max_steps` steps are taken; in order.

        A column at too short a step is not run, and its run says why: who shortens steps may not ask `refusal`.
        """
        with silent():
            return [
                not_run(column, max_steps, reason) if reason else run(column, max_steps, record_path)
                for column, reason in zip(columns, map(self.refusal, columns), strict=True)
            ]


class DrakeHuntCrossleySolver(DrakeSolver):
    """Drake, continuous time, Hunt-Crossley contacts; elastic ones are linear springs."""

    name, law = "drake-hunt-crossley", "hunt-crossley"

    def own_refusal(self, column: Column) -> str | None:
        """Why a column cannot be taken: there is no naive mapping to this law. No step is too short."""
        if column.mapping == "naive":
            return "mapping = 'naive': a Hunt-Crossley contact has no naive mapping; take 'calibrated'"
        return None

    def line_refusal(self, line: Line) -> str | None:
        """Why Drake cannot take a line: the naive mapping."""
        return naive_line(line)

    def run_lines(self, lines: Sequence[Line], max_steps: int, record_path: bool = False) -> list[LineRun]:
        """Run every line of N balls until its collision is over or `max_steps` samples are taken; in order."""
        with silent():
            return [run_line(line, max_steps, record_path, discrete=False) for line in lines]

    def run_columns(self, columns: Sequence[Column], max_steps: int, record_path: bool = False) -> list[Run]:
        """Run every column until its collision is over or `max_steps` samples are taken; in order."""
        with silent():
            return [
                follow(partial(_scene, abs(column.v1)), column, max_steps, record_path) for column in columns
            ]


class Scene(NamedTuple):
    """A column as Drake has it.

    Attributes
    ----------
    simulator, log
        The engine's objects; the log gains a column (x1, x2, v1, v2) a step, heights from the world's origin.
    datum1, datum2 : float
        What to subtract from those heights, in m.
    k2 : float
        Stiffness of the support in N/m.
    """

    simulator: Any
    log: Any
    datum1: float
    datum2: float
    k2: float


def build(column: Column, properties: Sequence[Any], k1: float, k2: float, *, discrete: bool) -> Scene:
    """Set a column up.

    Parameters
    ----------
    column : Column
        What to set up.
    properties : sequence
        Proximity properties of the upper ball, the lower ball and the table.
    k1, k2 : float
        Stiffnesses of the contacts as the engine combines them, in N/m.
    discrete : bool
        Whether to step by `column.step` (`kSap`), or to integrate in continuous time and to log as often.
    """
    builder, plant, _ = plant_at(column.step if discrete else 0.0, column.gravity)
    radius = radius_of(column.depth(k1, k2))
    x1, x2 = column.start(column.m2 * column.gravity / k2, radius)
    upper, lower, table = properties
    add_table(plant, table)
    joints = [
        add_ball(plant, name, mass, radius, [own])[0]
        for name, mass, own in (("B1", column.m1, upper), ("B2", column.m2, lower))
    ]
    plant.Finalize()
    simulator, log, context = simulator_of(builder, plant, column.step)
    for joint, z, v in zip(joints, (3 * radius + x1, radius + x2), (column.v1, column.v2), strict=True):
        joint.set_translation(context, z)
        joint.set_translation_rate(context, v)
    return Scene(simulator, log, 3 * radius, radius, k2)


def started(scene: Scene) -> Any:
    """Initialise a scene and give its log, which holds the start."""
    log = scene.log.FindMutableLog(scene.simulator.get_mutable_context())
    scene.simulator.Initialize()
    return log


def follow(make: Callable[[Column], Scene], column: Column, max_steps: int, record_path: bool) -> Run:
    """Advance a column until its collision is over; what the engine raises ends the run and is its failure.

    `make` sets a scene up in the state and under the gravity of a column.
    """
    scene = make(column)
    log = started(scene)
    first = log.data()[:, 0]
    recorder = Recorder(
        column, first[0] - scene.datum1, first[1] - scene.datum2, scene.k2, max_steps, record_path
    )
    done = before = 0  # steps, and those of an earlier scene
    while done < max_steps:
        log.Clear()
        done = min(done + WINDOW, max_steps)
        try:
            scene.simulator.AdvanceTo((done - before) * column.step)
        except RuntimeError as error:
            return recorder.finish(" ".join(f"Drake: {error}".split()))
        times, data = log.sample_times(), log.data()
        # A window's first sample may repeat the last of the one before.
        new = times > (recorder.n_steps - before + 0.5) * column.step
        heights = data[:2, new].T - (scene.datum1, scene.datum2)
        end = recorder.feed(data[2:, new].T.copy(), heights)
        if end == FLIGHT:
            # Gravity is part of a finished plant: another one goes on from here.
            (x1, x2), (v1, v2) = (map(float, values) for values in recorder.state)
            scene = make(replace(column, gravity=0.0, settled=False, x1=x1, x2=x2, v1=v1, v2=v2))
            log, done, before = started(scene), recorder.n_steps, recorder.n_steps
            continue
        if end != GOING:
            break
        if recorder.n_steps != done:
            raise AssertionError(f"{recorder.n_steps} samples logged in {done} steps")
    return recorder.finish()


def not_run(column: Column, max_steps: int, reason: str) -> Run:
    """Give the run of a column that was refused."""
    return Recorder(column, column.x1, column.x2, column.contact2.k, max_steps, False).finish(reason)


def run(column: Column, max_steps: int, record_path: bool) -> Run:
    """Run one column in discrete time, whatever its step."""
    bodies = drake_geometries(column.contact1, column.contact2, column.mapping)
    upper, lower, table = bodies
    k1, k2 = upper.against(lower).stiffness, lower.against(table).stiffness
    properties = [discrete_properties(body) for body in bodies]
    return follow(
        lambda state: build(state, properties, k1, k2, discrete=True), column, max_steps, record_path
    )


def _scene(speed: float, column: Column) -> Scene:
    """Set a column up whose contacts have their restitution at an approach speed in m/s."""
    one, two = column.contact1, column.contact2
    upper = contact_material(point_stiffness=one.k, dissipation=dissipation(one, speed))
    table = contact_material(point_stiffness=two.k, dissipation=dissipation(two, speed))
    lower = contact_material(point_stiffness=PYBULLET_RIGID, dissipation=0.0)
    scene = build(column, (upper, lower, table), one.k, two.k, discrete=False)
    set_accuracy(scene.simulator, speed, min(one.omega, two.omega), column.step)
    return scene
