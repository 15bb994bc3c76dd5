"""Solution of one collision by several solvers in worker processes. Every solver has a time limit.

The calling process imports no engine and no compiled code. It can therefore be interrupted at any time, and can read
its input while the worker processes start. The command ``solve``, `impact_xval.compare` and the explorer use this
module: they call `open_solvers_apart`, and then `SolversApart.solve` or `SolversApart.solve_graph`.
"""

from __future__ import annotations

import contextlib
import dataclasses
import time
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import Future, wait
from typing import TYPE_CHECKING, TypeVar

from impact_xval.compliant_baselines.registry import get_solver, is_engine, is_ours, solver_names
from impact_xval.experiments.config.experiment import CellKind, Config
from impact_xval.experiments.sweep.pool import TO_PREPARE, Slot, SlotPool, open_pool
from impact_xval.experiments.sweep.process import FaultError
from impact_xval.model.collision import Collision
from impact_xval.model.graph.collision_outcome import GraphCollisionOutcome
from impact_xval.model.outcome import Outcome
from impact_xval.model.path import Path

if TYPE_CHECKING:
    from impact_xval.experiments.sweep.rows import Resolve
    from impact_xval.model.graph.collision import GraphCollision

_Answer = TypeVar("_Answer")

#: Seconds between two lines on the terminal that say which solver is computing.
_SAY = 20.0


class SolversApart:
    """Solvers that run in worker processes; `open_solvers_apart` makes the object."""

    def __init__(self, pool: SlotPool[None], begun: Future[bool]) -> None:
        self._pool, self._begun = pool, begun
        #: Versions of the solvers by name, which `solve` adds. The version is missing if a solver crashed or took too
        #: long.
        self.versions: dict[str, str] = {}

    def solve(
        self,
        collision: Collision,
        config: Config,
        names: Sequence[str],
        resolve: Resolve,
        say: Callable[[str], None],
        points: int | None = None,
    ) -> dict[str, Outcome]:
        """Solve a collision by several solvers and return their outcomes by name.

        If a solver crashes or takes longer than ``cell_timeout``, the status of its outcome says so.

        Parameters
        ----------
        collision : Collision
        config : Config
            Settings of the solvers, and the time limit ``cell_timeout`` in s.
        names : sequence of str
        resolve : callable
            Returns a solver by its name.
        say : callable
            Called with a line while the caller waits for a solver; the line is empty if kernels have to be compiled.
        points : int, optional
            Largest number of points of a path; 0 for outcomes without paths, None for all points.
        """
        kind: CellKind = "pair" if collision.falls_on_resting else "chain"

        def prepare(slot: Slot[None], name: str) -> None:
            slot.prepare(name, _warm_up, resolve, name, kind)

        def solve(slot: Slot[None], name: str) -> tuple[Outcome, str]:
            limit = config.cell_timeout
            return slot.call(
                name, _outcome_and_version, resolve, name, config, collision, points, timeout=limit
            )

        def fail(name: str, fault: FaultError) -> Outcome:
            return Outcome.failure(name, collision, fault.status, fault.reason)

        return self._solve_by_each(names, config, say, prepare, solve, fail)

    def solve_graph(
        self,
        collision: GraphCollision,
        config: Config,
        names: Sequence[str],
        resolve: Resolve,
        say: Callable[[str], None],
    ) -> dict[str, GraphCollisionOutcome]:
        """Solve a contact graph by several solvers and return their outcomes by name.

        `solve` describes the parameters.
        """

        def prepare(slot: Slot[None], name: str) -> None:
            slot.prepare(name, _warm_graphs, resolve, name)

        def solve(slot: Slot[None], name: str) -> tuple[GraphCollisionOutcome, str]:
            limit = config.cell_timeout
            return slot.call(
                name, _graph_outcome_and_version, resolve, name, config, collision, timeout=limit
            )

        def fail(name: str, fault: FaultError) -> GraphCollisionOutcome:
            return GraphCollisionOutcome.failure(name, collision, fault.status, fault.reason)

        return self._solve_by_each(names, config, say, prepare, solve, fail)

    def _solve_by_each(
        self,
        names: Sequence[str],
        config: Config,
        say: Callable[[str], None],
        prepare: Callable[[Slot[None], str], None],
        solve: Callable[[Slot[None], str], tuple[_Answer, str]],
        fail: Callable[[str, FaultError], _Answer],
    ) -> dict[str, _Answer]:
        """Make the process ready for each solver, let the solver solve, and return the outcomes by name.

        If a solver crashes or takes too long, `fail` returns its outcome.
        """
        # A fault is ignored here. The solver fails again below, where its outcome records the failure.
        with contextlib.suppress(FaultError):
            if not self._begun.result():
                say("")
        ended = f"has taken {{:.0f}} s; it is ended after {TO_PREPARE:g} s"
        at_work = f"has worked for {{:.0f}} s; it is ended after {config.cell_timeout:g} s"
        solved: dict[str, _Answer] = {}
        for name in names:
            self._call_and_report(say, f"making {name} ready {ended}", prepare, name)
            try:
                solved[name], self.versions[name] = self._call_and_report(
                    say, f"{name} {at_work}", solve, name
                )
            except FaultError as fault:
                solved[name] = fail(name, fault)
        return solved

    def _call_and_report(
        self,
        say: Callable[[str], None],
        line: str,
        function: Callable[[Slot[None], str], _Answer],
        name: str,
    ) -> _Answer:
        """Let a thread of the pool call a function for a solver, and return the result of the function.

        Until the result is there, `say` is called every `_SAY` seconds with the line. The number of seconds so far is
        formatted into the line.
        """
        start, called = time.monotonic(), self._pool.submit(function, name)
        while not wait([called], _SAY).done:
            say(line.format(time.monotonic() - start))
        return called.result()


@contextlib.contextmanager
def open_solvers_apart(
    names: Sequence[str], *, chains: bool = False, graphs: bool = False
) -> Generator[SolversApart]:
    """Start a worker process that imports solvers, and yield the object that solves collisions by these solvers.

    The process imports solvers while the `with` block goes on. It is ended at the end of the block.

    Parameters
    ----------
    names : sequence of str
        Solvers to import. Unknown names are ignored here; without a known name, the default solvers are imported.
    chains, graphs : bool
        Whether the solvers are to solve chains of N balls or contact graphs; by default they solve two balls on a
        table.
    """
    legal = [name for name in solver_names(on_request=True) if name in names] or list(solver_names())

    def begin(slot: Slot[None]) -> bool:
        if graphs:
            return slot.call(None, _are_graphs_compiled, timeout=TO_PREPARE)
        return slot.call(None, _import_solvers, legal, "chain" if chains else "pair", timeout=TO_PREPARE)

    with open_pool(None, 1) as pool:
        yield SolversApart(pool, pool.submit(begin))


def _import_solvers(_: object, names: Sequence[str], kind: CellKind) -> bool:
    """Import this project's solvers; return whether all kernels that the named solvers need are compiled."""
    from impact_xval.experiments.sweep.chunk import are_compiled

    for name in filter(is_ours, names):
        get_solver(name).unavailable()
    return all(are_compiled(name, kind) for name in names)


def _warm_up(_: object, resolve: Resolve, name: str, kind: CellKind) -> bool:
    """Make the process ready for a solver; return whether any kernels were compiled.

    If the solver belongs to this project and its kernels are compiled, the process only imports the solver. The solver
    then reads the kernels from the cache when it solves.
    """
    from impact_xval.experiments.sweep.chunk import are_compiled, warm

    if is_ours(name) and are_compiled(name, kind):
        resolve(name).unavailable()
        return False
    return warm(_, resolve, name, kind)


def _are_graphs_compiled(_: object) -> bool:
    """Import the kernels that solve contact graphs, and return whether they are compiled."""
    from impact_xval.model.compiled import is_compiled
    from impact_xval.model.graph.in_time.kernel import follow_timed_graphs
    from impact_xval.model.graph.kernel import follow_graphs

    return is_compiled(follow_graphs) and is_compiled(follow_timed_graphs)


def _warm_graphs(_: object, resolve: Resolve, name: str) -> bool:
    """Let a solver of this project solve a graph, so that its kernel is compiled before any time limit applies.

    Return whether the solver was called. Engines and solvers of plug-ins are not called.
    """
    from impact_xval.compliant_baselines.solver import Settings
    from impact_xval.model.graph import box

    is_asked = is_ours(name) and not is_engine(name)
    if is_asked:
        resolve(name).solve_graphs([box()], Settings())
    return is_asked


def _graph_outcome_and_version(
    _: object, resolve: Resolve, name: str, config: Config, collision: GraphCollision
) -> tuple[GraphCollisionOutcome, str]:
    """Solve a contact graph by a solver; return its outcome and the version that the solver states."""
    from impact_xval.compliant_baselines.answers import answer_graph, stated_version
    from impact_xval.experiments.sweep.rows import settings_of

    solver = resolve(name)
    return answer_graph(solver, collision, settings_of(config, paths=False)), stated_version(solver)


def _outcome_and_version(
    _: object, resolve: Resolve, name: str, config: Config, collision: Collision, points: int | None
) -> tuple[Outcome, str]:
    """Solve a collision by a solver; return its outcome and the version that the solver states.

    `points` is the largest number of points of the outcome's path; 0 for no path, None for all points.
    """
    import numpy as np

    from impact_xval.compliant_baselines.answers import answer, stated_version
    from impact_xval.experiments.sweep.rows import settings_of

    solver = resolve(name)
    outcome = answer(solver, [collision], settings_of(config, paths=points != 0))[0]
    path = outcome.path
    if not points or path is None:
        return outcome, stated_version(solver)
    # A path of many balls is too large to send quickly. So only evenly spaced points are kept, both ends among them.
    kept = np.unique(np.linspace(0, len(path.time) - 1, points).astype(int))
    fewer = Path(*(getattr(path, each.name)[kept] for each in dataclasses.fields(Path)))
    return dataclasses.replace(outcome, path=fewer), stated_version(solver)
