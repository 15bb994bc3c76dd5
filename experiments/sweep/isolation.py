"""A chunk of cells in a sandbox: what crashes or hangs is found by halving, and becomes rows of its own.

The whole chunk is asked for at once. If the process dies of it, or is silent for longer than `cell_timeout`,
each half is asked for in a new process, and so on down to single cells, so that everything but the cells at
fault is answered. The last beat names the solver that was at work. It is blamed for a cell (status
``crashed`` or ``timeout``) when the cell failed by it alone and once before, in a larger batch or alone: one
death may have been anybody's (a full memory, an operator), and costs nothing but time.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import pyarrow as pa

from impact_xval.experiments.config.grid import GridCell
from impact_xval.experiments.sweep.sandbox import FaultError, Sandbox, SandboxError
from impact_xval.experiments.sweep.solving import (
    Failures,
    Seconds,
    Versions,
    compute,
)
from impact_xval.experiments.tables.store import part_bytes

#: Deaths in which one solver was at work on a cell, the last of them on this cell alone, before it is blamed.
_STRIKES = 2
#: Deaths outside of every solver that are borne before the run is ended.
_OUTSIDE = 5


@dataclass(frozen=True, slots=True)
class Task:
    """One chunk to be computed.

    Attributes
    ----------
    number : int
        Number of the chunk.
    cells : sequence of GridCell
        Its cells.
    patience : float
        Seconds that one solver may take over one cell.
    """

    number: int
    cells: Sequence[GridCell]
    patience: float


@dataclass(frozen=True, slots=True)
class Report:
    """What came of a task.

    Attributes
    ----------
    number : int
        Number of the chunk.
    data : bytes
        Its rows, as the content of a part.
    seconds : dict
        Wall time by solver.
    versions : dict
        Of the project and of every solver where the chunk was computed.
    faults : int
        Processes that died or were ended.
    """

    number: int
    data: bytes
    seconds: Seconds
    versions: Versions | None
    faults: int


def run_task(sandbox: Sandbox, task: Task) -> Report:
    """Compute a chunk in a sandbox, whatever its solvers do."""
    work = _Work(sandbox, task.patience)
    tables = work.rows(task.cells, Counter())
    data = part_bytes(pa.concat_tables(tables))
    return Report(task.number, data, dict(work.seconds), sandbox.prepared, work.faults)


class _Work:
    def __init__(self, sandbox: Sandbox, patience: float) -> None:
        self._sandbox, self._patience = sandbox, patience
        self.seconds: Counter[str] = Counter()
        self.faults = 0

    def rows(self, cells: Sequence[GridCell], strikes: Counter[str]) -> list[pa.Table]:
        """Return the rows of all cells; `strikes` counts the deaths of batches these cells were in, by solver."""
        try:
            return [self._ask(cells, {})]
        except FaultError as fault:
            strikes = strikes + Counter([fault.at])
            if len(cells) == 1:
                return [self._alone(cells[0], fault, strikes)]
        middle = len(cells) // 2
        return [*self.rows(cells[:middle], strikes), *self.rows(cells[middle:], strikes)]

    def _alone(self, cell: GridCell, fault: FaultError, strikes: Counter[str]) -> pa.Table:
        """Answer a cell that has failed alone: without the solvers that are to blame."""
        failures: Failures = {}
        while True:
            if not fault.at and strikes[""] > _OUTSIDE:
                raise SandboxError(f"cell {cell.index}, outside of every solver: {fault.reason}")
            if fault.at and strikes[fault.at] >= _STRIKES:
                failures[fault.at] = (fault.status, fault.reason)
            try:
                return self._ask([cell], failures)
            except FaultError as again:
                fault = again
                strikes = strikes + Counter([fault.at])

    def _ask(self, cells: Sequence[GridCell], failures: Failures) -> pa.Table:
        try:
            rows, seconds = self._sandbox.call(compute, cells, failures, patience=self._patience)
        except FaultError:
            self.faults += 1
            raise
        self.seconds.update(seconds)
        return rows
