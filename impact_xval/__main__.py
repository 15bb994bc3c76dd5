"""Entry point of the command ``impact-xval`` and of ``python -m impact_xval``, and its handling of signals."""

import contextlib
import os
import signal
import sys
from types import FrameType
from typing import Any, NoReturn

#: Signals that end a command. They come from Ctrl-C, from a scheduler of jobs, and from a terminal that is closed.
ENDS = (signal.SIGINT, signal.SIGTERM, *((signal.SIGHUP,) if hasattr(signal, "SIGHUP") else ()))
#: Seconds after which an interruption that Python has dropped is sent again.
_AGAIN = 0.1


def entry() -> int:
    """Run the command line of this process, and return its exit code.

    Every signal in `ENDS` has the effect of Ctrl-C: the command ends with one line and without a traceback. Further
    signals are ignored while the command ends.
    """
    heard: list[int] = []
    over = False

    def interrupt(number: int, frame: FrameType | None) -> None:
        heard.append(number)
        if not (over or _is_ending(sys.exception())):
            raise KeyboardInterrupt

    def unraisable(what: Any) -> None:
        """Send an interruption again if Python has dropped it.

        Python drops exceptions that are raised while an object is deleted, or in a callback from C.
        """
        if heard and _is_ending(what.exc_value):
            import threading

            again = threading.Timer(_AGAIN, _signal_main_thread, [heard[0]])
            again.daemon = True
            again.start()
        else:
            sys.__unraisablehook__(what)

    # A signal that is ignored already, as nohup does, stays ignored. The handlers stay in place at the first signal: if
    # they were set to SIG_IGN while a second signal is on its way, Python would print a traceback.
    for number in ENDS:
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, interrupt)
    sys.unraisablehook = unraisable
    try:
        try:
            from impact_xval.experiments.commands.cli import main
            from impact_xval.experiments.sweep.process import NO_WINDOW

            os.environ.update(NO_WINDOW | os.environ)
            code = main()
        finally:
            over = True
            # Python restores the handlers of the system before its process ends, so signals are ignored from here on.
            # They are blocked first: if a signal comes just when it is set to be ignored, Python prints a traceback.
            if sys.platform != "win32":
                signal.pthread_sigmask(signal.SIG_BLOCK, ENDS)
            for number in ENDS:
                signal.signal(number, signal.SIG_IGN)
    except BaseException:
        if not heard:
            raise
        # An interruption may surface as any exception: an extension module whose import is interrupted raises an
        # ImportError.
        print("impact-xval: interrupted", file=sys.stderr)
        code = 1
    if heard:
        _leave(code)
    return code


def _leave(code: int) -> NoReturn:
    """End the process without waiting for its threads, after an interruption.

    An interrupted import may never release its lock. Another thread that imports the same module then waits for ever,
    and Python would wait for that thread.
    """
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):  # the stream may be closed, or have no reader any more
            stream.flush()
    os._exit(code)


def _signal_main_thread(number: int) -> None:
    """Send a signal to the main thread, so that the thread wakes from a system call.

    On Windows the signal is raised in this process, and no thread wakes.
    """
    if sys.platform == "win32":
        signal.raise_signal(number)
    else:
        import threading

        signal.pthread_kill(threading.main_thread().ident or 0, number)


def _is_ending(handled: BaseException | None) -> bool:
    """Return whether an exception is a KeyboardInterrupt, or was raised while one was handled.

    In both cases the command is about to end.
    """
    while handled is not None and not isinstance(handled, KeyboardInterrupt):
        handled = handled.__context__
    return handled is not None


if __name__ == "__main__":
    sys.exit(entry())
