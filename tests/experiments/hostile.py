"""Solvers that do to a sweep what a plug-in might: each kind at a cell of its own, known by its e1.

Most kinds give an outcome that is none; some raise what is no `Exception`; some harm their process.
"""

import collections
import dataclasses
import os
import signal
import sys
import threading
import time
from pathlib import Path

import numpy as np

from impact_xval.compliant_baselines import get_solver
from impact_xval.model import Outcome
from impact_xval.model.collision import Event
from tests.experiments.fakes import Shifted

_MEGABYTE = "\x1b[31mred " * 125_000


class Anything:
    """No outcome, although it has a status."""

    status = "ok"


class Secretive(Outcome):
    """An outcome that cannot be read."""

    __slots__ = ()

    @property
    def v1(self):  # pyright: ignore[reportIncompatibleVariableOverride]
        raise RuntimeError("not for your eyes")


class UnspeakableError(Exception):
    def __str__(self):
        raise ValueError("no words")


class Escape(BaseException):
    """What `except Exception` does not catch."""


def _changed(**values):
    return lambda outcome: dataclasses.replace(outcome, **values)


def _secretive(outcome):
    made = object.__new__(Secretive)
    for one in dataclasses.fields(outcome):
        if one.name != "v1":
            object.__setattr__(made, one.name, getattr(outcome, one.name))
    return made


def _diagnostics(**values):
    return lambda outcome: dataclasses.replace(outcome, diagnostics=values)


def _path(**values):
    def change(outcome):
        made = {name: make(getattr(outcome.path, name)) for name, make in values.items()}
        return dataclasses.replace(outcome, path=dataclasses.replace(outcome.path, **made))

    return change


def _failed(reason):
    return _changed(status="unconverged", reason=reason)


def _raising(error):
    def act(outcomes):
        raise error

    return act


def _recurse(outcomes):
    return _recurse(outcomes)


def _empty_path(outcomes):
    sys.path.clear()
    return outcomes


def _no_path(outcomes):
    sys.path = None  # pyright: ignore[reportAttributeAccessIssue]
    return outcomes


def _print(outcomes):
    print("to stdout", flush=True)
    print("to stderr", file=sys.stderr, flush=True)
    os.write(1, b"to descriptor 1\n")
    return outcomes


def _close(outcomes):
    for stream in range(3):
        os.close(stream)
    return outcomes


def _close_all(outcomes):
    os.closerange(0, 1000)
    return outcomes


def _leave(outcomes):
    os.chdir("/")
    return outcomes


def _exit(outcomes):
    os._exit(3)


def _kill(outcomes):
    os.kill(os.getpid(), signal.SIGKILL)


def _thread(outcomes):
    threading.Thread(target=time.sleep, args=(3600,)).start()
    return outcomes


def _fork(outcomes):
    """Leave a child that works on for a while, with every pipe of its parent open."""
    if os.fork() == 0:
        time.sleep(20)
        os._exit(0)
    return outcomes


def _fork_and_return(outcomes):
    """Come out twice: as the parent, and as a child that answers too."""
    os.fork()
    return outcomes


#: Of one outcome: what is made of it, then the status and what the reason says; a status of ok has no reason.
OUTCOMES = {
    "v1 a text": (_changed(v1="0.5"), "crashed", "v1 is of type str; legal: a number"),
    "v1 None": (_changed(v1=None), "crashed", "v1 is of type NoneType; legal: a number"),
    "v1 an array": (_changed(v1=np.array([0.5])), "crashed", "v1 is of type ndarray; legal: a number"),
    "v1 a truth value": (_changed(v1=True), "crashed", "v1 is of type bool; legal: a number"),
    "v1 complex": (_changed(v1=0.5 + 0j), "crashed", "v1 is of type complex; legal: a number"),
    "v1 huge": (_changed(v1=1e300), "crashed", "their energy overflows"),
    "v1 a huge integer": (_changed(v1=10**400), "crashed", "v1 leaves double precision"),
    "v1 nan": (_changed(v1=float("nan")), "crashed", "but v1, v2, impulse1, impulse2 = (nan,"),
    "impulse huge": (_changed(impulse1=1.7e308), "crashed", "dimpulse1 = 1.7e+308; legal: at most"),
    "numpy scalars": (
        lambda o: dataclasses.replace(o, v1=np.float64(o.v1), v2=np.float32(0.25), n_events=np.int64(3)),
        "ok",
        None,
    ),
    "states numbers": (_changed(states=(1, 4)), "crashed", "states; legal: a tuple of text"),
    "states None": (_changed(states=None), "crashed", "states; legal: a tuple of text"),
    "states of its own": (_changed(states=("S1", "\x1b[2J")), "crashed", "legal: S1, S2, S3, S4"),
    "status unknown": (_changed(status="fine"), "crashed", "status = 'fine'; legal: ok, limit"),
    "status a number": (_changed(status=0), "crashed", "status is of type int; legal: text"),
    "reason a list": (_failed(["slow"]), "crashed", "reason is of type list; legal: text"),
    "reason bytes": (_failed(b"slow"), "crashed", "reason is of type bytes; legal: text"),
    "reason a surrogate": (_failed("half \ud800 of it"), "unconverged", r"half \ud800 of it"),
    "reason escapes": (_failed("\x1b[31mred\x07\nand \u202eback"), "unconverged", r"\x1b[31mred\x07 and"),
    "reason a megabyte": (_failed(_MEGABYTE), "unconverged", r"\x1b[31mred"),
    "marked a number": (_changed(marked=1), "crashed", "marked is of type int; legal: text"),
    "n_steps huge": (
        _diagnostics(n_steps=10**30),
        "crashed",
        "diagnostics['n_steps'] = 1e+30; legal: a whole",
    ),
    "n_steps nan": (
        _diagnostics(n_steps=float("nan")),
        "crashed",
        "diagnostics['n_steps'] = nan; legal: a w",
    ),
    "n_steps negative": (_diagnostics(n_steps=-1), "crashed", "diagnostics['n_steps'] = -1; legal: a whole"),
    "n_events huge": (_changed(n_events=2**70), "crashed", "n_events is less than 0 or more than 2^53"),
    "limit huge": (_diagnostics(v1_limit=1e308, v2_limit=-1e308), "crashed", "v1_limit = 1e+308; legal: at"),
    "limit nan": (_diagnostics(limit_error=float("nan")), "crashed", "limit_error = nan; legal: at most"),
    "diagnostics a list": (_changed(diagnostics=[1]), "crashed", "diagnostics is of type list; legal: a map"),
    "diagnostics by number": (
        _changed(diagnostics={1: 2.0}),
        "crashed",
        "diagnostics: a key; legal: printable",
    ),
    "diagnostics texts": (
        _diagnostics(step="1 ms"),
        "crashed",
        "diagnostics['step'] is of type str; legal: a",
    ),
    "diagnostics a lock": (
        _diagnostics(step=threading.Lock()),
        "crashed",
        "diagnostics['step'] is of type lock",
    ),
    "events of texts": (
        _changed(events=(Event("return", 1, "S1", "soon", 0.0, 0.0, 0.0, 0.0),)),
        "crashed",
        "events.time is of type str; legal: a number",
    ),
    "events that cannot be sent": (
        _changed(events=(Event("return", threading.Lock(), "S1", *5 * [0.0]),)),
        "crashed",
        "events.contact is of type lock; legal: a whole number",
    ),
    "events none": (_changed(events=[None]), "crashed", "events; legal: a tuple of Event"),
    "path a list": (_changed(path=[0.0]), "crashed", "path is of type list; legal: ImpulseCurve or None"),
    "path of two lengths": (_path(v1=lambda v: v[1:]), "crashed", "path has shapes"),
    "path empty": (
        lambda o: dataclasses.replace(
            o, path=dataclasses.replace(o.path, **{f: np.zeros(0, int) for f in o.path.__slots__})
        ),
        "crashed",
        "legal: one (n,), n >= 1",
    ),
    "path not finite": (
        _path(impulse1=lambda i: i * float("nan")),
        "crashed",
        "path.impulse1 holds a number that is not finite",
    ),
    "path huge": (
        _path(impulse1=lambda i: np.where(i > 0, 1.7e308, -1.7e308)),
        "crashed",
        "measuring its outcome: ",
    ),
    "path of objects": (
        _path(v2=lambda v: v.astype(object)),
        "crashed",
        "path.v2 has dtype object; legal: float64",
    ),
    "path states of its own": (_path(state=lambda s: s * 10), "crashed", "path.state holds another number"),
    "another class": (lambda o: Anything(), "crashed", "solve_many gave Anything; legal: Outcome"),
    "a property that raises": (
        _secretive,
        "crashed",
        "reading its outcome: RuntimeError: not for your eyes",
    ),
}


#: Of a whole call: what becomes of it, then as above.
CALLS = {
    "too many outcomes": (
        lambda outcomes: [*outcomes, *outcomes],
        "crashed",
        "RuntimeError: 2 outcomes for 1",
    ),
    "no outcomes": (lambda outcomes: [], "crashed", "RuntimeError: 0 outcomes for 1 collisions"),
    "a generator": (iter, "crashed", "TypeError: solve_many gave list_iterator; legal: list"),
    "None": (lambda outcomes: None, "crashed", "TypeError: solve_many gave NoneType; legal: list"),
    "KeyboardInterrupt": (_raising(KeyboardInterrupt()), "crashed", "KeyboardInterrupt:"),
    "SystemExit": (_raising(SystemExit(0)), "crashed", "SystemExit: 0"),
    "GeneratorExit": (_raising(GeneratorExit()), "crashed", "GeneratorExit:"),
    "StopIteration": (_raising(StopIteration(1)), "crashed", "StopIteration: 1"),
    "RecursionError": (_recurse, "crashed", "RecursionError: maximum recursion depth exceeded"),
    "MemoryError": (_raising(MemoryError()), "crashed", "MemoryError:"),
    "an escape": (_raising(Escape("out")), "crashed", "Escape: out"),
    "an exception without words": (
        _raising(UnspeakableError()),
        "crashed",
        "UnspeakableError: without a message",
    ),
    "an exception in red": (
        _raising(ValueError("\x1b[31m\udfff")),
        "crashed",
        r"ValueError: \x1b[31m\udfff",
    ),
    "sys.path emptied": (_empty_path, "ok", None),
    "sys.path gone": (_no_path, "ok", None),
    "output": (_print, "ok", None),
    "streams closed": (_close, "ok", None),
    "all descriptors closed": (_close_all, "crashed", "its process died: "),
    "working directory": (_leave, "ok", None),
    "os._exit": (_exit, "crashed", "its process died: exit code 3"),
    "SIGKILL": (_kill, "crashed", "its process died: SIGKILL"),
    "a thread": (_thread, "ok", None),
    "a child": (_fork, "ok", None),
    "a child that answers": (_fork_and_return, "ok", None),
}

KINDS = OUTCOMES | CALLS

#: The value of e1 by which a kind is known.
E1 = {kind: 0.3 + 0.005 * i for i, kind in enumerate(KINDS)}
_KIND = {e1: kind for kind, e1 in E1.items()}


class Hostile(Shifted):
    """The model's answer, 0.01 m/s faster, where its kind leaves it so."""

    def solve_many(self, collisions, settings):
        outcomes = super().solve_many(collisions, settings)
        for i, c in enumerate(collisions):
            if _KIND.get(c.e1) in OUTCOMES:
                outcomes[i] = OUTCOMES[_KIND[c.e1]][0](outcomes[i])
        for c in collisions:
            if _KIND.get(c.e1) in CALLS:
                outcomes = CALLS[_KIND[c.e1]][0](outcomes)
        return outcomes


class Silent(Shifted):
    """Cannot say its version, nor whether it can run."""

    name = "pybullet"

    def version(self):
        return 7

    def unavailable(self):
        raise OSError("no licence\x1b[2J")


class Mute(Shifted):
    """Gives a number where a reason or None is legal, and takes its version with it."""

    name = "drake"

    def version(self):
        raise SystemExit(1)

    def unavailable(self):
        return 7


class Neighbour(Shifted):
    """A solver that does no harm; it imports, and reads where it is, as late as it can."""

    name = "kelvin-voigt"

    def solve_many(self, collisions, settings):
        import wave  # nobody else's

        assert wave.Error
        assert Path.cwd() != Path("/")
        collections.deque(map(os.fstat, range(3)))
        return super().solve_many(collisions, settings)


_SOLVERS = {"mujoco": Hostile, "pybullet": Silent, "drake": Mute, "kelvin-voigt": Neighbour}


def hostile(name):
    return _SOLVERS[name]() if name in _SOLVERS else get_solver(name)


def harmless(name):
    return Shifted() if name == "mujoco" else hostile(name)
