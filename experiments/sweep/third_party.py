"""Solvers of other distributions, each in a sandbox of its own: whatever one does costs its own cells.

Their sandboxes are started by the process that calls them, when one is first called, and end with it. That process is a
sandbox itself, for what a solver does to its caller: of a run, or one for the question what the solver is. What such a
process answers is read as plain outcomes only: nothing is left to an interpreter that a solver may have changed.
"""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Sequence
from typing import Any

from impact_xval.compliant_baselines.answers import answer, stated_version, why_unavailable
from impact_xval.compliant_baselines.registry import is_ours
from impact_xval.compliant_baselines.solver import Settings, Solver
from impact_xval.experiments.sweep.sandbox import FaultError, Sandbox, in_halves, is_sandbox
from impact_xval.model.collision import Collision, Outcome

#: Seconds for a solver to be imported, and to say its version and whether it can run.
_TO_STATE = 60.0

#: What outcomes are pickled with: their classes, and what arrays are made by.
_PLAIN = frozenset(
    {
        *(("impact_xval.model.collision", name) for name in ("Outcome", "Path")),
        *(("numpy", name) for name in ("ndarray", "dtype")),
        ("numpy._core.multiarray", "_reconstruct"),
        ("numpy._core.numeric", "_frombuffer"),
    }
)


class ContainedSolver(Solver):
    """A solver in a sandbox of its own, started when it is first asked for anything.

    Parameters
    ----------
    resolve : callable
        Finds the solver by its name, in its own process; at the top level of a module.
    timeout : float
        Seconds for the collisions of a call; more, and they are halved (`sandbox.in_halves`).
    name : str
        Of the solver.
    """

    def __init__(self, resolve: Callable[[str], Solver], timeout: float, name: str) -> None:
        self.name, self._timeout, self._resolve = name, timeout, resolve
        self._sandbox = Sandbox((resolve, name), _stated, self._to_state, readable=_PLAIN)
        self._known: tuple[str, str | None] | None = None

    def version(self) -> str:
        """Version the solver states; ``""`` if it cannot."""
        return self._stated()[0]

    def unavailable(self) -> str | None:
        """Why it cannot run: its own reason, or what became of its process when it was asked."""
        return self._stated()[1]

    def solve_many(self, collisions: Sequence[Collision], settings: Settings) -> list[Outcome]:
        """Answer every collision, in order; one at which its process dies or hangs is a failure."""

        def call(place: slice) -> list[Outcome]:
            return self._sandbox.call(_solved, list(collisions[place]), settings, timeout=self._timeout)

        def lost(place: slice, fault: FaultError) -> list[Outcome]:
            return [Outcome.failure(self.name, collisions[place.start], fault.status, fault.reason)]

        return [outcome for piece in in_halves(call, len(collisions), lost) for outcome in piece]

    @property
    def _to_state(self) -> float:
        return min(_TO_STATE, self._timeout)

    def _stated(self) -> tuple[str, str | None]:
        if self._known is None:
            try:
                self._known = self._ask() if is_sandbox() else self._ask_apart()
            except FaultError as fault:
                self._known = _no_answer(None, fault)
        return self._known

    def _ask(self) -> tuple[str, str | None]:
        self._sandbox.start()
        return self._sandbox.prepared or self._sandbox.call(_stated, timeout=self._to_state)

    def _ask_apart(self) -> tuple[str, str | None]:
        with contextlib.closing(Sandbox((self._resolve, self._timeout, self.name), _nothing)) as between:

            def call(_: slice) -> tuple[str, str | None]:
                return between.call(_asked, timeout=3 * _TO_STATE)

            return in_halves(call, 1, _no_answer)[0]  # one death may have been anybody's


def contained(resolve: Callable[[str], Solver], timeout: float) -> Callable[[str], Solver]:
    """Have solvers of other distributions found as `ContainedSolver`, and all others as they are.

    Parameters
    ----------
    resolve : callable
        Finds a solver by its name; at the top level of a module.
    timeout : float
        As of `ContainedSolver`.

    Returns
    -------
    callable
        As `resolve`; it can be pickled, and gives the same solver whenever it is called in a process.
    """
    return functools.partial(_find, resolve, timeout)


def longest(name: str, n: int, timeout: float) -> float:
    """Limit of a call of a sandbox by which a solver answers n cells, in seconds.

    A contained solver has the limit in its own sandbox, and is called 3 n times there where every cell is lost.
    """
    return timeout if is_ours(name) else 3 * max(1, n) * (timeout + 2 * _TO_STATE)


#: The contained solvers of this process.
_contained: dict[tuple[Any, ...], ContainedSolver] = {}


def _find(resolve: Callable[[str], Solver], timeout: float, name: str) -> Solver:
    if is_ours(name):
        return resolve(name)
    key = resolve, timeout, name
    if key not in _contained:
        _contained[key] = ContainedSolver(*key)
    return _contained[key]


def _nothing(_: object) -> None:
    """Prepare a process for nothing."""


def _no_answer(_: object, fault: FaultError) -> tuple[str, str | None]:
    return "", f"asked what it is, it gave no answer: {fault.reason}"


def _asked(context: tuple[Callable[[str], Solver], float, str]) -> tuple[str, str | None]:
    """In a process between: what a solver says it is."""
    solver = _find(*context)
    return solver.version(), solver.unavailable()


def _stated(context: tuple[Callable[[str], Solver], str]) -> tuple[str, str | None]:
    """In the process of a solver: its version, and why it cannot run."""
    resolve, name = context
    solver = resolve(name)
    return stated_version(solver), why_unavailable(solver)


def _solved(
    context: tuple[Callable[[str], Solver], str], collisions: Sequence[Collision], settings: Settings
) -> list[Outcome]:
    """In the process of a solver: its outcomes."""
    resolve, name = context
    return list(answer(resolve(name), collisions, settings))
