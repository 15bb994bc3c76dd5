"""Whether a solver keeps the contract: checks that an adapter's author can run, each named by what it demands.

From the command line, for a solver that is installed: ``impact-xval conform NAME``. In the author's own tests:

    import pytest
    from impact_xval.compliant_baselines.conformance import checks
    from my_package.adapter import MyEngineSolver

    @pytest.mark.parametrize("check", checks("kelvin-voigt"), ids=lambda check: check.__name__)
    def test_contract(check):
        check(MyEngineSolver())

A check raises `NonConformingError`, whose message says what was found and what the contract demands (rule numbers
are those of `solver`). Numbers are held against the exact references of this package, never
against the solver's own.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from impact_xval.compliant_baselines.answers import (
    IllegalOutcomeError,
    raise_ctrl_c,
    said,
    validated,
)
from impact_xval.compliant_baselines.registry import get_solver
from impact_xval.compliant_baselines.solver import Settings, Solver, SolverError
from impact_xval.model.collision import RESULT_STATUSES, Collision, Outcome

#: Laws a solver may say it has, and the reference it is then held against.
Law = Literal["kelvin-voigt", "hunt-crossley", "none"]
LAWS: tuple[Law, ...] = ("kelvin-voigt", "hunt-crossley", "none")

Check = Callable[[Solver], None]

_ORDINARY = (
    Collision.two_balls(m1=1.0, m2=2 / math.sqrt(3), k1=1e6, k2=1e6, e1=0.9, e2=0.7),
    Collision.two_balls(m1=1.0, m2=0.5, k1=1e6, k2=1e7, e1=0.6, e2=0.8),
    Collision.two_balls(m1=1.0, m2=2.0, k1=1e6, k2=2e5, e1=1.0, e2=1.0),
)
_COARSE = Settings(step_fraction=5e-3)


class NonConformingError(AssertionError):
    """A solver does not keep the contract."""


def demand(kept: object, message: str) -> None:
    """Raise `NonConformingError` unless something holds."""
    if not kept:
        raise NonConformingError(message)


def _outcomes(
    solver: Solver, collisions: Sequence[Collision] = _ORDINARY, settings: Settings = _COARSE
) -> list[Outcome]:
    outcomes = solver.solve_many(list(collisions), settings)
    demand(len(outcomes) == len(collisions), f"{len(outcomes)} outcomes for {len(collisions)} collisions")
    try:
        return [validated(*each) for each in zip(outcomes, collisions, strict=True)]
    except IllegalOutcomeError as error:
        raise NonConformingError(str(error)) from error


def _with_outcomes(solver: Solver, settings: Settings = _COARSE) -> zip[tuple[Collision, Outcome]]:
    return zip(_ORDINARY, _outcomes(solver, settings=settings), strict=True)


def names_itself(solver: Solver) -> None:
    """Demand a name, a version and a say on whether it is available (rule 1)."""
    demand(isinstance(solver, Solver), f"lacks a method of {Solver.__module__}.Solver")
    printable = isinstance(solver.name, str) and solver.name.isprintable() and solver.name.strip()
    demand(printable, f"name = {solver.name!r}; legal: printable text")
    demand(isinstance(solver.version(), str), f"version() gave {solver.version()!r}; legal: text")
    reason = solver.unavailable()
    said = reason is None or (isinstance(reason, str) and reason)
    demand(said, f"unavailable() gave {reason!r}; legal: text or None")
    demand(type(solver)().name == solver.name, "constructed without arguments it has another name")


def answers_every_collision(solver: Solver) -> None:
    """Demand one outcome for each collision, in order, none for none, finite where the status is ok (rule 2)."""
    demand(list(solver.solve_many([], _COARSE)) == [], "solve_many([]) is not empty")
    outcomes = _outcomes(solver)
    for c, o in zip(_ORDINARY, outcomes, strict=True):
        result = o.status in RESULT_STATUSES
        demand(result, f"{c}: status {o.status} ({o.reason}); an ordinary collision needs a result")
        demand(o.solver == solver.name, f"the outcome is signed {o.solver!r}, not {solver.name!r}")
    (alone,) = _outcomes(solver, _ORDINARY[:1])
    demand(abs(alone.v1 - outcomes[0].v1) < 1e-3, "outcomes are not in the order of the collisions")


def same_bits_in_any_company(solver: Solver) -> None:
    """Demand that an outcome does not depend on what else is solved, before or at once (rule 6)."""

    def bits(outcomes: Sequence[Outcome]) -> list[tuple[Any, ...]]:
        return [(o.v1, o.v2, o.impulse1, o.impulse2, o.states, o.status) for o in outcomes]

    together = bits(_outcomes(solver))
    demand(bits(_outcomes(solver)) == together, "a second time the outcomes are others")
    backwards = bits(_outcomes(solver, _ORDINARY[::-1]))[::-1]
    demand(backwards == together, "in another order the outcomes are others")
    alone = [bits(_outcomes(type(solver)(), [c]))[0] for c in _ORDINARY]
    demand(alone == together, "one by one the outcomes are others")


def refuses_with_a_reason(solver: Solver) -> None:
    """Demand that limits are answered or refused with a reason, and never raise or spoil others (rules 2, 4)."""
    plain = {"m1": 1.0, "m2": 1.0, "k1": 1e6, "k2": 1e6, "e1": 0.5, "e2": 0.5}
    changes: list[dict[str, float]] = [{"e1": 0.0}, {"e2": 0.0}, {"k2": math.inf}, {"k2": 0.0}]
    limits = [Collision.two_balls(**plain | change) for change in changes]
    first, last = _ORDINARY[:2]
    outcomes = _outcomes(solver, [first, *limits, last])
    for c, o in zip(limits, outcomes[1:-1], strict=True):
        if o.status not in RESULT_STATUSES:
            demand(o.reason.strip(), f"{c}: status {o.status} without a reason")
            demand(math.isnan(o.v1) or o.status == "unconverged", f"{c}: status {o.status}, but v1 = {o.v1}")
    alone = [(o.v1, o.v2) for o in _outcomes(solver, [first, last])]
    same = alone == [(o.v1, o.v2) for o in (outcomes[0], outcomes[-1])]
    demand(same, "a collision it cannot do changes the outcome of others in the same call")


def raises_in_a_direct_call(solver: Solver) -> None:
    """Demand that `solve` raises `SolverError` where `solve_many` has no result, and agrees elsewhere (rule 3)."""
    (first,) = _outcomes(solver, _ORDINARY[:1])
    demand(solver.solve(_ORDINARY[0], _COARSE).v1 == first.v1, "solve and solve_many differ")
    plastic = Collision.two_balls(m1=1.0, m2=1.0, k1=1e6, k2=1e6, e1=0.0, e2=0.5)
    (outcome,) = _outcomes(solver, [plastic])
    if outcome.status in RESULT_STATUSES:
        return
    try:
        solver.solve(plastic, _COARSE)
    except SolverError as error:
        found = f"SolverError.status = {error.status}, the outcome's {outcome.status}"
        demand(error.status == outcome.status, found)
    else:
        raise NonConformingError(f"{plastic}: solve gave a result where solve_many says {outcome.status}")


def ends_apart_and_creates_no_energy(solver: Solver) -> None:
    """Demand v1 >= v2 >= 0 at the end, impulses that balance momentum, no energy gained, S1 first, S4 last."""
    for c, o in _with_outcomes(solver):
        demand(o.v1 >= o.v2 >= 0, f"{c}: v1, v2 = {o.v1}, {o.v2}; the balls are not apart")
        off = max(abs(c.m1 * (o.v1 - c.v0) - o.impulse1), abs(c.m2 * o.v2 - (o.impulse2 - o.impulse1)))
        balanced = off <= 1e-6 * c.m1 * abs(c.v0)
        demand(balanced, f"{c}: impulses {o.impulse1}, {o.impulse2} N s do not make these velocities")
        kept = o.retained_energy(c)
        demand(kept <= 1.01, f"{c}: {kept:.3f} of the kinetic energy after the collision")
        ends = o.states[:1] + o.states[-1:]
        demand(ends == ("S1", "S4"), f"{c}: states {o.states}; legal: S1 first, S4 last")


def scales(solver: Solver) -> None:
    """Demand Theorem 5 and SI units: masses, stiffnesses and speed change nothing but scale (rule 7)."""
    c = _ORDINARY[0]
    (base,) = _outcomes(solver, [c])
    for what, factor in (("m", 1e-2), ("m", 30.0), ("k", 1e-2), ("k", 40.0), ("v", 0.2), ("v", 3.0)):
        m, k, v = (factor if what == scaled else 1.0 for scaled in "mkv")
        (o,) = _outcomes(
            solver, [Collision.two_balls(c.m1 * m, c.m2 * m, c.k1 * k, c.k2 * k, c.e1, c.e2, c.v0 * v)]
        )
        off = math.hypot(o.v1 / v - base.v1, o.v2 / v - base.v2)
        found = f"with {what} times {factor:g} v/v0 differs by {off:.2g}: units, or a number that is absolute"
        demand(off < 1e-3, found)
        off = abs(o.impulse1 / (m * v) - base.impulse1)
        demand(off < 2e-3 * c.m1, f"with {what} times {factor:g} the impulse does not scale")


def has_a_drop(solver: Solver) -> None:
    """Demand that the scenario `drop` is answered, weak gravity as none, and B2 at rest reported as such."""
    weak = Settings(scenario="drop", gravity=1e-3, step_fraction=5e-3)
    for a, b in zip(_outcomes(solver, settings=weak), _outcomes(solver), strict=True):
        demand(a.status in RESULT_STATUSES, f"drop: status {a.status} ({a.reason})")
        off = math.hypot(a.v1 - b.v1, a.v2 - b.v2)
        demand(off < 1e-2, f"with g = 1e-3 m/s^2 a drop differs from an impact by {off:.2g} m/s")


def gives_a_path(solver: Solver) -> None:
    """Demand a path on request: from v0 to the outcome, in order of time, impulses growing; none otherwise."""
    for c, o in _with_outcomes(solver, dataclasses.replace(_COARSE, record_path=True)):
        p = o.path
        if p is None:
            raise NonConformingError("no path, although Settings.record_path is set")
        off = math.hypot(p.v1[0] - c.v0, p.v2[0])
        found = f"a path starts at {p.v1[0]}, {p.v2[0]} m/s, not at v0 = {c.v0}, 0"
        demand(off <= 1e-12 * abs(c.v0), found)
        off = math.hypot(p.v1[-1] - o.v1, p.v2[-1] - o.v2)
        demand(off <= 1e-9 * abs(c.v0), f"a path ends {off:.2g} m/s away from the outcome")
        demand(bool(np.all(np.diff(p.time) >= 0)), "times of a path decrease")
        falls = min(np.diff(p.impulse1).min(), np.diff(p.impulse2).min())
        found = f"an impulse along a path decreases by {-falls:.2g} N s: a contact pulls"
        demand(falls >= -1e-9 * c.m1 * abs(c.v0), found)
    demand(all(o.path is None for o in _outcomes(solver)), "a path although Settings.record_path is not set")


def leaves_no_trace(solver: Solver) -> None:
    """Demand that nothing is written into the working directory."""
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        solver.solve_many(list(_ORDINARY), _COARSE)
        left = [path.name for path in Path(folder).iterdir()]
    demand(not left, f"it leaves {', '.join(left)} in the working directory")


def converges_to(reference: str) -> Check:
    """Make the check that a solver converges to a reference of this package as its step goes to zero (rule 5)."""

    def converges(solver: Solver) -> None:
        exact = _outcomes(get_solver(reference), settings=Settings())
        errors = []
        for fraction in (4e-3, 1e-3):
            outcomes = _outcomes(solver, settings=Settings(step_fraction=fraction))
            errors.append(
                [math.hypot(o.v1 - x.v1, o.v2 - x.v2) for o, x in zip(outcomes, exact, strict=True)]
            )
        for c, coarse, fine in zip(_ORDINARY, *errors, strict=True):
            demand(
                fine < 0.02,
                f"{c}: {fine:.2g} m/s away from {reference} at a step of 1e-3 of a period: "
                "another law, or a mapping of stiffness or damping that is off",
            )
            # First order divides by four; an error that stays is not one of the step.
            demand(
                fine < 1e-3 or fine < 0.4 * coarse,
                f"{c}: the difference from {reference} goes from {coarse:.2g} to {fine:.2g} m/s as the step "
                "is divided by four: it does not converge there",
            )

    converges.__name__ = f"converges_to_{reference.replace('-', '_')}"
    converges.__doc__ = (
        f"Demand convergence in the step to `{reference}`, the exact motion under the law it claims (rule 5)."
    )
    return converges


def checks(law: Law = "kelvin-voigt") -> tuple[Check, ...]:
    """All checks, for a solver whose contacts obey a law.

    Parameters
    ----------
    law : str
        One of `LAWS`; ``"none"`` for a law of the solver's own, which is then not checked.

    Raises
    ------
    ValueError
        If the law is another one.
    """
    if law not in LAWS:
        raise ValueError(f"law = {law!r}; legal: {', '.join(LAWS)}")
    common: tuple[Check, ...] = (
        names_itself,
        answers_every_collision,
        same_bits_in_any_company,
        refuses_with_a_reason,
        raises_in_a_direct_call,
        ends_apart_and_creates_no_energy,
        scales,
        has_a_drop,
        gives_a_path,
        leaves_no_trace,
    )
    return common if law == "none" else (*common, converges_to(law))


def conform(solver: Solver, law: Law = "kelvin-voigt") -> Iterator[tuple[Check, str]]:
    """Run the checks one by one.

    Yields
    ------
    check : callable
        Its name and docstring say what it demands.
    problem : str
        What was found; ``""`` if the check passed. An exception of the solver is a finding.
    """
    for check in checks(law):
        yield check, problem_of(check, solver)


def problem_of(check: Check, solver: Solver) -> str:
    """Run a check of a solver; say what was found, as `conform` does."""
    try:
        check(solver)
    except NonConformingError as error:
        return str(error)
    except BaseException as error:
        raise_ctrl_c(error)
        return f"it raised {said(error)}"
    return ""
