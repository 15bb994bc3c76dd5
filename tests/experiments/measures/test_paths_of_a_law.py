"""State paths in the tables of a run: what is compared, and the agreement of a solver with its own law."""

import dataclasses

import pyarrow.parquet as pq
import pytest

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.contact.column import shorter_period
from impact_xval.compliant_baselines.contract.solver import Settings
from impact_xval.compliant_baselines.contract.state_runs import compared_states
from impact_xval.experiments.config.configuration import parse_config
from impact_xval.experiments.measures.summary import OWN_LAW, summarise
from impact_xval.experiments.sweep.run import run_sweep
from impact_xval.model import Collision
from tests.experiments import fakes
from tests.experiments.conftest import SMALL

GRID = {"stiffness_ratio": {"log": [1e-3, 1e3, 5]}, "mass_ratio": [0.5, 2.0], "e1": [0.5, 0.9], "e2": [0.7]}


class Elsewhere(fakes.Shifted):
    """The path of bistiffness, out of reach where e1 = 0.9 and m2 = 0.5."""

    def solve_many(self, collisions, settings):
        if any(c.e1 == 0.9 and c.m2 == 0.5 for c in collisions):
            raise ZeroDivisionError
        outcomes = get_solver("bistiffness").solve_many(collisions, settings)
        return [dataclasses.replace(outcome, solver=self.name) for outcome in outcomes]


def elsewhere(name):
    return Elsewhere() if name == "mujoco" else get_solver(name)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """An engine before the reference of its law, and a law that is its own."""
    solvers = ["mujoco", "kelvin-voigt", "bistiffness"]
    config = parse_config(SMALL | {"solvers": solvers, "grid": GRID, "grazing_threshold": 0.0})
    return run_sweep(config, tmp_path_factory.mktemp("paths") / "run", isolate=False, resolve=elsewhere)


def test_the_tables_hold_the_complete_path_and_the_compared_one(run):
    rows = pq.read_table(run.root / "cells.parquet").to_pylist()
    briefer = 0
    for row in rows:
        if row["status"] == "crashed":
            assert row["states"] is row["states_compared"] is None
            continue
        c = Collision(*(row[name] for name in ("m1", "m2", "k1", "k2", "e1", "e2", "v0")))
        name = "bistiffness" if row["solver"] == "mujoco" else row["solver"]
        outcome = get_solver(name).solve(c, Settings(record_path=True))
        assert row["states"] == " ".join(outcome.states)
        assert row["states_compared"] == " ".join(compared_states(outcome, 2.5e-3 * shorter_period(c)))
        briefer += row["states_compared"] != row["states"]
    assert briefer > 5
    model = {row["cell"]: row["states_compared"] for row in rows if row["solver"] == "state-transition"}
    for row in pq.read_table(run.root / "divergence.parquet").to_pylist():
        assert row["model_states_compared"] == model[row["cell"]]
        if row["states_compared"] is not None:
            assert row["states_equal"] == (row["states_compared"] == row["model_states_compared"])
            assert (row["states_edit_distance"] == 0) == row["states_equal"]


def test_agreement_with_the_own_law_is_that_of_the_tables(run):
    table = pq.read_table(run.root / "divergence.parquet").to_pandas()
    wide = table.pivot(index="cell", columns="solver", values="states_compared")
    there = wide.mujoco.notna()
    assert 0 < there.sum() < len(wide)
    equal = (wide.mujoco == wide["kelvin-voigt"])[there]
    summary = summarise(run)
    found = summary.get("mujoco", OWN_LAW)
    assert (found.n, found["mean"]) == (there.sum(), pytest.approx(equal.mean()))
    assert 0 < equal.mean() < 1
    for value, part in table[table.solver == "mujoco"].groupby("stiffness_ratio"):
        cells = part.cell[part.states_compared.notna()]
        found = summary.get("mujoco", OWN_LAW, "stiffness_ratio", float(str(value)))
        assert (found.n, found["mean"]) == (len(cells), pytest.approx(equal[cells].mean()))
    for reference in ("kelvin-voigt", "bistiffness"):  # a law of their own
        assert summary.get(reference, OWN_LAW).n == 0


def test_without_the_reference_of_its_law_nothing_is_said_of_it(tmp_path, small):
    summary = summarise(run_sweep(small, tmp_path / "a", isolate=False, resolve=fakes.shifted))
    assert summary.get("mujoco", OWN_LAW).n == 0
