"""Commands for one collision: ``solve``, ``explore`` and ``scene``.

``solve`` solves a collision by every solver, ``explore`` shows one in a browser, and ``scene`` writes files with which
an engine runs a collision without this project.
"""

from __future__ import annotations

import os
import webbrowser
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from impact_xval.experiments.commands.options import (
    Json,
    Solvers,
    argument,
    flag_option,
    known_solvers,
    option,
    parse_path,
    print_json,
    stop_if_unavailable,
    whole_number_parser,
    with_collision_options,
    word_parser,
)
from impact_xval.experiments.config.collision_options import OF_CHAIN, parse_collision, parse_settings
from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.config.graph_options import GRAPH_PARAMETERS, SOLVED_BY, parse_graph

if TYPE_CHECKING:
    from impact_xval.compliant_baselines import Settings
    from impact_xval.experiments.cells.compared import SolverComparison
    from impact_xval.experiments.config.arrangements import ChainSetup
    from impact_xval.experiments.config.experiment import Config
    from impact_xval.experiments.tables.frames import Record
    from impact_xval.model import Collision

#: Suffixes of files with a picture, and of files with slow motion.
_PICTURES, _FILMS = (".png", ".svg", ".pdf"), (".gif", ".html")
#: Largest number of points of a chain's path if the chain is shown in motion. It takes long to send the full path of
#: many balls between processes.
_POINTS = 4000
#: Engines whose scenes can be written.
_EXPORTED = ("mujoco", "pybullet")


def _drawable_path(text: str) -> Path:
    """Return a text as the path of a picture or film; an error says if the file cannot be written.

    This check finds a wrong path before anything is computed.
    """
    file = parse_path(text)
    if file.suffix not in (*_PICTURES, *_FILMS) or file.is_dir():
        legal = f"a file that ends in {', '.join((*_PICTURES, *_FILMS))}"
        raise typer.BadParameter(f"{text!r:.60}; legal: {legal}")
    if not file.parent.is_dir():
        raise typer.BadParameter(
            f"{text!r:.60}: no folder {file.parent} to write to; legal: a file in an existing folder"
        )
    if not os.access(file.parent, os.W_OK):
        says = f"the folder {file.parent} cannot be written to; legal: a file in another folder"
        raise typer.BadParameter(f"{text!r:.60}: {says}")
    return file


@with_collision_options(graphs=True)
def solve_command(
    *,
    solver: Solvers = None,
    plot: Path | None = option(
        "FILE",
        "Write a picture (.png, .svg, .pdf) or slow motion (.gif, .html), which can take minutes.",
        _drawable_path,
    ),
    json: Json = False,
    **typed: str | None,
) -> None:
    """Solve one collision by every solver.

    The bodies are two balls on a table, by ratios or in SI units; N balls with --arrangement; or others with --graph.
    Velocities are per |v0| (of a graph in m/s), impulses per m1 |v0|, times in s. The table has the divergence D of
    each solver from the model; below it is D between every two solvers.

    Example: impact-xval solve --stiffness-ratio 40 --mass-ratio 2 --e1 1 --e2 1
    """
    of_graph = {key: typed.pop(key) for key in GRAPH_PARAMETERS}
    if of_graph["graph"] is not None:
        _solve_graph(of_graph | typed, solver, plot, json=json)
        return
    for key, value in of_graph.items():
        if value is not None:
            raise UserError(f"--{key.replace('_', '-')} = {value!r:.60}; legal: with --graph")
    from impact_xval.experiments.presentation.terminal import (
        error_line,
        make_console,
        print_blocks,
        say_waiting,
    )
    from impact_xval.experiments.sweep.one import open_solvers_apart

    film = plot is not None and plot.suffix in _FILMS
    chains = typed["arrangement"] is not None or typed["balls"] is not None
    with open_solvers_apart(solver or (), chains=chains) as apart:
        from impact_xval.compliant_baselines.registry import get_solver

        collision, chain, config = parse_collision(typed)
        points = _count_path_points(chain, film=film)
        outcomes = apart.solve(
            collision, config, known_solvers(solver), get_solver, say_waiting, points=points
        )
    from impact_xval.experiments.cells.compared import SolverComparison
    from impact_xval.experiments.presentation.words import describe_scenario

    compared = SolverComparison(collision, outcomes, chain, apart.versions, describe_scenario(config))
    if json:
        print_json(compared.objects())
    else:
        print_blocks(make_console(), compared.blocks())
    if plot is not None:
        error_line(f"{plot}: {_draw_into(plot, compared, config)}")
    stop_if_unavailable(solver, [(name, outcome.status) for name, outcome in outcomes.items()])


def _solve_graph(
    typed: Mapping[str, str | None], solver: list[str] | None, plot: Path | None, *, json: bool
) -> None:
    """Solve one contact graph by the solvers that are named, and print and draw their outcomes.

    If no solvers are named, the model, the references and the rigid laws solve the graph. `typed` has the texts of
    options by name.
    """
    from impact_xval.experiments.presentation.terminal import (
        error_line,
        make_console,
        print_blocks,
        say_waiting,
    )
    from impact_xval.experiments.sweep.one import open_solvers_apart

    if plot is not None and plot.suffix in _FILMS:
        raise UserError(f"--plot = {str(plot)!r:.60} beside --graph; legal: {', '.join(_PICTURES)}")
    config = parse_settings({key: typed[key] for key in SOLVED_BY})
    collision, setup = parse_graph(typed)
    with open_solvers_apart(solver or (), graphs=True) as apart:
        from impact_xval.compliant_baselines.registry import get_solver
        from impact_xval.compliant_baselines.rigid.graphs import solve_graph_by_rigid_law
        from impact_xval.experiments.cells.compared_graph import REFERENCES, RIGID_LAWS, GraphComparison
        from impact_xval.experiments.config.experiment import REFERENCE

        names = known_solvers(solver) if solver else [REFERENCE, *REFERENCES, *RIGID_LAWS]
        others = [name for name in names if name not in RIGID_LAWS]
        outcomes = apart.solve_graph(collision, config, others, get_solver, say_waiting)
    for name in names:
        if name in RIGID_LAWS:
            outcomes[name] = solve_graph_by_rigid_law(name, collision)
    compared = GraphComparison(collision, outcomes, setup, apart.versions)
    if json:
        print_json(compared.objects())
    else:
        print_blocks(make_console(), compared.blocks())
    if plot is not None:
        from impact_xval.experiments.presentation.style import save_picture

        try:
            save_picture(compared.plot(), plot)
        except ValueError as error:
            raise UserError(f"--plot {plot}: {error}") from None
        error_line(f"{plot}: {compared.caption()}")
    stop_if_unavailable(solver, [(name, outcome.status) for name, outcome in outcomes.items()])


def _count_path_points(chain: ChainSetup | None, *, film: bool) -> int | None:
    """Return the largest number of points that the path of a collision may have.

    For two balls the result is None, which means all points. For a chain in slow motion it is `_POINTS`. For any other
    picture of a chain it is 0, because such pictures need no path.
    """
    if chain is None:
        return None
    return _POINTS if film else 0


def _draw_into(file: Path, compared: SolverComparison, config: Config) -> str:
    """Draw a collision into a file, as a picture or in slow motion; return its caption."""
    from impact_xval.experiments.presentation.pictures.curves import collision_caption, drawable_paths
    from impact_xval.experiments.presentation.pictures.motion import SlowMotion, write_animation
    from impact_xval.experiments.presentation.style import save_picture
    from impact_xval.experiments.presentation.terminal import report_waiting
    from impact_xval.experiments.presentation.words import describe_direction

    problem, outcomes, film = compared.problem, compared.outcomes, file.suffix in _FILMS
    try:
        picture = SlowMotion.of(problem, outcomes, config, compared.chain) if film else compared.plot()
    except ValueError as error:
        raise UserError(f"--plot {file}: {error}") from None
    if isinstance(picture, SlowMotion):
        with report_waiting("drawing the motion"):
            write_animation(picture, file)
        return picture.caption()
    save_picture(picture, file)
    if compared.is_chain:
        return f"final velocities per |v0|, {describe_direction(table=problem.table)}: {compared.setup}"
    return collision_caption(problem, drawable_paths(problem, outcomes), config.scenario)


def explore_command(
    port: int = option("N", "Port of the page; 0: any free port.", whole_number_parser(0, 65535), 5006),
    no_browser: bool = flag_option("--no-browser", "Print the address, but open no browser."),
) -> None:
    """Move one collision by sliders in a browser.

    The page shows two balls on a table, or a chain of N balls. The model and the exact references follow the sliders,
    and a button runs the engines. The address of the page contains the collision. Only this machine can open the page.
    Press Ctrl-C to end the command.

    Example: impact-xval explore --no-browser
    """
    from impact_xval.experiments.cells import explorer
    from impact_xval.experiments.presentation.terminal import make_console, print_line

    def announce(where: str) -> None:
        print_line(make_console(), f"{where} (Ctrl-C ends it)")
        if not no_browser:
            webbrowser.open(where)

    explorer.explore(port, announce)


@with_collision_options("arrangement", *OF_CHAIN, "cell_timeout")
def scene_command(
    folder: Path | None = argument(
        "[DIR]", "Folder of a finished run. Without it, describe a collision by options.", parse_path, None
    ),
    cell: int | None = argument(
        "[N]", "Number of the cell in this run.", whole_number_parser(0, 10**7), None
    ),
    *,
    solver: list[str] | None = option(
        "NAME", "Engine: 'mujoco' or 'pybullet'; by default both.", word_parser(*_EXPORTED)
    ),
    out: Path | None = option("DIR", "Folder to write; by default in scenes/.", parse_path),
    **typed: str | None,
) -> None:
    """Write one cell as files for an engine alone.

    The files are an MJCF file and a PyBullet script, for a cell of a run (DIR N) or a collision by the options of
    solve. The scripts print their velocities beside those given here, and fail if a difference is larger than 1e-12
    |v0|.

    Example: impact-xval scene runs/default 17
    """
    from impact_xval.compliant_baselines import get_solver
    from impact_xval.experiments.presentation.views import rows_of_cell
    from impact_xval.experiments.sweep.rows import settings_of
    from impact_xval.experiments.tables.folder import cells_of_run, finished_run_of_pairs

    if folder is None:
        collision, _, config = parse_collision(typed)
        table: dict[str, Record] = {}
        where = "collision"
    else:
        if cell is None or any(typed.values()):
            raise UserError(f"{folder}: a cell of a run is named by its number alone; legal: DIR N")
        run = finished_run_of_pairs(folder)
        config = run.config()
        cells = cells_of_run(run, config)
        if cell >= len(cells):
            raise UserError(f"N = {cell}; legal: a whole number from 0 to {len(cells) - 1}")
        collision, where = cells[cell], f"{folder.resolve().name}-cell-{cell}"
        table = {row["solver"]: row for row in rows_of_cell(run, cell)}
    names = list(dict.fromkeys(solver or (n for n in _EXPORTED if get_solver(n).unavailable() is None)))
    _write_scenes(collision, settings_of(config), names, out or Path("scenes") / where, table)


def _write_scenes(
    collision: Collision, settings: Settings, names: list[str], out: Path, table: dict[str, Record]
) -> None:
    """Write the files of a collision into one folder for each named engine, and print the engines' velocities.

    All engines run before the first file is written. `table` has the rows of a run for this collision, by solver. The
    velocities in these rows are printed for comparison.
    """
    from impact_xval.compliant_baselines import SolverError
    from impact_xval.compliant_baselines.paste import export_scene
    from impact_xval.experiments.presentation.terminal import make_console, print_blocks
    from impact_xval.experiments.tables.folder import write_text

    texts: dict[Path, str] = {}
    lines: list[str] = []
    for name in names:
        try:
            outcome, run, files = export_scene(name, collision, settings)
        except SolverError as error:
            raise UserError(str(error)) from None
        lines.append(f"{name}: v1 = {outcome.v1!r} m/s, v2 = {outcome.v2!r} m/s, {run.n_steps} steps")
        if outcome.velocities != tuple(v := run.velocities.tolist()):
            given = ", ".join(map(repr, v))
            lines.append(f"  at rest on the table when the collision was over: the script gives {given}")
        if (row := table.get(name)) and row["v1"] is not None:
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
    print_blocks(make_console(), [*lines, *(f"to check: python {out / name / 'run.py'}" for name in names)])
