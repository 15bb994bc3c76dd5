"""One collision by several solvers, each within a limit of time.

They are imported, and run, in processes of their own only. The caller's needs no engine and no compiled code: it can be
interrupted at any time, and reads its input while those start.
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

#: Seconds between two lines that say which solver is at work.
_SAY = 20.0


class SolversApart:
    """Solvers in processes of their own; made by `open_solvers_apart`."""

    def __init__(self, pool: SlotPool[None], begun: Future[bool]) -> None:
        self._pool, self._begun = pool, begun
        #: What each solver states of its version; filled by `solve`, without those that gave no answer.
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
        """Solve a collision by solvers; of one that crashed, or took longer than ``cell_timeout``, the outcome says so.

        `say` is given a line about what is waited for, empty once kernels are about to be compiled. Paths have so many
        points at most, none with 0.
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
        """Solve a collision of bodies by solvers, as `solve` does."""

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
        """Have each solver made ready, and solve; where it crashes or takes too long, `fail` gives its outcome."""
        with contextlib.suppress(FaultError):  # then the solvers say so
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
        """Have a function called for a solver, and say a line every `_SAY` s, into which the seconds are put."""
        start, called = time.monotonic(), self._pool.submit(function, name)
        while not wait([called], _SAY).done:
            say(line.format(time.monotonic() - start))
        return called.result()


@contextlib.contextmanager
def open_solvers_apart(
    names: Sequence[str], *, chains: bool = False, graphs: bool = False
) -> Generator[SolversApart]:
    """Start a process, which imports solvers meanwhile; it is gone when the block ends.

    They are to solve two balls, or chains of N balls, or contact graphs. Names may be illegal; none stand for the
    solvers that a run has by default.
    """
    legal = [name for name in solver_names(on_request=True) if name in names] or list(solver_names())

    def begin(slot: Slot[None]) -> bool:
        if graphs:
            return slot.call(None, _are_graphs_compiled, timeout=TO_PREPARE)
        return slot.call(None, _import_solvers, legal, "chain" if chains else "pair", timeout=TO_PREPARE)

    with open_pool(None, 1) as pool:
        yield SolversApart(pool, pool.submit(begin))


def _import_solvers(_: object, names: Sequence[str], kind: CellKind) -> bool:
    """Import our solvers; whether all kernels are compiled."""
    from impact_xval.experiments.sweep.chunk import are_compiled

    for name in filter(is_ours, names):
        get_solver(name).unavailable()
    return all(are_compiled(name, kind) for name in names)


def _warm_up(_: object, resolve: Resolve, name: str, kind: CellKind) -> bool:
    """Make a process ready; one of our solvers whose kernels are compiled reads them as fast while it solves."""
    from impact_xval.experiments.sweep.chunk import are_compiled, warm

    if is_ours(name) and are_compiled(name, kind):
        resolve(name).unavailable()
        return False
    return warm(_, resolve, name, kind)


def _are_graphs_compiled(_: object) -> bool:
    """Import the kernels of graphs; whether they are compiled."""
    from impact_xval.model.compiled import is_compiled
    from impact_xval.model.graph.in_time.kernel import follow_timed_graphs
    from impact_xval.model.graph.kernel import follow_graphs

    return is_compiled(follow_graphs) and is_compiled(follow_timed_graphs)


def _warm_graphs(_: object, resolve: Resolve, name: str) -> bool:
    """Have one of our solvers solve a graph, so that its kernel is compiled outside of any limit of a cell.

    Returned is whether the solver was asked.
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
    """Solve a collision of bodies by a solver; its outcome, and the version it states."""
    from impact_xval.compliant_baselines.answers import answer_graph, stated_version
    from impact_xval.experiments.sweep.rows import settings_of

    solver = resolve(name)
    return answer_graph(solver, collision, settings_of(config, paths=False)), stated_version(solver)


def _outcome_and_version(
    _: object, resolve: Resolve, name: str, config: Config, collision: Collision, points: int | None
) -> tuple[Outcome, str]:
    """Solve a collision by a solver; its outcome, and the version it states."""
    import numpy as np

    from impact_xval.compliant_baselines.answers import answer, stated_version
    from impact_xval.experiments.sweep.rows import settings_of

    solver = resolve(name)
    outcome = answer(solver, [collision], settings_of(config, paths=points != 0))[0]
    path = outcome.path
    if not points or path is None:
        return outcome, stated_version(solver)
    # With its ends; of many balls a path is large to be sent.
    kept = np.unique(np.linspace(0, len(path.time) - 1, points).astype(int))
    fewer = Path(*(getattr(path, each.name)[kept] for each in dataclasses.fields(Path)))
    return dataclasses.replace(outcome, path=fewer), stated_version(solver)
