"""Safe calls of solvers: every collision gets one outcome, even if the solver raises an exception.

Texts of outcomes become single printable lines. Every command and every sweep calls solvers by `answer`, both the
solvers of this project and plug-ins. A crash that ends the whole process is not caught here, but in
`experiments.sweep.process`.
"""

from __future__ import annotations

import unicodedata
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from impact_xval.compliant_baselines.solver import Settings, Solver
from impact_xval.model.collision import Collision
from impact_xval.model.graph.collision_outcome import GraphCollisionOutcome
from impact_xval.model.outcome import Outcome
from impact_xval.model.outcomes import Outcomes

if TYPE_CHECKING:
    from impact_xval.model.graph.collision import GraphCollision

#: Largest number of characters of a solver's text; longer texts are cut.
LONGEST = 1000


def answer(solver: Solver, collisions: Sequence[Collision], settings: Settings) -> Sequence[Outcome]:
    """Solve collisions by any solver, and return one outcome for each collision, in order.

    Solvers of this project return `Outcomes`. If a solver raises an exception or returns a wrong number of outcomes,
    the collision that causes this gets the status ``crashed``. The other collisions get their outcomes.
    """
    reason = why_unavailable(solver)
    if reason is not None:
        return [Outcome.failure(solver.name, c, "unavailable", reason) for c in collisions]
    return _answer_batch(solver, collisions, settings) if len(collisions) else []


def answer_graph(solver: Solver, collision: GraphCollision, settings: Settings) -> GraphCollisionOutcome:
    """Solve one contact graph by any solver; if the solver raises an exception, the outcome is ``crashed``."""
    return answer_graphs(solver, [collision], settings)[0]


def _answer_batch(solver: Solver, collisions: Sequence[Collision], settings: Settings) -> Sequence[Outcome]:
    """Call a solver; if the call fails, call it for each half of the batch, down to the single collision that fails."""
    n = len(collisions)
    try:
        answers = solver.solve_many(collisions, settings)
        outcomes = answers if isinstance(answers, Outcomes) else list(answers)
        if len(outcomes) != n:
            raise RuntimeError(f"{len(outcomes)} outcomes for {n} collisions")
        if isinstance(outcomes, Outcomes):
            return outcomes
        return [_clean(solver.name, o, c) for o, c in zip(outcomes, collisions, strict=True)]
    except Exception as error:
        if n == 1:
            return [Outcome.failure(solver.name, collisions[0], "crashed", describe_exception(error))]
    halves = collisions[: n // 2], collisions[n // 2 :]
    return [outcome for half in halves for outcome in _answer_batch(solver, half, settings)]


def answer_graphs(
    solver: Solver, collisions: Sequence[GraphCollision], settings: Settings
) -> list[GraphCollisionOutcome]:
    """Solve contact graphs by any solver, and return one outcome for each graph, in order.

    If a solver raises an exception or returns a wrong number of outcomes, the graph that causes this gets the status
    ``crashed``. The other graphs get their outcomes.
    """
    reason = why_unavailable(solver)
    if reason is not None:
        return [GraphCollisionOutcome.failure(solver.name, c, "unavailable", reason) for c in collisions]
    return _answer_graphs(solver, collisions, settings) if len(collisions) else []


def _answer_graphs(
    solver: Solver, collisions: Sequence[GraphCollision], settings: Settings
) -> list[GraphCollisionOutcome]:
    """Call a solver; if the call fails, call it for each half of the batch, down to the single graph that fails."""
    n = len(collisions)
    try:
        outcomes = list(solver.solve_graphs(collisions, settings))
        if len(outcomes) != n:
            raise RuntimeError(f"{len(outcomes)} outcomes for {n} collisions")
        return [_clean_graph(solver.name, o, c) for o, c in zip(outcomes, collisions, strict=True)]
    except Exception as error:
        if n == 1:
            reason = describe_exception(error)
            return [GraphCollisionOutcome.failure(solver.name, collisions[0], "crashed", reason)]
    halves = collisions[: n // 2], collisions[n // 2 :]
    return [outcome for half in halves for outcome in _answer_graphs(solver, half, settings)]


def _clean_graph(
    name: str, outcome: GraphCollisionOutcome, collision: GraphCollision
) -> GraphCollisionOutcome:
    """Return an outcome with printable texts; ``crashed`` if its velocities have the wrong shape."""
    given, legal = ([len(v) for v in each.velocities] for each in (outcome, collision))
    if given != legal:
        reason = f"velocities: {given} components by body; legal: {legal}"
        return GraphCollisionOutcome.failure(name, collision, "crashed", reason)
    return replace(outcome, reason=one_line(outcome.reason), mark=one_line(outcome.mark))


def _clean(name: str, outcome: Outcome, collision: Collision) -> Outcome:
    """Return an outcome with printable texts; ``crashed`` if it has too few or too many velocities or impulses."""
    given = len(outcome.velocities), len(outcome.impulses)
    legal = len(collision.masses), len(collision.stiffnesses)
    if given != legal:
        reason = f"velocities, impulses: {given[0]}, {given[1]} values; legal: {legal[0]}, {legal[1]}"
        return Outcome.failure(name, collision, "crashed", reason)
    reason, mark = one_line(outcome.reason), one_line(outcome.mark)
    if (reason, mark) == (outcome.reason, outcome.mark):
        return outcome
    return replace(outcome, reason=reason, mark=mark)


def why_unavailable(solver: Solver) -> str | None:
    """Return the reason why a solver cannot run on this machine, as one line; None if it can."""
    try:
        reason = solver.unavailable()
        return None if reason is None else one_line(reason)
    except Exception as error:
        return f"it failed when it was asked whether it can run: {describe_exception(error)}"


def stated_version(solver: Solver) -> str:
    """Return the version that a solver states, as one line; an empty text if the solver raises an exception."""
    try:
        return one_line(solver.version())
    except Exception:
        return ""


def describe_exception(error: Exception) -> str:
    """Return the type and the message of an exception as one line."""
    return one_line(f"{type(error).__name__}: {error}")


def one_line(text: str) -> str:
    """Return a text as one printable line of at most `LONGEST` characters, for tables, terminals and pages."""
    if not text.isprintable():
        text = " ".join(escape_invisible(text[: 2 * LONGEST]).split())
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 3]}..."


def escape_invisible(text: str) -> str:
    r"""Write control characters and invisible characters as Python's escapes, such as ``\x1b`` or ``\u202e``.

    Line feeds, tabs and spaces of any width are not changed.
    """

    def stays(letter: str) -> bool:
        return letter.isprintable() or letter in "\n\t" or unicodedata.category(letter) == "Zs"

    return "".join(letter if stays(letter) else letter.encode("unicode_escape").decode() for letter in text)
