"""Commands for one collision: solved by every solver, in a browser, or written as files that an engine runs alone."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from impact_xval.experiments.commands.options import (
    OF_COLUMN,
    Json,
    Solvers,
    argument,
    asked,
    known_solvers,
    of_one_collision,
    option,
    path,
    print_json,
    whole,
)
from impact_xval.experiments.config.errors import UserError

if TYPE_CHECKING:
    from impact_xval.compliant_baselines import Settings
    from impact_xval.experiments.cells.compared import Compared
    from impact_xval.experiments.config.experiment import Config
    from impact_xval.model import Collision

#: What is drawn, and what moves, by the suffix of the file.
_PICTURES, _FILMS = (".png", ".svg", ".pdf"), (".gif", ".html")
#: Points of the path of a column that moves: of many balls it is large to be sent.
_POINTS = 4000


def _drawable(text: str) -> Path:
    """Read the path of a picture or film, which is known to be legal before anything is computed."""
    file = path(text)
    if file.suffix not in (*_PICTURES, *_FILMS) or file.is_dir():
        legal = f"a file that ends in {', '.join((*_PICTURES, *_FILMS))}"
        raise typer.BadParameter(f"{text!r:.60}; legal: {legal}")
    if not file.parent.is_dir():
        raise typer.BadParameter(f"{text!r:.60}: no folder {file.parent}; legal: a file in one that is there")
    return file


@of_one_collision()
def solve(
    *,
    solver: Solvers = None,
    plot: Path | None = option(
        "FILE", "Draw curves (.png, .svg, .pdf), or slow motion beside the model (.gif, .html).", _drawable
    ),
    json: Json = False,
    **typed: str | None,
) -> None:
    """Solve one collision by every solver.

    Two balls on a table, by ratios or in SI units, or N balls with --arrangement. Velocities are per |v0|, those of
    the diagnostics too, impulses per m1 |v0|, times in s.

    Example: impact-xval solve --stiffness-ratio 40 --mass-ratio 1.15 --e1 0.9 --e2 0.7
    """
    from impact_xval.experiments.presentation.terminal import error_line, make_console, say_waiting, show
    from impact_xval.experiments.sweep.one import solvers_apart

    film = plot is not None and plot.suffix in _FILMS
    columns = typed["arrangement"] is not None or typed["balls"] is not None
    with solvers_apart(solver or (), columns=columns) as apart:
        from impact_xval.compliant_baselines.registry import get_solver

        collision, arranged, config = asked(typed)
        points = None if arranged is None else _POINTS * film
        outcomes = apart.solve(
            collision, config, known_solvers(solver), get_solver, say_waiting, points=points
        )
    from impact_xval.experiments.cells.compared import Compared

    compared = Compared(collision, outcomes, arranged)
    if json:
        print_json(compared.objects())
    else:
        show(make_console(), compared.blocks())
    if plot is not None:
        error_line(f"{plot}: {(_film if film else _picture)(plot, compared, config)}")


def _picture(file: Path, compared: Compared, config: Config) -> str:
    """Draw a collision into a file; its caption."""
    from impact_xval.experiments.presentation.pictures.curves import caption, drawn_paths
    from impact_xval.experiments.presentation.style import save_as

    try:
        figure = compared.plot()
    except ValueError as error:
        raise UserError(f"--plot {file}: {error}; legal: a collision that one solves") from None
    save_as(figure, file)
    if compared.is_column:
        return "final velocities"
    return caption(compared.problem, drawn_paths(compared.problem, compared.outcomes), config.scenario)


def _film(file: Path, compared: Compared, config: Config) -> str:
    """Show a collision in slow motion, the model beside an engine, or else another solver; its caption."""
    from impact_xval.compliant_baselines.registry import is_engine
    from impact_xval.experiments.config.experiment import REFERENCE
    from impact_xval.experiments.presentation.pictures.curves import at
    from impact_xval.experiments.presentation.pictures.history import history_of
    from impact_xval.experiments.presentation.pictures.motion import Motion, write_animation
    from impact_xval.experiments.presentation.terminal import at_work
    from impact_xval.experiments.presentation.words import arranged
    from impact_xval.model.collision import RESULT_STATUSES

    collision, drop, shown = compared.problem, config.scenario == "drop", {}
    for name in sorted(compared.outcomes, key=lambda name: (name != REFERENCE, not is_engine(name))):
        outcome = compared.outcomes[name]
        weight = config.gravity if drop and name != REFERENCE else 0.0
        if outcome.status in RESULT_STATUSES and outcome.path is not None:
            history = history_of(collision, outcome.path, weight)
            shown |= {name: history} if history is not None else {}
    if REFERENCE not in shown or len(shown) < 2:
        raise UserError(
            f"--plot {file}: needs the model and another solver with a path in finite time; legal: such a collision, "
            f"or a file that ends in {', '.join(_PICTURES)}"
        )
    what = (
        f"{at(collision)}, scenario {config.scenario}"
        if compared.arranged is None
        else arranged(compared.arranged)
    )
    what += ", in which the model has no gravity" if drop else ""
    motion = Motion(collision, what, dict(list(shown.items())[:2]))
    with at_work("drawing the motion"):
        write_animation(motion, file)
    return motion.caption()


def explore(
    port: int = option("N", "Port to listen at; 0: any free one.", whole(0, 65535), 5006),
    browser: Annotated[
        bool, typer.Option("--browser/--no-browser", help="Open the page in a browser.")
    ] = True,
) -> None:
    """Move one collision by sliders in a browser.

    Two balls on a table, or a column of N, until Ctrl-C. The model and the exact references follow the sliders; a
    button runs the engines. The address of the page holds the cell. The page is served to this machine alone.

    Example: impact-xval explore --no-browser
    """
    from impact_xval.experiments.cells.explorer import explorer
    from impact_xval.experiments.presentation.terminal import make_console, print_line

    with explorer(port, asked) as (where, wait):
        print_line(make_console(), f"{where} (Ctrl-C ends it)")
        if browser:
            import webbrowser

            webbrowser.open(where)
        wait()


@of_one_collision("arrangement", *OF_COLUMN, "cell_timeout")
def scene(
    folder: Path | None = argument("[DIR]", "Folder of a finished run, or a collision as solve.", path, None),
    cell: int | None = argument("[N]", "Number of a cell of that run.", whole(0, 10**7), None),
    *,
    solver: list[str] | None = option("NAME", "'mujoco' or 'pybullet'; may be repeated, by default both."),
    out: Path | None = option("DIR", "Folder to write; by default in scenes/.", path),
    **typed: str | None,
) -> None:
    """Write one cell as files for an engine alone.

    An MJCF file and a PyBullet script, of a cell of a run (DIR N) or of a collision given as to solve.
    The scripts print their velocities beside those given here, and fail where they differ by more than 1e-12 |v0|.

    Example: impact-xval scene runs/default 17
    """
    from impact_xval.experiments.presentation.views import rows_of_cell
    from impact_xval.experiments.sweep.rows import settings_of
    from impact_xval.experiments.tables.folder import cells_of_run, finished_collisions

    if folder is None:
        collision, _, config = asked(typed)
        table, where = {}, "collision"
    else:
        if cell is None or any(typed.values()):
            raise UserError(f"{folder}: a cell of a run is named by its number; legal: DIR N")
        run = finished_collisions(folder)
        config = run.config()
        cells = cells_of_run(run, config)
        if cell >= len(cells):
            raise UserError(f"N = {cell}; legal: a whole number from 0 to {len(cells) - 1}")
        collision, where = cells[cell], f"{folder.resolve().name}-cell-{cell}"
        table = {row["solver"]: row for row in rows_of_cell(run, cell)}
    _write_scenes(collision, settings_of(config), _exportable(solver), out or Path("scenes") / where, table)


def _exportable(solvers: list[str] | None) -> list[str]:
    """Check the names of engines; without any, those that are installed."""
    from impact_xval.compliant_baselines import get_solver
    from impact_xval.compliant_baselines.registry import exportable_names

    legal = exportable_names()
    for name in solvers or ():
        if name not in legal:
            raise UserError(f"--solver = {name!r}; legal: {', '.join(legal)}")
    installed = [name for name in legal if get_solver(name).unavailable() is None]
    return list(dict.fromkeys(solvers or installed))


def _write_scenes(
    collision: Collision, settings: Settings, names: list[str], out: Path, table: dict[str, dict[str, Any]]
) -> None:
    """Run a collision by every engine named, and only then write a folder for each; rows of a table are by solver."""
    from dataclasses import replace

    from impact_xval.compliant_baselines import get_solver
    from impact_xval.compliant_baselines.engines.engine import Engine
    from impact_xval.compliant_baselines.engines.scene import Scene
    from impact_xval.compliant_baselines.paste import scene_files
    from impact_xval.experiments.presentation.terminal import make_console, show
    from impact_xval.experiments.tables.folder import write_text

    texts: dict[Path, str] = {}
    lines: list[str] = []
    for name in names:
        solver = get_solver(name)
        assert isinstance(solver, Engine)
        (outcome,) = solver.solve_many([collision], replace(settings, convergence=None, mark=False))
        scene = solver.scene_or_refusal(collision, settings)
        if math.isnan(outcome.v1) or not isinstance(scene, Scene):
            raise UserError(f"{name}: {outcome.status}: {outcome.reason}")
        run, files = scene_files(solver, scene, settings.max_steps)
        lines.append(f"{name}: v1 = {outcome.v1!r} m/s, v2 = {outcome.v2!r} m/s, {run.n_steps} steps")
        if outcome.velocities != tuple(v := run.velocities.tolist()):
            given = ", ".join(map(repr, v))
            lines.append(f"  at rest on the table when the collision was over: the script gives {given}")
        row = table.get(name, {"v1": None})
        if row["v1"] is not None:
            apart = max(abs(outcome.v1 - row["v1"]), abs(outcome.v2 - row["v2"])) / abs(collision.v0)
            known = f"v1 = {row['v1']!r} m/s, v2 = {row['v2']!r} m/s"
            lines.append(f"  in the table of the run: {known} (difference {apart:.1e} |v0|)")
        texts |= {out / name / file: text for file, text in files.items()}
    for file, text in texts.items():
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UserError(f"--out {out}: cannot be written to: {error.strerror}") from None
        write_text(file, text)
    show(make_console(), [*lines, *(f"to check: python {out / name / 'run.py'}" for name in names)])
