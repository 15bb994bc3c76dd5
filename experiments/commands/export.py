"""What ``impact-xval export-scene`` does: one cell as files that an engine runs alone."""

from __future__ import annotations

import math
from pathlib import Path

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.calibration.scene_text import EXPORTABLE, scene_files
from impact_xval.compliant_baselines.contact.column import column_of, unrepresentable
from impact_xval.compliant_baselines.contract.solver import Settings
from impact_xval.compliant_baselines.engines.engine import EngineSolver, outcome_of
from impact_xval.experiments.commands.options import whole
from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.presentation.terminal import make_console, print_line
from impact_xval.experiments.sweep.designs import cells_of_run
from impact_xval.experiments.sweep.solving import settings_of
from impact_xval.experiments.tables.store import RunFolder, write_text
from impact_xval.model.collision import Collision

#: Difference, per |v0|, above which a tabulated velocity is not the one that was run again.
SAME = 1e-12


def export_cell(root: RunFolder, cell: str, solvers: list[str] | None, out: Path | None) -> None:
    """Export a cell of a finished run, and say whether it came out as tabulated.

    Raises
    ------
    UserError
        If there is no such cell, or the engine gives no result for it.
    """
    config = root.config()
    grid = cells_of_run(root, config)
    index = whole("--cell", cell, 0, len(grid) - 1)
    names = _names(solvers, [name for name in EXPORTABLE if name in config.solvers])
    where = out or Path("scenes") / f"{root.root.resolve().name}-cell-{index}"
    export(grid[index].collision, settings_of(config), names, where, _tabulated(root, index))


def export(
    collision: Collision,
    settings: Settings,
    solvers: list[str],
    out: Path,
    tabulated: dict[str, tuple[float, float]] | None = None,
) -> None:
    """Write a folder for each engine.

    Parameters
    ----------
    collision : Collision
        What to run.
    settings : Settings
        How.
    solvers : list of str
        Of `EXPORTABLE`.
    out : Path
        Folder to write; made if it is not there.
    tabulated : dict, optional
        v1 and v2 in m/s of a run's table, by solver.

    Raises
    ------
    UserError
        If an engine gives no result, or the folder cannot be written to.
    """
    written: list[tuple[Path, str]] = []
    lines: list[str] = []
    for name in solvers:
        solver = get_solver(name)
        assert isinstance(solver, EngineSolver)
        reason = solver.unavailable()
        if reason is not None:
            raise UserError(f"{name}: unavailable: {reason}")
        refused = unrepresentable(collision)
        column = None if refused else column_of(collision, settings)
        refused = refused or (solver.refusal(column) if column is not None else None)
        if refused or column is None:
            raise UserError(f"{name}: unrepresentable: {refused}")
        run, files = scene_files(solver, column, settings.max_steps)
        outcome = outcome_of(name, run, settings)
        if math.isnan(outcome.v1):
            raise UserError(f"{name}: {outcome.status}: {outcome.reason}")
        lines.append(f"{name}: v1 = {outcome.v1!r} m/s, v2 = {outcome.v2!r} m/s, {run.raw.n_steps} steps")
        if (outcome.v1, outcome.v2) != (run.v1, run.v2):
            lines.append(
                f"  at rest on the table when the collision was over: the script gives {run.v1!r}, {run.v2!r}"
            )
        if tabulated is not None:
            lines.append("  " + _against(tabulated.get(name), outcome.v1, outcome.v2, abs(collision.v0)))
        written += [(out / name / file, text) for file, text in files.items()]
    for path, text in written:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UserError(f"--out {out}: cannot be written to: {error.strerror}") from None
        write_text(path, text)
    console = make_console()
    for line in lines:
        print_line(console, line)
    for name in solvers:
        print_line(console, f"to check: python {out / name / 'run.py'}")


def names_of(solvers: list[str] | None) -> list[str]:
    """Check the names of engines; without any, those that are installed.

    Raises
    ------
    UserError
        If a name is not that of an engine that can be exported.
    """
    installed = [name for name in EXPORTABLE if get_solver(name).unavailable() is None]
    return _names(solvers, installed)


def _names(solvers: list[str] | None, default: list[str]) -> list[str]:
    names = list(dict.fromkeys(solvers or default))
    for name in names:
        if name not in EXPORTABLE:
            raise UserError(f"--solver = {name!r}; legal: {', '.join(EXPORTABLE)}")
    if not names:
        raise UserError(f"--solver: none of {', '.join(EXPORTABLE)} is there to export")
    return names


def _against(table: tuple[float, float] | None, v1: float, v2: float, speed: float) -> str:
    if table is None:
        return "the table holds no result of it"
    apart = max(abs(v1 - table[0]), abs(v2 - table[1])) / speed
    if apart <= SAME:
        return f"as in the table (difference {apart:.1e} |v0|)"
    return (
        f"NOT as in the table: {table[0]!r}, {table[1]!r} (difference {apart:.1e} |v0|); "
        "the engine's version may be another one, see manifest.json"
    )


def _tabulated(root: RunFolder, index: int) -> dict[str, tuple[float, float]]:
    import pyarrow.parquet as pq

    from impact_xval.experiments.tables.schema import CELLS_SCHEMA

    path = root.table_path("cells.parquet", CELLS_SCHEMA)
    rows = pq.read_table(path, columns=["solver", "v1", "v2"], filters=[("cell", "==", index)]).to_pylist()
    return {row["solver"]: (row["v1"], row["v2"]) for row in rows if row["v1"] is not None}
