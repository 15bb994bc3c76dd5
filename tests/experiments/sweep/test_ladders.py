"""Ladders in sandboxes: a cell without one costs its own rows, and extreme cells neither hours nor silence."""

import shutil
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np
import pyarrow.parquet as pq
import pytest

from impact_xval.compliant_baselines.references.jumps import jumps
from impact_xval.compliant_baselines.references.kelvin_voigt import kelvin_voigt_batch
from impact_xval.experiments.config.configuration import parse_config
from impact_xval.experiments.measures import corners as corners_module
from impact_xval.experiments.measures import ladder_summary
from impact_xval.experiments.measures.corners import corners
from impact_xval.experiments.measures.ladder_table import COLLISION_LADDERS
from impact_xval.experiments.presentation.ladder_page import ladder_facts
from impact_xval.experiments.sweep import ladders
from impact_xval.experiments.sweep.executors import DirectExecutor
from impact_xval.experiments.sweep.ladders import write_ladder
from impact_xval.experiments.sweep.run import run_sweep
from impact_xval.experiments.sweep.sandbox import FaultError, SandboxError
from tests.experiments import fakes
from tests.experiments.conftest import SMALL


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return run_sweep(
        parse_config(SMALL), tmp_path_factory.mktemp("run") / "a", isolate=False, resolve=fakes.shifted
    )


@pytest.fixture
def root(run, tmp_path):
    shutil.copy(run.root / "cells.parquet", tmp_path)
    return tmp_path


class _Spoiled(DirectExecutor):
    """Fails wherever one of some cells is computed."""

    def __init__(self, fault, cells):
        super().__init__(None)
        self._fault, self._cells, self._call = fault, cells, self._sandbox.call
        self._sandbox.call = self._spoiled

    def _spoiled(self, function, kind, cells, *arguments, timeout):
        if self._cells & set(cells["cell"].to_pylist()):
            raise self._fault
        return self._call(function, kind, cells, *arguments, timeout=timeout)


@pytest.mark.parametrize(
    ("fault", "status", "reason"),
    [
        (SandboxError("Traceback:\n  ...\nValueError: a bug"), "crashed", "ValueError: a bug"),
        (FaultError("crashed", "its process died: SIGSEGV"), "crashed", "its process died: SIGSEGV"),
        (FaultError("timeout", "no answer within 1 s"), "timeout", "no answer within 1 s"),
    ],
)
def test_a_ladder_that_fails_costs_the_rows_of_its_cell(root, run, fault, status, reason):
    said = []
    write_ladder(root, _Spoiled(fault, {3, 7}), COLLISION_LADDERS, say=said.append)
    assert said == [f"cell {cell} has no ladder: {reason}" for cell in (3, 7)]
    table, whole = (pq.read_table(each / "ladder.parquet") for each in (root, run.root))
    assert table.schema.equals(whole.schema)
    lost = np.isin(table["cell"].to_numpy(), (3, 7))
    assert table.filter(~lost).equals(whole.filter(~lost))
    for row in table.filter(lost).to_pylist():
        assert (row["status"], row["reason"]) == (status, f"ladder: {reason}")
        assert row["velocity_divergence"] is row["sentence"] is row["free_asked_scenario_v1"] is None


def test_pieces_and_workers_make_no_difference(root, run, monkeypatch):
    monkeypatch.setattr(ladders, "CELLS", 5)

    class Threads(ThreadPoolExecutor):
        workers = 3

        def submit(self, function, /, *arguments) -> Future:
            return super().submit(function, here, *arguments)

    here = DirectExecutor(None)._sandbox
    with Threads(3) as executor:
        write_ladder(root, executor, COLLISION_LADDERS)
    for name in ("ladder.parquet", "ladder.csv"):
        assert (root / name).read_bytes() == (run.root / name).read_bytes()


EXTREME = [np.array([x, y]) for x, y in ((1e300, 2.0), (1.0, 1.0), (0.5, 0.5), (0.5, 0.5))]


def test_a_cell_without_a_result_is_followed_once(monkeypatch):
    asked = []

    def counted(*cells, **how):
        asked.append(cells[0].tolist())
        return kelvin_voigt_batch(*cells, **how, max_steps=100)

    excess, _, _ = jumps(counted, *EXTREME, np.array([0.1, 0.1]))
    assert np.isnan(excess).tolist() == [True, False]
    assert [len(ratios) for ratios in asked] == [2] + 20 * [1]
    asked.clear()
    monkeypatch.setattr(corners_module, "bistiffness_batch", counted)
    monkeypatch.setattr(corners_module, "LAWS", {"kelvin-voigt": counted})
    found = corners(np.zeros((2, 2)), EXTREME, np.array([0.1, 0.1]))
    assert found.reason.tolist() == ["bistiffness: timeout", ""]
    assert asked == [[1e300, 2.0], *[[0.0, 2.0]] * 6]


def test_what_if_is_left_out_where_it_would_take_too_long(run, monkeypatch):
    config = run.config()
    assert len(ladder_summary.summarise_ladder(run, config).alternatives)
    monkeypatch.setattr(ladder_summary, "_MOST_SEGMENTS", 100)
    found = ladder_summary.summarise_ladder(run, config)
    assert not len(found.alternatives)
    assert ladder_facts(found)["alternatives"] == []
