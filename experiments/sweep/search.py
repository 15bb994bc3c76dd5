"""The worst divergence in a box of parameters, by differential evolution.

Generations of a population are batches of cells, solved side by side like those of a sweep, kept as parts,
and found again by a search that is resumed: with the same seed it takes the same way. Marked cells, beside
a jump, count as nothing, since there any divergence is found; so do cells without a result. What is found
is confirmed with the step halved twice: a divergence that moves with the step would be the integrator's, not
the law's.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from impact_xval.compliant_baselines import get_solver
from impact_xval.experiments.config.axes import AXES, Search
from impact_xval.experiments.config.configuration import REFERENCE, Config
from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.config.grid import CellList, GridCell
from impact_xval.experiments.sweep.designs import unit_points
from impact_xval.experiments.sweep.executors import available_cores, open_executor
from impact_xval.experiments.sweep.run import Progress, kept
from impact_xval.experiments.sweep.sandbox import FaultError, Sandbox
from impact_xval.experiments.sweep.solving import (
    Experiment,
    Resolve,
    make_ready,
    prepare,
    solve_all,
    solve_chunks,
    solver_versions,
)
from impact_xval.experiments.sweep.third_party import contained, longest
from impact_xval.experiments.tables.schema import COLUMNS, DIVERGENCE_SCHEMA
from impact_xval.experiments.tables.store import (
    MANIFEST,
    DamagedManifestError,
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
    take_over: bool = False,
    isolate: bool = True,
    progress: Progress = lambda done, total, line: None,
    resolve: Resolve = get_solver,
    present: Callable[[RunFolder, Found], None] = lambda folder, found: None,
) -> Found:
    """Search a box for the largest divergence and write what was found into a folder.

    Parameters
    ----------
    config : Config
        The experiment; its ``search`` says where, which solver and which measure.
    root, workers, scheduler, resume, take_over, isolate, progress, resolve
        As for `sweep.run_sweep`.
    present : callable
        Given the folder and what was found once the table is written; the search is complete when it returns.

    Returns
    -------
    Found

    Raises
    ------
    UserError
        If the box has no range, or the folder cannot be used.
    InterruptedRunError
        As for `sweep.run_sweep`; finished generations are kept.
    """
    search = config.search or Search.model_validate({})
    if not search.free():
        raise UserError("search: every parameter is a number; legal: one range or more")
    config = config.model_copy(update={"solvers": [REFERENCE, search.solver], "search": search})
    if isolate:
        resolve = contained(resolve, config.cell_timeout)
    experiment, workers = Experiment(config, resolve), workers or config.workers or available_cores()
    with kept(root, resume, progress, FORMAT, take_over=take_over) as (folder, continued):
        manifest = {
            "format": FORMAT,
            "state": "running",
            "configuration": config.canonical(),
            "versions": solver_versions(experiment),
        }
        _check_same(folder, continued, manifest["configuration"], progress)
        identity, say = _identity(config, search, manifest["versions"]), functools.partial(progress, 0, 0)
        with open_executor(
            experiment, prepare, workers, scheduler=scheduler, isolate=isolate, say=say
        ) as executor:
            write_json(root / MANIFEST, manifest)
            evolution = _Evolution(config, search, folder, executor, identity, progress)
            found = evolution.run()
        _write(folder, evolution.evaluations(), found)
        present(folder, found)
        write_json(root / MANIFEST, manifest | _summary(found))
    return found


def _identity(config: Config, search: Search, versions: dict[str, str]) -> str:
    return json.dumps([config.identity(), search.model_dump(), versions, list(COLUMNS)])


def _check_same(
    folder: RunFolder, continued: bool, configuration: dict[str, Any], progress: Progress
) -> None:
    try:
        if continued and folder.manifest()["configuration"] != configuration:
            raise UserError(f"--resume {folder.root}: holds a search of another configuration")
    except DamagedManifestError as damage:  # generations of another search are neither used nor removed
        progress(0, 0, f"{damage}: it is written now")


class _Evolution:
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
        self._cells: list[GridCell] = []
        self._generations: list[pa.Table] = []
        self._best: list[float] = []

    def run(self) -> Found:
        """Evolve, every generation being kept, and say what was found."""
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
        return self.found()

    def _objective(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Evaluate a generation: minus the size of the measure, 0 where it does not count; x is (d, n)."""
        ratios = self._search.place(x.T)
        first, number = len(self._cells), len(self._generations)
        cells = CellList(self._config, ratios).cells(range(len(ratios)))
        cells = [dataclasses.replace(cell, index=first + cell.index) for cell in cells]
        identity = hashlib.sha256(self._identity.encode() + ratios.astype("<f8").tobytes()).hexdigest()[:32]
        part = self._folder.find_part(number, identity)
        total = self._search.population * (self._search.generations + 1)
        if part is None:
            self._progress(first, total, "")  # the pace is that of what is solved, not of what is kept
        rows = read_part(part) if part is not None else self._solve(cells)
        if part is None:
            self._folder.write_part(number, identity, part_bytes(rows))
        self._cells += cells
        self._generations.append(rows.filter(pc.field("solver") != REFERENCE))
        values = self._values(self._generations[-1])
        self._best.append(max([*self._best[-1:], float(values.max())]))
        if part is None or len(self._cells) == total:
            self._progress(len(self._cells), total, "")
        return -values

    def _solve(self, cells: list[GridCell]) -> pa.Table:
        size = max(1, -(-len(cells) // (4 * max(1, self._executor.workers))))
        chunks = ((start, cells[start : start + size]) for start in range(0, len(cells), size))
        reports = sorted(solve_chunks(self._executor, chunks), key=lambda report: report.number)
        return pa.concat_tables([read_part(report.data) for report in reports])

    def _values(self, table: pa.Table) -> NDArray[np.float64]:
        """Size of the measure; 0 for marked cells, and without a result."""
        value = np.abs(_numbers(table, self._search.measure))
        return np.where(np.isnan(value) | _marked(table), 0.0, value)

    def evaluations(self) -> pa.Table:
        """Return the rows of every cell."""
        return pa.concat_tables(self._generations)

    def found(self) -> Found:
        """Say what is among the evaluations."""
        everything = self.evaluations().select(DIVERGENCE_SCHEMA.names)
        values, marked = self._values(everything), _marked(everything)
        order = np.argsort(-values, kind="stable")
        order = order[values[order] > 0][:_LISTED]
        return Found(
            search=self._search,
            rows=everything.take(order).to_pylist(),
            confirmed=[self._again(self._cells[order[0]], factor) for factor in _STEPS] if len(order) else [],
            evaluated=len(values),
            marked=int(marked.sum()),
            failed=int((np.isnan(_numbers(everything, self._search.measure)) & ~marked).sum()),
            best=self._best,
        )

    def _again(self, cell: GridCell, factor: float) -> dict[str, Any]:
        fraction = self._config.step_fraction * factor
        name, timeout = self._search.solver, self._config.cell_timeout
        row = self._executor.submit(_confirm, cell, fraction, name, timeout).result()
        value = row.get(self._search.measure)
        return {
            "step_fraction": fraction,
            "value": None if value is None else abs(value),
            "status": row["status"],
        }


def _confirm(sandbox: Sandbox, cell: GridCell, fraction: float, name: str, timeout: float) -> dict[str, Any]:
    make_ready(sandbox, name)
    try:
        return sandbox.call(_with_step, cell, fraction, timeout=longest(name, 1, timeout))
    except FaultError as fault:
        return {"status": fault.status}


def _with_step(experiment: Experiment, cell: GridCell, fraction: float) -> dict[str, Any]:
    config = experiment.config.model_copy(update={"step_fraction": fraction})
    return solve_all(dataclasses.replace(experiment, config=config), [cell]).to_pylist()[-1]


def _write(folder: RunFolder, evaluations: pa.Table, found: Found) -> None:
    with table_writer(folder.root / EVALUATIONS, DIVERGENCE_SCHEMA) as table:
        table.add(evaluations)
    lines = [",".join(AXES), *(",".join(repr(row[axis]) for axis in AXES) for row in found.rows)]
    write_text(folder.root / WORST, "\n".join(lines) + "\n")


def _summary(found: Found) -> dict[str, Any]:
    """Describe what was found for the manifest of a complete search."""
    return {
        "state": "complete",
        "evaluated": found.evaluated,
        "marked": found.marked,
        "failed": found.failed,
        "best": found.best,
        "worst": [{key: _plain(value) for key, value in row.items()} for row in found.rows],
        "confirmed": found.confirmed,
    }


def _plain(value: Any) -> Any:
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


def _numbers(table: pa.Table, name: str) -> NDArray[np.float64]:
    return table.column(name).to_numpy().astype(float)


def _marked(table: pa.Table) -> NDArray[np.bool_]:
    return table.column("marked").is_valid().to_numpy().astype(bool)
