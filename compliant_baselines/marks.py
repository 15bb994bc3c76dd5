"""Marks: sentences that warn of outcomes near a jump of their exact law.

A small change of the collision changes such an outcome a lot.

**Two balls on a table** (docs/theory.md, section 8). An outcome gets a mark if a relative change of one parameter, up
or down, moves a velocity over abs(v0) by more than `JUMPS` allows. Over the default ranges of parameters, outcomes that
are far from a jump move by less than three times the change (`benchmarks/limits.py jumps`). A limit dt -> 0 of an
engine also gets a mark if its run with the shortest time step and the exact law end differently: if only one of the two
has a first flight that ends gravity, or only one has B2 at rest on the table.

**N balls** have hundreds of events. Each event amplifies earlier differences, until the last digits of the inputs
determine the outcome. Two exact solvers of one law then differ as much as the solvers of two laws. Where forces are
linear, masses and stiffnesses are changed by a millionth. Velocities are not changed, because balls that fall or strike
together have equal velocities on purpose. Where forces are not linear, the mark depends on the error that the exact
solver states.

`JUMPS` defines a jump of two balls on a table; docs/theory.md repeats it. `CHANGE_OF_MANY` and `MOVE_OF_MANY` define a
jump of N balls. All other thresholds only select the collisions that are examined. Tests are in
tests/compliant_baselines: `engines/test_limit.py`, and `references/test_chains.py` for N balls. Golden values contain
the marks of exact solvers.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_xval.model.arrays import Floats
from impact_xval.model.collisions import Collisions
from impact_xval.model.outcomes import Outcomes

Bools = NDArray[np.bool_]

#: Function that solves collisions by a law, without recording their states. Its arguments are the collisions and
#: gravity in m/s^2, shape (n,).
Law = Callable[[Collisions, Floats], Outcomes]

#: Relative changes of a parameter that are tried. Each has the change of a velocity over abs(v0) above which the
#: outcome is taken to jump. The shortest time step of an engine acts like a change of a restitution by more than a
#: thousandth.
JUMPS = {1e-3: 0.01, 4e-3: 0.02}

#: Names of the parameters that are changed, as they appear in marks.
PARAMETERS = ("k2/k1", "m2/m1", "e1", "e2", "gravity")


class Change(NamedTuple):
    """A relative change of one parameter of a collision."""

    #: The parameter, as its position in `PARAMETERS`.
    parameter: int
    #: Relative change: a number of `JUMPS` or its negative.
    size: float


#: All changes of one parameter that are tried.
CHANGES = tuple(Change(i, sign * size) for i in range(len(PARAMETERS)) for size in JUMPS for sign in (1, -1))

#: Relative change of masses and stiffnesses for collisions of N balls.
CHANGE_OF_MANY = 1e-6

#: Change of a velocity, over the largest speed before the collision, from which an outcome of N balls gets a mark. It
#: is a hundred times the change of the parameters.
MOVE_OF_MANY = 1e-4

#: Number of random patterns of changes that are tried for N balls. Each pattern is also tried with all signs reversed.
_RANDOM_CHANGES = 2

#: Signs of the changes when all five parameters are changed at once, one pattern a row. The patterns are orthogonal
#: except in gravity. To first order, no change of a single parameter moves an outcome farther than the best of these
#: patterns or its opposite.
_PATTERNS = np.array([(1, 1, 1, 1, 1), (1, -1, 1, -1, 1), (1, 1, -1, -1, -1), (1, -1, -1, 1, -1)])

#: Relative changes of all five parameters at once: each pattern of signs, followed by its opposite; shape (8, 5). Such
#: a cheap change of all parameters is called a screen.
_SCREENS = max(JUMPS) * np.stack([_PATTERNS, -_PATTERNS], axis=1).reshape(-1, 5)
_FIRST_SCREENS, _OTHER_SCREENS = _SCREENS[:2], _SCREENS[2:]

# The thresholds below only save time. They must not let any mark get lost; `benchmarks/limits.py screens` counts lost
# marks.

#: Grazing margin of a bistiffness collision below which the first pattern of changes is tried. Among 28 000 collisions
#: without gravity, with k2/k1 from 1e-3 to 1e3 and m2/m1 and e from 0.1, the largest margin of a marked one was 0.11.
GRAZING = 0.2

#: Grazing margin of a bistiffness collision below which all patterns of changes are tried.
NEAR_GRAZING = 0.03

#: Restitution from which a bistiffness collision is examined whatever its grazing margin is. The margin ignores ends of
#: compression at which hardly any energy is lost, but a change of e makes them lose energy.
ELASTIC = 0.999

#: For laws with dashpots: number of events from which a collision is examined. Without gravity its outcome has no jumps
#: and is steep only where contacts return. If contacts only close and open once, there are two events.
FEW_EVENTS = 3

#: For laws with dashpots: number of events from which all single changes of a collision are tried at once.
MANY_EVENTS = 20

#: Mass ratio m2/m1 below which a collision is examined whatever its number of events is. A lower ball as light as this
#: can take up any speed.
LIGHT = 0.05

#: Change of a velocity by gravity, over abs(v0). From this change on, the outcome can depend on the instant at which
#: gravity ends.
FALLEN = 0.02

#: Change of a velocity, over abs(v0), when all parameters are changed at once. From this change on, single changes are
#: tried.
SCREENED_MOVE = 0.005

#: Relative change of a grazing margin when all parameters are changed at once. From this change on, single changes are
#: tried.
SCREENED_MARGIN = 0.25

_LARGEST = float(np.finfo(float).max)


class DropEnd(NamedTuple):
    """Two facts on how a drop ends."""

    #: True if gravity ended because all contacts were open, in a first flight.
    has_first_flight: bool
    #: True if B2, the lower ball, came to rest on the table.
    b2_settled: bool


#: Sentences of a mark, for a drop that ends differently in an engine and by the exact law. The braces stand for the
#: names of the engine and the law.
_DIFFERENT_FLIGHT = "gravity ends in a first flight of {}, and {} has none"
_DIFFERENT_REST = "by {} the lower ball comes to rest on the table, and by {} it leaves"


@dataclass(frozen=True, slots=True)
class Screening:
    """Masks of shape (n,), which select the collisions of an array that are examined for jumps in three ways."""

    #: True for collisions on which the first pattern of changes and its opposite are tried.
    first_pair: Bools
    #: True for collisions on which the other patterns are tried too, if the first one moves the outcome little.
    all_patterns: Bools
    #: True for collisions in which every parameter is changed alone, without trying patterns first.
    full: Bools


@dataclass(frozen=True, slots=True)
class LargestMoves:
    """Largest changes of outcomes when single parameters change a little; arrays of shape (n,)."""

    #: Largest change of a velocity, divided by the change that `JUMPS` allows. Above 1 it is a jump. It is infinite if
    #: a changed collision has no result, NaN if the collision itself has no result, and 0 if no change was tried.
    excess: Floats
    #: The single change that moves the velocity most, as its position in `CHANGES`.
    change: NDArray[np.intp]


def marks_of(
    law: Law,
    name: str,
    collisions: Collisions,
    exact: Outcomes,
    gravity: Floats,
    engine_ends: Sequence[DropEnd | None] = (),
) -> NDArray[np.object_]:
    """Return for each outcome the reason of its mark as a sentence, or an empty text if it is not marked.

    Parameters
    ----------
    law, name
        The law that a solver obeys or is asked for, and its name.
    collisions
        The n collisions, all of one layout (`solver.group_by_layout`).
    exact
        The outcomes of the collisions by the law.
    gravity
        Gravity in m/s^2, shape (n,).
    engine_ends
        For each of the n collisions, how the drop ended in the engine's run with the shortest time step; None where
        this is not known. Empty if there are no such runs.
    """
    marks = np.full(len(collisions), "", dtype=object)
    if not len(collisions):
        return marks
    if not collisions.falls_on_resting.all():
        reason, moves = rounding_moves(law, collisions, exact)
        for i in np.flatnonzero(~(moves <= MOVE_OF_MANY) & exact.has_result):
            marks[i] = f"{reason} moves the exact outcome of {name} by {moves[i]:.2g} |v0|"
        return marks
    largest = find_jumps(law, collisions, exact, gravity)
    for i in np.flatnonzero(largest.excess > 1).tolist():
        parameter, size = CHANGES[int(largest.change[i])]
        move = largest.excess[i] * JUMPS[abs(size)]
        change = f"a change of {size:g} in {PARAMETERS[parameter]}"
        marks[i] = f"{change} moves the exact outcome of {name} by {move:.2g} |v0|"
    for i, engine_end in enumerate(engine_ends):
        if engine_end is not None and not marks[i]:
            marks[i] = _compare_ends(name, _drop_end_of(exact, i), engine_end)
    return marks


def _drop_end_of(exact: Outcomes, i: int) -> DropEnd:
    """Return how drop i ended, read from the diagnostics of the outcomes."""
    first_flight, rest_speed = (exact.diagnostics[key][i] for key in ("first_flight", "rest_speed"))
    return DropEnd(bool(np.isfinite(first_flight)), bool(np.isfinite(rest_speed)))


def _compare_ends(name: str, exact: DropEnd, engine: DropEnd) -> str:
    """Return a sentence on how the drop by the exact law and the drop in an engine end differently.

    The sentence is empty if both end in the same way.
    """
    exact_first, engine_first = (f"exact {name}", "the engine"), ("the engine", f"exact {name}")
    if exact.has_first_flight != engine.has_first_flight:
        return _DIFFERENT_FLIGHT.format(*(exact_first if exact.has_first_flight else engine_first))
    if exact.b2_settled != engine.b2_settled:
        return _DIFFERENT_REST.format(*(exact_first if exact.b2_settled else engine_first))
    return ""


def find_jumps(
    law: Law, collisions: Collisions, exact: Outcomes, gravity: Floats, *, everywhere: bool = False
) -> LargestMoves:
    """Change every parameter of two balls on a table a little, and return how far the outcomes move.

    Parameters are changed one by one only where a jump may be near, unless `everywhere` is true. To find these
    collisions, their outcomes are examined first (`_plan_screening`), then all parameters are changed at once
    (`_SCREENS`). The thresholds of both stages must not let any mark get lost. `benchmarks/limits.py screens` counts
    lost marks.
    """
    # A collision without a result after the largest number of steps is not tried again. It may have taken a second, and
    # every change would take another second.
    has_result = exact.has_result
    plan = _plan_screening(collisions, exact, gravity)
    full = has_result & (plan.full | everywhere)
    for screened, changes in ((plan.first_pair, _FIRST_SCREENS), (plan.all_patterns, _OTHER_SCREENS)):
        rows = np.flatnonzero(has_result & screened & ~full)
        if rows.size:
            full[rows] = _moves_on_screen(law, collisions, exact, gravity, rows, changes)
    excess, largest = np.where(has_result, 0.0, np.nan), np.zeros(len(collisions), np.intp)
    rows = np.flatnonzero(full)
    if rows.size:
        falls = gravity[rows].any()
        tried = [change for change in CHANGES if falls or PARAMETERS[change.parameter] != "gravity"]
        parameter, size = (np.array(values) for values in zip(*tried, strict=True))
        one_at_a_time = np.eye(len(PARAMETERS))[parameter] * size[:, None]
        _, moves = _solve_changed(law, collisions, exact, gravity, rows, one_at_a_time)
        allowed = np.array([JUMPS[abs(change.size)] for change in tried])[:, None]
        ratios = np.where(np.isnan(moves), np.inf, moves) / allowed
        excess[rows], largest[rows] = ratios.max(axis=0), np.argmax(ratios, axis=0)
    return LargestMoves(excess, largest)


def _plan_screening(collisions: Collisions, exact: Outcomes, gravity: Floats) -> Screening:
    """Choose the collisions that may be near a jump, from their outcomes."""
    speed, light = collisions.units[1], collisions.mass_ratio < LIGHT
    margin = _margin(exact)
    v1, v2 = exact.v1 / speed, exact.v2 / speed
    gravity_matters, b2_rests = np.zeros(len(v1), bool), _drop_ends(exact) > 0
    if gravity.any():
        flight = exact.diagnostics["first_flight"]
        falling = np.where(np.isnan(flight), exact.diagnostics["duration"], flight)
        with np.errstate(over="ignore", invalid="ignore"):
            fallen = gravity * falling / speed
            would_return = np.minimum(v2, v1 - v2) < fallen
            gravity_matters = (fallen > FALLEN) & (b2_rests | would_return)
    has_dashpots = np.isinf(margin)
    elastic = ~has_dashpots & (collisions.restitutions.max(axis=1) > ELASTIC)
    returns = has_dashpots & (exact.n_events >= FEW_EVENTS)
    # If the law has dashpots, a ball can come to rest at any instant, even next to the instant at which the other ball
    # comes down again.
    rests_any_time = gravity_matters & b2_rests
    return Screening(
        first_pair=(margin < GRAZING) | elastic | returns | gravity_matters | light,
        all_patterns=gravity_matters | light | (margin < NEAR_GRAZING),
        full=has_dashpots & ((exact.n_events >= MANY_EVENTS) | rests_any_time),
    )


def _moves_on_screen(
    law: Law,
    collisions: Collisions,
    exact: Outcomes,
    gravity: Floats,
    rows: NDArray[np.intp],
    changes: Floats,
) -> Bools:
    """Return which of the rows move so far that parameters must be changed one by one; a mask of shape (rows,).

    All parameters are changed at once, in the patterns `changes`.
    """
    changed, moves = _solve_changed(law, collisions, exact, gravity, rows, changes)
    margin, changed_margin = _margin(exact)[rows], _margin(changed).reshape(moves.shape)
    smaller = np.minimum(margin, changed_margin)
    with np.errstate(invalid="ignore"):
        grazes = (smaller < GRAZING) & (abs(changed_margin - margin) > SCREENED_MARGIN * smaller)
    events_matter = np.isinf(margin) | (collisions.mass_ratio[rows] < LIGHT)
    other_events = events_matter & (changed.n_events.reshape(moves.shape) != exact.n_events[rows])
    other_end = _drop_ends(changed).reshape(moves.shape) != _drop_ends(exact)[rows]
    moves_far = ~(moves <= SCREENED_MOVE)
    return (moves_far | grazes | other_events | other_end).any(axis=0)


def _solve_changed(
    law: Law,
    collisions: Collisions,
    exact: Outcomes,
    gravity: Floats,
    rows: NDArray[np.intp],
    changes: Floats,
) -> tuple[Outcomes, Floats]:
    """Solve rows with changed parameters. Return the outcomes, and the largest changes of a velocity over abs(v0).

    `changes` are m sets of relative changes, shape (m, 5). The outcomes contain all rows with the first set, then all
    rows with the second set, and so on. The largest changes have the shape (m, rows). The gravity number stays the
    same, except where the set changes it.
    """
    m, n = len(changes), len(rows)
    repeated, ones = collisions[np.tile(rows, m)], np.ones(m * n)
    k2, m2, e1, e2, g = np.repeat(1 + changes, n, axis=0).T
    with np.errstate(over="ignore"):
        masses = np.minimum(repeated.masses * np.column_stack([ones, m2]), _LARGEST)
        stiffnesses = np.minimum(repeated.stiffnesses * np.column_stack([ones, k2]), _LARGEST)
    restitutions = np.minimum(repeated.restitutions * np.column_stack([e1, e2]), 1.0)
    changed = replace(repeated, masses=masses, stiffnesses=stiffnesses, restitutions=restitutions)
    # The gravity number is g/(|v0| omega), omega = sqrt(k1/M) with the reduced mass M of the two balls.
    same_number = np.sqrt((1 + 1 / changed.mass_ratio) / (1 + 1 / repeated.mass_ratio))
    outcomes = law(changed, same_number * (np.tile(gravity[rows], m) * g))
    differences = np.abs(outcomes.velocities.reshape(m, n, 2) - exact.velocities[rows])
    return outcomes, differences.max(axis=2) / collisions.units[1][rows]


def _margin(outcomes: Outcomes) -> Floats:
    """Return grazing margins; infinite for laws that have no margin."""
    return np.where(np.isnan(outcomes.grazing_margin), np.inf, outcomes.grazing_margin)


def _drop_ends(outcomes: Outcomes) -> NDArray[np.int64]:
    """Return how drops ended: 0 if both balls left the table, 1 if B2 rests on the table, 2 if both balls rest."""
    b2_rests = np.isfinite(outcomes.diagnostics.get("rest_speed", np.full(len(outcomes), np.nan)))
    return np.where(b2_rests, np.where(outcomes.v1 == 0, 2, 1), 0)


def rounding_moves(law: Law, collisions: Collisions, exact: Outcomes) -> tuple[str, Floats]:
    """Estimate how far rounding moves the outcomes of N balls.

    All masses and stiffnesses are changed by a millionth, up or down at random, and then the other way round. The
    function returns a phrase that names the change, and the largest change of a velocity over the largest speed before,
    shape (n,). Where the exact solver states an error of its own, this error is returned instead.
    """
    c, balls, speed = collisions, collisions.masses.shape[1], np.abs(collisions.velocities).max(axis=1)
    if "velocity_error" in exact.diagnostics:
        return "its own error", exact.diagnostics["velocity_error"] / speed
    largest = np.zeros(len(c))
    signs = np.random.default_rng(0).choice([-1.0, 1.0], (_RANDOM_CHANGES, balls + c.stiffnesses.shape[1]))
    for pattern in (*signs, *-signs):
        m, k = np.split(1 + CHANGE_OF_MANY * pattern, [balls])
        changed = law(replace(c, masses=c.masses * m, stiffnesses=c.stiffnesses * k), np.zeros(len(c)))
        differences = np.abs(changed.velocities - exact.velocities)
        moves = np.where(changed.has_result[:, None], differences, np.inf)
        largest = np.maximum(largest, moves.max(axis=1))
    return f"a change of {CHANGE_OF_MANY:g} in masses and stiffnesses", largest / speed
