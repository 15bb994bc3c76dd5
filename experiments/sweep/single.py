"""One collision, or one column, by several solvers, each within a limit of time.

They are imported, and run, in a sandbox only. The caller's process needs no engine and no compiled code: it can be
interrupted at any time, and reads its input while the sandbox starts.
"""

from __future__ import annotations

import contextlib
import dataclasses
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import wait
from typing import Any, Generic, NamedTuple, TypeVar

from impact_xval.compliant_baselines.registry import is_ours
from impact_xval.experiments.config.cells import collision_of
from impact_xval.experiments.config.experiment import Config, parse_config
from impact_xval.experiments.sweep.executors import open_executor
from impact_xval.experiments.sweep.sandbox import TO_PREPARE, FaultError, Sandbox
from impact_xval.experiments.sweep.third_party import contained, longest
from impact_xval.model.collision import ORDINARY, Collision, Outcome, Path, Status

_Answer = TypeVar("_Answer")
_Outcome = TypeVar("_Outcome", Outcome, Outcome)

#: Seconds that kernels may take to be compiled, which no limit of a solver covers.
_TO_COMPILE = 1800.0
#: Seconds between two lines that say which solver is at work.
_SAY = 20.0


class Solved(NamedTuple, Generic[_Outcome]):
    """What a solver made of a collision or column: its outcome, and diagnostics per abs(v0) (`scaled_diagnostics`)."""

    outcome: _Outcome
    diagnostics: dict[str, float]


class SolversApart:
    """Solvers in a sandbox; made by `solvers_apart`."""

    def __init__(self, executor: Any) -> None:
        self._executor = executor
        self._ready: set[str] = set()  # solvers that have answered since the last fault

    def solve(
        self,
        config: Config,
        names: Sequence[str],
        resolve: Callable[[str], Any],
        say: Callable[[str], None],
        collision: Collision | None = None,
    ) -> dict[str, Solved[Outcome]]:
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
        collision : Collision, optional
            Solved in the place of the figure cell, which may round its masses and stiffnesses.

        Returns
        -------
        dict
            By solver; one that crashed or did not answer in time has an outcome that says so.
        """
        given = collision or collision_of(config, config.figure_cell)
        usual = parse_config({"scenario": "impact"})
        ordinary = (collision_of(usual, usual.figure_cell),)

        def failure(name: str, status: Status, reason: str) -> Outcome:
            return Outcome.failure(name, given, status, reason)

        return self._solve(config, names, resolve, say, _answer, failure, (given,), ordinary)

    def solve_column(
        self,
        column: Collision,
        config: Config,
        names: Sequence[str],
        resolve: Callable[[str], Any],
        say: Callable[[str], None],
        points: int | None = 0,
    ) -> dict[str, Solved[Outcome]]:
        """Solve a column of N balls, as `solve` the figure cell of a configuration.

        Diagnostics are per speed of the configuration's ``v0``; outcomes carry a path of so many points at most, none
        with 0 and the whole with None.
        """

        def failure(name: str, status: Status, reason: str) -> Outcome:
            return Outcome.failure(name, column, status, reason)

        return self._solve(
            config, names, resolve, say, _answer_column, failure, (column, points), (ORDINARY, points)
        )

    def _solve(
        self,
        config: Config,
        names: Sequence[str],
        resolve: Callable[[str], Any],
        say: Callable[[str], None],
        function: Callable[..., Any],
        failure: Callable[[str, Status, str], Any],
        asked: tuple[Any, ...],
        ordinary: tuple[Any, ...],
    ) -> dict[str, Any]:
        """Call a function in the sandbox for each solver, with what is ordinary and, within its limit, asked."""
        if not self._executor.submit(_is_compiled).result():
            say("")
            self._wait(say, f"compiling has taken {{:.0f}} s; it is ended after {_TO_COMPILE:g} s", _compile)
        at_work = f" has worked for {{:.0f}} s; it is ended after {config.cell_timeout:g} s"
        solved = {}
        for name in names:
            within = (
                longest(name, 1, config.cell_timeout),
                function,
                name,
                config,
                resolve,
                asked,
                () if name in self._ready else ordinary,
            )
            try:
                solved[name] = self._wait(say, name + at_work, _within, *within)
                self._ready.add(name)
            except FaultError as fault:
                self._ready.clear()
                solved[name] = Solved(failure(name, fault.status, fault.reason), {})
        return solved

    def _wait(
        self, say: Callable[[str], None], line: str, function: Callable[..., _Answer], *asked: Any
    ) -> _Answer:
        """Call in the sandbox, and say a line every `_SAY` s, into which the seconds are put."""
        start, called = time.monotonic(), self._executor.submit(function, *asked)
        while not wait([called], _SAY).done:
            say(line.format(time.monotonic() - start))
        return called.result()


@contextlib.contextmanager
def solvers_apart(names: Sequence[str], *, columns: bool = False) -> Iterator[SolversApart]:
    """Start a sandbox, which imports solvers meanwhile; it is gone when the block ends.

    Parameters
    ----------
    names : sequence of str
        Of the solvers, legal or not; none for those that a run has by default.
    columns : bool
        Whether they are to solve columns of N balls.
    """
    with open_executor((tuple(names), columns), _import, 1) as executor:
        yield SolversApart(executor)


def _import(asked: tuple[Sequence[str], bool]) -> bool:
    """Import solvers; return whether the kernels are compiled."""
    from impact_xval.compliant_baselines.registry import get_solver
    from impact_xval.experiments.sweep import solving  # noqa: F401
    from impact_xval.model.compiled import is_compiled

    for name in filter(is_ours, _legal(asked)):
        get_solver(name).unavailable()
    return all(is_compiled(some.last) for some in _kernels_of(asked))


def _legal(asked: tuple[Sequence[str], bool]) -> Sequence[str]:
    from impact_xval.compliant_baselines.registry import solver_names

    return [name for name in solver_names(on_request=True) if name in asked[0]] or solver_names()


def _kernels_of(asked: tuple[Sequence[str], bool]) -> list[Any]:
    from impact_xval.experiments.sweep.kernels import column_kernels_of, kernels_of

    return (column_kernels_of if asked[1] else kernels_of)(_legal(asked))


def _is_compiled(sandbox: Sandbox) -> bool:
    sandbox.start()
    return sandbox.prepared is not False


def _compile(sandbox: Sandbox) -> None:
    with contextlib.suppress(FaultError):
        sandbox.call(_kernels, timeout=_TO_COMPILE)


def _kernels(asked: tuple[Sequence[str], bool]) -> None:
    from impact_xval.experiments.sweep.kernels import compile_once

    compile_once(_kernels_of(asked))


def _within(
    sandbox: Sandbox,
    limit: float,
    function: Callable[..., _Answer],
    name: str,
    config: Config,
    resolve: Any,
    asked: tuple[Any, ...],
    ordinary: tuple[Any, ...],
) -> _Answer:
    """Call for a solver within its limit, after an ordinary call: what is imported and read first has no limit."""
    sandbox.start()
    if is_ours(name) and ordinary:
        with contextlib.suppress(FaultError):  # the call that is asked for is to say so
            impact = parse_config({"scenario": "impact"})
            sandbox.call(function, name, impact, resolve, *ordinary, timeout=TO_PREPARE)
    return sandbox.call(function, name, config, resolve, *asked, timeout=limit)


def _answer(
    context: object, name: str, config: Config, resolve: Any, collision: Collision
) -> Solved[Outcome]:
    from impact_xval.compliant_baselines.answers import answer
    from impact_xval.experiments.measures.results import scaled_diagnostics
    from impact_xval.experiments.sweep.rows import settings_of

    solver = contained(resolve, config.cell_timeout)(name)
    outcome = answer(solver, [collision], settings_of(config))[0]
    return Solved(outcome, scaled_diagnostics(outcome, abs(collision.v0)))


def _answer_column(
    context: object,
    name: str,
    config: Config,
    resolve: Any,
    column: Collision,
    points: int | None,
) -> Solved[Outcome]:
    from impact_xval.compliant_baselines.answers import answer
    from impact_xval.experiments.measures.results import scaled_diagnostics
    from impact_xval.experiments.sweep.rows import settings_of

    solver = contained(resolve, config.cell_timeout)(name)
    settings = dataclasses.replace(settings_of(config), record_path=points != 0)
    outcome = answer(solver, [column], settings)[0]
    if points and outcome.path is not None:
        outcome = dataclasses.replace(outcome, path=_fewer(outcome.path, points))
    return Solved(outcome, scaled_diagnostics(outcome, abs(config.v0)))


def _fewer(path: Path, points: int) -> Path:
    """Pick so many points of a path at most, its ends among them: of many balls it is large to be sent."""
    import numpy as np

    kept = np.unique(np.linspace(0, len(path.time) - 1, points).astype(int))
    return Path(*(getattr(path, each.name)[kept] for each in dataclasses.fields(Path)))
