"""The process a command runs in, and one above it that ends it: soon after Ctrl-C, SIGTERM or SIGHUP, whatever it does.

Python answers a signal between two of its own instructions; compiled code, which may work for minutes, has none. So
the command runs in a child, forked before anything heavy is imported, and the process that was started only waits. The
child is interrupted first, and says what it has to say; one that does not answer is killed.

A library may catch the KeyboardInterrupt and go on. It is raised again as long as the last one is nowhere handled any
more, until the command has begun to say what it has to say (`last_word`); and a command that was interrupted has not
succeeded, whatever it returns.
"""

from __future__ import annotations

import os
import select
import signal
import sys
import threading
import weakref
from collections.abc import Callable
from types import FrameType
from typing import TextIO

#: Seconds for a command to answer a signal, and then to put away what it has begun.
_TO_ANSWER, _TO_END = 2, 30

#: Seconds after which it is looked whether a KeyboardInterrupt got lost.
_AGAIN = 0.5

#: Signals that interrupt the command of this process; none where it is not `supervised`.
_heard: set[signal.Signals] = set()

#: Of Linux: the signal that a process gets when its parent is gone.
_PR_SET_PDEATHSIG = 1


def open_streams() -> None:
    """Have what is written to a stream that was closed go nowhere: not to another, nor to the next file opened."""
    for number, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        if getattr(sys, name) is None:
            os.dup2(os.open(os.devnull, os.O_RDWR), number)
            os.set_inheritable(number, True)
            setattr(sys, name, os.fdopen(number, mode))


def supervised(command: Callable[[], int]) -> int:
    """Run a command in a child process, and end it when this process is to end.

    Parameters
    ----------
    command : callable
        Returns the exit code; when it is to end, it gets a KeyboardInterrupt, and again if that got lost.

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
    # One side may be told to end, and the other that it does (SIGUSR1), before it is ready.
    signal.pthread_sigmask(signal.SIG_BLOCK, {*ends, signal.SIGUSR1})
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)  # where it is ignored, no exit code is left for anybody
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
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {*ends, signal.SIGUSR1})
    if hasattr(os, "waitid"):  # until it is waited for, its number is nobody else's
        os.waitid(os.P_PID, child, os.WEXITED | os.WNOWAIT)
    signal.pthread_sigmask(signal.SIG_BLOCK, {*ends, signal.SIGALRM})
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if code >= 0:
        return code
    return _ended("interrupted" if interrupted else f"its process died: {signal.Signals(-code).name}")


class _Interrupt(KeyboardInterrupt):
    """A KeyboardInterrupt of which one can tell whether it is still being handled."""


def _interruptible(command: Callable[[], int], ends: set[signal.Signals], supervisor: int) -> int:
    """Run a command that gets a KeyboardInterrupt on the first signal, which is answered, until it ends of one."""
    handled: Callable[[], _Interrupt | None] | None = None

    def interrupt(number: int, _: FrameType | None) -> None:
        nonlocal handled
        if handled is None:
            if os.getppid() == supervisor:
                os.kill(supervisor, signal.SIGUSR1)
            sys.unraisablehook = sys.excepthook = threading.excepthook = _say_nothing
            signal.signal(signal.SIGALRM, interrupt)
            signal.setitimer(signal.ITIMER_REAL, _AGAIN, _AGAIN)
        elif handled() is not None:
            return
        error = _Interrupt()
        handled = weakref.ref(error)
        try:
            raise error
        finally:
            del error  # which its traceback would keep alive

    for number in ends:
        signal.signal(number, interrupt)
    _heard.update(ends)
    try:
        try:
            signal.pthread_sigmask(signal.SIG_UNBLOCK, {*ends, signal.SIGUSR1})
            code = command()
        finally:
            _hear_no_more()
    except BaseException:  # a compiler, interrupted, makes of it what it likes, and a library an exit
        if handled is None:
            raise
        code = 0
    if handled is None:
        return code
    return 1 if code else _ended("interrupted")  # another code: it has said so


def last_word(text: str) -> None:
    """Say the last line of a command, if standard error takes one within a second, and be interrupted no more."""
    _hear_no_more()
    if _takes_a_line(sys.stderr):
        print(f"impact-xval: {text}\n", end="", file=sys.stderr)  # in one piece, or not at all


def _takes_a_line(stream: TextIO) -> bool:
    """Whether a stream takes some hundred letters: nobody may read what comes out of a pipe that is full."""
    try:
        ready = select.poll()
        ready.register(stream.fileno(), select.POLLOUT)
        return bool(ready.poll(1000))
    except (AttributeError, OSError, ValueError):  # no such thing there
        return True


def _hear_no_more() -> None:
    """Have a command that is supervised interrupted no more: it says its last line, or is over."""
    if _heard:
        signal.setitimer(signal.ITIMER_REAL, 0)
        # The interpreter puts the default of SIGINT back when it ends, and a second one would count as a death.
        signal.pthread_sigmask(signal.SIG_BLOCK, {*_heard, signal.SIGALRM})
        for number in _heard:  # other threads have no mask
            signal.signal(number, signal.SIG_IGN)


def _say_nothing(*_: object) -> None:
    """Print nothing of what breaks where an interrupt cannot be raised, nor of what it left half made.

    It is raised again, and the command says that it was interrupted.
    """


def _ended(how: str) -> int:
    last_word(how)
    return 1


def _end_with(supervisor: int) -> None:
    """Have this process killed when its supervisor is, on Linux."""
    if sys.platform == "linux":
        import ctypes

        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != supervisor:  # it was before
            os._exit(1)
