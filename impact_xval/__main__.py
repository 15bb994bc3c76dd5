"""The command ``impact-xval``, also as ``python -m impact_xval``."""

import contextlib
import os
import signal
import sys
from types import FrameType
from typing import Any, NoReturn

#: What ends a command: Ctrl-C, a scheduler of jobs, a terminal that is closed.
ENDS = (signal.SIGINT, signal.SIGTERM, *((signal.SIGHUP,) if hasattr(signal, "SIGHUP") else ()))
#: Seconds after which an interruption is raised again that was raised where nothing can be.
_AGAIN = 0.1


def entry() -> int:
    """Run the command line of this process, which a signal interrupts as Ctrl-C does, with a line and no traceback.

    Further signals are ignored while the command ends.
    """
    heard: list[int] = []
    over = False

    def interrupt(number: int, frame: FrameType | None) -> None:
        heard.append(number)
        if not (over or _is_ending(sys.exception())):
            raise KeyboardInterrupt

    def unraisable(what: Any) -> None:
        """Interrupt again where that came while an object was deleted, or C called back: Python drops it there."""
        if heard and _is_ending(what.exc_value):
            import threading

            again = threading.Timer(_AGAIN, _signal_main_thread, [heard[0]])
            again.daemon = True
            again.start()
        else:
            sys.__unraisablehook__(what)

    # SIG_IGN is left as it is, as by nohup. It is not set at the first signal, for Python prints a traceback where a
    # second one was on its way.
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
            # Python puts the handlers of the system back before its process is gone. Blocked first: where a signal
            # comes while it is told to be ignored, Python prints a traceback.
            if sys.platform != "win32":
                signal.pthread_sigmask(signal.SIG_BLOCK, ENDS)
            for number in ENDS:
                signal.signal(number, signal.SIG_IGN)
    except BaseException:
        if not heard:
            raise
        # Any exception: an extension module whose import is interrupted raises an ImportError of its own.
        print("impact-xval: interrupted", file=sys.stderr)
        code = 1
    if heard:
        _leave(code)
    return code


def _leave(code: int) -> NoReturn:
    """End the process without waiting for its threads, after an interruption.

    An import that was interrupted can leave its lock held, and another thread that imports the same then waits for it
    for ever; Python would wait for that thread.
    """
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):  # nobody reads it any more, or it is closed
            stream.flush()
    os._exit(code)


def _signal_main_thread(number: int) -> None:
    """Send a signal to the main thread: it wakes from a system call, except on Windows, which has no such call."""
    if sys.platform == "win32":
        signal.raise_signal(number)
    else:
        import threading

        signal.pthread_kill(threading.main_thread().ident or 0, number)


def _is_ending(handled: BaseException | None) -> bool:
    """Whether what is handled now is an interruption, or has come of one: then the command is about to end."""
    while handled is not None and not isinstance(handled, KeyboardInterrupt):
        handled = handled.__context__
    return handled is not None


if __name__ == "__main__":
    sys.exit(entry())
