"""The command ``impact-xval``; ``python -m impact_xval`` runs it too."""

import contextlib
import os
import signal
import sys
from types import FrameType
from typing import Any, NoReturn

#: Signals that end a command: of Ctrl-C, of a scheduler of jobs, of a closed terminal.
ENDS = (signal.SIGINT, signal.SIGTERM, *((signal.SIGHUP,) if hasattr(signal, "SIGHUP") else ()))
#: Seconds after which an interruption is raised again if Python had to drop it.
_AGAIN = 0.1


def entry() -> int:
    """Run the command line of this process.

    Every signal of `ENDS` interrupts it as Ctrl-C does: with one line, without a traceback. Further signals are ignored
    while the command ends.
    """
    heard: list[int] = []
    over = False

    def interrupt(number: int, frame: FrameType | None) -> None:
        heard.append(number)
        if not (over or _is_ending(sys.exception())):
            raise KeyboardInterrupt

    def unraisable(what: Any) -> None:
        """Repeat an interruption that Python has dropped, in the deletion of an object or in a callback from C."""
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
        # Any exception may come of an interruption: an extension module whose import is interrupted raises an
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
    """Send a signal to the main thread, so that it wakes from a system call; Windows has no such wake-up."""
    if sys.platform == "win32":
        signal.raise_signal(number)
    else:
        import threading

        signal.pthread_kill(threading.main_thread().ident or 0, number)


def _is_ending(handled: BaseException | None) -> bool:
    """Return whether an exception is an interruption or has come of one; the command is then about to end."""
    while handled is not None and not isinstance(handled, KeyboardInterrupt):
        handled = handled.__context__
    return handled is not None


if __name__ == "__main__":
    sys.exit(entry())
