"""Curves kept for the figures.

Of two balls impulse curves of one cell by every solver; of N balls the forces of one column over time.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from impact_xval.compliant_baselines.answers import answer
from impact_xval.experiments.config.axes import AXES
from impact_xval.experiments.config.cells import collision_of
from impact_xval.experiments.config.experiment import Config
from impact_xval.experiments.measures.hausdorff import LARGEST
from impact_xval.experiments.sweep.pool import Slot
from impact_xval.experiments.sweep.process import FaultError, in_halves
from impact_xval.experiments.sweep.rows import Experiment, settings_of
from impact_xval.experiments.sweep.warmup import warm
from impact_xval.experiments.tables.folder import RunFolder
from impact_xval.experiments.tables.parquet import replacing
from impact_xval.experiments.tables.schema import PAIR, WHO, columns, schema
from impact_xval.model.collision import RESULT_STATUSES

FIGURE_CELL = "figure-cell"
CURVES = "curves.parquet"

#: How far a force may be from the straight lines it is drawn by, over the largest one: less than a pen is wide.
_STRAIGHT = 1e-3


CURVES_SCHEMA = schema(
    {"curve": ("text", "-", "which collision")}
    | {name: PAIR[name] for name in AXES}
    | {"solver": WHO["solver"]}
    | columns(
        """
        time      float  -  since first touch, per sqrt(m1/k1); of the model how long its forces take
        impulse1  float  -  ball-ball impulse so far, per m1 |v0|
        impulse2  float  -  ball-table impulse so far, per m1 |v0|
        state     int    -  1 to 4 for S1 to S4
        """
    )
)

#: Of a run of columns: a row a solver.
COLUMN_CURVES_SCHEMA = schema(
    {name: WHO[name] for name in ("solver", "status", "reason")}
    | columns(
        """
        velocities  floats  -  final velocities per |v0|, ball 1 first
        time        floats  -  since first touch, in its unit, (m1/k1 |v0|^(1 - p))^(1/(p + 1))
        forces      lists   -  of each contact, per m1 |v0| and that time
        """
    )
)


def write_curves(config: Config, folder: RunFolder, pool: Any) -> None:
    """Solve the cell, or the column, of the figures by every solver, and keep its curves."""
    pair = config.column is None
    solve = _curve if pair else _column_curve
    calls = [pool.submit(_solved, solve, name, config.cell_timeout, pair) for name in config.solvers]
    curves = pa.concat_tables(call.result() for call in calls)
    with replacing(folder.root / CURVES) as temporary:
        pq.write_table(curves, temporary, compression="zstd")


def _solved(slot: Slot, solve: Any, name: str, timeout: float, pair: bool) -> pa.Table:
    """Have the curves of a solver computed in its process; of one that fails a column's row says so."""

    def call(_: slice) -> pa.Table:
        slot.prepare(name, warm, slot.context.resolve, name, pair)
        return slot.call(name, solve, name, timeout=timeout)

    def lost(_: slice, fault: FaultError) -> pa.Table:
        row = {"solver": name, "status": fault.status, "reason": fault.reason}
        return CURVES_SCHEMA.empty_table() if pair else pa.Table.from_pylist([row], COLUMN_CURVES_SCHEMA)

    return in_halves(call, 1, lost)[0]


def _column_curve(experiment: Experiment, name: str) -> pa.Table:
    """Solve the column of the figures and keep its velocities and, of who has a path, its forces."""
    config, arranged = experiment.config, experiment.config.figure_column
    outcome = answer(experiment.resolve(name), [arranged.column()], settings_of(config))[0]
    row = {"solver": name, "status": outcome.status, "reason": outcome.reason or None}
    if outcome.status in RESULT_STATUSES:
        speed = abs(arranged.v0)
        row["velocities"] = [v / speed for v in outcome.velocities]
        if (path := outcome.path) is not None:
            m, k, p = arranged.m, arranged.k, arranged.exponent
            time = (m / k * speed ** (1 - p)) ** (1 / (p + 1))
            kept = needed(path.time, path.forces)
            row |= {
                "time": (path.time[kept] / time).tolist(),
                "forces": (path.forces[kept].T / (m * speed / time)).tolist(),
            }
    return pa.Table.from_pylist([row], COLUMN_CURVES_SCHEMA)


def needed(time: np.ndarray, forces: np.ndarray) -> np.ndarray:
    """Pick points between which straight lines are forces, within `_STRAIGHT` of the largest; peaks among them.

    Ramer, Douglas and Peucker: the point farthest from a line is kept, until none is far.
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
            between = a + 1 + int(distance.argmax())
            kept[between] = True
            spans += [(a, between), (between, b)]
    return np.flatnonzero(kept)


def _curve(experiment: Experiment, name: str) -> pa.Table:
    """Solve the cell of the figures and keep its curve, if it has one."""
    cell = experiment.config.figure_cell
    collision = collision_of(experiment.config, cell)
    outcome = answer(experiment.resolve(name), [collision], settings_of(experiment.config))[0]
    path = outcome.path
    if outcome.status not in RESULT_STATUSES or path is None:
        return CURVES_SCHEMA.empty_table()
    unit = collision.m1 * abs(collision.v0)
    i1, i2 = path.impulse1 / unit, path.impulse2 / unit
    if not max(np.abs(i1).max(), np.abs(i2).max()) <= LARGEST:  # nor has it a measure
        return CURVES_SCHEMA.empty_table()
    same = {"curve": FIGURE_CELL, **cell.model_dump(), "solver": name}
    found: dict[str, Any] = {key: [value] * len(i1) for key, value in same.items()}
    found |= {"time": path.time / collision.units.time, "impulse1": i1, "impulse2": i2, "state": path.state}
    return pa.table(found, schema=CURVES_SCHEMA)
