"""What the engine-free references have in common as solvers.

All of them are exact to rounding between events, and none has a time step. Both scenarios of `Settings` are
known to them; `step_fraction`, `shortest_state` and `mapping` do not concern them.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from importlib.metadata import version
from itertools import groupby, starmap

import numpy as np
from numpy.typing import NDArray

from impact_xval.compliant_baselines.contact.column import unrepresentable
from impact_xval.compliant_baselines.contract.solver import Settings, SolverBase, no_gravity
from impact_xval.compliant_baselines.references.batch import Floats, Law, ReferenceBatch, follow_all
from impact_xval.compliant_baselines.references.columns.rounding import mark_columns
from impact_xval.compliant_baselines.references.columns.solving import LAWS, solve_column
from impact_xval.compliant_baselines.references.jumps import mark
from impact_xval.model.chain.kernel import ACTS, COLLAPSE, RUNAWAY, TOO_MANY_EVENTS, UNITED, Followed
from impact_xval.model.chain.rest import FREE, STUCK
from impact_xval.model.collision import STATES, Collision, ImpulseCurve, Outcome, in_unit
from impact_xval.model.columns.column import Column, ColumnOutcome
from impact_xval.model.columns.solving import fitting, followed
from impact_xval.model.inputs import beyond_precision

#: Rows of the first try at a log; a collision that needs more is run once more.
LOG_ROWS = 512

#: Points of the path in each piece of a segment; numbers of a row of the log.
POINTS, LOG_WIDTH = 9, 7


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
        reason = no_gravity(settings)
        if self.name not in LAWS:
            reason = f"{self.name} is a law of two balls on a table; legal for columns: {', '.join(LAWS)}"
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

    def _one(self, c: Collision, settings: Settings) -> Outcome:
        ratios = {"k2/k1": c.stiffness_ratio, "m2/m1": c.mass_ratio}
        reason = unrepresentable(c) or next(filter(None, starmap(beyond_precision, ratios.items())), "")
        if reason:
            return Outcome.failure(self.name, "unrepresentable", reason)
        unit, law = c.units, self.law(c)
        gravity = settings.gravity if settings.scenario == "drop" else 0.0
        g = gravity * unit.time / unit.velocity
        points = POINTS if settings.record_path else 1
        one = Law(law.code, np.array([law.a1]), np.array([law.a2]))
        kappa, mu, gravities = (np.array([x]) for x in (c.stiffness_ratio, c.mass_ratio, g))
        problem = one, kappa, mu, gravities, False, settings.max_steps
        log = np.empty((LOG_ROWS, LOG_WIDTH))
        velocities, numbers, sequence = follow_all(*problem, points, log)
        went = followed(numbers, sequence)
        if went.code & TOO_MANY_EVENTS:
            return Outcome.failure(
                self.name, "timeout", f"not over after max_steps = {settings.max_steps} segments"
            )
        if went.rows > LOG_ROWS:
            points, rows = fitting(points, went.rows, LOG_WIDTH)
            log = np.empty((rows, LOG_WIDTH))
            follow_all(*problem, points, log)
        log = log[: went.rows]
        v1, v2 = velocities[0].tolist()
        diagnostics = {"duration": went.time * unit.time, "n_steps": float(went.pieces)}
        if g > 0:
            diagnostics["gravity_number"] = c.gravity_number(gravity)
            if went.fall < went.time:
                diagnostics["first_flight"] = went.fall * unit.time
        path = _path(c, log, went, g) if settings.record_path else None
        if went.end != FREE:
            diagnostics["rest_speed"] = v2 * unit.velocity
            v1, v2 = (0.0 if went.end == STUCK else v1), 0.0
        # Impulses go with the velocities reported, as those of engines do.
        fallen = g * went.fall if g > 0 else 0.0
        impulse1 = 1 + v1 + fallen
        impulse2 = impulse1 + c.mass_ratio * (v2 + fallen)
        limited = went.code & (RUNAWAY | COLLAPSE)
        return Outcome(
            solver=self.name,
            v1=v1 * unit.velocity,
            v2=v2 * unit.velocity,
            impulse1=impulse1 * unit.impulse,
            impulse2=impulse2 * unit.impulse,
            states=tuple(STATES[s] for s, _ in groupby([*_states(log), 4])),
            status="limit" if limited else "ok",
            reason="a contact became rigid: closed form from there on" if limited else "",
            n_events=went.events,
            diagnostics=diagnostics,
            path=path,
        )


def _states(log: Floats) -> NDArray[np.int64]:
    """State of each row of a log, 1 to 4. A rigid contact acts while the other does."""
    flags = log[:, 5:]
    acts = flags == ACTS
    pressed = acts.any(axis=1, keepdims=True)
    return 4 - (acts | ((flags == UNITED) & pressed)) @ np.array([1, 2])


def _path(c: Collision, log: Floats, went: Followed, g: float) -> ImpulseCurve:
    """Impulse curve of a log, in the collision's units. Gravity acts until the first flight."""
    unit, mu = c.units, c.mass_ratio
    time, one, two = log[:, 0], log[:, 1], log[:, 2]
    state = _states(log)
    state[-1] = 4
    # What leaves double precision is said where an outcome is checked (`contract.answers`).
    with np.errstate(over="ignore", invalid="ignore"):
        fallen = g * np.minimum(time, went.fall) if g > 0 else np.zeros_like(time)
        first = 1 + one + fallen
        return ImpulseCurve(
            time=in_unit(time, unit.time),
            impulse1=first * unit.impulse,
            impulse2=(first + mu * (two + fallen)) * unit.impulse,
            v1=one * unit.velocity,
            v2=two * unit.velocity,
            energy1=None,
            energy2=None,
            state=state,
            phase1=np.where(np.isin(state, (1, 3)), np.where(two > one, 1, 2), 0),
            phase2=np.where(np.isin(state, (1, 2)), np.where(two < 0, 1, 2), 0),
        )
