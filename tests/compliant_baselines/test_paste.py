"""Exported scenes that the engine runs without this project.

Their velocities agree to 1e-12 with the velocities that the project's adapter of the engine returns.
"""

import re
import subprocess
import sys

import pytest

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.paste import export_scene
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.model.collision import Collision

ENGINES = [name for name in ("mujoco", "pybullet") if get_solver(name).unavailable() is None]
COARSE = {"step_fraction": 5e-3}


def run_alone(script):
    """Run a script in a process that cannot import this project; return the velocities that the script prints."""
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
    ("collision", "settings"),
    [
        (Collision.two_balls(0.2, 0.23094, 1e8, 4e9, 0.9, 0.7, -3.3), {}),
        (Collision.two_balls(1.0, 1.1547, 1e4, 4e5, 0.9, 0.7), {"scenario": "drop", "gravity": 1.62}),
        (Collision.two_balls(1.0, 1.1547, 1e8, 0.108279e8, 0.627179, 0.7), {"scenario": "drop"}),
        (Collision((1.0, 2.0, 0.5), (1e5, 1e6, 1e4), (0.9, 1.0, 0.7), (-1.0, 0.0, 0.0), True), COARSE),
        (Collision((1.0, 2.0, 0.5), (1e5, 1e6), (0.9, 1.0), (-1.0, 0.0, 0.0)), COARSE),
    ],
    ids=["impact", "drop", "flight", "stack", "chain"],
)
def test_an_exported_scene_gives_the_numbers_of_solve(engine, collision, settings, tmp_path):
    settings = Settings(**settings)
    outcome, run, files = export_scene(engine, collision, settings)
    for name, text in files.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    found, speed = run_alone(tmp_path / "run.py"), max(map(abs, collision.velocities))
    assert found == pytest.approx(run.velocities.tolist(), abs=1e-12 * speed)
    assert outcome.velocities == tuple(run.velocities)
