"""A process of its own: what it answers, and what becomes of its deaths."""

import os
import signal
import subprocess
import sys
import threading
import time

import pytest

from impact_xval.experiments.sweep.sandbox import (
    ClosedError,
    FaultError,
    Sandbox,
    SandboxError,
)
from tests.experiments import sandbox_work as work


@pytest.fixture
def sandbox():
    made = Sandbox("a context", work.prepare)
    yield made
    made.close()


def test_it_answers_with_its_context_and_is_prepared_once(sandbox):
    assert sandbox.call(work.echo, 1, "two", patience=20) == ("a context", (1, "two"))
    assert sandbox.prepared == "prepared with a context"
    first = sandbox.call(work.pid, patience=20)
    assert first != os.getpid()
    assert sandbox.call(work.pid, patience=20) == first
    assert sandbox.call(work.threads, patience=20) == ("1", "1")
    assert sandbox.call(work.chatter, patience=20) == "still understood"
    assert sandbox.call(work.ctrl_c, patience=20) == "unmoved"


@pytest.mark.parametrize(
    ("how", "reason"),
    [
        (signal.SIGSEGV, "its process died: SIGSEGV"),
        (signal.SIGABRT, "its process died: SIGABRT"),
        (signal.SIGKILL, "its process died: SIGKILL (out of memory, or killed)"),
        ("exit", "its process died: exit code 5"),
    ],
)
def test_a_death_is_a_fault_that_says_of_what_and_where(sandbox, how, reason):
    with pytest.raises(FaultError) as caught:
        sandbox.call(work.die, how, patience=20)
    assert (caught.value.status, caught.value.at, caught.value.reason) == ("crashed", "about to", reason)
    assert sandbox.call(work.echo, 1, patience=20) == ("a context", (1,))


def test_silence_is_a_fault_and_a_beat_is_no_silence(sandbox):
    sandbox.start()
    assert sandbox.call(work.slow_steps, 4, 0.3, patience=1.0) == "through"
    with pytest.raises(FaultError) as caught:
        sandbox.call(work.slow_steps, 1, 60, patience=0.4)
    assert (caught.value.status, caught.value.at) == ("timeout", "step 0")
    assert caught.value.reason == "no answer within 0.4 s; its process was ended"


def test_an_exception_is_a_bug_with_its_traceback(sandbox):
    with pytest.raises(SandboxError, match="ValueError: a bug"):
        sandbox.call(work.fail, patience=20)
    assert sandbox.call(work.echo, patience=20) == ("a context", ())


def test_a_process_that_dies_of_its_preparation_starts_without():
    sandbox = Sandbox("dies at once", work.prepare)
    assert sandbox.call(work.echo, patience=20) == ("dies at once", ())
    assert sandbox.prepared is None
    sandbox.close()


def test_closing_ends_work_at_once_from_another_thread(sandbox):
    sandbox.start()
    start = time.monotonic()
    threading.Timer(0.3, sandbox.close).start()
    with pytest.raises(ClosedError):
        sandbox.call(work.slow_steps, 1, 60, patience=50)
    assert time.monotonic() - start < 5
    with pytest.raises(ClosedError):
        sandbox.call(work.echo, patience=20)


def test_it_does_not_outlive_a_killed_parent():
    script = (
        "import os, signal; from impact_xval.experiments.sweep.sandbox import Sandbox\n"
        "from tests.experiments import sandbox_work as w\n"
        "s = Sandbox(None, w.prepare); print(s.call(w.pid, patience=20), flush=True)\n"
        "os.kill(os.getpid(), signal.SIGKILL)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == -signal.SIGKILL
    child = int(done.stdout)
    for _ in range(100):
        try:
            os.kill(child, 0)
        except ProcessLookupError:
            return
        time.sleep(0.05)
    pytest.fail(f"process {child} is still there")
