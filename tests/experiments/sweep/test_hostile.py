"""Solvers of every hostile kind in one sweep: each costs its own cell, and the row says what was wrong."""

import pyarrow.parquet as pq
import pytest

from impact_xval.experiments.config.configuration import parse_config
from impact_xval.experiments.sweep.run import run_sweep
from tests.experiments import hostile

pytestmark = pytest.mark.slow

_SOLVERS = ["mujoco", "pybullet", "drake", "kelvin-voigt"]
_CELLS = [0.9, *hostile.E1.values(), 0.8]


def _rows(root):
    """Rows of the table of cells by cell and solver."""
    rows = pq.read_table(root / "cells.parquet").to_pylist()
    return {(row["cell"], row["solver"]): row for row in rows}


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    root = tmp_path_factory.mktemp("hostile")
    cells = "\n".join(["stiffness_ratio,mass_ratio,e1,e2", *(f"1.5,1.5,{e1!r},0.7" for e1 in _CELLS)])
    (root / "cells.csv").write_text(cells + "\n")
    config = parse_config(
        {
            "solvers": _SOLVERS,
            "scenario": "impact",
            "stiffness_ratio_cutoff": float("inf"),
            "cells": str(root / "cells.csv"),
            "cell_timeout": 10.0,
            "chunk_size": 16,
        }
    )
    folder = run_sweep(config, root / "hostile", workers=1, resolve=hostile.hostile)
    run_sweep(config, root / "harmless", isolate=False, resolve=hostile.harmless)
    return folder, _rows(root / "hostile"), _rows(root / "harmless")


def test_the_run_is_complete_with_every_row(runs):
    folder, rows, harmless = runs
    assert folder.manifest()["state"] == "complete"
    assert set(rows) == set(harmless)
    assert len(rows) == len(_CELLS) * (1 + len(_SOLVERS))


def test_the_rows_of_every_other_solver_are_what_they_are_without_it(runs):
    _, rows, harmless = runs
    others = [key for key in rows if key[1] != "mujoco"]
    assert {key: rows[key] for key in others} == {key: harmless[key] for key in others}
    assert rows[0, "mujoco"] == harmless[0, "mujoco"]
    assert {row["status"] for key, row in rows.items() if key[1] == "kelvin-voigt"} == {"ok", "limit"}


@pytest.mark.parametrize("kind", hostile.KINDS)
def test_its_own_row_says_what_was_wrong(runs, kind):
    _, rows, harmless = runs
    key = _CELLS.index(hostile.E1[kind]), "mujoco"
    _, status, says = hostile.KINDS[kind]
    if status == "ok":
        same = ("status", "reason", "v1", "states", "impulse2")
        assert [rows[key][name] for name in same] == [harmless[key][name] for name in same]
    else:
        assert rows[key]["status"] == status
        assert says in rows[key]["reason"]
        assert rows[key]["reason"].isprintable()
        assert len(rows[key]["reason"]) <= 1000


def test_a_solver_that_cannot_say_whether_it_can_run_is_unavailable(runs):
    folder, rows, _ = runs
    said = {rows[0, name]["reason"] for name in ("pybullet", "drake")}
    assert said == {
        r"asked whether it is available, 'pybullet' failed: OSError: no licence\x1b[2J",
        "unavailable() gave int; legal: text or None",
    }
    assert {rows[0, name]["status"] for name in ("pybullet", "drake")} == {"unavailable"}
    assert (
        folder.manifest()["versions"]["drake"] == "unavailable: unavailable() gave int; legal: text or None"
    )
