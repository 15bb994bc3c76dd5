"""The command that calibrates engines."""

import pandas as pd
import pytest

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.contract import registry
from impact_xval.compliant_baselines.engines.pybullet_engine import PybulletSolver
from impact_xval.experiments.commands import calibration
from impact_xval.experiments.commands.cli import main


@pytest.fixture
def few(monkeypatch):
    monkeypatch.setattr(calibration, "RESTITUTIONS", (0.5, 1.0))
    monkeypatch.setattr(calibration, "STIFFNESSES", (1e4, 1e6))
    monkeypatch.setattr(calibration, "STEP_FRACTIONS", (1e-3, 5e-4, 2.5e-4))


def test_calibrate_writes_tables_and_a_figure(few, tmp_path, capsys):
    assert main(["calibrate", "--engine", "mujoco", "--out", str(tmp_path / "c")]) == 0
    said = capsys.readouterr().out
    assert "in the limit dt -> 0 8 of 8 contacts are within 0.001" in said
    assert sorted(path.name for path in (tmp_path / "c").iterdir()) == [
        "calibration.csv",
        "calibration.md",
        "calibration.pdf",
        "calibration.png",
        "limits.csv",
    ]
    steps = pd.read_csv(tmp_path / "c/calibration.csv")
    assert list(steps.columns) == list(calibration.COLUMNS)
    assert len(steps) == 2 * 2 * 2 * 2 * 3  # mappings, contacts, e, k, steps
    assert set(steps.version) == {get_solver("mujoco").version()}
    limits = pd.read_csv(tmp_path / "c/limits.csv")
    good = limits[limits.mapping == "calibrated"]
    assert (good.restitution - good.e).abs().max() < 1e-5
    assert (good.duration_ratio - 1).abs().max() < 1e-5
    assert (good.order - 1).abs().max() < 0.1
    naive = limits[(limits.mapping == "naive") & (limits.e == 0.5)]
    assert (naive.restitution - naive.e).abs().min() > 0.02
    text = (tmp_path / "c/calibration.md").read_text()
    assert "](calibration.png)" in text


def test_an_engine_that_is_missing_is_said_not_raised(few, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(PybulletSolver, "unavailable", lambda self: "no wheel: use Python 3.11")
    monkeypatch.setattr(registry, "engine_names", lambda **_: ("mujoco", "pybullet"))
    assert main(["calibrate", "--out", str(tmp_path / "c")]) == 0
    assert "pybullet gave no result: no wheel: use Python 3.11." in capsys.readouterr().out
    steps = pd.read_csv(tmp_path / "c/calibration.csv")
    assert set(steps[steps.engine == "pybullet"].status) == {"unavailable"}
    assert set(steps[steps.engine == "mujoco"].status) == {"ok"}


def test_what_cannot_be_calibrated_is_said_and_nothing_is_written(few, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(PybulletSolver, "unavailable", lambda self: "no wheel: use Python 3.11")
    (tmp_path / "mine").write_text("keep")
    for arguments, says in (
        (["--engine", "bullet"], "--engine = 'bullet'; legal: mujoco, pybullet"),
        (["--engine", "kelvin-voigt"], "--engine = 'kelvin-voigt'; legal: mujoco"),
        (["--engine", "mujoco", "--engine", "mujoco"], "--engine 'mujoco' is given more than once"),
        (
            ["--engine", "pybullet"],
            "--engine pybullet: unavailable: no wheel: use Python 3.11; legal: an engine",
        ),
        (["--engine", "mujoco", "--out", str(tmp_path)], "not empty; legal: a new or empty folder"),
    ):
        assert main(["calibrate", "--out", str(tmp_path / "c"), *arguments]) == 2
        assert says in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]
