"""The scoreboard: its measures by their formulas, what becomes of engines that fail, and what counts as moved."""

import json
import math
import shutil

import numpy as np
import pandas as pd
import pytest

from impact_xval.experiments.commands.cli import main
from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.scoreboard import playing
from impact_xval.experiments.scoreboard.board import MEANINGS, VELOCITIES, answers_frame, board_of
from impact_xval.experiments.scoreboard.cases import BASIC, MOST_STEPS, USUAL, VARIATIONS, cases
from impact_xval.experiments.scoreboard.judging import ANSWERS, condition, moves, read_answers
from impact_xval.experiments.scoreboard.page import write_board
from impact_xval.experiments.scoreboard.playing import EXACT, LAWS, play
from tests.browser import opened, violations
from tests.experiments.scoreboard import work


@pytest.fixture(scope="module")
def laws(tmp_path_factory):
    """The exact laws' answers, kept: they are not given anew for every engine."""
    parts = tmp_path_factory.mktemp("laws")
    play([], parts, 1)
    (kept,) = parts.iterdir()
    return kept


@pytest.fixture
def played(tmp_path, laws):
    return lambda find, name="exact", parts="parts": _played(tmp_path / parts, laws, find, name)


def _played(parts, laws, find, name="exact"):
    if not parts.exists():
        parts.mkdir()
        shutil.copy(laws, parts)
    return play([name], parts, 2, find=find)


@pytest.fixture(scope="module")
def exact(tmp_path_factory, laws):
    return _played(tmp_path_factory.mktemp("exact") / "parts", laws, work.exact)


def row_of(board, case, e, solver="exact"):
    (row,) = board[(board.solver == solver) & (board.case == case) & (board.e == e)].to_dict("records")
    return row


def test_every_entrant_has_a_row_for_every_case(exact):
    board = board_of(exact)
    assert list(board.columns) == list(MEANINGS)
    assert len(board) == (len(LAWS) + 1) * 27
    assert board.divergence.notna().all()
    assert len(answers_frame(exact)) == 27 * (len(LAWS) + len(VARIATIONS))


def test_measures_are_their_formulas(exact):
    """The basic collision, 1 kg on 2 kg: Newton's law ends with (e, 0), the model with what docs/theory has."""
    board = board_of(exact)
    model = row_of(board, BASIC, 1.0, "state-transition")
    assert (model["v1"], model["v2"]) == pytest.approx((0.7161, 0.4935), abs=5e-5)
    row = row_of(board, BASIC, 1.0)
    assert (row["v1"], row["v2"]) == pytest.approx((1, 0), abs=3e-6)
    by_hand = math.sqrt((1 - model["v1"]) ** 2 + 2 * model["v2"] ** 2)
    assert row["divergence"] == pytest.approx(by_hand, abs=5e-6)
    assert row["law_divergence"] < 5e-6
    assert row["nearest"] == "newton, poisson"
    assert row["energy"] == pytest.approx(1, abs=5e-6)
    assert row["energy_error"] == pytest.approx(0, abs=5e-6)
    assert math.isnan(row["momentum_error"])  # the table takes some
    assert row_of(board, BASIC, 0.5)["energy"] == pytest.approx(0.25, abs=5e-6)
    assert row_of(board, BASIC, 0.5)["energy_error"] == pytest.approx(0, abs=5e-6)
    cradle = row_of(board, "cradle 1 on 4", 1.0)
    assert [cradle[v] for v in VELOCITIES] == pytest.approx([0.6, *[-0.4] * 4], abs=3e-6)
    assert abs(cradle["momentum_error"]) < 6e-6
    assert row["spread"] < 1e-5
    assert row["arrangements"] == len(VARIATIONS) - 1
    assert row["step"] == 1e-3


def test_more_restitution_than_asked_for_is_an_error_of_energy(played):
    board = board_of(played(work.planted))
    row = row_of(board, BASIC, 0.9)
    assert row["energy_error"] == pytest.approx(0.909**2 - 0.9**2, abs=5e-6)
    assert row["law_divergence"] == pytest.approx(0.009, abs=5e-6)


def test_the_spread_is_the_largest_change_and_says_by_what(played):
    board = board_of(played(work.gapped))
    row = row_of(board, BASIC, 0.5)
    assert row["spread"] == pytest.approx(0.5, abs=1e-5)
    assert row["spread_by"] == "apart by 1e-6"
    assert row["step_spread"] < 1e-5
    table = row_of(board, "ball on table", 0.5)
    assert table["spread"] == pytest.approx(0.5, abs=1e-5)


def test_what_fails_costs_its_answers_and_no_others(played, monkeypatch):
    monkeypatch.setattr(playing, "cases", lambda: iter(list(cases())[:1]))
    frame = answers_frame(played(work.dying)).query("solver == 'exact'")
    assert (frame.query("arrangement == 'one metre higher'").status == "crashed").all()
    assert frame.query("arrangement == 'one metre higher'").reason.str.contains("exit code 7").all()
    assert (frame.query("arrangement != 'one metre higher'").status == "ok").all()


@pytest.mark.slow
def test_what_hangs_is_ended(monkeypatch, played):
    monkeypatch.setattr(playing, "LONGEST", 0.5)
    monkeypatch.setattr(playing, "cases", lambda: iter(list(cases())[-1:]))
    parts = played(work.hanging)
    statuses = {answer.arrangement: answer.status for answer in parts[1].answers}
    assert statuses.pop("twice the step") == "timeout"
    assert set(statuses.values()) == {"ok"}


@pytest.mark.parametrize(
    ("find", "status", "reason"),
    [
        (work.missing, "unavailable", "exact is not installed"),
        (work.unloadable, "crashed", "it cannot be loaded: its process died: exit code 9"),
        (work.refusing, "unrepresentable", "no <i>way</i> | at all"),
    ],
)
def test_an_engine_without_any_answer_is_a_row_with_the_reason(tmp_path, find, status, reason, played):
    parts = played(find)
    rows = board_of(parts).query("solver == 'exact'")
    assert set(rows.status) == {status}
    assert set(rows.reason) == {reason}
    assert rows.divergence.isna().all()
    board, facts = write_board(tmp_path, parts, 1.0)
    page = (tmp_path / "scoreboard.html").read_text("utf-8")
    assert "<i>way</i>" not in page
    assert len(board) == 27 * (len(LAWS) + 1)
    assert bool(facts["missing"]) == (status != "unrepresentable")


def test_an_engine_that_dies_as_it_is_loaded_has_moved(exact, played):
    now = answers_frame(played(work.unloadable, parts="other"))
    found = moves(answers_frame(exact), now, 1e-4)
    assert set(found.rows["status now"]) == {"crashed"}
    assert len(found.rows) == 27 * len(VARIATIONS)
    assert not found.missing
    assert len(condition("no answer")(board_of(played(work.unloadable, parts="other")))) == 27


def test_what_was_answered_is_kept_and_damage_is_not(tmp_path, played):
    before = answers_frame(played(work.exact))
    again = answers_frame(played(work.exact))
    pd.testing.assert_frame_equal(before, again, check_exact=True)  # its noise is another one in every run
    path = tmp_path / "parts" / "exact.json"
    kept = path.read_text()
    part = json.loads(kept)
    fewer, wrong = json.loads(kept), json.loads(kept)
    del fewer["part"]["answers"][5]
    wrong["part"]["answers"][5]["velocities"] = ["fast"]
    for damage in (kept[:-100], '{"identity": 3}', "[]", json.dumps(fewer), json.dumps(wrong)):
        path.write_text(damage)
        assert not answers_frame(played(work.exact)).equals(before)
        assert json.loads(path.read_text())["identity"] == part["identity"]


def test_a_regression_of_one_per_cent_is_found_and_noise_is_not(exact, played):
    before = answers_frame(exact)
    noise = moves(before, answers_frame(played(work.exact, parts="same")), 1e-4)
    assert (len(noise.rows), noise.compared) == (0, len(before))
    found = moves(before, answers_frame(played(work.planted)), 1e-4)
    assert set(found.rows.solver) == {"exact"}
    assert set(found.rows.e) == {0.9, 0.5}  # more than 1 is not possible
    assert found.rows.change.max() == pytest.approx(0.009, rel=0.4)


@pytest.mark.slow
def test_a_regression_of_an_adapter_is_found(played):
    pytest.importorskip("pymunk")
    boards = []
    for at, find in enumerate((work.chipmunk, work.chipmunk, work.planted_chipmunk)):
        boards.append(answers_frame(played(find, "pymunk", str(at))))
    assert len(moves(boards[0], boards[1], 0.0).rows) == 0
    assert set(moves(boards[0], boards[2], 1e-4).rows.solver) == {"pymunk"}


def test_what_one_board_alone_has_is_not_compared_and_said(exact, played):
    before = answers_frame(exact)
    now = answers_frame(played(work.missing))
    found = moves(before, now, 1e-4)
    assert (found.missing, found.alone, len(found.rows)) == (["exact"], [], 0)
    assert moves(before, before[before.solver != "newton"], 0.0).alone == ["newton"]
    fewer = before.drop(index=before.index[-1])  # an answer that went away has moved
    assert len(moves(before, fewer, 1e-4).rows) == 1


def test_another_status_has_moved(exact):
    before, now = answers_frame(exact), answers_frame(exact)
    last = now.index[-1]
    now.loc[last, ["status", "reason", *VELOCITIES]] = ["crashed", "why", *[np.nan] * len(VELOCITIES)]
    (row,) = moves(before, now, 1e-4).rows.to_dict("records")
    assert (row["status before"], row["status now"], row["change"]) == ("ok", "crashed", math.inf)


def test_conditions(exact, played):
    board = board_of(exact)
    assert len(condition("energy > 1.01")(board)) == 0
    assert (
        len(condition("divergence>0.01")(board)) == (board[board.engine != EXACT].divergence > 0.01).sum() > 5
    )
    assert set(condition(" no answer ")(board_of(played(work.refusing))).status) == {"unrepresentable"}
    for wrong in ("energy", "energy > x", "energy > nan", "colour > 1", "energy >= 1", ""):
        with pytest.raises(UserError, match=r"--fail-if = .*; legal: 'no answer', or divergence, "):
            condition(wrong)


def test_the_cases_are_what_they_are_called():
    found = {(case.name, case.e): case.column for case in cases()}
    assert len(found) == 27
    assert found[BASIC, 0.9].masses == (1.0, 2.0)
    assert found["drop, k2/k1 = 100", 1.0].stiffnesses == (1e4, 1e6)
    assert found["cradle 2 on 3", 0.5].velocities == (-1.0, -1.0, 0.0, 0.0, 0.0)
    assert not found["cradle 1 on 4", 1.0].table
    assert found["stack of 3", 1.0].table


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    root = tmp_path_factory.mktemp("run") / "board"
    assert main(["scoreboard", "--setting", "mujoco-calibrated-0.1", "--out", str(root)]) == 0
    return root


def test_the_command_writes_a_folder_that_can_be_a_baseline(run, tmp_path, capsys):
    described = json.loads((run / "scoreboard.json").read_text())
    assert described["columns"] == MEANINGS
    assert list(pd.read_csv(run / "board.csv").columns) == list(MEANINGS)
    words = ["scoreboard", "--setting", "mujoco-calibrated-0.1", "--baseline", str(run), "--out"]
    assert main([*words, str(tmp_path / "b")]) == 0
    assert "Nothing moved" in capsys.readouterr().out
    other = tmp_path / "other"
    other.mkdir()
    answers = read_answers(run)
    answers.loc[answers.solver == "mujoco-calibrated-0.1", VELOCITIES] *= 1.01
    answers.to_parquet(other / ANSWERS)
    words[4] = str(other)
    assert main([*words, str(tmp_path / "b"), "--resume"]) == 3
    said = capsys.readouterr().out
    assert "answers moved" in said
    assert "mujoco-calibrated-0.1" in said
    resumed = ["scoreboard", "--setting", "mujoco-calibrated-0.1", "--resume", "--out", str(tmp_path / "b")]
    assert main([*resumed, "--fail-if", "energy > 1.01", "--fail-if", "divergence > 9"]) == 4
    assert "energy > 1.01 holds of" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--setting", "havok"], "--setting: practice 'havok' is unknown; known: "),
        (["--tolerance", "-1"], "--tolerance = '-1'; legal: a finite number >= 0"),
        (["--tolerance", "x"], "--tolerance = 'x'; legal: a number"),
        (["--fail-if", "speed > 1"], "--fail-if = 'speed > 1'; legal: "),
        (["--baseline", "nowhere"], "--baseline nowhere: has no answers.parquet; legal: "),
        (["--out", "full"], "--out full: not empty (mine.txt); legal: "),
        (["--workers", "0"], "--workers = '0'; legal: "),
    ],
)
def test_bad_input_is_one_line_and_nothing_is_written(tmp_path, monkeypatch, capsys, words, said):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.txt").write_text("mine")
    assert main(["scoreboard", *words]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["full", "mine.txt"]


@pytest.mark.parametrize("damage", [b"", b"PAR1 nothing", None])
def test_a_damaged_baseline_is_refused(run, tmp_path, capsys, damage):
    if damage is None:
        pd.DataFrame({"solver": ["x"]}).to_parquet(tmp_path / ANSWERS)
    else:
        (tmp_path / ANSWERS).write_bytes(damage)
    assert main(["scoreboard", "--baseline", str(tmp_path), "--out", str(tmp_path / "b")]) == 2
    assert "cannot be read" in capsys.readouterr().err


def test_an_answer_twice_is_refused(run, tmp_path):
    answers = read_answers(run)
    pd.concat([answers, answers.tail(1)]).to_parquet(tmp_path / ANSWERS)
    with pytest.raises(UserError, match="has an answer twice"):
        read_answers(tmp_path)


def test_the_longest_case_has_time(run):
    answers = pd.read_parquet(run / ANSWERS)
    assert (answers[answers.solver == "mujoco-calibrated-0.1"].steps < MOST_STEPS / 2).all()
    assert set(answers.arrangement) == set(VARIATIONS)
    assert USUAL in VARIATIONS


@pytest.mark.slow
@pytest.mark.parametrize(("width", "scheme"), [(1200, "light"), (390, "dark")])
def test_the_page_in_a_browser(exact, tmp_path, width, scheme):
    write_board(tmp_path, exact, 1.0)
    with opened(f"file://{tmp_path}/scoreboard.html", width, scheme) as page:
        page.wait_for_selector("html[data-ready]", state="attached")
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        assert violations(page) == []
        assert "<script>alert(1)</script>" in page.inner_text("body")  # of the version: text
