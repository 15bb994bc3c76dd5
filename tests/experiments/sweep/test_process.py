"""A worker process: its answers, and how its death is handled."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
import venv

import pytest

import impact_xval
from impact_xval import Collision, compare
from impact_xval.experiments.sweep.pool import Slot
from impact_xval.experiments.sweep.process import FaultError, Worker, WorkerError
from tests.waiting import gone, wait_until


def echo(context, *values):
    print("what is printed is no answer", flush=True)
    return context, values


def pid(context):
    return os.getpid()


def made_ready(context, pids, dies):
    """Record the process. With `dies` kill the first one, otherwise return True, as after compiling kernels."""
    with pids.open("a") as file:
        print(os.getpid(), file=file)
    if dies and len(pids.read_text().split()) == 1:
        die(context)
    return not dies


def die(context):
    os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(600)


def fail(context):
    raise LookupError("a bug")


def orphan(context):
    """Kill the process that waits for the answer, and continue, so that no closed pipe is noticed."""
    os.kill(os.getppid(), signal.SIGKILL)
    time.sleep(600)


@pytest.fixture
def worker():
    with contextlib.closing(Worker("a context")) as made:
        yield made


def test_a_worker_answers_from_one_process_with_its_context_and_says_what_is_raised(worker):
    first = worker.call(pid, timeout=60)
    assert worker.call(echo, 1, "two", timeout=60) == ("a context", (1, "two"))
    with pytest.raises(WorkerError, match=r"in fail\n.*\nLookupError: a bug"):
        worker.call(fail, timeout=60)
    assert worker.call(pid, timeout=60) == first != os.getpid()


def test_a_killed_process_is_a_fault_that_says_so_and_the_next_call_is_answered(worker):
    before = worker.call(pid, timeout=60)
    with pytest.raises(FaultError, match=r"its process died: SIGKILL \(out of memory, or killed\)") as caught:
        worker.call(die, timeout=60)
    assert caught.value.status == "crashed"
    assert gone(before)
    assert worker.call(echo, 1, timeout=60) == ("a context", (1,))


@pytest.mark.parametrize("dies", [False, True])
def test_a_process_that_compiled_or_died_of_it_is_replaced_once(tmp_path, dies):
    with contextlib.closing(Slot(None)) as slot:
        for _ in range(2):
            slot.prepare("mujoco", made_ready, tmp_path / "ready", dies)
        first, second = map(int, (tmp_path / "ready").read_text().split())
        assert slot.call("mujoco", pid, timeout=60) == second != first
        slot.compile(made_ready, tmp_path / "compiled", dies)
        (third,) = map(int, (tmp_path / "compiled").read_text().split())
        assert slot.call(None, pid, timeout=60) != third
        assert gone(first)
        assert gone(third)


def test_another_interpreter_imports_this_project_and_nothing_else_that_is_installed_here(
    tmp_path, monkeypatch
):
    venv.create(tmp_path / "other", symlinks=True)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(sys.path))
    facts = (
        "(__import__('sys').prefix, __import__('impact_xval').__file__, "
        "__import__('os').environ['NUMBA_CACHE_DIR'], __import__('importlib.util').util.find_spec('numpy'))"
    )
    with contextlib.closing(Worker(facts, python=tmp_path / "other" / "bin" / "python")) as worker:
        found = worker.call(eval, timeout=60)  # `eval` evaluates the worker's context
    other = tmp_path / "other"
    assert found == (str(other), impact_xval.__file__, str(other / "kernels"), None)


def test_a_worker_does_not_outlive_a_killed_parent_whatever_it_does():
    script = (
        "from impact_xval.experiments.sweep.process import Worker\n"
        "from tests.experiments.sweep import test_process as w\n"
        "s = Worker(None); print(s.call(w.pid, timeout=60), flush=True); s.call(w.orphan, timeout=600)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == -signal.SIGKILL
    left = int(done.stdout)
    wait_until(lambda: gone(left))


@pytest.mark.nightly
def test_the_process_that_compiles_and_those_that_read_say_the_same_to_the_last_bit(tmp_path, monkeypatch):
    """The process that compiles kernels and a process that reads them from the cache give identical results.

    For this cell (collision) the grazing margin by the law bistiffness once differed in a digit in the process that had
    just compiled the kernels.
    """
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    cell = Collision.two_balls(1.0, 0.441388, 1.0, 5.623413251903491e-06, 0.694292, 0.312025, -1.0)
    first, again = (json.dumps(compare(cell, ["bistiffness"]).objects()) for _ in range(2))
    assert first == again
