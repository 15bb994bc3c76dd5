"""The rigid laws as solvers: registered by name, for two balls on a table and for columns of N balls.

A rigid law knows masses, velocities and coefficients of restitution. It ignores stiffnesses, finite or infinite; a
contact of stiffness 0 passes on no force at all, which it cannot say, and is refused. It has no time either: scenario
and step do not concern it, a drop is an impact to it, and all points of a path are at t = 0.

**Phases and states.** A phase is what a law applies at once: the whole impact under Newton's law, compression and
expansion under Poisson's, a single impact of a sequence, a reflection (with e < 1 the blend, in one). A state is
the set of contacts that have an impulse in a phase, where a contact counts as acting until it first has one, as it
does in engines (`contract.state_runs`, rule 1). States are compared by time with those of solvers that have one,
and none of these lasts: what is then compared is S1, S4. A contact of a law without phases of its own is drawn as
compressing.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib.metadata import version
from itertools import groupby

import numpy as np

from impact_xval.compliant_baselines.contract.solver import Settings, SolverBase
from impact_xval.compliant_baselines.rigid.complementarity import MOST_CONDITION
from impact_xval.compliant_baselines.rigid.laws import (
    Jump,
    Law,
    Phase,
    generalised_reflection,
    newton,
    poisson,
    sequential_bottom,
    sequential_top,
)
from impact_xval.compliant_baselines.rigid.row import Row
from impact_xval.model.collision import Collision, ImpulseCurve, Outcome, Status
from impact_xval.model.columns.column import Column, ColumnOutcome

#: Impacts after which a sequence is given up, if `Settings.max_steps` does not do so before.
MOST_IMPACTS = 100_000

_INFINITE = "infinitely many impacts, which go to rest: their limit"
_BEYOND = (
    "masses so different that impulses are not found to ten digits; legal: a Delassus matrix of a condition number up "
    f"to {MOST_CONDITION:.0e}"
)


class RigidSolver(SolverBase):
    """A rigid law behind the contract: a subclass names it.

    Statuses beside `ok`: `limit` (a sequence of infinitely many impacts), `unrepresentable` (see the module, and
    gaps), `timeout` (more than `MOST_IMPACTS` impacts, or `Settings.max_steps`).
    """

    law: Law

    def version(self) -> str:
        """Version of this project: the law is its own."""
        return version("impact-xval")

    def unknown(self, column: Column) -> str | None:
        """Why the law does not know an impact, in a sentence; None if it does."""
        if any(column.gaps):
            return f"gaps = {column.gaps!r} m: under a rigid law all contacts touch; legal: 0"
        return None

    def solve_many(self, collisions: Sequence[Collision], settings: Settings) -> list[Outcome]:
        """Answer every collision, in order."""
        return [self._collision(c, settings) for c in collisions]

    def solve_columns(
        self, columns: Sequence[Column], settings: Settings, exponent: float = 1.0
    ) -> list[ColumnOutcome]:
        """Answer every column of N balls, in order; without a path, which would have forces."""
        return [self._column(column, settings) for column in columns]

    def _collision(self, c: Collision, settings: Settings) -> Outcome:
        for i, k in ((1, c.k1), (2, c.k2)):
            if k == 0:
                reason = (
                    f"k{i} = {k!r} N/m: a contact without stiffness has no force, and a rigid law no "
                    "stiffness; the state-transition model knows the limit"
                )
                return Outcome.failure(self.name, "unrepresentable", reason)
        # The law does not look at stiffnesses; those of a column are finite.
        column = Column((c.m1, c.m2), (1.0, 1.0), (c.e1, c.e2), (c.v0, 0.0), table=True)
        row, jump = self._jump(column, settings)
        if isinstance(jump, str):
            return Outcome.failure(self.name, *_failed(jump))
        v1, v2 = row.velocities_after(jump.rates, jump.impulses)
        impulse1, impulse2 = row.impulses_after(jump.impulses)
        codes = [_code(acting) for acting in _acting(jump, 2)]
        return Outcome(
            solver=self.name,
            v1=v1,
            v2=v2,
            impulse1=impulse1,
            impulse2=impulse2,
            states=tuple(f"S{code}" for code, _ in groupby(codes)),
            status="limit" if jump.infinite else "ok",
            reason=_INFINITE if jump.infinite else "",
            n_events=len(jump.phases),
            path=_curve(c, row, jump, codes, (v1, v2)) if settings.record_path else None,
        )

    def _column(self, column: Column, settings: Settings) -> ColumnOutcome:
        row, jump = self._jump(column, settings)
        if isinstance(jump, str):
            return ColumnOutcome.failure(self.name, column, *_failed(jump))
        sets = [tuple(i + 1 for i in acting) for acting in _acting(jump, len(column.stiffnesses))]
        return ColumnOutcome(
            self.name,
            row.velocities_after(jump.rates, jump.impulses),
            row.impulses_after(jump.impulses),
            states=tuple(acting for acting, _ in groupby(sets)),
            status="limit" if jump.infinite else "ok",
            reason=_INFINITE if jump.infinite else "",
            n_events=len(jump.phases),
        )

    def _jump(self, column: Column, settings: Settings) -> tuple[Row, Jump | str]:
        """Apply the law; in place of what it gives, why it gives nothing."""
        row, most = Row.of(column), min(settings.max_steps, MOST_IMPACTS)
        unknown = self.unknown(column)
        if unknown is not None:
            return row, unknown
        G = row.delassus
        if not np.isfinite(G).all():
            return row, _BEYOND
        try:
            jump = self.law(G, row.rates, row.restitutions, most)
        except (np.linalg.LinAlgError, RuntimeError):
            return row, _BEYOND
        return row, jump if jump.over else f"not over after {most} impacts"


class NewtonSolver(RigidSolver):
    """Newton's restitution at all contacts at once."""

    name = "newton"
    law = staticmethod(newton)


class PoissonSolver(RigidSolver):
    """Poisson's restitution: compression, then expansion."""

    name = "poisson"
    law = staticmethod(poisson)


class SequentialTopSolver(RigidSolver):
    """Single impacts one after another, the topmost contact that approaches first."""

    name = "sequential-top"
    law = staticmethod(sequential_top)


class SequentialBottomSolver(RigidSolver):
    """Single impacts one after another, the lowest contact that approaches first."""

    name = "sequential-bottom"
    law = staticmethod(sequential_bottom)


class GeneralisedReflectionSolver(RigidSolver):
    """Generalised reflections; one coefficient of restitution for all contacts, as its authors have it."""

    name = "generalised-reflection"
    law = staticmethod(generalised_reflection)

    def unknown(self, column: Column) -> str | None:
        """Why the law does not know an impact."""
        first, *others = column.restitutions
        if any(e != first for e in others):
            return (
                f"restitutions = {column.restitutions!r}: generalised reflections know one coefficient for all "
                "contacts; legal: equal ones"
            )
        return super().unknown(column)


def _failed(why: str) -> tuple[Status, str]:
    return ("timeout" if why.startswith("not over") else "unrepresentable"), why


def _acting(jump: Jump, contacts: int) -> list[tuple[int, ...]]:
    """Give the contacts that act in each phase, from 0 on, and at last none."""
    waiting, sets = set(range(contacts)), []
    for phase in jump.phases:
        waiting -= set(phase.contacts)
        sets.append(tuple(sorted(waiting | set(phase.contacts))))
    return [*sets, ()]


def _code(acting: tuple[int, ...]) -> int:
    """Give the state of two balls on a table in which these contacts act."""
    return 4 - 2 * (1 in acting) - (0 in acting)


def _curve(
    c: Collision, row: Row, jump: Jump, codes: list[int], velocities: tuple[float, float]
) -> ImpulseCurve:
    """Give the impulse curve: straight from the beginning of each phase to its end, all of it at t = 0."""
    n = len(jump.phases)
    impulses, phases = np.zeros((n + 1, 2)), np.zeros((n + 1, 2), np.int64)
    for j, phase in enumerate(jump.phases):
        of_contact = _by_contact(phase)
        impulses[j + 1] = impulses[j] + of_contact
        phases[j] = np.where(of_contact > 0, 2 if phase.restores else 1, 0)
    # The beginning and the end of each phase, and the end once more, for S4.
    points, of_phase = np.arange(2 * n + 1) // 2, np.append(np.repeat(np.arange(n), 2), n)
    points[1:-1:2] += 1
    I1, I2 = np.ldexp(impulses[points], row.mass_power + row.velocity_power).T
    v1, v2 = c.v0 + I1 / c.m1, (I2 - I1) / c.m2
    v1[-2:], v2[-2:] = velocities
    phase1, phase2 = phases[of_phase].T
    state = np.array(codes)[of_phase]
    return ImpulseCurve(np.zeros(2 * n + 1), I1, I2, v1, v2, None, None, state, phase1, phase2)


def _by_contact(phase: Phase) -> np.ndarray:
    """Impulses of a phase, shape (2,)."""
    impulses = np.zeros(2)
    impulses[list(phase.contacts)] = phase.impulses
    return impulses
