"""What can end a run from outside: one line, exit code 1 or 2, and earlier parts intact."""

import contextlib
import errno
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

from impact_xval.compliant_baselines import get_solver
from impact_xval.experiments.commands.cli import main
from impact_xval.experiments.config.configuration import load_config
from impact_xval.experiments.config.errors import InterruptedRunError
from impact_xval.experiments.sweep.run import run_sweep
from impact_xval.experiments.sweep.status import status_of
from impact_xval.experiments.tables.store import TABLES
from tests.experiments import fakes
from tests.experiments.conftest import resumed, tables_of
from tests.waiting import gone, wait_until

ROOT = Path(__file__).parents[3]


@pytest.fixture
def whole(fake_run):
    return tables_of(fake_run.root)


def test_a_part_that_cannot_be_written_ends_the_run_and_keeps_the_others(small, tmp_path, monkeypatch, whole):
    write = Path.write_bytes

    def fail(path, data):
        if "000001-" in path.name:  # the middle one of three, the last one done
            write(path, data[: len(data) // 2])
            raise OSError(errno.EIO, os.strerror(errno.EIO), str(path))
        return write(path, data)

    monkeypatch.setattr(Path, "write_bytes", fail)
    with pytest.raises(InterruptedRunError, match=os.strerror(errno.EIO)):
        run_sweep(small, tmp_path / "a", isolate=False, resolve=fakes.shifted)
    monkeypatch.undo()
    assert len(list((tmp_path / "a/parts").glob("0*"))) == 2
    resumed(small, tmp_path / "a")
    assert tables_of(tmp_path / "a") == whole


def test_a_table_that_cannot_be_written_leaves_no_half_of_it(small, tmp_path, monkeypatch, whole):
    replace, root = Path.replace, tmp_path / "a"
    for resume, table in enumerate([*TABLES, "manifest.json"]):
        calls = []

        def fail(path, target, table=table, calls=calls):
            if target.name == table and (table != "manifest.json" or table in calls):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(target))
            calls.append(target.name)
            return replace(path, target)

        monkeypatch.setattr(Path, "replace", fail)
        with pytest.raises(InterruptedRunError, match=f"{table}: No space left on device"):
            run_sweep(small, root, isolate=False, resume=resume > 0, resolve=fakes.shifted)
        monkeypatch.undo()
        assert not list(root.glob(".tmp-*"))
        assert json.loads((root / "manifest.json").read_text())["state"] == "running"
    resumed(small, root)
    assert tables_of(root) == whole


@pytest.mark.slow
def test_a_run_is_complete_only_with_its_report(tmp_path, monkeypatch, capsys):
    (tmp_path / "c.toml").write_text(
        "solvers = ['kelvin-voigt']\nscenario = 'impact'\n[grid]\nstiffness_ratio = [0.5, 2.0]\n"
        "mass_ratio = [1.5]\ne1 = [0.9]\ne2 = [0.7]\n"
    )
    root, replace = tmp_path / "a b", Path.replace

    def full(path, target):
        if target.name in ("summary.csv", "report.html"):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return replace(path, target)

    command = ["run", str(tmp_path / "c.toml"), "--out", str(root)]
    monkeypatch.setattr(Path, "replace", full)
    assert main([*command, "--workers", "1"]) == 1
    error = capsys.readouterr().err
    assert f"{root}/summary.csv: No space left on device; finished parts are kept; to continue: " in error
    assert f"impact-xval run {tmp_path}/c.toml --out '{root}' --resume" in error
    assert error.count("\n") == 1
    assert (status_of(root).state, status_of(root).cells_done) == ("stopped", 2)
    monkeypatch.undo()
    assert main([*command, "--resume", "--workers", "1"]) == 0
    assert status_of(root).state == "complete"
    assert "everything is in" in capsys.readouterr().out


def _begin(*command):
    """Start Python with some words, in a group of processes of its own."""
    return subprocess.Popen(
        [sys.executable, *map(str, command)],
        cwd=ROOT,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def _parts(root):
    return list((root / "parts").glob("0*"))


@pytest.mark.slow
@pytest.mark.skipif(os.geteuid() != 0, reason="mounting a small disk needs root")
def test_a_full_disk(tmp_path):
    disk, config = tmp_path / "disk", tmp_path / "c.toml"
    disk.mkdir()
    mount = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=200k", "tmpfs", str(disk)], check=False)
    if mount.returncode:
        pytest.skip("a small disk cannot be mounted here")
    try:
        config.write_text(
            "scenario = 'impact'\nsolvers = ['kelvin-voigt']\nchunk_size = 2\n[grid]\ne1 = [0.9]\n"
        )
        process = _begin("-m", "impact_xval", "run", config, "--out", disk / "run", "--workers", "2")
        _, error = process.communicate(timeout=300)
        assert process.returncode == 1
        assert "No space left on device; finished parts are kept; to continue: impact-xval run" in error
        assert error.count("\n") == 1
        kept = len(_parts(disk / "run"))
        assert kept > 2
        assert not list(disk.glob("run/parts/.tmp-*"))
        subprocess.run(["mount", "-o", "remount,size=20m", str(disk)], check=True)
        said = resumed(load_config(config), disk / "run", resolve=get_solver)
        assert f"resumed: {kept} of 78 parts are there and whole" in said
    finally:
        subprocess.run(["umount", str(disk)], check=True)


@pytest.mark.slow
def test_ctrl_c_while_a_solver_hangs_ends_the_run(tmp_path):
    script = (
        "import functools, sys\n"
        "from impact_xval.experiments.sweep import run as sweep; from tests.experiments import faulty\n"
        "sweep.run_sweep = functools.partial(sweep.run_sweep, resolve=faulty.faulty)\n"
        "from impact_xval.experiments.commands.cli import main; sys.exit(main(sys.argv[1:]))\n"
    )
    (tmp_path / "c.toml").write_text(
        "scenario = 'impact'\nsolvers = ['mujoco']\nchunk_size = 1\n[grid]\n"
        "stiffness_ratio = [0.5, 1.0]\nmass_ratio = [1.5]\ne1 = [0.9, 0.902]\ne2 = [0.7]\n"
    )
    root = tmp_path / "a"
    process = _begin("-c", script, "run", tmp_path / "c.toml", "--out", root, "--workers", "2")
    wait_until(lambda: process.poll() is not None or len(_parts(root)) >= 2)
    os.killpg(process.pid, signal.SIGINT)
    _, error = process.communicate(timeout=300)
    assert process.returncode == 1
    assert "interrupted; finished parts are kept; to continue: impact-xval run" in error
    assert "Traceback" not in error


CONFIG = """
scenario = "impact"
solvers = ["kelvin-voigt", "mujoco"]
step_fraction = 0.005
chunk_size = 3
[convergence]
enabled = false
[grid]
mass_ratio = [1.0]
e1 = [0.7]
e2 = [0.6]
stiffness_ratio = {log = [0.02, 30, %d]}
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    "end",
    [signal.SIGTERM, signal.SIGINT, pytest.param(signal.SIGHUP, marks=pytest.mark.nightly)],
    ids=lambda end: end.name,
)
def test_a_signal_keeps_what_is_done_and_says_how_to_go_on(tmp_path, end):
    """As sent by a scheduler of jobs or a closed terminal; sent twice, to all of a group and to the run alone."""
    (tmp_path / "c.toml").write_text(CONFIG % 20_000)
    root = tmp_path / "a"
    process = _begin("-m", "impact_xval", "run", tmp_path / "c.toml", "--out", root, "--workers", "2")
    wait_until(lambda: process.poll() is not None or len(_parts(root)) >= 2)
    started = psutil.Process(process.pid).children(recursive=True)
    assert started
    os.killpg(process.pid, end)
    process.send_signal(end)
    _, error = process.communicate(timeout=300)
    assert process.returncode == 1
    assert "interrupted; finished parts are kept; to continue: impact-xval run" in error
    assert error.count("\n") == 1
    wait_until(lambda: all(gone(each.pid) for each in started))
    assert len(_parts(root)) >= 2


@pytest.fixture
def left_alone(tmp_path):
    """The tables of a run that nothing ends."""
    (tmp_path / "c.toml").write_text(CONFIG % 24)
    run_sweep(load_config(tmp_path / "c.toml"), tmp_path / "whole", isolate=False)
    return tables_of(tmp_path / "whole")


@pytest.mark.slow
def test_five_kills_change_no_byte(tmp_path, left_alone):
    """SIGKILL to the run and all that it started, each time one more part is there, wherever that finds it."""
    root = tmp_path / "cut"
    cut = ["-m", "tests.experiments.runner", str(tmp_path / "c.toml"), str(root), "--workers", "2"]
    for parts in range(1, 6):
        with _begin(*cut) as process:
            wait_until(lambda: process.poll() is not None or len(_parts(root)) >= parts)  # noqa: B023
            with contextlib.suppress(ProcessLookupError):  # it is done already
                os.killpg(process.pid, signal.SIGKILL)
        assert len(_parts(root)) >= parts
    done = subprocess.run([sys.executable, *cut], cwd=ROOT, check=True, capture_output=True, text=True)
    assert " of 8 parts are there and whole" in done.stdout
    assert tables_of(root) == left_alone
