"""Outcomes beside a jump of their exact law, found by changing the parameters of a collision a little: they are marked.

**Two balls on a table** (docs/theory.md, section 8). A cell is marked where a relative change of one parameter, either
way, moves a velocity per abs(v0) by more than `JUMPS` says; smooth outcomes move by less than three times the change
over the default box (`benchmarks/limits.py jumps`). A limit dt -> 0 is marked too where its shortest step and the exact
law do not agree on whether gravity ends in a first flight, or on whether B2 comes to rest on the table.

**N balls** have hundreds of events, each of which amplifies what came before, up to the point at which the last digits
of the inputs decide: two exact solvers of one law then differ by as much as two laws do. Where forces are linear,
masses and stiffnesses are changed by a millionth; velocities are not, as those of balls that fall or strike together
are equal by intent. Elsewhere the solver states an error of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from impact_xval.model.arrays import Floats
from impact_xval.model.collisions import Collisions
from impact_xval.model.outcomes import Outcomes

#: What solves collisions by a law, at a gravity in m/s^2 each, without their states.
Law = Callable[[Collisions, Floats], Outcomes]

#: Relative changes of a parameter that are tried, and the change of a velocity per abs(v0) from which on it is a jump.
#: To a restitution an engine's finest step does more than a thousandth.
JUMPS = {1e-3: 0.01, 4e-3: 0.02}

#: What is changed, and how a reader knows it.
CHANGED = ("k2/k1", "m2/m1", "e1", "e2", "gravity")

#: Position in `CHANGED` and relative change of every try.
TRIED = tuple((i, sign * size) for i in range(len(CHANGED)) for size in JUMPS for sign in (1, -1))

#: Of N balls: relative change of masses and stiffnesses; the change of a velocity, over the largest speed before, from
#: which on an outcome is marked, a hundred times as much; and how many changes are tried, each with its opposite.
CHANGE, MOVED, _PAIRS = 1e-6, 1e-4, 2

#: Relative changes of a screen: all parameters at once, in four patterns that are orthogonal but for gravity, each with
#: its opposite. No change of one parameter moves an outcome by more than the best of them, to first order.
_PATTERNS = np.array([(1, 1, 1, 1, 1), (1, -1, 1, -1, 1), (1, 1, -1, -1, -1), (1, -1, -1, 1, -1)])
_SCREENS = max(JUMPS) * np.stack([_PATTERNS, -_PATTERNS], axis=1).reshape(-1, 5)

#: Below a margin of `GRAZING` a bistiffness cell is screened, below `GRAZING_MORE` by all patterns. The largest margin
#: of a marked cell was 0.11 in 28 000 cells without gravity, k2/k1 from 1e-3 to 1e3, m2/m1 and e from 0.1.
GRAZING, GRAZING_MORE = 0.2, 0.03

#: From this restitution on a margin does not see the end of compression that a change of e makes costly.
ELASTIC = 0.999

#: Laws of dashpots are continuous without gravity: steep is only what has contacts that return, more than the two
#: events of contacts that close and open once. From `MANY` events on a cell is tried in full, unscreened.
FEW, MANY = 3, 20

#: A lower ball lighter than this share of the upper one, which takes up any speed, is screened whatever its events.
LIGHT = 0.05

#: What gravity must have done to a velocity per abs(v0) for its first flight to matter.
FALLEN = 0.02

#: What a screen must do for a cell to be tried in full: move a velocity by so much, a grazing margin by such a share.
STIRRED, MARGIN_MOVED = 0.005, 0.25

#: How the ends of an engine and of its exact law may differ, by the diagnostics of the one that has it.
ENDS = {
    "first_flight": "gravity ends in a first flight of {}, and {} has none",
    "rest_speed": "by {} the lower ball comes to rest on the table, and by {} it leaves",
}

_LARGEST = float(np.finfo(float).max)


def marks_of(
    law: Law,
    name: str,
    collisions: Collisions,
    exact: Outcomes,
    gravity: Floats,
    ends: Mapping[int, tuple[bool, bool]] | None = None,
) -> NDArray[np.object_]:
    """Say of each collision, shape (n,), why its outcome means little, in one sentence; empty where it does not.

    The law, and its name, is that of a solver, or that it was asked for; `exact` are its outcomes, gravity is in m/s^2,
    shape (n,). Of drops `ends` says by their position whether the engine's run that decides on them had a first flight,
    and whether B2 came to rest on the table.
    """
    says = np.full(len(collisions), "", dtype=object)
    if not len(collisions):
        return says
    if not collisions.falls_on_resting.all():
        why, moved = rounding(law, collisions, exact)
        for i in np.flatnonzero(~(moved <= MOVED) & exact.has_result):
            says[i] = f"{why} moves the exact outcome of {name} by {moved[i]:.2g} |v0|"
        return says
    excess, which = jumps(law, collisions, exact, gravity)
    for i in np.flatnonzero(excess > 1):
        parameter, change = TRIED[which[i]]
        far = excess[i] * JUMPS[abs(change)]
        what = f"a change of {change:g} in {CHANGED[parameter]}"
        says[i] = f"{what} moves the exact outcome of {name} by {far:.2g} |v0|"
    for i, own in (ends or {}).items():
        for (key, text), engine in zip(ENDS.items(), own, strict=True):
            exactly = bool(np.isfinite(exact.diagnostics[key][i]))
            if not says[i] and engine != exactly:
                both = f"exact {name}", "the engine"
                says[i] = text.format(*(both if exactly else both[::-1]))
    return says


def jumps(
    law: Law, collisions: Collisions, exact: Outcomes, gravity: Floats, *, everywhere: bool = False
) -> tuple[Floats, NDArray[np.intp]]:
    """Change every parameter of two balls on a table a little and see how far the outcome moves.

    That is tried where a jump may be near, or `everywhere`. Near is decided in two stages: by the outcome itself
    (`_suspects`), and by screens, which change all parameters at once (`_SCREENS`). The thresholds are measured:
    `benchmarks/limits.py screens` counts the marks that are lost.

    Gives the largest change of a velocity over what `JUMPS` says, shape (n,), and which of `TRIED` makes it: above 1 it
    is a jump. Infinite if a change leaves no result, NaN where the collision itself has none, 0 where none was tried.
    """
    solved = exact.has_result  # one that was given up may have taken a second, and would at every try
    once, twice, near = (solved & flags for flags in _suspects(collisions, exact, gravity))
    near |= everywhere & solved
    for some, changes in ((once, _SCREENS[:2]), (twice, _SCREENS[2:])):
        asked = np.flatnonzero(some & ~near)
        if asked.size:
            near[asked] = _stirred(law, collisions[asked], exact, gravity[asked], asked, changes)
    excess, which = np.where(solved, 0.0, np.nan), np.zeros(len(collisions), np.intp)
    asked = np.flatnonzero(near)
    tried = [(i, change) for i, change in TRIED if gravity[asked].any() or CHANGED[i] != "gravity"]
    if asked.size:
        place, change = (np.array(each) for each in zip(*tried, strict=True))
        alone = np.eye(len(CHANGED))[place] * change[:, None]
        _, away = _moved(law, collisions[asked], exact, gravity[asked], asked, alone)
        allowed = np.array([JUMPS[abs(size)] for _, size in tried])[:, None]
        over = np.where(np.isnan(away), np.inf, away) / allowed
        excess[asked], which[asked] = over.max(axis=0), np.argmax(over, axis=0)
    return excess, which


def _suspects(collisions: Collisions, exact: Outcomes, gravity: Floats) -> tuple[NDArray[np.bool_], ...]:
    """Tell what is to be screened, what by the other patterns too, and what is tried in full unscreened."""
    speed, light = collisions.units[1], collisions.mass_ratio < LIGHT
    margin = _margin(exact)
    v1, v2 = exact.v1 / speed, exact.v2 / speed
    pulled, over = np.zeros(len(v1), bool), _end(exact) > 0
    if gravity.any():
        flight = exact.diagnostics["first_flight"]
        fall = np.where(np.isnan(flight), exact.diagnostics["duration"], flight)
        with np.errstate(over="ignore", invalid="ignore"):
            fallen = gravity * fall / speed
            pulled = (fallen > FALLEN) & (over | (np.minimum(v2, v1 - v2) < fallen))
    dashpots = np.isinf(margin)
    hidden = ~dashpots & (collisions.restitutions.max(axis=1) > ELASTIC)
    apart = pulled | light
    once = (margin < GRAZING) | hidden | (dashpots & (exact.n_events >= FEW)) | apart
    # Dashpots bring a ball to rest at any instant, next to the one at which the other comes down again.
    return once, apart | (margin < GRAZING_MORE), dashpots & ((exact.n_events >= MANY) | (pulled & over))


def _stirred(
    law: Law, some: Collisions, exact: Outcomes, gravity: Floats, asked: NDArray[np.intp], changes: Floats
) -> NDArray[np.bool_]:
    """Tell which of the collisions asked for a screen moves far enough to be tried in full."""
    other, away = _moved(law, some, exact, gravity, asked, changes)
    margin, then = _margin(exact)[asked], _margin(other).reshape(away.shape)
    least = np.minimum(margin, then)
    with np.errstate(invalid="ignore"):
        grazes = (least < GRAZING) & (abs(then - margin) > MARGIN_MOVED * least)
    counted = np.isinf(margin) | (some.mass_ratio < LIGHT)
    chatters = counted & (other.n_events.reshape(away.shape) != exact.n_events[asked])
    ends = _end(other).reshape(away.shape) != _end(exact)[asked]
    return (~(away <= STIRRED) | grazes | chatters | ends).any(axis=0)


def _moved(
    law: Law, some: Collisions, exact: Outcomes, gravity: Floats, asked: NDArray[np.intp], changes: Floats
) -> tuple[Outcomes, Floats]:
    """Solve with parameters changed by relative amounts (m, 5): outcomes, and the largest move of a velocity (m, n).

    The gravity number keeps its value where it is not changed itself.
    """
    m, n = len(changes), len(some)
    same, one = some[np.tile(np.arange(n), m)], np.ones(m * n)
    k2, m2, e1, e2, g = np.repeat(1 + changes, n, axis=0).T
    with np.errstate(over="ignore"):
        masses = np.minimum(same.masses * np.column_stack([one, m2]), _LARGEST)
        stiffnesses = np.minimum(same.stiffnesses * np.column_stack([one, k2]), _LARGEST)
    restitutions = np.minimum(same.restitutions * np.column_stack([e1, e2]), 1.0)
    others = replace(same, masses=masses, stiffnesses=stiffnesses, restitutions=restitutions)
    lighter = np.sqrt((1 + 1 / others.mass_ratio) / (1 + 1 / same.mass_ratio))
    found = law(others, lighter * (np.tile(gravity, m) * g))
    away = np.abs(found.velocities.reshape(m, n, 2) - exact.velocities[asked]).max(axis=2) / some.units[1]
    return found, away


def _margin(outcomes: Outcomes) -> Floats:
    """Grazing margins, infinite under laws that state none."""
    return np.where(np.isnan(outcomes.grazing_margin), np.inf, outcomes.grazing_margin)


def _end(outcomes: Outcomes) -> NDArray[np.int64]:
    """How drops ended: 0 with both balls off the table, 1 with B2 at rest on it, 2 with both."""
    rested = np.isfinite(outcomes.diagnostics.get("rest_speed", np.full(len(outcomes), np.nan)))
    return np.where(rested, np.where(outcomes.v1 == 0, 2, 1), 0)


def rounding(law: Law, collisions: Collisions, exact: Outcomes) -> tuple[str, Floats]:
    """Say what was changed of N balls, and the largest change of a velocity over the largest speed before.

    All masses and stiffnesses are changed by a millionth, up or down at random, and by the opposite.
    """
    c, balls, speed = collisions, collisions.masses.shape[1], np.abs(collisions.velocities).max(axis=1)
    if "velocity_error" in exact.diagnostics:
        return "its own error", exact.diagnostics["velocity_error"] / speed
    moved = np.zeros(len(c))
    signs = np.random.default_rng(0).choice([-1.0, 1.0], (_PAIRS, balls + c.stiffnesses.shape[1]))
    for some in (*signs, *-signs):
        m, k = np.split(1 + CHANGE * some, [balls])
        found = law(replace(c, masses=c.masses * m, stiffnesses=c.stiffnesses * k), np.zeros(len(c)))
        away = np.where(found.has_result[:, None], np.abs(found.velocities - exact.velocities), np.inf)
        moved = np.maximum(moved, away.max(axis=1))
    return f"a change of {CHANGE:g} in masses and stiffnesses", moved / speed
