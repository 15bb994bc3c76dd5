"""What every engine adapter shares: refusing, setting up, and saying what came of it."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from math import isnan

from impact_xval.compliant_baselines.contact.column import Column, column_of, unrepresentable
from impact_xval.compliant_baselines.contract import registry
from impact_xval.compliant_baselines.contract.solver import Settings, SolverBase
from impact_xval.compliant_baselines.contract.trajectory import REST, STUCK
from impact_xval.compliant_baselines.engines.convergence import Limit, estimate_limits
from impact_xval.compliant_baselines.engines.packages import version_of
from impact_xval.compliant_baselines.engines.recording import Run, states_of
from impact_xval.compliant_baselines.references.jumps import mark
from impact_xval.compliant_baselines.references.solver import ReferenceSolver
from impact_xval.model.collision import Collision, Outcome

#: Energy an engine may create, over that of B1 before the collision, before its answer counts as
#: `unconverged`. Contacts of springs and dashpots create none; an explicit step of 1/1000 of a period creates
#: 1e-4 of it at most.
ENERGY_GAIN_ALLOWED = 0.01


class EngineSolver(SolverBase):
    """An engine behind the contract: a subclass says how to run columns.

    Statuses beside `ok`: `unavailable` (the engine cannot be imported), `unrepresentable` (e_i = 0, k_i = 0 or
    infinite, or what the engine itself cannot take), `timeout` (not over after `max_steps`), `crashed`
    (numbers that are not finite, or the engine's own complaint), `unconverged` (over, but with more energy
    than it began with, or with a limit dt -> 0 that is not known to the tolerance asked for: the
    outcome keeps its numbers).
    """

    #: Name of the package that is the engine, as distributed.
    distribution: str

    #: How many times as much regularisation of contacts shows what that of the engine does; None: it has none.
    regularisation_probe: float | None = None

    def version(self) -> str:
        """Version of the engine's package, or ``""`` if it is not installed."""
        return version_of(self.distribution)

    @abstractmethod
    def run_columns(self, columns: Sequence[Column], max_steps: int, record_path: bool = False) -> list[Run]:
        """Run every column until its collision is over or `max_steps` steps are taken; in order."""

    def refusal(self, column: Column) -> str | None:
        """Why this engine in particular cannot take a column, in one sentence; None if it can."""
        return None

    def _column_or_refusal(self, collision: Collision, settings: Settings) -> Column | str:
        refused = unrepresentable(collision)
        if refused is not None:
            return refused
        column = column_of(collision, settings)
        return self.refusal(column) or column

    def solve_many(self, collisions: Sequence[Collision], settings: Settings) -> list[Outcome]:
        """Answer every collision, in order; failures are outcomes with a status."""
        if registry.is_naive(self.name):
            settings = replace(settings, mapping="naive")
        reason = self.unavailable()
        if reason is not None:
            return [Outcome.failure(self.name, "unavailable", reason) for _ in collisions]
        outcomes: dict[int, Outcome] = {}
        columns: dict[int, Column] = {}
        for i, collision in enumerate(collisions):
            column = self._column_or_refusal(collision, settings)
            if isinstance(column, str):
                outcomes[i] = Outcome.failure(self.name, "unrepresentable", column)
            else:
                columns[i] = column
        done = self.run_columns(list(columns.values()), settings.max_steps, settings.record_path)
        runs = dict(zip(columns, done, strict=True))
        outcomes |= {i: outcome_of(self.name, run, settings) for i, run in runs.items()}
        flights: dict[int, bool] = {}
        if settings.convergence is not None:
            over = {i: run for i, run in runs.items() if run.over}
            limits = estimate_limits(
                self.run_columns,
                self.regularisation_probe,
                list(over.values()),
                settings.convergence,
                settings.max_steps,
            )
            for i, (limit, reason) in zip(over, limits, strict=True):
                outcomes[i] = with_limit(outcomes[i], limit, reason)
                if limit is not None:
                    flights[i] = limit.flight
        answered = [outcomes[i] for i in range(len(collisions))]
        if settings.mapping == "naive":
            return answered  # its contacts are not those of the law
        law = registry.law_of(self.name)
        exact = registry.get_solver(law)
        assert isinstance(exact, ReferenceSolver)
        return mark(answered, collisions, settings, law, exact.batch, flights)


def outcome_of(solver: str, run: Run, settings: Settings) -> Outcome:
    """Turn a finished run into an outcome.

    `diagnostics` holds `step` (s), `n_steps`, `duration` (s), `energy_gain` (over the energy at the start), for a
    drop `gravity_number` = g/(|v0| omega1) and, if there is one, `first_flight` (s, when gravity ended), and where B2
    came to rest on the table `rest_speed`, its velocity in m/s at the instant the collision was over. Impulses are
    those of the contacts, support of B2's weight included, and go with the velocities reported: for a B2 at rest
    without what it still had.
    """
    column = run.column
    if not run.over:
        advice = "; a smaller step may help" if run.status == "crashed" else ""
        return Outcome.failure(solver, run.status, run.problem() + advice)
    runs = states_of(run, settings.shortest_state)
    gain = run.energy_gain()
    diagnostics = {
        "step": column.step,
        "n_steps": float(run.raw.n_steps),
        "duration": run.duration,
        "energy_gain": gain,
    }
    if column.gravity:
        diagnostics["gravity_number"] = column.gravity / (abs(column.v1) * column.contact1.omega)
    if run.fall is not None:
        diagnostics["first_flight"] = run.fall[0] * column.step
    v1, v2 = run.reported
    if run.end in (REST, STUCK):
        diagnostics["rest_speed"] = run.v2
    impulse1, impulse2 = run.impulses(v1, v2, run.duration)
    reason = ""
    if gain > ENERGY_GAIN_ALLOWED:
        reason = f"it ended with {gain:.1%} more energy than it began with: the step is too long"
    return Outcome(
        solver=solver,
        v1=v1,
        v2=v2,
        impulse1=impulse1,
        impulse2=impulse2,
        states=runs.names,
        status="unconverged" if reason else "ok",
        reason=reason,
        n_events=len(runs.names) - 1,
        diagnostics=diagnostics,
        path=run.path(runs) if run.points is not None else None,
    )


def with_limit(outcome: Outcome, limit: Limit | None, reason: str) -> Outcome:
    """Add to an outcome the limit dt -> 0, and why it is not converged, if it is not.

    `diagnostics` gains `v1_limit`, `v2_limit`, `limit_error` and the part of it that is `regularisation` (all
    in m/s), `order` and `finest_step` (s), see `engines.convergence`. The outcome's own numbers
    stay those of the step it was asked for.
    """
    if reason and outcome.status == "ok":
        outcome = replace(outcome, status="unconverged", reason=reason)
    if limit is None:
        return outcome
    stated = {
        "v1_limit": limit.v1,
        "v2_limit": limit.v2,
        "limit_error": limit.error,
        "regularisation": limit.regularisation,
        "finest_step": limit.step,
        "order": limit.order,
    }
    known = {key: value for key, value in stated.items() if not isnan(value)}
    return replace(outcome, diagnostics={**outcome.diagnostics, **known})
