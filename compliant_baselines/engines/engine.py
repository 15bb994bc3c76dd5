"""What every engine adapter shares: refusing, setting up, and saying what came of it."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from impact_xval.compliant_baselines import registry
from impact_xval.compliant_baselines.engines.column import BEYOND, Column, column_of, unrepresentable
from impact_xval.compliant_baselines.engines.convergence import Limit, estimate_limits
from impact_xval.compliant_baselines.engines.line import Line, line_of, unrepresentable_column
from impact_xval.compliant_baselines.engines.lines import LineRun, outcome_of_line
from impact_xval.compliant_baselines.engines.packages import version_of
from impact_xval.compliant_baselines.engines.recording import Run, states_of
from impact_xval.compliant_baselines.engines.trajectory import REST, STUCK
from impact_xval.compliant_baselines.references import marked
from impact_xval.compliant_baselines.solver import Settings, Solver, by_kind, no_gravity
from impact_xval.model.collision import Collision, Collisions, Outcome


class EngineSolver(Solver):
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
        """Why this engine cannot take a column, in one sentence; None if it can."""
        return _too_shallow(column) or self.own_refusal(column)

    def own_refusal(self, column: Column) -> str | None:
        """Why this engine in particular cannot, as `refusal`."""
        return None

    def run_lines(self, lines: Sequence[Line], max_steps: int, record_path: bool = False) -> list[LineRun]:
        """Run every line of N balls until its collision is over or `max_steps` steps are taken; in order."""
        return []

    def line_refusal(self, line: Line) -> str | None:
        """Why this engine cannot take a line of N balls, in one sentence; None if it can."""
        return f"{self.name} has no adapter for columns of N balls"

    def _solve_columns(self, columns: Sequence[Collision], settings: Settings) -> Sequence[Outcome]:
        if registry.is_naive(self.name):
            settings = replace(settings, mapping="naive")
        missing = self.unavailable()
        outcomes: dict[int, Outcome] = {}
        lines: dict[int, Line] = {}
        for i, column in enumerate(columns):
            refused = no_gravity(settings) or unrepresentable_column(column)
            if not missing and not refused:
                try:
                    lines[i] = line_of(column, settings)
                    refused = _too_shallow(lines[i]) or self.line_refusal(lines[i])
                except ArithmeticError:
                    refused = BEYOND
            if missing or refused:
                lines.pop(i, None)
                status = "unavailable" if missing else "unrepresentable"
                outcomes[i] = Outcome.failure(self.name, column, status, missing or refused or "")
        done = self.run_lines(list(lines.values()), settings.max_steps, settings.record_path) if lines else []
        runs = dict(zip(lines, done, strict=True))
        outcomes |= {i: outcome_of_line(self.name, columns[i], run, settings) for i, run in runs.items()}
        self._add_limits(outcomes, self.run_lines, runs, settings)
        answered = [outcomes[i] for i in range(len(columns))]
        if settings.mapping == "naive" or self.law is None or not runs:
            return answered  # its contacts are not those of the law
        return marked(answered, columns, self.law, settings)

    def column_or_refusal(self, collision: Collision, settings: Settings) -> Column | str:
        """Set a collision up as a column that this engine takes, or say in one sentence why it takes none."""
        refused = unrepresentable(collision)
        if refused is not None:
            return refused
        try:
            column = column_of(collision, settings)
            # Energies are told over that at the start.
            refused = None if 0 < column.m1 * column.v1 * column.v1 < math.inf else BEYOND
            return refused or self.refusal(column) or column
        except ArithmeticError:
            return BEYOND

    def solve_many(self, collisions: Sequence[Collision], settings: Settings) -> Sequence[Outcome]:
        """Answer every collision, in order; failures are outcomes with a status."""

        def solve(some: Collisions) -> Sequence[Outcome]:
            if some.falls_on_resting.all():
                return self._solve_two_balls(list(some), settings)
            return self._solve_columns(list(some), settings)

        return by_kind(collisions, solve)

    def _solve_two_balls(self, collisions: Sequence[Collision], settings: Settings) -> list[Outcome]:
        if registry.is_naive(self.name):
            settings = replace(settings, mapping="naive")
        reason = self.unavailable()
        if reason is not None:
            return [Outcome.failure(self.name, each, "unavailable", reason) for each in collisions]
        outcomes: dict[int, Outcome] = {}
        columns: dict[int, Column] = {}
        for i, collision in enumerate(collisions):
            column = self.column_or_refusal(collision, settings)
            if isinstance(column, str):
                outcomes[i] = Outcome.failure(self.name, collision, "unrepresentable", column)
            else:
                columns[i] = column
        done = self.run_columns(list(columns.values()), settings.max_steps, settings.record_path)
        runs = dict(zip(columns, done, strict=True))
        outcomes |= {i: outcome_of(self.name, collisions[i], run, settings) for i, run in runs.items()}
        ends = self._add_limits(outcomes, self.run_columns, runs, settings)
        answered = [outcomes[i] for i in range(len(collisions))]
        if settings.mapping == "naive" or self.law is None:
            return answered  # its contacts are not those of the law
        return marked(answered, collisions, self.law, settings, ends)

    def _add_limits(
        self,
        outcomes: dict[int, Outcome],
        run_again: Callable[[Sequence[Any], int], Sequence[Any]],
        runs: Mapping[int, Run] | Mapping[int, LineRun],
        settings: Settings,
    ) -> dict[int, tuple[bool, bool]]:
        """Add the limits dt -> 0 to outcomes, if they are asked for; how they ended, where known, as for `mark`."""
        over = {i: run for i, run in runs.items() if run.over}
        if settings.convergence is None or not over:
            return {}
        limits = estimate_limits(
            run_again,
            self.regularisation_probe,
            list(over.values()),
            settings.convergence,
            settings.max_steps,
        )
        for i, (limit, reason) in zip(over, limits, strict=True):
            outcomes[i] = with_limit(outcomes[i], limit, reason)
        return {
            i: (limit.flight, limit.rest)
            for i, (limit, _) in zip(over, limits, strict=True)
            if limit is not None
        }


def _too_shallow(column: Column | Line) -> str | None:
    """Why no ball of any engine has these contacts, if none has: its radius follows from how deep they go."""
    if column.depth(*(contact.k for contact in column.contacts)) > 0:
        return None
    return BEYOND


def outcome_of(solver: str, collision: Collision, run: Run, settings: Settings) -> Outcome:
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
        return Outcome.failure(solver, collision, run.status, run.problem() + advice)
    runs = states_of(run, settings.shortest_state)
    diagnostics = {
        "step": column.step,
        "n_steps": float(run.raw.n_steps),
        "duration": run.duration,
        "energy_gain": run.energy_gain(),
    }
    if column.gravity:
        diagnostics["gravity_number"] = column.gravity / (abs(column.v1) * column.contact1.omega)
    if run.fall is not None:
        diagnostics["first_flight"] = run.fall[0] * column.step
    v1, v2 = run.reported
    if run.end in (REST, STUCK):
        diagnostics["rest_speed"] = run.v2
    reason = run.too_much_energy()
    return Outcome(
        solver=solver,
        velocities=(v1, v2),
        impulses=tuple(map(float, run.impulses(v1, v2, run.duration))),
        states=runs.names,
        status="unconverged" if reason else "ok",
        reason=reason,
        n_events=len(runs.names) - 1,
        diagnostics=diagnostics,
        path=run.path(runs) if run.points is not None else None,
    )


def with_limit(outcome: Outcome, limit: Limit | None, reason: str) -> Outcome:
    """Add to an outcome the limit dt -> 0, and why it is not converged, if it is not.

    `diagnostics` gains `v1_limit`, `v2_limit`, ..., `limit_error` and the part of it that is `regularisation` (all
    in m/s), `order` and `finest_step` (s), see `engines.convergence`. The outcome's own numbers
    stay those of the step it was asked for.
    """
    if reason and outcome.status == "ok":
        outcome = replace(outcome, status="unconverged", reason=reason)
    if limit is None:
        return outcome
    return replace(outcome, diagnostics={**outcome.diagnostics, **limit.stated})
