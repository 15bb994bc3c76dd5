"""Contents of a cell that opens on the page: results, impulse curves, causes, commands and scene.

The functions here need the folder of a finished run. They run the exact solvers of the run again for the curves. The
page of a run calls this module.
"""

from __future__ import annotations

import base64
import gzip
import json
import re
import shlex
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Required, TypedDict

import numpy as np
import pyarrow.compute as pc
import pyarrow.parquet as pq

from impact_xval.compliant_baselines.engines.engine import Engine
from impact_xval.compliant_baselines.engines.scene import Scene
from impact_xval.compliant_baselines.paste import mjcf_of_scenes
from impact_xval.compliant_baselines.registry import exact_law_names, get_solver, solver_names
from impact_xval.experiments.config.axes import RATIO_OF, SI_AXES
from impact_xval.experiments.config.experiment import AXES_OF, Config
from impact_xval.experiments.config.graphs import GRAPH_SPECS
from impact_xval.experiments.presentation.words import display_name, format_axis_value, name_solver_in
from impact_xval.experiments.sweep.curves import points_to_keep
from impact_xval.experiments.sweep.rows import settings_of
from impact_xval.experiments.tables.folder import RunFolder, cells_of_run
from impact_xval.experiments.tables.frames import Record
from impact_xval.experiments.tables.parquet import read_selected
from impact_xval.model.collision import Collision
from impact_xval.model.outcome import Outcome
from impact_xval.model.status import RESULT_STATUSES

#: Number of decimals of the impulses of a curve, ten times finer than a screen shows.
_DIGITS = 4


#: Impulses I1 (ball on ball) and I2 (ball on table) along a curve, per m1 |v0|.
Curve = list[list[float]]


class SolverResult(TypedDict):
    """Result of one solver in a cell."""

    #: Name of the solver for readers, and name of the solver in tables.
    name: str
    solver: str
    status: str
    marked: str | None
    reason: str | None
    #: Whether the numbers count as a result.
    result: bool
    #: Final velocities per |v0|; None for a velocity that the solver did not return.
    velocities: list[float | None]
    #: Divergence D from the model.
    d: float | None
    states: str | None
    #: Final impulses of two balls per m1 |v0|; None for chains and graphs.
    end: list[float] | None


class CellContents(TypedDict, total=False):
    """Contents of a cell that a reader can open on the page; keys that do not apply to the kind of run are missing."""

    #: Values of the axes of the run as text, by label.
    at: dict[str, str]
    results: Required[list[SolverResult]]
    #: Sentence on the causes of divergence for each engine.
    causes: Required[list[str]]
    #: Commands that show the cell on a terminal, each as a description and a command line.
    commands: list[list[str]]
    #: Impulse curves of two balls by solver.
    curves: dict[str, Curve]
    #: Scene of two balls in MJCF; None if MuJoCo is not in the run or cannot represent the cell.
    scene: str | None


def pack_cells(folder: RunFolder, cells: Sequence[int]) -> str:
    """Return the contents of cells of a run as compressed JSON in base64."""
    text = json.dumps(collect_cells(folder, cells), separators=(",", ":"), allow_nan=False)
    return base64.b64encode(gzip.compress(text.encode(), mtime=0)).decode("ascii")


def collect_cells(folder: RunFolder, cells: Sequence[int]) -> dict[int, CellContents]:
    """Return the contents of cells of a run, by number of the cell.

    Only exact solvers have impulse curves, because they solve the cells again here. Other solvers have only the final
    impulses from the tables of the run.
    """
    config = folder.config()
    pair, axes = config.kind == "pair", AXES_OF[config.kind]
    shown: dict[int, CellContents] = {cell: {"results": [], "causes": []} for cell in cells}

    def rows(table: str, *columns: str) -> list[Record]:
        is_shown = pc.field("cell").isin(list(cells))
        return read_selected(
            folder.table_path(f"{table}.parquet"), ["cell", "solver", *columns], is_shown
        ).to_pylist()

    divergence = rows("divergence", "velocity_divergence")
    ds = {(row["cell"], row["solver"]): row["velocity_divergence"] for row in divergence}
    names = pq.read_schema(folder.table_path("cells.parquet")).names
    balls = [name for name in names if re.fullmatch(r"v[1-9]\d*[xz]?", name)]
    index = cells_of_run(folder, config)
    # Each body of a graph has two components of its velocity.
    components = {
        cell: 2 * len(graph.masses)
        for cell in (cells if config.kind == "graph" else ())
        for graph in index.block(range(cell, cell + 1)).graphs
    }
    ends, paths = (["impulse1", "impulse2"], ["states_compared"]) if pair else ([], [])
    scales = ("m1", "m2", "k1", "k2") if pair else ("m1", "k1")
    for row in rows("cells", *axes, "status", "marked", "reason", *scales, "v0", *balls, *ends, *paths):
        cell, speed = shown[row["cell"]], abs(row["v0"])
        moving = components[row["cell"]] if config.kind == "graph" else row.get("balls", 2)
        velocities = [row[name] for name in balls[:moving]]
        impulses = [row[name] for name in ends if row[name] is not None]
        cell["at"] = {
            label: format_axis_value(row[axis], 6) for axis, label in axes.items() if row[axis] is not None
        }
        cell["at"] |= {
            f"{name} in {SI_AXES[name]}": format_axis_value(row[name], 6)
            for name in config.grid.in_si
            if pair
        }
        cell["commands"] = _commands_for_cell(folder.root, config, row)
        cell["results"].append(
            {
                "name": display_name(row["solver"]),
                "solver": row["solver"],
                "status": row["status"],
                "marked": row["marked"],
                "reason": row["reason"],
                "result": row["status"] in RESULT_STATUSES,
                "velocities": [None if v is None else v / speed for v in velocities],
                "d": ds.get((row["cell"], row["solver"])),
                "states": row.get("states_compared"),
                "end": [impulse / (row["m1"] * speed) for impulse in impulses] or None,
            }
        )
    for row in rows("ladder", "sentence", "reason"):
        shown[row["cell"]]["causes"].append(
            name_solver_in(row["solver"], row["sentence"] or row["reason"] or "")
        )
    if pair:
        collisions = [index[cell] for cell in cells]
        both = zip(cells, _exact_curves(config, collisions), _mjcf_scenes(config, collisions), strict=True)
        for cell, curves, scene in both:
            shown[cell]["curves"], shown[cell]["scene"] = curves, scene
    return shown


def _commands_for_cell(root: Path, config: Config, row: Record) -> list[list[str]]:
    """Return the commands that show a cell on a terminal, each with a description."""
    run, cell = shlex.quote(str(root)), row["cell"]
    show = ["all results and causes of this cell", f"impact-xval show {run} --cell {cell}"]
    if config.kind == "graph":
        again = f"impact-xval solve --graph {row['graph']} {_options_of_graph(row)}"
        unit = (
            "solve again with m1 = 1 kg, k1 = 1 N/m and |v0| = 1 m/s, which gives the same outcome per |v0|"
        )
        picture = f"{again} --plot cell-{cell}.svg"
        return [["results of all solvers", show[1]], [unit, again], ["draw a picture", picture]]
    axes = AXES_OF[config.kind]
    ours = ["scenario"] if config.kind == "pair" else []
    ours += [*(["gravity"] if config.scenario == "drop" else []), "m1", "k1", "v0", "step_fraction"]
    given = {axis: row[axis] for axis in axes if row[axis] is not None}
    given |= {name: row[name] if name in row else getattr(config, name) for name in ours}
    for ratio, (quantity, _) in RATIO_OF.items():
        # The quantity gives the same bits again, but a rounded ratio may give other bits.
        if quantity in row and quantity in config.grid.in_si:
            given[quantity] = row[quantity]
            del given[ratio]
    again = " ".join(f"--{name.replace('_', '-')} {value}" for name, value in given.items())
    if config.mapping == "naive":
        naive = (f"{name}-naive" for name in config.solvers)
        again += "".join(f" --solver {name}" for name in naive if name in solver_names(on_request=True))
    solve = ["solve again with all solvers", f"impact-xval solve {again}"]
    scene = ["write scenes that run in the engine without this package", f"impact-xval scene {run} {cell}"]
    film = ["show it in slow motion", f"impact-xval solve {again} --plot cell-{cell}.html"]
    return [show, *([scene] if config.kind == "pair" else []), solve, film]


def _options_of_graph(row: Record) -> str:
    """Return the options of ``solve --graph`` for a cell.

    The option for k2/k1 of a bridge is ``--table-stiffness-ratio``.
    """
    name = row["graph"]
    both = name in ("corner", "bridge")
    renamed = {"e": ("--e1", "--e2") if both else ("--restitution",)}
    if name == "bridge":
        renamed["stiffness_ratio"] = ("--table-stiffness-ratio",)
    words: list[str] = []
    for axis in GRAPH_SPECS[name].axes:
        for option in renamed.get(axis, (f"--{axis.replace('_', '-')}",)):
            words += [option, f"{row[axis]}"]
    return " ".join(words)


def _exact_curves(config: Config, collisions: Sequence[Collision]) -> list[dict[str, Curve]]:
    """Return the impulse curves of collisions by the exact solvers of a run, one dictionary per collision."""
    settings = replace(settings_of(config), record_path=True, mark=False)
    exact = [name for name in config.solvers if name in exact_law_names()]
    solved = {name: get_solver(name).solve_many(collisions, settings) for name in exact}
    return [
        {
            name: curve
            for name, outcomes in solved.items()
            if (curve := impulse_curve(collision, outcomes[i])) is not None
        }
        for i, collision in enumerate(collisions)
    ]


def impulse_curve(collision: Collision, outcome: Outcome) -> Curve | None:
    """Return the impulse curve of an outcome; None if the outcome has no path or does not count as a result.

    A point is left out if the line through the other points shows the same curve without it.
    """
    path = outcome.path
    if outcome.status not in RESULT_STATUSES or path is None:
        return None
    points = np.column_stack([path.impulse1, path.impulse2]) / (collision.m1 * abs(collision.v0))
    return points[points_to_keep(points.sum(axis=1), points)].T.round(_DIGITS).tolist()


def _mjcf_scenes(config: Config, collisions: Sequence[Collision]) -> list[str | None]:
    """Return the MJCF of each collision; None if MuJoCo is not in the run or cannot represent the collision."""
    if "mujoco" not in config.solvers or get_solver("mujoco").unavailable() is not None:
        return [None] * len(collisions)
    solver, settings = get_solver("mujoco"), settings_of(config)
    assert isinstance(solver, Engine)
    scenes = [solver.scene_or_refusal(collision, settings) for collision in collisions]
    written = iter(mjcf_of_scenes(scene for scene in scenes if isinstance(scene, Scene)))
    return [next(written) if isinstance(scene, Scene) else None for scene in scenes]
