"""What can end a run from outside: one line, exit code 1 or 2, and earlier parts intact."""

import contextlib
import errno
import multiprocessing
import os
import signal
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

from impact_xval.experiments.config.errors import InterruptedRunError
from impact_xval.experiments.config.experiment import load_config
from impact_xval.experiments.sweep.run import run_sweep
from impact_xval.experiments.sweep.status import status_of
from impact_xval.experiments.tables.folder import write_text
from tests.experiments import fakes
from tests.experiments.conftest import resumed, tables_of
from tests.waiting import gone, wait_until

ROOT = Path(__file__).parents[3]


@pytest.mark.parametrize("name", ["000001-", "cells.parquet", "ladder.csv", "manifest.json", "report.html"])
def test_a_file_that_cannot_be_written_leaves_no_half_of_it(tmp_path, monkeypatch, fake_run, name):
    """A part, a table, the manifest at the end, the report: a line, and the run continues to the same bytes."""
    replace, root, seen = Path.replace, tmp_path / "a", []

    def full(path, target):
        seen.append(target.name)
        if target.name.startswith(name) and (name != "manifest.json" or seen.count(name) > 1):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(target))
        return replace(path, target)

    def present(folder, _apart):
        write_text(folder.root / "report.html", "what people look at")

    monkeypatch.setattr(Path, "replace", full)
    with pytest.raises(InterruptedRunError, match=f"{name}.*: No space left on device"):
        resumed(root, present=present)
    monkeypatch.undo()
    assert not list(root.rglob(".tmp-*"))
    assert len(_parts(root)) == (2 if name == "000001-" else 3)
    assert status_of(root).state == "stopped"
    resumed(root, present=present)
    assert status_of(root).state == "complete"
    assert (root / "report.html").exists()
    assert tables_of(root) == tables_of(fake_run.root)


def _parts(root):
    return list((root / "parts").glob("0*"))


#: The command, with an engine that hangs where e1 = 0.902.
HANGING = (
    "import functools, sys\n"
    "from impact_xval.experiments.sweep import run as sweep; from tests.experiments import fakes\n"
    "sweep.run_sweep = functools.partial(sweep.run_sweep, resolve=fakes.faulty)\n"
    "from impact_xval.__main__ import entry; sys.exit(entry())\n"
)
CONFIG = """
scenario = "impact"
solvers = ["mujoco"]
chunk_size = 1
[grid]
mass_ratio = [1.5]
e1 = %s
e2 = [0.7]
stiffness_ratio = [0.5, 1.0, 2.0]
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    "end",
    [signal.SIGTERM, signal.SIGINT, pytest.param(signal.SIGHUP, marks=pytest.mark.nightly)],
    ids=lambda end: end.name,
)
def test_a_signal_while_a_solver_hangs_keeps_what_is_done_and_says_how_to_go_on(tmp_path, end):
    """As sent by a scheduler of jobs or a closed terminal; sent twice, to all of a group and to the run alone."""
    (tmp_path / "c.toml").write_text(CONFIG % [0.9, fakes.HANG])
    root = tmp_path / "a"
    command = [sys.executable, "-c", HANGING, "run", tmp_path / "c.toml", "--out", root, "--workers", "2"]
    pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True}
    process = subprocess.Popen(command, cwd=ROOT, start_new_session=True, **pipes)
    wait_until(lambda: process.poll() is not None or _parts(root))
    started = psutil.Process(process.pid).children(recursive=True)
    assert started
    os.killpg(process.pid, end)
    process.send_signal(end)
    _, error = process.communicate(timeout=300)
    assert process.returncode == 1
    assert "interrupted; finished parts are kept; to continue: impact-xval run" in error
    assert error.count("\n") == 1
    wait_until(lambda: all(gone(each.pid) for each in started))
    assert 1 <= len(_parts(root)) <= 3


def run_slowly(config, root):
    os.setsid()  # to be killed with all that it starts
    run_sweep(load_config(config), root, workers=2, resolve=fakes.slow)


@pytest.mark.slow
@pytest.mark.parametrize("kills", [2, pytest.param(5, marks=pytest.mark.nightly)])
def test_kills_change_no_byte(tmp_path, kills):
    """SIGKILL to the run and all that it started, each time one more part is there, wherever that finds it."""
    (tmp_path / "c.toml").write_text(CONFIG % [0.7, 0.9])
    config, root = load_config(tmp_path / "c.toml"), tmp_path / "cut"
    left_alone = run_sweep(config, tmp_path / "whole", isolate=False, resolve=fakes.slow)
    # The runner starts in a process whose modules are there already; importing them takes seconds.
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([__name__])
    for parts in range(1, kills + 1):
        process = context.Process(target=run_slowly, args=(tmp_path / "c.toml", root))
        process.start()
        wait_until(lambda: not process.is_alive() or len(_parts(root)) >= parts)  # noqa: B023
        with contextlib.suppress(ProcessLookupError):  # it is done already
            os.killpg(process.pid, signal.SIGKILL)
        process.join()
        assert len(_parts(root)) >= parts
    said = resumed(root, config, resolve=fakes.slow)
    assert any(" of 6 parts are there and whole" in line for line in said)
    assert not list(root.rglob(".tmp-*"))
    assert tables_of(root) == tables_of(left_alone.root)
