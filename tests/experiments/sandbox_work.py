"""Work for sandboxes, at the top level of a light module: quick to start."""

import contextlib
import ctypes
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil

from impact_xval.experiments.sweep.sandbox import Sandbox


def prepare(context):
    if context == "dies at once" and not os.environ.get("NEVER"):
        os._exit(7)
    return f"prepared with {context}"


def echo(context, *values):
    return context, values


def pid(context):
    return os.getpid()


def window_system(context):
    """Tell whether MuJoCo has looked for a window, which starts a process."""
    import mujoco  # noqa: F401

    return "glfw" in sys.modules


def slow(context, seconds):
    time.sleep(seconds)
    return "through"


def die(context, how):
    if how == "exit":
        sys.exit(5)
    os.kill(os.getpid(), how)
    time.sleep(60)


def forked(context, how, seconds):
    """Fork a process that comes back from here as well, later; give the process that it is."""
    if how() == 0:
        time.sleep(seconds)
    return os.getpid()


def raw_fork():
    """Fork unknown to Python, as a library of C may."""
    return ctypes.PyDLL(None).fork()


def leave_behind(context, how, seconds=120):
    """Start a process that goes on; give its number."""
    keep = {name: value for name, value in os.environ.items() if how != "clean environment"}
    code = f"import time; time.sleep({seconds})"
    if how == "fork":
        child = os.fork()
        if child == 0:
            os.setsid()
            time.sleep(seconds)
            os._exit(0)
        return child
    return subprocess.Popen(
        [sys.executable, "-c", code], env=keep, start_new_session=how == "own session"
    ).pid


def kill_the_guard(context):
    """End what stands beside this process, and was not started by a solver."""
    mark = os.environ["IMPACT_XVAL_SANDBOX"]
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error):
            if process.pid != os.getpid() and process.environ().get("IMPACT_XVAL_SANDBOX") == mark:
                process.kill()


def children(context):
    """Children of this process, as two ways tell."""
    try:
        return psutil.Process().children(), os.wait()
    except ChildProcessError:
        return psutil.Process().children(), None


def hold_the_pipes_and_hang(context):
    """Kill the guard, and hold the pipes in a process nobody knows; its number is in a file."""
    kill_the_guard(context)
    if raw_fork() == 0:
        os.setsid()
        Path(context).write_text(str(os.getpid()))
    time.sleep(60)


def hold_the_pipes_and_die(context):
    """As `hold_the_pipes_and_hang`, but the process dies."""
    kill_the_guard(context)
    if raw_fork() == 0:
        os.setsid()
        Path(context).write_text(str(os.getpid()))
        time.sleep(60)
    number_in(context)
    os.abort()


def number_in(path):
    """Wait for a number that another process writes to a file."""
    until = time.monotonic() + 20
    while not (path.exists() and path.read_text()) and time.monotonic() < until:
        time.sleep(0.01)
    return int(path.read_text())


def start_another_and_kill_the_guard(context):
    """Start a sandbox in this one, then end what stands beside this one; give the number of the other's process."""
    context.append(Sandbox(None, prepare))
    number = context[-1].call(pid, timeout=20)
    kill_the_guard(context)
    return number


def halt_the_caller(context, seconds):
    """Answer while the caller is halted, for a while."""
    caller = os.getppid()
    os.kill(caller, signal.SIGSTOP)
    subprocess.Popen([sys.executable, "-c", f"import os, time; time.sleep({seconds}); os.kill({caller}, 18)"])
    return "answered"


def exit_code(context):
    return subprocess.run(["false"], check=False).returncode


def halt(context):
    os.kill(os.getpid(), signal.SIGSTOP)
    return "sent on"


def leave_behind_and_die(context):
    leave_behind(context, "fork")
    os.abort()


def request_of_another(context):
    """Read what a sandbox is sent."""
    return sys.stdin.read(), subprocess.run(["cat"], capture_output=True, check=True).stdout


def fail(context):
    raise ValueError("a bug")


def chatter(context):
    os.write(1, b"an engine says hello\n" * 1000)
    print("and so does Python")
    return "still understood"


def complain(context, times):
    os.write(2, b"\x1b[31mred\x07 \xff and r\xc3\xb6d\n" * times)
    os.write(2, b"at last")


def threads(context):
    return os.environ["NUMBA_NUM_THREADS"], os.environ["OMP_NUM_THREADS"]


def masked(context):
    return [int(number) for number in signal.pthread_sigmask(signal.SIG_BLOCK, [])]


def ctrl_c(context):
    os.kill(os.getpid(), signal.SIGINT)
    return "unmoved"


class Unreadable:
    """What can be sent to another process and not be read there."""

    def __reduce__(self):
        return fail, (None,)


class Named:
    """What may be sent."""


def made(context, name):
    return globals()[name]()


def unsendable(context):
    return lambda: None
