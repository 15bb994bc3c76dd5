"""Traps in the MuJoCo scenes of an experiment, as its adapter builds them: for reports."""

from __future__ import annotations

from collections import Counter
from importlib import import_module
from typing import Any

import numpy as np

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.engines.engine import Engine
from impact_xval.compliant_baselines.engines.scene import Scene
from impact_xval.compliant_baselines.inspect_mujoco import Finding, inspect_model
from impact_xval.compliant_baselines.paste import mjcf
from impact_xval.experiments.config.cells import Cells, experiment_cells
from impact_xval.experiments.config.experiment import Config
from impact_xval.experiments.sweep.rows import settings_of

#: Cells that are examined, evenly spread and the corners among them, and how what is said of them begins.
_MOST, _LOOKED = 40, "The MuJoCo scenes of this run, as its adapter builds them, were examined"


def traps_note(config: Config, cells: Cells | None = None) -> dict[str, Any]:
    """Say which traps the scenes of a run of two balls hold: an ``introduction``, and a list of what is ``found``."""
    solver = get_solver("mujoco")
    if "mujoco" not in config.solvers or solver.unavailable() is not None:
        return {"introduction": "This run has no scenes of MuJoCo that could be examined here.", "found": []}
    try:
        findings = _findings(solver, config, experiment_cells(config) if cells is None else cells)
    except Exception as error:  # a report must not fail for a note
        return {"introduction": f"{_LOOKED}, which failed: {type(error).__name__}: {error}.", "found": []}
    said = f"{_LOOKED}: " + (f"{len(findings)} traps." if findings else "no traps.")
    return {"introduction": said, "found": [str(finding) for finding in findings]}


def _findings(solver: Any, config: Config, cells: Cells) -> list[Finding]:
    """Examine scenes of a run: each trap once, with the number of cells that have it."""
    assert isinstance(solver, Engine)
    settings, first, counts = settings_of(config), {}, Counter[str]()
    places = np.unique(np.linspace(0, len(cells) - 1, min(len(cells), _MOST)).round().astype(int)).tolist()
    for place in places:
        scene = solver.scene_or_refusal(cells[place], settings)
        if isinstance(scene, Scene):
            found = {each.trap: each for each in scene_findings(scene)}
            first = found | first
            counts.update(found.keys())
    return [
        Finding(
            trap,
            f"mujoco, {counts[trap]} of {len(places)} cells examined, for example {each.where}",
            each.says,
        )
        for trap, each in first.items()
    ]


def scene_findings(scene: Scene) -> list[Finding]:
    """Examine one scene as MuJoCo runs it."""
    mujoco: Any = import_module("mujoco")
    return inspect_model(mujoco.MjModel.from_xml_string(mjcf(scene)))
