"""Solvers of other distributions, found by their entry points.

A distribution adds a solver by naming a class in its `pyproject.toml`:

    [project.entry-points."impact_xval.solvers"]
    my-engine = "my_package.adapter:MyEngineSolver"

The class keeps `solver`; `conformance` says whether it does. Nothing of a
distribution is imported before its solver is asked for, and nothing that is wrong with one can break a command: a
solver that cannot be loaded is ``unavailable``, with the reason.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from importlib.metadata import EntryPoint, distributions, entry_points

from impact_xval.compliant_baselines.answers import (
    answer,
    answer_columns,
    raise_ctrl_c,
    said,
    stated_version,
    undisturbed,
    why_unavailable,
)
from impact_xval.compliant_baselines.solver import Settings, Solver, SolverBase
from impact_xval.model.collision import Collision, Outcome

GROUP = "impact_xval.solvers"


def found() -> dict[str, list[EntryPoint]]:
    """Entry points by the name of their solver, in the order of the names; several of one name is a mistake."""
    points: dict[str, list[EntryPoint]] = {}
    for point in sorted(_points(), key=lambda point: (point.name, point.value)):
        if point not in points.setdefault(point.name, []):  # a distribution may be found twice on the path
            points[point.name].append(point)
    return points


def _points() -> list[EntryPoint]:
    try:
        return list(entry_points(group=GROUP))
    except Exception:  # of some distribution they cannot be read, perhaps not of one with a solver
        points: list[EntryPoint] = []
        for distribution in distributions():
            with contextlib.suppress(Exception):
                points += distribution.entry_points.select(group=GROUP)
        return points


def origin(point: EntryPoint) -> str:
    """Name and version of the distribution an entry point belongs to."""
    name = version = None
    if point.dist is not None:
        with contextlib.suppress(Exception):  # what there is without metadata is the finder's to say
            name, version = point.dist.name, point.dist.version
    return f"{name} {version}" if name else "an unknown distribution"


class ThirdPartySolver(SolverBase):
    """A solver of another distribution, kept from breaking what it must not; of the entry points with its name."""

    def __init__(self, name: str, points: Sequence[EntryPoint]) -> None:
        self.name = name
        self.solver: Solver | None = None
        self.problem = ""
        if len(points) > 1:
            several = " and ".join(origin(point) for point in points)
            self.problem = f"{several} both provide {name!r}: uninstall one of them"
            return
        (point,) = points
        try:
            with undisturbed():
                self.solver = _checked(point)
        except BaseException as error:  # whatever an import may do
            raise_ctrl_c(error)
            self.problem = f"{origin(point)} provides {name!r} as {point.value}, but {said(error)}"

    def version(self) -> str:
        """Version the solver states; ``""`` if it cannot."""
        return "" if self.solver is None else stated_version(self.solver)

    def unavailable(self) -> str | None:
        """Why it cannot run: its own reason, or what is wrong with it."""
        return self.problem if self.solver is None else why_unavailable(self.solver)

    def solve_many(self, collisions: Sequence[Collision], settings: Settings) -> list[Outcome]:
        """Answer every collision, in order; what goes wrong is an outcome with a status."""
        if self.solver is None:
            return [Outcome.failure(self.name, each, "unavailable", self.problem) for each in collisions]
        return answer(self.solver, collisions, settings)

    def solve_columns(self, columns: Sequence[Collision], settings: Settings) -> list[Outcome]:
        """Answer every column of N balls, in order; what goes wrong is an outcome with a status."""
        if self.solver is None:
            return [Outcome.failure(self.name, each, "unavailable", self.problem) for each in columns]
        return answer_columns(self.solver, columns, settings)


def _checked(point: EntryPoint) -> Solver:
    """Load and construct a solver; a `TypeError` says what it lacks."""
    solver = point.load()()
    methods = ("version", "unavailable", "solve_many", "solve")
    missing = [name for name in methods if not callable(getattr(solver, name, None))]
    if missing:
        raise TypeError(f"it lacks {', '.join(missing)}")
    if getattr(solver, "name", None) != point.name:
        raise TypeError(f"its name is {getattr(solver, 'name', None)!r}")
    return solver
