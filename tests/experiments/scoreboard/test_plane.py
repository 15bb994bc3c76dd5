"""The scoreboard for collisions in a plane: its cases, the judgement of the answers, and the table of its page."""

import math

import numpy as np
import pandas as pd
import pytest

from impact_xval.compliant_baselines.registry import exact_law_names
from impact_xval.experiments.scoreboard import plane
from impact_xval.experiments.scoreboard.cases import RESTITUTIONS
from impact_xval.experiments.scoreboard.plane import (
    PLANE_ANSWERS,
    PLANE_COLUMNS,
    VELOCITIES,
    collect_plane_answers,
    judge_plane_answers,
    list_plane_entrants,
    plane_table,
    write_plane,
)
from impact_xval.experiments.scoreboard.plane_cases import PLANE_CASES, PLANE_SETUPS, answer_plane_case

LAWS = ("state-transition", "newton-restitution", "sequential-top")


@pytest.fixture(scope="module")
def of_laws():
    """The answers of three exact laws to every case."""
    return [row for law in LAWS for row in rows_of(law)]


def rows_of(law, name=None, shift=0.0):
    """Return the answers of a law as those of a solver, with ball 1 faster along x."""
    rows = []
    for case, e in PLANE_CASES:
        status, reason, velocities = answer_plane_case(None, law, case, e)
        row = dict(solver=name or law, version="1", case=case, e=e, status=status, reason=reason)
        rows.append(row | dict(zip(VELOCITIES, velocities, strict=False)))
        rows[-1]["v1x"] += shift
    return rows


def table_of(rows):
    return pd.DataFrame(rows, columns=PLANE_COLUMNS)


def test_cases_are_the_named_graphs_at_one_speed_and_stiffness():
    assert len(PLANE_CASES) == len(PLANE_SETUPS) * len(RESTITUTIONS)
    for (case, e), (collision, mirror) in PLANE_CASES.items():
        assert {contact.stiffness for contact in collision.contacts} == {1e8}
        assert {contact.restitution for contact in collision.contacts} == {e}
        assert (mirror is None) == case.startswith("corner")
        assert 2 * len(collision.masses) <= len(VELOCITIES)


def test_exact_laws_and_engines_that_know_planes_take_part():
    assert list_plane_entrants(["newton-restitution", "mujoco", "lammps"]) == ["newton-restitution", "mujoco"]


def test_distances_and_asymmetries_are_those_of_their_definitions(of_laws):
    judged = judge_plane_answers(table_of([*of_laws, *rows_of("newton-restitution", "pymunk", 0.01)]))
    own = judged[judged.solver == "pymunk"].set_index(["case", "e"])
    assert np.allclose(
        own["D_newton-restitution"].drop(index=[(c, e) for c, e in PLANE_CASES if "corner" in c]), 0.01
    )
    # In a corner the ball comes with (-1, -0.3) m/s.
    assert math.isclose(
        own.loc[("corner, 60 degrees", 0.5), "D_newton-restitution"], 0.01 / math.hypot(1, 0.3)
    )
    assert own["D_poisson-restitution"].isna().all()  # Poisson's law gave no answers here
    symmetric = own.asymmetry.dropna()
    assert len(symmetric) == 4 * len(RESTITUTIONS)
    assert np.allclose(
        symmetric[[name.startswith(("bernoulli", "bridge")) for name, _ in symmetric.index]], 0.02
    )
    assert np.allclose(symmetric[[name.startswith("rack") for name, _ in symmetric.index]], 0, atol=1e-12)
    single = judged[judged.solver == "sequential-top"].asymmetry
    assert single.max() > 0.3


def test_the_table_names_the_nearest_law_and_the_largest_distance_by_case(of_laws):
    rows = [*of_laws, *rows_of("newton-restitution", "pymunk", 0.01)]
    rows += [row | {"solver": "mujoco", "v1x": row["v1x"] + 0.2} for row in rows_of("sequential-top")]
    silent = dict(solver="dart", version="1", status="crashed", reason="gone")
    rows += [silent | {"case": case, "e": e} for case, e in PLANE_CASES]
    table = plane_table(judge_plane_answers(table_of(rows)))
    assert table.header[3:-2] == (*PLANE_SETUPS,)
    by_engine = {row[0].partition(" ")[0]: row for row in table.rows}
    assert by_engine["Pymunk"][2:4] == ("newton-restitution", "0.01")
    assert by_engine["Pymunk"][-2:] == ("0.02", "28 of 28")
    assert by_engine["MuJoCo"][2].startswith("no exact law (nearest: ")
    assert by_engine["DART"][2] == "no answer"
    assert by_engine["DART"][-1] == "0 of 28"
    assert not {name for name in by_engine if name in exact_law_names()}


def test_answers_are_kept_and_written_to_a_file_of_their_own(tmp_path, monkeypatch):
    few = dict(list(PLANE_CASES.items())[:2])
    monkeypatch.setattr(plane, "PLANE_CASES", few)
    told = []
    answers = collect_plane_answers(["newton-restitution"], tmp_path / "board", 1, lambda *x: told.append(x))
    assert list(answers.columns) == PLANE_COLUMNS
    assert (answers.status == "ok").all()
    assert told[-1][:2] == (2, 2)
    (kept,) = (tmp_path / "board" / "answers").iterdir()
    kept.write_text(kept.read_text().replace('"ok"', '"kept"'))
    again = collect_plane_answers(["newton-restitution"], tmp_path / "board", 1, lambda *x: None)
    assert (again.status == "kept").all()
    section = write_plane(answers, tmp_path / "board")
    assert section.title == "In a plane"
    pd.testing.assert_frame_equal(pd.read_parquet(tmp_path / "board" / PLANE_ANSWERS), answers)
    assert not (tmp_path / "board" / "answers.parquet").exists()
