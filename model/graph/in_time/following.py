"""Solution of many contact graphs by a contact law that is integrated over time.

`solve_timed_graphs` takes and returns arrays in SI units.

Needs `in_time.kernel`, and `graph.solving` for the checks of the input. Used by `compliant_baselines.references`.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import cast

import numpy as np
from numpy.typing import ArrayLike

from impact_xval.model.arrays import Booleans, Floats, Integers, Records, zero_records
from impact_xval.model.chain.following import COLLAPSE_REASON, RUNAWAY_REASON
from impact_xval.model.chain.laws import Law
from impact_xval.model.compiled import run_in_threads
from impact_xval.model.graph.in_time.kernel import follow_timed_graphs
from impact_xval.model.graph.in_time.law import GRAPH_LAWS
from impact_xval.model.graph.in_time.record import TIMED_RESULT, TimedEnding
from impact_xval.model.graph.in_time.state import new_timed_contacts, new_timed_matrices
from impact_xval.model.graph.record import GraphEnds
from impact_xval.model.graph.solving import (
    LEAST_WINDOWS,
    MOST_WORK,
    SHARE,
    UNBALANCED,
    checked_graphs,
    scaled_graphs,
    window_work,
)
from impact_xval.model.inputs import MASS_PRECISION
from impact_xval.model.status import IS_RESULT, STATUSES, Ending, Status, first_endings, reason_texts_of


@dataclass(frozen=True, slots=True, eq=False)
class TimedGraphOutcomes:
    """Results of n graphs with C contacts each, for a contact law that is integrated over time.

    Attributes
    ----------
    impulses, rates : ndarray, shape (n, C)
        Total impulses in N s, and rates of compression in m/s when the collision is over; NaN where there is no result.
    status, reason : ndarray of int, shape (n,)
        Indices: `status` into the tuple `STATUSES`, `reason` into `reason_texts`.
    reason_texts : tuple of str
        Sentences that explain a status.
    duration : ndarray, shape (n,)
        Time from first touch to the end of the collision, in s.
    n_events, n_windows : ndarray of int, shape (n,)
    """

    impulses: Floats
    rates: Floats
    status: Integers
    reason: Integers
    reason_texts: tuple[str, ...]
    duration: Floats
    n_events: Integers
    n_windows: Integers

    @property
    def has_result(self) -> Booleans:
        """True for each graph whose impulses and rates are a result; shape (n,)."""
        return IS_RESULT[self.status]

    def status_of(self, i: int) -> Status:
        """Return the status of graph i as a text, such as 'ok'."""
        return cast("Status", STATUSES[int(self.status[i])])


def solve_timed_graphs(
    law: Law,
    delassus: ArrayLike,
    stiffnesses: ArrayLike,
    restitutions: ArrayLike,
    rates: ArrayLike,
    dampings: ArrayLike,
    *,
    frozen: bool = False,
    max_windows: int | None = None,
) -> TimedGraphOutcomes:
    """Solve n contact graphs with C contacts each on all processors, by a contact law that is integrated over time.

    Parameters
    ----------
    law : Law
        Law of all contacts, one of `GRAPH_LAWS` of `graph.in_time.law`.
    delassus : array_like, shape (n, C, C)
        Delassus matrices in 1/kg.
    stiffnesses, restitutions, rates : array_like, shape (n, C)
        Stiffnesses in N/m, coefficients of restitution, and rates of compression at first touch in m/s. `solve_graph`
        states their legal ranges. Only bistiffness uses the restitutions, which then have to be above 0.
    dampings : array_like, shape (n, C)
        Dampings of the dashpots in N s/m; 0 for bistiffness.
    frozen : bool
        Whether gaps are ignored, as in the model: a contact that has opened returns as soon as its bodies approach.
    max_windows : int, optional
        Largest number of windows of a graph. A graph that needs more is given up. The argument can only lower the
        default, which takes about a second.

    Returns
    -------
    TimedGraphOutcomes
        The status of a graph is ``closed-form`` if a closed form was used, ``timeout`` after too many windows,
        ``unconverged`` if the graph was given up for another reason, ``unrepresentable`` if its inverse masses or its
        stiffnesses are too far apart for double precision, and else ``ok``.

    Raises
    ------
    ValueError
        For an illegal value; the message names the field, the value and the legal range.
    """
    if law not in GRAPH_LAWS:
        raise ValueError(f"law = {law.name}; legal: {', '.join(each.name for each in GRAPH_LAWS)}")
    graphs, (mass, time, speed), is_followed = scaled_graphs(
        *checked_graphs(delassus, stiffnesses, restitutions, rates)
    )
    n, contacts = graphs.rates.shape
    with np.errstate(over="ignore", invalid="ignore"):
        scaled_dampings = np.asarray(dampings, float) * (time / mass)[:, None]
    scaled_dampings[~is_followed] = 0.0
    most = max(LEAST_WINDOWS, MOST_WORK // window_work(contacts))
    most = most if max_windows is None else min(most, max_windows)
    results = zero_records(n, TIMED_RESULT)
    impulses, final_rates = np.full((n, contacts), np.nan), np.full((n, contacts), np.nan)

    def follow_share(share: slice, _: object) -> int:
        ends = GraphEnds(impulses[share], final_rates[share], results[share])
        c, matrices = new_timed_contacts(contacts, law, frozen), new_timed_matrices(contacts)
        follow_timed_graphs(c, matrices, graphs.take(share), scaled_dampings[share], most, ends)
        return 0

    run_in_threads(follow_share, n, share=SHARE, log_rows=0, row_shape=(), log_type=np.dtype(np.uint8))
    unbalanced = np.abs(graphs.rates - (graphs.delassus @ impulses[:, :, None])[:, :, 0] - final_rates)
    is_balanced = (unbalanced.max(axis=1) <= UNBALANCED) & (np.abs(results["energy_residual"]) <= UNBALANCED)
    endings = _endings(results, is_followed, is_balanced, most)
    status, reason = first_endings(endings, n)
    blank = ~IS_RESULT[status]
    return TimedGraphOutcomes(
        impulses=np.where(blank[:, None], np.nan, impulses * (mass * speed)[:, None]),
        rates=np.where(blank[:, None], np.nan, final_rates * speed[:, None]),
        status=status.astype(np.int64),
        reason=reason.astype(np.int64),
        reason_texts=reason_texts_of(endings),
        duration=np.where(blank, np.nan, results["time"] * time),
        n_events=results["n_events"].copy(),
        n_windows=results["n_windows"].copy(),
    )


def _endings(
    results: Records, is_followed: Booleans, is_balanced: Booleans, most_windows: int
) -> list[Ending]:
    """Return all ways in which a graph may have ended, each with the graphs that ended so, a status and a sentence.

    A graph gets the first ending whose condition is true for it. So the endings without a result come first.
    """
    ending = results["ending"]
    endings = [
        Ending(
            ~is_followed,
            "unrepresentable",
            f"where an inverse mass or a stiffness exceeds {MASS_PRECISION:g} times another, squares of velocities "
            "are lost",
        ),
        Ending(
            ending == TimedEnding.GAINED_ENERGY,
            "unrepresentable",
            "energy was made: double precision cannot follow inverse masses and stiffnesses this far apart",
        ),
        Ending(ending == TimedEnding.UNFINISHED, "timeout", f"not over within {most_windows} windows"),
        Ending(
            ending == TimedEnding.SEARCH_FAILED,
            "unconverged",
            "the search for the first event of a window was given up",
        ),
        Ending(
            ending == TimedEnding.HELD,
            "unconverged",
            "contacts that are rigid to rounding hold a loaded one at rest: the bodies are jammed",
        ),
        Ending(
            ending == TimedEnding.PULLED_OPEN,
            "unconverged",
            "a contact that is rigid to rounding was pulled open: with positions it may close again with a blow",
        ),
        Ending(
            ~is_balanced,
            "unconverged",
            f"rounding has grown beyond {UNBALANCED:g} in the balance of impulses or energy: the bodies are jammed",
        ),
    ]
    for runaway, collapse in product((True, False), repeat=2):
        parts = [(runaway, RUNAWAY_REASON), (collapse, COLLAPSE_REASON)]
        if runaway or collapse:
            condition = (results["runaway"] == runaway) & (results["collapse"] == collapse)
            endings.append(
                Ending(condition, "closed-form", "; ".join(text for is_used, text in parts if is_used))
            )
    return endings
