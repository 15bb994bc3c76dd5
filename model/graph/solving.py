"""Solution of contact graphs that are given by their Delassus matrices, by the state-transition model.

`solve_graph` solves one graph, and `solve_graphs` solves many. `solve_graph_collision` solves a graph of bodies. This
module checks the input, scales all values to about 1, calls the compiled kernel in threads, and converts the results
back to SI units.

Needs `graph.kernel`. Used by users, and by `references` and `rigid.graphs` of `compliant_baselines`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from impact_xval.model.arrays import Booleans, Floats, Records, zero_records
from impact_xval.model.chain.following import COLLAPSE_REASON, PLASTIC_REASON, RUNAWAY_REASON
from impact_xval.model.compiled import run_in_threads
from impact_xval.model.graph.collision import GraphCollision
from impact_xval.model.graph.kernel import follow_graphs
from impact_xval.model.graph.motion import ROUNDING
from impact_xval.model.graph.outcome import GraphOutcome, GraphOutcomes
from impact_xval.model.graph.record import (
    EVENT,
    GRAPH_RESULT,
    MOST_CONTACTS,
    GraphEnding,
    GraphEnds,
    Graphs,
)
from impact_xval.model.graph.state import new_contacts, new_matrices
from impact_xval.model.inputs import GRAZING_THRESHOLD, LINE, MASS_PRECISION, Legal, checked_array
from impact_xval.model.status import IS_RESULT, Ending, first_endings, reason_texts_of

#: Limits of the computation of one graph. A graph that exceeds both is given up. `MOST_WORK` is about a second, in the
#: unit of `window_work`. `LEAST_WINDOWS` is a number of windows; a chain of 60 contacts needs at most 10,000 windows.
MOST_WORK, LEAST_WINDOWS = 15_000_000, 20_000

#: Number of graphs that a thread follows in one call of the kernel, and number of events per graph for which a log has
#: room at first.
SHARE, EVENT_ROWS = 512, 24

#: A negative eigenvalue of the Delassus matrix W is taken for rounding if its magnitude is at most this share of the
#: largest eigenvalue. W is first scaled to ones on its diagonal.
NEGATIVE = 1e-10

#: Rates of compression must lie in the range of the Delassus matrix W. A part outside the range is taken for rounding
#: if it is at most this share of the rates.
OUTSIDE = 1e-9

#: Largest residual of the balance of impulses, and of the balance of energy, with which impulses and rates of a graph
#: are a result. Jammed bodies exceed it, because they oscillate without end at ever higher stiffnesses, until their
#: rates are only rounding.
UNBALANCED = 1e-9

#: Largest difference between the entries W_ij and W_ji of a Delassus matrix that is taken for rounding, divided by
#: sqrt(W_ii W_jj).
ASYMMETRY = 1e-12

_, _STIFFNESSES, _RESTITUTIONS, _VELOCITIES, _ = LINE
_RATES = Legal(
    "rates", _VELOCITIES.low, _VELOCITIES.high, "finite numbers (m/s, positive where bodies approach)"
)
_DELASSUS = Legal("delassus", _VELOCITIES.low, _VELOCITIES.high, "finite numbers (1/kg)")


def solve_graph(
    delassus: ArrayLike,
    stiffnesses: ArrayLike,
    restitutions: ArrayLike,
    rates: ArrayLike,
    *,
    max_windows: int | None = None,
    grazing_threshold: float = GRAZING_THRESHOLD,
) -> GraphOutcome:
    """Solve one contact graph by the state-transition model of Jia, Mason and Erdmann.

    Parameters
    ----------
    delassus : array_like, shape (C, C)
        Delassus matrix W = J M^-1 J^T in 1/kg, where M is the mass matrix, and row i of J gives the rate of compression
        of contact i as -J_i v. W is symmetric, its diagonal is positive, and no eigenvalue is negative. It may be
        singular. C is from 1 to `MOST_CONTACTS`.
    stiffnesses : array_like, shape (C,)
        Stiffnesses in N/m; positive, finite.
    restitutions : array_like, shape (C,)
        Coefficients of energetic restitution, from 0 (perfectly plastic) to 1 (elastic).
    rates : array_like, shape (C,)
        Rates of compression w = -J v at first touch, in m/s; positive where bodies approach. At least one rate is
        positive. The vector of rates has to lie in the range of W.
    max_windows : int, optional
        Largest number of windows of a graph; a window is a time over which one power series is used. A graph that needs
        more is given up. The default takes about a second.
    grazing_threshold : float
        Grazing margin below which the outcome gets a mark, a sentence that warns that it is near a jump.

    Returns
    -------
    GraphOutcome

    Raises
    ------
    ValueError
        For an illegal value; the message names the field, the value and the legal range.

    Examples
    --------
    >>> outcome = solve_graph([[1.0, 0.5], [0.5, 1.0]], [1, 4], [1, 1], [1, 1])
    >>> outcome.status
    'ok'
    """
    fields: list[Any] = [[values] for values in (delassus, stiffnesses, restitutions, rates)]
    return solve_graphs(*fields, max_windows=max_windows, grazing_threshold=grazing_threshold)[0]


def solve_graph_collision(
    collision: GraphCollision,
    *,
    max_windows: int | None = None,
    grazing_threshold: float = GRAZING_THRESHOLD,
) -> GraphOutcome:
    """Solve one collision of any bodies by the state-transition model of Jia, Mason and Erdmann.

    Parameters
    ----------
    collision : GraphCollision
    max_windows : int, optional
        Largest number of windows of time of the collision. A collision that needs more is given up. The default takes
        about a second.
    grazing_threshold : float
        Grazing margin below which the outcome gets a mark, a sentence that warns that it is near a jump.

    Returns
    -------
    GraphOutcome
        Its velocities are v + M^-1 J^T I, with the velocities v at first touch and the impulses I of the contacts. It
        has angular velocities if the collision has moments of inertia.

    Raises
    ------
    ValueError
        If an entry of the Delassus matrix is too large or too small for double precision.
    """
    contacts = collision.contacts
    outcome = solve_graph(
        collision.delassus,
        [contact.stiffness for contact in contacts],
        [contact.restitution for contact in contacts],
        collision.rates,
        max_windows=max_windows,
        grazing_threshold=grazing_threshold,
    )
    velocities, turning = collision.after(outcome.impulses)
    return replace(
        outcome,
        velocities=tuple(tuple(row) for row in velocities.tolist()),
        angular_velocities=tuple(tuple(row) for row in turning.tolist()) if len(collision.inertias) else (),
    )


def solve_graphs(
    delassus: ArrayLike,
    stiffnesses: ArrayLike,
    restitutions: ArrayLike,
    rates: ArrayLike,
    *,
    max_windows: int | None = None,
    grazing_threshold: float = GRAZING_THRESHOLD,
    events: bool = True,
) -> GraphOutcomes:
    """Solve n contact graphs with C contacts each by the state-transition model, on all processors.

    Parameters
    ----------
    delassus : array_like, shape (n, C, C)
        Delassus matrices in 1/kg.
    stiffnesses, restitutions, rates : array_like, shape (n, C)
        Stiffnesses in N/m, coefficients of restitution, and rates of compression at first touch in m/s. `solve_graph`
        states their legal ranges.
    max_windows : int, optional
        Largest number of windows of a graph. A graph that needs more is given up. The default takes about a second.
    grazing_threshold : float
        Grazing margin below which an outcome gets a mark, a sentence that warns that it is near a jump.
    events : bool
        Whether events are recorded. Without them the outcomes have no events and no sets of active contacts.

    Returns
    -------
    GraphOutcomes
        The status of a graph is ``closed-form`` if a closed form was used, ``unconverged`` if the graph was given up,
        ``unrepresentable`` if its inverse masses or its stiffnesses are too far apart for double precision, and else
        ``ok``.

    Raises
    ------
    ValueError
        For an illegal value; the message names the field, the value and the legal range.
    """
    if max_windows is not None and max_windows < 1:
        raise ValueError(f"max_windows = {max_windows!r}; legal: at least 1")
    fields = checked_graphs(delassus, stiffnesses, restitutions, rates)
    graphs, units, is_followed = scaled_graphs(*fields)
    n, contacts = graphs.rates.shape
    most = max_windows or max(LEAST_WINDOWS, MOST_WORK // window_work(contacts))
    ends = GraphEnds(
        np.full((n, contacts), np.nan), np.full((n, contacts), np.nan), zero_records(n, GRAPH_RESULT)
    )
    log = _follow(graphs, most, ends, events)
    results: Records = ends.results.view(np.recarray)
    mass, time, speed = units
    impulses = ends.impulses * (mass * speed)[:, None]
    final_rates = ends.rates * speed[:, None]
    unbalanced = np.abs(graphs.rates - (graphs.delassus @ ends.impulses[:, :, None])[:, :, 0] - ends.rates)
    is_balanced = (unbalanced.max(axis=1) <= UNBALANCED) & (np.abs(results["energy_residual"]) <= UNBALANCED)
    endings = _endings(results, is_followed, is_balanced, most)
    status, reason = first_endings(endings, n)
    has_result = IS_RESULT[status]
    blank = ~has_result[:, None]
    offsets = np.append(0, np.cumsum(results["n_rows"]))
    if log is not None:
        log["time"] *= np.repeat(time, results["n_rows"])
    margin = np.where(has_result, results["margin"], np.nan)
    return GraphOutcomes(
        impulses=np.where(blank, np.nan, impulses),
        rates=np.where(blank, np.nan, final_rates),
        status=status,
        reason=reason,
        reason_texts=reason_texts_of(endings),
        marked=has_result & (margin < grazing_threshold),
        grazing_margin=margin,
        duration=np.where(has_result, results["time"] * time, np.nan),
        n_events=results["n_events"].copy(),
        n_windows=results["n_windows"].copy(),
        events=log,
        offsets=offsets,
        diagnostics={
            "energy_residual": np.where(has_result, results["energy_residual"], np.nan),
            "impulse_residual": np.where(has_result, unbalanced.max(axis=1), np.nan),
        },
    )


def window_work(contacts: int) -> int:
    """Return the computing time of one window of a graph, in units of about 60 ns."""
    return 60 + 20 * contacts + contacts * contacts


def _follow(graphs: Graphs, most_windows: int, ends: GraphEnds, events: bool) -> Records | None:
    """Call the kernel on all graphs, in threads. Return the log of events if `events` is true, else None."""
    n, contacts = graphs.rates.shape

    def follow_share(share: slice, log: NDArray[np.void]) -> int:
        results = ends.results[share]
        results[...] = np.zeros((), GRAPH_RESULT)
        part = GraphEnds(ends.impulses[share], ends.rates[share], results)
        c, matrices = new_contacts(contacts), new_matrices(contacts)
        follow_graphs(c, matrices, graphs.take(share), most_windows, log.view(np.recarray), part)
        return int(results["n_rows"].sum()) if events else 0

    log = run_in_threads(
        follow_share, n, share=SHARE, log_rows=EVENT_ROWS if events else 0, row_shape=(), log_type=EVENT
    )
    return log.view(np.recarray) if events else None


def _endings(
    results: Records, is_followed: Booleans, is_balanced: Booleans, most_windows: int
) -> list[Ending]:
    """Return all ways in which a graph may have ended, each with the graphs that ended so, a status and a sentence.

    A graph gets the first ending whose condition is true for it. So the endings without a result come first.
    """
    ending = results["ending"]
    failures = [
        Ending(
            ~is_followed,
            "unrepresentable",
            f"where an inverse mass or a stiffness exceeds {MASS_PRECISION:g} times another, squares of velocities "
            "are lost",
        ),
        Ending(
            ending == GraphEnding.GAINED_ENERGY,
            "unrepresentable",
            "energy was made: double precision cannot follow inverse masses and stiffnesses this far apart",
        ),
        Ending(ending == GraphEnding.UNFINISHED, "unconverged", f"not over within {most_windows} windows"),
        Ending(
            ending == GraphEnding.SEARCH_FAILED,
            "unconverged",
            "the search for the first event of a window was given up",
        ),
        Ending(
            ending == GraphEnding.RIGID_UNDECIDED,
            "unconverged",
            "which of several rigid contacts press could not be decided",
        ),
        Ending(
            ~is_balanced,
            "unconverged",
            f"rounding has grown beyond {UNBALANCED:g} in the balance of impulses or energy: the bodies are jammed",
        ),
    ]
    return failures + _closed_forms(results)


def _closed_forms(results: Records) -> list[Ending]:
    """Return one ending for each combination of closed forms with which a graph may have been solved."""
    parts = {"plastic": PLASTIC_REASON, "runaway": RUNAWAY_REASON, "collapse": COLLAPSE_REASON}
    endings: list[Ending] = []
    for bits in range(7, 0, -1):
        used = [name for place, name in enumerate(parts) if bits >> place & 1]
        condition = np.logical_and.reduce([results[name] for name in used])
        endings.append(Ending(condition, "closed-form", "; ".join(parts[name] for name in used)))
    return endings


def checked_graph(delassus: Floats, restitutions: Floats, rates: Floats) -> tuple[Floats, Floats, Floats]:
    """Check the Delassus matrix, the restitutions and the rates of one graph, and return them as arrays of floats.

    A ValueError names the first illegal value.
    """
    W, k, e, w = checked_graphs(delassus[None], np.ones((1, *rates.shape)), restitutions[None], rates[None])
    scaled_graphs(W, k, e, w)
    return W[0], e[0], w[0]


def checked_graphs(
    delassus: ArrayLike, stiffnesses: ArrayLike, restitutions: ArrayLike, rates: ArrayLike
) -> tuple[Floats, Floats, Floats, Floats]:
    """Check all values of n graphs, and return them as arrays of floats; a ValueError names the first illegal value."""
    w = checked_array(_RATES, rates)
    if w.ndim != 2 or not 1 <= w.shape[1] <= MOST_CONTACTS:
        raise ValueError(
            f"rates: shape {w.shape}; legal: from 1 to {MOST_CONTACTS} contacts, one rate per contact"
        )
    n, contacts = w.shape
    W, k, e = (
        checked_array(legal, values)
        for legal, values in (
            (_DELASSUS, delassus),
            (_STIFFNESSES, stiffnesses),
            (_RESTITUTIONS, restitutions),
        )
    )
    for legal, array, shape in (
        (_DELASSUS, W, (n, contacts, contacts)),
        (_STIFFNESSES, k, (n, contacts)),
        (_RESTITUTIONS, e, (n, contacts)),
    ):
        if array.shape != shape:
            raise ValueError(
                f"{legal.name}: shape {array.shape[1:]}; legal: {shape[1:]}, for {contacts} rates"
            )
    diagonal = np.diagonal(W, axis1=1, axis2=2)
    if not (diagonal > 0).all():
        row, i = np.argwhere(~(diagonal > 0))[0]
        raise ValueError(
            f"delassus[{i + 1}, {i + 1}] = {float(diagonal[row, i])!r} in row {row}; legal: > 0 (1/kg), an inverse mass"
        )
    with np.errstate(under="ignore", over="ignore"):
        scale = np.sqrt(diagonal)[:, :, None] * np.sqrt(diagonal)[:, None, :]
        difference = np.abs(W - np.swapaxes(W, 1, 2)) / scale
    if not (difference <= ASYMMETRY).all():
        row, i, j = np.argwhere(~(difference <= ASYMMETRY))[0]
        raise ValueError(
            f"delassus[{i + 1}, {j + 1}] = {float(W[row, i, j])!r}, but [{j + 1}, {i + 1}] = {float(W[row, j, i])!r} "
            f"in row {row}; legal: a symmetric matrix"
        )
    resting = np.flatnonzero(~(w > 0).any(axis=1))
    if resting.size:
        row = int(resting[0])
        raise ValueError(
            f"rates = {w[row].tolist()} in row {row}: nothing approaches; legal: at least one > 0 (m/s)"
        )
    return W, k, e, w


def scaled_graphs(
    W: Floats, k: Floats, e: Floats, w: Floats
) -> tuple[Graphs, tuple[Floats, Floats, Floats], Booleans]:
    """Scale graphs so that their values are about 1.

    The function returns the scaled graphs, their units of mass, time and velocity, and True for each graph that can be
    followed in double precision. For each graph the unit of mass is 1/W_11, the unit of time is sqrt(1/(W_11 k_1)), and
    the unit of velocity is the largest rate. By Theorem 5 of the paper the outcome does not depend on the units. A
    ValueError names a Delassus matrix W with a negative eigenvalue, or rates outside the range of W.
    """
    contacts = w.shape[1]
    mass, speed = 1 / W[:, 0, 0], np.abs(w).max(axis=1)
    diagonal = np.diagonal(W, axis1=1, axis2=2)
    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        time = np.sqrt(mass) / np.sqrt(k[:, 0])
        scaled_k, scaled_w = k / k[:, :1], w / speed[:, None]
        scaled_W = 0.5 * (W + np.swapaxes(W, 1, 2)) * mass[:, None, None]
        root = np.sqrt(diagonal * mass[:, None])
        is_followed = np.ones(len(w), bool)
        for values in (diagonal, k):
            is_followed &= values.max(axis=1) <= MASS_PRECISION * values.min(axis=1)
        root[~is_followed] = 1.0
        correlation = scaled_W / (root[:, :, None] * root[:, None, :])
    correlation[~is_followed] = np.eye(contacts)
    # If the normals of two contacts are at right angles, their entry of W differs from 0 by rounding only.
    is_noise = np.abs(correlation) <= ROUNDING
    scaled_W[is_noise] = 0.0
    correlation[is_noise] = 0.0
    values, vectors = np.linalg.eigh(correlation)
    lowest, highest = values[:, 0], values[:, -1]
    negative = np.flatnonzero(lowest < -NEGATIVE * highest)
    if negative.size:
        row = int(negative[0])
        raise ValueError(
            f"delassus in row {row}: an eigenvalue of {float(lowest[row])!r} (with 1 on the diagonal); legal: "
            "none below 0, as of W = J M^-1 J^T"
        )
    parts = np.einsum("nij,ni->nj", vectors, scaled_w / root)
    is_null = values <= 8 * contacts * 2.0**-52 * highest[:, None]
    outside = np.sqrt((np.where(is_null, parts, 0.0) ** 2).sum(axis=1) / (parts**2).sum(axis=1))
    beyond = np.flatnonzero(is_followed & (outside > OUTSIDE))
    if beyond.size:
        row = int(beyond[0])
        raise ValueError(
            f"rates = {w[row].tolist()} in row {row}: a share of {float(outside[row]):.3g} lies outside the range of "
            "the singular W; legal: rates -J v of velocities v"
        )
    energies = 0.5 * (np.where(is_null, 0.0, parts) ** 2 / np.where(is_null, 1.0, values)).sum(axis=1)
    rates = np.where(is_followed[:, None], scaled_w, 1.0)
    stiffnesses = np.where(is_followed[:, None], scaled_k, 1.0)
    scaled_W[~is_followed] = np.eye(contacts)
    graphs = Graphs(scaled_W, stiffnesses, e.copy(), rates, energies)
    return graphs, (mass, time, speed), is_followed
