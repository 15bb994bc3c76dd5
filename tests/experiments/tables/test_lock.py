"""Two runs into one folder: the second refuses; a run that died blocks nobody."""

import json
import os
import signal
import socket
import subprocess
import sys

import pytest

from impact_xval.experiments.commands.cli import main
from impact_xval.experiments.config.errors import UserError
from impact_xval.experiments.sweep.run import run_sweep
from impact_xval.experiments.tables.lock import (
    OWNER,
    holding,
    owner_of,
    running,
)
from tests.experiments import fakes

_HOLD = (
    "import sys, time; from pathlib import Path; from impact_xval.experiments.tables.lock import holding\n"
    "with holding(Path(sys.argv[1])):\n    print('held', flush=True); time.sleep(60)"
)


@pytest.fixture
def other(tmp_path):
    """Another process that holds the folder."""
    process = subprocess.Popen(
        [sys.executable, "-c", _HOLD, str(tmp_path)], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "held\n"
    yield process
    process.kill()
    process.communicate()


def test_the_second_refuses_and_says_who_is_there(tmp_path, other, small, capsys):
    before = sorted(path.name for path in tmp_path.iterdir())
    with (
        pytest.raises(UserError, match=f"another run writes there .process {other.pid} on"),
        holding(tmp_path),
    ):
        pass
    for resume in (False, True):
        with pytest.raises(UserError, match=f"another run writes there .process {other.pid} on"):
            run_sweep(small, tmp_path, isolate=False, resume=resume, resolve=fakes.shifted)
    (tmp_path / "c.toml").write_text("solvers = ['state-transition']")
    assert main(["run", str(tmp_path / "c.toml"), "--out", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert f"process {other.pid} on {socket.gethostname()}, since 20" in error
    assert "legal: wait for it, or another folder" in error
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([*before, "c.toml"])


def test_a_killed_owner_blocks_nobody_and_is_named(tmp_path, other):
    assert running(tmp_path) is not None
    other.send_signal(signal.SIGKILL)
    other.wait()
    assert running(tmp_path) is None
    with holding(tmp_path) as line:
        assert line.startswith(f"taken over from a run that died (process {other.pid} on ")
        owner = owner_of(tmp_path)
        assert owner is not None
        assert owner.pid == os.getpid()
    assert owner_of(tmp_path) is None
    with holding(tmp_path) as line:
        assert line == ""


def test_a_run_leaves_the_sign_of_one_that_took_over(tmp_path):
    text = json.dumps({"host": "elsewhere", "pid": 7, "since": "2026-01-01T00:00:00+00:00"})
    with holding(tmp_path):
        (tmp_path / OWNER).write_text(text)
    assert (tmp_path / OWNER).read_text() == text


def test_a_damaged_sign_is_no_sign(tmp_path):
    for text in ("", "{", "[]", '{"host": 1}', "[" * 10_000, '{"host": "", "pid": 1e999, "since": ""}'):
        (tmp_path / OWNER).write_text(text)
        assert owner_of(tmp_path) is None
        with holding(tmp_path):
            pass
