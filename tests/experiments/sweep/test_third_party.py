"""Solvers of other distributions that harm their process, in real runs: each costs its own cells, and nothing else."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest

from tests.experiments import hostile_plugins as plugins

ROOT = Path(__file__).parents[3]
_OURS = ["state-transition", "kelvin-voigt", "mujoco"]
_CELLS = [0.9, 0.7, plugins.STRUCK]


def _command(site, *arguments):
    return subprocess.run(
        [sys.executable, "-m", "impact_xval", *map(str, arguments)],
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(site), str(ROOT)])},
        capture_output=True,
        check=False,
        timeout=900,
    )


def _run(folder, kinds, cell_timeout, *options):
    """Run an experiment with solvers of some kinds; its folder, and what the command said."""
    plugins.lay_down(folder / "site", kinds)
    (folder / "c.toml").write_text(
        f"scenario = 'impact'\nsolvers = {[*_OURS[1:], *kinds, plugins.GOOD]}\nchunk_size = 2\n"
        f"step_fraction = 0.01\ncell_timeout = {cell_timeout}\n[grid]\nstiffness_ratio = [1.5]\n"
        f"mass_ratio = [1.5]\ne1 = {_CELLS}\ne2 = [0.7]\n"
    )
    done = _command(folder / "site", "run", folder / "c.toml", "--out", folder / "run", *options)
    return folder / "run", done


def _bytes_of(root, *names):
    """Rows of some solvers, as bytes."""
    table = pq.read_table(root / "cells.parquet")
    rows = table.filter(pc.field("solver").isin(names)).combine_chunks()
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, rows.schema) as stream:
        stream.write_table(rows)
    assert len(rows) == len(_CELLS) * len(names)
    return sink.getvalue().to_pybytes()


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    root, done = _run(tmp_path_factory.mktemp("alone"), {}, 60)
    assert done.returncode == 0, done.stderr.decode()
    return root


def _contained(folder, kinds, cell_timeout, alone, *options):
    root, done = _run(folder, kinds, cell_timeout, *options)
    assert done.returncode == 0, done.stderr.decode()
    said = (done.stdout + done.stderr).decode()
    assert [letter for letter in set(said) if not (letter.isprintable() or letter in "\n\t")] == []
    assert len(said) < 500_000
    assert json.loads((root / "manifest.json").read_text())["state"] == "complete"
    assert _bytes_of(root, *_OURS, plugins.GOOD) == _bytes_of(alone, *_OURS, plugins.GOOD)
    for row in pq.read_table(root / "cells.parquet").to_pylist():
        if row["solver"] in kinds:
            _is_as_expected(row, kinds[row["solver"]])
    _none_left(folder / "site")


def _is_as_expected(row, kind):
    found = row["solver"], row["status"], row["reason"]
    if kind.place == "solving" and row["e1"] != plugins.STRUCK:
        assert row["status"] in ("ok", "limit"), found
        return
    assert row["status"] in kind.statuses, found
    assert row["status"] in ("ok", "limit") or kind.says in row["reason"], found


def _none_left(site):
    until = time.monotonic() + 10
    while left := [
        p for p in psutil.process_iter(["cmdline"]) if str(site) in " ".join(p.info["cmdline"] or ())
    ]:
        assert time.monotonic() < until, left
        time.sleep(0.1)


@pytest.mark.slow
def test_one_that_cannot_be_asked_what_it_is_is_unavailable(tmp_path, alone):
    _contained(tmp_path, plugins.SPEECHLESS, 6, alone, "--workers", "1")


@pytest.mark.slow
def test_one_that_changes_its_interpreter_changes_no_other_row(tmp_path, alone):
    _contained(tmp_path, plugins.CHANGING, 30, alone, "--workers", "2")


@pytest.mark.slow
def test_one_that_leaves_something_behind_costs_its_cells(tmp_path, alone):
    _contained(tmp_path, plugins.LEAVING, 10, alone, "--workers", "1")


@pytest.mark.slow
def test_one_that_kills_its_caller_costs_its_cell(tmp_path, alone):
    _contained(tmp_path, plugins.KILLING, 10, alone, "--workers", "1")
