"""Exported scenes: run by the engine alone they give what the adapter gives."""

import re
import subprocess
import sys

import pytest

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.paste import exported
from impact_xval.compliant_baselines.solver import Settings, SolverError
from impact_xval.model.collision import Collision

ENGINES = [name for name in ("mujoco", "pybullet") if get_solver(name).unavailable() is None]
DROP = {"scenario": "drop"}
COLUMN = (1.0, 2.0, 0.5), (1e5, 1e6, 1e4), (0.9, 1.0, 0.7), (-1.0, 0.0, 0.0)


def two_balls(kappa=40.0, e1=0.9, m1=1.0, k1=1e8, v0=-1.0):
    return Collision.two_balls(m1, 1.1547 * m1, k1, kappa * k1, e1, 0.7, v0)


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
    ("collision", "settings"),
    [
        (two_balls(), {}),
        (two_balls(k1=1e4), DROP | {"gravity": 1.62}),
        (two_balls(m1=0.2, v0=-3.3), {}),
        (two_balls(kappa=0.108279, e1=0.627179), DROP),
        (Collision(*COLUMN, True), {"step_fraction": 5e-3}),
        (
            Collision(COLUMN[0], *(some[:2] for some in COLUMN[1:3]), COLUMN[3], False),
            {"step_fraction": 5e-3},
        ),
    ],
    ids=["impact", "drop", "fast", "flight", "stack", "chain"],
)
def test_an_exported_scene_gives_the_numbers_of_solve(engine, collision, settings, tmp_path):
    settings = Settings(**settings)
    outcome, run, files = exported(engine, collision, settings)
    for name, text in files.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    found, speed = run_alone(tmp_path / "run.py"), max(map(abs, collision.velocities))
    assert found == pytest.approx(run.velocities.tolist(), abs=1e-12 * speed)
    assert outcome.velocities == tuple(run.velocities)


def test_what_an_engine_refuses_is_not_exported():
    with pytest.raises(SolverError, match="unrepresentable: e1 = 0: no finite damping"):
        exported("mujoco", two_balls(e1=0.0), Settings())
