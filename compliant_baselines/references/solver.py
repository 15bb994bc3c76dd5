"""What the engine-free references have in common as solvers.

All of them are exact to rounding between events, and none has a time step. Both scenarios of `Settings` are
known to them; `step_fraction`, `shortest_state` and `mapping` do not concern them.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from importlib.metadata import version

import numpy as np
from numpy.typing import NDArray

from impact_xval.compliant_baselines.contact.column import unrepresentable
from impact_xval.compliant_baselines.contract.solver import Settings, SolverBase, no_gravity
from impact_xval.compliant_baselines.contract.trajectory import FREE, STUCK
from impact_xval.compliant_baselines.references.batch import Floats, ReferenceBatch
from impact_xval.compliant_baselines.references.contact_law import COLUMN_LAWS
from impact_xval.compliant_baselines.references.driver import LOG_WIDTH, Followed, Law, collide
from impact_xval.compliant_baselines.references.ending import TOO_LONG
from impact_xval.compliant_baselines.references.jumps import mark
from impact_xval.compliant_baselines.references.path import curve_of, events_of, state_names
from impact_xval.model.collision import Collision, Outcome
from impact_xval.model.columns.column import Column, ColumnOutcome

#: Rows of the first try at a log; a collision that needs more is run once more.
LOG_ROWS = 512


class ReferenceSolver(SolverBase):
    """A reference behind the contract: a subclass names its law.

    Statuses beside `ok`: `limit` (only `bistiffness`: a contact became rigid), `unrepresentable` (e_i = 0,
    k_i = 0 or infinite), `timeout` (not over after `Settings.max_steps` segments).
    """

    @abstractmethod
    def batch(self, *cells: Floats) -> ReferenceBatch:
        """Follow many collisions at once, given k2/k1, m2/m1, e1, e2 and the gravity number."""

    @abstractmethod
    def law(self, collision: Collision) -> Law:
        """Give the law its numbers for one collision."""

    def version(self) -> str:
        """Version of this project: the reference is its own."""
        return version("impact-xval")

    def solve_many(self, collisions: Sequence[Collision], settings: Settings) -> list[Outcome]:
        """Answer every collision, in order."""
        outcomes = [self._one(c, settings) for c in collisions]
        return mark(outcomes, collisions, settings, self.name, self.batch)

    def solve_columns(
        self, columns: Sequence[Column], settings: Settings, exponent: float = 1.0
    ) -> list[ColumnOutcome]:
        """Answer every column of N balls, in order."""
        # With scipy's integrators, which nobody else here needs.
        from impact_xval.compliant_baselines.references.columns.rounding import mark_columns
        from impact_xval.compliant_baselines.references.columns.solving import solve_column

        reason = no_gravity(settings)
        if self.name not in COLUMN_LAWS:
            reason = (
                f"{self.name} is a law of two balls on a table; legal for columns: {', '.join(COLUMN_LAWS)}"
            )
        if reason is not None:
            return [ColumnOutcome.failure(self.name, column, "unrepresentable", reason) for column in columns]
        steps = settings.max_steps
        outcomes = [
            solve_column(column, self.name, exponent=exponent, path=settings.record_path, max_steps=steps)
            for column in columns
        ]
        if not settings.mark:
            return outcomes
        return mark_columns(outcomes, columns, self.name, exponent, max_steps=steps)

    def refusal(self, collision: Collision) -> str | None:
        """Say why the law does not represent a collision; None if it does."""
        return unrepresentable(collision)

    def _one(self, c: Collision, settings: Settings) -> Outcome:
        reason = self.refusal(c)
        if reason is not None:
            return Outcome.failure(self.name, "unrepresentable", reason)
        unit, law = c.units, self.law(c)
        gravity = settings.gravity if settings.scenario == "drop" else 0.0
        g = gravity * unit.time / unit.velocity
        followed, log = self._follow(law, c, g, settings.max_steps, LOG_ROWS)
        n_rows = followed.n_steps + 1
        if n_rows > LOG_ROWS:
            followed, log = self._follow(law, c, g, settings.max_steps, n_rows)
        if followed.end == TOO_LONG:
            return Outcome.failure(
                self.name, "timeout", f"not over after max_steps = {settings.max_steps} segments"
            )
        log = log[:n_rows]
        v1, v2, fall = followed.v1, followed.v2, followed.fall
        diagnostics = {"duration": followed.duration * unit.time, "n_steps": float(followed.n_steps)}
        if g > 0:
            diagnostics["gravity_number"] = c.gravity_number(gravity)
            if fall < followed.duration:
                diagnostics["first_flight"] = fall * unit.time
        if followed.end != FREE:
            diagnostics["rest_speed"] = v2 * unit.velocity
            v1, v2 = (0.0 if followed.end == STUCK else v1), 0.0
        # Impulses go with the velocities reported, as those of engines do.
        impulse1 = 1 + v1 + g * fall
        impulse2 = impulse1 + c.mass_ratio * (v2 + g * fall)
        return Outcome(
            solver=self.name,
            v1=v1 * unit.velocity,
            v2=v2 * unit.velocity,
            impulse1=impulse1 * unit.impulse,
            impulse2=impulse2 * unit.impulse,
            states=state_names(log),
            status="limit" if followed.limited else "ok",
            reason="a contact became rigid: closed form from there on" if followed.limited else "",
            n_events=followed.n_events,
            diagnostics=diagnostics,
            path=curve_of(c, log, law) if settings.record_path else None,
            events=events_of(c, log),
        )

    @staticmethod
    def _follow(
        law: Law, c: Collision, g: float, max_steps: int, rows: int
    ) -> tuple[Followed, NDArray[np.float64]]:
        log = np.zeros((rows, LOG_WIDTH))
        ratios = c.stiffness_ratio, c.mass_ratio
        return collide(law.code, *ratios, law.a1, law.a2, g, law.cutoff, False, max_steps, log), log
