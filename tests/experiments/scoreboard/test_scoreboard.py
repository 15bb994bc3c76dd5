"""The scoreboard: how engines get its cases, how answers are judged, and how a changed answer is found."""

import contextlib
import json
import os
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from markupsafe import escape

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.rigid.laws import follow_impacts
from impact_xval.experiments.scoreboard import cases, playing
from impact_xval.experiments.scoreboard.cases import CASE_SETUPS, CASES, MIRRORED, USUAL, arrange_scenes
from impact_xval.experiments.scoreboard.judging import find_nearest_laws, judge_answers, list_moved_answers
from impact_xval.experiments.scoreboard.page import (
    AS_PEOPLE_RUN_THEM,
    GRAINS,
    NO_LAW,
    RIGID,
    SPRINGS,
    board_table,
    describe_law,
    group_of,
    worst_case_table,
    write_scoreboard,
)
from impact_xval.experiments.sweep.pool import Slot
from impact_xval.experiments.tables.numbers import number
from tests.browser import opened

BASIC = ("pile, k2/k1 = 1", 1.0)


def answer(solver, case, v, arrangement=USUAL, status="ok", **other):
    row = {"solver": solver, "case": case[0], "e": case[1], "arrangement": arrangement, "status": status}
    row |= {"version": "1", "microseconds": 2.0, "reason": ""} | other
    return row | {f"v{i}": each for i, each in enumerate(v, 1)}


def of_laws(case, names=("newton-restitution", "sequential-top", "poisson-restitution")):
    return [answer(name, case, follow_impacts(CASES[case], name).v) for name in names]


def test_distances_energy_and_spread_are_those_of_their_definitions():
    # With m = (1, 2) and v0 = (-1, 0), Newton's law ends at (1, 0) and single impacts at (7/9, 4/9).
    rows = [
        *of_laws(BASIC),
        answer("engine", BASIC, (1.0, 0.1)),
        answer("engine", BASIC, (7 / 9, 4 / 9), "apart by 1e-6"),
        answer("engine", BASIC, (1.0, 0.2), "half the step"),
        answer("engine", BASIC, (np.nan, np.nan), "apart by 1e-4", status="timeout"),
    ]
    found = judge_answers(pd.DataFrame(rows)).set_index("solver").loc["engine"]
    assert found["D_newton-restitution"] == found.D_nearest == pytest.approx(np.sqrt(2 * 0.1**2), rel=1e-12)
    assert found.nearest == "newton-restitution, poisson-restitution"
    assert found.spread == pytest.approx(np.sqrt((2 / 9) ** 2 + 2 * (4 / 9 - 0.1) ** 2), rel=1e-12)
    assert (found.spread_of, found.energy_gained) == ("apart by 1e-6", pytest.approx(0.02, rel=1e-12))
    assert found.step_spread == pytest.approx(np.sqrt(2 * 0.1**2), rel=1e-12)
    assert np.isnan(found.momentum_error)
    # momentum is checked only for chains without a table
    found = judge_answers(pd.DataFrame([answer("engine", ("cradle 1 on 2", 0.5), (-0.1, -0.2, -0.6))])).iloc[
        0
    ]
    assert (found.momentum_error, found.energy_gained) == (pytest.approx(0.1, rel=1e-12), 0)


def test_of_placements_that_move_an_answer_alike_to_rounding_the_last_is_named():
    moved = {USUAL: 0.0, "apart by 1e-6": 0.3, "apart by 1e-4": np.nextafter(0.3, 0)}
    size = {case: len(chain.masses) for case, chain in CASES.items()}
    rows = [answer("engine", case, [v] * n, name) for name, v in moved.items() for case, n in size.items()]
    assert set(judge_answers(pd.DataFrame(rows)).spread_of) == {"apart by 1e-4"}


def test_the_law_of_an_engine_is_the_one_that_is_near_to_all_it_answers():
    every = [case for case in CASES if case[1] in (1.0, 0.5) and "apart" not in case[0]]
    rows = [row for case in every for row in of_laws(case)]
    rows += [answer("engine", case, follow_impacts(CASES[case], "sequential-top").v + 1e-4) for case in every]
    found = find_nearest_laws(judge_answers(pd.DataFrame(rows))).loc["engine"]
    assert (found.law, found.cases) == ("sequential-top", len(every))
    assert 1e-4 < found.farthest < 1e-3 < found.next_farthest


def test_of_laws_that_only_rounding_sets_apart_the_first_is_named():
    # Newton's and Poisson's laws agree here to rounding; the answer is nearer to Poisson's by one bit.
    case = ("cradle 1 on 2", 1.0)
    newton, poisson = (
        row | {"v1": v1} for row, v1 in zip(of_laws(case)[::2], (0.5, 0.5 + 2**-50), strict=True)
    )
    engine = answer("engine", case, (0.6, newton["v2"], newton["v3"]))
    found = find_nearest_laws(judge_answers(pd.DataFrame([poisson, newton, engine]))).loc["engine"]
    assert (found.law, found.next) == ("newton-restitution", "poisson-restitution")


def test_rigid_engines_end_elsewhere_where_bodies_do_not_quite_touch():
    pytest.importorskip("pymunk")
    found = {arrangement: v for arrangement, *_, v in cases.answer_case(None, "pymunk", *BASIC)}
    for name in (USUAL, "overlapping by 1e-6", "overlapping by 1e-4", "half the step", "twice the step"):
        # as if all contacts collided at once
        assert found[name] == pytest.approx((1.0, 0.0), abs=1e-12), name
    for name in ("apart by 1e-6", "apart by 1e-4"):
        # as by single impacts one after the other
        assert found[name] == pytest.approx((7 / 9, 4 / 9), abs=1e-12), name


def test_gaps_are_those_that_are_said_and_a_mirrored_line_is_numbered_as_the_others():
    engine, case = get_solver("mujoco"), ("cradle 2 on 3", 0.9)
    scenes = arrange_scenes(engine, CASES[case])
    # the power of two above four depths; a depth is at most sqrt(m/k) |v0|
    usual, radius = scenes[USUAL], 2.0**-11
    for name, gap in (("apart by 1e-4", 1e-4), ("overlapping by 1e-6", -1e-6)):
        change = np.diff(scenes[name].heights) - np.diff(usual.heights)
        assert change == pytest.approx([-gap * radius] * 4, rel=1e-9)
    assert np.ptp(np.subtract(scenes["moved by 0.37 radii"].heights, usual.heights)) == 0
    found = {arrangement: v for arrangement, *_, v in cases.answer_case(None, "mujoco", *case)}
    assert found[MIRRORED] == pytest.approx(found[USUAL], abs=1e-7)


def test_a_baseline_catches_an_answer_that_moved_and_an_engine_that_is_gone(
    tmp_path, command, refused, monkeypatch
):
    pytest.importorskip("pymunk")
    few = {case: chain for case, chain in CASES.items() if case[1] == 0.9 and "apart" not in case[0]}
    monkeypatch.setattr(playing, "CASES", few)
    board = ["scoreboard", "--solver", "pymunk", "--workers", "1", "--out"]
    command([*board, tmp_path / "before"])
    again = [*board, tmp_path / "same", "--baseline", tmp_path / "before"]
    assert "no answer differs" in command(again)
    # Change a kept answer, as another adapter of the same version would answer. The command continues from it.
    (kept,) = (tmp_path / "same" / "answers").glob("pymunk-*.json")
    first, *others = json.loads(kept.read_text())
    kept.write_text(json.dumps([first | {"v1": first["v1"] + 1e-5}, *others]))
    assert re.search(r"\b1 answers? differ from those in", command(again, ends=3))
    # an engine that the baseline has and this run does not
    answers = pd.read_parquet(tmp_path / "before" / "answers.parquet")
    more = [answers, answers[answers.solver == "pymunk"].assign(solver="dart")]
    (tmp_path / "more").mkdir()
    pd.concat(more).to_parquet(tmp_path / "more" / "answers.parquet")
    refused([*board, tmp_path / "more"])  # refused, because the folder holds something else
    monkeypatch.setattr(playing, "solver_names", lambda on_request: ["pymunk"])
    every = ["scoreboard", "--workers", "1", "--out", tmp_path / "before", "--baseline"]
    printed = command([*every, tmp_path / "more"], ends=3)
    assert re.search(r"^dart: \d+ answers not compared, only in ", printed, re.M)


def test_what_moved_is_a_status_an_answer_or_a_velocity():
    before = pd.DataFrame(of_laws(BASIC))
    assert list_moved_answers(before, before.copy(), 0.0).empty
    slower = before.assign(v1=before.v1 * (1 - 1e-6))
    assert len(list_moved_answers(before, slower, 1e-7)) == 3
    assert list_moved_answers(before, slower, 1e-5).empty
    assert len(list_moved_answers(before, before.assign(status="timeout"), 1.0)) == 3
    assert len(list_moved_answers(before, before.assign(v1=np.nan), 1.0)) == 3


def test_a_lost_answer_comes_before_all_changes_of_a_velocity():
    before = pd.DataFrame(of_laws(BASIC))
    after = before.assign(v1=before.v1 + np.array([0.5, 0.0, 0.7]), status=["ok", "crashed", "ok"])
    after.loc[after.status == "crashed", ["v1", "v2"]] = np.nan
    moved = list_moved_answers(before, after)
    assert moved.solver.tolist() == ["sequential-top", "poisson-restitution", "newton-restitution"]
    assert moved.change.tolist() == pytest.approx([np.nan, 0.7, 0.5], nan_ok=True)


def dies(_, name, case, e):
    if case.startswith("stack"):
        os._exit(7)
    return [(USUAL, "ok", "", (0.0, 0.0))]


@pytest.mark.nightly
def test_an_engine_that_dies_costs_the_answers_it_does_not_give(monkeypatch, tmp_path):
    monkeypatch.setattr(playing, "answer_case", dies)
    with contextlib.closing(Slot(None)) as slot:
        found = pd.DataFrame(playing._answer_all_cases(slot, "newton-restitution", tmp_path))
    said = {*zip(found.case == "stack of 3", found.status, found.reason, strict=True)}
    assert said == {(True, "crashed", "its process died: exit code 7"), (False, "ok", "")}


def page_in(folder):
    return re.sub(' class="[a-z]+"', "", (folder / "report.html").read_text())


def rows_of(table):
    return ["".join(f"<td>{escape(cell)}</td>" for cell in row) for row in table.rows]


def test_the_page_shows_the_numbers_of_the_board_and_text_stays_text(tmp_path):
    every = [case for case in CASES if case[0] == "cradle 1 on 4"]
    rows = [row for case in every for row in of_laws(case)]
    rows += [
        answer("dart", case, follow_impacts(CASES[case], "newton-restitution").v + 0.003) for case in every
    ]
    rows[-1] |= {"status": "timeout", "reason": "<script>alert(1)</script>", "v1": np.nan}
    said_of = write_scoreboard(pd.DataFrame(rows), tmp_path)
    page = page_in(tmp_path)
    assert "<script>alert" not in page
    judged = judge_answers(pd.DataFrame(rows))
    found = find_nearest_laws(judged)
    ((name, release, said, answered, *cells),) = board_table(judged, found).rows
    farthest = number(judged[judged.solver == "dart"]["D_newton-restitution"].max(), 2)
    newton = "by Newton's restitution, all contacts at once"
    assert (name, release, said) == ("DART", "1", newton)
    assert (
        describe_law(found.loc["dart"])
        == f"{newton}; poisson-restitution gives the same answers in these cases"
    )
    assert said_of[1].startswith(f"DART answers {newton}; poisson")
    assert cells == [farthest if case == "cradle 1 on 4" else "-" for case in CASE_SETUPS]
    assert (found.version["dart"], found.cases["dart"], answered) == ("1", 3, "3 of 4")
    assert said_of[0].header[2] == "cases answered"
    assert said_of[0].rows[0][2] == "3 of 4"
    for table in (board_table(judged, found), worst_case_table(found)):
        assert rows_of(table)[0] in page


def test_the_published_board_is_what_its_page_and_docs_say():
    folder = Path(__file__).parents[3] / "docs" / "scoreboard"
    judged = judge_answers(pd.read_parquet(folder / "answers.parquet"))
    found = find_nearest_laws(judged)
    text, page = (folder.parent / "scoreboard.md").read_text(), page_in(folder)
    shown = rows_of(board_table(judged, found))
    assert len(shown) == 34
    for row, (name, its) in zip(shown, found.iterrows(), strict=True):
        assert row in page
        says = describe_law(its) + f" (nearest: {its.law})" * (describe_law(its) == NO_LAW)
        (line,) = (line for line in text.splitlines() if line.startswith(f"| {says} |"))
        cell = f"`{name}`: {number(its.farthest, 2)}, {number(its.spread, 2)}, {its.cases} of {its.asked}"
        assert cell in line.removesuffix(" |").split(" | ")[1].split("; ")


@pytest.mark.slow
def test_the_field_of_the_page_leaves_the_rows_that_have_its_words():
    folder = Path(__file__).parents[3] / "docs" / "scoreboard"
    with opened((folder / "report.html").as_uri()) as page:
        shown = page.locator("#the-board tbody tr:visible")
        everything = shown.count()
        page.locator("#filter input").fill("DART, ships")
        assert shown.count() == 1
        assert shown.inner_text().startswith("DART (as it ships)")
        assert not page.locator("#grains-dem").is_visible()
        page.locator("#filter input").fill("")
        assert shown.count() == everything


def test_engines_stand_in_groups_by_what_their_contacts_are():
    groups = {
        SPRINGS: ("mujoco", "pybullet", "drake", "drake:lagged", "drake-hunt-crossley", "newton"),
        GRAINS: ("lammps", "lammps:limit-damping", "exudyn", "exudyn:impact-model-1"),
        RIGID: ("pymunk", "dart", "rapier", "sapien", "pybullet-restitution"),
        AS_PEOPLE_RUN_THEM: ("mujoco:default", "mujoco-naive", "pybullet:step-0.1", "dart:default"),
    }
    for group, names in groups.items():
        assert {group_of(name) for name in names} == {group}
