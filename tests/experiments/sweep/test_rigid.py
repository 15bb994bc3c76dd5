"""Runs that name rigid laws: of collisions and of columns, beside the model."""

import pandas as pd
import pytest

from impact_xval.experiments.commands.cli import main

LAWS = ["newton", "sequential-top", "generalised-reflection"]


def ran(folder, text):
    config = folder / "rigid.toml"
    config.write_text(f"solvers = {['state-transition', *LAWS]}\n{text}", encoding="utf-8")
    assert main(["run", str(config), "--out", str(folder / "run"), "--workers", "1"]) == 0
    return pd.read_parquet(folder / "run" / "cells.parquet")


@pytest.mark.slow
def test_a_run_of_collisions(tmp_path):
    grid = "[grid]\nstiffness_ratio = [0.1, 10.0]\nmass_ratio = [2.0]\ne1 = [1.0]\ne2 = [1.0, 0.5]\n"
    cells = ran(tmp_path, grid).set_index(["solver", "stiffness_ratio", "e2"])
    for ratio in (0.1, 10.0):
        assert cells.loc["newton", ratio, 1.0][["v1", "v2"]].tolist() == [1.0, 0.0]
        found = cells.loc["sequential-top", ratio, 1.0]
        assert (found.status, found.v1, found.v2) == ("ok", pytest.approx(7 / 9), pytest.approx(4 / 9))
        assert cells.loc["generalised-reflection", ratio, 0.5].status == "unrepresentable"


@pytest.mark.slow
def test_a_run_of_columns(tmp_path):
    cells = ran(
        tmp_path, '[column]\narrangement = ["cradle"]\nballs = [5]\ne = [1.0]\nstiffness_taper = [1.0]\n'
    )
    found = {row.solver: list(row.velocities) for row in cells.itertuples()}
    assert found["newton"] == pytest.approx([0.6, *[-0.4] * 4])
    assert found["sequential-top"] == found["generalised-reflection"] == pytest.approx([0, 0, 0, 0, -1])
