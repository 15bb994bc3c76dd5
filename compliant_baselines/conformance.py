"""Checks that a solver obeys the rules in the docstring of `solver`; the name of a check says what it demands.

The checks are for authors of solvers. The command ``impact-xval solvers NAME`` runs them on an installed solver. An
author's own tests get them from `checks`, one function for each test (docs/adding-a-solver.md).

A check that fails raises `NonConformingError`. The message says what was found and what the rule demands. Numbers of
rules refer to the docstring of `solver`. Checks compare the solver with the exact solvers of this package.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import cast

import numpy as np

from impact_xval.compliant_baselines.answers import answer, describe_exception
from impact_xval.compliant_baselines.registry import exact_law_names, get_solver
from impact_xval.compliant_baselines.solver import KELVIN_VOIGT, Scenario, Settings, Solver
from impact_xval.model.collision import Collision
from impact_xval.model.graph.collision import BodyContact, GraphCollision
from impact_xval.model.outcome import Outcome
from impact_xval.model.status import RESULT_STATUSES

#: Laws that a solver may state: a law that this package solves exactly, or ``none`` for any other law. A solver with
#: the law ``none`` is not compared with an exact solution.
LAWS = (*exact_law_names(), "none")

Check = Callable[[Solver], None]

_ORDINARY = (
    Collision.two_balls(m1=1.0, m2=2 / math.sqrt(3), k1=1e6, k2=1e6, e1=0.9, e2=0.7),
    Collision.two_balls(m1=1.0, m2=0.5, k1=1e6, k2=1e7, e1=0.6, e2=0.8),
    Collision.two_balls(m1=1.0, m2=2.0, k1=1e6, k2=2e5, e1=1.0, e2=1.0),
)

#: A drop on a table that is so soft that the outcome depends on the weight of the balls.
_DROPPED = Collision.two_balls(m1=1.0, m2=1.0, k1=2e3, k2=1e3, e1=0.9, e2=0.7)

#: Two contact graphs that every solver must solve or refuse: a ball in a corner, and a box that lands flat.
_CORNER = GraphCollision(
    (1.0,),
    ((-1.0, -0.3),),
    (BodyContact((1, None), (0, 1), 1e6, 0.9), BodyContact((1, None), (1, 0), 2e6, 0.7)),
)
_BOX = GraphCollision(
    (1.0,),
    ((0.0, -1.0),),
    tuple(BodyContact((1, None), (0, 1), 1e6, 0.8, ((x, -1.0), (0, 0))) for x in (1.0, -1.0)),
    inertias=(0.5,),
)

#: Error of velocities in m/s, by scenario, below which a solver passes even if its error does not shrink with the step.
#: The error of a drop changes its sign at some step length. So a small error may grow when the step is shortened.
_NEAR = {"impact": 1e-3, "drop": 5e-3}

#: Laws whose contacts may pull. Along a path their impulses may decrease.
_PULLING = ("linear-dashpot",)

#: Likely mistakes of a solver, by the scenario in which it is wrong; messages name them.
_SUSPECTS = {
    "impact": "a mapping of stiffness or damping",
    "drop": "gravity, or the depth of rest at the start,",
}

_COARSE = Settings(step_fraction=5e-3)

#: Time steps, as fractions of the shorter contact period, at which the error of a solver is measured.
_FRACTIONS = (4e-3, 1e-3)

#: Largest number of steps of a collision. A collision that needs more is given up. If a solver has no gravity, the
#: balls of a drop never come back to each other, and the collision never ends.
_MAX_STEPS = 200_000


class NonConformingError(AssertionError):
    """Error that a check raises: the solver breaks a rule."""


def demand(holds: object, message: str) -> None:
    """Raise `NonConformingError` with a message if a condition is false."""
    if not holds:
        raise NonConformingError(message)


def _outcomes(
    solver: Solver, collisions: Sequence[Collision] = _ORDINARY, settings: Settings = _COARSE
) -> list[Outcome]:
    """Solve collisions; raise an error if an outcome has the status ``crashed``."""
    outcomes = list(answer(solver, list(collisions), settings))
    for c, o in zip(collisions, outcomes, strict=True):
        demand(o.status != "crashed", f"{c}: {o.reason}")
    return outcomes


def _results(solver: Solver, settings: Settings = _COARSE) -> list[tuple[Collision, Outcome]]:
    """Solve the ordinary collisions (`_ORDINARY`); raise an error unless each of them has a result."""
    solved = list(zip(_ORDINARY, _outcomes(solver, settings=settings), strict=True))
    for c, o in solved:
        demand(o.status in RESULT_STATUSES, f"{c}: status {o.status} ({o.reason}); legal: a result")
    return solved


def _bits(outcomes: Sequence[Outcome]) -> list[tuple[object, ...]]:
    """Return the parts of outcomes that must have the same bits in every call."""
    return [(o.velocities, o.impulses, o.states, o.status) for o in outcomes]


def names_itself(solver: Solver) -> None:
    """Demand legal values of the name, the version and `unavailable`, and a constructor without arguments (rule 1)."""
    # A solver by another author may return values of any type, whatever its annotations say.
    name = cast(object, solver.name)
    version = cast(object, solver.version())
    reason = cast(object, solver.unavailable())
    demand(
        isinstance(name, str) and name.isprintable() and name.strip(),
        f"name = {name!r}; legal: printable text",
    )
    demand(isinstance(version, str), f"version() gave {version!r}; legal: text")
    demand(reason is None or reason, f"unavailable() gave {reason!r}; legal: a reason, or None")
    demand(type(solver)().name == solver.name, "constructed without arguments it has another name")


def answers_every_collision(solver: Solver) -> None:
    """Demand a result for each ordinary collision, in order, with the same bits in any batch (rules 2, 4)."""
    together = [o for _, o in _results(solver)]
    for o in together:
        demand(o.solver == solver.name, f"the outcome is signed {o.solver!r}, not {solver.name!r}")
    demand(_bits(_outcomes(solver)) == _bits(together), "a repeated call returned different outcomes")
    backwards = _outcomes(solver, _ORDINARY[::-1])[::-1]
    demand(_bits(backwards) == _bits(together), "in another order the outcomes are different")
    alone = [_outcomes(type(solver)(), [c])[0] for c in _ORDINARY]
    demand(_bits(alone) == _bits(together), "one by one the outcomes are different")


def refuses_with_a_reason(solver: Solver) -> None:
    """Demand a result or a refusal with a reason for limiting cases, N balls, a drop and contact graphs (rule 2).

    A collision that the solver refuses must not change the outcomes of other collisions in the same call.
    """
    ordinary = {"m1": 1.0, "m2": 1.0, "k1": 1e6, "k2": 1e6, "e1": 0.5, "e2": 0.5}
    changes: list[dict[str, float]] = [{"e1": 0.0}, {"e2": 0.0}, {"k2": math.inf}, {"k2": 0.0}]
    limits = [Collision.two_balls(**ordinary | change) for change in changes]
    chain = Collision((1.0, 1.0, 1.0), (1e6, 1e6), (0.9, 0.9), (-1.0, 0.0, 0.0))
    outcomes = _outcomes(solver, [_ORDINARY[0], *limits, chain, _ORDINARY[1]])
    same = _bits([outcomes[0], outcomes[-1]]) == _bits(_outcomes(solver, _ORDINARY[:2]))
    demand(same, "a collision it cannot do changes the outcomes of others in the same call")
    _outcomes(solver, _ORDINARY, dataclasses.replace(_COARSE, scenario="drop"))
    graphs = [_CORNER, _BOX]
    answers = solver.solve_graphs(graphs, _COARSE)
    demand(len(answers) == len(graphs), f"{len(answers)} outcomes for {len(graphs)} contact graphs")
    for graph, answer_to_graph in zip(graphs, answers, strict=True):
        told = answer_to_graph.has_result or answer_to_graph.reason
        demand(told, f"{graph}: status {answer_to_graph.status} without a reason")
        demand(answer_to_graph.status != "crashed", f"{graph}: {answer_to_graph.reason}")


def ends_apart_and_creates_no_energy(solver: Solver) -> None:
    """Demand v1 >= v2 >= 0 at the end, impulses that explain the velocities, and no gain of energy (rules 5, 6)."""
    for c, o in _results(solver):
        demand(o.v1 >= o.v2 >= 0, f"{c}: v1, v2 = {o.v1}, {o.v2}; the balls are not apart")
        off = max(abs(c.m1 * (o.v1 - c.v0) - o.impulse1), abs(c.m2 * o.v2 - (o.impulse2 - o.impulse1)))
        balanced = off <= 1e-6 * c.m1 * abs(c.v0)
        demand(balanced, f"{c}: impulses {o.impulse1}, {o.impulse2} N s do not make these velocities")
        kept = o.retained_energy(c)
        demand(kept <= 1.01, f"{c}: {kept:.3f} of the kinetic energy after the collision")
        ends = o.states[:1] + o.states[-1:]
        demand(ends == ("S1", "S4"), f"{c}: states {o.states}; legal: S1 first, S4 last")


def scales(solver: Solver) -> None:
    """Demand that scaling all masses, all stiffnesses or the speed only scales the outcome (Theorem 5, rule 5)."""
    c = _ORDINARY[0]
    (base,) = _outcomes(solver, [c])
    for quantity, factor in (("m", 1e-2), ("m", 30.0), ("k", 1e-2), ("k", 40.0), ("v", 0.2), ("v", 3.0)):
        m, k, v = (factor if quantity == symbol else 1.0 for symbol in "mkv")
        scaled = Collision.two_balls(c.m1 * m, c.m2 * m, c.k1 * k, c.k2 * k, c.e1, c.e2, c.v0 * v)
        (o,) = _outcomes(solver, [scaled])
        off = math.hypot(o.v1 / v - base.v1, o.v2 / v - base.v2)
        scaling = f"with {quantity} times {factor:g}"
        demand(off < 1e-3, f"{scaling} v/v0 differs by {off:.2g}: units, or a number that is absolute")
        off = abs(o.impulse1 / (m * v) - base.impulse1)
        demand(off < 2e-3 * c.m1, f"{scaling} the impulse does not scale")


def gives_a_path(solver: Solver) -> None:
    """Demand a path from v0 to the outcome, in order of time, if a path is asked for; and no path otherwise.

    Impulses must not decrease along the path, unless the contacts of the solver's law may pull.
    """
    for c, o in _results(solver, dataclasses.replace(_COARSE, record_path=True)):
        p, speed = o.path, abs(c.v0)
        if p is None:
            raise NonConformingError("no path, although Settings.record_path is set")
        off = math.hypot(p.v1[0] - c.v0, p.v2[0])
        demand(off <= 1e-12 * speed, f"a path starts at {p.v1[0]}, {p.v2[0]} m/s, not at v0 = {c.v0}, 0")
        off = math.hypot(p.v1[-1] - o.v1, p.v2[-1] - o.v2)
        demand(off <= 1e-9 * speed, f"a path ends {off:.2g} m/s away from the outcome")
        demand(bool(np.all(np.diff(p.time) >= 0)), "times of a path decrease")
        falls = -np.diff(p.impulses, axis=0).min()
        pulls = f"an impulse along a path decreases by {falls:.2g} N s: a contact pulls"
        demand(solver.law in _PULLING or falls <= solver.rounding * c.m1 * speed, pulls)
    demand(all(o.path is None for o in _outcomes(solver)), "a path although Settings.record_path is not set")


def converges_to(law: str) -> Check:
    """Make the check that a solver converges to the exact solver of a law as its step goes to zero (rule 3)."""

    def converges(solver: Solver) -> None:
        cases: list[tuple[Collision, Scenario]] = [*((c, "impact") for c in _ORDINARY), (_DROPPED, "drop")]
        for c, scenario in cases:
            settings = [Settings(scenario, step_fraction=step, max_steps=_MAX_STEPS) for step in _FRACTIONS]
            (exact,) = _outcomes(get_solver(law), [c], settings[0])
            outcomes = [_outcomes(solver, [c], at_step)[0] for at_step in settings]
            refused = [o.status == "unrepresentable" for o in (exact, *outcomes)]
            if scenario == "drop" and any(refused):
                continue
            for o in outcomes:
                demand(o.status in RESULT_STATUSES, f"{c}, {scenario}: status {o.status} ({o.reason})")
            before, after = (math.hypot(o.v1 - exact.v1, o.v2 - exact.v2) for o in outcomes)
            # The second step is a quarter of the first, so that an error of first order shrinks to a quarter. An error
            # that does not shrink has another cause than the step.
            shrinks = after < 0.4 * before
            demand(
                after < 0.02 and (after < _NEAR[scenario] or shrinks),
                f"{c}, {scenario}: at a step of {_FRACTIONS[1]:g} periods {after:.2g} m/s away from {law}, "
                f"{before:.2g} at {_FRACTIONS[0]:g}: another law, or {_SUSPECTS[scenario]} that is off",
            )

    converges.__name__ = f"converges_to_{law.replace('-', '_')}"
    converges.__doc__ = f"Demand convergence in the step to `{law}`, the exact motion under its law (rule 3)."
    return converges


def checks(law: str | None = KELVIN_VOIGT) -> tuple[Check, ...]:
    """Return the checks of a solver.

    Parameters
    ----------
    law
        The law of the solver's contacts, one of `LAWS`. With None or ``"none"`` the solver is not compared with
        an exact solution.

    Returns
    -------
    tuple[Check, ...]
        Functions of a solver that raise `NonConformingError`.

    Raises
    ------
    ValueError
        If no exact solver has this law.
    """
    if law is not None and law not in LAWS:
        raise ValueError(f"law = {law!r}; legal: {', '.join(LAWS)}")
    common = (
        names_itself,
        answers_every_collision,
        refuses_with_a_reason,
        ends_apart_and_creates_no_energy,
        scales,
        gives_a_path,
    )
    return common if law in (None, "none") else (*common, converges_to(law))


def problem_of(check: Check, solver: Solver) -> str:
    """Run a check, and return the message of the failure or of the solver's exception; ``""`` if the check passed."""
    try:
        check(solver)
    except NonConformingError as error:
        return str(error)
    except Exception as error:
        return f"it raised {describe_exception(error)}"
    return ""


def problems(solver: Solver, law: str | None = KELVIN_VOIGT) -> dict[str, str]:
    """Run all checks of a solver, and return the messages of the failed checks by their names."""
    messages = {check.__name__: problem_of(check, solver) for check in checks(law)}
    return {name: message for name, message in messages.items() if message}
