"""The worst divergence in a box of parameters, by differential evolution.

Generations of a population are batches of cells, solved side by side like those of a sweep, kept as parts,
and found again by a search that is resumed: with the same seed it takes the same way. Marked cells, beside
a jump, count as nothing, since there any divergence is found; so do cells without a result. What is found
is confirmed with the step halved twice: a divergence that moves with the step would be the integrator's, not
the law's.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray

from impact_xval.compliant_baselines import get_solver
from impact_xval.experiments.config.axes import AXES, Search
from impact_xval.experiments.config.configuration import REFERENCE, Config
from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.config.grid import CellList, GridCell
from impact_xval.experiments.sweep.designs import unit_points
from impact_xval.experiments.sweep.executors import available_cores, in_flight, open_executor
from impact_xval.experiments.sweep.isolation import Task, run_task
from impact_xval.experiments.sweep.run import Progress, clearly
from impact_xval.experiments.sweep.sandbox import Beat, FaultError, Sandbox
from impact_xval.experiments.sweep.solving import (
    Job,
    Resolve,
    solve_cells,
    solver_versions,
)
from impact_xval.experiments.tables.folders import open_folder
from impact_xval.experiments.tables.lock import holding
from impact_xval.experiments.tables.schema import COLUMNS, DIVERGENCE_SCHEMA
from impact_xval.experiments.tables.store import (
    MANIFEST,
    RunFolder,
    part_bytes,
    read_part,
    write_json,
    write_text,
)
from impact_xval.experiments.tables.streams import table_writer

FORMAT = "impact-xval search, format 1"
EVALUATIONS = "evaluations.parquet"
WORST = "worst.csv"

#: Cells listed as the worst.
_LISTED = 10
#: Steps, over that of the configuration, at which the worst cell is solved again.
_STEPS = (1.0, 0.5, 0.25)


@dataclass(frozen=True, slots=True)
class Found:
    """What a search found.

    Attributes
    ----------
    search : Search
    rows : list of dict
        The worst cells, the worst first, as rows of the table of evaluations.
    confirmed : list of dict
        The worst cell again: ``step_fraction``, ``value`` of the measure (None without a result), ``status``.
    evaluated, marked, failed : int
        Cells that were solved; those marked, and those without a result.
    best : list of float
        Largest value so far after each generation.
    """

    search: Search
    rows: list[dict[str, Any]]
    confirmed: list[dict[str, Any]]
    evaluated: int
    marked: int
    failed: int
    best: list[float]


def search_worst(
    config: Config,
    root: Path,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    resume: bool = False,
    isolate: bool = True,
    progress: Progress = lambda done, total, line: None,
    resolve: Resolve = get_solver,
) -> Found:
    """Search a box for the largest divergence and write what was found into a folder.

    Parameters
    ----------
    config : Config
        The experiment; its ``search`` says where, which solver and which measure.
    root, workers, scheduler, resume, isolate, progress, resolve
        As for `sweep.run_sweep`.

    Returns
    -------
    Found

    Raises
    ------
    UserError
        If the box has no range, or the folder cannot be used.
    InterruptedRunError
        On Ctrl-C, a full disk or a lost cluster; finished generations are kept.
    """
    search = config.search or Search.model_validate({})
    if not search.free():
        raise UserError("search: every parameter is a number; legal: one range or more")
    config = config.model_copy(update={"solvers": [REFERENCE, search.solver], "search": search})
    workers = workers or config.workers or available_cores()
    folder, continued = open_folder(root, resume=resume, format=FORMAT)
    manifest = {
        "format": FORMAT,
        "state": "running",
        "configuration": config.canonical(),
        "versions": solver_versions(config, resolve),
    }
    identity = json.dumps([config.identity(), search.model_dump(), manifest["versions"], list(COLUMNS)])
    with clearly(folder), holding(root) as line:
        progress(0, 0, line)
        if continued and folder.manifest().get("configuration") != manifest["configuration"]:
            raise UserError(f"--resume {root}: holds a search of another configuration")
        write_json(root / MANIFEST, manifest)
        job, say = Job(config, resolve), lambda text: progress(0, 0, text)
        with open_executor(job, workers, scheduler, say, isolate=isolate) as executor:
            work = _Work(config, search, folder, executor, identity, progress)
            work.run()
            found = work.found()
        _write(folder, config, found, manifest)
    return found


class _Work:
    def __init__(
        self,
        config: Config,
        search: Search,
        folder: RunFolder,
        executor: Any,
        identity: str,
        progress: Progress,
    ) -> None:
        self._config, self._search, self._folder, self._executor = config, search, folder, executor
        self._identity, self._progress = identity, progress
        self._generation = 0
        self.parts: list[Path] = []
        self.values: list[NDArray[np.float64]] = []
        self.cells: list[NDArray[np.float64]] = []

    def run(self) -> None:
        """Evolve; every generation is kept."""
        from scipy.optimize import differential_evolution

        d = len(self._search.free())
        first: Any = unit_points("sobol", self._search.population, d, self._search.seed)
        differential_evolution(
            self._objective,
            [(0.0, 1.0)] * d,
            init=first,
            maxiter=self._search.generations,
            tol=0.0,
            polish=False,
            updating="deferred",
            vectorized=True,
            rng=self._search.seed,
        )

    def _objective(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Evaluate a generation: minus the size of the measure, 0 where it does not count; x is (d, n)."""
        ratios = self._search.place(x.T)
        start = sum(map(len, self.cells))
        cells = CellList(self._config, np.vstack([*self.cells, ratios])).cells(
            range(start, start + len(ratios))
        )
        identity = hashlib.sha256(self._identity.encode() + ratios.astype("<f8").tobytes()).hexdigest()[:32]
        part = self._folder.find_part(self._generation, identity)
        if part is None:
            part = self._folder.write_part(self._generation, identity, self._solve(cells))
        table = read_part(part).filter(pc.field("solver") != REFERENCE)
        self.parts.append(part)
        self.cells.append(ratios)
        self.values.append(self._counted(table))
        self._generation += 1
        total = self._search.population * (self._search.generations + 1)
        self._progress(sum(map(len, self.cells)), total, "")
        return -self.values[-1]

    def _solve(self, cells: Sequence[GridCell]) -> bytes:
        size = max(1, -(-len(cells) // (4 * max(1, self._executor.workers))))
        tasks = [
            Task(n, cells[i : i + size], self._config.cell_timeout)
            for n, i in enumerate(range(0, len(cells), size))
        ]
        reports = in_flight(
            lambda task: self._executor.submit(run_task, task),
            tasks,
            lambda: max(2, 2 * self._executor.workers),
        )
        done = {report.number: report.data for report in reports}
        tables = [read_part(done[n]) for n in sorted(done)]
        return part_bytes(pa.concat_tables(tables))

    def _counted(self, table: pa.Table) -> NDArray[np.float64]:
        """Size of the measure; 0 for marked cells, and without a result."""
        value = np.abs(table.column(self._search.measure).to_numpy().astype(float))
        return np.where(np.isnan(value) | _marked(table), 0.0, value)

    def found(self) -> Found:
        """Write the table of evaluations, and say what is in it."""
        with table_writer(self._folder.root / EVALUATIONS, DIVERGENCE_SCHEMA) as table:
            for part in self.parts:
                rows = read_part(part)
                table.add(rows.filter(pc.field("solver") != REFERENCE))
        everything = pq.read_table(self._folder.root / EVALUATIONS)
        values = np.concatenate(self.values)
        order = np.argsort(-values, kind="stable")
        order = order[values[order] > 0][:_LISTED]
        rows = everything.take(order).to_pylist()
        measured = everything.column(self._search.measure).to_numpy().astype(float)
        marked = _marked(everything)
        return Found(
            search=self._search,
            rows=rows,
            confirmed=[self._again(int(order[0]), factor) for factor in _STEPS] if len(order) else [],
            evaluated=len(values),
            marked=int(marked.sum()),
            failed=int((np.isnan(measured) & ~marked).sum()),
            best=np.maximum.accumulate([values.max() for values in self.values]).tolist(),
        )

    def _again(self, index: int, factor: float) -> dict[str, Any]:
        cell = CellList(self._config, np.vstack(self.cells))[index]
        fraction = self._config.step_fraction * factor
        row = self._executor.submit(_confirm, cell, fraction, self._config.cell_timeout).result()
        value = row.get(self._search.measure)
        return {
            "step_fraction": fraction,
            "value": None if value is None else abs(value),
            "status": row["status"],
        }


def _confirm(sandbox: Sandbox, cell: GridCell, fraction: float, patience: float) -> dict[str, Any]:
    try:
        return sandbox.call(_with_step, cell, fraction, patience=patience)
    except FaultError as fault:
        return {"status": fault.status}


def _with_step(job: Job, cell: GridCell, fraction: float, *, beat: Beat) -> dict[str, Any]:
    config = job.config.model_copy(update={"step_fraction": fraction})
    rows, _ = solve_cells(config, [cell], job.resolve, beat=beat)
    return rows[-1]


def _write(folder: RunFolder, config: Config, found: Found, manifest: dict[str, Any]) -> None:
    lines = [",".join(AXES), *(",".join(repr(row[axis]) for axis in AXES) for row in found.rows)]
    write_text(folder.root / WORST, "\n".join(lines) + "\n")
    write_json(
        folder.root / MANIFEST,
        manifest
        | {
            "state": "complete",
            "evaluated": found.evaluated,
            "marked": found.marked,
            "failed": found.failed,
            "best": found.best,
            "worst": [{key: _plain(value) for key, value in row.items()} for row in found.rows],
            "confirmed": found.confirmed,
        },
    )


def _plain(value: Any) -> Any:
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


def _marked(table: pa.Table) -> NDArray[np.bool_]:
    return table.column("marked").is_valid().to_numpy().astype(bool)
