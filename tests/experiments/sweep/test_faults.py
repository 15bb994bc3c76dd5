"""A solver that crashes, hangs or gives nonsense costs only its own cells."""

import contextlib
import pickle

import psutil
import pyarrow.parquet as pq
import pytest

from impact_xval.compliant_baselines.engines.scanner import scan
from impact_xval.experiments.config.cells import experiment_cells
from impact_xval.experiments.config.experiment import parse_config
from impact_xval.experiments.measures.hausdorff import distances
from impact_xval.experiments.measures.summary import summarise
from impact_xval.experiments.sweep.chunk import warm
from impact_xval.experiments.sweep.process import Worker
from impact_xval.experiments.sweep.rows import Experiment, solve_all
from impact_xval.experiments.sweep.run import run_sweep
from impact_xval.model.chain.kernel import follow_chains
from impact_xval.model.pair.kernel import collide_all
from tests.compliant_baselines.third_party import install
from tests.experiments import fakes
from tests.experiments.conftest import tables_of

#: Expected status and reason of a cell by its e1, with a limit of 3 s per cell.
SAID = {
    fakes.SEGFAULT: ("crashed", "its process died: SIGSEGV"),
    fakes.HANG: ("timeout", "no answer within 3 s; its process was ended"),
    fakes.LEAVE: ("crashed", "its process died: exit code 3"),
    fakes.RAISE: ("crashed", "ZeroDivisionError: a bug"),
    fakes.SHORT: ("crashed", "RuntimeError: 0 outcomes for 1 collisions"),
}


def _config(tmp_path, e1, **more):
    lines = [f"{10 ** (2 * i / len(e1) - 1)!r},1.5,{each!r},0.7" for i, each in enumerate(e1)]
    path = tmp_path / "cells.csv"
    path.write_text("\n".join(["stiffness_ratio,mass_ratio,e1,e2", *lines]) + "\n")
    fields = {"solvers": ["mujoco"], "scenario": "impact", "cells": str(path), "cell_timeout": 3.0}
    return parse_config(fields | more)


def _rows(root):
    rows = pq.read_table(root / "cells.parquet").to_pylist()
    return {(row["cell"], row["solver"]): row for row in rows}


def _failed(rows):
    return {key: (row["status"], row["reason"]) for key, row in rows.items() if row["status"] != "ok"}


@pytest.mark.nightly
def test_every_failure_of_a_plug_in_is_found_named_and_costs_its_cell(tmp_path, monkeypatch):
    """Each failure of two broken plug-ins is a row of the table with a reason; an exact solver still has all its rows.

    One plug-in fails in four cells (collisions) of the run, each time in a different way. The other plug-in cannot be
    imported. The exact solver runs in a separate process.
    """
    text = "from tests.experiments.fakes import Faulty\nclass Bad(Faulty):\n    name, law = 'bad', None\n"
    install(tmp_path / "site", "bad-dist", {"bad": "bad_solver:Bad"}, bad_solver=text)
    install(tmp_path / "site", "lost-dist", {"lost": "no_such_module:Solver"})
    monkeypatch.syspath_prepend(str(tmp_path / "site"))
    e1 = [fakes.SEGFAULT, fakes.RAISE, fakes.SHORT, *[0.9] * 9, fakes.HANG]
    config = _config(tmp_path, e1, solvers=["bad", "lost", "kelvin-voigt"], chunk_size=2)
    folder = run_sweep(config, tmp_path / "a", workers=2).folder
    failed = _failed(_rows(tmp_path / "a"))
    lost = {failed.pop((cell, "lost")) for cell in range(13)}
    assert failed == {(cell, "bad"): SAID[each] for cell, each in enumerate(e1) if each != 0.9}
    assert {status for status, _ in lost} == {"unavailable"}
    assert "no_such_module" in lost.pop()[1]
    # The cell that crashes is found by halving and tried once more. The cell that hangs is not tried again.
    assert folder.manifest()["sessions"][0]["processes_lost"] == 4
    monkeypatch.undo()  # the tables must be readable where neither plug-in is installed
    assert summarise(folder).solvers == ["kelvin-voigt", "bad", "lost"]


def test_a_reference_that_dies_leaves_the_others_a_result_without_a_comparison(tmp_path):
    config = _config(tmp_path, [0.9, fakes.LEAVE], solvers=["kelvin-voigt"])
    run_sweep(config, tmp_path / "a", workers=1, resolve=fakes.faulty_model)
    rows = _rows(tmp_path / "a")
    assert _failed(rows) == {(1, "state-transition"): SAID[fakes.LEAVE]}
    assert rows[1, "kelvin-voigt"]["v1"] is not None
    compared, lost = pq.read_table(tmp_path / "a/divergence.parquet").to_pylist()
    assert compared["velocity_divergence"] is not None
    assert (lost["velocity_divergence"], lost["model_status"]) == (None, "crashed")


@pytest.mark.nightly
def test_processes_that_are_killed_cost_nothing_but_time(tmp_path):
    config = _config(tmp_path, [0.9] * 6, chunk_size=1)
    killed = []

    def kill(done, total, line):
        if done and not killed:  # if the process died twice for the same single cell, the cell would be lost
            killed.extend(psutil.Process().children())
            for child in killed:
                child.kill()

    # Each new process is made ready first. Otherwise its five seconds would exceed the time limit of a cell.
    run_sweep(config, tmp_path / "a", workers=2, resolve=fakes.slow_to_start, progress=kill)
    assert killed
    whole = run_sweep(config, tmp_path / "b", isolate=False, resolve=fakes.shifted).folder
    assert tables_of(tmp_path / "a") == tables_of(whole.root)


def test_what_a_solver_needs_at_its_first_call_has_no_limit(tmp_path):
    """The first answer of a solver may take any time, and no kernel is compiled after the warm-up.

    Numba compiles a kernel for every kind of array anew. The signatures of the kernels are compared before and after
    cells.
    """
    config = _config(tmp_path, [0.9] * 12, solvers=["kelvin-voigt", "mujoco"])
    run_sweep(config, tmp_path / "a", workers=1, resolve=fakes.slow_to_start)
    assert _failed(_rows(tmp_path / "a")) == {}
    with contextlib.closing(Worker(Experiment(config))) as worker:
        before, after = worker.call(_compiled, timeout=600)
    assert before == after


def _compiled(experiment):
    """Return the signatures of compiled kernels after the warm-up, and after solving blocks of several kinds.

    This function runs in a process of its own.
    """
    kernels, names = (collide_all, follow_chains, distances, scan), experiment.config.solvers
    for name in names:
        warm(None, experiment.resolve, name, "pair")
    before = [kernel.signatures for kernel in kernels]
    block = experiment_cells(experiment.config).block(range(12))
    for some in (block, block[:3], block[1:2], block[::2], pickle.loads(pickle.dumps(block))):
        solve_all(experiment, some)
    return before, [kernel.signatures for kernel in kernels]
