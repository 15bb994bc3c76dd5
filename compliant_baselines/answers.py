"""Calling a solver, whatever it does: one outcome a collision, and its words in one printable line.

Every command and every sweep calls solvers by `answer`, those of this project and of others alike. What no process
survives is for `experiments.sweep.process`.
"""

from __future__ import annotations

import unicodedata
from collections.abc import Sequence
from dataclasses import replace

from impact_xval.compliant_baselines.solver import Settings, Solver
from impact_xval.model.collision import Collision
from impact_xval.model.outcome import Outcome
from impact_xval.model.outcomes import Outcomes

#: Characters of a sentence of a solver that are kept.
LONGEST = 1000


def answer(solver: Solver, collisions: Sequence[Collision], settings: Settings) -> Sequence[Outcome]:
    """Call a solver: one outcome a collision, in order, `Outcomes` as its own solvers give them.

    An exception or a wrong number of outcomes is ``crashed`` for the collision at fault alone.
    """
    reason = why_unavailable(solver)
    if reason is not None:
        return [Outcome.failure(solver.name, each, "unavailable", reason) for each in collisions]
    return _answered(solver, collisions, settings) if len(collisions) else []


def _answered(solver: Solver, collisions: Sequence[Collision], settings: Settings) -> Sequence[Outcome]:
    """Call a solver; halve the batch until the collision at fault is alone."""
    n = len(collisions)
    try:
        found = solver.solve_many(collisions, settings)
        outcomes = found if isinstance(found, Outcomes) else list(found)
        if len(outcomes) != n:
            raise RuntimeError(f"{len(outcomes)} outcomes for {n} collisions")
        if isinstance(outcomes, Outcomes):
            return outcomes
        return [_shown(solver.name, *each) for each in zip(outcomes, collisions, strict=True)]
    except Exception as error:
        if n == 1:
            return [Outcome.failure(solver.name, collisions[0], "crashed", said(error))]
    halves = collisions[: n // 2], collisions[n // 2 :]
    return [outcome for half in halves for outcome in _answered(solver, half, settings)]


def _shown(name: str, outcome: Outcome, collision: Collision) -> Outcome:
    """Return an outcome with its texts in a line; crashed if it is one of another number of balls or contacts."""
    given = len(outcome.velocities), len(outcome.impulses)
    legal = len(collision.masses), len(collision.stiffnesses)
    if given != legal:
        reason = f"velocities, impulses: {given[0]}, {given[1]} values; legal: {legal[0]}, {legal[1]}"
        return Outcome.failure(name, collision, "crashed", reason)
    reason, marked = one_line(outcome.reason), one_line(outcome.marked)
    if (reason, marked) == (outcome.reason, outcome.marked):
        return outcome
    return replace(outcome, reason=reason, marked=marked)


def why_unavailable(solver: Solver) -> str | None:
    """Return why a solver cannot run here, in a line; None if it can."""
    try:
        reason = solver.unavailable()
        return None if reason is None else one_line(reason)
    except Exception as error:
        return f"asked whether it is available, it failed: {said(error)}"


def stated_version(solver: Solver) -> str:
    """Return the version a solver states, in a line; ``""`` if it cannot."""
    try:
        return one_line(solver.version())
    except Exception:
        return ""


def said(error: Exception) -> str:
    """Return what an exception says, in a line."""
    return one_line(f"{type(error).__name__}: {error}")


def one_line(text: str) -> str:
    """Return a text as tables, terminals and pages can show it: one line of printable characters, not too long."""
    if not text.isprintable():
        text = " ".join(visible(text[: 2 * LONGEST]).split())
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 3]}..."


def visible(text: str) -> str:
    r"""Write what a terminal would obey, or nobody would see, as Python does: ``\x1b``, ``\u202e``.

    Line feeds, tabs and spaces of any width stay.
    """

    def shown(letter: str) -> bool:
        return letter.isprintable() or letter in "\n\t" or unicodedata.category(letter) == "Zs"

    return "".join(each if shown(each) else each.encode("unicode_escape").decode() for each in text)
