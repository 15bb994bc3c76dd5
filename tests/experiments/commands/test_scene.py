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
    rows = {r["solver"]: r for r in pq.read_table(run / "cells.parquet").to_pylist() if r["cell"] == 2}
    for engine in ENGINES:
        v1, v2 = run_alone(tmp_path / "scene" / engine / "run.py")
        assert max(abs(v1 - rows[engine]["v1"]), abs(v2 - rows[engine]["v2"])) <= 1e-12
    cell = "scene --stiffness-ratio 40 --mass-ratio 1.1547 --e1 0.9 --e2 0.7 --v0 -3.3 --solver mujoco --out"
    assert main([*cell.split(), str(tmp_path / "typed")]) == 0
    v1, v2 = run_alone(tmp_path / "typed" / "mujoco" / "run.py")
    assert f"mujoco: v1 = {v1!r} m/s, v2 = {v2!r} m/s" in capsys.readouterr().out
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
