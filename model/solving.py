"""Solution of collisions by the state transition model.

`solve` solves one collision. `solve_many` and `solve_batch` solve arrays of collisions. If ball 1 falls on ball 2,
which rests on a table, `model.pair` solves the collision in closed form between events. `model.chain` solves all other
collisions. This module checks the input, calls the compiled kernels, and converts their results to SI units.

Called by users, by `compliant_baselines.references` and by the hypothesis.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from impact_xval.model.arrays import Floats
from impact_xval.model.chain.following import COLLAPSE_REASON, MAX_WINDOWS, TOO_FAR_APART, Problem
from impact_xval.model.chain.laws import Law
from impact_xval.model.collision import Collision
from impact_xval.model.collisions import Collisions
from impact_xval.model.inputs import (
    GRAZING_THRESHOLD,
    LEGAL_CUTOFF,
    RATIOS,
    Cutoff,
    checked_array,
    legal_cutoff,
)
from impact_xval.model.marks import CUTOFF_THRESHOLD, MARKS
from impact_xval.model.outcome import Outcome
from impact_xval.model.outcomes import GridOutcomes, Outcomes, total_impulses
from impact_xval.model.pair.events import MOST_WINDOWS
from impact_xval.model.pair.following import follow_pairs, follow_with_paths, follow_with_states
from impact_xval.model.pair.limits import BOUND, EXACT
from impact_xval.model.pair.path import POINTS
from impact_xval.model.pair.record import PairEnding, PairOptions, PairRatios
from impact_xval.model.path import Paths
from impact_xval.model.states import States
from impact_xval.model.status import Ending, first_endings, reason_texts_of

NAME = "state-transition"

#: Impact laws by name: the model's own law, and the law of Liu, Zhao and Brogliato (`pair.law`).
LAWS = {"jia-mason-erdmann": Law.STATE_TRANSITION, "liu-zhao-brogliato": Law.LIU_ZHAO_BROGLIATO}

#: Largest number of events of a collision of two balls; they take about a second. A collision that needs more is given
#: up. At extreme stiffness ratios a collision has about 50/(1 - e) events, where e is the restitution of the contact
#: that oscillates. The ratio of the frequencies of both modes is a further bound of this number.
MAX_EVENTS = 2_000_000


def solve(
    collision: Collision,
    *,
    law: str = "jia-mason-erdmann",
    stiffness_ratio_cutoff: Cutoff = "exact",
    max_events: int | None = None,
    grazing_threshold: float = GRAZING_THRESHOLD,
    path: bool = False,
) -> Outcome:
    """Solve one collision by the state transition model of Jia, Mason and Erdmann.

    The outcome is exact if contacts are linear. With any exponent other than 1 the motion is integrated in steps, with
    an error of about 1e-12 of the velocity of impact.

    Parameters
    ----------
    collision : Collision
        Every limiting case is legal: e_i = 0, e_i = 1, and for two balls on a table k2/k1 = 0 or infinity.
    law : str
        ``jia-mason-erdmann``, the model's own law, or ``liu-zhao-brogliato``. The second law differs only in repeated
        compressions of a contact, which begin with the original stiffness.
    stiffness_ratio_cutoff : float or "exact"
        For two balls on a table. With a number greater than 1 the closed form of the limiting case finishes the
        collision when the running stiffness ratio exceeds this number, or falls below its inverse. With ``exact`` the
        closed form finishes it as soon as this changes the outcome by less than `pair.limits.BOUND`.
    max_events : int, optional
        Largest number of events. A collision that needs more is given up. The default takes about a second.
    grazing_threshold : float
        Grazing margin below which an outcome is marked as near a jump.
    path : bool
        Whether the outcome has a `path`: velocities, impulses and forces during the collision.

    Returns
    -------
    Outcome

    Raises
    ------
    ValueError
        For an illegal cut-off, an unknown law, or gaps.
    """
    outcomes = solve_many(
        Collisions.of([collision]),
        law=law,
        stiffness_ratio_cutoff=stiffness_ratio_cutoff,
        max_events=max_events,
        grazing_threshold=grazing_threshold,
        paths=path,
    )
    return outcomes[0]


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
    """Solve n collisions of N balls each by the state transition model, on all processors.

    Parameters
    ----------
    collisions : Collisions
    law : str
        ``jia-mason-erdmann``, the model's own law, or ``liu-zhao-brogliato``. The second law differs only
        in repeated compressions of a contact, which begin with the original stiffness.
    stiffness_ratio_cutoff : float or "exact"
        Used for two balls on a table. A number greater than 1 is a cut-off: when the ratio of the running stiffnesses
        k2/k1 exceeds it, or falls below its inverse, the closed form of the limiting case finishes the collision. The
        supplement, section 3.4, uses `SUPPLEMENT_CUTOFF`. Infinity means no cut-off. With ``exact`` the closed form
        finishes the collision as soon as it changes the outcome by less than `pair.limits.BOUND`.
    max_events : int, optional
        Largest number of events of a collision of two balls on a table. A collision that needs more is given up. For
        all other collisions it is the largest number of windows, in each of which one event is searched for. The
        default takes about a second.
    grazing_threshold : float
        Grazing margin below which an outcome gets a mark, a sentence that warns that it is near a jump.
    states, paths : bool
        Whether outcomes have states, and whether they have paths.

    Returns
    -------
    Outcomes
        The status is ``closed-form`` if a closed form was used, ``unconverged`` after `max_events`, and
        ``unrepresentable`` if masses or stiffnesses differ by more than the factor `MASS_PRECISION` or if rounding made
        energy. Otherwise it is ``ok``.

        An outcome is marked if its grazing margin is below the threshold, or if a cut-off changed it by more than
        `CUTOFF_THRESHOLD` (`pair.grazing`). The diagnostic ``energy_residual`` is the residual of the energy balance,
        divided by the kinetic energy at first touch relative to the centre of mass or the table. With a finite cut-off,
        ``cutoff_effect`` is the difference of velocities from the outcome without a cut-off, in the kinetic norm
        divided by sqrt(m1) abs(v0). It is missing if the outcome without a cut-off is not reached within `max_events`.

    Raises
    ------
    ValueError
        For an illegal cut-off, an unknown law, or gaps.
    """
    cutoff = _checked_cutoff(law, stiffness_ratio_cutoff)
    if collisions.gaps.any():
        raise ValueError(no_positions(collisions))
    is_pair = collisions.falls_on_resting
    if is_pair.any() and not is_pair.all():
        raise ValueError(
            "velocities: B2 rests in some rows and not in others; legal: collisions of one kind at a time"
        )
    if is_pair.any():
        options = _pair_options(law, cutoff, max_events)
        outcomes = _solve_pairs(collisions, options, states=states, paths=paths)
    else:
        outcomes = _solve_chains(collisions, LAWS[law], max_events or MAX_WINDOWS, states=states, paths=paths)
    return _with_marks(outcomes, LAWS[law], grazing_threshold)


def _checked_cutoff(law: str, stiffness_ratio_cutoff: Cutoff) -> float:
    """Return the cut-off as a number for the kernel; a ValueError names an illegal law or cut-off."""
    if law not in LAWS:
        raise ValueError(f"law = {law!r}; legal: {', '.join(LAWS)}")
    if not legal_cutoff(stiffness_ratio_cutoff):
        raise ValueError(f"stiffness_ratio_cutoff = {stiffness_ratio_cutoff!r}; legal: {LEGAL_CUTOFF}")
    return EXACT if stiffness_ratio_cutoff == "exact" else float(stiffness_ratio_cutoff)


def _pair_options(law: str, cutoff: float, max_events: int | None) -> PairOptions:
    """Return the options of the kernel of two balls."""
    return PairOptions(cutoff, max_events or MAX_EVENTS, LAWS[law] == Law.STATE_TRANSITION, POINTS)


def _with_marks(outcomes: Outcomes, law: Law, grazing_threshold: float) -> Outcomes:
    """Return the outcomes with marks where the grazing margin is small or a cut-off has changed the outcome."""
    margin = outcomes.grazing_margin
    if law != Law.STATE_TRANSITION:  # the other law has no jumps: a restart gives back the lost energy
        margin = np.where(outcomes.has_result, np.inf, np.nan)
    mark = np.zeros(len(margin), np.int32)
    grazing = np.flatnonzero(margin < grazing_threshold)
    mark[grazing[outcomes.has_result[grazing]]] = 1
    if "cutoff_effect" in outcomes.diagnostics:
        is_small = outcomes.diagnostics["cutoff_effect"] <= CUTOFF_THRESHOLD
        mark += 2 * (outcomes.has_result & ~is_small)
    return replace(outcomes, grazing_margin=margin, mark=mark, mark_texts=MARKS)


def no_positions(collisions: Collisions) -> str:
    """Return the message that the model does not accept gaps."""
    largest = float(collisions.gaps.max())
    return f"gaps of up to {largest!r} m: the model has no positions; legal: 0 (the references accept gaps)"


def _solve_chains(
    collisions: Collisions, law: Law, max_windows: int, *, states: bool, paths: bool
) -> Outcomes:
    """Solve collisions of N balls by the kernel of chains, with the model's assumption of constant positions."""
    no_damping, no_gravity = np.zeros_like(collisions.stiffnesses), np.zeros(len(collisions))
    problem = Problem(collisions, law, no_damping, True, no_gravity, max_windows=max_windows)
    result = problem.follow(states=states)
    too_long = f"not over within {problem.most_windows} windows"
    return problem.outcomes(
        NAME,
        result,
        [Ending(result.given_up, "unconverged", too_long)],
        margin=result.records["margin"],
        diagnostics={"energy_residual": 1 - result.records["energy_share"]},
        paths=paths,
    )


def _solve_pairs(collisions: Collisions, options: PairOptions, *, states: bool, paths: bool) -> Outcomes:
    """Solve collisions of two balls on a table, in SI units, by the kernel of two balls."""
    scaled = _solve_cells(_cells_of(collisions), options, states=states)
    velocities = scaled.velocities * collisions.units[1][:, None]
    recorded = None
    if paths:
        has_path = ~np.isnan(velocities[:, 0])
        recorded = _pair_paths(collisions[has_path], options).scatter(has_path)
    impulses = total_impulses(collisions, velocities)
    return replace(scaled, velocities=velocities, impulses=impulses, paths=recorded)


def _cells_of(c: Collisions) -> PairRatios:
    """Return the ratios on which collisions of two balls depend, as the contiguous arrays that the kernel needs."""
    return PairRatios(
        np.array(c.stiffness_ratio),
        np.array(c.mass_ratio),
        np.array(c.restitutions[:, 0]),
        np.array(c.restitutions[:, 1]),
    )


def _solve_cells(cells: PairRatios, options: PairOptions, *, states: bool) -> Outcomes:
    """Solve collisions of two balls on a table with m1 = 1 kg, k1 = 1 N/m and v0 = -1 m/s, given by their ratios."""
    n = len(cells.kappa)
    if states:
        result, sets = follow_with_states(cells, options)
        sequences = States.of(result.records.n_states, sets)
    else:
        result, sequences = follow_pairs(cells, options), None
    velocities, records = result.velocities, result.records
    diagnostics: dict[str, Floats] = {"energy_residual": records["energy_residual"]}
    if 1 < options.cutoff < math.inf:
        diagnostics["cutoff_effect"] = _cutoff_effect(cells, options, velocities, records["ending"])
    impulses = np.empty((n, 2))
    impulses[:, 0] = velocities[:, 0] + 1
    impulses[:, 1] = impulses[:, 0] + cells.mu * velocities[:, 1]
    # Sentences are needed only for collisions whose ending is not FINISHED.
    unfinished = np.flatnonzero(records["ending"] != PairEnding.FINISHED)
    endings = _pair_endings(cells.take(unfinished), records["ending"][unfinished], options)
    status, reason = np.zeros(n, np.uint8), np.zeros(n, np.int32)
    status[unfinished], reason[unfinished] = first_endings(endings, len(unfinished))
    return Outcomes(
        solver=NAME,
        velocities=velocities,
        impulses=impulses,
        status=status,
        reason=reason,
        reason_texts=reason_texts_of(endings),
        mark=np.zeros(n, np.int32),
        mark_texts=MARKS,
        n_states=records["n_states"],
        n_events=records["n_events"],
        grazing_margin=records["margin"],
        states=sequences,
        diagnostics=diagnostics,
    )


def _cutoff_effect(
    cells: PairRatios, options: PairOptions, velocities: Floats, ending: NDArray[np.int64]
) -> Floats:
    """Return the change of velocities by a cut-off, shape (n,), in the kinetic norm divided by sqrt(m1) abs(v0)."""
    effect = np.zeros(len(ending))
    cut_off = np.flatnonzero(ending == PairEnding.CLOSED_FORM)
    cells = cells.take(cut_off)
    change = follow_pairs(cells, options._replace(cutoff=EXACT)).velocities - velocities[cut_off]
    effect[cut_off] = np.hypot(change[:, 0], np.sqrt(cells.mu) * change[:, 1])
    return effect


def _pair_paths(collisions: Collisions, options: PairOptions) -> Paths:
    """Return paths of two balls on a table in SI units."""
    k = collisions.stiffnesses.copy()
    # With an infinite k1 the unit of time would be 0. A ratio of 1e60 is infinite to rounding.
    infinite = np.isinf(k[:, 0])
    k[infinite, 0] = 1e60 * k[infinite, 1]
    c = replace(collisions, stiffnesses=k)
    time_unit, speed = c.units
    result, points = follow_with_paths(_cells_of(c), options)
    lengths = result.records["n_points"]
    row = np.repeat(np.arange(len(c)), lengths)  # for each point, the number of its collision
    offsets = np.append(0, np.cumsum(lengths))
    time = points["time"].copy()
    for i, j in pairwise(offsets.tolist()):  # rounding may end a segment before its start
        np.maximum.accumulate(time[i:j], out=time[i:j])
    velocities = np.stack([points["v1"], points["v2"]], axis=1) * speed[row, None]
    impulses = np.cumsum(c.masses[row] * (velocities - c.velocities[row]), axis=1)
    with np.errstate(divide="ignore"):  # forces that act for an instant are infinite
        force_unit = (c.masses[:, 0] * speed / time_unit)[row]
    forces = np.stack([points["F1"], points["F2"]], axis=1)
    active = np.stack([np.isin(points["state"], (1, 3)), np.isin(points["state"], (1, 2))], axis=1)
    return Paths(
        offsets=offsets,
        time=_times_unit(time, time_unit[row]),
        velocities=velocities,
        impulses=impulses,
        forces=_times_unit(forces, force_unit[:, None]),
        active=active,
    )


def _times_unit(values: Floats, unit: Floats) -> Floats:
    """Return values times a unit. A value of 0 stays 0, even if the unit is infinite in double precision."""
    with np.errstate(over="ignore", invalid="ignore"):
        return np.multiply(values, unit, out=np.zeros_like(values), where=values != 0)


def _pair_endings(cells: PairRatios, ending: NDArray[np.int64], options: PairOptions) -> list[Ending]:
    """Return the possible endings of collisions of two balls in which the kernel's ending is not `PairEnding.FINISHED`.

    Each `Ending` has a condition for each collision, a status and a sentence. A collision gets the first one whose
    condition is true.
    """
    kappa, e1, e2 = cells.kappa, cells.e1, cells.e2
    cutoff = options.cutoff
    is_exact = cutoff == EXACT
    beyond_cutoff = False if is_exact else (kappa > cutoff) | (kappa < 1 / cutoff)
    ratio = "the running stiffness ratio left"
    runs_away = (
        f"the running stiffness ratio grows without bound: closed form of the limit, to {BOUND:g} |v0|"
    )
    events = f"{options.max_events} events, or {MOST_WINDOWS} windows of the search for them"
    precision = f"{ratio} double precision: closed form of the limit from there on"
    return [
        Ending(ending == PairEnding.TOO_MANY_EVENTS, "unconverged", f"not over after {events}"),
        Ending(ending == PairEnding.UNREPRESENTABLE, "unrepresentable", TOO_FAR_APART),
        Ending(ending == PairEnding.COLLAPSED, "closed-form", COLLAPSE_REASON),
        Ending(kappa == 0, "closed-form", "closed form of k2/k1 = 0"),
        Ending(np.isinf(kappa), "closed-form", "closed form of k2/k1 = inf"),
        Ending(
            beyond_cutoff,
            "closed-form",
            f"k2/k1 lies beyond the cut-off {cutoff:g}: closed form of the limit",
        ),
        Ending(ending == PairEnding.PRECISION, "closed-form", precision),
        Ending((e1 == 0) & (e2 == 0), "closed-form", "closed form of e1 = 0 and e2 = 0"),
        Ending(e1 == 0, "closed-form", "closed form of e1 = 0"),
        Ending(e2 == 0, "closed-form", "closed form of e2 = 0"),
        Ending(is_exact, "closed-form", runs_away),
        Ending(
            True, "closed-form", f"{ratio} the cut-off {cutoff:g}: closed form of the limit from there on"
        ),
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
) -> GridOutcomes:
    """Solve many collisions of two balls on a table at once, with m1 = 1 kg, k1 = 1 N/m and v0 = -1 m/s.

    Parameters
    ----------
    stiffness_ratio, mass_ratio, e1, e2 : array_like
        k2/k1 from 0 to infinity, m2/m1 > 0 and finite, e_i from 0 to 1; they broadcast.
    law, stiffness_ratio_cutoff, max_events, grazing_threshold
        The same as for `solve`.
    states, paths : bool
        Whether outcomes have states, and whether they have paths.

    Returns
    -------
    GridOutcomes
        Arrays of the common shape to which the inputs broadcast: `v1`, `v2`, `statuses`, `grazing_margin`, `marked`,
        ...

    Raises
    ------
    ValueError
        If a value is illegal; the message names the parameter, the first illegal value and the legal range.
    """
    options = _pair_options(law, _checked_cutoff(law, stiffness_ratio_cutoff), max_events)
    ratios = np.broadcast_arrays(*map(checked_array, RATIOS, (stiffness_ratio, mass_ratio, e1, e2)))
    if paths:
        outcomes = _solve_pairs(Collisions.from_ratios(*ratios), options, states=states, paths=paths)
    else:
        # Contiguous arrays of the caller are not copied, because the kernel only reads them.
        cells = PairRatios(*(np.array(ratio, order="C").ravel() for ratio in ratios))
        outcomes = _solve_cells(cells, options, states=states)
    return GridOutcomes(_with_marks(outcomes, LAWS[law], grazing_threshold), ratios[0].shape)
