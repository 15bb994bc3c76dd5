"""Work for sandboxes, at the top level of a light module: quick to start."""

import os
import signal
import sys
import time


def prepare(context):
    if context == "dies at once" and not os.environ.get("NEVER"):
        os._exit(7)
    return f"prepared with {context}"


def echo(context, *values):
    return context, values


def pid(context):
    return os.getpid()


def slow(context, seconds):
    time.sleep(seconds)
    return "through"


def die(context, how):
    if how == "exit":
        sys.exit(5)
    os.kill(os.getpid(), how)
    time.sleep(60)


def fail(context):
    raise ValueError("a bug")


def chatter(context):
    os.write(1, b"an engine says hello\n" * 1000)
    print("and so does Python")
    return "still understood"


def threads(context):
    return os.environ["NUMBA_NUM_THREADS"], os.environ["OMP_NUM_THREADS"]


def ctrl_c(context):
    os.kill(os.getpid(), signal.SIGINT)
    return "unmoved"


class Unreadable:
    """What can be sent to another process and not be read there."""

    def __reduce__(self):
        return fail, (None,)
