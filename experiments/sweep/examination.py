"""Traps in the MuJoCo scenes of an experiment, as its adapter builds them: for reports."""

from __future__ import annotations

from collections import Counter
from importlib import import_module
from typing import Any

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.engines.engine import Engine
from impact_xval.compliant_baselines.engines.scene import Scene
from impact_xval.compliant_baselines.inspect_mujoco import Finding, inspect_model
from impact_xval.compliant_baselines.paste import mjcf
from impact_xval.experiments.config.cells import Cells, experiment_cells
from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.config.experiment import Config
from impact_xval.experiments.sweep.rows import settings_of

#: Cells of an experiment that are examined, evenly spread and the corners among them.
MOST_CELLS = 100

#: Cells examined for the note in a report, and how it begins.
IN_REPORT = 40
_LOOKED = "The MuJoCo scenes of this run, as its adapter builds them, were examined"


def experiment_findings(
    config: Config, most: int = MOST_CELLS, cells: Cells | None = None
) -> list[Finding] | None:
    """Examine the scenes of MuJoCo that an experiment runs, as its adapter builds them.

    Parameters
    ----------
    config : Config
        The experiment.
    most : int
        Cells to examine, at most.
    cells : Cells, optional
        Those of the experiment; by default they are made of its configuration.

    Returns
    -------
    list of Finding or None
        Each trap once, with the number of cells that have it; None where MuJoCo is not among the solvers, or not
        installed.
    """
    if config.column is not None:
        raise UserError(
            f"{config.name}: columns of N balls; legal: an experiment with collisions of two balls"
        )
    solver = get_solver("mujoco")
    if "mujoco" not in config.solvers or solver.unavailable() is not None:
        return None
    assert isinstance(solver, Engine)
    settings, grid = settings_of(config), experiment_cells(config) if cells is None else cells
    count = min(len(grid), most)
    indices = sorted({round(i * (len(grid) - 1) / max(1, count - 1)) for i in range(count)})
    seen: dict[str, Finding] = {}
    counts: Counter[str] = Counter()
    for index in indices:
        scene = solver.scene_or_refusal(grid[index], settings)
        if isinstance(scene, Scene):
            found = {f.trap: f for f in scene_findings(scene)}
            seen = {**found, **seen}
            counts.update(found.keys())
    return [
        Finding(
            trap, f"mujoco, {counts[trap]} of {len(indices)} cells examined, for example {f.where}", f.says
        )
        for trap, f in seen.items()
    ]


def traps_note(config: Config, cells: Cells | None = None) -> dict[str, Any]:
    """Say, for the report of a run, which traps its own scenes hold.

    Returns
    -------
    dict
        ``introduction``, a sentence, and ``found``, a list of them.
    """
    try:
        findings = experiment_findings(config, IN_REPORT, cells)
    except Exception as error:  # a report must not fail for a note
        return failed_note(f"{type(error).__name__}: {error}")
    if findings is None:
        return {"introduction": "This run has no scenes of MuJoCo that could be examined here.", "found": []}
    said = f"{_LOOKED}: " + (f"{len(findings)} traps." if findings else "no traps.")
    return {"introduction": said, "found": [str(finding) for finding in findings]}


def failed_note(reason: str) -> dict[str, Any]:
    """Say, as `traps_note`, that the scenes could not be examined."""
    return {"introduction": f"{_LOOKED}, which failed: {reason}.", "found": []}


def scene_findings(scene: Scene) -> list[Finding]:
    """Examine one scene as MuJoCo runs it."""
    mujoco: Any = import_module("mujoco")
    return inspect_model(mujoco.MjModel.from_xml_string(mjcf(scene)))
