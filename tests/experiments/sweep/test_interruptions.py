"""What can end a run from outside: one line, exit code 1 or 2, and earlier parts intact."""

import errno
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from impact_xval.experiments.commands.cli import main
from impact_xval.experiments.config.errors import InterruptedRunError, UserError
from impact_xval.experiments.sweep.run import run_sweep
from impact_xval.experiments.sweep.status import status_of
from impact_xval.experiments.tables import store
from impact_xval.experiments.tables.store import TABLES
from tests.experiments import fakes
from tests.waiting import gone, wait_until

ROOT = Path(__file__).parents[3]


def _tables(root):
    return {name: (root / name).read_bytes() for name in TABLES}


@pytest.fixture
def whole(small, tmp_path):
    run_sweep(small, tmp_path / "whole", isolate=False, resolve=fakes.shifted)
    return _tables(tmp_path / "whole")


@pytest.mark.parametrize("error", [errno.ENOSPC, errno.EROFS, errno.EACCES, errno.EIO])
def test_a_part_that_cannot_be_written_ends_the_run_and_keeps_the_others(
    small, tmp_path, monkeypatch, whole, error
):
    write = Path.write_bytes

    def fail(path, data):
        if "000001-" in path.name:  # the middle one of three, the last one done
            write(path, data[: len(data) // 2])
            raise OSError(error, os.strerror(error), str(path))
        return write(path, data)

    monkeypatch.setattr(Path, "write_bytes", fail)
    with pytest.raises(InterruptedRunError, match=os.strerror(error)):
        run_sweep(small, tmp_path / "a", isolate=False, resolve=fakes.shifted)
    monkeypatch.undo()
    assert len(list((tmp_path / "a/parts").glob("0*"))) == 2
    run_sweep(small, tmp_path / "a", isolate=False, resume=True, resolve=fakes.shifted)
    assert _tables(tmp_path / "a") == whole


@pytest.mark.parametrize("table", [*TABLES, "manifest.json"])
def test_a_table_that_cannot_be_written_leaves_no_half_of_it(small, tmp_path, monkeypatch, whole, table):
    replace = Path.replace
    calls = []

    def fail(path, target):
        if target.name == table and (table != "manifest.json" or table in calls):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(target))
        calls.append(target.name)
        return replace(path, target)

    monkeypatch.setattr(Path, "replace", fail)
    with pytest.raises(InterruptedRunError, match=f"{table}: No space left on device"):
        run_sweep(small, tmp_path / "a", isolate=False, resolve=fakes.shifted)
    monkeypatch.undo()
    assert not list((tmp_path / "a").glob(".tmp-*"))
    assert json.loads((tmp_path / "a/manifest.json").read_text())["state"] == "running"
    run_sweep(small, tmp_path / "a", isolate=False, resume=True, resolve=fakes.shifted)
    assert _tables(tmp_path / "a") == whole


@pytest.mark.slow
def test_a_run_is_complete_only_with_its_report(tmp_path, monkeypatch, capsys):
    (tmp_path / "c.toml").write_text(
        "solvers = ['kelvin-voigt']\nscenario = 'impact'\n[grid]\nstiffness_ratio = [0.5, 2.0]\n"
        "mass_ratio = [1.5]\ne1 = [0.9]\ne2 = [0.7]\n"
    )
    root, replace = tmp_path / "a b", Path.replace

    def full(path, target):
        if target.name in ("summary.csv", "report.html", "energy.png"):
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
    # What needs no more than the tables works, or says what there is no place for.
    assert main(["ladder", str(root)]) == 0
    for name, what in (("table", "summary.csv"), ("figures", "energy.png"), ("report", "energy.png")):
        capsys.readouterr()
        assert main([name, str(root)]) == 1
        assert f"{what}: No space left on device" in capsys.readouterr().err
    monkeypatch.undo()
    for name in ("table", "figures", "report"):
        assert main([name, str(root)]) == 0
    assert main([*command, "--resume", "--workers", "1"]) == 0
    assert status_of(root).state == "complete"
    assert "everything is in" in capsys.readouterr().out


def test_a_folder_that_vanishes_is_said_so(small, tmp_path):
    def vanish(done, total, line):
        if done == 4:
            shutil.rmtree(tmp_path / "a")

    with pytest.raises(InterruptedRunError, match="a: the folder is gone"):
        run_sweep(small, tmp_path / "a", isolate=False, resolve=fakes.shifted, progress=vanish)
    assert not (tmp_path / "a").exists()


def test_a_part_that_cannot_be_read_is_computed_again(small, tmp_path, monkeypatch, whole):
    run_sweep(small, tmp_path / "a", isolate=False, resolve=fakes.shifted)
    digest = store._digest
    part = sorted((tmp_path / "a/parts").glob("0*"))[2]

    def fail(path):
        if path == part and path.exists():
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
        return digest(path)

    monkeypatch.setattr(store, "_digest", fail)
    said = []
    run_sweep(
        small,
        tmp_path / "a",
        isolate=False,
        resume=True,
        resolve=fakes.shifted,
        progress=lambda done, total, line: said.append(line),
    )
    assert "part 2 cannot be read (Permission denied): computed again" in said
    assert _tables(tmp_path / "a") == whole


def test_a_part_with_a_right_name_that_is_no_table_is_computed_again(small, tmp_path, whole):
    import hashlib

    run_sweep(small, tmp_path / "a", isolate=False, resolve=fakes.shifted)
    part = sorted((tmp_path / "a/parts").glob("0*"))[1]
    name = f"{part.name.rsplit('-', 1)[0]}-{hashlib.sha256(b'PAR1').hexdigest()}.parquet"
    part.unlink()
    (tmp_path / "a/parts" / name).write_bytes(b"PAR1")
    run_sweep(small, tmp_path / "a", isolate=False, resume=True, resolve=fakes.shifted)
    assert _tables(tmp_path / "a") == whole


@pytest.mark.slow
@pytest.mark.skipif(os.geteuid() != 0, reason="mounting a small disk needs root")
def test_a_full_disk(tmp_path):
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=200k", "tmpfs", str(disk)], check=False)
    if mount.returncode:
        pytest.skip("a small disk cannot be mounted here")
    try:
        (tmp_path / "c.toml").write_text("scenario = 'impact'\nsolvers = ['kelvin-voigt']\nchunk_size = 2\n")
        command = ["run", str(tmp_path / "c.toml"), "--out", str(disk / "run"), "--workers", "2"]
        done = subprocess.run(
            [sys.executable, "-m", "impact_xval", *command],
            cwd=ROOT,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 1
        assert "No space left on device; finished parts are kept; to continue: impact-xval run" in done.stderr
        assert done.stderr.count("\n") == 1
        kept = len(list(disk.glob("run/parts/0*")))
        assert kept > 2
        assert not list(disk.glob("run/parts/.tmp-*"))
        subprocess.run(["mount", "-o", "remount,size=20m", str(disk)], check=True)
        done = subprocess.run(
            [sys.executable, "-m", "tests.experiments.runner", str(tmp_path / "c.toml"), str(disk / "run")],
            cwd=ROOT,
            capture_output=True,
            text=True,
            check=True,
        )
        assert f"resumed: {kept} of 312 parts are there and whole" in done.stdout
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
    process = subprocess.Popen(
        [
            sys.executable,
            "-c",
            script,
            "run",
            str(tmp_path / "c.toml"),
            "--out",
            str(tmp_path / "a"),
            "--workers",
            "2",
        ],
        cwd=ROOT,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    wait_until(lambda: process.poll() is not None or len(list(tmp_path.glob("a/parts/0*"))) >= 2)
    os.killpg(process.pid, signal.SIGINT)
    _, error = process.communicate(timeout=300)
    assert process.returncode == 1
    assert "interrupted; finished parts are kept; to continue: impact-xval run" in error
    assert "Traceback" not in error


CONFIG = """
scenario = "impact"
solvers = ["kelvin-voigt", "mujoco"]
chunk_size = 2
[grid]
stiffness_ratio = {log = [0.02, 50, 200]}
mass_ratio = [1.0, 2.0]
e1 = [0.7, 0.9]
e2 = [0.6, 0.8]
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "end"),
    [
        ("run", signal.SIGTERM),
        ("run", signal.SIGINT),
        pytest.param("run", signal.SIGHUP, marks=pytest.mark.nightly),
        pytest.param("search", signal.SIGTERM, marks=pytest.mark.nightly),
    ],
)
def test_a_signal_keeps_what_is_done_and_says_how_to_go_on(tmp_path, command, end):
    """As sent by a scheduler of jobs or a closed terminal; sent twice, and to one process or to all of a group."""
    (tmp_path / "c.toml").write_text(CONFIG)
    words = [command, str(tmp_path / "c.toml"), "--out", str(tmp_path / "a"), "--workers", "2"]
    process = subprocess.Popen(
        [sys.executable, "-m", "impact_xval", *words],
        cwd=ROOT,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    wait_until(lambda: process.poll() is not None or len(list(tmp_path.glob("a/parts/0*"))) >= 2)
    started = psutil.Process(process.pid).children(recursive=True)
    assert started
    (os.killpg if command == "run" else os.kill)(process.pid, end)
    time.sleep(0.1)
    process.send_signal(end)
    _, error = process.communicate(timeout=300)
    assert process.returncode == 1
    kept = "parts" if command == "run" else "generations"
    assert f"interrupted; finished {kept} are kept; to continue: impact-xval {command}" in error
    assert error.count("\n") == 1
    wait_until(lambda: all(gone(each.pid) for each in started))
    assert len(list(tmp_path.glob("a/parts/0*"))) >= 2


def test_a_worker_with_another_version_is_one_line(tmp_path, small, monkeypatch):
    monkeypatch.setattr(fakes.Shifted, "version", lambda self: "shifted 2")  # here, not in the worker
    with pytest.raises(
        UserError, match=r"a worker has mujoco shifted 1, this process mujoco shifted 2; legal"
    ):
        run_sweep(small, tmp_path / "a", workers=1, resolve=fakes.shifted)
