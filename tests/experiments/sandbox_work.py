"""Work for sandboxes, at the top level of a light module: quick to start."""

import os
import signal
import sys
import time


def prepare(context, *, beat):
    if context == "dies at once" and not os.environ.get("NEVER"):
        os._exit(7)
    return f"prepared with {context}"


def echo(context, *values, beat):
    return context, values


def pid(context, *, beat):
    return os.getpid()


def slow_steps(context, steps, seconds, *, beat):
    for step in range(steps):
        beat(f"step {step}")
        time.sleep(seconds)
    return "through"


def die(context, how, *, beat):
    beat("about to")
    if how == "exit":
        sys.exit(5)
    os.kill(os.getpid(), how)
    time.sleep(60)


def fail(context, *, beat):
    raise ValueError("a bug")


def chatter(context, *, beat):
    os.write(1, b"an engine says hello\n" * 1000)
    print("and so does Python")
    return "still understood"


def threads(context, *, beat):
    return os.environ["NUMBA_NUM_THREADS"], os.environ["OMP_NUM_THREADS"]


def ctrl_c(context, *, beat):
    os.kill(os.getpid(), signal.SIGINT)
    return "unmoved"
