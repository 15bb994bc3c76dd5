"""Solvers of other distributions that harm the process they are in, each in a module and under a name of its own."""

from typing import NamedTuple

from tests.compliant_baselines.third_party import install

#: The value of e1 at which a solver does its harm.
STRUCK = 0.5

_MODULE = """
import ctypes, os, sys, time, signal, threading
{at_import}

import dataclasses
from impact_xval.compliant_baselines.contract.solver import SolverBase
from impact_xval.model import solve

class Engine(SolverBase):
    name = {name!r}

    def __init__(self):
        {constructor}

    def version(self):
        {version}
        return "1.0"

    def unavailable(self):
        {unavailable}

    def solve_many(self, collisions, settings):
        outcomes = [solve(c, path=settings.record_path) for c in collisions]
        outcomes = [dataclasses.replace(o, solver=self.name, v1=o.v1 + 0.01) for o in outcomes]
        if any(c.e1 == {struck} for c in collisions):
            {solving}
        return outcomes
"""

_SEGFAULT = "ctypes.string_at(0)"
_HANG = "while True: time.sleep(1)"


class Kind(NamedTuple):
    """What a solver does at which place, the statuses that its cells (or the one struck) may have, and the reason."""

    place: str
    does: str
    statuses: tuple[str, ...]
    says: str = ""


def _dead(place: str, does: str, says: str) -> Kind:
    return Kind(place, does, ("unavailable",), says)


#: Solvers that cannot even be asked what they are.
SPEECHLESS = {
    "import-exit": _dead("at_import", "sys.exit(3)", "SystemExit: 3"),
    "import-leave": _dead("at_import", "os._exit(0)", "its process died: exit code 0"),
    "import-segfault": _dead("at_import", _SEGFAULT, "its process died: SIGSEGV"),
    "import-hang": _dead("at_import", _HANG, "no answer within 6 s"),
    "import-escape": _dead("at_import", "raise BaseException('out')", "BaseException: out"),
    "import-close": _dead("at_import", "os.closerange(0, 1000)", "it gave no answer"),
    "import-killpg": _dead("at_import", "os.killpg(0, signal.SIGKILL)", "its process died: SIGKILL"),
    "constructor-abort": _dead("constructor", "os.abort()", "its process died: SIGABRT"),
    "constructor-escape": _dead("constructor", "raise KeyboardInterrupt", "KeyboardInterrupt"),
    "version-hang": _dead("version", _HANG, "no answer within 6 s"),
    "version-leave": _dead("version", "os._exit(1)", "its process died: exit code 1"),
    "unavailable-segfault": _dead("unavailable", _SEGFAULT, "its process died: SIGSEGV"),
    "unavailable-escape": _dead("unavailable", "raise GeneratorExit", "GeneratorExit"),
}


def _changing(does: str, *statuses: str, says: str = "") -> Kind:
    return Kind("solving", does, statuses or ("ok", "limit"), says)


_EITHER = "ok", "limit", "crashed"

#: Solvers that change the interpreter they are in, for good.
CHANGING = {
    "numpy-patched": _changing("import numpy; numpy.isfinite = numpy.hypot = lambda *x: None", *_EITHER),
    "numpy-errors": _changing("import numpy; numpy.seterr(all='raise')", *_EITHER),
    "rounding": _changing("ctypes.CDLL('libm.so.6').fesetround(0x800)"),
    "timer": _changing("signal.setitimer(signal.ITIMER_REAL, 0.001); time.sleep(0.01)", "crashed"),
    "timer-later": _changing("signal.setitimer(signal.ITIMER_REAL, 0.3)", *_EITHER),
    "handlers": _changing("[signal.signal(n, lambda *a: os._exit(9)) for n in (2, 14, 15)]"),
    "memory": _changing("import resource; resource.setrlimit(resource.RLIMIT_AS, (2**20, 2**20))", *_EITHER),
    "files": _changing("import resource; resource.setrlimit(resource.RLIMIT_NOFILE, (4, 4))", *_EITHER),
    "modules": _changing("sys.modules.clear()", "crashed"),
    "builtins": _changing("import builtins; builtins.len = builtins.isinstance = None", "crashed"),
    "recursion": _changing("sys.setrecursionlimit(40)", *_EITHER),
    "environment": _changing("os.environ.clear()"),
    "directory": _changing("os.chdir('/')"),
    "locale": _changing("import locale; locale.setlocale(locale.LC_ALL, 'C')"),
    "streams": _changing("sys.stdin.close(); sys.stdout.close(); os.close(0); os.close(1)"),
}

#: Solvers that leave something behind, or spoil what they are spoken to through.
LEAVING = {
    "atexit": _changing("import atexit; atexit.register(os.abort); atexit.register(time.sleep, 60)"),
    "garbage": _changing(
        "import gc; type('Last', (), {'__del__': lambda self: os._exit(4)})(); gc.collect()",
        "crashed",
        says="its process died: exit code 4",
    ),
    "threads": _changing("[threading.Thread(target=time.sleep, args=(3600,)).start() for _ in range(20)]"),
    "writing-thread": _changing(
        "[os.write(end, b'noise') for end in range(3, 12) if not os.set_blocking(end, False)]",
        *_EITHER,
    ),
    "pickle-noise": _changing(
        "import pickle; pickle.dumps = lambda *a: b'noise'", *_EITHER, says="cannot be read"
    ),
    "pickle-hang": _changing(
        "import pickle; dumps = pickle.dumps; slow = lambda self: (time.sleep, (1e6,)); "
        "pickle.dumps = lambda *a: dumps(type('Slow', (), {'__reduce__': slow})())",
        *_EITHER,
        says="its answer cannot be read: UnpicklingError",
    ),
    "collision": _changing(
        "[object.__setattr__(c, 'm2', 9.0) for c in collisions]",
        "crashed",
        says="it changed the collision it was given to Collision(m1=1.0, m2=9.0,",
    ),
    "waiting": _changing("while True: os.wait()", "crashed", says="ChildProcessError: "),
    "noise": _changing("os.write(2, b'\\x1b[31mred\\x07' * 1_000_000)"),
    "once-dead": _changing("os.abort()", "crashed", says="its process died: SIGABRT"),
    "once-hanging": _changing("time.sleep(1e6)", "timeout", says="no answer within 10 s"),
}

#: Solvers that kill or halt the process that called their own.
KILLING = {
    "parent-halter": _changing(
        "os.kill(os.getppid(), signal.SIGSTOP); time.sleep(1e6)", "timeout", says="no answer within 10 s"
    ),
    "parent-killer": _changing(
        "os.kill(os.getppid(), signal.SIGKILL)",
        "crashed",
        says="its process died: SIGKILL",
    ),
}

#: A solver that kills the process that asks what it is.
SECRETIVE = {
    "asker-killer": _dead("at_import", "os.kill(os.getppid(), signal.SIGKILL)", "its process died: SIGKILL")
}

#: The solver that does no harm.
GOOD = "good"


def lay_down(site, kinds):
    """Install a distribution with solvers of these kinds, and one that does no harm."""
    modules, points = {}, {}
    for name, kind in (kinds | {GOOD: Kind("solving", "pass", ("ok", "limit"))}).items():
        places = dict.fromkeys(("at_import", "constructor", "version", "unavailable", "solving"), "pass")
        places[kind.place] = kind.does
        module = f"kind_{name.replace('-', '_')}"
        modules[module] = _MODULE.format(name=name, struck=STRUCK, **places)
        points[name] = f"{module}:Engine"
    install(site, "hostile", points, **modules)
