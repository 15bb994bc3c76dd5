"""Drake: N balls in a line, in discrete and in continuous time.

Drake sets stiffness and dissipation per geometry, and a ball inside a line has two contacts. So each ball has two
spheres at one place: the first, which meets the ball below, carries the contact; the second, which meets the ball
above, is rigid and undamped, as the table is. All pairs of geometries are excluded from proximity but these. Geometries
have no mass: nothing is added to the motion.

Else the set-up is that of `engines.drake_engine`, for its reasons. A flight is taken at once: the heights are moved on,
and the engine goes on from there.
"""

from __future__ import annotations

import math
from importlib import import_module
from typing import Any

import numpy as np

from impact_xval.compliant_baselines.engines.column import radius_of
from impact_xval.compliant_baselines.engines.drake_setup import (
    WINDOW,
    add_ball,
    add_table,
    contact_material,
    discrete_properties,
    dissipation,
    plant_at,
    set_accuracy,
    simulator_of,
    too_short,
)
from impact_xval.compliant_baselines.engines.line import Line
from impact_xval.compliant_baselines.engines.lines import LineRecorder, LineRun
from impact_xval.compliant_baselines.engines.trajectory import GOING
from impact_xval.compliant_baselines.mapping import PYBULLET_RIGID, DrakeGeometry

#: Steps of flight from which on the engine is spared them.
LEAST_FLIGHT = 16


def naive_line(line: Line) -> str | None:
    """Why a line cannot be taken: its mapping."""
    if line.mapping == "calibrated":
        return None
    return f"mapping = {line.mapping!r}: Drake's is that of two balls on a table; legal: 'calibrated'"


def shortest_of_line(line: Line) -> str | None:
    """Why a line cannot be taken in discrete time: a step so short that the engine neglects a contact.

    The engine compares residuals with the momentum of all bodies, both per sqrt(mass): an impulse M u of a pair that
    meets at u counts sqrt(M) u beside sqrt(sum m v^2). Such a contact starts late, by a phase that is bounded here.
    """
    total = math.sqrt(float(np.array(line.masses) @ np.square(line.velocities)))
    slow = min(contact.omega * math.sqrt(contact.mass) for contact in line.contacts)
    return too_short(line.step, slow * line.speed / total)


def run_line(line: Line, max_steps: int, record_path: bool, *, discrete: bool) -> LineRun:
    """Run one line until its collision is over or `max_steps` steps, or samples, are taken.

    Parameters
    ----------
    line : Line
    max_steps : int
    record_path : bool
        Whether to keep points of its path.
    discrete : bool
        Whether to step by `line.step` (`kSap`; not at all where that is too short), or to integrate in continuous time
        with contacts of Hunt and Crossley and to look as often.
    """
    recorder = LineRecorder(line, max_steps, record_path)
    reason = shortest_of_line(line) if discrete else None
    if reason:
        return recorder.finish(reason)
    balls = len(line.masses)
    radius = radius_of(line.depth(*(contact.k for contact in line.contacts)))
    builder, plant, graph = plant_at(line.step if discrete else 0.0)
    joints = add_bodies(plant, graph, line, radius, discrete)
    simulator, output, context = simulator_of(builder, plant, line.step)
    origins = radius * np.arange(2 * balls - 1, 0, -2)
    x = line.heights(radius)
    for joint, z, v in zip(joints, origins + x, line.velocities, strict=True):
        joint.set_translation(context, z)
        joint.set_translation_rate(context, v)
    if not discrete:
        set_accuracy(simulator, line.speed, min(contact.omega for contact in line.contacts), line.step)
    log = output.FindMutableLog(simulator.get_mutable_context())
    simulator.Initialize()
    end, taken = GOING, 0  # steps of the engine, which are all but those of flights
    while end == GOING and (left := max_steps - recorder.n_steps) > 0:
        flight = min(recorder.flight_steps(x), left)
        if flight >= LEAST_FLIGHT:
            x = recorder.skip(flight, x)
            for joint, z in zip(joints, origins + x, strict=True):
                joint.set_translation(context, z)
            continue
        n = min(WINDOW, left)
        log.Clear()
        try:
            simulator.AdvanceTo((taken + n) * line.step)
        except RuntimeError as error:
            return recorder.finish(" ".join(f"Drake: {error}".split()))
        # A window's first sample may repeat the last of the one before.
        data = log.data()[:, log.sample_times() > (taken + 0.5) * line.step]
        if data.shape[1] != n:
            raise AssertionError(f"{data.shape[1]} samples logged in {n} steps")
        heights = data[:balls].T - origins
        end, x = recorder.feed(data[balls:].T.copy(), heights), heights[-1]
        taken += n
    return recorder.finish()


def add_bodies(plant: Any, graph: Any, line: Line, radius: float, discrete: bool) -> list[Any]:
    """Add table and balls, their radius in m, and finish the plant; the joints of the balls, the upper one's first."""
    geometry = import_module("pydrake.geometry")
    if discrete:
        rigid = discrete_properties(DrakeGeometry(PYBULLET_RIGID, 0.0))
        own = [discrete_properties(DrakeGeometry(c.k, c.c / c.k)) for c in line.contacts]
    else:
        rigid = contact_material(point_stiffness=PYBULLET_RIGID, dissipation=0.0)
        own = [
            contact_material(point_stiffness=c.k, dissipation=dissipation(c, line.speed))
            for c in line.contacts
        ]
    if not line.table:
        own.append(rigid)  # which nothing meets
    balls = [
        add_ball(plant, f"B{i}", mass, radius, [lower, rigid])
        for i, (mass, lower) in enumerate(zip(line.masses, own, strict=True), 1)
    ]
    above = [lower for _, (lower, _) in balls]
    below = [upper for _, (_, upper) in balls[1:]]
    if line.table:
        below.append(add_table(plant, rigid))
    plant.Finalize()
    everything = geometry.GeometrySet([each for _, both in balls for each in both] + below[-1:])
    declared = geometry.CollisionFilterDeclaration().ExcludeWithin(everything)
    for one, other in zip(above, below, strict=False):
        declared.AllowBetween(geometry.GeometrySet(one), geometry.GeometrySet(other))
    graph.collision_filter_manager().Apply(declared)
    return [joint for joint, _ in balls]
