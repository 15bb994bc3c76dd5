"""Table of the curves that a run keeps for its figures: the curves of one pair or one chain, by every solver.

For a pair the table has impulse curves, for a chain it has forces over time. `run` calls `write_curves` at the end of a
run.
"""

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

#: Name of the file of curves in the folder of a run.
CURVES = "curves.parquet"

#: Largest distance between a force and the straight lines that are drawn in its place, over the largest force. This
#: distance is less than the width of a line in a figure.
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
    """Solve the one pair or chain that the figures of a run show, by every solver, and write the curves into a file.

    The file lies in the folder of the run.

    For an experiment with contact graphs the table of curves is empty.
    """
    names = [] if config.kind == "graph" else config.solvers
    calls = [pool.submit(_solve_curves, name, config.cell_timeout) for name in names]
    curves = pa.Table.from_pylist([call.result() for call in calls], CURVES_SCHEMA)
    with replacing(folder.root / CURVES) as temporary:
        pq.write_table(curves, temporary, compression="zstd", write_page_checksum=True)


def _solve_curves(slot: Slot[Experiment], name: str, timeout: float) -> Record:
    """Return the row of curves of a solver, computed in the worker process of the solver.

    If the process fails, the row has the status and the reason of the failure and no curves.
    """

    def call() -> Record:
        slot.prepare(name, warm, slot.context.resolve, name, slot.context.layout.kind)
        return slot.call(name, _curves_of_solver, name, timeout=timeout)

    def row_of_failure(fault: FaultError) -> Record:
        return {"solver": name, "status": fault.status, "reason": fault.reason}

    return retry_once(call, row_of_failure)


def _curves_of_solver(experiment: Experiment, name: str) -> Record:
    """Solve the one pair or chain that the figures show by a solver, and return the solver's row of curves.

    The row has the final velocities. If the outcome has a path, the row also has the impulses of a pair or the forces
    of a chain.
    """
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
        # With a larger impulse, the distance between impulse curves would overflow.
        row["impulses"] = impulses.tolist() if np.abs(impulses).max() <= LARGEST else None
    elif path is not None:
        kept = points_to_keep(path.time, path.forces)
        row["time"] = (path.time[kept] / time).tolist()
        row["forces"] = (path.forces[kept].T / (impulse / time)).tolist()
    return row


def points_to_keep(time: np.ndarray, forces: np.ndarray) -> np.ndarray:
    """Return the indices of points that are enough to draw forces over time by straight lines.

    The lines follow the forces within `_STRAIGHT` times the largest force, and the peak of every force is kept. The
    method is the one of Ramer, Douglas and Peucker. It draws a line between two points that are kept. Of the points
    between them, it keeps the point that is farthest from this line. It repeats this until no point is too far from a
    line.

    Parameters
    ----------
    time : array of shape (n,)
    forces : array of shape (n, contacts)
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
