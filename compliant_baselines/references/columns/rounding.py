"""Columns of N balls whose outcome in time rounding decides, or the next jump of their law: they are marked.

A column of many unlike balls has hundreds of events, each of which amplifies what came before, up to the point at
which the last digits of its inputs decide: two exact solvers of one law then differ by as much as two laws do. Where
forces are linear, masses and stiffnesses are changed by a millionth; velocities are not, as those of balls that fall or
strike together are equal by intent. Elsewhere the solver states an error of its own.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from impact_xval.compliant_baselines.references.columns.solving import MAX_STEPS, solve_column
from impact_xval.model.collision import RESULT_STATUSES
from impact_xval.model.columns.column import Column, ColumnOutcome

#: Relative change of masses and stiffnesses, and the change of a velocity, over the largest speed before, beyond which
#: an outcome is marked: a hundred times as much.
CHANGE, MOVED = 1e-6, 1e-4

#: Changes that are tried, each with its opposite.
_PAIRS = 2


def mark_columns(
    outcomes: Sequence[ColumnOutcome],
    columns: Sequence[Column],
    law: str,
    exponent: float = 1.0,
    *,
    frozen: bool = False,
    max_steps: int = MAX_STEPS,
) -> list[ColumnOutcome]:
    """Mark the outcomes of which the exact law says that they mean little.

    Parameters
    ----------
    outcomes, columns : sequence
        Of a solver that has the law or was asked for it; what is marked or has no result stays as it is.
    law : str
        One of `contact_law.COLUMN_LAWS`.
    exponent, frozen, max_steps
        As of `solving.solve_column`.
    """

    def solved(column: Column) -> ColumnOutcome:
        return solve_column(column, law, exponent=exponent, frozen=frozen, max_steps=max_steps)

    marked = list(outcomes)
    for i, (outcome, column) in enumerate(zip(outcomes, columns, strict=True)):
        if outcome.marked or not np.isfinite(outcome.velocities).all():
            continue
        # The outcome of an engine is not that of its law.
        exact = outcome if outcome.solver == law else solved(column)
        speed = max(map(abs, column.velocities))
        if exact.status not in RESULT_STATUSES:
            continue
        error = exact.diagnostics.get("velocity_error")
        if error is not None:
            moved, why = error, "its own error"
        else:
            moved = max(_apart(exact, solved(other)) for other in changed(column))
            why = f"a change of {CHANGE:g} in masses and stiffnesses"
        if not moved <= MOVED * speed:
            says = f"{why} moves the exact outcome of {law} by {moved / speed:.2g} |v0|"
            marked[i] = replace(outcome, marked=says)
    return marked


def changed(column: Column) -> list[Column]:
    """Change all masses and stiffnesses of a column by a millionth, up or down at random, and the opposite."""
    balls, contacts = len(column.masses), len(column.stiffnesses)
    signs = np.random.default_rng(0).choice([-1.0, 1.0], (_PAIRS, balls + contacts))
    found = []
    for some in (*signs, *-signs):
        masses, stiffnesses = np.split(1 + CHANGE * some, [balls])
        found.append(
            replace(
                column,
                masses=tuple(column.masses * masses),
                stiffnesses=tuple(column.stiffnesses * stiffnesses),
            )
        )
    return found


def _apart(one: ColumnOutcome, other: ColumnOutcome) -> float:
    """Largest difference of velocities in m/s; infinite where the other has no result."""
    if other.status not in RESULT_STATUSES:
        return math.inf
    return float(np.abs(np.subtract(one.velocities, other.velocities)).max())
