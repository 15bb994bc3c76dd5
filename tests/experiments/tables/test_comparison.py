"""The comparison of two runs, checked with the tables of the runs and with runs that were made to differ."""

import dataclasses
import json
from typing import Any

import numpy as np
import pandas as pd
import pytest

from impact_xval.experiments.tables.comparison import compare_runs
from tests.experiments import fakes
from tests.experiments.conftest import SMALL, swept

SOLVERS = ["state-transition", "bistiffness", "mujoco"]
#: For some stiffness ratios: how much larger v1/|v0| is in the second run than in the first run.
FASTER = {1.0: 1e-6, 2.0: 3e-12}


class Upgraded(fakes.Crashing):
    """Another version of the engine. It changes a few velocities, and raises an exception for cells with e1 = 0.5."""

    def version(self):
        return "shifted 2"

    def moved(self, collision, settings):
        before = super().moved(collision, settings)
        faster = FASTER.get(collision.stiffness_ratio, 0.0) * abs(collision.v0)
        return dataclasses.replace(before, velocities=(before.v1 + faster, before.v2))


def _run(root, resolve=fakes.shifted, **changes):
    return swept(root, resolve, **{"solvers": SOLVERS} | changes)


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    root = tmp_path_factory.mktemp("runs")
    return _run(root / "a"), _run(root / "b", Upgraded.resolve)


# annotated as Any, because the annotations of data frames are too wide for a check
def _merged(runs, name) -> Any:
    a, b = (pd.read_parquet(folder.root / name) for folder in runs)
    return a.merge(b, on=["cell", "solver"], suffixes=("_a", "_b"))


@pytest.mark.parametrize(("tolerance", "moved"), [(1e-9, 8), (0.0, 10), (1e-5, 6)])
def test_the_changes_are_those_of_the_tables(runs, tolerance, moved):
    cells, away = _merged(runs, "cells.parquet"), _merged(runs, "divergence.parquet")
    found = compare_runs(*runs, tolerance)
    assert list(found.solvers) == SOLVERS
    mujoco = found.solvers["mujoco"]
    assert (found.moved, mujoco.moved, mujoco.statuses) == (moved, moved, 6)
    for name, each in found.solvers.items():
        mine = cells[cells.solver == name]
        assert each.compared == len(mine) == 12
        changes = np.abs(mine[["v1_a", "v2_a"]].to_numpy() - mine[["v1_b", "v2_b"]].to_numpy())
        assert each.velocity == np.nanmax(changes / np.abs(mine[["v0_a"]].to_numpy()))
        d = away[away.solver == name]
        change = (d.velocity_divergence_a - d.velocity_divergence_b).abs().max()
        assert each.divergence == (0 if name == "state-transition" else change)
    assert mujoco.velocity == pytest.approx(1e-6, rel=1e-6)
    # The worst rows are listed first: rows with another status, then the largest changes.
    ends = [(row.status_b, row.velocity == np.inf) for row in found.worst]
    assert ends == ([("crashed", True)] * 6 + [("ok", False)] * 4)[:moved]
    worst = cells[cells.solver == "mujoco"].set_index("cell").loc[[row.cell for row in found.worst]]
    assert worst.stiffness_ratio_a.tolist() == [0.5, 0.5, 1.0, 1.0, 2.0, 2.0, 1.0, 1.0, 2.0, 2.0][:moved]
    assert worst.e1_a.tolist() == ([0.5] * 6 + [0.9] * 4)[:moved]


def test_the_command_ends_with_3_where_something_moved_and_with_0_where_nothing_did(runs, command):
    a, b = (folder.root for folder in runs)
    assert command(["compare", a, a, "--tolerance", "0"]).startswith("Nothing changed by more than 0.")
    text = command(["compare", a, b], ends=3)
    assert "8 rows changed by more than 1e-09, or changed the status." in text
    assert "mujoco is shifted 1 in the first run, shifted 2 in the second." in text
    found = json.loads(command(["compare", a, b, "--json"], ends=3))
    assert (found["moved"], found["worst"][0]["statuses"]) == (8, ["ok", "crashed"])


def test_solvers_and_settings_that_differ_are_named(runs, tmp_path):
    other = _run(tmp_path / "c", solvers=["state-transition", "kelvin-voigt", "mujoco"], step_fraction=5e-4)
    found = compare_runs(runs[0], other, 1e-9)
    assert list(found.solvers) == ["state-transition", "mujoco"]
    assert found.alone == ["bistiffness", "kelvin-voigt"]
    assert found.settings == {"step_fraction": ("0.001", "0.0005")}


def test_a_solver_or_cells_of_one_run_alone_are_said_and_end_with_3(runs, tmp_path, command):
    a, longer = runs[0].root, {"grid": SMALL["grid"] | {"stiffness_ratio": [0.5, 1, 2, 3]}}
    for changes, solvers, cells, says in (
        ({"solvers": SOLVERS[:-1]}, ["mujoco"], [], "mujoco."),
        (longer, [], [12, 13, 14, 15], "4 cells, first cell 12."),
    ):
        b = _run(tmp_path / str(len(solvers)), **changes).root
        for pair in ([a, b], [b, a]):
            said = command(["compare", *pair], ends=3)
            assert f"Not compared, because only one run has it: {says}\n" in said
            found = json.loads(command(["compare", *pair, "--json"], ends=3))
            assert (found["moved"], found["not_compared"], found["cells_not_compared"]) == (0, solvers, cells)


def test_runs_whose_cells_differ_are_refused_with_the_place(runs, tmp_path, refused):
    a, grid = runs[0].root, SMALL["grid"]
    for changes, says in (
        ({"grid": grid | {"e2": [0.71]}}, f"cell 0: e2 = 0.7 in {a}, 0.71 in "),
        ({"v0": -2.0}, f"cell 0: v0 = -1.0 in {a}, -2.0 in "),
    ):
        other = _run(tmp_path / str(len(list(tmp_path.iterdir()))), **changes)
        refused(["compare", a, other.root], f"impact-xval: {says}", "; legal: two runs of the same cells")
    refused(["compare", a, a, "--tolerance", "nan"], "--tolerance = nan; legal: a")


def test_chains_of_n_balls_are_compared_ball_by_ball(tmp_path, refused, runs):
    chain = {"arrangement": ["cradle", "stack"], "balls": [2, 3], "stiffness_taper": 1.0, "e": 0.9}
    a = _run(tmp_path / "a", chunk_size=1, grid=None, chain=chain)
    b = _run(tmp_path / "b", fakes.refusing, chunk_size=1, grid=None, chain=chain)
    assert compare_runs(a, a, 0).moved == 0
    found = compare_runs(a, b, 1e-9)
    assert [each.moved for each in found.solvers.values()] == [0, 0, 4]
    refused(["compare", a.root, runs[0].root], "a run of chains of N balls, ")
