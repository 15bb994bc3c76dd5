"""A command that is deaf to signals, as compiled code is, ends all the same; the others say what they have to say."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

ROOT = Path(__file__).parents[3]

#: Bodies of a command; a loop of C looks for no signal.
DEAF = 'start(); hashlib.pbkdf2_hmac("sha256", b"", b"", 10**9)'
WILLING = """
    try:
        start()
        time.sleep(120)
    except KeyboardInterrupt:
        time.sleep(4)
        print("put away", flush=True)
        return 1
"""


#: Swallows what it gets once, as libraries do; in a callback of compiled code nobody can catch it.
DEAF_ONCE = """
    try:
        start()
        time.sleep(60)
    except KeyboardInterrupt:
        pass
    time.sleep(60)
"""
DEAF_IN_A_CALLBACK = """
    class Slow:
        def __del__(self):
            time.sleep(60)
    start()
    Slow()
    time.sleep(60)
"""
DEAF_TO_THE_END = """
    try:
        start()
        time.sleep(60)
    except KeyboardInterrupt:
        return 0
"""
AN_EXIT = """
    try:
        start()
        time.sleep(60)
    except KeyboardInterrupt:
        sys.exit(130)
"""

SAYS_SO = """
    from impact_xval.experiments.commands.cli import _fail
    start()
    try:
        time.sleep(60)
    except KeyboardInterrupt:
        pass
    code = _fail("interrupted", 1)
    time.sleep(1.2)
    return code
"""

#: What an interrupt leaves half made breaks where nothing can be raised.
BREAKS = """
    import threading
    class Half:
        def __del__(self):
            self.missing
    start()
    try:
        time.sleep(60)
    except KeyboardInterrupt:
        Half()
        broken = threading.Thread(target=lambda: 1 / 0)
        broken.start()
        broken.join()
        sys.excepthook(*sys.exc_info())  # as generated C code does
"""


def _start(body, stderr=subprocess.PIPE, **how):
    script = (
        "import hashlib, os, sys, time\n"
        "from impact_xval.experiments.commands.supervision import supervised\n"
        "def start():\n    print(os.getpid(), flush=True)\n"
        f"def command():\n    {body.strip()}\n    return 0\n"
        "sys.exit(supervised(command))"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", script],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=stderr,
        text=True,
        **how,
    )
    return process, int(process.stdout.readline())


@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_compiled_code_ends_at_once(end):
    process, child = _start(DEAF, start_new_session=True)
    began = sum(psutil.Process(child).cpu_times()[:2])
    while sum(psutil.Process(child).cpu_times()[:2]) < began + 0.3:  # by now it is in the loop
        time.sleep(0.05)
    start = time.monotonic()
    os.killpg(process.pid, end)
    said, error = process.communicate(timeout=30)
    assert time.monotonic() - start < 5
    assert (process.returncode, said, error) == (
        1,
        "",
        "impact-xval: interrupted\n",
    )
    assert not psutil.pid_exists(child)


@pytest.mark.slow
@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_what_answers_may_put_away_what_it_has_begun(end):
    process, _ = _start(WILLING, start_new_session=True)
    for _ in range(3):  # what comes after the first changes nothing
        os.killpg(process.pid, end)
        time.sleep(0.3)
    said, error = process.communicate(timeout=30)
    assert (process.returncode, said, error) == (1, "put away\n", "")


@pytest.mark.parametrize(
    "body", ["start(); time.sleep(60)", DEAF_ONCE, DEAF_IN_A_CALLBACK, DEAF_TO_THE_END, AN_EXIT]
)
def test_an_interrupt_that_is_swallowed_comes_again_and_is_told_once(body):
    process, _ = _start(body)
    start = time.monotonic()
    for _ in range(2):
        process.send_signal(signal.SIGHUP)
        time.sleep(0.05)
    said, error = process.communicate(timeout=30)
    assert time.monotonic() - start < 10
    assert (process.returncode, said, error) == (1, "", "impact-xval: interrupted\n")


def test_what_says_its_last_line_is_not_interrupted_again():
    process, _ = _start(SAYS_SO)
    process.send_signal(signal.SIGTERM)
    said, error = process.communicate(timeout=30)
    assert (process.returncode, said, error) == (1, "", "impact-xval: interrupted\n")


@pytest.mark.parametrize("body", ["start(); time.sleep(60)", SAYS_SO, DEAF])
def test_a_pipe_that_nobody_reads_keeps_no_command_from_its_end(body):
    read, write = os.pipe()
    os.set_blocking(write, False)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(write, b"x" * 4096)
    os.set_blocking(write, True)
    process, _ = _start(body, stderr=write)
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=20)
    assert process.returncode == 1
    os.close(read)
    os.close(write)


def test_nothing_is_said_of_what_an_interrupt_breaks():
    process, _ = _start(BREAKS)
    process.send_signal(signal.SIGTERM)
    said, error = process.communicate(timeout=30)
    assert (process.returncode, said, error) == (1, "", "impact-xval: interrupted\n")


def test_a_signal_while_the_command_is_imported_is_answered():
    script = "import sys; from impact_xval.__main__ import entry; print(flush=True); entry()"
    loaded = "print(sorted({'typer', 'numpy', 'ctypes'} & set(sys.modules)), file=sys.stderr)"
    process = subprocess.Popen(
        [sys.executable, "-c", script.replace("print(flush=True)", f"print(flush=True); {loaded}"), "status", "/"],
        cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    process.stdout.readline()
    while not psutil.Process(process.pid).children():
        time.sleep(0.001)
    process.send_signal(signal.SIGTERM)
    said, error = process.communicate(timeout=30)
    assert (said, error) == ("", "[]\nimpact-xval: interrupted\n")


def test_a_death_is_told_in_one_line():
    process, _ = _start("start(); os.abort()")
    _, error = process.communicate(timeout=30)
    assert process.returncode == 1
    assert error.splitlines()[-1] == "impact-xval: its process died: SIGABRT"


def test_a_parent_that_ignores_the_death_of_children_changes_nothing():
    code = (
        "import os, signal, sys; signal.signal(signal.SIGCHLD, signal.SIG_IGN);"
        "os.execv(sys.executable, [sys.executable, '-c', 'import sys; "
        "from impact_xval.experiments.commands.supervision import supervised; sys.exit(supervised(lambda: 3))'])"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (3, "")


@pytest.mark.parametrize("late", ["", "os.waitid(os.P_PID, child, os.WEXITED | os.WNOWAIT)"])
def test_a_signal_that_waits_for_the_command_is_answered(late):
    code = (
        "import os, signal, sys; from impact_xval.experiments.commands import supervision\n"
        "wait_for = supervision._wait_for\n"
        f"def wait_late(child, ends):\n    {late or None}\n    return wait_for(child, ends)\n"
        "supervision._wait_for = wait_late\n"
        "end_with = supervision._end_with\n"
        "def pending(supervisor):\n    end_with(supervisor)\n    os.kill(os.getpid(), signal.SIGTERM)\n"
        "supervision._end_with = pending\n"
        "sys.exit(supervision.supervised(lambda: 0))"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (1, "impact-xval: interrupted\n")


def test_the_exit_code_is_the_commands():
    process, _ = _start("start(); return 3")
    assert process.communicate(timeout=30)
    assert process.returncode == 3


def test_a_signal_ignored_from_the_start_stays_so():
    process, child = _start(
        "start(); time.sleep(1)", preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_IGN)
    )
    for each in (child, process.pid):
        os.kill(each, signal.SIGHUP)
    assert process.communicate(timeout=30) == ("", "")
    assert process.returncode == 0


@pytest.mark.skipif(sys.platform != "linux", reason="the death of a parent is a signal on Linux")
def test_a_command_does_not_outlive_the_process_that_was_started():
    process, child = _start(DEAF)
    child = psutil.Process(child)
    process.kill()
    process.communicate()
    child.wait(timeout=5)
