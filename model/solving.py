"""`solve`: one collision by the state transition model; `solve_many`, `solve_batch`: arrays of them.

Two balls on a table, the upper one falling on the lower one at rest, are followed by `model.pair`, in closed form; all
others by `model.chain` with frozen positions.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from impact_xval.model.chain.following import MAX_PIECES, TOO_FAR_APART, Problem
from impact_xval.model.chain.kernel import COLLAPSE, HAPPENED
from impact_xval.model.chain.laws import LIU_ZHAO_BROGLIATO, STATE_TRANSITION
from impact_xval.model.collision import (
    Collision,
    Collisions,
    Ending,
    Floats,
    Outcome,
    Outcomes,
    Paths,
    States,
    first_endings,
    reasons_of,
    total_impulses,
)
from impact_xval.model.compiled import FEW_STATES, in_shares
from impact_xval.model.inputs import (
    GRAZING_THRESHOLD,
    LEGAL_CUTOFF,
    RATIOS,
    Cutoff,
    checked_array,
    legal_cutoff,
)
from impact_xval.model.pair import kernel
from impact_xval.model.pair.events import MOST_WINDOWS
from impact_xval.model.pair.grazing import CUTOFF_THRESHOLD, MARKS
from impact_xval.model.pair.limits import BOUND
from impact_xval.model.pair.path import LOG_COLUMNS, POINTS

NAME = "state-transition"

#: Impact laws by name: the model's own, and that of Liu, Zhao and Brogliato (`pair.law`); the code of `chain.laws`.
LAWS = {"jia-mason-erdmann": STATE_TRANSITION, "liu-zhao-brogliato": LIU_ZHAO_BROGLIATO}

#: Events after which two balls are given up, within a second. At extreme stiffness ratios there are some 50/(1 - e) of
#: them, for e of the contact that oscillates, or as many as the modes' frequencies are apart if that is fewer.
MAX_EVENTS = 2_000_000

#: Rows a collision of the first try at the log of paths.
LOG_ROWS = 512

#: Collisions that a thread is given at once.
SHARE = 8192


def solve(collision: Collision, *, path: bool = False, **how: Any) -> Outcome:
    """Solve one collision by the state transition model of Jia, Mason and Erdmann.

    Exact where contacts are linear; any other exponent than 1 is integrated, with an error of some 1e-12 of the
    velocity of impact.

    Parameters
    ----------
    collision : Collision
        Every limit is legal: e_i = 0, e_i = 1, of two balls on a table k2/k1 = 0 or infinity.
    path : bool
        Whether the outcome carries `path`.
    **how
        As for `solve_many`.

    Returns
    -------
    Outcome

    Raises
    ------
    ValueError
        For an illegal cut-off, an unknown law, or gaps.
    """
    return solve_many(Collisions.of([collision]), paths=path, **how)[0]


def solve_many(
    collisions: Collisions,
    *,
    law: str = "jia-mason-erdmann",
    stiffness_ratio_cutoff: Cutoff = "exact",
    max_events: int | None = None,
    grazing_threshold: float = GRAZING_THRESHOLD,
    states: bool = True,
    paths: bool = False,
) -> Outcomes:
    """Solve collisions of one number of balls by the state transition model, on all processors.

    Parameters
    ----------
    collisions : Collisions
    law : str
        ``jia-mason-erdmann``, the model's own, or ``liu-zhao-brogliato``, which differs from the second compression of
        a contact on: it runs at the original stiffness.
    stiffness_ratio_cutoff : float or "exact"
        Of two balls on a table, a number greater than 1: when the running ratio k2/k1 exceeds it, or falls below its
        inverse, the closed form of the limiting case finishes the collision (supplement, 3.4, where it is
        `SUPPLEMENT_CUTOFF`). Infinity switches that off. By default the outcome is that without a cut-off, to
        `pair.limits.BOUND`: the closed form finishes the collision once it cannot change more.
    max_events : int, optional
        Events, of N balls pieces of segments, after which a collision is given up; by default some that take a second.
    grazing_threshold : float
        Grazing margin below which an outcome is marked.
    states, paths : bool
        Whether outcomes carry their states and paths; the latter one by one.

    Returns
    -------
    Outcomes
        Status ``closed-form`` where a closed form was used, ``unconverged`` after `max_events`, ``unrepresentable``
        where masses or stiffnesses lie further apart than `MASS_PRECISION`, or so far that rounding made energy, else
        ``ok``.
        Marked where the grazing margin is small or a cut-off changed an outcome by more than `CUTOFF_THRESHOLD`
        (`pair.grazing`). Diagnostics: ``energy_residual``, of the energy balance per kinetic energy at first touch,
        relative to the centre of mass or the table; and with a finite cut-off ``cutoff_effect``, by how much velocities
        differ from the outcome without one (kinetic norm per sqrt(m1) abs(v0)), not there where that is not reached
        within `max_events`.

    Raises
    ------
    ValueError
        For an illegal cut-off, an unknown law, or gaps.
    """
    cutoff = _checked(law, stiffness_ratio_cutoff)
    if collisions.gaps.any():
        raise ValueError(no_positions(collisions))
    two = collisions.falls_on_resting
    if two.any() and not two.all():
        raise ValueError(
            "velocities: B2 rests in some rows and not in others; legal: collisions of one kind at a time"
        )
    if two.any():
        found = _by_diagram(collisions, LAWS[law], cutoff, max_events or MAX_EVENTS, states, paths)
    else:
        found = _by_chain(collisions, LAWS[law], max_events or MAX_PIECES, states, paths)
    return _marked(found, LAWS[law], grazing_threshold)


def _checked(law: str, stiffness_ratio_cutoff: Cutoff) -> float:
    """Return the cut-off as the kernel takes it; a ValueError names an illegal law or cut-off."""
    if law not in LAWS:
        raise ValueError(f"law = {law!r}; legal: {', '.join(LAWS)}")
    if not legal_cutoff(stiffness_ratio_cutoff):
        raise ValueError(f"stiffness_ratio_cutoff = {stiffness_ratio_cutoff!r}; legal: {LEGAL_CUTOFF}")
    return kernel.EXACT if stiffness_ratio_cutoff == "exact" else float(stiffness_ratio_cutoff)


def _marked(found: Outcomes, law: int, grazing_threshold: float) -> Outcomes:
    """Mark outcomes that graze, or that a cut-off has changed."""
    there, margin = found.has_result, found.grazing_margin
    if law != STATE_TRANSITION:  # a restart that takes back the loss leaves no jump
        margin = np.where(there, np.inf, np.nan)
    mark = ((margin < grazing_threshold) & there).astype(np.int32)
    if "cutoff_effect" in found.diagnostics:
        mark += 2 * (there & ~(found.diagnostics["cutoff_effect"] <= CUTOFF_THRESHOLD))
    return replace(found, grazing_margin=margin, mark=mark, marks=MARKS)


def no_positions(collisions: Collisions) -> str:
    """Say that the model knows no gaps."""
    largest = float(collisions.gaps.max())
    return f"gaps of up to {largest!r} m: the model has no positions; legal: 0 (the references know gaps)"


def _by_chain(collisions: Collisions, law: int, max_pieces: int, states: bool, paths: bool) -> Outcomes:
    nothing, no_gravity = np.zeros_like(collisions.stiffnesses), np.zeros(len(collisions))
    problem = Problem(collisions, law, nothing, True, no_gravity, max_pieces=max_pieces)
    went = problem.follow(states=states)
    too_long = f"not over within {max_pieces} pieces of segments"
    return problem.outcomes(
        NAME,
        went,
        [(went.given_up, "unconverged", too_long)],
        margin=went.numbers["margin"],
        diagnostics={"energy_residual": 1 - went.numbers["loss"]},
        paths=paths,
    )


def _by_diagram(
    c: Collisions, law: int, cutoff: float, max_events: int, states: bool, paths: bool
) -> Outcomes:
    found = _of_ratios(_cells(c), law, cutoff, max_events, states)
    velocities, there = found.velocities * c.units[1][:, None], ~np.isnan(found.velocities[:, 0])
    drawn = None
    if paths:
        drawn = _diagram_paths(c[there], cutoff, max_events, law == STATE_TRANSITION).spread(there)
    return replace(found, velocities=velocities, impulses=total_impulses(c, velocities), paths=drawn)


def _cells(collisions: Collisions) -> list[Floats]:
    """k2/k1, m2/m1, e1 and e2, as arrays of one type: for any other the kernel would be compiled once more."""
    c = collisions
    return [np.array(each) for each in (c.stiffness_ratio, c.mass_ratio, *c.restitutions.T)]


def _of_ratios(cells: Sequence[Floats], law: int, cutoff: float, max_events: int, states: bool) -> Outcomes:
    """Solve two balls on a table with m1 = 1 kg, k1 = 1 N/m and v0 = -1 m/s, given k2/k1, m2/m1, e1 and e2.

    Nothing is worked out here that the ratios tell, for that would take a share of the time of the kernel.
    """
    n, how = len(cells[0]), (max_events, law == STATE_TRANSITION)
    velocities, results, sets = _diagrams(cells, cutoff, *how, "n_states" if states else "")
    code, n_states = results["code"], results["n_states"]
    diagnostics = {"energy_residual": results["residual"]}
    if 1 < cutoff < math.inf:
        used, effect = np.flatnonzero(code == kernel.LIMIT), np.zeros(n)
        exact = _diagrams([each[used] for each in cells], kernel.EXACT, *how)[0]
        moved = exact - velocities[used]
        effect[used] = np.hypot(moved[:, 0], np.sqrt(cells[1][used]) * moved[:, 1])
        diagnostics["cutoff_effect"] = effect
    impulses = np.empty((n, 2))
    impulses[:, 0] = velocities[:, 0] + 1
    impulses[:, 1] = impulses[:, 0] + cells[1] * velocities[:, 1]
    # Endings are told apart only where there is something to tell: nearly all collisions are followed to their end.
    others = np.flatnonzero(code != kernel.DONE)
    endings = _endings([each[others] for each in cells], code[others], cutoff, max_events)
    status, reason = np.zeros(n, np.uint8), np.zeros(n, np.int32)
    status[others], reason[others] = first_endings(endings, len(others))
    return Outcomes(
        solver=NAME,
        velocities=velocities,
        impulses=impulses,
        status=status,
        reason=reason,
        reasons=reasons_of(endings),
        mark=np.zeros(n, np.int32),
        marks=MARKS,
        n_states=n_states,
        n_events=results["n_events"],
        grazing_margin=results["margin"],
        states=States.of(n_states, sets) if states else None,
        diagnostics=diagnostics,
    )


def _diagrams(
    cells: Sequence[Floats], cutoff: float, max_events: int, stiffens: bool, logged: str = ""
) -> tuple[Floats, NDArray[Any], NDArray[Any]]:
    """Velocities per abs(v0), records and a log of `pair.kernel.collide_all`.

    `logged` is the field of the records that counts the rows of that log.
    """
    n, width, path = len(cells[0]), len(LOG_COLUMNS), logged == "rows"
    velocities, results = np.empty((n, 2)), np.empty(n, kernel.RESULT).view(np.recarray)
    no_path, no_states = np.empty((0, width)), np.empty((0, 1), np.uint64)

    def follow(share: slice, log: NDArray[Any]) -> int:
        how, logs = (cutoff, max_events, stiffens, POINTS), (log, no_states) if path else (no_path, log)
        kernel.collide_all(*(x[share] for x in cells), *how, *logs, velocities[share], results[share])
        return int(results[logged][share].sum()) if logged else 0

    log = (LOG_ROWS, width, float) if path else (FEW_STATES if logged else 0, 1, np.uint64)
    return velocities, results, in_shares(follow, n, SHARE, *log)


def _diagram_paths(collisions: Collisions, cutoff: float, max_events: int, stiffens: bool) -> Paths:
    """Paths of collisions, from the log of the kernel: time, state, velocities and forces."""
    c, k = collisions, collisions.stiffnesses.copy()
    stiff = np.isinf(k[:, 0])  # whose time unit would be 0: any such ratio is infinite to rounding
    k[stiff, 0] = 1e60 * k[stiff, 1]
    c = replace(c, stiffnesses=k)
    _, results, log = _diagrams(_cells(c), cutoff, max_events, stiffens, "rows")
    lengths = results["rows"]
    of = np.repeat(np.arange(len(c)), lengths)
    offsets, (time, speed) = np.append(0, np.cumsum(lengths)), c.units
    state, velocities, passed = log[:, 0].astype(int), log[:, 2:4] * speed[of, None], log[:, 1].copy()
    for i, j in pairwise(offsets.tolist()):  # a segment may end before it starts, to a rounding
        np.maximum.accumulate(passed[i:j], out=passed[i:j])
    impulses = np.cumsum(c.masses[of] * (velocities - c.velocities[of]), axis=1)
    with np.errstate(divide="ignore"):  # the forces of an instant are infinite
        forces = _in_unit(log[:, 4:6], (c.masses[:, 0] * speed / time)[of, None])
    acting = np.stack([np.isin(state, (1, 3)), np.isin(state, (1, 2))], axis=1)
    return Paths(offsets, _in_unit(passed, time[of]), velocities, impulses, forces, acting)


def _in_unit(values: Floats, unit: Floats) -> Floats:
    """Return values times a unit: 0 stays 0 where the unit leaves double precision, as that of time may."""
    with np.errstate(over="ignore", invalid="ignore"):
        return np.multiply(values, unit, out=np.zeros_like(values), where=values != 0)


def _endings(
    cells: Sequence[Floats], code: NDArray[np.int64], cutoff: float, max_events: int
) -> list[Ending]:
    """Tell how two balls may end that were not just followed to their end, by the kernel's code."""
    kappa, _, e1, e2 = cells
    outside = (kappa > cutoff) | (kappa < 1 / cutoff) if cutoff != kernel.EXACT else kappa < 0
    rest = "the running stiffness ratio left"
    runs_away = f"the running stiffness ratio runs away: closed form of the limit, to {BOUND:g} |v0|"
    events = f"{max_events} events, or {MOST_WINDOWS} windows of the search for them"
    precision = f"{rest} double precision: closed form of the limit from there on"
    return [
        (code == kernel.TOO_MANY_EVENTS, "unconverged", f"not over after {events}"),
        (code == kernel.BEYOND_PRECISION, "unrepresentable", TOO_FAR_APART),
        (code == kernel.COLLAPSE, "closed-form", HAPPENED[COLLAPSE]),
        (kappa == 0, "closed-form", "closed form of k2/k1 = 0"),
        (np.isinf(kappa), "closed-form", "closed form of k2/k1 = inf"),
        (outside, "closed-form", f"k2/k1 lies beyond the cut-off {cutoff:g}: closed form of the limit"),
        (code == kernel.PRECISION_LIMIT, "closed-form", precision),
        ((e1 == 0) & (e2 == 0), "closed-form", "closed form of e1 = 0 and e2 = 0"),
        (e1 == 0, "closed-form", "closed form of e1 = 0"),
        (e2 == 0, "closed-form", "closed form of e2 = 0"),
        (cutoff == kernel.EXACT, "closed-form", runs_away),
        (True, "closed-form", f"{rest} the cut-off {cutoff:g}: closed form of the limit from there on"),
    ]


def solve_batch(
    stiffness_ratio: ArrayLike,
    mass_ratio: ArrayLike,
    e1: ArrayLike,
    e2: ArrayLike,
    *,
    law: str = "jia-mason-erdmann",
    stiffness_ratio_cutoff: Cutoff = "exact",
    max_events: int | None = None,
    grazing_threshold: float = GRAZING_THRESHOLD,
    states: bool = False,
    paths: bool = False,
) -> Outcomes:
    """Solve many collisions of two balls on a table at once, m1 = 1 kg, k1 = 1 N/m and v0 = -1 m/s.

    Parameters
    ----------
    stiffness_ratio, mass_ratio, e1, e2 : array_like
        k2/k1 from 0 to infinity, m2/m1 > 0 and finite, e_i from 0 to 1; they broadcast.
    law, stiffness_ratio_cutoff, max_events, grazing_threshold, states, paths
        As for `solve_many`; states are not kept by default.

    Returns
    -------
    Outcomes
        Arrays of the shape that the inputs broadcast to: `v1`, `v2`, `statuses`, `grazing_margin`, `marked`, ...

    Raises
    ------
    ValueError
        If any value is illegal; the message names the parameter, the first such value and the legal range.
    """
    cutoff, events = _checked(law, stiffness_ratio_cutoff), max_events or MAX_EVENTS
    given = np.broadcast_arrays(*map(checked_array, RATIOS, (stiffness_ratio, mass_ratio, e1, e2)))
    if paths:
        found = _by_diagram(Collisions.from_ratios(*given), LAWS[law], cutoff, events, states, paths)
    else:
        cells = [np.array(each, order="C").ravel() for each in given]  # of one type, as in `_cells`
        found = _of_ratios(cells, LAWS[law], cutoff, events, states)
    return _marked(found, LAWS[law], grazing_threshold).shaped(given[0].shape)
