"""Traps in the scenes of an experiment, as its adapters build them: for ``impact-xval doctor`` and for reports."""

from __future__ import annotations

from collections import Counter
from importlib import import_module
from typing import Any

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.contract.registry import exportable_names
from impact_xval.compliant_baselines.diagnosis.diagnosis import Finding
from impact_xval.compliant_baselines.engines.engine import EngineSolver
from impact_xval.experiments.config.configuration import Config
from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.config.grid import Cells
from impact_xval.experiments.sweep.designs import cells_of
from impact_xval.experiments.sweep.kinds.kind import settings_of

#: Cells of an experiment that are examined, evenly spread and the corners among them.
MOST_CELLS = 100

#: Cells examined for the note in a report, and how it begins.
IN_REPORT = 40
_LOOKED = "The scenes of this run, as its adapters build them, were examined by impact-xval doctor"


def experiment_findings(
    config: Config, most: int = MOST_CELLS, cells: Cells | None = None
) -> tuple[list[str], list[Finding]]:
    """Examine the scenes an experiment runs, as its adapters build them.

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
    examined : list of str
        The engines among the experiment's solvers that are installed.
    findings : list of Finding
        Each trap once for an engine, with the number of cells that have it.
    """
    if config.column is not None:
        raise UserError(
            f"{config.name}: columns of N balls; legal: an experiment with collisions of two balls"
        )
    settings, grid = settings_of(config), cells_of(config) if cells is None else cells
    count = min(len(grid), most)
    indices = sorted({round(i * (len(grid) - 1) / max(1, count - 1)) for i in range(count)})
    examined: list[str] = []
    findings: list[Finding] = []
    for name in exportable_names():
        solver = get_solver(name)
        if name not in config.solvers or solver.unavailable() is not None:
            continue
        assert isinstance(solver, EngineSolver)
        examined.append(name)
        seen: dict[str, Finding] = {}
        counts: Counter[str] = Counter()
        for index in indices:
            column = solver.column_or_refusal(grid[index].collision, settings)
            if not isinstance(column, str):
                found = {f.trap: f for f in column_findings(solver, column)}
                seen = {**found, **seen}
                counts.update(found.keys())
        findings += [
            Finding(
                trap,
                f"{name}, {counts[trap]} of {len(indices)} cells examined, for example {f.where}",
                f.says,
            )
            for trap, f in seen.items()
        ]
    return examined, findings


def traps_note(config: Config, cells: Cells | None = None) -> dict[str, Any]:
    """Say, for the report of a run, which traps its own scenes hold.

    Returns
    -------
    dict
        ``introduction``, a sentence, and ``found``, a list of them.
    """
    try:
        examined, findings = experiment_findings(config, IN_REPORT, cells)
    except Exception as error:  # a report must not fail for a note
        return failed_note(f"{type(error).__name__}: {error}")
    if not examined:
        return {
            "introduction": "This run has no engine whose scenes could be examined here.",
            "found": [],
        }
    said = f"{_LOOKED} ({', '.join(examined)}): " + (f"{len(findings)} traps." if findings else "no traps.")
    return {"introduction": said, "found": [str(finding) for finding in findings]}


def failed_note(reason: str) -> dict[str, Any]:
    """Say, as `traps_note`, that the scenes could not be examined."""
    return {"introduction": f"{_LOOKED}, which failed: {reason}.", "found": []}


def column_findings(solver: EngineSolver, column: Any) -> list[Finding]:
    """Examine the scene of one collision by an engine whose scenes can be written down."""
    if solver.name == "mujoco":
        from impact_xval.compliant_baselines.calibration.scene_text import mjcf
        from impact_xval.compliant_baselines.diagnosis.diagnose_mujoco import diagnose_mujoco

        mujoco: Any = import_module("mujoco")
        return diagnose_mujoco(mujoco.MjModel.from_xml_string(mjcf(column)))
    from impact_xval.compliant_baselines.diagnosis.diagnose_pybullet import diagnose_at_first_step

    return diagnose_at_first_step(lambda: solver.run_columns([column], 1), column=True) or []
