"""A solver that crashes or hangs costs its cells, and nothing else."""

import pyarrow.parquet as pq
import pytest

from impact_xval.experiments.config.experiment import parse_config
from impact_xval.experiments.sweep.run import run_sweep
from tests.experiments import faulty

_HEADER = "stiffness_ratio,mass_ratio,e1,e2"


def _config(tmp_path, n, fatal, **more):
    lines = [f"{10 ** (2 * i / n - 1)!r},1.5,{fatal.get(i, 0.9)!r},0.7" for i in range(n)]
    path = tmp_path / "cells.csv"
    path.write_text("\n".join([_HEADER, *lines]) + "\n")
    fields = {"solvers": ["mujoco"], "scenario": "impact", "cells": str(path), "cell_timeout": 3.0}
    return parse_config(fields | more)


def _rows(root):
    return pq.read_table(root / "cells.parquet").to_pylist()


@pytest.mark.slow
def test_every_kind_of_death_is_found_named_and_survived(tmp_path):
    fatal = {1: faulty.ABORT, 2: faulty.LEAVE}
    config = _config(tmp_path, 4, fatal, chunk_size=2)
    folder = run_sweep(config, tmp_path / "a", workers=2, resolve=faulty.faulty)
    rows = _rows(tmp_path / "a")
    assert len(rows) == 4 * 2
    failed = {(r["cell"], r["solver"]): (r["status"], r["reason"]) for r in rows if r["status"] != "ok"}
    assert failed == {
        (1, "mujoco"): ("crashed", "its process died: SIGABRT"),
        (2, "mujoco"): ("crashed", "its process died: exit code 3"),
    }
    assert folder.manifest()["sessions"][0]["processes_lost"] >= 2


def test_a_reference_that_dies_leaves_the_others_a_result_without_a_comparison(tmp_path):
    config = _config(tmp_path, 2, {1: faulty.SEGFAULT}, chunk_size=2, solvers=["kelvin-voigt"])
    run_sweep(config, tmp_path / "a", workers=1, resolve=faulty.faulty_model)
    rows = {(r["cell"], r["solver"]): r for r in _rows(tmp_path / "a")}
    assert rows[1, "state-transition"]["status"] == "crashed"
    assert rows[1, "kelvin-voigt"]["status"] == "ok"
    assert rows[1, "kelvin-voigt"]["v1"] is not None
    compared, lost = pq.read_table(tmp_path / "a/divergence.parquet").to_pylist()
    assert compared["velocity_divergence"] is not None
    assert (lost["velocity_divergence"], lost["model_status"]) == (None, "crashed")


def test_the_first_rows_wait_for_no_engine_and_its_first_call_has_no_limit(tmp_path):
    config = _config(tmp_path, 2, {}, solvers=["bistiffness", "mujoco"])
    seen = []
    run_sweep(
        config,
        tmp_path / "a",
        workers=1,
        resolve=faulty.slow_to_start,
        on_rows=lambda rows: seen.append(rows["solver"][0].as_py()),
    )
    assert [row["status"] for row in _rows(tmp_path / "a")] == ["ok"] * 6
    assert seen == ["bistiffness", "mujoco"]
