"""The command that calibrates engines."""

import pandas as pd
import pytest

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.contract import registry
from impact_xval.experiments.commands import calibration
from impact_xval.experiments.commands.cli import main
from impact_xval.experiments.sweep.sandbox import FaultError


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
    from impact_xval.compliant_baselines.engines.pybullet_engine import PybulletSolver

    monkeypatch.setattr(PybulletSolver, "unavailable", lambda self: "no wheel: use Python 3.11")
    monkeypatch.setattr(registry, "engine_names", lambda **_: ("mujoco", "pybullet"))
    assert main(["calibrate", "--out", str(tmp_path / "c")]) == 0
    assert "pybullet gave no result: no wheel: use Python 3.11." in capsys.readouterr().out
    steps = pd.read_csv(tmp_path / "c/calibration.csv")
    assert set(steps[steps.engine == "pybullet"].status) == {"unavailable"}
    assert set(steps[steps.engine == "mujoco"].status) == {"ok"}


@pytest.mark.parametrize("asked", [["--engine", "mujoco", "--engine", "pybullet"], []])
def test_where_no_engine_that_was_meant_is_there_nothing_is_tried(asked, tmp_path, capsys, monkeypatch):
    from impact_xval.compliant_baselines.engines.pybullet_engine import PybulletSolver

    monkeypatch.setattr(PybulletSolver, "unavailable", lambda self: "no wheel: use Python 3.11")
    monkeypatch.setattr(
        registry, "engine_names", lambda **_: ("mujoco", "pybullet") if asked else ("pybullet",)
    )
    assert main(["calibrate", *asked, "--out", str(tmp_path / "c")]) == 2
    assert capsys.readouterr().err == (
        "impact-xval: --engine pybullet: unavailable: no wheel: use Python 3.11; legal: an engine that is installed "
        "(impact-xval solvers)\n"
    )
    assert not (tmp_path / "c").exists()


class DyingSandbox:
    """Runs contacts here; a soft elastic one takes the process along."""

    def call(self, function, requests, *, timeout):
        if any((request.e, request.k) == (1.0, 1e4) for request in requests):
            raise FaultError("crashed", "its process died: SIGSEGV")
        return function("mujoco", requests)


def test_a_contact_that_crashes_its_engine_is_a_row_and_costs_no_other(few):
    requests = calibration.requests()
    rows = calibration.rows_of(get_solver("mujoco"), DyingSandbox(), requests)
    crashed = [row for row in rows if row["status"] != "ok"]
    assert {(row["e"], row["k"], row["reason"]) for row in crashed} == {
        (1.0, 1e4, "its process died: SIGSEGV")
    }
    assert (len(rows), len(crashed)) == (len(requests), len(requests) // 4)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--engine", "bullet"], "--engine = 'bullet'; legal: mujoco, pybullet"),
        (["--engine", "kelvin-voigt"], "--engine = 'kelvin-voigt'; legal: mujoco"),
        (["--engine", "mujoco", "--engine", "mujoco"], "--engine 'mujoco' is given more than once"),
    ],
)
def test_what_cannot_be_calibrated_is_said(arguments, says, tmp_path, capsys):
    assert main(["calibrate", *arguments, "--out", str(tmp_path / "c")]) == 2
    assert says in capsys.readouterr().err
    assert not (tmp_path / "c").exists()


def test_a_folder_that_holds_something_is_left_alone(few, tmp_path, capsys):
    (tmp_path / "mine").write_text("keep")
    assert main(["calibrate", "--engine", "mujoco", "--out", str(tmp_path)]) == 2
    assert "not empty (mine); legal: a new or empty folder" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]


def test_a_file_is_no_folder(few, tmp_path, capsys):
    (tmp_path / "file").write_text("keep")
    for out, says in (
        ("file", "is a file; legal: a new or empty folder"),
        ("file/c", "cannot be written to"),
    ):
        assert main(["calibrate", "--engine", "mujoco", "--out", str(tmp_path / out)]) == 2
        assert f"--out {tmp_path / out}: {says}" in capsys.readouterr().err
    assert (tmp_path / "file").read_text() == "keep"
