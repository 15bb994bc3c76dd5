"""What the page shows of a cell that is opened: results, impulse curves, causes, commands, and its scene."""

from __future__ import annotations

import base64
import gzip
import json
import math
import shlex
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pyarrow.compute as pc
import pyarrow.dataset as ds
from numpy.typing import NDArray

from impact_xval.compliant_baselines.calibration.scene_text import mjcf
from impact_xval.compliant_baselines.contract.registry import (
    engine_free_names,
    exportable_names,
    get_solver,
    is_costly,
)
from impact_xval.compliant_baselines.engines.engine import EngineSolver
from impact_xval.experiments.config.axes import AXES
from impact_xval.experiments.config.configuration import REFERENCE, Config
from impact_xval.experiments.measures.ladder import CONTRIBUTIONS
from impact_xval.experiments.presentation.pictures.history import History, history_of
from impact_xval.experiments.sweep.curves import thinned
from impact_xval.experiments.sweep.designs import cells_of_run
from impact_xval.experiments.sweep.kinds.kind import settings_of
from impact_xval.experiments.tables.numbers import number
from impact_xval.experiments.tables.store import RunFolder
from impact_xval.model.collision import RESULT_STATUSES, Collision

Floats = NDArray[np.float64]

#: Impulses 1 and 2 per m1 |v0|.
Curve = list[list[float]]
#: When it has ended (`History.ended`), then at instants: times, velocities of B1 and B2, mean forces of contacts 1
#: and 2 until the next one, and states; in units of m1, |v0| and k1.
Clocked = list[Any]

#: Digits of an impulse and of a velocity, of a force those of the largest: a tenth of what a screen tells apart.
_DIGITS = 4

#: Points of a curve at most, beside changes of state: straight lines between them are the curve, to an eye.
_POINTS = 60

#: Who is shown in slow motion beside the model: the first of them that has a result.
MOVING = ("mujoco", "kelvin-voigt", "pybullet", "bistiffness")

_RESULT = ("solver", "status", "marked", "reason", "v1", "v2", "states_compared", "impulse1", "impulse2")


def packed_cells(folder: RunFolder, cells: Sequence[int]) -> str:
    """Collect what is shown of some cells of a run of two balls, as JSON, compressed, in letters (base64)."""
    text = json.dumps(opened_cells(folder, cells), separators=(",", ":"), allow_nan=False)
    return base64.b64encode(gzip.compress(text.encode(), mtime=0)).decode("ascii")


def opened_cells(folder: RunFolder, cells: Sequence[int]) -> dict[int, dict[str, Any]]:
    """Collect what is shown of some cells of a run of two balls.

    Curves are those of the exact solvers of the run, solved again; of the others the table holds the end.

    Returns
    -------
    dict
        By number of the cell, ``at`` (k2/k1, m2/m1, e1, e2), ``gravity`` (`fall`), ``results``, ``causes``,
        ``curves`` (`curve`), ``clocked`` (`clocked_curve`), ``commands`` and ``scene`` (MJCF; None where MuJoCo is
        not in the run).
    """
    config = folder.config()
    index = cells_of_run(folder, config)
    collisions = [index[cell].collision for cell in cells]
    shown: dict[int, dict[str, Any]] = {cell: {"results": [], "causes": []} for cell in cells}
    divergences = {
        (row["cell"], row["solver"]): row["velocity_divergence"]
        for row in _rows(folder, "divergence", ("cell", "solver", "velocity_divergence"), cells)
    }
    ratios: dict[int, dict[str, float]] = {}
    for row in _rows(folder, "cells", ("cell", *AXES, "m1", "v0", *_RESULT), cells):
        speed = abs(row["v0"])
        end = [_per(row[name], row["m1"] * speed) for name in ("impulse1", "impulse2")]
        ratios[row["cell"]] = {axis: row[axis] for axis in AXES}
        shown[row["cell"]]["at"] = [number(row[axis], 6) for axis in AXES]
        shown[row["cell"]]["results"].append(
            {
                **{name: row[name] for name in ("solver", "status", "marked", "reason")},
                "v1": _per(row["v1"], speed),
                "v2": _per(row["v2"], speed),
                "d": divergences.get((row["cell"], row["solver"])),
                "states": row["states_compared"],
                "end": None if None in end else end,
            }
        )
    for row in _rows(folder, "ladder", None, cells):
        shown[row["cell"]]["causes"].append(_causes(row))
    for cell, found in shown.items():
        found["commands"] = _commands(folder.root.resolve().name, config, cell, ratios[cell], found)
    for cell, found, collision in zip(cells, _curves(config, collisions), collisions, strict=True):
        shown[cell] |= found | {"gravity": fall(config, collision)}
    for cell, scene in zip(cells, _scenes(config, collisions), strict=True):
        shown[cell]["scene"] = scene
    return shown


def _rows(
    folder: RunFolder, table: str, columns: Sequence[str] | None, cells: Sequence[int]
) -> list[dict[str, Any]]:
    path = folder.root / f"{table}.parquet"
    if not path.is_file():
        return []
    wanted = pc.field("cell").isin(list(cells))
    return ds.dataset(path).to_table(columns=columns and list(columns), filter=wanted).to_pylist()


def _per(value: float | None, unit: float) -> float | None:
    return None if value is None else value / unit


def _causes(row: dict[str, Any]) -> dict[str, Any]:
    causes = [
        [c.label, row[f"{c.name}_share"], row[f"{c.name}_norm"]]
        for c in CONTRIBUTIONS
        if row.get(f"{c.name}_norm") is not None
    ]
    return {"solver": row["solver"], "said": row["sentence"] or row["reason"], "causes": causes}


def _commands(
    root: str, config: Config, cell: int, ratios: dict[str, float], shown: dict[str, Any]
) -> list[list[str]]:
    """Write what opens a cell on a terminal: those commands that have something to show of it.

    Parameters
    ----------
    root : str
        Name of the run's folder; commands that read it are typed beside it.
    config : Config
    cell : int
    ratios : dict of float
        Those of the cell, by axis.
    shown : dict
        Its ``results`` and ``causes``.
    """
    options = {
        **{axis.replace("_", "-"): ratio for axis, ratio in ratios.items()},
        "scenario": config.scenario,
        **({"gravity": config.gravity} if config.scenario == "drop" else {}),
        **{name: getattr(config, name) for name in ("m1", "k1", "v0")},
        "step-fraction": config.step_fraction,
        "max-steps": config.max_steps,
        "mapping": config.mapping,
        "cutoff": config.stiffness_ratio_cutoff,
        "cell-timeout": config.cell_timeout,
    }
    again = " ".join(f"--{name} {value}" for name, value in options.items())
    run, beside = f"{shlex.quote(root)} --cell {cell}", f"typed in the folder that holds {root}"
    done = [row["solver"] for row in shown["results"] if row["status"] in RESULT_STATUSES]
    commands = []
    if shown["causes"]:
        commands.append([f"every cause, in every order ({beside})", f"impact-xval ladder {run}"])
    if exported := [name for name in exportable_names() if name in done]:
        only = "".join(f" --solver {name}" for name in exported)
        what = f"scenes that run in the engine alone ({beside})"
        commands.append([what, f"impact-xval export-scene {run}{only}"])
    commands.append(["once more, by every solver", f"impact-xval solve {again}"])
    moving = [name for name in MOVING if name in done]
    if (
        moving and REFERENCE in done and 0 < ratios["stiffness_ratio"] < math.inf
    ):  # else the model has no clock
        to = f"--solver {moving[0]} --out cell-{cell}.html"
        commands.append(["in slow motion", f"impact-xval animate {again} {to}"])
    return commands


def _curves(config: Config, collisions: Sequence[Collision]) -> list[dict[str, dict[str, Any]]]:
    """Solve collisions by the exact solvers of a run: curves by solver, of as few points as an eye needs."""
    found: list[dict[str, dict[str, Any]]] = [{"curves": {}, "clocked": {}} for _ in collisions]
    settings = replace(settings_of(config), record_path=True, mark=False)
    for name in config.solvers:
        if name not in engine_free_names() or is_costly(name):
            continue
        for shown, collision, outcome in zip(
            found, collisions, get_solver(name).solve_many(collisions, settings), strict=True
        ):
            if outcome.status in RESULT_STATUSES and (path := outcome.path) is not None:
                impulses = np.column_stack([path.impulse1, path.impulse2]) / collision.units.impulse
                shown["curves"][name] = curve(impulses, path.state)
                if (history := history_of(collision, path)) is not None:
                    shown["clocked"][name] = clocked_curve(history, _POINTS)
    return found


def curve(impulses: Floats, state: NDArray[np.int64]) -> Curve:
    """Thin a curve, in units of m1 abs(v0), shape (n, 2)."""
    kept = thinned(impulses[:, 0], impulses[:, 1], state, _POINTS)
    return impulses[kept].T.round(_DIGITS).tolist()


def clocked_curve(history: History, points: int) -> Clocked:
    """Thin a history to about so many points, evenly along impulses and as many along velocities."""
    planes = (history.impulses, history.velocities)
    kept = np.unique(np.concatenate([thinned(x[:, 0], x[:, 1], history.state, points) for x in planes]))
    time, velocities = history.time[kept], history.velocities[kept]
    # From what is not rounded: steps may be as short as a rounding.
    forces = np.diff(history.impulses[kept], axis=0) / np.diff(time)[:, None]
    columns = [*velocities.T.round(_DIGITS), *forces.T.round(_digits(np.abs(forces).max()))]
    digits = _digits(np.diff(time).min())
    return [
        history.ended,
        time.round(digits).tolist(),
        *(column.tolist() for column in columns),
        history.state[kept].tolist(),
    ]


def _digits(size: float) -> int:
    """Digits after the point of numbers of a size, `_DIGITS` of them significant; and no fewer."""
    return _DIGITS + max(0, -math.floor(math.log10(size))) if size > 0 else _DIGITS


def fall(config: Config, collision: Collision) -> float:
    """Give the acceleration of gravity in a drop in units of m1, abs(v0) and k1; 0 in an impact."""
    units = collision.units
    return config.gravity * units.time / units.velocity if config.scenario == "drop" else 0.0


def _scenes(config: Config, collisions: Sequence[Collision]) -> list[str | None]:
    """Write the MJCF of every collision that MuJoCo represents, where it is in the run."""
    if "mujoco" not in config.solvers or get_solver("mujoco").unavailable() is not None:
        return [None] * len(collisions)
    solver, settings = get_solver("mujoco"), settings_of(config)
    assert isinstance(solver, EngineSolver)
    columns = [solver.column_or_refusal(collision, settings) for collision in collisions]
    return [None if isinstance(column, str) else mjcf(column) for column in columns]
