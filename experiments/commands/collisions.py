"""Commands for one collision, or one column: solved by every solver, or written as files that an engine runs alone."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from impact_xval.experiments.commands.options import (
    ARRANGEMENT,
    BALLS,
    CELL_TIMEOUT,
    CUTOFF,
    E1,
    E2,
    EXPONENT,
    GAP,
    GRAVITY,
    JSON_LIST,
    K1,
    M1,
    MAPPING,
    MASS_RATIO,
    MASS_TAPER,
    RATIOS,
    SCENARIO,
    SOLVER,
    STEP_FRACTION,
    STIFFNESS_RATIO,
    STIFFNESS_TAPER,
    STRIKE,
    V0,
    E,
    K,
    M,
    file_to_write,
    folder_to_write,
    one_cell,
    one_column,
    path,
    typed,
    whole,
)
from impact_xval.experiments.config.errors import UserError

if TYPE_CHECKING:
    from impact_xval.compliant_baselines import Settings
    from impact_xval.experiments.cells.compared import Compared
    from impact_xval.experiments.measures.divergence import Measures
    from impact_xval.experiments.tables.folder import RunFolder
    from impact_xval.model import Collision, Outcome

#: Difference, per |v0|, above which a tabulated velocity is not the one that was run again.
SAME = 1e-12


def solve(
    context: typer.Context,
    stiffness_ratio: Annotated[str, STIFFNESS_RATIO],
    mass_ratio: Annotated[str, MASS_RATIO],
    e1: Annotated[str, E1],
    e2: Annotated[str, E2],
    solver: Annotated[list[str] | None, SOLVER] = None,
    json: Annotated[bool, JSON_LIST] = False,
    plot: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            parser=path("--plot"),
            help="Draw impulse curves and velocities into a file that ends in .png, .svg or .pdf.",
        ),
    ] = None,
    scenario: Annotated[str, SCENARIO] = "impact",
    gravity: Annotated[str | None, GRAVITY] = None,
    m1: Annotated[str, M1] = "1",
    k1: Annotated[str, K1] = "1e8",
    v0: Annotated[str, V0] = "-1",
    step_fraction: Annotated[str, STEP_FRACTION] = "1e-3",
    mapping: Annotated[str, MAPPING] = "calibrated",
    cutoff: Annotated[str, CUTOFF] = "exact",
    cell_timeout: Annotated[str, CELL_TIMEOUT] = "300",
) -> None:
    """Solve one collision by every solver and show the results side by side.

    Velocities are per |v0|, those of the diagnostics too, impulses per m1 |v0|, times in s. Without gravity
    velocities and impulses depend on the four ratios only; mass, stiffness and velocity matter to a drop.
    """
    from json import dumps

    from impact_xval.experiments.sweep.one import solvers_apart

    if plot is not None:
        file_to_write("--plot", plot, (".png", ".svg", ".pdf"))
    with solvers_apart(solver or ()) as apart:
        from impact_xval.compliant_baselines.registry import get_solver
        from impact_xval.experiments.config.cells import collision_of
        from impact_xval.experiments.config.experiment import REFERENCE

        config = one_cell(context.params)
        collision = collision_of(config, config.figure_cell)
        outcomes = apart.solve(collision, config, known_solvers(solver), get_solver, say)
    if json:
        model = outcomes[REFERENCE]
        objects = [_object(name, collision, each, model) for name, each in outcomes.items()]
        print(dumps(objects, indent=2, allow_nan=False))
    else:
        from impact_xval.experiments.cells.compared import Compared

        _show(Compared(collision, outcomes))
    if plot is not None:
        _plot(plot, collision, outcomes, config.scenario)


def _plot(file: Path, collision: Collision, outcomes: dict[str, Outcome], scenario: str) -> None:
    """Draw one collision into a file; what is said goes to standard error, beside JSON."""
    from impact_xval.experiments.presentation.pictures.one import drawn_paths, write_plot
    from impact_xval.experiments.presentation.terminal import error_line

    paths = drawn_paths(collision, outcomes)
    if not paths:
        raise UserError(
            f"--plot {file}: no solver has a path to draw; legal: a collision that one of them solves"
        )
    error_line(f"{file}: {write_plot(collision, paths, scenario, file)}")


def known_solvers(solvers: list[str] | None) -> list[str]:
    """Check the names of solvers, and add the model, as a run does; without any, those that a run has by default.

    The model comes last where it was not asked for: the objects of ``--json`` begin with those that were.
    """
    from impact_xval.compliant_baselines.registry import solver_names
    from impact_xval.experiments.config.experiment import REFERENCE, solvers_problem

    names = solvers or list(solver_names())
    problem = solvers_problem(names)
    if problem:
        raise UserError(f"--solver {problem}")
    return names if REFERENCE in names else [*names, REFERENCE]


def say(line: str) -> None:
    """Say what is waited for, on standard error."""
    from impact_xval.experiments.commands.runs import COMPILING
    from impact_xval.experiments.presentation.terminal import error_line

    error_line(line or COMPILING)


def _show(compared: Compared) -> None:
    """Print one collision, or one column, by several solvers."""
    from impact_xval.experiments.presentation.terminal import make_console, show

    show(make_console(), compared.markdown())


def _object(name: str, collision: Collision, outcome: Outcome, model: Outcome) -> dict[str, Any]:
    """Return the JSON object of an outcome: velocities per abs(v0), impulses per m1 abs(v0), times in s."""
    from impact_xval.experiments.measures.divergence import velocity_divergence

    speed = abs(collision.v0)
    impulse = collision.m1 * speed
    return {
        "solver": name,
        "v1": _finite(outcome.v1 / speed),
        "v2": _finite(outcome.v2 / speed),
        "impulse1": _finite(outcome.impulse1 / impulse),
        "impulse2": _finite(outcome.impulse2 / impulse),
        "states": list(outcome.states),
        **_said(outcome),
        "velocity_divergence": velocity_divergence(collision, model, outcome),
        "diagnostics": _diagnostics(outcome, speed),
    }


def _diagnostics(outcome: Outcome, speed: float) -> dict[str, float | None]:
    from impact_xval.experiments.measures.results import scaled_diagnostics

    return {key: _finite(value) for key, value in scaled_diagnostics(outcome, speed).items()}


def _finite(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)


def cradle(
    context: typer.Context,
    balls: Annotated[str, BALLS] = "5",
    strike: Annotated[str | None, STRIKE] = None,
    e: Annotated[str, E] = "0.95",
    arrangement: Annotated[str, ARRANGEMENT] = "cradle",
    exponent: Annotated[str, EXPONENT] = "1",
    gap: Annotated[str, GAP] = "0",
    solver: Annotated[list[str] | None, SOLVER] = None,
    json: Annotated[bool, JSON_LIST] = False,
    m: Annotated[str, M] = "1",
    mass_taper: Annotated[str, MASS_TAPER] = "1",
    k: Annotated[str, K] = "1e8",
    stiffness_taper: Annotated[str, STIFFNESS_TAPER] = "1",
    v0: Annotated[str, V0] = "-1",
    step_fraction: Annotated[str, STEP_FRACTION] = "1e-3",
    mapping: Annotated[str, MAPPING] = "calibrated",
    cell_timeout: Annotated[str, CELL_TIMEOUT] = "300",
) -> None:
    """Solve one column of N balls, such as Newton's cradle, by every solver and show the results side by side.

    Ball 1 is on top, or strikes; up is positive; there is no gravity. Velocities are per |v0|, those of the
    diagnostics too, impulses per m |v0|, times in s.
    """
    from json import dumps

    from impact_xval.experiments.sweep.one import solvers_apart

    with solvers_apart(solver or (), columns=True) as apart:
        from impact_xval.compliant_baselines.registry import get_solver
        from impact_xval.experiments.measures.divergence import measures_of

        arranged, config = one_column(context.params)
        column = arranged.column()
        outcomes = apart.solve(column, config, known_solvers(solver), get_solver, say, points=0)
    if json:
        measures = measures_of(column, outcomes, config.mapping)
        units = abs(config.v0), arranged.m * abs(config.v0)
        objects = [_column_object(name, each, measures[name], *units) for name, each in outcomes.items()]
        print(dumps(objects, indent=2, allow_nan=False))
    else:
        from impact_xval.experiments.cells.compared import Compared

        _show(Compared(column, outcomes, arranged, config.mapping))


def _column_object(
    name: str,
    outcome: Outcome,
    measures: Measures,
    speed: float,
    impulse: float,
) -> dict[str, Any]:
    """Return the JSON object of an outcome of a column: velocities and impulses per those units, times in s."""
    from dataclasses import asdict

    return {
        "solver": name,
        "velocities": [_finite(v / speed) for v in outcome.velocities],
        "impulses": [_finite(i / impulse) for i in outcome.impulses],
        "states": outcome.states,
        **_said(outcome),
        **{key: _finite(value) for key, value in asdict(measures).items()},
        "diagnostics": _diagnostics(outcome, speed),
    }


def _said(outcome: Outcome) -> dict[str, Any]:
    return {
        "status": outcome.status,
        "reason": outcome.reason,
        "grazing_margin": _finite(outcome.grazing_margin),
        "marked": outcome.marked,
    }


def export_scene(
    context: typer.Context,
    folder: Annotated[
        Path | None,
        typer.Argument(metavar="[DIR]", parser=path("DIR"), help="Folder of a finished run, with --cell."),
    ] = None,
    cell: Annotated[str | None, typer.Option(metavar="N", help="Number of a cell of that run.")] = None,
    stiffness_ratio: Annotated[str | None, STIFFNESS_RATIO] = None,
    mass_ratio: Annotated[str | None, MASS_RATIO] = None,
    e1: Annotated[str | None, E1] = None,
    e2: Annotated[str | None, E2] = None,
    solver: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="'mujoco' or 'pybullet'; may be repeated. By default both."),
    ] = None,
    out: Annotated[Path | None, folder_to_write("by default in scenes/")] = None,
    scenario: Annotated[str | None, SCENARIO] = None,
    gravity: Annotated[str | None, GRAVITY] = None,
    m1: Annotated[str | None, M1] = None,
    k1: Annotated[str | None, K1] = None,
    v0: Annotated[str | None, V0] = None,
    step_fraction: Annotated[str | None, STEP_FRACTION] = None,
    mapping: Annotated[str | None, MAPPING] = None,
) -> None:
    """Write one cell as an MJCF file and as a PyBullet script that run in the engine alone.

    The cell is one of a finished run (DIR --cell N), or given by its ratios and, where they differ from what solve
    has by default, by the other options. The scripts print their velocities beside the tabulated ones and fail where
    they differ by more than 1e-12 of the speed.
    """
    from impact_xval.experiments.config.cells import collision_of
    from impact_xval.experiments.sweep.rows import settings_of
    from impact_xval.experiments.tables.folder import cells_of_run, finished_collisions

    given = typed(context.params)
    if folder is not None:
        if cell is None or given:
            raise UserError(f"{folder}: a cell of a run is named by --cell N, and by nothing else")
        run = finished_collisions(folder)
        config = run.config()
        cells = cells_of_run(run, config)
        index = whole("--cell", cell, 0, len(cells) - 1)
        names = _exportable(solver, config.solvers)
        collision, table = cells[index], _tabulated(run, index)
        where = f"{folder.resolve().name}-cell-{index}"
    else:
        missing = [f"--{key.replace('_', '-')}" for key in RATIOS if key not in given]
        if cell is not None or missing:
            wanted = ", ".join(missing) or "the folder of a run"
            raise UserError(f"{wanted} missing; legal: DIR --cell N, or the ratios of a collision")
        names, config = _exportable(solver), one_cell({"scenario": "impact"} | given)
        collision, table, where = collision_of(config, config.figure_cell), None, "collision"
    _export(collision, settings_of(config), names, out or Path("scenes") / where, table)


def _exportable(solvers: list[str] | None, of_run: list[str] | None = None) -> list[str]:
    """Check the names of engines; without any, those of a run or else those that are installed."""
    from impact_xval.compliant_baselines import get_solver
    from impact_xval.compliant_baselines.registry import exportable_names

    legal = exportable_names()
    if not solvers:
        solvers = [
            name
            for name in legal
            if (get_solver(name).unavailable() is None if of_run is None else name in of_run)
        ]
    for name in solvers:
        if name not in legal:
            raise UserError(f"--solver = {name!r}; legal: {', '.join(legal)}")
    if not solvers:
        raise UserError(f"--solver: none of {', '.join(legal)} is there to export")
    return list(dict.fromkeys(solvers))


def _export(
    collision: Collision,
    settings: Settings,
    names: list[str],
    out: Path,
    tabulated: dict[str, tuple[float, float]] | None,
) -> None:
    """Run a collision by every engine named, and only then write a folder for each.

    Parameters
    ----------
    tabulated : dict, optional
        v1 and v2 in m/s of a run's table, by solver.
    """
    from impact_xval.experiments.presentation.terminal import make_console, print_line
    from impact_xval.experiments.tables.folder import write_text

    texts: dict[Path, str] = {}
    lines: list[str] = []
    for name in names:
        run, outcome, files = _run_alone(name, collision, settings)
        lines.append(f"{name}: v1 = {outcome.v1!r} m/s, v2 = {outcome.v2!r} m/s, {run.n_steps} steps")
        if outcome.velocities != tuple(v := run.velocities.tolist()):
            given = ", ".join(map(repr, v))
            lines.append(f"  at rest on the table when the collision was over: the script gives {given}")
        if tabulated is not None:
            lines.append("  " + _against(tabulated.get(name), outcome, abs(collision.v0)))
        texts |= {out / name / file: text for file, text in files.items()}
    for file, text in texts.items():
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UserError(f"--out {out}: cannot be written to: {error.strerror}") from None
        write_text(file, text)
    console = make_console()
    for line in (*lines, *(f"to check: python {out / name / 'run.py'}" for name in names)):
        print_line(console, line)


def _run_alone(name: str, collision: Collision, settings: Settings) -> tuple[Any, Outcome, dict[str, str]]:
    """Run a collision by an engine: the run, its outcome, and the files to run it without this package."""
    from impact_xval.compliant_baselines import get_solver
    from impact_xval.compliant_baselines.engines.engine import Engine, outcome_of
    from impact_xval.compliant_baselines.paste import scene_files

    solver = get_solver(name)
    assert isinstance(solver, Engine)
    reason = solver.unavailable()
    if reason is not None:
        raise UserError(f"{name}: unavailable: {reason}")
    scene = solver.scene_or_refusal(collision, settings)
    if isinstance(scene, str):
        raise UserError(f"{name}: unrepresentable: {scene}")
    run, files = scene_files(solver, scene, settings.max_steps)
    outcome = outcome_of(name, collision, run, settings)
    if math.isnan(outcome.v1):
        raise UserError(f"{name}: {outcome.status}: {outcome.reason}")
    return run, outcome, files


def _against(table: tuple[float, float] | None, outcome: Outcome, speed: float) -> str:
    if table is None:
        return "the table holds no result of it"
    apart = max(abs(outcome.v1 - table[0]), abs(outcome.v2 - table[1])) / speed
    if apart <= SAME:
        return f"as in the table (difference {apart:.1e} |v0|)"
    return (
        f"NOT as in the table: {table[0]!r}, {table[1]!r} (difference {apart:.1e} |v0|); "
        "the engine's version may be another one, see manifest.json"
    )


def _tabulated(root: RunFolder, index: int) -> dict[str, tuple[float, float]]:
    import pyarrow.parquet as pq

    path = root.table_path("cells.parquet")
    rows = pq.read_table(path, columns=["solver", "v1", "v2"], filters=[("cell", "==", index)]).to_pylist()
    return {row["solver"]: (row["v1"], row["v2"]) for row in rows if row["v1"] is not None}
