"""Curves kept for the figures: impulse curves of one pair by every solver, or the forces of one chain over time."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from impact_xval.compliant_baselines.answers import answer
from impact_xval.experiments.config.cells import collision_of
from impact_xval.experiments.config.experiment import Config
from impact_xval.experiments.measures.hausdorff import LARGEST
from impact_xval.experiments.sweep.chunk import warm
from impact_xval.experiments.sweep.pool import Slot, SlotPool
from impact_xval.experiments.sweep.process import FaultError, retry_once
from impact_xval.experiments.sweep.rows import Experiment, settings_of
from impact_xval.experiments.tables.folder import RunFolder
from impact_xval.experiments.tables.frames import Record
from impact_xval.experiments.tables.parquet import replacing
from impact_xval.experiments.tables.schema import SOLVER_AND_STATUS, Column, arrow_schema, pick
from impact_xval.model.status import RESULT_STATUSES

CURVES = "curves.parquet"

#: Largest distance of a force from the straight lines that draw it, over the largest force: less than a pen is wide.
_STRAIGHT = 1e-3

#: Schema of the table of curves: one row per solver.
CURVES_SCHEMA = arrow_schema(
    (
        *pick(SOLVER_AND_STATUS, ("solver", "status", "reason")),
        Column("velocities", "floats", "-", "final velocities per |v0|, ball 1 first"),
        Column("impulses", "lists", "-", "of each contact so far, per m1 |v0|; of two balls"),
        Column(
            "time",
            "floats",
            "-",
            "of forces since first touch, in its unit, (m1/k1 |v0|^(1 - p))^(1/(p + 1))",
        ),
        Column("forces", "lists", "-", "of each contact, per m1 |v0| and that time; of chains of N balls"),
    )
)


def write_curves(config: Config, folder: RunFolder, pool: SlotPool[Experiment]) -> None:
    """Solve the cell, or the chain, of the figures by every solver, and keep its curves; of graphs there are none."""
    names = [] if config.kind == "graph" else config.solvers
    calls = [pool.submit(_solve_curves, name, config.cell_timeout) for name in names]
    curves = pa.Table.from_pylist([call.result() for call in calls], CURVES_SCHEMA)
    with replacing(folder.root / CURVES) as temporary:
        pq.write_table(curves, temporary, compression="zstd")


def _solve_curves(slot: Slot[Experiment], name: str, timeout: float) -> Record:
    """Have the curves of a solver computed in its process; the row of one that fails says so."""

    def call() -> Record:
        slot.prepare(name, warm, slot.context.resolve, name, slot.context.layout.kind)
        return slot.call(name, _curves_of_solver, name, timeout=timeout)

    def row_of_failure(fault: FaultError) -> Record:
        return {"solver": name, "status": fault.status, "reason": fault.reason}

    return retry_once(call, row_of_failure)


def _curves_of_solver(experiment: Experiment, name: str) -> Record:
    """Solve the cell or the chain of the figures: return velocities and, with a path, impulses or forces."""
    config, pair = experiment.config, experiment.layout.pair
    collision = collision_of(config, config.figure_cell) if pair else config.figure_chain.collision()
    outcome = answer(experiment.resolve(name), [collision], settings_of(config))[0]
    row: Record = {"solver": name, "status": outcome.status, "reason": outcome.reason or None}
    if outcome.status not in RESULT_STATUSES:
        return row
    path = outcome.path
    time, speed, impulse = collision.units
    row["velocities"] = [v / speed for v in outcome.velocities]
    if path is not None and pair:
        impulses = path.impulses.T / impulse
        # A curve with a larger impulse has no measure either.
        row["impulses"] = impulses.tolist() if np.abs(impulses).max() <= LARGEST else None
    elif path is not None:
        kept = points_to_keep(path.time, path.forces)
        row["time"] = (path.time[kept] / time).tolist()
        row["forces"] = (path.forces[kept].T / (impulse / time)).tolist()
    return row


def points_to_keep(time: np.ndarray, forces: np.ndarray) -> np.ndarray:
    """Pick points such that straight lines between them follow the forces within `_STRAIGHT` of the largest force.

    Peaks are among the points. By Ramer, Douglas and Peucker: the point farthest from a line is kept, until none is
    far.
    """
    kept = np.zeros(len(time), bool)
    kept[[0, -1]] = True
    kept[forces.argmax(axis=0)] = True
    far = _STRAIGHT * np.abs(forces).max()
    spans = list(pairwise(np.flatnonzero(kept).tolist()))
    while spans:
        a, b = spans.pop()
        if b - a < 2:
            continue
        share = (time[a : b + 1] - time[a]) / max(time[b] - time[a], np.finfo(float).tiny)
        line = forces[a] + share[:, None] * (forces[b] - forces[a])
        distance = np.abs(forces[a : b + 1] - line).max(axis=1)[1:-1]
        if distance.max() > far:
            farthest = a + 1 + int(distance.argmax())
            kept[farthest] = True
            spans += [(a, farthest), (farthest, b)]
    return np.flatnonzero(kept)
