"""Rows of a chunk of cells do not depend on how cells are grouped, and a failure in one cell costs only this cell."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.experiments.config.cells import experiment_cells
from impact_xval.experiments.config.experiment import REFERENCE, parse_config
from impact_xval.experiments.measures.divergence import results_of
from impact_xval.experiments.sweep.chunk import Chunk
from impact_xval.experiments.sweep.process import FaultError
from impact_xval.experiments.sweep.rows import (
    Experiment,
    complete_rows,
    model_as_comparison,
    solve_all,
    solve_and_compare,
    solve_by_model,
)
from impact_xval.model.path import Path
from tests.experiments import fakes

EXACT = ["state-transition", "bistiffness", "kelvin-voigt"]


def config_of(**changes):
    return parse_config({"solvers": EXACT, "sample": {"n": 40, "seed": 5}, "scenario": "impact"} | changes)


@pytest.mark.parametrize("chain", [False, True])
def test_order_and_company_change_no_bit(chain):
    axes = {"balls": [2, 3], "e": [0.7, 0.9]}
    config = parse_config({"solvers": EXACT, "chain": axes}) if chain else config_of()
    experiment, cells = Experiment(config), experiment_cells(config)
    whole = solve_all(experiment, cells.block(range(len(cells))))
    for start, stop in ((0, 1), (5, 12)):
        rows = solve_all(experiment, cells.block(range(start, stop)))
        assert rows.equals(whole[start * len(EXACT) : stop * len(EXACT)])


def test_rows_of_velocities_alone_are_the_same_velocities_without_curves_and_marks():
    configs = [config_of(measures=each) for each in ("all", "velocities")]
    all_of_it, alone = (solve_all(Experiment(c), experiment_cells(c).block(range(40))) for c in configs)
    for name in ("solver", "status", "v1", "v2", "impulse1", "velocity_divergence", "grazing_margin"):
        assert all_of_it[name].equals(alone[name]), name
    assert all_of_it["impulse_curve_distance"].null_count < len(alone)
    assert alone["impulse_curve_distance"].null_count == alone["states_equal"].null_count == len(alone)


def test_arrays_say_what_outcomes_say_one_by_one():
    block = experiment_cells(config_of()).block(range(40))
    speed, shortest = np.ones(40), np.full(40, 1e-6)
    for name in EXACT:
        outcomes = get_solver(name).solve_many(block.collisions, Settings(record_path=True))
        arrays, single = (results_of(each, speed, 2, 2, shortest) for each in (outcomes, list(outcomes)))
        for field in ("velocities", "impulses", "status", "reason", "mark", "n_states", "n_events", "margin"):
            np.testing.assert_array_equal(
                getattr(arrays, field), getattr(single, field), err_msg=f"{name} {field}"
            )
        assert (arrays.states, arrays.compared) == (single.states, single.compared)
        np.testing.assert_array_equal(arrays.curves.impulses, single.curves.impulses)


class _Nonsense(fakes.Shifted):
    """A solver whose path has arrays of different lengths where e1 is above 0.9."""

    def moved(self, collision, settings):
        outcome = super().moved(collision, settings)
        if collision.e1 > 0.9:
            two = np.ones((2, 2))
            return replace(outcome, path=Path(np.ones(3), two, two, two, two > 0))
        return outcome


def test_an_outcome_of_which_no_measure_can_be_made_costs_its_own_row():
    config = config_of(solvers=["mujoco"], sample={"n": 16, "seed": 1, "e1": {"linear": [0.5, 1.0]}})
    experiment = Experiment(config, _Nonsense.resolve)
    block = experiment_cells(config).block(range(16))
    rows = [row for row in solve_all(experiment, block).to_pylist() if row["solver"] == "mujoco"]
    for row in rows:
        assert (row["status"] == "crashed") == (row["e1"] > 0.9), row
        assert row["status"] != "crashed" or row["reason"].startswith("measuring its outcome: ")
    assert {row["status"] for row in rows} == {"ok", "closed-form", "crashed"}


def test_a_ladder_that_fails_costs_its_own_cell():
    config = config_of(solvers=["mujoco"], sample={"n": 8, "seed": 2})
    experiment = Experiment(config, fakes.Shifted.resolve)
    block = experiment_cells(config).block(range(8))
    model = solve_by_model(experiment, block)
    comparisons = {
        REFERENCE: model_as_comparison(model),
        "mujoco": solve_and_compare(experiment, "mujoco", block, model),
    }
    whole = complete_rows(experiment, block, comparisons)

    def call(solver, function, block, comparisons, timeout):
        if {3, 7} & set(block.index.tolist()):
            raise FaultError("crashed", "its process died: SIGSEGV")
        return function(experiment, block, comparisons)

    chunk = Chunk(SimpleNamespace(context=experiment, call=call), block)
    rows = chunk.rows(comparisons).to_pylist()
    for row, other in zip(rows, whole.to_pylist(), strict=True):
        if row["solver"] == "mujoco" and row["cell"] in (3, 7):
            assert (row["ladder_status"], row["ladder_dv1"]) == ("crashed", None)
            assert row["ladder_reason"] == "ladder: its process died: SIGSEGV"
        else:
            assert row == other
