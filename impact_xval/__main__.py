"""The command ``impact-xval``, also as ``python -m impact_xval``."""

import os
import signal
import sys
from types import FrameType

#: What ends a command: Ctrl-C, a scheduler of jobs, a terminal that is closed.
ENDS = (signal.SIGINT, signal.SIGTERM, *((signal.SIGHUP,) if hasattr(signal, "SIGHUP") else ()))


def entry() -> int:
    """Run the command line of this process, which a signal interrupts as Ctrl-C does, once."""
    heard = [number for number in ENDS if signal.getsignal(number) != signal.SIG_IGN]  # as by nohup

    def interrupt(number: int, frame: FrameType | None) -> None:
        for each in heard:
            signal.signal(each, signal.SIG_IGN)
        raise KeyboardInterrupt

    for number in heard:
        signal.signal(number, interrupt)
    try:
        from impact_xval.experiments.commands.cli import main
        from impact_xval.experiments.sweep.process import NO_WINDOW

        os.environ.update(NO_WINDOW | os.environ)
        return main()
    except KeyboardInterrupt:
        print("impact-xval: interrupted", file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(entry())
