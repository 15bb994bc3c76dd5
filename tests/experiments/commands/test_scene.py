"""The command `scene` on a run: its files give what the table holds, and what cannot be written is one line."""

import pyarrow.parquet as pq

from impact_xval.experiments.commands.cli import main
from impact_xval.experiments.config.experiment import parse_config
from impact_xval.experiments.sweep.run import run_sweep
from tests.compliant_baselines.test_paste import ENGINES, run_alone


def test_a_cell_of_a_run_gives_what_its_table_holds(tmp_path, capsys):
    run = tmp_path / "run"
    grid = {"stiffness_ratio": [0.1, 10.0], "mass_ratio": [1.0], "e1": [0.7], "e2": [0.7, 0.0]}
    run_sweep(parse_config({"solvers": ENGINES, "step_fraction": 5e-3, "grid": grid}), run, isolate=False)
    assert main(["scene", str(run), "2", "--out", str(tmp_path / "scene")]) == 0
    said = capsys.readouterr().out
    assert said.count(" m/s (difference 0.0e+00 |v0|)") == len(ENGINES)
    assert f"to check: python {tmp_path / 'scene'}" in said
    rows = pq.read_table(run / "cells.parquet").to_pylist()
    for engine in ENGINES:
        (row,) = (r for r in rows if r["cell"] == 2 and r["solver"] == engine)
        v1, v2 = run_alone(tmp_path / "scene" / engine / "run.py")
        assert abs(v1 - row["v1"]) <= 1e-12
        assert abs(v2 - row["v2"]) <= 1e-12
    # what cannot be exported is said, and nothing is written
    for arguments, says in (
        (["1"], "unrepresentable: e2 = 0: no finite damping"),
        (["4"], "N = 4; legal: a whole number from 0 to 3"),
        (["1", "--solver", "kelvin-voigt"], "--solver = 'kelvin-voigt'; legal: mujoco, pybullet"),
    ):
        out = tmp_path / "nothing"
        assert main(["scene", str(run), *arguments, "--out", str(out)]) == 2
        assert says in capsys.readouterr().err
        assert not out.exists()
