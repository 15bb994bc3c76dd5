"""Solutions of contact graphs by the state-transition model, given their Delassus matrices.

`solve_graph` solves one graph, `solve_graphs` many; `solve_graph_collision` solves a graph of bodies. This module
checks the input, scales it to units of about 1, calls the kernel in threads, and builds outcomes in SI units.

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

#: Work after which a graph is given up, about a second; and number of windows that every graph may have in any case. A
#: chain of 60 contacts needs up to 10,000 windows. `window_work` is the work of one window.
MOST_WORK, LEAST_WINDOWS = 15_000_000, 20_000

#: Graphs that a thread follows in one call; rows per graph that a log of events has at first.
SHARE, EVENT_ROWS = 512, 24

#: Largest magnitude of a negative eigenvalue that is rounding, as a share of the largest eigenvalue; W is scaled to
#: ones on its diagonal.
NEGATIVE = 1e-10

#: Largest part of the rates outside the range of W that is rounding, as a share of the rates.
OUTSIDE = 1e-9

#: Largest residual of the balances of impulses and of energy with which the numbers of a graph are a result. Jammed
#: bodies exceed it: they ring without end at ever higher stiffnesses, until their rates are only rounding.
UNBALANCED = 1e-9

#: Largest difference of W_ij and W_ji that is rounding, over sqrt(W_ii W_jj).
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
        W = J M^-1 J^T in 1/kg, where row J_i belongs to contact i. W is symmetric, without negative eigenvalues, and
        with a positive diagonal. It may be singular. C is from 1 to `MOST_CONTACTS`.
    stiffnesses : array_like, shape (C,)
        In N/m; positive, finite.
    restitutions : array_like, shape (C,)
        Coefficients of energetic restitution, from 0 (perfectly plastic) to 1 (elastic).
    rates : array_like, shape (C,)
        Rates of compression -J v at first touch, in m/s, in the range of W. At least one is positive.
    max_windows : int, optional
        Number of windows after which a graph is given up; the default takes about a second.
    grazing_threshold : float
        Grazing margin below which the outcome is marked.

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
    """Solve one collision of bodies by the state-transition model.

    Parameters
    ----------
    collision : GraphCollision
    max_windows, grazing_threshold
        As for `solve_graph`.

    Returns
    -------
    GraphOutcome
        With velocities, v + M^-1 J^T I, and with angular velocities where bodies turn.

    Raises
    ------
    ValueError
        If W leaves double precision.
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
    """Solve n contact graphs of one number of contacts by the state-transition model, on all processors.

    Parameters
    ----------
    delassus : array_like, shape (n, C, C)
    stiffnesses, restitutions, rates : array_like, shape (n, C)
        As for `solve_graph`.
    max_windows, grazing_threshold
        As for `solve_graph`.
    events : bool
        Whether outcomes have their events, and the sets of active contacts.

    Returns
    -------
    GraphOutcomes
        Status ``closed-form`` where a closed form was used, ``unconverged`` where a graph was given up,
        ``unrepresentable`` where inverse masses or stiffnesses are too far apart for double precision, else ``ok``.

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
    """Return the work of a window of a graph, in units of some 60 ns."""
    return 60 + 20 * contacts + contacts * contacts


def _follow(graphs: Graphs, most_windows: int, ends: GraphEnds, events: bool) -> Records | None:
    """Call the kernel on all graphs, in threads, and return the log of events, if it is asked for."""
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
    """Return the endings that graphs may have; the endings without a result come first."""
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
    """Return the endings of graphs that a closed form finished: one ending for each combination of closed forms."""
    parts = {"plastic": PLASTIC_REASON, "runaway": RUNAWAY_REASON, "collapse": COLLAPSE_REASON}
    endings: list[Ending] = []
    for bits in range(7, 0, -1):
        used = [name for place, name in enumerate(parts) if bits >> place & 1]
        condition = np.logical_and.reduce([results[name] for name in used])
        endings.append(Ending(condition, "closed-form", "; ".join(parts[name] for name in used)))
    return endings


def checked_graph(delassus: Floats, restitutions: Floats, rates: Floats) -> tuple[Floats, Floats, Floats]:
    """Check Delassus matrix, restitutions and rates of one graph; a ValueError names the first illegal value."""
    W, k, e, w = checked_graphs(delassus[None], np.ones((1, *rates.shape)), restitutions[None], rates[None])
    scaled_graphs(W, k, e, w)
    return W[0], e[0], w[0]


def checked_graphs(
    delassus: ArrayLike, stiffnesses: ArrayLike, restitutions: ArrayLike, rates: ArrayLike
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return the fields as arrays; a ValueError names the first illegal one."""
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
    """Return graphs in units of about 1; their units of mass, time and velocity; and which graphs can be followed.

    The units are 1/W_11, sqrt(1/(W_11 k_1)), and the largest rate (Theorem 5). A ValueError names a W with a negative
    eigenvalue, and rates outside its range.
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
    # Contacts with normals at right angles have an entry that is 0 but for rounding.
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
