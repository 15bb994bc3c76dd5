"""One collision by several solvers, each within a limit of time; they are imported, and run, in a sandbox only.

The caller's process needs no engine and no compiled code: it can be interrupted at any time, and reads its input while
the sandbox starts.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import wait
from typing import Any, NamedTuple

from impact_xval.experiments.config.configuration import Config, parse_config
from impact_xval.experiments.sweep.executors import open_executor
from impact_xval.experiments.sweep.sandbox import FaultError, Sandbox
from impact_xval.experiments.sweep.third_party import contained, longest
from impact_xval.model.collision import Outcome

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
            self._executor.submit(_compile, config, names, resolve).result()
        return {name: self._solved(config, name, resolve, say) for name in names}

    def _solved(self, config: Config, name: str, resolve: Any, say: Callable[[str], None]) -> Solved:
        start = time.monotonic()
        solved = self._executor.submit(_solve, config, name, resolve)
        while not wait([solved], _SAY).done:
            seconds = time.monotonic() - start
            say(f"{name} has worked for {seconds:.0f} s; it is ended after {config.cell_timeout:g} s")
        return solved.result()


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
    from impact_xval.model.compiled import is_compiled
    from impact_xval.model.diagram import collide

    for name in set(names).intersection(solver_names(on_request=True)) or solver_names():
        if is_ours(name):
            get_solver(name).unavailable()
    return is_compiled(collide)


def _is_compiled(sandbox: Sandbox) -> bool:
    sandbox.start()
    return sandbox.prepared is not False


def _compile(sandbox: Sandbox, config: Config, names: Sequence[str], resolve: Any) -> None:
    """Have every solver solve an ordinary collision."""
    ordinary = config.model_copy(update={"figure_cell": parse_config({}, "").figure_cell})
    for name in names:
        with contextlib.suppress(FaultError):
            sandbox.call(_answer, ordinary, name, resolve, timeout=_TO_COMPILE)


def _solve(sandbox: Sandbox, config: Config, name: str, resolve: Any) -> Solved:
    sandbox.start()
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
