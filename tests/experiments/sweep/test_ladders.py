"""Ladders in sandboxes: a cell without one costs its own rows."""

import shutil

import numpy as np
import pyarrow.parquet as pq
import pytest

from impact_xval.experiments.measures.ladder_table import COLLISION_LADDERS
from impact_xval.experiments.sweep.executors import DirectExecutor
from impact_xval.experiments.sweep.ladders import write_ladder
from impact_xval.experiments.sweep.sandbox import FaultError, SandboxError


@pytest.fixture
def root(fake_run, tmp_path):
    shutil.copy(fake_run.root / "cells.parquet", tmp_path)
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


def test_a_ladder_that_fails_costs_the_rows_of_its_cell(root, fake_run):
    for fault, status, reason in (
        (SandboxError("Traceback:\n  ...\nValueError: a bug"), "crashed", "ValueError: a bug"),
        (FaultError("crashed", "its process died: SIGSEGV"), "crashed", "its process died: SIGSEGV"),
        (FaultError("timeout", "no answer within 1 s"), "timeout", "no answer within 1 s"),
    ):
        said = []
        write_ladder(root, _Spoiled(fault, {3, 7}), COLLISION_LADDERS, say=said.append)
        assert said == [f"cell {cell} has no ladder: {reason}" for cell in (3, 7)]
        table, whole = (pq.read_table(each / "ladder.parquet") for each in (root, fake_run.root))
        assert table.schema.equals(whole.schema)
        lost = np.isin(table["cell"].to_numpy(), (3, 7))
        assert table.filter(~lost).equals(whole.filter(~lost))
        for row in table.filter(lost).to_pylist():
            assert (row["status"], row["reason"]) == (status, f"ladder: {reason}")
            assert row["velocity_divergence"] is row["sentence"] is row["free_asked_scenario_v1"] is None
