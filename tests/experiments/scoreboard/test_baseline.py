"""The scoreboard against a baseline: answers that differ, answers of one scoreboard only, and answers that are read."""

import re

import numpy as np
import pandas as pd
import pytest

from impact_xval.compliant_baselines import get_solver, solver_names
from impact_xval.experiments.scoreboard import plane, playing
from impact_xval.experiments.scoreboard.baseline import compare_with_baseline, read_baseline
from impact_xval.experiments.scoreboard.cases import CASES, USUAL
from impact_xval.experiments.scoreboard.page import ANSWERS
from impact_xval.experiments.scoreboard.plane import PLANE_ANSWERS, PLANE_CASES, PLANE_COLUMNS


def answers_of(*solvers):
    """Return the answers of solvers to the cases in a line and in a plane; all velocities are 1 m/s."""
    row = {"version": "1", "status": "ok", "reason": ""}
    in_line = [
        row | {"solver": solver, "case": case, "e": e, "arrangement": USUAL, "v1": 1.0, "v2": 1.0}
        for solver in solvers
        for case, e in CASES
    ]
    in_plane = [
        row | {"solver": solver, "case": case, "e": e, "v1x": 1.0, "v1z": 1.0}
        for solver in solvers
        for case, e in PLANE_CASES
    ]
    return pd.DataFrame(in_line, columns=playing._COLUMNS), pd.DataFrame(in_plane, columns=PLANE_COLUMNS)


def folder_with(path, in_line, in_plane=None):
    path.mkdir()
    in_line.to_parquet(path / ANSWERS)
    if in_plane is not None:
        in_plane.to_parquet(path / PLANE_ANSWERS)
    return path


@pytest.fixture
def compared(tmp_path):
    """Return a function that compares answers with a baseline.

    It returns the section, whether an answer differs, and the rows of the written file.
    """

    def compared(before, after, *named):
        baseline = read_baseline(folder_with(tmp_path / "base", *before))
        section, differs = compare_with_baseline(baseline, *after, tmp_path, named)
        return section, differs, pd.read_csv(tmp_path / "moved.csv")

    return compared


def test_the_number_of_compared_answers_is_said(compared):
    section, differs, moved = compared(answers_of("law", "pebble"), answers_of("law", "pebble"))
    (line,) = section.blocks
    n = 2 * (len(CASES) + len(PLANE_CASES))
    assert line.startswith("no answer differs")
    assert line.endswith(f"{n} answers of 2 solvers were compared")
    assert (differs, len(moved)) == (False, 0)


def test_a_solver_that_is_not_in_the_baseline_is_named(compared):
    section, differs, _ = compared(answers_of("law"), answers_of("law", "pebble"), "pebble")
    said, line = section.blocks
    n = len(CASES) + len(PLANE_CASES)
    assert said == f"pebble: {n} answers not compared, only in this scoreboard"
    assert f"{n} answers of 1 solvers" in line
    assert differs


def test_new_solvers_that_were_not_asked_for_by_name_are_named_and_are_no_change(compared):
    section, differs, _ = compared(answers_of("law"), answers_of("law", "pebble", "stone"))
    n = len(CASES) + len(PLANE_CASES)
    assert section.blocks[0] == f"pebble and stone: {n} answers each not compared, only in this scoreboard"
    assert not differs


def test_a_solver_with_fewer_answers_in_the_baseline_is_named(compared):
    in_line, in_plane = answers_of("law", "pebble")
    section, differs, _ = compared((in_line[:-1], in_plane), (in_line, in_plane), "pebble")
    assert section.blocks[0] == "pebble: 1 answer not compared, only in this scoreboard"
    assert differs


@pytest.mark.parametrize("named", [[], ["law"]])
def test_solvers_of_the_baseline_that_were_not_asked_are_ignored(compared, named):
    section, differs, _ = compared(answers_of("law", "pebble"), answers_of("law"), *named)
    every = not named
    assert [bool(re.match("pebble: .* only in .*base", block)) for block in section.blocks[:-1]] == [
        True
    ] * every
    assert differs == every


def test_lost_answers_are_printed_first_and_all_changes_are_written(compared):
    before, (in_line, in_plane) = answers_of("law", "pebble"), answers_of("law", "pebble")
    in_line.loc[in_line.solver == "pebble", "v1"] += 0.5
    lost = in_line.index[-1]
    in_line.loc[lost, ["status", "v1", "v2"]] = ["crashed", np.nan, np.nan]
    section, differs, moved = compared(before, (in_line, in_plane))
    table, more = section.blocks
    assert len(table.rows) == 20
    assert table.rows[0][-3:] == ["ok", "crashed", "-"]
    assert len(moved) == len(CASES)
    assert moved.change.tolist() == pytest.approx([np.nan, *[0.5] * (len(CASES) - 1)], nan_ok=True)
    assert more.startswith(f"{len(CASES) - 20} more differ; ")
    assert more.endswith("moved.csv")
    assert differs


def test_answers_in_a_plane_are_compared(compared):
    before, (in_line, in_plane) = answers_of("law"), answers_of("law")
    in_plane.loc[3, "v1z"] += 0.25
    section, differs, moved = compared(before, (in_line, in_plane))
    assert section.title == "Compared with the baseline"
    assert (moved.case.item(), moved.e.item()) == [*PLANE_CASES][3]
    assert moved.change.item() == pytest.approx(0.25)
    assert differs


def test_a_baseline_without_answers_in_a_plane_is_said(compared):
    after = answers_of("law")
    section, differs, _ = compared(after[:1], after)
    assert section.blocks[0].endswith("base has no plane.parquet: answers in a plane were not compared")
    assert f"{len(CASES)} answers of 1 solvers" in section.blocks[1]
    assert not differs


def test_the_folder_of_the_baseline_is_not_overwritten(tmp_path, refused):
    folder = folder_with(tmp_path / "base", *answers_of("newton-restitution"))
    (tmp_path / "link").symlink_to(folder)
    for out in (folder, tmp_path / "." / "base" / ".." / "base", tmp_path / "link"):
        refused(
            ["scoreboard", "--out", out, "--baseline", folder], "--baseline", "folder of --out", "legal: "
        )
    assert {path.name for path in folder.iterdir()} == {ANSWERS, PLANE_ANSWERS}


def test_a_scoreboard_fails_where_every_solver_that_was_asked_for_is_unavailable(
    tmp_path, monkeypatch, command
):
    absent = [name for name in solver_names(on_request=True) if get_solver(name).unavailable()]
    if not absent:
        pytest.skip("every engine is installed")
    monkeypatch.setattr(playing, "CASES", dict(list(CASES.items())[:1]))
    monkeypatch.setattr(plane, "PLANE_CASES", dict(list(PLANE_CASES.items())[:1]))
    monkeypatch.setattr(playing, "exact_law_names", lambda: ("newton-restitution", "state-transition"))
    words = ["scoreboard", "--workers", "1", "--out", tmp_path / "out", "--solver", absent[0]]
    command(words, ends=1)
    assert command([*words, "--solver", "mujoco:default"])


def test_solvers_whose_answers_are_read_are_named(tmp_path, monkeypatch, command):
    laws = ("newton-restitution", "state-transition")
    monkeypatch.setattr(playing, "CASES", dict(list(CASES.items())[:1]))
    monkeypatch.setattr(plane, "PLANE_CASES", dict(list(PLANE_CASES.items())[:1]))
    monkeypatch.setattr(playing, "exact_law_names", lambda: laws)
    words = ["scoreboard", "--solver", "mujoco:default", "--workers", "1", "--out", tmp_path / "out"]
    assert "not asked again" not in command(words)
    (line,) = (line for line in command(words).splitlines() if "not asked again" in line)
    assert f"read from {tmp_path / 'out'}, not asked again: mujoco:default and 2 exact laws; " in line
    assert line.endswith("to ask again, remove this folder or choose another --out")
    for path in (tmp_path / "out" / "answers").glob("*mujoco*"):
        path.unlink()
    (line,) = (line for line in command(words).splitlines() if "not asked again" in line)
    assert "again: 2 exact laws; " in line
