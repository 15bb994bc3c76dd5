"""Runs that are ended from outside print one line, exit with code 1 or 2, and keep their finished parts."""

import contextlib
import errno
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import psutil
import pytest
from filelock import FileLock

from impact_xval.experiments.config.errors import InterruptedRunError
from impact_xval.experiments.config.experiment import load_config, parse_config
from impact_xval.experiments.sweep import run as sweep
from impact_xval.experiments.sweep.run import present_once, run_sweep
from impact_xval.experiments.sweep.status import status_of
from impact_xval.experiments.tables.folder import new_folder, tables_lock, write_text
from tests.experiments import fakes
from tests.experiments.conftest import SMALL, resumed, swept, tables_of
from tests.waiting import gone, wait_until

ROOT = Path(__file__).parents[3]


@pytest.mark.parametrize("name", ["000001-", "cells.parquet", "ladder.csv", "manifest.json", "report.html"])
def test_a_file_that_cannot_be_written_leaves_no_half_of_it(tmp_path, monkeypatch, fake_run, name):
    """If a file cannot be written, the run ends with one line and leaves no half file.

    After the run is continued, its tables equal those of an undisturbed run to the byte. The file is a part, a table,
    the manifest at the end, or the report.
    """
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


def steps(monkeypatch, step):
    """Call ``step(name, function)`` instead of each function that writes into a run's folder.

    Here ``name`` is the name of what the function writes.
    """

    def watched(owner, attribute, name):
        function = getattr(owner, attribute)

        def called(*arguments, **options):
            return step(name(*arguments), lambda: function(*arguments, **options))

        monkeypatch.setattr(owner, attribute, called)

    def asks(*_):
        return "versions"

    watched(Path, "mkdir", lambda path, *_, **__: path.name)
    watched(FileLock, "acquire", lambda lock, *_: Path(lock.lock_file).name)
    watched(Path, "replace", lambda _, target: target.name.partition("-")[0])
    watched(sweep, "solver_versions", asks)


def ended_at(monkeypatch, root, name, after, end):
    """Run `swept` into a folder, and call `end` before or after the first step of the given name."""
    seen = []

    def step(here, function):
        first = here == name and here not in seen
        seen.append(here)
        if here == "versions":
            # the processes that report versions write this file; in this test there are none
            (root / "solvers.log").touch()
        if first and not after:
            end()
        done = function()
        if first:
            end()
        return done

    steps(monkeypatch, step)
    swept(root)


def interrupt():
    raise KeyboardInterrupt


def killed_at(root, name, after):
    with pytest.MonkeyPatch.context() as monkeypatch:
        ended_at(monkeypatch, root, name, after, lambda: os.kill(os.getpid(), signal.SIGKILL))


#: The steps that write into the folder of a run, in order, by what each writes.
STEPS = ["parts", ".lock", "experiment.toml", "versions", ".lock-tables", "manifest.json", "000000"]
STEPS += ["curves.parquet", "divergence.parquet", "cells.parquet", "divergence.csv"]


def test_these_are_the_steps_of_a_run(tmp_path, monkeypatch):
    seen = []

    def step(name, function):
        seen.append(name)
        return function()

    steps(monkeypatch, step)
    swept(tmp_path / "a")
    there = [name for name in dict.fromkeys(seen) if name in STEPS]
    assert there == STEPS, seen


@pytest.mark.parametrize("after", [False, True], ids=["before", "after"])
@pytest.mark.parametrize("name", STEPS)
def test_a_run_that_is_interrupted_at_any_step_goes_on_by_the_same_command(
    tmp_path, monkeypatch, fake_run, name, after
):
    root = tmp_path / "a"
    with monkeypatch.context() as patched, pytest.raises(InterruptedRunError, match=r"^interrupted$"):
        ended_at(patched, root, name, after, interrupt)
    resumed(root)
    assert tables_of(root) == tables_of(fake_run.root)


def test_two_shards_that_finish_at_once_present_once_and_hold_no_lock_of_tables(tmp_path):
    results = [run_shard(tmp_path / "a", shard) for shard in ((1, 2), (2, 2), (1, 2))]
    assert [result.tables_complete for result in results] == [False, True, True]
    seen, both_there = [], threading.Barrier(2)

    def present(folder, _apart):
        with tables_lock(folder).acquire(timeout=0):
            seen.append(folder.manifest()["state"])
        return "presented"

    def present_with_the_other():
        both_there.wait()
        return present_once(results[-1], present, isolate=False)

    with ThreadPoolExecutor(2) as threads:
        calls = [threads.submit(present_with_the_other) for _ in range(2)]
    assert seen == ["tables"]
    assert {call.result() for call in calls} == {"presented", None}
    assert status_of(tmp_path / "a").state == "complete"
    assert len(results[0].folder.manifest()["sessions"]) == 3


def test_where_a_shard_is_stopped_while_it_presents_the_other_one_does(tmp_path):
    run_shard(tmp_path / "a", (1, 2))
    result = run_shard(tmp_path / "a", (2, 2))

    def stopped(folder, _apart):
        raise KeyboardInterrupt

    with pytest.raises(InterruptedRunError, match=r"^interrupted$"):
        present_once(result, stopped, isolate=False)
    assert status_of(tmp_path / "a").state == "stopped"
    assert present_once(result, lambda folder, _apart: folder.root.name, isolate=False) == "a"
    assert status_of(tmp_path / "a").state == "complete"


@pytest.mark.parametrize(
    "left",
    [{"state": "running"}, {"state": "tables", "identity": "of another version"}],
    ids=["runs", "ended"],
)
def test_a_session_that_begins_while_a_page_is_drawn_is_not_called_complete(tmp_path, left):
    result = run_shard(tmp_path / "a", (1, 1))

    def present(folder, _apart):
        folder.write_manifest(folder.manifest() | left)

    present_once(result, present, isolate=False)
    assert result.folder.manifest().items() >= left.items()


def run_shard(root, shard):
    """Run a shard, which is a part of the cells, of `SMALL` in this process, up to its tables."""
    how = {"isolate": False, "resolve": fakes.shifted, "to_be_presented": True}
    return run_sweep(parse_config(SMALL), root, shard=shard, **how)


@pytest.fixture(scope="module")
def preloaded():
    """A context for processes that start with all modules imported, which otherwise takes seconds."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([__name__])
    return context


@pytest.mark.parametrize("after", [False, True], ids=["before", "after"])
@pytest.mark.parametrize(
    "name", ["parts", ".lock", "experiment.toml", "versions", "manifest.json", "cells.parquet"]
)
def test_a_run_that_is_killed_at_any_step_goes_on_by_the_same_command(
    tmp_path, preloaded, fake_run, name, after
):
    root = tmp_path / "a"
    process = preloaded.Process(target=killed_at, args=(root, name, after))
    process.start()
    process.join()
    assert process.exitcode == -signal.SIGKILL
    resumed(root)
    assert not list(root.rglob(".tmp-*"))
    assert tables_of(root) == tables_of(fake_run.root)


def test_a_test_of_the_hypothesis_whose_folder_was_just_made_goes_on(tmp_path):
    (tmp_path / ".tmp-1-hypothesis.toml").write_text("half")
    new_folder(tmp_path)


#: A program that runs the command line with a test's `main` instead of all commands.
STAND_IN = """
import atexit, os, signal, sys, time, types
from impact_xval.__main__ import ENDS, entry
def kill(*numbers):
    for number in numbers:
        os.kill(os.getpid(), number)
    time.sleep(0)
{}
sys.modules["impact_xval.experiments.commands.cli"] = types.SimpleNamespace(main=main)
sys.exit(entry())
"""
#: Versions of `main` that receive signals at awkward times.
HIT = {
    "two signals at once": """
def main():
    signal.pthread_sigmask(signal.SIG_BLOCK, ENDS)
    kill(signal.SIGINT, signal.SIGTERM)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDS)
""",
    "again while it ends": """
def main():
    try:
        kill(signal.SIGINT)
    finally:
        kill(signal.SIGINT, signal.SIGTERM)
        print("all ended")
""",
    "while an object is deleted": """
class Deleted:
    def __del__(self):
        kill(signal.SIGINT)
def main():
    Deleted()
    time.sleep(60)
    print('not interrupted')
""",
    "in a string that is executed": """
def main():
    exec("kill(signal.SIGINT)")
""",
    "in an import that makes it another error": """
def main():
    try:
        kill(signal.SIGINT)
    except KeyboardInterrupt:
        raise ImportError("multiarray failed to import") from None
""",
    "in an import that drops it, and again": """
def main():
    try:
        kill(signal.SIGINT)
    except BaseException:
        pass
    kill(signal.SIGINT)
""",
}


@pytest.mark.parametrize("name", HIT)
def test_a_signal_is_one_line_and_no_traceback_wherever_it_comes(tmp_path, name):
    done = said_by(tmp_path, HIT[name])
    assert (done.returncode, done.stderr) == (1, "impact-xval: interrupted\n")
    assert done.stdout == ("all ended\n" if name == "again while it ends" else "")


#: An object that Python deletes last, after it has restored the signal handlers of the system.
LAST = """
class Deleted:
    def __init__(self):
        self.kill, self.numbers = os.kill, (os.getpid(), signal.SIGINT)
    def __del__(self):
        self.kill(*self.numbers)
sys.kept = Deleted()
def main():
    atexit.register(kill, signal.SIGINT, signal.SIGTERM)
    return 3
"""


def test_a_signal_after_the_end_changes_nothing(tmp_path):
    done = said_by(tmp_path, LAST)
    assert (done.returncode, done.stderr) == (3, "")


def test_an_error_that_no_signal_has_caused_is_shown(tmp_path):
    done = said_by(tmp_path, "def main():\n    raise LookupError('a bug')\n")
    assert done.returncode == 1
    assert done.stderr.endswith("LookupError: a bug\n")


def said_by(folder, command):
    """Run a program with the given `main` as a module. Python ends a module differently from a script."""
    (folder / "stand_in.py").write_text(STAND_IN.format(command))
    words, env = [sys.executable, "-m", "stand_in"], os.environ | {"PYTHONPATH": str(ROOT)}
    return subprocess.run(
        words, cwd=folder, env=env, capture_output=True, text=True, check=False, timeout=300
    )


def _parts(root):
    return list((root / "parts").glob("0*"))


#: The command line, with an engine that hangs where e1 = 0.902.
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
    """A signal keeps the finished parts, and the message says how to continue, although a solver hangs.

    A scheduler of jobs or a closed terminal sends such signals. Here the signal is sent twice: to all processes of the
    group, and to the run alone.
    """
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
    os.setsid()  # a session of its own, so that a test can kill the run with all its processes
    run_sweep(load_config(config), root, workers=2, resolve=fakes.slow)


@pytest.mark.slow
@pytest.mark.parametrize("kills", [2, pytest.param(5, marks=pytest.mark.nightly)])
def test_kills_change_no_byte(tmp_path, kills, preloaded):
    """A run that is killed several times and then continued has the tables of an undisturbed run, to the byte.

    SIGKILL goes to the run and all its processes, each time that one more part is finished.
    """
    (tmp_path / "c.toml").write_text(CONFIG % [0.7, 0.9])
    config, root = load_config(tmp_path / "c.toml"), tmp_path / "cut"
    left_alone = run_sweep(config, tmp_path / "whole", isolate=False, resolve=fakes.slow)
    for parts in range(1, kills + 1):
        process = preloaded.Process(target=run_slowly, args=(tmp_path / "c.toml", root))
        process.start()
        wait_until(lambda: not process.is_alive() or len(_parts(root)) >= parts)  # noqa: B023
        with contextlib.suppress(ProcessLookupError):  # the run may have ended already
            os.killpg(process.pid, signal.SIGKILL)
        process.join()
        assert len(_parts(root)) >= parts
    said = resumed(root, config, resolve=fakes.slow)
    assert any(" of 6 parts are already computed" in line for line in said)
    assert not list(root.rglob(".tmp-*"))
    assert tables_of(root) == tables_of(left_alone.folder.root)
