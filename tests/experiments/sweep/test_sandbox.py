"""A process of its own: what it answers, and what becomes of its deaths."""

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import psutil
import pytest

from impact_xval.experiments.sweep.sandbox import (
    ClosedError,
    FaultError,
    Sandbox,
    SandboxError,
    _Process,
    in_halves,
)
from tests.experiments import sandbox_work as work


@pytest.fixture
def sandbox():
    made = Sandbox("a context", work.prepare)
    yield made
    made.close()


def test_it_answers_with_its_context_and_is_prepared_once(sandbox):
    assert sandbox.call(work.echo, 1, "two", timeout=20) == ("a context", (1, "two"))
    assert sandbox.prepared == "prepared with a context"
    first = sandbox.call(work.pid, timeout=20)
    assert first != os.getpid()
    assert sandbox.call(work.pid, timeout=20) == first
    assert sandbox.call(work.threads, timeout=20) == ("1", "1")
    assert sandbox.call(work.chatter, timeout=20) == "still understood"
    assert sandbox.call(work.ctrl_c, timeout=20) == "unmoved"
    pytest.importorskip("mujoco")
    assert not sandbox.call(work.window_system, timeout=20)


@pytest.mark.parametrize(
    ("how", "reason"),
    [
        (signal.SIGSEGV, "its process died: SIGSEGV"),
        (signal.SIGABRT, "its process died: SIGABRT"),
        (signal.SIGKILL, "its process died: SIGKILL (out of memory, or killed)"),
        ("exit", "its process died: exit code 5"),
    ],
)
def test_a_death_is_a_fault_that_says_of_what(sandbox, how, reason):
    with pytest.raises(FaultError) as caught:
        sandbox.call(work.die, how, timeout=20)
    assert (caught.value.status, caught.value.reason) == ("crashed", reason)
    assert sandbox.call(work.echo, 1, timeout=20) == ("a context", (1,))


def test_signals_that_its_caller_blocks_reach_it(sandbox):
    """As a worker of a cluster on this machine does: a solver ends what it starts by SIGTERM."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGTERM, signal.SIGHUP])
    try:
        assert sandbox.call(work.masked, timeout=20) == []
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def test_work_beyond_its_time_is_a_fault(sandbox):
    sandbox.start()
    assert sandbox.call(work.slow, 0.3, timeout=20) == "through"
    with pytest.raises(FaultError) as caught:
        sandbox.call(work.slow, 60, timeout=0.4)
    assert caught.value.status == "timeout"
    assert caught.value.reason == "no answer within 0.4 s; its process was ended"
    assert sandbox.call(work.echo, timeout=20) == ("a context", ())


def test_an_exception_is_a_bug_with_its_traceback(sandbox):
    with pytest.raises(SandboxError, match="ValueError: a bug"):
        sandbox.call(work.fail, timeout=20)
    assert sandbox.call(work.echo, timeout=20) == ("a context", ())


@contextlib.contextmanager
def standard_error_to(path):
    """Not `capfd`, which drops what is written while it reads; pytest goes back to its own between two phases."""
    before = os.dup(2)
    with path.open("wb") as file:
        os.dup2(file.fileno(), 2)
    try:
        yield
    finally:
        os.dup2(before, 2)
        os.close(before)


@pytest.mark.parametrize("times", [1, 1_000_000])
def test_what_it_writes_to_standard_error_is_visible_in_part_and_waits_for_nobody(sandbox, tmp_path, times):
    path, until = tmp_path / "said", time.monotonic() + 60
    with standard_error_to(path):
        sandbox.call(work.complain, times, timeout=60)
        sandbox.close()
        while "at last" not in path.read_text("utf-8") and time.monotonic() < until:
            time.sleep(0.05)
    said = path.read_text("utf-8")
    assert said.startswith("\\x1b[31mred\\x07 \\xff and röd\n")
    assert "\x1b" not in said
    assert said.rstrip().endswith("at last")
    assert len(said) < 200_000
    assert ("characters more" in said) == (times > 1)


def test_of_a_process_that_is_not_trusted_only_what_was_named_is_read():
    readable = frozenset({("tests.experiments.sandbox_work", "Named")})
    sandbox = Sandbox(None, work.prepare, readable=readable)
    assert sandbox.call(work.echo, 1, ["two"], timeout=20) == (None, (1, ["two"]))
    assert isinstance(sandbox.call(work.made, "Named", timeout=20), work.Named)
    with pytest.raises(FaultError, match="its answer cannot be read: UnpicklingError"):
        sandbox.call(work.made, "Unreadable", timeout=20)
    assert sandbox.call(work.echo, timeout=20) == (None, ())
    sandbox.close()


def test_a_process_that_dies_of_its_preparation_starts_without():
    sandbox = Sandbox("dies at once", work.prepare)
    assert sandbox.call(work.echo, timeout=20) == ("dies at once", ())
    assert sandbox.prepared is None
    sandbox.close()


def test_a_context_that_cannot_be_read_is_the_same_bug_at_every_call():
    sandbox = Sandbox(work.Unreadable(), work.prepare)
    for _ in range(2):
        with pytest.raises(SandboxError, match="ValueError: a bug"):
            sandbox.call(work.echo, timeout=20)
    sandbox.close()


def test_closing_ends_work_at_once_from_another_thread(sandbox):
    sandbox.start()
    start = time.monotonic()
    threading.Timer(0.3, sandbox.close).start()
    with pytest.raises(ClosedError):
        sandbox.call(work.slow, 60, timeout=50)
    assert time.monotonic() - start < 5
    with pytest.raises(ClosedError):
        sandbox.call(work.echo, timeout=20)


def test_it_does_not_outlive_a_killed_parent():
    script = (
        "import os, signal; from impact_xval.experiments.sweep.sandbox import Sandbox\n"
        "from tests.experiments import sandbox_work as w\n"
        "import threading, time; s = Sandbox(None, w.prepare); print(s.call(w.pid, timeout=20), flush=True)\n"
        "threading.Thread(target=s.call, args=(w.slow, 60), kwargs={'timeout': 60}).start(); time.sleep(0.5)\n"
        "os.kill(os.getpid(), signal.SIGKILL)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == -signal.SIGKILL
    assert _gone(int(done.stdout))


def _gone(process, seconds=5.0):
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        if not psutil.pid_exists(process) or psutil.Process(process).status() == psutil.STATUS_ZOMBIE:
            return True
        time.sleep(0.05)
    return False


def test_a_process_that_a_solver_forked_gives_no_answer_and_takes_no_request(sandbox):
    for seconds in (0.0, 0.2):  # its answer is there before the next request, or comes during it
        first = sandbox.call(work.forked, os.fork, seconds, timeout=20)
        sandbox.call(work.slow, 0.4, timeout=20)
        assert [sandbox.call(work.pid, timeout=20) for _ in range(3)] == [first] * 3
    assert sandbox.call(work.request_of_another, timeout=20) == ("", b"")


def test_the_answer_to_another_request_ends_the_process(sandbox):
    for seconds in (0.0, 0.2):
        sandbox.call(work.forked, work.raw_fork, seconds, timeout=20)
        with pytest.raises(FaultError) as caught:
            _call_often(sandbox)
        assert caught.value.status == "crashed"
        assert caught.value.reason == "it gave the answer to another request; its process was ended"
        assert sandbox.call(work.echo, 1, timeout=20) == ("a context", (1,))


def _call_often(sandbox):
    for _ in range(20):
        sandbox.call(work.slow, 0.1, timeout=20)


def test_an_answer_has_to_name_what_was_requested_not_its_number_alone(sandbox):
    first, second = Sandbox("one", work.prepare), Sandbox("two", work.prepare)
    for each in (first, second):
        each.start()
    one, two = first._process, second._process
    assert one is not None
    assert two is not None
    one.answers, two.answers = two.answers, one.answers
    second_asked = threading.Thread(target=_call, args=(second, work.echo, 2))
    second_asked.start()
    with pytest.raises(FaultError, match="the answer to another request"):
        first.call(work.echo, 1, timeout=20)
    for each in (first, second):
        each.close()
    second_asked.join()


def _call(sandbox, *request):
    with contextlib.suppress(FaultError, ClosedError):
        sandbox.call(*request, timeout=20)


@pytest.mark.parametrize("end", ["closed", "died"])
@pytest.mark.parametrize("how", ["fork", "child", "own session", "clean environment"])
def test_what_a_solver_started_ends_with_its_sandbox(sandbox, how, end):
    if not Path("/proc/self/environ").exists() and how in ("fork", "own session"):
        pytest.skip("processes in sessions of their own are found in /proc")
    left = sandbox.call(work.leave_behind, how, timeout=20)
    assert psutil.pid_exists(left)
    if end == "closed":
        sandbox.close()
    else:
        _call(sandbox, work.die, signal.SIGKILL)
    assert _gone(left)


@pytest.mark.parametrize("end", ["closed", "late", "died"])
def test_what_a_solver_started_ends_with_its_sandbox_though_it_killed_the_guard(sandbox, end):
    sandbox.call(work.kill_the_guard, timeout=20)
    left = sandbox.call(work.leave_behind, "child", timeout=20)
    assert psutil.pid_exists(left)
    if end == "closed":
        sandbox.close()
    elif end == "died":
        _call(sandbox, work.die, signal.SIGABRT)
    else:
        with pytest.raises(FaultError, match=r"no answer within 0\.2 s"):
            sandbox.call(work.slow, 60, timeout=0.2)
    assert _gone(left)


def test_a_solver_finds_no_child_that_it_did_not_start(sandbox):
    assert sandbox.call(work.children, timeout=20) == ([], None)


@pytest.mark.parametrize(
    ("how", "reason"),
    [
        (work.hold_the_pipes_and_hang, "no answer within 1 s; its process was ended"),
        (work.hold_the_pipes_and_die, "its process died: SIGABRT"),
    ],
)
def test_nobody_waits_for_a_process_that_holds_the_pipes(tmp_path, how, reason):
    sandbox, holder, start = Sandbox(tmp_path / "holder", work.prepare), tmp_path / "holder", time.monotonic()
    try:
        with pytest.raises(FaultError) as caught:
            sandbox.call(how, timeout=1 if how is work.hold_the_pipes_and_hang else 50)
        assert caught.value.reason == reason
        assert time.monotonic() - start < 15
    finally:
        sandbox.close()
        os.kill(work.number_in(holder), signal.SIGKILL)


def test_a_process_that_was_halted_is_sent_on(sandbox):
    assert sandbox.call(work.halt, timeout=20) == "sent on"


def _script(*lines):
    """Run a script that has a sandbox `s`, in a process of its own, since what is tried is done to the caller."""
    start = (
        "import os, pathlib, signal, sys, threading, time\n"
        "from impact_xval.experiments.sweep.sandbox import Sandbox\n"
        "from tests.experiments import sandbox_work as w\n"
    )
    return subprocess.run(
        [sys.executable, "-c", start + "\n".join(lines)],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )


def test_time_in_which_the_caller_is_halted_is_no_time_of_the_solver():
    done = _script(
        "s = Sandbox(None, w.prepare); s.start()",
        "print(s.call(w.halt_the_caller, 3, timeout=2)); s.close()",
    )
    assert done.stdout == "answered\n", done.stderr


def test_a_request_that_was_interrupted_leaves_no_answer_behind():
    done = _script(
        "s = Sandbox(None, w.prepare); s.start()",
        "threading.Timer(0.3, lambda: os.kill(os.getpid(), signal.SIGINT)).start()",
        "try:\n    s.call(w.slow, 1, timeout=20)",
        "except KeyboardInterrupt:\n    print(s.call(w.echo, 1, timeout=20)); s.close()",
    )
    assert done.stdout == "(None, (1,))\n", done.stderr


def test_a_sandbox_in_another_ends_with_it_though_its_guard_was_killed():
    sandbox = Sandbox([], work.prepare)
    inner = sandbox.call(work.start_another_and_kill_the_guard, timeout=20)
    assert psutil.pid_exists(inner)
    sandbox.close()
    assert _gone(inner)


def test_it_does_not_outlive_a_killed_parent_whose_child_holds_the_pipe():
    done = _script(
        "s = Sandbox(None, w.prepare); print(s.call(w.pid, timeout=20), flush=True)",
        "if os.fork() == 0:\n    [os.close(end) for end in (1, 2)]\n    time.sleep(20)\n    os._exit(0)",
        "os.kill(os.getpid(), signal.SIGKILL)",
    )
    assert _gone(int(done.stdout))


def test_a_caller_without_children_to_wait_for_and_with_odd_places_of_modules_has_sandboxes_like_any():
    done = _script(
        "signal.signal(signal.SIGCHLD, signal.SIG_IGN); sys.path.append(pathlib.Path('.'))",
        "s = Sandbox(None, w.prepare); print(s.call(w.exit_code, timeout=20)); s.close()",
    )
    assert done.stdout == "1\n", done.stderr


def test_nobody_waits_for_whoever_does_not_read_standard_error():
    read, write = os.pipe()
    script = (
        "from impact_xval.experiments.sweep.sandbox import Sandbox\n"
        "from tests.experiments import sandbox_work as w; s = Sandbox(None, w.prepare); s.start()\n"
        "s.call(w.complain, 10_000, timeout=15); print('answered'); s.close()"
    )
    done = subprocess.run(
        [sys.executable, "-c", script],
        stdout=subprocess.PIPE,
        stderr=write,
        text=True,
        check=False,
        timeout=60,
    )
    os.close(read)
    os.close(write)
    assert done.stdout == "answered\n"


def test_an_answer_without_end_is_not_read_to_its_end(sandbox, monkeypatch):
    monkeypatch.setattr("impact_xval.experiments.sweep.sandbox._LARGEST", 10_000)
    with pytest.raises(FaultError, match="its answer cannot be read: OverflowError"):
        sandbox.call(work.echo, bytes(20_000), timeout=20)
    assert sandbox.call(work.echo, 1, timeout=20) == ("a context", (1,))


def test_what_cannot_be_sent_back_is_a_bug_and_no_death(sandbox):
    first = sandbox.call(work.pid, timeout=20)
    with pytest.raises(SandboxError, match="pickle"):
        sandbox.call(work.unsendable, timeout=20)
    assert sandbox.call(work.pid, timeout=20) == first


def test_a_process_that_reads_no_request_is_not_waited_for():
    process, start = _Process("import time; time.sleep(60)"), time.monotonic()
    process.send(bytes(1 << 22), start + 0.3)
    with pytest.raises(TimeoutError):
        process.answer_to(0, b"", None)
    process.end()
    assert time.monotonic() - start < 5


def test_a_crash_is_told_at_once_though_a_forked_process_goes_on(sandbox):
    sandbox.start()
    start = time.monotonic()
    with pytest.raises(FaultError, match="its process died: SIGABRT"):
        sandbox.call(work.leave_behind_and_die, timeout=60)
    assert time.monotonic() - start < 10


def test_what_a_solver_started_does_not_outlive_a_killed_caller():
    script = (
        "import os, signal; from impact_xval.experiments.sweep.sandbox import Sandbox\n"
        "from tests.experiments import sandbox_work as w; s = Sandbox(None, w.prepare)\n"
        "print(*(s.call(w.leave_behind, how, timeout=20) for how in ('fork', 'child')), s.call(w.pid, timeout=20),"
        " flush=True)\n"
        "os.kill(os.getpid(), signal.SIGKILL)"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=False, timeout=30
    )
    assert done.returncode == -signal.SIGKILL
    assert all(_gone(int(process)) for process in done.stdout.split())


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
