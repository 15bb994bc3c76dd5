"""Kernels compiled once an installation: each by one process, while others compile the rest, or wait for it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from filelock import FileLock, Timeout

from impact_xval.compliant_baselines import get_solver
from impact_xval.compliant_baselines.engines.quiet import between
from impact_xval.compliant_baselines.engines.stepping import scan
from impact_xval.compliant_baselines.registry import engine_names, is_engine, is_ours, kind_of
from impact_xval.compliant_baselines.solver import Settings
from impact_xval.experiments.config.experiment import Config
from impact_xval.experiments.measures.hausdorff import hausdorff, measure_all
from impact_xval.model.chain.kernel import follow_chains
from impact_xval.model.collision import ORDINARY, Collision
from impact_xval.model.compiled import cache_folder, is_compiled
from impact_xval.model.pair.kernel import collide_all as collide_pairs

#: Seconds between two looks at whether another process has compiled what this one waits for, and seconds after which
#: it does so itself: the other may be halted.
_LOOK, _PATIENCE = 0.05, 300.0
#: Kernels at most that are compiled by one use of one, with all that they call.
_TRIES = 100

#: Stiff enough for an engine to be left alone between events, whose path is interpolated then.
_ORDINARY = Collision.two_balls(m1=1.0, m2=1.0, k1=1e8, k2=1e8, e1=0.9, e2=0.7)


@dataclass(frozen=True, slots=True)
class Kernels:
    """Kernels that are compiled together.

    Attributes
    ----------
    name : str
        Of the lock that keeps other processes from compiling them too.
    last : callable
        The one that is compiled last, or last but for little ones.
    use : callable
        Uses all of them, and so has them compiled.
    """

    name: str
    last: Any
    use: Callable[[], object]


def kernels_of(solvers: Iterable[str]) -> list[Kernels]:
    """List the kernels that a run with some solvers needs, in the order in which they had best be compiled.

    That of chains, which the references use, comes first: it takes the longest.
    """
    engines = [name for name in solvers if name in engine_names(on_request=True)]
    settings = Settings(scenario="drop", record_path=True)
    bare = replace(settings, mark=False)  # an engine's marks need the kernels of the references

    def solve_by(names: Iterable[str], settings: Settings) -> None:
        for solver in map(get_solver, names):
            if solver.unavailable() is None:
                solver.solve_many([_ORDINARY], settings)

    line = [[0.0, 0.0], [1.0, 1.0]]
    return [
        Kernels(
            "chain", follow_chains, lambda: get_solver("kelvin-voigt").solve_many([ORDINARY], Settings())
        ),
        Kernels("model", collide_pairs, lambda: solve_by(["state-transition"], settings)),
        Kernels("distance", measure_all, lambda: hausdorff(line, line)),
        *([Kernels("engines", between, lambda: solve_by(engines, bare))] if engines else []),
    ]


def column_kernels_of(solvers: Iterable[str]) -> list[Kernels]:
    """List the kernels that columns of N balls need with some solvers."""
    parts: dict[str, tuple[str, Any]] = {
        "model": ("chain", follow_chains),
        "reference": ("chain", follow_chains),
        "engine": ("scan", scan),
    }

    def solve_by(names: Iterable[str]) -> None:
        for solver in map(get_solver, names):
            if solver.unavailable() is None:
                solver.solve_many([ORDINARY], Settings())

    by_kind: dict[str, list[str]] = {kind: [] for kind in parts}
    for name in filter(is_ours, solvers):
        by_kind["engine" if is_engine(name) else kind_of(name)].append(name)
    return [Kernels(*parts[kind], partial(solve_by, names)) for kind, names in by_kind.items() if names]


def kernels_for(config: Config, solvers: Iterable[str]) -> list[Kernels]:
    """List the kernels that the cells of an experiment need with some solvers."""
    return (kernels_of if config.column is None else column_kernels_of)(solvers)


def compile_once(kernels: Iterable[Kernels], meanwhile: Iterable[Kernels] = ()) -> None:
    """Have kernels compiled that are not in the cache: first those that no other process is at.

    Parameters
    ----------
    kernels : iterable of Kernels
        In the order in which they are tried.
    meanwhile : iterable of Kernels
        Tried while other processes are at all that are left of these.
    """
    left, others, until = list(kernels), list(meanwhile), time.monotonic() + _PATIENCE
    while left:
        alone = time.monotonic() > until
        done = next((some for some in (*left, *others) if _compiled(some, alone=alone)), None)
        if done is None:
            time.sleep(_LOOK)
        else:
            (left if done in left else others).remove(done)


def _compiled(some: Kernels, *, alone: bool) -> bool:
    """Have kernels compiled; False where another process is at it, whose work is not done again but `alone`."""
    if is_compiled(some.last):
        return True
    if alone:
        _use(some)
        return True
    try:
        with FileLock(cache_folder(some.last) / f"compiling-{some.name}.lock", blocking=False):
            if not is_compiled(some.last):
                _use(some)
    except Timeout:
        return False
    except (OSError, NotImplementedError):  # a file system without locks: work may be done twice
        _use(some)
    return True


def _use(some: Kernels) -> None:
    """Use kernels; where one cannot be kept, numba has compiled it for this process when it says so."""
    for _ in range(_TRIES):
        try:
            some.use()
        except OSError:
            continue
        except Exception:  # said where it is needed, of the cell
            pass
        return
