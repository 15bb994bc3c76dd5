"""A process of its own: what it answers, and what becomes of its deaths."""

import os
import signal
import subprocess
import sys
import threading
import time

import pytest

from impact_xval.experiments.sweep.sandbox import ClosedError, FaultError, Sandbox, SandboxError, in_halves
from tests.waiting import gone, wait_until


def prepare(context):
    return f"prepared with {context}"


def echo(context, *values):
    return context, values


def pid(context):
    return os.getpid()


def chatter(context):
    """Write to standard output, which carries the answers."""
    os.write(1, b"noise")
    print("more of it", flush=True)
    return "still understood"


def sleep(context, seconds):
    time.sleep(seconds)


def die(context, how):
    if how == "exit":
        sys.exit(5)
    os.kill(os.getpid(), how)
    time.sleep(60)


def fail(context):
    raise ValueError("a bug")


def unsendable(context):
    return lambda: None


@pytest.fixture
def sandbox():
    made = Sandbox("a context", prepare)
    yield made
    made.close()


def test_it_answers_with_its_context_and_is_prepared_once(sandbox):
    assert sandbox.call(echo, 1, "two", timeout=60) == ("a context", (1, "two"))
    assert sandbox.prepared == "prepared with a context"
    first = sandbox.call(pid, timeout=60)
    assert first != os.getpid()
    assert sandbox.call(pid, timeout=60) == first
    assert sandbox.call(chatter, timeout=60) == "still understood"


@pytest.mark.parametrize(
    ("how", "reason"),
    [
        (signal.SIGSEGV, "its process died: SIGSEGV"),
        (signal.SIGKILL, "its process died: SIGKILL (out of memory, or killed)"),
        ("exit", "its process died: exit code 5"),
    ],
)
def test_a_death_is_a_fault_that_says_of_what(sandbox, how, reason):
    with pytest.raises(FaultError) as caught:
        sandbox.call(die, how, timeout=60)
    assert (caught.value.status, caught.value.reason) == ("crashed", reason)
    assert sandbox.call(echo, 1, timeout=60) == ("a context", (1,))


def test_work_beyond_its_time_is_a_fault(sandbox):
    with pytest.raises(FaultError) as caught:
        sandbox.call(sleep, 600, timeout=0.5)
    assert caught.value.status == "timeout"
    assert caught.value.reason == "no answer within 0.5 s; its process was ended"
    assert sandbox.call(echo, timeout=60) == ("a context", ())


@pytest.mark.parametrize(("work", "says"), [(fail, "ValueError: a bug"), (unsendable, "pickle")])
def test_an_exception_is_a_bug_with_its_traceback(sandbox, work, says):
    with pytest.raises(SandboxError, match=says):
        sandbox.call(work, timeout=60)
    assert sandbox.call(echo, timeout=60) == ("a context", ())


def test_closing_ends_work_from_another_thread(sandbox):
    sandbox.start()
    threading.Timer(0.3, sandbox.close).start()
    with pytest.raises(ClosedError):
        sandbox.call(sleep, 600, timeout=60)
    with pytest.raises(ClosedError):
        sandbox.call(echo, timeout=60)


def test_it_does_not_outlive_a_killed_parent():
    script = (
        "import os, signal; from impact_xval.experiments.sweep.sandbox import Sandbox\n"
        "from tests.experiments.sweep import test_sandbox as w\n"
        "s = Sandbox(None, w.prepare); print(s.call(w.pid, timeout=60), flush=True)\n"
        "os.kill(os.getpid(), signal.SIGKILL)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == -signal.SIGKILL
    left = int(done.stdout)
    wait_until(lambda: gone(left))


def _isolated(n, fatal, once=()):
    """Isolate cells of which some are fatal, always or the first time; the answers, and how often it was called."""
    calls, died = [], set()

    def call(place):
        cells = range(n)[place]
        calls.append(list(cells))
        if fatal & set(cells) or set(once) & set(cells) - died:
            died.update(cells)
            raise FaultError("crashed", f"of {list(cells)}")
        return [f"{cell} answered" for cell in cells]

    found = in_halves(call, n, lambda place, fault: [f"{place.start} lost: {fault.reason}"])
    return [answer for piece in found for answer in piece], calls


def test_what_is_fatal_is_found_by_halving_and_everything_else_answered():
    found, calls = _isolated(7, {2, 6})
    lost = {2: "2 lost: of [2]", 6: "6 lost: of [6]"}
    assert found == [lost.get(cell, f"{cell} answered") for cell in range(7)]
    assert calls.count([2]) == calls.count([6]) == 2
    assert _isolated(7, set()) == ([f"{cell} answered" for cell in range(7)], [list(range(7))])


def test_one_death_is_not_enough_to_lose_a_cell():
    assert _isolated(1, set(), once=[0]) == (["0 answered"], [[0], [0]])
    assert _isolated(1, {0}) == (["0 lost: of [0]"], [[0], [0]])
    assert _isolated(4, set(), once=[3])[0] == [f"{cell} answered" for cell in range(4)]


def test_nor_is_one_death_alone_after_that_of_a_fatal_cell_beside_it():
    alone = []

    def call(place):
        if place == slice(1, 2):
            alone.append(place)
        if place.start == 0 or len(alone) == 1:
            raise FaultError("crashed", "killed")
        return place

    assert in_halves(call, 2, lambda place, fault: "lost") == ["lost", slice(1, 2)]


@pytest.mark.parametrize("n", [1, 4])
def test_a_cell_that_hangs_alone_is_not_waited_for_again(n):
    hung = []

    def call(place):
        if place.stop == n:
            hung.append(place)
            raise FaultError("timeout", "no answer")
        return place

    assert in_halves(call, n, lambda place, fault: "lost")[-1] == "lost"
    assert hung == [slice(start, n) for start in (0, 2, 3) if start < n]
