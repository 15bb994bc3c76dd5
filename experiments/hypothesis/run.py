"""The run: every limit as two lists of cells, which the sweep solves, and what the solvers give there.

Exact solvers go to contrasts of 1e8; engines, whose steps grow as its root, as far as one can wait. Each list is a run
of its own in the folder of the test (``exact``, ``engines``), and is continued, or read again, as any run is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from impact_xval.compliant_baselines.registry import engine_free_names
from impact_xval.experiments.config.axes import AXES
from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.config.experiment import REFERENCE, Config, parse_config
from impact_xval.experiments.hypothesis.cases import (
    CASES,
    GRAZING,
    Frame,
    closed_form,
    distance,
    draw,
    pair_class,
)
from impact_xval.experiments.hypothesis.columns import column_outcomes
from impact_xval.experiments.hypothesis.config import HypothesisConfig, spaced
from impact_xval.experiments.hypothesis.verdicts import columns_judged, judged, verdicts
from impact_xval.experiments.measures.laws import exact_for, in_order_of_laws
from impact_xval.experiments.sweep.run import run_sweep
from impact_xval.experiments.tables.folder import finished, new_folder, write_text
from impact_xval.experiments.tables.parquet import replacing
from impact_xval.model.collision import RESULT_STATUSES

#: The configuration of a test, in its folder.
CONFIGURATION = "hypothesis.toml"

#: The two runs in the folder of a test.
EXACT, ENGINES = "exact", "engines"
_STAGES = {EXACT: "exact solvers", ENGINES: "engines, and the exact solvers of their laws"}

#: Rounding of an exact solver's velocities, per abs(v0).
ROUNDING = 1e-13


@dataclass(frozen=True, slots=True, eq=False)
class Results:
    """Everything a test found.

    Attributes
    ----------
    config : HypothesisConfig
    outcomes : DataFrame
        A row a limit, solver, point and contrast: velocities per abs(v0), those of engines in the limit dt -> 0.
    points : DataFrame
        A row a limit, solver and point: what the series of its outcomes comes to (`judging.Judgement`).
    verdicts : DataFrame
        A row a limit, solver and class of points (``all`` first).
    column_outcomes, columns : DataFrame
        Likewise, of columns of N balls: a row a place, solver, column and contrast; a place, solver and class.
    unavailable : dict
        Why, by solver.
    versions : dict
        By solver.
    """

    config: HypothesisConfig
    outcomes: Frame
    points: Frame
    verdicts: Frame
    column_outcomes: Frame
    columns: Frame
    unavailable: dict[str, str]
    versions: dict[str, str]

    @property
    def solvers(self) -> list[str]:
        """The solvers that were tested, grouped by the law they were asked for."""
        return in_order_of_laws(name for name in self.config.solvers if name not in self.unavailable)


def run_hypothesis(config: HypothesisConfig, root: Path, **how: Any) -> Results:
    """Test the hypothesis in a folder; `how` is for `run_sweep`."""
    for _, solve in stages(config, root):
        solve(**how)
    return results(config, root)


def stages(config: HypothesisConfig, root: Path) -> Iterator[tuple[str, Callable[..., Any]]]:
    """Prepare the folder of a test, and give its runs, each with a line that says what it is of, as a `run_sweep`.

    Raises
    ------
    UserError
        If the folder holds anything but the same test.
    """
    file = root / CONFIGURATION
    if not file.exists():
        new_folder(root)
        write_text(file, config.toml())
    elif file.read_text(encoding="utf-8") != config.toml():
        raise UserError(f"--out {root}: holds another test of the hypothesis; legal: a new or empty folder")
    for name in _runs(config):
        with replacing(root / f"{name}.parquet") as temporary:
            listed(config, name).to_parquet(temporary, index=False)
        experiment = _experiment(config, root, name)
        yield f"{_STAGES[name]}: {', '.join(experiment.solvers)}", partial(run_sweep, experiment, root / name)


def _runs(config: HypothesisConfig) -> dict[str, list[str]]:
    """Return the solvers of each run that has any."""
    exact = [name for name in config.solvers if name in engine_free_names()]
    others = [name for name in config.solvers if name not in exact]
    return {name: some for name, some in ((EXACT, exact), (ENGINES, others)) if some}


def _experiment(config: HypothesisConfig, root: Path, name: str) -> Config:
    """Return a run as an experiment; beside engines stand the exact solvers of their laws."""
    solvers = _runs(config)[name]
    laws = {exact_for(solver, "calibrated") for solver in solvers} - {"", *solvers}
    return parse_config(
        {
            "name": f"hypothesis, {name}",
            "scenario": "impact",
            "measures": "velocities",
            "m1": 1.0,
            "k1": 1.0,
            "solvers": [*solvers, *sorted(laws - {REFERENCE})],
            "stiffness_ratio_cutoff": float("inf"),
            "step_fraction": config.step_fraction,
            "max_steps": 50_000_000,
            "cell_timeout": config.cell_timeout,
            "workers": config.workers,
            "cells": str(root / f"{name}.parquet"),
            "convergence": {"tolerance": config.tolerance, "halvings": config.halvings},
        }
    )


def listed(config: HypothesisConfig, run: str) -> Frame:
    """List the cells of a run, a row each, with what they are cells of: limit, point, class and contrast.

    Contrasts vary more slowly than points: neighbours take about as many steps.
    """
    rows = []
    for case in CASES:
        points = [*draw(case, config.points, config.seed), *config.given(case.key)]
        known = [(i, pair_class(case, point), *closed_form(case, point)) for i, point in enumerate(points)]
        for x in _contrasts(config, case.plastic, run):
            for (i, name, *form), point in zip(known, points, strict=True):
                rows.append((case.key, i, name, float(x), *point.ratios(case, float(x)), *form))
    return pd.DataFrame(
        rows, columns=["case", "point", "class", "contrast", *AXES, "closed_form_v1", "closed_form_v2"]
    )


def _contrasts(config: HypothesisConfig, plastic: bool, run: str) -> Any:
    if run == ENGINES:
        return spaced(
            config.engine_plastic_contrast if plastic else config.engine_contrast, config.engine_per_decade
        )
    if plastic:
        return spaced(config.plastic_contrast, max(4, config.per_decade // 2))
    return spaced(config.contrast, config.per_decade)


def results(config: HypothesisConfig, root: Path) -> Results:
    """Judge what the runs in a folder have found."""
    frames, versions = [], {}
    for name, solvers in _runs(config).items():
        folder = finished(root / name)
        rows = pd.read_parquet(folder.table_path("cells.parquet"), columns=_COLUMNS)
        cells = listed(config, name)
        frames.append(rows[rows.solver.isin(solvers)].merge(cells, left_on="cell", right_index=True))
        versions |= {solver: folder.manifest()["versions"][solver] for solver in solvers}
    found: Frame = pd.concat(frames, ignore_index=True)
    lost = found[found.status == "unavailable"]
    unavailable = dict(zip(lost.solver, lost.reason, strict=True))
    outcomes = _outcomes(found[~found.solver.isin(list(unavailable))], config)
    points = judged(outcomes, config)
    columns = column_outcomes(config)
    return Results(
        config,
        outcomes,
        points,
        verdicts(points, ["case", "solver"]),
        columns,
        verdicts(columns_judged(columns, config), ["arrangement", "stiff_contact", "meets", "solver"]),
        unavailable,
        {name: version for name, version in versions.items() if name not in unavailable},
    )


_VELOCITIES = ["v1", "v2"]
_LIMITS = ["v1_limit", "v2_limit"]
#: What is read of a run.
_COLUMNS = [
    *("cell", "solver", "status", "reason", *_VELOCITIES, *_LIMITS),
    *("limit_error", "velocity_error", "limit_distance", "grazing_margin"),
]


def _outcomes(found: Frame, config: HypothesisConfig) -> Frame:
    """Make the table of outcomes: engines by their limit dt -> 0, and which of all can be used."""
    at_no_step = found[_LIMITS].notna().all(axis=1)
    v = np.where(at_no_step.to_numpy()[:, None], found[_LIMITS], found[_VELOCITIES])
    there = found.status.isin(RESULT_STATUSES) | (at_no_step & (found.status == "unconverged"))
    root = np.where(found["case"].str.startswith("plastic"), 1.0, np.sqrt(found.contrast))
    grazing = there & (found.grazing_margin.fillna(np.inf) * root < GRAZING)
    v = np.where(there.to_numpy()[:, None], v, np.nan)
    away = distance(found.mass_ratio, v[:, 0] - found.closed_form_v1, v[:, 1] - found.closed_form_v2)
    error = np.maximum(found[["limit_error", "velocity_error"]].max(axis=1).fillna(0.0), ROUNDING)
    table = found.assign(
        v1=v[:, 0], v2=v[:, 1], error=error, distance=away, used=there & ~grazing, grazing=grazing
    )
    order = {
        name: i for i, name in enumerate([*(case.key for case in CASES), *in_order_of_laws(config.solvers)])
    }
    sorted_by = ["case", "solver", "point", "contrast"]
    table = table.sort_values(
        sorted_by, key=lambda column: column.map(order) if column.name in sorted_by[:2] else column
    )
    dropped = [*_LIMITS, "cell", "limit_error", "velocity_error"]
    return table.drop(columns=dropped).reset_index(drop=True)
