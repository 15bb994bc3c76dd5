"""One collision by several solvers, each within a limit of time; they are imported, and run, in a sandbox only.

The caller's process needs no engine and no compiled code: it can be interrupted at any time, and reads its input while
the sandbox starts.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import wait
from typing import Any, NamedTuple, TypeVar

from impact_xval.compliant_baselines.contract.registry import is_ours
from impact_xval.experiments.config.configuration import Config, parse_config
from impact_xval.experiments.sweep.executors import open_executor
from impact_xval.experiments.sweep.sandbox import TO_PREPARE, FaultError, Sandbox
from impact_xval.experiments.sweep.third_party import contained, longest
from impact_xval.model.collision import Outcome

_Answer = TypeVar("_Answer")

#: Seconds that kernels may take to be compiled, which no limit of a solver covers.
_TO_COMPILE = 1800.0
#: Seconds between two lines that say which solver is at work.
_SAY = 20.0


class Solved(NamedTuple):
    """What a solver made of a collision: its outcome, and the diagnostics per abs(v0) (`scaled_diagnostics`)."""

    outcome: Outcome
    diagnostics: dict[str, float]


class SolversApart:
    """Solvers in a sandbox; made by `solvers_apart`."""

    def __init__(self, executor: Any) -> None:
        self._executor = executor

    def solve(
        self, config: Config, names: Sequence[str], resolve: Callable[[str], Any], say: Callable[[str], None]
    ) -> dict[str, Solved]:
        """Solve the figure cell of a configuration.

        Parameters
        ----------
        config : Config
            Its ``cell_timeout`` is the limit of each solver.
        names : sequence of str
            Of the solvers.
        resolve : callable
            Finds a solver by its name; at the top level of a module.
        say : callable
            Given a line about what is waited for; empty once kernels are about to be compiled.

        Returns
        -------
        dict
            By solver; one that crashed or did not answer in time has an outcome that says so.
        """
        if not self._executor.submit(_is_compiled).result():
            say("")
            self._wait(
                say, f"compiling has taken {{:.0f}} s; it is ended after {_TO_COMPILE:g} s", _compile, names
            )
        at_work = f" has worked for {{:.0f}} s; it is ended after {config.cell_timeout:g} s"
        return {name: self._wait(say, name + at_work, _solve, config, name, resolve) for name in names}

    def _wait(
        self, say: Callable[[str], None], line: str, function: Callable[..., _Answer], *asked: Any
    ) -> _Answer:
        """Call in the sandbox, and say a line every `_SAY` s, into which the seconds are put."""
        start, called = time.monotonic(), self._executor.submit(function, *asked)
        while not wait([called], _SAY).done:
            say(line.format(time.monotonic() - start))
        return called.result()


@contextlib.contextmanager
def solvers_apart(names: Sequence[str]) -> Iterator[SolversApart]:
    """Start a sandbox, which imports solvers meanwhile; it is gone when the block ends.

    Parameters
    ----------
    names : sequence of str
        Of the solvers, legal or not; none for those that a run has by default.
    """
    with open_executor(tuple(names), _import, 1) as executor:
        yield SolversApart(executor)


def _import(names: Sequence[str]) -> bool:
    """Import solvers; return whether the kernels are compiled."""
    from impact_xval.compliant_baselines.contract.registry import get_solver, is_ours, solver_names
    from impact_xval.experiments.sweep import solving  # noqa: F401
    from impact_xval.experiments.sweep.kernels import kernels_of
    from impact_xval.model.compiled import is_compiled

    legal = set(names).intersection(solver_names(on_request=True)) or solver_names()
    for name in filter(is_ours, legal):
        get_solver(name).unavailable()
    return all(is_compiled(some.last) for some in kernels_of(legal))


def _is_compiled(sandbox: Sandbox) -> bool:
    sandbox.start()
    return sandbox.prepared is not False


def _compile(sandbox: Sandbox, names: Sequence[str]) -> None:
    with contextlib.suppress(FaultError):
        sandbox.call(_kernels, names, timeout=_TO_COMPILE)


def _kernels(_: object, names: Sequence[str]) -> None:
    from impact_xval.experiments.sweep.kernels import compile_once, kernels_of

    compile_once(kernels_of(names))


def _solve(sandbox: Sandbox, config: Config, name: str, resolve: Any) -> Solved:
    sandbox.start()
    if is_ours(name):
        with contextlib.suppress(FaultError):  # it is to say so of the collision
            sandbox.call(_answer, parse_config({}), name, resolve, timeout=TO_PREPARE)
    try:
        limit = longest(name, 1, config.cell_timeout)
        return sandbox.call(_answer, config, name, resolve, timeout=limit)
    except FaultError as fault:
        return Solved(Outcome.failure(name, fault.status, fault.reason), {})


def _answer(context: object, config: Config, name: str, resolve: Any) -> Solved:
    from impact_xval.experiments.config.grid import collision_of
    from impact_xval.experiments.sweep.solving import answer, scaled_diagnostics, settings_of

    collision = collision_of(config, config.figure_cell)
    solver = contained(resolve, config.cell_timeout)(name)
    outcome = answer(solver, [collision], settings_of(config))[0]
    return Solved(outcome, scaled_diagnostics(collision, outcome))
