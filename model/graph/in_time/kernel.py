"""The compiled kernel of graphs with contact laws over time: it follows each graph to the end of its collision.

Python calls `follow_timed_graphs`, which follows many graphs. `collide` follows one graph. While a contact is active,
the graph moves window by window. Over a window every rate of compression, every depth and every force is a polynomial
in time (`in_time.motion`). So the first event of the window is found with certainty (`in_time.event`). The law states
how an event changes its contact (`in_time.law`). While no contact is active, the bodies fly until a gap closes; if no
gap closes, the collision is over.

Used by `in_time.following`.
"""

from __future__ import annotations

from math import inf

from impact_xval.model.chain import laws
from impact_xval.model.chain.laws import Watched, has_dashpot, is_active
from impact_xval.model.compiled import kernel_entry, kernel_helper
from impact_xval.model.graph.in_time.event import first_event
from impact_xval.model.graph.in_time.motion import expand, place, start_window, window_length
from impact_xval.model.graph.in_time.record import TimedEnding
from impact_xval.model.graph.in_time.rigid import is_pulled_open, make_rigid, ringing_ends
from impact_xval.model.graph.in_time.state import (
    bring_to_rest,
    energy_left,
    is_moving,
    spring_energy,
    still_rounding,
    write_forces,
)
from impact_xval.model.graph.kernel import COLLAPSED, GAIN
from impact_xval.model.graph.state import rounding_energy
from impact_xval.model.pair.law import Phase


@kernel_helper
def begin(c, matrices, graphs, dampings, graph):
    """Set all contacts of a graph to their state at first touch.

    No contact is active yet. The start rule (`in_time.law`) makes contacts active at the beginning of the first window.
    """
    for i in range(c.size):
        contact = c[i]
        contact.k, contact.e = graphs.stiffnesses[graph, i], graphs.restitutions[graph, i]
        contact.original, contact.b = contact.k, dampings[graph, i]
        contact.w, contact.delta, contact.F = graphs.rates[graph, i], 0.0, 0.0
        contact.impulse, contact.reach = 0.0, 0.0
        contact.phase, contact.is_rigid, contact.force_is_zero = Phase.INACTIVE, False, False
        for j in range(c.size):
            matrices.full[i, j] = matrices.W[i, j] = graphs.delassus[graph, i, j]


@kernel_helper
def first_gap(c):
    """Return the contact whose gap closes first while no contact is active, and the time until it closes.

    The contact is -1 if no gap closes.
    """
    first_contact, first = -1, inf
    for i in range(c.size):
        contact = c[i]
        if contact.w > 0 and max(0.0, -contact.delta / contact.w) < first:
            first_contact, first = i, max(0.0, -contact.delta / contact.w)
    return first_contact, first


@kernel_helper
def fly(c, time):
    """Move a graph without active contacts by a time: depths change at constant rates."""
    for i in range(c.size):
        contact = c[i]
        if time > 0:
            contact.force_is_zero = False
        if not (contact.frozen or contact.is_rigid):
            contact.delta += time * contact.w
        if contact.phase == Phase.SLACK and contact.delta <= 0:
            contact.phase = Phase.INACTIVE


@kernel_helper
def apply_event(c, matrices, i, watched, energy, result):
    """Apply the event of contact i, and return the strain energy that it loses.

    `watched` is the function that has reached zero. `energy` is the energy of impact. For a law with a dashpot the
    returned energy has no meaning.
    """
    contact = c[i]
    before = spring_energy(contact)
    if watched == Watched.RATE:
        contact.w = 0.0
    if has_dashpot(contact):
        laws.apply_dashpot_event(contact, watched)
        contact.force_is_zero = watched == Watched.FORCE
    elif contact.phase == Phase.INACTIVE:
        laws.reactivate(contact)
    elif contact.phase == Phase.RESTITUTION and watched == Watched.RATE:
        laws.restart_compression(contact)
    elif watched == Watched.GAP or before <= rounding_energy(contact, energy):
        laws.deactivate(contact)
    else:
        laws.end_compression(contact)
        write_forces(c)
        if contact.e < 1 and ringing_ends(c, matrices.W, i):
            result.runaway = True
            make_rigid(c, matrices, i)
    return before - spring_energy(contact)


@kernel_helper
def collide(c, matrices, energy, most_windows, result):
    """Follow a graph from first touch to the end of its collision, and return the strain energy that it lost.

    The returned energy has a meaning for bistiffness only. All fields of `result`, a record of
    `in_time.record.TIMED_RESULT`, are filled in except `energy_residual`.
    """
    ending, events, windows = TimedEnding.UNFINISHED, 0, 0
    loss, time = 0.0, 0.0
    while True:
        if not has_dashpot(c[0]):
            write_forces(c)
            still_rounding(c, matrices.W, energy)
            if 0 < energy_left(c, matrices.W) <= COLLAPSED * energy:
                dropped, is_lossy = bring_to_rest(c)
                loss += dropped
                result.collapse |= is_lossy
        start_window(c)
        moves = False
        for i in range(c.size):
            moves |= is_moving(c[i])
        gap, flight = -1, 0.0
        if not moves:
            gap, flight = first_gap(c)
            if gap < 0:
                ending = TimedEnding.FREE
                break
        if windows == most_windows:
            break
        windows += 1
        if not moves:
            fly(c, flight)
            time += flight
            if not is_active(c[gap]):
                loss += apply_event(c, matrices, gap, Watched.GAP, energy, result)
                events += 1
            continue
        h = window_length(c, matrices.W)
        if h == inf:
            ending = TimedEnding.HELD
            break
        expand(c, matrices, h)
        event = first_event(c)
        if event.x < 0:
            ending = TimedEnding.SEARCH_FAILED
            break
        x = min(event.x, 1.0)
        if is_pulled_open(c, matrices.pivots, x):
            ending = TimedEnding.PULLED_OPEN
            break
        if x > 0:
            place(c, x, h)
            time += x * h
            for i in range(c.size):
                c[i].force_is_zero = False
        if event.contact >= 0:
            loss += apply_event(c, matrices, event.contact, event.watched, energy, result)
            events += 1
    result.ending, result.n_events, result.n_windows, result.time = ending, events, windows, time
    return loss


@kernel_entry
def follow_timed_graphs(c, matrices, graphs, dampings, most_windows, ends):
    """Follow the collisions of n graphs with C contacts each. Python calls no other compiled function of this module.

    Parameters
    ----------
    c : recarray of `in_time.state.TIMED_CONTACT`, shape (C,)
        Working memory for the contacts of one graph. The fields `law`, `frozen`, `p`, `g` and `a` are read, and all
        other fields are overwritten.
    matrices : TimedMatrices
        Working memory for the matrices of one graph; overwritten.
    graphs : Graphs
        The graphs, scaled so that all values are about 1.
    dampings : ndarray, shape (n, C)
        Dampings of the contacts, in the scaled units of `graphs`.
    most_windows : int
        Largest number of windows of a graph. A graph that needs more is given up.
    ends : GraphEnds
        Filled in. Its results are records of `in_time.record.TIMED_RESULT`, and have to be zeros before the call.
    """
    for graph in range(graphs.rates.shape[0]):
        result, energy = ends.results[graph], graphs.energies[graph]
        begin(c, matrices, graphs, dampings, graph)
        loss = collide(c, matrices, energy, most_windows, result)
        taken_up = 0.0
        for i in range(c.size):
            ends.impulses[graph, i], ends.rates[graph, i] = c[i].impulse, c[i].w
            taken_up += 0.5 * c[i].impulse * (graphs.rates[graph, i] + c[i].w)
        is_exact = not has_dashpot(c[0])
        result.energy_residual = (taken_up - loss) / energy if is_exact else 0.0
        if result.ending == TimedEnding.FREE and not taken_up >= -GAIN * energy:
            result.ending = TimedEnding.GAINED_ENERGY
