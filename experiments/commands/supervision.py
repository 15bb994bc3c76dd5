"""The process a command runs in, and one above it that ends it: soon after Ctrl-C, SIGTERM or SIGHUP, whatever it does.

Python answers a signal between two of its own instructions; compiled code, which may work for minutes, has none. So
the command runs in a child, forked before anything heavy is imported, and the process that was started only waits. The
child is interrupted first, and says what it has to say; one that does not answer is killed.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
from collections.abc import Callable
from types import FrameType

#: Seconds for a command to answer a signal, and then to put away what it has begun.
_TO_ANSWER, _TO_END = 2, 30

#: Of Linux: the signal that a process gets when its parent is gone.
_PR_SET_PDEATHSIG = 1


def supervised(command: Callable[[], int]) -> int:
    """Run a command in a child process, and end it when this process is to end.

    Parameters
    ----------
    command : callable
        Returns the exit code; when it is to end, it gets a KeyboardInterrupt, once.

    Returns
    -------
    int
        The exit code; 1 where the child was killed or died, after a line that says so.
    """
    if not hasattr(os, "fork"):
        return command()
    supervisor = os.getpid()
    # One that is ignored from the start, as by nohup, stays so.
    ends = {
        number
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
        if signal.getsignal(number) != signal.SIG_IGN
    }
    signal.pthread_sigmask(signal.SIG_BLOCK, ends)
    child = os.fork()
    if child == 0:
        _end_with(supervisor)
        return _interruptible(command, ends, supervisor)
    return _wait_for(child, ends)


def _wait_for(child: int, ends: set[signal.Signals]) -> int:
    """Pass signals on to the child until it is gone; return its exit code."""
    interrupted = answered = False

    def pass_on(number: int, _: FrameType | None) -> None:
        nonlocal interrupted
        if not interrupted and not answered:
            signal.alarm(_TO_ANSWER)
        interrupted = True
        os.kill(child, number)  # a second time for a signal to the whole group, which changes nothing there

    def answer(*_: object) -> None:
        nonlocal answered
        answered = True
        signal.alarm(_TO_END)

    for number in ends:
        signal.signal(number, pass_on)
    signal.signal(signal.SIGUSR1, answer)
    signal.signal(signal.SIGALRM, lambda *_: os.kill(child, signal.SIGKILL))
    signal.pthread_sigmask(signal.SIG_UNBLOCK, ends)
    os.waitid(os.P_PID, child, os.WEXITED | os.WNOWAIT)  # until it is waited for, its number is nobody else's
    signal.pthread_sigmask(signal.SIG_BLOCK, {*ends, signal.SIGALRM})
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if code >= 0:
        return code
    return _ended("interrupted" if interrupted else f"its process died: {signal.Signals(-code).name}")


def _interruptible(command: Callable[[], int], ends: set[signal.Signals], supervisor: int) -> int:
    """Run a command that gets a KeyboardInterrupt on the first signal, which is answered; others change nothing."""
    interrupted = False

    def interrupt(number: int, _: FrameType | None) -> None:
        nonlocal interrupted
        if interrupted:
            return
        interrupted = True
        if os.getppid() == supervisor:
            os.kill(supervisor, signal.SIGUSR1)
        raise KeyboardInterrupt

    for number in ends:
        signal.signal(number, interrupt)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, ends)
    try:
        return command()
    except (Exception, KeyboardInterrupt):  # a compiler, interrupted, makes of it what it likes
        if not interrupted:
            raise
        return _ended("interrupted")
    finally:  # the interpreter puts the default of SIGINT back when it ends, and a second one would count as a death
        signal.pthread_sigmask(signal.SIG_BLOCK, ends)
        for number in ends:  # other threads have no mask
            signal.signal(number, signal.SIG_IGN)


def _ended(how: str) -> int:
    print(f"impact-xval: {how}", file=sys.stderr)
    return 1


def _end_with(supervisor: int) -> None:
    """Have this process killed when its supervisor is, on Linux."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != supervisor:  # it was before
            os._exit(1)
