"""Exported scenes: run by the engine alone they give what the table holds."""

import json
import re
import subprocess
import sys

import pyarrow.parquet as pq
import pytest

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.paste import scene_files
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.experiments.commands.cli import main
from impact_xval.experiments.config.experiment import parse_config
from impact_xval.experiments.sweep.run import run_sweep
from impact_xval.model.collision import Collision

ENGINES = [name for name in ("mujoco", "pybullet") if get_solver(name).unavailable() is None]
RATIOS = ["--stiffness-ratio", "40", "--mass-ratio", "1.1547", "--e1", "0.9", "--e2", "0.7"]


def run_alone(script):
    """Run a script where nothing of this project can be found; give its velocities."""
    assert "compliant_baselines" not in script.read_text(encoding="utf-8")
    guard = (
        "import sys, runpy\n"
        "sys.modules.update(dict.fromkeys(('model', 'compliant_baselines', 'experiments')))\n"
        f"runpy.run_path({str(script)!r}, run_name='__main__')"
    )
    done = subprocess.run(
        [sys.executable, "-I", "-c", guard], capture_output=True, text=True, cwd="/", check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return [float(v) for v in re.findall(r"^v\d = (\S+) m/s", done.stdout, re.MULTILINE)]


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(
    "options",
    [
        [],
        ["--scenario", "drop", "--k1", "1e4", "--gravity", "1.62"],
        ["--v0", "-3.3", "--m1", "0.2"],
        ["--scenario", "drop", "--stiffness-ratio", "0.108279", "--e1", "0.627179", "--k1", "1e8"],
    ],
    ids=["impact", "drop", "fast", "flight"],
)
def test_an_exported_scene_gives_the_numbers_of_solve(engine, options, tmp_path, capsys):
    common = [*RATIOS, "--solver", engine, *options]
    assert main(["scene", *common, "--out", str(tmp_path)]) == 0
    assert f"to check: python {tmp_path}" in capsys.readouterr().out
    assert main(["solve", *common, "--json"]) == 0
    row, _ = json.loads(capsys.readouterr().out)  # and the model
    speed = 3.3 if "--v0" in options else 1.0
    v1, v2 = run_alone(tmp_path / engine / "run.py")
    assert v1 / speed == pytest.approx(row["v1"], abs=1e-12)
    assert v2 / speed == pytest.approx(row["v2"], abs=1e-12)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("table", [True, False])
def test_the_files_of_a_column_give_the_numbers_of_its_run(engine, table, tmp_path):
    contacts = 2 + table
    collision = Collision(
        (1.0, 2.0, 0.5), (1e5, 1e6, 1e4)[:contacts], (0.9, 1.0, 0.7)[:contacts], (-1.0, 0.0, 0.0), table
    )
    solver = get_solver(engine)
    run, files = scene_files(
        solver, solver.scene_or_refusal(collision, Settings(step_fraction=5e-3)), 100_000
    )
    for name, text in files.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    assert run.over
    assert run_alone(tmp_path / "run.py") == pytest.approx(run.velocities.tolist(), abs=1e-12)


def test_a_cell_of_a_run_gives_what_its_table_holds(tmp_path, capsys):
    run = tmp_path / "run"
    grid = {"stiffness_ratio": [0.1, 10.0], "mass_ratio": [1.0], "e1": [0.7], "e2": [0.7, 0.0]}
    run_sweep(parse_config({"solvers": ENGINES, "step_fraction": 5e-3, "grid": grid}), run, isolate=False)
    assert main(["scene", str(run), "2", "--out", str(tmp_path / "scene")]) == 0
    assert capsys.readouterr().out.count(" m/s (difference 0.0e+00 |v0|)") == len(ENGINES)
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
