"""Limiting cases of the paper's supplement, the points from which a test approaches them, and the test's runs.

A point is a set of ratios and restitutions of a collision. One number of the set goes to its limit as the contrast x
grows (docs/hypothesis.md). For k2/k1 the contrast is a ratio of stiffnesses. For e_i → 0 it is 1/e_i^2, because at the
end of compression the stiffness is multiplied by this number (supplement, 3.3). So a rate of approach in terms of e_i
is twice the rate in terms of x.

Closed forms are the outcomes of the model at an infinite contrast (`model.pair.limits`). Tests of this project compare
them with the closed forms of the supplement. Velocities are per abs(v0), and masses are per m1. A cell is a point at
one contrast. Exact solvers and engines have separate lists of cells. Each list is run as a sweep, and the folder of the
sweep lies in the folder of the test. The command `impact-xval hypothesis` calls this module.
"""

from __future__ import annotations

import math
from collections import namedtuple
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
import tomli_w

from impact_xval.compliant_baselines.registry import exact_law_names, exact_solver_for, sort_by_law
from impact_xval.experiments.config.axes import AXES, Sample
from impact_xval.experiments.config.cells import sobol_sequence
from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.config.experiment import REFERENCE, parse_config
from impact_xval.experiments.hypothesis.chains import solve_chains
from impact_xval.experiments.hypothesis.config import HypothesisConfig, spaced_contrasts
from impact_xval.experiments.hypothesis.judging import (
    judge_classes,
    judge_points,
    kinetic_distance,
    mark_usable,
)
from impact_xval.experiments.sweep.run import SweepResult, run_sweep
from impact_xval.experiments.tables.folder import finished_run, new_folder, write_text
from impact_xval.experiments.tables.frames import Frame
from impact_xval.experiments.tables.parquet import read_table, replacing
from impact_xval.model import solve_batch
from impact_xval.model.status import RESULT_STATUSES

#: Names in the folder of a test: the configuration, the run of exact solvers, and two runs of engines. The run `UNITED`
#: has the limiting cases `_BALLS_UNITE`, in which the model's balls become one body. Engines, whose positions are not
#: frozen, end far from the closed form there, so that a wider tolerance and half the steps suffice.
CONFIGURATION, EXACT, ENGINES, UNITED = "hypothesis.toml", "exact", "engines", "engines-united"
_BALLS_UNITE = ("zero-early", "zero-late")

#: Settings of all runs. The cut-off of the stiffness ratio is infinite. Beyond a finite cut-off the model would use the
#: closed form that is tested.
_SETTINGS: dict[str, object] = {"scenario": "impact", "measures": "velocities", "m1": 1.0, "k1": 1.0}
_SETTINGS |= {"stiffness_ratio_cutoff": math.inf, "step_fraction": 5e-3, "max_steps": 50_000_000}

#: Error of an exact solver's velocities by rounding, per abs(v0).
ROUNDING = 1e-13

#: Columns that are read from the table of a run and replaced by others (`_READ`), columns that are read from it and
#: kept in the table of outcomes (`_KEPT`), and columns with the velocities of the closed form (`_CLOSED`).
_READ = ["v1", "v2", "v1_limit", "v2_limit", "limit_error", "velocity_error"]
_KEPT = ["solver", "status", "reason", "limit_distance", "grazing_margin"]
_CLOSED = ["closed_form_v1", "closed_form_v2"]

#: Least distance of a point from the border of its regime, as a velocity per abs(v0). A regime is the set of points for
#: which one closed form is valid. At its border another closed form becomes valid. At a small distance d from the
#: border, outcomes approach the closed form only at contrasts above 1/d. Near the border balls also part so slowly that
#: engines need very many steps.
MARGIN = 0.1

#: Ranges from which points are drawn: of m2/m1, of restitutions below 1, and of k2/k1. The ratio k2/k1 is drawn only if
#: e1 or e2 is the number that goes to its limit.
_RANGES = {"stiffness_ratio": {"log": [0.03, 30.0]}, "mass_ratio": {"log": [0.2, 10.0]}}
BOX = Sample.model_validate(_RANGES | {e: {"linear": [0.3, 0.95]} for e in ("e1", "e2")})

#: Ratios and restitutions of a collision. The number that goes to its limit is NaN.
Point = namedtuple("Point", AXES)


class LimitingCase(NamedTuple):
    """A limiting case, or one regime of a limiting case with its own closed form.

    `variable` is the contrast in symbols, `regime` the condition that points fulfil, and `axis` the ratio or
    restitution that goes to its limit.
    """

    key: str
    variable: str
    regime: str
    axis: str = "stiffness_ratio"

    plastic = property(
        lambda self: self.axis != "stiffness_ratio", doc="Whether a restitution goes to its limit."
    )

    def at(self, contrast: float) -> dict[str, float]:
        """Return the value of the ratio or restitution that goes to its limit, by its name, at a contrast."""
        return {self.axis: contrast ** {"k2/k1": 1, "k1/k2": -1}.get(self.variable, -0.5)}


LIMITING_CASES = (
    LimitingCase(
        "zero-apart", "k1/k2", "e1 m2/m1 ≥ 1 and e2 (1 + e1) ≤ e1 m2/m1 - 1"
    ),  # the balls part at once
    LimitingCase(
        "zero-early", "k1/k2", "e1 m2/m1 below 1"
    ),  # one body from a time when the table contact is compressed
    LimitingCase(
        "zero-late", "k1/k2", "e1 m2/m1 ≥ 1 and e2 (1 + e1) above e1 m2/m1 - 1"
    ),  # one body from a time when the table contact restores
    LimitingCase("infinity", "k2/k1", "everywhere"),
    LimitingCase("plastic-ball-ball", "1/e1^2", "everywhere", "e1"),
    LimitingCase("plastic-ball-table", "1/e2^2", "everywhere", "e2"),
)


def distance_from_border(case: LimitingCase, point: Point) -> float:
    """Return the distance of a point from the border of the regime of a limiting case, as a velocity per abs(v0).

    The distance is positive inside the regime, negative outside, and infinite if the regime has no border. At k2/k1 → 0
    the borders are v11 = 0 and -e2 v21 = v11. Here v11 and v21 are the velocities of ball 1 and ball 2 after an impact
    of the balls alone (supplement, equations 11 and 12).
    """
    _, mu, e1, e2 = point
    v11, v21 = (e1 * mu - 1) / (1 + mu), -(1 + e1) / (1 + mu)
    catch_up = -e2 * v21 - v11
    inside = {"zero-apart": min(v11, -catch_up), "zero-early": -v11, "zero-late": min(v11, catch_up)}
    return inside.get(case.key, math.inf)


def pair_class(case: LimitingCase, point: Point) -> str:
    """Return the name of the class of a point, which says which of its contacts are elastic (e = 1).

    In a plastic limiting case, e1 → 0 or e2 → 0, the class says whether the other contact is elastic.
    """
    if case.plastic:
        return "other elastic" if 1 in (point.e1, point.e2) else "other lossy"
    names = {(True, True): "e1 = e2 = 1", (True, False): "only e1 = 1", (False, True): "only e2 = 1"}
    return names.get((point.e1 == 1, point.e2 == 1), "both lossy")


def draw_points(case: LimitingCase, n: int, seed: int) -> list[Point]:
    """Return n points of a limiting case from a scrambled Sobol sequence in `BOX`, rounded to six digits.

    Every point lies at least `MARGIN` inside the regime of the limiting case. If k2/k1 goes to its limit, half of the
    points have e1 < 1 and e2 < 1. Three groups of a sixth of the points each have only e1 = 1, only e2 = 1, and e1 = e2
    = 1. If a restitution goes to 0, the other restitution is 1 for a third of the points.
    """
    elastic = n // 6 * [{"e1": 1.0}] + n // 6 * [{"e2": 1.0}] + n // 6 * [{"e1": 1.0, "e2": 1.0}]
    if case.plastic:
        elastic = n // 3 * [{"e2" if case.axis == "e1" else "e1": 1.0}]
    sampler = sobol_sequence(4, np.random.default_rng([seed, *case.key.encode()]))
    unit = sampler.random(2**16)  # a number of points that is enough for every class of a regime
    ratios_drawn = iter(BOX.place(np.roll(unit, 1, axis=1)))

    def inside(fixed: dict[str, float]) -> Point:
        points = (Point(*(float(f"{x:.6g}") for x in ratios))._replace(**fixed) for ratios in ratios_drawn)
        return next(point for point in points if distance_from_border(case, point) >= MARGIN)

    wanted = (n - len(elastic)) * [{}] + elastic
    return [inside(fixed_ratios | {case.axis: math.nan}) for fixed_ratios in wanted]


def draw_design(n: int, seed: int) -> Frame:
    """Return the points of all limiting cases, one per row, with their classes and the closed form's velocities."""
    tables = []
    for case in LIMITING_CASES:
        points = draw_points(case, n, seed)
        table: Frame = pd.DataFrame(points)
        closed = solve_batch(**table.assign(**case.at(math.inf)), stiffness_ratio_cutoff=math.inf)
        known = {"case": case.key, "point": range(n), "class": [pair_class(case, each) for each in points]}
        tables.append(table.assign(**known, closed_form_v1=closed.v1, closed_form_v2=closed.v2))
    return pd.concat(tables, ignore_index=True)


class HypothesisResults(NamedTuple):
    """Results of a test of the hypothesis.

    Three tables are about pairs of balls on a table. `outcomes` has one row per solver, point and contrast. `points`
    has the verdicts on solvers at points, one per row. `verdicts` has the verdicts on classes of points, with the class
    ``all`` first. `chain_outcomes` and `chains` are the outcomes and verdicts for chains of N balls. `versions` has the
    version of each engine, or the reason why the engine is not available.
    """

    config: HypothesisConfig
    outcomes: Frame
    points: Frame
    verdicts: Frame
    chain_outcomes: Frame
    chains: Frame
    versions: dict[str, str]

    @property
    def solvers(self) -> list[str]:
        """The solvers that were tested. Solvers that were asked for the same law stand together."""
        return sort_by_law(name for name in self.config.solvers if name in set(self.points.solver))


def prepare_runs(config: HypothesisConfig, root: Path) -> Iterator[tuple[str, Callable[..., SweepResult]]]:
    """Prepare the folder of a test, and yield the runs of the test.

    Each run is yielded as a pair: a line of text with the name and the solvers of the run, and a function that performs
    the run by calling `run_sweep`. A `UserError` is raised if the folder holds anything other than the same test.
    """
    file, text = root / CONFIGURATION, tomli_w.dumps(config.model_dump(mode="json"))
    if not file.exists():
        new_folder(root)
        write_text(file, text)
    elif file.read_text(encoding="utf-8") != text:
        raise UserError(f"--out {root}: holds another test of the hypothesis; legal: a new or empty folder")
    for name, solvers in _solvers_by_run(config).items():
        cells = root / f"{name}.parquet"
        with replacing(cells) as temporary:
            _list_cells(config, name).to_parquet(temporary, index=False)
        laws = {exact_solver_for(solver, "calibrated") for solver in solvers} - {"", REFERENCE, *solvers}
        given = {"name": f"hypothesis, {name}", "cells": str(cells), "cell_timeout": config.cell_timeout}
        given |= {"convergence": {"tolerance": 3e-3 if name == UNITED else 2e-4, "halvings": 3}}
        experiment = parse_config(_SETTINGS | given | {"solvers": [*solvers, *sorted(laws)]})
        yield f"{name}: {', '.join(experiment.solvers)}", partial(run_sweep, experiment, root / name)


def _solvers_by_run(config: HypothesisConfig) -> dict[str, list[str]]:
    """Return the solvers of each run of a test, by the name of the run. A run without solvers is left out."""
    exact = [name for name in config.solvers if name in exact_law_names()]
    engines = [name for name in config.solvers if name not in exact]
    return {name: names for name, names in ((EXACT, exact), (ENGINES, engines), (UNITED, engines)) if names}


def _list_cells(config: HypothesisConfig, run: str) -> Frame:
    """Return the cells of a run, one per row, sorted by limiting case and then by contrast.

    Cells that follow one another then need about the same number of time steps.
    """
    contrasts = spaced_contrasts(config.contrast, config.per_decade)
    plastic_contrasts = spaced_contrasts(config.plastic_contrast, max(4, config.per_decade // 2))
    if run != EXACT:  # the number of steps grows as the square root of the contrast
        contrasts, plastic_contrasts = (
            spaced_contrasts((10**0.5, 10**3.5), 2),
            spaced_contrasts((1e2, 1e5), 2),
        )
    points = draw_design(config.points, config.seed)
    cells = [
        points[points["case"] == case.key].assign(contrast=x, **case.at(x))
        for case in LIMITING_CASES
        if run == EXACT or (case.key in _BALLS_UNITE) == (run == UNITED)
        for x in (plastic_contrasts if case.plastic else contrasts)
    ]
    return pd.concat(cells, ignore_index=True)


def judge_runs(config: HypothesisConfig, root: Path) -> HypothesisResults:
    """Return the results of a test, with all verdicts, from the finished runs in its folder."""
    tables, versions = [], {}
    for name, solvers in _solvers_by_run(config).items():
        folder = finished_run(root / name)
        rows: Frame = read_table(folder.table_path("cells.parquet"), ["cell", *_KEPT, *_READ]).to_pandas()
        rows = rows[rows.solver.isin(solvers) & (rows.status != "unavailable")]
        rows = rows.merge(pd.read_parquet(root / f"{name}.parquet"), left_on="cell", right_index=True)
        tables.append(rows.assign(decades=config.fit_decades if name == EXACT else 2.0))
        if name != EXACT:
            versions = {engine: folder.manifest()["versions"][engine] for engine in solvers}
    order = [*(case.key for case in LIMITING_CASES), *sort_by_law(config.solvers)]
    outcomes = _make_outcomes(pd.concat(tables)).sort_values(
        ["case", "solver", "point", "contrast"],
        key=lambda column: column.map(order.index) if column.name in ("case", "solver") else column,
        ignore_index=True,
    )
    points = judge_points(outcomes, ["case", "solver", "point", "class"])
    ratios = draw_design(config.points, config.seed)[["case", "point", *AXES, *_CLOSED]]
    chains, keys = solve_chains(config), ["arrangement", "stiff_contact", "meets", "solver"]
    of_chains = (
        judge_classes(judge_points(chains, [*keys, "chain", "class"]), keys) if len(chains) else chains
    )
    of_cases = judge_classes(points, ["case", "solver"])
    points = points.merge(ratios, on=["case", "point"])
    return HypothesisResults(config, outcomes, points, of_cases, chains, of_chains, versions)


def _make_outcomes(rows: Frame) -> Frame:
    """Return the table of outcomes, whose column `used` says which outcomes a verdict may use.

    The outcome of an engine is its limit at a time step of zero.
    """
    limits, velocities = (rows[names].to_numpy() for names in (["v1_limit", "v2_limit"], ["v1", "v2"]))
    at_no_step = ~np.isnan(limits).any(axis=1)
    has_result = rows.status.isin(RESULT_STATUSES) | (at_no_step & (rows.status == "unconverged"))
    v = np.where(has_result.to_numpy()[:, None], np.where(at_no_step[:, None], limits, velocities), np.nan)
    closed_form, weights = rows[_CLOSED].to_numpy(), np.column_stack([np.ones(len(rows)), rows.mass_ratio])
    root = np.where(rows["case"].str.startswith("plastic"), 1.0, np.sqrt(rows.contrast))
    rows = rows.drop(columns=["cell", *_READ]).assign(
        velocities=v.tolist(),
        closed_form=closed_form.tolist(),
        weights=weights.tolist(),
        error=rows[["limit_error", "velocity_error"]].max(axis=1).fillna(0.0).clip(lower=ROUNDING),
        distance=kinetic_distance(weights, v - closed_form),
    )
    return mark_usable(rows, root)
